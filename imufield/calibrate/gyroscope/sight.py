"""What moves and stills can show of a gyroscope, before anything is fitted.

The residuals are linearised at the start with generous noise. Parameter by parameter, in order of importance, the part of its
column that the ones before do not explain is its *sight*: one over the sigma it would have. What cannot be seen is held at the
preset and named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.calibrate.gyroscope.fit import first_scatter
from imufield.calibrate.gyroscope.model import GyroscopeData, evaluate
from imufield.calibrate.gyroscope.move_integration import INVERSE, PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.noise import ForceErrors, Scatter, covariances
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray, IntArray

WORST_SCALE = 0.05
"""Relative sigma above which an entry of K E counts as not seen: a driver's nominal scale is as good."""
WORST_SENSITIVITY = 2e-3
"""The same for g-sensitivity, rad/s per m/s^2: 1.1 deg/s per g."""
# Turns are taken to be as wrong as this, at least and at most: what a start off by a few per cent leaves may be either.
_TURN_RAD = (0.002, 0.05)
_ORDER = (0, 4, 8, 9, 10, 11, 1, 2, 3, 5, 6, 7)  # Scales, biases, then misalignment.


@dataclass(frozen=True, slots=True)
class Sight:
    """Which of the 21 parameters can be seen."""

    visible: tuple[int, ...]
    hidden: tuple[int, ...]
    """Of A and b, held at the start."""
    sensitivity: bool
    """Whether all nine entries of the g-sensitivity can be seen."""
    known: bool
    """Whether the start comes from a preset or a driver."""

    @property
    def hidden_names(self) -> tuple[str, ...]:
        """Names of the hidden entries of K E."""
        return tuple(entry_name(k) for k in self.hidden)

    def free(self, columns: IntArray) -> IntArray:
        """Return those of the columns that can be seen."""
        return np.array([k for k in columns if k in self.visible or (k >= SENSITIVITY.start and self.sensitivity)])


def entry_name(k: int) -> str:
    """Return the name of the parameter that entry k of A (row by row) stands for."""
    row, column = divmod(k, 3)
    if row == column:
        return f"gyroscope.scale.{AXES[row]}"
    return f"gyroscope.misalignment_rad.{AXES[row]}{AXES[column]}"


def look(p: FloatArray, data: GyroscopeData, errors: ForceErrors, *, known: bool) -> Sight:
    """Judge what can be seen.

    Parameters
    ----------
    p : ndarray
        Start.
    data : GyroscopeData
    errors : ForceErrors
    known : bool
        Whether the start comes from a preset or a driver, so that hidden entries have a value to be left at.

    Raises
    ------
    CalibrationError
        If a scale cannot be seen and nothing says what it is.
    """
    now = evaluate(p, data)
    generous = first_scatter(now)
    scatter = Scatter(generous.drift_rad_s, 0.0, float(np.clip(generous.turn_rad, *_TURN_RAD)))
    S = covariances(now, p[:PARAMETERS], data, errors).total(scatter)
    scale = _natural_scale(p)
    whitened = np.linalg.solve(np.linalg.cholesky(S), now.jacobian[:, :PARAMETERS] * scale)
    order = (*_ORDER, *range(SENSITIVITY.start, SENSITIVITY.stop))
    sight = dict(zip(order, _sights(np.asarray(whitened[:, order], dtype=np.float64)), strict=True))
    visible = tuple(k for k in _ORDER if sight[k] > 1 / WORST_SCALE or k >= INVERSE.stop)
    hidden = tuple(sorted(set(_ORDER) - set(visible)))
    unknown = [entry_name(k) for k in hidden if k % 4 == 0]
    if unknown and not known:
        raise CalibrationError(
            f"these moves cannot show {' and '.join(unknown)} and nothing says what it is; add moves that turn about "
            f"{', '.join(name[-1] for name in unknown)}, or give a preset",
            Reason.UNOBSERVABLE,
            names=tuple(unknown),
        )
    sensitivity = all(sight[k] > 1 / WORST_SENSITIVITY for k in range(SENSITIVITY.start, SENSITIVITY.stop))
    return Sight(visible, hidden, sensitivity and not any(k >= INVERSE.stop for k in hidden), known)


def _natural_scale(p: FloatArray) -> FloatArray:
    """Return steps that mean the same everywhere: 1 (100 %) for A, 1 rad/s for b, 1 rad/s per m/s^2 for H."""
    A = p[INVERSE].reshape(3, 3)
    columns = np.linalg.norm(A, axis=0)
    return np.concatenate([np.tile(columns, 3), np.ones(12)])


def _sights(columns: FloatArray) -> list[float]:
    sights: list[float] = []
    basis = np.zeros((len(columns), 0))
    for column in columns.T:
        rest = column
        for _ in range(2):  # the second pass takes away what rounding left
            rest = rest - basis @ (basis.T @ rest)
        length = float(np.linalg.norm(rest))
        sights.append(length)
        if length > 0:
            basis = np.column_stack([basis, rest / length])
    return sights
