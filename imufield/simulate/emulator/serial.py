"""A virtual instrument on a pseudo-terminal: real protocol, real rate times ``speed``.

::

    with Emulator(Stim300Device(), source) as emulator:
        port = serial.Serial(emulator.port)

Bytes that do not fit into the buffer of the system are dropped and counted, as a UART does.
"""

from __future__ import annotations

import time

from imufield.samples import Samples
from imufield.simulate.emulator.core import LINGER_S, SLICE_S, EmulatorCore, EmulatorSettings
from imufield.simulate.emulator.faults import FaultInjector, Faults
from imufield.simulate.emulator.port import PseudoTerminal
from imufield.simulate.instruments.device import Device
from imufield.simulate.truth.virtual_imu import SampleSource


class Emulator(EmulatorCore):
    """An instrument on a pseudo-terminal, run by a thread from ``start`` (or ``with``) to ``stop``.

    Parameters
    ----------
    device : Device
        Speaks the protocol.
    source : SampleSource
        Gives the samples.
    settings : EmulatorSettings, optional
    faults : Faults, optional
    seed : int
        Of the faults.
    """

    def __init__(
        self,
        device: Device,
        source: SampleSource,
        settings: EmulatorSettings | None = None,
        *,
        faults: Faults | None = None,
        seed: int = 0,
    ) -> None:
        settings = settings or EmulatorSettings()
        self.device = device
        self.injector = FaultInjector(faults or Faults(), seed)
        self._terminal = PseudoTerminal(settings.link)
        super().__init__(source, settings, self._terminal, self.injector, start_up_s=device.start_up_s)
        self._rate_hz = device.rate_hz
        self._answers = b""
        self._pending = b""  # Kept back while the instrument stalls.

    @property
    def port(self) -> str:
        """What a host opens."""
        return self.address

    @property
    def bytes_dropped(self) -> int:
        """Bytes that nobody took in time."""
        return self._terminal.bytes_dropped

    def _power_on(self) -> None:
        self._answers = self.device.power_on()

    def _listen(self) -> None:
        answer = self.device.receive(self._terminal.read())
        self._answers += answer.data
        if answer.resets:
            self._boot_sample = self._samples_made
            self._answers += self.device.power_on()
        if self.device.rate_hz not in (None, self._rate_hz):
            self._rate_hz = self.device.rate_hz
            self._set_rate(self._rate_hz)
        # An answer that takes the place of a sample waits for the next sample.
        if self._answers and not self.device.answers_replace_samples:
            self._send(b"", stalled=self._is_stalled)

    def _put(self, samples: Samples, duration_s: float, *, stalled: bool) -> None:
        self.device.jump_counter(self.injector.counter_jump(duration_s))
        # Only what takes the place of a sample is still waiting here; that may be the only one that is due.
        samples = samples[1:] if self._answers and self.samples_sent else samples
        data = b""
        if self.device.streaming and len(samples):
            frames = self.device.encode(samples)
            data = self.injector.damage(frames.data, frames.checksum_at, duration_s)
            self.samples_sent += len(samples)
        self._send(data, stalled=stalled)

    def _send(self, data: bytes, *, stalled: bool = False) -> None:
        """Send the answers there are and samples behind them."""
        self._pending += self._answers + data
        self._answers = b""
        if not stalled:
            self._terminal.write(self._pending)
            self._pending = b""

    def _go_away(self) -> None:
        self._terminal.close()

    def _come_back(self) -> None:
        self._terminal.open()

    def _linger(self) -> None:
        self._send(b"")
        end_s = time.monotonic() + LINGER_S
        while self._terminal.has_reader() and time.monotonic() < end_s and not self._stopping.wait(SLICE_S):
            self._terminal.write(b"")
