"""The changes in the history of an instrument as text and table: against what it does from day to day.

Two calibrations are compared as a pair (``pair_test``). From three on the scatter from day to day is known, and the whole
history is tested at once (``calibrate.sessions.changes``).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from imufield.calibrate.model.grades import GRADES, grade_by_noise
from imufield.calibrate.sessions.changes import FEWEST, MOST, DatedNumbers, Judged, LargestChange, day_to_day, judge
from imufield.calibrate.sessions.forecast import Forecast, forecast
from imufield.calibrate.sessions.kinds import PPM, kind_of
from imufield.calibrate.sessions.repeatability import Repeatability
from imufield.deliver.history import STALE_DAYS, Entry, History, InstrumentHistory
from imufield.deliver.pair_test import Change, compare, family_of, typical_turn_on
from imufield.deliver.parameters.gauge_free import Number, unit_of
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_NO_UNIT = ("m/s^2 per m/s^2", "rad/s per rad/s")  # Units of a scale that is 1 but for its error.
_MANY = 4  # Up to three of one kind are told one by one.
_OF_MANY = {
    "history_words.moved": "history_words.moved_many",
    "history_words.differs": "history_words.differs_many",
    "history_words.differs_as_turn_on": "history_words.differs_as_turn_on_many",
}
_DAYS_A_YEAR = 365.25
_SAME_DEGC = 10.0  # Rooms and instruments that warm up differ by less; more is a chamber, or the weather.
CSV_COLUMNS = (
    "instrument",
    "serial_number",
    "created",
    "verdict",
    "file",
    "parameter",
    "unit",
    "value",
    "sigma",
    "change_sigma",
    "remark",
)
_INSTRUMENTS_A_WORKER = 8  # A process takes as long to start as some five instruments to judge.


@dataclass(frozen=True, slots=True)
class JudgedHistory:
    """What the calibrations of an instrument say."""

    instrument: InstrumentHistory
    sessions: tuple[DatedNumbers, ...]
    judged: Judged

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The calibrations that are judged, the oldest first."""
        return self.instrument.entries[-MOST:]

    @property
    def repeatability(self) -> Mapping[str, Repeatability]:
        """What each kind of numbers does from day to day, in its ``unit_of``; empty with fewer than three sessions."""
        return self.judged.repeatability

    def changes(self) -> tuple[Change, ...]:
        """Return what has changed from the calibration before to the newest; nothing for a single calibration."""
        daily = {kind: found.sigma for kind, found in self.repeatability.items()}
        return _changes_between(self.entries[-2], self.entries[-1], daily) if len(self.entries) > 1 else ()


def shown_as(name: str, unit: str) -> tuple[str, str, float]:
    """Return name and unit of a number for people, and the size of that unit: a scale without one is its error in ppm."""
    return (name.replace("scale", "scale error"), "ppm", PPM) if unit in _NO_UNIT else (name, unit, 1.0)


def judge_histories(instruments: Sequence[InstrumentHistory], workers: int = 1) -> list[JudgedHistory]:
    """Judge every instrument, where they are many on several processes."""
    share = min(workers, 1 + len(instruments) // _INSTRUMENTS_A_WORKER)
    if share == 1:
        return [judge_history(instrument) for instrument in instruments]
    from imufield.campaign import run_campaign  # late: processes take time to import

    return run_campaign(_judge_one, instruments, seed=0, workers=share)


def _judge_one(instrument: InstrumentHistory, _: np.random.Generator) -> JudgedHistory:
    return judge_history(instrument)


def judge_history(instrument: InstrumentHistory) -> JudgedHistory:
    """Hold the changes of an instrument against what it does from day to day."""
    sessions = dated_numbers(instrument.entries)
    return JudgedHistory(instrument, sessions, judge(sessions))


def in_one_model(entries: Sequence[Entry]) -> tuple[Entry, ...]:
    """Return calibrations in the linear model where those from the same positions have different ones.

    A quadratic term is there on all days, whether it was fitted or not: in one model it moves all numbers alike. And sigma is
    too small beside a drift that was fitted by chance.
    """
    setups: dict[str, set[str]] = {}
    for entry in entries:
        setups.setdefault(entry.linear_setup, set()).add(entry.setup)
    return tuple(entry.in_linear_model() if len(setups[entry.linear_setup]) > 1 else entry for entry in entries)


def dated_numbers(entries: Sequence[Entry]) -> tuple[DatedNumbers, ...]:
    """Return the numbers of calibrations for a test, in the units of ``unit_of``: scales against those of the newest."""
    judged = in_one_model(entries[-MOST:])
    newest = {number.name: number for number in judged[-1].numbers}
    return tuple(_dated(entry, newest) for entry in judged)


def _dated(entry: Entry, newest: Mapping[str, Number]) -> DatedNumbers:
    # In another unit (another range, another output) it is another number.
    rows = [k for k, number in enumerate(entry.numbers) if newest.get(number.name, number).unit == number.unit]
    found = entry.gauge_free.against(newest, rows)
    is_known = entry.gravity_source != "assumed"
    return DatedNumbers(
        day=entry.time.timestamp() / 86400,
        names=tuple(number.name for number in found.numbers),
        values=np.array([number.value for number in found.numbers]),
        covariance=found.scatter,
        freedom=np.array([number.scatter_freedom for number in found.numbers]),
        setup=entry.setup,
        hidden=found.error - found.scatter,
        # A gravity that was only assumed says nothing of the place.
        site=f"{entry.gravity_m_s2:.6f}" if is_known else entry.path,
        by_gravity=np.array([number.common for number in found.numbers]),
    )


def _changes_between(old: Entry, new: Entry, daily: Mapping[str, float]) -> tuple[Change, ...]:
    """Return the change of every number that both have, in the same unit; its sigma has in it what days do."""
    old, new = in_one_model((old, new))
    numbers = {number.name: number for number in new.numbers}
    return tuple(
        replace(change, sigma=math.hypot(change.sigma, math.sqrt(2) * _day_change(daily, numbers[change.name])))
        for change in compare(old.gauge_free, new.gauge_free, new.shared_with(old))
    )


def _day_change(daily: Mapping[str, float], number: Number) -> float:
    return daily.get(kind_of(number.name), 0.0) * abs(number.adjusted_size)


def to_csv(history: History) -> str:
    """Return one row per instrument, calibration and number, and one without a number for each file that was refused."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for instrument in history.instruments:
        daily = day_to_day(dated_numbers(instrument.entries))
        for place, entry in enumerate(instrument.entries):
            before = _changes_between(instrument.entries[place - 1], entry, daily) if place else ()
            changes = {change.name: change.in_sigma for change in before}
            for number in entry.numbers:
                change = changes.get(number.name, math.nan)
                # Every digit: with a table one computes on.
                writer.writerow([
                    instrument.instrument, instrument.serial_number, entry.created, entry.verdict, entry.path, number.name,
                    number.unit, repr(number.value), repr(number.sigma), "" if math.isnan(change) else f"{change:.2f}",
                    "edited by hand" if entry.edited else "",
                ])  # fmt: skip
    for fault in history.faults:
        writer.writerow([*[""] * (len(CSV_COLUMNS) - 1), f"refused: {fault}"])
    return buffer.getvalue()


def sentences(
    history: JudgedHistory, now: datetime, stale_days: float = STALE_DAYS, wanted: Mapping[str, float] | None = None
) -> Iterator[Sentence]:
    """Yield what there is to say: every number that changed, what days do, when to calibrate again.

    Parameters
    ----------
    history : JudgedHistory
    now : datetime
    stale_days : float
        Age at which a calibration is old.
    wanted : mapping, optional
        By kind the accuracy wanted, 1 sigma, in its ``unit_of``.
    """
    instrument, entries = history.instrument, history.entries
    if not instrument.serial_number and len(entries) > 1:
        yield sentence("history_words.no_serial")
    edited = [entry.path for entry in entries if entry.edited]
    if edited:
        yield sentence("history_words.edited", paths=edited)
    if instrument.not_listed:
        yield sentence("history_words.not_listed", files=instrument.not_listed)
    if len(entries) >= 2 and entries[-2].time == entries[-1].time:
        yield sentence("history_words.same_time", first=entries[-2].path, second=entries[-1].path)
    known_degc = [entry.temperature_degc for entry in entries if entry.temperature_degc is not None]
    if known_degc and max(known_degc) - min(known_degc) > _SAME_DEGC:
        yield sentence("history_words.temperatures", low=min(known_degc), high=max(known_degc))
    if len(entries) == FEWEST - 1:
        yield from _differences(*entries)
    yield from _judged(history)
    for kind, accuracy in (wanted or {}).items():
        yield from _forecast(history, kind, accuracy)
    age_days = instrument.age_days(now)
    if age_days > stale_days:
        yield sentence("history_words.stale", age_days=age_days, limit_days=stale_days)


def _judged(history: JudgedHistory) -> Iterator[Sentence]:
    """Yield a sentence for each number that is news, or one that none is, and what days do."""
    judged, entries = history.judged, history.entries
    names = {number.name: shown_as(number.name, number.unit)[0] for number in entries[-1].numbers}
    for change in judged.news:
        told = {"name": names[change.name], "unit": unit_of(change.name), "in_sigma": abs(change.in_sigma)}
        if change.first_after is None:
            yield sentence("history_words.drift", size=change.size * _DAYS_A_YEAR, limit_sigma=change.limit_sigma, **told)
        else:
            days = _around(entries, change.first_after)
            yield sentence("history_words.step", size=change.size, limit_sigma=change.limit_sigma, **days, **told)
    if judged.changes and not judged.news:
        largest = max(judged.changes, key=_share_of_limit)
        name, first_after = names[largest.name], largest.first_after
        a_drift = sentence("history_words.a_drift", name=name)
        what = a_drift if first_after is None else sentence("history_words.a_step", name=name, **_around(entries, first_after))
        told = {"numbers": len(judged.changes), "change": what, "in_sigma": abs(largest.in_sigma)}
        yield sentence("history_words.none", sessions=len(entries), limit_sigma=largest.limit_sigma, **told)
    is_one_day = len({entry.time.date() for entry in entries}) == 1
    between = sentence("history_words.between_sessions" if is_one_day else "history_words.between_days")
    for kind, found in judged.repeatability.items():
        key = "history_words.daily" if found.sigma > 0 else "history_words.daily_unseen"
        figures = {"sigma": found.sigma, "low": found.low, "high": found.high}
        yield sentence(key, kind=kind, between=between, unit=unit_of(f"{kind} x"), **figures)


def _around(entries: Sequence[Entry], first_after: int) -> dict[str, str]:
    """Return between which calibrations a step lies."""
    before, after = entries[first_after - 1], entries[first_after]
    return {"before": _moment(before, after), "after": _moment(after, before)}


def _share_of_limit(change: LargestChange) -> float:
    return abs(change.in_sigma) / change.limit_sigma


def _forecast(history: JudgedHistory, kind: str, accuracy: float) -> Iterator[Sentence]:
    """Yield when to calibrate again for an accuracy, or why nobody knows."""
    stated = [number for number in history.entries[-1].numbers if kind_of(number.name) == kind]
    sigma = max((number.sigma / abs(number.adjusted_size) for number in stated), default=math.nan)
    found = forecast(history.sessions, history.judged, kind, file_sigma=sigma, wanted=accuracy)
    told = {"kind": kind, "wanted": accuracy, "unit": unit_of(f"{kind} x")}
    if not isinstance(found, Forecast):
        key = "history_words.forecast_short" if found.why == "short" else "history_words.forecast_now"
        yield sentence(key, sessions=found.sessions, limit=found.limit, now=found.now, **told)
        return
    days = {"low": found.low_days, "high": found.high_days, "middle": found.days, "span": found.span_days}
    on = history.entries[-1].time + timedelta(days=min(found.days, found.span_days))
    key = "history_words.forecast"
    if found.days > found.span_days:
        key = "history_words.forecast_unseen" if found.low_days >= found.span_days else "history_words.forecast_late"
    yield sentence(key, day=f"{on.day} {on:%B %Y}", **days, **told)


def _differences(old: Entry, new: Entry) -> Iterator[Sentence]:
    """Yield what differs between two calibrations, many of one kind in one sentence, or one that nothing does."""
    old, new = in_one_model((old, new))
    family = family_of(old.gauge_free, new.gauge_free, new.shared_with(old))
    since = _moment(old, new)
    grade = GRADES.get(new.grade) or grade_by_noise("gyroscope", new.gyroscope_noise_rad_s_per_root_hz)
    kinds: dict[str, list[Change]] = {}
    for change in family.beyond:
        turn_on = typical_turn_on(grade, change.name)
        key = "history_words.moved"
        if not family.exceeds(change, turn_on):
            key = "history_words.differs_as_turn_on" if math.isfinite(turn_on) else "history_words.differs"
        kinds.setdefault(key, []).append(change)
    for key, alike in kinds.items():
        is_many = len(alike) >= _MANY
        for change in [max(alike, key=_in_sigma)] if is_many else alike:
            name, unit, size = shown_as(change.name, change.unit)
            said = {"name": name, "since": since, "difference": change.difference / size, "unit": unit}
            said |= {"in_sigma": _in_sigma(change), "turn_on": typical_turn_on(grade, change.name), "numbers": len(alike)}
            yield sentence(_OF_MANY[key] if is_many else key, **said)
    if family.changes and not family.beyond:
        largest = max(family.changes, key=_in_sigma)
        name, _, _ = shown_as(largest.name, largest.unit)
        told = {"numbers": len(family.changes), "name": name, "in_sigma": _in_sigma(largest)}
        yield sentence("history_words.same", since=since, limit_sigma=family.limit_sigma, **told)


def _in_sigma(change: Change) -> float:
    return abs(change.in_sigma)


def _moment(one: Entry, other: Entry) -> str:
    """Return the day of one, with the time where both are of the same day, to the second where they are of one minute."""
    if one.time.date() != other.time.date():
        return f"{one.time.day} {one.time:%B %Y}"
    is_one_minute = f"{one.time:%H:%M}" == f"{other.time:%H:%M}"
    return f"{one.time.day} {one.time:%B %Y}, {one.time:{'%H:%M:%S' if is_one_minute else '%H:%M'}} UTC"
