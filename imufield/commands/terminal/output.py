"""What a command gives away: files beside the parameter file, sentences for a person, and the clock that is told of."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from imufield.acquire.link.host_clock import HostClock, ScaledClock, SystemClock
from imufield.deliver.parameters.printed_numbers import beside, shown_on
from imufield.drawing.printed_lines import aligned
from imufield.errors import UsageError
from imufield.files import open_to_read, refuse_overwriting, typed_write_errors, write_atomically
from imufield.progress import hidden
from imufield.sentences import Sentences, folded, printable, printable_lines

sentence = Sentences(__package__)

_HEAD_BYTES = 512  # The mark stands in the first lines of every file of ours.


class NothingRecorded(KeyboardInterrupt):
    """Ctrl-C before the first byte was written."""


class NoAnswer(KeyboardInterrupt):
    """The input ended where a question was asked."""


@contextmanager
def before_recording() -> Iterator[None]:
    """Let an interrupt say that nothing was recorded.

    Raises
    ------
    NothingRecorded
        Instead of the interrupt, at a question too.
    """
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise NothingRecorded(*interrupt.args) from interrupt


def write_output(path: Path, data: bytes, *, as_json: bool = False) -> None:
    """Write a file in one step and say which; on standard error where standard output is for a program.

    Raises
    ------
    ParameterFileError
        If it cannot be written; what stood there is intact.
    """
    with typed_write_errors(path):
        write_atomically(path, data)
    tell_written(path, as_json=as_json)


def tell_written(path: Path, kept: Path | None = None, *, as_json: bool = False) -> None:
    """Say which file was written, and where the one that stood there is kept; on standard error beside JSON."""
    echo(beside("written to", path), err=as_json)
    if kept is not None:
        say(sentence("output.kept", name=kept.name), err=as_json)


def replace_only(path: Path, mark: str, option: str, what: str) -> None:
    """Let an output go over nothing but an earlier one of its own kind.

    Parameters
    ----------
    path : Path
        It need not exist.
    mark : str
        What stands at the beginning of such a file.
    option, what : str
        For the sentence, e.g. "--truth" and "the truth of an emulation".

    Raises
    ------
    UsageError
        If ``path`` holds something else.
    """
    refuse_overwriting(path)
    try:
        with open_to_read(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return  # not there, or no file: writing says which
    # An empty file is nobody's work: touch and mktemp leave them.
    if head and mark.encode() not in head:
        raise UsageError(sentence("output.something_else", option=option, path=path, what=what))


def echo(text: str = "", *, begin: str = "", end: str = "\n", err: bool = False) -> None:
    """Print lines; all that commands print goes through here, ``say`` or ``imufield.console``.

    What controls a terminal in ``text`` came from somebody else and is shown instead; ``begin`` and ``end`` are ours.
    """
    with hidden():
        _write(f"{begin}{printable_lines(text)}{end}", err=err)


def echo_table(rows: Sequence[Sequence[str]], places: str) -> None:
    """Print rows with their cells below each other; each column goes to its place, "<" the left or ">" the right."""
    # Headings of two words need two blanks between them.
    spaced = {"<": "{} ", ">": " {}"}
    cells = [[(spaced[place].format(cell), "") for cell, place in zip(row, places, strict=False)] for row in rows]
    for line in aligned(cells, places):
        echo(shown_on(sys.stdout, "".join(words for words, _ in line).rstrip()))


def echo_path(path: Path) -> None:
    """Print a path alone: a script gets what it can open, a terminal what it can show."""
    text = str(path)
    with hidden():
        _write(f"{printable(text) if sys.stdout.isatty() else text}\n")


def say(line: str, *, err: bool = False, indent: int = 0, color: str | None = None) -> None:
    """Print a sentence with its words whole; lines below the first are indented.

    A terminal breaks words in two; a pipe or a log gets the sentence as one line.
    """
    line = printable_lines(line)
    if (sys.stderr if err else sys.stdout).isatty():
        line = textwrap.fill(
            line,
            shutil.get_terminal_size().columns,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
    with hidden():
        _write(f"{line}\n", err=err, color=color)


def _write(text: str, *, err: bool = False, color: str | None = None) -> None:
    stream = sys.stderr if err else sys.stdout
    if color is None and os.name == "posix" and (stream.encoding or "").lower() == "utf-8":
        stream.write(text)
        stream.flush()
        return
    # Colours, consoles of Windows and other encodings are what typer is good at; most commands need none of it.
    import typer

    typer.echo(text if color is None else typer.style(text, fg=color), nl=False, err=err)


def say_each(sentences: Iterable[str], *, err: bool = False, indent: int = 0, begin: str = "") -> None:
    """Print a list of sentences, of many of a kind the worst."""
    for line in folded(sentences):
        say(f"{begin}{line}", err=err, indent=indent)


def say_assumed(assumption: str) -> None:
    """Tell what was found or assumed while connecting, beside the result of the command."""
    say(assumption, err=True, indent=2)


def host_clock(speed: float) -> HostClock:
    """Return the clock to read an instrument with that runs ``speed`` times faster than real time, as emulated ones may."""
    if speed == 1.0:
        return SystemClock()
    # Said each time: with a real instrument every rate would come out wrong by this factor.
    say(sentence("output.fast_clock", speed=speed), err=True)
    return ScaledClock(speed)
