"""Turntable runs: known rates, both ways, about known axes.

A run at +w about an axis and one at -w about the same axis, in the same attitude, differ by ``2 K E w``: bias, g-sensitivity
(the centripetal force is the same both ways) and, over whole turns, the Earth's rate drop out ([1]_ eq. 25, in vector form).
Each pair gives three numbers, so three axes give all nine entries of K E.

The paper's own cost for this path (eq. 26) compares only the *lengths* of ``N+ - N-`` and ``2 K E w``. With turns about the
sensor axes it sees nothing but the three column norms of K E: rank 3 of 9 (``triad_costs.TurnsProblem`` has both).

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imufield.dataclass import dataclass
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_SAME_AXIS = 1 - 1e-3  # Cosine of 2.6 deg.
_SAME_RATE = 0.05  # Runs whose rates differ by more than this share are no pair.


@dataclass(frozen=True, slots=True, kw_only=True)
class TurntableRun:
    """The mean output of one run.

    Attributes
    ----------
    axis : ndarray, shape (3,)
        Axis of the table in the body frame, unit: "up" of the still before, for a table with a vertical axis.
    rate_rad_s : float
        Signed, right-handed about ``axis``.
    mean_raw : ndarray, shape (3,)
        Mean gyroscope output over whole turns.
    covariance_raw : ndarray, shape (3, 3)
    rate_sigma_rad_s : float
    axis_sigma_rad : float
    """

    axis: FloatArray
    rate_rad_s: float
    mean_raw: FloatArray
    covariance_raw: FloatArray
    rate_sigma_rad_s: float = 0.0
    axis_sigma_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRows:
    """t pairs of turntable rates, ready for fitting.

    Attributes
    ----------
    half_difference_raw : ndarray, shape (t, 3)
        (N+ - N-) / 2.
    half_sum_raw : ndarray, shape (t, 3)
        (N+ + N-) / 2: what does not change sign with the rate.
    axis : ndarray, shape (t,)
        Number of the first pair about the same axis.
    covariance_raw : ndarray, shape (t, 3, 3)
        Of half difference and half sum alike.
    rate_rad_s : ndarray, shape (t, 3)
        Body rate in the positive run.
    rate_covariance : ndarray, shape (t, 3, 3)
        Of that rate, (rad/s)^2: speed of the table and direction of its axis.
    """

    half_difference_raw: FloatArray
    half_sum_raw: FloatArray
    axis: FloatArray
    covariance_raw: FloatArray
    rate_rad_s: FloatArray
    rate_covariance: FloatArray

    def __len__(self) -> int:
        return len(self.rate_rad_s)


def no_table() -> TableRows:
    """Return zero pairs."""
    vectors, matrices = np.empty((0, 3)), np.empty((0, 3, 3))
    return TableRows(
        half_difference_raw=vectors,
        half_sum_raw=vectors,
        axis=np.empty(0),
        covariance_raw=matrices,
        rate_rad_s=vectors,
        rate_covariance=matrices,
    )


def pair_runs(runs: Sequence[TurntableRun]) -> TableRows:
    """Join runs into pairs of opposite rates about the same axis.

    Raises
    ------
    CalibrationError
        If a run has no counterpart.
    """
    left = list(runs)
    rows, axes = [], list[FloatArray]()
    while left:
        run = left.pop(0)
        partners = [
            place
            for place, other in enumerate(left)
            if float(run.axis @ other.axis) > _SAME_AXIS
            and abs(run.rate_rad_s + other.rate_rad_s) <= _SAME_RATE * abs(run.rate_rad_s)
        ]
        if not partners:
            rate_deg_s, axis = float(np.degrees(run.rate_rad_s)), np.round(run.axis, 2).tolist()
            alone = sentence("turntable.no_counterpart", rate_deg_s=rate_deg_s, axis=axis)
            raise CalibrationError(alone, Reason.TOO_FEW)
        minus, plus = sorted((run, left.pop(partners[0])), key=lambda one: one.rate_rad_s)
        w = (plus.rate_rad_s - minus.rate_rad_s) / 2
        u = plus.axis / np.linalg.norm(plus.axis)
        along, across = plus.rate_sigma_rad_s**2 / 2, (w * plus.axis_sigma_rad) ** 2
        axis = next((k for k, other in enumerate(axes) if float(u @ other) > _SAME_AXIS), len(axes))
        axes.append(u)
        rows.append(
            {
                # (N+ - N-) / 2 = K E w, [1]_ eq. 25
                "half_difference_raw": (plus.mean_raw - minus.mean_raw) / 2,
                "half_sum_raw": (plus.mean_raw + minus.mean_raw) / 2,
                "axis": axis,
                "covariance_raw": (plus.covariance_raw + minus.covariance_raw) / 4,
                "rate_rad_s": w * u,
                "rate_covariance": along * np.outer(u, u) + across * (np.eye(3) - np.outer(u, u)),
            }
        )
    return TableRows(**{name: np.array([row[name] for row in rows]) for name in rows[0]})
