"""The gyroscope's fit on real recordings, against the references in the folder beside the project."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gyroscope_sessions import collect_moves, fit_turns_only

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput, make_data
from imufield.calibrate.gyroscope.move_integration import rough_inverse
from imufield.calibrate.gyroscope.residuals import evaluate
from imufield.earth import Gravity
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples, SampleUnits, make_samples
from imufield.sentences import Sentences
from tests.guide.guided import find_still_intervals

sentence = Sentences("imufield.calibrate.gyroscope")


def real_session(samples: Samples, zero: float, gravity: float) -> GyroscopeInput:
    found = find_still_intervals(
        [samples], scale=replace(RoughScale.of_units(samples.units), raw_zero=np.full(3, zero))
    ).observations
    calibration = calibrate_accelerometer(
        found, Gravity(gravity_m_s2=gravity, sigma_m_s2=1e-5, source="typed"), raw_zero=zero, model="linear"
    )
    return GyroscopeInput(
        observations=found, moves=collect_moves([samples], found.start_s, found.duration_s), calibration=calibration
    )


@pytest.fixture(scope="module")
def xsens(shared_folder: Path) -> Samples:
    a = np.loadtxt(shared_folder / "data" / "imu_tk" / "xsens_acc.mat.gz")
    g = np.loadtxt(shared_folder / "data" / "imu_tk" / "xsens_gyro.mat.gz")
    return make_samples(a[:, 0], a[:, 1:], g[:, 1:], units=SampleUnits(accelerometer="count", gyroscope="count"))


@pytest.fixture(scope="module")
def xsens_given(xsens: Samples) -> GyroscopeInput:
    return real_session(xsens, 32768.0, 9.81744)


def test_xsens_on_the_reference_model(xsens: Samples, xsens_given: GyroscopeInput) -> None:
    given = xsens_given
    first = xsens.gyroscope[xsens.time_s < 50].mean(axis=0)
    still = replace(given.observations, gyroscope_mean_raw=np.tile(first, (len(given.observations), 1)))
    data = make_data(replace(given, observations=still))
    p = np.zeros(data.parameters)
    p[:9] = rough_inverse(data.moves).ravel()
    p = fit_turns_only(data, p)
    M = np.linalg.inv(p[:9].reshape(3, 3))
    assert np.linalg.norm(M, axis=1) == pytest.approx([4778.42, 4772.14, 4775.28], rel=1e-3)
    reference = np.array([[0, -0.009676, -0.010574], [-0.005567, 0, 0.032153], [-0.016155, 0.024104, 0]])
    assert M / np.diag(M)[:, None] - np.eye(3) == pytest.approx(reference, abs=2e-3)
    errors = np.degrees(evaluate(p, data).angle_error_rad(data.up[data.moves.after]))
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.512, abs=0.02)


def test_xsens_with_g_sensitivity(xsens_given: GyroscopeInput) -> None:
    result = calibrate_gyroscope(xsens_given)
    assert sentence("result.g_sensitivity") in result.calibration.path
    assert result.moves.rms_after_deg <= 0.15
    G = np.array([[0.104, 0.293, 0.645], [-1.305, 0.029, 0.818], [-0.697, -0.807, 0.215]])
    assert result.calibration.parameters.g_sensitivity == pytest.approx(G, abs=0.1)
    assert result.calibration.raw_unit == "count"


@pytest.mark.parametrize("name", ["imu0", "imu2"])
def test_mpu_9150(shared_folder: Path, name: str) -> None:
    rows = np.loadtxt(shared_folder / "data" / "mikoff" / f"{name}.log.gz")
    samples = make_samples(np.arange(len(rows)) / 100, rows[:, :3], rows[:, 3:6], units=SampleUnits())
    assert calibrate_gyroscope(real_session(samples, 0.0, 9.81)).moves.rms_after_deg <= 0.15
