"""A ramp for tests, window by window."""

from __future__ import annotations

import math

import numpy as np

from imufield.samples import FloatArray

TIME_S = np.arange(0.0, 4000.0, 10.0)
# Even for 700 s, 1 degC/min for 20 degC, 3 degC/min for 6, and even again.
AT_DEGC = np.interp(TIME_S, [0.0, 700.0, 1900.0, 2020.0, 4000.0], [-10.0, -10.0, 10.0, 16.0, 16.0])


def pose(moved_s: float = math.inf) -> FloatArray:
    force = np.tile([0.1, 0.2, 9.8], (len(TIME_S), 1))
    force[moved_s <= TIME_S] = [0.1, 0.6, 9.8]
    return force
