"""The built documentation: a section for every command and instrument, and no link that leads nowhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from imufield.acquire.registry import driver_names, load_driver
from imufield.cli.app import make_app

pytest.importorskip("mkdocs", reason="install the docs extra to build the pages")
pytest.importorskip("towncrier", reason="install the dev extra to join the list of changes")
PROJECT = Path(__file__).resolve().parent.parent


def build(config: Path, output: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(config), "--site-dir", str(output)]
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    return subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False, env=environment)


def test_every_command_and_instrument_has_its_section(tmp_path: Path) -> None:
    done = build(PROJECT / "mkdocs.yml", tmp_path)
    assert done.returncode == 0, done.stderr
    commands = (tmp_path / "commands.html").read_text(encoding="utf-8")
    for name, command in get_command(make_app()).commands.items():  # type: ignore[attr-defined]  # the app is a group
        assert f'<h2 id="{name}">' in commands
        for option in command.params:
            assert option.hidden or all(f"<code>{one}</code>" in commands for one in option.opts if one.startswith("-"))
    instruments = (tmp_path / "instruments.html").read_text(encoding="utf-8")
    for name in driver_names():
        assert f"--driver {name}</code>" in instruments
        assert load_driver(name).status in instruments
        assert f"{load_driver(name).default_baud} bit/s (also {load_driver(name).default_baud}" not in instruments
    assert "921600 bit/s (also 460800, 1843200, 374400)" in instruments
    for line in ("imufield record --port /dev/ttyUSB0 --duration-s 3600", "imufield import drive.blf --driver aceinna_can"):
        assert f"$ {line}\n" in commands, "each example is a line of its own"
    for page in ("security", "contributing", "changes"):
        assert (tmp_path / f"{page}.html").stat().st_size > 3000
    assert "https://cdn" not in commands


def test_a_broken_link_fails_the_build(tmp_path: Path) -> None:
    pages = tmp_path / "docs"
    pages.mkdir()
    (pages / "index.md").write_text("# A\n\n[there](nowhere.md)\n", encoding="utf-8")
    settings = (PROJECT / "mkdocs.yml").read_text(encoding="utf-8")
    head, _, _ = settings.partition("nav:")
    config = tmp_path / "mkdocs.yml"
    config.write_text(head.replace("hooks: [.ci/docs_pages.py]", ""), encoding="utf-8")
    done = build(config, tmp_path / "out")
    assert done.returncode == 1
    assert "nowhere.md" in done.stderr
