"""What a command line was refused for, and the facts that it said: never its wording."""

from __future__ import annotations

from unittest import mock

from imufield.cli.run import run, run_line
from imufield.errors import ImufieldError, Reason
from imufield.sentences import Sentences


def failure(*arguments: object) -> ImufieldError:
    """Run a command line that fails and return its error, whose exit code must be that of its kind."""
    seen: list[ImufieldError] = []

    def watched(line: list[str]) -> int:
        try:
            return run_line(line)
        except ImufieldError as error:
            seen.append(error)
            raise

    with mock.patch("imufield.cli.run.run_line", watched):
        code = run([str(one) for one in arguments])
    assert seen, f"it ended with {code}"
    assert code == seen[0].exit_code
    return seen[0]


def fails(arguments: str | list[str], code: int, reason: Reason, *facts: str, key: str | None = None) -> ImufieldError:
    """Run a command line that must fail with this exit code, reason and key of its sentence, and name these facts."""
    error = failure(*(arguments.split() if isinstance(arguments, str) else arguments))
    assert (error.exit_code, error.reason) == (code, reason), error
    assert key is None or getattr(error.message, "key", None) == key, error
    assert not missing(error.message, *facts), error
    return error


def says(text: str, room: str, key: str, **values: object) -> bool:
    """Whether a text holds a sentence of a room ("files" and the like are of ""), however its lines are broken."""
    return Sentences(f"imufield.{room}".rstrip("."))(key, **values) in " ".join(text.split())


def missing(text: str, *facts: object) -> list[str]:
    """Return which facts (names, options, numbers with their units) a text does not tell, however its lines are broken."""
    told = " ".join(text.split())
    return [str(fact) for fact in facts if str(fact) not in told]


def one_sentence(stderr: str) -> str:
    """Return the error: the last line, which is all there is but for what was assumed."""
    lines = stderr.strip().splitlines()
    assert "Traceback" not in stderr
    assert sum(line.startswith("imufield: ") for line in lines) == 1, stderr
    assert lines[-1].startswith("imufield: ")
    assert lines[-1].endswith(".")
    return lines[-1].removeprefix("imufield: ")
