"""Which of an instrument's signals make samples, in packets made by hand after the makers' documents."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
import pytest

from imufield.acquire.decode.statistics import without_samples
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
    assert decoder.statistics.lost == 0
    assert decoder.statistics.nominal_rate_hz == pytest.approx(100)


def mtdata2(counter: int, tenth_ms: int, *packets: tuple[int, float]) -> bytes:
    """Return a message: counter, time, packets of three float32 of one value each."""
    data = struct.pack(">HBHHBI", 0x1020, 2, counter % 65536, 0x1060, 4, tenth_ms)
    data += b"".join(struct.pack(">HB3f", number, 12, *[value] * 3) for number, value in packets)
    body = bytes([0xFF, 0x36, len(data)]) + data
    return b"\xfa" + body + bytes([-sum(body) % 256])


HIGH_RATE = {"accelerometer_output": "high_rate", "gyroscope_output": "high_rate"}


def test_signal_paths_are_never_mixed() -> None:
    # Both paths at rates of their own, the HR outputs in messages of their own (MTi 600 series: 2000 and 1600 Hz).
    messages = [(10 * number, [(0x4040, 2.0)]) for number in range(1000)]
    messages += [(10 * number + 5, [(0x8040, 4.0)]) for number in range(1000)]
    messages += [(100 * number, [(0x4020, 1.0), (0x8020, 3.0)]) for number in range(100)]
    data = b"".join(mtdata2(counter, at, *packets) for counter, (at, packets) in enumerate(sorted(messages)))
    samples, decoder = decoded("xsens_mtdata2", data)
    assert np.unique(samples.accelerometer).tolist() == [1.0]
    assert np.unique(samples.gyroscope).tolist() == [3.0]
    assert (len(samples), decoder.statistics.lost, decoder.statistics.samples_incomplete) == (100, 0, 0)


@pytest.mark.parametrize(("given", "values"), [({}, (1.0, 3.0)), (HIGH_RATE, (2.0, 4.0))])
def test_of_a_message_with_both_paths_the_chosen_one_is_read(given: Mapping[str, object], values: tuple[float, float]) -> None:
    packets = ((0x4040, 2.0), (0x4020, 1.0), (0x8040, 4.0), (0x8020, 3.0))
    samples, _ = decoded("xsens_mtdata2", mtdata2(0, 0, *packets), given)
    assert (samples.accelerometer.tolist(), samples.gyroscope.tolist()) == ([[values[0]] * 3], [[values[1]] * 3])


def test_high_rate_alone_is_no_sample_until_it_is_chosen() -> None:
    data = b"".join(mtdata2(number, 10 * number, (0x4040, 2.0), (0x8040, 4.0)) for number in range(100))
    samples, decoder = decoded("xsens_mtdata2", data)
    assert len(samples) == 0
    said = without_samples(decoder.protocol, [decoder.statistics])
    assert all(f"--set {name}={value}" in said for name, value in HIGH_RATE.items())
    samples, decoder = decoded("xsens_mtdata2", data, HIGH_RATE)
    assert (len(samples), decoder.statistics.lost, decoder.statistics.samples_incomplete) == (100, 0, 0)
