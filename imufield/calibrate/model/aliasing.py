"""Aliasing: how unfitted terms of a size typical of the grade change the fitted parameters, as added covariance.

Some terms of a real accelerometer change no residual, or none that these positions have to spare. With the columns ``C`` of
such terms beside the weighted Jacobian ``J`` of those that are fitted, a term of size ``c`` moves the parameters by
``J^+ C c``, its alias [1]_. Drawn from what is typical, ``c ~ N(0, S)``, it adds ``J^+ C S C^T J^+T`` to their covariance.

With the specific force ``s`` along the sensing axes in g, axis i reads more by

    quadratic    c s_i^2        misalignment    c s_j
    asymmetry    c |s_i|        (scale of the two sides differs by 2 c)
    cubic        c s_i^3        cross           c s_j s_k, j < k

References
----------
.. [1] G. E. P. Box, K. B. Wilson, "On the experimental attainment of optimum conditions", J. Royal Stat. Soc. B 13 (1951).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.higher_terms import TERMS
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray

HIGHER_COLUMNS = slice(3, 3 + TERMS)
"""Of ``open_terms``."""
LEFT_OUT_SHARES = ("misalignment_not_shown", "quadratic_not_shown")
"""Names of the shares of the entries that positions leave open."""
_PAIRS = ((0, 1), (0, 2), (1, 2))


def typical_higher(typical: Grade) -> FloatArray:
    """Return 1 sigma of the higher terms, m/s^2 at 1 g, shape (12,)."""
    return STANDARD_GRAVITY_M_S2 * np.repeat([typical.cubic, typical.cross], [3, TERMS - 3])


def typical_entries(typical: Grade) -> FloatArray:
    """Return 1 sigma of three misalignments (xy, xz, yz) and three quadratic terms, m/s^2 at 1 g, shape (6,)."""
    # The angle between two axes is the sum of two entries of T.
    angle = math.sqrt(2) * typical.accelerometer.misalignment_rad
    return STANDARD_GRAVITY_M_S2 * np.repeat([angle, typical.quadratic], 3)


def open_terms(up: FloatArray, typical: Grade, is_open: NDArray[np.bool_]) -> FloatArray:
    """Return d norm / d term times 1 sigma of each term that is not fitted, m/s^2, shape (m, k).

    Asymmetry 3, higher terms 12, and those of the others that are open.

    Parameters
    ----------
    up : ndarray, shape (m, 3)
        Direction of the specific force at each position, unit vectors.
    typical : Grade
    is_open : ndarray, shape (6,)
        Which of three misalignments (xy, xz, yz) and three quadratic terms are open too; the other terms always are.
    """
    # Each axis adds its own reading to the norm by its share of the direction.
    columns = [typical.asymmetry * up * np.abs(up), typical.cubic * up**4]
    columns += [typical.cross * up * (up[:, j] * up[:, k])[:, None] for j, k in _PAIRS]
    angles = np.stack([up[:, j] * up[:, k] for j, k in _PAIRS], axis=1)
    entries = np.hstack([angles, up**3]) * typical_entries(typical)
    return np.hstack([STANDARD_GRAVITY_M_S2 * np.hstack(columns), entries[:, is_open]])
