"""Integrate the gyroscope over moves for given parameters, with the derivative of every turn.

The gyroscope's inverse model is linear in its parameters: with ``n = N - N0`` (``N0`` the mean output at rest)

    w = A n - b - H a,        A = (K E)^-1,  b = A (e - N0),  H = A G

so the rotation vector of a slot is linear in ``A``, ``b`` and ``H`` but for the small coning term (see ``slots``), and with
``W_k`` the matrix that takes a change of the rotation vector of slot k to the frame at the end of the move,

    d turn = sum_k W_k (dA turn_k - db T_k - dH velocity_k),    W_k = R^T V_k,    V_k = R_k Jr_k

where ``R_k`` is the turn from the start of the move to the end of slot k, ``R`` that of the whole move, and ``Jr_k`` the right
Jacobian of the rotation vector of the slot. All that is wanted are sums over the slots of products of ``V_k`` with what the
slots hold, so they are products of long matrices, one for each move, and ``R`` comes in afterwards.

Vectors of parameters ``x`` hold A row by row (9), b (3), H row by row (9).
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.rotation import (
    cross,
    exponential,
    matrix,
    misfits_rad,
    product,
    right_jacobian,
    running_turns,
    signed_permutations,
    skew,
)
from imufield.calibrate.moves.moves import Moves
from imufield.calibrate.moves.slots import SHORTEST_SLOT_S
from imufield.dataclass import dataclass, replace
from imufield.samples import FloatArray, IntArray, median

PARAMETERS = 21
INVERSE = slice(0, 9)
BIAS = slice(9, 12)
SENSITIVITY = slice(12, 21)
_LEAST_SHOWN = 0.3  # Of the length of what is shown best: less is the hand's acceleration rather than the turn.
_WINDOW_S = 0.1  # Over which a rough inverse takes the specific force to turn at one rate.
# Total angle turned over the angle between the ups, as the range in which an unknown scale is searched, in steps of 9 %.
_TURNS_OF_UP = np.geomspace(0.5, 4.0, 25)


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """Turns of m moves at one parameter vector.

    Attributes
    ----------
    quaternion : ndarray, shape (m, 4)
        Takes body vectors at the end to the body frame at the start, relative to inertial space.
    jacobian : ndarray, shape (m, 3, 21)
        d turn / d x, rotation vector at the end.
    duration : ndarray, shape (m, 3, 3)
        Sum of W_k T_k: what a constant rate error does.
    spread : ndarray, shape (m, 3, 3)
        Covariance of the turn for white noise of unit density in each raw axis: sum of W_k A A^T W_k^T T_k.
    """

    quaternion: FloatArray
    jacobian: FloatArray
    duration: FloatArray
    spread: FloatArray
    net_rad: FloatArray
    """Sum of the rotation vectors in the frame at the end, shape (m, 3): 2 pi for a whole turn."""
    by_rate: FloatArray
    """What a scale error of each axis does that goes with the sense of rotation, or the raw rate squared, shape (m, 3, 6)."""


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
    slots, T = moves.slots, moves.slots.duration_s
    # Row after row of one axis, which is how ``integrate`` reads them.
    turn, moment = (np.ascontiguousarray(values.T) for values in (slots.turn, slots.moment))
    swept = T * turn - 2 * moment
    centred = replace(
        slots,
        turn=(turn - rest_raw[:, None] * T).T,
        moment=(moment - rest_raw[:, None] * T**2 / 2).T,  # a constant over the slot has the moment T^2 / 2
        area=(slots.area.T + cross(swept.T, rest_raw).T).T,
        force=(force_m_s2.T * T).T,
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
    slots, T, M = moves.slots, moves.slots.duration_s, np.linalg.inv(A)
    # Arrays have a row for each component: NumPy's loops along them are long.
    turn, force = slots.turn.T, slots.force.T
    # cof(A) = det(A) A^-T, see slots: A x x A y = cof(A) (x x y)
    coning = 0.5 * np.linalg.det(A) * M.T @ (slots.area.T - skew(M @ b) @ (T * turn - 2 * slots.moment.T))
    by_rate = (np.abs(turn), turn * (turn / np.maximum(T, SHORTEST_SLOT_S)) ** 2)
    # Rows: turn 0 to 2, force 3 to 5, duration 6, coning 7 to 9, what goes with the rate 10 to 15.
    integrals, to_vectors = np.vstack([turn, force, T, coning, *by_rate]), np.column_stack([A, -H, -b, np.eye(3)])
    vectors = (to_vectors @ integrals[:10]).T
    running = running_turns(exponential(vectors), moves.first)
    V = product(matrix(running), right_jacobian(vectors)).reshape(-1, 9).T
    end = running[moves.first + moves.length - 1]
    R = matrix(end)
    sums = _sums(V, integrals, moves).reshape(-1, 3, 3 * len(integrals))
    at_end = (np.swapaxes(R, 1, 2) @ sums).reshape(-1, 3, 3, len(integrals))
    by_turn, by_force = (at_end[..., columns].reshape(-1, 3, 9) for columns in (slice(3), slice(3, 6)))
    duration = at_end[..., 6]

    def spread(weight: FloatArray, covariance: FloatArray) -> FloatArray:
        squares = _sums(V * weight, V, moves).reshape(-1, 3, 3, 3, 3)
        return np.asarray(np.swapaxes(R, 1, 2) @ np.einsum("mijkl,jl->mik", squares, covariance) @ R)

    # White noise of density n gives each slot the variance n^2 T.
    of_noise = spread(T, (A * noise_density_raw**2) @ A.T)
    return Turns(
        quaternion=end,
        jacobian=np.concatenate([by_turn, -duration, -by_force], axis=2),
        duration=duration,
        # A rate that changes anywhere in a gap, evenly likely: a third of the square of the largest error.
        spread=of_noise + spread(slots.bridge / 3, A @ A.T) if slots.bridge.any() else of_noise,
        # Jr leaves its own vector as it is.
        net_rad=np.einsum("mijc,jc->mi", at_end[..., :10], to_vectors),
        by_rate=np.einsum("mijc,jc->mic", at_end[..., 10:], np.tile(A, 2)),
    )


def _sums(factors: FloatArray, others: FloatArray, moves: Moves) -> FloatArray:
    """Return the sums of products over the slots of each move, shape (p, k) and (q, k) to (m, p, q)."""
    spans = map(slice, moves.first.tolist(), (moves.first + moves.length).tolist())
    each = [factors[:, span] @ others[:, span].T for span in spans]
    return np.array(each).reshape(-1, len(factors), len(others))  # also of no move at all


def rough_inverse(moves: Moves, preset: FloatArray | None = None) -> FloatArray:
    """Return A from how the specific force turns during centred moves, shape (3, 3); the preset's where few moves show nothing.

    A vector fixed in space turns in the body as ``da/dt = a x w``, so ``a_2 - a_1 = a x A turn`` for a short window: linear in
    the nine entries. The acceleration of the hand disturbs it; what comes out is good to 10 or 20 %, signs and order of
    the axes included. Where the hand is quick and far from the unit it is good for nothing (``arranged_inverse``).
    """
    slots, starts = moves.slots, _windows(moves)
    T = np.add.reduceat(slots.duration_s, starts)
    force = np.add.reduceat(slots.force, starts) / T[:, None]
    turn = np.add.reduceat(slots.turn, starts)
    between = np.searchsorted(moves.first, starts, side="right")
    # Three windows in a row must belong to one move.
    same = between[2:] == between[:-2]
    change = (force[2:] - force[:-2])[same]
    middle, gained = force[1:-1][same], ((turn[:-2] + turn[2:]) / 2 + turn[1:-1])[same]
    # Windows in which the hand accelerates the unit count less.
    weight = 1 / (1 + np.abs(np.linalg.norm(middle, axis=1) - median(np.linalg.norm(middle, axis=1))))
    rows = np.zeros((len(middle), 3, 9))
    for axis in range(3):
        # (a x e_axis) turn_j multiplies A[axis, j].
        rows[:, :, 3 * axis : 3 * axis + 3] = cross(middle, np.eye(3)[axis])[:, :, None] * gained[:, None, :]
    rows *= weight[:, None, None]
    A = np.zeros(9) if preset is None else preset.ravel()
    rest = (change * weight[:, None]).reshape(-1) - rows.reshape(-1, 9) @ A
    A = A + np.linalg.lstsq(rows.reshape(-1, 9), rest, rcond=None if preset is None else _LEAST_SHOWN)[0]
    return np.asarray(A.reshape(3, 3), dtype=np.float64)


def arranged_inverse(moves: Moves, up: FloatArray) -> FloatArray:
    """Return A of the arrangement of the axes, and one scale, with which centred moves carry up from still to still best.

    No acceleration disturbs that. Shape (3, 3); ``up`` of each still, shape (s, 3).
    """
    starts = _windows(moves)
    move = np.searchsorted(moves.first, starts, side="right") - 1
    place = np.arange(len(starts)) - np.searchsorted(starts, moves.first)[move]
    turns = np.zeros((len(moves), int(place.max()) + 1, 3))
    turns[move, place] = np.add.reduceat(moves.slots.turn, starts)
    before, after, permutations = up[moves.before], up[moves.after], signed_permutations()
    needed = np.arctan2(np.linalg.norm(cross(before, after), axis=1), np.sum(before * after, axis=1)).sum()
    scales = np.linalg.norm(turns, axis=2).sum() / max(float(needed), 1e-9) / _TURNS_OF_UP
    misfits = (misfits_rad(turns, before, after, permutations=permutations, scales=scale[None]) for scale in scales)
    squares = np.vstack([np.sum(each**2, axis=1) for each in misfits])
    row, column = np.unravel_index(int(squares.argmin()), squares.shape)
    return np.asarray(permutations[column] / scales[row])


def _windows(moves: Moves) -> IntArray:
    """Return the first slot of each window of the moves."""
    duration_s = moves.slots.duration_s
    elapsed = np.cumsum(duration_s) - duration_s
    chain = np.repeat(np.arange(len(moves)), moves.length)
    window = np.floor((elapsed - elapsed[moves.first][chain]) / _WINDOW_S).astype(np.int64)
    return np.concatenate(([0], np.flatnonzero((np.diff(window) != 0) | (np.diff(chain) != 0)) + 1))
