"""Joint adjustment of sessions of one instrument: generalised least squares on their numbers, all at once.

Session i has the numbers ``y_i`` of its own solve and the covariance ``S_i`` of their errors for a known gravity:

    y_i = H_i theta + delta_i + c_i gamma + e_i,    e_i ~ N(0, S_i),    gamma ~ N(0, 1) of the site

``H_i`` picks the numbers that the session has. ``delta_i`` is the day: independent, with one variance for the three axes of
each kind in ``DAILY``, zero for all others, which the sessions share. ``gamma`` is the error of gravity in its sigmas: the same
in all sessions of a site, independent between sites, so it is a further unknown with a prior.

The variances are those of restricted maximum likelihood, kind by kind until they stand still: with one number for each session
and axis of a kind in place of ``theta`` and ``delta``, the adjustment gives these numbers and their covariance, and that is all
that the data say of the variance of that kind (``repeatability``), the others given.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from imufield.calibrate.model.coverage_factors import f_tail, student_factor
from imufield.calibrate.sessions.kinds import DAILY, kind_of
from imufield.calibrate.sessions.repeatability import (
    Contrasts,
    Repeatability,
    contrasts,
    reml_variance,
    repeatability,
    sigmas,
    studentised,
)
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

FEWEST = 2
"""Sessions that are solved together."""
FEWEST_WITHOUT_PRIOR = 5
"""Sessions that tell their repeatability alone, and which of them is outlying."""
_SWEEPS = 30  # At most: kinds hardly correlate, and three or four are enough.
_SETTLED = 1e-4  # Relative change of a deviation, against a sampling error of a tenth and more.
_OUTLYING = 0.01  # Chance that any number of any session is called outlying.
_FEWEST_FOR_TREND = 3
_TREND_SIGMA = 2.0  # From the first session to the last: less would be called a trend in 1 of 20 that only seem in order.
_DIFFERENT = 0.001  # Chance that what the sessions share is called different.


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionNumbers:
    """The numbers of one session, n of them."""

    names: tuple[str, ...]
    """Kind and place, such as "bias x"."""
    values: FloatArray
    covariance: FloatArray
    """Of the errors that another session draws anew, gravity known, shape (n, n)."""
    by_gravity: FloatArray
    """Change of the values by 1 sigma of gravity, shape (n,)."""
    site: str
    """Sessions with the same have the same error of gravity."""
    freedom: int
    """Degrees of freedom of the covariance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Daily:
    """What a kind of numbers does from day to day, on a axes."""

    repeatability: Repeatability
    places: tuple[str, ...]
    mean_sigma: FloatArray
    """Of the mean over all days, shape (a,): the 95 % half width over 1.96, so that few sessions count for what they are."""
    day_sigma: FloatArray
    """The same of a new day."""


@dataclass(frozen=True, slots=True)
class Outlying:
    """A number of a session that the other sessions contradict."""

    session: int
    name: str
    off_sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """Sessions as one: n numbers."""

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    """Of a new day, shape (n, n), gravity's error included."""
    shares: Mapping[str, FloatArray]
    """What it is the sum of, by name, each of shape (n, n)."""
    with_gravity: Mapping[str, FloatArray]
    """By site, covariance of the errors of the numbers and of the gravity taken, in its sigmas, shape (n,)."""
    gravity_variance: Mapping[str, float]
    """By site, what is left of the variance of gravity, 1 at most."""
    daily: Mapping[str, Daily]
    outlying: tuple[Outlying, ...]
    """Empty with fewer than ``FEWEST_WITHOUT_PRIOR`` sessions: two of three cannot outvote the third."""
    trends: tuple[str, ...]
    """Names of the numbers that only rise, or only fall, by more than their errors: perhaps a drift, and no scatter of days."""
    differs: bool
    """Whether what the sessions share contradicts their errors."""


class _Unknown(NamedTuple):
    what: Literal["theta", "day", "site"]
    name: str
    """Of the number, or of the site."""
    session: int | None = None
    """Which has a number of its own."""


@dataclass(frozen=True, slots=True)
class _Adjusted:
    columns: tuple[_Unknown, ...]
    values: FloatArray
    covariance: FloatArray
    weighted_square: float


def adjust(sessions: Sequence[SessionNumbers], prior_scales: Mapping[str, float]) -> Joint:
    """Solve sessions together.

    Parameters
    ----------
    sessions : sequence of SessionNumbers
        Two at least, in order of time.
    prior_scales : mapping
        By kind, what the repeatability typically is at most, used with fewer than ``FEWEST_WITHOUT_PRIOR`` sessions.
    """
    names = tuple(dict.fromkeys(name for session in sessions for name in session.names))
    counted = {kind: sum(any(kind_of(name) == kind for name in session.names) for session in sessions) for kind in DAILY}
    kinds = [kind for kind in DAILY if counted[kind] >= FEWEST]
    found = _variances(sessions, names, kinds)
    variances = {kind: reml_variance(of_kind) for kind, of_kind in found.items()}
    adjusted = _adjust(sessions, names, variances)
    n = len(names)
    values, own = adjusted.values[:n], np.sqrt(np.diag(adjusted.covariance))
    daily = {}
    for kind, of_kind in found.items():
        rows = _rows(names, kind)
        prior_scale = prior_scales.get(kind, math.inf) if counted[kind] < FEWEST_WITHOUT_PRIOR else math.inf
        spread = sigmas(of_kind, prior_scale, values[rows])
        mean_sigma = np.maximum(spread.mean, own[rows])
        daily[kind] = Daily(
            repeatability=repeatability(of_kind),
            places=tuple(names[k].rpartition(" ")[2] for k in rows),
            mean_sigma=mean_sigma,
            day_sigma=np.maximum(spread.day, mean_sigma),
        )
    sites = {column.name: k for k, column in enumerate(adjusted.columns) if column.what == "site"}
    covariance, shares = _of_new_day(names, adjusted.covariance, [*sites.values()], daily)
    return Joint(
        names=names,
        values=values,
        covariance=covariance,
        shares=shares,
        # gamma is how far the gravity taken is off the true one; the unknown numbers go the other way than their errors.
        with_gravity={site: -adjusted.covariance[:n, k] for site, k in sites.items()},
        gravity_variance={site: float(adjusted.covariance[k, k]) for site, k in sites.items()},
        daily=daily,
        outlying=_outlying(sessions, found, variances) if len(sessions) >= FEWEST_WITHOUT_PRIOR else (),
        trends=tuple(name for kind, of_kind in found.items() for name in _trends(kind, of_kind, names)),
        differs=_differs(sessions, names, adjusted),
    )


def _of_new_day(
    names: tuple[str, ...], adjusted: FloatArray, sites: list[int], daily: Mapping[str, Daily]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return ``Joint.covariance`` and ``Joint.shares`` from the covariance of an adjustment and its rows of sites."""
    n = len(names)
    with_sites = adjusted[:n, sites]
    by_gravity = with_sites @ np.linalg.solve(adjusted[np.ix_(sites, sites)], with_sites.T)
    factor, variance_of_day = np.ones(n), np.zeros(n)
    for kind, of_kind in daily.items():
        rows = _rows(names, kind)
        factor[rows] = of_kind.mean_sigma / np.sqrt(np.diag(adjusted)[rows])
        variance_of_day[rows] = of_kind.day_sigma**2 - of_kind.mean_sigma**2
    # Correlations, those with gravity too, are those of the mean; the day is independent of everything.
    of_mean, by_gravity = (part * np.outer(factor, factor) for part in (adjusted[:n, :n], by_gravity))
    day = np.diag(variance_of_day)
    return of_mean + day, {"sessions": of_mean - by_gravity, "gravity": by_gravity, "day_to_day": day}


def _rows(names: tuple[str, ...], kind: str) -> list[int]:
    return [k for k, name in enumerate(names) if kind_of(name) == kind]


def _variances(sessions: Sequence[SessionNumbers], names: tuple[str, ...], kinds: list[str]) -> dict[str, Contrasts]:
    """Return the contrasts of each kind, given the variances of the others that the same contrasts tell."""
    variances = dict.fromkeys(kinds, 0.0)
    found: dict[str, Contrasts] = {}
    for _ in range(_SWEEPS):
        before = dict(variances)
        for kind in kinds:
            found[kind] = _contrasts_of(sessions, names, {**variances, kind: 0.0}, kind)
            variances[kind] = reml_variance(found[kind])
        if all(abs(math.sqrt(variances[kind]) - math.sqrt(before[kind])) <= _SETTLED * _size(found[kind]) for kind in kinds):
            break
    return found


def _size(found: Contrasts) -> float:
    return math.sqrt(float(np.mean(found.u**2 + found.own_variance)))


def _contrasts_of(
    sessions: Sequence[SessionNumbers], names: tuple[str, ...], variances: Mapping[str, float], kind: str
) -> Contrasts:
    adjusted = _adjust(sessions, names, variances, free=kind)
    rows = [k for k, column in enumerate(adjusted.columns) if column.what == "day"]
    places = [name for name in names if kind_of(name) == kind]
    axes = np.array([[adjusted.columns[k].name == place for place in places] for k in rows], dtype=np.float64)
    return contrasts(adjusted.values[rows], axes, adjusted.covariance[np.ix_(rows, rows)])


def _adjust(
    sessions: Sequence[SessionNumbers], names: tuple[str, ...], variances: Mapping[str, float], free: str = ""
) -> _Adjusted:
    """Adjust once with known variances; the kind ``free`` has an unknown for each session and axis."""
    columns = [_Unknown("theta", name) for name in names if kind_of(name) != free]
    columns += [_Unknown("day", name, i) for i, each in enumerate(sessions) for name in each.names if kind_of(name) == free]
    columns += [_Unknown("site", site) for site in dict.fromkeys(session.site for session in sessions)]
    place = {column: k for k, column in enumerate(columns)}
    # Gravity's error in its sigmas is zero with a sigma of one.
    normal = np.diag([float(column.what == "site") for column in columns])
    right, square = np.zeros(len(columns)), 0.0
    for i, session in enumerate(sessions):
        n = len(session.names)
        X = np.zeros((n, len(columns)))
        unknowns = [_Unknown("day", name, i) if kind_of(name) == free else _Unknown("theta", name) for name in session.names]
        X[range(n), [place[unknown] for unknown in unknowns]] = 1.0
        X[:, place[_Unknown("site", session.site)]] = session.by_gravity
        day = np.diag([variances.get(kind_of(name), 0.0) for name in session.names])
        weighted = np.linalg.solve(session.covariance + day, np.column_stack([X, session.values]))
        normal += X.T @ weighted[:, :-1]
        right += X.T @ weighted[:, -1]
        square += float(session.values @ weighted[:, -1])
    covariance = np.linalg.inv(normal)
    values = covariance @ right
    return _Adjusted(tuple(columns), values, (covariance + covariance.T) / 2, square - float(values @ right))


def _outlying(
    sessions: Sequence[SessionNumbers], found: Mapping[str, Contrasts], variances: Mapping[str, float]
) -> tuple[Outlying, ...]:
    """Test each number of each session against what the others predict."""
    tested = sum(len(of_kind.y) for of_kind in found.values())
    outlying: list[Outlying] = []
    for kind, of_kind in found.items():
        limit = student_factor(len(of_kind.u) - 1, of=tested, chance=_OUTLYING)
        who = [(i, name) for i, session in enumerate(sessions) for name in session.names if kind_of(name) == kind]
        off = studentised(of_kind, variances[kind])
        outlying += [Outlying(i, name, float(size)) for (i, name), size in zip(who, off, strict=True) if abs(size) > limit]
    return tuple(outlying)


def _trends(kind: str, found: Contrasts, names: tuple[str, ...]) -> Iterator[str]:
    for axis, name in zip(found.axes.T, [name for name in names if kind_of(name) == kind], strict=True):
        rows = np.flatnonzero(axis)
        steps, ends = np.diff(found.y[rows]), rows[[0, -1]]
        C = found.covariance[np.ix_(ends, ends)]
        limit = _TREND_SIGMA * math.sqrt(C[0, 0] + C[1, 1] - 2 * C[0, 1])
        if len(rows) >= _FEWEST_FOR_TREND and abs(np.sign(steps).sum()) == len(steps) and abs(steps.sum()) > limit:
            yield name


def _differs(sessions: Sequence[SessionNumbers], names: tuple[str, ...], adjusted: _Adjusted) -> bool:
    """Test by F whether the residuals of all numbers are beyond their errors; the day's variance takes up its own."""
    numerator = sum(len(session.names) for session in sessions) - len(names)
    denominator = sum(session.freedom for session in sessions)
    if numerator < 1 or denominator < 1:
        return False
    return f_tail(numerator, denominator, adjusted.weighted_square / numerator) < _DIFFERENT
