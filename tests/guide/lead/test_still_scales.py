"""Scales by the stills of a recording: as few of them as tell, and as many as are needed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from imufield.guide.lead.still_scales import find_scales
from imufield.samples import FloatArray, Samples
from imufield.simulate.truth.grades import draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu

HABITS = OperatorSettings(hold_s=3.0, initial_still_s=5.0, turn_s=(2.0, 3.0), peak_rate_rad_s=np.radians(60))
RATE_HZ = 50.0
BLOCK = 250
FEW = np.random.default_rng(5).standard_normal((26, 3))


def recorded(ups: FloatArray) -> Iterator[Samples]:
    source = VirtualImu(
        Imu(draw_truth(find_grade("mems"), np.random.default_rng(3)), 3, ImuSettings(rate_hz=RATE_HZ)), Operator(ups, 3, HABITS)
    )
    for _ in range(int((len(ups) * 6.5 + 10) * RATE_HZ / BLOCK)):
        yield source.next_block(BLOCK)


@pytest.mark.parametrize(
    ("ups", "least", "most"),
    [
        pytest.param(FEW, 12, 14, id="the first that tell"),
        # The centre of a sphere lies anywhere on a plane between two points of it.
        pytest.param(np.concatenate([np.tile([[0.0, 0, 1], [0, 0, -1]], (7, 1)), FEW]), 24, 40, id="two poses first"),
        pytest.param(FEW[:9], 9, 9, id="fewer than that"),
    ],
)
def test_stills_are_used_until_they_tell_both_scales(ups: FloatArray, least: int, most: int) -> None:
    found = find_scales(recorded(ups), np.zeros(3))
    assert found.scales == pytest.approx({"accelerometer": 1.0, "gyroscope": 1.0}, rel=0.03)
    assert least <= found.stills <= most


def test_every_block_is_taken() -> None:
    """What decodes a recording counts its frames to the end."""
    blocks = recorded(FEW)
    find_scales(blocks, np.zeros(3))
    assert next(blocks, None) is None
