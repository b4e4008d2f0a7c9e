"""The tables of a protocol file as typed objects: frames, fields, what they mean in a sample, the clock.

Every limit is far above what instruments use (the longest known body is 4096 bytes) and keeps a wrong file harmless.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from imufield.acquire.checksum import Checksum, make_checksum
from imufield.acquire.layout import NUMBER_BYTES, TEXT_TYPES, Bits, Field, Layout
from imufield.acquire.protocol_toml import Table
from imufield.errors import ProtocolError
from imufield.samples import INSTRUMENT_STATUS_SHIFT, Status

LONGEST_FRAME = 65536
ANY_KEY = "any"
"""The one entry of ``[frames]`` where no byte tells kinds of frames apart."""


@dataclass(frozen=True, slots=True)
class FrameRule:
    """How frames are found in a stream."""

    sync: bytes
    """Bytes every frame begins with; may be empty."""
    key_at: int
    key_size: int
    """Where the bytes stand that tell what kind of frame it is; size 0: there is one kind."""
    key_big_endian: bool
    checksum: Checksum | None
    checksum_from: int
    """Offset of the first byte covered; the checksum itself stands at the end of the frame."""
    checksum_big_endian: bool
    trailer: bytes
    """Bytes that may follow a frame and carry nothing."""
    layouts: dict[int, Layout]
    """By key; key 0 where there is one kind."""

    def key_of(self, row: bytes) -> int:
        """Return the key of one frame."""
        return int.from_bytes(row[self.key_at : self.key_at + self.key_size], "big" if self.key_big_endian else "little")


@dataclass(frozen=True, slots=True)
class TextRule:
    """How lines of numbers are read."""

    columns: tuple[str, ...]
    """Names in the order of the line; "-" is passed over."""
    delimiter: str
    prefix: str
    comments: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A part of a sample: the first of these fields that a frame has (or three of one value each)."""

    fields: tuple[str, ...]
    unit: str | None = None
    """None: the unit of the field."""
    increment: bool = False


@dataclass(frozen=True, slots=True)
class FlagRule:
    """Status bits of the instrument that set flags of a sample."""

    field: str
    mask: int
    flag: Status
    when_clear: bool = False


@dataclass(frozen=True, slots=True)
class SampleRule:
    """What fields mean in a sample."""

    accelerometer: Quantity
    gyroscope: Quantity
    temperature: Quantity
    flags: tuple[FlagRule, ...]
    instrument_status: tuple[tuple[str, int], ...]
    """Fields and by how many bits they are shifted inside the upper 16 bits of the status."""


@dataclass(frozen=True, slots=True)
class ClockRule:
    """What gives a sample its time."""

    counter_field: str = ""
    counter_modulus: int = 0
    counter_ticks_per_s: float = 0.0
    """0: the counter counts samples and says nothing about time."""
    counter_steps: tuple[int, ...] = (1,)
    time_field: str = ""
    time_modulus: int = 0
    time_ticks_per_s: float = 1.0
    rate_hz: float = 0.0
    """Nominal sample rate; 0: not known beforehand."""


def read_frames(top: Table) -> FrameRule:
    """Read ``[frame]``, ``[parts]``, ``[frames]`` and ``[messages]``."""
    big_endian = top.choice("byte_order", ("big", "little")) == "big"
    frame = top.table("frame")
    key = frame.table("key")
    key_size = NUMBER_BYTES[key.choice("type", ("u8", "u16", "u24", "u32"))] if frame.has("key") else 0
    key_at = key.integer("at", 0, 64, 0) if key_size else 0
    key_big_endian = _byte_order(key, big_endian)
    key.finish()
    sync = frame.hexadecimal("sync")
    checksum, covered_from, checksum_big_endian = _read_checksum(frame, big_endian)
    trailer = _read_trailer(frame)
    frame.finish()
    header = max(len(sync), key_at + key_size)
    if key_size and key_at < len(sync):
        raise frame.error("key", f"the key begins at byte {key_at}, inside the {len(sync)} sync bytes")
    tail = checksum.size if checksum else 0
    layouts = _read_layouts(top, header, tail, key_size, big_endian)
    if trailer and trailer[0] in _first_bytes(sync, key_at, key_size, layouts):
        raise frame.error("trailer", "the trailer begins like a frame, so the two cannot be told apart")
    return FrameRule(sync, key_at, key_size, key_big_endian, checksum, covered_from, checksum_big_endian, trailer, layouts)


def _first_bytes(sync: bytes, key_at: int, key_size: int, layouts: dict[int, Layout]) -> set[int]:
    if sync:
        return {sync[0]}
    return set(layouts) if key_size == 1 and key_at == 0 else set(range(256))


def _byte_order(table: Table, default_big: bool) -> bool:
    return table.choice("byte_order", ("big", "little"), "big" if default_big else "little") == "big"


def _read_checksum(frame: Table, big_endian: bool) -> tuple[Checksum | None, int, bool]:
    if not frame.has("checksum"):
        return None, 0, True
    table = frame.table("checksum")
    algorithm, pad_to = table.text("algorithm"), table.integer("pad_to", 1, 64, 1)
    try:
        checksum = make_checksum(algorithm, pad_to)
    except ProtocolError as error:
        raise table.error("algorithm", error.message) from error
    covered_from, order = table.integer("from", 0, 64, 0), _byte_order(table, big_endian)
    table.finish()
    return checksum, covered_from, order


def _read_trailer(frame: Table) -> bytes:
    table = frame.table("trailer")
    trailer = table.hexadecimal("bytes")
    if trailer and not table.flag("optional"):
        raise table.error("optional", "a trailer that must be there is not supported; write optional = true")
    table.finish()
    return trailer


def _read_layouts(top: Table, header: int, tail: int, key_size: int, big_endian: bool) -> dict[int, Layout]:
    parts = {name: _read_fields(top.table("parts"), name, big_endian) for name in top.table("parts").values}
    layouts: dict[int, Layout] = {}
    frames = top.table("frames")
    for name in frames.values:
        used = frames.items(name)
        unknown = next((part for part in used if part not in parts), None)
        if unknown is not None:
            raise frames.error(name, f"there is no part {unknown!r}; [parts] has: {', '.join(parts)}")
        fields = tuple(field for part in used for field in parts[part])
        _add(layouts, frames, name, name, _place(name, fields, header, tail), key_size)
    messages = top.table("messages")
    for name in messages.values:
        table = messages.table(name)
        fields = _read_fields(table, "fields", big_endian)
        layout = replace(_place(name, fields, header, tail), is_message=True)
        for key in table.items("keys"):
            _add(layouts, table, "keys", key, layout, key_size)
        table.finish()
    if not layouts:
        raise top.error("frames", "a protocol needs at least one frame")
    return layouts


def _add(layouts: dict[int, Layout], table: Table, at: str, key: object, layout: Layout, key_size: int) -> None:
    if not key_size:
        if key != ANY_KEY or layouts:
            raise table.error(at, f"without a key there is one kind of frame, called {ANY_KEY!r}")
        layouts[0] = layout
        return
    try:
        number = int(str(key), 16)
    except ValueError:
        raise table.error(at, f"a frame is called by its key in hexadecimal such as 0x93, not {key!r}") from None
    if not 0 <= number < 1 << 8 * key_size or number in layouts:
        raise table.error(at, f"key {key} does not fit into {key_size} bytes or is given twice")
    if layout.length > LONGEST_FRAME:
        raise table.error(at, f"this frame has {layout.length} bytes, more than the limit of {LONGEST_FRAME}")
    layouts[number] = layout


def _place(kind: str, fields: tuple[Field, ...], header: int, tail: int) -> Layout:
    at, placed = header, []
    for field in fields:
        placed.append(replace(field, at=at))
        at += field.size
    return Layout(kind, tuple(placed), at + tail)


def _read_fields(table: Table, key: str, big_endian: bool) -> tuple[Field, ...]:
    fields = tuple(_read_field(each, big_endian) for each in table.tables(key))
    if not fields:
        raise table.error(key, "needs at least one field")
    return fields


def _read_field(table: Table, default_big: bool) -> Field:
    name, kind = table.text("name"), table.choice("type", (*NUMBER_BYTES, *TEXT_TYPES))
    if kind in TEXT_TYPES:
        size = table.integer("size", 1, LONGEST_FRAME)
        table.finish()
        return Field(name, kind, 0, size=size)
    count = table.integer("count", 1, 256, 1)
    field = Field(
        name,
        kind,
        0,
        count,
        NUMBER_BYTES[kind] * count,
        _byte_order(table, default_big),
        table.number("scale", 1.0) / 2.0 ** table.integer("fraction_bits", 0, 64, 0),
        table.number("offset", 0.0),
        table.text("unit", ""),
        tuple(_read_bits(each) for each in table.tables("bits")),
    )
    if field.bits and (count != 1 or kind[0] != "u"):
        raise table.error("bits", f"bits belong to one unsigned number, not to {count} of type {kind}")
    table.finish()
    return field


def _read_bits(table: Table) -> Bits:
    bits = Bits(
        table.text("name"), table.integer("from", 0, 63), table.integer("size", 1, 64, 1), tuple(table.items("values", []))
    )
    table.finish()
    return bits


def read_text(top: Table) -> TextRule:
    """Read ``[text]``."""
    table = top.table("text")
    names = tuple(name.strip() for name in table.text("columns").split(","))
    known = ("time", "counter", "ax", "ay", "az", "gx", "gy", "gz", "temperature", "-")
    for name in names:
        if name not in known or (name != "-" and names.count(name) > 1):
            raise table.error("columns", f"{name!r} is not known or stands there twice; columns are: {', '.join(known)}")
    if not {"ax", "ay", "az"} <= set(names):
        raise table.error("columns", f"ax, ay and az must be among the columns, but these are: {', '.join(names)}")
    rule = TextRule(
        names,
        table.choice("delimiter", ("auto", "comma", "semicolon", "whitespace"), "auto"),
        table.text("prefix", ""),
        tuple(str(comment) for comment in table.items("comments", [])),
    )
    table.finish()
    return rule


def read_samples(top: Table) -> SampleRule:
    """Read ``[samples]``."""
    table = top.table("samples")
    status = tuple(_read_shift(each) for each in table.tables("instrument_status"))
    rule = SampleRule(
        _read_quantity(table.table("accelerometer")),
        _read_quantity(table.table("gyroscope")),
        _read_quantity(table.table("temperature")),
        tuple(_read_flag(each) for each in table.tables("flags")),
        status,
    )
    for key in ("accelerometer", "gyroscope", "temperature"):
        table.has(key)
    table.finish()
    return rule


def _read_quantity(table: Table) -> Quantity:
    quantity = Quantity(
        tuple(str(name) for name in table.items("fields", [])),
        table.text("unit") if table.has("unit") else None,
        table.flag("increment"),
    )
    table.finish()
    return quantity


def _read_flag(table: Table) -> FlagRule:
    names = {flag.name.lower(): flag for flag in Status if flag.name}
    rule = FlagRule(
        table.text("field"),
        table.integer("mask", 1, (1 << 64) - 1),
        names[table.choice("flag", names)],
        table.choice("when", ("set", "clear"), "set") == "clear",
    )
    table.finish()
    return rule


def _read_shift(table: Table) -> tuple[str, int]:
    found = table.text("field"), table.integer("shift", 0, 31 - INSTRUMENT_STATUS_SHIFT, 0)
    table.finish()
    return found


def read_clock(top: Table) -> ClockRule:
    """Read ``[clock]``."""
    table = top.table("clock")
    counter, time = table.table("counter"), table.table("time")
    rule = ClockRule(
        counter.text("field", ""),
        counter.integer("modulus", 0, 1 << 53, 0),
        counter.number("ticks_per_s", 0.0),
        tuple(step for step in counter.items("steps", [1]) if isinstance(step, int) and step > 0),
        time.text("field", ""),
        time.integer("modulus", 0, 1 << 53, 0),
        time.number("ticks_per_s", 1.0),
        table.number("rate_hz", 0.0),
    )
    if rule.counter_ticks_per_s < 0 or rule.time_ticks_per_s <= 0 or rule.rate_hz < 0:
        raise table.error("ticks_per_s", "rates must be positive")
    for part in (counter, time, table):
        part.finish()
    return rule
