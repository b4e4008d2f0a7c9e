"""Calibration at known attitudes: the traditional way of [1]_ and [2]_, with a turntable.

Where the specific force a of every position is known, the outputs are linear in what is sought: on body axes (eq. 10 of [1]_)

    N_i = sum_j K_i T_ij a_j + K_i b_i + K2_i a_i^2,

one line of least squares for each axis. On sensing axes s_i = sum_j T_ij a_j takes the place of a_i in the last term, and T is
that of the round before. What the turntable is off goes into the misalignments, and from there into the norm.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: sections 1 and 5.
.. [2] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: sections 1 and 2.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS
from imufield.calibrate.model.result import QuadraticAxes
from imufield.samples import FloatArray

_ROUNDS = 4  # Misalignments of 0.1 rad move K2 by a hundredth of itself in a round.


def fit_known_attitudes(
    raw: FloatArray, force_m_s2: FloatArray, *, quadratic: bool = True, quadratic_axes: QuadraticAxes = "sensing"
) -> FloatArray:
    """Return the 15 parameters from mean outputs at known specific forces.

    Parameters
    ----------
    raw : ndarray, shape (m, 3)
        Mean outputs less the output at zero input, m of at least 5 attitudes, 4 for a linear model.
    force_m_s2 : ndarray, shape (m, 3)
        Body frame, +g along the axis that points up.
    quadratic : bool
        Whether K2 is fitted; zero otherwise.
    quadratic_axes : {"sensing", "body"}

    Returns
    -------
    ndarray, shape (15,)
        In the order of ``ACCELEROMETER_NAMES``, in the body frame of ``force_m_s2``.
    """
    found = _lines(raw, force_m_s2, force_m_s2, quadratic=quadratic)
    for _ in range(_ROUNDS if quadratic and quadratic_axes == "sensing" else 0):
        T = found[:, :3] / np.diag(found)[:, None]
        found = _lines(raw, force_m_s2, force_m_s2 @ T.T, quadratic=True)
    K = np.diag(found)
    T = found[:, :3] / K[:, None]
    return np.concatenate([K, found[:, 3] / K, T[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS], found[:, 4]])


def _lines(raw: FloatArray, force: FloatArray, squared: FloatArray, *, quadratic: bool) -> FloatArray:
    """Return K T, K b and K2 of each axis, shape (3, 5)."""
    found = np.zeros((3, 5))
    columns = 5 if quadratic else 4
    for axis in range(3):
        A = np.column_stack([force, np.ones(len(raw)), squared[:, axis] ** 2])[:, :columns]
        found[axis, :columns] = np.linalg.lstsq(A, raw[:, axis], rcond=None)[0]
    return found
