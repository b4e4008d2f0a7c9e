"""``imufield solve``: a session or a file of position means in, a parameter file and a verdict out.

Several sessions are each solved as if alone, on all cores or a Dask cluster. A worker replays and solves; this process writes
the parameter files, so a session whose worker was killed and that is solved again is written once.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imufield.acquire.recording.session import Session
from imufield.commands.options.result_commands import SolveOptions
from imufield.commands.terminal.output import echo, echo_table, say, tell_written
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.file import PARAMETER_FILE, Parameters, json_ready
from imufield.deliver.parameters.printed_numbers import hanging
from imufield.deliver.parameters.schema import Document
from imufield.deliver.report.gain import document_with_gain
from imufield.deliver.report.summary import Outcome, print_summary
from imufield.earth import MICRO_G_M_S2
from imufield.errors import ImufieldError, UsageError
from imufield.files import real_path, refuse_overwriting
from imufield.pipeline.same_recording import RecordingMarks
from imufield.pipeline.solving import solve_observations, solve_session, write_solved
from imufield.samples import FloatArray
from imufield.sentences import Sentences, printable, three_digits

sentence = Sentences(__package__)

FAILED = "failed"


def run_solve(options: SolveOptions) -> int:
    """Solve, write the parameter file, and print the summary or the document; return the exit code."""
    sessions = options.sessions or []
    if options.together or options.serial_number is not None:
        # What it needs is slow to import, and most solve one session.
        from imufield.commands.solve_together import run_solve_together

        return run_solve_together(options)
    if options.scheduler is not None or len(sessions) > 1:
        return run_solve_many(sessions, options)
    settings, marks = options.settings(), RecordingMarks()
    if options.observations is not None:
        if sessions:
            raise UsageError(sentence("solve.session_and_observations"))
        session = None
        path = options.output or Path(PARAMETER_FILE)
        refuse_overwriting(path, [options.observations], advice=sentence("solve.elsewhere"))
        solved = solve_observations(options.observations, settings, options.site)
    else:
        session = Session.open(sessions[0]) if sessions else Session.newest()
        path = options.output or session.folder / PARAMETER_FILE
        refuse_overwriting(path, session.parts, advice=sentence("solve.elsewhere"))
        solved = solve_session(session, settings, options.site, (marks.feed,) if options.temperature else ())
    base = solved
    if options.temperature:
        from imufield.pipeline.temperature import MarkedSession, over_temperature

        recorded = [Session.open(folder) for folder in options.temperature]
        solved = over_temperature(MarkedSession(base, marks), recorded, settings, options.site)
    solved, kept, lost = write_solved(path, solved, advice=sentence("solve.elsewhere"))
    if options.as_json:
        echo(json.dumps(document_with_gain(solved) | {"notes": lost}))
        tell_written(path, kept, as_json=True)
        return 0
    print_summary(solved, Outcome(path, kept, session, base.calibration.quality))
    for note in lost:
        echo(hanging("", note))
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOutcome:
    """What became of one session; goes from a worker to the process that writes."""

    session: Path
    exit_code: int = 0
    error: str = ""
    found: Parameters | None = None
    notes: tuple[str, ...] = ()
    written: Path | None = None
    kept: Path | None = None
    """Where the parameter file that stood there before is kept."""

    @property
    def name(self) -> str:
        """Name of the folder, to be shown."""
        return printable(self.session.name)

    @property
    def verdict(self) -> str:
        """In one word, for the table."""
        return FAILED if self.found is None or self.error else self.found.calibration.quality.verdict


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
        raise UsageError(sentence("solve.observations_elsewhere"))
    if not sessions:
        raise UsageError(sentence("solve.no_sessions"))
    if options.temperature:
        raise UsageError(sentence("solve.temperature_of_one"))
    if options.output is not None:
        key = "solve.output_of_scheduler" if len(sessions) == 1 else "solve.output_of_several"
        raise UsageError(sentence(key, output=options.output, file=PARAMETER_FILE))
    # Workers on a cluster have a working folder of their own.
    preset = None if options.preset is None else real_path(options.preset)
    folders = dict.fromkeys(real_path(folder) for folder in sessions)
    # Asked here, where it is written, and before anything is computed for no place.
    failed = {folder: outcome for folder in folders if (outcome := _unwritable(folder)) is not None}
    jobs = [replace(options, sessions=[folder], preset=preset) for folder in folders if folder not in failed]
    done: list[SessionOutcome] = []

    def tell(outcome: SessionOutcome) -> None:
        done.append(outcome)
        say(f"{len(done)} of {len(folders)}: {outcome.name}, {outcome.verdict}", err=True)

    for outcome in failed.values():
        tell(outcome)
    # Slow to import, and most solve one session.
    from imufield.campaign import run_campaign

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
    solved = {outcome.session: _write(outcome) for outcome in found}
    outcomes = [failed.get(folder) or solved[folder] for folder in folders]
    if options.as_json:
        echo(json.dumps([_as_json(outcome) for outcome in outcomes]))
    else:
        _print(outcomes)
    return max(outcome.exit_code for outcome in outcomes)


def solve_job(options: SolveOptions, _rng: np.random.Generator) -> SessionOutcome:
    """Solve one session; the function that workers are sent. Random numbers are those of ``--seed``, as for one session."""
    folder = _folder(options)
    try:
        solved = solve_session(Session.open(folder), options.settings(), options.site)
    except ImufieldError as error:
        return SessionOutcome(session=folder, exit_code=error.exit_code, error=str(error.message))
    return SessionOutcome(session=folder, found=solved)


def _killed(options: SolveOptions) -> SessionOutcome:
    return SessionOutcome(session=_folder(options), exit_code=UsageError.exit_code, error=sentence("solve.worker_killed"))


def _folder(options: SolveOptions) -> Path:
    """Return the session that a job of a worker is about."""
    return (options.sessions or [Path()])[0]


def _unwritable(folder: Path) -> SessionOutcome | None:
    """Return what becomes of a session whose parameters could not be written; None for one that can be tried."""
    if not folder.is_dir():
        return None  # What opens it says so.
    try:
        refuse_overwriting(folder / PARAMETER_FILE)
    except ImufieldError as error:
        return SessionOutcome(session=folder, exit_code=error.exit_code, error=str(error.message))
    return None


def _write(outcome: SessionOutcome) -> SessionOutcome:
    if outcome.found is None:
        return outcome
    path = outcome.session / PARAMETER_FILE
    try:
        found, kept, lost = write_solved(path, outcome.found)
    # One folder that cannot be written must not cost the others their files.
    except ImufieldError as error:
        return replace(outcome, exit_code=error.exit_code, error=str(error.message))
    moved = () if kept is None else (sentence("solve.kept", name=kept.name),)
    return replace(outcome, found=found, written=path, kept=kept, notes=(*moved, *lost))


def _print(outcomes: list[SessionOutcome]) -> None:
    headings = ("session", "verdict", "positions", "residual", "bias sigma", "scale sigma")
    echo_table([headings, *((outcome.name, outcome.verdict, *_figures(outcome)) for outcome in outcomes)], "<<>>>>")
    for outcome in outcomes:
        # What is to be read beside its row: an error alone, or why it is not good before the rest.
        said = (outcome.error,) if outcome.error else outcome.notes
        if outcome.found is not None and outcome.verdict not in (FAILED, "good"):
            said = (outcome.found.calibration.quality.main_reason, *outcome.notes)
        for note in said:
            say(f"{outcome.name}: {note}", indent=2)
    failed = sum(outcome.error != "" for outcome in outcomes)
    key = "solve.all_solved" if not failed else "solve.some_solved" if failed < len(outcomes) else "solve.none_solved"
    say(sentence(key, solved=len(outcomes) - failed, sessions=len(outcomes), file=PARAMETER_FILE, failed=failed))


def _as_json(outcome: SessionOutcome) -> Document:
    shown = {"session": str(outcome.session), "verdict": outcome.verdict, "exit_code": outcome.exit_code}
    if outcome.error or outcome.found is None:
        return {**shown, "error": outcome.error}
    files = {"file": str(outcome.written), "kept": None if outcome.kept is None else str(outcome.kept)}
    return {**shown, **files, "notes": outcome.notes, "parameters": json_ready(outcome.found.document)}


def _figures(outcome: SessionOutcome) -> tuple[str, ...]:
    if outcome.found is None:
        return ()
    calibration = outcome.found.calibration
    sigma = calibration.accelerometer_sigma
    return (
        str(len(calibration.positions.residual_m_s2)),
        f"{three_digits(calibration.quality.residual_rms_m_s2 / MICRO_G_M_S2)} µg",
        f"{three_digits(_largest(sigma.bias_m_s2) / MICRO_G_M_S2)} µg",
        f"{three_digits(_largest(sigma.scale / np.abs(calibration.accelerometer.scale)) * 1e6)} ppm",
    )


def _largest(values: FloatArray) -> float:
    # All NaN where nothing was fitted, which nanmax would warn of.
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")
