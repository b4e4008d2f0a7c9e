"""Bias and scale over temperature against simulated truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.models import at_temperature, predict, predict_gyroscope
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.calibrate.model.temperature_polynomials import Polynomials, TriadTemperature
from imufield.calibrate.temperature.fit import (
    RampBlocks,
    SessionPoints,
    TemperatureData,
    distinct,
    fit_orders,
    fit_temperature,
    fit_warnings,
)
from imufield.calibrate.temperature.one_pose import gyroscope_sentence, pose_sentence
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason
from tests.refused import refused
from tests.told import key_of, keys

pytestmark = pytest.mark.numerical

REFERENCE_DEGC = 20.0
G = STANDARD_GRAVITY_M_S2
BIAS = np.array([[0.15, -0.1, 0.2], [1e-3, -2e-3, 1.5e-3]]) * MILLI_G_M_S2
"""Per degC and degC^2: figures of a cheap chip."""
SCALE = np.array([[60e-6, -40e-6, 80e-6]])
POSE = np.array([0.6, -0.5, 0.62]) * G
OFFSET = np.array([0.5, -0.4, 0.3])
"""50 mg: a drift of the scale moves the output by its share of this, too."""


def true_change(temperature_degc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    d = np.asarray(temperature_degc)[:, None] - REFERENCE_DEGC
    return d * BIAS[0] + d**2 * BIAS[1], d * SCALE[0]


def sessions(temperature_degc: list[float], rng: np.random.Generator, sigma: tuple[float, float]) -> SessionPoints:
    at = np.array(temperature_degc)
    bias, scale = true_change(at)
    noise = rng.normal(size=(2, len(at), 3))
    covariance = np.broadcast_to(np.diag(np.square(sigma)), (len(at), 3, 2, 2)).copy()
    return SessionPoints(
        temperature_degc=at,
        bias=0.03 + bias + sigma[0] * noise[0],
        scale=1e-4 + scale + sigma[1] * noise[1],
        covariance=covariance,
    )


def ramp(
    rng: np.random.Generator, sigma: float, *, force: np.ndarray = POSE, hysteresis: float = 0.0, low_degc: float = -20.0
) -> RampBlocks:
    up = np.arange(low_degc, 60.1, 2.0)
    at, direction = np.concatenate([up, up[::-1]]), np.repeat([1.0, -1.0], len(up))
    bias, scale = true_change(at)
    output = (1 + scale) * (force + OFFSET + bias) + hysteresis * direction[:, None] + sigma * rng.normal(size=(len(at), 3))
    return RampBlocks(
        temperature_degc=at,
        output=output,
        sigma=np.full((len(at), 3), sigma),
        direction=direction,
        specific_force_m_s2=force,
    )


SIGMA = (0.05 * MILLI_G_M_S2, 20e-6)
ENDS = np.array([-20.0, 60.0])


def test_sessions_and_a_ramp_separate_bias_from_scale() -> None:
    rng = np.random.default_rng(1)
    data = TemperatureData(reference_degc=20.0, points=sessions([-18.0, 20.0, 58.0], rng, SIGMA), ramps=[ramp(rng, 1e-4)])
    found = fit_temperature(data).temperature
    assert (found.bias.order, found.scale.order) == (2, 1)
    assert found.scale_separated
    bias, scale = true_change(ENDS)
    d = found.degrees_above(ENDS)
    assert np.abs((found.bias.at(d) - bias) / found.bias.sigma_at(d)).max() < 3.5
    assert np.abs((found.scale.at(d) - scale) / found.scale.sigma_at(d)).max() < 3.5
    assert found.scale.sigma_at(d).max() < 60e-6
    np.testing.assert_array_equal(found.bias.at(np.zeros(1)), 0.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("temperatures", [[20.0, 60.0, 40.0], [20.0, 60.0], [20.0, 60.0, 10.0], [20.0, -15.0, 55.0]])
def test_a_ramp_on_one_side_of_the_reference(temperatures: list[float], seed: int) -> None:
    """As where an instrument is only heated: an output of gravity must not pass for a bias that scatters by gravity."""
    rng = np.random.default_rng(seed)
    data = TemperatureData(
        reference_degc=20.0, points=sessions(temperatures, rng, SIGMA), ramps=[ramp(rng, 1e-4, low_degc=20.0)]
    )
    found = fit_temperature(data).temperature
    bias, scale = true_change(np.array([60.0]))
    d = found.degrees_above(np.array([60.0]))
    assert np.abs(found.scale.at(d) - scale).max() < 5 * SIGMA[1] * np.sqrt(2)
    assert np.abs(found.bias.at(d) - bias).max() < 5 * SIGMA[0] * np.sqrt(2)


def test_the_covariance_of_bias_and_scale_gives_the_sigma_of_every_pose() -> None:
    """A ramp knows what the output does in its own pose far better than bias and scale by themselves."""
    rng, off, stated, apart = np.random.default_rng(13), [], [], []
    for _ in range(60):
        points = sessions([-18.0, 20.0, 58.0], rng, SIGMA)
        found = fit_orders(TemperatureData(reference_degc=20.0, points=points, ramps=[ramp(rng, 1e-4)]), 2, 1).temperature
        bias, scale = true_change(ENDS[1:])
        d = found.degrees_above(ENDS[1:])
        of_force = POSE + OFFSET
        off.append(found.bias.at(d)[0] + of_force * found.scale.at(d)[0] - (bias + of_force * scale)[0])
        without = found.bias.sigma_at(d)[0] ** 2 + (of_force * found.scale.sigma_at(d)[0]) ** 2
        stated.append(np.sqrt(without + 2 * of_force * replace(found, new_day=None).covariance_there(ENDS[1])))
        apart.append(np.sqrt(without))
    # About their mean: a scale of 0.3 % leaves 10 ppm beyond a polynomial of its order.
    assert 0.8 < np.sqrt(np.mean(np.var(off, axis=0) / np.mean(np.square(stated), axis=0))) < 1.25
    assert np.median(np.array(stated) / apart) < 0.5


def test_two_sessions_need_the_ramp() -> None:
    rng = np.random.default_rng(2)
    points = sessions([-10.0, 20.0], rng, SIGMA)
    with refused(CalibrationError, Reason.TOO_FEW, key="fit.too_few"):
        fit_temperature(TemperatureData(reference_degc=20.0, points=points))
    found = fit_temperature(TemperatureData(reference_degc=20.0, points=points, ramps=[ramp(rng, 1e-4)])).temperature
    assert found.scale.order == 1


def test_a_one_pose_ramp_puts_the_scale_into_the_bias_and_says_how_much() -> None:
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[ramp(np.random.default_rng(3), 1e-4)])).temperature
    assert not found.scale_separated
    assert found.scale.order == 0
    bias, scale = true_change(ENDS)
    mixed = bias + scale * (POSE + OFFSET + bias)
    np.testing.assert_allclose(found.bias.at(found.degrees_above(ENDS)), mixed, atol=3e-4)
    told = pose_sentence(found, GRADES["mems"])
    assert key_of(told) == "one_pose.pose"
    typical = GRADES["mems"].accelerometer.scale_ppm_per_degc
    assert told.values["size_mg"] == pytest.approx(typical * 40e-3, rel=1e-6)
    assert key_of(gyroscope_sentence(found, GRADES["mems"], None)) == "one_pose.gyroscope"


def test_what_sessions_show_of_the_scale_is_told_where_it_has_no_curve() -> None:
    seen = sessions([25.0, 25.1, 55.0, -10.0], np.random.default_rng(7), (1e-3, 1e-6))
    # The last has no turns, and the others are at two temperatures.
    scale = np.array([[0, 0, 0], [1e-5, 0, 0], [3.6e-4, 7e-5, -1.511e-3], [np.nan] * 3])
    data = TemperatureData(reference_degc=25.0, points=replace(seen, scale=scale), ramps=[])
    assert data.highest_orders().scale == 0
    found = fit_temperature(data).temperature
    told = gyroscope_sentence(found, GRADES["mems"], data.points)
    assert key_of(told) == "one_pose.gyroscope_sessions"
    assert (told.values["low"], told.values["high"]) == (25.0, 55.0)
    assert told.values["size_ppm"] == pytest.approx(1511.0)
    # One session that shows it shows no change.
    alone = replace(seen, scale=np.where(np.arange(4)[:, None] < 1, scale, np.nan))
    assert key_of(gyroscope_sentence(found, GRADES["mems"], alone)) == "one_pose.gyroscope"
    # It counts as a difference between days.
    assert found.new_day is not None
    assert found.new_day.scale.max() > 3e-4


def test_ramps_in_opposite_poses_separate_them_without_a_session() -> None:
    rng = np.random.default_rng(4)
    found = fit_temperature(
        TemperatureData(reference_degc=20.0, ramps=[ramp(rng, 1e-4), ramp(rng, 1e-4, force=-POSE)])
    ).temperature
    assert found.scale_separated
    assert np.abs(found.scale.coefficients[0] - SCALE[0]).max() < 5e-6


def test_hysteresis_is_half_the_difference_of_the_branches() -> None:
    rng = np.random.default_rng(5)
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[ramp(rng, 1e-5, hysteresis=2e-3)])).temperature
    np.testing.assert_allclose(found.hysteresis, 2e-3, rtol=0.02)
    assert np.all(found.bias_sigma_at(ENDS) > 1.9e-3)


def test_the_noise_of_blocks_is_no_hysteresis() -> None:
    rng, sigma = np.random.default_rng(11), 1e-3
    ramps = [ramp(rng, sigma) for _ in range(20)]
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=ramps)).temperature
    # Half of the difference of two blocks has 0.71 sigma.
    assert np.all(found.hysteresis < 0.3 * sigma)
    ramps = [ramp(rng, sigma, hysteresis=sigma) for _ in range(20)]
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=ramps)).temperature
    np.testing.assert_allclose(found.hysteresis, sigma, rtol=0.1)


def test_scatter_beyond_the_stated_sigma_widens_the_uncertainty() -> None:
    rng = np.random.default_rng(6)
    honest = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[ramp(rng, 1e-3)]))
    bold = ramp(np.random.default_rng(6), 1e-3)
    scattered = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[replace(bold, sigma=bold.sigma / 10)]))
    assert honest.factor < 1.2
    assert scattered.factor == pytest.approx(10, rel=0.2)
    assert scattered.temperature.bias.order == honest.temperature.bias.order
    assert keys(fit_warnings(scattered, "accelerometer")) == ["fit.scatter"]
    assert not fit_warnings(honest, "accelerometer")


def test_a_long_ramp_does_not_dilute_what_sessions_scatter() -> None:
    """Three scales of a gyroscope that lie on no line, beside 82 blocks at rest that say nothing of them."""
    rng = np.random.default_rng(3)
    found = sessions([-18.0, 20.0, 58.0], rng, SIGMA)
    off = replace(found, scale=found.scale + 12 * SIGMA[1] * np.array([[0.0], [1.0], [0.0]]))
    at_rest = ramp(rng, 1e-4, force=np.zeros(3))
    told = [fit_temperature(TemperatureData(reference_degc=20.0, points=each, ramps=[at_rest])) for each in (found, off)]
    assert [keys(fit_warnings(each, "gyroscope")) for each in told] == [[], ["fit.scatter"]]
    # Two thirds of the square of an error in the middle are left of a line.
    assert told[1].factor == pytest.approx(12 * np.sqrt(2 / 3), abs=2.5)


def test_a_reference_far_from_what_was_measured_is_told() -> None:
    whole = ramp(np.random.default_rng(10), 1e-4)
    warm = whole.temperature_degc >= 44
    kept = replace(whole, **{name: getattr(whole, name)[warm] for name in ("temperature_degc", "output", "sigma", "direction")})
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[kept]))
    assert found.gap_degc == 24.0
    assert keys(fit_warnings(found, "accelerometer")) == ["fit.gap"]


def test_temperatures_nearer_than_half_a_degree_are_one() -> None:
    assert distinct(np.array([24.24, 24.26, 24.7, np.nan])) == 1
    assert distinct(np.array([24.24, 24.8, 20.0])) == 3


@pytest.mark.parametrize(
    ("temperatures", "orders"), [([0.0, 20.0], (0, 0)), ([0.0, 20.0, 40.0], (1, 1)), ([0, 0.1, 20, 20.1], (0, 0))]
)
def test_orders_never_exceed_distinct_temperatures_less_two(temperatures: list[float], orders: tuple[int, int]) -> None:
    points = sessions(temperatures, np.random.default_rng(7), SIGMA)
    assert TemperatureData(reference_degc=20.0, points=points).highest_orders() == orders


def test_raw_output_at_a_temperature_becomes_that_of_the_reference() -> None:
    rng = np.random.default_rng(8)
    accelerometer = AccelerometerParameters(
        scale=np.array([1.01, -0.99, 1.02]),
        bias_m_s2=rng.normal(size=3),
        misalignment_rad=1e-2 * rng.normal(size=(3, 3)) * (1 - np.eye(3)),
        quadratic=1e-4 * rng.normal(size=3),
        raw_zero=np.array([5.0, -3.0, 2.0]),
    )
    gyroscope = GyroscopeParameters(
        np.array([2.0, 2.1, -1.9]),
        np.zeros((3, 3)),
        rng.normal(size=3),
        1e-3 * rng.normal(size=(3, 3)),
        np.array([4.0, 2.0, -3.0]),
    )
    model = TriadTemperature(
        reference_degc=20.0,
        range_degc=(-20.0, 60.0),
        bias=Polynomials(rng.normal(size=(3, 3)) * [[1e-2], [1e-4], [1e-6]], np.zeros((3, 3, 3))),
        scale=Polynomials(1e-4 * rng.normal(size=(2, 3)), np.zeros((3, 2, 2))),
        hysteresis=np.full(3, np.nan),
        scale_separated=True,
    )
    force, rate = 10 * rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    for temperature_degc, same_as in ((-5.0, -5.0), (90.0, 60.0), (np.nan, 20.0)):
        at = np.full(4, temperature_degc)
        raw = predict(at_temperature(accelerometer, model, same_as), force)
        back = model.to_reference(raw, at, scale=accelerometer.scale, raw_zero=accelerometer.raw_zero)
        np.testing.assert_allclose(back, predict(accelerometer, force), atol=1e-12)
        turned = predict_gyroscope(at_temperature(gyroscope, model, same_as), rate, force)
        back = model.to_reference(turned, at, scale=gyroscope.scale, raw_zero=gyroscope.raw_zero)
        np.testing.assert_allclose(back, predict_gyroscope(gyroscope, rate, force), atol=1e-12)
    np.testing.assert_array_equal(model.is_outside(np.array([-21.0, 0.0, 61.0, np.nan])), [True, False, True, False])
    assert Polynomials(np.zeros((0, 3)), np.zeros((3, 0, 0))).at(np.zeros(2)).tolist() == [[0.0] * 3] * 2


def test_the_order_is_found_and_a_fifth_order_ramp_is_fitted_well() -> None:
    """20 blocks, the last coefficient 5 sigma: the study (docs/study.md) has the larger run of this."""
    rng, right = np.random.default_rng(9), 0
    unit = np.linspace(-1, 1, 20)
    for trial in range(60):
        order = 1 + trial % 3
        V = unit[:, None] ** np.arange(order + 1)
        last_sigma = np.sqrt(np.linalg.inv(V.T @ V)[-1, -1])
        truth = V @ np.vstack([8 * rng.normal(size=(order, 3)), 5 * last_sigma * rng.choice([-1, 1], (1, 3))])
        blocks = RampBlocks(
            temperature_degc=20 + 40 * unit,
            output=truth + rng.normal(size=truth.shape),
            sigma=np.ones_like(truth),
            direction=np.ones(20),
            specific_force_m_s2=np.zeros(3),
        )
        right += fit_temperature(TemperatureData(reference_degc=20.0, ramps=[blocks])).temperature.bias.order == order
    assert right >= 0.85 * 60
