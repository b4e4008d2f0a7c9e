"""What the norm of gravity leaves open, put into the uncertainty by what is typical of the instrument's grade.

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
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imufield.earth import MICRO_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

DEFAULT_GRADE = "mems"
"""Where nobody says which: the uncertainty is rather too large than too small."""

_PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Typical:
    """1 sigma of what a session does not show, g per power of g."""

    quadratic: float
    cubic: float
    cross: float
    asymmetry: float
    misalignment_rad: float
    scatter_ug: float
    """Between positions, beyond the noise within them."""

    @property
    def scatter_m_s2(self) -> float:
        """The same in m/s^2."""
        return self.scatter_ug * MICRO_G_M_S2


@cache
def grades() -> dict[str, Typical]:
    """Return the grades by name, the best first."""
    tables = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return {name: Typical(**table) for name, table in tables.items()}


def typical_of(grade: str) -> Typical:
    """Return what is typical of a grade.

    Raises
    ------
    UsageError
        If there is no such grade.
    """
    if grade not in grades():
        raise UsageError(sentence("typical.no_grade", grade=grade, grades=[*grades()]))
    return grades()[grade]


def open_terms(up: FloatArray, typical: Typical, is_open: NDArray[np.bool_]) -> FloatArray:
    """Return d norm / d term times 1 sigma of each term that is not fitted, m/s^2, shape (m, k).

    Parameters
    ----------
    up : ndarray, shape (m, 3)
        Direction of the specific force at each position, unit vectors.
    typical : Typical
    is_open : ndarray, shape (6,)
        Which of three misalignments (xy, xz, yz) and three quadratic terms are open too; the other terms always are.
    """
    # Each axis adds its own reading to the norm by its share of the direction.
    columns = [typical.asymmetry * up * np.abs(up), typical.cubic * up**4]
    columns += [typical.cross * up * (up[:, j] * up[:, k])[:, None] for j, k in _PAIRS]
    # The angle between two axes is the sum of two entries of T.
    angles = math.sqrt(2) * typical.misalignment_rad * np.stack([up[:, j] * up[:, k] for j, k in _PAIRS], axis=1)
    columns += [np.hstack([angles, typical.quadratic * up**3])[:, is_open]]
    return STANDARD_GRAVITY_M_S2 * np.hstack(columns)
