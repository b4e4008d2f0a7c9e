"""Checksums of many frames at once; ``decode.header_and_checksum`` compares them with what was sent.

A CRC is linear over GF(2): the register after a message is the XOR of what the start value alone would leave and of what
each byte alone would leave. What byte value v leaves depends only on v and on how many bytes follow it, so one table
``left[d, v]`` (d bytes follow) turns the CRC of n frames of m bytes into one look-up of an (n, m) array and one XOR along
its rows, with no step from byte to byte. Zero bytes appended but never sent only shift d. The parameters (polynomial,
start value, reflection, final XOR) come from the catalogue in ``crccheck``.

Sums have the same form with numbers for XOR: each byte adds a weight that depends on how many bytes follow.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imufield.errors import ProtocolError
from imufield.sentences import Sentences

if TYPE_CHECKING:
    import crccheck.crc

sentence = Sentences(__package__)

Bytes = NDArray[np.uint8]
Values = NDArray[np.unsignedinteger]
Positions = NDArray[np.intp]

# Longest message whose weighted sum, at most 255 n (n + 1) / 2, stays below 2^24, so that single precision is exact.
_EXACT_IN_SINGLE = 362
# Longest message that is looked up in the flat table, 2 MiB; what instruments send all the time has a few hundred bytes.
_LONGEST_TABLE = 2048
# Where the part of each place begins in that table, from the first byte of a message on, shape (n, 1).
_OFFSETS = np.arange(_LONGEST_TABLE, dtype=np.intp)[:, np.newaxis] * 256
# Rows looked up together: keeps the index array (8 bytes for each byte of a frame) in the second-level cache.
_ROWS_AT_ONCE = 1024
_START = 256  # Column of the start value in the table of what each byte value leaves.


class _Tables(NamedTuple):
    """What the CRC of messages of one length is looked up in."""

    left: NDArray[np.unsignedinteger]  # Flat: what each byte value leaves at each place. A view.
    offsets: NDArray[np.intp]  # Where the part of each place begins, shape (length, 1). A view.
    start: np.unsignedinteger  # What start value and final XOR leave.


class _Ragged(NamedTuple):
    """Every byte of many spans, one after another."""

    values: Bytes
    following: Positions  # How many bytes of the same span follow this one.
    first: Positions  # Where each span begins in the two arrays above.


class Checksum(ABC):
    """A checksum algorithm over frames of any length."""

    size: int
    """Bytes of the value on the wire."""

    @abstractmethod
    def of_rows(self, rows: Bytes) -> Values:
        """Return the values of n messages of one length.

        Parameters
        ----------
        rows : ndarray of uint8, shape (n, m)
            May be a view with any row stride.

        Returns
        -------
        ndarray of unsigned integers, shape (n,)
        """

    def of(self, message: bytes) -> int:
        """Return the value of one message."""
        return int(self.of_rows(np.frombuffer(message, dtype=np.uint8).reshape(1, -1))[0])

    def of_spans(self, data: Bytes, starts: Positions, lengths: Positions) -> Values:
        """Return the values of n messages of different lengths (all at least 1) inside ``data``, shape (n,)."""
        if len(starts) == 0:
            return np.empty(0, dtype=np.uint64)
        ends = lengths.cumsum()
        first = ends - lengths
        place = np.arange(int(ends[-1]))
        values = data.take(place + (starts - first).repeat(lengths))
        return self._spans(_Ragged(values, (ends - 1).repeat(lengths) - place, first), lengths)

    @abstractmethod
    def _spans(self, span: _Ragged, lengths: Positions) -> Values: ...


@cache
def _left_by_each(parameters: type[crccheck.crc.CrcBase]) -> list[int]:
    """Return the CRC of each byte value alone; a protocol is read again and again, and crccheck is slow."""
    return [parameters.calc(bytes([value]), 0) for value in range(256)]


class Crc(Checksum):
    """A CRC of 8 to 64 bits with the parameters of one class of ``crccheck``.

    Parameters
    ----------
    parameters : type
        Class of ``crccheck.crc``.
    pad_to : int
        Zero bytes are appended up to a multiple of this; they are never sent.
    start, final : int, optional
        Start value and final XOR instead of those of the catalogue.
    """

    def __init__(
        self, parameters: type[crccheck.crc.CrcBase], pad_to: int = 1, start: int | None = None, final: int | None = None
    ) -> None:
        self._width = int(parameters.width())
        self._reflected = bool(parameters.reflect_input())
        self._final = int(parameters.xor_output()) if final is None else final
        self._pad_to = pad_to
        self.size = self._width // 8
        alone = _left_by_each(parameters)  # type: ignore[arg-type]  # a class without types is hashable, too
        # Row d: what each byte value, and last the start value, leaves when d bytes follow. The final XOR is no part of it.
        self._left = np.array([[*alone, parameters(start).final()]], dtype=np.uint64) ^ np.uint64(parameters.xor_output())
        # Half the size where it will do: what the frames of an instrument need stays in cache.
        self._flat: NDArray[np.unsignedinteger] = np.empty(0, dtype=np.uint32 if self._width <= 32 else np.uint64)
        self._by_length: dict[int, _Tables] = {}

    def of_rows(self, rows: Bytes) -> Values:
        """Return the checksum of each row, as the base class has it."""
        count, length = rows.shape
        if length == 0:
            return np.full(count, self._left[0, _START] ^ np.uint64(self._final))
        if length > _LONGEST_TABLE:
            whole = np.ascontiguousarray(rows).reshape(-1)
            return self.of_spans(whole, np.arange(count, dtype=np.intp) * length, np.full(count, length, dtype=np.intp))
        table, offsets, start = self._tables_of(length)
        values = np.empty(count, dtype=table.dtype)
        for at in range(0, count, _ROWS_AT_ONCE):
            # One row of the index for each place: the registers of all messages are then taken together step by step.
            index = np.add(rows[at : at + _ROWS_AT_ONCE].T, offsets, order="C")
            left = table.take(index, mode="clip")
            np.bitwise_xor.reduce(left, axis=0, initial=start, out=values[at : at + _ROWS_AT_ONCE])
        return values

    def _spans(self, span: _Ragged, lengths: Positions) -> Values:
        pad = -lengths % self._pad_to
        self._grow(int((lengths + pad).max()))
        left = self._left.take((span.following + pad.repeat(lengths)) * self._left.shape[1] + span.values)
        return np.asarray(
            np.bitwise_xor.reduceat(left, span.first) ^ self._left[lengths + pad, _START] ^ np.uint64(self._final)
        )

    def _tables_of(self, length: int) -> _Tables:
        """Return what messages of one length need: all share one table, as they end at the same place of it."""
        found = self._by_length.get(length)
        if found is None:
            padded = length + -length % self._pad_to
            self._grow(padded)
            if len(self._flat) < 256 * padded:
                self._flat = self._left[: max(padded, _LONGEST_TABLE), :_START][::-1].astype(self._flat.dtype).ravel()
                self._by_length.clear()
            begin = len(self._flat) - 256 * padded
            start = self._flat.dtype.type(int(self._left[padded, _START]) ^ self._final)
            found = self._by_length[length] = _Tables(self._flat[begin : begin + 256 * length], _OFFSETS[:length], start)
        return found

    def _grow(self, length: int) -> None:
        """Extend the table to messages of ``length`` bytes; more than needed, as longer ones may follow."""
        if length < len(self._left):
            return
        wanted = max(length + 1, min(2 * len(self._left), len(self._left) + _LONGEST_TABLE))
        rows = [*self._left]
        while len(rows) < wanted:
            rows.append(self._after_zero_byte(rows[-1]))
        self._left = np.array(rows, dtype=np.uint64)

    def _after_zero_byte(self, register: Values) -> Values:
        eight, width, first = np.uint64(8), np.uint64(self._width), self._left[0]
        if self._reflected:
            return np.asarray((register >> eight) ^ first[register & np.uint64(0xFF)])
        mask = np.uint64((1 << self._width) - 1)
        return np.asarray(((register << eight) & mask) ^ first[register >> (width - eight)])


class Sum(Checksum):
    """The sum of all bytes (or 16-bit words) modulo 2**bits, or its negative.

    Parameters
    ----------
    bits : {8, 16, 32}
    negated : bool
        The value makes the total zero.
    words : bool
        Add little-endian 16-bit words; the span must be even.
    """

    def __init__(self, bits: int, *, negated: bool = False, words: bool = False) -> None:
        self.size = bits // 8
        self._mask = np.uint64((1 << bits) - 1)
        self._negated = negated
        self._words = words

    def of_rows(self, rows: Bytes) -> Values:
        """Return the checksum of each row, as the base class has it."""
        if self.size == 1:
            total8 = np.add.reduce(rows, axis=1, dtype=np.uint8)
            return np.asarray(np.negative(total8) if self._negated else total8)
        total = rows.sum(axis=1, dtype=np.uint64)
        if self._words:
            total += np.uint64(255) * rows[:, 1::2].sum(axis=1, dtype=np.uint64)
        return self._finish(total)

    def _spans(self, span: _Ragged, lengths: Positions) -> Values:  # noqa: ARG002  sums need no length
        weighted = span.values.astype(np.uint64)
        if self._words:
            # The high byte of a little-endian word is the one with an even number of bytes after it.
            weighted *= np.where(span.following % 2 == 0, 256, 1).astype(np.uint64)
        return self._finish(np.add.reduceat(weighted, span.first))

    def _finish(self, total: Values) -> Values:
        return (np.uint64(0) - total if self._negated else total) & self._mask


class Xor(Checksum):
    """The XOR of all bytes."""

    size = 1

    def of_rows(self, rows: Bytes) -> Values:
        """Return the checksum of each row, as the base class has it."""
        return np.asarray(np.bitwise_xor.reduce(rows, axis=1))

    def _spans(self, span: _Ragged, lengths: Positions) -> Values:  # noqa: ARG002  an XOR needs no length
        return np.bitwise_xor.reduceat(span.values, span.first).astype(np.uint64)


class Fletcher(Checksum):
    """Two running sums modulo 256; the value is first * 256 + second (MicroStrain MIP sends the first sum first)."""

    size = 2

    def of_rows(self, rows: Bytes) -> Values:
        """Return the checksum of each row, as the base class has it."""
        if rows.shape[1] <= _EXACT_IN_SINGLE:
            sums = rows.astype(np.float32) @ _fletcher_weights(rows.shape[1])
            # Kept to their lowest bytes and read as one number.
            return sums.astype(np.int32).astype(np.uint8).view(">u2")[:, 0]
        weights = np.arange(rows.shape[1], 0, -1, dtype=np.uint64)
        return self._join(rows.sum(axis=1, dtype=np.uint64), (rows * weights).sum(axis=1, dtype=np.uint64))

    def _spans(self, span: _Ragged, lengths: Positions) -> Values:  # noqa: ARG002  the weights say it
        values = span.values.astype(np.uint64)
        # A byte enters the second sum once when it is added and once for each byte after it.
        second = np.add.reduceat(values * (span.following + 1).astype(np.uint64), span.first)
        return self._join(np.add.reduceat(values, span.first), second)

    @staticmethod
    def _join(first: Values, second: Values) -> Values:
        low = np.uint64(0xFF)
        return (first & low) << np.uint64(8) | (second & low)


@cache
def _fletcher_weights(length: int) -> NDArray[np.float32]:
    """Return how often each byte of a message enters the first and the second sum, shape (length, 2)."""
    weights = np.ones((length, 2), dtype=np.float32)
    weights[:, 1] = np.arange(length, 0, -1)
    return weights


_PLAIN = {
    "SUM-8": lambda: Sum(8),
    "SUM-8/NEGATED": lambda: Sum(8, negated=True),
    "SUM-16": lambda: Sum(16),
    "SUM-16/WORDS": lambda: Sum(16, words=True),
    "SUM-32": lambda: Sum(32),
    "XOR-8": Xor,
    "FLETCHER-16/MOD-256": Fletcher,
}


@cache
def _catalogue() -> dict[str, type[crccheck.crc.CrcBase]]:
    """Return every CRC of the catalogue that works on whole bytes, by name."""
    import crccheck.crc  # Slow to import, and not every wire has a CRC.

    return {
        name: parameters
        for parameters in crccheck.crc.ALLCRCCLASSES
        if parameters.width() in range(8, 65, 8) and parameters.reflect_input() == parameters.reflect_output()
        for name in parameters._names  # noqa: SLF001  crccheck publishes the names only so
    }


def checksum_names() -> list[str]:
    """Return the names that ``make_checksum`` knows."""
    return sorted({*_PLAIN, *_catalogue()})


def make_checksum(algorithm: str, pad_to: int = 1, *, start: int | None = None, final: int | None = None) -> Checksum:
    """Return the checksum of that name.

    Parameters
    ----------
    algorithm : str
        A CRC by its catalogue name, e.g. "CRC-32/MPEG-2", or one of the plain sums.
    pad_to : int
        The CRC covers zero bytes up to a multiple of this, which are never sent.
    start, final : int, optional
        Start value and final XOR of a CRC that is in no catalogue but differs from one only by these.

    Raises
    ------
    ProtocolError
        If there is no such algorithm, or a plain sum is to be padded or started with a value.
    """
    if algorithm in _PLAIN:
        if pad_to != 1:
            raise ProtocolError(sentence("checksum.padded", algorithm=algorithm, pad_to=pad_to))
        if (start, final) != (None, None):
            raise ProtocolError(sentence("checksum.started", algorithm=algorithm), start=start)
        return _PLAIN[algorithm]()
    parameters = _catalogue().get(algorithm)
    if parameters is None:
        import difflib  # late: only for a misspelt name

        near = difflib.get_close_matches(algorithm.upper(), checksum_names(), n=1, cutoff=0.4)
        example = near[0] if near else "CRC-32/MPEG-2"
        raise ProtocolError(sentence("checksum.unknown", algorithm=algorithm, example=example))
    largest = (1 << int(parameters.width())) - 1
    if max(start or 0, final or 0) > largest:
        raise ProtocolError(sentence("checksum.too_wide", algorithm=algorithm, largest=largest), start=start)
    return Crc(parameters, pad_to, start, final)
