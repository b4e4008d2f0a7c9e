"""Protocols of CAN instruments: which signals of a DBC file make a sample, and how messages are joined.

Such a protocol is a TOML file with ``kind = "can"`` and a DBC file beside it; ``--dbc`` with ``--map`` writes the same text
from what the user typed. The DBC is appended to the text as table ``[dbc]``, so that a recording holds all that decodes it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TypeVar

from imufield.acquire.protocol.can_dbc import COUNTER_BITS, CanMessage, CanSignal, DbcFile, Selectors
from imufield.acquire.protocol.references import check_values, check_whole
from imufield.acquire.protocol.samples_and_clock import (
    LEAST_TICKS_PER_S,
    MOST_TICKS_PER_S,
    ClockRule,
    FlagRule,
    read_flag,
    read_modulus,
    read_rate,
    read_shift,
    read_steps,
    sample_units,
)
from imufield.acquire.protocol.toml import LARGEST, Table, near
from imufield.acquire.protocol.units import SECONDS, TO_DEGC, TO_SI, UNITS_OF, known_units, unit_name
from imufield.dataclass import dataclass, field
from imufield.errors import ProtocolError, Reason
from imufield.limits import BAUD_RANGE
from imufield.samples import SampleUnits
from imufield.sentences import Sentences

sentence = Sentences(__package__)

ANY_ADDRESS = 255
"""Source address that stands for the first one heard; no node may send from it (J1939-81)."""
TEMPERATURE = 6
"""Place of the temperature among the values of a sample, behind three of the accelerometer and three of the gyroscope."""
_PLACES = {"accelerometer": 0, "gyroscope": 3}
_LONGEST_LIMIT_S = 10.0
_SHORTEST_LIMIT_S = 1e-6  # Below the time of one frame on the fastest bus.
_LONG_TIME_BITS = 48  # A time stamp of so many bits runs for 8.9 years of microseconds before it wraps.
_Found = TypeVar("_Found")
_DBC_LINE = re.compile(r'^[ \t]*+dbc[ \t]*+=[ \t]*+"([^"\n]+)"', re.MULTILINE)
_EMBEDDED = re.compile(r"^\[dbc\]", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Column:
    """One value of a sample: raw * factor + offset."""

    place: int
    """0 to 2 accelerometer, 3 to 5 gyroscope, 6 temperature."""
    signal: CanSignal
    factor: float
    offset: float


@dataclass(slots=True, kw_only=True)
class CanKind:
    """One kind of frame that belongs to a sample: a message, or one multiplexed form of it."""

    message: CanMessage
    columns: list[Column] = field(default_factory=list)
    flags: list[tuple[CanSignal, FlagRule]] = field(default_factory=list)
    status: list[tuple[CanSignal, int]] = field(default_factory=list)
    """Signals of the instrument's status and by how many bits they are shifted in the upper half of the flags."""
    counter: CanSignal | None = None
    counter_modulus: int = 1
    """After how many counts it begins anew; 1 without a counter."""
    time: CanSignal | None = None
    group: CanSignal | None = None
    """Counter that the messages of one sample share."""

    @property
    def name(self) -> str:
        """Name of the message, with the multiplexer's value where there is one."""
        chosen = "".join(f"[{'/'.join(map(str, values))}]" for _, values in self.message.selectors)
        return self.message.name + chosen

    @property
    def bytes_needed(self) -> int:
        """Data bytes without which a frame is of no use."""
        pairs = [*self.flags, *self.status, *self.message.selectors]
        optional = [signal for signal in (self.counter, self.time, self.group) if signal is not None]
        signals = [*(column.signal for column in self.columns), *(signal for signal, _ in pairs), *optional]
        return max(signal.bytes_needed for signal in signals)


@dataclass(frozen=True, slots=True)
class AssemblyRule:
    """How the frames of one sample are found."""

    starts_with: int | None = None
    """Number of the kind a sample begins with; None: learned from the pauses of the bus."""
    needs: tuple[int, ...] = ()
    """Kinds without which there is no sample; what else is missing is not available."""
    limit_s: float = 0.0
    """Latest time of a frame behind the first of its sample; 0: three quarters of the learned period."""

    group_modulus: int = 0
    """The smallest of the counters that all kinds share (``CanKind.group``); 0 where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanRule:
    """Everything a decoder needs to know of one CAN instrument."""

    dbc: DbcFile
    kinds: tuple[CanKind, ...]
    assembly: AssemblyRule
    messages: tuple[CanMessage, ...]
    """Messages that are kept for identity and settings."""
    source_address: int
    """Only J1939 frames from here; ``ANY_ADDRESS``: from where the first comes."""
    bit_rate: int | None

    @property
    def has_accelerometer(self) -> bool:
        """Whether samples have an accelerometer."""
        return any(column.place < 3 for kind in self.kinds for column in kind.columns)

    @property
    def has_gyroscope(self) -> bool:
        """Whether samples have a gyroscope."""
        return any(3 <= column.place < TEMPERATURE for kind in self.kinds for column in kind.columns)


def embed_dbc(text: str, read: Callable[[str], str]) -> str:
    """Return a protocol's text with the DBC file it names appended; other texts as they are.

    Parameters
    ----------
    text : str
    read : callable
        Returns the text of the file of that name.
    """
    found = _DBC_LINE.search(text)
    if found is None or _EMBEDDED.search(text):
        return text
    return text.rstrip("\n") + dbc_table(read(found.group(1)))


def dbc_table(content: str) -> str:
    """Return a DBC file as the table ``[dbc]`` of a protocol."""
    # TOML has no control characters, and reads a carriage return as the end of a line.
    content = "".join(" " if ord(mark) < 32 and mark not in "\n\t" else mark for mark in content.replace("\r\n", "\n"))
    # Three quotes, which end the text, stand in comments if anywhere.
    content = content.replace("'''", "'' '").replace("\x7f", " ")
    return f"\n\n[dbc]\ntext = '''\n{content}'''\n"


def read_can(top: Table) -> tuple[CanRule, SampleUnits, ClockRule]:
    """Read ``[can]``, ``[map]``, ``[assembly]``, ``[clock]`` and ``[dbc]``.

    Raises
    ------
    ProtocolError
        If something is missing, unknown or contradictory, with line and key.
    """
    can, assembly, clock, embedded = top.table("can"), top.table("assembly"), top.table("clock"), top.table("dbc")
    name, identifiers = can.text("dbc", "DBC file"), can.choice("identifiers", ("auto", "exact", "j1939"), "auto")
    if not embedded.has("text"):
        raise can.error("dbc", sentence("can_protocol.no_dbc"))
    dbc = DbcFile(embedded.text("text"), name, identifiers)
    mapped = _Mapping(top.table("map"), dbc)
    units_of = {part: mapped.triad(part) for part in _PLACES}
    mapped.others()
    if not any(units_of.values()):
        raise mapped.table.error("", sentence("can_protocol.nothing_mapped", candidates=_candidates(dbc)))
    modulus = mapped.settle_counter(clock)
    clock_rule = ClockRule(
        counter_modulus=modulus,
        counter_steps=read_steps(clock, "counter_steps", modulus),
        time_modulus=mapped.time_modulus,
        time_ticks_per_s=clock.number("time_ticks_per_s", mapped.ticks_per_s, low=LEAST_TICKS_PER_S, high=MOST_TICKS_PER_S),
        rate_hz=read_rate(clock),
    )
    units = sample_units(clock, clock_rule, units_of["accelerometer"] or "m/s^2", units_of["gyroscope"] or "rad/s")
    rule = CanRule(
        dbc=dbc,
        kinds=tuple(mapped.kinds.values()),
        assembly=_read_assembly(assembly, mapped),
        messages=tuple(_in_file(can, "messages", dbc.message, name) for name in can.texts("messages")),
        source_address=can.integer("source_address", 0, ANY_ADDRESS, ANY_ADDRESS),
        bit_rate=can.optional_integer("bit_rate", *BAUD_RANGE),
    )
    for table in (can, assembly, clock, embedded, mapped.table):
        table.finish()
    return rule, units, clock_rule


def _in_file(table: Table, key: str, find: Callable[[str], _Found], name: str) -> _Found:
    try:
        return find(name)
    except ProtocolError as error:
        raise table.error(key, error.message) from error


class _Mapping:
    """Table ``[map]`` being read: collects what each kind of frame carries."""

    def __init__(self, table: Table, dbc: DbcFile) -> None:
        self.table = table
        self.kinds: dict[tuple[str, Selectors], CanKind] = {}
        self.ticks_per_s = 1.0
        self.time_modulus = 0
        self._dbc = dbc
        self._counter_kind: CanKind | None = None

    def settle_counter(self, clock: Table) -> int:
        """Note in its kind where the counter begins anew, as ``[clock]`` states it, else the file; 0 without a counter."""
        stated = read_modulus(clock, "counter_modulus")
        if self._counter_kind is None or (counter := self._counter_kind.counter) is None:
            if clock.has("counter_modulus"):
                raise clock.error("counter_modulus", sentence("can_protocol.no_counter"))
            return 0
        check_whole(clock, "counter_modulus", counter, counter_modulus=stated - 1)
        self._counter_kind.counter_modulus = stated or min(counter.stated_modulus, 1 << COUNTER_BITS)
        return self._counter_kind.counter_modulus

    def triad(self, part: str) -> str:
        """Read three axes; return their unit in a sample, "" where the part is not mapped."""
        names = self.table.texts(part)
        if not names:
            self.table.has(f"{part}_unit")
            return ""
        if len(names) != 3:
            raise self.table.error(part, sentence("can_protocol.three_signals", count=len(names), names=names))
        units = {self._axis(part, place, name) for place, name in enumerate(names)}
        if len(units) > 1:
            raise self.table.error(part, sentence("can_protocol.mixed_units", units=" and ".join(sorted(units))))
        return units.pop()

    def _axis(self, part: str, axis: int, name: str) -> str:
        kind, signal = self._find(part, name.lstrip("-"))
        given = self.table.text(f"{part}_unit", "")
        written = given or signal.unit
        unit, factor = TO_SI.get(unit_name(written, part) or "", ("", 0.0))
        if unit not in UNITS_OF[part]:
            shown = f"{written!r}" if written else "no unit"
            wrong = sentence("can_protocol.unit", signal=signal.name, unit=shown, part=part, known=known_units(part))
            raise self.table.error(f"{part}_unit" if given else part, wrong, Reason.UNITS)
        if any(column.signal.name == signal.name and column.place // 3 == _PLACES[part] // 3 for column in kind.columns):
            raise self.table.error(part, sentence("can_protocol.twice", name=signal.name))
        factor = -factor if name.startswith("-") else factor
        kind.columns.append(Column(_PLACES[part] + axis, signal, signal.factor * factor, signal.offset * factor))
        return unit

    def others(self) -> None:
        """Read temperature, counter, time, flags and status."""
        if self.table.has("temperature"):
            kind, signal = self._find("temperature", self.table.text("temperature"))
            given = self.table.text("temperature_unit", "")
            written = given or signal.unit
            unit = unit_name(written, "temperature")
            if unit is None:
                wrong = sentence("can_protocol.temperature_unit", signal=signal.name, unit=written, known=[*TO_DEGC])
                raise self.table.error("temperature_unit" if given else "temperature", wrong, Reason.UNITS)
            factor, offset = TO_DEGC[unit]
            kind.columns.append(Column(TEMPERATURE, signal, signal.factor * factor, signal.offset * factor + offset))
        if self.table.has("counter"):
            kind, signal = self._find("counter", self.table.text("counter"))
            check_whole(self.table, "counter", signal)
            kind.counter, self._counter_kind = signal, kind
        if self.table.has("time"):
            kind, signal = self._find("time", self.table.text("time"))
            kind.time = signal
            # What has no unit counts as seconds, as in sessions of earlier versions; ``--map`` refuses it.
            unit = unit_name(signal.unit, "time")
            # A factor of 0 is refused with the other rates that no clock has.
            self.ticks_per_s = 1.0 / (SECONDS[unit or "s"] * abs(signal.factor) or math.inf)
            self.time_modulus = signal.stated_modulus if signal.stated_modulus < 1 << _LONG_TIME_BITS else 0
        for each in self.table.tables("flags"):
            kind, signal = self._find("flags", each.text("signal"))
            flag = read_flag(each, "signal")
            check_whole(each, "signal", signal, mask=flag.mask % (1 << 64))
            if flag.values:
                check_values(each, "values", signal, flag.values)
            kind.flags.append((signal, flag))
        for each in self.table.tables("instrument_status"):
            kind, signal = self._find("instrument_status", each.text("signal"))
            check_whole(each, "signal", signal)
            kind.status.append((signal, read_shift(each, "signal")[1]))

    def group(self, key: str, table: Table, name: str) -> None:
        """Note a counter that the messages of one sample share."""
        found, signal = _in_file(table, key, self._dbc.find, name)
        # A signal outside all multiplexed forms is part of each.
        kinds = [kind for kind in self.kinds.values() if kind.message.name == found.name]
        kinds = [kind for kind in kinds if not found.selectors or kind.message.selectors == found.selectors]
        if not kinds:
            raise table.error(key, sentence("can_protocol.group", message=found.name, name=name))
        check_whole(table, key, signal)
        for kind in kinds:
            kind.group = signal

    def numbers_of(self, table: Table, key: str, name: str) -> list[int]:
        """Return the numbers of the kinds of frames that a key of another table names: all forms of a message."""
        kinds = [*self.kinds.values()]
        found = [number for number, kind in enumerate(kinds) if name in (kind.name, kind.message.name)]
        if found:
            return found
        _in_file(table, key, self._dbc.message, name)
        names = [kind.name for kind in kinds]
        raise table.error(key, sentence("can_protocol.not_mapped", name=name, near=near(name, names), known=names))

    def _find(self, key: str, name: str) -> tuple[CanKind, CanSignal]:
        message, signal = _in_file(self.table, key, self._dbc.find, name)
        for other in (kind.message for kind in self.kinds.values()):
            if other.name != message.name and other.meets(message):
                names = [other.name, message.name]
                raise self.table.error(key, sentence("can_protocol.same_identifier", names=names))
        if not message.selectors:
            forms = [kind for kind in self.kinds.values() if kind.message.name == message.name]
            if forms:
                return forms[0], signal
        elif (message.name, ()) in self.kinds:
            raise self.table.error(key, sentence("can_protocol.some_forms", name=name, message=message.name))
        return self.kinds.setdefault((message.name, message.selectors), CanKind(message=message)), signal


def _read_assembly(table: Table, mapped: _Mapping) -> AssemblyRule:
    counters = table.texts("counters")
    for name in counters:
        mapped.group("counters", table, name)
    if counters and any(kind.group is None for kind in mapped.kinds.values()):
        raise table.error("counters", sentence("can_protocol.counters"))
    start = table.text("starts_with", "")
    return AssemblyRule(
        mapped.numbers_of(table, "starts_with", start)[0] if start else None,
        tuple(number for name in table.texts("needs") for number in mapped.numbers_of(table, "needs", name)),
        min(table.known_number("limit_s", low=_SHORTEST_LIMIT_S, high=LARGEST), _LONGEST_LIMIT_S),
        min((kind.group.stated_modulus for kind in mapped.kinds.values() if kind.group), default=0),
    )


def _candidates(dbc: DbcFile) -> str:
    """Name the signals whose unit is one of an accelerometer or a gyroscope."""
    units = {si for part in _PLACES for si in UNITS_OF[part]} - {"rad", "m/s"}
    found = [
        f"{message.name}.{signal.name}"
        for message, signal in dbc.signals()
        if any(TO_SI.get(unit_name(signal.unit, part) or "", ("", 0.0))[0] in units for part in _PLACES)
    ]
    return ", ".join(found[:20]) or "none has such a unit"
