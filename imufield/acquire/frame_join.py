"""Samples that take several frames: acceleration in one, angular rate in the next.

A sample begins with one kind of frame and is complete when each kind it needs has come, before the next one begins and
without any bytes passed over in between: frames carry no number, so behind a gap nothing tells what belongs together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.assembly import RawBlock, join
from imufield.acquire.frame_schema import JoinRule

Kinds = NDArray[np.int64]
Flags = NDArray[np.bool_]


class FrameJoin:
    """Joins frames of several kinds, in the order of the stream.

    Parameters
    ----------
    rule : JoinRule
    """

    def __init__(self, rule: JoinRule) -> None:
        self.kinds = rule.needs
        """Kinds that take part; their place here is their number."""
        self._start = rule.needs.index(rule.starts_with)
        self._open: tuple[Kinds, RawBlock] | None = None
        """Frames of a sample that is not complete yet, at most one of each kind."""
        self._lost = 0
        """Samples that were not completed since the last good one."""
        self._was_complete = False
        """Whether the newest frame belongs to a complete sample."""

    def add(self, kinds: Kinds, block: RawBlock) -> RawBlock | None:
        """Return the samples that are complete now.

        Parameters
        ----------
        kinds : ndarray, shape (n,)
            Number of the kind of each frame.
        block : RawBlock
            What each of the n frames has; NaN for what it has not.
        """
        carried = 0
        if self._open is not None:
            carried = len(self._open[0])
            kinds, block = np.concatenate([self._open[0], kinds]), join([self._open[1], block])
            self._open = None
        begins = kinds == self._start
        gaps = (block.skipped_before > 0) & ~begins
        # The gap before frames carried over was taken note of when they came.
        gaps[:carried] = False
        group = np.cumsum(begins | gaps)
        group -= group[0]
        rows = self._first_of_each(kinds, group)
        begun, behind_gap = np.zeros((2, len(rows)), dtype=np.bool_)
        begun[group[begins]] = True
        behind_gap[group[gaps]] = True
        complete = begun & (rows >= 0).all(axis=1)
        if begun[-1] and not complete[-1]:
            last = np.flatnonzero(group == group[-1])
            self._open = (kinds[last], block[last])
        lost = self._count_lost(begun, behind_gap, complete)
        return self._samples(block, rows[complete], lost) if complete.any() else None

    def _first_of_each(self, kinds: Kinds, group: Kinds) -> Kinds:
        """Return the row of the first frame of each kind in each group, -1 where there is none; shape (groups, kinds)."""
        rows = np.full((int(group[-1]) + 1, len(self.kinds)), -1, dtype=np.int64)
        rows[group[::-1], kinds[::-1]] = np.arange(len(kinds))[::-1]
        return rows

    def _count_lost(self, begun: Flags, behind_gap: Flags, complete: Flags) -> Kinds:
        """Return how many samples were lost before each complete one, and keep the count of those behind the last."""
        state = complete.copy()
        state[0] |= self._was_complete & ~(begun[0] | behind_gap[0])
        previous = np.append(self._was_complete, state[:-1])
        # What follows a gap without a beginning is the rest of the sample before, unless that one was complete.
        failed = (begun & ~complete) | (behind_gap & previous)
        if self._open is not None:
            failed[-1] = False
        self._was_complete = bool(state[-1])
        total = np.cumsum(failed) + self._lost
        at = np.flatnonzero(complete)
        lost: Kinds = np.diff(total[at], prepend=0) if len(at) else np.empty(0, dtype=np.int64)
        self._lost = int(total[-1] - (total[at[-1]] if len(at) else 0))
        return lost

    def _samples(self, block: RawBlock, rows: Kinds, lost: Kinds) -> RawBlock:
        first = block[rows[:, self._start]]
        last = rows.max(axis=1)
        accelerometer, gyroscope, temperature = first.accelerometer, first.gyroscope, first.temperature_degc
        status, ticks = first.status, first.ticks
        for kind in range(len(self.kinds)):
            other = block[rows[:, kind]]
            accelerometer = np.where(np.isnan(accelerometer), other.accelerometer, accelerometer)
            gyroscope = np.where(np.isnan(gyroscope), other.gyroscope, gyroscope)
            temperature = np.where(np.isnan(temperature), other.temperature_degc, temperature)
            status = status | other.status
        return replace(
            first,
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            temperature_degc=temperature,
            status=status,
            ticks=ticks,
            lost_before=lost,
            skipped_before=lost.astype(np.float64),
            stream_end=block.stream_end[last],
        )
