"""Histories of one instrument: how often unchanged ones are called changed, what is found, and how good the forecasts are.

Mostly at the level of parameters: the covariance of one solved session, and in each session an estimate of it that is off as
that of few residuals is. Some go through the solve.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, partial

import numpy as np

from imufield.calibrate.sessions.accuracy_forecast import Forecast, forecast
from imufield.calibrate.sessions.changes import DatedNumbers, judge
from imufield.calibrate.sessions.joint import SessionNumbers
from imufield.calibrate.sessions.kinds import kind_of
from imufield.dataclass import replace
from imufield.deliver.parameters.joined import numbers_of
from imufield.simulate.truth.grades import draw_truth
from imufield.study.answers.means import without_quadratic
from imufield.study.answers.tables import Study, Table
from imufield.study.answers.together import DAY_MG, DAY_PPM, GRADE, calibrated, on_another_day

SESSIONS = 10
CHANGED_AFTER = 8
STEP = 5.0
"""Of a change, times the repeatability."""
_EVERY_DAYS = 30.0
_LARGE = 10.0  # Of days that are far above the errors of a session, times the usual ones.
_WANTED_MG = 0.5
_WALK_MG2_PER_DAY = 5e-4
_DRIFT_MG_PER_DAY = 2e-3


def of_numbers(rng: np.random.Generator, *, size: float, step: float = 0.0) -> dict[str, bool]:
    """Judge a history of numbers; days differ by ``size`` times the usual, one bias changes by ``step`` repeatabilities."""
    sessions = _drawn(rng, size)
    axis = "xyz"[int(rng.integers(3))]
    after = [_moved(session, axis, step * size * DAY_MG) for session in sessions[CHANGED_AFTER:]]
    return _counted([*sessions[:CHANGED_AFTER], *after])


def of_solves(rng: np.random.Generator) -> dict[str, bool]:
    """Judge a history of solved sessions."""
    instrument = without_quadratic(draw_truth(GRADE, rng))
    found = [calibrated(on_another_day(instrument, rng), rng) for _ in range(SESSIONS)]
    reference = found[-1][1]
    return _counted([_dated(k, numbers_of(calibration, free, reference).own) for k, (calibration, free) in enumerate(found)])


def forecasts(rng: np.random.Generator, *, walks: bool) -> dict[str, float]:
    """Forecast when a bias passes an accuracy: with a random walk, or a steady drift of one axis."""
    sessions = _drawn(rng, 1.0)
    day = np.array([session.day for session in sessions])
    steps = math.sqrt(_WALK_MG2_PER_DAY * _EVERY_DAYS) * rng.standard_normal((SESSIONS, 3))
    added = np.cumsum(steps, axis=0) if walks else np.outer(day, [_DRIFT_MG_PER_DAY, 0.0, 0.0])
    for axis, of_axis in zip("xyz", added.T, strict=True):
        sessions = [_moved(session, axis, off) for session, off in zip(sessions, of_axis, strict=True)]
    sigma = max(_sigma(name) for name in _template().names if kind_of(name) == "bias")
    room = _WANTED_MG**2 - sigma**2 - 2 * DAY_MG**2
    true = room / _WALK_MG2_PER_DAY if walks else math.sqrt(room) / _DRIFT_MG_PER_DAY
    found = forecast(sessions, judge(sessions), "bias", file_sigma=sigma, wanted=_WANTED_MG)
    is_known = isinstance(found, Forecast)
    return {
        "given": is_known,
        "inside": found.low_days <= true <= found.high_days if isinstance(found, Forecast) else True,
        "ratio": found.days / true if isinstance(found, Forecast) else math.nan,
    }


def _counted(sessions: Sequence[DatedNumbers]) -> dict[str, bool]:
    judged = judge(sessions)
    after = {change.first_after for change in judged.news if kind_of(change.name) == "bias"}
    return {"called": bool(judged.news), "bias": bool(after), "at once": CHANGED_AFTER in after}


@cache
def _template() -> SessionNumbers:
    """Return the numbers of one solved session."""
    rng = np.random.default_rng(0)
    calibration, found = calibrated(without_quadratic(draw_truth(GRADE, rng)), rng)
    return numbers_of(calibration, found, found).own


def _sigma(name: str) -> float:
    template = _template()
    row = template.names.index(name)
    return math.sqrt(float(template.covariance[row, row]))


def _drawn(rng: np.random.Generator, size: float) -> list[DatedNumbers]:
    template = _template()
    sizes = {"bias": size * DAY_MG, "scale": size * DAY_PPM}
    daily = np.array([sizes.get(kind_of(name), 0.0) for name in template.names])
    sessions = []
    for k in range(SESSIONS):
        values = rng.multivariate_normal(np.zeros(len(daily)), template.covariance) + daily * rng.standard_normal(len(daily))
        share = rng.chisquare(template.freedom) / template.freedom
        sessions.append(_dated(k, replace(template, values=values, covariance=template.covariance * share)))
    return sessions


def _dated(place: int, numbers: SessionNumbers) -> DatedNumbers:
    n = len(numbers.names)
    return DatedNumbers(
        day=_EVERY_DAYS * place,
        names=numbers.names,
        values=numbers.values,
        covariance=numbers.covariance,
        freedom=np.full(n, float(numbers.freedom)),
        setup="",
        hidden=np.zeros((n, n)),
        site=numbers.site,
        by_gravity=numbers.by_gravity,
    )


def _moved(session: DatedNumbers, axis: str, off_mg: float) -> DatedNumbers:
    moved = np.array([off_mg if name == f"bias {axis}" else 0.0 for name in session.names])
    return replace(session, values=session.values + moved)


_UNCHANGED = {
    "days do not differ": partial(of_numbers, size=0.0),
    "days differ by 0.1 mg, 60 ppm": partial(of_numbers, size=1.0),
    "days differ by 1 mg, 600 ppm": partial(of_numbers, size=_LARGE),
}
_SOLVED = {"solved sessions": of_solves}
_CHANGED = {
    "0.5 mg where days differ by 0.1 mg": partial(of_numbers, size=1.0, step=STEP),
    "5 mg where days differ by 1 mg": partial(of_numbers, size=_LARGE, step=STEP),
}
_FORECASTS = {"random walk": partial(forecasts, walks=True), "drift of one axis": partial(forecasts, walks=False)}
judged_histories = Study(
    Table(name="unchanged", label="history", campaign="answers-history", rows=_UNCHANGED, runs=(2000, 1)),
    Table(name="solved", label="history", campaign="answers-history solved", rows=_SOLVED, runs=(8000, 1)),
    Table(name="changed", label="history", campaign="answers-history changed", rows=_CHANGED, runs=(400, 1)),
    Table(
        name="forecasts", label="history", campaign="answers-history forecasts", rows=_FORECASTS, runs=(200, 1),
        statistics={"ratio": np.nanmedian},
    ),
    sessions=SESSIONS, changed_after=CHANGED_AFTER, step=STEP, wanted_mg=_WANTED_MG,
)  # fmt: skip
