"""The pages in a real browser, where there is one: no message on the console, the record on one sheet of A4."""

from __future__ import annotations

import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import pytest

from imufield.deliver.parameters.file import load
from imufield.deliver.report.data import ReportData
from imufield.deliver.report.page import render_record, render_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "exports" / "example.toml"
pytestmark = pytest.mark.skipif(BROWSER is None, reason="install chromium to look at the pages as a browser does")


def browse(page: Path, *options: str) -> str:
    """Open a page; return what the browser has to say."""
    common = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        f"--user-data-dir={page.parent}/browser",
    ]
    done = subprocess.run(
        [str(BROWSER), *common, *options, page.as_uri()], capture_output=True, text=True, timeout=250, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    return done.stderr


@pytest.mark.parametrize(("name", "sheets"), [("report", 5), ("record", 1)])
def test_pages_open_without_a_message_and_print(tmp_path: Path, name: str, sheets: int) -> None:
    data = ReportData(parameters=load(EXAMPLE))
    page = tmp_path / f"{name}.html"
    page.write_text(render_report(data) if name == "report" else render_record(data), encoding="utf-8")
    printed = tmp_path / "page.pdf"
    messages = browse(page, "--no-pdf-header-footer", f"--print-to-pdf={printed}")
    assert "CONSOLE" not in messages
    count = len(re.findall(rb"/Type\s*/Page\b", printed.read_bytes()))
    assert 1 <= count <= sheets


@pytest.mark.parametrize("name", ["report", "record"])
@pytest.mark.parametrize("width", [390, 1366])
def test_nothing_is_wider_than_the_window(tmp_path: Path, width: int, name: str) -> None:
    """A script beside the page measures it; the page itself holds none. Only drawings may be swiped, on a phone."""
    data = ReportData(parameters=load(EXAMPLE))
    text = render_report(data) if name == "report" else render_record(data)
    # In a frame: a window of its own has a least width of 500.
    script = """<script>
      const frame = document.querySelector("iframe");
      frame.onload = () => {
        const all = [...frame.contentDocument.querySelectorAll("body *")].filter(one => !one.closest("figure"));
        document.title = Math.ceil(Math.max(...all.map(one => one.getBoundingClientRect().right))) + " of " + frame.clientWidth;
      };</script>"""
    page = tmp_path / "report.html"
    framed = f'<iframe srcdoc="{escape(text)}" style="width: {width}px; height: 900px; border: 0"></iframe>'
    page.write_text(f'<!DOCTYPE html><meta charset="utf-8"><body style="margin: 0">{framed}{script}', encoding="utf-8")
    done = subprocess.run(
        [
            str(BROWSER),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--window-size=1500,900",
            "--virtual-time-budget=5000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )
    found = re.search(r"<title>(\d+) of (\d+)</title>", done.stdout)
    assert found
    assert int(found[1]) <= int(found[2])
