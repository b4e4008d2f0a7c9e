"""Decide whether bytes at given positions are a frame, and of what shape. Knows nothing of streams.

``header_and_checksum`` compares the checksum. ``protocol.layout`` reads the values of a frame, and ``frame_source`` brings them
to SI.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.header_and_checksum import BYTES_CHECKED_AT_ONCE, Bytes, FormCheck, Positions
from imufield.acquire.protocol.frame_forms import NONE, Shape
from imufield.acquire.protocol.frame_schema import FrameRule
from imufield.acquire.protocol.layout import Frames, Layout, Rows
from imufield.dataclass import dataclass
from imufield.samples import every

INVALID = 0
VALID = 1
INCOMPLETE = 2
NO_SHAPE = -1
_SHAPES_TRIED = 16  # Known shapes that are compared with many frames at once; an instrument sends one to ten of one length.
_SHAPES_KEPT = 1024
# Frames of one length are checked together, several times faster, but each length costs as much as some frames: frames are
# checked length by length up to 3 lengths, plus one for each 50 frames; above, all at once.
_GROUPS_OF_LENGTHS = 3
_FRAMES_OF_ONE_LENGTH = 50
_LONGEST_CYCLE = 8  # Frames after which an instrument begins anew with the first kind.
_FEW = 256  # Numbers up to which a set is faster than a sort.
_LENGTH_BITS = 17
_LENGTH_MASK = (1 << _LENGTH_BITS) - 1
_KEY_BITS = 32


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

    def matches(self, frames: Frames, place: int) -> bool:
        """Tell whether all of these frames have these shapes, from a place of the cycle on, and their trailers."""
        size = len(self.mask)
        begin, end = place * size, (place + frames.count) * size
        if len(self.repeated) < end:
            self.repeated = self.values.tobytes() * (frames.count // len(self.shapes) + 2)
        # As bytes, which are compared at half of the price of arrays.
        return (frames.columns(0, size) & self.mask).tobytes() == self.repeated[begin:end]

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
        return places[self._form_of(buffer, places) >= 0] if len(places) else places

    def length_at(self, buffer: Bytes, at: int) -> int:
        """Return the length of the frame whose header stands at ``at``; 0 where there is none or it is incomplete."""
        if not self._can_begin[buffer[at]]:
            return 0
        for form in self._forms:
            head = buffer[at : at + form.header].tobytes()
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
        for form, mine in self._by_form(buffer, starts):
            found[mine] = form.lengths(buffer, starts[mine])
        return found

    def judge(self, buffer: Bytes, starts: Positions, last: bool) -> tuple[NDArray[np.int8], Positions]:
        """Return for each candidate whether it is a frame, none, or one that may still be completed; and where it would end."""
        if not len(starts):  # Nearly always, in noise.
            return np.empty(0, dtype=np.int8), starts
        lengths = self.lengths(buffer, starts)
        judged = np.full(len(starts), INVALID if last else INCOMPLETE, dtype=np.int8)
        judged[lengths == NONE] = INVALID
        ends = starts + np.maximum(lengths, 0)
        complete = (lengths > 0) & (ends <= len(buffer))
        fitting = self.fit(buffer, starts[complete], lengths[complete]) != NO_SHAPE
        judged[complete] = np.where(fitting, VALID, INVALID)
        return judged, ends

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
        header = self._form_of_row(rows[0]).header
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
        mask[: form.header] = mask[length - len(form.form.end) :] = 255
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
            # Candidates overlap: frames of one length, copied one behind another, may be many times the bytes they come from.
            has_few_of_each = len(different) > _GROUPS_OF_LENGTHS + len(mine) // _FRAMES_OF_ONE_LENGTH
            if has_few_of_each or int(ordered.sum()) > BYTES_CHECKED_AT_ONCE:
                good = mine[form.fit_spans(buffer, starts[mine], ordered)]
                found[good] = self.shapes(buffer, starts[good], lengths[good])
                continue
            for length in different:
                group = mine if len(different) == 1 else mine[ordered == length]
                frames = frames_at(buffer, starts[group], length)
                rows, fitting = frames.rows, form.fits(frames)
                if not every(fitting):
                    group, rows = group[fitting], rows[fitting]
                if len(group) == 0:
                    continue
                if form.are_alike(rows) or every(form.have_first_key(rows)):
                    found[group] = self._match(form, self._family(form, rows), rows)
                else:
                    found[group] = self.shapes(buffer, starts[group], lengths[group])
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
