"""Running a command line: interrupts, errors in one sentence, exit codes (which error has which: ``imufield.errors``)."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
from collections.abc import Collection, Iterator
from types import FrameType
from typing import TextIO

from imufield.cli.table import COMPLETION, NAMES
from imufield.errors import EXIT_INTERRUPTED, ImufieldError, Reason, RecordingError, UsageError
from imufield.files import write_error
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_AGAIN_S = 0.01  # Until an interrupt that was dropped is raised again: what dropped it takes microseconds.
RECORDING_COMMANDS = ("capture", "record", "demo")


class Interrupted(KeyboardInterrupt):
    """SIGTERM or SIGHUP, handled as Ctrl-C is."""


def _raise_interrupted(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001  (signature of a handler)
    raise Interrupted(signal.Signals(signal_number).name)


@contextlib.contextmanager
def _signals_as_interrupts() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP, if they are not ignored, into the exception of Ctrl-C, so that every path closes its files."""
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    heard = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    previous = [(number, signal.signal(number, _raise_interrupted)) for number in heard]
    try:
        with _dropped_interrupts_again():
            yield
    finally:
        for number, handler in previous:
            signal.signal(number, handler)


@contextlib.contextmanager
def _dropped_interrupts_again() -> Iterator[None]:
    """Raise an interrupt again that Python drops: in a destructor, or in what a weak reference calls, as at every import."""
    previous = sys.unraisablehook
    with contextlib.ExitStack() as undone:

        def hear(dropped: sys.UnraisableHookArgs) -> None:
            if isinstance(dropped.exc_value, KeyboardInterrupt) and hasattr(signal, "setitimer"):
                undone.callback(signal.signal, signal.SIGALRM, signal.signal(signal.SIGALRM, _raise_interrupted))
                undone.callback(signal.setitimer, signal.ITIMER_REAL, 0)
                signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            else:
                previous(dropped)

        undone.callback(setattr, sys, "unraisablehook", previous)
        sys.unraisablehook = hear
        yield


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; a defect of ours leaves its traceback (code 1)."""
    try:
        return _run(arguments)
    except OSError as error:
        # Files and ports have errors of their own kind: what comes here is about standard output.
        failure = write_error("standard output", error, RecordingError)
        if failure.reason is Reason.DISK_FULL:
            _forget(sys.stdout)
            _complain(failure.message)
            return failure.exit_code
        # Whether a name is there is asked in many places, and the answer to this one is always the same.
        if error.errno == errno.ENAMETOOLONG:
            _complain(sentence("run.long_name", name=str(error.filename)))
            return UsageError.exit_code
        # The reader of our output went away (`imufield ... | head`), or the terminal was closed: there is nobody to tell.
        closed = error.errno == errno.EIO and _comes_from(error, KeyboardInterrupt)
        if not (closed or isinstance(error, BrokenPipeError)):
            raise
        _forget(sys.stdout)
        _forget(sys.stderr)
        return EXIT_INTERRUPTED


def _forget(stream: TextIO) -> None:
    """Let nothing more be said there, by the interpreter on its way out either."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _complain(message: str) -> None:
    from imufield.commands.terminal.output import say

    say(f"imufield: {message.rstrip('.')}.", err=True, indent=2, color="red")


def _run(arguments: list[str]) -> int:
    try:
        with _signals_as_interrupts():
            return 0 if arguments in (["--help"], ["-h"]) and _help_is_printed() else run_line(arguments)
    except ImufieldError as error:
        _complain(error.message)
        return error.exit_code
    except KeyboardInterrupt as interrupt:
        return _interrupted(arguments, interrupt)
    except RuntimeError as error:
        # Python 3.11 makes one of what is raised while a class is made.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        return _interrupted(arguments, error)
    except SystemExit as leave:
        if isinstance(leave.__context__, BrokenPipeError):
            # typer leaves with 1 then, which is kept for defects.
            raise leave.__context__ from None
        if leave.code == EXIT_INTERRUPTED:
            return _interrupted(arguments, leave)
        return leave.code if isinstance(leave.code, int) else 0


def run_line(arguments: list[str]) -> int:
    """Run a command line, by typer where it does not say all itself; return the exit code.

    Raises
    ------
    ImufieldError
        Of the command.
    SystemExit
        As typer leaves.
    """
    # Made for the command alone that is run; all of them where none is named: help, completion, a slip of the pen.
    wanted: Collection[str] = NAMES
    if arguments and arguments[0] in NAMES:
        from imufield.cli.command import find_command
        from imufield.cli.plain import read
        from imufield.commands.options.configuration import default_map

        command, wanted = find_command(arguments[0]), arguments[:1]
        found = None if os.environ.get(COMPLETION) else read(command, arguments[1:], default_map().get(command.name, {}))
        if found is not None:
            return command.run(*found)
    from imufield.cli.app import make_app

    make_app(wanted)(arguments, prog_name="imufield")
    return 0


def _interrupted(arguments: list[str], interrupt: BaseException) -> int:
    from imufield.commands.terminal.output import NoAnswer, NothingRecorded, say

    if _comes_from(interrupt, NoAnswer) and not _comes_from(interrupt, NothingRecorded):
        say("Aborted.", err=True, color="red")
    say(f"imufield: {_interrupted_words(arguments, interrupt)}.", err=True)
    return EXIT_INTERRUPTED


def _help_is_printed() -> bool:
    from imufield.cli.root_help import print_help

    return print_help()


def _interrupted_words(arguments: list[str], interrupt: BaseException) -> str:
    from imufield.commands.terminal.output import NothingRecorded

    command = arguments[0] if arguments else ""
    if _comes_from(interrupt, NothingRecorded):
        return sentence("run.nothing_recorded")
    if command in RECORDING_COMMANDS:
        return sentence("run.recorded")
    return sentence("run.nothing_imported") if command == "import" else "interrupted"


def _comes_from(error: BaseException | None, *kinds: type[BaseException]) -> bool:
    """Whether an error is one of these kinds, or came up while one was on its way out."""
    while error is not None and not isinstance(error, kinds):
        error = error.__context__
    return error is not None
