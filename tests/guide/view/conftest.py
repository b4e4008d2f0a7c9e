"""One simulated session, for every view."""

import math
from typing import Any

import pytest

from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme


@pytest.fixture
def session(make_path: Any) -> Any:
    """A guide fed in 20 ms blocks: yields events and the guide after each."""
    path = make_path(100.0).hold([0, 0, 1], 6).turn([1, 0, 0], 1.5).hold([1, 0, 0], 2).turn([1, 1, 0], 1).hold([1, 1, 0], 3)
    samples = path.samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0))

    def play(until_s: Any = math.inf) -> Any:
        for start in range(0, len(samples), 2):
            if samples.time_s[start] >= until_s:
                return
            yield guide.feed(samples[start : start + 2]), guide

    return play
