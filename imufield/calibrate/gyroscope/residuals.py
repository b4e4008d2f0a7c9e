"""Residuals of the gyroscope fit and their derivatives: what moves, stills, stops and turntable rates say.

With ``u`` the direction of the specific force in the body frame (from the calibrated accelerometer), ``R`` the turn of a move
from gyroscope integration (end frame to start frame, inertial), ``T`` its duration and ``w_e`` the Earth's rate in the body
frame at its start::

    move    u_after - R^T exp([w_e T]) u_before       two components at right angles to u
    still   A n - b - H a - w_e                       three components, rad/s

The Earth's rate at a still is ``v u + Q h``: ``v = rate sin(latitude)`` along up, and a horizontal vector ``h`` (2) in axes
``Q`` that are carried from still to still through the moves, so that one unknown ``h`` serves a whole chain of moves. A move
that had to be dropped begins a new chain. Where the latitude is known, ``h`` has a known length and only its direction, one
azimuth, is unknown.

Two more kinds of rows, where the session holds them::

    stop    log(R^T exp([w_e T])) . u_after           a whole turn about the vertical, against a stop: one component
    table   A d - w u                                 d: half the difference of outputs at +w and -w about u; three components

Parameters ``p`` of a fit: the 21 of ``move_integration``, then ``v``, then ``h`` of each chain.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.gyroscope.move_integration import BIAS, INVERSE, PARAMETERS, SENSITIVITY, Turns, integrate
from imufield.calibrate.gyroscope.turntable import TableRows, no_table
from imufield.calibrate.model.rotation import (
    cross,
    exponential,
    from_matrix,
    logarithm,
    matrix,
    multiply,
    one_rotation_matrix,
    skew,
    unit_vectors,
)
from imufield.calibrate.moves.moves import Moves
from imufield.dataclass import dataclass, field, replace
from imufield.samples import FloatArray, IntArray

VERTICAL = PARAMETERS
FIRST_HORIZONTAL = PARAMETERS + 1
_REMEMBERED = 32  # Turns at so many parameter vectors: all of a session's fits, and not all of a search with thousands.
# Change of a turn whose square, 1e-10 rad, is nothing beside the noise of any gyroscope over a move. Of whole turns a bias
# across the axis cancels in first order, but other moves and stills tell it.
_LINEAR_RAD = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceErrors:
    """Where errors of the specific force of s stills come from.

    Attributes
    ----------
    by_noise : ndarray, shape (s, 3, 3)
        d force / d raw accelerometer mean.
    noise : ndarray, shape (s, 3, 3)
        Covariance of the raw accelerometer mean, scatter between positions included.
    by_parameters : ndarray, shape (s, 3, 15)
        d force / d accelerometer parameters.
    gain : ndarray, shape (s, 15, 3)
        d accelerometer parameters / d raw mean of each still: the calibration used them.
    rest : ndarray, shape (15, 15)
        Covariance of the parameters that does not come from those means (gravity, doubt about the model).
    with_gravity : ndarray, shape (15,)
        Covariance of the parameters with gravity.
    by_gravity : ndarray, shape (15, 15)
        The part of ``rest`` that comes from gravity.
    left_out : dict of ndarray, shape (15, k)
        As of the calibration; no part of ``rest``.
    """

    by_noise: FloatArray
    noise: FloatArray
    by_parameters: FloatArray
    gain: FloatArray
    rest: FloatArray
    with_gravity: FloatArray
    by_gravity: FloatArray
    left_out: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeData:
    """s stills and m moves, ready for fitting.

    Attributes
    ----------
    rate_raw : ndarray, shape (s, 3)
        Mean gyroscope output less ``rest_raw``.
    rate_covariance : ndarray, shape (s, 3, 3)
        Of that mean, within the still, without rounding.
    rounding_covariance : ndarray, shape (3 s, 3 s)
        Of what rounding leaves in these means.
    force : ndarray, shape (s, 3)
        Specific force, m/s^2, body frame.
    moves : Moves
        Centred (``centre``); their stills are rows of these.
    chain : ndarray of int, shape (s,)
        Number of the chain that each still belongs to.
    noise_density_raw : ndarray, shape (3,)
        Raw unit per sqrt(Hz).
    rest_raw : ndarray, shape (3,)
    time_s : ndarray, shape (s,)
        Middle of each still.
    errors : ForceErrors
    latitude_deg : float or None
        Of the site; None where it is not known, or not to be used.
    stops : ndarray of int, shape (c,)
        Moves that are whole turns against a stop.
    stop_sigma_rad : ndarray, shape (c,)
        Repeatability of the stop.
    table : TableRows
    """

    rate_raw: FloatArray
    rate_covariance: FloatArray
    rounding_covariance: FloatArray
    force: FloatArray
    moves: Moves
    chain: IntArray
    noise_density_raw: FloatArray
    rest_raw: FloatArray
    time_s: FloatArray
    errors: ForceErrors
    latitude_deg: float | None
    stops: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    stop_sigma_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    table: TableRows = field(default_factory=no_table)
    known_turns: dict[bytes, Turns] = field(default_factory=dict, repr=False, compare=False)
    """Of these moves, at some parameter vectors; a copy with other moves or another noise needs its own."""

    def turns(self, x: FloatArray) -> Turns:
        """Return the turns of all moves at ``x``, shape (21,), to 1e-10 rad: near integrated ones they follow from these."""
        for key, known in reversed(self.known_turns.items()):
            change = known.jacobian @ (x - np.frombuffer(key))
            if np.abs(change).max(initial=0.0) < _LINEAR_RAD:
                return replace(known, quaternion=multiply(known.quaternion, exponential(change)))
        if len(self.known_turns) >= _REMEMBERED:
            del self.known_turns[next(iter(self.known_turns))]
        found = self.known_turns[x.tobytes()] = integrate(x, self.moves, self.noise_density_raw)
        return found

    @property
    def up(self) -> FloatArray:
        """Unit vectors, shape (s, 3)."""
        return unit_vectors(self.force)

    @property
    def chains(self) -> int:
        """Number of chains."""
        return int(self.chain.max()) + 1

    @property
    def parameters(self) -> int:
        """Length of ``p``."""
        return FIRST_HORIZONTAL + 2 * self.chains


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Residuals at one ``p``: 2 m of moves, 3 s of stills, c of stops, 3 t of the turntable."""

    residual: FloatArray
    jacobian: FloatArray
    """Shape (2 m + 3 s + c + 3 t, parameters)."""
    turns: Turns
    tangent: FloatArray
    """Two unit vectors at right angles to u_after, shape (m, 2, 3)."""
    predicted: FloatArray
    """R^T exp([w_e T]) u_before, shape (m, 3)."""
    carry: FloatArray
    """R^T exp([w_e T]), shape (m, 3, 3)."""
    stills: int
    """Number of stills."""

    @property
    def moves(self) -> int:
        """Number of moves."""
        return len(self.tangent)

    def moved(self, change: FloatArray) -> Evaluation:
        """Return it with the predictions of slightly other instrument parameters, shape (21,), in first order.

        All else stays, the Earth's rate too.
        """
        return replace(self, predicted=self.predicted + cross(self.predicted, self.turns.jacobian @ change))

    def angle_error_rad(self, up_after: FloatArray) -> FloatArray:
        """Return the angle between measured and predicted direction of each move, shape (m,)."""
        sine = np.linalg.norm(cross(self.predicted, up_after), axis=1)
        return np.asarray(np.arctan2(sine, np.sum(self.predicted * up_after, axis=1)))


def chains_of(stills: int, before: IntArray, after: IntArray) -> IntArray:
    """Return the chain of each still: stills joined by moves share one."""
    chain = np.arange(stills)
    for first, second in zip(before, after, strict=True):
        chain[chain == chain[second]] = chain[first]  # the two chains are one
    return np.unique(chain, return_inverse=True)[1].astype(np.int64)


def evaluate(p: FloatArray, data: GyroscopeData) -> Evaluation:
    """Return residuals and derivatives at ``p``."""
    x, v, h = p[:PARAMETERS], p[VERTICAL], p[FIRST_HORIZONTAL:].reshape(-1, 2)
    turns, up, duration_s = data.turns(x), data.up, data.moves.duration_s
    Q, carry = carry_azimuth(data, turns, v, h, duration_s=duration_s)
    predicted = (carry @ up[data.moves.before][:, :, None])[:, :, 0]
    tangent = _tangent(up[data.moves.after])
    earth = v * up + (Q @ h[data.chain][:, :, None])[:, :, 0]
    # exp([(w_e + d) T]) u = exp([w_e T]) u + T d x u to first order
    by_earth = tangent @ carry @ skew(up[data.moves.before]) * duration_s[:, None, None]
    residuals, rows = zip(
        _of_moves(data, turns, tangent, predicted, by_horizontal=by_earth @ Q[data.moves.before]),
        _of_stills(data, x, up, earth, Q=Q),
        _of_stops(data, turns, carry),
        _of_table(data, x),
        strict=True,
    )
    n = data.parameters
    return Evaluation(
        residual=np.concatenate([residual.ravel() for residual in residuals]),
        jacobian=np.vstack([part.reshape(-1, n) for part in rows]),
        turns=turns,
        tangent=tangent,
        predicted=predicted,
        carry=carry,
        stills=len(up),
    )


def _of_moves(
    data: GyroscopeData, turns: Turns, tangent: FloatArray, predicted: FloatArray, *, by_horizontal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return u_after - R^T exp([w_e T]) u_before at right angles to u_after, shape (m, 2), and its derivative, (m, 2, n)."""
    residual = (tangent @ (data.up[data.moves.after] - predicted)[:, :, None])[:, :, 0]
    rows = np.zeros((*residual.shape, data.parameters))
    # u_pred' = exp(-d turn) u_pred, so d u_pred = u_pred x d turn.
    rows[:, :, :PARAMETERS] = -tangent @ skew(predicted) @ turns.jacobian
    _fill_horizontal(rows, data.chain[data.moves.before], by_horizontal)
    return residual, rows


def _of_stills(
    data: GyroscopeData, x: FloatArray, up: FloatArray, earth: FloatArray, *, Q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return A n - b - H a - w_e, shape (s, 3), and its derivative, (s, 3, n)."""
    A, H = x[INVERSE].reshape(3, 3), x[SENSITIVITY].reshape(3, 3)
    residual = data.rate_raw @ A.T - x[BIAS] - data.force @ H.T - earth
    rows = np.zeros((*residual.shape, data.parameters))
    _fill_matrix(rows, INVERSE, data.rate_raw)
    rows[:, :, BIAS] = -np.eye(3)
    _fill_matrix(rows, SENSITIVITY, -data.force)
    rows[:, :, VERTICAL] = -up
    _fill_horizontal(rows, data.chain, -Q)
    return residual, rows


def _of_stops(data: GyroscopeData, turns: Turns, carry: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log(R^T exp([w_e T])) . u_after, shape (c,), and its derivative, (c, n)."""
    c = data.stops
    up = data.up[data.moves.after[c]]
    rows = np.zeros((len(c), data.parameters))
    rows[:, :PARAMETERS] = -(up[:, None, :] @ turns.jacobian[c])[:, 0, :]
    return np.sum(logarithm(from_matrix(carry[c])) * up, axis=1), rows


def _of_table(data: GyroscopeData, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A d - w u, shape (t, 3), and its derivative, (t, 3, n)."""
    difference = data.table.half_difference_raw
    residual = difference @ x[INVERSE].reshape(3, 3).T - data.table.rate_rad_s
    rows = np.zeros((*residual.shape, data.parameters))
    _fill_matrix(rows, INVERSE, difference)
    return residual, rows


def _fill_matrix(rows: FloatArray, columns: slice, v: FloatArray) -> None:
    """Write d (X v) / d X for the nine entries of X, which are these columns, row by row; shape (k, 3, n) and (k, 3)."""
    for axis, first in enumerate(range(columns.start, columns.stop, 3)):
        rows[:, axis, first : first + 3] = v


def _fill_horizontal(rows: FloatArray, chain: IntArray, values: FloatArray) -> None:
    """Write the derivative by h of the chain of each, shape (k, r, n), (k,) and (k, r, 2)."""
    for k, column in enumerate(FIRST_HORIZONTAL + 2 * chain):
        rows[k, :, column : column + 2] = values[k]


def carry_azimuth(
    data: GyroscopeData, turns: Turns, v: float, h: FloatArray, *, duration_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the horizontal axes at each still, shape (s, 3, 2), and R^T exp([w_e T]) of each move, shape (m, 3, 3)."""
    up = data.up
    across = skew(up)
    Q = np.swapaxes(_tangent(up), 1, 2).copy()
    back = np.swapaxes(matrix(turns.quaternion), 1, 2)
    carry = np.empty_like(back)
    for k, (i, j) in enumerate(zip(data.moves.before, data.moves.after, strict=True)):
        earth = v * up[i] + Q[i] @ h[data.chain[i]]
        carry[k] = back[k] @ one_rotation_matrix(earth * duration_s[k])
        # The carried axes are made orthonormal again, and at right angles to up.
        axis = (carry[k] @ Q[i])[:, 0]
        first = axis - up[j] * (up[j] @ axis)
        Q[j, :, 0] = first / math.sqrt(first @ first)
        Q[j, :, 1] = across[j] @ Q[j, :, 0]
    return Q, carry


def _tangent(up: FloatArray) -> FloatArray:
    """Return two unit vectors at right angles to each of the unit vectors, shape (m, 3) -> (m, 2, 3)."""
    other = np.eye(3)[np.argmin(np.abs(up), axis=1)]
    first = unit_vectors(cross(up, other))
    return np.stack([first, cross(up, first)], axis=1)
