"""Forms of a frame: how its length is known, and how its bytes become a layout.

A form is what all frames with the same first bytes share. Its length is fixed by the key, or stands in a field, or follows
from masks. Its *shape* is everything that decides where the values stand: key, length, and for bodies made of fields or
masks the bytes that say so. ``FrameForm.shape`` turns one frame into a layout in plain Python; it runs once for each shape,
and all frames of that shape are recognised by comparing those bytes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.checksum import Checksum
from imufield.acquire.protocol.layout import Field, Layout
from imufield.dataclass import dataclass, replace
from imufield.dataclass import field as dataclass_field

Bytes = NDArray[np.uint8]
Positions = NDArray[np.intp]

NONE = 0
MORE = -1
"""Instead of a length: no frame begins here; more bytes are needed to tell."""
_HEADERS_KEPT = 4096  # Headers of masks whose length is remembered; noise makes many, an instrument sends a few.


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthRule:
    """Length of a frame = number in a field + ``add``; the one value ``extended_when`` refers to a second, wider field."""

    at: int
    size: int
    big_endian: bool
    add: int
    maximum: int
    """Of the number; anything above is no frame."""
    extended_when: int = -1
    extended_size: int = 0

    @property
    def header(self) -> int:
        """Bytes from the start of the frame to the end of the field."""
        return self.at + self.size

    def columns(self, number: int) -> tuple[int, ...]:
        """Return where the bytes stand that fix the length."""
        return tuple(range(self.at, self.header + (self.extended_size if number == self.extended_when else 0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldsRule:
    """A body of fields, each with an id and a size of its own."""

    at: int
    id_at: int
    id_size: int
    size_at: int
    size_size: int
    size_counts_header: bool
    big_endian: bool
    keys: frozenset[int] | None
    """Keys of frames that have such a body; None: all."""
    ignored_bits: int
    """Bits of the id that do not belong to its meaning."""
    format_types: tuple[Field, ...]
    """For fields of type "format": what the lowest bits of the id make of them."""
    known: dict[int | None, dict[int, tuple[Field, ...]]]
    """By key of the frame (None: any), then by id."""
    messages: dict[int, str]
    """Keys of frames that are no samples, and what to call them."""

    @property
    def header(self) -> int:
        """Bytes of id and size."""
        return max(self.id_at + self.id_size, self.size_at + self.size_size)

    def fields_of(self, key: int, number: int, size: int) -> tuple[Field, ...]:
        """Return the fields of one part with this id, at 0; none where id or size are not as known."""
        for table in (self.known.get(key, {}), self.known.get(None, {})):
            found = table.get(number, table.get(number & ~self.ignored_bits))
            if found is not None:
                fields = tuple(self._formatted(field, number) for field in found)
                spare = size - sum(field.size for field in fields)
                # An instrument may append to a field what it did not have before; a last part of no size takes the rest.
                if spare > 0 and fields[-1].size == 0:
                    fields = (*fields[:-1], replace(fields[-1], size=spare))
                return fields if spare >= 0 else ()
        return ()

    def _formatted(self, field: Field, number: int) -> Field:
        if field.type != "format":
            return field
        kind = self.format_types[number % len(self.format_types)]
        return replace(field, type=kind.type, size=kind.size * field.count, factor=field.factor * kind.factor)


@dataclass(frozen=True, slots=True)
class MasksRule:
    """A body told by a byte of groups and a 16-bit mask for each group, one bit for each field."""

    at: int
    groups: dict[int, tuple[tuple[Field, ...], ...]]
    """By bit of the group byte: the fields of each bit of its mask."""
    lengths: dict[bytes, tuple[int, int, int]] = dataclass_field(default_factory=dict, compare=False)
    """For headers met so far: length, then where the byte stands that makes it longer, and by how much for each unit."""

    def header_at(self, data: Bytes, at: int) -> bytes | None:
        """Return group byte and masks of a frame; None where they are not all there yet."""
        first = at + self.at
        if first >= len(data):
            return None
        end = first + 1 + 2 * int(data[first]).bit_count()
        return data[first:end].tobytes() if end <= len(data) else None

    def fields(self, header: bytes) -> list[Field] | None:
        """Return the fields in order, None where a bit is not known or nothing is sent."""
        found: list[Field] = []
        bits = [bit for bit in range(8) if header[0] >> bit & 1]
        for place, bit in enumerate(bits):
            mask = int.from_bytes(header[1 + 2 * place : 3 + 2 * place], "little")
            known = self.groups.get(bit, ())
            if mask >> len(known):
                return None
            found += [field for number, fields in enumerate(known) if mask >> number & 1 for field in fields]
        return found or None

    def length(self, data: Bytes, at: int, tail: int) -> int:
        """Return the length of the frame at ``at``; ``NONE`` or ``MORE`` where there is none. ``tail`` is behind its body."""
        header = self.header_at(data, at)
        if header is None:
            return MORE
        if header not in self.lengths:
            if len(self.lengths) >= _HEADERS_KEPT:
                self.lengths.clear()
            self.lengths[header] = self._measure(header, tail)
        length, count_at, repeat = self.lengths[header]
        if repeat == 0:
            return length
        return length + repeat * int(data[at + count_at]) if at + count_at < len(data) else MORE

    def _measure(self, header: bytes, tail: int) -> tuple[int, int, int]:
        at, count_at, repeat = self.at + len(header), 0, 0
        fields = self.fields(header)
        for field in fields or []:
            if field.repeat:
                # A second such field could only be found through the first; no instrument sends two.
                count_at, repeat = (at, field.repeat) if repeat == 0 else (0, -1)
            at += field.size
        return (NONE, 0, 0) if fields is None or repeat < 0 else (at + tail, count_at, repeat)


@dataclass(frozen=True, slots=True)
class Shape:
    """Frames that can be read together."""

    layout: Layout
    mask: Bytes
    """255 where bytes stand, besides key and length, that tell this shape, to the last of them; 0 elsewhere. Shape (m,)."""
    values: Bytes
    """Those bytes; 0 elsewhere. Shape (m,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameForm:
    """How frames with the same first bytes are found and read."""

    sync: bytes
    """Bytes every frame begins with; may be empty."""
    key_at: int
    key_size: int
    """Where the bytes stand that tell what kind of frame it is; size 0: there is one kind."""
    key_big_endian: bool
    checksum: Checksum | None
    checksum_from: int
    """Offset of the first byte covered; the checksum stands at the end of the frame, before ``end``."""
    checksum_big_endian: bool
    end: bytes
    """Bytes every frame ends with."""
    length: LengthRule | None
    layouts: dict[int, Layout]
    """Fixed parts by key; key 0 where there is one kind."""
    fields: FieldsRule | None = None
    masks: MasksRule | None = None

    @property
    def tail(self) -> int:
        """Bytes behind the body."""
        return (self.checksum.size if self.checksum else 0) + len(self.end)

    @property
    def header(self) -> int:
        """Bytes needed to know the length; for masks the least."""
        parts = (len(self.sync), self.key_at + self.key_size, self.length.header if self.length else 0)
        return max(*parts, self.masks.at + 1 if self.masks else 0)

    @property
    def is_fixed(self) -> bool:
        """Whether the key alone tells the length."""
        return self.length is None and self.masks is None

    @property
    def first_bytes(self) -> NDArray[np.bool_]:
        """Which byte values can begin a frame, shape (256,)."""
        known = set(range(256))
        if self.sync:
            known = {self.sync[0]}
        elif self.key_size == 1 and self.key_at == 0 and self.is_fixed:
            known = set(self.layouts)
        return np.isin(np.arange(256), list(known))

    @property
    def has_structure(self) -> bool:
        """Whether frames of one key and length may still differ in shape."""
        return self.fields is not None or self.masks is not None

    def sample_fields(self) -> list[Field]:
        """Return every field that a frame of this form may have which is no message."""
        found = [field for layout in self.layouts.values() if not layout.is_message for field in layout.fields]
        if rule := self.fields:
            kinds = [kind for key, kind in rule.known.items() if key not in rule.messages]
            found += [field for kind in kinds for fields in kind.values() for field in fields]
        if self.masks:
            found += [field for bits in self.masks.groups.values() for fields in bits for field in fields]
        return found

    def key_of(self, row: bytes) -> int:
        """Return the key of one frame."""
        return int.from_bytes(row[self.key_at : self.key_at + self.key_size], "big" if self.key_big_endian else "little")

    def shape(self, row: bytes) -> Shape | None:
        """Return the shape of one whole frame, None where its parts do not add up."""
        key = self.key_of(row)
        if self.masks:
            return self._shape_of_masks(self.masks, row)
        if self.fields and key not in self.layouts and (self.fields.keys is None or key in self.fields.keys):
            return self._shape_of_fields(self.fields, row, key)
        layout = self.layouts.get(key)
        if layout is None or layout.length > len(row):
            layout = Layout(self._name(key), (), len(row))
        stretched = tuple(
            replace(field, size=len(row) - self.tail - field.at) if field.size == 0 else field for field in layout.fields
        )
        return _shape(replace(layout, fields=stretched, length=len(row)), [], row)

    def _name(self, key: int) -> str:
        return f"0x{key:0{2 * self.key_size}X}"

    def _shape_of_masks(self, rule: MasksRule, row: bytes) -> Shape | None:
        header = rule.header_at(np.frombuffer(row, dtype=np.uint8), 0)
        fields = None if header is None else rule.fields(header)
        if header is None or fields is None:
            return None
        columns = list(range(rule.at, rule.at + len(header)))
        at, placed = rule.at + len(header), []
        for field in fields:
            size = field.size
            if field.repeat:
                columns.append(at)
                size += field.repeat * row[at]
            placed.append(replace(field, at=at, size=size))
            at += size
        return _shape(Layout("masks " + header.hex(" ").upper(), tuple(placed), len(row)), columns, row)

    def _shape_of_fields(self, rule: FieldsRule, row: bytes, key: int) -> Shape | None:

        def number_of(at: int, size: int) -> int:
            return int.from_bytes(row[at : at + size], "big" if rule.big_endian else "little")

        at = rule.at
        if self.length and number_of(self.length.at, self.length.size) == self.length.extended_when:
            at += self.length.extended_size
        until = len(row) - self.tail
        columns: list[int] = []
        placed: dict[str, Field] = {}
        while at < until:
            number, size = number_of(at + rule.id_at, rule.id_size), number_of(at + rule.size_at, rule.size_size)
            behind = at + size + (0 if rule.size_counts_header else rule.header)
            if behind > until or behind < at + rule.header:
                return None
            columns += range(at, at + rule.header)
            at += rule.header
            for field in rule.fields_of(key, number, behind - at):
                # Of fields of one name the first counts.
                placed.setdefault(field.name, replace(field, at=at))
                at += field.size
            at = behind
        kind = rule.messages.get(key, self._name(key))
        return _shape(Layout(kind, tuple(placed.values()), len(row), key in rule.messages), columns, row)


def _shape(layout: Layout, columns: list[int], row: bytes) -> Shape:
    mask = np.zeros(max(columns, default=-1) + 1, dtype=np.uint8)
    mask[columns] = 255
    return Shape(layout, mask, np.frombuffer(row, dtype=np.uint8)[: len(mask)] & mask)
