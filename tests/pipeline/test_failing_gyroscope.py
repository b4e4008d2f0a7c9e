"""A gyroscope that changes in mid-session: the accelerometer is calibrated, and the verdict says what is contradictory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imufield.guide.positions import scheme
from imufield.testing import Replayed
from tests.guide.conftest import Path as BodyPath
from tests.told import keys


@pytest.mark.parametrize(
    ("what", "verdict"), [("sound", "good"), ("scale twice as large", "usable"), ("z constant", "usable"), ("dead", "usable")]
)
def test_moves_that_contradict_each_other_lower_the_verdict(
    what: str, verdict: str, tmp_path: Path, imufield_replay: Callable[..., Replayed]
) -> None:
    first, *others = scheme("paper24").directions()
    path = BodyPath(100.0).hold(first, 8)
    for direction in others:
        path.turn(direction, 1.5).hold(direction, 4)
    samples = path.samples(2e-3, 5e-4)
    if what == "scale twice as large":
        samples.gyroscope[len(samples) // 2 :] *= 2
    elif what == "z constant":
        samples.gyroscope[:, 2] = 0.01
    elif what == "dead":
        samples.gyroscope[:] = 0
    lines = np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope])
    np.savetxt(tmp_path / "lines.txt", lines, delimiter=",", fmt="%.9f")
    # Not 9.8, which textbooks print for every place.
    quality = imufield_replay(tmp_path / "lines.txt", protocol="text").solve(gravity_m_s2=9.8001).calibration.quality
    assert quality.verdict == verdict
    assert keys(quality.warnings) == ([] if verdict == "good" else ["calibration.no_gyroscope"])
