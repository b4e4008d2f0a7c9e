"""Observability of the gyroscope's parameters: what moves and stills can show, before anything is fitted and after.

The residuals are linearised at the start with generous noise. Parameter by parameter, in order of importance, the part of its
column that the ones before do not explain has a length: one over the sigma it would have. What cannot be observed is left at
the preset and named. So is what a fit then does not tell: its noise may be larger than was thought, and a scale without a
hold runs away.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.gyroscope.fit import JointFit, first_scatter
from imufield.calibrate.gyroscope.move_integration import INVERSE, PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.residual_covariance import Scatter, covariances, turns_tell_scatter
from imufield.calibrate.gyroscope.residuals import GyroscopeData, evaluate
from imufield.calibrate.model.observability import unexplained_lengths
from imufield.dataclass import dataclass, replace
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray, IntArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

WORST_SCALE = 0.05
"""Relative sigma above which an entry of K E counts as not observed: a driver's nominal scale is as good."""
WORST_FITTED = 0.5
"""The same of a fitted entry, and most by which it may leave a rough one: beyond, the fit has run to another minimum."""
WORST_SENSITIVITY = 2e-3
"""The same for g-sensitivity, rad/s per m/s^2: 1.1 deg/s per g."""
# Turns are taken to be as wrong as this, at least and at most: what a start off by a few per cent leaves may be either.
_TURN_RAD = (0.002, 0.05)
ENTRY_NAMES = tuple(
    f"gyroscope.scale.{row}" if row == column else f"gyroscope.misalignment_rad.{row}{column}"
    for row in AXES
    for column in AXES
)
"""The parameters that the entries of A, row by row, stand for."""
_ORDER = (0, 4, 8, 9, 10, 11, 1, 2, 3, 5, 6, 7)  # Scales, biases, then misalignment.


@dataclass(frozen=True, slots=True)
class Observability:
    """Which of the 21 parameters can be observed."""

    hidden: tuple[int, ...]
    """Of A and b, left at the start."""
    sensitivity: bool
    """Whether all nine entries of the g-sensitivity can be observed."""
    known: bool
    """Whether the start comes from a preset or a driver."""

    @property
    def hidden_names(self) -> tuple[str, ...]:
        """Names of the hidden entries of K E."""
        return tuple(ENTRY_NAMES[k] for k in self.hidden)

    def free(self, columns: IntArray) -> IntArray:
        """Return those of the columns that can be observed."""
        return np.array([k for k in columns if (k not in self.hidden if k < SENSITIVITY.start else self.sensitivity)])


def observe(p: FloatArray, data: GyroscopeData, *, known: bool) -> Observability:
    """Judge what moves and stills show.

    Parameters
    ----------
    p : ndarray
        Start.
    data : GyroscopeData
    known : bool
        Whether the start comes from a preset or a driver, so that hidden entries have a value to be left at.

    Raises
    ------
    CalibrationError
        If a scale cannot be observed and nothing says what it is.
    """
    now = evaluate(p, data)
    generous = first_scatter(now)
    scatter = Scatter(generous.drift_rad_s, 0.0, float(np.clip(generous.turn_rad, *_TURN_RAD)))
    S = covariances(now, p[:PARAMETERS], data).total(scatter)
    # Steps that mean the same everywhere: 1 (100 %) for A, 1 rad/s for b, 1 rad/s per m/s^2 for H.
    scale = np.concatenate([_sizes(p[INVERSE].reshape(3, 3)), np.ones(12)])
    whitened = np.linalg.solve(np.linalg.cholesky(S), now.jacobian[:, :PARAMETERS] * scale)
    order = (*_ORDER, *range(SENSITIVITY.start, SENSITIVITY.stop))
    length = dict(zip(order, unexplained_lengths(np.asarray(whitened[:, order], dtype=np.float64)), strict=True))
    # Biases are always visible, so `hidden` has entries of A alone.
    hidden = tuple(k for k in range(INVERSE.stop) if not length[k] > 1 / WORST_SCALE)
    sensitivity = all(length[k] > 1 / WORST_SENSITIVITY for k in range(SENSITIVITY.start, SENSITIVITY.stop))
    found = Observability(hidden, sensitivity, known)
    _require_known_scales(found)
    return found


def without_contradicted(fit: JointFit, estimate: FloatArray | None, observability: Observability) -> Observability:
    """Return what is left of the observability behind a fit.

    Parameters
    ----------
    fit : JointFit
    estimate : ndarray, shape (3, 3), or None
        A where a fit of moves alone must end, roughly.
    observability : Observability

    Raises
    ------
    CalibrationError
        As ``observe``.
    """
    entries = fit.free < INVERSE.stop
    free, size = fit.free[entries], _sizes(fit.p[INVERSE].reshape(3, 3) if estimate is None else estimate)
    off = np.sqrt(np.diag(fit.covariance)[entries])
    if estimate is not None and not turns_tell_scatter(fit.scatter, fit.evaluation.jacobian[:, fit.free], fit.parts):
        # Another minimum may have no less sense, and no residual tells of it.
        off = np.maximum(off, np.abs(fit.p[free] - estimate.ravel()[free]))
    lost = free[~(off < WORST_FITTED * size[free])]
    left = replace(observability, hidden=tuple(sorted({*observability.hidden, *lost.tolist()})))
    _require_known_scales(left)
    return left


def _sizes(A: FloatArray) -> FloatArray:
    """Return what is 100 % of each entry of A: the length of its column."""
    return np.tile(np.linalg.norm(A, axis=0), 3)


def _require_known_scales(observability: Observability) -> None:
    unknown = [ENTRY_NAMES[k] for k in observability.hidden if k % 4 == 0]
    if unknown and not observability.known:
        axes = [name[-1] for name in unknown]
        hidden_scale = sentence("observability.hidden_scale", scales=" and ".join(unknown), axes=axes)
        raise CalibrationError(hidden_scale, Reason.UNOBSERVABLE, names=tuple(unknown))
