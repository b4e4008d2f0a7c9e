"""Where samples are missing, by the steps of a counter or of a time stamp from one sample to the next.

The regular step is learned from the first samples and learned anew when the stream settles on another (somebody changed the
output rate), always at a fixed place in the sequence of samples, so that it does not matter how reads cut it. Steps come here
unwrapped, a counter's by ``sample_clock``. Losses that no step shows are those of ``host_lag``; ``sample_clock`` adds both. On
a bus ``can_clock`` counts losses, or ``can_sent_time`` where the instrument sends a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray, median

LEARN_FROM = 8
"""Steps from which the regular one is learned."""
_RELEARN_AFTER = 16  # Equal irregular steps in a row: at 2000 Hz 8 ms, and no pattern of losses is that regular.
_SHORTEST_S = 1e-6  # No instrument sends a million samples per second; steps below are rounding.
TOLERANCE = 0.25
"""Time stamps may jitter by this part of a step and still count as equal."""
FREE_LAG_S = 0.25
"""Lag, or silence, that counts as loss where neither counter nor time tells of one: above the usual delays of a busy host."""


@dataclass(frozen=True, slots=True)
class Steps:
    """What stands before each of n samples."""

    lost: IntArray
    """Samples missing before this one. Shape (n,)."""
    irregular: NDArray[np.bool_]
    """Whether there is a gap before this one. Shape (n,)."""
    inexact: NDArray[np.bool_]
    """Whether the number lost is only the nearest, the step being no multiple of the regular one. Shape (n,)."""


class StepRule:
    """Finds gaps in the steps of a counter (exact) or of a time stamp (with jitter).

    Parameters
    ----------
    allowed : tuple of int
        Steps a counter may make; empty for time stamps.
    jitter : int
        By how much they may be off.
    """

    def __init__(self, allowed: tuple[int, ...] = (), jitter: int = 0) -> None:
        self._allowed = allowed
        self._jitter = jitter
        self.step = 0.0  # The regular step; 0 while not learned.
        self._run_value = 0.0
        self._run_length = 0

    def learn(self, steps: FloatArray) -> None:
        """Learn the regular step from the first ones."""
        if not self._allowed:
            positive = steps[steps > _SHORTEST_S]
            self.step = float(median(positive)) if len(positive) else 0.0
            return
        counts = [int(np.count_nonzero(np.abs(steps - step) <= self._jitter)) for step in self._allowed]
        self.step = float(self._allowed[int(np.argmax(counts))])

    def examine(self, steps: FloatArray) -> Steps:
        """Judge n steps, shape (n,), in order."""
        lost = np.zeros(len(steps), dtype=np.int64)
        irregular = np.zeros(len(steps), dtype=np.bool_)
        inexact = np.zeros(len(steps), dtype=np.bool_)
        at = 0
        while at < len(steps) and self.step > 0:
            tolerance = self._jitter if self._allowed else 2 * TOLERANCE * self.step
            odd = np.flatnonzero(np.abs(steps[at:] - self.step) > tolerance) + at
            if not len(odd):
                self._run_length = 0
                break
            until, learned = self._relearn(steps, odd)
            odd = odd[odd < until]
            ratio = steps[odd] / self.step
            whole = np.rint(ratio)
            lost[odd] = np.maximum(whole - 1, 0)
            irregular[odd] = (lost[odd] > 0) | bool(self._allowed)
            if self._allowed:
                inexact[odd] = np.abs(ratio - whole) * self.step > self._jitter * np.maximum(whole, 1)
            if learned:
                self.step, self._run_length = self._run_value, 0
            at = until
        return Steps(lost, irregular, inexact)

    def are_regular(self, lowest: float, highest: float) -> bool:
        """Whether all steps between these two are regular; if they are, they count as examined."""
        limit = self._jitter if self._allowed else 2 * TOLERANCE * self.step
        regular = self.step > 0 and abs(lowest - self.step) <= limit and abs(highest - self.step) <= limit
        if regular:
            self._run_length = 0
        return regular

    def _relearn(self, steps: FloatArray, odd_at: IntArray) -> tuple[int, bool]:
        """Return behind which of the steps another one becomes regular, and True; their number and False if none does."""
        previous = -1 if self._run_length else -2
        for place in odd_at.tolist():
            value = float(steps[place])
            tolerance = self._jitter if self._allowed else TOLERANCE * abs(self._run_value)
            goes_on = place == previous + 1 and abs(value - self._run_value) <= tolerance
            self._run_length = self._run_length + 1 if goes_on else 1
            self._run_value = self._run_value if goes_on else value
            previous = place
            if self._run_length >= _RELEARN_AFTER and self._may_be_step(value):
                return int(place) + 1, True
        if previous != len(steps) - 1:
            self._run_length = 0
        return len(steps), False

    def _may_be_step(self, value: float) -> bool:
        return any(abs(value - step) <= self._jitter for step in self._allowed) if self._allowed else value > _SHORTEST_S


def steps_in_silence(silence_s: float, step_s: float) -> int:
    """Return how many regular steps a silence before an instrument began anew takes; 1 where it was none, or is not known."""
    return max(round(silence_s / step_s), 1) if silence_s > FREE_LAG_S and step_s > 0 else 1
