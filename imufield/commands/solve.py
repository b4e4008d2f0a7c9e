"""``imufield solve``: a session or a file of position means in, a parameter file and a verdict out."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import get_args

import numpy as np
import typer

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.calibrate.gyroscope.model_choice import GyroscopeModel
from imufield.calibrate.model.observation_files import read_observations
from imufield.calibrate.model.observations import Observations, count_repeats_once
from imufield.calibrate.model.result import Gauge, ModelChoice
from imufield.calibrate.solvers.agreement import LEAST_SQUARES
from imufield.commands.configuration import parse_zero
from imufield.commands.terminal.progress import ProgressLine
from imufield.deliver.parameters.file import (
    PARAMETER_FILE,
    Context,
    InstrumentFacts,
    Parameters,
    SessionFacts,
    json_ready,
    load,
    write_document,
)
from imufield.deliver.parameters.numbers import hanging
from imufield.deliver.report.summary import Outcome, print_summary
from imufield.earth import Gravity
from imufield.errors import CalibrationError, ImufieldError, Reason, UsageError, counted
from imufield.files import refuse_overwriting
from imufield.guide.cross_checks.axes import AxesCheck
from imufield.guide.events import Event, RefusalCode, Rejected
from imufield.guide.lead.guide import Guide
from imufield.pipeline.calibration import Measured, MoveListener, Wishes, calibrate, one_of
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from imufield.pipeline.damage import naming_damage
from imufield.pipeline.site import SiteOptions

HASH_BLOCK_BYTES = 1 << 20
_BETTER_KNOWN = 3.0  # Factor between sigmas of gravity from which the common scale of a session is another in practice.
FEWEST_POSITIONS = 6
"""For scale and bias, each axis up and down."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveOptions:
    """Options of the command."""

    session: Path | None = None
    observations: Path | None = None
    site: SiteOptions = field(default_factory=SiteOptions)
    model: str = "auto"
    gauge: str | None = None
    preset: Path | None = None
    zero: str | None = None
    method: str = LEAST_SQUARES
    polish: bool = True
    cross_check: bool = False
    gyroscope_model: str = "auto"
    seed: int = 0
    output: Path | None = None
    as_json: bool = False


@dataclass(frozen=True, slots=True)
class Solved:
    """What a solve found, before it is written."""

    parameters: Parameters
    notes: tuple[str, ...]
    """Sentences about the recording that are not about the numbers."""


def run_solve(options: SolveOptions) -> None:
    """Solve, write the parameter file, and print the summary or the document."""
    if options.observations is not None:
        if options.session is not None:
            raise UsageError("give a session or --observations, not both")
        session = None
        path = options.output or Path(PARAMETER_FILE)
        refuse_overwriting(path, [options.observations])
        solved = solve_observations(options.observations, options)
    else:
        session = Session.newest() if options.session is None else Session.open(options.session)
        path = options.output or session.folder / PARAMETER_FILE
        refuse_overwriting(path, session.parts)
        with ProgressLine("reading") as progress:
            solved = solve_session(session, options, progress)
    better = better_gravity(path, solved.parameters.calibration.gravity)
    kept = write_document(path, solved.parameters.document)
    if options.as_json:
        typer.echo(json.dumps(json_ready(solved.parameters.document)))
        return
    print_summary(solved.parameters, Outcome(path, kept, None if session is None else session.folder))
    for note in (*solved.notes, *better):
        typer.echo(hanging("", note))


def better_gravity(path: Path, now: Gravity) -> tuple[str, ...]:
    """Return a sentence where the parameter file that stands at ``path`` knows gravity much better than it is known now."""
    try:
        before = load(path).calibration.gravity
    except ImufieldError:
        return ()
    if not before.sigma_m_s2 * _BETTER_KNOWN < now.sigma_m_s2:
        return ()
    again = f"--gravity {before.gravity_m_s2:.6g}"
    if before.source == "normal" and before.latitude_deg is not None:
        again = f"--latitude {before.latitude_deg:g} --height {before.height_m or 0:g}"
    known = f"that file had gravity to {before.sigma_m_s2:.2g} m/s^2, this one has it to {now.sigma_m_s2:.2g} m/s^2"
    return (f"{known}: to solve as it was, add {again}",)


def solve_session(session: Session, options: SolveOptions, progress: ProgressLine | None = None) -> Solved:
    """Replay a session and solve it; say on ``progress`` how far it is.

    Raises
    ------
    ImufieldError
        Recording unreadable, calibration impossible or refused.
    """
    wishes = _wishes(options)
    damage: list[Damage] = []
    goes_on = session.is_being_recorded
    moves = MoveListener()
    chain = Chain(ReadingPlan.of(session), listeners=(moves.feed,) if progress is None else (moves.feed, progress.feed))
    refusals: list[Rejected] = []

    def hear(events: list[Event]) -> None:
        moves.hear(events)
        refusals.extend(event for event in events if isinstance(event, Rejected))

    replay_into(chain, session, damage, hear)
    if goes_on:
        # The end of the part under way is no damage.
        damage = [one for one in damage if not (one.torn_end and one.path == session.parts[-1])]
        chain.notes.append("This session is still being recorded: solved is what was on disk; solve again when it is over.")
    if progress is not None:
        progress.say("solving")
    with naming_damage(session, damage):
        observations, axes, refused, saturated = _observations(chain, refusals)
        if axes.error is not None:
            raise axes.error
        where = "are missing in the file" if session.record.kind == "import" else "were lost on the wire"
        reasons = (axes.words, *saturated, *chain.notes, *_loss_sentences(chain, damage, where))
        found = _measured(session, chain, observations, moves, site=options.site, reasons=reasons)
        with _naming_saturation(saturated):
            return Solved(calibrate(found, wishes), refused)


@contextmanager
def _naming_saturation(saturated: tuple[str, ...]) -> Iterator[None]:
    """Name clipped outputs as the cause where what is left of a session cannot be calibrated from."""
    try:
        yield
    except CalibrationError as error:
        if not saturated:
            raise
        raise CalibrationError(
            f"{saturated[0].removesuffix('.')}, and what is left is not enough: {error.message}",
            Reason.SATURATED,
            **error.values,
        ) from error


def _saturation_sentence(where: list[str], words: str) -> tuple[str, ...]:
    """Return a sentence for the verdict about what was left out because an axis was clipped; none where none was."""
    if not where:
        return ()
    shown = ", ".join(where[:_SHOWN]) + (" and others" if len(where) > _SHOWN else "")
    return (f"{counted(len(where), 'still interval')} left out because of saturation ({shown}): {words}.",)


def _measured(
    session: Session,
    chain: Chain,
    observations: Observations,
    moves: MoveListener,
    *,
    site: SiteOptions,
    reasons: tuple[str, ...],
) -> Measured:
    instrument = InstrumentFacts(**asdict(session.record.instrument))
    facts = SessionFacts(session.name, session_sha256(session), _true_rate_hz(chain), chain.temperature_degc)
    nominal = chain.protocol.nominal if chain.protocol is not None else None
    rests = chain.turn_rests()
    between = moves.between(observations, rests)
    return Measured(
        observations=observations,
        gravity=site.gravity(session.record.site),
        context=Context(instrument=instrument, session=facts),
        moves=between,
        rests=rests,
        stops=moves.stops(between),
        raw_zero=None if chain.protocol is None else chain.raw_zero(chain.protocol),
        gyroscope_scale=None if nominal is None else nominal.gyroscope_scale,
        reasons=reasons,
    )


def solve_observations(path: Path, options: SolveOptions) -> Solved:
    """Solve position means from a file."""
    wishes = _wishes(options)
    observations, repeats = count_repeats_once(read_observations(path))
    facts = SessionFacts(path.name, _sha256([path]))
    found = Measured(observations=observations, gravity=options.site.gravity(), context=Context(session=facts), reasons=repeats)
    return Solved(calibrate(found, wishes), ())


def _wishes(options: SolveOptions) -> Wishes:
    zero = parse_zero(options.zero)
    return Wishes(
        model=one_of("model", options.model, get_args(ModelChoice)),
        gauge=None if options.gauge is None else one_of("gauge", options.gauge, get_args(Gauge)),
        method=options.method,
        polish=options.polish,
        cross_check=options.cross_check,
        gyroscope_model=one_of("gyro-model", options.gyroscope_model, get_args(GyroscopeModel)),
        preset=None if options.preset is None else load(options.preset),
        raw_zero=None if zero is None else np.array(zero),
        seed=options.seed,
    )


def _observations(chain: Chain, refusals: list[Rejected]) -> _Found:
    if chain.guide is not None:
        observations = chain.observations()
        spoilt = [one for one in refusals if one.position or one.reason in _SPOIL_DATA]
        _check_count(len(observations), [(one.reason, one.words, one.remedy) for one in spoilt])
        missing = chain.guide.plan.missing()
        # A position that was taken again lacks nothing.
        clipped = [one for one in refusals if one.reason in _AT_LIMIT and missing and (one.position or missing[0]) in missing]
        saturated = _saturation_sentence([f"at {one.time_s:.1f} s" for one in clipped], clipped[-1].words if clipped else "")
        return observations, chain.guide.check_axes(), _missing_sentences(chain.guide, refusals), saturated
    found = chain.still_intervals()
    _check_count(len(found.observations), [(one.reason, one.words, one.remedy) for _, one in found.refused])
    clips = [(start_s, one.words) for start_s, one in found.refused if one.reason in _AT_LIMIT]
    saturated = _saturation_sentence([f"at {start_s:.1f} s" for start_s, _ in clips], clips[-1][1] if clips else "")
    sentences = tuple(
        f"The still interval at {start_s:.1f} s is left out: {refusal.words}."
        for start_s, refusal in found.refused
        if refusal.reason not in _AT_LIMIT
    )
    return found.observations, found.axes, sentences, saturated


# Observations, their axes, sentences beside the numbers, and one for the verdict about clipped outputs.
_Found = tuple[Observations, AxesCheck, tuple[str, ...], tuple[str, ...]]
_SHOWN = 6  # Places that a sentence lists.
_AT_LIMIT = (RefusalCode.SATURATED, RefusalCode.STUCK)
# Refused as soon as it is seen, before a position is known.
_SPOIL_DATA = (RefusalCode.SATURATED, RefusalCode.INVALID, RefusalCode.SAMPLE_LOSS)


def _check_count(count: int, refusals: list[tuple[RefusalCode, str, str]]) -> None:
    """Say what stood in the way where holds were refused and too few are left; without refusals the solver says it.

    Raises
    ------
    CalibrationError
        If fewer are left than scale and bias need.
    """
    if count >= FEWEST_POSITIONS or not refusals:
        return
    (code, _), *_ = Counter(code for code, _, _ in refusals).most_common(1)
    words, remedy = next((words, remedy) for one, words, remedy in reversed(refusals) if one is code)
    at_its_end = code in _AT_LIMIT
    raise CalibrationError(
        f"{counted(count, 'position')} {'is' if count == 1 else 'are'} left, scale and bias need {FEWEST_POSITIONS}, because "
        f"{len(refusals)} {'was' if len(refusals) == 1 else 'were'} refused, mostly as "
        f"this one: {words}; {remedy}",
        Reason.SATURATED if at_its_end else Reason.TOO_FEW,
        positions=count,
        limit=FEWEST_POSITIONS,
        refused=len(refusals),
    )


def _missing_sentences(guide: Guide, refusals: list[Rejected]) -> tuple[str, ...]:
    """Say which planned positions were not measured, and why as far as holds were refused there."""
    plan = guide.plan
    missing = plan.missing()
    if not missing:
        return ()
    why = {one.position: one.words for one in refusals if one.position in missing}
    sentences = [f"{len(missing)} of {len(plan.scheme)} planned positions are not measured: {', '.join(missing)}."]
    return (*sentences, *(f"A hold at {position} was refused: {words}." for position, words in why.items()))


def _true_rate_hz(chain: Chain) -> float:
    rates = [statistics.rate_hz for statistics in chain.statistics if statistics.rate_hz]
    return float(np.median(rates)) if rates else math.nan


def _loss_sentences(chain: Chain, damage: list[Damage], where: str) -> tuple[str, ...]:
    sentences = [f"{part.what}" for part in damage]
    lost = sum(statistics.samples_lost for statistics in chain.statistics)
    estimated = sum(statistics.losses_estimated for statistics in chain.statistics)
    total = sum(statistics.samples for statistics in chain.statistics)
    if lost:
        sentences.append(f"{lost} of {total + lost} samples {where}.")
    if estimated:
        sentences.append(f"About {estimated} more were lost in longer gaps, by the clock of the host.")
    return tuple(sentences)


def session_sha256(session: Session) -> str:
    """Return the hash of the session's parts, in their order."""
    return _sha256(session.parts)


def _sha256(paths: list[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            while block := file.read(HASH_BLOCK_BYTES):
                digest.update(block)
    return digest.hexdigest()
