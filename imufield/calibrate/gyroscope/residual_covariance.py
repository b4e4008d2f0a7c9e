"""Covariance of the residuals of the gyroscope fit: every source of error, shared sources counted once.

Sources, all independent: noise of the accelerometer mean of each still (enters the two moves that share it, and, through the
calibration, every other), the rest of the accelerometer's uncertainty, noise of the gyroscope mean of each still, its noise
during each move, and three kinds of scatter whose size the residuals tell:

drift    the bias of each still differs from the fitted one (flicker, and g-sensitivity where it is not fitted)
wander   the bias walks over the session (temperature, slow flicker): a random walk about its mean over the stills
turn     every turn is wrong by a little more than its noise says (non-linearity, sampling, vibration)

A move has the mean of the biases of its two stills. The fitted bias is the mean over the stills of this session.

With ``S = S0 + drift^2 V1 + wander^2 V2 + turn^2 V3`` their sizes are estimated by restricted maximum likelihood, by Fisher
scoring [1]_: with ``P = S^-1 - S^-1 J (J^T S^-1 J)^-1 J^T S^-1``, score and information are

    2 s_k = r^T P V_k P r - tr(P V_k),    2 F_kl = tr(P V_k P V_l)

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
from imufield.calibrate.model.budget import Share
from imufield.calibrate.model.coverage_factors import degrees_of_freedom
from imufield.calibrate.model.models import norm_derivatives, recover_vectors, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, GRAVITY_NAME, AccelerometerParameters, Calibration
from imufield.calibrate.model.rotation import skew
from imufield.calibrate.model.uncertainty import block_diagonal, rms
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray

# Relative step for the derivative of the specific force by the accelerometer's parameters; it is nearly linear in them.
_DIFFERENCE = 1e-6
# Degrees of freedom from which on a scatter is estimated: 4 tell it to a factor of three (chi-square, 95 %).
_LEAST_FREEDOM = 4.0
_OUTWEIGHED = 100.0  # Times the largest variance of the noise: a scatter beside which it does not count.
_MOST_SCATTER = 1e4  # Times the largest squared residual: no scatter beyond it explains anything, and the numbers stay finite.


def force_errors(observations: Observations, calibration: Calibration, rests: int = 0) -> ForceErrors:
    """Return how errors of the accelerometer and its calibration reach the specific force of each still.

    The calibration came from all stills but the last ``rests``.
    """
    parameters = calibration.accelerometer
    p, axes = to_vector(parameters), parameters.quadratic_axes
    raw = observations.mean_raw - parameters.raw_zero

    def difference(change: FloatArray, shift: FloatArray) -> FloatArray:
        size = float(np.abs(change).max() + np.abs(shift).max())
        ends = (recover_vectors(p + sign * change, raw + sign * shift, axes, parameters.higher) for sign in (1.0, -1.0))
        return (next(ends) - next(ends)) / (2 * size)

    raw_step = _DIFFERENCE * np.abs(raw).max()
    by_noise = np.stack([difference(np.zeros(15), np.eye(3)[k] * raw_step) for k in range(3)], axis=2)
    steps = _DIFFERENCE * np.maximum(np.abs(p), [*np.abs(p[:3]), *[1.0] * 9, *np.abs(p[:3]) / 10])
    by_parameters = np.stack([difference(np.eye(15)[k] * steps[k], np.zeros(3)) for k in range(15)], axis=2)
    # The covariance of the 15 parameters, the part of it that comes from gravity, and that with gravity.
    places = {name: k for k, name in enumerate(calibration.covariance_names)}
    known = [name for name in ACCELEROMETER_NAMES if name in places]
    rows, columns = [ACCELEROMETER_NAMES.index(name) for name in known], [places[name] for name in known]
    covariance, by_gravity, with_gravity = np.zeros((15, 15)), np.zeros((15, 15)), np.zeros(15)
    covariance[np.ix_(rows, rows)] = calibration.covariance[np.ix_(columns, columns)]
    g = places.get(GRAVITY_NAME)
    if g is not None and calibration.covariance[g, g] > 0:
        with_gravity[rows] = calibration.covariance[columns, g]
        by_gravity = np.outer(with_gravity, with_gravity) / calibration.covariance[g, g]
    tau = calibration.quality.between_position_sigma_m_s2
    noise = np.nan_to_num(observations.covariance_raw) + np.diag((tau * parameters.scale) ** 2)
    # The gain of the accelerometer fit: weighted least squares moves its parameters by -C J^T v / s^2 for noise in a mean.
    derivatives = norm_derivatives(p, raw, axes, parameters.higher)
    v = derivatives.raw_gradient
    variance = np.einsum("mi,mij,mj->m", v, noise, v)
    measured = len(raw) - rests
    usable = (variance > 0) & (np.count_nonzero(calibration.positions.used) == measured) & (np.arange(len(raw)) < measured)
    weight = np.where(usable, 1 / np.where(variance > 0, variance, 1.0), 0.0)
    gain = -(derivatives.jacobian * weight[:, None] @ (covariance - by_gravity))[:, :, None] * v[:, None, :]
    # What the covariance holds beyond the noise of these means; rounding must not make it negative.
    values, vectors = np.linalg.eigh(covariance - by_gravity - np.einsum("mij,mjk,mlk->il", gain, noise, gain))
    beyond = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return ForceErrors(
        by_noise=by_noise,
        noise=noise,
        by_parameters=by_parameters,
        gain=gain,
        rest=beyond + by_gravity,
        with_gravity=with_gravity,
        by_gravity=by_gravity,
        freedom=degrees_of_freedom(calibration.quality.student_factor_95),
    )


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
_FROM_ELSEWHERE = ("gravity", "stops", "turntable", "earth_rate", "rate_nonlinearity")
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
    m, s, rows, errors = evaluation.moves, len(data.force), len(evaluation.residual), data.errors
    A, H = x[INVERSE].reshape(3, 3), x[SENSITIVITY].reshape(3, 3)
    stops = range(2 * m + 3 * s, 2 * m + 3 * s + len(data.stops))
    to_tangent = -evaluation.tangent @ skew(evaluation.predicted)
    # d (a / norm(a)) / d a
    to_up = (np.eye(3) - data.up[:, :, None] * data.up[:, None, :]) / np.linalg.norm(data.force, axis=1)[:, None, None]
    # d residual / d specific force of each still, and / d its drift in rad/s: a move has the mean of the biases of its two.
    by_force, drift = np.zeros((rows, s, 3)), np.zeros((rows, 3 * s))
    moves, before, after = np.arange(m), data.moves.before, data.moves.after
    of_moves, drift_of_moves = (part[: 2 * m].reshape(m, 2, s, 3) for part in (by_force, drift))
    of_moves[moves, :, after] += evaluation.tangent @ to_up[after]
    of_moves[moves, :, before] -= evaluation.tangent @ evaluation.carry @ to_up[before]
    for stills in (before, after):
        drift_of_moves[moves, :, stills] += to_tangent @ evaluation.turns.duration / 2
    by_force[2 * m : 2 * m + 3 * s].reshape(s, 3, s, 3)[range(s), :, range(s)] = -H
    drift[2 * m : 2 * m + 3 * s] = np.eye(3 * s)
    by_parameters = by_force.reshape(rows, -1) @ errors.by_parameters.reshape(-1, 15)
    gain = np.swapaxes(errors.gain, 1, 2).reshape(-1, 15)
    by_raw = _by_stills(by_force, errors.by_noise) + (by_parameters @ gain.T).reshape(rows, s, 3)
    noisy = _by_stills(by_raw, errors.noise).reshape(rows, -1)
    rest = by_parameters @ (errors.rest - errors.by_gravity) @ by_parameters.T
    known = {name: np.zeros((rows, rows)) for name in ("gyroscope_within_hold", "gyroscope_moving", "stops", "turntable")}
    known["accelerometer"] = noisy @ by_raw.reshape(rows, -1).T + rest
    known["gravity"] = by_parameters @ errors.by_gravity @ by_parameters.T
    from_means = noisy @ gain
    from_rest = by_parameters @ np.column_stack([errors.rest, errors.with_gravity])
    with_accelerometer = from_rest + np.pad(from_means, ((0, 0), (0, 1)))
    moving = known["gyroscope_moving"]
    moving[: 2 * m, : 2 * m] = block_diagonal(to_tangent @ evaluation.turns.spread @ np.swapaxes(to_tangent, 1, 2))
    within = known["gyroscope_within_hold"]
    within[2 * m : 2 * m + 3 * s, 2 * m : 2 * m + 3 * s] = block_diagonal(A @ data.rate_covariance @ A.T)
    for row, k, sigma in zip(stops, data.stops, data.stop_sigma_rad, strict=True):
        # A stop shares the noise of its move.
        to_stop = -data.up[data.moves.after[k]]
        shared = to_tangent[k] @ evaluation.turns.spread[k] @ to_stop
        moving[row, row] += to_stop @ evaluation.turns.spread[k] @ to_stop
        known["stops"][row, row] = sigma**2
        moving[row, 2 * k : 2 * k + 2] += shared
        moving[2 * k : 2 * k + 2, row] += shared
        for still in (data.moves.before[k], data.moves.after[k]):
            drift[row, 3 * still : 3 * still + 3] += to_stop @ evaluation.turns.duration[k] / 2
    table = data.table
    of_table = slice(rows - 3 * len(table), rows)
    within[of_table, of_table] = block_diagonal(A @ table.covariance_raw @ A.T)
    known["turntable"][of_table, of_table] = block_diagonal(table.rate_covariance)
    turn = np.zeros((rows, rows))
    turning = [*range(2 * m), *stops]
    turn[turning, turning] = 1.0
    walk = drift @ np.kron(random_walk(data.time_s), np.eye(3)) @ drift.T
    return Covariances(known=known, drift=drift @ drift.T, wander=walk, turn=turn, with_accelerometer=with_accelerometer)


def gyroscope_share(name: str, sigma: FloatArray, *, stills: int, accelerometer_freedom: float, input_sigma: float) -> Share:
    """Return a share of the gyroscope's uncertainty.

    Parameters
    ----------
    name : str
    sigma : ndarray, shape (n,)
        Contribution to each of n parameters.
    stills : int
        A bias hangs on the scatter between them, and everything else on their biases: one less is the degrees of freedom.
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


def _by_stills(rows: FloatArray, matrices: FloatArray) -> FloatArray:
    """Return rows times the matrix of each still, shape (r, s, 3) and (s, 3, 3) to (r, s, 3)."""
    return np.swapaxes(np.swapaxes(rows, 0, 1) @ matrices, 0, 1)


def next_scatter(scatter: Scatter, residual: FloatArray, jacobian: FloatArray, parts: Covariances) -> Scatter:
    """Return one step of restricted maximum likelihood towards the sizes of the scatters.

    One keeps its size where it has fewer than four degrees of freedom: the parameters absorb the residuals of three moves, and
    g-sensitivity with one heading for each still those of six stills; what is left of them is rounding.
    """
    P = _projection(parts.total(scatter), jacobian)
    components = (parts.drift, parts.wander, parts.turn)
    products = [P @ V for V in components]
    Pr = P @ residual
    score = np.array([Pr @ V @ Pr - np.trace(PV) for V, PV in zip(components, products, strict=True)])  # 2 s_k
    information = np.array([[np.einsum("ij,ji", a, b) for b in products] for a in products])  # tr(P V_k P V_l)
    now = np.array(scatter) ** 2
    from_stills = _has_freedom(parts.drift, parts.total(Scatter(0.0, 0.0, scatter.turn_rad)), jacobian)
    estimated = np.array([from_stills, from_stills, turns_tell_scatter(scatter, jacobian, parts)])
    # A component at zero that wants to fall stays there.
    free = estimated & ~((now <= 0) & (score <= 0)) & (np.diag(information) > 0)
    step = np.zeros(len(now))
    step[free] = np.linalg.lstsq(information[np.ix_(free, free)], score[free], rcond=None)[0]
    falling = now + step < 0
    if falling.any():
        # The others answer for what the one at its bound cannot take.
        step[falling] = -now[falling]
        rest = free & ~falling
        answer = score[rest] - information[np.ix_(rest, falling)] @ step[falling]
        step[rest] = np.linalg.lstsq(information[np.ix_(rest, rest)], answer, rcond=None)[0]
    # The least variance that a scatter of size one gives to a residual it touches at all; infinite where it touches none.
    least = np.array([np.min(np.diag(V)[np.diag(V) > 0], initial=np.inf) for V in components])
    most = _MOST_SCATTER * float(np.max(residual**2)) / least
    return Scatter(*np.sqrt(np.where(estimated, np.clip(now + step, 0.0, most), now)).tolist())


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
    inverse = np.linalg.inv(S)
    weighted = inverse @ jacobian
    return np.asarray(inverse - weighted @ np.linalg.pinv(jacobian.T @ weighted, hermitian=True) @ weighted.T)


def accelerometer_force(parameters: AccelerometerParameters, mean_raw: FloatArray) -> FloatArray:
    """Return the specific force of slot means without the quadratic term, shape (k, 3): enough for g-sensitivity in a move."""
    s = (mean_raw - parameters.raw_zero) / parameters.scale - parameters.bias_m_s2
    return np.asarray(s @ np.linalg.inv(np.eye(3) + parameters.misalignment_rad).T)
