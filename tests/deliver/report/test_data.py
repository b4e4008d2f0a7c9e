"""What a report reads of the recording beside the parameter file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.deliver.report.data import with_gyroscope
from imufield.samples import SampleUnits


def test_the_gyroscope_of_a_recording_comes_with_its_unit(observations: Observations) -> None:
    """In counts nothing says the scale before, and no closing error is drawn for it."""
    m, units = len(observations), SampleUnits(accelerometer="count", gyroscope="count")
    rates = np.arange(3.0 * m).reshape(m, 3)
    read = replace(observations, gyroscope_mean_raw=rates, gyroscope_covariance_raw=np.zeros((m, 3, 3)), units=units)
    read = replace(read, gyroscope_noise_raw=np.ones((m, 3)), middle_s=np.arange(1.0 * m), middle_rad=np.ones((m, 3)))
    joined = with_gyroscope(replace(observations, units=SampleUnits()), read)
    np.testing.assert_array_equal(joined.gyroscope_mean_raw, rates)
    assert joined.units == units
    # As the calibration had them, or the picture shows other errors.
    for name in ("gyroscope_noise_raw", "middle_s", "middle_rad"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(read, name))


def test_what_the_recording_does_not_show_has_nothing_of_another_position(observations: Observations) -> None:
    m = len(observations)
    read = replace(observations, gyroscope_mean_raw=np.ones((m, 3)), gyroscope_rounding_raw=np.ones((m, 3)))
    joined = with_gyroscope(replace(observations, start_s=observations.start_s + 1e6), read)
    assert np.isnan(joined.gyroscope_mean_raw).all()
    assert not joined.gyroscope_rounding_raw.any()
