"""Means over windows, of samples with flags."""

from __future__ import annotations

import numpy as np

from imufield.pipeline.windows import WindowSums
from imufield.samples import SampleUnits, Status, make_samples


def test_flags_of_one_triad_do_not_keep_a_sample_out_of_the_other() -> None:
    values = np.arange(4.0)[:, None] * np.ones(3)
    status = [Status.GOOD, Status.ACCELEROMETER_INVALID, Status.GYROSCOPE_SATURATED, Status.INSTRUMENT_FAULT]
    samples = make_samples(
        units=SampleUnits(),
        time_s=np.arange(4.0),
        accelerometer=values,
        gyroscope=10 * values,
        temperature_degc=20.0 + np.arange(4.0),
        status=np.array(status, dtype=np.uint32),
    )
    windows = WindowSums()
    windows.feed(samples)
    means = windows.means()
    np.testing.assert_allclose([means.time_s, means.temperature_degc], [[1.0], [21.0]])
    np.testing.assert_allclose(means.accelerometer, [[1.0, 1.0, 1.0]])
    np.testing.assert_allclose(means.gyroscope, [[5.0, 5.0, 5.0]])
