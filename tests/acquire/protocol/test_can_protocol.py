"""CAN protocols: every vector, what ``--map`` makes of a DBC file, and what is wrong with one that cannot be used."""

from __future__ import annotations

import errno
import json
import math
import os
import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.can_map import parse_map, protocol_from_dbc, protocol_text
from imufield.acquire.protocol.can_frame import Frame, pack_frame
from imufield.acquire.protocol.can_protocol import dbc_table, embed_dbc
from imufield.acquire.protocol.protocol import Protocol, load_protocol, parse_protocol
from imufield.errors import ProtocolError, Reason, SettingError, UsageError
from imufield.samples import Samples, Status, concatenate
from tests.acquire.plain_frames import parse_candump, values_of
from tests.refused import refused

DBC = """VERSION ""
BS_:
BU_: A
BO_ 256 Acc: 8 A
 SG_ Count : 48|8@1+ (1,0) [0|0] "" A
 SG_ AccX : 0|16@1- (0.001,0) [0|0] "g" A
 SG_ AccY : 16|16@1- (0.001,0) [0|0] "g" A
 SG_ AccZ : 32|16@1- (0.001,0) [0|0] "g" A

BO_ 257 Gyro: 8 A
 SG_ Count : 48|8@1+ (1,0) [0|0] "" A
 SG_ GyroX : 7|16@0- (0.01,0) [0|0] "deg/s" A
 SG_ GyroY : 23|16@0- (0.01,0) [0|0] "deg/s" A
 SG_ GyroZ : 39|16@0- (0.01,0) [0|0] "deg/s" A

BO_ 258 Housekeeping: 4 A
 SG_ Temp : 0|8@1- (1,0) [0|0] "K" A
 SG_ Speed : 8|16@1+ (1,0) [0|0] "km/h" A
 SG_ Nameless : 8|16@1+ (1,0) [0|0] "" A

BO_ 259 Floats: 4 A
 SG_ Share : 0|32@1- (1,0) [0|0] "" A

BO_ 260 Wide: 8 A
 SG_ Bits : 0|64@1+ (1,0) [0|0] "" A

BO_ 256 Twin: 4 A
 SG_ TwinTemp : 0|8@1- (1,0) [0|0] "K" A

SIG_VALTYPE_ 259 Share : 1;
"""
MAP = {
    "accelerometer.x": "AccX",
    "accelerometer.y": "-AccY",
    "accelerometer.z": "Acc.AccZ",
    "gyroscope.x": "GyroX",
    "gyroscope.y": "GyroY",
    "gyroscope.z": "GyroZ",
}
DBC_OF = {"0x0": "xsens_can", "0x1": "sbg_can", "0x6": "racelogic_can"}


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "my imu.dbc"
    path.write_text(DBC, encoding="cp1252")
    return path


def decode(protocol: Protocol, frames: list[Frame]) -> Samples:
    decoder = Decoder(protocol)
    data = b"".join(pack_frame(frame.can_id, frame.data, frame.time_s) for frame in frames)
    return concatenate([decoder.feed(data, 0.0), decoder.flush()])


def vectors(shared_folder: Path, name: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((shared_folder / "wire" / f"{name}.vectors.json").read_text())
    return found


def signals_of(protocol: str, message: str, frame: Frame) -> dict[str, float]:
    """Return the values of every signal of a message, by our arrays."""
    rule = load_protocol(protocol).can
    assert rule is not None
    row = np.frombuffer(frame.data.ljust(8, b"\0"), dtype=np.uint8).reshape(1, 8)
    return {signal.name: float(values_of(signal, row)[0]) for owner, signal in rule.dbc.signals() if owner.name == message}


def test_every_j1939_vector(shared_folder: Path) -> None:
    compared = 0
    for vector in vectors(shared_folder, "aceinna_mtlt_can"):
        frame, wanted = parse_candump(vector["hex"]), vector["decoded"]
        assert frame.can_id == int(wanted["can_id"], 16) | 0x80000000
        group = {61481: "SlopeSensor2", 61482: "AngularRate", 61485: "AccelerationSensor"}.get(wanted["pgn"])
        if group is None:
            assert frame.data.hex() == wanted["data"]
            continue
        found = signals_of("j1939_imu", group, frame)
        names = {
            "pitch_deg": "PitchAngle",
            "roll_deg": "RollAngle",
            "acc_w1_ms2": "LateralAcceleration",
            "acc_w2_ms2": "LongitudinalAcceleration",
            "acc_w3_ms2": "VerticalAcceleration",
            "rate_w1_dps": "PitchRate",
            "rate_w2_dps": "RollRate",
            "rate_w3_dps": "YawRate",
        }
        for key, name in names.items():
            if key in wanted:
                assert found[name] == pytest.approx(wanted[key], abs=1e-9), vector["hex"]
                compared += 1
        if "latency_ms" in wanted:
            assert found.get("SlopeLatency", found.get("RateLatency")) == wanted["latency_ms"]
    assert compared == 3 * (7 + 6) + 2 * 8  # messages of acceleration, rate, slope


def test_the_real_trace_as_samples(shared_folder: Path) -> None:
    frames = [
        Frame(frame.can_id, frame.data, vector["decoded"]["t_ms"] / 1e3)
        for vector in vectors(shared_folder, "aceinna_mtlt_can")
        if "t_ms" in vector["decoded"] and (frame := parse_candump(vector["hex"]))
    ]
    samples = decode(load_protocol("j1939_imu"), frames)
    assert len(samples) == 5
    np.testing.assert_allclose(samples.accelerometer[0], [-9.75, 0.85, 0.1], atol=1e-12)
    np.testing.assert_allclose(np.degrees(samples.gyroscope[3]), [9.5859375, -0.203125, -7.0546875], atol=1e-12)
    assert (np.abs(np.linalg.norm(samples.accelerometer, axis=1) - 9.8) < 0.05).all()
    np.testing.assert_allclose(np.diff(samples.time_s), 0.010, atol=2e-4)
    # The trace ends before the last rate message.
    assert samples.status[-1] & Status.GYROSCOPE_INVALID
    assert np.isnan(samples.gyroscope[-1]).all()


@pytest.mark.parametrize(
    ("axes", "accelerometer", "gyroscope"),
    [("xyz", (2, 3, 4), (5, 6, 7)), ("sae", (3, 2, 4), (6, 5, 7)), ("openimu300ri", (3, -2, -4), (6, 5, 7))],
)
def test_order_of_axes(axes: str, accelerometer: tuple[int, ...], gyroscope: tuple[int, ...]) -> None:
    # The examples of the maker's DBC: 2, 3, 4 m/s^2 and 5, 6, 7 deg/s.
    frames = [parse_candump("08f02d80#c87d2c7e907e0000"), parse_candump("0cf02a80#807f008080800000")]
    samples = decode(load_protocol("j1939_imu", {"axes": axes}), frames)
    np.testing.assert_allclose(samples.accelerometer, [accelerometer], atol=1e-12)
    np.testing.assert_allclose(np.degrees(samples.gyroscope), [gyroscope], atol=1e-12)


def test_every_vector_of_other_instruments(shared_folder: Path) -> None:
    keys = {
        "acc_ms2": [f"Acceleration{axis}" for axis in "XYZ"],
        "euler_deg": ["Roll", "Pitch", "Yaw"],
        "quaternion": ["Q0", "Q1", "Q2", "Q3"],
        "sample_time_us": ["SampleTime"],
        "group_counter": ["GroupCounter"],
        "time_us": ["TimeStamp"],
        "status": ["ImuStatus"],
        "temp_c": ["Temperature"],
        "yaw_rate_dps": ["YawRate"],
        "roll_rate_dps": ["RollRate"],
        "ay_g": ["AccelerationY"],
        "ax_g": ["AccelerationX"],
        "acc_x_g": ["AccelerationX"],
        "acc_z_g": ["AccelerationZ"],
    }
    compared = 0
    for vector in vectors(shared_folder, "can_imus"):
        frame, wanted = parse_candump(vector["hex"]), dict(vector["decoded"])
        identifier = wanted.pop("can_id")
        protocol = "bosch_mm510" if "ABS" in identifier else DBC_OF[f"0x{identifier[2]}"]
        rule = load_protocol(protocol).can
        assert rule is not None
        (message,) = {owner.name for owner, _ in rule.dbc.signals() if owner.can_id == frame.can_id}
        found = signals_of(protocol, message, frame)
        for key, value in wanted.items():
            rate = "Rate" if protocol == "sbg_can" else "Gyroscope"
            names = [f"{rate}{axis}" for axis in "XYZ"] if key == "gyro_rads" else keys[key]
            values = value if isinstance(value, list) else [value]
            assert [found[name] for name in names] == pytest.approx(values, abs=1e-8), vector["hex"]
            compared += 1
    assert compared == 24


def test_a_dbc_file_with_a_map(dbc: Path) -> None:
    protocol = protocol_from_dbc(dbc, MAP)
    assert protocol.name == "my_imu"
    assert (protocol.units.accelerometer, protocol.units.gyroscope) == ("m/s^2", "rad/s")
    frames = [
        Frame(0x100, np.array([1000, -500, 250], dtype="<i2").tobytes() + bytes(2), 0.0),
        Frame(0x101, np.array([100, -200, 18000], dtype=">i2").tobytes() + bytes(2), 0.001),
    ]
    samples = decode(protocol, frames)
    np.testing.assert_allclose(samples.accelerometer, [[9.80665, 0.5 * 9.80665, 0.25 * 9.80665]])
    np.testing.assert_allclose(samples.gyroscope, [[math.pi / 180, -math.pi / 90, math.pi]])
    assert samples.status.tolist() == [Status.TIME_ESTIMATED]


def test_the_text_of_a_protocol_is_all_that_decodes_it(dbc: Path) -> None:
    protocol = protocol_from_dbc(dbc, {**MAP, "temperature": "Temp", "counter": "Gyro.Count"}, {"rate_hz": 100})
    again = parse_protocol(protocol.text, {name: one.value for name, one in protocol.settings.items()})
    assert again.sha256 == protocol.sha256
    assert again.can is not None
    assert protocol.can is not None
    assert again.can.kinds == protocol.can.kinds
    assert again.clock == protocol.clock
    assert again.clock.rate_hz == 100


def with_lines(dbc: Path, after: str, *lines: str, counter: str = "AccX") -> Protocol:
    """Return the protocol of a map with more lines in its file, behind the header of a table."""
    text = protocol_text("mine", dbc.name, {**MAP, "counter": counter})
    assert after in text
    return parse_protocol(text.replace(after, "\n".join((after, *lines)), 1) + dbc_table(DBC))


@pytest.mark.parametrize(
    ("flag", "key", "problem"),
    [
        ('values = ["on"]', "map.flags.0.values", "toml.integer"),
        ("values = [inf]", "map.flags.0.values", "toml.integer"),
        ("values = [1.5]", "map.flags.0.values", "toml.integer"),
        ("values = [1, 256]", "map.flags.0.values", "references.outside"),
        ("values = [-1]", "map.flags.0.values", "references.outside"),
        ("mask = 256", "map.flags.0.mask", "references.beyond"),
    ],
)
def test_what_is_wrong_with_a_flag(dbc: Path, flag: str, key: str, problem: str) -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, key, key=problem):
        with_lines(dbc, "[map]", f'flags = [{{ signal = "Acc.Count", {flag}, flag = "start_up" }}]')
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "map.flags.0.signal", key="references.no_whole"):
        with_lines(dbc, "[map]", 'flags = [{ signal = "Share", mask = 1, flag = "start_up" }]')
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "map.instrument_status.0.signal", key="references.no_whole"):
        with_lines(dbc, "[map]", 'instrument_status = [{ signal = "Share" }]')
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "clock.counter_steps", "255", key="toml.integer"):
        with_lines(dbc, "[assembly]", "[clock]", "counter_steps = [256]", counter="Acc.Count")


def test_the_highest_bit_of_a_signal_may_be_a_flag(dbc: Path) -> None:
    protocol = with_lines(dbc, "[map]", f'flags = [{{ signal = "Bits", mask = {1 << 63}, flag = "start_up" }}]')
    frames = [
        Frame(can_id, data, number * 0.01 + (can_id & 7) * 1e-4)
        for number in range(60)
        for can_id, data in ((0x100, bytes(8)), (0x101, bytes(8)), (0x104, (number % 2 << 63).to_bytes(8, "little")))
    ]
    status = decode(protocol, frames).status & np.uint32(Status.START_UP)
    assert (status > 0).tolist() == [number % 2 == 1 for number in range(60)]


def test_a_signal_with_a_sign_counts(dbc: Path) -> None:
    protocol = protocol_from_dbc(dbc, {**MAP, "counter": "Temp"}, {"rate_hz": 100})
    frames = [
        Frame(can_id, data, number * 0.01 + (can_id & 7) * 1e-4)
        for number in range(400)
        if number not in (130, 250)
        for can_id, data in ((0x100, bytes(8)), (0x101, bytes(8)), (0x102, bytes([number % 256, 0, 0, 0])))
    ]
    samples = decode(protocol, frames)
    assert samples.counter.tolist() == [number % 256 for number in range(400) if number not in (130, 250)]
    assert np.flatnonzero(samples.status & Status.AFTER_GAP).tolist() == [130, 249]


@pytest.mark.parametrize(("stated", "told"), [("[-50|49]", ""), ("[-50|49]", "100"), ("[0|0]", "100")])
def test_a_counter_with_a_sign_begins_anew_where_it_is_stated(tmp_path: Path, stated: str, told: str) -> None:
    path = tmp_path / "mine.dbc"
    path.write_text(DBC.replace("48|8@1+ (1,0) [0|0]", f"48|8@1- (1,0) {stated}"), encoding="cp1252")
    text = protocol_from_dbc(path, {**MAP, "counter": "Gyro.Count"}, {"rate_hz": 100}).text
    line = f"[clock]\ncounter_modulus = {told}\n" if told else ""
    protocol = parse_protocol(text.replace("[clock.rate_hz]", f"{line}[clock.rate_hz]"))
    frames = [
        Frame(can_id, bytes(6) + bytes([(number % 100 - 50) % 256, 0]), number * 0.01 + (can_id & 7) * 1e-4)
        for number in range(400)
        if number not in (20, 110, 250)
        for can_id in (0x100, 0x101, 0x102)
    ]
    samples = decode(protocol, frames)
    assert samples.counter.min() >= 0
    assert np.flatnonzero(samples.status & Status.AFTER_GAP).tolist() == [20, 109, 248]


def test_a_written_protocol_beside_its_dbc(dbc: Path) -> None:
    path = dbc.with_name("mine.toml")
    path.write_text(protocol_text("mine", dbc.name, MAP), encoding="utf-8")
    assert load_protocol(path).name == "mine"
    dbc.unlink()
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "my imu.dbc", os.strerror(errno.ENOENT)):
        load_protocol(path)


def test_code_page_of_windows_and_quotes(tmp_path: Path) -> None:
    path = tmp_path / "degree.dbc"
    path.write_bytes((DBC.replace('"deg/s"', '"°/s"') + "CM_ \"it's '''so'''\";\r\n").encode("cp1252"))
    assert protocol_from_dbc(path, MAP).units.gyroscope == "rad/s"


@pytest.mark.parametrize(
    ("change", "key", "wanted"),
    [
        ({"accelerometer.x": "AccQ"}, "can_dbc.unknown", ("signal 'AccQ'", "'AccZ'")),
        ({"gyroscope.x": "Gyr.GyroX"}, "can_dbc.unknown", ("message 'Gyr'", "'Gyro'")),
        ({"gyroscope.x": "Speed"}, "can_protocol.unit", ("Speed", "'km/h'", "gyroscope")),
        ({"gyroscope.z": "GyroX"}, "can_protocol.twice", ("GyroX",)),
        ({"gyroscope.z": "-Gyro.GyroX"}, "can_protocol.twice", ("GyroX",)),
        ({"gyroscope.x": "Nameless"}, "can_protocol.unit", ("Nameless", "no unit")),
        ({"gyroscope.x": "AccX"}, "can_protocol.unit", ("AccX", "'g'", "gyroscope")),
        ({"temperature": "Speed"}, "can_protocol.temperature_unit", ("Speed", "'km/h'", "degC")),
        ({"temperature": "Temp", "temperature.unit": "degR"}, "can_protocol.temperature_unit", ("Temp", "'degR'")),
        ({"counter": "Count"}, "can_dbc.several", ("Acc.Count, Gyro.Count",)),
        ({"counter": "Share"}, "references.no_whole", ("'Share'", "f32", "counter")),
        ({"temperature": "TwinTemp", "starts_with": "Acc"}, "can_protocol.same_identifier", ("Acc, Twin", "temperature")),
        ({"starts_with": "Housekeeping"}, "can_protocol.not_mapped", ("'Housekeeping'", "Acc, Gyro")),
        ({"starts_with": "Akk"}, "can_dbc.unknown", ("message 'Akk'", "Acc, Gyro")),
        ({"counters": "Acc.Count"}, "can_protocol.counters", ("counters",)),
        ({"accelerometer.unit": "furlong"}, "can_protocol.unit", ("'furlong'",)),
    ],
)
def test_what_is_wrong_with_a_map(dbc: Path, change: dict[str, str], key: str, wanted: tuple[str, ...]) -> None:
    with refused(SettingError, None, *wanted, key=key) as caught:
        protocol_from_dbc(dbc, {**MAP, **change})
    assert caught.value.reason is (Reason.UNITS if key.endswith("unit") else Reason.USAGE)
    option = re.match(r"--map ([a-z_.]+): ", caught.value.message)
    assert option is not None
    assert option[1] in change or next(iter(change)).startswith(f"{option[1]}.")
    # In a protocol file the same is named by its line and key.
    path = dbc.with_name("mine.toml")
    path.write_text(protocol_text("mine", dbc.name, {**MAP, **change}), encoding="utf-8")
    with refused(ProtocolError, None, *wanted, key=key) as caught:
        load_protocol(path)
    assert caught.value.reason is (Reason.UNITS if key.endswith("unit") else Reason.BAD_PROTOCOL)
    place = re.search(r"line (\d+), key `[a-z]+\.([a-z_.0-9]+)`", caught.value.message)
    assert place is not None
    assert path.read_text(encoding="utf-8").splitlines()[int(place[1]) - 1].startswith(place[2])


@pytest.mark.parametrize(
    ("bits", "stated", "modulus"),
    [
        ("4", "(1,0) [0|14]", 15),
        ("4", "(1,0) [0|15]", 16),
        ("8", "(1,0) [0|14.9]", 256),
        ("8", "(0.1,0) [0|1.4]", 15),
        ("4", "(0.5,0) [0|7]", 15),
        ("8", "(1,0) [0|99]", 100),
        ("8", "(1,-10) [-10|89]", 100),
        ("8", "(1,0) [0|0]", 256),
        ("8", "(1,0) [1|99]", 256),
        ("8", "(1,0) [0|1000]", 256),
        ("8", "(1,0) [0|1e400]", 256),
        ("8", "(-1,0) [0|99]", 256),
    ],
)
@pytest.mark.parametrize("key", ["counter", "time"])
def test_a_counter_or_a_time_stamp_begins_anew_behind_the_range_of_the_file(
    tmp_path: Path, bits: str, stated: str, modulus: int, key: str
) -> None:
    path = tmp_path / "mine.dbc"
    path.write_text(DBC.replace('48|8@1+ (1,0) [0|0] ""', f'48|{bits}@1+ {stated} "s"'), encoding="cp1252")
    protocol = protocol_from_dbc(path, {**MAP, key: "Gyro.Count"})
    assert getattr(protocol.clock, f"{key}_modulus") == modulus
    if key == "time":
        return
    told = protocol.text.replace("[clock.rate_hz]", "[clock]\ncounter_modulus = 12\n[clock.rate_hz]")
    assert parse_protocol(told).clock.counter_modulus == 12


def test_a_counter_that_cannot_have_the_stated_number_or_is_not_there_is_refused(dbc: Path) -> None:
    text = protocol_from_dbc(dbc, {**MAP, "counter": "Gyro.Count"}).text
    told = text.replace("[clock.rate_hz]", "[clock]\ncounter_modulus = {}\n[clock.rate_hz]")
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "1000", "clock.counter_modulus", key="references.beyond"):
        parse_protocol(told.replace("{}", "1000"))
    assert parse_protocol(told.replace("{}", "256")).clock.counter_modulus == 256
    without = told.replace("{}", "15").replace('counter = "Gyro.Count"\n', "")
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "clock.counter_modulus", key="can_protocol.no_counter"):
        parse_protocol(without)


@pytest.mark.parametrize(("values", "is_there"), [("[-128, 127]", True), ("[128]", False), ("[-129, 0]", False)])
def test_values_of_a_signal_with_a_sign_are_those_it_can_have(values: str, is_there: bool) -> None:
    flag = f'[map]\nflags = [{{ signal = "Gyro.Count", values = {values}, flag = "start_up" }}]'
    text = protocol_text("mine", "mine.dbc", MAP).replace("[map]", flag, 1)
    signed = dbc_table(DBC.replace("48|8@1+ (1,0) [0|0]", "48|8@1- (1,0) [0|0]"))
    with nullcontext() if is_there else refused(ProtocolError, Reason.BAD_PROTOCOL, key="references.outside"):
        parse_protocol(text + signed)


@pytest.mark.parametrize(("signal", "unit"), [("Nameless", "no unit"), ("Speed", "'km/h'")])
def test_a_time_stamp_without_a_unit_is_refused_but_in_earlier_sessions(dbc: Path, signal: str, unit: str) -> None:
    with refused(ProtocolError, Reason.UNITS, signal, unit, "time.ticks_per_s", key="can_map.time_unit"):
        protocol_from_dbc(dbc, {**MAP, "time": signal})
    kept = protocol_text("mine", dbc.name, {**MAP, "time": signal}) + dbc_table(DBC)
    assert parse_protocol(kept).clock.time_ticks_per_s == 1.0


@pytest.mark.parametrize(
    ("unit", "mapping", "ticks_per_s"),
    [("msec", {}, 1e3), ("usec", {}, 1e6), ("s", {}, 1.0), ("10us", {"time.ticks_per_s": "1e5"}, 1e5)],
)
def test_a_time_stamp_counts_in_the_unit_of_the_file(
    tmp_path: Path, unit: str, mapping: dict[str, str], ticks_per_s: float
) -> None:
    path = tmp_path / "mine.dbc"
    path.write_text(DBC.replace('(1,0) [0|0] "km/h"', f'(1,0) [0|0] "{unit}"'), encoding="cp1252")
    protocol = protocol_from_dbc(path, {**MAP, "time": "Housekeeping.Speed", **mapping})
    assert protocol.clock.time_ticks_per_s == pytest.approx(ticks_per_s)


def test_a_wrong_unit_can_be_overruled(dbc: Path) -> None:
    plain = {**MAP, "gyroscope.x": "Nameless", "gyroscope.y": "Share", "gyroscope.z": "Bits", "gyroscope.unit": "rad/s"}
    assert protocol_from_dbc(dbc, plain).units.gyroscope == "rad/s"


def test_nothing_mapped_names_candidates(dbc: Path) -> None:
    with refused(SettingError, Reason.USAGE, "Acc.AccX, Acc.AccY, Acc.AccZ, Gyro.GyroX", key="can_protocol.nothing_mapped"):
        protocol_from_dbc(dbc, {})


def test_a_missing_axis_is_named(dbc: Path) -> None:
    with refused(UsageError, Reason.USAGE, "accelerometer.y", "accelerometer.z") as caught:
        protocol_from_dbc(dbc, {"accelerometer.x": "AccX"})
    assert caught.value.values["missing"] == ["accelerometer.y", "accelerometer.z"]


def test_parse_map() -> None:
    assert parse_map(["accelerometer.x=-A.B", " counter = C "]) == {"accelerometer.x": "-A.B", "counter": "C"}
    for texts, wanted in (
        (["acelerometer.x=A"], "'accelerometer.x'"),
        (["counter="], "counter"),
        (["counter=A", "counter=B"], "counter"),
    ):
        with pytest.raises(UsageError) as caught:
            parse_map(texts)
        assert wanted in str(caught.value)


def test_blank_lines_take_no_longer_than_their_number() -> None:
    text = "\n" * 1_000_000

    def read(name: str) -> str:
        return name

    assert embed_dbc(text, read) == text
    assert "text" in embed_dbc(f'{text} dbc = "a.dbc"', read)


def test_missing_file() -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "nowhere.dbc"):
        protocol_from_dbc("nowhere.dbc", MAP)
