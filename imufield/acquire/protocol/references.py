"""What a protocol file refers to is there and fits: fields of frames, columns of lines, signals of a bus.

A name that is nowhere would lose its value without a word, and a number beyond its field would never come.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from imufield.acquire.protocol.layout import TEXT_TYPES, Field
from imufield.acquire.protocol.samples_and_clock import (
    MOST_TICKS,
    NANOSECONDS,
    PARTS,
    ClockRule,
    Quantity,
    SampleRule,
)
from imufield.acquire.protocol.toml import Table, near
from imufield.dataclass import replace
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.acquire.protocol.can_dbc import CanSignal

sentence = Sentences(__package__)

# Time stamps of more bits, or a longer wrap, do not wrap while a program runs.
_LONGEST_WRAP = 1 << 32
_LONGEST_WRAP_NS = 2.0**62
_ANY_COUNT = range(1, 1 << 16)


def check_whole(table: Table, key: str, field: Field | CanSignal, **numbers: int) -> None:
    """Refuse a field that has no whole numbers, or one of the numbers of the table that such a field cannot have."""
    if not field.modulus:
        raise table.error(key, sentence("references.no_whole", name=field.name, type=field.type))
    bits = field.modulus.bit_length() - 1
    for other, number in numbers.items():
        if number >= field.modulus:
            raise table.error(other, sentence("references.beyond", found=table.value(other), name=field.name, bits=bits))


def check_values(table: Table, key: str, signal: CanSignal, values: tuple[int, ...]) -> None:
    """Refuse numbers of the table that a signal of whole numbers can never have."""
    low = -(signal.modulus // 2) if signal.is_signed else 0
    high = low + signal.modulus - 1
    if min(values) < low or max(values) > high:
        raise table.error(key, sentence("references.outside", values=values, name=signal.name, low=low, high=high))


class References:
    """Checks what the tables of a protocol file name against the fields that samples may have.

    Fields of one name, in frames of several kinds, must all fit.

    Parameters
    ----------
    fields : iterable of Field
    """

    def __init__(self, fields: Iterable[Field]) -> None:
        self._named: dict[str, list[Field]] = {}
        for field in fields:
            self._named.setdefault(field.name, []).append(field)

    def check(self, top: Table, samples: SampleRule, clock: ClockRule) -> None:
        """Check all names in ``[samples]`` and ``[clock]``."""
        table, times = top.table("samples"), top.table("clock")
        for part in PARTS:
            self._check_quantity(table, part, samples.quantity(part))
        for each, flag in zip(table.tables("flags"), samples.flags, strict=True):
            self._check_whole(each, flag.field, mask=flag.mask % (1 << 64))
        for each, (name, _) in zip(table.tables("instrument_status"), samples.instrument_status, strict=True):
            self._check_whole(each, name)
        if clock.counter_field:
            numbers = {"modulus": clock.counter_modulus - 1, "steps": max(clock.counter_steps)}
            self._check_whole(times.table("counter"), clock.counter_field, **numbers)
        tables = times.tables("time") if clock.times else [times.table("time")]
        stamps = [(stamp.field, stamp.modulus) for stamp in clock.times] or [(clock.time_field, clock.time_modulus)]
        for each, (name, modulus) in zip(tables, stamps, strict=True):
            for field in self._numbers(each, "field", name) if name else ():
                if field.modulus:
                    check_whole(each, "field", field, modulus=modulus - 1)

    def _check_quantity(self, table: Table, part: str, quantity: Quantity) -> None:
        names, below = quantity.fields, table.table(part)
        # A status bit of the same name counts 1, and is no value of the triad.
        counts = [max(field.count for field in self._numbers(table, part, name, _ANY_COUNT)) for name in names]
        # Alternatives of three values each, or the three axes.
        if part != "temperature" and (counts not in ([], [3] * len(counts), [1, 1, 1]) or len({*names}) < len(names)):
            raise table.error(part, sentence("references.triad", names=names, counts=counts))
        if own := quantity.sensor_temperature:
            for field in self._numbers(below, "sensor_temperature", own, (1, 3)):
                if field.unit not in ("", "degC"):
                    raise below.error("sensor_temperature", sentence("references.unit", name=own, unit=field.unit))
        if when := quantity.scale_when:
            self._check_whole(below.table("scale_when"), when.field, mask=when.mask)

    def _numbers(self, table: Table, key: str, name: str, counts: range | tuple[int, ...] = (1,)) -> list[Field]:
        """Return the fields of a name; refuse what is none, holds no numbers, or another count of them."""
        if name not in self._named:
            raise table.error(key, sentence("references.field", name=name, near=near(name, self._named)))
        for field in self._named[name]:
            if field.type in TEXT_TYPES:
                raise table.error(key, sentence("references.no_number", name=name, type=field.type))
            if field.count not in counts:
                raise table.error(key, sentence("references.count", name=name, count=field.count, counts=counts))
        return self._named[name]

    def _check_whole(self, table: Table, name: str, **numbers: int) -> None:
        for field in self._numbers(table, "field", name):
            check_whole(table, "field", field, **numbers)


def complete_clock(rule: ClockRule, fields: Iterable[Field]) -> ClockRule:
    """Return the clock's rule with what the fields of a stream add: their moduli, and which of them are there."""
    known = {field.name: field for field in reversed([*fields])}
    counter, time = known.get(rule.counter_field), known.get(rule.time_field)
    if counter is None:
        rule = replace(rule, counter_field="")
    elif not rule.counter_modulus:
        rule = replace(rule, counter_modulus=min(counter.modulus, MOST_TICKS))
    if time is None:
        return replace(rule, time_field="")
    if rule.times and not rule.time_modulus:
        # Several time stamps are turned into ns; the longest wrap is theirs.
        wraps = [known[stamp.field].modulus * NANOSECONDS / stamp.ticks_per_s for stamp in rule.times]
        return replace(rule, time_modulus=round(max((wrap for wrap in wraps if wrap < _LONGEST_WRAP_NS), default=0)))
    wraps_itself = not rule.times and not rule.time_modulus and time.modulus <= _LONGEST_WRAP
    return replace(rule, time_modulus=time.modulus) if wraps_itself else rule
