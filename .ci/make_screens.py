"""Make the pictures of the guide's screens and of the report: ``make screens``.

An emulated session runs in a pseudo-terminal, of 80 by 24 and of 120 by 40, as a person would see it. At chosen moments the
cells of that terminal are written as text and as SVG, in the colours that were sent. The report is that of the demo, its top
as a browser shows it. They stand in the README and in the documentation.
"""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import select
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from itertools import groupby
from pathlib import Path

import pyte
from rich.console import Console
from rich.style import Style
from rich.terminal_theme import MONOKAI
from rich.text import Text

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "docs" / "screens"
README = ROOT / "README.md"
USUAL = (80, 24)
LARGE = (120, 40)
SPEED = 8
REPORT_SIZE = "760,700"
LONGEST_S = 300.0
BEGIN, END = "<!-- screen: turn -->\n```text\n", "\n```\n<!-- end of screen -->"
_NAMES = {"brown": "yellow"}
"""Colours that the terminal calls otherwise than rich."""


@dataclass(frozen=True)
class Moment:
    """When a picture is taken: the first screen of which this is true, once a number of positions is done."""

    name: str
    done: int
    shows: Callable[[str], bool]


PICTURES = (
    Moment("hold", 4, lambda text: "H O L D" in text and "########...." in text),
    Moment("turn", 8, lambda text: "T U R N" in text and "G O O D" not in text and "moving" in text and "->" in text),
)
WIDE = (Moment("large", 8, lambda text: "T U R N" in text and "G O O D" not in text and "moving" in text and "->" in text),)
BIG = (Moment("big", 0, lambda text: "##" in text and "HOLD" in text),)


class Terminal:
    """A terminal of columns and lines with the program in it."""

    def __init__(self, arguments: list[str], folder: Path, size: tuple[int, int]) -> None:
        self._master, slave = pty.openpty()
        self.width, self._height = size
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", self._height, self.width, 0, 0))
        kept = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "COLORTERM")}
        variables = {**kept, "TERM": "xterm-256color", "HOME": str(folder), "IMUFIELD_CLOCK_SPEED": str(SPEED)}
        command = [sys.executable, "-m", "imufield", *arguments]
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=variables, start_new_session=True
        )
        os.close(slave)
        self._screen = pyte.Screen(*size)
        self._stream = pyte.ByteStream(self._screen)

    @property
    def text(self) -> str:
        """What the screen shows, lines without blanks at their ends."""
        return "\n".join(line.rstrip() for line in self._screen.display).rstrip()

    def wait_for(self, moment: Moment) -> None:
        """Read until the screen shows it."""
        end_s = time.monotonic() + LONGEST_S
        while not (_done(self.text) >= moment.done and moment.shows(self.text)):
            if time.monotonic() > end_s or self.process.poll() is not None:
                raise SystemExit(f"the screen {moment.name!r} did not come; the last one was:\n{self.text}")
            ready, _, _ = select.select([self._master], [], [], 0.2)
            if ready:
                self._stream.feed(os.read(self._master, 65536))

    def close(self) -> None:
        """End the program."""
        # First the terminal: nobody reads it any more, and a program that has filled it would wait for ever.
        os.close(self._master)
        self.process.terminate()
        self.process.wait()

    def styled(self) -> Text:
        """Return the screen with its colours."""
        text = Text()
        for row in range(self._height):
            cells = [self._screen.buffer[row][column] for column in range(self.width)]
            for (colour, bold, dots), run in groupby(
                cells, key=lambda cell: (cell.fg, cell.bold, "\u2800" <= cell.data <= "\u28ff")
            ):
                # Dots come from another font, often a wider one: by themselves they move no letters.
                text.append("".join(cell.data for cell in run), Style(color=_colour(colour), bold=bold, meta={"dots": dots}))
            text.append("\n")
        return text


def _done(text: str) -> int:
    words = text.replace(":", " ").split()
    places = [k for k in range(len(words) - 3) if words[k + 1] == "of" and words[k + 3] == "done" and words[k].isdigit()]
    return int(words[places[0]]) if places else 0


def _colour(name: str) -> str | None:
    if name == "default":
        return None
    return _NAMES.get(name, name.replace("bright", "bright_"))


@contextmanager
def emulator(folder: Path) -> Iterator[str]:
    """Run a virtual instrument in a process of its own; yield the port."""
    options = ["--json", "--wait", "--rate-hz", "250", "--speed", str(SPEED), "--hold-s", "9", "--seed", "4"]
    command = [sys.executable, "-m", "imufield", "emulate", "stim300", *options]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=quiet, text=True, cwd=folder) as process:
        try:
            yield str(json.loads(process.stdout.readline())["port"]) if process.stdout is not None else ""
        finally:
            process.terminate()


def take(moments: tuple[Moment, ...], *options: str, size: tuple[int, int] = USUAL) -> None:
    """Run a session and write its pictures."""
    with tempfile.TemporaryDirectory() as name, emulator(Path(name)) as port:
        command = ["capture", "--port", port, "--driver", "stim300", "--hold-s", "4", "--latitude", "48", "--quiet"]
        terminal = Terminal([*command, "--cable=-x", *options], Path(name), size)
        try:
            for moment in moments:
                terminal.wait_for(moment)
                write(moment.name, terminal)
        finally:
            terminal.close()


def write(name: str, terminal: Terminal) -> None:
    """Write the screen as text and as SVG."""
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.txt").write_text(terminal.text + "\n", encoding="utf-8")
    console = Console(record=True, width=terminal.width, file=StringIO(), force_terminal=True, color_system="256")
    console.print(terminal.styled(), end="")
    svg = console.export_svg(title="imufield capture", theme=MONOKAI, unique_id=f"imufield-{name}")
    # Whoever looks at the picture need not ask a server for a font.
    (FOLDER / f"{name}.svg").write_text(re.sub(r"@font-face \{.*?\}\n", "", svg, flags=re.DOTALL), encoding="utf-8")


def photograph_report() -> None:
    """Run the demo and take a picture of its report."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        raise SystemExit("install chromium, which takes the picture of the report")
    with tempfile.TemporaryDirectory() as name:
        for command in (["demo", "--plain"], ["report"]):
            subprocess.run([sys.executable, "-m", "imufield", *command], cwd=name, check=True, stdout=subprocess.DEVNULL)
        (page,) = Path(name).rglob("report.html")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={name}/browser"]
        picture = [f"--window-size={REPORT_SIZE}", f"--screenshot={FOLDER / 'report.png'}", page.as_uri()]
        subprocess.run([browser, *options, *picture], check=True, capture_output=True)


def refresh_readme() -> None:
    """Put the screen of a turn into the README."""
    before, rest = README.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END, 1)[1]
    screen = (FOLDER / "turn.txt").read_text(encoding="utf-8").rstrip()
    README.write_text(f"{before}{BEGIN}{screen}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    take(PICTURES)
    take(WIDE, size=LARGE)
    take(BIG, "--big")
    photograph_report()
    refresh_readme()
