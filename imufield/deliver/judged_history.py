"""What the calibrations of an instrument say together: judged once, and kept in the index until one of them is another.

In words and as a table: ``history_words``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from imufield.calibrate.sessions.changes import MOST, DatedNumbers, Judged, LargestChange, judge
from imufield.calibrate.sessions.kinds import kind_of
from imufield.calibrate.sessions.repeatability import Repeatability
from imufield.dataclass import asdict, dataclass, replace
from imufield.deliver.history import Entry, History, InstrumentHistory
from imufield.deliver.history_index import with_index
from imufield.deliver.pair_test import Change, compare
from imufield.deliver.parameters.gauge_free import Number
from imufield.version import __version__

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
        return changes_between(self.entries[-2], self.entries[-1], daily) if len(self.entries) > 1 else ()


def judge_histories(history: History, workers: int = 1) -> list[JudgedHistory]:
    """Judge every instrument as its calibrations are now, where they are many on several processes."""
    instruments = history.instruments
    rows = with_index(history.folder, lambda index: [index.judgement(instrument.title) for instrument in instruments])
    kept = [_kept(instrument, row) for instrument, row in zip(instruments, rows, strict=True)]
    made = _judge_each([instrument for instrument, known in zip(instruments, kept, strict=True) if known is None], workers)
    if made:
        texts = [(one.instrument, _as_text(one.judged)) for one in made]
        new = [(instrument.title, _digest(instrument, text), text) for instrument, text in texts]
        with_index(history.folder, lambda index: index.put_judgements(new))
    rest = iter(made)
    return [next(rest) if known is None else known for known in kept]


def _kept(instrument: InstrumentHistory, row: tuple[str, str] | None) -> JudgedHistory | None:
    if row is None or row[0] != _digest(instrument, row[1]):
        return None
    changes, repeatability = json.loads(row[1])
    judged = Judged(
        tuple(LargestChange(**change) for change in changes),
        {kind: Repeatability(**found) for kind, found in repeatability.items()},
    )
    return JudgedHistory(instrument, dated_numbers(instrument.entries), judged)


def _as_text(judged: Judged) -> str:
    repeatability = {kind: asdict(found) for kind, found in judged.repeatability.items()}
    return json.dumps([[asdict(change) for change in judged.changes], repeatability])


def _digest(instrument: InstrumentHistory, text: str) -> str:
    """Return the hash of a judgement and of all it depends on: the calibrations, and the versions that made it."""
    entries = "\n".join(entry.text for entry in instrument.entries[-MOST:])
    return hashlib.sha256(f"{__version__}\n{np.__version__}\n{text}\n{entries}".encode()).hexdigest()


def _judge_each(instruments: Sequence[InstrumentHistory], workers: int) -> list[JudgedHistory]:
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


def changes_between(old: Entry, new: Entry, daily: Mapping[str, float]) -> tuple[Change, ...]:
    """Return the change of every number that both have, in the same unit; its sigma has in it what days do."""
    old, new = in_one_model((old, new))
    numbers = {number.name: number for number in new.numbers}
    return tuple(
        replace(change, sigma=math.hypot(change.sigma, math.sqrt(2) * _day_change(daily, numbers[change.name])))
        for change in compare(old.gauge_free, new.gauge_free, new.shared_with(old))
    )


def _day_change(daily: Mapping[str, float], number: Number) -> float:
    return daily.get(kind_of(number.name), 0.0) * abs(number.adjusted_size)
