"""Faults of a wire, with given rates and a seed: damaged and lost bytes and frames, stalls, disconnections, counter jumps.

Faults of bytes and frames are applied to the encoded stream here. Stalls, disconnections and jumps of the counter are
drawn here and carried out by the emulator, which owns the port and the clock.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from imufield.acquire.protocol.can_frame import ERROR, Frame
from imufield.dataclass import dataclass, fields, replace
from imufield.errors import UsageError
from imufield.sentences import Sentences
from imufield.simulate.wire.frames import Bytes

sentence = Sentences(__package__)

GARBAGE_BYTES = (1, 64)
"""Length of a burst of garbage."""
_ERROR_BURST = 16  # Error frames before a node leaves the bus: each adds 8 to its error counter, which gives up at 256.


@dataclass(frozen=True, slots=True, kw_only=True)
class WireFaults:
    """Faults of any wire; rates are per second of the instrument's time."""

    stalls_per_s: float = 0.0
    stall_s: float = 0.5
    """Duration of a stall: nothing comes, then everything of that time at once."""
    counter_jumps_per_s: float = 0.0
    """Jumps of the counter by 1 to 255; where there is none, of the time stamp by as many samples."""
    disconnects_per_s: float = 0.0
    disconnect_at_s: tuple[float, ...] = ()
    """The port goes away, or the instrument leaves the bus after a burst of error frames ..."""
    disconnect_s: float = 1.0
    """... and is back after this time; what is sent meanwhile is lost."""
    start_up_s: float | None = None
    """Time after power-on in which samples are flagged as starting; None: as the instrument does."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            limit = 1.0 if field.name.endswith("_probability") else np.inf
            if value is not None and not np.all((np.asarray(value) >= 0) & (np.asarray(value) <= limit)):
                raise UsageError(sentence("faults.outside", fault=field.name, value=value, limit=limit))


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults(WireFaults):
    """Faults of a serial line: chances of bytes and frames."""

    bit_flip_probability: float = 0.0
    """Of each byte to have one bit flipped."""
    lost_byte_probability: float = 0.0
    doubled_byte_probability: float = 0.0
    wrong_checksum_probability: float = 0.0
    """Of each frame."""
    garbage_per_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CanFaults(WireFaults):
    """Faults of a CAN bus, whose controllers let no damaged frame through."""

    lost_frame_probability: float = 0.0
    doubled_frame_probability: float = 0.0
    reordered_frame_probability: float = 0.0
    """Of a frame to change places with the next."""
    wrong_dlc_probability: float = 0.0
    """Of a frame to lose its last bytes."""
    not_available_probability: float = 0.0
    """Of a sample to have no values."""
    error_frames_per_s: float = 0.0


class Chances:
    """Draws faults; ``counts`` holds how often each happened."""

    def __init__(self, faults: WireFaults, seed: list[int]) -> None:
        self.common = faults
        self.counts: Counter[str] = Counter()
        self._rng = np.random.default_rng(seed)
        self._disconnects = sorted(faults.disconnect_at_s)

    def happens(self, name: str, rate_per_s: float, duration_s: float) -> bool:
        """Draw whether a fault of a rate happens in a time that is short against its interval, and count it."""
        # For rate * time << 1 that is the chance of a Poisson process; the draw is left out where there is no fault, so that
        # a new kind of fault changes no session without it.
        if rate_per_s == 0 or self._rng.random() >= rate_per_s * duration_s:
            return False
        self.counts[name] += 1
        return True

    def disconnects(self, time_s: float, duration_s: float) -> bool:
        """Return whether the instrument goes away in the ``duration_s`` before ``time_s``."""
        if self._disconnects and self._disconnects[0] <= time_s:
            self._disconnects.pop(0)
            self.counts["disconnects"] += 1
            return True
        return self.happens("disconnects", self.common.disconnects_per_s, duration_s)

    def counter_jump(self, duration_s: float) -> int:
        """Return by how much the counter jumps; mostly 0."""
        jumps = self.happens("counter_jumps", self.common.counter_jumps_per_s, duration_s)
        return int(self._rng.integers(1, 256)) if jumps else 0

    def _draw(self, name: str, probability: float, count: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        if probability == 0:
            return np.empty(0, dtype=np.intp)
        hit = np.flatnonzero(self._rng.random(count) < probability)
        self.counts[name] += len(hit)
        return hit


class FaultInjector(Chances):
    """Damages bytes."""

    def __init__(self, faults: Faults, seed: int) -> None:
        super().__init__(faults, [seed, 301])
        self.faults = faults

    def damage(self, data: Bytes, checksum_at: np.ndarray[tuple[int], np.dtype[np.int64]], duration_s: float) -> bytes:
        """Return the stream as it arrives.

        Parameters
        ----------
        data : ndarray of uint8, shape (n,)
            Whole frames.
        checksum_at : ndarray, shape (m,)
            Place in ``data`` of a byte of the checksum of each frame.
        duration_s : float
            Time that these frames take.
        """
        faults = self.faults
        data = data.copy()
        hit = self._draw("wrong_checksums", faults.wrong_checksum_probability, len(checksum_at))
        # One wrong bit: every checksum of the protocols finds it.
        data[checksum_at[hit]] ^= np.uint8(0x01)
        hit = self._draw("bit_flips", faults.bit_flip_probability, len(data))
        data[hit] ^= np.uint8(1) << self._rng.integers(0, 8, len(hit), dtype=np.uint8)
        repeats = np.ones(len(data), dtype=np.int64)
        repeats[self._draw("doubled_bytes", faults.doubled_byte_probability, len(data))] = 2
        repeats[self._draw("lost_bytes", faults.lost_byte_probability, len(data))] = 0
        damaged = np.repeat(data, repeats).tobytes()
        if not self.happens("garbage", faults.garbage_per_s, duration_s):
            return damaged
        at = int(self._rng.integers(len(damaged) + 1))
        return damaged[:at] + self._rng.bytes(int(self._rng.integers(*GARBAGE_BYTES, endpoint=True))) + damaged[at:]


class CanFaultInjector(Chances):
    """Damages frames of a bus."""

    def __init__(self, faults: CanFaults, seed: int) -> None:
        super().__init__(faults, [seed, 302])
        self.faults = faults

    def damage(self, frames: list[Frame], time_s: float, duration_s: float) -> list[Frame]:
        """Return the frames as they are on the bus in the ``duration_s`` before ``time_s``."""
        faults = self.faults
        damaged: list[Frame] = []
        for frame in frames:
            if self.happens("lost_frames", faults.lost_frame_probability, 1.0):
                continue
            if frame.data and self.happens("wrong_dlcs", faults.wrong_dlc_probability, 1.0):
                frame = replace(frame, data=frame.data[: int(self._rng.integers(len(frame.data)))])  # noqa: PLW2901
            damaged.append(frame)
            if self.happens("doubled_frames", faults.doubled_frame_probability, 1.0):
                damaged.append(frame)
            elif len(damaged) > 1 and self.happens("reordered_frames", faults.reordered_frame_probability, 1.0):
                damaged[-2:] = damaged[:-3:-1]
        if self.happens("error_frames", faults.error_frames_per_s, duration_s):
            damaged.append(_error_frame(time_s))
        return damaged

    def unavailable(self, count: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return which of ``count`` samples have no values."""
        hit = np.zeros(count, dtype=np.bool_)
        hit[self._draw("not_available", self.faults.not_available_probability, count)] = True
        return hit


def error_burst(time_s: float) -> list[Frame]:
    """Return the error frames with which a node leaves the bus."""
    return [_error_frame(time_s)] * _ERROR_BURST


def _error_frame(time_s: float) -> Frame:
    # Protocol violation in the frame, as Linux reports it (include/uapi/linux/can/error.h).
    return Frame(ERROR | 0x08, bytes(8), time_s)
