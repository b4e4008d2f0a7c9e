"""The tables [text], [sample] and [clock] of a protocol file: columns, units, flags, counter and time stamp."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.checksum import Checksum, make_checksum
from imufield.acquire.protocol.layout import Field
from imufield.acquire.protocol.toml import Table
from imufield.acquire.protocol.units import UNITS_OF
from imufield.dataclass import dataclass
from imufield.errors import ProtocolError
from imufield.limits import RATE_RANGE_HZ
from imufield.samples import (
    ACCELEROMETER_COLUMNS,
    GYROSCOPE_COLUMNS,
    INSTRUMENT_STATUS_SHIFT,
    IntArray,
    SampleUnits,
    Status,
)
from imufield.sentences import Sentences

sentence = Sentences(__package__)

NANOSECONDS = 1e9
PARTS = ("accelerometer", "gyroscope", "temperature")
"""Of a sample."""
COLUMNS = ("time", "counter", *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS, "temperature", "-")
"""What a number of a line may be; "-" is passed over."""
_COLUMNS_OF = {
    "accelerometer": ACCELEROMETER_COLUMNS,
    "gyroscope": GYROSCOPE_COLUMNS,
    "temperature": ("temperature",),
}
COLUMN_FIELDS = (
    Field(name="time", type="f64", at=0),
    Field(name="counter", type="u64", at=0),
    *(Field(name=name, type="f64", at=0, unit=UNITS_OF[part][0]) for part, names in _COLUMNS_OF.items() for name in names),
)
"""Columns as fields. A stream may lack some of them: its user says which there are."""

# No instrument counts more slowly than every quarter of an hour, or faster than femtoseconds.
LEAST_TICKS_PER_S = 1e-3
MOST_TICKS_PER_S = 1e15
MOST_TICKS = 1 << 53
"""A float tells all smaller numbers of ticks apart."""


@dataclass(frozen=True, slots=True)
class SentenceRule:
    """A line that begins with a name."""

    name: str
    columns: tuple[str, ...]
    """In the order of the line; "-" is passed over, "-ax" is the negative of ax."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextRule:
    """How lines of numbers are read."""

    columns: tuple[str, ...]
    """Names in the order of the line; "-" is passed over."""
    delimiter: str = "comma"
    prefix: str = ""
    comments: tuple[str, ...] = ()
    sentences: tuple[SentenceRule, ...] = ()
    """Kinds of lines that begin with a name of their own; empty: all lines are of one kind."""
    markers: str = "$"
    """Characters a sentence may begin with; its name stands behind."""
    header_end: str = ""
    """Ends a header that is passed over; empty: the numbers begin behind the name."""
    checksums: tuple[Checksum, ...] = ()
    """By the number of digits behind the star; a sentence without one of them is refused."""


@dataclass(frozen=True, slots=True)
class ScaleWhen:
    """A scale that holds while status bits of the same frame are set."""

    field: str
    mask: int
    scale: float


@dataclass(frozen=True, slots=True)
class TimeRule:
    """One of several time stamps a stream may have."""

    field: str
    modulus: int
    ticks_per_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A part of a sample: the first of these fields that a frame has (or three of one value each)."""

    fields: tuple[str, ...] = ()
    unit: str | None = None
    """None: the unit of the field."""
    increment: bool = False
    scale: float = 1.0
    """What the values are multiplied by, besides what their fields say."""
    scale_when: ScaleWhen | None = None
    sensor_temperature: str = ""
    """Field with the temperature of each of the three sensors, or of all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlagRule:
    """Status bits of the instrument that set flags of a sample."""

    field: str
    """Field of a frame, or signal of a bus."""
    flag: Status
    mask: int
    """Any of these bits sets it, as a number of 64 bits with a sign; 0 where ``values`` tell."""
    when_clear: bool = False
    values: tuple[int, ...] = ()
    """Numbers that set it; signals of a bus only."""

    def bits(self, raw: IntArray) -> NDArray[np.uint32]:
        """Return the flag where a status field sets it, elsewhere 0. Shape (n,)."""
        is_set = np.isin(raw, self.values) if self.values else (raw & self.mask) != 0
        return np.where(is_set ^ self.when_clear, np.uint32(self.flag), np.uint32(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleRule:
    """What fields mean in a sample."""

    accelerometer: Quantity = Quantity()
    gyroscope: Quantity = Quantity()
    temperature: Quantity = Quantity()
    flags: tuple[FlagRule, ...] = ()
    instrument_status: tuple[tuple[str, int], ...] = ()
    """Fields and by how many bits they are shifted inside the upper 16 bits of the status."""
    corrected: bool = False
    """The instrument has corrected the values itself and taken gravity out of them."""
    advice: str = ""
    """What to set the instrument to where it sends no sample that can be calibrated from."""

    def quantity(self, part: str) -> Quantity:
        """Return the rule of "accelerometer", "gyroscope" or "temperature"."""
        found: Quantity = getattr(self, part)
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockRule:
    """What gives a sample its time."""

    counter_field: str = ""
    counter_modulus: int = 0
    counter_ticks_per_s: float = 0.0
    """0: the counter counts samples and says nothing about time."""
    counter_steps: tuple[int, ...] = (1,)
    time_field: str = ""
    time_modulus: int = 0
    time_ticks_per_s: float = 1.0
    rate_hz: float = 0.0
    """Nominal sample rate; 0: not known beforehand."""
    counter_jitter: int = 0
    """By how much a step of the counter may differ from the regular one: it counts time, and rounds."""
    counter_counts_others: bool = False
    """The counter also counts messages that are no samples, so it says nothing where there is a time stamp."""
    times: tuple[TimeRule, ...] = ()
    """Several time stamps, of which the first that a frame has counts; all are turned into ns."""
    gaps_told: bool = False
    """The flags of the samples tell where some are lost, and the time is as it stands."""


def read_text(top: Table) -> TextRule:
    """Read ``[text]``."""
    with top.table("text") as table:
        if table.has("sentences"):
            return _read_sentences(table)
        columns = _read_columns(table, COLUMNS)
        if not {"ax", "ay", "az"} <= set(columns):
            raise table.error("columns", sentence("samples_and_clock.no_acceleration", columns=columns))
        return TextRule(
            columns=columns,
            delimiter=table.choice("delimiter", ("auto", "comma", "semicolon", "whitespace"), "auto"),
            prefix=table.text("prefix", ""),
            comments=table.texts("comments"),
        )


def _read_sentences(table: Table) -> TextRule:
    known = ("", *COLUMNS, *(f"-{name}" for name in COLUMNS))
    sentences, checksums = [], []
    for each in table.tables("sentences"):
        with each:
            sentences.append(SentenceRule(each.text("name"), _read_columns(each, known)))
    for each in table.tables("checksums"):
        with each:
            checksums.append(read_checksum(each))
    used = {name.lstrip("-") for rule in sentences for name in rule.columns}
    markers = table.text("markers", "$")
    if not markers:
        raise table.error("markers", sentence("samples_and_clock.no_marker"))
    if not checksums:
        raise table.error("checksums", sentence("samples_and_clock.no_checksum"))
    return TextRule(
        columns=tuple(name for name in COLUMNS if name in used and name != "-"),
        sentences=tuple(sentences),
        markers=markers,
        header_end=table.text("header_end", ""),
        checksums=tuple(checksums),
    )


def _read_columns(table: Table, known: tuple[str, ...]) -> tuple[str, ...]:
    columns = tuple(name.strip() for name in table.text("columns").split(","))
    for name in columns:
        if name not in known or (name not in ("", "-") and columns.count(name) > 1):
            raise table.error("columns", sentence("samples_and_clock.column", column=name, columns=COLUMNS))
    return columns


def read_checksum(table: Table, pad_to: int = 1) -> Checksum:
    """Read the algorithm of a checksum, and its start and final value where they differ from the catalogue's."""
    start = table.optional_integer("start", 0, (1 << 64) - 1)
    final = table.optional_integer("final", 0, (1 << 64) - 1)
    try:
        return make_checksum(table.text("algorithm"), pad_to, start=start, final=final)
    except ProtocolError as error:
        raise table.error("algorithm", error.message) from error


def read_samples(top: Table, *, of_text: bool) -> SampleRule:
    """Read ``[samples]``; lines of text have neither status bits nor sensor temperatures, so their keys are unknown there."""
    with top.table("samples") as table:
        return SampleRule(
            **{part: _read_quantity(table.table(part), _COLUMNS_OF[part] if of_text else ()) for part in PARTS},
            flags=() if of_text else tuple(read_flag(each, "field") for each in table.tables("flags")),
            instrument_status=() if of_text else tuple(read_shift(each, "field") for each in table.tables("instrument_status")),
            corrected=table.flag("corrected"),
            advice=table.text("advice", ""),
        )


def _read_quantity(table: Table, columns: tuple[str, ...]) -> Quantity:
    with table:
        scale_when = None
        if not columns and table.has("scale_when"):
            with table.table("scale_when") as when:
                scale_when = ScaleWhen(when.text("field"), when.integer("mask", 1, (1 << 63) - 1), when.scale("scale"))
        return Quantity(
            fields=table.texts("fields") or columns,
            unit=table.text("unit") if table.has("unit") else None,
            increment=table.flag("increment"),
            scale=table.scale("scale", 1.0),
            scale_when=scale_when,
            sensor_temperature="" if columns else table.text("sensor_temperature", ""),
        )


def read_flag(table: Table, source: str) -> FlagRule:
    """Read a flag; key ``source`` names the field or signal. Signals of a bus may have values instead of a mask."""
    names = {flag.name.lower(): flag for flag in Status if flag.name}
    has_values = source == "signal" and table.has("values")
    with table:
        mask = 0 if source == "signal" and not table.has("mask") else table.integer("mask", 1, (1 << 64) - 1)
        rule = FlagRule(
            field=table.text(source),
            # Fields of all sizes are read as numbers of 64 bits with a sign.
            mask=mask - (mask >> 63 << 64),
            flag=names[table.choice("flag", names)],
            when_clear=table.choice("when", ("set", "clear"), "set") == "clear",
            values=table.integers("values", -(1 << 63), (1 << 63) - 1, ()) if has_values else (),
        )
        if bool(rule.values) == bool(rule.mask):
            raise table.error("values", sentence("samples_and_clock.flag"))
        return rule


def read_shift(table: Table, source: str) -> tuple[str, int]:
    """Read a status field or signal and by how many bits it is shifted."""
    with table:
        return table.text(source), table.integer("shift", 0, 31 - INSTRUMENT_STATUS_SHIFT, 0)


def read_clock(top: Table, *, of_text: bool) -> ClockRule:
    """Read ``[clock]``; a line of text has one time stamp, and no flags that tell of losses."""
    with top.table("clock") as table, table.table("counter") as counter:
        several = not of_text and isinstance(table.plain("time"), list)
        times = [_read_time(each) for each in (table.tables("time") if several else [table.table("time")])]
        if several and not all(each.field for each in times):
            raise table.error("time", sentence("samples_and_clock.time_field"))
        # What several have in common: the first field, the longest wrap, ns.
        longest = max(round(each.modulus * NANOSECONDS / each.ticks_per_s) for each in times)
        time = TimeRule(times[0].field, longest, NANOSECONDS) if several else times[0]
        modulus = read_modulus(counter)
        return ClockRule(
            counter_field=counter.text("field", ""),
            counter_modulus=modulus,
            counter_ticks_per_s=counter.known_number("ticks_per_s", low=LEAST_TICKS_PER_S, high=MOST_TICKS_PER_S),
            counter_steps=read_steps(counter, "steps", modulus),
            time_field=time.field,
            time_modulus=time.modulus,
            time_ticks_per_s=time.ticks_per_s,
            rate_hz=read_rate(table),
            counter_jitter=counter.integer("jitter", 0, 1 << 16, 0),
            counter_counts_others=counter.flag("counts_others"),
            times=tuple(times) if several else (),
            gaps_told=not of_text and table.flag("gaps_told"),
        )


def read_steps(table: Table, key: str, modulus: int) -> tuple[int, ...]:
    """Read the steps that a counter may make from one sample to the next, 1 where none is given; modulus 0: not known."""
    return table.integers(key, 1, (modulus or MOST_TICKS) - 1, (1,))


def read_modulus(table: Table, key: str = "modulus") -> int:
    """Read how many numbers a counter or a time stamp runs through before it begins anew; 0 where that is not stated."""
    return table.known_integer(key, low=2, high=MOST_TICKS)


def read_rate(table: Table) -> float:
    """Read the nominal sample rate in Hz of ``[clock]``; 0 where it is not known."""
    return table.known_number("rate_hz", low=RATE_RANGE_HZ[0], high=RATE_RANGE_HZ[1])


def _read_time(table: Table) -> TimeRule:
    with table:
        return TimeRule(
            table.text("field", ""),
            read_modulus(table),
            table.number("ticks_per_s", 1.0, low=LEAST_TICKS_PER_S, high=MOST_TICKS_PER_S),
        )


def sample_units(
    table: Table, clock: ClockRule, accelerometer: str, gyroscope: str, *, increments: tuple[bool, bool] = (False, False)
) -> SampleUnits:
    """Return the units of a sample; ``table`` is ``[clock]``, which must have the rate where values are increments.

    Parameters
    ----------
    table : Table
    clock : ClockRule
    accelerometer, gyroscope : str
        Their units; those of velocity and angle are increments in any case.
    increments : tuple of bool
        Whether accelerometer and gyroscope send increments in a unit that does not say so.
    """
    by_velocity, by_angle = accelerometer == "m/s" or increments[0], gyroscope == "rad" or increments[1]
    if (by_velocity or by_angle) and not clock.rate_hz:
        raise table.error("rate_hz", sentence("samples_and_clock.no_rate"))
    return SampleUnits(
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        accelerometer_is_increment=by_velocity,
        gyroscope_is_increment=by_angle,
        interval_s=1 / clock.rate_hz if by_velocity or by_angle else None,
    )
