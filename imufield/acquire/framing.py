"""Find frames in a stream of bytes, whole blocks at a time.

What a frame is, is defined one position after another: where the bytes begin a frame of known kind whose checksum fits,
the frame is taken and the search goes on behind it (and behind an optional trailer); anywhere else it goes on one byte
further. A length is never trusted before the checksum is. What comes out depends on the bytes alone, not on how reads cut
them: a frame that may still be completed is waited for.

That definition is carried out in two ways, chosen by what the stream looks like, with equal results:

* *Run*: behind a good frame, assume frames of the same length one after another and check all of them together. Where
  single ones fail between good ones, look for other frames in just those bytes.
* *Search*: check every position of a window that could begin a frame, together, and take the first that fits.

Both work on batches that grow while they succeed and shrink when they do not, so the work is linear in the number of
bytes for a clean stream, for noise, and for anything between.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import as_strided, sliding_window_view
from numpy.typing import NDArray

from imufield.acquire.layout import Rows
from imufield.acquire.protocol_schema import FrameRule

Bytes = NDArray[np.uint8]
Positions = NDArray[np.intp]

_FIRST_RUN, _LONGEST_RUN = 32, 8192
"""Frames checked together: the first guess after a disturbance, and the bound on memory (8 bytes for each byte checked)."""
_FIRST_WINDOW, _LONGEST_WINDOW = 128, 8192
"""Positions searched together: about three frames after a disturbance, many in noise."""
_BYTES_CHECKED_AT_ONCE = 1 << 20
"""Bound on positions searched times the longest frame: memory for a search stays below about 40 MB."""

_INVALID, _VALID, _INCOMPLETE = 0, 1, 2


@dataclass(frozen=True, slots=True)
class FrameBlock:
    """The frames of one feed, in the order of the stream."""

    data: Bytes
    starts: Positions
    """Shape (n,), offsets in ``data``."""
    keys: NDArray[np.int64]
    """Shape (n,)."""
    skipped_before: NDArray[np.int64]
    """Bytes passed over just before this frame. Shape (n,)."""
    origin: int
    """Offset of ``data`` in the stream."""

    def __len__(self) -> int:
        return len(self.starts)

    def rows(self, which: Positions | None, length: int) -> Rows:
        """Return frames of one length as an array, shape (m, length): a view where they are evenly spaced."""
        starts = self.starts if which is None else self.starts[which]
        if len(starts) == 0:
            return np.empty((0, length), dtype=np.uint8)
        step = int(starts[1] - starts[0]) if len(starts) > 1 else length
        if len(starts) < 3 or (starts[1:] - starts[:-1] == step).all():
            return as_strided(self.data[starts[0] :], (len(starts), length), (step, 1), writeable=False)
        return sliding_window_view(self.data, length)[starts]


class FrameCheck:
    """Decides whether bytes at given positions are a frame. Knows nothing of streams.

    Parameters
    ----------
    rule : FrameRule
    """

    def __init__(self, rule: FrameRule) -> None:
        self._rule = rule
        self._keys = np.array(sorted(rule.layouts), dtype=np.int64)
        self._lengths = np.array([rule.layouts[int(key)].length for key in self._keys], dtype=np.intp)
        self._header = max(len(rule.sync), rule.key_at + rule.key_size)
        self._can_begin = self._first_bytes()
        self.longest = int(self._lengths.max())

    def _first_bytes(self) -> NDArray[np.bool_]:
        """Return which byte values can begin a frame, shape (256,)."""
        rule = self._rule
        table = np.zeros(256, dtype=np.bool_)
        if rule.sync:
            table[rule.sync[0]] = True
        elif rule.key_size == 1 and rule.key_at == 0:
            table[self._keys] = True
        else:
            table[:] = True
        return table

    def candidates(self, buffer: Bytes, positions: Positions) -> Positions:
        """Return those positions whose first byte can begin a frame."""
        return positions[self._can_begin[buffer[positions]]]

    def length_at(self, buffer: Bytes, at: int) -> int:
        """Return the length of the frame whose header stands at ``at``; 0 where there is none or it is incomplete."""
        if not self._can_begin[buffer[at]] or at + self._header > len(buffer):
            return 0
        return int(self.lengths(buffer, np.array([at], dtype=np.intp))[0])

    def lengths(self, buffer: Bytes, starts: Positions) -> Positions:
        """Return the lengths of frames whose headers stand at ``starts``; 0 where there is none."""
        keys = self.keys(buffer, starts)
        place = np.searchsorted(self._keys, keys).clip(max=len(self._keys) - 1)
        found = np.where(self._keys[place] == keys, self._lengths[place], 0)
        for offset, byte in enumerate(self._rule.sync):
            found[buffer[starts + offset] != byte] = 0
        return found

    def keys(self, buffer: Bytes, starts: Positions) -> NDArray[np.int64]:
        """Return the keys of frames at ``starts``."""
        rule = self._rule
        keys = np.zeros(len(starts), dtype=np.int64)
        for index in range(rule.key_size):
            shift = 8 * (rule.key_size - 1 - index if rule.key_big_endian else index)
            keys |= buffer[starts + (rule.key_at + index)].astype(np.int64) << shift
        return keys

    def judge(self, buffer: Bytes, starts: Positions, last: bool) -> NDArray[np.int8]:
        """Return for each candidate whether it is a frame, none, or one that may still be completed."""
        judged = np.full(len(starts), _INCOMPLETE, dtype=np.int8)
        readable = starts + self._header <= len(buffer)
        lengths = np.zeros(len(starts), dtype=np.intp)
        lengths[readable] = self.lengths(buffer, starts[readable])
        judged[readable & (lengths == 0)] = _INVALID
        complete = (lengths > 0) & (starts + lengths <= len(buffer))
        judged[complete] = self._fit(buffer, starts[complete], lengths[complete])
        if last:
            judged[judged == _INCOMPLETE] = _INVALID
        return judged

    def rows_fit(self, rows: Rows) -> NDArray[np.bool_]:
        """Return which frames of one length have the key of the first and a checksum that fits, shape (n,)."""
        rule = self._rule
        same = np.ones(len(rows), dtype=np.bool_)
        header = [*range(len(rule.sync)), *range(rule.key_at, rule.key_at + rule.key_size)]
        for offset in header:
            same &= rows[:, offset] == rows[0, offset]
        if rule.checksum is None:
            return same
        until = rows.shape[1] - rule.checksum.size
        sent = _unsigned(rows[:, until:], rule.checksum_big_endian)
        same &= rule.checksum.of_rows(rows[:, rule.checksum_from : until]) == sent
        return same

    def _fit(self, buffer: Bytes, starts: Positions, lengths: Positions) -> NDArray[np.bool_]:
        rule = self._rule
        if rule.checksum is None:
            return np.ones(len(starts), dtype=np.bool_)
        size = rule.checksum.size
        covered = rule.checksum.of_spans(buffer, starts + rule.checksum_from, lengths - (rule.checksum_from + size))
        tails = buffer[(starts + lengths - size)[:, None] + np.arange(size)]
        return np.asarray(covered == _unsigned(tails, rule.checksum_big_endian))


def _unsigned(columns: Rows, big_endian: bool) -> NDArray[np.unsignedinteger]:
    """Return the number in each row of up to 8 bytes."""
    size = columns.shape[1]
    if size in (1, 2, 4, 8):
        return columns.view(f"{'>' if big_endian else '<'}u{size}")[:, 0]
    value = np.zeros(len(columns), dtype=np.uint64)
    for index in range(size):
        value = value << np.uint64(8) | columns[:, index if big_endian else size - 1 - index]
    return value


@dataclass(slots=True)
class _Found:
    """What one feed has found so far."""

    starts: list[Positions] = field(default_factory=list)
    skipped_before: list[tuple[Positions, NDArray[np.int64]]] = field(default_factory=list)
    """Offsets of frames that follow skipped bytes, and how many."""


class Framer:
    """Turns bytes into frames. Holds the bytes of a frame that is not complete yet, never more than the longest frame.

    Parameters
    ----------
    rule : FrameRule
    """

    def __init__(self, rule: FrameRule) -> None:
        self._rule = rule
        self._check = FrameCheck(rule)
        self._longest_window = max(_FIRST_WINDOW, min(_LONGEST_WINDOW, _BYTES_CHECKED_AT_ONCE // self._check.longest))
        self._rest = b""
        self._origin = 0
        self._run = _FIRST_RUN
        self._window = _FIRST_WINDOW
        self._behind_frame = False
        """The last byte passed belongs to a frame, so a trailer may follow."""
        self._skipped_here = 0
        """Bytes passed over since the last frame."""
        self.bytes_skipped = 0
        self.frames_bad_checksum = 0
        """Headers of a known kind, right behind a good frame, whose checksum does not fit."""

    def feed(self, data: bytes, *, last: bool = False) -> FrameBlock:
        """Return the frames that are complete now.

        Parameters
        ----------
        data : bytes
        last : bool
            Nothing will follow: give up waiting for incomplete frames.
        """
        joined = self._rest + data if self._rest else data
        buffer: Bytes = np.frombuffer(joined, dtype=np.uint8)
        found = _Found()
        at = 0
        while at < len(buffer):
            start = self._pass_trailer(joined, at, last)
            if start is None:
                break
            behind = start
            if start < len(buffer):
                behind = self._take_run(buffer, start, found)
                behind = self._search(buffer, start, last) if behind == start else behind
            if behind == at:
                break
            at = behind
        self._rest = joined[at:]
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
            return at
        trailer = self._rule.trailer
        behind = at + length
        step = length + len(trailer) * (buffer[behind : behind + len(trailer)].tobytes() == trailer)
        count = min((len(buffer) - behind) // step + 1, self._run)
        good = self._check.rows_fit(as_strided(buffer[at:], (count, length), (step, 1), writeable=False))
        joined = np.ones(count, dtype=np.bool_)
        for offset, byte in enumerate(trailer[: step - length]):
            joined[:-1] &= buffer[behind + offset : len(buffer) - length : step][: count - 1] == byte
        starts = np.arange(at, at + count * step, step, dtype=np.intp)
        if good.all() and joined.all():
            self._run = min(2 * self._run, _LONGEST_RUN)
            return self._accept(found, starts, length)
        return self._take_broken_run(buffer, _Run(starts, length, step, good, joined), found)

    def _take_broken_run(self, buffer: Bytes, run: _Run, found: _Found) -> int:
        """Take the good frames of a run up to where it ends, single bad ones between them left out."""
        limit = self._end_of_run(buffer, run)
        taken = np.flatnonzero(run.good[:limit])
        if not run.good[0] or len(taken) == 0:
            self._run = _FIRST_RUN
            return int(run.starts[0])
        if limit < len(run.good):
            self._run = _FIRST_RUN
        count = taken[-1] + 1
        before, after = taken[:-1], taken[1:]
        bad = np.flatnonzero(~run.good[:count])
        loose = before[~run.joined[before]]
        skipped = (after - before - 1) * run.step + ~run.joined[before] * (run.step - run.length)
        self.bytes_skipped += int(skipped.sum())
        # Right behind a good frame stands a bad one, or what should have been the trailer.
        suspects = np.concatenate([run.starts[bad[run.joined[bad - 1]]], run.starts[loose] + run.length])
        self.frames_bad_checksum += int(np.count_nonzero(self._check.lengths(buffer, suspects)))
        starts = run.starts[taken]
        found.skipped_before.append((starts[1:], skipped))
        return self._accept(found, starts, run.length)

    def _end_of_run(self, buffer: Bytes, run: _Run) -> int:
        """Return how many frames of the run to look at: up to two bad ones in a row, or to another frame in a bad one."""
        bad = ~run.good
        ends = np.flatnonzero(bad & np.append(bad[1:], True))
        limit = int(ends[0]) if len(ends) else len(bad)
        gaps = run.starts[:limit][bad[:limit], None] + np.arange(run.step)
        loose = run.starts[: max(limit - 1, 0)][~run.joined[: max(limit - 1, 0)], None] + np.arange(run.length, run.step)
        inside = self._check.candidates(buffer, np.concatenate([gaps.ravel(), loose.ravel()]))
        others = inside[self._check.judge(buffer, inside, last=False) != _INVALID]
        if self._rule.trailer and run.step == run.length:
            # A stream that sends no trailers does not begin a bad frame with one; leave such a place to the search.
            others = np.concatenate([others, gaps[buffer[gaps[:, 0]] == self._rule.trailer[0], 0]])
        if len(others) == 0:
            return limit
        return int(others.min() - run.starts[0] - run.length) // run.step + 1

    def _accept(self, found: _Found, starts: Positions, length: int) -> int:
        if self._skipped_here:
            found.skipped_before.append((starts[:1], np.array([self._skipped_here])))
        self._skipped_here = 0
        self._behind_frame = True
        found.starts.append(starts)
        return int(starts[-1]) + length

    def _search(self, buffer: Bytes, at: int, last: bool) -> int:
        """Go to the next position that is a frame or may become one, at most to the end of the window."""
        until = min(at + self._window, len(buffer))
        candidates = self._check.candidates(buffer, np.arange(at, until, dtype=np.intp))
        judged = self._check.judge(buffer, candidates, last)
        hits = candidates[judged != _INVALID]
        if len(hits):
            self._window = _FIRST_WINDOW
            until = int(hits[0])
        else:
            self._window = min(2 * self._window, self._longest_window)
        if until > at:
            if self._skipped_here == 0 and self._check.length_at(buffer, at):
                self.frames_bad_checksum += 1
            self._skipped_here += until - at
            self.bytes_skipped += until - at
            self._behind_frame = False
        return until

    def _block(self, buffer: Bytes, found: _Found) -> FrameBlock:
        starts = found.starts[0] if len(found.starts) == 1 else np.concatenate([*found.starts, np.empty(0, dtype=np.intp)])
        skipped_before = np.zeros(len(starts), dtype=np.int64)
        for offsets, skipped in found.skipped_before:
            skipped_before[np.searchsorted(starts, offsets)] = skipped
        return FrameBlock(buffer, starts, self._check.keys(buffer, starts), skipped_before, self._origin)


@dataclass(frozen=True, slots=True)
class _Run:
    """Frames assumed one behind another."""

    starts: Positions
    length: int
    step: int
    good: NDArray[np.bool_]
    joined: NDArray[np.bool_]
    """Whether the trailer behind each frame is there; true where none is expected."""
