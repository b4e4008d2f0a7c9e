"""Gauge-free numbers: the same in every frame, with the sigma that draws of the parameters show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.accelerometer.methods import restart
from imufield.calibrate.model.gauge import change_gauge, turn_accelerometer, turn_gyroscope
from imufield.calibrate.model.models import from_vector, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    GYROSCOPE_NAMES,
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    QuadraticAxes,
)
from imufield.deliver.navigation.uncertain import draw_parameters
from imufield.deliver.parameters.gauge_free import (
    NAMES,
    PARAMETER_NAMES,
    Number,
    gauge_free,
    lower_jacobian,
    lower_parameters,
    si_values,
)
from imufield.earth import STANDARD_GRAVITY_M_S2, choose_gravity
from imufield.errors import CalibrationError, Reason
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.study.answers.means import MeanSession
from tests.refused import refused

E = np.array([[0, 1.2e-3, -8e-4], [2.1e-3, 0, 5e-4], [-1.7e-3, 9e-4, 0]])
G = np.array([[3e-6, -1e-6, 2e-6], [0.5e-6, 4e-6, -2e-6], [1e-6, 1.5e-6, -3e-6]])
SCALE = np.array([1.002, 0.998, 1.001])
GRAVITY = choose_gravity(latitude_deg=48.0)


@pytest.fixture
def whole(calibration: Calibration) -> Calibration:
    """Return a calibration whose gyroscope was estimated whole, with one joint covariance."""
    names = (*ACCELEROMETER_NAMES, *GYROSCOPE_NAMES)
    root = np.random.default_rng(8).normal(scale=2e-5, size=(len(names), len(names)))
    root[names.index("gyroscope.g_sensitivity.xx") :] *= 0.02
    known = np.full((3, 3), 1e-5)
    sigma = GyroscopeParameters(known[0], known, known[0], known)
    gyroscope = GyroscopeCalibration(parameters=GyroscopeParameters(SCALE, E, np.zeros(3), G), sigma=sigma, path="simulated")
    return replace(calibration, gyroscope=gyroscope, covariance_names=names, covariance=root @ root.T)


def with_gyroscope(calibration: Calibration, parameters: GyroscopeParameters) -> Calibration:
    assert calibration.gyroscope is not None
    return replace(calibration, gyroscope=replace(calibration.gyroscope, parameters=parameters))


# Of the units of the numbers of the gyroscope.
DEG_PER_H = np.pi / 180 / 3600
SIZES = np.repeat([DEG_PER_H, 1.0, 1e-3, DEG_PER_H / STANDARD_GRAVITY_M_S2], [3, 3, 6, 9])


def turned(calibration: Calibration, gauge: str) -> Calibration:
    rotation = change_gauge(to_vector(calibration.accelerometer), gauge).rotation  # type: ignore[arg-type]
    other = with_gyroscope(calibration, turn_gyroscope(calibration.gyroscope.parameters, rotation))
    return replace(other, accelerometer=turn_accelerometer(calibration.accelerometer, rotation))


def numbers_of(calibration: Calibration) -> tuple[Number, ...]:
    """Return the numbers alone, which do not depend on the positions."""
    nothing = np.full((len(calibration.positions.used), 3), np.nan)
    return gauge_free(calibration, nothing, nothing).numbers


def gyroscope_of(calibration: Calibration) -> np.ndarray:
    """Return the values of the gyroscope in the units of the numbers."""
    return np.array([one.value for one in numbers_of(calibration) if one.name.startswith(("gyroscope", "g-"))])


@pytest.mark.parametrize("gauge", ["upper", "symmetric"])
def test_another_frame_changes_nothing(whole: Calibration, gauge: str) -> None:
    other = turned(whole, gauge)
    assert np.abs(other.gyroscope.parameters.misalignment_rad - E).max() > 1e-4
    assert np.abs(other.gyroscope.parameters.scale / SCALE - 1).max() > 1e-6
    np.testing.assert_allclose(gyroscope_of(other), gyroscope_of(whole), atol=1e-11, rtol=1e-12)


def test_in_the_frame_of_the_accelerometer_they_are_the_parameters(whole: Calibration) -> None:
    values = gyroscope_of(whole)
    np.testing.assert_allclose(values[3:6], SCALE, rtol=1e-12)
    np.testing.assert_allclose(values[6:12], 1e3 * E[~np.eye(3, dtype=bool)], atol=1e-12)
    deg_per_h = np.degrees(1) * 3600
    np.testing.assert_allclose(values[12:].reshape(3, 3), G / SCALE[:, None] * STANDARD_GRAVITY_M_S2 * deg_per_h, rtol=1e-12)


def test_sigma_and_correlation_are_what_draws_show(whole: Calibration, observations: Observations) -> None:
    drawn = draw_parameters(whole, 2000, np.random.default_rng(3))
    found = gauge_free(whole, observations.mean_raw, np.full((len(observations), 3), np.nan))
    values = []
    for k in range(2000):
        parameters = GyroscopeParameters(**{name: drawn.gyroscope[name][k] for name in drawn.gyroscope})
        values.append(si_values(replace(with_gyroscope(whole, parameters), accelerometer=from_vector(drawn.vector[k]))))
    order = [NAMES.index(number.name) for number in found.numbers]
    drawn_values = np.transpose(values)[order]
    known = [number.sigma for number in found.numbers][12:]
    # The sigma of a standard deviation of 2000 draws is 1.6 %, that of a correlation at most 2.2 %.
    np.testing.assert_allclose(np.std(drawn_values, axis=1)[12:] / SIZES, known, rtol=0.05)
    root = np.sqrt(np.diag(found.error))
    np.testing.assert_allclose(np.corrcoef(drawn_values), found.error / np.outer(root, root), atol=0.08)


def stepped(calibration: Calibration, name: str, step: float) -> Calibration:
    triad, key, place = name.split(".")
    axes = tuple("xyz".index(axis) for axis in place)
    if triad == "accelerometer":
        values = getattr(calibration.accelerometer, key).copy()
        values[axes] += step
        return replace(calibration, accelerometer=replace(calibration.accelerometer, **{key: values}))
    parameters = calibration.gyroscope.parameters
    values = getattr(parameters, key).copy()
    values[axes] += step
    return with_gyroscope(calibration, replace(parameters, **{key: values}))


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_the_covariance_follows_the_derivatives_by_differences(skew: Calibration, axes: QuadraticAxes) -> None:
    skew = replace(skew, accelerometer=replace(skew.accelerometer, quadratic_axes=axes))
    names, rng = PARAMETER_NAMES, np.random.default_rng(4)
    spread = np.array([1e-4 if "misalignment" in name else 1e-5 for name in names])
    root = spread[:, None] * rng.standard_normal((len(names), len(names)))
    correlated = replace(skew, covariance_names=(*names, GRAVITY_NAME), covariance=np.pad(root @ root.T, (0, 1)))
    nothing = np.full((len(skew.positions.used), 3), np.nan)
    found = gauge_free(correlated, nothing, nothing)
    ends = [[si_values(stepped(skew, name, sign * 1e-5)) for sign in (1.0, -1.0)] for name in names]
    J = np.transpose([(high - low) / 2e-5 for high, low in ends])
    expected = J @ root @ root.T @ J.T
    # The numbers of the gyroscope have their sigma from here alone, in units of their own.
    own = [number for number in found.numbers if number.name.startswith(("gyroscope", "g-"))]
    sigma = SIZES * [number.sigma for number in own]
    np.testing.assert_allclose(sigma, np.sqrt(np.diag(expected))[12:], rtol=1e-7)
    scale = np.sqrt(np.diag(found.error))
    order = [NAMES.index(number.name) for number in found.numbers]
    wanted = expected[np.ix_(order, order)]
    size = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(found.error / np.outer(scale, scale), wanted / np.outer(size, size), atol=1e-7)


def test_what_differs_between_sessions_is_the_fit_alone() -> None:
    truth = perfect_instrument(TACTICAL)
    session = MeanSession(instrument=truth, gravity_m_s2=GRAVITY.gravity_m_s2)
    observations = session.observe(np.random.default_rng(3)).observations
    found = calibrate_accelerometer(observations, GRAVITY, gauge="symmetric")
    assert not found.quadratic_fitted
    sigma_raw = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    numbers = gauge_free(found, observations.mean_raw, sigma_raw)
    by_name = {number.name: k for k, number in enumerate(numbers.numbers)}
    # By another route, in whitened coordinates from a start of its own: scale, K b, angle, K2 (raw).
    again = restart(observations, found).gauge_free_sigma()
    # That has the weights; what the residuals say of them is a factor, as degrees of freedom tell.
    tau, within = found.quality.between_position_sigma_m_s2, sigma_raw[0, 0] / truth.accelerometer.scale[0]
    freedom = len(observations) - 9
    birge = np.sum(found.positions.residual_m_s2**2) / (within**2 + tau**2) / freedom
    assert numbers.numbers[0].scatter_freedom == freedom
    scatter = np.sqrt(np.diag(numbers.scatter) / birge)
    for name, expected in (("scale x", again[0]), ("bias y", again[4] / 9.80665e-3), ("angle yz", again[8] * 1e3)):
        assert scatter[by_name[name]] == pytest.approx(expected, rel=1e-3)
    # A quadratic term that was left out may hide in the bias, in every session alike.
    error = np.sqrt(np.diag(numbers.error))
    assert error[by_name["bias y"]] > 1.5 * scatter[by_name["bias y"]]
    # Nor is it among the residuals that say how sure an angle is, which it is in those of the fit alone.
    assert error[by_name["angle yz"]] == pytest.approx(scatter[by_name["angle yz"]], rel=0.15)


def test_a_drift_that_was_fitted_is_part_of_the_fit() -> None:
    """What the numbers of sessions with other noise scatter is what each says of them, within 25 % for each kind."""
    effects = Effects(warm_up_m_s2=(0.01, -0.01, 0.01))
    truth = replace(perfect_instrument(TACTICAL), effects=effects)
    session = MeanSession(instrument=truth, gravity_m_s2=GRAVITY.gravity_m_s2, order="corners24")
    rng = np.random.default_rng(5)
    found = []
    for _ in range(40):
        observations = session.observe(rng).observations
        calibration = calibrate_accelerometer(observations, GRAVITY, gauge="symmetric")
        if np.any(calibration.positions.bias_drift_m_s2) and not calibration.quadratic_fitted:
            sigma_raw = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
            found.append(gauge_free(calibration, observations.mean_raw, sigma_raw))
    assert len(found) > 30
    assert {number.scatter_freedom for one in found for number in one.numbers} == {24 - 15}
    values = np.array([[number.value for number in one.numbers] for one in found])
    stated = np.sqrt(np.mean([np.diag(one.scatter) for one in found], axis=0))
    ratio = (values.std(axis=0, ddof=1) / stated).reshape(3, 3)
    np.testing.assert_allclose(np.sqrt(np.mean(ratio**2, axis=1)), 1.0, atol=0.25)


def test_names_units_and_what_was_not_estimated(whole: Calibration) -> None:
    found = {one.name: one for one in numbers_of(whole)}
    assert found["gyroscope misalignment yx"].value == pytest.approx(2.1)
    deg_per_h_g = np.degrees(3e-6 / 1.002) * 3600 * STANDARD_GRAVITY_M_S2
    assert found["g-sensitivity xx"].value == pytest.approx(deg_per_h_g)
    kept = tuple(name for name in whole.covariance_names if "g_sensitivity" not in name)
    n = len(kept)
    partly = replace(whole, covariance_names=kept, covariance=whole.covariance[:n, :n])
    names = [one.name for one in numbers_of(partly)]
    assert "gyroscope misalignment zy" in names
    assert not any(name.startswith("g-sensitivity") for name in names)


def test_left_handed_axes_are_refused(whole: Calibration) -> None:
    flat = np.array([[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
    bent = replace(whole.accelerometer, misalignment_rad=flat + np.triu(np.full((3, 3), 2.0), 1))
    with refused(CalibrationError, Reason.HANDEDNESS) as caught:
        numbers_of(replace(whole, accelerometer=bent))
    assert caught.value.values["volume"] < 0


@pytest.fixture
def skew(calibration: Calibration) -> Calibration:
    """Return a calibration with every term, written in the symmetric gauge."""
    rng = np.random.default_rng(1)
    crooked = 0.01 * rng.standard_normal((3, 3)) * ~np.eye(3, dtype=np.bool_)
    accelerometer = AccelerometerParameters(
        scale=np.array([400.0, -410.0, 405.0]),
        bias_m_s2=np.array([0.3, -0.2, 0.1]),
        misalignment_rad=(crooked + crooked.T) / 2,
        quadratic=np.array([0.01, 0.02, -0.03]),
    )
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    parameters = replace(gyroscope.parameters, misalignment_rad=crooked, g_sensitivity=0.1 * rng.standard_normal((3, 3)))
    return replace(calibration, accelerometer=accelerometer, gyroscope=replace(gyroscope, parameters=parameters))


def lower(calibration: Calibration) -> np.ndarray:
    """Return the parameters in the lower gauge, by a turn."""
    gyroscope: GyroscopeCalibration | None = calibration.gyroscope
    assert gyroscope is not None
    change = change_gauge(to_vector(calibration.accelerometer), "lower")
    turned = turn_gyroscope(gyroscope.parameters, change.rotation)
    accelerometer = to_vector(turn_accelerometer(calibration.accelerometer, change.rotation))
    off_diagonal = turned.misalignment_rad[~np.eye(3, dtype=np.bool_)]
    return np.concatenate([accelerometer, turned.scale, off_diagonal, turned.bias, turned.g_sensitivity.ravel()])


def test_both_triads_come_back_as_a_turn_writes_them(skew: Calibration) -> None:
    found = lower_parameters(si_values(skew))
    assert len(found) == len(PARAMETER_NAMES)
    assert found == pytest.approx(lower(skew), rel=1e-9, abs=1e-12)


def test_without_a_gyroscope_there_are_fifteen(skew: Calibration) -> None:
    alone = lower_parameters(si_values(replace(skew, gyroscope=None)))
    assert alone == pytest.approx(lower(skew)[:15], rel=1e-9, abs=1e-12)


def test_derivatives_predict_a_small_change(skew: Calibration) -> None:
    values = si_values(skew)
    change = 1e-5 * np.random.default_rng(2).standard_normal(len(values))
    predicted = lower_parameters(values) + lower_jacobian(values) @ change
    # What is left is of second order.
    assert lower_parameters(values + change) == pytest.approx(predicted, rel=1e-7, abs=1e-8)


def test_a_bias_from_another_raw_zero_is_another_number(whole: Calibration) -> None:
    assert whole.gyroscope is not None
    counted = with_gyroscope(whole, whole.gyroscope.parameters.about(np.array([2048.0, 0.0, 2048.0])))
    found = {number.name: number for number in numbers_of(counted)}
    before = {number.name: number for number in numbers_of(whole)}
    others = {name for name, number in found.items() if number.unit != before[name].unit}
    assert others == {"gyroscope bias x", "gyroscope bias z"}
    assert found["gyroscope bias x"].unit.endswith(" from 2048")
