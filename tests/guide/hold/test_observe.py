from typing import Any

import numpy as np
import pytest

from imufield.guide.hold.observe import cell_means, correlation_factor, gather, observe, trim_stretch
from imufield.guide.stillness.cells import CellBuilder, join_cells
from imufield.guide.stillness.limits import noise_limits
from imufield.guide.stillness.noise_floor import measure_floor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import SampleUnits, make_samples
from tests.guide.guided import cells_of

pytestmark = pytest.mark.numerical


def limits_for(cells: Any) -> Any:
    return noise_limits(measure_floor(cells), RoughScale(accelerometer=1.0, gyroscope=1.0))


def cells_from(values: Any, rate_hz: float = 200.0, gyroscope: Any = None) -> Any:
    samples = make_samples(np.arange(len(values)) / rate_hz, values, gyroscope, units=SampleUnits())
    return join_cells(list(cells_of([samples])))


def first_order(rng: np.random.Generator, n: Any, correlation: Any, runs: Any) -> Any:
    """Series of unit variance with exponential autocorrelation, shape (n, runs)."""
    series = np.empty((n, runs))
    series[0] = rng.normal(size=runs)
    for i in range(1, n):
        series[i] = correlation * series[i - 1] + np.sqrt(1 - correlation**2) * rng.normal(size=runs)
    return series


def test_mean_is_the_mean_of_the_samples() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(5, 1, (2000, 3))
    samples = make_samples(np.arange(2000) / 200, values, 0.1 * values, units=SampleUnits())
    cells = CellBuilder().feed(samples)
    assert cells is not None
    mean = cell_means(cells).mean
    np.testing.assert_allclose(mean[:3], values[:1980].mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(mean[3:], 0.1 * mean[:3], rtol=1e-12)


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.995])
def test_stated_sigma_of_the_mean_is_honest(correlation: Any) -> None:
    """Error over sigma of 150 simulated holds of 10 s; the correlation times are 0, 0.05 and 1 s."""
    rng = np.random.default_rng(4)
    series = first_order(rng, 2000, correlation, 450) * 0.01
    pulls = []
    for run in range(150):
        mean, covariance, _ = cell_means(cells_from(series[:, 3 * run : 3 * run + 3]))
        pulls.append(mean[:3] / np.sqrt(np.diag(covariance)[:3]))
    rms = np.sqrt(np.mean(np.square(pulls)))
    assert 0.75 < rms < (1.15 if correlation < 0.99 else 1.7)


def test_covariance_between_axes_is_kept() -> None:
    rng = np.random.default_rng(5)
    common = rng.normal(0, 1, (4000, 1))
    cells = cells_from(common * [1.0, 1.0, -1.0] + rng.normal(0, 0.3, (4000, 3)))
    covariance = cell_means(cells).covariance
    correlation = covariance[:3, :3] / np.sqrt(np.outer(np.diag(covariance)[:3], np.diag(covariance)[:3]))
    assert correlation[0, 1] > 0.8
    assert correlation[0, 2] < -0.8
    assert np.all(np.linalg.eigvalsh(covariance[:3, :3]) > 0)


def test_correlation_factor_of_white_noise_is_about_one() -> None:
    rng = np.random.default_rng(6)
    factors = [correlation_factor(x - x.mean()) for x in rng.normal(size=(300, 100))]
    assert 1.0 <= np.mean(factors) < 1.35


def test_output_between_two_steps_keeps_its_uncertainty() -> None:
    """A silent output on a grid of 0.01 is off by 0.01 / sqrt(12), however long the hold."""
    values = np.full((2000, 3), 9.81)
    values[700] += 0.01
    covariance = cell_means(cells_from(values)).covariance
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[:3]), 0.01 / np.sqrt(12), rtol=0.1)


@pytest.mark.parametrize("rate_hz", [200.0, 10.0])
@pytest.mark.parametrize("noise_steps", [0.1, 0.2, 0.3, 0.5])
def test_noise_takes_from_the_rounding_what_it_spreads(noise_steps: float, rate_hz: float) -> None:
    """Error over sigma of 8 s at values anywhere within a step; at 10 Hz a cell has one sample."""
    rng, step, pulls = np.random.default_rng(7), 0.7, []
    for _ in range(40):
        true = 100 + rng.uniform(0, step, 3)
        values = step * np.rint(true / step + noise_steps * rng.normal(size=(int(8 * rate_hz), 3)))
        mean, covariance, rounding = cell_means(cells_from(values, rate_hz))
        # One that never changes shows no step: that comes from other holds.
        shows = np.ptp(values, axis=0) > 0
        assert np.all(rounding[:3][shows] <= step / np.sqrt(12))
        pulls += ((mean[:3] - true) / np.sqrt(np.diag(covariance)[:3]))[shows].tolist()
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.15


def test_output_that_never_changes_is_not_exact() -> None:
    covariance = cell_means(cells_from(np.full((2000, 3), 9.81))).covariance
    assert np.all(np.diag(covariance)[:3] > 0)


def test_missing_gyroscope_is_nan() -> None:
    one = observe(cells_from(np.random.default_rng(0).normal(9.8, 0.01, (2000, 3))), limits_for_noise(), "a")
    assert np.isfinite(one.covariance_raw).all()
    assert np.isnan(one.gyroscope_mean_raw).all()
    assert np.isnan(one.gyroscope_covariance_raw).all()


def limits_for_noise() -> Any:
    rng = np.random.default_rng(0)
    return limits_for(cells_from(rng.normal(9.8, 0.01, (1000, 3)), gyroscope=rng.normal(0, 1e-3, (1000, 3))))


def test_a_knock_is_left_out() -> None:
    rng = np.random.default_rng(8)
    values, turning = rng.normal(9.8, 0.01, (2400, 3)), rng.normal(0, 1e-3, (2400, 3))
    clean = cells_from(values, gyroscope=turning)
    limits = limits_for(clean)
    values = values.copy()
    values[1210:1230] += 0.5
    struck = observe(cells_from(values, gyroscope=turning), limits, "struck")
    calm = observe(clean, limits, "calm")
    sigma = np.sqrt(np.diag(calm.covariance_raw))
    assert np.all(np.abs(struck.mean_raw - calm.mean_raw) < sigma)


def test_rocking_to_rest_is_cut_off() -> None:
    rng = np.random.default_rng(9)
    values, turning = rng.normal(9.8, 0.01, (2400, 3)), rng.normal(0, 1e-3, (2400, 3))
    limits = limits_for(cells_from(values, gyroscope=turning))
    time_s = np.arange(2400) / 200
    values[:, 0] += 0.3 * np.exp(-time_s / 0.1) * np.sin(2 * np.pi * 12 * time_s)
    rows = trim_stretch(cells_from(values, gyroscope=turning), limits)
    assert 0.5 <= rows.start * 0.1 <= 0.8
    assert rows.stop == 120 - 3


def test_gather_makes_arrays_of_nothing_and_of_some() -> None:
    units = SampleUnits()
    none = gather([], units)
    assert (len(none), none.mean_raw.shape, none.covariance_raw.shape) == (0, (0, 3), (0, 3, 3))
    cells = cells_from(np.random.default_rng(0).normal(9.8, 0.01, (2000, 3)))
    one = observe(cells, limits_for_noise(), "a", np.array([0.0, 0.0, 1.0]))
    two = gather([one, one], units)
    assert two.name == ("a", "a")
    assert two.covariance_raw.shape == (2, 3, 3)
    np.testing.assert_array_equal(two.direction, [[0, 0, 1], [0, 0, 1]])
