"""The median, beside that of NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.lean.median import median


@pytest.mark.parametrize("count", [1, 2, 3, 8, 501])
@pytest.mark.parametrize("axis", [None, 0, 1, -1])
def test_it_is_that_of_numpy(count: int, axis: int | None) -> None:
    values = np.random.default_rng(1).normal(size=(count, 4))
    assert np.array_equal(median(values, axis), np.median(values, axis=axis))
    values[0, 2] = np.nan
    assert np.array_equal(median(values, axis), np.median(values, axis=axis), equal_nan=True)


def test_of_counts_and_of_infinity() -> None:
    assert median([3, 1, 2, 2]) == 2
    assert median(np.array([1, 4], dtype=np.int64)) == 2.5
    assert median([np.inf, -np.inf, 1.0]) == 1
