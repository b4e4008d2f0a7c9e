"""Mechanisation against one direct run of python-ins, and its state against known errors."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from at_rest import LATITUDE_DEG, MICRO_G, inputs, random_attitude, recording

from imufield.deliver.navigation import mechanise
from imufield.deliver.navigation.drift import NAUTICAL_MILE_M, Drift
from imufield.deliver.navigation.mechanise import Mechanisation, load_pyins
from imufield.errors import Reason, UsageError
from imufield.samples import FloatArray, Samples
from tests.refused import refused

pytestmark = pytest.mark.numerical

EQUATOR_RADIUS_M = 6378137.0


def direct(samples: Samples, attitude: FloatArray) -> Any:
    """One run of python-ins in the instrument's own axes."""
    pyins = load_pyins()
    columns = [*pyins.util.GYRO_COLS, *pyins.util.ACCEL_COLS]
    values = np.hstack([samples.gyroscope, samples.accelerometer])
    imu = pyins.pandas.DataFrame(values, index=samples.time_s, columns=columns)
    increments = pyins.strapdown.compute_increments_from_imu(imu, "rate")
    start = [LATITUDE_DEG, 0.0, 0.0, 0.0, 0.0, 0.0, *pyins.transform.mat_to_rph(attitude)]
    state = pyins.pandas.Series(start, index=pyins.util.TRAJECTORY_COLS, name=0.0)
    return pyins.strapdown.Integrator(state, with_altitude=False).integrate(increments)


@pytest.mark.filterwarnings("ignore:The copy keyword:DeprecationWarning")
def test_equals_a_direct_run_to_a_millimetre() -> None:
    attitude = random_attitude(1)
    samples = recording(attitude, 3600, 20.0, force=(50 * MICRO_G, 0, 20 * MICRO_G), rate=(0, 3e-8, 0), noise=1.0)
    run = Mechanisation(attitude, 0.0, LATITUDE_DEG, 0.0)
    for first in range(0, len(samples), 777):
        block = samples[first : first + 777]
        run.feed(block.time_s, block.accelerometer, block.gyroscope)
    run.finish()
    trajectory = direct(samples, attitude)
    rows = np.searchsorted(trajectory.index.to_numpy(), run.drift.time_s)
    latitude = np.abs(trajectory.lat.to_numpy()[rows] - LATITUDE_DEG - run.drift.latitude_deg).max()
    longitude = np.abs(trajectory.lon.to_numpy()[rows] - run.drift.longitude_deg).max()
    assert EQUATOR_RADIUS_M * np.radians(max(latitude, longitude)) < 1e-3
    assert run.drift.position_nmi.max() > 0.05


def test_cutting_into_blocks_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    attitude = random_attitude(2)
    samples = recording(attitude, 600, 10.0, rate=(1e-7, 0, 0))
    drifts = []
    for piece, size in ((16384, len(samples)), (500, 33)):
        monkeypatch.setattr(mechanise, "PIECE", piece)
        run = Mechanisation(attitude, 0.0, LATITUDE_DEG, 0.0)
        for first in range(0, len(samples), size):
            block = samples[first : first + size]
            run.feed(block.time_s, block.accelerometer, block.gyroscope)
        run.finish()
        drifts.append(run.drift)
    np.testing.assert_array_equal(drifts[0].time_s, drifts[1].time_s)
    np.testing.assert_allclose(drifts[0].position_nmi, drifts[1].position_nmi, rtol=0, atol=1e-9)


def test_exact_data_stay_where_they_are() -> None:
    attitude = random_attitude(3)
    f, w = inputs(attitude)
    run = Mechanisation(attitude, 0.0, LATITUDE_DEG, 0.0)
    time_s = np.arange(0, 3600.0)
    run.feed(time_s, np.tile(f, (len(time_s), 1)), np.tile(w, (len(time_s), 1)))
    run.finish()
    assert run.drift.position_nmi.max() < 2e-5  # steps of a second cost a centimetre or two
    np.testing.assert_allclose(run.attitudes[-1], attitude, atol=1e-9)


def test_position_error_is_equation_23() -> None:
    drift = Drift(
        time_s=np.array([0.0, 3600.0]),
        latitude_deg=np.array([0, 0.03]),
        longitude_deg=np.array([0, 0.08]),
        north_velocity_m_s=np.zeros(2),
        east_velocity_m_s=np.zeros(2),
        true_latitude_deg=60.0,
    )
    # 0.03 deg north and 0.08 deg x cos 60 = 0.04 deg east make 0.05 deg.
    assert drift.position_nmi[-1] == pytest.approx(np.radians(0.05) * 6371000 / NAUTICAL_MILE_M, rel=1e-12)
    assert drift.rate_nmi_per_h == pytest.approx(drift.position_nmi[-1])


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    load_pyins.cache_clear()
    monkeypatch.setitem(sys.modules, "pyins.strapdown", None)
    with refused(UsageError, Reason.MISSING_PACKAGE, "pip install '.[nav]", key="errors.missing_package") as caught:
        load_pyins()
    assert caught.value.values["package"] == "python-ins"
    assert caught.value.reason is Reason.MISSING_PACKAGE
    load_pyins.cache_clear()
