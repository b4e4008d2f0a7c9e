"""What a protocol file refers to is there and fits, whatever the wire."""

from __future__ import annotations

import pytest

from imufield.acquire.protocol.protocol import load_protocol, parse_protocol
from imufield.errors import ProtocolError, Reason
from tests.acquire.own_protocols import FRAMES, LINES, changed
from tests.refused import refused

COUNTER, FLAG = 'counter = { field = "counter"', 'field = "status", mask = 1'
GYROSCOPE, TEMPERATURE = '{ fields = ["gyroscope"]', '{ fields = ["temperature"]'


def of_flag(name: str, mask: int = 1) -> tuple[str, str]:
    return FLAG, f'field = "{name}", mask = {mask}'


def with_scale(name: str, mask: int = 1) -> tuple[str, str]:
    return GYROSCOPE, GYROSCOPE + f', scale_when = {{ field = "{name}", mask = {mask}, scale = 2 }}'


def stamped(name: str, more: str = "") -> tuple[str, str]:
    return COUNTER, f'time = {{ field = "{name}"{more} }}\n{COUNTER}'


IN_FRAMES = [
    # (change), key, sentence, what it names
    (('["ax", "ay", "az"]', '["ax", "ay", "ac"]'), "samples.accelerometer", "references.field", "'ac'"),
    (('["ax", "ay", "az"]', '["ax", "ay", "ay"]'), "samples.accelerometer", "references.triad", "ay, ay"),
    (('["ax", "ay", "az"]', '["ax", "ay", "label"]'), "samples.accelerometer", "references.no_number", "ascii"),
    ((GYROSCOPE, '{ fields = ["pair"]'), "samples.gyroscope", "references.triad", "2"),
    ((TEMPERATURE, '{ fields = ["temprature"]'), "samples.temperature", "references.field", "'temperature'"),
    ((TEMPERATURE, '{ fields = ["label"]'), "samples.temperature", "references.no_number", "'label'"),
    ((TEMPERATURE, '{ fields = ["share"]'), "samples.temperature", "protocol.unit", "degC"),
    (of_flag("state"), "samples.flags.0.field", "references.field", "'state'"),
    (of_flag("label"), "samples.flags.0.field", "references.no_number", "'label'"),
    (of_flag("share"), "samples.flags.0.field", "references.no_whole", "f32"),
    (of_flag("pair"), "samples.flags.0.field", "references.count", "2"),
    (of_flag("status", 256), "samples.flags.0.mask", "references.beyond", "256"),
    (("[clock]", 'instrument_status = [{ field = "share" }]\n[clock]'), None, "references.no_whole", "'share'"),
    (with_scale("state"), "samples.gyroscope.scale_when.field", "references.field", "'state'"),
    (with_scale("label"), "samples.gyroscope.scale_when.field", "references.no_number", "'label'"),
    (with_scale("pair"), "samples.gyroscope.scale_when.field", "references.count", "2"),
    (with_scale("share"), "samples.gyroscope.scale_when.field", "references.no_whole", "f32"),
    (with_scale("status", 512), "samples.gyroscope.scale_when.mask", "references.beyond", "512"),
    ((GYROSCOPE, GYROSCOPE + ', sensor_temperature = "label"'), None, "references.no_number", "'label'"),
    ((GYROSCOPE, GYROSCOPE + ', sensor_temperature = "pair"'), None, "references.count", "2"),
    ((GYROSCOPE, GYROSCOPE + ', sensor_temperature = "ax"'), None, "references.unit", "m/s^2"),
    ((COUNTER, 'counter = { field = "conter"'), "clock.counter.field", "references.field", "'counter'"),
    ((COUNTER, 'counter = { field = "label"'), "clock.counter.field", "references.no_number", "ascii"),
    ((COUNTER, 'counter = { field = "share"'), "clock.counter.field", "references.no_whole", "f32"),
    ((COUNTER, 'counter = { field = "pair"'), "clock.counter.field", "references.count", "2"),
    ((COUNTER, COUNTER + ", modulus = 65536"), "clock.counter.modulus", "references.beyond", "65536"),
    ((COUNTER, COUNTER + ", steps = [256]"), "clock.counter.steps", "references.beyond", "256"),
    ((COUNTER, COUNTER + ", modulus = 100, steps = [100]"), "clock.counter.steps", "toml.integer", "99"),
    (stamped("tme"), "clock.time.field", "references.field", "'tme'"),
    (stamped("label"), "clock.time.field", "references.no_number", "'label'"),
    (stamped("pair"), "clock.time.field", "references.count", "2"),
    (stamped("status", ", modulus = 1000"), "clock.time.modulus", "references.beyond", "1000"),
    ((COUNTER, 'time = [{ field = "share" }, { field = "tme" }]\n' + COUNTER), "clock.time.1.field", "references.field", "tme"),
    (('name = "counter", type = "u8"', 'name = "counter", type = "format"'), "parts.all.0.type", "toml.choice", "'format'"),
    (("[clock]", '[nominal]\ngrade = "super"\n[clock]'), "nominal.grade", "toml.choice", "tactical"),
]
IN_LINES = [
    (('["ax", "ay", "az"]', '["ax", "ay", "foo"]'), "samples.accelerometer", "references.field", "'foo'"),
    (('["gx", "gy", "gz"]', '["gx", "gy"]'), "samples.gyroscope", "references.triad", "gx, gy"),
    (('["temperature"]', '["temp"]'), "samples.temperature", "references.field", "'temp'"),
    ((COUNTER, 'counter = { field = "count"'), "clock.counter.field", "references.field", "'counter'"),
    ((COUNTER, 'counter = { field = "ax"'), "clock.counter.field", "references.no_whole", "'ax'"),
    ((COUNTER, COUNTER + ", steps = [65536]"), "clock.counter.steps", "toml.integer", "65535"),
    (stamped("tme"), "clock.time.field", "references.field", "'time'"),
    ((COUNTER, 'time = [{ field = "time" }]\n' + COUNTER), "clock.time", "toml.table", "table"),
    (("[clock]", "[clock]\ngaps_told = true"), "clock.gaps_told", "toml.unknown", "gaps_told"),
    (
        ("[clock]", 'flags = [{ field = "counter", mask = 1, flag = "start_up" }]\n[clock]'),
        "samples.flags",
        "toml.unknown",
        "flags",
    ),
    (
        ("[clock]", 'instrument_status = [{ field = "counter" }]\n[clock]'),
        "samples.instrument_status",
        "toml.unknown",
        "status",
    ),
    (
        ('unit = "g"', 'unit = "g", scale_when = { field = "counter", mask = 1, scale = 2 }'),
        "samples.accelerometer.scale_when",
        "toml.unknown",
        "scale_when",
    ),
    (
        ('unit = "g"', 'unit = "g", sensor_temperature = "temperature"'),
        "samples.accelerometer.sensor_temperature",
        "toml.unknown",
        "sensor_temperature",
    ),
]


@pytest.mark.parametrize(
    ("text", "change", "key", "problem", "says"),
    [(FRAMES, *case) for case in IN_FRAMES] + [(LINES, *case) for case in IN_LINES],
)
def test_what_is_not_there_or_does_not_fit_is_refused(
    text: str, change: tuple[str, str], key: str | None, problem: str, says: str
) -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, says, "mine.toml line", key=problem) as caught:
        parse_protocol(changed(text, change), label="mine.toml")
    assert key in (None, caught.value.values["key"])


def test_fields_of_one_name_must_all_fit() -> None:
    text = load_protocol("stim300").text
    # The status byte of one kind of frame is the four bytes of another part there.
    wrong = changed(text, ('{ name = "gyroscope_status", type = "u8"', '{ name = "gyroscope_status", type = "f32"'))
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "gyroscope_status", "f32", key="references.no_whole"):
        parse_protocol(wrong)


def test_fields_of_messages_are_none_of_samples() -> None:
    named = '[messages.version]\nkeys = ["0x02"]\nfields = [{ name = "release", type = "u8" }]\n'
    keyed = changed(
        FRAMES,
        ('sync = "AA 55"', 'sync = "AA 55"\nkey = { at = 2, type = "u8" }'),
        ("any =", "0x01 ="),
        ("[samples]", named + "[samples]"),
    )
    assert parse_protocol(keyed).clock.counter_modulus == 256
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "'release'", key="references.field"):
        parse_protocol(changed(keyed, (COUNTER, 'counter = { field = "release"')))


@pytest.mark.parametrize(
    ("kind", "modulus"), [("u8", 256), ("i8", 256), ("i16", 65536), ("u24", 1 << 24), ("i32", 1 << 32), ("u64", 1 << 53)]
)
def test_a_counter_wraps_where_its_bits_end(kind: str, modulus: int) -> None:
    text = changed(FRAMES, ('name = "counter", type = "u8"', f'name = "counter", type = "{kind}"'))
    assert parse_protocol(text).clock.counter_modulus == modulus


def test_a_stream_may_lack_columns() -> None:
    text = changed(LINES, ('"counter,ax,ay,az,gx,gy,gz,temperature"', '"ax,ay,az"'))
    assert parse_protocol(text).clock.counter_field == ""
    assert load_protocol("text", {"columns": "ax,ay,az"}).clock.time_field == ""
    assert load_protocol("text", {"columns": "counter,ax,ay,az"}).clock.counter_field == "counter"
