import numpy as np
import pytest

from imufield.guide.hold.checks import HoldUnderTest, change_over, examine, largest_step
from imufield.guide.stillness.cells import join_cells
from imufield.guide.stillness.limits import noise_limits
from imufield.guide.stillness.noise_floor import measure_floor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import NO_COUNTER, Samples, SampleUnits
from tests.guide.guided import cells_of


def test_change_over_a_line_is_the_change_and_its_sigma_is_honest() -> None:
    rng = np.random.default_rng(0)
    pulls = []
    for _ in range(300):
        change, sigma = change_over(np.linspace(0, [3.0, -1.0], 100) + rng.normal(0, 0.5, (100, 2)))
        pulls.append((change - [3.0, -1.0]) / sigma)
    assert np.sqrt(np.mean(np.square(pulls), axis=0)) == pytest.approx([1.0, 1.0], abs=0.15)
    assert change_over(np.ones((3, 1))).tolist() == [[0.0], [np.inf]]


def test_largest_step_finds_where_and_how_far() -> None:
    rng = np.random.default_rng(1)
    series = rng.normal(0, 0.1, (100, 3))
    series[63:] += [0.5, 0, -0.2]
    step, sigma, row = largest_step(series)
    assert abs(row - 63) <= 1
    np.testing.assert_allclose(step, [0.5, 0, -0.2], atol=0.08)
    assert 0.03 < sigma < 0.06


def test_noise_alone_has_no_step_of_six_sigma() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        step, sigma, _ = largest_step(rng.normal(0, 0.1, (100, 3)))
        assert np.linalg.norm(step) < 6 * sigma
    assert largest_step(np.ones((6, 3)))[1] == np.inf


@pytest.mark.statistical
def test_no_hold_is_refused_for_its_noise() -> None:
    """2000 holds of 4 s of a cheap chip, 0.08 m/s^2 at 50 Hz: of 4 sigma one in 1500 has a drift beyond the limit."""
    rng, scale, rows = np.random.default_rng(5), RoughScale(accelerometer=1.0, gyroscope=1.0), 2000 * 200
    samples = Samples(
        time_s=np.arange(rows) / 50.0,
        accelerometer=np.array([0.0, 0.0, 9.8]) + 0.08 * rng.standard_normal((rows, 3)),
        gyroscope=1e-3 * rng.standard_normal((rows, 3)),
        temperature_degc=np.full(rows, 25.0),
        counter=np.full(rows, NO_COUNTER),
        status=np.zeros(rows, dtype=np.uint32),
        units=SampleUnits(),
    )
    cells = join_cells(list(cells_of([samples])))
    floor = measure_floor(cells[:100])
    limits = noise_limits(floor, scale)
    size = len(cells) // 2000
    holds = [cells[k * size + 2 : (k + 1) * size - 2] for k in range(2000)]
    assert [examine(HoldUnderTest(cells=hold, floor=floor, limits=limits, scale=scale)) for hold in holds] == [None] * 2000
