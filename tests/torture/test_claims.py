"""Do the stated 95 % intervals hold the truth in 95 % of sessions? Bytes, decoder, stillness, guide and fit in the loop."""

from __future__ import annotations

import numpy as np
import pytest

from tests.torture.conftest import Campaign
from tests.torture.sessions import PARAMETERS, Sessions

GRADES = ("navigation", "tactical", "industrial", "mems")


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("grade", GRADES)
def test_intervals_hold_the_truth(grade: str, campaign: Campaign) -> None:
    seeds = campaign.times(2, 500)
    over_limit = np.abs(Sessions(grade).errors_over_limit(seeds))
    inside = over_limit < 1
    share, pooled = 100 * inside.mean(axis=0), 100 * float(inside.mean())
    # So few sessions can only show gross errors: of all together, a sigma that should be twice as large, and of one parameter,
    # four sigma. 500 know the share of one parameter to 1 %, of all together to about 0.5 %.
    single, together = ((90.0, 98.5), (93.5, 96.5)) if campaign.full else ((0.0, 100.0), (75.0, 100.0))
    assert campaign.full or np.all(over_limit < 2), over_limit
    assert single[0] <= share.min(), dict(zip(PARAMETERS, share, strict=True))
    assert share.max() <= single[1], dict(zip(PARAMETERS, share, strict=True))
    assert together[0] <= pooled <= together[1]
    campaign.tell(
        f"95 % intervals of {grade} grade against the simulated truth, all twelve gauge-free parameters",
        seeds,
        "sessions",
        f"hold it in {pooled:.1f} % of cases; single parameters {share.min():.1f} to {share.max():.1f} %",
    )
