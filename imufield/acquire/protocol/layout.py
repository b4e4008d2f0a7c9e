"""Where the values stand inside a frame, and NumPy reading them for all frames of one kind at once.

Numbers come out as they were sent; ``acquire.decode.frame_source`` makes samples in SI units of them.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray

Bytes = NDArray[np.uint8]
Rows = NDArray[np.uint8]
"""Shape (n, length)."""
Numbers = NDArray[np.number]
"""As sent, of whatever type the field has."""
MessageValue = str | int | float | list[int] | list[float] | None
"""Value of a field in a message, for people and programs."""

NUMBER_BYTES = {f"{kind}{8 * size}": size for size in (1, 2, 3, 4, 8) for kind in "ui"} | {"f32": 4, "f64": 8, "fp16.32": 6}
"""Number types and their size."""
TEXT_TYPES = ("ascii", "bcd", "bytes")
"""Types that are no numbers: characters, one digit per half byte, anything else (shown in hexadecimal)."""
_READ_AS = {"u24": "u4", "i24": "i4", "fp16.32": "u2"}
_DTYPES = {
    (name, big_endian): np.dtype((">" if big_endian else "<") + _READ_AS.get(name, f"{name[0]}{size}"))
    for name, size in NUMBER_BYTES.items()
    for big_endian in (True, False)
}


@dataclass(slots=True)  # Some for each read: a frozen one takes five times as long to make.
class Frames:
    """n frames of one length, evenly spaced in a buffer, so that each field of all of them is one view."""

    data: Bytes
    """One dimension, contiguous."""
    at: int
    """Where the first begins."""
    step: int
    """Bytes from one to the next."""
    count: int
    length: int
    """Bytes of each."""

    @classmethod
    def of(cls, rows: Rows) -> Frames:
        """Return frames that stand in the rows of an array."""
        return cls(np.ascontiguousarray(rows).reshape(-1), 0, rows.shape[1], *rows.shape)

    @property
    def rows(self) -> Rows:
        """The bytes, shape (n, length): a view."""
        return self.columns(0, self.length)

    def columns(self, begin: int, end: int) -> Rows:
        """Return a view of some bytes of each frame, also of those that follow it, shape (n, end - begin)."""
        # Bounds are checked, and it takes a tenth of the time of ``as_strided``.
        return np.ndarray((self.count, end - begin), np.uint8, self.data, self.at + begin, (self.step, 1))

    def numbers(self, kind: np.dtype[np.number], at: int, count: int, spacing: int) -> Numbers:
        """Return a view of the numbers that stand ``at`` bytes from the beginning of each frame, shape (n,) or (n, count)."""
        if count == 1:
            return np.ndarray((self.count,), kind, self.data, self.at + at, (self.step,))
        return np.ndarray((self.count, count), kind, self.data, self.at + at, (self.step, spacing))


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
        """How many values a whole number of this type has: a counter of n bits wraps at 2^n, with a sign or without; else 0."""
        return 1 << 8 * NUMBER_BYTES[self.type] if self.type[0] in "ui" else 0

    def raw(self, frames: Frames) -> Numbers:
        """Return the numbers as sent, shape (n,) or (n, count). Integers of 24 bits come as 32."""
        size, kind = NUMBER_BYTES[self.type], _DTYPES[self.type, self.big_endian]
        if size == 3:
            return self._raw24(frames, kind)
        if self.type == "fp16.32":
            return self._raw48(frames, kind)
        return frames.numbers(kind, self.at, self.count, size)

    def counts(self, frames: Frames, modulus: int) -> IntArray:
        """Return the numbers of a counter that begins anew after ``modulus`` of them, from 0 on; 0: as sent. Shape (n,)."""
        raw = self.raw(frames).astype(np.int64)
        return from_zero(raw, modulus) if modulus else raw

    def values(self, frames: Frames) -> FloatArray:
        """Return the numbers in ``unit``, shape (n,) or (n, count)."""
        scaled: FloatArray = np.multiply(self.raw(frames), self.factor, dtype=np.float64)
        return scaled + self.offset if self.offset else scaled

    def text(self, row: bytes) -> str:
        """Return a field that is no number, from one frame."""
        part = row[self.at : self.at + self.size]
        if self.type == "ascii":
            # Texts of fixed length are filled up with zeros by some makers, with spaces by others.
            return part.decode("ascii", "replace").strip("\x00 ")
        return part.hex()

    def _raw48(self, frames: Frames, kind: np.dtype[np.number]) -> Numbers:
        # Xsens sends the 32 bits of the fraction first, the 16 bits of the whole number behind them.
        words = frames.numbers(kind, self.at, 3 * self.count, 2).reshape(frames.count, self.count, 3).astype(np.int64)
        whole = words[:, :, 2].astype(np.int16).astype(np.int64)
        values = whole << 32 | words[:, :, 0] << 16 | words[:, :, 1]
        return values[:, 0] if self.count == 1 else values

    def _raw24(self, frames: Frames, kind: np.dtype[np.number]) -> Numbers:
        # Four bytes are read, of which one belongs to the neighbour and is shifted out: several times faster than
        # putting three single bytes together. Where there is no neighbour the row gets one more byte.
        start = self.first_read
        if not self.can_be_read(frames.length):
            frames, start = Frames.of(np.pad(frames.rows, ((0, 0), (1, 1)))), start + 1
        return np.asarray(np.right_shift(frames.numbers(kind, start, self.count, 3), 8))

    @property
    def first_read(self) -> int:
        """Offset of the first byte that is read; one of 24 bits is read with a neighbour."""
        return self.at - (NUMBER_BYTES[self.type] == 3 and not self.big_endian)

    def can_be_read(self, length: int) -> bool:
        """Whether a frame of this length has all bytes that are read."""
        return NUMBER_BYTES[self.type] != 3 or 0 <= self.first_read <= length - 3 * self.count - 1


def from_zero(counts: IntArray, modulus: int) -> IntArray:
    """Return counts that begin anew after ``modulus`` of them, those below 0 a round further on: -1 stands for no counter."""
    return np.where(counts < 0, counts % modulus, counts) if np.count_nonzero(counts < 0) else counts


class FieldPair:
    """Two fields of one type and count, read at once: acceleration and rate.

    Parameters
    ----------
    first, second : Field
    """

    def __init__(self, first: Field, second: Field) -> None:
        self._size = NUMBER_BYTES[first.type]
        self._kind = _DTYPES[first.type, first.big_endian]
        self._count = first.count
        self._start, self._distance = first.first_read, second.at - first.at

    @staticmethod
    def fits(first: Field, second: Field, length: int) -> bool:
        """Whether two fields of a frame can be read so."""
        return (
            (first.type, first.count, first.big_endian) == (second.type, second.count, second.big_endian)
            and first.type != "fp16.32"
            and first.can_be_read(length)
            and second.can_be_read(length)
        )

    def raw(self, frames: Frames) -> Numbers:
        """Return the numbers as sent, shape (2, n, count)."""
        strides = (self._distance, frames.step, self._size)
        shape = (2, frames.count, self._count)
        values: Numbers = np.ndarray(shape, self._kind, frames.data, frames.at + self._start, strides)
        return np.asarray(np.right_shift(values, 8)) if self._size == 3 else values


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
        frames = Frames.of(np.frombuffer(row, dtype=np.uint8)[np.newaxis])
        found: dict[str, MessageValue] = {}
        for field in self.fields:
            if field.type in TEXT_TYPES:
                found[field.name] = field.text(row)
                continue
            raw = field.raw(frames)[0].tolist()
            found[field.name] = raw
            found.update({bits.name: bits.of(raw) for bits in field.bits})
            if (field.factor, field.offset) != (1.0, 0.0):
                found[f"{field.name} [{field.unit or 1}]"] = field.values(frames)[0].tolist()
        return found
