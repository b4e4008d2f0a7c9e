"""Protocol files: what they say, and the sentence a wrong one gets."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imufield.acquire.protocol.protocol import GRADES, load_protocol, parse_protocol, protocol_names
from imufield.acquire.protocol.toml import FILE_LIMIT_BYTES
from imufield.calibrate.model import grades
from imufield.errors import ProtocolError, Reason, SettingError
from imufield.toml_and_json import DEEPEST
from tests.refused import refused

STIM300 = load_protocol("stim300").text


def wrong(text: str, old: str, new: str) -> ProtocolError:
    assert old in text
    with pytest.raises(ProtocolError) as caught:
        parse_protocol(text.replace(old, new, 1), label="mine.toml")
    assert "\n" not in caught.value.message
    return caught.value


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def test_shipped_protocols_load_by_name() -> None:
    assert {"rows_f64", "stim300", "text"} <= set(protocol_names())
    for name in protocol_names():
        protocol = load_protocol(name)
        assert protocol.name == name
        assert parse_protocol(protocol.text).sha256 == protocol.sha256


def test_lengths_are_those_of_the_datasheet(lengths: dict[int, int]) -> None:
    frame = load_protocol("stim300").frame
    assert frame is not None
    assert {key: layout.length for key, layout in frame.forms[0].layouts.items()} == lengths


def test_settings_are_assumed_read_or_given() -> None:
    protocol = load_protocol("stim300", {"accelerometer_range_g": "30"}, read={"rate_hz": 500, "accelerometer_range_g": 5})
    origins = {name: (setting.value, setting.origin) for name, setting in protocol.settings.items()}
    assert origins == {
        "accelerometer_range_g": (30, "given"),
        "accelerometer_output": ("rate", "assumed"),
        "gyroscope_output": ("rate", "assumed"),
        "rate_hz": (500, "read"),
    }
    assert protocol.nominal.accelerometer_range_m_s2 == pytest.approx(30 * 9.80665)
    assert protocol.nominal.gyroscope_range_rad_s == pytest.approx(np.radians(400))
    assert protocol.nominal.rate_hz == 500


@pytest.mark.parametrize(
    ("given", "reason", "facts"),
    [
        ({"accelerometer_range": 10}, Reason.UNKNOWN_KEY, ("accelerometer_range_g",)),
        ({"accelerometer_range_g": 12}, Reason.USAGE, ("accelerometer_range_g", "12", "2, 5, 10, 30, 80")),
        ({"accelerometer_range_g": "big"}, Reason.USAGE, ("big", "2, 5, 10, 30, 80")),
        ({"accelerometer_range_g": True}, Reason.USAGE, ("True", "2, 5, 10, 30, 80")),
        ({"gyroscope_output": "integrated"}, Reason.USAGE, ("integrated", "rate, average, increment")),
        ({"rate_hz": 125.5}, Reason.USAGE, ("rate_hz", "125.5", "0, 125")),
    ],
)
def test_wrong_settings_name_what_is_allowed(given: dict[str, object], reason: Reason, facts: tuple[str, ...]) -> None:
    with refused(ProtocolError, reason, *facts):
        load_protocol("stim300", given)


@pytest.mark.parametrize(
    ("columns", "key"),
    [
        ("ax,ay", "samples_and_clock.no_acceleration"),
        ("ax,ay,az,foo", "samples_and_clock.column"),
        ("ax,ax,ay,az", "samples_and_clock.column"),
        ("", "samples_and_clock.column"),
    ],
)
def test_a_setting_that_its_key_refuses_is_the_users(columns: str, key: str) -> None:
    with refused(SettingError, Reason.USAGE, "columns", repr(columns)) as caught:
        load_protocol("text", {"columns": columns})
    assert "line" not in caught.value.message
    assert getattr(caught.value.message, "key", None) == key
    # What the instrument or its driver says is not.
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "text.columns") as caught:
        load_protocol("text", read={"columns": columns})
    assert not isinstance(caught.value, SettingError)


@pytest.mark.parametrize(
    ("old", "new", "at", "key", "problem", "says"),
    [
        ('kind = "frames"', 'kind = "frame"', 'kind = "frames"', "kind", "toml.choice", "frames, text"),
        ('name = "stim300"\n', "", "# Sensonor STIM300", "name", "toml.text", "nothing"),
        ('byte_order = "big"', "", "# Sensonor STIM300", "byte_order", "toml.choice", "big, little"),
        (
            "default = 10\n",
            "default = 11\n",
            "default = 10\n",
            "settings.accelerometer_range_g.default",
            "settings.default",
            "2, 5, 10, 30, 80",
        ),
        (
            'type = "i24", count = 3, fraction_bits = 22',
            'type = "i25", count = 3, fraction_bits = 22',
            "fraction_bits = 22",
            "parts.inclinometer.0.type",
            "toml.choice",
            "'i25'",
        ),
        (
            "fraction_bits = 22",
            "fraction_bit = 22",
            "fraction_bits = 22",
            "parts.inclinometer.0.fraction_bit",
            "toml.unknown",
            "'fraction_bits'",
        ),
        (
            '0x92 = ["gyroscope", "inclinometer"',
            '0x92 = ["gyroscope", "inclination"',
            "0x92 =",
            "frames.0x92",
            "frame_schema.part",
            "'inclination'",
        ),
        ("0x92 =", "0x91 =", None, None, "toml_and_json.no_protocol_file", "line "),
        ("0x92 =", "ninety =", "0x92 =", "frames.ninety", "frame_schema.key", "'ninety'"),
        (
            "CRC-32/MPEG-2",
            "CRC-32/MPEG",
            "CRC-32/MPEG-2",
            "frame.checksum.algorithm",
            "checksum.unknown",
            "'CRC-32/MPEG-2'",
        ),
        ('"0D 0A"', '"0D 0"', '"0D 0A"', "frame.trailer.bytes", "toml.hexadecimal", "'0D 0'"),
        ('flag = "start_up"', 'flag = "startup"', 'flag = "start_up"', "samples.flags.0.flag", "toml.choice", "'start_up'"),
        (
            'accelerometer = { fields = ["accelerometer"]',
            'accelerometer = { fields = ["acceleration"]',
            "accelerometer = { fields",
            "samples.accelerometer",
            "references.field",
            "'acceleration'",
        ),
        # A frame is one sample: of several in it the others would be lost.
        (
            '0x92 = ["gyroscope", "inclinometer"',
            '0x92 = ["gyroscope", "gyroscope"',
            "0x92 =",
            "frames.0x92",
            "frame_schema.twice",
            "'gyroscope'",
        ),
        (
            '"accelerometer", type = "i24", count = 3',
            '"accelerometer", type = "i24", count = 6',
            "accelerometer = { fields",
            "samples.accelerometer",
            "references.triad",
            "6",
        ),
        (
            '{ name = "accelerometer", type = "i24"',
            1001 * '{ name = "spare", type = "u8" }, ' + '{ name = "accelerometer", type = "i24"',
            "accelerometer = [",
            "parts.accelerometer",
            "frame_schema.most_fields",
            "1003",
        ),
        ("[nominal]", "[nominals]", "[nominal]", "nominals", "toml.unknown", "'nominal'"),
        ("version = 1", "version = 2", "version = 1", "version", "protocol.version", "2"),
        (
            "10 = 19, ",
            "",
            "10 = 19",
            "parts.accelerometer.0.fraction_bits",
            "toml.not_listed",
            "accelerometer_range_g = 10",
        ),
        ('setting = "rate_hz"', 'setting = "rate"', "rate_hz = { setting", "clock.rate_hz", "toml.setting", "'rate'"),
        ('format = "imufield-protocol"', 'format = "other"', "format", "format", "protocol.format", "imufield-protocol"),
        (
            'keys = ["0xB1", "0xB3"]',
            'keys = ["0xB1", "0x93"]',
            "keys = [",
            "messages.part_number.keys",
            "frame_schema.key_size",
            "0x93",
        ),
    ],
)
def test_errors_name_line_and_key(old: str, new: str, at: str | None, key: str | None, problem: str, says: str) -> None:
    error = wrong(STIM300, old, new)
    assert (error.reason, getattr(error.message, "key", None), error.values.get("key")) == (Reason.BAD_PROTOCOL, problem, key)
    assert says in error.message
    assert key is None or f"`{key}`" in error.message
    if at is not None:
        assert f"mine.toml line {line_of(STIM300, at)}," in error.message


@pytest.mark.parametrize(
    ("name", "old", "new", "key", "problem"),
    [
        ("microstrain_mip", "ticks_per_s = 1e9", "ticks_per_s = 0e9", "clock.time.0.ticks_per_s", "toml.range"),
        ("microstrain_mip", "ticks_per_s = 1e9", "ticks_per_s = 1e-320", "clock.time.0.ticks_per_s", "toml.range"),
        ("stim300", "ticks_per_s = 2000", "ticks_per_s = 0", "clock.counter.ticks_per_s", "toml.range"),
        ("stim300", "ticks_per_s = 2000", "ticks_per_s = 5e-324", "clock.counter.ticks_per_s", "toml.range"),
        ("stim300", "steps = [1, 2, 4, 8, 16]", "steps = [0, -1]", "clock.counter.steps", "toml.integer"),
        ("text", "minimum = 0.001\nmaximum = 100000.0", "minimum = 3\nmaximum = 2", "settings.rate_hz.maximum", "toml.range"),
        ("stim300", "steps = [1, 2, 4, 8, 16]", "steps = []", "clock.counter.steps", "toml.integer"),
        ("stim300", 'rate_hz = { setting = "rate_hz" }', "rate_hz = 1e-300", "clock.rate_hz", "toml.range"),
        ("stim300", 'rate_hz = { setting = "rate_hz" }', "rate_hz = nan", "clock.rate_hz", "toml.range"),
        ("kvh_17xx", "modulus = 128", "modulus = 0", "clock.counter.modulus", "toml.integer"),
        ("novatel_oem7_ascii", "modulus = 604800", "modulus = 0", "clock.time.modulus", "toml.integer"),
        ("stim300", "fraction_bits = 22", f"fraction_bits = {'9' * 18}", "parts.inclinometer.0.fraction_bits", "toml.integer"),
        ("aceinna_serial", "scale = 1260", "scale = 0", "parts.dmu.1.scale", "toml.scale"),
        ("aceinna_serial", "scale = 1260", "scale = -5e-324", "parts.dmu.1.scale", "toml.scale"),
        ("aceinna_serial", "scale = 1260", "scale = 1e400", "parts.dmu.1.scale", "toml.range"),
        ("vectornav_ascii", 'markers = "$"', 'markers = ""', "text.markers", "samples_and_clock.no_marker"),
    ],
)
def test_what_would_break_at_the_first_bytes_is_refused(name: str, old: str, new: str, key: str, problem: str) -> None:
    error = wrong(load_protocol(name).text, old, new)
    assert (getattr(error.message, "key", None), error.values["key"]) == (problem, key)


def test_a_unit_that_is_none() -> None:
    for name, key in (("witmotion", "samples.temperature"), ("stim300", "samples.accelerometer.sensor_temperature")):
        with refused(ProtocolError, Reason.BAD_PROTOCOL, key, "'K'", "degC") as caught:
            parse_protocol(load_protocol(name).text.replace('unit = "degC"', 'unit = "K"'))
        assert caught.value.values["key"] == key


def test_own_files_by_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(STIM300.replace('name = "stim300"', 'name = "mine"'), encoding="utf-8")
    assert load_protocol(path).name == "mine"
    assert load_protocol(str(path)).name == "mine"


def test_grades_are_those_of_the_calibration() -> None:
    assert tuple(grades.GRADES) == GRADES


def test_files_that_are_none(tmp_path: Path) -> None:
    binary, large, folder = tmp_path / "a.toml", tmp_path / "b.toml", tmp_path / "c.toml"
    binary.write_bytes(b"\x93\xff\xfe")
    large.write_bytes(b"#" * (FILE_LIMIT_BYTES + 1))
    folder.mkdir()
    for path, key, *facts in (
        (binary, "toml_and_json.no_text", "a.toml line 1", "UTF-8"),
        (large, "protocol.size", "b.toml", str(FILE_LIMIT_BYTES)),
        (folder, "protocol.cannot_read", str(folder), os.strerror(errno.EISDIR)),
        (tmp_path / "d.toml", "protocol.cannot_read", "d.toml", os.strerror(errno.ENOENT)),
    ):
        with refused(ProtocolError, Reason.BAD_PROTOCOL, *facts, key=key):
            load_protocol(path)
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "stim30", "stim300", key="protocol.unknown_name") as caught:
        load_protocol("stim30")
    assert caught.value.values["name"] == "stim30"


DEEP = {
    "arrays": "a = " + "[" * 100_000,
    "tables": "a = " + "{a = " * 100_000,
    "a name": STIM300.replace('kind = "frames"', f"kind{'.a' * 5000} = 1"),
    "a header": STIM300.replace("[nominal]", f"[settings{'.a' * 5000}]"),
    "33 levels": STIM300.replace('kind = "frames"', "kind = " + "[" * 33 + "]" * 33),
}


@pytest.mark.parametrize("text", DEEP.values(), ids=list(DEEP))
def test_tables_that_nest_too_deeply_are_refused(text: str) -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "mine.toml line", "32 levels", key="toml_and_json.nested") as caught:
        parse_protocol(text, label="mine.toml")
    assert caught.value.values["deepest"] == DEEPEST


def test_a_few_levels_too_many_are_refused_where_they_stand() -> None:
    error = wrong(STIM300, 'kind = "frames"', "kind = " + "[" * 32 + "]" * 32)
    assert (getattr(error.message, "key", None), error.values["key"]) == ("toml.choice", "kind")


@settings(max_examples=150, deadline=None)
@given(
    start=st.integers(0, len(STIM300)),
    length=st.integers(0, 40),
    new=st.one_of(
        st.text(max_size=10), st.sampled_from(['"x"', "-1", "1e400", "{}", "[]", "true", "nan", "[[1]]", "0x93", "\n"])
    ),
)
def test_any_damage_to_a_protocol_is_a_protocol_error_or_harmless(start: int, length: int, new: str) -> None:
    with contextlib.suppress(ProtocolError):
        parse_protocol(STIM300[:start] + new + STIM300[start + length :])
