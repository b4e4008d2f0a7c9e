"""Bias and scale over temperature, from solved sessions at several temperatures and from recordings of a ramp in one pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.calibrate.model.grades import DEFAULT_GRADE, find_grade
from imufield.calibrate.model.observations import require_named
from imufield.calibrate.model.result import Calibration, Quality, of_session
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.calibrate.sessions.verdict import sigma_doubts
from imufield.calibrate.temperature.at_temperature import calibration_at
from imufield.calibrate.temperature.fit import SessionPoints, TemperatureData, TemperatureFit, fit_temperature, fit_warnings
from imufield.calibrate.temperature.one_pose import gyroscope_sentence, pose_sentence
from imufield.calibrate.temperature.points import accelerometer_points, gyroscope_points
from imufield.calibrate.temperature.ramp import Ramp, RampWindows, cut_ramp, in_one_pose, ramp_sentences, turns
from imufield.dataclass import asdict, dataclass, field, replace
from imufield.deliver.parameters.context import TemperatureSource
from imufield.deliver.parameters.document import judgement
from imufield.deliver.parameters.file import Parameters, from_document
from imufield.deliver.parameters.temperature_tables import add_temperature
from imufield.errors import CalibrationError, Reason
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.chain import session_samples
from imufield.pipeline.same_recording import RecordingMarks, without_copies
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.solving import solve_session
from imufield.pipeline.windows import RAMP, WindowMeans, WindowSums
from imufield.samples import TRIADS, FloatArray, require_possible_degc
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_MOST_OF_IT = 0.5  # Of a recording that nobody was led through: a ramp is one pose for most of its time.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RampMeans(WindowMeans):
    """Means of a recording over windows, in its raw units."""

    name: str
    sha256: str
    remarks: tuple[str, ...] = ()
    """What of the recording could not be read, or is not used, in sentences."""
    marks: RecordingMarks = field(default_factory=RecordingMarks)


def read_ramp(session: Session, base: Parameters) -> RampMeans:
    """Return the means of a recorded ramp.

    Raises
    ------
    RecordingError
        If it cannot be read, or has a temperature that no instrument has.
    ParameterFileError
        If it is of another instrument than the parameters, or in other raw units.
    """
    base.check_instrument(session.serial_number)
    damage: list[Damage] = []
    windows, marks = WindowSums(), RecordingMarks()
    for samples in session_samples(session, damage):
        base.check_unit("accelerometer", samples.units.accelerometer_rate_unit)
        if base.gyroscope_is_complete and np.isfinite(samples.gyroscope).any():
            base.check_unit("gyroscope", samples.units.gyroscope_rate_unit)
        windows.feed(samples)
        marks.feed(samples)
    means = windows.means()
    remarks = [entry.what for entry in damage]
    kept = in_one_pose(_specific_force(base, means.accelerometer))
    share = (kept.stop - kept.start) / max(len(means), 1)
    # A session of positions stays one; who was led through a ramp was told where it begins anew.
    least_kept = 0.0 if session.record.kind == RAMP else _MOST_OF_IT
    if least_kept <= share < 1.0:
        remarks.append(sentence("temperature.moved", name=session.name, kept=share))
        means = means[kept]
    require_possible_degc(session.name, means.temperature_degc)
    return RampMeans(**asdict(means), name=session.name, sha256=session.sha256(), remarks=tuple(remarks), marks=marks)


@dataclass(frozen=True, slots=True)
class MarkedSession:
    """A solved session with the marks of its recording."""

    parameters: Parameters
    marks: RecordingMarks = field(default_factory=RecordingMarks)

    @property
    def name(self) -> str:
        """That of the session."""
        return self.parameters.context.session.name


def over_temperature(
    base: MarkedSession, recorded: Sequence[Session], settings: SolveSettings, site: SiteOptions | None = None
) -> Parameters:
    """Return solved parameters over temperature, from sessions at other temperatures and ramps; raises as what it calls.

    What was captured with a guide is a session; of other recordings one whose pose stays the same is a ramp. Of copies of a
    recording one counts.
    """
    found: list[MarkedSession | RampMeans] = [base]
    # The model is chosen once, or a term would be in some only.
    others = replace(settings, is_of_several=True, model=base.parameters.calibration.model)
    for session in recorded:
        means = None if session.record.kind == "capture" else read_ramp(session, base.parameters)
        is_turned = (
            means is not None and session.record.kind != RAMP and turns(_specific_force(base.parameters, means.accelerometer))
        )
        if means is None or is_turned:
            marks = RecordingMarks()
            found.append(MarkedSession(solve_session(session, others, site, (marks.feed,)), marks))
        else:
            found.append(means)
    kept, copies = without_copies(found)
    ramps = [each for each in kept if isinstance(each, RampMeans)]
    sessions = [each.parameters for each in kept if isinstance(each, MarkedSession)]
    require_named((table["name"] for each in sessions for table in each.document["position"]), settings.without)
    return with_temperature(base.parameters, sessions if len(sessions) > 1 else [], ramps, copies)


def with_temperature(
    base: Parameters, sessions: Sequence[Parameters], ramps: Sequence[RampMeans], notes: Sequence[str] = ()
) -> Parameters:
    """Return parameters that hold over temperature.

    Parameters
    ----------
    base : Parameters
        What holds at the reference, the temperature of its own session; its numbers stay as they are.
    sessions : sequence of Parameters
        Solved sessions at several temperatures, ``base`` among them if it is one of them.
    ramps : sequence of RampMeans
        In one pose each.
    notes : sequence of str
        What else there is to say.

    Raises
    ------
    CalibrationError
        If a session has no temperature, its parameters stand in another frame or unit, a ramp has no output of a triad that
        the base has, or there are too few temperatures.
    RecordingError
        If a session has a temperature that no instrument has.
    ParameterFileError
        If a session is of another instrument.
    """
    for other in sessions:
        _require_comparable(base, other)
    triads = [*TRIADS] if base.gyroscope_is_complete else ["accelerometer"]
    for means in ramps:
        _require_output(means, triads)
    cut = {triad: _cut(base, triad, ramps) for triad in triads}
    # One thermometer: the lag that some of its ramps show holds in the others, and in the sessions, too.
    lags_s = [ramp.lag_s for of_triad in cut.values() for _, ramp in of_triad if ramp.lag_s]
    lag_s = float(np.mean(lags_s)) if lags_s else 0.0
    cut = {triad: _cut(base, triad, ramps, lag_s) for triad in triads} if lags_s else cut
    fits = {triad: _fit_triad(base, triad, sessions, cut, lag_s=lag_s) for triad in triads}
    told = [*notes, *(remark for means in ramps for remark in means.remarks)]
    told += [note for fit in fits.values() for note in fit.notes]
    others = [session for session in sessions if session is not base]
    told += [of_session(other.context.session.name, reason) for other in others for reason in other.of_recording]
    calibration = _over_temperature(base.calibration, fits)
    quality = _judged_over_temperature(base.calibration.quality.with_reasons(*told), calibration)
    for triad, fit in fits.items():
        quality = quality.triad_doubted(triad, fit.warnings)
    # The last comes first, as each goes before the others.
    for other in reversed(others):
        quality = quality.joined(other.context.session.name, other.calibration.quality)
    calibration = replace(calibration, quality=quality)
    document = base.document | {"quality": base.document["quality"] | judgement(quality)}
    document.pop("integrity", None)
    return from_document(add_temperature(document, calibration, _sources(sessions, ramps)))


@dataclass(frozen=True, slots=True)
class _TriadFit:
    """What is known of one triad over temperature, and what there is to say of it."""

    temperature: TriadTemperature | None
    """None for a gyroscope at too few temperatures."""
    notes: Sequence[str]
    warnings: Sequence[str] = ()


def _cut(base: Parameters, triad: str, ramps: Sequence[RampMeans], lag_s: float = 0.0) -> Sequence[tuple[RampMeans, Ramp]]:
    """Return the ramps of a triad; one without this triad is still good for the other."""
    return [(means, cut_ramp(_windows(base, triad, means), lag_s)) for means in ramps if _shows(means, triad)]


def _fit_triad(
    base: Parameters,
    triad: str,
    sessions: Sequence[Parameters],
    cut: Mapping[str, Sequence[tuple[RampMeans, Ramp]]],
    *,
    lag_s: float,
) -> _TriadFit:
    notes: list[str] = []
    for means, ramp in cut[triad]:
        # Once for both triads.
        if triad == "accelerometer" or not _shows(means, "accelerometer"):
            notes += ramp_sentences(ramp, means.name)
    points = _points(base, triad, sessions, lag_s) if sessions else None
    # A ramp is by the temperature of the instrument, and no curve belongs to two thermometers.
    if points is not None and not cut[triad]:
        points = _by_sensors(points, base, triad, sessions)
    ramps = [ramp.blocks for _, ramp in cut[triad]]
    data = TemperatureData(reference_degc=_temperature(base, lag_s), points=points, ramps=ramps)
    highest = data.highest_orders()
    if triad == "gyroscope" and highest.bias == 0:
        return _TriadFit(None, [*notes, sentence("temperature.gyroscope_unknown")])
    found = fit_temperature(data)
    notes.append(_words(triad, found))
    if points is not None and points.sensor_degc is not None:
        apart = float(np.abs(points.sensor_degc - points.temperature_degc[:, np.newaxis]).max())
        notes.append(sentence("temperature.by_sensors", triad=triad, apart=apart))
    warnings, grade = [*fit_warnings(found, triad)], find_grade(base.context.instrument.grade or DEFAULT_GRADE)
    if triad == "accelerometer" and not found.temperature.scale_separated:
        warnings.append(pose_sentence(found.temperature, grade))
    if triad == "gyroscope" and highest.scale == 0:
        notes.append(gyroscope_sentence(found.temperature, grade, points))
    return _TriadFit(found.temperature, notes, warnings)


def _shows(means: RampMeans, triad: str) -> bool:
    return bool(np.isfinite(getattr(means, triad)).any())


def _require_output(means: RampMeans, triads: Sequence[str]) -> None:
    """Raise where a ramp has nothing of these triads."""
    if not any(_shows(means, triad) for triad in triads):
        raise CalibrationError(sentence("temperature.no_output", name=means.name, triads=triads), Reason.NOT_FINITE)


def _require_comparable(base: Parameters, other: Parameters) -> None:
    """Raise where parameters of a session mean something else than those of the base."""
    base.check_instrument(other.context.instrument.serial_number)
    ours, theirs = base.calibration, other.calibration
    alike = [
        ("gauge", ours.gauge, theirs.gauge),
        ("raw_unit", ours.accelerometer_raw_unit, theirs.accelerometer_raw_unit),
        ("quadratic_fitted", ours.quadratic_fitted, theirs.quadratic_fitted),
    ]
    if ours.gyroscope is not None and theirs.gyroscope is not None:
        alike.append(("raw_unit of the gyroscope", ours.gyroscope.raw_unit, theirs.gyroscope.raw_unit))
    for what, wanted, found in alike:
        if wanted != found:
            values = {"name": other.context.session.name, "what": what, "found": found, "wanted": wanted}
            raise CalibrationError(sentence("temperature.differs", **values), Reason.UNITS)


def _temperature(parameters: Parameters, lag_s: float = 0.0) -> float:
    """Return the temperature at which parameters hold: the mean over their positions, as the bias is the mean over them.

    A thermometer that lags is as far behind as the temperature of the session changes meanwhile.
    """
    rows = [(row["start_s"], row["temperature_degc"]) for row in parameters.document["position"] if row["used"]]
    at_s, measured = np.array(rows, dtype=np.float64).reshape(-1, 2).T
    known = measured[np.isfinite(measured)]
    mean = float(known.mean() if len(known) else np.mean(parameters.context.session.temperature_degc))
    from_middle_s = at_s - at_s.mean()
    if len(known) == len(measured) and (size := float(from_middle_s @ from_middle_s)) > 0:
        mean += lag_s * float(from_middle_s @ measured) / size
    if not np.isfinite(mean):
        none = sentence("temperature.none", name=parameters.context.session.name)
        raise CalibrationError(none, Reason.NOT_FINITE)
    require_possible_degc(parameters.context.session.name, np.array([mean]))
    return mean


def _points(base: Parameters, triad: str, sessions: Sequence[Parameters], lag_s: float) -> SessionPoints:
    """Return what the sessions found of a triad."""
    at_degc = [_temperature(session, lag_s) for session in sessions]
    of_base = next((number for number, session in enumerate(sessions) if session is base), None)
    calibrations = [session.calibration for session in sessions]
    gyroscope = base.calibration.gyroscope
    if triad == "accelerometer" or gyroscope is None:
        return accelerometer_points(base.calibration.accelerometer, calibrations, at_degc, of_base)
    theirs = [calibration.gyroscope for calibration in calibrations if calibration.gyroscope is not None]
    if len(theirs) < len(sessions):
        lacking = next(session for session in sessions if session.calibration.gyroscope is None)
        none = sentence("temperature.no_gyroscope", name=lacking.context.session.name)
        raise CalibrationError(none, Reason.UNOBSERVABLE)
    return gyroscope_points(gyroscope.parameters, theirs, at_degc, of_base)


def _by_sensors(points: SessionPoints, base: Parameters, triad: str, sessions: Sequence[Parameters]) -> SessionPoints:
    """Return points with the temperature of each axis' own sensor, where base and sessions all have them."""
    axes = slice(3) if triad == "accelerometer" else slice(3, 6)
    facts = (session.context.session.sensor_offset_degc or (np.nan,) * 6 for session in (base, *sessions))
    of_base, *offsets_degc = (np.array(each[axes], dtype=np.float64) for each in facts)
    sensor_degc = points.temperature_degc[:, np.newaxis] + np.array(offsets_degc) - of_base
    return replace(points, sensor_degc=sensor_degc, sensor_offset_degc=of_base) if np.isfinite(sensor_degc).all() else points


def _windows(base: Parameters, triad: str, means: RampMeans) -> RampWindows:
    """Return a ramp's means, less the raw zero, over the scale at the reference."""
    force = _specific_force(base, means.accelerometer)
    output = force + base.calibration.accelerometer.bias_m_s2
    gyroscope = base.calibration.gyroscope
    if triad == "gyroscope" and gyroscope is not None:
        rates = gyroscope.parameters
        output, force = (means.gyroscope - rates.raw_zero) / rates.scale, np.zeros_like(force)
    return RampWindows(time_s=means.time_s, temperature_degc=means.temperature_degc, output=output, specific_force_m_s2=force)


def _specific_force(base: Parameters, accelerometer: FloatArray) -> FloatArray:
    """Return the specific force along the sensing axes for raw outputs, both of shape (n, 3)."""
    parameters = base.calibration.accelerometer
    return (accelerometer - parameters.raw_zero) / parameters.scale - parameters.bias_m_s2


def _words(triad: str, found: TemperatureFit) -> str:
    model = found.temperature
    low, high = model.range_degc
    orders = {"bias": model.bias.order, "scale": model.scale.order, "blocks": found.blocks}
    return sentence("temperature.found", triad=triad, low=low, high=high, reference=model.reference_degc, **orders)


def _sources(sessions: Sequence[Parameters], ramps: Sequence[RampMeans]) -> tuple[TemperatureSource, ...]:
    of_sessions = (
        TemperatureSource(facts.name, "session", facts.sha256, facts.temperature_degc)
        for facts in (session.context.session for session in sessions)
    )
    of_ramps = (
        TemperatureSource(ramp.name, "ramp", ramp.sha256, (float(known.min()), float(known.max())))
        for ramp, known in ((ramp, ramp.temperature_degc[np.isfinite(ramp.temperature_degc)]) for ramp in ramps)
    )
    return (*of_sessions, *of_ramps)


def _over_temperature(base: Calibration, fits: Mapping[str, _TriadFit]) -> Calibration:
    """Return a calibration with what was found."""
    gyroscope = base.gyroscope
    if gyroscope is not None and "gyroscope" in fits and fits["gyroscope"].temperature is not None:
        gyroscope = replace(gyroscope, temperature=fits["gyroscope"].temperature)
    return replace(base, accelerometer_temperature=fits["accelerometer"].temperature, gyroscope=gyroscope)


def _judged_over_temperature(quality: Quality, calibration: Calibration) -> Quality:
    """Return a verdict that holds at both ends of the range, where polynomials are least sure."""
    model, said = calibration.accelerometer_temperature, set[str]()
    for end_degc in () if model is None else model.range_degc:
        remedy = sentence("temperature.remedy", end=end_degc)
        for triad, why in sigma_doubts(calibration_at(calibration, end_degc), remedy):
            # Both ends are mostly as unsure for one reason, which is said once.
            quality = quality.triad_doubted(triad, [each for each in why if each.key not in said])
            said.update(each.key for each in why)
    return quality
