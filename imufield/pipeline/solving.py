"""Solving a recorded session or a file of position means: replay, calibration, and the sentences about the recording."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imufield.acquire.background_work import BackgroundWork
from imufield.acquire.protocol.units import nominal_scale
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.calibrate.accelerometer.ellipsoid_start import FEWEST_FOR_SCALE_AND_BIAS
from imufield.calibrate.gyroscope.whole_turns import stops_at
from imufield.calibrate.model.observations import Observations, count_repeats_once, join_observations, leave_out
from imufield.dataclass import asdict, dataclass, replace
from imufield.deliver.parameters.clock import best_rate, clock_facts
from imufield.deliver.parameters.file import (
    Context,
    InstrumentFacts,
    Parameters,
    SessionFacts,
    as_written,
    load_found,
    write_document,
)
from imufield.earth import STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError, ImufieldError, Reason
from imufield.files import Origin, utf8_text
from imufield.guide.cross_checks.axes import AxesCheck
from imufield.guide.events import RefusalCode, Rejected
from imufield.guide.lead.still_scales import fitting_unit
from imufield.guide.refusals import Refusal, what_is_left
from imufield.guide.view.marks import with_keys
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.pipeline.chain import Chain, ReadingPlan, SamplesListener, replay_into
from imufield.pipeline.damage import naming_damage
from imufield.pipeline.reading import Reading, ReadingCollector
from imufield.pipeline.reading_cache import cached_reading, is_cached, write_cache
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.windows import is_ramp
from imufield.progress import task
from imufield.samples import median
from imufield.sentences import Sentences, printable, shell_word

if TYPE_CHECKING:
    from imufield.guide.lead.guide import Guide

sentence = Sentences(__package__)

_BETTER_KNOWN = 3.0  # Factor between sigmas of gravity from which the common scale of a session is another in practice.
_SHOWN = 6  # Places that a sentence lists.
_AT_LIMIT = (RefusalCode.SATURATED, RefusalCode.STUCK)
# Refused as soon as it is seen, before a position is known.
_SPOIL_DATA = (RefusalCode.SATURATED, RefusalCode.FROZEN, RefusalCode.INVALID, RefusalCode.SAMPLE_LOSS)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Usable:
    """What a session holds to be calibrated from, with sentences about it."""

    observations: Observations
    axes: AxesCheck
    refused: tuple[str, ...]
    """What, and why."""
    saturated: str
    """What was left out because an axis was clipped; empty where nothing was."""
    sticking: tuple[str, ...]
    """Codes that stick."""


def solve_session(
    session: Session,
    settings: SolveSettings,
    site: SiteOptions | None = None,
    listeners: tuple[SamplesListener, ...] = (),
    *,
    keeps: bool = True,
) -> Parameters:
    """Replay a session and solve it.

    Parameters
    ----------
    session : Session
    settings : SolveSettings
    site : SiteOptions, optional
        What was typed of the place.
    listeners : sequence of callable
        Each is given every block of samples, in order.
    keeps : bool
        Whether what was read is kept beside the recording.

    Raises
    ------
    ImufieldError
        Recording unreadable, calibration impossible or refused.
    """
    damage: list[Damage] = []
    with (
        _naming_unfinished(session),
        read_recording(session, damage, listeners, keeps=keeps) as reading,
        naming_damage(session, damage),
        task("solving"),
    ):
        observations, left_out = leave_out(reading.observations, settings.without, may_lack=settings.is_of_several)
        between, best = reading.between(observations), reading.best
        is_import = session.record.kind == "import"
        saturated, of_holds = tuple(filter(None, (reading.saturated,))), (*reading.refused, *reading.notes, *reading.lost)
        site = site or SiteOptions()
        measured = SolveInput(
            observations=observations,
            left_out=left_out,
            gravity=site.gravity(session.record.site),
            context=Context(
                instrument=InstrumentFacts(**asdict(session.record.instrument)),
                session=_facts(session, reading),
                clock=None if best is None else clock_facts(best, is_import=is_import, stated_sigma=settings.clock_sigma),
            ),
            moves=between,
            rests=reading.rests,
            stops=stops_at(reading.turned_s.tolist(), between.start_s, between.end_s),
            raw_zero=reading.raw_zero,
            gyroscope_scale=reading.gyroscope_scale,
            grade=reading.grade,
            reasons=(*filter(None, (reading.compared,)), *of_holds),
            # First: more positions of the same range would be clipped, too.
            cautions=(*saturated, *reading.sticking),
            of_place=tuple(filter(None, (site.another_place(session.record.site),))),
        )
        try:
            return replace(calibrate(measured, settings), of_recording=(*saturated, *of_holds))
        except CalibrationError as error:
            if not reading.saturated:
                raise
            # Clipped outputs are the cause where what is left cannot be calibrated from.
            why = sentence("solving.rest", saturated=reading.saturated.removesuffix("."), error=error.message)
            raise CalibrationError(why, Reason.SATURATED, **error.values) from error


@contextmanager
def _naming_unfinished(session: Session) -> Iterator[None]:
    """Say of a guided session that has too few positions how it goes on, also where it was finished early."""
    try:
        yield
    except CalibrationError as error:
        is_done = session.finished and not error.values.get("finished_early")
        if error.reason is not Reason.TOO_FEW or session.record.scheme is None or is_done or session.is_being_recorded:
            raise
        values = {"error": error.message.removesuffix("."), "folder": session.folder}
        raise CalibrationError(sentence("solving.unfinished", **values), Reason.TOO_FEW, **error.values) from error


@contextmanager
def read_recording(
    session: Session, damage: list[Damage], listeners: tuple[SamplesListener, ...] = (), *, keeps: bool = True
) -> Iterator[Reading]:
    """Replay a session, or take what is kept of an earlier replay where nobody listens.

    What was read is kept when the block ends well: a command that is refused writes nothing.

    Parameters
    ----------
    session : Session
    damage : list of Damage
        Receives what could not be read.
    listeners : sequence of callable
        Each is given every block of samples, in order.
    keeps : bool
        Whether what was read is kept beside the recording.

    Raises
    ------
    RecordingError
        If it cannot be read.
    CalibrationError
        If it holds nothing to be calibrated from.
    """
    goes_on = session.is_being_recorded
    collected = ReadingCollector()
    chain = Chain(ReadingPlan.of(session), listeners=(collected.feed, *listeners))
    sha256 = BackgroundWork(session.sha256)
    if not (goes_on or listeners) and is_cached(session):
        found = cached_reading(session, sha256.result())
        if found is not None:
            yield found
            return
    replay_into(chain, session, damage, collected.hear)
    with naming_damage(session, damage), task("solving"):
        reading = reading_of(session, chain, collected, damage, sha256=sha256.result())
    yield reading
    if keeps and not (goes_on or damage):
        write_cache(session, reading)


def reading_of(
    session: Session, chain: Chain, collected: ReadingCollector, damage: Sequence[Damage] = (), *, sha256: str
) -> Reading:
    """Return what a chain has read to its end.

    Raises
    ------
    CalibrationError
        If that is nothing to be calibrated from.
    """
    usable = _unguided(chain, session) if chain.guide is None else _guided(chain, chain.guide, collected.refusals)
    if usable.axes.error is not None:
        raise usable.axes.error
    observations = usable.observations
    rests = chain.turn_rests()
    slots, ends_raw = collected.slots(observations if rests is None else join_observations(observations, rests))
    nominal = None if chain.protocol is None else chain.protocol.nominal
    return Reading(
        sha256=sha256,
        observations=observations,
        rests=rests,
        slots=slots,
        ends_raw=ends_raw,
        turned_s=np.array(collected.turned_s),
        resumed_s=np.array(collected.resumed_s),
        cells=collected.trace.finish(),
        best=best_rate(chain.statistics),
        temperature_degc=np.array(chain.temperature_degc),
        sensor_offset_degc=chain.sensor_offset_degc(),
        raw_zero=None if chain.protocol is None else chain.raw_zero(chain.protocol),
        gyroscope_scale=None if nominal is None else nominal.gyroscope_scale,
        grade="" if nominal is None else nominal.grade,
        # Axes are compared by the gyroscope's turns: where there is none, of few of them nobody need be told.
        compared=usable.axes.words if np.isfinite(observations.gyroscope_mean_raw).any() else "",
        saturated=usable.saturated,
        refused=usable.refused,
        sticking=usable.sticking,
        notes=tuple(chain.notes),
        lost=_loss_sentences(chain, damage, is_import=session.record.kind == "import"),
    )


def _facts(session: Session, reading: Reading) -> SessionFacts:
    rate_hz = math.nan if reading.best is None else reading.best.rate_hz or math.nan
    low, high = reading.temperature_degc.tolist()
    own_degc = tuple(reading.sensor_offset_degc.tolist()) if np.isfinite(reading.sensor_offset_degc).any() else ()
    recorded = session.record.recorded
    return SessionFacts(
        name=session.name,
        sha256=reading.sha256,
        sample_rate_hz=rate_hz,
        temperature_degc=(low, high),
        recorded=recorded,
        sensor_offset_degc=own_degc,
    )


def solve_observations(path: Path, settings: SolveSettings, site: SiteOptions) -> Parameters:
    """Solve position means from a file."""
    from imufield.calibrate.model.observation_files import parse_observations, read_content  # No session needs it.

    # Once, for numbers and hash: what a pipe held is gone afterwards.
    content = read_content(path)
    observations, repeats = count_repeats_once(parse_observations(content, path))
    facts = SessionFacts(name=printable(utf8_text(path.name)), sha256=hashlib.sha256(content).hexdigest())
    observations, left_out = leave_out(observations, settings.without, may_lack=settings.is_of_several)
    context = Context(session=facts)
    measured = SolveInput(
        observations=observations, left_out=left_out, gravity=site.gravity(), context=context, reasons=repeats
    )
    return calibrate(measured, settings)


def _guided(chain: Chain, guide: Guide, refusals: list[Rejected]) -> _Usable:
    """Return the accepted positions of a guided session."""
    observations, axes = chain.observations(), guide.check_axes()
    # In a wrong unit the noise of the gyroscope may be none of a unit at rest.
    if not len(observations) and axes.turns_ratio != 1.0:
        raise CalibrationError(axes.words, Reason.UNITS)
    missing = guide.plan.missing()
    # A position that was taken again lacks nothing.
    lacking = [event for event in refusals if missing and (event.position or missing[0]) in missing]
    held = [event for event in lacking if event.position or event.reason in _SPOIL_DATA]
    only_moved = all(event.reason is RefusalCode.MOVED for event in held)
    # If the moved holds would not have been enough either, the positions never shown are what is missing.
    if not only_moved or len(observations) + len({event.position for event in held}) >= FEWEST_FOR_SCALE_AND_BIAS:
        _check_count(len(observations), held)
    if missing and len(observations) < FEWEST_FOR_SCALE_AND_BIAS and axes.error is None:
        values = {"positions": len(observations), "limit": FEWEST_FOR_SCALE_AND_BIAS, "left": what_is_left(missing)}
        values |= {"more": FEWEST_FOR_SCALE_AND_BIAS - len(observations), "finished_early": guide.finished_early}
        raise CalibrationError(sentence("solving.too_few_measured", **values), Reason.TOO_FEW)
    clipped = [event for event in lacking if event.reason in _AT_LIMIT]
    return _Usable(
        observations=observations,
        axes=axes,
        refused=_missing_sentences(guide, refusals),
        saturated=_saturation_sentence([(event.time_s, event.words) for event in clipped]),
        sticking=guide.sticking(),
    )


def _unguided(chain: Chain, session: Session) -> _Usable:
    """Return the still intervals of a session that nobody guided; raises ``CalibrationError`` where it is of one pose."""
    try:
        found = chain.still_intervals()
        _check_count(len(found.observations), _as_imported(chain, session, [refusal for _, refusal in found.refused]))
    except CalibrationError as error:
        _refuse_ramp(chain, session, error)
        raise
    if len(found.observations) < FEWEST_FOR_SCALE_AND_BIAS:
        _refuse_ramp(chain, session)
    if len(found.observations) == 1 and not found.refused:
        has_gyroscope = np.isfinite(found.observations.gyroscope_mean_raw).all()
        key = "solving.one_rest" if has_gyroscope else "solving.one_rest_in_hand"
        values = {"name": session.name, "folder": session.folder, "limit": FEWEST_FOR_SCALE_AND_BIAS}
        raise CalibrationError(sentence(key, **values), Reason.TOO_FEW)
    clipped: list[tuple[float, str]] = []
    others: dict[RefusalCode, list[tuple[float, str]]] = {}
    for start_s, refusal in found.refused:
        (clipped if refusal.reason in _AT_LIMIT else others.setdefault(refusal.reason, [])).append((start_s, refusal.words))
    return _Usable(
        observations=found.observations,
        axes=found.axes,
        refused=tuple(
            _left_out_sentence("solving.shaken" if code is RefusalCode.NOT_STILL else "solving.left_out", stills)
            for code, stills in others.items()
        ),
        saturated=_saturation_sentence(clipped),
        sticking=found.sticking,
    )


def _as_imported(chain: Chain, session: Session, refusals: list[Refusal]) -> list[Refusal]:
    """Return the refusals with the remedy of an import where the unit is wrong: it has no driver that could be set."""
    setting = None if chain.protocol is None else chain.protocol.settings.get("accelerometer_unit")
    scale = None if setting is None else nominal_scale(str(setting.value))
    if session.record.kind != "import" or scale is None:
        return refusals
    # Offsets, of which nothing is known, lengthen some and shorten others.
    typical_m_s2 = float(median(np.array([each.measured for each in refusals if each.reason is RefusalCode.GRAVITY] or [0.0])))
    unit = fitting_unit(scale * typical_m_s2 / STANDARD_GRAVITY_M_S2, "m/s^2")
    remedy = sentence("solving.import_unit" if unit else "solving.import_scale", unit=unit, folder=session.folder)
    return [replace(each, remedy=remedy) if each.reason is RefusalCode.GRAVITY else each for each in refusals]


def _refuse_ramp(chain: Chain, session: Session, error: CalibrationError | None = None) -> None:
    """Say of a ramp of temperature what it is good for: a person needs that more than why none of its stills counts."""
    if chain.protocol is not None and is_ramp(session, chain.raw_zero(chain.protocol)[:3]):
        values = {"name": session.name, "folder": session.folder, "limit": FEWEST_FOR_SCALE_AND_BIAS}
        raise CalibrationError(sentence("solving.one_pose", **values), Reason.TOO_FEW) from error


def _saturation_sentence(clipped: list[tuple[float, str]]) -> str:
    """Return the sentence about stills at the limit of an axis; empty where there are none."""
    return _left_out_sentence("solving.clipped", clipped) if clipped else ""


def _left_out_sentence(key: str, stills: list[tuple[float, str]]) -> str:
    """Return the sentence about stills that were refused for one reason, each with its time and words."""
    shown = ", ".join(f"at {time_s:.1f} s" for time_s, _ in stills[:_SHOWN]) + (" and others" if len(stills) > _SHOWN else "")
    return sentence(key, count=len(stills), shown=shown, words=stills[-1][1])


def _check_count(count: int, refusals: Sequence[Rejected | Refusal]) -> None:
    """Say what stood in the way where holds were refused and too few are left; without refusals the solver says it.

    Raises
    ------
    CalibrationError
        If fewer are left than scale and bias need.
    """
    if count >= FEWEST_FOR_SCALE_AND_BIAS or not refusals:
        return
    ((code, _),) = Counter(refusal.reason for refusal in refusals).most_common(1)
    last = next(refusal for refusal in reversed(refusals) if refusal.reason is code)
    too_few = sentence(
        "solving.too_few" if len(refusals) > 1 else "solving.too_few_one",
        positions=count,
        are="is" if count == 1 else "are",
        limit=FEWEST_FOR_SCALE_AND_BIAS,
        refused=len(refusals),
        position=getattr(last, "position", None) or "1",
        words=last.words,
        remedy=with_keys(last.remedy),
    )
    raise CalibrationError(too_few, Reason.SATURATED if code in _AT_LIMIT else Reason.TOO_FEW)


def _missing_sentences(guide: Guide, refusals: list[Rejected]) -> tuple[str, ...]:
    """Say which planned positions were not measured, and why as far as holds were refused there."""
    plan = guide.plan
    missing = plan.missing()
    if not missing:
        return ()
    why = {event.position: event.words for event in refusals if event.position in missing}
    unmeasured = sentence("solving.missing", count=len(missing), planned=len(plan.scheme), missing=missing)
    refused = (sentence("solving.refused_at", position=position, words=words) for position, words in why.items())
    return (unmeasured, *refused)


def _loss_sentences(chain: Chain, damage: Sequence[Damage], *, is_import: bool) -> tuple[str, ...]:
    sentences = [part.what for part in damage]
    lost = sum(statistics.samples_lost for statistics in chain.statistics)
    estimated = sum(statistics.losses_estimated for statistics in chain.statistics)
    total = sum(statistics.samples for statistics in chain.statistics)
    if lost:
        key = "solving.missing_in_file" if is_import else "solving.lost_on_wire"
        sentences.append(sentence(key, lost=lost, total=total + lost))
    if estimated:
        sentences.append(sentence("solving.estimated", estimated=estimated))
    return tuple(sentences)


def lost_by_replacing(path: Path, now: Parameters) -> tuple[str, ...]:
    """Return a sentence for each thing that the parameter file at ``path`` knows and the one to be written there does not."""
    try:
        before = load_found(path, Origin.INSIDE)
    except ImufieldError:
        return ()
    return (*_better_gravity(before.calibration.gravity, now.calibration.gravity), *_lost_temperature(before, now))


def write_solved(path: Path, solved: Parameters, *, advice: str = "") -> tuple[Parameters, Path | None, tuple[str, ...]]:
    """Write a parameter file; return what it holds, where the one before is kept, and what only that one knows.

    Raises
    ------
    ImufieldError
        As ``write_document``.
    """
    # Asked before the file that stands there is replaced.
    lost = lost_by_replacing(path, solved)
    solved = replace(solved, document=as_written(path, solved.document))
    return solved, write_document(path, solved.document, advice=advice), lost


def _lost_temperature(before: Parameters, now: Parameters) -> tuple[str, ...]:
    if now.temperature_models or not before.temperature_models:
        return ()
    sources = before.context.temperature_sources
    others = [source.name for source in sources if source.sha256 != now.context.session.sha256]
    low, high = before.temperature_range_degc
    again = " ".join(f"--temperature {shell_word(name)}" for name in others)
    return (sentence("solving.lost_temperature", low=low, high=high, again=again),)


def _better_gravity(before: Gravity, now: Gravity) -> tuple[str, ...]:
    # Earlier versions wrote 0 for a height that nobody gave: where none is given now, that is nothing to propose.
    has_height = before.height_m != 0 or before.source != "normal" or not now.lacks_height
    if not (has_height and before.sigma_m_s2 * _BETTER_KNOWN < now.sigma_m_s2):
        return ()
    again = f"--gravity {before.gravity_m_s2:.8g}+-{before.sigma_m_s2:.2g}"
    if before.source == "normal" and before.latitude_deg is not None:
        height = "" if before.height_m is None else f" --height {before.height_m:g}"
        # A gravity that is stated goes before that of the place.
        without = "" if now.source == "normal" else " and without --gravity"
        again = f"--latitude {before.latitude_deg:g}{height}{without}"
    return (sentence("solving.better_gravity", before_m_s2=before.sigma_m_s2, now_m_s2=now.sigma_m_s2, again=again),)
