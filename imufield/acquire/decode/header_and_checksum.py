"""Check frames of one form: header (sync bytes), length and checksum; the checksums themselves are in ``protocol.checksum``."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.frame_forms import MORE, NONE, FrameForm, LengthRule
from imufield.acquire.protocol.layout import Frames, Numbers, Rows
from imufield.samples import every

Bytes = NDArray[np.uint8]
Positions = NDArray[np.intp]

# Bytes of frames of many lengths checked together: bounds memory to some 20 MB, 40 bytes for each.
BYTES_CHECKED_AT_ONCE = 1 << 19
_NUMBER_SIZES = (1, 2, 4, 8)


class FormCheck:
    """The header and the checksum of one form of frame.

    Parameters
    ----------
    form : FrameForm
    """

    def __init__(self, form: FrameForm) -> None:
        self.form = form
        self.header = form.header
        layouts = dict(sorted(form.layouts.items()))
        self._keys = np.array(list(layouts), dtype=np.int64)
        self._lengths = np.array([layout.length for layout in layouts.values()], dtype=np.intp)
        self._by_byte: Positions | None = None
        if form.is_fixed and form.key_size == 1:
            # Length of a frame by its key of one byte, 0 where there is no such key: a look-up in place of a search.
            self._by_byte = np.zeros(256, dtype=np.intp)
            self._by_byte[self._keys] = self._lengths
        self._tail = form.tail
        self._shortest = self.header + form.tail
        self._checksum = form.checksum
        # The type of number that the checksum is sent as; None where NumPy has none of that size.
        size = form.checksum.size if form.checksum else 0
        self._checksum_kind = np.dtype(f"{'>' if form.checksum_big_endian else '<'}u{size}") if size in _NUMBER_SIZES else None

    def matches(self, buffer: Bytes, starts: Positions) -> NDArray[np.bool_]:
        """Return where the sync bytes stand, as far as the buffer reaches. Shape (n,)."""
        found = np.ones(len(starts), dtype=np.bool_)
        size = len(buffer)
        may_be_cut = len(starts) > 0 and int(starts.max()) + len(self.form.sync) > size
        for offset, byte in enumerate(self.form.sync):
            places = starts + offset
            same = buffer.take(places, mode="clip") == byte
            found &= same | (places >= size) if may_be_cut else same
        return found

    def lengths(self, buffer: Bytes, starts: Positions) -> Positions:
        """Return the lengths of frames whose sync bytes stand at ``starts``; ``NONE`` or ``MORE`` where there is none."""
        readable = starts + self.header <= len(buffer)
        if readable.all():
            return self._lengths_of(buffer, starts)
        found = np.full(len(starts), MORE, dtype=np.intp)
        found[readable] = self._lengths_of(buffer, starts[readable])
        return found

    def keys(self, buffer: Bytes, starts: Positions) -> NDArray[np.int64]:
        """Return the keys of frames at ``starts``."""
        form = self.form
        return _numbers(buffer, starts + form.key_at, form.key_size, form.key_big_endian)

    def length_at(self, buffer: Bytes, at: int, head: bytes) -> int:
        """Return the length of the one frame at ``at`` by its header, 0 where there is none or it is cut."""
        form, rule = self.form, self.form.length
        if len(head) < self.header:
            return 0
        if self._by_byte is not None:
            return int(self._by_byte[head[form.key_at]])
        if form.masks:
            return max(form.masks.length(buffer, at, form.tail), 0)
        number = -1 if rule is None else int.from_bytes(head[rule.at : rule.header], _order(rule.big_endian))
        if rule is None or number == rule.extended_when:
            return max(int(self._lengths_of(buffer, np.array([at], dtype=np.intp))[0]), 0)
        length = number + rule.add
        return length if number <= rule.maximum and length >= self._shortest else 0

    def have_first_key(self, rows: Rows) -> NDArray[np.bool_]:
        """Return which rows have the key of the first one, shape (n,)."""
        same = np.ones(len(rows), dtype=np.bool_)
        # Column by column, which is several times faster than all at once.
        for column in range(self.form.key_at, self.form.key_at + self.form.key_size):
            same &= rows[:, column] == rows[0, column]
        return same

    def are_alike(self, rows: Rows) -> bool:
        """Whether all rows have the header of the first one, and so its key and its length; False where that is not simple."""
        header = self.header
        return self.has_plain_length(rows.shape[1]) and every(rows[:, :header] == rows[0, :header])

    def has_plain_length(self, length: int) -> bool:
        """Whether the header of frames of this length tells all of it."""
        rule = self.form.length
        return rule is None or not 0 <= rule.extended_when <= length - rule.add

    def same_length(self, rows: Rows) -> NDArray[np.bool_]:
        """Return which rows have a header that gives them the length they have, shape (n,)."""
        form, length = self.form, rows.shape[1]
        same = np.ones(len(rows), dtype=np.bool_)
        for offset, byte in enumerate(form.sync):
            same &= rows[:, offset] == byte
        if self._by_byte is not None:
            same &= (self._by_byte == length)[rows[:, form.key_at]]
        elif form.is_fixed and form.key_size:
            keys = _numbers_of_rows(rows[:, form.key_at : form.key_at + form.key_size], form.key_big_endian)
            same &= np.isin(keys, self._keys[self._lengths == length])
        elif form.length:
            number = int.from_bytes(rows[0, form.length.at : form.length.header].tobytes(), _order(form.length.big_endian))
            for offset in form.length.columns(number):
                same &= rows[:, offset] == rows[0, offset]
        return same

    def fits(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames of one length have the checksum and the last bytes they must, shape (n,)."""
        good = self.sums_fit(frames)
        for offset, byte in enumerate(self.form.end, frames.length - len(self.form.end)):
            good &= frames.rows[:, offset] == byte
        return good

    def sums_fit(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames of one length have the checksum they must, shape (n,)."""
        checksum, begin, end = self._checksum, self.form.checksum_from, frames.length - self._tail
        if checksum is None:
            return np.ones(frames.count, dtype=np.bool_)
        if end <= begin:
            return np.zeros(frames.count, dtype=np.bool_)
        if self._checksum_kind is None:
            sent: Numbers = _numbers_of_rows(frames.columns(end, end + checksum.size), self.form.checksum_big_endian)
        else:
            sent = frames.numbers(self._checksum_kind, end, 1, 0)
        return np.asarray(checksum.of_rows(frames.columns(begin, end)) == sent)

    def fit_spans(self, buffer: Bytes, starts: Positions, lengths: Positions) -> NDArray[np.bool_]:
        """Return the same as ``fits`` for frames of many lengths."""
        form = self.form
        ends = starts + lengths - len(form.end)
        good = np.ones(len(starts), dtype=np.bool_)
        for offset, byte in enumerate(form.end):
            good &= buffer[ends + offset] == byte
        if form.checksum is None:
            return good
        covered = ends - form.checksum.size - starts - form.checksum_from
        good &= covered > 0
        places = np.flatnonzero(good)
        batch = covered[places].cumsum() // BYTES_CHECKED_AT_ONCE
        cuts = np.flatnonzero(batch[1:] != batch[:-1]) + 1
        for begin, end in pairwise((0, *cuts.tolist(), len(places))):
            part = places[begin:end]
            values = form.checksum.of_spans(buffer, starts[part] + form.checksum_from, covered[part])
            tails = buffer[(ends[part] - form.checksum.size)[:, None] + np.arange(form.checksum.size)]
            good[part] = values == _numbers_of_rows(tails, form.checksum_big_endian)
        return good

    def _lengths_of(self, buffer: Bytes, starts: Positions) -> Positions:
        form = self.form
        if form.masks:
            # One by one: headers with masks are rare in a stream, as runs of them are checked together.
            return np.array([form.masks.length(buffer, start, form.tail) for start in starts.tolist()], dtype=np.intp)
        if form.length:
            return self._lengths_by_field(form.length, buffer, starts)
        if self._by_byte is not None:
            return self._by_byte[buffer[starts + form.key_at]]
        keys = self.keys(buffer, starts)
        place = np.searchsorted(self._keys, keys).clip(max=len(self._keys) - 1)
        return np.where(self._keys[place] == keys, self._lengths[place], NONE)

    def _lengths_by_field(self, rule: LengthRule, buffer: Bytes, starts: Positions) -> Positions:
        numbers = _numbers(buffer, starts + rule.at, rule.size, rule.big_endian)
        found = np.where(numbers <= rule.maximum, numbers + rule.add, NONE).astype(np.intp)
        wide = np.flatnonzero(numbers == rule.extended_when)
        if len(wide):
            behind = starts[wide] + rule.header
            there = behind + rule.extended_size <= len(buffer)
            found[wide] = MORE
            numbers = _numbers(buffer, behind[there], rule.extended_size, rule.big_endian)
            usable = (numbers >= rule.extended_when) & (numbers <= rule.maximum)
            found[wide[there]] = np.where(usable, numbers + rule.add + rule.extended_size, NONE)
        found[(found > 0) & (found < self._shortest)] = NONE
        return found


def _order(big_endian: bool) -> Literal["big", "little"]:
    return "big" if big_endian else "little"


def _numbers(buffer: Bytes, at: Positions, size: int, big_endian: bool) -> NDArray[np.int64]:
    """Return the number of ``size`` bytes at each position; 0 for no bytes."""
    return _numbers_of_rows(buffer[at[:, None] + np.arange(size)], big_endian).astype(np.int64)


def _numbers_of_rows(columns: Rows, big_endian: bool) -> NDArray[np.unsignedinteger]:
    """Return the number in each row of up to 8 bytes."""
    size = columns.shape[1]
    if size in _NUMBER_SIZES:
        return columns.view(f"{'>' if big_endian else '<'}u{size}")[:, 0]
    value = np.zeros(len(columns), dtype=np.uint64)
    for index in range(size):
        value = value << np.uint64(8) | columns[:, index if big_endian else size - 1 - index]
    return value
