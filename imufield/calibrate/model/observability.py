"""What the norm of the specific force can show of the 15 parameters, and what it cannot.

A turn ``a' = R a`` of the body frame leaves norm(a) as it is. With ``M = T R^T`` and ``D = diag(M)`` the instrument is
the same when

    T' = D^-1 M,  K' = K D,  b' = D^-1 b,  K2' = K2 D**2

(exactly for quadratic axes "sensing"). For a small turn ``R = I + [w]x`` its derivative is the 15 x 3 matrix of
``generators``: three directions in parameter space in which the norm is flat, at every set of positions. They are taken out
analytically; a threshold on singular values cannot do it, because a large ``K2`` on body axes lifts them over any.

What is left is judged in scaled coordinates, where a unit step of each parameter weighs as 1 m/s^2 at 1 g. There the part of a
column of the Jacobian that the columns before it do not explain has a length, its observability. A position put halfway
between two faces gives a length of about 0.5 to the misalignment of those two axes; sigma of a parameter is at least s_i over
its length.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import (
    BIAS,
    MISALIGNMENT,
    MISALIGNMENT_COLUMNS,
    MISALIGNMENT_ROWS,
    PARAMETERS,
    QUADRATIC,
    SCALE,
    NormDerivatives,
    alignment_matrix,
)
from imufield.calibrate.model.result import ACCELEROMETER_NAMES
from imufield.calibrate.model.rotation import skew
from imufield.dataclass import dataclass
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, LARGEST_OUTPUT, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

LOWER_GAUGE_COLUMNS = (0, 1, 2, 3, 4, 5, 8, 10, 11, 12, 13, 14)
"""The parameters that stay free where T is lower triangular: K, b, T_yx, T_zx, T_zy, K2."""

WEAKEST_COLUMN = 0.15
"""A parameter whose column has less than this length of its own counts as unobservable.

The 24-position schemes give misalignment 1.0 and the quadratic term 0.7 or more, a hand-held session that shows one axis once
0.24; edges alone, placed to 0.05 rad, give the quadratic term 0.03.
"""

_FLATTEST = 0.1  # Thickness over spread of the outputs of positions in one plane, placed to 5 deg; 24 positions have 0.9.
_DEAD = 1e-3  # Spread of an axis over that of the widest at which it counts as dead.
# Positions in a plane keep their distance to a degree or so; those of a scheme, seen along an axis, go through the middle.
_ROUND = 0.2
OUTPUT_SIZE = (1e-9, LARGEST_OUTPUT)
"""Spread and size of outputs: nano-units are below the step of any instrument."""

FACE_COSINE = float(np.cos(np.radians(15.0)))
"""Nearer than 15 deg to an axis a position is a face. Faces alone show misalignment and quadratic term only by accident of
their placement (a length of 0.2 to 0.4 for 24 positions placed to 0.1 rad), so those are not fitted from them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observability:
    """What m positions show."""

    rank: int
    """Of the gauge-free problem: at most 12 with the quadratic term, 9 without."""
    condition: float
    """Largest over smallest singular value among those counted in ``rank``, scaled coordinates."""
    free: tuple[int, ...]
    """Observable parameters in the lower gauge, indices into ACCELEROMETER_NAMES."""
    unobservable: tuple[str, ...]
    """Names of the parameters these positions cannot show (in the lower gauge)."""


def parameter_scale(vector: FloatArray, gravity_m_s2: float) -> FloatArray:
    """Return the step of each parameter that weighs as 1 m/s^2 at 1 g, shape (15,)."""
    K = np.abs(vector[SCALE])
    ones = np.ones(3)
    g = gravity_m_s2
    return np.concatenate([K / g, ones, np.full(6, 1 / g), K / g**2])


def generators(vector: FloatArray) -> FloatArray:
    """Return d parameters / d w for a turn a' = a + w x a of the body frame, shape (15, 3)."""
    T = alignment_matrix(vector)
    result = np.zeros((PARAMETERS, 3))
    # (I + [e]x)^T = I - [e]x, so dM = -T [e]x
    for axis, dM in enumerate(-T @ skew(np.eye(3))):
        d = np.diag(dM)
        dT = dM - d[:, None] * T
        result[SCALE, axis] = vector[SCALE] * d
        result[BIAS, axis] = -vector[BIAS] * d  # b' = D^-1 b
        result[MISALIGNMENT, axis] = dT[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
        result[QUADRATIC, axis] = 2 * vector[QUADRATIC] * d  # K2' = K2 D^2
    return result


def observe(derivatives: NormDerivatives, vector: FloatArray, gravity_m_s2: float, *, quadratic: bool) -> Observability:
    """Judge what positions show, from the derivatives of the norm.

    Parameters
    ----------
    derivatives : NormDerivatives
        At ``vector``, of m positions.
    vector : ndarray, shape (15,)
    gravity_m_s2 : float
    quadratic : bool
        Whether the quadratic term is asked for.
    """
    columns = np.arange(PARAMETERS if quadratic else PARAMETERS - 3)
    gauge_free = [column for column in LOWER_GAUGE_COLUMNS if column in columns]
    scale = parameter_scale(vector, gravity_m_s2)
    scaled = (derivatives.jacobian * scale)[:, columns]
    turns = (generators(vector) / scale[:, None])[columns]
    # By the raw offset in place of the bias: what positions show does not depend on the raw zero that is stated.
    bias_by_scale = vector[BIAS] * scale[SCALE] / vector[SCALE]
    scaled[:, SCALE] -= bias_by_scale * scaled[:, BIAS]
    turns[BIAS] += bias_by_scale[:, None] * turns[SCALE]
    # The three flat directions are taken out before rank and condition are judged.
    complement = np.linalg.qr(turns, mode="complete")[0][:, 3:]
    values = np.asarray(np.linalg.svd(scaled @ complement, compute_uv=False), dtype=np.float64)
    # Faces alone leave misalignment and quadratic term to the accident of placement, see FACE_COSINE.
    faces_only = bool(np.all(np.abs(derivatives.a).max(axis=1) > FACE_COSINE * derivatives.norm))
    sought = gauge_free[:6] if faces_only else gauge_free
    lengths = unexplained_lengths(scaled[:, sought], WEAKEST_COLUMN)
    free = [column for column, length in zip(sought, lengths, strict=True) if length > WEAKEST_COLUMN]
    hidden = tuple(ACCELEROMETER_NAMES[column] for column in gauge_free if column not in free)
    rank = len(free)
    condition = float(values[0] / values[rank - 1]) if 0 < rank <= len(values) else np.inf
    return Observability(rank=rank, condition=condition, free=tuple(free), unobservable=hidden)


def unexplained_lengths(columns: FloatArray, least: float = 0.0) -> list[float]:
    """Return the length of the part of each column that the columns before it do not explain (Gram-Schmidt), shape (m, n).

    A column that is not longer than ``least`` explains nothing of those after it.
    """
    lengths: list[float] = []
    basis = np.zeros((len(columns), 0))
    for column in columns.T:
        rest = column
        for _ in range(2):  # the second pass takes away what rounding left
            rest = rest - basis @ (basis.T @ rest)
        lengths.append(float(np.linalg.norm(rest)))
        if lengths[-1] > least:
            basis = np.column_stack([basis, rest / lengths[-1]])
    return lengths


def require_scale_and_bias(observability: Observability) -> None:
    """Refuse positions that do not even show scale and bias of each axis.

    Raises
    ------
    CalibrationError
        Naming the axis and the positions that are missing.
    """
    missing = sorted({ACCELEROMETER_NAMES[column][-1] for column in range(6) if column not in observability.free})
    if missing:
        sides = [f"+{axis} up and -{axis} up" for axis in missing]
        axis_names = " and ".join(missing)
        confused = sentence(
            "observability.scale_and_bias", axis_names=axis_names, least_observability=WEAKEST_COLUMN, sides=sides
        )
        raise CalibrationError(confused, Reason.UNOBSERVABLE, axes=tuple(missing))


def require_outputs(raw: FloatArray, names: tuple[str, ...]) -> None:
    """Refuse outputs that no instrument sends.

    Raises
    ------
    CalibrationError
    """
    small, large = OUTPUT_SIZE
    sizes = np.abs(raw).max(axis=1)
    worst = int(np.argmax(sizes))
    if sizes[worst] > large:
        number, output = worst + 1, raw[worst].tolist()
        values = {"position": names[worst], "number": number, "count": len(raw), "output": output, "limit": large}
        raise CalibrationError(sentence("observability.output_size", **values), Reason.BOUNDS)
    spread = float(np.ptp(raw, axis=0).max())
    if spread < small:
        same = sentence("observability.same_outputs", count=len(raw), spread=spread, limit=small)
        raise CalibrationError(same, Reason.UNOBSERVABLE)


def require_space(raw: FloatArray) -> None:
    """Refuse outputs that do not fill space: a dead axis, or all positions in one plane.

    Raises
    ------
    CalibrationError
    """
    spread = np.ptp(raw, axis=0)
    widest = float(spread.max())
    # Fewer than three rows have no third direction unless it is asked for.
    sizes, directions = np.linalg.svd(raw - raw.mean(axis=0), full_matrices=len(raw) < 3)[1:]
    flatness = float(sizes[2] / sizes[0])
    axis = int(np.argmin(spread))
    # Two axes that stay in a vertical plane keep their distance to a centre.
    others = np.delete(raw, axis, axis=1)
    centre = (others.max(axis=0) + others.min(axis=0)) / 2
    distance = np.linalg.norm((others - centre) / np.maximum(np.ptp(others, axis=0), np.finfo(float).tiny), axis=1)
    is_circle = np.ptp(distance) < _ROUND * distance.max()
    if spread[axis] <= _DEAD * widest and not is_circle:
        dead = {"axis": AXES[axis], "output": raw[0, axis], "spread": spread[axis], "limit": _DEAD * widest}
        raise CalibrationError(sentence("observability.dead_axis", **dead), Reason.SATURATED)
    if flatness < _FLATTEST:
        missing = AXES[int(np.argmax(np.abs(directions[2])))]
        plane = {"count": len(raw), "thickness": flatness, "least_thickness": _FLATTEST, "axis": missing}
        raise CalibrationError(sentence("observability.one_plane", **plane), Reason.UNOBSERVABLE)
