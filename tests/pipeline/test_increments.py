"""Increments about a middle of the converter: the same recording as rates gives the same parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imufield.guide.positions import scheme
from imufield.samples import Samples
from imufield.testing import Replayed
from tests.guide.conftest import Path as BodyPath

RATE_HZ = 100.0
COUNTS_PER_M_S2, COUNTS_PER_RAD_S, MIDDLE = 400.0, 4000.0, 32768.0
"""Of a rate; of an increment a hundredth, about a middle of its own."""


@pytest.fixture(scope="module")
def samples() -> Samples:
    first, *others = scheme("faces6").directions()
    path = BodyPath(RATE_HZ).hold(first, 8)
    for direction in others:
        path.turn(direction, 1.5).hold(direction, 6)
    moved: Samples = path.samples(2e-3, 5e-4)
    moved.accelerometer[:] *= [1.01, 0.99, 1.02]
    moved.accelerometer[:] += [0.3, -0.2, 0.1]
    return moved


@pytest.mark.parametrize(
    ("per_s", "zero"), [(1.0, None), (RATE_HZ, None), (RATE_HZ, str(MIDDLE))], ids=["rates", "increments", "typed"]
)
def test_the_middle_of_increments_is_that_of_one_sample(
    samples: Samples, per_s: float, zero: str | None, tmp_path: Path, imufield_replay: Callable[..., Replayed]
) -> None:
    accelerometer = samples.accelerometer * COUNTS_PER_M_S2 / per_s + MIDDLE
    lines = np.column_stack([samples.time_s, accelerometer, samples.gyroscope * COUNTS_PER_RAD_S / per_s])
    np.savetxt(tmp_path / "lines.txt", lines, delimiter=",", fmt="%.9f")
    settings = {
        "accelerometer_unit": "count",
        "gyroscope_unit": "count",
        "raw_zero": str(MIDDLE),
        "rate_hz": str(RATE_HZ),
        "increments": str(per_s > 1).lower(),
    }
    found = imufield_replay(tmp_path / "lines.txt", protocol="text", settings=settings).solve(gravity_m_s2=9.8, zero=zero)
    parameters = found.calibration.accelerometer
    # Raw rates: counts a second of increments, whose middle is that of a sample over its time.
    np.testing.assert_allclose(parameters.raw_zero, MIDDLE * per_s)
    np.testing.assert_allclose(parameters.scale, COUNTS_PER_M_S2 * np.array([1.01, 0.99, 1.02]), rtol=1e-3)
    np.testing.assert_allclose(parameters.bias_m_s2, np.array([0.3, -0.2, 0.1]) / [1.01, 0.99, 1.02], atol=5e-3)
