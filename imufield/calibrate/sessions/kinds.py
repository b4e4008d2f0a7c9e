"""The numbers of a session by their names: "bias x" is of the kind "bias"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

DAILY = ("bias", "scale", "gyroscope bias", "gyroscope scale")
"""Kinds that change from day to day."""
SCALES = ("scale", "gyroscope scale")
"""Kinds that an adjustment takes as their deviation from those of one session, in ppm."""
PPM = 1e-6


def kind_of(name: str) -> str:
    """Return the kind of a number, "bias" of "bias x"."""
    return name.rpartition(" ")[0]


def of_gyroscope(names: Sequence[str]) -> NDArray[np.bool_]:
    """Return which of the numbers are the gyroscope's."""
    return np.array([name.startswith(("gyroscope", "g-")) for name in names])
