"""Where the values stand inside a frame, and NumPy reading them for all frames of one kind at once.

``rows`` is everywhere an array of uint8, shape (n, length): n frames of one kind, any row stride, bytes of a row contiguous.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from imufield.samples import FloatArray

Rows = NDArray[np.uint8]
Numbers = NDArray[np.number]
"""As sent, of whatever type the field has."""
MessageValue = str | int | float | list[int] | list[float] | None
"""Value of a field in a message, for people and programs."""

NUMBER_BYTES = {f"{kind}{8 * size}": size for size in (1, 2, 3, 4, 8) for kind in "ui"} | {"f32": 4, "f64": 8, "fp16.32": 6}
"""Number types and their size."""
TEXT_TYPES = ("ascii", "bcd", "bytes")
"""Types that are no numbers: characters, one digit per half byte, anything else (shown in hexadecimal)."""


@dataclass(frozen=True, slots=True)
class Bits:
    """Some bits of an unsigned field under a name of their own."""

    name: str
    start: int
    size: int
    values: tuple[str | int | float, ...] = ()
    """What the numbers mean, from 0; empty: the number itself."""

    def of(self, raw: int) -> str | int | float | None:
        """Return the meaning of these bits of ``raw``; None where it has none."""
        number = raw >> self.start & (1 << self.size) - 1
        if not self.values:
            return number
        return self.values[number] if number < len(self.values) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One field of a frame: ``count`` values of one type, value = raw * factor + offset in ``unit``."""

    name: str
    type: str
    at: int
    """Offset of the first byte in the frame."""
    count: int = 1
    size: int = 0
    """Bytes of the whole field."""
    big_endian: bool = True
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    bits: tuple[Bits, ...] = ()
    repeat: int = 0
    """Bytes that follow for each unit of the first byte of this field."""

    @property
    def modulus(self) -> int:
        """One more than the largest value of an unsigned type; 0 for others."""
        return 1 << 8 * NUMBER_BYTES[self.type] if self.type[0] == "u" else 0

    def raw(self, rows: Rows) -> Numbers:
        """Return the numbers as sent, shape (n,) or (n, count). Integers of 24 bits come as 32."""
        if NUMBER_BYTES[self.type] == 3:
            values = self._raw24(rows)
        elif self.type == "fp16.32":
            values = self._raw48(rows)
        else:
            order = ">" if self.big_endian else "<"
            kind = np.dtype(f"{order}{self.type[0]}{NUMBER_BYTES[self.type]}")
            values = rows[:, self.at : self.at + self.size].view(kind)
        return values[:, 0] if self.count == 1 else values

    def values(self, rows: Rows) -> FloatArray:
        """Return the numbers in ``unit``, shape (n,) or (n, count)."""
        scaled: FloatArray = np.multiply(self.raw(rows), self.factor, dtype=np.float64)
        return scaled + self.offset if self.offset else scaled

    def text(self, row: bytes) -> str:
        """Return a field that is no number, from one frame."""
        part = row[self.at : self.at + self.size]
        if self.type == "ascii":
            # Texts of fixed length are filled up with zeros by some makers, with spaces by others.
            return part.decode("ascii", "replace").strip("\x00 ")
        return part.hex()

    def _raw48(self, rows: Rows) -> Numbers:
        # Xsens sends the 32 bits of the fraction first, the 16 bits of the whole number behind them.
        parts = np.ascontiguousarray(rows[:, self.at : self.at + self.size])
        words = parts.view(f"{'>' if self.big_endian else '<'}u2").reshape(len(rows), self.count, 3).astype(np.int64)
        whole = words[:, :, 2].astype(np.int16).astype(np.int64)
        return whole << 32 | words[:, :, 0] << 16 | words[:, :, 1]

    def _raw24(self, rows: Rows) -> Numbers:
        # Four bytes are read, of which one belongs to the neighbour and is shifted out: several times faster than
        # putting three single bytes together. Where there is no neighbour the row gets one more byte.
        start = self.at if self.big_endian else self.at - 1
        if start < 0 or start + 3 * self.count + 1 > rows.shape[1]:
            rows, start = np.pad(rows, ((0, 0), (1, 1))), start + 1
        kind = np.dtype((">" if self.big_endian else "<") + self.type[0] + "4")
        first = rows[:, start : start + 4].view(kind)
        values = as_strided(first, (len(rows), self.count), (first.strides[0], 3), writeable=False)
        return values >> 8


@dataclass(frozen=True, slots=True)
class Layout:
    """All fields of one kind of frame."""

    kind: str
    """The key of the frame as the protocol writes it, or the name of the message."""
    fields: tuple[Field, ...]
    length: int
    """Bytes from the first to the last of the checksum."""
    is_message: bool = False

    def field(self, name: str) -> Field | None:
        """Return the field of that name, None where this kind of frame has none."""
        return next((field for field in self.fields if field.name == name), None)

    def fields_of(self, names: Iterable[str]) -> list[Field]:
        """Return those fields of these names that this kind of frame has."""
        return [field for name in names if (field := self.field(name)) is not None]

    def describe(self, row: bytes) -> dict[str, MessageValue]:
        """Return one frame as plain values: numbers raw, bits by their names, text as text; for people and programs.

        Numbers that the protocol scales come a second time in their unit, under the name with the unit appended.
        """
        rows = np.frombuffer(row, dtype=np.uint8).reshape(1, -1)
        found: dict[str, MessageValue] = {}
        for field in self.fields:
            if field.type in TEXT_TYPES:
                found[field.name] = field.text(row)
                continue
            raw = field.raw(rows)[0].tolist()
            found[field.name] = raw
            found.update({bits.name: bits.of(raw) for bits in field.bits})
            if (field.factor, field.offset) != (1.0, 0.0):
                found[f"{field.name} [{field.unit or 1}]"] = field.values(rows)[0].tolist()
        return found
