"""Decide whether bytes at given positions are a frame, and of what shape. Knows nothing of streams."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.frame_forms import MORE, NONE, FrameForm, LengthRule, Shape
from imufield.acquire.protocol.frame_schema import FrameRule
from imufield.acquire.protocol.layout import Frames, Layout, Numbers, Rows
from imufield.samples import every

Bytes = NDArray[np.uint8]
Positions = NDArray[np.intp]

INVALID = 0
VALID = 1
INCOMPLETE = 2
NO_SHAPE = -1
_SHAPES_TRIED = 16  # Known shapes that are compared with many frames at once; an instrument sends one to ten of one length.
_SHAPES_KEPT = 1024
_GROUPS_OF_LENGTHS = 8  # Frames of so many lengths are checked length by length; more (candidates in noise) all at once.
_LONGEST_CYCLE = 8  # Frames after which an instrument begins anew with the first kind.
_FEW = 256  # Numbers up to which a set is faster than a sort.
# Bytes of frames of many lengths checked together: bounds memory to some 20 MB, 40 bytes for each.
_BYTES_CHECKED_AT_ONCE = 1 << 19
_LENGTH_BITS = 17
_LENGTH_MASK = (1 << _LENGTH_BITS) - 1
_KEY_BITS = 32
_NUMBER_SIZES = (1, 2, 4, 8)


class FormCheck:
    """The header and the checksum of one form of frame.

    Parameters
    ----------
    form : FrameForm
    """

    def __init__(self, form: FrameForm) -> None:
        self.form = form
        layouts = dict(sorted(form.layouts.items()))
        self._keys = np.array(list(layouts), dtype=np.int64)
        self._lengths = np.array([layout.length for layout in layouts.values()], dtype=np.intp)
        self._by_byte: Positions | None = None
        if form.is_fixed and form.key_size == 1:
            # Length of a frame by its key of one byte, 0 where there is no such key: a look-up in place of a search.
            self._by_byte = np.zeros(256, dtype=np.intp)
            self._by_byte[self._keys] = self._lengths
        self._tail = form.tail
        self._shortest = form.header + form.tail
        self._checksum = form.checksum
        # The type of number that the checksum is sent as; None where NumPy has none of that size.
        size = form.checksum.size if form.checksum else 0
        self._checksum_kind = np.dtype(f"{'>' if form.checksum_big_endian else '<'}u{size}") if size in _NUMBER_SIZES else None

    def matches(self, buffer: Bytes, starts: Positions) -> NDArray[np.bool_]:
        """Return where the sync bytes stand, as far as the buffer reaches. Shape (n,)."""
        found = np.ones(len(starts), dtype=np.bool_)
        last = len(buffer) - 1
        for offset, byte in enumerate(self.form.sync):
            places = starts + offset
            found &= (buffer[np.minimum(places, last)] == byte) | (places > last)
        return found

    def lengths(self, buffer: Bytes, starts: Positions) -> Positions:
        """Return the lengths of frames whose sync bytes stand at ``starts``; ``NONE`` or ``MORE`` where there is none."""
        readable = starts + self.form.header <= len(buffer)
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
        if len(head) < form.header:
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
        header = self.form.header
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
        batch = np.cumsum(covered[places]) // _BYTES_CHECKED_AT_ONCE
        for part in np.split(places, np.flatnonzero(np.diff(batch)) + 1):
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


@dataclass(slots=True, kw_only=True)
class Stencil:
    """What frames one behind another have in common, of one length and of shapes in cycles: all are recognised at once."""

    form: FormCheck
    shapes: tuple[int, ...]
    """Of frames one behind another, again and again: k of them."""
    length: int
    step: int
    """Bytes from one frame to the next, the trailer behind each included."""
    mask: Bytes
    """255 where bytes stand that are known, to the last of them; 0 elsewhere. Shape (m,)."""
    values: Bytes
    """Those bytes; 0 elsewhere. Shape (k, m)."""
    repeated: bytes = b""
    """The same, as often as there were frames at once."""

    def fits(self, frames: Frames, place: int) -> bool:
        """Tell whether all of these frames are good, of these shapes from a place of the cycle on, and have their trailers."""
        size = len(self.mask)
        begin, end = place * size, (place + frames.count) * size
        if len(self.repeated) < end:
            self.repeated = self.values.tobytes() * (frames.count // len(self.shapes) + 2)
        # As bytes, which are compared at half of the price of arrays.
        known = (frames.columns(0, size) & self.mask).tobytes()
        return known == self.repeated[begin:end] and every(self.form.sums_fit(frames))

    def may_become(self, rest: Bytes, place: int) -> bool:
        """Tell whether these bytes are the beginning of one more such frame, of that place of the cycle."""
        known = min(len(rest), len(self.mask))
        return len(rest) < self.length and every(rest[:known] & self.mask[:known] == self.values[place, :known])


class FrameCheck:
    """Decides for all forms of a protocol.

    Parameters
    ----------
    rule : FrameRule
    """

    def __init__(self, rule: FrameRule) -> None:
        self._forms = [FormCheck(form) for form in rule.forms]
        self._can_begin = np.logical_or.reduce([form.first_bytes for form in rule.forms])
        # Whether frames of several lengths are usual in one stream.
        self.mixes_lengths = any(form.form.length or form.form.masks for form in self._forms) or len(self._forms) > 1
        self._shapes: dict[int, Shape] = {}
        self._families: dict[int, list[int]] = {}
        self._next = 0

    def layout(self, number: int) -> Layout:
        """Return the layout of a shape."""
        return self._shapes[number].layout

    def forget(self) -> bool:
        """Drop known shapes if there are too many, which only noise makes; tell so. Numbers given before are void then."""
        is_full = len(self._shapes) > _SHAPES_KEPT
        if is_full:
            self._shapes.clear()
            self._families.clear()
        return is_full

    def candidates(self, buffer: Bytes, positions: Positions) -> Positions:
        """Return those positions whose first byte can begin a frame."""
        return np.asarray(positions[self._can_begin[buffer[positions]]])

    def headers(self, buffer: Bytes, begin: int, end: int) -> Positions:
        """Return the positions from ``begin`` to ``end`` where sync bytes stand."""
        places = np.flatnonzero(self._can_begin[buffer[begin:end]]) + begin
        return places[self._form_of(buffer, places) >= 0]

    def length_at(self, buffer: Bytes, at: int) -> int:
        """Return the length of the frame whose header stands at ``at``; 0 where there is none or it is incomplete."""
        if not self._can_begin[buffer[at]]:
            return 0
        for form in self._forms:
            head = buffer[at : at + form.form.header].tobytes()
            if head.startswith(form.form.sync) or form.form.sync.startswith(head):
                return form.length_at(buffer, at, head)
        return 0

    def lengths_of_headers(self, buffer: Bytes, places: Positions) -> Positions:
        """Return the same as ``lengths`` for positions from ``headers``, where the sync bytes need no second look."""
        return self._forms[0].lengths(buffer, places) if len(self._forms) == 1 else self.lengths(buffer, places)

    def lengths(self, buffer: Bytes, starts: Positions) -> Positions:
        """Return the lengths of frames whose headers stand at ``starts``; ``NONE`` or ``MORE`` where there is none."""
        if len(self._forms) == 1:
            found = self._forms[0].lengths(buffer, starts)
            return np.where(self._forms[0].matches(buffer, starts), found, NONE) if self._forms[0].form.sync else found
        found = np.full(len(starts), NONE, dtype=np.intp)
        which = self._form_of(buffer, starts)
        for number, form in enumerate(self._forms):
            mine = np.flatnonzero(which == number)
            if len(mine):
                found[mine] = form.lengths(buffer, starts[mine])
        return found

    def judge(self, buffer: Bytes, starts: Positions, last: bool) -> NDArray[np.int8]:
        """Return for each candidate whether it is a frame, none, or one that may still be completed."""
        lengths = self.lengths(buffer, starts)
        judged = np.full(len(starts), INVALID if last else INCOMPLETE, dtype=np.int8)
        judged[lengths == NONE] = INVALID
        complete = (lengths > 0) & (starts + lengths <= len(buffer))
        fitting = self.fit(buffer, starts[complete], lengths[complete]) != NO_SHAPE
        judged[complete] = np.where(fitting, VALID, INVALID)
        return judged

    def run_fits(self, frames: Frames) -> tuple[NDArray[np.bool_], int]:
        """Return which frames of one length are good, shape (n,), and the shape they have in common.

        Where parts of frames may differ, a good frame has the key and the shape of the first one. Elsewhere there are several
        shapes if keys differ, and ``NO_SHAPE`` is returned.
        """
        rows = frames.rows
        form = self._form_of_row(rows[0])
        # The usual case: one comparison of the headers tells of their lengths and their keys.
        alike = form.are_alike(rows)
        good = form.fits(frames) if alike else form.fits(frames) & form.same_length(rows)
        number = NO_SHAPE
        if form.form.has_structure:
            number = self._shape_of_first(form, rows)
            if number == NO_SHAPE:
                return np.zeros(len(rows), dtype=np.bool_), NO_SHAPE
            good &= _have(rows, self._shapes[number])
            if not alike:
                good &= form.have_first_key(rows)
        elif good[0] and (alike or every(form.have_first_key(rows))):
            number = self._shape_of_first(form, rows)
        return good, number

    def stencil(self, frames: Frames, shapes: NDArray[np.int64], trailer: bytes) -> Stencil | None:
        """Return what recognises more frames like these, whose shapes come in cycles; None where they do not."""
        rows = frames.rows
        header = self._form_of_row(rows[0]).form.header
        size = cycle_length(shapes)
        if not size or not every(rows[size:, :header] == rows[:-size, :header]):
            return None
        return self.stencil_of(rows[:size], tuple(shapes[:size].tolist()), trailer)

    def stencil_of(self, rows: Rows, shapes: tuple[int, ...], trailer: bytes) -> Stencil | None:
        """Return what recognises these frames again, one of each shape; None where their headers do not tell enough."""
        form, length = self._form_of_row(rows[0]), rows.shape[1]
        if not form.has_plain_length(length):
            return None
        mask = np.zeros(length + len(trailer), dtype=np.uint8)
        # Frames of one length whose parts differ have one shape, if they are good at all.
        structure = self._shapes[shapes[0]].mask
        mask[: len(structure)] = structure
        mask[: form.form.header] = mask[length - len(form.form.end) :] = 255
        trailers = np.tile(np.frombuffer(trailer, dtype=np.uint8), (len(rows), 1))
        values = np.bitwise_and(np.hstack([rows, trailers]), mask)
        size = int(np.flatnonzero(mask)[-1]) + 1 if mask.any() else 0
        return Stencil(form=form, shapes=shapes, length=length, step=len(mask), mask=mask[:size], values=values[:, :size])

    def _form_of_row(self, row: Bytes) -> FormCheck:
        """Return the form of one whole frame."""
        first = row.tobytes()
        return next(form for form in self._forms if first.startswith(form.form.sync))

    def _shape_of_first(self, form: FormCheck, rows: Rows) -> int:
        """Return the shape of the first of several frames of one length, ``NO_SHAPE`` where its parts do not add up."""
        family = self._family(form, rows)
        for number in self._families.get(family, ())[-1:]:
            if _have(rows[:1], self._shapes[number])[0]:
                return number
        return int(self._match(form, family, rows[:1])[0])

    def _family(self, form: FormCheck, rows: Rows) -> int:
        """Return the number that stands for form, key and length of the first frame."""
        first = self._forms.index(form) << _KEY_BITS
        return (first | form.form.key_of(rows[0].tobytes())) << _LENGTH_BITS | int(rows.shape[1])

    def fit(self, buffer: Bytes, starts: Positions, lengths: Positions) -> NDArray[np.int64]:
        """Return the shapes of whole frames, ``NO_SHAPE`` where they are not good. Shape (n,)."""
        found = np.full(len(starts), NO_SHAPE, dtype=np.int64)
        for form, mine in self._by_form(buffer, starts):
            ordered = lengths[mine]
            different = distinct(ordered)
            if len(different) > _GROUPS_OF_LENGTHS:
                good = mine[form.fit_spans(buffer, starts[mine], ordered)]
                found[good] = self.shapes(buffer, starts[good], lengths[good])
                continue
            for length in different:
                group = mine if len(different) == 1 else mine[ordered == length]
                frames = frames_at(buffer, starts[group], length)
                rows, fitting = frames.rows, form.fits(frames)
                if every(fitting) and (form.are_alike(rows) or every(form.have_first_key(rows))):
                    found[group] = self._match(form, self._family(form, rows), rows)
                else:
                    good = group[fitting]
                    found[good] = self.shapes(buffer, starts[good], lengths[good])
        return found

    def shapes(self, buffer: Bytes, starts: Positions, lengths: Positions) -> NDArray[np.int64]:
        """Return the number of the shape of each frame, ``NO_SHAPE`` where its parts do not add up. Shape (n,)."""
        found = np.full(len(starts), NO_SHAPE, dtype=np.int64)
        for form, mine in self._by_form(buffer, starts):
            first = np.int64(self._forms.index(form)) << _KEY_BITS
            families = ((first | form.keys(buffer, starts[mine])) << _LENGTH_BITS) | lengths[mine]
            for family in distinct(families):
                group = mine[families == family]
                known = () if form.form.has_structure else self._families.get(family, ())
                found[group] = known or self._match(form, family, frames_at(buffer, starts[group], family & _LENGTH_MASK).rows)
        return found

    def _by_form(self, buffer: Bytes, starts: Positions) -> Iterator[tuple[FormCheck, Positions]]:
        """Yield each form that stands at some of the positions, and at which."""
        if len(self._forms) == 1:
            if len(starts):
                yield self._forms[0], np.arange(len(starts))
            return
        which = self._form_of(buffer, starts)
        for number, form in enumerate(self._forms):
            mine = np.flatnonzero(which == number)
            if len(mine):
                yield form, mine

    def _form_of(self, buffer: Bytes, starts: Positions) -> NDArray[np.int64]:
        """Return the number of the form whose sync bytes stand at each position, -1 where none does. Shape (n,)."""
        if len(self._forms) == 1 and not self._forms[0].form.sync:
            return np.zeros(len(starts), dtype=np.int64)
        which = np.full(len(starts), -1, dtype=np.int64)
        for number in range(len(self._forms) - 1, -1, -1):
            which[self._forms[number].matches(buffer, starts)] = number
        return which

    def _match(self, form: FormCheck, family: int, rows: Rows) -> NDArray[np.int64]:
        """Return the shapes of frames of one key and one length."""
        known = self._families.setdefault(family, [])
        if not form.form.has_structure:
            return np.full(len(rows), known[0] if known else self._learn(form, family, rows[0]), dtype=np.int64)
        found = np.full(len(rows), NO_SHAPE, dtype=np.int64)
        left = np.arange(len(rows))
        untried = known[-_SHAPES_TRIED:]
        learned = 0
        while len(left):
            if untried:
                number = untried.pop()
            else:
                number = self._learn(form, family, rows[left[0]])
                learned += 1
            if number == NO_SHAPE or learned > _SHAPES_TRIED:
                found[left[0]] = number
                left = left[1:]
                continue
            same = _have(rows if len(left) == len(rows) else rows[left], self._shapes[number])
            found[left[same]] = number
            left = left[~same]
        return found

    def _learn(self, form: FormCheck, family: int, row: Bytes) -> int:
        """Return the number of the shape of one frame, a new one if it was never seen."""
        shape = form.form.shape(row.tobytes())
        if shape is None:
            return NO_SHAPE
        self._next += 1
        self._shapes[self._next] = shape
        self._families[family].append(self._next)
        return self._next


def cycle_length(shapes: NDArray[np.int64]) -> int:
    """Return how many of the first shapes all others repeat; 0 where they do not."""
    sizes = range(1, min(len(shapes) - 1, _LONGEST_CYCLE) + 1)
    return next((size for size in sizes if every(shapes[size:] == shapes[:-size])), 0)


def distinct(values: NDArray[np.signedinteger]) -> list[int]:
    """Return the different values of at least one number, ascending."""
    if every(values == values[0]):
        return [int(values[0])]
    return sorted(set(values.tolist())) if len(values) <= _FEW else np.unique(values).tolist()


def frames_at(buffer: Bytes, starts: Positions, length: int) -> Frames:
    """Return frames of one length: where they stand if they are evenly spaced, else copied one behind another."""
    step = int(starts[1] - starts[0]) if len(starts) > 1 else length
    if step > 0 and (len(starts) < 3 or every(starts[1:] - starts[:-1] == step)):
        return Frames(buffer, int(starts[0]), step, len(starts), length)
    return Frames.of(Frames(buffer, 0, 1, len(buffer) - length + 1, length).rows[starts])


def _have(rows: Rows, shape: Shape) -> NDArray[np.bool_]:
    """Return which rows have the bytes of a shape, shape (n,)."""
    same = rows[:, : len(shape.mask)] & shape.mask == shape.values
    return np.ones(len(rows), dtype=np.bool_) if every(same) else np.asarray(same.all(axis=1))


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
