"""``imufield solve``: a session or a file of position means in, a parameter file and a verdict out.

Several sessions are each solved as if alone, on all cores or a Dask cluster. A worker replays and solves; this process writes
the parameter files, so a session whose worker was killed and that is solved again is written once.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from imufield.acquire.recording.session import Session
from imufield.commands.options.calibrate import SolveOptions
from imufield.commands.terminal.output import say
from imufield.commands.terminal.progress import ProgressLine
from imufield.deliver.parameters.file import PARAMETER_FILE, Parameters, from_document, json_ready, write_document
from imufield.deliver.parameters.numbers import hanging
from imufield.deliver.parameters.schema import Document
from imufield.deliver.report.summary import Outcome, print_summary
from imufield.earth import MICRO_G_M_S2
from imufield.errors import ImufieldError, UsageError
from imufield.files import refuse_overwriting
from imufield.pipeline.solving import better_gravity, solve_observations, solve_session
from imufield.samples import FloatArray

FAILED = "failed"
WIDTH = 80  # Of the table where there is no terminal: what a log or a mail shows unbroken.


def run_solve(options: SolveOptions) -> int:
    """Solve, write the parameter file, and print the summary or the document; return the exit code."""
    sessions = options.sessions or []
    if options.scheduler is not None or len(sessions) > 1:
        return run_solve_many(sessions, options)
    settings = options.settings()
    if options.observations is not None:
        if sessions:
            raise UsageError("give a session or --observations, not both")
        session = None
        path = options.output or Path(PARAMETER_FILE)
        refuse_overwriting(path, [options.observations])
        solved = solve_observations(options.observations, settings, options.site)
    else:
        session = Session.open(sessions[0]) if sessions else Session.newest()
        path = options.output or session.folder / PARAMETER_FILE
        refuse_overwriting(path, session.parts)
        with ProgressLine("reading") as progress:
            solved = solve_session(
                session, settings, options.site, listener=progress.feed, on_read=lambda: progress.say("solving")
            )
    # Asked before the file that stands there is replaced.
    better = better_gravity(path, solved.parameters.calibration.gravity)
    kept = write_document(path, solved.parameters.document)
    if options.as_json:
        typer.echo(json.dumps(json_ready(solved.parameters.document)))
        return 0
    print_summary(solved.parameters, Outcome(path, kept, None if session is None else session.folder))
    for note in (*solved.notes, *better):
        typer.echo(hanging("", note))
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOutcome:
    """What became of one session; goes from a worker to the process that writes."""

    session: Path
    exit_code: int = 0
    error: str = ""
    document: Document | None = None
    notes: tuple[str, ...] = ()
    written: Path | None = None
    kept: Path | None = None
    """Where the parameter file that stood there before is kept."""


def run_solve_many(sessions: Sequence[Path], options: SolveOptions) -> int:
    """Solve every session, write its parameter file, print a table of verdicts; return the exit code of the worst.

    Raises
    ------
    UsageError
        If an option belongs to one session only, or Dask is not installed.
    LinkError
        If the scheduler does not answer.
    """
    if options.observations is not None:
        raise UsageError("--observations is solved in this process; leave out the sessions, or --scheduler")
    if not sessions:
        raise UsageError("--scheduler needs the folders of the sessions to solve; name them")
    if options.output is not None and len(sessions) == 1:
        raise UsageError(
            f"--scheduler writes each session's {PARAMETER_FILE}; leave out --output {options.output}, or --scheduler"
        )
    if options.output is not None:
        raise UsageError(
            f"--output {options.output} names one file for several sessions; leave it out, each gets its {PARAMETER_FILE}"
        )
    # Workers on a cluster have a working folder of their own.
    preset = None if options.preset is None else options.preset.resolve()
    folders = dict.fromkeys(folder.resolve() for folder in sessions)
    jobs = [replace(options, sessions=[folder], preset=preset) for folder in folders]
    done: list[SessionOutcome] = []

    def tell(outcome: SessionOutcome) -> None:
        done.append(outcome)
        say(f"{len(done)} of {len(jobs)}: {_name(outcome)}, {_verdict(outcome)}", err=True)

    # Dask is looked for only where there are several sessions.
    from imufield.study.campaign import run_campaign

    found = run_campaign(
        solve_job,
        jobs,
        seed=options.seed,
        workers=options.workers,
        scheduler=options.scheduler,
        on_killed=_killed,
        on_result=tell,
    )
    # Written here and not by the workers: one that is killed and started again would write twice.
    outcomes = [_write(outcome) for outcome in found]
    _print(outcomes, as_json=options.as_json)
    return max(outcome.exit_code for outcome in outcomes)


def _only_session(options: SolveOptions) -> Path:
    """Return the folder that a job of a worker is about."""
    return (options.sessions or [Path()])[0]


def solve_job(options: SolveOptions, _rng: np.random.Generator) -> SessionOutcome:
    """Solve one session; the function that workers are sent. Random numbers are those of ``--seed``, as for one session."""
    folder = _only_session(options)
    try:
        solved = solve_session(Session.open(folder), options.settings(), options.site)
    except ImufieldError as error:
        return SessionOutcome(session=folder, exit_code=error.exit_code, error=error.message)
    return SessionOutcome(session=folder, document=solved.parameters.document, notes=solved.notes)


def _killed(options: SolveOptions) -> SessionOutcome:
    sentence = "its worker was killed again and again, most likely for lack of memory; solve it alone, with more memory"
    folder = _only_session(options)
    return SessionOutcome(session=folder, exit_code=UsageError.exit_code, error=sentence)


def _write(outcome: SessionOutcome) -> SessionOutcome:
    if outcome.document is None:
        return outcome
    path = outcome.session / PARAMETER_FILE
    better = better_gravity(path, from_document(outcome.document).calibration.gravity)
    try:
        kept = write_document(path, outcome.document)
    # One folder that cannot be written must not cost the others their files.
    except ImufieldError as error:
        return replace(outcome, exit_code=error.exit_code, error=error.message)
    moved = () if kept is None else (f"the file that stood there before is now {kept.name}",)
    return replace(outcome, written=path, kept=kept, notes=(*outcome.notes, *moved, *better))


def _print(outcomes: list[SessionOutcome], *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps([_as_json(outcome) for outcome in outcomes]))
        return
    console = Console() if sys.stdout.isatty() else Console(width=WIDTH, color_system=None, legacy_windows=False)
    console.print(_table(outcomes))
    for outcome in outcomes:
        found = _parameters(outcome)
        # What is to be read beside its row: an error alone, or why it is not good before the rest.
        sentences = (outcome.error,) if outcome.error else outcome.notes
        if found is not None and not outcome.error and found.calibration.quality.verdict != "good":
            sentences = (found.calibration.quality.main_reason, *outcome.notes)
        for sentence in sentences:
            say(f"{_name(outcome)}: {sentence}", indent=2)
    failed = sum(outcome.error != "" for outcome in outcomes)
    solved = f"{len(outcomes) - failed} of {len(outcomes)} sessions solved"
    if failed < len(outcomes):
        solved += f", each has its {PARAMETER_FILE} now"
    say(f"{solved}; {failed} failed, for the reasons above." if failed else f"{solved}.")


def _as_json(outcome: SessionOutcome) -> Document:
    shown = {"session": str(outcome.session), "verdict": _verdict(outcome), "exit_code": outcome.exit_code}
    if outcome.error:
        return {**shown, "error": outcome.error}
    files = {"file": str(outcome.written), "kept": None if outcome.kept is None else str(outcome.kept)}
    return {**shown, **files, "parameters": json_ready(outcome.document or {})}


def _name(outcome: SessionOutcome) -> str:
    return outcome.session.name


def _parameters(outcome: SessionOutcome) -> Parameters | None:
    return None if outcome.document is None else from_document(outcome.document)


def _verdict(outcome: SessionOutcome) -> str:
    found = _parameters(outcome)
    return FAILED if found is None or outcome.error else found.calibration.quality.verdict


def _table(outcomes: list[SessionOutcome]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("session", overflow="fold")
    for heading in ("verdict", "positions", "residual", "bias sigma", "scale sigma"):
        table.add_column(heading, justify="left" if heading == "verdict" else "right", no_wrap=True)
    for outcome in outcomes:
        table.add_row(_name(outcome), _verdict(outcome), *_figures(outcome))
    return table


def _figures(outcome: SessionOutcome) -> tuple[str, ...]:
    found = _parameters(outcome)
    if found is None:
        return ()
    calibration = found.calibration
    sigma = calibration.accelerometer_sigma
    return (
        str(len(calibration.positions.residual_m_s2)),
        f"{calibration.quality.residual_rms_m_s2 / MICRO_G_M_S2:.3g} µg",
        f"{_largest(sigma.bias_m_s2) / MICRO_G_M_S2:.3g} µg",
        f"{_largest(sigma.scale / np.abs(calibration.accelerometer.scale)) * 1e6:.3g} ppm",
    )


def _largest(values: FloatArray) -> float:
    # All NaN where nothing was fitted, which nanmax would warn of.
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")
