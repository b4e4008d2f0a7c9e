from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imufield.guide.stillness.cells import CellBuilder, Cells, join_cells
from imufield.samples import Samples, SampleUnits, Status, make_samples
from tests.guide.guided import cells_of

NAMES = Cells.__dataclass_fields__


def stream(n: Any = 1000, rate_hz: float = 200.0, seed: int = 3, **extra: Any) -> Any:
    rng = np.random.default_rng(seed)
    return make_samples(
        np.arange(n) / rate_hz, rng.normal(9.8, 0.1, (n, 3)), rng.normal(0, 0.01, (n, 3)), units=SampleUnits(), **extra
    )


def pieces(samples: Samples, cuts: Any) -> Any:
    edges = [0, *sorted(cuts), len(samples)]
    return [samples[a:b] for a, b in pairwise(edges)]


def equal(first: Cells, second: Cells) -> bool:
    return all(np.array_equal(getattr(first, n), getattr(second, n), equal_nan=True) for n in NAMES)


def test_statistics_are_those_of_the_samples_in_the_slot() -> None:
    samples = stream()
    cells = join_cells(list(cells_of([samples])))
    assert len(cells) == 50
    inside = (samples.time_s >= 0.7 - 1e-9) & (samples.time_s < 0.8 - 1e-9)
    values = np.hstack([samples.accelerometer, samples.gyroscope])[inside]
    assert cells.slot[7] == 7
    assert cells.count[7] == inside.sum() == 20
    np.testing.assert_allclose(cells.mean[7], values.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(cells.variance[7], values.var(axis=0, ddof=1), rtol=1e-12)
    np.testing.assert_array_equal(cells.low[7], values.min(axis=0))
    np.testing.assert_array_equal(cells.high[7], values.max(axis=0))
    assert (cells.start_s[7], cells.end_s[7]) == (samples.time_s[inside][0], samples.time_s[inside][-1])


@settings(max_examples=60, deadline=None)
@given(st.sets(st.integers(0, 400), max_size=40))
def test_cells_do_not_depend_on_the_cuts(cuts: Any) -> None:
    samples = stream(400)
    assert equal(join_cells(list(cells_of(pieces(samples, cuts)))), join_cells(list(cells_of([samples]))))


def test_cells_do_not_depend_on_the_cuts_with_bad_samples() -> None:
    status = np.zeros(1000, dtype=np.uint32)
    status[100:130] = Status.ACCELEROMETER_SATURATED
    samples = stream(status=status)
    samples.accelerometer[300] = np.nan
    samples.gyroscope[500:510] = np.nan
    whole = join_cells(list(cells_of([samples])))
    for seed in range(5):
        cuts = np.random.default_rng(seed).integers(0, 1000, 60)
        assert equal(join_cells(list(cells_of(pieces(samples, cuts.tolist())))), whole)
    assert whole.usable[5:7].tolist() == [0, 10]
    assert np.isnan(whole.mean[5]).all()
    assert whole.flags[5] == Status.ACCELEROMETER_SATURATED
    assert whole.usable[15] == 19
    assert (whole.usable[25], whole.gyroscope_usable[25]) == (20, 10)
    good = samples[510:520]
    np.testing.assert_allclose(whole.mean[25, 3:], good.gyroscope.mean(axis=0), rtol=1e-12)


def test_a_cell_waits_until_the_next_slot_begins() -> None:
    builder = CellBuilder()
    samples = stream(40)
    assert builder.feed(samples[:10]) is None
    assert builder.feed(samples[10:20]) is None
    cells = builder.feed(samples[20:21])
    assert cells is not None
    assert cells.count.tolist() == [20]
    assert builder.flush().count.tolist() == [1]
    assert builder.flush() is None
    assert builder.feed(samples[:0]) is None


def test_tiny_variance_on_a_large_mean_survives() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 1e-8, (2000, 3))
    samples = make_samples(np.arange(2000) / 2000, 9.80665 + noise, noise, units=SampleUnits())
    cells = join_cells(list(cells_of([samples])))
    assert np.sqrt(cells.variance[:, 0].mean()) == pytest.approx(1e-8, rel=0.05)


def test_smallest_step_bounds_the_resolution() -> None:
    rng = np.random.default_rng(0)
    values = np.round(rng.normal(500, 0.8, (2000, 3))) * 4.0
    samples = make_samples(np.arange(2000) / 200, values, units=SampleUnits(accelerometer="count", gyroscope="count"))
    cells = join_cells(list(cells_of([samples])))
    assert cells.step[:, :3].min() == 4.0
    assert np.isinf(cells.step[:, 3:]).all()


def test_increments_become_rates() -> None:
    units = SampleUnits(
        accelerometer="m/s", gyroscope="rad", accelerometer_is_increment=True, gyroscope_is_increment=True, interval_s=0.005
    )
    samples = make_samples(np.arange(40) / 200, np.full((40, 3), 0.049), np.full((40, 3), 0.001), units=units)
    cells = join_cells(list(cells_of([samples])))
    np.testing.assert_allclose(cells.mean, np.repeat([[9.8, 9.8, 9.8, 0.2, 0.2, 0.2]], 2, axis=0))


def test_a_clock_that_jumps_back_begins_a_new_cell() -> None:
    samples = make_samples(np.array([0.0, 0.05, 0.1, 0.0, 0.05]), np.ones((5, 3)), units=SampleUnits())
    cells = join_cells(list(cells_of([samples])))
    assert cells.slot.tolist() == [0, 1, 0]
