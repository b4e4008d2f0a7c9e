"""The maker's own library reads our MicroStrain instrument on a port, and agrees with our decoder on every value."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.samples import Samples, concatenate
from imufield.simulate.emulator.core import EmulatorSettings
from imufield.simulate.emulator.emulate import Emulation, WireChoice, choose_wire
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.device import Frames
from imufield.simulate.instruments.protocol_device import ProtocolDevice
from tests.simulate.accounting import random_samples

mscl: Any = pytest.importorskip("mscl", reason="the maker's library is not installed: pip install pymscl")

G = 9.80665
LIMIT_S = 30.0
CHANNELS = {
    "reference_time": ("scaledAccel", "scaledGyro", G, 1.0, "timeInfo_referenceTime", 1e-9),
    "gps_time": ("scaledAccel", "scaledGyro", G, 1.0, "gpsTime", 0.0),
    "increments": ("deltaVel", "deltaTheta", G, 1.0, "", 0.0),
}
"""By form: names of the channels without their axis, factors to SI, and the time with its factor (0: in another form)."""


class _Random:
    def __init__(self, choice: WireChoice) -> None:
        self.interval_s = 1 / choice.rate_hz
        self._choice, self._next = choice, 0

    def set_rate(self, rate_hz: float) -> None:
        self.interval_s = 1 / rate_hz

    def next_block(self, count: int) -> Samples:
        first, self._next = self._next, self._next + count
        return random_samples(self._choice.protocol, self._choice.rate_hz, first, count)


class _Taped(ProtocolDevice):
    """Keeps what it sends."""

    tape = b""

    def encode(self, samples: Samples) -> Frames:
        frames = super().encode(samples)
        self.tape += frames.data.tobytes()
        return frames


@pytest.mark.parametrize("form", CHANNELS)
def test_both_decoders_agree_on_every_value(form: str) -> None:
    choice = choose_wire(Emulation(device="microstrain_mip", form=form))
    assert choice.form is not None
    device = _Taped(choice.protocol, choice.form, choice.rate_hz)
    count = round(2.0 * choice.rate_hz)
    settings = EmulatorSettings(speed=2.0, duration_s=2.0, wait_for_reader=True)
    packets: list[dict[str, float]] = []
    with Emulator(device, _Random(choice), settings) as emulator:
        node = mscl.InertialNode(mscl.Connection.Serial(emulator.port, 115200))
        end_s = time.monotonic() + LIMIT_S
        while len(packets) < count and time.monotonic() < end_s:
            packets += [{point.channelName(): point.as_double() for point in one.data()} for one in node.getDataPackets(100)]
        node.connection().disconnect()
    decoder = Decoder(choice.protocol)
    ours = concatenate([decoder.feed(device.tape), decoder.flush()])
    assert len(packets) == len(ours) == emulator.samples_sent == count
    accelerometer, gyroscope, to_m_s2, to_rad_s, stamp, to_s = CHANNELS[form]
    theirs = {name: np.array([one[name] for one in packets]) for name in packets[0]}
    for axis, letter in enumerate("XYZ"):
        # Both read the same 32 bits; the factor to SI is all that rounds.
        np.testing.assert_allclose(ours.accelerometer[:, axis], theirs[accelerometer + letter] * to_m_s2, rtol=1e-15)
        np.testing.assert_allclose(ours.gyroscope[:, axis], theirs[gyroscope + letter] * to_rad_s, rtol=1e-15)
    if to_s:
        (name,) = [one for one in theirs if one.startswith(stamp)]
        np.testing.assert_allclose(ours.time_s, theirs[name] * to_s, rtol=1e-15, atol=1e-12)
