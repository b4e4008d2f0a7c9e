"""What the STIM300's special datagrams mean."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from crccheck.crc import Crc32Mpeg2

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol
from imufield.errors import ProtocolError, Reason
from imufield.samples import Status
from tests.refused import refused

if TYPE_CHECKING:
    from drivers import stim300
else:
    from imufield.drivers import stim300

Stim300 = stim300.Stim300


@pytest.fixture
def crc() -> Callable[[bytes], bytes]:
    return lambda body: body + struct.pack(">I", Crc32Mpeg2.calc(body + bytes(-len(body) % 4)))


@pytest.fixture
def messages(crc: Callable[[bytes], bytes]) -> list[dict[str, Any]]:
    digits = "84167-4400003-321".replace("-", "")
    p = [0] * 19
    p[1:12] = [int(digit) for digit in digits[:11]]
    p[17], p[12], p[13], p[14] = (int(digit) for digit in digits[11:])
    half = p[:18]
    packed = [half[i] << 4 | half[i + 1] for i in range(0, 18, 2)]
    part = bytes([*packed[:3], 45, *packed[3:6], 45, *packed[6:], 0, 0, 0])
    configuration = bytes([0xBC, ord("K"), 7, 0x62, 0x20, 0x71, 0, 0, 0x70, 0, 0, 0x70, 0, 0, 8, 0, 0, 0x33, 0x30, 0, 0, 0])
    stream = crc(b"\xb1" + part + b"K") + crc(b"\xb5N\x25\x58\x18\x46\x02\x00\x20" + bytes(7)) + crc(configuration)
    decoder = Decoder(load_protocol("stim300"))
    decoder.feed(stream)
    return [dict(message) for message in decoder.messages()]


def test_identity(messages: list[dict[str, Any]]) -> None:
    assert Stim300.identity(messages) == {
        "model": "STIM300 84167-4400003-321 K",
        "serial_number": "N25581846020020",
        "firmware": "7, hardware K",
    }


def test_settings_are_read_from_the_configuration(messages: list[dict[str, Any]]) -> None:
    read = {"accelerometer_range_g": 5, "accelerometer_output": "rate", "gyroscope_output": "increment", "rate_hz": 1000}
    assert Stim300.read_settings(messages) == read
    protocol = Stim300.load_protocol({"accelerometer_range_g": 30}, messages=messages)
    assert protocol.settings["accelerometer_range_g"].value == 30
    assert protocol.settings["gyroscope_output"].origin == "read"
    assert protocol.units.gyroscope == "rad"
    assert protocol.units.interval_s == 0.001
    assert protocol.units.accelerometer == "m/s^2"


@pytest.mark.parametrize("triad", ["gyroscope", "accelerometer"])
def test_an_output_that_is_not_supported_is_refused_and_no_rate(triad: str) -> None:
    messages = [{"kind": "configuration", f"{triad}_output": "integrated", "rate_hz": None}]
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "integrated", f"{triad}_output", key="settings.read"):
        Stim300.load_protocol(messages=messages)
    # Who knows better is believed.
    assert Stim300.load_protocol({f"{triad}_output": "average"}, messages=messages)


def test_ranges_that_differ_are_refused_as_one_setting_scales_all() -> None:
    ranges = {"accelerometer_range_g": 10, "accelerometer_range_y_g": 5, "accelerometer_range_z_g": 10}
    messages = [{"kind": "configuration", **ranges}]
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "x 10, y 5, z 10", "accelerometer_range_g", key="settings.read"):
        Stim300.load_protocol(messages=messages)
    assert Stim300.load_protocol({"accelerometer_range_g": 10}, messages=messages)


def test_status_flags_are_known() -> None:
    frame = load_protocol("stim300")
    assert {rule.flag for rule in frame.samples.flags} == {
        Status.START_UP,
        Status.INSTRUMENT_FAULT,
        Status.GYROSCOPE_SATURATED,
        Status.GYROSCOPE_INVALID,
        Status.ACCELEROMETER_SATURATED,
        Status.ACCELEROMETER_INVALID,
    }
