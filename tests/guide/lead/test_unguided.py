"""Still intervals of the real recordings, against the reference in the folder beside the project."""

import gzip
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from imufield.errors import CalibrationError, Reason
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import SampleUnits, make_samples, no_samples
from tests.guide.guided import find_still_intervals
from tests.refused import refused

REFERENCE = {
    "xsens": (9.81744, [414.4455, 412.1213, 414.5082], [0.858606, 1.230565, -0.973426], [0.003579, 0.009249, 0.021334]),
    "imu0": (9.81, [1.003668, 1.002879, 1.006557], [0.1022, 0.0977, 0.3433], [0.43e-3, 5.49e-3, 2.00e-3]),
    "imu2": (9.81, [1.003965, 1.003496, 1.007804], [0.0946, 0.0071, -0.0456], [0.09e-3, 5.07e-3, 4.04e-3]),
}


def load(path: Any) -> Any:
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file)


def fit_norms(mean_raw: Any, raw_zero: Any, start: Any, gravity: Any) -> Any:
    """Unweighted least squares on the norms, lower triangular T: scale, bias, misalignment and residuals."""

    def residuals(p: Any) -> Any:
        matrix = np.eye(3)
        matrix[1, 0], matrix[2, 0], matrix[2, 1] = p[6:]
        return np.linalg.norm(np.linalg.solve(matrix, ((mean_raw - raw_zero) / p[:3] - p[3:6]).T), axis=0) - gravity

    return least_squares(residuals, start, x_scale=np.abs(start) + 1e-3, xtol=1e-15, ftol=1e-15, gtol=1e-15)


@pytest.fixture(scope="module")
def xsens(shared_folder: Any) -> Any:
    force = load(shared_folder / "data" / "imu_tk" / "xsens_acc.mat.gz")
    turning = load(shared_folder / "data" / "imu_tk" / "xsens_gyro.mat.gz")
    return make_samples(force[:, 0], force[:, 1:], turning[:, 1:], units=SampleUnits(accelerometer="count", gyroscope="count"))


def test_xsens_session(xsens: Any) -> None:
    found = find_still_intervals([xsens], scale=RoughScale(raw_zero=np.full(3, 32768.0)))
    assert 36 <= len(found.observations) <= 46
    gravity, scale, bias, misalignment = REFERENCE["xsens"]
    start = np.array([*scale, *bias, *misalignment])
    fit = fit_norms(found.observations.mean_raw, 32768, start, gravity)
    assert np.abs(fit.x[:3] / scale - 1).max() < 50e-6
    assert np.abs(fit.x[3:6] - bias).max() < 0.05 * 9.81e-3
    assert np.abs(fit.x[6:] - misalignment).max() < 0.2e-3
    assert 0.09 < 1e3 * np.sqrt(np.mean(fit.fun**2)) / 9.81 < 0.12
    assert found.axes.agrees
    assert found.axes.gyroscope_scale == pytest.approx(4770, rel=0.05)
    assert found.scale.learned


def test_xsens_session_does_not_depend_on_the_cuts(xsens: Any, cut_blocks: Any) -> None:
    scale = RoughScale(raw_zero=np.full(3, 32768.0))
    whole = find_still_intervals([xsens], scale=scale).observations
    parts = find_still_intervals(cut_blocks(xsens, [7] * 300 + [1000] * 20), scale=scale).observations
    assert parts.name == whole.name
    np.testing.assert_array_equal(parts.mean_raw, whole.mean_raw)
    np.testing.assert_array_equal(parts.covariance_raw, whole.covariance_raw)


@pytest.mark.parametrize(("name", "residual_mg"), [("imu0", 0.193), ("imu2", 0.203)])
def test_mpu_9150_session(shared_folder: Any, name: str, residual_mg: float) -> None:
    table = load(shared_folder / "data" / "mikoff" / f"{name}.log.gz")
    samples = make_samples(np.arange(len(table)) / 100, table[:, :3], table[:, 3:], units=SampleUnits())
    found = find_still_intervals([samples])
    assert 17 <= len(found.observations) <= 23
    gravity, scale, bias, misalignment = REFERENCE[name]
    fit = fit_norms(found.observations.mean_raw, 0, np.array([*scale, *bias, *misalignment]), gravity)
    # The reference moves by so much when the settings of its own detector are swept.
    assert np.abs(fit.x[:3] - scale).max() < 2.9e-4
    assert np.abs(fit.x[3:6] - bias).max() < 1.9e-3
    assert np.abs(fit.x[6:] - misalignment).max() < 5.1e-4
    assert 1e3 * np.sqrt(np.mean(fit.fun**2)) / 9.80665 == pytest.approx(residual_mg, rel=0.1)
    assert found.axes.agrees


def test_observations_are_named_after_the_nearest_side(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 5).turn([1, 0.1, 0], 1).hold([1, 0.1, 0], 4).samples()
    found = find_still_intervals([samples]).observations
    assert found.name == ("free 1: near +z", "free 2: near +x")
    assert np.isnan(found.direction).all()


def test_a_recording_without_a_quiet_stretch_is_refused(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 8).samples()
    samples.accelerometer[:] += np.random.default_rng(0).normal(0, 2, samples.accelerometer.shape)
    with refused(CalibrationError, Reason.TOO_FEW, "3 s", "m/s^2", key="unguided.never_quiet"):
        find_still_intervals([samples])


def test_an_empty_recording_is_refused() -> None:
    with refused(CalibrationError, Reason.TOO_FEW, "3 s", "m/s^2", key="unguided.never_quiet"):
        find_still_intervals([no_samples(SampleUnits())])
