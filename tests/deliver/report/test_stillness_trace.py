"""The trace of stillness: cells of a stream, and pauses in it."""

from __future__ import annotations

import numpy as np

from imufield.deliver.report.stillness_trace import CELL_S, TraceCollector
from imufield.samples import SampleUnits, make_samples


def test_a_pause_of_years_is_one_empty_cell_and_others_are_the_means_of_their_samples() -> None:
    time_s = np.concatenate([np.arange(100), 1.7e11 + np.arange(100)]) / 100
    force = np.random.default_rng(1).normal([0.0, 0.0, 9.8], 0.01, (len(time_s), 3))
    samples, collector = make_samples(time_s, force, np.zeros_like(force), units=SampleUnits()), TraceCollector()
    for begin in range(0, 200, 30):
        collector.feed(samples[begin : begin + 30])
    cells = collector.finish()
    # The last cell may still get samples.
    np.testing.assert_allclose(np.diff(cells.time_s), [CELL_S, 1.7e9 - 2 * CELL_S, CELL_S], rtol=1e-9)
    assert np.isnan(cells.accelerometer).all(axis=1).tolist() == [False, False, True, False]
    for cell, rows in ((0, slice(0, 50)), (1, slice(50, 100)), (3, slice(100, 150))):
        np.testing.assert_allclose(cells.accelerometer[cell], samples.accelerometer[rows].mean(axis=0), atol=1e-12)
        expected = np.cov(samples.accelerometer[rows].T, bias=True)
        np.testing.assert_allclose(cells.covariance[cell], expected[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], atol=1e-12)
