"""``imufield solve --together``: sessions of one instrument in, the parameters of a new day and the repeatability out."""

from __future__ import annotations

import json
from pathlib import Path

from imufield.acquire.recording.session import Session
from imufield.commands.options.result_commands import SolveOptions
from imufield.commands.terminal.output import echo, echo_table, say, say_each, tell_written
from imufield.deliver.parameters.file import PARAMETER_FILE, Parameters, json_ready
from imufield.deliver.parameters.joined import shown_unit
from imufield.deliver.report.together import HEADINGS, together_rows
from imufield.errors import UsageError
from imufield.files import DEFAULT_ROOT, refuse_overwriting
from imufield.pipeline.solving import write_solved
from imufield.pipeline.together import refuse_of_single, sessions_of, solve_together
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def run_solve_together(options: SolveOptions) -> int:
    """Solve sessions together, write one parameter file, and print what changes from day to day; return the exit code.

    Raises
    ------
    UsageError
        If it is not said which sessions, or an option belongs to single ones.
    ImufieldError
        If a session cannot be solved, or they cannot be joined.
    """
    sessions = _sessions(options)
    path = options.output or Path(PARAMETER_FILE)
    parts = [part for session in sessions for part in session.parts]
    refuse_overwriting(path, parts, advice=sentence("solve.elsewhere"))
    parameters = solve_together(sessions, options.settings(), options.site, options.workers)
    parameters, kept, lost = write_solved(path, parameters, advice=sentence("solve.elsewhere"))
    if options.as_json:
        echo(json.dumps(json_ready(parameters.document) | {"notes": lost}))
    else:
        _print(parameters)
        say_each(lost, indent=4, begin="  - ")
    tell_written(path, kept, as_json=options.as_json)
    return 0


def _sessions(options: SolveOptions) -> list[Session]:
    folders, serial_number = options.sessions or [], options.serial_number
    if not options.together:
        raise UsageError(sentence("solve_together.serial_alone", serial_number=serial_number))
    refuse_of_single(
        {
            "--observations": options.observations is not None,
            "--scheduler": options.scheduler is not None,
            "--temperature": bool(options.temperature),
        }
    )
    if serial_number is not None:
        if folders:
            raise UsageError(sentence("solve_together.both", serial_number=serial_number))
        return sessions_of(serial_number, DEFAULT_ROOT)
    if not folders:
        raise UsageError(sentence("solve_together.none"))
    # A folder that is named twice is one session.
    return [Session.open(folder) for folder in dict.fromkeys(folder.resolve() for folder in folders)]


def _print(parameters: Parameters) -> None:
    """Print a row for each kind of parameter that changes, and the verdict."""
    quality, instrument = parameters.calibration.quality, parameters.context.instrument
    who = " ".join(filter(None, (instrument.model or instrument.driver, instrument.serial_number)))
    say(f"{who}: {quality.reasons[0]}")
    echo_table([HEADINGS, *together_rows(parameters)], "<<>>>>")
    together = parameters.context.together
    # From FEWEST_WITHOUT_PRIOR sessions on they say themselves how days differ.
    if together is not None and together.prior_grade:
        bias = next(each for each in together.repeatability if each.kind == "accelerometer.bias_m_s2")
        unit, size = shown_unit(bias.kind)
        say(
            sentence(
                "solve_together.few",
                grade=together.prior_grade,
                sessions=len(together.session),
                high=bias.high / size,
                unit=unit,
            )
        )
    say(f"Verdict: {quality.verdict.upper()}")
    say_each((*quality.warnings, *quality.details), indent=4, begin="  - ")
