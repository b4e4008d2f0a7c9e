"""Commands on a terminal say how far they are and what they write, leave it clean, and end at Ctrl-C without half a file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from imufield.errors import EXIT_INTERRUPTED
from imufield.pipeline.reading_cache import CACHE_FILE
from tests.commands.pty_terminal import Terminal
from tests.commands.test_verify import rest_session
from tests.commands.told import missing

if TYPE_CHECKING:
    from tests.commands.conftest import Program

# What is said to be done by commands that take a while for long sessions; "here" is a solved one.
COMMANDS = {
    "solve here": ("solve", "reading", "solving"),
    "solve here again --workers 1": ("solve", "computing"),
    "report here": ("report", "reading", "drawing", "writing report.html"),
    "verify here/parameters.toml here": ("verify", "reading", "solving without some positions", "simulating sessions"),
    "apply here/parameters.toml here -o corrected.csv": ("apply", "reading"),
    "export-data here -o samples.csv": ("export-data", "reading"),
    "import table.csv --output imported": ("import", "reading table.csv"),
    "history . --plot history.svg": ("history", "reading"),
    "noise still": ("noise", "reading"),
    "replay here": ("replay", "reading"),
    "study bsas-bound --quick --workers 1 --output tables": ("study", "computing"),
}
AT_ONCE = [("show_progress_at_once",)]


@pytest.fixture
def here(program: Program, short_solved: Path) -> Path:
    # Without what is kept of its replay: reading it again is what takes long.
    shutil.copytree(short_solved, program.folder / "here", ignore=shutil.ignore_patterns(CACHE_FILE))
    return program.folder / "here"


def start(terminals: list[Terminal], program: Program, command: str) -> Terminal:
    terminals.append(Terminal(program, *command.split(), at_start=AT_ONCE))
    return terminals[-1]


def lines(terminal: Terminal) -> list[str]:
    """Return what stands on the screen: of each line what was written since it was erased."""
    return [line.rpartition("\x1b[K")[2].rstrip("\r") for line in terminal.raw.split("\n")]


def test_the_screen_is_what_was_written_since_it_was_erased() -> None:
    terminal = Terminal.__new__(Terminal)
    terminal.raw = "\r\x1b[Ksolve: 1 s\r\x1b[Kdone\r\n\r\x1b[Kreading"
    assert lines(terminal) == ["done", "reading"]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_says_what_it_does_and_writes_and_leaves_the_terminal_clean(
    program: Program, here: Path, terminals: list[Terminal], command: str
) -> None:
    shutil.copytree(here, program.folder / "again")
    rows = ("time_s,ax,ay,az,gx,gy,gz", *(f"{number / 100},0.0,0.0,9.8,0,0,0.01" for number in range(300)))
    (program.folder / "table.csv").write_text("\n".join(rows))
    if "still" in command:
        rest_session(program.folder / "still", 600.0)
    before = set(program.folder.iterdir()) | set(here.iterdir())
    terminal = start(terminals, program, command)
    assert terminal.wait() == 0, terminal.text
    # Hidden are the index of a history and what is kept of a replay, which are nobody's results.
    made = [path for path in (*program.folder.iterdir(), *here.iterdir()) if path not in before and path.name[0] != "."]
    assert not missing(terminal.text, *(path.name for path in made))
    drawn = [words.partition(":")[0] for words in terminal.raw.split("\r\x1b[K") if ":" in words]
    assert set(COMMANDS[command]) <= set(drawn)
    left = lines(terminal)
    assert left[-1] == ""
    assert not [line for line in left if line.startswith(tuple(f"{words}: " for words in COMMANDS[command]))]


@pytest.mark.parametrize("task", ["reading", "drawing", "writing report.pdf"])
def test_an_interrupt_ends_every_phase_with_nothing_half_written(
    program: Program, here: Path, terminals: list[Terminal], task: str
) -> None:
    pytest.importorskip("weasyprint", reason="needs the pdf extra")
    before = {path.name for path in here.iterdir()}
    terminal = start(terminals, program, "report here --pdf")
    terminal.expect(f"{task}:")
    terminal.type("\x03")
    assert terminal.wait() == EXIT_INTERRUPTED
    assert lines(terminal)[-1] == ""
    whole = {"report.html", "calibration-record.html"} if task == "writing report.pdf" else set()
    # What is kept of a replay is whole, too, but nobody's result.
    assert {path.name for path in here.iterdir()} - {CACHE_FILE} == before | whole


def test_a_pipe_gets_no_line(program: Program, here: Path) -> None:
    ended = program.run("solve", here, at_start=AT_ONCE)
    assert ended.returncode == 0
    assert ended.stderr == ""
    assert "reading:" not in ended.stdout
