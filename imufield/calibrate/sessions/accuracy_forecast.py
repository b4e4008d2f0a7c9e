"""When to calibrate again: how long the newest parameters hold to an accuracy, from the history of the instrument.

Some days after a calibration its numbers are off by the errors of the file, by the change between the two days, and by what has
drifted since, with the mean square

    v(d) = f^2 + 2 s^2 + q d + (r d)^2

f is the sigma in the file, s the repeatability, q a random walk a day (drift without a direction), and r the rate of the
fastest axis. The accuracy A is reached at the d with ``v(d) = A^2``. A walk and a drift that goes on are hard to tell apart:
the forecast has r where the test of the history found a drift and r = 0 elsewhere, and the interval holds those of both. A
step is part of the walk here: what has happened may happen again.

s, q and r are averaged over with the restricted likelihood of the contrasts of all sessions, u ~ N(x r, L^T (s^2 + q W + C)
L) with W the earlier of two days, and priors flat in s, the root of q, and r: the quantiles of d are forecast and 95 %
interval. Beyond the length of the history nothing is forecast: nobody has seen what then begins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from imufield.calibrate.sessions.changes import DatedNumbers, Judged, KindTest
from imufield.calibrate.sessions.joint import FEWEST_WITHOUT_PRIOR
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

_DRAWS = 4000  # They tell the ends of the interval to a few percent.
_GRID = 40  # Values of s, and of q: the likelihood changes by a factor of 2 in some three.
_DECADES = (-2.5, 1.5)  # Of s, and of the root of q, about the size of the contrasts.
_QUANTILES = (0.025, 0.5, 0.975)


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """When the newest parameters pass an accuracy, in days after their session."""

    days: float
    low_days: float
    """Of the 95 % interval."""
    high_days: float
    span_days: float
    """What the history spans."""


@dataclass(frozen=True, slots=True)
class NoForecast:
    """Why there is none."""

    why: Literal["short", "now"]
    """Short: too few sessions; now: the accuracy is not reached on any day."""
    sessions: int
    now: float = math.nan
    """What the newest parameters know a new day to, 1 sigma, before any drift."""
    limit: int = FEWEST_WITHOUT_PRIOR


def forecast(
    sessions: Sequence[DatedNumbers], judged: Judged, kind: str, *, file_sigma: float, wanted: float
) -> Forecast | NoForecast:
    """Return when to calibrate again.

    Parameters
    ----------
    sessions : sequence of DatedNumbers
        In order of time.
    judged : Judged
        What changed among them.
    kind : str
        Of the numbers, such as "bias".
    file_sigma : float
        Of the newest parameters, of the worst axis.
    wanted : float
        1 sigma, in the unit of the numbers as ``file_sigma``.
    """
    test = KindTest.of(sessions, kind)
    known = len(sessions if test is None else test.sessions)
    if test is None or known < FEWEST_WITHOUT_PRIOR or not np.ptp(test.day) > 0:
        return NoForecast("short", known)
    a = len(test.names)
    steady = np.kron((test.day - test.day.mean())[:, None], np.eye(a))
    walk, drift = (_likely(test, lines) for lines in (steady[:, :0], steady))
    is_drifting = any(change.name in test.names and change.first_after is None for change in judged.news)
    foreseen = drift if is_drifting else walk
    now = math.sqrt(file_sigma**2 + 2 * _median(foreseen.s, foreseen.weight) ** 2)
    if now >= wanted:
        return NoForecast("now", known, now)
    ends = [_days(likely, file_sigma, wanted) for likely in (walk, drift)]
    middle = ends[is_drifting][1]
    low, high = min(end[0] for end in ends), max(end[2] for end in ends)
    return Forecast(days=middle, low_days=low, high_days=high, span_days=float(np.ptp(test.day)))


def _median(values: FloatArray, weight: FloatArray) -> float:
    """Return the value that half of the weight is below."""
    order = np.argsort(values)
    return float(values[order][np.searchsorted(np.cumsum(weight[order]), 0.5)])


def _days(likely: _Likely, file_sigma: float, wanted: float) -> list[float]:
    """Return the quantiles of the days until the accuracy is reached."""
    rng = np.random.default_rng(0)
    rows = rng.choice(len(likely.s), _DRAWS, p=likely.weight)
    noise = rng.standard_normal((_DRAWS, likely.rate.shape[1]))
    rates = likely.rate[rows] + np.einsum("dij,dj->di", likely.rate_root[rows], noise)
    fastest = np.max(np.abs(rates), axis=1, initial=0.0)
    q, room = likely.q[rows], np.maximum(wanted**2 - file_sigma**2 - 2 * likely.s[rows] ** 2, 0.0)
    # The positive root of (r d)^2 + q d = room, in the form that holds for r = 0 too.
    days = 2 * room / (q + np.sqrt(q**2 + 4 * fastest**2 * room))
    return [float(quantile) for quantile in np.quantile(days, _QUANTILES)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Likely:
    """The grid of s and q, g pairs."""

    weight: FloatArray
    s: FloatArray
    q: FloatArray
    rate: FloatArray
    """Of k drifts, shape (g, k)."""
    rate_root: FloatArray
    """Root of their covariance, shape (g, k, k)."""


def _likely(test: KindTest, lines: FloatArray) -> _Likely:
    """Return how likely each pair is, and what it makes of drifts, columns of shape (m, k)."""
    basis = np.linalg.qr(test.axes, mode="complete")[0][:, len(test.names) :]
    since = test.day - test.day[0]
    W = np.kron(np.minimum.outer(since, since), np.eye(len(test.names)))
    u, x = basis.T @ test.y, basis.T @ lines
    own, walk = (basis.T @ part @ basis for part in (test.covariance, W))
    size = math.sqrt(float(np.mean(u**2 + np.diag(own))))
    steps = np.logspace(*_DECADES, _GRID)
    s, root_q = (part.ravel() for part in np.meshgrid(size * steps, size / math.sqrt(float(since[-1])) * steps))
    k = x.shape[1]
    log_weight, rate, rate_root = np.zeros(len(s)), np.zeros((len(s), k)), np.zeros((len(s), k, k))
    for j, (one, other) in enumerate(zip(s, root_q, strict=True)):
        root = np.linalg.cholesky(own + one**2 * np.eye(len(u)) + other**2 * walk)
        white = np.linalg.solve(root, np.column_stack([x, u]))
        Q, R = np.linalg.qr(white[:, :-1])
        rest = white[:, -1] - Q @ (Q.T @ white[:, -1])
        log_weight[j] = -np.sum(np.log(np.diag(root))) - np.sum(np.log(np.abs(np.diag(R)))) - 0.5 * np.sum(rest**2)
        rate_root[j] = np.linalg.inv(R)
        rate[j] = rate_root[j] @ Q.T @ white[:, -1]
    # Grids of logarithms.
    log_weight += np.log(s) + np.log(root_q)
    weight = np.exp(log_weight - log_weight.max())
    return _Likely(weight=weight / weight.sum(), s=s, q=root_q**2, rate=rate, rate_root=rate_root)
