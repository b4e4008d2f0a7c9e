"""The gyroscope's model: whether the g-sensitivity G is fitted, and whether one scale serves all rates.

The choice "auto" keeps G where an F test on its nine entries together says 95 %. Where it does not, the best guess of what it
hides goes into the covariance, as for the accelerometer's quadratic term. The fit that is tested knows no latitude: of a wrong
one the error of the vertical Earth rate is a G that is alike on all axes, and that of the horizontal rate has a part in others.

A scale that differs between the senses of rotation, or changes with the rate, is not fitted but tested. With the rate ``s``
along the sensing axes and its largest value ``S``, the output has another ``K f(s) c``:

    asymmetry    f = |s|           nonlinearity    f = s^3 / S^2

In the linearisation of the fit this is a column ``C`` of what the residuals change by: of a move ``sum_k W_k A K f(s_k) T_k``
in place of its turn, of a pair of turntable runs ``f`` of its half difference (nonlinearity) or half sum (asymmetry). Half sums
hold bias, g-sensitivity and centripetal force besides: a constant and ``s^2`` for each axis of the table. With the whitened
residual ``r`` and C less what the Jacobian of the fit explains of them, the score test [1]_ of three columns is

    F = (|P r|^2 / 3) / ((|r|^2 - |P r|^2) / (n - 3)),        P on C

What it does not name is in the uncertainty by what is typical of the grade. A term c ~ N(0, S), S diagonal, leaves -X c of the
whitened residual, X the columns less what is fitted, and moves the parameters by D c, D the gain of the fit times C. So

    c | r ~ N(m, V),    V = (X^T X + S^-1)^-1,    m = -V X^T r

D m is taken off the parameters and D V D^T added to their covariance, as in a fit of both together: all of S where the moves
show nothing, what they leave open where they show something. A term that is named is not drawn towards zero. Of others the root
of S is typical, or what is shown where that is more: an instrument that has a larger one is held too. A term is shown where
its sigma beside the other terms of its kind is small: few moves may tell a sum of terms, and none of them.

A data sheet's nonlinearity n is the largest deviation from the best straight line over the range R, as a share of it. By least
squares that line leaves 2/5 c R of c s^3 / R^2, so c is 5 n / 2 (S / R)^2, and c R / 2 of c |s|, so 2 n is the most that an
asymmetry can be. No data sheet gives it apart; differential electrodes and two beams make both senses alike: a tenth is taken.

References
----------
.. [1] C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Proc. Cambridge Phil. Soc. 44
   (1948).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.calibrate.gyroscope.fit import JointFit, fit_jointly, make_prior
from imufield.calibrate.gyroscope.move_integration import INVERSE, PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.observability import Observability
from imufield.calibrate.gyroscope.residuals import GyroscopeData
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95, f_limit_95, f_tail
from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.rotation import skew
from imufield.calibrate.model.uncertainty import block_diagonal, distinguishing_digits
from imufield.calibrate.moves.slots import SHORTEST_SLOT_S
from imufield.dataclass import dataclass, replace
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

GyroscopeModel = Literal["auto", "basic", "g-sensitive"]
BASIC = np.arange(SENSITIVITY.start)
FULL = np.arange(PARAMETERS)


@dataclass(frozen=True, slots=True)
class ChosenModel:
    """The model that is kept, and its fit."""

    fit: JointFit
    g_sensitive: bool
    hidden_change: FloatArray
    """By how much a rejected g-sensitivity may have moved the rest, shape (parameters,)."""
    sentence: Sentence


def choose_model(data: GyroscopeData, start: FloatArray, observability: Observability, model: GyroscopeModel) -> ChosenModel:
    """Fit what is asked for, or, with "auto", what is significant.

    Raises
    ------
    CalibrationError
        If the g-sensitivity is asked for and the positions cannot show it.
    """
    nothing = np.zeros(data.parameters)
    if model == "basic" or not observability.sensitivity:
        if model == "g-sensitive":
            raise CalibrationError(sentence("model_choice.hidden"), Reason.UNOBSERVABLE)
        why = sentence("model_choice.basic_as_asked" if model == "basic" else "model_choice.basic_as_shown")
        basic = fit_jointly(data, start, observability.free(BASIC))
        return ChosenModel(basic, False, nothing, why)
    free = observability.free(FULL)
    if model == "g-sensitive":
        return ChosenModel(fit_jointly(data, start, free), True, nothing, sentence("model_choice.fitted_as_asked"))
    full = fit_jointly(replace(data, latitude_deg=None), start, free)
    # F statistic of the entries of G against zero.
    places = np.flatnonzero((full.free >= SENSITIVITY.start) & (full.free < SENSITIVITY.stop))
    values = full.p[full.free[places]]
    F = float(values @ np.linalg.pinv(full.covariance[np.ix_(places, places)], hermitian=True) @ values) / len(places)
    F, limit = max(F, np.finfo(float).tiny), f_limit_95(len(places), full.degrees_of_freedom)
    told = dict(zip(("F", "limit"), distinguishing_digits(F, limit), strict=True))
    if limit < F:
        full = full if data.latitude_deg is None else fit_jointly(data, full.p, free, full.scatter)
        return ChosenModel(full, True, nothing, sentence("model_choice.kept", **told))
    basic = fit_jointly(data, start, observability.free(BASIC))
    # Of F only what is above 1, the value of pure noise, speaks for a true G.
    hidden_change = np.sqrt(max(0.0, 1 - 1 / F)) * (full.p - basic.p)
    hidden_change[SENSITIVITY] = 0.0
    return ChosenModel(basic, False, hidden_change, sentence("model_choice.left_out", **told))


SCALES = [0, 4, 8]
"""The diagonal of A."""
_RATE_LEVEL = 0.005  # Of each of the two tests: one clean session of a hundred is named.
# 1 sigma from which on a term counts as not shown, ten times what data sheets of consumer chips give for nonlinearity.
_SHOWN = 0.01
# Of whitened residuals, 0.6 to 1 in simulated sessions: without noise a ratio of rounding means nothing.
_LEAST_VARIANCE = 0.5
_TYPICAL_ASYMMETRY = 0.2  # Half of the difference over a data sheet's nonlinearity, 1 sigma: a tenth of what that allows.
_ANY_SIZE = 1.0  # 1 sigma of a term that is not drawn towards zero: a hundred times what counts as shown.
_EXPLAINED = 1e-9  # Share of a direction's length below which it is rounding.
_ROUNDING = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearity:
    """Whether one scale serves all rates."""

    range_rad_s: FloatArray
    """Largest rate about each axis, shape (3,)."""
    sigma: FloatArray
    """1 sigma of asymmetry (half of the difference) and nonlinearity on the axis that shows them least, shape (2,)."""
    sentences: tuple[Sentence, ...]
    """What is there."""
    matters: bool
    """Whether one of them moves a scale by more than its 95 % limit."""
    moved: FloatArray
    """By how much the fit is off because of them, as far as is known, shape (parameters,)."""
    hidden_root: FloatArray
    """Root of what they add to the covariance of the parameters, shape (parameters, 6)."""


def check_linearity(data: GyroscopeData, fit: JointFit, typical: Grade | None = None) -> Linearity:
    """Test whether the scale is the same for both senses of rotation and at all rates; what is not shown is typical."""
    range_rad_s, C, C_sum = _rate_columns(data, fit)
    r, columns, freedom = _left_over(data, fit, C, C_sum)
    sigma = 1 / np.maximum(np.linalg.norm(columns, axis=0), _ROUNDING)
    found, prior, sentences = np.zeros(6), typical_rate_terms(range_rad_s, typical), []
    for kind, key in enumerate(("model_choice.asymmetry", "model_choice.nonlinearity")):
        # Half of the difference between the senses is what the column stands for.
        to_ppm = 1e6 * (2 - kind)
        alone = [k for k in range(3 * kind, 3 * kind + 3) if sigma[k] < _SHOWN]
        sigma[alone] = _sigma_together(columns[:, alone])
        seen = [k for k in alone if sigma[k] < _SHOWN]
        spare = freedom - len(seen)
        if not seen or spare < 1:
            continue
        size = -np.linalg.lstsq(columns[:, seen], r, rcond=None)[0]
        rest = float(np.sum((r + columns[:, seen] @ size) ** 2))
        variance = max(rest / spare, _LEAST_VARIANCE)
        if f_tail(len(seen), spare, (float(r @ r) - rest) / len(seen) / variance) < _RATE_LEVEL:
            found[seen], prior[seen] = size, _ANY_SIZE
            worst = seen[int(np.argmax(np.abs(size) / sigma[seen]))]
            sizes = {"size_ppm": to_ppm * found[worst], "sigma_ppm": to_ppm * sigma[worst]}
            rate_deg_s = float(np.degrees(range_rad_s[worst % 3]))
            sentences.append(sentence(key, axis=AXES[worst % 3], rate_deg_s=rate_deg_s, **sizes))
            continue
        if typical is not None:
            prior[seen] = np.maximum(prior[seen], np.abs(size))
    # With R = X S^1/2: V = S^1/2 (1 + R^T R)^-1 S^1/2, also where S is zero.
    R = columns * prior
    L = prior[:, None] * np.linalg.inv(np.linalg.cholesky(np.eye(6) + R.T @ R)).T
    of_terms = np.zeros((data.parameters, 6))
    of_terms[fit.free] = fit.gain @ C
    known = np.zeros(data.parameters)
    known[fit.free] = np.sqrt(np.diag(fit.covariance))
    limit = NORMAL_FACTOR_95 * known[SCALES] / np.abs(fit.p[SCALES])
    return Linearity(
        range_rad_s=range_rad_s,
        sigma=sigma.reshape(2, 3).max(axis=1),
        sentences=tuple(sentences),
        matters=bool(np.any(np.abs(found.reshape(2, 3)) > limit)),
        moved=-of_terms @ (L @ (L.T @ (columns.T @ r))),
        hidden_root=of_terms @ L,
    )


def _sigma_together(columns: FloatArray) -> FloatArray:
    """Return 1 sigma of each of some terms, all of them unknown."""
    _, lengths, directions = np.linalg.svd(columns, full_matrices=False)
    lengths = np.maximum(lengths, _EXPLAINED * lengths.max(initial=0.0))
    return np.asarray(np.linalg.norm(directions.T / lengths, axis=1), dtype=np.float64)


def typical_rate_terms(range_rad_s: FloatArray, typical: Grade | None) -> FloatArray:
    """Return 1 sigma of asymmetry (half of the difference) and nonlinearity up to a rate, shape (3,) to (6,)."""
    if typical is None:
        return np.zeros(6)
    share = (range_rad_s / typical.gyroscope.range_si) ** 2
    return typical.rate_nonlinearity * np.concatenate([np.full(3, _TYPICAL_ASYMMETRY), 2.5 * share])


def _left_over(data: GyroscopeData, fit: JointFit, C: FloatArray, C_sum: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return whitened residual and columns (n, 6) less what is fitted explains, and the degrees of freedom."""
    L = np.linalg.cholesky(fit.parts.total(fit.scatter))
    rows = np.linalg.solve(L, np.column_stack([fit.evaluation.residual, C, fit.evaluation.jacobian[:, fit.free]]))
    prior_residual, prior_jacobian = make_prior(data, heading=fit.heading_fitted).rows(fit.p, fit.free)
    of_prior = np.column_stack([prior_residual, np.zeros((len(prior_residual), 6)), prior_jacobian])
    residual, else_held, root = _half_sums(data, fit)
    of_sums = np.linalg.solve(root, np.column_stack([residual, C_sum, else_held]))
    left, freedom = [], 0
    for part in (np.vstack([rows, of_prior]), of_sums):
        values, jacobian = part[:, :7], part[:, 7:]
        size = np.maximum(np.linalg.norm(jacobian, axis=0), _ROUNDING)
        U, lengths, _ = np.linalg.svd(jacobian / size, full_matrices=False)
        U = U[:, lengths > _EXPLAINED]
        left.append(values - U @ (U.T @ values))
        freedom += len(U) - U.shape[1]
    every = np.vstack(left)
    return every[:, 0], every[:, 1:], freedom


def _rate_columns(data: GyroscopeData, fit: JointFit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the largest rates, shape (3,), and what the residuals of the fit and of half sums change by, six columns each."""
    A, now = fit.p[INVERSE].reshape(3, 3), fit.evaluation
    K, slots, m = np.diag(np.linalg.inv(A)), data.moves.slots, fit.evaluation.moves
    raw, s_table = slots.turn.T / np.maximum(slots.duration_s, SHORTEST_SLOT_S), data.table.half_difference_raw / K
    S = np.maximum(np.abs(raw).max(axis=1, initial=0.0) / np.abs(K), np.abs(s_table).max(axis=0, initial=0.0))
    by_turn = now.turns.by_rate * np.concatenate([np.sign(K), 1 / (K * S) ** 2])
    C, t = np.zeros((len(now.residual), 6)), len(s_table)
    C[: 2 * m] = (now.tangent @ skew(now.predicted) @ by_turn).reshape(-1, 6)
    start = 2 * m + 3 * now.stills
    C[start : start + len(data.stops)] = np.einsum("ci,cij->cj", data.up[data.moves.after[data.stops]], by_turn[data.stops])
    # Half differences are odd in the rate, half sums even.
    C[len(C) - 3 * t :, 3:] = -(A * K * (s_table**3 / S**2)[:, None, :]).reshape(-1, 3)
    C_sum = np.zeros((3 * t, 6))
    C_sum[:, :3] = -(A * K * np.abs(s_table)[:, None, :]).reshape(-1, 3)
    return S, C, C_sum


def _half_sums(data: GyroscopeData, fit: JointFit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals (3 t,) of the half sums of turntable pairs, what else they hold, and the root of their covariance."""
    A, table = fit.p[INVERSE].reshape(3, 3), data.table
    # Without ``numpy.unique``, which imports NumPy's masked arrays.
    own = (table.axis[:, None] == np.array(sorted({*table.axis.tolist()}))).astype(np.float64)
    square = np.sum(table.rate_rad_s**2, axis=1)
    else_held = np.kron(np.hstack([own, own * square[:, None]]), np.eye(3))
    covariance = block_diagonal(A @ table.covariance_raw @ A.T + fit.scatter.drift_rad_s**2 * np.eye(3))
    residual: FloatArray = ((table.half_sum_raw - data.rest_raw) @ A.T).ravel()
    return residual, np.asarray(else_held, dtype=np.float64), np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
