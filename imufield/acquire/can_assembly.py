"""Which frames of a bus make one sample.

Either by order: a sample begins with one kind of frame, and what follows within a limit and before the next beginning belongs
to it. Or by counter: frames that carry the same count, near each other in time. A frame that belongs to no sample (its
beginning was lost, or it came twice) is left out and counted; a sample of which a frame was lost stays, with what is there.

Where the protocol does not say which kind comes first, the pauses of the bus do: an instrument sends the frames of one sample
together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.can_protocol import AssemblyRule
from imufield.samples import FloatArray, IntArray

NO_FRAME = -1
_LEARN_FRAMES = 24
"""Frames of sample kinds from which the order is learned; 0.12 s of two messages at 100 Hz."""
_OPEN_FRAMES = 4096
"""A sample that so many frames could not complete is closed, whatever the time stamps say: memory stays bounded."""
_LATE_FRAMES = 32
"""By counter: how many frames of samples a frame may come late or early where time stamps tell nothing."""
_PERIOD_PART = 0.75
_USUAL_PART = 0.7
"""A kind that may begin samples comes at least this often, compared with the most frequent one."""


@dataclass(frozen=True, slots=True)
class SampleFrames:
    """The frames of a block that carry parts of samples, in the order of the bus."""

    kind: NDArray[np.int64]
    """Number of the kind. Shape (n,)."""
    time_s: FloatArray
    """Shape (n,)."""
    same_as_before: NDArray[np.bool_]
    """Whether the data are those of the frame before. Shape (n,)."""
    group: IntArray | None = None
    """Shared counter, where there is one. Shape (n,)."""

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True, slots=True)
class Groups:
    """The frames of m samples.

    Attributes
    ----------
    rows : ndarray of int64, shape (m, kinds)
        Place of each frame among the sample frames, ``NO_FRAME`` where one is missing.
    left_out : int
        Frames that belong to no sample.
    keep_from : int
        Frames from here on must be given again, in front of the next.
    """

    rows: IntArray
    left_out: int
    keep_from: int


class Assembler:
    """Groups frames into samples, block by block.

    Parameters
    ----------
    rule : AssemblyRule
    kinds : int
        Number of kinds.
    may_begin : sequence of bool
        Which kinds carry inertial values.
    """

    def __init__(self, rule: AssemblyRule, kinds: int, may_begin: list[bool]) -> None:
        self._rule = rule
        self._kinds = kinds
        self._may_begin = np.array(may_begin)
        self._start = 0 if kinds == 1 else rule.starts_with
        self._limit_s = rule.limit_s
        self._learned = kinds == 1 or (self._start is not None and self._limit_s > 0)
        self._done = 0
        """By counter: samples given out of those that begin with the first frames of the next block."""

    def group(self, frames: SampleFrames, *, last: bool = False) -> Groups:
        """Return the samples that are settled now.

        Parameters
        ----------
        frames : SampleFrames
            Those kept from the call before, then the new ones.
        last : bool
            Nothing will follow.
        """
        if not self._learned:
            if len(frames) < _LEARN_FRAMES and not last:
                return Groups(np.empty((0, self._kinds), dtype=np.int64), 0, 0)
            self._learn(frames)
        if self._kinds == 1:
            return Groups(np.arange(len(frames))[:, np.newaxis], 0, len(frames))
        groups = self._by_order(frames, last) if frames.group is None else self._by_counter(frames, frames.group, last)
        lacking = np.zeros(len(groups.rows), dtype=np.bool_)
        for kind in self._rule.needs:
            lacking |= groups.rows[:, kind] == NO_FRAME
        return groups if not lacking.any() else Groups(groups.rows[~lacking], groups.left_out, groups.keep_from)

    def _learn(self, frames: SampleFrames) -> None:
        """Find the kind that comes after the longest pauses, and the period."""
        self._learned = True
        if len(frames) == 0:
            return
        counts = np.bincount(frames.kind, minlength=self._kinds)
        if self._start is None:
            pause_s = np.diff(frames.time_s, prepend=frames.time_s[0])
            total_s = np.bincount(frames.kind, weights=pause_s, minlength=self._kinds)
            usual = (counts >= _USUAL_PART * counts.max()) & self._may_begin
            usual = usual if usual.any() else counts > 0
            # Where stamps tell nothing all pauses are equal, and the kind seen first is as good as any.
            best = np.where(usual, total_s / np.maximum(counts, 1), -1.0)
            first = [int(kind) for kind in frames.kind if best[kind] >= best.max()]
            self._start = first[0] if first else int(np.argmax(best))
        if not self._limit_s:
            number = max(int(counts[self._start]) - 1, 1)
            self._limit_s = _PERIOD_PART * max(float(frames.time_s[-1] - frames.time_s[0]), 0.0) / number

    def _by_order(self, frames: SampleFrames, last: bool) -> Groups:
        kind, time_s = frames.kind, frames.time_s
        is_start = kind == self._start
        # The same frame twice in a row, at once: sent again, or doubled on the way.
        doubled = is_start & frames.same_as_before
        doubled[1:] &= is_start[:-1] & (np.diff(time_s) <= self._limit_s)
        doubled[:1] = False
        starts = np.flatnonzero(is_start & ~doubled)
        rows = np.full((len(starts), self._kinds), NO_FRAME)
        used = len(starts)
        if used:
            rows[:, self._start] = starts
        for other in range(self._kinds):
            if other != self._start and used:
                rows[:, other] = self._first_behind(np.flatnonzero(kind == other), starts, time_s)
        settled = len(starts) if last else self._settled(rows, frames)
        keep_from = int(starts[settled]) if settled < len(starts) else len(frames)
        taken = int(np.count_nonzero(rows[:settled] != NO_FRAME))
        return Groups(rows[:settled], keep_from - taken, keep_from)

    def _first_behind(self, places: IntArray, starts: IntArray, time_s: FloatArray) -> IntArray:
        """Return for each start the first of ``places`` before the next start and within the limit."""
        found = np.full(len(starts), NO_FRAME)
        sample = np.searchsorted(starts, places) - 1
        behind = sample >= 0
        places, sample = places[behind], sample[behind]
        near = time_s[places] - time_s[starts[sample]] <= self._limit_s
        places, sample = places[near], sample[near]
        # Written backwards, so that the first of several stays.
        found[sample[::-1]] = places[::-1]
        return found

    def _settled(self, rows: IntArray, frames: SampleFrames) -> int:
        """Return how many samples nothing can be added to: all but the last, and that too if it is complete or too old."""
        if not len(rows):
            return 0
        if (rows[-1] != NO_FRAME).all():
            return len(rows)
        begin = int(rows[-1, self._start])
        old = frames.time_s[-1] - frames.time_s[begin] > self._limit_s or len(frames) - begin > _OPEN_FRAMES
        return len(rows) if old else len(rows) - 1

    def _by_counter(self, frames: SampleFrames, group: IntArray, last: bool) -> Groups:
        starts = np.flatnonzero(frames.kind == self._start)
        repeated = np.zeros(len(starts), dtype=np.bool_)
        repeated[1:] = np.diff(group[starts]) == 0
        starts = starts[~repeated]
        rows = np.full((len(starts), self._kinds), NO_FRAME)
        rows[:, self._start] = starts
        for other in range(self._kinds):
            if other != self._start:
                rows[:, other] = self._same_count(np.flatnonzero(frames.kind == other), starts, group, frames.time_s)
        settled = len(starts) if last else self._settled_by_counter(rows, frames)
        fresh = rows[min(self._done, settled) : settled]
        # Frames may still come that belong to a sample before; those given out already are remembered by their number.
        open_from = int(starts[settled]) if settled < len(starts) else len(frames)
        keep_from = len(frames) if last else max(0, open_from - _LATE_FRAMES)
        self._done = settled - int(np.searchsorted(starts[:settled], keep_from))
        taken = int(np.count_nonzero((rows[:settled] != NO_FRAME) & (rows[:settled] < keep_from)))
        return Groups(fresh, keep_from - taken, keep_from)

    def _same_count(self, places: IntArray, starts: IntArray, group: IntArray, time_s: FloatArray) -> IntArray:
        """Return for each start the nearest of ``places`` with its count, within the limit."""
        found = np.full(len(starts), NO_FRAME)
        if not len(places) or not len(starts):
            return found
        # One number that orders by count first and by place second.
        span = int(max(places[-1], starts[-1])) + 1
        key = np.sort(group[places] * span + places)
        wanted = group[starts] * span + starts
        at = np.searchsorted(key, wanted)
        for side in (np.minimum(at, len(key) - 1), np.maximum(at - 1, 0)):
            place = key[side] % span
            good = (key[side] // span == group[starts]) & (np.abs(time_s[place] - time_s[starts]) <= self._limit_s)
            nearer = good & ((found == NO_FRAME) | (np.abs(place - starts) < np.abs(found - starts)))
            found = np.where(nearer, place, found)
        return found

    def _settled_by_counter(self, rows: IntArray, frames: SampleFrames) -> int:
        if not len(rows):
            return 0
        begin = rows[:, self._start]
        complete = (rows != NO_FRAME).all(axis=1)
        old = (frames.time_s[-1] - frames.time_s[begin] > self._limit_s) | (len(frames) - begin > _LATE_FRAMES)
        open_ones = np.flatnonzero(~(complete | old))
        return int(open_ones[0]) if len(open_ones) else len(rows)
