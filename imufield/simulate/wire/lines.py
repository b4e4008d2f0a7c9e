"""Samples to lines, by the columns that decode them: numbers alone, or sentences, ``$NAME,number,...*checksum``."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imufield.acquire.formats.table_columns import quantity_of
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import TextRule
from imufield.errors import UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, FloatArray, IntArray, Samples
from imufield.simulate.wire.forms import WireFrame, number_template
from imufield.simulate.wire.frames import WireClock

LINE_END = "\r\n"
RAW_UNITS = ("count", "pulse")
_SEPARATORS = {"comma": ",", "semicolon": ";", "whitespace": " "}


class LineEncoder:
    """Encodes one line of numbers for each sample.

    Parameters
    ----------
    protocol : Protocol
        Of kind "text" without sentences.
    clock : WireClock
    """

    def __init__(self, protocol: Protocol, clock: WireClock) -> None:
        assert protocol.lines is not None  # noqa: S101  the caller looked
        self._protocol, self._clock = protocol, clock
        separator = _SEPARATORS.get(protocol.lines.delimiter, ",")
        raw = {"accelerometer": protocol.units.accelerometer, "gyroscope": protocol.units.gyroscope}
        ticks_per_s = protocol.clock.time_ticks_per_s
        self._cells = [
            (name, number_template(name, ticks_per_s, whole=raw.get(quantity_of(name)) in RAW_UNITS))
            for name in protocol.lines.columns
        ]
        self._head = protocol.lines.prefix + separator if protocol.lines.prefix else ""
        self._separator = separator
        self.has_counter = "counter" in protocol.lines.columns

    def encode(self, samples: Samples) -> list[bytes]:
        """Return the lines of a block."""
        columns = [
            _print(text, _column_values(name, samples, self._protocol, self._clock), len(samples)) for name, text in self._cells
        ]
        return [(self._head + self._separator.join(row) + LINE_END).encode("ascii") for row in zip(*columns, strict=True)]


class SentenceEncoder:
    """Encodes one sentence for each sample.

    Parameters
    ----------
    protocol : Protocol
        Of kind "text" with sentences.
    frame : WireFrame
        With a line.
    clock : WireClock

    Raises
    ------
    UsageError
        If the template does not fit the sentence.
    """

    def __init__(self, protocol: Protocol, frame: WireFrame, clock: WireClock) -> None:
        assert protocol.lines is not None  # noqa: S101  the caller looked
        self._protocol, self._clock = protocol, clock
        self._marker, self._head, cells, self._check = _split(protocol.lines, frame.line)
        sentence = next((one for one in protocol.lines.sentences if one.name == self._head.partition(",")[0]), None)
        if sentence is None or len(cells) != len(sentence.columns):
            raise UsageError(f"line {frame.line!r} is no sentence of {protocol.name}; correct its table [[emulate]]")
        self._cells = list(zip(sentence.columns, cells, strict=True))
        self._checksum = next(one for one in protocol.lines.checksums if 2 * one.size == len(self._check.format(0)))
        self.has_counter = "counter" in sentence.columns

    def encode(self, samples: Samples) -> list[bytes]:
        """Return the lines of a block."""
        columns = [
            _print(text, _column_values(name, samples, self._protocol, self._clock), len(samples)) for name, text in self._cells
        ]
        bodies = [(self._head + ",".join(row)).encode("ascii") for row in zip(*columns, strict=True)]
        return [self._closed(body) for body in bodies]

    def _closed(self, body: bytes) -> bytes:
        value = int(self._checksum.of_rows(np.frombuffer(body, dtype=np.uint8).reshape(1, -1))[0])
        return self._marker.encode() + body + f"*{self._check.format(value)}{LINE_END}".encode()


def _column_values(column: str, samples: Samples, protocol: Protocol, wire: WireClock) -> FloatArray | IntArray | None:
    """Return the numbers of one column as they are printed; None for one that means nothing in a sample."""
    name = column.removeprefix("-")
    sign, factors, clock = (-1.0 if column.startswith("-") else 1.0), protocol.factors, protocol.clock
    if name in ACCELEROMETER_COLUMNS:
        return sign * samples.accelerometer[:, ACCELEROMETER_COLUMNS.index(name)] / factors["accelerometer"]
    if name in GYROSCOPE_COLUMNS:
        return sign * samples.gyroscope[:, GYROSCOPE_COLUMNS.index(name)] / factors["gyroscope"]
    if name == "temperature":
        return samples.temperature_degc
    if name == "time":
        ticks = wire.time_s(samples) * clock.time_ticks_per_s
        return ticks % clock.time_modulus if clock.time_modulus else ticks
    return wire.counter(samples, 0) if name == "counter" else None


def _split(rule: TextRule, line: str) -> tuple[str, str, list[str], str]:
    """Return marker, name with header and separator, the cells of the numbers, and the template of the checksum."""
    body, _, check = line[1:].rpartition("*")
    separator = rule.header_end or ","
    head, _, cells = body.partition(separator)
    return line[:1], head + separator, cells.split(","), check


def _print(text: str, values: FloatArray | IntArray | None, count: int) -> list[str]:
    return [text] * count if values is None else [text.format(value) for value in values.tolist()]


TEXT_COLUMNS = ("time", *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS)
"""What a line of text holds unless told otherwise; ``counter`` and ``temperature`` may be added."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextFormat:
    """Lines of numbers as home-made systems print them.

    Raises
    ------
    UsageError
        If a column has no such name.
    """

    columns: tuple[str, ...] = TEXT_COLUMNS
    separator: str = ","
    prefix: str = ""
    line_end: str = "\r\n"
    decimals: int = 9
    """Places after the point; 0 for counts and pulses."""

    def __post_init__(self) -> None:
        known = (*TEXT_COLUMNS, "counter", "temperature")
        unknown = [name for name in self.columns if name not in known]
        if unknown:
            raise UsageError(f"there is no column {unknown[0]!r} of text; choose among {', '.join(known)}", column=unknown[0])


def encode_text(samples: Samples, settings: TextFormat) -> list[bytes]:
    """Return the lines of a block, values in the unit of the samples; what is not available is left empty."""
    values = {
        "time": samples.time_s,
        "counter": samples.counter,
        **dict(zip(ACCELEROMETER_COLUMNS, samples.accelerometer.T, strict=True)),
        **dict(zip(GYROSCOPE_COLUMNS, samples.gyroscope.T, strict=True)),
        "temperature": samples.temperature_degc,
    }
    columns = [_print_column(name, values[name], settings.decimals) for name in settings.columns]
    rows = zip(*columns, strict=True)
    return [(settings.prefix + settings.separator.join(row) + settings.line_end).encode("ascii") for row in rows]


def _print_column(name: str, values: FloatArray | IntArray, decimals: int) -> list[str]:
    places = {"time": 6, "counter": 0, "temperature": 2}.get(name, decimals)
    return ["" if math.isnan(value) else f"{value:.{places}f}" for value in values.tolist()]
