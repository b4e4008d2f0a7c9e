"""The home-made instrument: its lines by hand, and read back by the decoder."""

from __future__ import annotations

import numpy as np

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol
from imufield.errors import ProtocolError
from imufield.samples import SampleUnits, make_samples
from imufield.simulate.emulator.emulate import Emulation, choose_wire, make_device
from imufield.simulate.instruments.device import Answer, Device
from tests.refused import refused


def text(**settings: object) -> Device:
    options = Emulation(device="text", settings=settings)
    return make_device(options, choose_wire(options))


def test_it_prints_and_is_deaf() -> None:
    device = text(columns="counter,ax,ay,az")
    samples = make_samples(np.arange(2.0), np.ones((2, 3)), units=SampleUnits(), counter=np.arange(2))
    device.jump_counter(7)
    frames = device.encode(samples)
    assert frames.data.tobytes() == b"7,1.000000000,1.000000000,1.000000000\r\n8,1.000000000,1.000000000,1.000000000\r\n"
    assert frames.data[frames.checksum_at].tobytes() == b"00"
    assert device.receive(b"N\r") == Answer()
    assert device.power_on() == b""


def test_its_lines_by_hand() -> None:
    samples = make_samples(
        np.zeros(1),
        np.array([[1.0, -2.5, 3e-4]]),
        np.array([[-1.0, np.nan, 1.0]]),
        units=SampleUnits(),
        temperature_degc=np.array([25.0]),
        counter=np.arange(1),
    )
    line = b"0.000000,1.000000000,-2.500000000,0.000300000,-1.000000000,nan,1.000000000\r\n"
    assert text().encode(samples).data.tobytes() == line
    device = text(columns="counter, ax, ay, az, temperature", prefix="$IMU ")
    assert device.encode(samples).data.tobytes() == b"$IMU 0,1.000000000,-2.500000000,0.000300000,25.00\r\n"


def test_a_column_must_be_known() -> None:
    with refused(ProtocolError, None, "altitude"):
        text(columns="ax,ay,az,altitude")


def test_the_decoder_reads_its_lines_back() -> None:
    rng = np.random.default_rng(1)
    sent = make_samples(
        np.arange(50) / 100, 4 * rng.standard_normal((50, 3)), rng.standard_normal((50, 3)), units=SampleUnits()
    )
    got = Decoder(load_protocol("text", {})).feed(text().encode(sent).data.tobytes(), 0.0)
    np.testing.assert_allclose(got.accelerometer, sent.accelerometer, atol=5.1e-10)
    np.testing.assert_allclose(got.gyroscope, sent.gyroscope, atol=5.1e-10)
    np.testing.assert_allclose(got.time_s, sent.time_s, atol=1e-9)
