"""From what was measured to parameters: accelerometer by the method asked for, gyroscope by what the session holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.accelerometer.ellipsoid_start import FEWEST_FOR_MISALIGNMENT
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import FEWEST_STILLS, GyroscopeInput
from imufield.calibrate.gyroscope.model_choice import GyroscopeModel
from imufield.calibrate.gyroscope.whole_turns import Stop
from imufield.calibrate.model.grades import DEFAULT_GRADE
from imufield.calibrate.model.models import recover_vectors, to_vector
from imufield.calibrate.model.observations import Observations, join_observations
from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    Gauge,
    ModelChoice,
    PositionResult,
    without_drift,
)
from imufield.calibrate.moves.moves import Moves, cut_moves
from imufield.calibrate.moves.slots import no_slots
from imufield.calibrate.solvers.agreement import LEAST_SQUARES
from imufield.dataclass import dataclass, field, replace
from imufield.deliver.parameters.clock import clock_words
from imufield.deliver.parameters.file import Context, Parameters, from_document, to_document
from imufield.earth import MILLI_G_M_S2, Gravity
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray, SampleUnits
from imufield.sentences import Sentences

sentence = Sentences(__package__)

FEWEST_CHECKED = FEWEST_FOR_MISALIGNMENT + 1
"""For misalignment, too, and one that checks the others: with fewer a result is POOR, or lacks parameters."""
_LARGEST_BIAS_DEG_S = 40.0  # Twice the tolerance of a consumer chip at zero rate (MPU-6050: 20).
_NOT_CALIBRATED = "not calibrated"
# Reasons for a gyroscope without a calibration that say that its data are not what they are said to be.
_CONTRADICTED = (Reason.UNITS, Reason.HANDEDNESS, Reason.NOT_CONVERGED, Reason.SATURATED)


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveInput:
    """What is calibrated from, wherever it came from."""

    observations: Observations
    gravity: Gravity
    context: Context
    left_out: Observations | None = None
    """What the user left out: for the record alone."""
    moves: Moves | None = None
    """Between the stills, of positions and then of turns; None where only means are known."""
    rests: Observations | None = None
    """Stills between whole turns: for the gyroscope alone."""
    stops: tuple[Stop, ...] = ()
    """Whole turns about the vertical."""
    raw_zero: FloatArray | None = None
    gyroscope_scale: float | None = None
    """Raw unit per rad/s, nominal."""
    grade: str = ""
    """Of the instrument; empty where it is not known."""
    reasons: tuple[str, ...] = ()
    """Sentences about the recording that belong to the verdict."""
    cautions: tuple[str, ...] = ()
    """The same that keep the verdict from being good."""
    of_place: tuple[str, ...] = ()
    """The same that doubt gravity: that on the accelerometer is no better either."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveSettings:
    """How the user wants it calibrated."""

    model: ModelChoice = "auto"
    gauge: Gauge | None = None
    method: str = LEAST_SQUARES
    method_settings: Mapping[str, str] = field(default_factory=dict)
    polish: bool = True
    cross_check: bool = False
    gyroscope_model: GyroscopeModel = "auto"
    preset: Parameters | None = None
    raw_zero: FloatArray | None = None
    grade: str | None = None
    """Whose typical errors stand in the uncertainty for what a session does not show; None: the instrument's."""
    seed: int = 0
    without: tuple[str, ...] = ()
    """Names of positions to leave out."""
    is_of_several: bool = False
    """Whether other sessions are solved with it: a name to leave out may be one of theirs."""
    clock_sigma: float | None = None
    """1 sigma of the sample period, relative; None: by what clock it is."""


def calibrate(measured: SolveInput, settings: SolveSettings) -> Parameters:
    """Return the parameters of both triads.

    Raises
    ------
    CalibrationError
        If calibration is impossible from these data, or refused.
    ParameterFileError
        If the preset is for another instrument.
    """
    preset, grade = None, settings.grade or measured.grade
    units = measured.observations.units
    if settings.preset is not None:
        grade = grade or settings.preset.context.instrument.stated_grade
        # In other raw units, or of another instrument, its scale would mean something else.
        settings.preset.check_instrument(measured.context.instrument.serial_number)
        settings.preset.check_unit("accelerometer", units.accelerometer_rate_unit)
        if settings.preset.gyroscope_is_complete and np.isfinite(measured.observations.gyroscope_mean_raw).any():
            settings.preset.check_unit("gyroscope", units.gyroscope_rate_unit)
        preset = settings.preset.calibration.accelerometer
    grade, grade_source = (grade, "stated") if grade else (DEFAULT_GRADE, "assumed")
    zero = _raw_zero(measured, settings)
    calibration = calibrate_accelerometer(
        measured.observations,
        measured.gravity,
        model=settings.model,
        gauge=settings.gauge,
        preset=preset,
        raw_zero=None if zero is None else zero[:3],
        grade=grade,
        seed=settings.seed,
    )
    # One for all that draws, made by the first of them: numpy.random is slow to import, and least squares alone draws nothing.
    rng = cache(lambda: np.random.default_rng(settings.seed))
    # Least squares comes first whatever the method: it chooses the model, and the others are held against it.
    calibration, checked = _by_other_methods(calibration, measured.observations, settings, rng, preset=preset)
    sentences = [*measured.reasons, *checked]
    # After the accelerometer, which tells in what position each still was.
    accelerometer_verdict = calibration.quality.verdict
    calibration, gyroscope_verdict = _with_gyroscope(calibration, measured, settings, rng, grade=grade)
    gyroscope = calibration.gyroscope
    if gyroscope is None or np.isnan(gyroscope.range_rad_s).all():
        sentences.append(sentence("calibration.range"))
    quality = replace(
        calibration.quality.with_reasons(*sentences),
        accelerometer_verdict=accelerometer_verdict,
        gyroscope_verdict=gyroscope_verdict,
    )
    quality = quality.triad_doubted("accelerometer", measured.of_place)
    if measured.cautions:
        quality = quality.lowered("usable", *measured.cautions)
    calibration, observations = replace(calibration, quality=quality), measured.observations
    if measured.left_out is not None and len(measured.left_out):
        observations = join_observations(observations, measured.left_out)
        calibration = _recording_left_out(calibration, observations)
    # Through the document and back: what is printed is what the file holds, digit by digit.
    instrument = replace(measured.context.instrument, grade=grade, grade_source=grade_source)
    return from_document(to_document(calibration, observations, replace(measured.context, instrument=instrument)))


def _by_other_methods(
    calibration: Calibration,
    observations: Observations,
    settings: SolveSettings,
    rng: Callable[[], np.random.Generator],
    *,
    preset: AccelerometerParameters | None,
) -> tuple[Calibration, list[str]]:
    """Return the accelerometer by the method that is asked for, and what a cross-check says."""
    if settings.method == LEAST_SQUARES and not settings.cross_check:
        return calibration, []
    # Least squares alone, as nearly always, needs none of it.
    from imufield.calibrate.accelerometer.methods import cross_check, solve_with

    sentences = []
    if settings.cross_check:
        sentences.append(cross_check(observations, calibration, rng=rng(), preset=preset).sentence)
    if settings.method != LEAST_SQUARES:
        calibration = solve_with(
            settings.method,
            observations,
            calibration,
            rng=rng(),
            preset=preset,
            polish=settings.polish,
            settings=settings.method_settings,
            seed=settings.seed,
        )
    return calibration, sentences


def _recording_left_out(calibration: Calibration, observations: Observations) -> Calibration:
    """Return the calibration with the positions that the user left out behind the others, and a sentence about each."""
    parameters, gravity = calibration.accelerometer, calibration.gravity.gravity_m_s2
    out = np.arange(len(observations)) >= len(calibration.positions.used)
    left_out, steady = observations[out], without_drift(observations, calibration)[out]
    drift = (left_out.mean_raw - steady.mean_raw) / parameters.scale
    zeroed = steady.mean_raw - parameters.raw_zero
    force = recover_vectors(to_vector(parameters), zeroed, parameters.quadratic_axes, parameters.higher)
    off_m_s2, unknown = np.linalg.norm(force, axis=1) - gravity, np.full(len(left_out), np.nan)
    rows = {
        "residual_m_s2": unknown,
        "leave_one_out_m_s2": off_m_s2,
        "leverage": unknown,
        "used": np.zeros(len(left_out), dtype=np.bool_),
        "bias_drift_m_s2": drift,
    }
    before = calibration.positions
    positions = PositionResult(**{name: np.concatenate([getattr(before, name), more]) for name, more in rows.items()})
    told = (
        sentence("calibration.left_out", position=name, off_mg=off / MILLI_G_M_S2)
        for name, off in zip(left_out.name, off_m_s2, strict=True)
    )
    return replace(calibration, positions=positions, quality=calibration.quality.with_reasons(*told))


def _with_gyroscope(
    calibration: Calibration,
    measured: SolveInput,
    settings: SolveSettings,
    rng: Callable[[], np.random.Generator],
    *,
    grade: str,
) -> tuple[Calibration, str]:
    """Join the gyroscope, where the session holds its output; return the verdict on it too."""
    observations = measured.observations if measured.rests is None else join_observations(measured.observations, measured.rests)
    there = np.isfinite(observations.gyroscope_mean_raw).all(axis=1)
    if int(there.sum()) < FEWEST_STILLS:
        return calibration, ""
    before = None if settings.preset is None else settings.preset.calibration.gyroscope
    moves = measured.moves
    given = GyroscopeInput(
        observations=without_drift(observations, calibration),
        moves=cut_moves(no_slots(), observations.start_s, observations.duration_s) if moves is None else moves,
        calibration=calibration,
        latitude_deg=measured.gravity.latitude_deg,
        preset=None if before is None else before.parameters,
        nominal_scale=measured.gyroscope_scale,
        stops=measured.stops,
        rests=0 if measured.rests is None else len(measured.rests),
        grade=grade,
    )
    try:
        result = calibrate_gyroscope(given, settings.gyroscope_model)
        check = solved = None
        if settings.cross_check:
            from imufield.calibrate.gyroscope.methods import cross_check_gyroscope  # late, as those of the accelerometer

            check = cross_check_gyroscope(result, rng=rng())
        if settings.method != LEAST_SQUARES:
            from imufield.calibrate.gyroscope.methods import solve_gyroscope_with  # late, as those of the accelerometer

            result, solved = solve_gyroscope_with(
                settings.method, result, rng=rng(), polish=settings.polish, settings=settings.method_settings
            )
        joined = result.join(calibration)
    except CalibrationError as error:
        # The accelerometer is known all the same; axes that contradict it were refused before.
        why, quality = sentence("calibration.no_gyroscope", error=error.message), calibration.quality
        quality = quality.lowered("usable", why) if error.reason in _CONTRADICTED else quality.with_reasons(why)
        return replace(calibration, quality=quality), _NOT_CALIBRATED
    quality, clock = joined.quality, measured.context.clock
    verdict = result.verdict
    if solved is not None:
        key = "calibration.solved_by" if solved.converged else "calibration.not_converged"
        how = sentence(key, method=settings.method, message=solved.message)
        quality = quality.with_reasons(how) if solved.converged else quality.lowered("poor", how)
        verdict = verdict if solved.converged else "poor"
    if check is not None:
        quality = quality.with_reasons(check.sentence)
    if clock is not None and result.knows_scale:
        quality = quality.with_reasons(clock_words(clock))
    return _with_raw_zero(replace(joined, quality=quality), _raw_zero(measured, settings), observations.units), verdict


def _raw_zero(measured: SolveInput, settings: SolveSettings) -> FloatArray | None:
    """Return the raw zero of the accelerometer, shape (3,), or of both triads, shape (6,), as rates; None where not stated."""
    # Typed as the instrument sends it.
    return measured.raw_zero if settings.raw_zero is None else measured.observations.units.raw_zero_rate(settings.raw_zero)


def _with_raw_zero(calibration: Calibration, stated: FloatArray | None, units: SampleUnits) -> Calibration:
    """Return a calibration whose gyroscope has its raw zero: the stated one, or the accelerometer's on axes that need it."""
    gyroscope, raw_zero = calibration.gyroscope, calibration.accelerometer.raw_zero
    if gyroscope is None:
        return calibration
    parameters, quality = gyroscope.parameters, calibration.quality
    largest = math.radians(_LARGEST_BIAS_DEG_S) * np.abs(parameters.scale)
    largest = np.where(np.isnan(largest), np.abs(raw_zero) / 2, largest)
    if stated is None or len(stated) == len(AXES):
        # Different numbers are of the accelerometer's axes; increments and rates do not come from one converter.
        is_common = not np.ptp(raw_zero) and units.accelerometer_is_increment == units.gyroscope_is_increment
        helps = (np.abs(parameters.bias) > largest) & (np.abs(parameters.bias - raw_zero) <= largest)
        parameters = parameters.about(np.where(helps & is_common, raw_zero, 0.0))
    else:
        parameters = parameters.about(stated[len(AXES) :])
    # NaN where the scale is not known.
    bias_deg_s = float(np.degrees(np.abs(parameters.bias / parameters.scale)).max())
    if nominal_scale(gyroscope.raw_unit) is None and bias_deg_s > _LARGEST_BIAS_DEG_S:
        quality = quality.with_reasons(sentence("calibration.raw_zero", bias_deg_s=bias_deg_s, limit=_LARGEST_BIAS_DEG_S))
    return replace(calibration, gyroscope=replace(gyroscope, parameters=parameters), quality=quality)
