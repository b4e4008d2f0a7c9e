"""When to calibrate again: how long the newest parameters hold to an accuracy, from the history of the instrument.

Some days after a calibration its numbers are off by the errors of the file, by the change between the two days, and by what has
drifted since, with the variance

    v(d) = f^2 + 2 s^2 + q d

f is the sigma in the file and s the repeatability. Drift without a direction is a random walk of q a day (its Allan deviation
rises with the root of time); where the history shows a direction, a rate r is in place of it: ``v(d) = f^2 + 2 s^2 + (r d)^2``.
The accuracy A is reached at the d with ``v(d) = A^2``.

s and q are averaged over with the restricted likelihood of the contrasts of all sessions, u ~ N(0, L^T (s^2 + q W + C) L) with
W the earlier of two days, and priors flat in s and in the root of q: the quantiles of d are the forecast and its 95 % interval.
A rate has Student's distribution. Beyond the length of the history nothing is forecast: nobody has seen what then begins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imufield.calibrate.model.uncertainty import student_factor
from imufield.calibrate.sessions.changes import DatedNumbers, Judged, KindTest
from imufield.calibrate.sessions.joint import FEWEST_WITHOUT_PRIOR
from imufield.samples import FloatArray

_GRID = 60  # Values of s, and of q: the likelihood changes by a factor of 2 in some five.
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
    now: float
    """What they know a new day to, 1 sigma, before any drift."""


@dataclass(frozen=True, slots=True)
class NoForecast:
    """Why there is none."""

    why: Literal["short", "now"]
    """Short: too few sessions; now: the accuracy is not reached on any day."""
    sessions: int
    now: float = math.nan
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
    known = 0 if test is None else len(test.sessions)
    if test is None or known < FEWEST_WITHOUT_PRIOR or not np.ptp(test.day) > 0:
        return NoForecast("short", known)
    weight, s, q = _likely(test, test.with_news(judged.news))
    now = math.sqrt(file_sigma**2 + 2 * float(np.sum(weight * s)) ** 2)
    low, middle, high = _quantiles(weight, np.maximum(wanted**2 - file_sigma**2 - 2 * s**2, 0.0) / q)
    drifts = [change for change in judged.news if change.name in test.names and change.first_after is None]
    if now > wanted or middle == 0:
        return NoForecast("now", known, now)
    if drifts:
        fastest = max(drifts, key=lambda change: abs(change.size))
        half = student_factor(judged.repeatability[kind].freedom) * fastest.sigma
        left = math.sqrt(wanted**2 - now**2)
        low, middle, high = (left / max(abs(fastest.size) + off, 0.01 * fastest.sigma) for off in (half, 0.0, -half))
    return Forecast(days=middle, low_days=low, high_days=high, span_days=float(np.ptp(test.day)), now=now)


def _likely(test: KindTest, columns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weight of each pair, s and q of the grid, shape (g,) each."""
    basis = np.linalg.qr(columns, mode="complete")[0][:, columns.shape[1] :]
    since = test.day - test.day[0]
    W = np.kron(np.minimum.outer(since, since), np.eye(len(test.names)))
    u = basis.T @ test.y
    own, walk = (basis.T @ part @ basis for part in (test.covariance, W))
    size = math.sqrt(float(np.mean(u**2 + np.diag(own))))
    steps = np.logspace(*_DECADES, _GRID)
    s, root_q = (part.ravel() for part in np.meshgrid(size * steps, size / math.sqrt(float(since[-1])) * steps))
    log_weight = np.array([
        _log_likelihood(own + one**2 * np.eye(len(u)) + rate**2 * walk, u) for one, rate in zip(s, root_q, strict=True)
    ])  # fmt: skip
    # Grids of logarithms.
    log_weight += np.log(s) + np.log(root_q)
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum(), s, root_q**2


def _log_likelihood(V: FloatArray, u: FloatArray) -> float:
    root = np.linalg.cholesky(V)
    return float(-np.sum(np.log(np.diag(root))) - 0.5 * np.sum(np.linalg.solve(root, u) ** 2))


def _quantiles(weight: FloatArray, values: FloatArray) -> list[float]:
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return [float(values[order[min(int(np.searchsorted(share, chance)), len(order) - 1)]]) for chance in _QUANTILES]
