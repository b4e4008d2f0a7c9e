"""Forms that a drift of the bias can take over the positions of a session: time, or temperature.

The bias at position i is ``b + sum_j X_ij d_j``, with a vector ``d_j`` of three axes for each column of ``X``. The columns have
mean zero over the positions, so ``b`` is the mean bias; those of time are the first two Legendre polynomials, made orthogonal
over the times there are: a warm-up is neither straight nor over when the session ends.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

MOST_CONFUSION = 2.0
"""Factor in sigma of the bias (``order_confusion``): 1.7 in the proposed order of paper24, 1.1 in that of corners24, and 3.2
with all faces before all edges."""

DriftKind = Literal["time", "temperature"]

FEWEST_TO_SPARE = 3
"""Positions less parameters that a fit with drift must leave: with fewer the F test has no power (limit 19 and more)."""
_FEWEST_FOR_ALL = 18 + FEWEST_TO_SPARE  # Nine linear parameters, three quadratic, six of the drift.
LEAST_SPAN_DEGC = 0.5
"""Of temperature over the positions: a bias of 0.5 mg/degC, typical of chips, moves by the scatter between positions there."""


@dataclass(frozen=True, slots=True)
class DriftForm:
    """One form of drift."""

    kind: DriftKind
    columns: FloatArray
    """X, shape (m, k), mean zero, largest value about one."""


def drift_forms(observations: Observations, spare: int) -> tuple[DriftForm, ...]:
    """Return the forms that the positions can be asked for.

    Parameters
    ----------
    observations : Observations
    spare : int
        Degrees of freedom of the richest model without drift.
    """
    forms: list[DriftForm] = []
    middle_s = observations.start_s + observations.duration_s / 2
    orders = min(2, (spare - FEWEST_TO_SPARE) // 3)
    if orders >= 1 and np.isfinite(middle_s).all() and np.ptp(middle_s) > 0:
        forms.append(DriftForm("time", _orthogonal(middle_s, orders)))
    temperature = observations.temperature_degc
    if orders >= 1 and np.isfinite(temperature).all() and np.ptp(temperature) >= LEAST_SPAN_DEGC:
        forms.append(DriftForm("temperature", _orthogonal(temperature, 1)))
    return tuple(forms)


def _orthogonal(values: FloatArray, orders: int) -> FloatArray:
    """Return polynomials of 1 to ``orders``, orthogonal to a constant and to each other, scaled to 1."""
    unit = (values - values.mean()) / np.ptp(values)
    powers = np.vander(unit, orders + 1, increasing=True)
    columns = np.linalg.qr(powers)[0][:, 1:]
    return np.asarray(columns / np.abs(columns).max(axis=0))


def order_confusion(up: FloatArray) -> float:
    """Return how much less sure the bias is with quadratic term and drift than with the worse of them alone.

    1 where the positions are too few for both.

    Parameters
    ----------
    up : ndarray, shape (m, 3)
        Directions of up, unit vectors, in the order and at the pace in which they are taken.
    """
    if len(up) < _FEWEST_FOR_ALL:
        return 1.0
    # d norm / d parameter of a perfect instrument, in g: scale, bias and misalignment; quadratic; drift.
    linear = np.hstack([up**2, up, up[:, [0, 0, 1]] * up[:, [1, 2, 2]]])
    columns = _orthogonal(np.arange(len(up), dtype=np.float64), 2)
    drift = np.hstack([column[:, None] * up for column in columns.T])

    def variance(*terms: FloatArray) -> float:
        inverse = np.linalg.pinv(np.hstack([linear, *terms]))
        return float(np.sum(inverse[3:6] ** 2))

    return float(np.sqrt(variance(up**3, drift) / max(variance(up**3), variance(drift))))
