"""Between parameter files and the joint adjustment of sessions: their numbers in, one file's parameters out.

Scales go in as their deviation from those of one session, ppm. What a session's model leaves out is in all of them alike: it is
no part of what another session draws anew, so it stays out of the adjustment and is added to its result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from imufield.calibrate.model.budget import Kind, Share, picked, root_of
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95
from imufield.calibrate.model.gauge import intrinsic, make_intrinsic
from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.models import PARAMETERS, from_vector
from imufield.calibrate.model.result import (
    GRAVITY_NAME,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    PositionResult,
    Quality,
    SolverSummary,
)
from imufield.calibrate.model.uncertainty import rms
from imufield.calibrate.sessions.joint import Joint, SessionNumbers
from imufield.calibrate.sessions.kinds import PPM, SCALES, kind_of, of_gyroscope
from imufield.calibrate.sessions.verdict import judged_by_sigma
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.context import Context, DayToDay, JoinedSession, SessionFacts, Together, now_text
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.parameters.gauge_free import (
    FIXED_NAMES,
    NAMES,
    PARAMETER_NAMES,
    UNITS,
    GaugeFree,
    lower_jacobian,
    lower_parameters,
    si_values,
)
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2, Gravity
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_KEYS = {
    "bias": "accelerometer.bias_m_s2",
    "scale": "accelerometer.scale",
    "gyroscope bias": "gyroscope.bias_rad_s",
    "gyroscope scale": "gyroscope.scale",
}
_NAMES = {key: name for name, key in _KEYS.items()}


@dataclass(frozen=True, slots=True)
class Gathered:
    """What a session gives to the adjustment."""

    own: SessionNumbers
    shared: Mapping[tuple[str, str], float]
    """By two names, covariance of the errors that it shares with the other sessions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JoinedFrom:
    """What is joined."""

    parameters: Sequence[Parameters]
    """Of each session, in order of time."""
    base: int
    """Whose gravity, units and unfitted terms stand in the result."""
    shared: Sequence[Mapping[tuple[str, str], float]]
    prior_grade: str
    sha256: str
    """Over those of all sessions."""


def prior_scales(grade: Grade) -> dict[str, float]:
    """Return what each kind typically changes by from day to day at most, in its unit."""
    accelerometer, gyroscope = grade.accelerometer, grade.gyroscope
    return {
        "bias": accelerometer.turn_on / MILLI_G_M_S2,
        # What a maker leaves in a scale: no instrument changes by more.
        "scale": accelerometer.scale_ppm,
        "gyroscope bias": gyroscope.turn_on / DEG_PER_HOUR_RAD_S,
        "gyroscope scale": gyroscope.scale_ppm,
    }


def shown_unit(kind: str) -> tuple[str, float]:
    """Return the unit for people of a ``DayToDay.kind``, and its size in the unit of the file."""
    return UNITS[_NAMES[kind]]


def shown_name(kind: str) -> str:
    """Return the words for a ``DayToDay.kind``: "gyroscope bias"."""
    return _NAMES[kind]


def numbers_of(calibration: Calibration, found: GaugeFree, reference: GaugeFree) -> Gathered:
    """Return the numbers of a session for the adjustment, scales against those of a reference."""
    # A quadratic term that was not fitted is zero with a sigma, and nothing that the session says.
    rows = [k for k, number in enumerate(found.numbers) if calibration.quadratic_fitted or kind_of(number.name) != "quadratic"]
    adjusted = found.against({number.name: number for number in reference.numbers}, rows)
    names = tuple(number.name for number in adjusted.numbers)
    # The two triads have parts of their own only as wholes: what they have in common is not told apart from what is drawn anew.
    gyroscope = of_gyroscope(names)
    scatter = np.where(gyroscope[:, None] != gyroscope, 0.0, adjusted.scatter)
    shared = np.where(gyroscope[:, None] | gyroscope, 0.0, adjusted.error - scatter)
    gravity = calibration.gravity
    # K goes with 1/g: what is taken for too much makes it too small.
    by_gravity = [-gravity.sigma_m_s2 / gravity.gravity_m_s2 / PPM if kind_of(name) == "scale" else 0.0 for name in names]
    own = SessionNumbers(
        names=names,
        values=np.array([number.value for number in adjusted.numbers]),
        covariance=scatter,
        by_gravity=np.array(by_gravity),
        site=_site(gravity),
        freedom=calibration.quality.degrees_of_freedom,
    )
    table = {(one, two): float(shared[i, j]) for i, one in enumerate(names) for j, two in enumerate(names)}
    return Gathered(own, table)


def _site(gravity: Gravity) -> str:
    # Assumed gravity counts as one place: its error does not average out, and what places differ by widens repeatability.
    return f"{gravity.gravity_m_s2:.6f}"


def joined_parameters(
    joined: JoinedFrom, joint: Joint, reference: GaugeFree, *, warnings: Sequence[str], notes: Sequence[str]
) -> Parameters:
    """Return the parameters of a new day, in the lower gauge.

    Parameters
    ----------
    joined : JoinedFrom
    joint : Joint
    reference : GaugeFree
        Of the base, whose scales the joint ones are shares of.
    warnings, notes : sequence of str
        What lowers the verdict, and what does not.
    """
    base = joined.parameters[joined.base].calibration
    shared = _shared(joined.shared, joint.names)
    calibration = _calibration(base, joint, shared, reference)
    quality = judged_by_sigma(_quality(joined, joint, warnings, notes), calibration, sentence("joined.remedy"))
    context = _context(joined, joint, dict(zip(joint.names, np.diag(shared).tolist(), strict=True)))
    return from_document(to_document(replace(calibration, quality=quality), None, context))


def _shared(tables: Sequence[Mapping[tuple[str, str], float]], names: tuple[str, ...]) -> FloatArray:
    """Return the covariance of the errors that all sessions share: the mean over those that have them."""
    n = len(names)
    total = np.zeros((n, n))
    for i, one in enumerate(names):
        for j, two in enumerate(names):
            known = [table[one, two] for table in tables if (one, two) in table]
            total[i, j] = sum(known) / max(len(known), 1)
    # A difference of two covariances may be slightly negative in some direction.
    values, vectors = np.linalg.eigh((total + total.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _calibration(base: Calibration, joint: Joint, shared: FloatArray, reference: GaugeFree) -> Calibration:
    values = si_values(base)
    before = {number.name: number.value for number in reference.numbers}
    places = [NAMES.index(name) for name in joint.names]
    units = np.array([UNITS[kind_of(name)][1] * (before[name] if kind_of(name) in SCALES else 1.0) for name in joint.names])
    scales = np.array([before[name] if kind_of(name) in SCALES else 0.0 for name in joint.names])
    values[places] = scales + units * joint.values
    vector = lower_parameters(values)
    J = lower_jacobian(values)[:, places] * units
    gravity, site = base.gravity, _site(base.gravity)
    sigma_m_s2 = gravity.sigma_m_s2 * math.sqrt(joint.gravity_variance[site])
    with_gravity = J @ joint.with_gravity[site] * gravity.sigma_m_s2
    full = np.block([[J @ (joint.covariance + shared) @ J.T, with_gravity[:, None]], [with_gravity, np.array([sigma_m_s2**2])]])
    names = (*PARAMETER_NAMES[: len(vector)], GRAVITY_NAME)
    known = np.array([name not in FIXED_NAMES and variance > 0 for name, variance in zip(names, np.diag(full), strict=True)])
    sigma = np.where(known, np.sqrt(np.maximum(np.diag(full), 0.0)), np.nan)
    sigma[[names.index(name) for name in FIXED_NAMES]] = 0.0
    quadratic = any(kind_of(name) == "quadratic" for name in joint.names)
    numbers, by_vector = intrinsic(vector[:PARAMETERS])
    spread = np.sqrt(np.einsum("ij,jk,ik->i", by_vector, full[:PARAMETERS, :PARAMETERS], by_vector))
    accelerometer = from_vector(vector[:PARAMETERS], base.accelerometer.raw_zero)
    return replace(
        base,
        accelerometer=accelerometer,
        accelerometer_sigma=from_vector(sigma[:PARAMETERS]),
        gauge="lower",
        intrinsic=make_intrinsic(numbers, np.where((np.arange(12) < 9) | quadratic, spread, np.nan)),
        covariance_names=tuple(name for name, is_known in zip(names, known, strict=True) if is_known),
        covariance=full[np.ix_(known, known)],
        budget=picked(_shares(joint, shared, J, sigma_m_s2), np.flatnonzero(known).tolist()),
        gravity=replace(gravity, sigma_m_s2=sigma_m_s2),
        # Each session's own file has its positions.
        positions=PositionResult.none(),
        solver=SolverSummary(
            method="together", status=1, message=sentence("joined.solved"), cost=0.0, evaluations=len(joint.names)
        ),
        quadratic_fitted=quadratic,
        gyroscope=_gyroscope(base.gyroscope, vector[PARAMETERS:], sigma[PARAMETERS:-1]),
    )


def _shares(joint: Joint, shared: FloatArray, J: FloatArray, gravity_sigma_m_s2: float) -> Iterator[Share]:
    """Yield the shares of the uncertainty of a new day; what is estimated is so by limits for infinitely many sessions."""
    kinds: dict[str, Kind] = {"sessions": "A", "gravity": "B", "day_to_day": "A", "no_session_shows": "B"}
    parts = {**joint.shares, "no_session_shows": shared}
    for name, kind in kinds.items():
        is_gravity = name == "gravity"
        yield Share(
            name=name,
            kind=kind,
            input_sigma=gravity_sigma_m_s2 if is_gravity else math.nan,
            input_unit="m/s^2" if is_gravity else "",
            sigma=np.append(root_of(np.diag(J @ parts[name] @ J.T)), gravity_sigma_m_s2 * is_gravity),
        )


def _gyroscope(base: GyroscopeCalibration | None, vector: FloatArray, sigma: FloatArray) -> GyroscopeCalibration | None:
    if base is None or not len(vector):
        return None
    parameters = replace(GyroscopeParameters.from_vector(vector), raw_zero=base.parameters.raw_zero)
    return replace(base, parameters=parameters, sigma=GyroscopeParameters.from_vector(sigma))


def _quality(joined: JoinedFrom, joint: Joint, warnings: Sequence[str], notes: Sequence[str]) -> Quality:
    """Return the figures of all sessions as one, with a verdict no better than that of any of them."""
    each = [parameters.calibration for parameters in joined.parameters]
    residual, left_out = (
        np.concatenate([getattr(calibration.positions, name)[calibration.positions.used] for calibration in each])
        for name in ("residual_m_s2", "leave_one_out_m_s2")
    )
    quality = replace(
        each[joined.base].quality,
        residual_rms_m_s2=rms(residual),
        residual_max_m_s2=float(np.nanmax(np.abs(residual))),
        leave_one_out_rms_m_s2=rms(left_out),
        between_position_sigma_m_s2=rms(np.array([calibration.quality.between_position_sigma_m_s2 for calibration in each])),
        degrees_of_freedom=sum(calibration.quality.degrees_of_freedom for calibration in each),
        student_factor_95=NORMAL_FACTOR_95,
        rank=len(joint.names),
        parameters_fitted=len(joint.names),
        condition=math.nan,
        verdict="good",
        reasons=(_summary(joined), *notes),
        warnings=(),
        suspects=tuple(
            f"{parameters.context.session.name}: {name}"
            for parameters in joined.parameters
            for name in parameters.calibration.quality.suspects
        ),
    )
    if warnings:
        quality = quality.lowered("usable", *warnings)
    # The last comes first, as each goes before the others.
    for parameters in reversed(joined.parameters):
        quality = quality.joined(parameters.context.session.name, parameters.calibration.quality)
    return quality


def _summary(joined: JoinedFrom) -> str:
    days = sorted(parameters.context.session.recorded[:10] for parameters in joined.parameters)
    span = "" if not days[0] or days[0] == days[-1] else f", {days[0]} to {days[-1]},"
    positions = sum(parameters.calibration.positions.count for parameters in joined.parameters)
    return sentence("joined.summary", sessions=len(joined.parameters), span=span, positions=positions)


def _context(joined: JoinedFrom, joint: Joint, shared: Mapping[str, float]) -> Context:
    each = [parameters.context for parameters in joined.parameters]
    base = each[joined.base]
    temperatures = np.array([context.session.temperature_degc for context in each])
    known = temperatures[np.isfinite(temperatures).all(axis=1)]
    instrument = next((context.instrument for context in each[::-1] if context.instrument.serial_number), base.instrument)
    session = SessionFacts(
        name=", ".join(context.session.name for context in each),
        sha256=joined.sha256,
        sample_rate_hz=base.session.sample_rate_hz,
        temperature_degc=(float(known[:, 0].min()), float(known[:, 1].max())) if len(known) else (math.nan, math.nan),
        recorded=max(context.session.recorded for context in each),
    )
    sessions = tuple(
        JoinedSession(
            name=parameters.context.session.name,
            sha256=parameters.context.session.sha256,
            recorded=parameters.context.session.recorded,
            positions=parameters.calibration.positions.count,
        )
        for parameters in joined.parameters
    )
    together = Together(session=sessions, repeatability=tuple(_day_to_day(joint, shared)), prior_grade=joined.prior_grade)
    instrument = replace(instrument, grade=base.instrument.grade, grade_source=base.instrument.grade_source)
    return replace(base, instrument=instrument, session=session, together=together, created=now_text())


def _day_to_day(joint: Joint, shared: Mapping[str, float]) -> list[DayToDay]:
    """Return what changes from day to day; sigmas of mean and new day hold what no session shows, too."""
    found = []
    for kind, daily in joint.daily.items():
        size, own = UNITS[kind][1], daily.repeatability
        hidden = np.sqrt([shared[f"{kind} {place}"] for place in daily.places])
        both = [np.hypot(sigma, hidden) * size for sigma in (daily.mean_sigma, daily.day_sigma)]
        on_axes = [dict(zip(daily.places, sigma.tolist(), strict=True)) for sigma in both]
        mean_sigma, day_sigma = (tuple(sigmas.get(axis, math.nan) for axis in AXES) for sigmas in on_axes)
        found.append(
            DayToDay(
                kind=_KEYS[kind],
                sigma=own.sigma * size,
                low=own.low * size,
                high=own.high * size,
                degrees_of_freedom=own.freedom,
                mean_sigma=mean_sigma,
                day_sigma=day_sigma,
            )
        )
    return found
