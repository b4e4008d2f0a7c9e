"""How long a hold must be: until the mean is known as well as wanted, and no longer than the Allan minimum.

Within a hold the mean of white noise improves with the root of time until flicker noise takes over; the Allan deviation of the
stills of this session shows where (docs/maths.md, stillness). It is pooled over all placed holds, so each tells more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.hold.observe import cell_means
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray

SHORTEST_S = 3.0
LONGEST_S = 60.0
USUAL_S = 10.0
"""Longest hold where no target is given: a person's patience."""
USUAL_SIGMA_M_S2 = 10e-6 * STANDARD_GRAVITY_M_S2
"""Good enough where no target is given: below what most instruments repeat from hold to hold."""
_FEWEST_DIFFERENCES = 50
_STILL_FALLING = 0.85  # White noise falls by 0.71 when the time doubles; above this the minimum is near.


@dataclass(frozen=True, slots=True)
class HoldWish:
    """What ends a hold.

    Attributes
    ----------
    fixed_s : float or None
        Ends it whatever the mean is worth.
    sigma_m_s2 : float
        Of the mean along gravity.
    longest_s : float
    """

    fixed_s: float | None = None
    sigma_m_s2: float = USUAL_SIGMA_M_S2
    longest_s: float = USUAL_S

    @classmethod
    def of(cls, fixed_s: float | None, sigma_m_s2: float | None) -> HoldWish:
        """Return the wish for a fixed time, for a sigma, or the usual one."""
        if fixed_s is not None:
            return cls(fixed_s, 0.0, fixed_s)
        return cls() if sigma_m_s2 is None else cls(None, sigma_m_s2, LONGEST_S)


class AllanMinimum:
    """Pooled Allan deviation of the norm over the placed holds of a session.

    Parameters
    ----------
    cell_s : float
    """

    _OCTAVES = 9

    def __init__(self, cell_s: float) -> None:
        self._cell_s = cell_s
        self._squares = np.zeros(self._OCTAVES)
        self._counts = np.zeros(self._OCTAVES)

    def add(self, norm: FloatArray) -> None:
        """Take the norms of the cells of one hold, shape (m,)."""
        for octave in range(self._OCTAVES):
            size = 2**octave
            groups = len(norm) // size
            if groups < 2:
                return
            means = norm[: groups * size].reshape(groups, size).mean(axis=1)
            self._squares[octave] += float((np.diff(means) ** 2).sum()) / 2
            self._counts[octave] += groups - 1

    @property
    def minimum_s(self) -> float:
        """Averaging time beyond which little is gained, infinite while not seen."""
        known = self._counts >= _FEWEST_DIFFERENCES
        deviation = np.sqrt(np.divide(self._squares, self._counts, where=known, out=np.full(self._OCTAVES, np.nan)))
        for octave in range(3, self._OCTAVES - 1):
            if known[octave + 1] and deviation[octave + 1] > _STILL_FALLING * deviation[octave]:
                return float(2 ** (octave + 1) * self._cell_s)
        return math.inf


def sigma_along(cells: Cells, scale: RoughScale) -> float:
    """Return 1 sigma of the mean of cells along the mean force, m/s^2; infinite for fewer than 8 cells."""
    if len(cells) < 8 or not scale.accelerometer:
        return math.inf
    mean, covariance = cell_means(cells)
    along = mean[:3] - scale.raw_zero
    along = along / np.linalg.norm(along)
    return math.sqrt(max(float(along @ covariance[:3, :3] @ along), 0.0)) / scale.accelerometer


def is_long_enough(length_s: float, sigma_m_s2: float, wish: HoldWish, minimum_s: float) -> bool:
    """Whether a hold of so much usable time may end.

    Parameters
    ----------
    length_s : float
        Guard bands off.
    sigma_m_s2 : float
        Of its mean, infinite where not known.
    wish : HoldWish
    minimum_s : float
        Of the Allan deviation.
    """
    if wish.fixed_s is not None:
        return length_s >= wish.fixed_s - 1e-9
    if length_s < SHORTEST_S - 1e-9:
        return False
    latest_s = max(min(wish.longest_s, minimum_s), SHORTEST_S)
    return sigma_m_s2 <= wish.sigma_m_s2 or length_s >= latest_s - 1e-9
