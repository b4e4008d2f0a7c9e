"""Covariance of the residuals of the gyroscope fit: every source of error, shared sources counted once.

Sources, all independent: noise of the accelerometer mean of each still (enters the two moves that share it, and, through the
calibration, every other), the rest of the accelerometer's uncertainty, noise of the gyroscope mean of each still, what rounding
leaves in it (stills that read alike share that), its noise during each move, and three kinds of scatter whose size the
residuals tell:

drift    the bias of each still differs from the fitted one (flicker, and g-sensitivity where it is not fitted)
wander   the bias walks over the session (temperature, slow flicker): a random walk about its mean over the stills
turn     every turn is wrong by a little more than its noise says (non-linearity, sampling, vibration)

A move has the mean of the biases of its two stills. The fitted bias is the mean over the stills of this session.

With ``S = S0 + drift^2 V1 + wander^2 V2 + turn^2 V3`` their sizes are estimated by restricted maximum likelihood, by Fisher
scoring [1]_: with ``P = S^-1 - S^-1 J (J^T S^-1 J)^-1 J^T S^-1``, score and information are

    2 s_k = r^T P V_k P r - tr(P V_k),    2 F_kl = tr(P V_k P V_l)

A step goes no further than ``solvers.scoring`` lets it.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation", J. Am. Stat. Assoc. 72 (1977).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imufield.calibrate.gyroscope.move_integration import INVERSE, SENSITIVITY
from imufield.calibrate.gyroscope.residuals import Evaluation, ForceErrors, GyroscopeData
from imufield.calibrate.model.aliasing import LEFT_OUT_SHARES
from imufield.calibrate.model.budget import Share
from imufield.calibrate.model.models import PARAMETERS as ACCELEROMETER_PARAMETERS
from imufield.calibrate.model.rotation import skew
from imufield.calibrate.model.uncertainty import block_diagonal, inverse_root, rms
from imufield.calibrate.solvers.scoring import cut_at_top
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray

# Degrees of freedom from which on a scatter is estimated: 4 tell it to a factor of three (chi-square, 95 %).
_LEAST_FREEDOM = 4.0
_OUTWEIGHED = 100.0  # Times the largest variance of the noise: a scatter beside which it does not count.
_MOST_SCATTER = 1e4  # Times the largest squared residual: no scatter beyond it explains anything, and the numbers stay finite.


class Scatter(NamedTuple):
    """1 sigma of what the residuals show beyond the noise, in the order of the parts of S."""

    drift_rad_s: float
    wander_rad_s_per_root_s: float
    turn_rad: float


SCATTER_SHARES = ("gyroscope_between_holds", "gyroscope_wander", "gyroscope_turns")
"""Names of the shares of the three."""


_RESIDUALS = "gyroscope"
# Told by the scatter of few residuals; all others come from thousands of samples, from elsewhere, or from the accelerometer.
_TOLD = (*SCATTER_SHARES, "g_sensitivity_not_fitted")
_FROM_ELSEWHERE = ("gravity", "stops", "turntable", "earth_rate", "rate_nonlinearity", *LEFT_OUT_SHARES)
_INPUT_UNITS = {
    "gyroscope_within_hold": "rad/s",
    "gyroscope_moving": "rad",
    "gyroscope_between_holds": "rad/s",
    "gyroscope_wander": "rad/s/sqrt(s)",
    "gyroscope_turns": "rad",
}


@dataclass(frozen=True, kw_only=True)
class Covariances:
    """Parts of S, in the order of ``Evaluation.residual``."""

    known: dict[str, FloatArray]
    """What is known beforehand, by the name of the share."""
    drift: FloatArray
    wander: FloatArray
    turn: FloatArray
    with_accelerometer: FloatArray
    """Covariance of the residuals with the 15 accelerometer parameters and gravity, shape (2 m + 3 s, 16)."""

    @cached_property
    def _all_known(self) -> FloatArray:
        return np.asarray(np.sum([*self.known.values()], axis=0))

    def total(self, scatter: Scatter) -> FloatArray:
        """Return S."""
        S = self._all_known.copy()
        for size, part in zip(scatter, (self.drift, self.wander, self.turn), strict=True):
            if size > 0:
                S += size**2 * part
        return S

    def shares(self, scatter: Scatter) -> dict[str, FloatArray]:
        """Return the terms of S by their names."""
        told = (self.drift, self.wander, self.turn)
        return self.known | {name: size**2 * V for name, size, V in zip(SCATTER_SHARES, scatter, told, strict=True)}


def covariances(evaluation: Evaluation, x: FloatArray, data: GyroscopeData) -> Covariances:
    """Return the parts of S at one evaluation."""
    A, table, rows, m = x[INVERSE].reshape(3, 3), data.table, len(evaluation.residual), 2 * evaluation.moves
    of_stills, of_table = slice(m, m + 3 * len(data.force)), slice(rows - 3 * len(table), rows)
    stops = np.arange(of_stills.stop, of_table.start)
    by_turn, by_force, drift = _derivatives(evaluation, x, data)
    # A stop shares the noise of its move.
    moving = _by_each(by_turn, evaluation.turns.spread).reshape(rows, -1) @ by_turn.reshape(rows, -1).T
    within, at_stops, of_rates, turn = np.zeros((4, rows, rows))
    within[of_stills, of_stills] = block_diagonal(A @ data.rate_covariance @ A.T)
    within[of_table, of_table] = block_diagonal(A @ table.covariance_raw @ A.T)
    # As a drift: a move begins and ends at rest, where it is rounded as the still beside it.
    if data.rounding_covariance.any():
        by_rounding = (drift.reshape(rows, -1, 3) @ A).reshape(rows, -1)
        within += by_rounding @ data.rounding_covariance @ by_rounding.T
    of_rates[of_table, of_table] = block_diagonal(table.rate_covariance)
    at_stops[stops, stops] = data.stop_sigma_rad**2
    turning = [*range(m), *stops]
    turn[turning, turning] = 1.0
    known = {"gyroscope_within_hold": within, "gyroscope_moving": moving, "stops": at_stops, "turntable": of_rates}
    shares, with_accelerometer = _accelerometer_shares(by_force, data.errors)
    walk = (random_walk(data.time_s) @ drift.reshape(rows, -1, 3)).reshape(rows, -1) @ drift.T
    return Covariances(
        known=known | shares, drift=drift @ drift.T, wander=walk, turn=turn, with_accelerometer=with_accelerometer
    )


def _derivatives(evaluation: Evaluation, x: FloatArray, data: GyroscopeData) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d residual / d turn of each move, / d specific force of each still and / d its drift.

    Of shape (r, m, 3), (r, s, 3) and (r, 3 s).
    """
    m, s, rows = evaluation.moves, len(data.force), len(evaluation.residual)
    before, after, moves, stills = data.moves.before, data.moves.after, np.arange(m), np.arange(s)
    stops = 2 * m + 3 * s + np.arange(len(data.stops))
    by_turn, by_force, drift = np.zeros((rows, m, 3)), np.zeros((rows, s, 3)), np.zeros((rows, s, 3))
    of_moves = slice(2 * m)
    by_turn[of_moves].reshape(m, 2, m, 3)[moves, :, moves] = -evaluation.tangent @ skew(evaluation.predicted)
    by_turn[stops, data.stops] = -data.up[after[data.stops]]
    # d (a / norm(a)) / d a
    to_up = (np.eye(3) - data.up[:, :, None] * data.up[:, None, :]) / np.linalg.norm(data.force, axis=1)[:, None, None]
    force_of_moves = by_force[of_moves].reshape(m, 2, s, 3)
    force_of_moves[moves, :, after] += evaluation.tangent @ to_up[after]
    force_of_moves[moves, :, before] -= evaluation.tangent @ evaluation.carry @ to_up[before]
    of_stills = slice(2 * m, 2 * m + 3 * s)
    by_force[of_stills].reshape(s, 3, s, 3)[stills, :, stills] = -x[SENSITIVITY].reshape(3, 3)
    # A move has the mean of the biases of its two stills.
    by_bias = _by_each(by_turn, evaluation.turns.duration) / 2
    drift[:, before] += by_bias
    drift[:, after] += by_bias
    drift[of_stills] = np.eye(3 * s).reshape(3 * s, s, 3)
    return by_turn, by_force, drift.reshape(rows, -1)


def _accelerometer_shares(by_force: FloatArray, errors: ForceErrors) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the shares of accelerometer and gravity, and the covariance of r residuals with both, shape (r, 16)."""
    rows, stills, _ = by_force.shape
    by_parameters = by_force.reshape(rows, -1) @ errors.by_parameters.reshape(-1, ACCELEROMETER_PARAMETERS)
    gain = np.swapaxes(errors.gain, 1, 2).reshape(-1, ACCELEROMETER_PARAMETERS)
    # Noise of a mean comes by the force of its own still, and by the calibration to all.
    by_raw = _by_each(by_force, errors.by_noise) + (by_parameters @ gain.T).reshape(rows, stills, 3)
    noisy = _by_each(by_raw, errors.noise).reshape(rows, -1)
    rest = by_parameters @ (errors.rest - errors.by_gravity) @ by_parameters.T
    with_both = by_parameters @ np.column_stack([errors.rest, errors.with_gravity])
    with_both[:, :ACCELEROMETER_PARAMETERS] += noisy @ gain
    gravity = by_parameters @ errors.by_gravity @ by_parameters.T
    shares = {"accelerometer": noisy @ by_raw.reshape(rows, -1).T + rest, "gravity": gravity}
    for name, root in errors.left_out.items():
        by_term = by_parameters @ root
        shares[name] = by_term @ by_term.T
        with_both[:, :ACCELEROMETER_PARAMETERS] += by_term @ root.T
    return shares, with_both


def gyroscope_share(name: str, sigma: FloatArray, *, stills: int, accelerometer_freedom: float, input_sigma: float) -> Share:
    """Return a share of the gyroscope's uncertainty.

    Parameters
    ----------
    name : str
    sigma : ndarray, shape (n,)
        Contribution to each of n parameters.
    stills : int
        A bias depends on the scatter between them, and all else on their biases: one less is the degrees of freedom.
    accelerometer_freedom : float
        Degrees of freedom of the accelerometer's covariance.
    input_sigma : float
        NaN where there is no single input quantity.
    """
    is_told = name in _TOLD
    return Share(
        name=name,
        kind="B" if name in _FROM_ELSEWHERE else "A",
        residuals=_RESIDUALS if is_told else "",
        degrees_of_freedom=stills - 1 if is_told else accelerometer_freedom if name == "accelerometer" else math.inf,
        input_sigma=input_sigma,
        input_unit=_INPUT_UNITS.get(name, ""),
        sigma=sigma,
    )


def input_sigmas(parts: Covariances, scatter: Scatter) -> dict[str, float]:
    """Return the standard uncertainty of the input quantity of each share that has a single one."""
    own = {name: np.sqrt(np.diag(parts.known[name])) for name in _INPUT_UNITS if name in parts.known}
    return {name: rms(sigma[sigma > 0]) for name, sigma in own.items()} | dict(zip(SCATTER_SHARES, scatter, strict=True))


def random_walk(time_s: FloatArray) -> FloatArray:
    """Return the covariance of a random walk of 1 per sqrt(s) about its own mean, shape (s, s)."""
    elapsed = time_s - time_s.min()
    centring = np.eye(len(elapsed)) - 1 / len(elapsed)
    # The covariance of a walk at two times is the earlier of them.
    return np.asarray(centring @ np.minimum(elapsed[:, None], elapsed) @ centring)


def _by_each(rows: FloatArray, matrices: FloatArray) -> FloatArray:
    """Return rows times the matrix of each still, or move, shape (r, s, 3) and (s, 3, 3) to (r, s, 3)."""
    return np.swapaxes(np.swapaxes(rows, 0, 1) @ matrices, 0, 1)


def next_scatter(scatter: Scatter, residual: FloatArray, jacobian: FloatArray, parts: Covariances) -> Scatter:
    """Return one step of restricted maximum likelihood towards the sizes of the scatters.

    A scatter with fewer than four degrees of freedom keeps its size, as only rounding is left of its residuals. The parameters
    absorb those of three moves; g-sensitivity and a heading for each still absorb those of six stills.
    """
    P = _projection(parts.total(scatter), jacobian)
    V = np.stack([parts.drift, parts.wander, parts.turn])
    PV, VPr = np.stack([P @ V[0], P @ V[1], P * np.diag(V[2])]), V @ (P @ residual)  # V3 is diagonal.
    score = VPr @ P @ residual - np.trace(PV, axis1=1, axis2=2)  # 2 s_k
    information = PV.reshape(3, -1) @ np.swapaxes(PV, 1, 2).reshape(3, -1).T  # tr(P V_k P V_l)
    now = np.array(scatter) ** 2
    from_stills = _has_freedom(parts.drift, parts.total(Scatter(0.0, 0.0, scatter.turn_rad)), jacobian)
    estimated = np.array([from_stills, from_stills, turns_tell_scatter(scatter, jacobian, parts)])
    # A component at zero that wants to fall stays there.
    free = estimated & ~((now <= 0) & (score <= 0)) & (np.diag(information) > 0)
    step = np.zeros(len(now))
    step[free] = _scoring_step(information[np.ix_(free, free)], score[free])
    falling = now + step < 0
    if falling.any():
        # The others answer for what the one at its bound cannot take.
        step[falling] = -now[falling]
        rest = free & ~falling
        answer = score[rest] - information[np.ix_(rest, falling)] @ step[falling]
        step[rest] = _scoring_step(information[np.ix_(rest, rest)], answer)
    step = cut_at_top(step, score, 2 * VPr @ P @ VPr.T - information)
    # The least variance that a scatter of size one gives to a residual it touches at all; infinite where it touches none.
    own = np.diagonal(V, axis1=1, axis2=2)
    least = np.min(own, axis=1, initial=np.inf, where=own > 0)
    most = _MOST_SCATTER * float(np.max(residual**2)) / least
    return Scatter(*np.sqrt(np.where(estimated, np.clip(now + step, 0.0, most), now)).tolist())


def _scoring_step(information: FloatArray, score: FloatArray) -> FloatArray:
    """Return the step of Fisher scoring for k variances, shape (k,)."""
    # Of one size: a wander has 10^20 times the information of a large scatter of turns, which would count as rounding.
    size = np.sqrt(np.diag(information))
    return np.asarray(np.linalg.lstsq(information / np.outer(size, size), score / size, rcond=None)[0] / size)


def turns_tell_scatter(scatter: Scatter, jacobian: FloatArray, parts: Covariances) -> bool:
    """Whether the parameters leave the residuals of the turns enough degrees of freedom to estimate their scatter."""
    return _has_freedom(parts.turn, parts.total(scatter._replace(turn_rad=0.0)), jacobian)


def _has_freedom(V: FloatArray, others: FloatArray, jacobian: FloatArray) -> bool:
    """Whether a scatter has enough degrees of freedom, whatever its size is now, beside other noise of this covariance.

    They are tr(P V) times the scatter's variance where it outweighs all other noise.
    """
    own, noise = np.diag(V), np.diag(others)
    touched = own > 0
    variance = _OUTWEIGHED * float(np.max(noise[touched] / own[touched], initial=0.0))
    if _freedom_at_least(V, others, variance, jacobian.shape[1]) >= _LEAST_FREEDOM:
        return True
    P = _projection(others + variance * V, jacobian)
    return bool(variance * np.sum(P * V) >= _LEAST_FREEDOM)


def _freedom_at_least(V: FloatArray, others: FloatArray, variance: float, parameters: int) -> float:
    """Return a lower bound of the degrees of freedom, at a twentieth of their price.

    With S = others + variance V, the parameters take at most one each of variance tr(S^-1 V). That trace is not smaller than
    the same of some rows alone; and where V is diagonal there, (S^-1)_ii >= 1 / S_ii bounds each of its terms.
    """
    rows = _uncoupled_rows(V)
    own = variance * np.diag(V)[rows]
    return float(np.sum(own / (np.diag(others)[rows] + own))) - parameters


def _uncoupled_rows(V: FloatArray) -> IntArray:
    """Return rows among which V is diagonal: those with fewer entries than every other row that they have an entry with."""
    meets = V != 0
    entries = np.count_nonzero(meets, axis=1)
    fewer = entries[:, None] < entries
    np.fill_diagonal(fewer, val=True)
    return np.flatnonzero((fewer | ~meets).all(axis=1) & (entries > 0))


def _projection(S: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Return P."""
    root = inverse_root(S)
    # Columns of one length, as in the fit; P is the same.
    jacobian = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    weighted = root.T @ (root @ jacobian)
    return np.asarray(root.T @ root - weighted @ np.linalg.pinv(jacobian.T @ weighted, hermitian=True) @ weighted.T)
