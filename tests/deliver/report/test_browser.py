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
from tests.web.browser import PROGRAMS

BROWSER = next(filter(None, map(shutil.which, PROGRAMS)), None)
EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "exports" / "example.toml"
WIDTHS = (390, 1366)
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


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], tuple[int, int]]:
    """Return how far each page reaches in windows of each width, and how wide they are: all in one run of the browser.

    A script beside the pages measures them; they hold none. Only drawings may be swiped, on a phone.
    """
    data = ReportData(parameters=load(EXAMPLE))
    texts = {"report": render_report(data), "record": render_record(data)}
    sizes = [(name, width) for width in WIDTHS for name in texts]
    # In frames: a window of its own has a least width of 500.
    frames = "".join(
        f'<iframe srcdoc="{escape(texts[name])}" style="width: {width}px; height: 900px; border: 0"></iframe>'
        for name, width in sizes
    )
    script = """<script>
      onload = () => {
        document.title = [...document.querySelectorAll("iframe")].map(frame => {
          const all = [...frame.contentDocument.querySelectorAll("body *")].filter(one => !one.closest("figure"));
          return Math.ceil(Math.max(...all.map(one => one.getBoundingClientRect().right))) + " of " + frame.clientWidth;
        }).join(", ");
      };</script>"""
    page = tmp_path_factory.mktemp("frames") / "frames.html"
    page.write_text(f'<!DOCTYPE html><meta charset="utf-8"><body style="margin: 0">{frames}{script}', encoding="utf-8")
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
    title = re.search(r"<title>([^<]*)</title>", done.stdout)
    assert title
    found = [(int(right), int(width)) for right, width in re.findall(r"(\d+) of (\d+)", title[1])]
    return dict(zip(sizes, found, strict=True))


@pytest.mark.parametrize("name", ["report", "record"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_window(measured: dict[tuple[str, int], tuple[int, int]], width: int, name: str) -> None:
    right, window = measured[name, width]
    assert window == width
    assert 0 < right <= window
