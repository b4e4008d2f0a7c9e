"""What the encoder writes the decoder reads, for every CAN protocol that ships."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol, protocol_names
from imufield.errors import Reason, UsageError
from imufield.samples import Samples, Status, concatenate, make_samples
from imufield.simulate.wire.can_frames import CanEncoder
from tests.acquire.plain_frames import pack_frames
from tests.refused import refused

NAMES = [name for name in protocol_names() if load_protocol(name).can is not None]


def make(name: str, count: int = 300) -> Samples:
    protocol = load_protocol(name)
    rng = np.random.default_rng(1)
    return make_samples(
        np.arange(count) / 100.0,
        rng.uniform(-15, 15, (count, 3)),
        rng.uniform(-3, 3, (count, 3)),
        units=protocol.units,
        temperature_degc=rng.uniform(10, 40, count),
        counter=np.arange(count),
    )


@pytest.mark.parametrize("name", NAMES)
def test_round_trip(name: str) -> None:
    protocol = load_protocol(name)
    rule = protocol.can
    assert rule is not None
    sent = make(name)
    decoder = Decoder(protocol)
    data = pack_frames(CanEncoder(protocol).encode(sent))
    got = concatenate([decoder.feed(data), decoder.flush()])
    assert len(got) == len(sent)
    # Half a step of the coarsest signal.
    step = max(
        abs(column.factor) for kind in rule.kinds for column in kind.columns if not column.signal.is_float or column.place == 6
    )
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=0.501 * step)
    if rule.has_gyroscope:
        np.testing.assert_allclose(got.gyroscope, sent.gyroscope, atol=0.501 * step)
    np.testing.assert_allclose(got.time_s - got.time_s[0], sent.time_s, atol=1e-3)
    assert decoder.statistics.samples_lost == decoder.statistics.losses_estimated == 0
    assert not (got.status & ~np.uint32(Status.TIME_ESTIMATED) & 0xFFFF).any()


def test_invalid_samples_become_codes() -> None:
    protocol = load_protocol("j1939_imu")
    sent = make("j1939_imu", 50)
    sent.accelerometer[7, 1] = np.nan
    sent.status[9] |= np.uint32(Status.GYROSCOPE_INVALID)
    frames = CanEncoder(protocol).encode(sent)
    assert frames[14].data[2:4] == b"\xff\xff"
    assert frames[19].data[:6] == b"\xff" * 6
    assert frames[0].text.startswith("08F02D80#"), "priority of the file, address of the instrument"


@pytest.mark.parametrize(("given", "sent_from"), [({}, 0x80), ({"source_address": 226}, 226), ({"source_address": 0}, 0)])
def test_an_instrument_sends_from_its_address(given: dict[str, int], sent_from: int) -> None:
    protocol, encoded = load_protocol("j1939_imu", given), make("j1939_imu", 50)
    encoder, decoder = CanEncoder(protocol), Decoder(protocol)
    frames = [*encoder.encode(encoded), encoder.frame("SoftwareVersion", {})]
    assert {frame.can_id & 0xFF for frame in frames} == {sent_from}
    assert len(concatenate([decoder.feed(pack_frames(frames)), decoder.flush()])) == 50


def test_values_stop_at_the_last_that_is_no_code() -> None:
    protocol = load_protocol("j1939_imu")
    sent = make("j1939_imu", 2)
    sent.accelerometer[:] = 1e6, -1e6, 0
    frame = CanEncoder(protocol).encode(sent)[0]
    assert frame.data[:4] == b"\xff\xfa\x00\x00"


def test_other_protocols_have_no_frames() -> None:
    with refused(UsageError, Reason.USAGE, "stim300", "DBC", key="can_frames.no_bus"):
        CanEncoder(load_protocol("stim300"))
