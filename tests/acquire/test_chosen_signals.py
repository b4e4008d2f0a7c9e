"""Which of an instrument's signals make samples, in packets made by hand after the makers' documents."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.checksum import make_checksum
from imufield.acquire.protocol.protocol import load_protocol
from imufield.samples import Samples, Status, concatenate


def decoded(name: str, data: bytes, given: Mapping[str, object] | None = None) -> tuple[Samples, Decoder]:
    decoder = Decoder(load_protocol(name, given))
    return concatenate([decoder.feed(data), decoder.flush()]), decoder


def mip(at_ns: int, *others: bytes) -> bytes:
    """Return a packet of set 0x80: reference time, 1 g along z, no rate, other fields as (descriptor, data)."""
    fields = [b"\xd5" + struct.pack(">Q", at_ns), b"\x04" + struct.pack(">3f", 0, 0, 1), b"\x05" + bytes(12), *others]
    payload = b"".join(bytes([len(field) + 1]) + field for field in fields)
    body = bytes([0x75, 0x65, 0x80, len(payload)]) + payload
    return body + make_checksum("FLETCHER-16/MOD-256").of(body).to_bytes(2, "big")


def test_a_mean_since_power_on_is_no_temperature_of_a_sample() -> None:
    # mip_sdk, data_sensor.h: least, greatest and mean "since the last power on or reset".
    samples, _ = decoded("microstrain_mip", mip(0, b"\x14" + struct.pack(">3f", 15, 40, 25)))
    assert np.isnan(samples.temperature_degc).tolist() == [True]


def test_packets_of_an_event_enter_no_mean() -> None:
    # mip_sdk, data_shared.h: a trigger of 0 is the schedule of the message format.
    packets = [(10_000_000 * number, 0) for number in range(300)]
    packets += [(10_000_000 * number + 3_000_000, 1) for number in range(0, 300, 25)]
    data = b"".join(mip(at_ns, b"\xd0" + bytes([trigger])) for at_ns, trigger in sorted(packets))
    samples, decoder = decoded("microstrain_mip", data)
    by_event = (samples.status & np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)) != 0
    np.testing.assert_allclose(samples.time_s[by_event] % 0.25, 0.003, atol=1e-9)
    assert (len(samples), by_event.sum(), samples.usable.sum()) == (312, 12, 300)
    assert (decoder.statistics.lost, decoder.statistics.nominal_rate_hz) == (0, pytest.approx(100))
