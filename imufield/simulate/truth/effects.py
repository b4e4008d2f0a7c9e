"""Effects beyond the error model of an instrument: what a calibration does not fit, one field each."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects:
    """What an instrument does beside its error model; by default nothing.

    A converter with codes that stick gives the code ``n - n mod P`` for every n with ``n mod P < W``: of each P codes the first
    W read as the lowest of them, a differential nonlinearity of W - 1 steps, which the histogram of the codes shows [1]_.

    References
    ----------
    .. [1] IEEE Std 1241-2010, "Terminology and test methods for analog-to-digital converters": code density histogram,
       differential nonlinearity, missing codes.
    """

    silent_range_m_s2: float = math.inf
    """The accelerometer's output goes no farther than this from zero, and no flag says so."""
    frozen_s: tuple[float, float] | None = None
    """From when to when outputs repeat the value that they had before."""
    frozen_outputs: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    """Outputs that do: accelerometer x, y, z, gyroscope x, y, z."""
    sticking_period: int = 0
    """P of the accelerometer's codes that stick; 0: none does."""
    sticking_width: int = 0
    """W of these codes."""


NO_EFFECTS = Effects()
