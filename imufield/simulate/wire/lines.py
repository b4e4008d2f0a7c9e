"""Samples to lines of text: by the columns of a protocol, or as sentences (``$NAME,number,...*checksum``)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from imufield.acquire.formats.table_names import quantity_of
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import PARTS
from imufield.dataclass import dataclass
from imufield.errors import UsageError
from imufield.samples import FloatArray, IntArray, Samples
from imufield.sentences import Sentences
from imufield.simulate.wire.forms import WireFrame, number_template
from imufield.simulate.wire.frames import WireClock

sentence = Sentences(__package__)

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
        assert protocol.lines is not None  # noqa: S101  checked by the caller
        rule, ticks_per_s = protocol.lines, protocol.clock.time_ticks_per_s
        units = {"accelerometer": protocol.units.accelerometer, "gyroscope": protocol.units.gyroscope}
        # Who scales numbers prints whole ones.
        counted = {part for part, unit in units.items() if unit in RAW_UNITS or protocol.samples.quantity(part).scale != 1.0}
        whole = [quantity_of(name) in counted for name in rule.columns]
        cells = [number_template(name, ticks_per_s, whole=count) for name, count in zip(rule.columns, whole, strict=True)]
        self._table = _Table(protocol, clock, rule.columns, cells)
        self._separator = _SEPARATORS.get(rule.delimiter, ",")
        # Behind a word as behind a number, but not behind "Raw:".
        self._head = rule.prefix + (self._separator if rule.prefix[-1:].isalnum() else "")
        self.has_counter = "counter" in rule.columns

    def encode(self, samples: Samples) -> list[bytes]:
        """Return the lines of a block."""
        return [(self._head + self._separator.join(row) + LINE_END).encode("ascii") for row in self._table.rows(samples)]


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
        assert protocol.lines is not None  # noqa: S101  checked by the caller
        rule, line = protocol.lines, frame.line
        # MARKER name,header END number,number*checksum: the numbers begin behind the end of the header, or the name.
        body, _, self._check = line[1:].rpartition("*")
        separator = rule.header_end or ","
        head, _, numbers = body.partition(separator)
        self._marker, self._head, cells = line[:1].encode(), head + separator, numbers.split(",")
        rules = [known for known in rule.sentences if known.name == self._head.partition(",")[0]]
        if not rules or len(cells) != len(rules[0].columns):
            raise UsageError(sentence("lines.no_sentence", line=line, protocol=protocol.name))
        columns = rules[0].columns
        self._table = _Table(protocol, clock, columns, cells)
        # Two hexadecimal digits for each byte of the checksum.
        self._checksum = next(known for known in rule.checksums if 2 * known.size == len(self._check.format(0)))
        self.has_counter = "counter" in columns

    def encode(self, samples: Samples) -> list[bytes]:
        """Return the lines of a block."""
        lines = []
        for row in self._table.rows(samples):
            body = (self._head + ",".join(row)).encode("ascii")
            value = int(self._checksum.of_rows(np.frombuffer(body, dtype=np.uint8).reshape(1, -1))[0])
            lines.append(self._marker + body + f"*{self._check.format(value)}{LINE_END}".encode())
        return lines


@dataclass(frozen=True, slots=True)
class _Table:
    """Columns of a line, each with the template that prints its numbers."""

    protocol: Protocol
    clock: WireClock
    columns: Sequence[str]
    templates: Sequence[str]

    def rows(self, samples: Samples) -> Iterable[tuple[str, ...]]:
        """Return the printed numbers of each sample."""
        printed = []
        for column, template in zip(self.columns, self.templates, strict=True):
            values = self._values(column, samples)
            # A template without a number is printed as it is.
            printed.append(
                [template] * len(samples) if values is None else [template.format(value) for value in values.tolist()]
            )
        return zip(*printed, strict=True)

    def _values(self, column: str, samples: Samples) -> FloatArray | IntArray | None:
        """Return the numbers of one column as they are printed; None for one that means nothing in a sample."""
        name, rule = column.removeprefix("-"), self.protocol.clock
        sign = -1.0 if column.startswith("-") else 1.0
        parts = (samples.accelerometer, samples.gyroscope, samples.temperature_degc[:, np.newaxis])
        for part, values in zip(PARTS, parts, strict=True):
            fields = self.protocol.samples.quantity(part).fields
            if name in fields:
                return sign * values[:, fields.index(name)] / self.protocol.factors[part]
        if name == "time":
            ticks = self.clock.time_s(samples) * rule.time_ticks_per_s
            return ticks % rule.time_modulus if rule.time_modulus else ticks
        return self.clock.counter(samples, 0) if name == "counter" else None
