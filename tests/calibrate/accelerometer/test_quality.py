"""What the verdict asks for can be done: few positions do not show which of them is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.calibrate.accelerometer.quality import (
    POOR_RESIDUAL_M_S2,
    USABLE_BIAS_SIGMA_M_S2,
    poor_sentences,
    sigma_sentences,
)
from imufield.calibrate.model.models import BIAS, PARAMETERS, SCALE
from imufield.calibrate.model.uncertainty import SPARE_POSITIONS
from imufield.earth import Gravity
from imufield.samples import LARGEST_OFFSET_M_S2
from tests.told import told


@pytest.mark.parametrize("spare", range(1, 2 * SPARE_POSITIONS))
def test_positions_that_disagree_are_to_be_repeated_where_they_are_known(spare: int) -> None:
    (reason,) = poor_sentences(None, spare, 2 * POOR_RESIDUAL_M_S2)
    assert told([reason], "quality.few_disagree" if spare < SPARE_POSITIONS else "quality.disagree")
    assert not poor_sentences(None, spare, POOR_RESIDUAL_M_S2)
    assert not poor_sentences(None, spare, math.nan)


@pytest.mark.parametrize("over", [0.9, 1.1])
def test_a_bias_of_several_g_asks_for_the_raw_zero_and_not_for_more_positions(over: float) -> None:
    vector, sigma = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    vector[SCALE], vector[BIAS] = 836.0, [0.1, -over * LARGEST_OFFSET_M_S2, 0.2]
    sigma[BIAS] = 2 * USABLE_BIAS_SIGMA_M_S2
    (reason,) = sigma_sentences(vector, sigma, Gravity(gravity_m_s2=9.81, sigma_m_s2=1e-6, source="measured"))
    assert told([reason], "quality.bias_sigma")
    assert told([reason.values["remedy"]], "quality.raw_zero" if over > 1 else "quality.more_positions")
