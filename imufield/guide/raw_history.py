"""The latest raw samples, as far back as one hold can reach: a hold in the hand is measured from them, not from cells."""

from __future__ import annotations

from collections import deque

from imufield.samples import Samples, concatenate

MOST_SAMPLES = 200_000
"""Bound on what is kept, whatever the rate: 100 s at 2000 Hz, some 17 MB."""


class RawHistory:
    """Keeps blocks of samples for a while.

    Parameters
    ----------
    keep_s : float
        Sample clock kept behind the newest sample.
    """

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._blocks: deque[Samples] = deque()
        self._count = 0

    def add(self, samples: Samples) -> None:
        """Append a block, oldest first."""
        self._blocks.append(samples)
        self._count += len(samples)

    def prune(self) -> None:
        """Let go of what is older than ``keep_s``; call it when the newest block has been used."""
        while len(self._blocks) > 1 and self._may_go(self._blocks[0], self._blocks[-1]):
            self._count -= len(self._blocks.popleft())

    def _may_go(self, oldest: Samples, newest: Samples) -> bool:
        too_old = float(oldest.time_s[-1]) < float(newest.time_s[-1]) - self._keep_s
        return too_old or self._count - len(oldest) > MOST_SAMPLES

    def clear(self) -> None:
        """Forget everything: another clock begins."""
        self._blocks.clear()
        self._count = 0

    def between(self, start_s: float, end_s: float) -> Samples | None:
        """Return the samples of a stretch, both ends included, None where there are none."""
        parts = []
        for block in self._blocks:
            first, last = block.time_s.searchsorted([start_s, end_s], side="left")
            last += int(last < len(block) and block.time_s[last] == end_s)
            if last > first:
                parts.append(block[int(first) : int(last)])
        return concatenate(parts) if parts else None
