"""A virtual instrument on a CAN bus: real frames, real rate times ``speed``, with faults on request.

::

    with CanEmulator(load_protocol("j1939_imu"), source, "udp_multicast:239.0.0.1") as emulator:
        opened = open_can(emulator.bus, driver="aceinna_can")

``virtual:NAME`` stays inside one process. Between processes take ``udp_multicast:GROUP``, or ``slcan``: the emulator then plays
an adapter on a pseudo-terminal, and ``emulator.bus`` names it.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol as Interface
from typing import Self

import can
import numpy as np

from imufield.acquire.can_frames import ERROR, EXTENDED, Frame
from imufield.acquire.can_link import make_message, open_bus, parse_bus
from imufield.acquire.protocol import Protocol
from imufield.errors import UsageError
from imufield.samples import Samples, Status
from imufield.simulate.can_encode import CanEncoder
from imufield.simulate.emulator import LINGER_S, MAXIMUM_SPEED, EmulatorSettings, Source
from imufield.simulate.port import PseudoTerminal
from imufield.simulate.slcan import SlcanDevice

SLCAN = "slcan"
SLICE_S = 0.005
_LARGEST_BLOCK_S = 1.0
_ERROR_BURST = 16
"""Error frames before a node leaves the bus: each adds 8 to its error counter, which gives up at 256."""
_REQUEST_PF = 0xEA
_VERSION = {"VersionMajor": 19, "VersionMinor": 1, "VersionPatch": 51, "VersionStage": 0, "VersionBuild": 3}


@dataclass(frozen=True, slots=True)
class CanFaults:
    """Chances and rates of faults; rates are per second of the instrument's time."""

    lost_frame_probability: float = 0.0
    doubled_frame_probability: float = 0.0
    reordered_frame_probability: float = 0.0
    """Of a frame to change places with the next."""
    wrong_dlc_probability: float = 0.0
    """Of a frame to lose its last bytes."""
    not_available_probability: float = 0.0
    """Of a sample to have no values."""
    error_frames_per_s: float = 0.0
    counter_jumps_per_s: float = 0.0
    bus_off_at_s: tuple[float, ...] = ()
    """The instrument leaves the bus after a burst of error frames ..."""
    bus_off_s: float = 1.0
    """... and is back after this time."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            limit = 1.0 if field.name.endswith("_probability") else np.inf
            if not np.all((np.asarray(value) >= 0) & (np.asarray(value) <= limit)):
                raise UsageError(
                    f"fault {field.name} = {value} is outside 0 to {limit:g}; give a value inside", fault=field.name
                )


class CanFaultInjector:
    """Draws faults and damages frames; ``counts`` holds how often each happened."""

    def __init__(self, faults: CanFaults, seed: int) -> None:
        self.faults = faults
        self.counts: Counter[str] = Counter()
        self._rng = np.random.default_rng([seed, 302])
        self._off_at_s = sorted(faults.bus_off_at_s)
        self._back_s = 0.0

    def damage(self, frames: list[Frame], time_s: float, duration_s: float) -> list[Frame]:
        """Return the frames as they are on the bus in the ``duration_s`` before ``time_s``."""
        faults = self.faults
        if self._is_off(time_s):
            self.counts["frames_while_off"] += len(frames)
            return []
        damaged: list[Frame] = []
        for frame in frames:
            if self._happens("lost_frames", faults.lost_frame_probability):
                continue
            if frame.data and self._happens("wrong_dlcs", faults.wrong_dlc_probability):
                frame = replace(frame, data=frame.data[: int(self._rng.integers(len(frame.data)))])  # noqa: PLW2901
            damaged.append(frame)
            if self._happens("doubled_frames", faults.doubled_frame_probability):
                damaged.append(frame)
            elif len(damaged) > 1 and self._happens("reordered_frames", faults.reordered_frame_probability):
                damaged[-2:] = damaged[:-3:-1]
        if self._happens("error_frames", min(faults.error_frames_per_s * duration_s, 1.0)):
            damaged.append(_error_frame(time_s))
        if self._off_at_s and self._off_at_s[0] <= time_s:
            self._off_at_s.pop(0)
            self._back_s = time_s + faults.bus_off_s
            self.counts["bus_offs"] += 1
            damaged += [_error_frame(time_s)] * _ERROR_BURST
        return damaged

    def unavailable(self, count: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return which of ``count`` samples have no values."""
        hit: np.ndarray[tuple[int], np.dtype[np.bool_]] = self._rng.random(count) < self.faults.not_available_probability
        self.counts["not_available"] += int(np.count_nonzero(hit))
        return hit

    def counter_jump(self, duration_s: float) -> int:
        """Return by how much the counter jumps; mostly 0."""
        jumps = self._happens("counter_jumps", min(self.faults.counter_jumps_per_s * duration_s, 1.0))
        return int(self._rng.integers(1, 256)) if jumps else 0

    def _is_off(self, time_s: float) -> bool:
        return time_s < self._back_s

    def _happens(self, name: str, probability: float) -> bool:
        if probability == 0 or self._rng.random() >= probability:
            return False
        self.counts[name] += 1
        return True


def _error_frame(time_s: float) -> Frame:
    # Protocol violation in the frame, as Linux reports it (include/uapi/linux/can/error.h).
    return Frame(ERROR | 0x08, bytes(8), time_s)


class _Port(Interface):
    """What frames are handed to."""

    bus: str

    def send(self, frames: list[Frame]) -> None: ...

    def receive(self) -> list[Frame]: ...

    def has_reader(self) -> bool: ...

    def close(self) -> None: ...


class _BusPort:
    """A bus of python-can."""

    def __init__(self, bus: str) -> None:
        self.bus = bus
        self._bus = open_bus(parse_bus(bus))

    def send(self, frames: list[Frame]) -> None:
        for frame in frames:
            message = make_message(frame.can_id, frame.data, frame.flags)
            message.timestamp = frame.time_s
            # Nobody may be there to take it.
            with contextlib.suppress(can.CanError):
                self._bus.send(message)

    def receive(self) -> list[Frame]:
        frames = []
        while (message := self._bus.recv(0)) is not None:
            extended = EXTENDED if message.is_extended_id else 0
            frames.append(Frame(message.arbitration_id | extended, bytes(message.data)))
        return frames

    def has_reader(self) -> bool:
        return True

    def close(self) -> None:
        self._bus.shutdown()


class _SlcanPort:
    """An adapter on a pseudo-terminal."""

    def __init__(self, link: Path | None) -> None:
        self._device = SlcanDevice(PseudoTerminal(link))
        self.bus = f"{SLCAN}:{self._device.port.port}"

    def send(self, frames: list[Frame]) -> None:
        self._device.send(frames)

    def receive(self) -> list[Frame]:
        return self._device.receive()

    def has_reader(self) -> bool:
        self._device.receive()
        return self._device.is_open

    def close(self) -> None:
        self._device.close()


class CanEmulator:
    """An instrument on a bus, run by a thread from ``start`` (or ``with``) to ``stop``.

    Parameters
    ----------
    protocol : Protocol
        Of kind "can".
    source : Source
        Gives the samples, in the units of the protocol.
    bus : str
        ``INTERFACE:CHANNEL``, or ``slcan`` for an adapter on a pseudo-terminal.
    settings : EmulatorSettings, optional
    faults : CanFaults, optional
    seed : int
        Of the faults.
    on_progress : callable, optional
        Called by the thread after each slice that sent samples.

    Raises
    ------
    UsageError
        If the speed or the bus makes no sense.
    LinkError
        If the bus cannot be opened.
    """

    def __init__(
        self,
        protocol: Protocol,
        source: Source,
        bus: str,
        settings: EmulatorSettings | None = None,
        *,
        faults: CanFaults | None = None,
        seed: int = 0,
        on_progress: Callable[[], None] | None = None,
    ) -> None:
        self.settings = settings or EmulatorSettings()
        if not 0 < self.settings.speed <= MAXIMUM_SPEED:
            raise UsageError(f"speed {self.settings.speed:g} is outside 0 to {MAXIMUM_SPEED:g}; 1 is real time")
        self.encoder = CanEncoder(protocol)
        self.source = source
        self.injector = CanFaultInjector(faults or CanFaults(), seed)
        self.samples_sent = 0
        self.frames_sent = 0
        self.failure: BaseException | None = None
        """What ended the thread, if it did not end by itself."""
        self._on_progress = on_progress
        self._messages = {
            message.can_id >> 8 & 0x3FFFF: message.name for message in (protocol.can.messages if protocol.can else ())
        }
        self._port: _Port = _SlcanPort(self.settings.link) if bus == SLCAN else _BusPort(bus)
        self._stopping = threading.Event()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="can-emulator", daemon=True)
        self._samples_made = 0
        self._start_wall_s = 0.0

    @property
    def bus(self) -> str:
        """What a host opens."""
        return self._port.bus

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
        """End the thread and leave the bus; once is enough, more do no harm."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._port.close()

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
        # An adapter hands out nothing before its channel is open, so it always waits for that.
        must_wait = self.settings.wait_for_reader or isinstance(self._port, _SlcanPort)
        while must_wait and not self._port.has_reader():
            if self._stopping.wait(SLICE_S):
                return
        started_s, self._start_wall_s = time.monotonic(), time.time()
        while not self._stopping.wait(SLICE_S):
            self._answer(self._port.receive())
            elapsed_s = (time.monotonic() - started_s) * self.settings.speed
            while self._advance(elapsed_s):
                if self._stopping.is_set():
                    return
            if self._samples_made == self._last_sample:
                self._stopping.wait(LINGER_S)
                return

    def _advance(self, until_s: float) -> bool:
        """Make and send samples that are due; return whether there were any."""
        due = min(int(until_s / self.source.interval_s) + 1, self._last_sample)
        largest = math.ceil(_LARGEST_BLOCK_S / self.source.interval_s)
        count = min(due - self._samples_made, largest)
        if count <= 0:
            return False
        self._send(self.source.next_block(count), count * self.source.interval_s)
        self._samples_made += count
        return True

    @property
    def _last_sample(self) -> int:
        duration_s = self.settings.duration_s
        return sys.maxsize if duration_s is None else round(duration_s / self.source.interval_s)

    def _send(self, samples: Samples, duration_s: float) -> None:
        self.encoder.counter_offset += self.injector.counter_jump(duration_s)
        unavailable = self.injector.unavailable(len(samples))
        if unavailable.any():
            invalid = np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)
            samples = replace(samples, status=np.where(unavailable, samples.status | invalid, samples.status))
        frames = [
            replace(one.frame, time_s=self._start_wall_s + one.frame.time_s / self.settings.speed)
            for one in self.encoder.encode(samples)
        ]
        sent = self.injector.damage(frames, self.time_s + duration_s, duration_s)
        self._port.send(sent)
        self.samples_sent += len(samples)
        self.frames_sent += len(sent)
        if self._on_progress is not None:
            self._on_progress()

    def _answer(self, frames: list[Frame]) -> None:
        """Answer J1939 requests for the messages this instrument has."""
        for frame in frames:
            if frame.can_id & EXTENDED and frame.can_id >> 16 & 0xFF == _REQUEST_PF and len(frame.data) >= 3:
                name = self._messages.get(int.from_bytes(frame.data[:3], "little"))
                if name is not None:
                    self._port.send([self.encoder.frame(name, _VERSION if name == "SoftwareVersion" else {})])
