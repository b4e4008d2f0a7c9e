"""An instrument described by a protocol file: it sends one of the forms of the file, and answers by a script."""

from __future__ import annotations

import math
from itertools import chain

import numpy as np

from imufield.acquire.protocol.protocol import Protocol
from imufield.dataclass import replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray, Samples
from imufield.simulate.instruments.device import Answer, Device, Frames
from imufield.simulate.instruments.scripted import NoCommands, ScriptedInstrument
from imufield.simulate.truth.virtual_imu import SampleSource
from imufield.simulate.wire.forms import WireForm
from imufield.simulate.wire.frames import FrameEncoder, WireClock
from imufield.simulate.wire.lines import LineEncoder, SentenceEncoder

COUNTS_OF_A_CONVERTER = 32768.0
"""From the middle of a 16-bit converter to its end."""
CONVERTER_RANGE_M_S2 = 4 * STANDARD_GRAVITY_M_S2
CONVERTER_RANGE_RAD_S = math.radians(500.0)
"""What the end of the converter stands for where a protocol says neither scale nor range."""


class ProtocolDevice(Device):
    """An instrument that sends samples in the units of its protocol.

    Parameters
    ----------
    protocol : Protocol
        With the settings of the form in place.
    form : WireForm
    rate_hz : float
        Nominal rate of the samples.
    script : ScriptedInstrument, optional
        What it answers; nothing without.

    Raises
    ------
    UsageError
        If the form does not fit the protocol.
    """

    def __init__(self, protocol: Protocol, form: WireForm, rate_hz: float, script: ScriptedInstrument | None = None) -> None:
        self.protocol = protocol
        self.script = script or NoCommands(rate_hz)
        self._clock = WireClock(protocol, rate_hz)
        lines = [frame for frame in form.frames if frame.line]
        self._sentences: list[SentenceEncoder | LineEncoder] = [
            SentenceEncoder(protocol, frame, self._clock) for frame in lines
        ]
        if protocol.lines is not None and not protocol.lines.sentences:
            self._sentences = [LineEncoder(protocol, self._clock)]
        self._frames = [] if self._sentences else [FrameEncoder(protocol, frame, self._clock) for frame in form.frames]
        self._has_counter = any(encoder.has_counter for encoder in (*self._sentences, *self._frames))

    @property
    def streaming(self) -> bool:
        """Whether samples are sent."""
        return self.script.streaming

    @property
    def rate_hz(self) -> float:
        """Output rate now."""
        return self.script.rate_hz

    @property
    def memory_writes(self) -> list[bytes]:
        """Commands that would have changed memory that outlives the power."""
        return self.script.memory_writes

    def encode(self, samples: Samples) -> Frames:
        """Return the frames of a block, all those of a sample one behind another."""
        if self._sentences:
            of_sample = zip(*(encoder.encode(samples) for encoder in self._sentences), strict=True)
            return Frames.of_lines([*chain.from_iterable(of_sample)])
        rows = np.hstack([encoder.encode(samples) for encoder in self._frames])
        lengths = np.array([encoder.length for encoder in self._frames])
        ends = (np.arange(len(rows))[:, np.newaxis] * rows.shape[1] + np.cumsum(lengths)).reshape(-1)
        last = np.array([encoder.length - encoder.checksum_at for encoder in self._frames])
        return Frames(rows.reshape(-1), ends, ends - np.tile(last, len(rows)))

    def receive(self, data: bytes) -> Answer:
        """Return what the script answers."""
        answer = self.script.receive(data)
        self._clock.rate_hz = self.script.rate_hz
        return Answer(answer)

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
    """

    def __init__(self, source: SampleSource, scale: tuple[float, float], protocol: Protocol, rate_hz: float) -> None:
        nominal, self._units, self._rate_hz, self._source = protocol.nominal, protocol.units, rate_hz, source
        self._raw_zero = nominal.raw_zero
        increments = (self._units.accelerometer_is_increment, self._units.gyroscope_is_increment)
        self._is_increment = increments
        # Where a file leaves open what a count is, a converter is assumed: solving finds its scale as that of any other.
        middle = float(np.mean(nominal.raw_zero)) or COUNTS_OF_A_CONVERTER
        accelerometer = middle / (nominal.accelerometer_range_m_s2 or CONVERTER_RANGE_M_S2)
        gyroscope = COUNTS_OF_A_CONVERTER / (nominal.gyroscope_range_rad_s or CONVERTER_RANGE_RAD_S)
        # Raw unit of the protocol per m/s^2 and per rad/s (per m/s and per rad of increments), over that of the source.
        self._per_unit = (
            (nominal.accelerometer_scale or accelerometer * (rate_hz if increments[0] else 1.0)) / scale[0],
            (nominal.gyroscope_scale or gyroscope * (rate_hz if increments[1] else 1.0)) / scale[1],
        )

    @property
    def interval_s(self) -> float:
        """True time between samples."""
        return self._source.interval_s

    def set_rate(self, rate_hz: float) -> None:
        """Go on at another nominal rate."""
        self._source.set_rate(rate_hz)
        self._rate_hz = rate_hz

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost."""
        samples = self._source.next_block(count)
        # An increment is the rate over the time of one sample.
        to_accelerometer, to_gyroscope = (
            factor / (self._rate_hz if increment else 1.0)
            for factor, increment in zip(self._per_unit, self._is_increment, strict=True)
        )
        accelerometer: FloatArray = samples.accelerometer_rate() * to_accelerometer + self._raw_zero
        return replace(
            samples, accelerometer=accelerometer, gyroscope=samples.gyroscope_rate() * to_gyroscope, units=self._units
        )
