"""A stream of CAN frames in blocks of arrays, without a loop; how one frame stands in it says ``can_frame``."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.can_frame import (
    CONTINUATION,
    FIRST_BYTES,
    FURTHER_BYTES,
    MARK,
    MOST_DATA,
    REMOTE,
    UNIT_BYTES,
    Frame,
)
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray, every

_MARK_BYTES = MARK.to_bytes(2, "little")
_MARK_AT = 6
LATEST_S = 1e11
"""In the year 5138, if seconds since 1970."""

Units = NDArray[np.uint8]


@dataclass(slots=True, kw_only=True)  # One for each read: a frozen one takes five times as long to make.
class CanFrames:
    """n frames as arrays."""

    can_id: NDArray[np.uint32]
    """With ``EXTENDED``, ``REMOTE`` and ``ERROR``. Shape (n,)."""
    size: Units
    """Data bytes. Shape (n,)."""
    flags: Units
    """Shape (n,)."""
    time_s: FloatArray
    """Shape (n,)."""
    units: Units
    """All units of the block, shape (m, 24)."""
    unit: IntArray
    """Which of them is the first of each frame. Shape (n,)."""

    def __len__(self) -> int:
        return len(self.can_id)

    def data(self, which: IntArray, width: int) -> Units:
        """Return the first ``width`` data bytes of some frames, shape (k, width); zero where a frame has fewer.

        Parameters
        ----------
        which : ndarray of int64, shape (k,)
            Numbers of the frames.
        width : int
            At most 8 gives 8, anything above 64.
        """
        first = which if len(self) == len(self.units) else self.unit[which]
        if width <= FIRST_BYTES:
            # One number of 8 bytes for each frame is gathered several times faster than 8 of one.
            return np.asarray(self.units.view(np.uint64)[first, 2].view(np.uint8).reshape(-1, FIRST_BYTES))
        rows = np.zeros((len(which), FIRST_BYTES + 3 * FURTHER_BYTES), dtype=np.uint8)
        rows[:, :FIRST_BYTES] = self.units[first, 16:]
        for number in range(3):
            at = FIRST_BYTES + number * FURTHER_BYTES
            long = self.size[which] > at
            rows[long, at : at + FURTHER_BYTES] = self.units[first[long] + 1 + number, 4:]
        return rows[:, :MOST_DATA]


class Unpacker:
    """Cuts a stream of packed frames into blocks, however it is cut into reads.

    What is no frame is passed over and counted in ``bytes_skipped``.
    """

    def __init__(self) -> None:
        self.bytes_skipped = 0
        self._rest = b""

    def feed(self, data: bytes, *, last: bool = False) -> CanFrames:
        """Return the frames that are whole now.

        Parameters
        ----------
        data : bytes
        last : bool
            Nothing will follow: what cannot be completed counts as skipped.
        """
        data = self._rest + data if self._rest else data
        units = _units_of(data)
        is_first = _first_units(units)
        if is_first is None:
            data = self._only_units(data)
            units = _units_of(data)
            is_first = _first_units(units)
        whole = len(units) if last else _whole_units(units)
        self._rest = data[whole * UNIT_BYTES :]
        if last:
            self.bytes_skipped += len(self._rest)
            self._rest = b""
        first = np.arange(whole) if is_first is None else is_first[:whole].nonzero()[0]
        return self._frames(units[:whole], first)

    def put_back(self, frames: CanFrames, first: int) -> None:
        """Take frames from ``first`` on back: the next call of ``feed`` returns them again."""
        if len(frames) == len(frames.units):
            self._rest = frames.units[first:].tobytes() + self._rest
            return
        lengths = 1 + _further_units(frames.size[first:])
        pieces = (frames.units[at : at + length] for at, length in zip(frames.unit[first:], lengths, strict=True))
        self._rest = b"".join(piece.tobytes() for piece in pieces) + self._rest

    def _frames(self, units: Units, first: IntArray) -> CanFrames:
        """Return the frames whose first units are these, if as many follow as their length needs; others lost some."""
        if len(first) and (len(first) < len(units) or not every(units[:, 4] <= FIRST_BYTES)):
            follow = np.diff(np.append(first, len(units))) - 1
            good = follow == _further_units(units[first, 4])
            self.bytes_skipped += int(UNIT_BYTES * (len(units) - np.sum(1 + follow[good])))
            first = first[good]
        # Where every unit begins a frame, which is nearly always so, the arrays are views.
        rows = slice(None) if len(first) == len(units) else first
        return CanFrames(
            can_id=units.view("<u4")[rows, 0],
            size=units[rows, 4],
            flags=units[rows, 5],
            time_s=_possible(units.view("<f8")[rows, 1]),
            units=units,
            unit=first,
        )

    def _only_units(self, data: bytes) -> bytes:
        """Keep what looks like units; step byte by byte over the rest until a mark stands where one should."""
        kept, at = [], 0
        while at + UNIT_BYTES <= len(data):
            is_first = data[at + _MARK_AT : at + _MARK_AT + 2] == _MARK_BYTES and data[at + 4] <= MOST_DATA
            if is_first or data[at : at + 4] == CONTINUATION.to_bytes(4, "little"):
                kept.append(data[at : at + UNIT_BYTES])
                at += UNIT_BYTES
                continue
            mark = data.find(_MARK_BYTES, at + _MARK_AT + 1)
            until = mark - _MARK_AT if mark >= 0 else max(len(data) - UNIT_BYTES + 1, at + 1)
            self.bytes_skipped += until - at
            at = until
        return b"".join(kept) + data[at:]


def _units_of(data: bytes) -> Units:
    end = len(data) - len(data) % UNIT_BYTES
    return np.frombuffer(data, dtype=np.uint8, count=end).reshape(-1, UNIT_BYTES)


def _possible(time_s: FloatArray) -> FloatArray:
    """Replace time stamps that are none, which a damaged recording may hold, by the one before."""
    good = np.abs(time_s) < LATEST_S
    if every(good):
        return time_s
    place = np.maximum.accumulate(np.where(good, np.arange(len(time_s)), -1))
    return np.where(place >= 0, time_s[place], 0.0)


def _first_units(units: Units) -> NDArray[np.bool_] | None:
    """Return which units begin a frame, the others going on with one; None where some do neither."""
    is_first: NDArray[np.bool_] = (units.view("<u2")[:, 3] == MARK) & (units[:, 4] <= MOST_DATA)
    if every(is_first) or every(units.view("<u4")[~is_first, 0] == CONTINUATION):
        return is_first
    return None


def _further_units(size: Units) -> IntArray:
    return np.maximum(size.astype(np.int64) - FIRST_BYTES + FURTHER_BYTES - 1, 0) // FURTHER_BYTES


def _whole_units(units: Units) -> int:
    """Return how many units belong to frames that are complete."""
    if not len(units) or (units[-1, 4] <= FIRST_BYTES and units[-1, 3] != CONTINUATION >> 24):
        return len(units)
    tail = units[-4:]
    words = tail.view("<u4")[:, 0]
    for back in range(1, len(tail) + 1):
        if words[-back] != CONTINUATION:
            needed = 1 + int(_further_units(tail[-back : len(tail) - back + 1, 4])[0])
            return len(units) - back if needed > back else len(units)
    return len(units)


def unpack_frames(data: bytes) -> Iterator[Frame]:
    """Yield the frames of packed bytes one by one."""
    frames = Unpacker().feed(data, last=True)
    rows = frames.data(np.arange(len(frames)), int(frames.size.max(initial=0)))
    numbers = (frames.can_id.tolist(), frames.size.tolist(), frames.time_s.tolist(), frames.flags.tolist())
    for row, can_id, size, time_s, flags in zip(rows, *numbers, strict=True):
        yield Frame(can_id, b"" if can_id & REMOTE else row[:size].tobytes(), time_s, flags)
