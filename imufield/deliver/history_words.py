"""The changes in the history of an instrument as text and table: against what it does from day to day.

Two calibrations are compared as a pair (``pair_test``). From three on the scatter from day to day is known, and the whole
history is tested at once (``calibrate.sessions.changes``).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta

from imufield.calibrate.model.grades import GRADES, grade_by_noise
from imufield.calibrate.sessions.accuracy_forecast import Forecast, forecast
from imufield.calibrate.sessions.changes import FEWEST, DatedNumbers, day_to_day
from imufield.calibrate.sessions.kinds import PPM, kind_of
from imufield.deliver.history import STALE_DAYS, Entry, History
from imufield.deliver.judged_history import JudgedHistory, changes_between, dated_numbers, in_one_model
from imufield.deliver.pair_test import Change, family_of, typical_turn_on
from imufield.deliver.parameters.gauge_free import unit_of
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


def shown_as(name: str, unit: str) -> tuple[str, str, float]:
    """Return name and unit of a number for people, and the size of that unit: a scale without one is its error in ppm."""
    return (name.replace("scale", "scale error"), "ppm", PPM) if unit in _NO_UNIT else (name, unit, 1.0)


def to_csv(history: History) -> str:
    """Return one row per instrument, calibration and number, and one without a number for each file that was refused."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for instrument in history.instruments:
        daily = day_to_day(dated_numbers(instrument.entries))
        for place, entry in enumerate(instrument.entries):
            before = changes_between(instrument.entries[place - 1], entry, daily) if place else ()
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
        largest = max(judged.changes, key=lambda change: abs(change.in_sigma) / change.limit_sigma)
        name, first_after = names[largest.name], largest.first_after
        a_drift = sentence("history_words.a_drift", name=name)
        what = a_drift if first_after is None else sentence("history_words.a_step", name=name, **_around(entries, first_after))
        told = {"numbers": len(judged.changes), "change": what, "in_sigma": abs(largest.in_sigma)}
        yield sentence("history_words.none", sessions=len(entries), limit_sigma=largest.limit_sigma, **told)
    is_one_day = len({entry.time.date() for entry in entries}) == 1
    between = sentence("history_words.between_sessions" if is_one_day else "history_words.between_days")
    for kind, found in judged.repeatability.items():
        if found.high == 0:
            is_alone = _scatters_alone(history.sessions, kind)
            key = "history_words.daily_closer" if is_alone else "history_words.daily_closer_in_part"
        elif found.sigma > 0:
            key = "history_words.daily"
        else:
            key = "history_words.daily_unseen"
        figures = {"sigma": found.sigma, "low": found.low, "high": found.high}
        yield sentence(key, kind=kind, between=between, unit=unit_of(f"{kind} x"), **figures)


def _scatters_alone(sessions: Sequence[DatedNumbers], kind: str) -> bool:
    """Whether what the sigma of a kind predicts of its scatter holds nothing that may be common to the sessions."""
    is_told_apart = all(
        any(session.hidden[k, k] for k, name in enumerate(session.names) if kind_of(name) == kind) for session in sessions
    )
    return is_told_apart and len({(session.setup, session.site) for session in sessions}) == 1


def _around(entries: Sequence[Entry], first_after: int) -> dict[str, str]:
    """Return between which calibrations a step lies."""
    before, after = entries[first_after - 1], entries[first_after]
    return {"before": _moment(before, after), "after": _moment(after, before)}


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
