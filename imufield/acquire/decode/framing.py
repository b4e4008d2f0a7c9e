"""Find frames in a stream of bytes, whole blocks at a time.

What a frame is, is defined one position after another: where the bytes begin a frame of known kind whose checksum fits,
the frame is taken and the search goes on behind it (and behind an optional trailer); anywhere else it goes on one byte
further. A length is never trusted before the checksum is. What comes out depends on the bytes alone, not on how reads cut
them: a frame that may still be completed is waited for.

That definition is carried out in two ways, chosen by what the stream looks like, with equal results:

* *Run*: behind a good frame, assume frames of the same length one after another and check all of them together. Where
  single ones fail between good ones, look for other frames in just those bytes.
* *Search*: check every position of a window that could begin a frame, together, and take the first that fits.

Where frames repeated each other, one kind or a few in cycles, a *stencil* of the bytes that they have in common is kept: a
feed that is nothing but more of them is recognised by one comparison and their checksums.

Both work on batches that grow while they succeed and shrink when they do not, so the work is linear in the number of
bytes for a clean stream, for noise, and for anything between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.frame_check import INVALID, NO_SHAPE, VALID, FrameCheck, Stencil, cycle_length, frames_at
from imufield.acquire.protocol.frame_schema import FrameRule
from imufield.acquire.protocol.layout import Frames, Layout
from imufield.dataclass import dataclass, field
from imufield.samples import every

Bytes = NDArray[np.uint8]
Positions = NDArray[np.intp]

# Frames checked together: the first guess after a disturbance, and the bound on memory (8 bytes for each byte checked).
_FIRST_RUN = 128
_LONGEST_RUN = 8192
# Positions searched together: about three frames after a disturbance, many in noise.
_FIRST_WINDOW = 128
_LONGEST_WINDOW = 1 << 15
# Bytes in which headers are followed from one to the next.
_FIRST_CHAIN = 1 << 10
_LONGEST_CHAIN = 1 << 16
_SAME_AGAIN = 64  # Frames of one length in a row after which a stream is taken to go on like that.


@dataclass(slots=True, kw_only=True)  # One for each feed: a frozen one takes five times as long to make.
class FrameBlock:
    """The frames of one feed, in the order of the stream."""

    data: Bytes
    starts: Positions
    """Shape (n,), offsets in ``data``."""
    shapes: NDArray[np.int64]
    """Numbers of their shapes; ``Framer.layout`` has the layout. Shape (n,)."""
    skipped_before: NDArray[np.int64] | None
    """Bytes passed over just before this frame. Shape (n,); None where there are none before any."""
    seen_until: NDArray[np.int64] | None
    """Offset in the stream of what must be there to know that each is a frame: beside its own bytes those of the header before
    it, which promised a longer frame and was none. Shape (n,); None where there was no such header."""
    origin: int
    """Offset of ``data`` in the stream."""

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(slots=True)
class EvenBlock:
    """The frames of one feed where all are of one length, of shapes in cycles, with nothing else between: nearly always."""

    frames: Frames
    cycle: tuple[int, ...]
    """Shapes of the first k frames, which all others repeat."""
    origin: int
    """Offset of the buffer in the stream."""

    def __len__(self) -> int:
        return self.frames.count

    @property
    def data(self) -> Bytes:
        """The buffer."""
        return self.frames.data

    @property
    def starts(self) -> Positions:
        """Offsets in ``data``, shape (n,)."""
        return self.frames.at + self.frames.step * np.arange(self.frames.count)

    @property
    def shapes(self) -> NDArray[np.int64]:
        """The shape of each, shape (n,)."""
        return np.resize(np.array(self.cycle, dtype=np.int64), self.frames.count)

    def of_place(self, place: int) -> Frames:
        """Return the frames of one place of the cycle."""
        if len(self.cycle) == 1:
            return self.frames
        at, step, count = self.frames.at, self.frames.step, len(range(place, self.frames.count, len(self.cycle)))
        return Frames(self.frames.data, at + place * step, step * len(self.cycle), count, self.frames.length)

    @property
    def skipped_before(self) -> None:
        """No bytes were passed over."""
        return

    @property
    def seen_until(self) -> None:
        """No frame was waited for longer than its own bytes."""
        return


@dataclass(slots=True)
class _Found:
    """What one feed has found so far."""

    starts: list[Positions] = field(default_factory=list)
    shapes: list[NDArray[np.int64]] = field(default_factory=list)
    # Offsets of frames that follow skipped bytes, and how many.
    skipped_before: list[tuple[Positions, NDArray[np.int64]]] = field(default_factory=list)
    # Offsets of headers that were none, and where the frames that they promised would have ended.
    promises: list[tuple[Positions, Positions]] = field(default_factory=list)
    run: tuple[Frames, NDArray[np.int64]] | None = None  # The last one without a bad frame, and its shapes.

    def promise(self, rejected: Positions, ends: Positions) -> None:
        """Note headers that were none, if there are any."""
        if len(rejected):
            self.promises.append((rejected, ends))


class Framer:
    """Turns bytes into frames. Holds the bytes of a frame that is not complete yet, never more than the longest frame.

    Parameters
    ----------
    rule : FrameRule
    """

    def __init__(self, rule: FrameRule) -> None:
        self._rule = rule
        self._trailer: Bytes = np.frombuffer(rule.trailer, dtype=np.uint8)
        self._check = FrameCheck(rule)
        self._rest = b""
        self._origin = 0
        self._run = _FIRST_RUN
        self._stencil: Stencil | None = None  # What the frames of the last run have in common.
        self._place = 0  # Of the next frame in the cycle of its shapes.
        self._sequence: list[Stencil] = []  # Of the next frames, where some of several lengths come in cycles.
        self._window = _FIRST_WINDOW
        self._is_mixed = False  # Frames of different lengths came one behind another.
        self._chain = _FIRST_CHAIN
        self._cut_at = -1  # Where in the buffer a frame is known to begin that is not complete yet.
        self._behind_frame = False  # The last byte passed belongs to a frame, so a trailer may follow.
        self._skipped_here = 0  # Bytes passed over since the last frame.
        self._seen_until = 0  # In the stream, where the last false promise ends.
        self.bytes_skipped = 0
        self.frames_bad_checksum = 0  # Headers of a known kind, right behind a good frame, whose checksum does not fit.

    def layout(self, shape: int) -> Layout:
        """Return the layout of a shape of the newest block."""
        return self._check.layout(shape)

    def feed(self, data: bytes, *, last: bool = False) -> FrameBlock | EvenBlock:
        """Return the frames that are complete now.

        Parameters
        ----------
        data : bytes
        last : bool
            Nothing will follow: give up waiting for incomplete frames.
        """
        joined = self._rest + data if self._rest else data
        buffer: Bytes = np.frombuffer(joined, dtype=np.uint8)
        again = None if last else self._as_before(buffer)
        if isinstance(again, tuple):
            block, until = again
            self._rest = joined[until:]
            self._origin += until
            return block
        if self._check.forget():
            again, self._stencil, self._sequence = None, None, []
        found = _Found()
        at = 0 if again is None else self._take_broken_run(buffer, again, found)
        self._cut_at = -1
        while at < len(buffer):
            start = self._pass_trailer(joined, at, last)
            if start is None:
                break
            behind = start
            if start < len(buffer):
                take = self._take_chain if self._is_mixed else self._take_run
                behind = take(buffer, start, found)
                if behind == start and (last or self._cut_at != start):
                    behind = self._search(buffer, start, found, last=last)
            if behind == at:
                break
            at = behind
            if at == self._cut_at and not last:
                break
        self._rest = joined[at:]
        self._learn(buffer, found)
        block = self._block(buffer, found)
        self._origin += at
        return block

    def _pass_trailer(self, data: bytes, at: int, last: bool) -> int | None:
        """Return the position behind the trailer, if there is one; None: wait, it may have begun here."""
        trailer = self._rule.trailer
        if not (self._behind_frame and trailer):
            return at
        there = data[at : at + len(trailer)]
        if len(there) < len(trailer) and trailer.startswith(there) and not last:
            return None
        self._behind_frame = False
        return at + len(trailer) if there == trailer else at

    def _take_run(self, buffer: Bytes, at: int, found: _Found) -> int:
        """Take frames of one length that begin at ``at``; return the position behind the last one, ``at`` if there is none."""
        length = self._check.length_at(buffer, at)
        if length == 0 or at + length > len(buffer):
            self._cut_at = at if length else -1
            return at
        trailer = self._rule.trailer
        behind = at + length
        step = length + len(trailer) * (buffer[behind : behind + len(trailer)].tobytes() == trailer)
        count = min((len(buffer) - behind) // step + 1, self._run)
        frames = Frames(buffer, at, step, count, length)
        good, shape = self._check.run_fits(frames)
        starts = np.arange(at, at + count * step, step, dtype=np.intp)
        trailers = Frames(buffer, behind, step, count - 1, step - length).rows == self._trailer[: step - length]
        if every(good) and every(trailers):
            self._run = min(2 * self._run, _LONGEST_RUN)
            shapes = self._run_shapes(buffer, starts, length, shape)
            found.run = frames, shapes
            return self._accept(found, starts, shapes, length)
        joined = np.append(trailers.all(axis=1), True)
        return self._take_broken_run(
            buffer, _Run(starts=starts, length=length, step=step, shape=shape, good=good, joined=joined), found
        )

    def _as_before(self, buffer: Bytes) -> tuple[FrameBlock | EvenBlock, int] | _Run | None:
        """Return the frames of a feed that is nothing but frames like those before, and where they end.

        A run if their checksums alone are not all good, None if it is anything else.
        """
        is_waiting = self._behind_frame and self._rule.trailer
        if self._skipped_here or self._seen_until > self._origin or is_waiting:
            return None
        if self._is_mixed:
            return self._sequence_again(buffer, self._sequence) if self._sequence else None
        return self._run_again(buffer, self._stencil) if self._stencil else None

    def _run_again(self, buffer: Bytes, stencil: Stencil) -> tuple[EvenBlock, int] | _Run | None:
        count, rest = divmod(len(buffer), stencil.step)
        frames, size = Frames(buffer, 0, stencil.step, count, stencil.length), len(stencil.shapes)
        if count < size or not stencil.matches(frames, self._place):
            return None
        good = stencil.form.sums_fit(frames)
        if not every(good):
            starts = np.arange(0, count * stencil.step, stencil.step, dtype=np.intp)
            shape = stencil.shapes[0] if size == 1 else NO_SHAPE
            joined = np.ones(count, dtype=np.bool_)
            return _Run(starts=starts, length=stencil.length, step=stencil.step, shape=shape, good=good, joined=joined)
        following = (self._place + count) % size
        if rest and not stencil.may_become(buffer[-rest:], following):
            return None
        cycle = stencil.shapes[self._place :] + stencil.shapes[: self._place]
        self._place, self._behind_frame = following, stencil.step == stencil.length
        return EvenBlock(frames, cycle, self._origin), len(buffer) - rest

    def _sequence_again(self, buffer: Bytes, sequence: list[Stencil]) -> tuple[FrameBlock, int] | None:
        lengths = [stencil.length for stencil in sequence]
        cycles = np.arange(len(buffer) // sum(lengths) + 1)[:, np.newaxis]
        ends = (cycles * sum(lengths) + np.cumsum(lengths)).ravel()
        count = int(ends.searchsorted(len(buffer), side="right"))
        if count < len(sequence):
            return None
        starts = np.concatenate([[0], ends])[:count]
        shapes = np.resize([stencil.shapes[0] for stencil in sequence], count)
        for shape, stencil in {stencil.shapes[0]: stencil for stencil in sequence}.items():
            frames = frames_at(buffer, starts[shapes == shape], stencil.length)
            if not stencil.matches(frames, 0) or not every(stencil.form.sums_fit(frames)):
                return None
        until, following = int(ends[count - 1]), count % len(sequence)
        if not sequence[following].may_become(buffer[until:], 0):
            return None
        self._sequence = sequence[following:] + sequence[:following]
        block = FrameBlock(data=buffer, starts=starts, shapes=shapes, skipped_before=None, seen_until=None, origin=self._origin)
        return block, until

    def _take_broken_run(self, buffer: Bytes, run: _Run, found: _Found) -> int:
        """Take the good frames of a run up to where it ends, single bad ones between them left out."""
        if not run.good[0]:
            self._run = _FIRST_RUN
            return int(run.starts[0])
        limit = self._end_of_run(buffer, run, found)
        taken = np.flatnonzero(run.good[:limit])
        if limit < len(run.good):
            self._run = _FIRST_RUN
            # Frames of another length follow: from now on headers are followed from one to the next.
            self._is_mixed = self._check.mixes_lengths and not self._rule.trailer
        count = taken[-1] + 1
        before, after = taken[:-1], taken[1:]
        bad = np.flatnonzero(~run.good[:count])
        loose = before[~run.joined[before]]
        skipped = (after - before - 1) * run.step + ~run.joined[before] * (run.step - run.length)
        self.bytes_skipped += int(skipped.sum())
        # Right behind a good frame stands a bad one, or what should have been the trailer.
        suspects = np.concatenate([run.starts[bad[run.joined[bad - 1]]], run.starts[loose] + run.length])
        self.frames_bad_checksum += int(np.count_nonzero(self._check.lengths(buffer, suspects) > 0))
        starts = run.starts[taken]
        found.skipped_before.append((starts[1:], skipped))
        return self._accept(found, starts, self._run_shapes(buffer, starts, run.length, run.shape), run.length)

    def _run_shapes(self, buffer: Bytes, starts: Positions, length: int, shape: int) -> NDArray[np.int64]:
        if shape != NO_SHAPE:
            return np.full(len(starts), shape, dtype=np.int64)
        return self._check.shapes(buffer, starts, np.full(len(starts), length, dtype=np.intp))

    def _take_chain(self, buffer: Bytes, at: int, found: _Found) -> int:
        """Take frames of any length from ``at`` on, each beginning where the one before ends; return where that ends."""
        places = self._check.headers(buffer, at, min(at + self._chain, len(buffer)))
        lengths = self._check.lengths_of_headers(buffer, places)
        begun = lengths > 0
        whole = begun & (places + lengths <= len(buffer))
        cut = places[begun & ~whole]
        places, lengths = places[whole], lengths[whole]
        if len(places) == 0 or places[0] != at:
            self._cut_at = at if at in cut else -1
            return at
        chain = _follow(places, places + lengths)
        starts, lengths = places[chain], lengths[chain]
        shapes = self._check.fit(buffer, starts, lengths)
        bad = np.flatnonzero(shapes == NO_SHAPE)
        count = int(bad[0]) if len(bad) else len(shapes)
        self._chain = _FIRST_CHAIN if len(bad) else min(2 * self._chain, _LONGEST_CHAIN)
        if count == 0:
            return at
        self._is_mixed = count < _SAME_AGAIN or bool((lengths[:count] != lengths[0]).any())
        behind = self._accept(found, starts[:count], shapes[:count], int(lengths[count - 1]))
        self._cut_at = behind if behind in cut else -1
        return behind

    def _learn(self, buffer: Bytes, found: _Found) -> None:
        """Keep what the last frames have in common: once for each feed, as only the next one asks for it."""
        if found.run is not None:
            frames, shapes = found.run
            self._stencil = self._check.stencil(frames, shapes, self._rule.trailer[: frames.step - frames.length])
            self._place = frames.count % len(self._stencil.shapes) if self._stencil else 0
        if self._is_mixed and found.starts:
            self._sequence = self._sequence_of(buffer, found.starts[-1], found.shapes[-1])

    def _sequence_of(self, buffer: Bytes, starts: Positions, shapes: NDArray[np.int64]) -> list[Stencil]:
        """Return what recognises the frames to come if those so far came in cycles; empty if they did not."""
        size = cycle_length(shapes)
        # Two cycles at least: a few frames in any order look like the beginning of one.
        if not size or 2 * size > len(shapes):
            return []
        found = []
        for start, shape in zip(starts[:size].tolist(), shapes[:size].tolist(), strict=True):
            rows = buffer[start : start + self._check.layout(shape).length][np.newaxis]
            stencil = self._check.stencil_of(rows, (shape,), b"")
            if stencil is None:
                return []
            found.append(stencil)
        following = len(shapes) % size
        return found[following:] + found[:following]

    def _end_of_run(self, buffer: Bytes, run: _Run, found: _Found) -> int:
        """Return how many frames of the run to look at: up to two bad ones in a row, or to another frame in a bad one."""
        bad = ~run.good
        two = np.flatnonzero(bad & np.append(bad[1:], True))
        limit = int(two[0]) if len(two) else len(bad)
        gaps = run.starts[:limit][bad[:limit], None] + np.arange(run.step)
        loose = run.starts[: max(limit - 1, 0)][~run.joined[: max(limit - 1, 0)], None] + np.arange(run.length, run.step)
        inside = self._check.candidates(buffer, np.concatenate([gaps.ravel(), loose.ravel()]))
        judged, ends = self._check.judge(buffer, inside, last=False)
        is_none = judged == INVALID
        found.promise(inside[is_none], ends[is_none])
        others = inside[~is_none]
        if self._rule.trailer and run.step == run.length:
            # A stream that sends no trailers does not begin a bad frame with one; leave such a place to the search.
            others = np.concatenate([others, gaps[buffer[gaps[:, 0]] == self._rule.trailer[0], 0]])
        if len(others) == 0:
            return limit
        return int(others.min() - run.starts[0] - run.length) // run.step + 1

    def _accept(self, found: _Found, starts: Positions, shapes: NDArray[np.int64], last_length: int) -> int:
        if self._skipped_here:
            found.skipped_before.append((starts[:1], np.array([self._skipped_here])))
        self._skipped_here = 0
        self._behind_frame = True
        found.starts.append(starts)
        found.shapes.append(shapes)
        return int(starts[-1]) + last_length

    def _search(self, buffer: Bytes, at: int, found: _Found, *, last: bool) -> int:
        """Go to the next position that is a frame or may become one, at most to the end of the window."""
        until = min(at + self._window, len(buffer))
        candidates = self._check.headers(buffer, at, until)
        judged, ends = self._check.judge(buffer, candidates, last)
        hits = np.flatnonzero(judged != INVALID)
        rejected = slice(int(hits[0]) if len(hits) else None)
        if len(hits):
            until = int(candidates[hits[0]])
        # What may become a frame, at the end of the bytes, is no sign that the noise is over.
        if len(hits) and judged[hits[0]] == VALID:
            self._window = _FIRST_WINDOW
        else:
            self._window = min(2 * self._window, _LONGEST_WINDOW)
        found.promise(candidates[rejected], ends[rejected])
        if until > at:
            if self._skipped_here == 0 and self._check.length_at(buffer, at):
                self.frames_bad_checksum += 1
            self._skipped_here += until - at
            self.bytes_skipped += until - at
            self._behind_frame = False
        return until

    def _block(self, buffer: Bytes, found: _Found) -> FrameBlock:
        nothing = np.empty(0, dtype=np.intp)
        is_one_run = len(found.starts) == 1
        starts = found.starts[0] if is_one_run else np.concatenate([*found.starts, nothing])
        skipped_before = None
        if found.skipped_before:
            skipped_before = np.zeros(len(starts), dtype=np.int64)
            for offsets, skipped in found.skipped_before:
                skipped_before[np.searchsorted(starts, offsets)] = skipped
        return FrameBlock(
            data=buffer,
            starts=starts,
            shapes=found.shapes[0] if is_one_run else np.concatenate([*found.shapes, nothing]),
            skipped_before=skipped_before,
            seen_until=self._promised(starts, found),
            origin=self._origin,
        )

    def _promised(self, starts: Positions, found: _Found) -> NDArray[np.int64] | None:
        """Return how far the false promises before each frame reach in the stream, and keep the last one for the next block."""
        if not found.promises and self._seen_until <= self._origin:
            return None
        until = np.full(len(starts) + 1, self._seen_until, dtype=np.int64)
        if found.promises:
            offsets, ends = (np.concatenate(parts) for parts in zip(*found.promises, strict=True))
            np.maximum.at(until, np.searchsorted(starts, offsets), ends + self._origin)
            until = np.maximum.accumulate(until)
        self._seen_until = int(until[-1])
        return until[:-1]


def _follow(starts: Positions, ends: Positions) -> list[int]:
    """Return the first of these spans, the one that begins where it ends, and so on, by their places."""
    places = np.searchsorted(starts, ends)
    linked = starts[np.minimum(places, len(starts) - 1)] == ends
    following: list[int] = np.where(linked, places, -1).tolist()
    chain, place = [], 0
    while place >= 0:
        chain.append(place)
        place = following[place]
    return chain


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """Frames assumed one behind another."""

    starts: Positions
    length: int
    step: int
    shape: int  # What all have in common, ``NO_SHAPE`` where there may be several.
    good: NDArray[np.bool_]
    joined: NDArray[np.bool_]  # Whether the trailer behind each frame is there; true where none is expected.
