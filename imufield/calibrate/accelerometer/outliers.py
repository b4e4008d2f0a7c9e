"""Positions that the others contradict: which, by how much, and how sure that is.

One hold that was touched enters the scatter between positions, and so hides others like it. Positions are therefore taken out
one after the other, the worst first, whether or not it stands out, and all up to the last that does are outliers: the
generalized extreme studentized deviate procedure [1]_, with the externally studentised residuals of a fit for deviates.

They are named and stay in the fit: a person leaves them out with ``--without`` (``observations.leave_out``).

A position that alone shows a parameter is never taken out: the fit goes through it, and the others say nothing about it.

References
----------
.. [1] B. Rosner, "Percentage points for a generalized ESD many-outlier procedure", Technometrics 25 (1983).
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.accelerometer.fit import Fit
from imufield.calibrate.accelerometer.leave_one_out import NOT_LEFT_OUT
from imufield.calibrate.model.coverage_factors import student_factor
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

_LEVEL = 0.01  # Chance that any position of a good session is called an outlier (both sides, Bonferroni).
_FEWEST_TO_SPARE = 3  # Below, Student's limit is beyond what a hold can be off.
# Of the positions to spare at most this share is taken out: the rest must tell the scatter.
_LARGEST_SHARE = 1 / 3


@dataclass(frozen=True, slots=True)
class Outlier:
    """A position that does not fit the others; both figures are against a fit without any outlier."""

    position: int
    off_m_s2: float
    sigmas: float
    limit: float


def find_outliers(fitted: Fit) -> list[Outlier]:
    """Return the positions that do not fit the others, in their order."""
    weighted = _Weighted(fitted)
    kept = list(range(len(fitted.sigma_m_s2)))
    taken: list[int] = []
    outliers, limit = 0, np.inf
    most = max(1, int(fitted.degrees_of_freedom * _LARGEST_SHARE))
    while len(taken) < most and len(kept) - weighted.parameters >= _FEWEST_TO_SPARE:
        sigmas = weighted.external(kept)
        worst = int(np.argmax(sigmas))
        now = student_factor(len(kept) - weighted.parameters - 1, of=len(kept), chance=_LEVEL)
        taken.append(kept.pop(worst))
        if sigmas[worst] > now:
            outliers, limit = len(taken), now
    found = sorted(taken[:outliers])
    others = [position for position in range(len(fitted.sigma_m_s2)) if position not in found]
    predicted = [weighted.predicted(others, position) for position in found]
    return [
        Outlier(position, off * float(fitted.sigma_m_s2[position]), sigmas, limit)
        for position, (off, sigmas) in zip(found, predicted, strict=True)
    ]


class _Weighted:
    """Residuals and derivatives of a fit in units of sigma, and the least scatter that the noise of the means allows."""

    def __init__(self, fitted: Fit) -> None:
        self._residual: FloatArray = fitted.residual_m_s2 / fitted.sigma_m_s2
        self._jacobian: FloatArray = fitted.jacobian / fitted.sigma_m_s2[:, None]
        # What the outliers put into the scatter between positions is no noise.
        self._noise: FloatArray = 1 - (fitted.tau_m_s2 / fitted.sigma_m_s2) ** 2
        self.parameters = fitted.jacobian.shape[1]

    def external(self, kept: list[int]) -> FloatArray:
        """Return each of the kept residuals over its sigma by the scatter of the other kept ones; -1 where those tell none."""
        Q = np.linalg.qr(self._jacobian[kept])[0]
        rest = self._residual[kept] - Q @ (Q.T @ self._residual[kept])
        # Leverages add up to the parameters, so some are below one while a position is to spare.
        leverage = np.sum(Q**2, axis=1)
        can_go = leverage < NOT_LEFT_OUT
        student = rest**2 / np.where(can_go, 1 - leverage, 1.0)
        freedom = len(kept) - self.parameters
        sigmas = np.sqrt(student / self._variance(kept, (rest @ rest - student) / (freedom - 1)))
        return np.where(can_go, sigmas, -1.0)

    def predicted(self, others: list[int], position: int) -> tuple[float, float]:
        """Return how far a position is off a fit to the others, in units of its sigma, and over the sigma of that."""
        Q, R = np.linalg.qr(self._jacobian[others])
        rest = self._residual[others] - Q @ (Q.T @ self._residual[others])
        gain = np.linalg.solve(R.T, self._jacobian[position])
        off = float(self._residual[position] - gain @ (Q.T @ self._residual[others]))
        variance = self._variance(others, np.asarray(rest @ rest / (len(others) - self.parameters)))
        return off, float(abs(off) / np.sqrt(variance * (1 + gain @ gain)))

    def _variance(self, kept: list[int], scatter: FloatArray) -> FloatArray:
        return np.maximum(scatter, max(float(self._noise[kept].mean()), 1e-12))
