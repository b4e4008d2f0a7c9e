"""What the verdict asks for can be done: few positions do not show which of them is wrong."""

from __future__ import annotations

import math

import pytest

from imufield.calibrate.accelerometer.quality import POOR_RESIDUAL_M_S2, poor_sentences
from imufield.calibrate.model.uncertainty import SPARE_POSITIONS
from tests.told import told


@pytest.mark.parametrize("spare", range(1, 2 * SPARE_POSITIONS))
def test_positions_that_disagree_are_to_be_repeated_where_they_are_known(spare: int) -> None:
    (reason,) = poor_sentences(None, spare, 2 * POOR_RESIDUAL_M_S2)
    assert told([reason], "quality.few_disagree" if spare < SPARE_POSITIONS else "quality.disagree")
    assert not poor_sentences(None, spare, POOR_RESIDUAL_M_S2)
    assert not poor_sentences(None, spare, math.nan)
