"""Samples to binary frames of any protocol, by the same description that decodes them, for whole blocks at once.

A frame is a template of zeros with its header in place; the layout that the decoder finds in it says where the values go.
Fields without a meaning in a sample stay 0. Values outside the range of a field are set to its end. A value that is not
available is NaN in a field of floating point, else 0, and the flag of the sample says so where the protocol has one.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.frame_forms import FieldsRule, FrameForm
from imufield.acquire.protocol.layout import NUMBER_BYTES, Field
from imufield.acquire.protocol.protocol import Protocol
from imufield.errors import UsageError
from imufield.samples import FloatArray, IntArray, Samples
from imufield.sentences import Sentences
from imufield.simulate.wire.forms import WireFrame

sentence = Sentences(__package__)

Bytes = NDArray[np.uint8]
Numbers = FloatArray | IntArray
_ANY_SIZE = 1 << 16  # Of the rest of a body: no field is left out for lack of room.
_WHOLE_TURN = 1 << 53  # Wrap of stamps of 64 bits: 104 days of ns, and every number below is exact.


class WireClock:
    """Counter and time stamps as the instrument counts them.

    Parameters
    ----------
    protocol : Protocol
    rate_hz : float
        Nominal rate of the samples.
    """

    def __init__(self, protocol: Protocol, rate_hz: float) -> None:
        self.protocol = protocol
        self.rate_hz = rate_hz
        self.counter_offset = 0
        self.time_offset_s = 0.0

    def counter(self, samples: Samples, modulus: int) -> IntArray:
        """Return the counter of each sample; it counts samples, or time."""
        # A counter of lines counts them, whatever the clock makes of it.
        counts_lines = self.protocol.lines is not None
        per_sample = 1.0 if counts_lines else self.protocol.clock.counter_ticks_per_s / self.rate_hz or 1.0
        ticks = np.rint(samples.counter * per_sample).astype(np.int64) + self.counter_offset
        wrapped: IntArray = ticks % (self.protocol.clock.counter_modulus or modulus or _WHOLE_TURN)
        return wrapped

    def stamps(self) -> dict[str, tuple[float, float]]:
        """Return ticks per second and wrap of each time stamp the protocol knows, by field; a wrap of 0: that of the field."""
        clock = self.protocol.clock
        if clock.times:
            return {time.field: (time.ticks_per_s, time.modulus) for time in clock.times}
        return {clock.time_field: (clock.time_ticks_per_s, clock.time_modulus)} if clock.time_field else {}

    def time_s(self, samples: Samples) -> FloatArray:
        """Return the instrument's time of each sample."""
        return samples.time_s + self.time_offset_s

    def jump(self, by: int, has_counter: bool) -> None:
        """Let the counter jump; without a counter, the time stamp by as many samples."""
        if has_counter:
            self.counter_offset += by
        else:
            self.time_offset_s += by / self.rate_hz


class FrameEncoder:
    """Encodes one frame for each sample.

    Parameters
    ----------
    protocol : Protocol
    frame : WireFrame
    clock : WireClock

    Raises
    ------
    UsageError
        If the protocol has no such frame.
    """

    def __init__(self, protocol: Protocol, frame: WireFrame, clock: WireClock) -> None:
        self._protocol = protocol
        self._clock = clock
        self._form = _find_form(protocol, frame)
        self._template = np.frombuffer(_template(protocol, self._form, frame), dtype=np.uint8)
        shape = self._form.shape(self._template.tobytes())
        fields = () if shape is None else shape.layout.fields
        if not fields:
            raise UsageError(sentence("frames.no_key", protocol=protocol.name, key=frame.key))
        self._fields: dict[str, Field] = {field.name: field for field in fields}
        self._constant = {name: value for name, value in frame.values.items() if name in self._fields}
        self.has_counter = protocol.clock.counter_field in self._fields
        self.length = len(self._template)
        # Place of the last byte of the checksum; without one, of the last byte before the end marker.
        self.checksum_at = self.length - len(self._form.end) - 1

    def encode(self, samples: Samples) -> Bytes:
        """Return the frames of a block, shape (n, length)."""
        rows = np.tile(self._template, (len(samples), 1))
        for name, raw in self._raw(samples).items():
            _put(rows, self._fields[name], raw)
        checksum, until = self._form.checksum, self.length - len(self._form.end)
        if checksum is not None:
            at = until - checksum.size
            value = checksum.of_rows(rows[:, self._form.checksum_from : at])
            rows[:, at:until] = bytes_of(value[:, np.newaxis].astype(np.int64), checksum.size, self._form.checksum_big_endian)
        return rows

    def _raw(self, samples: Samples) -> dict[str, Numbers]:
        """Return the raw values by field."""
        clock = self._protocol.clock
        raw: dict[str, Numbers] = {name: np.full(len(samples), value) for name, value in self._constant.items()}
        raw |= self._triad("accelerometer", samples.accelerometer) | self._triad("gyroscope", samples.gyroscope)
        rules = self._protocol.samples
        named = next((name for name in rules.temperature.fields if name in self._fields), None)
        if named is not None:
            field = self._fields[named]
            degc = (samples.temperature_degc / self._protocol.factors["temperature"] - field.offset) / field.factor
            raw[named] = degc if field.count == 1 else np.repeat(degc[:, np.newaxis], field.count, axis=1)
        # Several flags may share a field, which may have constant bits besides; nothing else is written to such a field.
        flags: dict[str, Numbers] = {}
        for rule in rules.flags:
            if rule.field in self._fields:
                is_set = ((samples.status & np.uint32(rule.flag)) != 0) ^ rule.when_clear
                before = flags.get(rule.field, np.full(len(samples), self._constant.get(rule.field, 0)))
                flags[rule.field] = before.astype(np.int64) | np.where(is_set, rule.mask, 0)
        raw |= flags
        if self.has_counter:
            raw[clock.counter_field] = self._clock.counter(samples, self._fields[clock.counter_field].modulus)
        for name, (ticks_per_s, modulus) in self._clock.stamps().items():
            if name in self._fields:
                raw[name] = _stamp(self._fields[name], self._clock.time_s(samples) * ticks_per_s, modulus)
        return raw

    def _triad(self, part: str, values: FloatArray) -> dict[str, Numbers]:
        rule = getattr(self._protocol.samples, part)
        found = [self._fields[name] for name in rule.fields if name in self._fields]
        # One field with three numbers, or three fields.
        columns = [values] if found and found[0].count == 3 else list(values.T) if len(found) >= 3 else []
        triad = zip(found, columns, strict=False)
        return {
            field.name: (column / self._protocol.factor(part, field) - field.offset) / field.factor for field, column in triad
        }


def _find_form(protocol: Protocol, frame: WireFrame) -> FrameForm:
    forms = protocol.frame.forms if protocol.frame else ()
    for form in forms:
        common = min(len(form.sync), len(frame.start))
        if form.sync[:common] == frame.start[:common]:
            return form
    raise UsageError(sentence("frames.no_start", protocol=protocol.name, start=frame.start.hex(" ")))


def _template(protocol: Protocol, form: FrameForm, frame: WireFrame) -> bytes:
    """Return a frame with header and zeros."""
    if form.masks:
        fields = form.masks.fields(frame.masks) or []
        body = frame.masks + bytes(sum(field.size for field in fields))
        return form.sync.ljust(form.masks.at, b"\0") + body + bytes(form.tail - len(form.end)) + form.end
    if form.fields and frame.fields:
        body = b"".join(_field(form.fields, frame.key, number) for number in frame.fields)
        data = bytearray(bytes(form.fields.at) + body + bytes(form.tail))
    else:
        layout = form.layouts.get(frame.key)
        data = bytearray(0 if layout is None else layout.length)
    if len(data) < form.header + form.tail:
        raise UsageError(sentence("frames.no_key", protocol=protocol.name, key=frame.key))
    data[: len(form.sync)] = form.sync
    data[form.key_at : form.key_at + form.key_size] = frame.key.to_bytes(form.key_size, _order(form.key_big_endian))
    if form.length:
        number, size = len(data) - form.length.add, form.length.size
        if number > form.length.maximum or number >= 1 << 8 * size or number == form.length.extended_when:
            raise UsageError(sentence("frames.too_long", size_bytes=len(data)))
        data[form.length.at : form.length.header] = number.to_bytes(size, _order(form.length.big_endian))
    data[len(data) - len(form.end) :] = form.end
    return bytes(data)


def _field(rule: FieldsRule, key: int, number: int) -> bytes:
    """Return one field of a body, all zeros behind id and size."""
    size = sum(field.size for field in rule.fields_of(key, number, _ANY_SIZE))
    header = bytearray(rule.header)
    order = _order(rule.big_endian)
    header[rule.id_at : rule.id_at + rule.id_size] = number.to_bytes(rule.id_size, order)
    told = size + (rule.header if rule.size_counts_header else 0)
    header[rule.size_at : rule.size_at + rule.size_size] = told.to_bytes(rule.size_size, order)
    return bytes(header) + bytes(size)


def _order(big_endian: bool) -> Literal["big", "little"]:
    return "big" if big_endian else "little"


def _stamp(field: Field, ticks: FloatArray, modulus: float) -> Numbers:
    # A wrap of 0 in the protocol is the wrap of the field itself; a float has none.
    if field.type[0] == "f":
        return ticks % modulus if modulus else ticks
    whole = np.rint(ticks).astype(np.int64)
    turn = int(modulus) or (field.modulus if NUMBER_BYTES[field.type] < 8 else _WHOLE_TURN)
    return np.asarray(whole % turn)


def _put(rows: Bytes, field: Field, raw: Numbers) -> None:
    """Write raw values, shape (n,) or (n, count), into a field."""
    values = raw.reshape(len(rows), -1)
    if field.type in ("f32", "f64"):
        kind = ("<", ">")[field.big_endian] + field.type.replace("32", "4").replace("64", "8")
        data = np.ascontiguousarray(values, dtype=kind).view(np.uint8)
    elif field.type == "fp16.32":
        data = _bytes_of_48(_whole(values, 48, signed=True), field.big_endian)
    else:
        size = NUMBER_BYTES[field.type]
        data = bytes_of(_whole(values, 8 * size, signed=field.type[0] == "i"), size, field.big_endian)
    rows[:, field.at : field.at + field.size] = data.reshape(len(rows), -1)


def _whole(values: Numbers, bits: int, *, signed: bool) -> IntArray:
    if values.dtype.kind == "i":
        return values.astype(np.int64)
    low, high = (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1) if signed else (0.0, 2.0**bits - 1)
    return np.clip(np.rint(np.nan_to_num(values)), low, high).astype(np.int64)


def bytes_of(values: IntArray, size: int, big_endian: bool) -> Bytes:
    """Return the low ``size`` bytes of whole numbers, shape (n, k) to (n, k * size)."""
    # All eight bytes of each number, the most significant first; the low ones are the last.
    wide = np.ascontiguousarray(values, dtype=">i8").view(np.uint8).reshape(*values.shape, 8)[:, :, 8 - size :]
    return (wide if big_endian else wide[:, :, ::-1]).reshape(len(values), -1)


def _bytes_of_48(values: IntArray, big_endian: bool) -> Bytes:
    """Return numbers of 48 bits as Xsens sends them: the 32 bits of the fraction, then the 16 bits of the whole number."""
    fraction = bytes_of(values & 0xFFFFFFFF, 4, big_endian).reshape(*values.shape, 4)
    whole = bytes_of(values >> 32, 2, big_endian).reshape(*values.shape, 2)
    return np.concatenate([fraction, whole], axis=2).reshape(len(values), -1)
