"""Turntable runs: known rates, both ways, about known axes.

A run at +w about an axis and one at -w about the same axis, in the same attitude, differ by ``2 K E w``: bias, g-sensitivity
(the centripetal force is the same both ways) and, over whole turns, the Earth's rate drop out ([1]_ eq. 25, in vector form). Each
pair gives three numbers, so three axes give all nine entries of K E.

The paper's own cost for this path (eq. 26, ``printed_cost``) compares only the *lengths* of ``N+ - N-`` and ``2 K E w``. With
turns about the sensor axes it sees nothing but the three column norms of K E: rank 3 of 9. It is here for the study.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imufield.calibrate.gyroscope_model import TableRows
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray

RATES_DEG_S = (10.0, 20.0, 30.0)
"""Rates of the paper, both ways, about each axis."""
_SAME_RATE = 0.05
"""Runs whose rates differ by more than this share are no pair."""


@dataclass(frozen=True, slots=True)
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


def pair_runs(runs: Sequence[TurntableRun]) -> TableRows:
    """Join runs into pairs of opposite rates about the same axis.

    Raises
    ------
    CalibrationError
        If a run has no counterpart.
    """
    left = list(runs)
    pairs: list[tuple[TurntableRun, TurntableRun]] = []
    while left:
        run = left.pop(0)
        partner = next((other for other in left if _opposite(run, other)), None)
        if partner is None:
            raise CalibrationError(
                f"the turntable run at {np.degrees(run.rate_rad_s):+.1f} deg/s about {np.round(run.axis, 2).tolist()} has no "
                "counterpart at the opposite rate about the same axis; record both ways, or leave it out",
                Reason.TOO_FEW,
                rate_deg_s=float(np.degrees(run.rate_rad_s)),
            )
        left.remove(partner)
        pairs.append((run, partner) if run.rate_rad_s > 0 else (partner, run))
    return _rows(pairs)


def _opposite(run: TurntableRun, other: TurntableRun) -> bool:
    same_axis = float(run.axis @ other.axis) > 1 - 1e-3
    return same_axis and abs(run.rate_rad_s + other.rate_rad_s) <= _SAME_RATE * abs(run.rate_rad_s)


def _rows(pairs: list[tuple[TurntableRun, TurntableRun]]) -> TableRows:
    t = len(pairs)
    half, rate = np.zeros((t, 3)), np.zeros((t, 3))
    raw_covariance, covariance = np.zeros((t, 3, 3)), np.zeros((t, 3, 3))
    for k, (plus, minus) in enumerate(pairs):
        w = (plus.rate_rad_s - minus.rate_rad_s) / 2
        u = plus.axis / np.linalg.norm(plus.axis)
        half[k], rate[k] = (plus.mean_raw - minus.mean_raw) / 2, w * u
        raw_covariance[k] = (plus.covariance_raw + minus.covariance_raw) / 4
        along, across = plus.rate_sigma_rad_s**2 / 2, (w * plus.axis_sigma_rad) ** 2
        covariance[k] = along * np.outer(u, u) + across * (np.eye(3) - np.outer(u, u))
    return TableRows(half, raw_covariance, rate, covariance)


def matrix_from_pairs(table: TableRows) -> FloatArray:
    """Return K E by plain least squares over all pairs, shape (3, 3): eq. 25 in vector form.

    Raises
    ------
    CalibrationError
        If the axes do not fill space.
    """
    values = np.linalg.svd(table.rate, compute_uv=False) if len(table) >= 3 else np.zeros(3)
    if values[-1] <= 1e-3 * max(float(values[0]), 1e-300):
        raise CalibrationError(
            f"{len(table)} pairs of turntable runs do not turn about three independent axes; add the missing axis, both ways",
            Reason.UNOBSERVABLE,
            pairs=len(table),
        )
    solution: FloatArray = np.asarray(np.linalg.lstsq(table.rate, table.half_difference_raw, rcond=None)[0], dtype=np.float64)
    return solution.T


def printed_cost(matrices: FloatArray, table: TableRows) -> FloatArray:
    """Return L_gm as eq. 26 prints it for candidate matrices K E, shape (..., 3, 3) -> (...)."""
    difference = np.sum((2 * table.half_difference_raw) ** 2, axis=1)
    predicted = np.sum((2 * np.einsum("...ij,tj->...ti", matrices, table.rate)) ** 2, axis=-1)
    cost: FloatArray = np.sqrt(np.sum((difference - predicted) ** 2, axis=-1) / max(len(table) - 1, 1))
    return cost


def vector_cost(matrices: FloatArray, table: TableRows) -> FloatArray:
    """Return the sum of squares of (N+ - N-)/2 - K E w for candidate matrices, shape (..., 3, 3) -> (...)."""
    predicted = np.einsum("...ij,tj->...ti", matrices, table.rate)
    cost: FloatArray = np.sum((table.half_difference_raw - predicted) ** 2, axis=(-1, -2))
    return cost
