"""Whitened coordinates of the parameters for swarm solvers: a step of one size means the same in every direction.

Let ``J`` be the Jacobian of ``norm(a)`` at the preset, ``S`` the scale of each parameter and ``G`` the three generators of
turns (``observability``), along which the norm is flat. With ``C`` an orthonormal basis of what is perpendicular to
``S^-1 G``, and ``J S C = U D V^T``, the coordinates ``z`` of

    parameters = origin + S C V D^-1 z

move the m norms by ``U z``, so ``norm(z)`` is the length of the change in m/s^2. No direction of ``z`` is flat and none is
steeper than another, so one step size serves all. The generators are taken out analytically: on body axes a large ``K2``
gives them singular values above any threshold.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import MISALIGNMENT, PARAMETERS, norm_derivatives
from imufield.calibrate.model.observability import generators, parameter_scale
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, QuadraticAxes
from imufield.calibrate.solvers.norm_problem import CostName, NormProblem
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

ALL_FREE = tuple(range(PARAMETERS))
_WORST_CONDITION = 1e6  # Singular values further apart than this are a direction the positions do not show.
_REACH = 5.0  # Bounds of the coordinates: the solution is about one unit away, and this leaves room for what is not linear.
# Relative error of the norm at the start that no instrument has: the preset is in another unit or of another instrument.
_WORST_START = 0.5


def observable_basis(
    vector: FloatArray,
    raw: FloatArray,
    gravity_m_s2: float,
    quadratic_axes: QuadraticAxes = "sensing",
    *,
    free: tuple[int, ...] = ALL_FREE,
) -> FloatArray:
    """Return the basis S C V D^-1 of the whitened coordinates, shape (15, n).

    Parameters
    ----------
    vector : ndarray, shape (15,)
        Preset; the basis belongs to it.
    raw : ndarray, shape (m, 3)
        Zeroed mean outputs.
    gravity_m_s2 : float
    quadratic_axes : {"sensing", "body"}
    free : tuple of int
        Parameters that may move. Where all six misalignments are among them, the three turns of the body frame are taken out.

    Raises
    ------
    CalibrationError
        If there are fewer positions than coordinates, or the positions do not show some direction.
    """
    columns = list(free)
    scale = parameter_scale(vector, gravity_m_s2)
    complement = np.eye(len(columns))
    if set(range(MISALIGNMENT.start, MISALIGNMENT.stop)) <= set(columns):
        # A turn moves K, b and K2 a little too; what it moves of a parameter that is not free is left out.
        turns = (generators(vector) / scale[:, None])[columns]
        complement = np.linalg.qr(turns, mode="complete")[0][:, 3:]
    observed = (norm_derivatives(vector, raw, quadratic_axes).jacobian * scale)[:, columns] @ complement
    m, n = observed.shape
    if m < n:
        few = sentence("swarm_coordinates.too_few", positions=m, needed=n, last=ACCELEROMETER_NAMES[columns[-1]])
        raise CalibrationError(few, Reason.TOO_FEW)
    if not np.isfinite(observed).all():
        raise CalibrationError(sentence("swarm_coordinates.not_finite"), Reason.NOT_FINITE)
    _, D, Vt = np.linalg.svd(observed, full_matrices=False)
    if D[-1] * _WORST_CONDITION < D[0]:
        weakest = ACCELEROMETER_NAMES[columns[int(np.argmax(np.abs(complement @ Vt[-1])))]]
        hidden = sentence("swarm_coordinates.hidden", count=m, parameter=weakest, largest=D[0], least=D[-1])
        condition = float(D[0] / D[-1]) if D[-1] > 0 else float("inf")
        raise CalibrationError(hidden, Reason.UNOBSERVABLE, condition=condition)
    basis = np.zeros((PARAMETERS, complement.shape[1]))
    # S C V D^-1
    basis[columns] = scale[columns, None] * (complement @ (Vt.T / D))
    return basis


def whitened_problem(
    vector: FloatArray,
    raw: FloatArray,
    gravity_m_s2: float,
    *,
    quadratic_axes: QuadraticAxes = "sensing",
    cost_name: CostName = "absolute",
    sigma_m_s2: FloatArray | None = None,
    free: tuple[int, ...] = ALL_FREE,
) -> NormProblem:
    """Return the problem of finding parameters near a preset, in whitened coordinates.

    A unit of the coordinates is the length of the residual vector at the preset: the solution is about one unit away,
    whatever the instrument, so the papers' first step of 0.98 fits. Bounds are five units on each side, which leaves room for
    what is not linear.

    Raises
    ------
    CalibrationError
        If the preset does not belong to these outputs, or the positions do not show what is asked for.
    """
    norm = norm_derivatives(vector, raw, quadratic_axes).norm
    middle = float(median(norm)) if np.isfinite(norm).all() else float("nan")
    if not abs(middle / gravity_m_s2 - 1) <= _WORST_START:
        foreign = sentence("swarm_coordinates.foreign_preset", norm_m_s2=middle, gravity_m_s2=gravity_m_s2, limit=_WORST_START)
        raise CalibrationError(foreign, Reason.UNITS, parameter="accelerometer.scale")
    # A preset that is exact already still needs a step of some size.
    unit = max(float(np.linalg.norm(norm - gravity_m_s2)), 1e-9 * gravity_m_s2)
    basis = unit * observable_basis(vector, raw, gravity_m_s2, quadratic_axes, free=free)
    sigma = np.ones(len(raw)) if sigma_m_s2 is None else sigma_m_s2
    return NormProblem(
        raw=raw,
        gravity_m_s2=gravity_m_s2,
        sigma_m_s2=sigma,
        origin=vector,
        basis=basis,
        quadratic_axes=quadratic_axes,
        cost_name=cost_name,
        reach=_REACH,
    )
