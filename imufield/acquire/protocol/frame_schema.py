"""The tables of a protocol file that describe frames: ``[frame]``, ``[parts]``, ``[frames]``, ``[messages]`` and bodies.

Every limit is far above what instruments use (the longest known body is 4096 bytes) and keeps a wrong file harmless.
"""

from __future__ import annotations

from typing import cast

from imufield.acquire.protocol.frame_forms import FieldsRule, FrameForm, LengthRule, MasksRule
from imufield.acquire.protocol.layout import NUMBER_BYTES, TEXT_TYPES, Bits, Field, Layout
from imufield.acquire.protocol.samples_and_clock import read_checksum
from imufield.acquire.protocol.toml import Table
from imufield.dataclass import dataclass, replace
from imufield.sentences import Sentences

sentence = Sentences(__package__)

LONGEST_FRAME = 65536
MOST_FIELDS = 1000
"""Of a part of a frame, each of which is read for every frame; those shipped have at most 20."""
ANY_KEY = "any"
"""The one entry of ``[frames]`` where no byte tells kinds of frames apart."""
_UNSIGNED = ("u8", "u16", "u24", "u32")
# Names of fixed-point types: the type that is read and its fraction bits.
_FIXED_POINT = {"fp12.20": ("i32", 20), "fp16.32": ("fp16.32", 32)}
FORMAT = "format"
"""Type of a field whose number type the id of the field tells."""
_FORMS = 8


@dataclass(frozen=True, slots=True)
class JoinRule:
    """Which frames make one sample, where it takes several."""

    starts_with: str
    """Kind of frame a sample begins with."""
    needs: tuple[str, ...]
    """Kinds that make a sample complete, the first included."""


@dataclass(frozen=True, slots=True)
class FrameRule:
    """How frames are found in a stream."""

    forms: tuple[FrameForm, ...]
    trailer: bytes
    """Bytes that may follow a frame and carry nothing."""
    join: JoinRule | None = None

    def sample_fields(self) -> list[Field]:
        """Return every field that a frame may have which is no message."""
        return [field for form in self.forms for field in form.sample_fields()]


def read_frames(top: Table) -> FrameRule:
    """Read everything that describes frames."""
    big_endian = top.choice("byte_order", ("big", "little")) == "big"
    parts = {name: _read_fields(top.table("parts"), name, big_endian) for name in top.table("parts").values}
    several = isinstance(top.plain("frame"), list)
    tables = top.tables("frame") if several else [top.table("frame")]
    forms = tuple(_read_form(top, table, parts, big_endian) for table in tables if table.flag("enabled", True))
    if not 1 <= len(forms) <= _FORMS:
        raise top.error("frame", sentence("frame_schema.forms", most=_FORMS, forms=len(forms)))
    trailer = b""
    if not several:
        with top.table("frame").table("trailer") as table:
            trailer = table.hexadecimal("bytes")
            if trailer and not table.flag("optional"):
                raise table.error("optional", sentence("frame_schema.trailer_needed"))
    if trailer and any(form.first_bytes[trailer[0]] for form in forms):
        raise top.table("frame").error("trailer", sentence("frame_schema.trailer_like_frame"))
    for name in ("fields", "masks"):
        top.has(name)
    if not top.table("join").values:
        return FrameRule(forms, trailer)
    with top.table("join") as table:
        starts_with, needs = table.text("starts_with"), table.texts("needs")
        if starts_with not in needs:
            raise table.error("needs", sentence("frame_schema.join", starts_with=starts_with))
    return FrameRule(forms, trailer, JoinRule(starts_with, needs) if len(needs) > 1 else None)


def _read_form(top: Table, frame: Table, parts: dict[str, tuple[Field, ...]], big_endian: bool) -> FrameForm:
    with frame.table("key") as key:
        key_size = NUMBER_BYTES[key.choice("type", _UNSIGNED)] if frame.has("key") else 0
        key_at = key.integer("at", 0, 64, 0) if key_size else 0
        key_big_endian = _byte_order(key, big_endian)
    sync, end = frame.hexadecimal("sync"), frame.hexadecimal("end")
    checksum, covered_from, checksum_big_endian = None, 0, True
    if frame.has("checksum"):
        with frame.table("checksum") as table:
            checksum = read_checksum(table, table.integer("pad_to", 1, 64, 1))
            covered_from, checksum_big_endian = table.integer("from", 0, 64, 0), _byte_order(table, big_endian)
    length = _read_length(frame, big_endian)
    if key_size and key_at < len(sync):
        raise frame.error("key", sentence("frame_schema.key_in_sync", key_at=key_at, sync_size=len(sync)))
    form = FrameForm(
        sync=sync,
        key_at=key_at,
        key_size=key_size,
        key_big_endian=key_big_endian,
        checksum=checksum,
        checksum_from=covered_from,
        checksum_big_endian=checksum_big_endian,
        end=end,
        length=length,
        layouts={},
        fields=_read_fields_rule(top, frame, big_endian),
        masks=_read_masks(top, frame, big_endian),
    )
    form = replace(form, layouts=_read_layouts(top, frame, form, parts, big_endian=big_endian))
    if length is None and form.masks is None and form.fields is not None:
        raise frame.error("length", sentence("frame_schema.no_length"))
    for known in ("trailer", "enabled", "name", "message"):
        frame.has(known)
    frame.finish()
    return form


def _byte_order(table: Table, default_big: bool) -> bool:
    return table.choice("byte_order", ("big", "little"), "big" if default_big else "little") == "big"


def _read_length(frame: Table, big_endian: bool) -> LengthRule | None:
    if not frame.has("length"):
        return None
    with frame.table("length") as table, table.table("extended") as extended:
        size = NUMBER_BYTES[table.choice("type", _UNSIGNED)]
        largest = min((1 << 8 * size) - 1, LONGEST_FRAME)
        return LengthRule(
            at=table.integer("at", 0, 64),
            size=size,
            big_endian=_byte_order(table, big_endian),
            add=table.integer("add", 0, 256, 0),
            maximum=table.integer("maximum", 0, LONGEST_FRAME, largest),
            extended_when=extended.integer("when", 0, largest) if table.has("extended") else -1,
            extended_size=NUMBER_BYTES[extended.choice("type", _UNSIGNED)] if table.has("extended") else 0,
        )


def _read_layouts(
    top: Table, frame: Table, form: FrameForm, parts: dict[str, tuple[Field, ...]], *, big_endian: bool
) -> dict[int, Layout]:
    header = max(len(form.sync), form.key_at + form.key_size, form.length.header if form.length else 0)
    header = frame.integer("body_at", header, max(header, 256), header)
    if frame.has("content"):
        fields = _fields_of(frame, "content", parts)
        layout = _place(frame, "content", fields, start=header, tail=form.tail)
        return {0: replace(layout, kind=frame.text("name"), is_message=frame.flag("message"))}
    layouts: dict[int, Layout] = {}
    frames = top.table("frames")
    for name in frames.values:
        layout = _place(frames, name, _fields_of(frames, name, parts), start=header, tail=form.tail)
        _add(layouts, frames, name, name, layout=layout, key_size=form.key_size)
    messages = top.table("messages")
    for name in messages.values:
        with messages.table(name) as table:
            fields = _read_fields(table, "fields", big_endian) if form.length is None or table.has("fields") else ()
            layout = replace(_place(table, "fields", fields, start=header, tail=form.tail), kind=name, is_message=True)
            for key in table.texts("keys"):
                _add(layouts, table, "keys", key, layout=layout, key_size=form.key_size)
    if not (layouts or form.fields or form.masks):
        raise top.error("frames", sentence("frame_schema.no_frame"))
    return layouts


def _fields_of(table: Table, key: str, parts: dict[str, tuple[Field, ...]]) -> tuple[Field, ...]:
    used = table.texts(key)
    for part in used:
        if part not in parts:
            raise table.error(key, sentence("frame_schema.part", part=part, parts=list(parts)))
    return tuple(field for part in used for field in parts[part])


def _add(layouts: dict[int, Layout], table: Table, at: str, key: str, *, layout: Layout, key_size: int) -> None:
    if not key_size:
        if key != ANY_KEY or layouts:
            raise table.error(at, sentence("frame_schema.any_key", key=ANY_KEY))
        layouts[0] = layout
        return
    number = _hexadecimal_key(table, at, key)
    if not 0 <= number < 1 << 8 * key_size or number in layouts:
        raise table.error(at, sentence("frame_schema.key_size", key=key, size=key_size))
    if layout.length > LONGEST_FRAME:
        raise table.error(at, sentence("frame_schema.frame_size", size=layout.length, limit=LONGEST_FRAME))
    layouts[number] = layout


def _hexadecimal_key(table: Table, at: str, key: str) -> int:
    try:
        return int(key, 16)
    except ValueError:
        raise table.error(at, sentence("frame_schema.key", key=key)) from None


def _place(table: Table, key: str, fields: tuple[Field, ...], *, start: int, tail: int) -> Layout:
    """Return the frame with these fields one behind the other, of the kind that ``key`` names."""
    at, placed, names = start, [], set()
    for field in fields:
        # Of two with one name the second would be lost without a word.
        if field.name in names:
            raise table.error(key, sentence("frame_schema.twice", name=field.name))
        names.add(field.name)
        placed.append(replace(field, at=at))
        at += field.size
    return Layout(key, tuple(placed), at + tail)


def _read_fields_rule(top: Table, frame: Table, big_endian: bool) -> FieldsRule | None:
    if not frame.has("fields"):
        return None
    with frame.table("fields") as table, table.table("id") as number, table.table("size") as size:
        keys = frozenset(_hexadecimal_key(table, "keys", key) for key in table.texts("keys"))
        kinds = tuple(_format_type(table, kind, big_endian) for kind in table.texts("formats"))
        types = (FORMAT,) if kinds else ()
        messages = table.table("messages").values
        return FieldsRule(
            at=table.integer("at", 0, 64),
            id_at=number.integer("at", 0, 64),
            id_size=NUMBER_BYTES[number.choice("type", _UNSIGNED)],
            size_at=size.integer("at", 0, 64),
            size_size=NUMBER_BYTES[size.choice("type", _UNSIGNED)],
            size_counts_header=size.flag("counts_header"),
            big_endian=big_endian,
            keys=keys if table.has("keys") else None,
            ignored_bits=table.integer("ignored_id_bits", 0, (1 << 32) - 1, 0),
            format_types=kinds,
            known=_known_fields(top, big_endian, types),
            messages={_hexadecimal_key(table, "messages", key): str(name) for key, name in messages.items()},
        )


def _format_type(table: Table, kind: str, big_endian: bool) -> Field:
    name, bits = _FIXED_POINT.get(kind, (kind, 0))
    if name not in NUMBER_BYTES:
        raise table.error("formats", sentence("frame_schema.format", type=kind, known=[*NUMBER_BYTES, *_FIXED_POINT]))
    return Field(name="", type=name, at=0, size=NUMBER_BYTES[name], big_endian=big_endian, factor=1 / 2.0**bits)


def _known_fields(top: Table, big_endian: bool, types: tuple[str, ...]) -> dict[int | None, dict[int, tuple[Field, ...]]]:
    known: dict[int | None, dict[int, tuple[Field, ...]]] = {}
    groups = top.table("fields")
    for key in groups.values:
        group = groups.table(key)
        number = None if key == ANY_KEY else _hexadecimal_key(groups, key, key)
        known[number] = {_hexadecimal_key(group, id_, id_): _read_fields(group, id_, big_endian, types) for id_ in group.values}
    return known


def _read_masks(top: Table, frame: Table, big_endian: bool) -> MasksRule | None:
    if not frame.has("masks"):
        return None
    with frame.table("masks") as table:
        at = table.integer("at", 0, 64)
    masks = top.table("masks")
    groups: dict[int, tuple[tuple[Field, ...], ...]] = {}
    for bit in masks.values:
        if bit not in tuple("01234567"):
            raise masks.error(bit, sentence("frame_schema.mask_bit", bit=bit))
        # A bit stands for one field or for several.
        bits = [found if isinstance(found, list) else [found] for found in masks.items(bit)]
        groups[int(bit)] = tuple(
            tuple(_read_field(masks.below(field, bit, number), big_endian) for number, field in enumerate(fields))
            for fields in bits
        )
    return MasksRule(at, groups)


def _read_fields(table: Table, key: str, big_endian: bool, types: tuple[str, ...] = ()) -> tuple[Field, ...]:
    tables = list(table.tables(key))
    if len(tables) > MOST_FIELDS:
        raise table.error(key, sentence("frame_schema.most_fields", fields=len(tables), limit=MOST_FIELDS))
    fields = tuple(_read_field(each, big_endian, types) for each in tables)
    if not fields:
        raise table.error(key, sentence("frame_schema.no_field"))
    return fields


def _read_field(table: Table, default_big: bool, types: tuple[str, ...] = ()) -> Field:
    """Read a field; ``types`` are those that it may have besides the usual ones."""
    with table:
        name, kind = table.text("name"), table.choice("type", (*NUMBER_BYTES, "fp12.20", *types, *TEXT_TYPES))
        if kind in TEXT_TYPES:
            size = 0 if table.flag("rest") else table.integer("size", 1, LONGEST_FRAME)
            return Field(name=name, type=kind, at=0, size=size, repeat=table.integer("repeat", 0, 256, 0))
        count = table.integer("count", 1, 256, 1)
        kind, fraction_bits = _FIXED_POINT.get(kind, (kind, 0))
        field = Field(
            name=name,
            type=kind,
            at=0,
            count=count,
            size=(1 if kind == FORMAT else NUMBER_BYTES[kind]) * count,
            big_endian=_byte_order(table, default_big),
            factor=table.scale("scale", 1.0) / 2.0 ** table.integer("fraction_bits", 0, 64, fraction_bits),
            offset=table.number("offset", 0.0),
            unit=table.text("unit", ""),
            bits=tuple(_read_bits(each) for each in table.tables("bits")),
        )
        if field.bits and (count != 1 or kind[0] != "u"):
            raise table.error("bits", sentence("frame_schema.bits", count=count, type=kind))
        return field


def _read_bits(table: Table) -> Bits:
    with table:
        name, start, size = table.text("name"), table.integer("from", 0, 63), table.integer("size", 1, 64, 1)
        return Bits(name, start, size, cast("tuple[str | int | float, ...]", tuple(table.items("values", []))))
