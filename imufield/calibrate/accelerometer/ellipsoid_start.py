"""A start without a preset: the ellipsoid on which the outputs of a still instrument lie, in closed form.

With ``N = M a + c`` (``M = K T``, ``c = K b``, no quadratic term) and norm(a) = g, the outputs satisfy
``(N - c)^T Q (N - c) = g^2`` with ``Q = (M M^T)^-1``: an ellipsoid, linear in nine coefficients once it is written as
``x^T A x + 2 h^T x = 1``. Then ``c = -A^-1 h`` and ``M M^T = (1 + h^T A^-1 h) A^-1 / g^2``; its Cholesky factor is ``M`` in the
lower gauge. Outputs are brought to unit size first, and the fit is repeated about its own centre, where the algebraic
distance it minimises is nearly the geometric one.

Signs: an ellipsoid is symmetric, so the sign of each axis comes from the planned directions, else the preset, else positive.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import MISALIGNMENT, MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS, PARAMETERS
from imufield.dataclass import dataclass
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

FEWEST_FOR_SCALE_AND_BIAS = 6
FEWEST_FOR_MISALIGNMENT = 9
FEWEST_FOR_QUADRATIC = 12
"""One position for each unknown: three scales and three biases, three angles, three quadratic terms."""

_REFITS = 3  # An algebraic fit depends on its origin: each is about the centre that the one before found.
# Square over that of the outputs: an ellipsoid so much larger than what should lie on it is a flat quadric in disguise.
_LARGEST_SHAPE = 100
_DIRECTION_RANGE = 0.2  # An axis whose planned directions vary less than this (unit vectors) says nothing about its sign.


@dataclass(frozen=True, slots=True)
class Signs:
    """The sign of each axis and where it comes from."""

    sign: FloatArray
    source: str
    """"directions", "preset" or "assumed"."""


def closed_form_start(raw: FloatArray, gravity_m_s2: float, sign: FloatArray, *, misalignment: bool = True) -> FloatArray:
    """Return a parameter vector in the lower gauge (quadratic term zero) from zeroed outputs.

    Parameters
    ----------
    raw : ndarray, shape (m, 3)
        At least six positions.
    gravity_m_s2 : float
    sign : ndarray, shape (3,)
        Signs of the scales.
    misalignment : bool
        Whether to try the full ellipsoid first (needs nine positions), or the one along the axes.

    Raises
    ------
    CalibrationError
        If no ellipsoid fits.
    """
    # The ellipsoid is symmetric: with the signs taken out its scales are positive.
    signed = raw * sign
    order = (misalignment, not misalignment)
    fits = (_ellipsoid(signed, full=full) for full in order if not full or len(raw) >= FEWEST_FOR_MISALIGNMENT)
    fit = next((fit for fit in fits if fit is not None), None)
    if fit is None:
        raise CalibrationError(sentence("ellipsoid_start.no_ellipsoid", positions=len(raw)), Reason.UNOBSERVABLE)
    centre, shape = fit
    M = np.linalg.cholesky(shape) / gravity_m_s2
    K = np.diag(M).copy()
    vector = np.zeros(PARAMETERS)
    vector[0:3] = K * sign
    vector[3:6] = centre / K
    vector[MISALIGNMENT] = (M / K[:, None])[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
    return vector


def _ellipsoid(raw: FloatArray, *, full: bool) -> tuple[FloatArray, FloatArray] | None:
    """Return centre and shape S of (N - c)^T S^-1 (N - c) = 1, or None where the best quadric is no ellipsoid."""
    centre = (raw.max(axis=0) + raw.min(axis=0)) / 2
    size = np.ptp(raw, axis=0) / 2
    shape = np.zeros((3, 3))
    for _ in range(_REFITS):
        # x^T A x + 2 h^T x = 1, linear in the entries of A and h
        x = (raw - centre) / size
        columns = [x**2, 2 * x]
        if full:
            columns.append(2 * x[:, (0, 0, 1)] * x[:, (1, 2, 2)])
        coefficients = np.linalg.lstsq(np.hstack(columns), np.ones(len(x)), rcond=None)[0]
        A = np.diag(coefficients[:3])
        if full:
            A[(0, 0, 1), (1, 2, 2)] = A[(1, 2, 2), (0, 0, 1)] = coefficients[6:]
        if np.linalg.eigvalsh(A)[0] <= 0:
            return None
        # c = -A^-1 h,  S = (1 + h^T A^-1 h) A^-1
        h = coefficients[3:6]
        inverse = np.linalg.inv(A)
        unit_shape = (1 + h @ inverse @ h) * inverse
        if not np.diag(unit_shape).max() < _LARGEST_SHAPE:
            return None
        centre = centre + size * (-inverse @ h)
        shape = unit_shape * np.outer(size, size)
    return centre, shape


def find_signs(raw: FloatArray, direction: FloatArray, preset_scale: FloatArray | None) -> Signs:
    """Return the sign of each axis from the planned directions, else the preset, else positive.

    Parameters
    ----------
    raw : ndarray, shape (m, 3)
    direction : ndarray, shape (m, 3)
        Planned "up" in the body frame; NaN where there was none.
    preset_scale : ndarray, shape (3,), optional

    Raises
    ------
    CalibrationError
        If axes are swapped or left-handed, or directions and preset disagree.
    """
    planned = np.isfinite(direction).all(axis=1)
    if planned.sum() < 4 or not np.all(np.ptp(direction[planned], axis=0) > _DIRECTION_RANGE):
        return Signs(np.ones(3), "assumed") if preset_scale is None else Signs(np.sign(preset_scale), "preset")
    design = np.column_stack([direction[planned], np.ones(int(planned.sum()))])
    # Raw output by direction, bias beside it: its diagonal has the signs.
    slope = np.linalg.lstsq(design, raw[planned], rcond=None)[0][:3].T
    follows = np.argmax(np.abs(slope), axis=1)
    for axis in range(3):
        if follows[axis] != axis:
            swapped = sentence("ellipsoid_start.swapped", axis=AXES[axis], follows=AXES[int(follows[axis])])
            raise CalibrationError(swapped, Reason.HANDEDNESS)
    sign: FloatArray = np.sign(np.diag(slope))
    # All three reversed is an instrument that reports gravity instead of specific force; one reversed is a left-handed triad.
    if np.prod(sign) < 0 and np.any(sign > 0):
        raise CalibrationError(sentence("ellipsoid_start.left_handed", axis=AXES[int(np.argmax(sign < 0))]), Reason.HANDEDNESS)
    if preset_scale is not None and np.any(sign != np.sign(preset_scale)):
        opposite = AXES[int(np.argmax(sign != np.sign(preset_scale)))]
        raise CalibrationError(sentence("ellipsoid_start.opposite_preset", axis=opposite), Reason.HANDEDNESS)
    return Signs(sign, "directions")
