"""Any instrument whose protocol is a file: it sends one of the forms the file lists, and hears no commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.acquire.protocol import Protocol
from imufield.errors import UsageError
from imufield.samples import FloatArray, Samples, SampleUnits
from imufield.simulate.devices import Answer, Frames
from imufield.simulate.emulator_core import SampleSource
from imufield.simulate.frame_encode import FrameEncoder, WireClock
from imufield.simulate.sentence_encode import LINE_END, SentenceEncoder
from imufield.simulate.wire_forms import WireForm


class ProtocolDevice:
    """An instrument that sends samples in the units of its protocol.

    Parameters
    ----------
    protocol : Protocol
        With the settings of the form in place.
    form : WireForm
    rate_hz : float
        Nominal rate of the samples.
    baud : int

    Raises
    ------
    UsageError
        If the form does not fit the protocol.
    """

    start_up_s = 0.0
    streaming = True

    def __init__(self, protocol: Protocol, form: WireForm, rate_hz: float, baud: int = 115200) -> None:
        self.protocol = protocol
        self.baud = baud
        self._clock = WireClock(protocol, rate_hz)
        lines = [frame for frame in form.frames if frame.line]
        self._sentences = [SentenceEncoder(protocol, frame, self._clock) for frame in lines]
        self._frames = [] if lines else [FrameEncoder(protocol, frame, self._clock) for frame in form.frames]
        self._has_counter = any(one.has_counter for one in self._sentences) or any(one.has_counter for one in self._frames)

    def encode(self, samples: Samples) -> Frames:
        """Return the frames of a block, all those of a sample one behind another."""
        if self._sentences:
            lines = [line for each in zip(*(one.encode(samples) for one in self._sentences), strict=True) for line in each]
            ends = np.cumsum([len(line) for line in lines], dtype=np.int64)
            return Frames(np.frombuffer(b"".join(lines), dtype=np.uint8), ends, ends - len(LINE_END) - 1)
        rows = np.hstack([encoder.encode(samples) for encoder in self._frames])
        lengths = np.array([encoder.length for encoder in self._frames])
        ends = (np.arange(len(rows))[:, np.newaxis] * rows.shape[1] + np.cumsum(lengths)).reshape(-1)
        last = np.array([encoder.length - encoder.checksum_at for encoder in self._frames])
        return Frames(rows.reshape(-1), ends, ends - np.tile(last, len(rows)))

    def power_on(self) -> bytes:
        """Return nothing."""
        return b""

    def hear(self, data: bytes) -> Answer:  # noqa: ARG002 - what is not heard is not answered
        """Return nothing."""
        return Answer()

    def jump_counter(self, by: int) -> None:
        """Let the counter jump, or the time stamp where there is none."""
        self._clock.jump(by, self._has_counter)


class InProtocolUnits:
    """A source whose samples come in the units of a protocol.

    Parameters
    ----------
    source : SampleSource
    scale : tuple of float
        Raw unit of the source per m/s^2 and per rad/s.
    protocol : Protocol
    rate_hz : float
        Nominal rate, for increments.

    Raises
    ------
    UsageError
        If the protocol leaves open what a count is.
    """

    def __init__(self, source: SampleSource, scale: tuple[float, float], protocol: Protocol, rate_hz: float) -> None:
        self._source = source
        self.interval_s = source.interval_s
        self._units: SampleUnits = protocol.units
        nominal = (protocol.nominal.accelerometer_scale, protocol.nominal.gyroscope_scale)
        if None in nominal:
            raise UsageError(
                f"protocol {protocol.name} sends counts whose size it does not know, so nothing can be emulated; choose it "
                "with --set, see `settings` in its file, or give scales under [nominal]"
            )
        by_increment = (self._units.accelerometer_is_increment, self._units.gyroscope_is_increment)
        self._factors = [
            float(wanted or 1.0) / has / (rate_hz if increment else 1.0)
            for wanted, has, increment in zip(nominal, scale, by_increment, strict=True)
        ]
        self._raw_zero = protocol.nominal.raw_zero

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost."""
        samples = self._source.next_block(count)
        accelerometer: FloatArray = samples.accelerometer_rate() * self._factors[0] + self._raw_zero
        return replace(
            samples, accelerometer=accelerometer, gyroscope=samples.gyroscope_rate() * self._factors[1], units=self._units
        )
