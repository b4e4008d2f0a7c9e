"""Which frames of a bus make one sample.

Either by order: a sample begins with one kind of frame, and what follows within a limit and before the next beginning belongs
to it. Or by counter: frames that carry the same count, near each other in time. A frame that belongs to no sample (its
beginning was lost, or it came twice) is left out and counted; a sample of which a frame was lost stays, with what is there.

A kind may come at a fraction of the rate of the one that samples begin with, an angular rate with every second acceleration.
How many samples there are to one of its frames is learned with the order, so that a pause is told from a loss.

Where the protocol does not say which kind comes first, the pauses of the bus do: an instrument sends the frames of one sample
together. Where stamps show no pauses, the lowest identifier does: it wins the bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import NO_FRAME, frame_table
from imufield.acquire.protocol.can_protocol import AssemblyRule
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray, every, median

_LEARN_FRAMES = 24  # Frames of sample kinds from which the order is learned; 0.12 s of two messages at 100 Hz.
# The same, and the longest time, where the kinds come at different rates: a kind with every tenth sample comes eight times.
_LEARN_UNEVEN_FRAMES = 96
_LEARN_UNEVEN_S = 2.0
# Kinds differ in rate if one comes less often than this, compared with the most frequent one: more than a slower one comes, so
# that none is missed; to listen longer in vain costs nothing else.
_EVEN_PART = 0.85
# Frames of a slower kind are even if more than so many are there, and none is off its turn by more samples than a loss or two
# make: what comes on demand is in no turn.
_FEWEST_INTERVALS = 3
_MOST_OFF = 2.0
# Samples to one frame, on average, of a kind that is slower; of one that comes with each a fifth would have to be lost.
_SLOWER = 1.25
# A sample that so many frames could not complete is closed, whatever the time stamps say: memory stays bounded.
_OPEN_FRAMES = 4096
_LATE_FRAMES = 32  # By counter: how many frames of samples a frame may come late or early where time stamps tell nothing.
_PERIOD_PART = 0.75  # A frame that comes later than this part of the period is of another sample.
# A host under load hands over the second frame of a sample so much later, whatever the period; the latter where stamps are made
# when a buffer is read.
_LEAST_LIMIT_S = 0.05
_LOOSE_LIMIT_S = 0.2
_DOUBLED_PART = 0.25  # Two equal frames in a row are the same one if the second comes within this part of the period.
_CLEAR = 2.0  # Factor by which the longest pause must exceed all others; stamps made while reading a buffer show none.
_FEWEST = 4  # Frames of each kind before pauses are believed.
_LONGEST_READ_S = 0.5  # Between two reads of an adapter; a longer silence tells no period.
_USUAL_PART = 0.7  # A kind that may begin samples comes at least this often, compared with the most frequent one.


@dataclass(slots=True)  # One for each read: a frozen one takes five times as long to make.
class SampleFrames:
    """The frames of a block that carry parts of samples, in the order of the bus."""

    kind: NDArray[np.int8]
    """Number of the kind. Shape (n,)."""
    time_s: FloatArray
    """Shape (n,)."""
    is_repeated: Callable[[IntArray], NDArray[np.bool_]]
    """Tells for the frames of these places whether their data are those of the frame before."""
    group: IntArray | None = None
    """Shared counter, where there is one. Shape (n,)."""

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(slots=True)  # One for each read, too.
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


@dataclass(slots=True)
class _Past:
    """What the counter showed up to the beginning of a sample, or up to those of many: then arrays."""

    count: int | IntArray = -1
    time_s: float | FloatArray = 0.0
    samples: int | IntArray = 0
    elapsed_s: float | FloatArray = 0.0  # Silences, and clocks that were set, left out.
    low: int | IntArray = np.iinfo(np.int64).max
    high: int | IntArray = -1

    def followed(self, count: IntArray, time_s: FloatArray, is_same: NDArray[np.bool_]) -> _Past:
        """Return what it shows with each of the next; a count that is the same once more may be a copy."""
        step_s = np.diff(time_s, prepend=self.time_s if self.samples else time_s[:1])
        return _Past(
            count,
            time_s,
            self.samples + np.cumsum(~is_same),
            self.elapsed_s + np.cumsum(np.clip(step_s, 0.0, _LONGEST_READ_S)),
            low=np.minimum(np.minimum.accumulate(count), self.low),
            high=np.maximum(np.maximum.accumulate(count), self.high),
        )

    def at(self, place: int) -> _Past:
        """Return what it shows at one of many."""
        return _Past(*(getattr(self, name)[place].item() for name in self.__slots__))


class Assembler:
    """Groups frames into samples, block by block.

    Parameters
    ----------
    rule : AssemblyRule
    identifiers : list of int
        Of each kind. The lowest wins the bus where several are ready at once.
    """

    def __init__(self, rule: AssemblyRule, identifiers: list[int]) -> None:
        self._rule = rule
        self._kinds = len(identifiers)
        self._identifiers = np.array(identifiers)
        self._start = 0 if self._kinds == 1 else rule.starts_with
        self._limit_s = self._doubled_s = rule.limit_s
        self._learned = self._kinds == 1
        self.samples_each = [1] * self._kinds  # Samples to one frame of each kind; 1 while it is not learned.
        # By counter: samples given out of those that begin with the first frames of the next block, which of these frames are
        # used, and what began before them.
        self._done = 0
        self._used = np.zeros(0, dtype=np.bool_)
        self._past = _Past()

    @property
    def start(self) -> int:
        """Number of the kind samples begin with; 0 while it is not learned."""
        return self._start or 0

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
            # From as many frames in any case, so that it does not matter in what pieces the stream comes.
            count = _frames_to_learn_from(frames)
            if len(frames) < count and not last:
                return Groups(np.empty((0, self._kinds), dtype=np.int64), 0, 0)
            self._learn(frames.kind[:count], frames.time_s[:count])
            if count > _LEARN_FRAMES:
                self.samples_each = [_samples_each(frames.kind[:count], self.start, kind) for kind in range(self._kinds)]
        if self._kinds == 1:
            return Groups(np.arange(len(frames))[:, np.newaxis], 0, len(frames))
        groups = self._by_order(frames, last) if frames.group is None else self._by_counter(frames, frames.group, last)
        if not self._rule.needs:
            return groups
        lacking = np.zeros(len(groups.rows), dtype=np.bool_)
        # What lacks a kind that the protocol names is no sample at all; whatever else is missing is only not available.
        for kind in self._rule.needs:
            lacking |= groups.rows[:, kind] == NO_FRAME
        return Groups(groups.rows[~lacking], groups.left_out, groups.keep_from)

    def _learn(self, kind: NDArray[np.int8], time_s: FloatArray) -> None:
        """Find the kind that comes after the longest pauses, and the period."""
        self._learned = True
        if len(kind) == 0:
            return
        counts = np.bincount(kind, minlength=self._kinds)
        longest, is_clear = self._longest_pause(kind, time_s, counts)
        if self._start is None:
            usual = np.flatnonzero(counts >= _USUAL_PART * counts.max())
            self._start = longest if is_clear else int(usual[np.argmin(self._identifiers[usual])])
        number = max(int(counts[self._start]) - 1, 1)
        period_s = max(float(time_s[-1] - time_s[0]), 0.0) / number
        if not self._limit_s:
            self._limit_s = max(_PERIOD_PART * period_s, _LEAST_LIMIT_S if is_clear else _LOOSE_LIMIT_S)
        if self._rule.limit_s and self._rule.starts_with is not None:
            return
        self._doubled_s = _DOUBLED_PART * period_s if is_clear else self._limit_s

    def _longest_pause(self, kinds: NDArray[np.int8], time_s: FloatArray, counts: IntArray) -> tuple[int, bool]:
        """Return the kind that usually comes after the longest pause, and whether there is no doubt."""
        pause_s = np.maximum(np.diff(time_s, prepend=time_s[0]), 0.0)
        usual = np.flatnonzero(counts >= _USUAL_PART * counts.max())
        # The median: a pause between two reads of a buffer comes at any place, but not before most frames of a kind.
        median_s = {int(kind): float(median(pause_s[kinds == kind])) for kind in usual}
        longest = max(median_s, key=lambda kind: median_s[kind])
        others_s = max((pause for kind, pause in median_s.items() if kind != longest), default=0.0)
        return longest, bool(counts[usual].min() >= _FEWEST and median_s[longest] > _CLEAR * others_s)

    def _by_order(self, frames: SampleFrames, last: bool) -> Groups:
        regular = self._all_complete(frames)
        if regular is not None:
            return Groups(regular, 0, len(frames))
        kind, time_s = frames.kind, frames.time_s
        starts = np.flatnonzero(kind == self._start)
        again = starts[1:][np.diff(starts) == 1]
        if len(again):
            # The same frame twice in a row, at once: sent again, or doubled on the way.
            again = again[frames.is_repeated(again) & (time_s[again] - time_s[again - 1] <= self._doubled_s)]
            starts = np.setdiff1d(starts, again, assume_unique=True)
        # A frame belongs to the last start before it, unless it came too late for that.
        sample = np.searchsorted(starts, np.arange(len(frames)), side="right") - 1
        places = np.flatnonzero(sample >= 0)
        # Last to first, so that the first of several stays.
        places = places[time_s[places] - time_s[starts[sample[places]]] <= self._limit_s][::-1]
        rows = frame_table(kind[places], sample[places], places, shape=(len(starts), self._kinds))
        settled = len(starts) if last else self._settled(rows, frames)
        keep_from = int(starts[settled]) if settled < len(starts) else len(frames)
        taken = int(np.count_nonzero(rows[:settled] != NO_FRAME))
        return Groups(rows[:settled], keep_from - taken, keep_from)

    def _all_complete(self, frames: SampleFrames) -> IntArray | None:
        """Return the samples of a block where nothing is missing, doubled or late: nearly always, and quickly."""
        n = len(frames)
        if n % self._kinds or n == 0 or frames.kind[0] != self._start:
            return None
        cycle = frames.kind[: self._kinds]
        times = frames.time_s.reshape(-1, self._kinds)
        if (
            len(set(cycle.tolist())) < self._kinds
            or not every(frames.kind[self._kinds :] == frames.kind[: -self._kinds])
            or not every(times - times[:, :1] <= self._limit_s)
        ):
            return None
        return np.arange(n).reshape(-1, self._kinds)[:, cycle.argsort()]

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
        all_starts = np.flatnonzero(frames.kind == self._start)
        count, begin_s = group[all_starts], frames.time_s[all_starts]
        is_same = np.diff(count, prepend=self._past.count) == 0
        past = self._past.followed(count, begin_s, is_same)
        # More samples than counts from the lowest to the highest: the counter wrapped. Half a round away is another such count.
        span, stated = past.high - past.low + 1, self._rule.group_modulus
        half_round = np.where(past.samples > span, np.minimum(span, stated), stated) / 2
        # Of all so far: the first frames may have been read, and stamped, at once.
        period_s = past.elapsed_s / np.maximum(past.samples - 1, 1)
        limit_s = np.minimum(self._limit_s, np.where(period_s > 0, half_round * period_s, np.inf))
        # A whole round of the counter may have been lost.
        is_new = ~(is_same & (np.diff(begin_s, prepend=self._past.time_s) <= limit_s))
        starts, half_round, limit_s = all_starts[is_new], half_round[is_new], limit_s[is_new]
        used = np.zeros(len(frames), dtype=np.bool_)
        used[: len(self._used)] = self._used
        rows = np.full((len(starts), self._kinds), NO_FRAME)
        rows[:, self._start] = starts
        for other in range(self._kinds):
            if other != self._start:
                free = np.flatnonzero((frames.kind == other) & ~used)
                near = _nearest_alike(starts, free, group, frames.time_s, limit_s=limit_s)
                # The nearest of each other: while the own frame of a sample has not come, another's is no stand-in.
                is_own = _nearest_alike(near, starts, group, frames.time_s, limit_s=limit_s) == starts
                good = is_own & (near != NO_FRAME) & (np.abs(near - starts) <= half_round * self._kinds)
                rows[good, other] = near[good]
        settled = len(starts) if last else self._settled_by_counter(rows, frames)
        fresh = rows[min(self._done, settled) : settled]
        # Frames may still come that belong to a sample before; those given out already are remembered by their number.
        open_from = int(starts[settled]) if settled < len(starts) else len(frames)
        keep_from = len(frames) if last else max(0, open_from - _LATE_FRAMES)
        self._done = settled - int(np.searchsorted(starts[:settled], keep_from))
        used[fresh[fresh != NO_FRAME]] = True
        self._used = used[keep_from:]
        gone = int(np.searchsorted(all_starts, keep_from))
        if gone:
            self._past = past.at(gone - 1)
        return Groups(fresh, int(np.count_nonzero(~used[:keep_from])), keep_from)

    def _settled_by_counter(self, rows: IntArray, frames: SampleFrames) -> int:
        if not len(rows):
            return 0
        begin = rows[:, self._start]
        complete = (rows != NO_FRAME).all(axis=1)
        old = (frames.time_s[-1] - frames.time_s[begin] > self._limit_s) | (len(frames) - begin > _LATE_FRAMES)
        open_ones = np.flatnonzero(~(complete | old))
        # What was given out stays settled, even where its frames are gone.
        open_ones = open_ones[open_ones >= self._done]
        return int(open_ones[0]) if len(open_ones) else len(rows)


def _nearest_alike(places: IntArray, others: IntArray, group: IntArray, time_s: FloatArray, *, limit_s: FloatArray) -> IntArray:
    """Return for each of ``places`` the nearest of the others with its count, within its limit; else ``NO_FRAME``."""
    found = np.full(len(places), NO_FRAME)
    if not len(others) or not len(places):
        return found
    # One number that orders by count first and by place second.
    span = int(max(others[-1], places.max())) + 1
    key = np.sort(group[others] * span + others)
    at = np.searchsorted(key, group[places] * span + places)
    for side in (np.minimum(at, len(key) - 1), np.maximum(at - 1, 0)):
        place = key[side] % span
        good = (key[side] // span == group[places]) & (np.abs(time_s[place] - time_s[places]) <= limit_s)
        nearer = good & ((found == NO_FRAME) | (np.abs(place - places) < np.abs(found - places)))
        found = np.where(nearer, place, found)
    return found


def _frames_to_learn_from(frames: SampleFrames) -> int:
    """Return how many frames it takes to learn the order: more where the kinds differ in rate. At least two of a kind count."""
    counts = np.bincount(frames.kind[:_LEARN_FRAMES])
    # A stray frame is no rate.
    counts = counts[counts > 1]
    if len(frames) < _LEARN_FRAMES or len(counts) < 2 or counts.min() >= _EVEN_PART * counts.max():
        return _LEARN_FRAMES
    late = np.flatnonzero(frames.time_s[:_LEARN_UNEVEN_FRAMES] > frames.time_s[0] + _LEARN_UNEVEN_S)
    return max(int(late[0]), _LEARN_FRAMES + 1) if len(late) else _LEARN_UNEVEN_FRAMES


def _samples_each(kinds: NDArray[np.int8], start: int, kind: int) -> int:
    """Return how many samples there are to one frame of a kind; 1 where it comes with each, or in no regular turn."""
    sample = np.cumsum(kinds == start)[kinds == kind]
    if kind == start or len(sample) <= _FEWEST_INTERVALS:
        return 1
    turn = np.arange(len(sample))
    each = float(sample[-1] - sample[0]) / turn[-1]
    off = np.abs(sample - sample[0] - turn * each).max()
    # A few lost frames of the faster kind make the mean too small: round up unless it is just above a whole number.
    return math.ceil(each - 0.25) if each >= _SLOWER and off <= _MOST_OFF else 1
