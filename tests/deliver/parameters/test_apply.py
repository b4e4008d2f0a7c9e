from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    QuadraticAxes,
)
from imufield.deliver.parameters.apply import correct_accelerometer, correct_both, correct_gyroscope
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.parameters.schema import first_fault
from imufield.errors import CalibrationError, ParameterFileError, Reason
from imufield.samples import SampleUnits, make_samples
from tests.refused import refused

pytestmark = pytest.mark.numerical

RNG = np.random.default_rng(11)
FORCE = RNG.uniform(-20, 20, (50, 3))
RATE = RNG.uniform(-3, 3, (50, 3))
FULL_GYROSCOPE = GyroscopeParameters(
    scale=np.array([4777.9, 4769.6, -4773.3]),
    misalignment_rad=np.array([[0, -0.0097, -0.0106], [-0.0056, 0, 0.0322], [-0.0162, 0.0241, 0]]),
    bias=np.array([12.0, -3.5, 7.25]),
    g_sensitivity=np.array([[0.104, 0.293, 0.645], [-1.305, 0.029, 0.818], [-0.697, -0.807, 0.215]]),
    raw_zero=np.array([2048.0, 2040.0, 2050.0]),
)


def raw_accelerometer(p: AccelerometerParameters, force: np.ndarray) -> np.ndarray:
    """Write the measurement equation out axis by axis: the second route."""
    raw = np.empty_like(force)
    for i in range(3):
        s = force[:, i] + sum(p.misalignment_rad[i, j] * force[:, j] for j in range(3))
        squared = s**2 if p.quadratic_axes == "sensing" else force[:, i] ** 2
        raw[:, i] = p.raw_zero[i] + p.scale[i] * (s + p.bias_m_s2[i]) + p.quadratic[i] * squared
    return raw


def raw_gyroscope(p: GyroscopeParameters, rate: np.ndarray, force: np.ndarray) -> np.ndarray:
    turned = rate @ (np.eye(3) + p.misalignment_rad).T
    return p.raw_zero + p.scale * turned + p.bias + force @ p.g_sensitivity.T


@pytest.mark.parametrize("axes", ["sensing", "body"])
@pytest.mark.parametrize("linear", [True, False])
def test_undoes_the_measurement_equation(parameters: AccelerometerParameters, axes: QuadraticAxes, linear: bool) -> None:
    zero = np.array([32768.0, 32760.0, 32770.0])
    p = replace(parameters, raw_zero=zero, quadratic_axes=axes, quadratic=parameters.quadratic * (not linear))
    np.testing.assert_allclose(correct_accelerometer(p, raw_accelerometer(p, FORCE)), FORCE, rtol=0, atol=1e-10)


def test_undoes_the_gyroscope_equation() -> None:
    raw = raw_gyroscope(FULL_GYROSCOPE, RATE, FORCE)
    np.testing.assert_allclose(correct_gyroscope(FULL_GYROSCOPE, raw, FORCE), RATE, rtol=0, atol=1e-12)
    without_g = replace(FULL_GYROSCOPE, g_sensitivity=np.zeros((3, 3)))
    raw = raw_gyroscope(without_g, RATE, 0 * FORCE)
    np.testing.assert_allclose(correct_gyroscope(without_g, raw), RATE, rtol=0, atol=1e-12)


def test_g_sensitivity_asks_for_the_specific_force() -> None:
    with refused(ParameterFileError, Reason.USAGE, "g-sensitivity", key="apply.no_force"):
        correct_gyroscope(FULL_GYROSCOPE, RATE)


def test_nan_stays_in_its_sample(parameters: AccelerometerParameters) -> None:
    raw = raw_accelerometer(parameters, FORCE)
    raw[7] = np.nan
    corrected = correct_accelerometer(parameters, raw)
    assert np.flatnonzero(np.isnan(corrected).any(axis=1)).tolist() == [7]


def test_beyond_the_turning_point_is_an_error(parameters: AccelerometerParameters) -> None:
    steep = replace(parameters, quadratic=np.array([-0.1, 0, 0]))
    with refused(CalibrationError, Reason.BOUNDS) as caught:
        correct_accelerometer(steep, np.array([[30.0, 0, 0]]))
    assert caught.value.values["axis"] == "x"
    assert caught.value.values["raw"] == 30


@pytest.fixture
def made(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    full = GyroscopeCalibration(parameters=FULL_GYROSCOPE, sigma=FULL_GYROSCOPE, path="from moves", raw_unit="count")
    full = replace(full, sigma=GyroscopeParameters(np.ones(3), np.ones((3, 3)), np.ones(3), np.ones((3, 3))))
    return from_document(to_document(replace(calibration, gyroscope=full), observations, context))


def test_samples_and_arrays_give_the_same(made: Parameters) -> None:
    p = made.calibration.accelerometer
    accelerometer, gyroscope = raw_accelerometer(p, FORCE), raw_gyroscope(FULL_GYROSCOPE, RATE, FORCE)
    time_s = np.arange(50) / 100
    samples = make_samples(time_s, accelerometer, gyroscope, units=SampleUnits(gyroscope="count"))
    corrected = made.apply(samples)
    np.testing.assert_allclose(corrected.specific_force_m_s2, FORCE, atol=1e-10)
    np.testing.assert_allclose(corrected.angular_rate_rad_s, RATE, atol=1e-10)
    np.testing.assert_array_equal(corrected.time_s, time_s)
    both = made.apply(np.hstack([accelerometer, gyroscope]))
    np.testing.assert_array_equal(both, np.hstack(corrected[1:]))
    np.testing.assert_array_equal(made.apply(accelerometer[0]), corrected.specific_force_m_s2[0])


def test_increments_are_divided_by_their_interval(made: Parameters) -> None:
    accelerometer = raw_accelerometer(made.calibration.accelerometer, FORCE)
    units = SampleUnits(
        accelerometer="m/s", gyroscope="count", accelerometer_is_increment=True, interval_s=0.005
    )  # gyroscope: rates
    samples = make_samples(np.arange(50) / 200, accelerometer * 0.005, 0 * RATE, units=units)
    np.testing.assert_allclose(made.apply(samples).specific_force_m_s2, FORCE, atol=1e-10)


def test_other_units_and_shapes_are_refused(made: Parameters) -> None:
    samples = make_samples(np.arange(50) / 200, FORCE, RATE, units=SampleUnits(accelerometer="g", gyroscope="count"))
    with refused(ParameterFileError, Reason.UNITS, "accelerometer", key="file.unit") as caught:
        made.apply(samples)
    assert caught.value.values["wanted"] == "m/s^2"
    assert caught.value.values["unit"] == "g"
    assert caught.value.reason is Reason.UNITS
    with refused(ParameterFileError, Reason.USAGE, "(50, 4)", key="apply.columns"):
        made.apply(np.zeros((50, 4)))


def test_samples_without_a_gyroscope_are_in_no_unit_of_it(made: Parameters) -> None:
    accelerometer = raw_accelerometer(made.calibration.accelerometer, FORCE)
    units = SampleUnits(accelerometer="m/s^2", gyroscope="deg/s")
    found = made.apply(make_samples(np.arange(50) / 200, accelerometer, np.full((50, 3), np.nan), units=units))
    np.testing.assert_allclose(found.specific_force_m_s2, FORCE, atol=1e-10)
    assert np.isnan(found.angular_rate_rad_s).all()
    with refused(ParameterFileError, Reason.UNITS, "gyroscope", key="file.unit"):
        made.apply(make_samples(np.arange(50) / 200, accelerometer, RATE, units=units))


def test_without_gyroscope(made: Parameters, six_faces: Calibration) -> None:
    bare = replace(made, calibration=six_faces)
    samples = make_samples(np.arange(50) / 200, FORCE, RATE, units=SampleUnits())
    assert np.isnan(bare.apply(samples).angular_rate_rad_s).all()
    with refused(ParameterFileError, Reason.UNITS, "gyroscope", key="file.no_gyroscope"):
        bare.apply_gyroscope(RATE)


def test_gyroscope_scale_not_known(made: Parameters, observations: Observations, context: Context) -> None:
    gyroscope = made.calibration.gyroscope
    assert gyroscope is not None
    unknown = replace(gyroscope, parameters=replace(gyroscope.parameters, scale=np.full(3, np.nan)))
    document = to_document(replace(made.calibration, gyroscope=unknown), observations, context)
    assert first_fault(document) is None
    bare = from_document(document)
    with refused(ParameterFileError, Reason.UNITS, "gyroscope", key="file.no_scale"):
        bare.apply_gyroscope(RATE)
    samples = make_samples(np.arange(50) / 200, FORCE, RATE, units=SampleUnits(gyroscope="count"))
    assert np.isnan(bare.apply(samples).angular_rate_rad_s).all()


def test_six_columns_of_any_length_and_shape_equal_three_and_three(
    calibration: Calibration, observations: Observations, context: Context
) -> None:
    """More rows than one piece, and a NaN in one triad stays in that triad."""
    assert calibration.gyroscope is not None
    gyroscope = replace(calibration.gyroscope, parameters=replace(FULL_GYROSCOPE, g_sensitivity=np.zeros((3, 3))))
    loaded = from_document(to_document(replace(calibration, gyroscope=gyroscope), observations, context))
    raw = RNG.uniform(-20, 20, (2, 5000, 6))
    raw[0, 3, 1], raw[1, 4, 5] = np.nan, np.nan
    corrected = loaded.apply(raw)
    force = loaded.apply_accelerometer(np.ascontiguousarray(raw[..., :3]))
    np.testing.assert_array_equal(corrected[..., :3], force)
    np.testing.assert_array_equal(corrected[..., 3:], loaded.apply_gyroscope(np.ascontiguousarray(raw[..., 3:]), force))
    assert np.isfinite(corrected[0, 3, 3:]).all()
    assert np.isfinite(corrected[1, 4, :3]).all()
    assert loaded.apply(raw[0, 0]).shape == (6,)
    assert loaded.apply(raw[:0]).shape == (0, 5000, 6)


def test_six_columns_of_a_linear_model_are_one_map() -> None:
    accelerometer = AccelerometerParameters(
        scale=np.array([1.01, 0.98, -1.0]), bias_m_s2=np.array([0.1, -0.2, 0.3]), misalignment_rad=2e-3 * (1 - np.eye(3))
    )
    raw = RNG.uniform(-20, 20, (5000, 6))
    raw[3, 1], raw[4, 5], raw[5, 4] = np.nan, np.nan, np.inf
    force = correct_accelerometer(accelerometer, raw[:, :3])
    rate = correct_gyroscope(FULL_GYROSCOPE, raw[:, 3:], force)
    assert np.isfinite(force[4:6]).all()
    np.testing.assert_allclose(
        correct_both(accelerometer, FULL_GYROSCOPE, raw), np.hstack([force, rate]), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("columns", [(0,), (4,), (1, 2), (0, 3, 5)], ids=str)
def test_infinite_outputs_warn_on_no_processor(columns: tuple[int, ...]) -> None:
    """What comes of them is not finite, the other rows are what they are, and no kernel says "invalid value"."""
    accelerometer = AccelerometerParameters(scale=np.ones(3), bias_m_s2=np.zeros(3), misalignment_rad=2e-3 * (1 - np.eye(3)))
    raw = RNG.uniform(-20, 20, (9, 6))
    clean = correct_both(accelerometer, FULL_GYROSCOPE, raw)
    raw[3, columns] = [np.inf, -np.inf, np.inf][: len(columns)]
    raw[5, columns] = [np.inf, np.inf, -np.inf][: len(columns)]
    corrected = correct_both(accelerometer, FULL_GYROSCOPE, raw)
    assert not np.isfinite(corrected[[3, 5]][:, columns]).any()
    np.testing.assert_allclose(np.delete(corrected, [3, 5], axis=0), np.delete(clean, [3, 5], axis=0), rtol=1e-12)
