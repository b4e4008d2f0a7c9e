"""A virtual instrument on a pseudo-terminal: real protocol, real rate times ``speed``.

::

    with Emulator(Stim300Device(), source) as emulator:
        port = serial.Serial(emulator.port)

A thread sends what is due every few milliseconds of the monotonic clock. It never waits for a reader: what does not
fit into the buffer of the system is dropped and counted, as a UART does.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from imufield.errors import UsageError
from imufield.samples import Samples, Status
from imufield.simulate.devices import COMMAND_END, Device
from imufield.simulate.faults import FaultInjector, Faults
from imufield.simulate.imu import Imu
from imufield.simulate.operator import Operator
from imufield.simulate.port import PseudoTerminal

SLICE_S = 0.008
"""Wall time between writes: short against the 20 ms a reader gathers, long against the cost of a wake-up."""
MAXIMUM_SPEED = 1000.0
LINGER_S = 0.5
"""The port outlives the last sample by this."""
_LARGEST_BLOCK_S = 1.0
"""Instrument's time made at once after a delay; keeps stop() prompt when the machine cannot keep up."""
_LONGEST_COMMAND = 256
"""Bytes kept while waiting for the end of a command; those of a STIM300 have at most some 60."""


class Source(Protocol):
    """Where samples come from."""

    interval_s: float
    """True time between samples."""

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost; ``counter`` is the number of the sample."""
        ...


class VirtualImu:
    """A simulated instrument in the hands of a simulated operator."""

    def __init__(self, imu: Imu, operator: Operator) -> None:
        self.imu = imu
        self.operator = operator
        self.interval_s = imu.interval_s
        self._next = 0

    @property
    def time_s(self) -> float:
        """True time of the next sample."""
        return self._next * self.interval_s

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost."""
        motion = self.operator.block(self._next, count, self.interval_s)
        self._next += count
        return self.imu.feed(motion)


@dataclass(frozen=True, slots=True)
class EmulatorSettings:
    """How the emulator runs."""

    speed: float = 1.0
    """Times real time."""
    wait_for_reader: bool = False
    """Power on only when a host opens the port."""
    duration_s: float | None = None
    """Stop sending after so much of the instrument's time."""
    link: Path | None = None
    """Symbolic link to the port."""


class Emulator:
    """An instrument on a pseudo-terminal, run by a thread from ``start`` (or ``with``) to ``stop``.

    Parameters
    ----------
    device : Device
        Speaks the protocol.
    source : Source
        Gives the samples.
    settings : EmulatorSettings, optional
    faults : Faults, optional
    seed : int
        Of the faults.
    on_progress : callable, optional
        Called by the thread after each slice that sent samples.

    Raises
    ------
    UsageError
        If the speed makes no sense.
    """

    def __init__(
        self,
        device: Device,
        source: Source,
        settings: EmulatorSettings | None = None,
        *,
        faults: Faults | None = None,
        seed: int = 0,
        on_progress: Callable[[], None] | None = None,
    ) -> None:
        self.device = device
        self.source = source
        self.settings = settings or EmulatorSettings()
        if not 0 < self.settings.speed <= MAXIMUM_SPEED:
            raise UsageError(f"speed {self.settings.speed:g} is outside 0 to {MAXIMUM_SPEED:g}; 1 is real time")
        self.injector = FaultInjector(faults or Faults(), seed)
        self.samples_sent = 0
        self.failure: BaseException | None = None
        """What ended the thread, if it did not end by itself."""
        self._on_progress = on_progress
        self._pty = PseudoTerminal(self.settings.link)
        self._stopping = threading.Event()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulator", daemon=True)
        self._samples_made = 0
        self._boot_sample = 0
        self._command = b""
        self._answers = b""
        self._held_back = b""
        self._stalled_until_s = 0.0
        self._gone_until_s = 0.0

    @property
    def port(self) -> str:
        """What a host opens."""
        return self._pty.port

    @property
    def bytes_dropped(self) -> int:
        """Bytes that nobody took in time."""
        return self._pty.bytes_dropped

    @property
    def time_s(self) -> float:
        """Instrument's time since power-on."""
        return self._samples_made * self.source.interval_s

    @property
    def finished(self) -> bool:
        """Whether the thread has ended: after ``stop``, at the end of ``duration_s`` or by a failure."""
        return self._finished.is_set()

    def start(self) -> Self:
        """Power on."""
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the thread and take the port away; once is enough, more do no harm."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._pty.close()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the thread to end and return whether it did."""
        return self._finished.wait(timeout_s)

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:  # noqa: BLE001 - top of a thread: kept for whoever asks
            self.failure = error
        finally:
            self._finished.set()

    def _serve(self) -> None:
        while self.settings.wait_for_reader and not self._pty.has_reader():
            if self._stopping.wait(SLICE_S):
                return
        self._answers = self.device.power_on()
        started_s = time.monotonic()
        while not self._stopping.wait(SLICE_S):
            self._listen()
            elapsed_s = (time.monotonic() - started_s) * self.settings.speed
            while self._advance(elapsed_s):
                if self._stopping.is_set():
                    return
            if self._samples_made == self._last_sample:
                self._linger()
                return

    def _linger(self) -> None:
        """Leave the port open for a moment: who reads late still gets the end."""
        end_s = time.monotonic() + LINGER_S
        while self._pty.has_reader() and time.monotonic() < end_s and not self._stopping.wait(SLICE_S):
            self._put(b"", 0.0)

    def _advance(self, until_s: float) -> bool:
        """Make and send samples that are due; return whether there were any."""
        due = min(int(until_s / self.source.interval_s) + 1, self._last_sample)
        largest = math.ceil(_LARGEST_BLOCK_S / self.source.interval_s)
        count = min(due - self._samples_made, largest)
        if count <= 0:
            return False
        self._send(self.source.next_block(count), count)
        return True

    @property
    def _last_sample(self) -> int:
        """Number of samples after which the time is over."""
        duration_s = self.settings.duration_s
        return sys.maxsize if duration_s is None else round(duration_s / self.source.interval_s)

    def _send(self, samples: Samples, count: int) -> None:
        """Send a block of which ``count`` samples were made and some perhaps lost."""
        duration_s = count * self.source.interval_s
        self._samples_made += count
        self._plug(duration_s)
        self.device.jump_counter(self.injector.counter_jump(duration_s))
        if self.device.streaming and len(samples):
            # The answer to a command takes the place of a datagram.
            samples = samples[1:] if self._answers and self.samples_sent else samples
            frames = self.device.encode(self._flag_start_up(samples))
            data = self.injector.damage(frames.data, frames.checksum_at, duration_s)
            self.samples_sent += len(samples)
        else:
            data = b""
        self._put(self._answers + data, duration_s)
        self._answers = b""
        if self._on_progress is not None:
            self._on_progress()

    def _flag_start_up(self, samples: Samples) -> Samples:
        starting = samples.counter < self._boot_sample + self.device.start_up_s / self.source.interval_s
        if not np.any(starting):
            return samples
        return replace(samples, status=np.where(starting, samples.status | np.uint32(Status.START_UP), samples.status))

    def _put(self, data: bytes, duration_s: float) -> None:
        faults = self.injector.faults
        if self.injector.happens("stalls", faults.stalls_per_s, duration_s):
            self._stalled_until_s = self.time_s + faults.stall_s
        self._held_back += data
        if self.time_s >= self._stalled_until_s:
            self._pty.write(self._held_back)
            self._held_back = b""

    def _plug(self, duration_s: float) -> None:
        """Unplug and plug in again as the faults have it."""
        if self._pty.is_open:
            if self.injector.disconnects(self.time_s, duration_s):
                self._pty.close()
                self._gone_until_s = self.time_s + self.injector.faults.disconnect_s
        elif self.time_s >= self._gone_until_s:
            self._pty.open()

    def _listen(self) -> None:
        """Hear commands; each ends with a carriage return."""
        *commands, rest = (self._command + self._pty.read()).split(COMMAND_END)
        self._command = rest[-_LONGEST_COMMAND:]
        for command in commands:
            answer = self.device.answer(command.strip(b"\n"))
            self._answers += answer.data
            if answer.resets:
                self._boot_sample = self._samples_made
                self._answers += self.device.power_on()
