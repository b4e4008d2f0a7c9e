"""Samples through the encoder of every form and back through the decoder: values to the quantisation, time, counters, flags."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import Protocol, load_protocol, parse_protocol
from imufield.errors import ImufieldError, Reason, UsageError
from imufield.samples import Samples, Status, concatenate
from imufield.simulate.emulator.emulate import OWN_RATE_HZ, Emulation, choose_wire, make_device
from imufield.simulate.instruments.device import Device
from imufield.simulate.instruments.protocol_device import InProtocolUnits, ProtocolDevice
from imufield.simulate.truth.virtual_imu import SampleSource
from imufield.simulate.wire.forms import choose_form, wire_forms
from tests.acquire.own_protocols import FRAMES, LINES, changed
from tests.refused import refused
from tests.simulate.accounting import Wire, random_samples, serial_wires

G = 9.80665
DEG = math.pi / 180
WIRES = [wire for wire in serial_wires() if wire.driver not in OWN_RATE_HZ]
SINGLE = (1e-6, 2e-7)
"""Half a step of 32-bit floats at 16 m/s^2 and 4 rad/s, from above."""
HALF_STEPS = {
    "aceinna_serial-z1": SINGLE,
    "aceinna_serial-s1": SINGLE,
    "aceinna_serial-S1": (10 * G / 65536, 630 * DEG / 65536),
    "aceinna_serial-S0": (10 * G / 65536, 630 * DEG / 65536),
    "kvh_17xx": SINGLE,
    "microstrain_mip": SINGLE,
    "novatel_oem7-RAWIMU": (2**-30, 2**-34),
    "novatel_oem7-IMURATECORRIMUS": (0.0, 0.0),
    "novatel_oem7_ascii": (2**-30, 2**-34),
    "sbg_sbgecom-IMU_SHORT": (2**-21, 2**-27),
    "sbg_sbgecom-IMU_DATA": SINGLE,
    "motioncal": (G / 16384, DEG / 32),
    "text": (5e-10, 5e-10),
    "vectornav_ascii": (0.0005, 0.0000005),
    "vectornav_binary": SINGLE,
    "witmotion": (8 * G / 32768, 1000 * DEG / 32768),
    "xsens_mtdata2-float32": SINGLE,
    "xsens_mtdata2-fp12.20": (2**-21, 2**-21),
    "xsens_mtdata2-fp16.32": (2**-33, 2**-33),
    "xsens_mtdata2-float64": (0.0, 0.0),
    "xsens_mtdata2-increments": SINGLE,
}
"""By the beginning of a wire's name: half a step of acceleration, m/s^2, and of rate, rad/s, by the manuals."""
TEMPERATURE_HALF_STEPS = {
    "aceinna_serial-s1": 2e-6,
    "aceinna_serial-S1": 100 / 65536,
    "aceinna_serial-S0": 100 / 65536,
    "kvh_17xx-A": 0.5,
    "kvh_17xx-B": 0.5,
    "sbg_sbgecom-IMU_SHORT": 2**-9,
    "sbg_sbgecom-IMU_DATA": 2e-6,
    "vectornav_ascii-VNIMU": 0.05,
    "vectornav_binary-uncompensated": 2e-6,
    "witmotion-uart": 0.005,
    "xsens_mtdata2-float32": 2e-6,
    "xsens_mtdata2-fp12.20": 2**-21,
    "xsens_mtdata2-fp16.32": 2**-33,
    "xsens_mtdata2-float64": 0.0,
}
STAMPS_WRAP_AT_S = {
    "xsens_mtdata2": 2**32 / 1e4,
    "novatel_oem7": 604800,
    "microstrain_mip-gps_time": 604800,
    "microstrain_mip-increments": 604800,
    "aceinna_serial-z1": 2**32 / 1e6,
    "kvh_17xx-B": 2**32 / 1e6,
    "sbg_sbgecom": 2**32 / 1e6,
}
WITHOUT_TIME = ("motioncal", "vectornav_ascii", "witmotion", "aceinna_serial-S0")


def decode(protocol: Protocol, device: Device, samples: Samples) -> tuple[Samples, Decoder]:
    decoder = Decoder(protocol)
    got = decoder.feed(device.encode(samples).data.tobytes())
    return concatenate([got, decoder.flush()]), decoder


def of(table: dict[str, tuple[float, float]], wire: Wire) -> tuple[float, float]:
    return table[max((name for name in table if str(wire).startswith(name)), key=len)]


@pytest.mark.parametrize("wire", WIRES, ids=str)
def test_round_trip(wire: Wire) -> None:
    choice = wire.choose()
    rate_hz, units = choice.rate_hz, choice.protocol.units
    wrap_s = next((wrap_s for name, wrap_s in STAMPS_WRAP_AT_S.items() if str(wire).startswith(name)), 3.0)
    sent = random_samples(choice.protocol, rate_hz, round((wrap_s - 2.0) * rate_hz), 600)
    got, decoder = decode(choice.protocol, wire.device(), sent)
    assert len(got) == 600
    assert decoder.statistics.bytes_skipped == decoder.statistics.frames_bad_checksum == 0
    accelerometer, gyroscope = of(HALF_STEPS, wire)
    slack = 1 + 1e-9
    if units.accelerometer_is_increment and accelerometer == SINGLE[0]:
        accelerometer, gyroscope = SINGLE[0] / rate_hz, SINGLE[1] / rate_hz if units.gyroscope_is_increment else gyroscope
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, rtol=1e-13, atol=accelerometer * slack)
    np.testing.assert_allclose(got.gyroscope, sent.gyroscope, rtol=1e-13, atol=gyroscope * slack)
    if str(wire) in TEMPERATURE_HALF_STEPS:
        allowed = TEMPERATURE_HALF_STEPS[str(wire)] * slack
        np.testing.assert_allclose(got.temperature_degc, sent.temperature_degc, rtol=1e-13, atol=allowed)
    else:
        assert np.isnan(got.temperature_degc).all()
    time_s = np.arange(600) / rate_hz
    # Half a tick of the coarsest stamp, 100 us, and of the counter that counts time, 3 us.
    np.testing.assert_allclose(got.time_s - got.time_s[0], time_s, atol=6e-5)
    assert decoder.statistics.samples_lost == decoder.statistics.losses_estimated == 0
    flags = np.uint32(Status.TIME_ESTIMATED if str(wire).startswith(WITHOUT_TIME) else 0)
    assert ((got.status & 0xFFFF) == flags).all()


@pytest.mark.parametrize("name", ["kvh_17xx-A", "xsens_mtdata2-float32", "aceinna_serial-S1"])
def test_counters_count(name: str) -> None:
    wire = next(one for one in WIRES if str(one) == name)
    choice = wire.choose()
    got, _ = decode(choice.protocol, wire.device(), random_samples(choice.protocol, choice.rate_hz, 120, 300))
    modulus, step = {"kvh_17xx-A": (128, 1), "xsens_mtdata2-float32": (65536, 1)}.get(name, (65536, 3276.8))
    expected = np.rint(np.arange(120, 420) * step) % modulus
    assert got.counter.tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("name", "flag"),
    [
        ("xsens_mtdata2-float32", Status.ACCELEROMETER_SATURATED),
        ("xsens_mtdata2-float32", Status.GYROSCOPE_SATURATED),
        ("microstrain_mip-reference_time", Status.GYROSCOPE_SATURATED),
        ("kvh_17xx-A", Status.ACCELEROMETER_INVALID),
        ("kvh_17xx-C", Status.GYROSCOPE_INVALID),
        ("sbg_sbgecom-IMU_SHORT", Status.ACCELEROMETER_SATURATED),
        ("novatel_oem7-RAWIMUX", Status.INSTRUMENT_FAULT),
    ],
)
def test_flags_reach_the_reader(name: str, flag: Status) -> None:
    wire = next(one for one in WIRES if str(one) == name)
    choice = wire.choose()
    sent = random_samples(choice.protocol, choice.rate_hz, 0, 50)
    status = np.zeros(50, dtype=np.uint32)
    status[20:30] = np.uint32(flag)
    got, _ = decode(choice.protocol, wire.device(), replace(sent, status=status))
    assert ((got.status & np.uint32(flag)) != 0).tolist() == (status != 0).tolist()


def test_values_stop_at_the_end_of_their_range() -> None:
    wire = Wire("witmotion", "uart")
    choice = wire.choose()
    sent = random_samples(choice.protocol, choice.rate_hz, 0, 10)
    sent.accelerometer[:] = 1e6, -1e6, 0
    got, _ = decode(choice.protocol, wire.device(), sent)
    np.testing.assert_allclose(got.accelerometer[0] / G, [16 * 32767 / 32768, -16, 0])


@pytest.mark.parametrize(("name", "lost"), [("kvh_17xx-A", 9), ("microstrain_mip-reference_time", 9)])
def test_a_jump_is_a_gap(name: str, lost: int) -> None:
    wire = next(one for one in WIRES if str(one) == name)
    choice, device, decoder = wire.choose(), wire.device(), Decoder(wire.choose().protocol)
    decoder.feed(device.encode(random_samples(choice.protocol, choice.rate_hz, 0, 100)).data.tobytes())
    device.jump_counter(lost)
    decoder.feed(device.encode(random_samples(choice.protocol, choice.rate_hz, 100, 100)).data.tobytes())
    decoder.flush()
    assert decoder.statistics.samples_lost == lost


def test_frames_end_where_they_end() -> None:
    wire = Wire("witmotion", "uart")
    frames = wire.device().encode(random_samples(wire.choose().protocol, 100, 0, 4))
    assert frames.ends.tolist() == list(range(11, 133, 11))
    for begin, end, at in zip([0, *frames.ends], frames.ends, frames.checksum_at, strict=False):
        assert frames.data[at] == int(frames.data[begin : end - 1].sum()) & 0xFF


def test_form_is_found_by_name_or_by_settings() -> None:
    protocol = load_protocol("witmotion")
    assert choose_form(protocol, None, {}).name == "uart"
    assert choose_form(protocol, None, {"form": "card"}).name == "card"
    assert choose_form(protocol, "bluetooth", {}).settings == {"form": "bluetooth"}
    with refused(UsageError, Reason.USAGE, "uart, bluetooth, card", key="forms.no_form") as caught:
        choose_form(protocol, "usart", {})
    assert caught.value.values["form"] == "usart"


def test_a_protocol_without_the_table_sends_its_first_samples() -> None:
    text = load_protocol("kvh_17xx").text.partition("# What `imufield emulate`")[0]
    (form,) = wire_forms(parse_protocol(text))
    assert (form.name, form.rate_hz, form.frames[0].key) == ("default", 1000.0, 0x55)


def test_a_users_own_file_is_emulated(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "protocols.md").read_text(encoding="utf-8")
    path = tmp_path / "my_imu.toml"
    blocks = re.findall(r"^```toml\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    path.write_text(next(block for block in blocks if 'name = "my_imu"' in block), encoding="utf-8")
    options = Emulation(device=str(path))
    choice = choose_wire(options)
    sent = random_samples(choice.protocol, choice.rate_hz, 0, 300)
    got, _ = decode(choice.protocol, make_device(options, choice), sent)
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=0.51 * G / 2**18)
    assert got.counter.tolist() == list(range(300))


@pytest.mark.parametrize("stamp", ["counter", "time"])
def test_what_a_file_says_of_a_field_holds_both_ways(stamp: str) -> None:
    """A counter with a sign, axes in different units, a scale of the temperature."""
    protocol = parse_protocol(
        changed(
            FRAMES,
            ('"counter", type = "u8"', '"counter", type = "i8"'),
            ("counter = {", f"{stamp} = {{"),
            ('"ay", type = "f32", unit = "m/s^2"', '"ay", type = "f32", unit = "mg"'),
            ('{ fields = ["temperature"] }', '{ fields = ["temperature"], scale = 0.01 }'),
        )
    )
    (form,) = wire_forms(protocol)
    sent = random_samples(protocol, form.rate_hz, 0, 400)
    got, decoder = decode(protocol, ProtocolDevice(protocol, form, form.rate_hz), sent)
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=2e-6)
    np.testing.assert_allclose(got.temperature_degc, sent.temperature_degc, atol=0.0051)
    np.testing.assert_allclose(got.time_s - got.time_s[0], np.arange(400) / 100)
    assert decoder.statistics.lost == 0


def test_lines_stand_in_the_order_that_fields_tell() -> None:
    order, scale = ('["ax", "ay", "az"]', '["ay", "az", "ax"]'), ('unit = "degC"', 'unit = "degC", scale = 0.1')
    protocol = parse_protocol(changed(LINES, order, scale))
    (form,) = wire_forms(protocol)
    sent = random_samples(protocol, 100.0, 0, 50)
    got, _ = decode(protocol, ProtocolDevice(protocol, form, 100.0), sent)
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=1e-7)
    np.testing.assert_allclose(got.temperature_degc, sent.temperature_degc, atol=0.00051)


@pytest.mark.parametrize(
    ("before", "after", "reason", "fact", "key"),
    [
        ('key = "0x55"', 'key = "0x99"', Reason.USAGE, "0x99", "frames.no_key"),
        ('key = "0x55"', 'start = "AA"', Reason.USAGE, "aa", "frames.no_start"),
        ('key = "0x55"', 'kee = "0x55"', Reason.BAD_PROTOCOL, "emulate.0.frames.0.kee", None),
    ],
)
def test_a_wrong_table_is_an_error(before: str, after: str, reason: Reason, fact: str, key: str | None) -> None:
    protocol = parse_protocol(load_protocol("kvh_17xx").text.replace(before, after))
    with refused(ImufieldError, reason, "kvh_17xx", fact, key=key):
        ProtocolDevice(protocol, wire_forms(protocol)[0], 1000.0)


class _AtRest:
    interval_s = 0.01

    def set_rate(self, rate_hz: float) -> None:
        self.interval_s = 1 / rate_hz

    def next_block(self, count: int) -> Samples:
        protocol = load_protocol("kvh_17xx", {"gyroscope_output": "rad/s"})
        samples = random_samples(protocol, 100.0, 0, count)
        samples.accelerometer[:] = 0, 0, G
        samples.gyroscope[:] = 0.1
        return samples


def test_samples_take_the_units_of_the_protocol() -> None:
    source: SampleSource = _AtRest()
    increments = load_protocol("novatel_oem7", {"imu": "hg4930", "rate_hz": 100})
    block = InProtocolUnits(source, (1.0, 1.0), increments, 100.0).next_block(3)
    np.testing.assert_allclose(block.accelerometer[0], [0, 0, G / 100])
    np.testing.assert_allclose(block.gyroscope[0], 0.001)


def test_a_count_of_unknown_size_is_that_of_a_converter(tmp_path: Path) -> None:
    """1 g is a quarter of the way from the middle of a 10-bit converter to its end."""
    page = (Path(__file__).resolve().parents[3] / "docs" / "protocols.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```toml\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    path = tmp_path / "my_logger.toml"
    path.write_text(next(block for block in blocks if 'name = "my_logger"' in block), encoding="utf-8")
    options = Emulation(device=str(path))
    choice = choose_wire(options)
    source: SampleSource = _AtRest()
    sent = InProtocolUnits(source, (1.0, 1.0), choice.protocol, choice.rate_hz).next_block(5)
    frames = make_device(options, choice).encode(sent)
    lines = frames.data.tobytes().decode().splitlines()
    assert [line.split(",")[:5] for line in lines] == [["$HOME", str(n), "512", "512", "640"] for n in range(5)]


TEXTS = [
    {"columns": "ax,ay,az", "accelerometer_unit": "g", "delimiter": "semicolon"},
    {"columns": "counter,-,gx,gy,gz,ax,ay,az,temperature", "gyroscope_unit": "deg/s", "delimiter": "whitespace"},
    {"columns": "time,ax,ay,az,gx,gy,gz", "time_unit": "ms", "prefix": "$IMU"},
    {"columns": "time,ax,ay,az", "time_unit": "us", "accelerometer_unit": "m/s", "rate_hz": "50"},
]


@pytest.mark.parametrize("settings", TEXTS, ids=lambda one: one["columns"])
def test_lines_without_a_table_come_back(settings: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(load_protocol("text").text, encoding="utf-8")
    options = Emulation(device=str(path), settings=settings)
    choice = choose_wire(options)
    sent = random_samples(choice.protocol, choice.rate_hz, 0, 300)
    got, decoder = decode(choice.protocol, make_device(options, choice), sent)
    assert len(got) == 300
    assert decoder.statistics.bytes_skipped == 0
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=1e-8)
    if "gx" in settings["columns"]:
        np.testing.assert_allclose(got.gyroscope, sent.gyroscope, atol=1e-8)
    if "temperature" in settings["columns"]:
        np.testing.assert_allclose(got.temperature_degc, sent.temperature_degc, atol=0.0051)
    if "time" in settings["columns"]:
        np.testing.assert_allclose(got.time_s, sent.time_s, atol=1e-6)


def test_sentences_without_a_table_come_back() -> None:
    protocol = parse_protocol(load_protocol("vectornav_ascii").text.partition("[[emulate]]")[0])
    (form,) = wire_forms(protocol)
    sent = random_samples(protocol, form.rate_hz, 0, 300)
    got, decoder = decode(protocol, ProtocolDevice(protocol, form, form.rate_hz), sent)
    assert (len(got), decoder.statistics.bytes_skipped) == (300, 0)
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=1e-8)
