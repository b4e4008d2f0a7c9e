"""When a hold ends: as soon as its mean is known as well as wanted, and no later than the Allan minimum.

How well that is for a target of the result follows from the whole session: ``session_time``. ``--hold-s`` comes from
``lead/settings`` as a target of a fixed time; ``lead/session_time`` sets the same where the result has a target;
``lead/hold_under_way`` asks whether it is met.

Within a hold the mean of white noise improves with the root of time until flicker noise dominates; the Allan deviation of the
stills of this session shows where (docs/maths.md, stillness). It is pooled over all placed holds, so each adds to it.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.dataclass import dataclass
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.hold.observe import cell_means
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import CELL_S, FloatArray

SHORTEST_S = 3.0  # The scatter of a shorter hold does not tell how well its mean is known.
LONGEST_HOLD_S = 60.0  # Where a target needs it: a person's patience with a purpose.
USUAL_S = 10.0  # Longest hold where no target needs more: a person's patience.
# Good enough where no target is given: below what most instruments repeat from hold to hold.
_USUAL_SIGMA_M_S2 = 10e-6 * STANDARD_GRAVITY_M_S2
_FEWEST_DIFFERENCES = 50  # Of two neighbouring means; the Allan deviation of fewer scatters by more than a tenth.
_STILL_FALLING = 0.85  # White noise falls by 0.71 when the time doubles; above this the minimum is near.
_OCTAVES = 9  # Averaging times up to 25 s: longer ones do not occur twice in a hold.
_FEWEST_CELLS = 8  # The autocorrelation of fewer cells says nothing.
# A hold ends this much later than white noise alone says: its sigma is estimated, and tested every half second. Simulated:
# 0.9 to 1.3 s for holds of 3 to 8 s.
_LATE_S = 1.0
_ROUNDING_S = 1e-9  # A whole number of cells is its length but for rounding.


@dataclass(frozen=True, slots=True)
class HoldTarget:
    """What ends a hold.

    Attributes
    ----------
    fixed_s : float or None
        Ends it whatever its mean.
    sigma_m_s2 : float
        Of the mean along gravity.
    longest_s : float
    """

    fixed_s: float | None = None
    sigma_m_s2: float = _USUAL_SIGMA_M_S2
    longest_s: float = USUAL_S

    @classmethod
    def fixed(cls, length_s: float) -> HoldTarget:
        """Return what ends a hold at this length, whatever its noise."""
        return cls(fixed_s=length_s, sigma_m_s2=0.0, longest_s=length_s)

    @classmethod
    def lasting(cls, length_s: float, noise: float) -> HoldTarget:
        """Return what ends a hold at this length on average where its noise is white, m/s^2 per sqrt(Hz).

        Where it is not, a hold of less than 10 s may last up to 10 s; a longer one never exceeds its length.
        """
        return cls(sigma_m_s2=noise / math.sqrt(length_s - _LATE_S), longest_s=max(length_s, USUAL_S))

    def latest_s(self, minimum_s: float) -> float:
        """Return the length at which a hold ends at the latest; ``minimum_s`` is that of the Allan deviation."""
        return self.fixed_s or max(min(self.longest_s, minimum_s), SHORTEST_S)

    def expected_s(self, noise: float) -> float:
        """Return the length of a hold with white noise alone, m/s^2 per sqrt(Hz), on average."""
        wanted_s = (noise / self.sigma_m_s2) ** 2 + _LATE_S if self.sigma_m_s2 else math.inf
        return min(max(wanted_s, SHORTEST_S), self.latest_s(math.inf))

    def is_met(self, length_s: float, sigma_m_s2: float, minimum_s: float) -> bool:
        """Whether a hold may end.

        Parameters
        ----------
        length_s : float
            Guard bands off.
        sigma_m_s2 : float
            Of its mean, infinite where not known.
        minimum_s : float
            Of the Allan deviation.
        """
        good_enough = self.fixed_s is None and sigma_m_s2 <= self.sigma_m_s2 and length_s >= SHORTEST_S - _ROUNDING_S
        return good_enough or length_s >= self.latest_s(minimum_s) - _ROUNDING_S


class AllanMinimum:
    """Pooled Allan deviation of the norm over the placed holds of a session."""

    def __init__(self) -> None:
        self._squares = np.zeros(_OCTAVES)
        self._counts = np.zeros(_OCTAVES)
        self.minimum_s = math.inf  # Averaging time beyond which little is gained, infinite while not known.

    def add(self, norm: FloatArray) -> None:
        """Add the norms of the cells of one hold, shape (m,)."""
        for octave in range(_OCTAVES):
            size = 2**octave
            groups = len(norm) // size
            if groups < 2:
                break
            means = norm[: groups * size].reshape(groups, size).mean(axis=1)
            self._squares[octave] += float((np.diff(means) ** 2).sum()) / 2
            self._counts[octave] += groups - 1
        self.minimum_s = self._minimum_s()

    def _minimum_s(self) -> float:
        known = self._counts >= _FEWEST_DIFFERENCES
        deviation = np.sqrt(np.divide(self._squares, self._counts, where=known, out=np.full(_OCTAVES, np.nan)))
        # Below 0.8 s neighbouring cells depend on each other in the bandwidth of slow instruments.
        for octave in range(3, _OCTAVES - 1):
            if known[octave + 1] and deviation[octave + 1] > _STILL_FALLING * deviation[octave]:
                return float(2 ** (octave + 1) * CELL_S)
        return math.inf


def sigma_along(cells: Cells, scale: RoughScale) -> float:
    """Return 1 sigma of the mean of cells along the mean force, m/s^2; infinite for fewer than 8 cells."""
    if len(cells) < _FEWEST_CELLS or not scale.accelerometer:
        return math.inf
    mean, covariance, _ = cell_means(cells)
    along = mean[:3] - scale.raw_zero
    along = along / np.linalg.norm(along)
    return math.sqrt(max(float(along @ covariance[:3, :3] @ along), 0.0)) / scale.accelerometer
