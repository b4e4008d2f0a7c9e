"""Integrate the gyroscope over moves for given parameters, with the derivative of every turn.

The gyroscope's inverse model is linear in its parameters: with ``n = N - N0`` (``N0`` the mean output at rest)

    w = A n - b - H a,        A = (K E)^-1,  b = A (e - N0),  H = A G

so the rotation vector of a slot is linear in ``A``, ``b`` and ``H`` but for the small coning term (see ``moves``), and with
``W_k`` the matrix that takes a change of the rotation vector of slot k to the frame at the end of the move,

    d turn = sum_k W_k (dA turn_k - db T_k - dH velocity_k)

Vectors of parameters ``x`` hold A row by row (9), b (3), H row by row (9).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.gyroscope.moves import Moves
from imufield.calibrate.model.rotation import cross, exponential, matrix, right_jacobian, running_turns
from imufield.samples import FloatArray

PARAMETERS = 21
INVERSE = slice(0, 9)
BIAS = slice(9, 12)
SENSITIVITY = slice(12, 21)


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """Turns of m moves at one parameter vector.

    Attributes
    ----------
    quaternion : ndarray, shape (m, 4)
        Takes body vectors at the end to the body frame at the start, relative to inertial space.
    jacobian : ndarray, shape (m, 3, 21)
        d turn / d x, rotation vector at the end.
    by_slot : ndarray, shape (k, 3, 3)
        W_k of every slot.
    duration : ndarray, shape (m, 3, 3)
        Sum of W_k T_k: what a constant rate error does.
    spread : ndarray, shape (m, 3, 3)
        Covariance of the turn for white noise of unit density in each raw axis: sum of W_k A A^T W_k^T T_k.
    """

    quaternion: FloatArray
    jacobian: FloatArray
    by_slot: FloatArray
    duration: FloatArray
    spread: FloatArray
    net_rad: FloatArray
    """Sum of the rotation vectors in the frame at the end, shape (m, 3): 2 pi for a whole turn."""


def centre(moves: Moves, rest_raw: FloatArray, force_m_s2: FloatArray) -> Moves:
    """Return the moves with the output at rest taken off, exactly: their slots hold integrals of n, and ``force`` in m/s.

    Parameters
    ----------
    moves : Moves
    rest_raw : ndarray, shape (3,)
        N0.
    force_m_s2 : ndarray, shape (k, 3)
        Mean specific force of each slot.
    """
    slots, T = moves.slots, moves.slots.duration_s[:, None]
    centred = replace(
        slots,
        turn=slots.turn - rest_raw * T,
        moment=slots.moment - rest_raw * T**2 / 2,  # a constant over the slot has the moment T^2 / 2
        area=slots.area + cross(T * slots.turn - 2 * slots.moment, rest_raw),
        force=force_m_s2 * T,
    )
    return replace(moves, slots=centred)


def integrate(x: FloatArray, moves: Moves, noise_density_raw: FloatArray) -> Turns:
    """Return the turns of all moves at ``x``.

    Parameters
    ----------
    x : ndarray, shape (21,)
    moves : Moves
        Centred.
    noise_density_raw : ndarray, shape (3,)
        Raw unit per sqrt(Hz), for ``spread``.
    """
    A, b, H = x[INVERSE].reshape(3, 3), x[BIAS], x[SENSITIVITY].reshape(3, 3)
    slots, first, length = moves.slots, moves.first, moves.length
    T = slots.duration_s[:, None]
    M = np.linalg.inv(A)
    # cof(A) = det(A) A^-T, see moves: A x x A y = cof(A) (x x y)
    cofactor = np.linalg.det(A) * M.T
    coning = slots.area + cross(T * slots.turn - 2 * slots.moment, M @ b)
    vectors = np.asarray(slots.turn @ A.T - b * T - slots.force @ H.T + 0.5 * coning @ cofactor.T)
    running = running_turns(exponential(vectors), first)
    last = first + length - 1
    end = running[last]
    C = matrix(running)
    # W_k = (turn from slot k to the end)^T Jr(vector of slot k)
    to_end = np.swapaxes(np.repeat(C[last], length, axis=0), 1, 2) @ C
    W = to_end @ right_jacobian(vectors)

    def products(left: FloatArray, right: FloatArray) -> FloatArray:
        """Return the sum of left^T right over the slots of each move: one product of long matrices a move."""
        ends = zip(first * left.shape[1], (last + 1) * left.shape[1], strict=True)
        rows, others = (factor.reshape(-1, factor.shape[-1]) for factor in (left, right))
        sums = np.array([rows[begin:end].T @ others[begin:end] for begin, end in ends])
        return sums.reshape(-1, left.shape[2], right.shape[2])  # also of no move at all

    by_all = products(W.reshape(-1, 1, 9), np.hstack([slots.turn, slots.force, T])[:, None])
    by_inverse, by_force = (by_all[:, :, columns].reshape(-1, 3, 9) for columns in (slice(3), slice(3, 6)))
    duration = by_all[:, :, 6].reshape(-1, 3, 3)
    # White noise of density n gives each slot the variance n^2 T.
    noise = np.swapaxes(W @ (A * noise_density_raw), 1, 2) * np.sqrt(T)[:, :, None]
    spread = products(noise, noise)
    if slots.bridge.any():
        # A rate that changes anywhere in a gap, evenly likely: a third of the square of the largest error.
        bridged = np.swapaxes(W @ A, 1, 2) * np.sqrt(slots.bridge / 3)[:, None, None]
        spread += products(bridged, bridged)
    return Turns(
        quaternion=end,
        jacobian=np.concatenate([by_inverse, -duration, -by_force], axis=2),
        by_slot=W,
        duration=duration,
        spread=spread,
        net_rad=np.add.reduceat((to_end @ vectors[:, :, None])[:, :, 0], first, axis=0),
    )


def rough_inverse(moves: Moves, window_s: float = 0.1) -> FloatArray:
    """Return A without knowing anything, from how the specific force turns during centred moves, shape (3, 3).

    A vector fixed in space turns in the body as ``da/dt = a x w``, so ``a_2 - a_1 = a x A turn`` for a short window: linear in
    the nine entries. The acceleration of the hand disturbs it; what comes out is good to 10 or 20 %, signs and order of
    the axes included.
    """
    slots = moves.slots
    elapsed = np.cumsum(slots.duration_s) - slots.duration_s
    chain = np.repeat(np.arange(len(moves)), moves.length)
    window = np.floor((elapsed - elapsed[moves.first][chain]) / window_s).astype(np.int64)
    starts = np.concatenate(([0], np.flatnonzero((np.diff(window) != 0) | (np.diff(chain) != 0)) + 1))
    T = np.add.reduceat(slots.duration_s, starts)
    force = np.add.reduceat(slots.force, starts) / T[:, None]
    turn = np.add.reduceat(slots.turn, starts)
    between = np.searchsorted(moves.first, starts, side="right")
    # Three windows in a row must belong to one move.
    same = between[2:] == between[:-2]
    change = (force[2:] - force[:-2])[same]
    middle, gained = force[1:-1][same], ((turn[:-2] + turn[2:]) / 2 + turn[1:-1])[same]
    # Windows in which the hand accelerates the unit count less.
    weight = 1 / (1 + np.abs(np.linalg.norm(middle, axis=1) - np.median(np.linalg.norm(middle, axis=1))))
    rows = np.zeros((len(middle), 3, 9))
    for axis in range(3):
        # (a x e_axis) turn_j multiplies A[axis, j].
        rows[:, :, 3 * axis : 3 * axis + 3] = cross(middle, np.eye(3)[axis])[:, :, None] * gained[:, None, :]
    rows *= weight[:, None, None]
    solution: FloatArray = np.linalg.lstsq(rows.reshape(-1, 9), (change * weight[:, None]).reshape(-1), rcond=None)[0]
    return solution.reshape(3, 3)
