"""Whether an instrument has changed over its history: one test of all its numbers at all times, against what each day does.

A number of a kind has in session i the value ``y_i = mu + delta_i + e_i`` as in ``joint``. A change adds ``f beta``: a step
after any session (f is 0 before, 1 after), or a drift (f is the time). With the contrasts ``u`` and their variances ``s^2 + l``
as in ``repeatability``, whitened, a shape f on the a axes of a kind has the columns Q (n, a), and

    beta = (Q^T Q)^-1 Q^T u,    t = beta / sqrt(its variance)

What tells s is what the shape leaves of the contrasts, on all axes of the kind: what happens to one axis mostly happens to all,
and a change may not hide behind the scatter that it makes. With r the rest of ``u`` and weights w_j = 1 / (s_0^2 + l_j)

    s^2 = (sum w_j r_j^2 - part of e) / (part of delta for s = 1),    not below zero,    s_0^2 of restricted maximum likelihood

The largest |t| of each kind in an unchanged history is drawn, days and sessions with their covariances, and estimated
variances by chi squared with their degrees of freedom, one draw for all numbers of a triad in a session. Days differ in the
draws only where Q(0) of ``repeatability`` is large, as an s that is noise makes all limits too wide. Then s is drawn, too, by
the sum of s_0^2 and the mean of l over chi squared with n degrees of freedom. The limits of kinds are passed with one chance
each, such that any of them is passed in 5 % (balanced, the first step of [1]_): three numbers with few degrees of freedom do
not set the limit of all others.

References
----------
.. [1] J. P. Romano, M. Wolf, "Balanced control of generalized error rates", Annals of Statistics 38 (2010).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from imufield.calibrate.model.coverage_factors import chi_squared_quantile
from imufield.calibrate.model.uncertainty import block_diagonal
from imufield.calibrate.sessions.draws import FAMILY_CHANCE, symmetric_root, variance_share
from imufield.calibrate.sessions.kinds import DAILY, kind_of, of_gyroscope
from imufield.calibrate.sessions.repeatability import Repeatability, contrasts, reml_variance, repeatability
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

FEWEST = 3
"""Sessions whose scatter from day to day is known at all."""
MOST = 50
"""Sessions, the newest, that are enough: the work grows with their square."""
_DRAWS = 5_000  # They tell the chance to 0.3 %.
# That errors alone scatter so much. Of simulated histories (ten sessions, three axes, 15 degrees of freedom) 4.2 % are called
# changed if days do not differ, 5.6 % if they do by 0.8 sigma; with 2.5 % here 4.8 and 7.2 %, always with s_0^2 2.8 and 4.8 %.
_EXCESS_CHANCE = 0.07
_PRIOR_FREEDOM = 30.0  # Of the mean sigma of all sessions, beside some 15 of each.
_DRAWN_SESSIONS = 200_000  # Fewer draws of long histories, 2000 at least.


@dataclass(frozen=True, slots=True, kw_only=True)
class DatedNumbers:
    """The numbers of one session, n of them."""

    day: float
    """When, in days."""
    names: tuple[str, ...]
    """Kind and place, such as "bias x"."""
    values: FloatArray
    covariance: FloatArray
    """Of the errors that another session draws anew, shape (n, n)."""
    freedom: FloatArray
    """Degrees of freedom of each variance, 0 where nothing tells it, shape (n,)."""
    setup: str
    """Sessions with the same share what the model leaves out."""
    hidden: FloatArray
    """Covariance of that, shape (n, n)."""
    site: str
    """Sessions with the same have the same error of gravity."""
    by_gravity: FloatArray
    """Change of the values by 1 sigma of gravity, shape (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LargestChange:
    """The largest change of a number in units of its sigma."""

    name: str
    first_after: int | None
    """Index of the first session after a step; None: a drift."""
    size: float
    """Of the step, or of the drift in a day."""
    sigma: float
    limit_sigma: float

    @property
    def in_sigma(self) -> float:
        """The change in units of its sigma."""
        return self.size / self.sigma

    @property
    def is_news(self) -> bool:
        """Whether an unchanged instrument does not show it; in 5 % of such histories there is one all the same."""
        return abs(self.in_sigma) > self.limit_sigma


@dataclass(frozen=True, slots=True)
class Judged:
    """What a history says."""

    changes: tuple[LargestChange, ...]
    """One for each number that could be tested."""
    repeatability: Mapping[str, Repeatability]
    """By kind, news left out."""

    @property
    def news(self) -> tuple[LargestChange, ...]:
        """The changes beyond their limits."""
        return tuple(change for change in self.changes if change.is_news)


def judge(sessions: Sequence[DatedNumbers]) -> Judged:
    """Test whether an instrument has changed.

    Parameters
    ----------
    sessions : sequence of DatedNumbers
        In order of time, ``MOST`` at most; fewer than ``FEWEST`` say nothing.
    """
    kinds = dict.fromkeys(kind_of(name) for name in sessions[-1].names) if sessions else ()
    tests = [test for test in (KindTest.of(sessions, kind) for kind in kinds) if test is not None]
    if len(sessions) < FEWEST or not tests:
        return Judged((), {})
    limits = _limits(sessions, tests)
    changes = [change for test, limit in zip(tests, limits, strict=True) for change in test.largest(limit)]
    news = [change for change in changes if change.is_news]
    daily = {
        test.kind: repeatability(contrasts(test.y, test.with_news(news), test.covariance)) for test in tests if test.is_daily
    }
    return Judged(tuple(changes), daily)


def day_to_day(sessions: Sequence[DatedNumbers]) -> dict[str, float]:
    """Return by kind how much the numbers change from session to session, 1 sigma; nothing of fewer than ``FEWEST``."""
    tests = (KindTest.of(sessions, kind) for kind in DAILY if len(sessions) >= FEWEST)
    return {test.kind: math.sqrt(test.variance) for test in tests if test is not None}


@dataclass(frozen=True, kw_only=True)
class _Shapes:
    """Columns that a change adds, c of them on a axes, with all that a test of them needs."""

    first_after: tuple[int | None, ...]
    """Index into the sessions of the kind."""
    columns: FloatArray
    """f, shape (c, h)."""
    B: FloatArray
    """Orthonormal columns of Q, shape (n, c, a)."""
    to_beta: FloatArray
    """R^-1 with Q = B R, shape (c, a, a)."""
    by_day: FloatArray
    """Variance of beta for s = 1, shape (c, a)."""
    by_session: FloatArray
    """What each session's own errors add to it, shape (c, a, h)."""
    by_groups: FloatArray
    """What errors of a setup or a site add, shape (c, a)."""
    rest_by_day: FloatArray
    """The same three of the sum of weighted squares that the shape leaves: shapes (c,), (c, h), (c,)."""
    rest_by_session: FloatArray
    rest_by_groups: FloatArray


@dataclass(frozen=True, kw_only=True)
class KindTest:
    """The test of one kind on a axes in h sessions, m = a h values."""

    kind: str
    names: tuple[str, ...]
    sessions: tuple[int, ...]
    day: FloatArray
    y: FloatArray
    """Shape (m,), session by session."""
    own: FloatArray
    """Covariance of each session's own errors, shape (h, a, a)."""
    freedom: FloatArray
    """Its degrees of freedom, shape (h,)."""
    groups: FloatArray
    """Covariance of the errors of setups and sites, shape (m, m)."""

    @classmethod
    def of(cls, sessions: Sequence[DatedNumbers], kind: str) -> KindTest | None:
        """Return the test; None where too few sessions have the numbers."""
        names = tuple(name for name in sessions[-1].names if kind_of(name) == kind)
        used, rows = [], []
        for i, session in enumerate(sessions if names else ()):
            if set(names) <= set(session.names):
                places = [session.names.index(name) for name in names]
                if session.freedom[places].min() > 0:
                    used.append(i)
                    rows.append(places)
        if len(used) < (FEWEST if kind in DAILY else 2):
            return None
        picked = [sessions[i] for i in used]
        return cls(
            kind=kind,
            names=names,
            sessions=tuple(used),
            day=np.array([session.day for session in picked]),
            y=np.concatenate([session.values[places] for session, places in zip(picked, rows, strict=True)]),
            own=np.array([session.covariance[np.ix_(places, places)] for session, places in zip(picked, rows, strict=True)]),
            freedom=np.array([session.freedom[places].min() for session, places in zip(picked, rows, strict=True)]),
            groups=_group_covariance(picked, rows),
        )

    @property
    def is_daily(self) -> bool:
        """Whether the kind changes from day to day."""
        return self.kind in DAILY

    @cached_property
    def axes(self) -> FloatArray:
        """M, shape (m, a)."""
        return np.tile(np.eye(len(self.names)), (len(self.sessions), 1))

    @cached_property
    def covariance(self) -> FloatArray:
        """C, shape (m, m)."""
        return self.groups + block_diagonal(self.own)

    @cached_property
    def variance(self) -> float:
        """s_0^2; zero of a kind that days do not change."""
        return reml_variance(contrasts(self.y, self.axes, self.covariance)) if self.is_daily else 0.0

    def drawn_variance(self, draws: int, rng: np.random.Generator) -> FloatArray:
        """Draw s^2 as the contrasts leave it open; zero where they scatter no more than their own errors mostly do."""
        if not self.is_daily:
            return np.zeros(draws)
        found = contrasts(self.y, self.axes, self.covariance)
        n, own = len(found.u), float(np.mean(found.own_variance))
        # Infinite where a session has no noise.
        with np.errstate(over="ignore"):
            excess = float(np.sum(found.u**2 / found.own_variance))
        if excess <= chi_squared_quantile(n, 1 - _EXCESS_CHANCE):
            return np.zeros(draws)
        return np.maximum((self.variance + own) * n / rng.chisquare(n, draws) - own, 0.0)

    @cached_property
    def whitening(self) -> FloatArray:
        """What makes whitened contrasts of values, shape (m, n)."""
        basis = np.linalg.qr(self.axes, mode="complete")[0][:, self.axes.shape[1] :]
        # Weights from one session's few residuals would favour the sessions whose sigma is too small by chance.
        share = (_PRIOR_FREEDOM / (_PRIOR_FREEDOM + self.freedom))[:, None, None]
        own = block_diagonal((1 - share) * self.own + share * self.own.mean(axis=0))
        V = self.variance * np.eye(len(self.y)) + self.groups + own
        values, vectors = np.linalg.eigh(basis.T @ V @ basis)
        return np.asarray(basis @ vectors / np.sqrt(values))

    @cached_property
    def weights(self) -> FloatArray:
        """1 / (s_0^2 + l_j), shape (n,)."""
        return np.asarray(np.sum(self.whitening**2, axis=0))

    @cached_property
    def shapes(self) -> _Shapes:
        """Every step and the drift."""
        h, a = len(self.sessions), len(self.names)
        shapes: list[tuple[int | None, FloatArray]] = [(k, (np.arange(h) >= k).astype(np.float64)) for k in range(1, h)]
        # Of two sessions, or of days that are one, a drift is a step.
        if h >= FEWEST and np.ptp(self.day) > 0:
            shapes.append((None, self.day - self.day.mean()))
        W, weights, blocks = self.whitening, self.weights, (h, a, -1)
        parts: list[dict[str, FloatArray]] = []
        for _, f in shapes:
            B, R = np.linalg.qr(W.T @ np.kron(f[:, None], np.eye(a)))
            to_beta = np.linalg.inv(R)
            K = to_beta @ B.T @ W.T
            rest = (W - W @ B @ B.T) * np.sqrt(weights)
            K_blocks, rest_blocks = K.T.reshape(blocks), rest.reshape(blocks)
            parts.append(
                {
                    "columns": f,
                    "B": B,
                    "to_beta": to_beta,
                    "by_day": np.sum(K**2, axis=1),
                    "by_session": np.einsum("hik,hij,hjk->kh", K_blocks, self.own, K_blocks),
                    "by_groups": np.einsum("km,mn,kn->k", K, self.groups, K),
                    "rest_by_day": np.asarray(np.sum(rest**2)),
                    "rest_by_session": np.einsum("hin,hij,hjn->h", rest_blocks, self.own, rest_blocks),
                    "rest_by_groups": np.einsum("mj,mn,nj->", rest, self.groups, rest),
                }
            )
        stacked = {name: np.array([part[name] for part in parts]) for name in parts[0]}
        stacked["B"] = np.moveaxis(stacked["B"], 0, 1)
        return _Shapes(first_after=tuple(first for first, _ in shapes), **stacked)

    def statistics(self, y: FloatArray, own_share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return beta and its sigma, shapes (d, c, a).

        Parameters
        ----------
        y : ndarray, shape (d, m)
        own_share : ndarray, shape (d, h)
            Estimated over true variance of each session's own errors.
        """
        shapes = self.shapes
        u = y @ self.whitening
        b = np.einsum("dn,nca->dca", u, shapes.B, optimize=True)
        variance = own_share @ np.moveaxis(shapes.by_session, 2, 0).reshape(len(self.sessions), -1)
        variance = variance.reshape(b.shape) + shapes.by_groups
        if self.is_daily:
            weighted = self.weights[:, None, None] * shapes.B
            bw = np.einsum("dn,nca->dca", u, weighted, optimize=True)
            inner = np.einsum("nca,nce->cae", shapes.B, weighted)
            squares = (u**2 @ self.weights)[:, None] - 2 * np.sum(b * bw, axis=2)
            squares += np.sum(np.einsum("dca,cae->dce", b, inner, optimize=True) * b, axis=2)
            by_errors = own_share @ shapes.rest_by_session.T + shapes.rest_by_groups
            s2 = np.maximum((squares - by_errors) / shapes.rest_by_day, 0.0)
            variance = variance + s2[:, :, None] * shapes.by_day
        beta = np.einsum("cae,dce->dca", shapes.to_beta, b, optimize=True)
        return beta, np.sqrt(variance)

    def largest(self, limit_sigma: float) -> Iterator[LargestChange]:
        """Yield the largest change of each number."""
        beta, sigma = (found[0] for found in self.statistics(self.y[None], np.ones((1, len(self.sessions)))))
        for axis, name in enumerate(self.names):
            k = int(np.argmax(np.abs(beta[:, axis] / sigma[:, axis])))
            place = self.shapes.first_after[k]
            yield LargestChange(
                name=name,
                first_after=None if place is None else self.sessions[place],
                size=float(beta[k, axis]),
                sigma=float(sigma[k, axis]),
                limit_sigma=limit_sigma,
            )

    def with_news(self, news: Sequence[LargestChange]) -> FloatArray:
        """Return the axes and a column for each of these changes of the kind, shape (m, a + news)."""
        columns = [self.axes]
        places = [None if k is None else self.sessions[k] for k in self.shapes.first_after]
        for change in news:
            if change.name in self.names:
                f = self.shapes.columns[places.index(change.first_after)]
                columns.append(np.kron(f, np.eye(len(self.names))[self.names.index(change.name)])[:, None])
        return np.hstack(columns)


def _group_covariance(sessions: Sequence[DatedNumbers], rows: Sequence[Sequence[int]]) -> FloatArray:
    """Return the covariance of what sessions of a setup and of a site share, shape (m, m); nothing where it is one for all."""
    a = len(rows[0])
    whole = np.zeros((len(rows) * a, len(rows) * a))
    setups, sites = ({getattr(session, key) for session in sessions} for key in ("setup", "site"))
    for i, (one, its) in enumerate(zip(sessions, rows, strict=True)):
        for j, (other, theirs) in enumerate(zip(sessions, rows, strict=True)):
            block = whole[i * a : (i + 1) * a, j * a : (j + 1) * a]
            if one.setup == other.setup and len(setups) > 1:
                block += symmetric_root(one.hidden[np.ix_(its, its)]).T @ symmetric_root(other.hidden[np.ix_(theirs, theirs)])
            if one.site == other.site and len(sites) > 1:
                block += np.outer(one.by_gravity[its], other.by_gravity[theirs])
    return whole


def _limits(sessions: Sequence[DatedNumbers], tests: Sequence[KindTest]) -> list[float]:
    """Return the limit of the largest |t| of each kind."""
    draws = int(np.clip(_DRAWN_SESSIONS / len(sessions), 2000, _DRAWS))
    rng = np.random.default_rng(0)
    drawn = [_drawn(session, draws, rng) for session in sessions]
    groups = [_drawn_groups(test, draws, rng) for test in tests]
    largest = np.empty((draws, len(tests)))
    for k, (test, shared) in enumerate(zip(tests, groups, strict=True)):
        places = [[sessions[i].names.index(name) for name in test.names] for i in test.sessions]
        y = np.concatenate([drawn[i][0][:, rows] for i, rows in zip(test.sessions, places, strict=True)], axis=1)
        own_share = np.stack([drawn[i][1][:, rows[0]] for i, rows in zip(test.sessions, places, strict=True)], axis=1)
        beta, sigma = test.statistics(y + shared, own_share)
        largest[:, k] = np.max(np.abs(beta / sigma), axis=(1, 2))
    rank = np.argsort(np.argsort(-largest, axis=0), axis=0).min(axis=1)
    allowed = int(np.quantile(rank, FAMILY_CHANCE))
    return [float(limit) for limit in -np.sort(-largest, axis=0)[allowed]]


def _drawn(session: DatedNumbers, draws: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return errors of a session's own, and its estimated over its true variances, shape (draws, n) each."""
    error = rng.standard_normal((draws, len(session.names))) @ symmetric_root(session.covariance)
    share = np.empty_like(error)
    gyroscope = of_gyroscope(session.names)
    for triad in (gyroscope, ~gyroscope):
        share[:, triad] = variance_share(session.freedom[triad], draws, rng)
    return error, share


def _drawn_groups(test: KindTest, draws: int, rng: np.random.Generator) -> FloatArray:
    """Return what days, setups and sites add to the values of a kind, shape (draws, m)."""
    added = np.sqrt(test.drawn_variance(draws, rng))[:, None] * rng.standard_normal((draws, len(test.y)))
    if test.groups.any():
        added += rng.standard_normal((draws, len(test.y))) @ symmetric_root(test.groups)
    return np.asarray(added)
