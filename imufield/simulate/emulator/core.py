"""The thread that runs a virtual instrument on any wire: it makes the samples that are due and sends them.

The thread wakes every few milliseconds of the monotonic clock. It never waits for a reader. The classes derived from
``EmulatorCore`` do what differs from wire to wire: how samples become bytes or frames, and what a port is.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from imufield.dataclass import dataclass, replace
from imufield.errors import UsageError
from imufield.samples import Samples, Status
from imufield.sentences import Sentences
from imufield.simulate.emulator.faults import Chances
from imufield.simulate.truth.virtual_imu import SampleSource

sentence = Sentences(__package__)

SLICE_S = 0.008
"""Wall time between writes: short against the 20 ms a reader gathers, long against the cost of a wake-up."""
MAXIMUM_SPEED = 1000.0
LINGER_S = 0.5
"""The port outlives the last sample by this."""
_ROUNDING = 1e-6  # Of a sample number at another rate.
_PACE_OVER_S = 1.0  # Wall time over which the pace is measured: far above a write, so that its grain does not count.
_SLOW_FOR_S = 5.0  # A machine that stops for a moment catches up, one that is slow for so long does not.
_SLOW_BELOW = 0.95  # Of the speed asked for; a capture takes such a lag for lost samples.
_LARGEST_BLOCK_S = 1.0  # Instrument's time made at once after a delay; keeps stop() prompt when the machine cannot keep up.


@dataclass(frozen=True, slots=True)
class EmulatorSettings:
    """How the emulator runs.

    Raises
    ------
    UsageError
        If the speed makes no sense.
    """

    speed: float = 1.0
    """Times real time."""
    wait_for_reader: bool = False
    """Power on only when a host opens the port."""
    duration_s: float | None = None
    """Time of the instrument after which it stops sending."""
    link: Path | None = None
    """Symbolic link to the port."""

    def __post_init__(self) -> None:
        if not 0 < self.speed <= MAXIMUM_SPEED:
            raise UsageError(sentence("core.speed", speed=self.speed, limit=MAXIMUM_SPEED))


class Port(Protocol):
    """The instrument's end of a wire."""

    @property
    def address(self) -> str:
        """What a host opens."""
        ...

    @property
    def share_taken(self) -> float:
        """Of what was sent to a host, the part that it did not lose by taking it too late."""
        ...

    def has_reader(self) -> bool:
        """Return whether a host is there."""
        ...

    def close(self) -> None:
        """Take the port away."""


class PaceWatch:
    """Finds out that an emulated instrument is slower than asked, for seconds on end.

    Parameters
    ----------
    speed : float
        Times real time, as asked.

    Attributes
    ----------
    reached : float or None
        Times real time, as measured when it had been slow for too long; None while it has not.
    """

    def __init__(self, speed: float) -> None:
        self.reached: float | None = None
        self._speed = speed
        self._checked_s = self._delivered_s = self._slow_s = 0.0

    def check(self, wall_s: float, delivered_s: float) -> None:
        """Take the wall time since power-on, and for how much of the instrument's time samples were delivered."""
        span_s = wall_s - self._checked_s
        if span_s < _PACE_OVER_S:
            return
        reached = (delivered_s - self._delivered_s) / span_s
        self._checked_s, self._delivered_s = wall_s, delivered_s
        self._slow_s = max(self._slow_s + (span_s if reached < _SLOW_BELOW * self._speed else -span_s), 0.0)
        if self._slow_s >= _SLOW_FOR_S:
            self.reached = max(reached, 0.0)


class EmulatorCore(ABC):
    """An instrument on a wire, run by a thread from ``start`` (or ``with``) to ``stop``.

    Parameters
    ----------
    source : SampleSource
        Gives the samples.
    settings : EmulatorSettings
    port : Port
    chances : Chances
        Of faults.
    start_up_s : float
        Time after power-on in which samples are flagged as those of an instrument that starts.

    Attributes
    ----------
    on_progress : callable or None
        Called by the thread after each slice that sent samples; set before ``start``.
    """

    def __init__(
        self, source: SampleSource, settings: EmulatorSettings, port: Port, chances: Chances, *, start_up_s: float = 0.0
    ) -> None:
        self.source = source
        self.settings = settings
        self.on_progress: Callable[[], None] | None = None
        self.samples_sent = 0
        self.pace = PaceWatch(settings.speed)
        self.failure: BaseException | None = None  # What ended the thread, if it did not end by itself.
        self._chances = chances
        asked_s = chances.common.start_up_s
        self._start_up_s = start_up_s if asked_s is None else asked_s
        self._port = port
        self._waits = settings.wait_for_reader
        self._stopping = threading.Event()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulator", daemon=True)
        self._samples_made = 0
        self._boot_sample = 0
        self._stalled_until_s = 0.0
        self._gone_until_s = 0.0

    @property
    def address(self) -> str:
        """What a host opens."""
        return self._port.address

    @property
    def time_s(self) -> float:
        """Instrument's time since power-on."""
        return self._samples_made * self.source.interval_s

    @property
    def is_read(self) -> bool:
        """Whether a host is there."""
        return self._port.has_reader()

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
        self._port.close()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the thread to end and return whether it did."""
        end_s = time.monotonic() + (math.inf if timeout_s is None else timeout_s)
        # Ctrl-C inside Event.wait can leave the event's lock held: the thread would wait for it and never end.
        while not self._finished.is_set() and time.monotonic() < end_s:
            time.sleep(SLICE_S)
        return self._finished.is_set()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *error: object) -> None:
        self.stop()

    @abstractmethod
    def _power_on(self) -> None:
        """Begin; no sample is sent yet."""

    @abstractmethod
    def _listen(self) -> None:
        """Read commands and answer."""

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
        """Send what is kept back and give a late reader time to take it."""

    def _run(self) -> None:
        try:
            self._serve()
        # Raised again by who waits for the end: an error in this thread alone would pass for a stream that is over.
        except Exception as error:  # noqa: BLE001
            self.failure = error
        finally:
            self._finished.set()

    def _serve(self) -> None:
        while self._waits and not self._port.has_reader():
            if self._stopping.wait(SLICE_S):
                return
        self._power_on()
        started_s = time.monotonic()
        while not self._stopping.wait(SLICE_S):
            self._listen()
            elapsed_s = (time.monotonic() - started_s) * self.settings.speed
            # Several blocks where this thread was late; a stop is heard between them.
            while self._advance(elapsed_s):
                self.pace.check(time.monotonic() - started_s, self.time_s * self._port.share_taken)
                if self._stopping.is_set():
                    return
            if self._samples_made >= self._last_sample:
                self._linger()
                return

    def _advance(self, until_s: float) -> bool:
        """Make and send samples that are due; return whether there were any."""
        interval_s, faults, chances = self.source.interval_s, self._chances.common, self._chances
        due = min(int(until_s / interval_s) + 1, self._last_sample)
        count = min(due - self._samples_made, math.ceil(_LARGEST_BLOCK_S / interval_s))
        if self._is_gone:
            # Blocks are longer on a busy machine, a disconnection is not.
            count = min(count, max(math.ceil((self._gone_until_s - self.time_s) / interval_s - _ROUNDING), 1))
        if count <= 0:
            return False
        samples = self.source.next_block(count)
        duration_s = count * interval_s
        self._samples_made += count
        if not self._is_gone:
            if chances.disconnects(self.time_s, duration_s):
                self._gone_until_s = self.time_s + faults.disconnect_s
                self._go_away()
        elif self.time_s - duration_s >= self._gone_until_s - _ROUNDING * interval_s:
            self._gone_until_s = 0.0
            self._come_back()
        starting = samples.counter < self._boot_sample + self._start_up_s / interval_s
        if np.any(starting):
            samples = replace(samples, status=np.where(starting, samples.status | np.uint32(Status.START_UP), samples.status))
        if chances.happens("stalls", faults.stalls_per_s, duration_s):
            self._stalled_until_s = self.time_s + faults.stall_s
        self._put(samples, duration_s, stalled=self._is_stalled)
        if self.on_progress is not None:
            self.on_progress()
        return True

    def _set_rate(self, rate_hz: float) -> None:
        """Go on at another rate."""
        before_s = self.source.interval_s
        self.source.set_rate(rate_hz)
        to_new = before_s / self.source.interval_s
        # Numbers of samples, now counted at the new rate since power-on, as the source does.
        self._samples_made = math.ceil(self._samples_made * to_new - _ROUNDING)
        self._boot_sample = math.ceil(self._boot_sample * to_new - _ROUNDING)

    @property
    def _last_sample(self) -> int:
        """Number of samples after which the time is over."""
        duration_s = self.settings.duration_s
        return sys.maxsize if duration_s is None else round(duration_s / self.source.interval_s)

    @property
    def _is_stalled(self) -> bool:
        return self.time_s < self._stalled_until_s

    @property
    def _is_gone(self) -> bool:
        """Whether the instrument is disconnected now."""
        return self._gone_until_s > 0
