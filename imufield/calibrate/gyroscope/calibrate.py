"""Calibrate a gyroscope with whatever the session contains: the one call behind the gyroscope half of ``imufield solve``.

Stills alone give one of two paths:

static bias     the still means, Earth rate accounted for
static norm     for instruments that see the Earth turn (``gyroscope.stills_alone``)

What a session has beside them goes into one weighted fit with its stills:

moves           between still positions, against gravity
whole turns     by hand: rolled ones are moves, those about the vertical close against a stop
turntable       rates, both ways

``model_choice`` decides whether the g-sensitivity is fitted, ``fit`` fits bias, scale and misalignment, ``residual_covariance``
says how sure the residuals are, ``result`` puts it together.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.gyroscope.fit import fit_jointly
from imufield.calibrate.gyroscope.input import (
    GyroscopeInput,
    handedness_error,
    make_data,
    refuse_dead,
    refuse_foreign,
    without_impossible,
)
from imufield.calibrate.gyroscope.model_choice import FULL, ChosenModel, GyroscopeModel, check_linearity, choose_model
from imufield.calibrate.gyroscope.move_integration import INVERSE, PARAMETERS, SENSITIVITY, arranged_inverse, rough_inverse
from imufield.calibrate.gyroscope.observability import Observability, observe, without_contradicted
from imufield.calibrate.gyroscope.residuals import VERTICAL, GyroscopeData, evaluate
from imufield.calibrate.gyroscope.result import (
    GyroscopeResult,
    JointSolution,
    StaticSolution,
    joint_result,
    static_bias_result,
    static_norm_result,
)
from imufield.calibrate.gyroscope.stills_alone import (
    CONTRADICTED,
    StaticData,
    contradicts,
    fit_static,
    latitude_figures,
    latitude_words,
    sees_earth,
    static_bias,
    unknown_earth_rate,
)
from imufield.calibrate.gyroscope.whole_turns import find_stops, misses_and_limits
from imufield.calibrate.model.coverage_factors import student_quantile
from imufield.calibrate.model.grades import find_grade
from imufield.calibrate.model.rotation import unit_vectors
from imufield.calibrate.model.uncertainty import block_diagonal, rms
from imufield.dataclass import replace
from imufield.earth import EARTH_RATE_RAD_S
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_OTHERS = 8  # Entries of a g-sensitivity beside the part that is alike on all axes.
_ALIKE = 0.995  # Both ways: one of a hundred instruments with entries that are random seems to be at another latitude.

_NO_START_RAD = 0.35  # 20 deg: right axes with a bias of 1 m/s^2 on each accelerometer axis miss by 14.


def calibrate_gyroscope(given: GyroscopeInput, model: GyroscopeModel = "auto") -> GyroscopeResult:
    """Calibrate the gyroscope by every path the session allows.

    Parameters
    ----------
    given : GyroscopeInput
    model : {"auto", "basic", "g-sensitive"}
        Without or with the g-sensitivity G; "auto" keeps it where it proves itself.

    Returns
    -------
    GyroscopeResult
        ``calibration`` has scale (raw unit per rad/s), misalignment (rad), bias (raw unit) and their sigmas;
        ``join`` puts it into the calibration of the accelerometer.

    Raises
    ------
    CalibrationError
        If the stills have no gyroscope output, or the moves contradict the accelerometer's handedness.
    UsageError
        If a stop belongs to no move.
    """
    given.require_stills()
    given = without_impossible(given)
    if not len(given.moves) and not given.turntable:
        return _static(given)
    data = make_data(given)
    refuse_dead(given, data)
    preset = given.preset_inverse()
    estimate = _first_estimate(data, preset)
    start = _start_at(estimate, data)
    observability = observe(start, data, known=preset is not None)
    start = _with_hidden(start, preset, observability)
    warnings: tuple[str, ...] = ()
    if given.stops:
        # A fit without the stops tells which of their turns were whole; the others are used as moves.
        moves, sigma = find_stops(given.stops, given.moves.start_s, given.moves.end_s)
        first = fit_jointly(data, start, observability.free(FULL))
        missed, limit = misses_and_limits(first.evaluation, data, moves, sigma)
        whole = np.abs(missed) <= limit
        warnings = tuple(
            sentence("calibrate.not_whole", start_s=start_s, missed_deg=missed_deg, limit_deg=limit_deg)
            for start_s, missed_deg, limit_deg in zip(
                given.moves.start_s[moves[~whole]], np.degrees(missed[~whole]), np.degrees(limit[~whole]), strict=True
            )
        )
        data = replace(data, stops=moves[whole], stop_sigma_rad=sigma[whole])
    chosen = choose_model(data, start, observability, model)
    while (told := without_contradicted(chosen.fit, None if given.turntable else estimate, observability)) != observability:
        observability, start = told, _with_hidden(start, preset, told)
        chosen = choose_model(data, start, observability, model)
    of_latitude, is_caution = _latitude_told(given, data, chosen)
    return joint_result(
        JointSolution(
            given=given,
            data=data,
            chosen=chosen,
            linearity=check_linearity(data, chosen.fit, None if given.grade is None else find_grade(given.grade)),
            start=start,
            observability=observability,
            warnings=warnings if is_caution else (*warnings, *of_latitude),
            cautions=of_latitude if is_caution else (),
        )
    )


def _latitude_told(given: GyroscopeInput, data: GyroscopeData, chosen: ChosenModel) -> tuple[tuple[Sentence, ...], bool]:
    """Return what the gyroscope says of the latitude, if anything, and whether that lowers the verdict.

    An error of the vertical Earth rate is an exact alias of a g-sensitivity c I: where one is fitted, their sum is compared.
    """
    latitude_deg = given.latitude_deg
    if latitude_deg is None:
        return (), False
    fitted, gravity_m_s2 = chosen.fit, given.calibration.gravity.gravity_m_s2
    loose = fit_jointly(replace(data, latitude_deg=None), fitted.p, fitted.free[fitted.free < PARAMETERS], fitted.scatter)
    share = np.zeros(data.parameters)
    share[VERTICAL] = 1.0
    share[SENSITIVITY] = gravity_m_s2 / 3 * np.eye(3).ravel()
    vertical_rad_s = float(share @ loose.p)
    sigma_rad_s = float(np.sqrt(share[loose.free] @ loose.covariance @ share[loose.free]))
    is_contradicted = contradicts(latitude_deg, vertical_rad_s, sigma_rad_s)
    if not chosen.g_sensitive:
        words = latitude_words(latitude_deg, vertical_rad_s, sigma_rad_s)
        return (words,) if fitted.heading_fitted or is_contradicted else (), is_contradicted
    if not is_contradicted or abs(vertical_rad_s) > EARTH_RATE_RAD_S + CONTRADICTED * sigma_rad_s:
        return (), False
    told = sentence("calibrate.alike", **latitude_figures(latitude_deg, vertical_rad_s, sigma_rad_s))
    # Of nine independent entries the part along c I is Student's over the root mean square of the other eight.
    H = loose.p[SENSITIVITY].reshape(3, 3)
    others = gravity_m_s2 * float(np.linalg.norm(H - np.trace(H) / 3 * np.eye(3))) / math.sqrt(3 * _OTHERS)
    off_rad_s = abs(vertical_rad_s - EARTH_RATE_RAD_S * math.sin(math.radians(latitude_deg)))
    return (told,), off_rad_s > student_quantile(_OTHERS, _ALIKE) * math.hypot(others, sigma_rad_s)


def _first_estimate(data: GyroscopeData, preset: FloatArray | None) -> FloatArray:
    """Return the A with which the moves carry up best from still to still; refuse a preset that another one contradicts."""
    moves, estimates = data.moves, [] if preset is None else [preset]
    if len(moves):
        estimates.append(rough_inverse(moves, preset))
    if not estimates:
        raise CalibrationError(sentence("calibrate.no_scale"), Reason.UNOBSERVABLE)
    # From a preset of half the scale, as of another range, the fit runs to another minimum.
    misses = [_misses_rad(A, data) for A in estimates]
    if min(misses) > _NO_START_RAD:
        estimates.append(arranged_inverse(moves, data.up))
        misses.append(_misses_rad(estimates[-1], data))
    best = estimates[int(np.argmin(misses))]
    if preset is not None and len(moves):
        refuse_foreign(data, best, preset)
    elif np.linalg.det(best) <= 0:
        raise handedness_error()
    return best


def _misses_rad(A: FloatArray, data: GyroscopeData) -> float:
    """Return how far the moves end from where the stills have gravity, RMS."""
    return rms(evaluate(_start_at(A, data), data).angle_error_rad(data.up[data.moves.after]))


def _start_at(A: FloatArray, data: GyroscopeData) -> FloatArray:
    p = np.zeros(data.parameters)
    p[INVERSE] = A.ravel()
    return p


def _with_hidden(start: FloatArray, preset: FloatArray | None, observability: Observability) -> FloatArray:
    """Return the start with what cannot be observed as the preset has it."""
    hidden, p = list(observability.hidden), start.copy()
    if preset is not None:
        p[hidden] = preset.ravel()[hidden]
    return p


def _static(given: GyroscopeInput) -> GyroscopeResult:
    """Return what stills alone show: the Earth's rate where the instrument sees it, else the bias."""
    preset, observations = given.preset, given.observations
    A = given.preset_inverse()
    if A is not None and given.latitude_deg is not None and sees_earth(observations.gyroscope_covariance_raw, A):
        up = unit_vectors(given.force_m_s2)
        middle_s = observations.start_s + observations.duration_s / 2
        rate_raw = observations.gyroscope_mean_raw - given.rest_raw
        covariance = block_diagonal(observations.gyroscope_unrounded_covariance) + observations.gyroscope_rounding()
        data = StaticData(rate_raw, covariance, up, middle_s)
        fitted = fit_static(data, A, given.latitude_deg, given.static_free)
        return static_norm_result(StaticSolution(given=given, data=data, fitted=fitted))
    gyroscope = static_bias(
        observations,
        given.nominal_scale if preset is None else preset.scale,
        misalignment_rad=None if preset is None else preset.misalignment_rad,
        up=given.force_m_s2,
        latitude_deg=given.latitude_deg,
    )
    earth_rate = np.abs(np.nan_to_num(gyroscope.parameters.scale)) * unknown_earth_rate(given.force_m_s2, given.latitude_deg)
    return static_bias_result(gyroscope, given.moves.dropped, stills=len(observations), earth_rate=earth_rate)
