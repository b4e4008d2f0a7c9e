"""What runs a virtual instrument on any wire: a thread makes the samples that are due and hands them to an output.

The thread wakes every few milliseconds of the monotonic clock. It never waits for a reader. What differs from wire to wire is
in the classes derived from ``EmulatorCore``: how samples become bytes or frames, and what a port is.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from imufield.errors import UsageError
from imufield.samples import Samples, Status
from imufield.simulate.emulator.faults import Chances
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import Operator

SLICE_S = 0.008
"""Wall time between writes: short against the 20 ms a reader gathers, long against the cost of a wake-up."""
MAXIMUM_SPEED = 1000.0
LINGER_S = 0.5
"""The port outlives the last sample by this."""
_ROUNDING = 1e-6  # Of a sample number at another rate.
_LARGEST_BLOCK_S = 1.0  # Instrument's time made at once after a delay; keeps stop() prompt when the machine cannot keep up.


class SampleSource(Protocol):
    """Where samples come from."""

    @property
    def interval_s(self) -> float:
        """True time between samples."""
        ...

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost; ``counter`` is the number of the sample."""
        ...

    def set_rate(self, rate_hz: float) -> None:
        """Go on at another nominal rate, from the next whole sample of it since the beginning."""
        ...


class VirtualImu:
    """A simulated instrument in the hands of a simulated operator."""

    def __init__(self, imu: Imu, operator: Operator) -> None:
        self.imu = imu
        self.operator = operator
        self._next = 0

    @property
    def interval_s(self) -> float:
        """True time between samples."""
        return self.imu.interval_s

    @property
    def time_s(self) -> float:
        """True time of the next sample."""
        return self._next * self.interval_s

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost."""
        motion = self.operator.block(self._next, count, self.interval_s)
        self._next += count
        return self.imu.feed(motion)

    def set_rate(self, rate_hz: float) -> None:
        """Go on at another nominal rate, from the next whole sample of it since the beginning."""
        self._next = self.imu.set_rate(rate_hz)


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


class EmulatorCore(ABC):
    """An instrument on a wire, run by a thread from ``start`` (or ``with``) to ``stop``.

    Parameters
    ----------
    source : SampleSource
        Gives the samples.
    settings : EmulatorSettings or None
    chances : Chances
        Of faults.
    start_up_s : float
        For so long after power-on the instrument says that it is starting.
    on_progress : callable or None
        Called by the thread after each slice that sent samples.

    Raises
    ------
    UsageError
        If the speed makes no sense.
    """

    def __init__(
        self,
        source: SampleSource,
        settings: EmulatorSettings | None,
        chances: Chances,
        start_up_s: float,
        *,
        on_progress: Callable[[], None] | None,
    ) -> None:
        self.source = source
        self.settings = settings or EmulatorSettings()
        if not 0 < self.settings.speed <= MAXIMUM_SPEED:
            raise UsageError(f"speed {self.settings.speed:g} is outside 0 to {MAXIMUM_SPEED:g}; 1 is real time")
        self.samples_sent = 0
        self.failure: BaseException | None = None  # What ended the thread, if it did not end by itself.
        self._chances = chances
        asked_s = chances.common.start_up_s
        self._start_up_s = start_up_s if asked_s is None else asked_s
        self._on_progress = on_progress
        self._stopping = threading.Event()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulator", daemon=True)
        self._samples_made = 0
        self._boot_sample = 0
        self._stalled_until_s = 0.0
        self._gone_until_s = 0.0

    @property
    @abstractmethod
    def address(self) -> str:
        """What a host opens."""

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
        self._close()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the thread to end and return whether it did."""
        return self._finished.wait(timeout_s)

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.stop()

    @abstractmethod
    def _must_wait(self) -> bool:
        """Return whether to wait before power-on."""

    @abstractmethod
    def _power_on(self) -> None:
        """Begin; no sample is sent yet."""

    @abstractmethod
    def _listen(self) -> None:
        """Hear commands and answer."""

    @abstractmethod
    def _put(self, samples: Samples, duration_s: float, *, stalled: bool) -> None:
        """Encode, damage and send a block; while stalled keep it back."""

    @abstractmethod
    def _go_away(self) -> None:
        """Disconnect."""

    @abstractmethod
    def _come_back(self) -> None:
        """Connect again."""

    @abstractmethod
    def _linger(self) -> None:
        """Let who reads late have the end."""

    @abstractmethod
    def _close(self) -> None:
        """Take the port away."""

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:  # noqa: BLE001 - top of a thread: kept for whoever asks
            self.failure = error
        finally:
            self._finished.set()

    def _serve(self) -> None:
        while self._must_wait():
            if self._stopping.wait(SLICE_S):
                return
        self._power_on()
        started_s = time.monotonic()
        while not self._stopping.wait(SLICE_S):
            self._listen()
            elapsed_s = (time.monotonic() - started_s) * self.settings.speed
            while self._advance(elapsed_s):
                if self._stopping.is_set():
                    return
            if self._samples_made >= self._last_sample:
                self._linger()
                return

    def _advance(self, until_s: float) -> bool:
        """Make and send samples that are due; return whether there were any."""
        due = min(int(until_s / self.source.interval_s) + 1, self._last_sample)
        largest = math.ceil(_LARGEST_BLOCK_S / self.source.interval_s)
        count = min(due - self._samples_made, largest)
        if self._is_gone:
            # Blocks are longer on a busy machine, a disconnection is not.
            count = min(count, max(math.ceil((self._gone_until_s - self.time_s) / self.source.interval_s - _ROUNDING), 1))
        if count <= 0:
            return False
        samples = self.source.next_block(count)
        duration_s = count * self.source.interval_s
        self._samples_made += count
        self._plug(duration_s)
        self._put(self._flag_start_up(samples), duration_s, stalled=self._stalls(duration_s))
        if self._on_progress is not None:
            self._on_progress()
        return True

    def _set_rate(self, rate_hz: float) -> None:
        """Go on at another rate."""
        before_s = self.source.interval_s
        self.source.set_rate(rate_hz)
        to_new = before_s / self.source.interval_s
        self._samples_made = math.ceil(self._samples_made * to_new - _ROUNDING)
        self._boot_sample = math.ceil(self._boot_sample * to_new - _ROUNDING)

    @property
    def _last_sample(self) -> int:
        """Number of samples after which the time is over."""
        duration_s = self.settings.duration_s
        return sys.maxsize if duration_s is None else round(duration_s / self.source.interval_s)

    def _flag_start_up(self, samples: Samples) -> Samples:
        starting = samples.counter < self._boot_sample + self._start_up_s / self.source.interval_s
        if not np.any(starting):
            return samples
        return replace(samples, status=np.where(starting, samples.status | np.uint32(Status.START_UP), samples.status))

    def _stalls(self, duration_s: float) -> bool:
        faults = self._chances.common
        if self._chances.happens("stalls", faults.stalls_per_s, duration_s):
            self._stalled_until_s = self.time_s + faults.stall_s
        return self.time_s < self._stalled_until_s

    @property
    def _is_gone(self) -> bool:
        """Whether the instrument is disconnected now."""
        return self._gone_until_s > 0

    def _plug(self, duration_s: float) -> None:
        """Disconnect and connect again as the faults have it."""
        if not self._is_gone:
            if self._chances.disconnects(self.time_s, duration_s):
                self._gone_until_s = self.time_s + self._chances.common.disconnect_s
                self._go_away()
        elif self.time_s - duration_s >= self._gone_until_s - _ROUNDING * self.source.interval_s:
            self._gone_until_s = 0.0
            self._come_back()
