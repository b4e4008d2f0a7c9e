"""The clock of a CAN bus whose instrument sends the time in one of its messages.

Of a stamp that wraps, whole wraps that are missing show only in the stamps of the frames: behind a silence of the bus. A host
that stood still makes the same silence, and then hands over at once what had waited; so samples behind a silence are kept back
for as long as ``can_clock`` allows for that. A clock of the host that is set makes one, too, but none that fits the stamp.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.clock.can_clock import CanClock
from imufield.acquire.clock.clock import Arrival, Arrivals, Clock, filled_in
from imufield.acquire.clock.frame_stamps import FrameStamps
from imufield.acquire.clock.missing_samples import FREE_LAG_S, LEARN_FROM, TOLERANCE, StepRule, steps_in_silence
from imufield.acquire.clock.stamp_clock import MeanStep, StampClock, steps_between
from imufield.acquire.decode.assembly import RawBlock, Ticks, join
from imufield.acquire.decode.statistics import NO_TIME, DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import MOST_TICKS, ClockRule
from imufield.dataclass import replace
from imufield.samples import FloatArray, Samples, SampleUnits, Status, concatenate, median

_DRIFT = 2e-4  # Two crystals differ by less.


class CanSentTime(Clock):
    """Gives the samples of a bus the time that the instrument sent."""

    def __init__(self, rule: ClockRule, units: SampleUnits, statistics: DecoderStatistics) -> None:
        super().__init__(rule, units, statistics)
        self._stamps = StampClock(rule)
        self._steps = StepRule()
        self._mean = MeanStep()
        self._pending: list[RawBlock] = []
        self._started = False
        self._by_frames: CanClock | None = None  # Takes over where the stamps are no times.
        self._last = 0.0
        self._sent = np.full(2, np.nan)  # The last two numbers, which may be no times.
        self._frame_stamps = FrameStamps()
        self._last_stamp_s = math.nan  # Of the bus.
        self._frames_tell = False  # Whether the bus has a time at all.

    def push(self, block: RawBlock, arrivals: Arrival | Arrivals) -> Samples | None:  # noqa: ARG002  the instrument tells the time
        """Return the samples whose time is settled now, None if there are none."""
        if self._by_frames is not None:
            return self._timed_by_frames(self._by_frames, block)
        # Until it is clear which clock is used they stay as they are: another one takes out jumps itself.
        self._pending.append(self._continuous(block) if self._started else block)
        return self._release(last=False) if self._started or sum(map(len, self._pending)) > LEARN_FROM else None

    def flush(self) -> Samples | None:
        """Return what is kept back; nothing will follow."""
        timed = [self._release(last=True)] if self._pending else []
        timed += [self._by_frames.flush()] if self._by_frames is not None else []
        done = [samples for samples in timed if samples is not None]
        return concatenate(done) if done else None

    def _release(self, *, last: bool) -> Samples | None:
        """Time what has come, up to a silence behind which it is not clear yet whether data are late or missing."""
        block, self._pending = join(self._pending), []
        if not self._started:
            if not self._learn(block):
                self._by_frames = CanClock(self._rule, self._units, self._statistics)
                return self._timed_by_frames(self._by_frames, block)
            block = self._continuous(block)
        silence_s = steps_between(block.stamp_s, self._last_stamp_s)
        begins = np.flatnonzero(silence_s > max(self._stamps.wrap_s / 2, FREE_LAG_S)).tolist()
        done = []
        for begin, end in pairwise(sorted({0, *begins, len(block)})):
            unseen_s = 0.0
            if begin in begins:
                late_s = self._late_s(block.stamp_s[begin:], float(silence_s[begin]), last=last)
                if late_s is None:
                    self._pending = [block[begin:]]
                    break
                unseen_s = float(silence_s[begin]) - late_s
            self._last_stamp_s = float(block.stamp_s[end - 1])
            done.append(self._time(block[begin:end], silence_s[begin:end], unseen_s))
        return concatenate(done) if done else None

    def _timed_by_frames(self, clock: CanClock, block: RawBlock) -> Samples | None:
        if self._frames_tell:
            self._statistics.count(NO_TIME, len(block))
        return clock.push(block, Arrival(math.nan))

    def _continuous(self, block: RawBlock) -> RawBlock:
        # A jump of their clock is no silence, and nothing to a time that the instrument tells.
        return replace(block, stamp_s=self._frame_stamps.continuous(block.stamp_s)[0])

    def _late_s(self, stamp_s: FloatArray, silence_s: float, *, last: bool) -> float | None:
        """Return by how much the first sample behind a silence is late: what waited comes at once, behind a loss nothing does.

        None while that cannot be told.
        """
        waited_s = np.arange(len(stamp_s)) * self._steps.step
        since_s = stamp_s - stamp_s[0]
        if not last and since_s.max() <= FREE_LAG_S and waited_s[-1] < silence_s:
            return None
        return float((waited_s - since_s)[since_s <= FREE_LAG_S].max())

    def _learn(self, block: RawBlock) -> bool:
        """Learn the regular step from the first stamps: of as many in any case, in whatever pieces they come.

        False where they tell no time.
        """
        first = block[: LEARN_FROM + 1]
        self._frames_tell = bool(first.stamp_s[-1] > first.stamp_s[0])
        self._widen(first.ticks)
        ticks = np.where(self._are_times(first.ticks), first.ticks, np.nan)
        # How often a stamp began anew between two samples cannot be told from it where it does so as fast as they come.
        is_slow = len(first) > 1 and median(np.diff(first.stamp_s)) > self._stamps.wrap_s / 2
        self._started = self._stamps.tells_time(ticks, has_host=self._frames_tell) and not is_slow
        if self._started:
            known = ticks[np.isfinite(ticks)]
            self._last = float(known[0])
            self._steps.learn(self._stamps.start(self._whole(known)))
        return self._started

    def _time(self, block: RawBlock, silence_s: FloatArray, unseen_s: float) -> Samples:
        """Time samples by their stamps; before the first nothing was sent for ``unseen_s``, if that is not 0."""
        step_s = self._steps.step or 1.0
        ticks = self._filled(block.ticks, step_s * self._rule.time_ticks_per_s)
        within_s = max(FREE_LAG_S, step_s) + _DRIFT * unseen_s
        went_round = bool(unseen_s) and self._stamps.go_round(ticks[0].item(), unseen_s, within_s)
        stamped = self._stamps.time(ticks, lambda row: steps_in_silence(silence_s[row], step_s) * step_s)
        lost = self._steps.examine(stamped.step_s).lost
        is_set = stamped.reset & (stamped.step_s <= step_s)
        # Nobody knows whether the bus was silent for longer than the stamps show, or the clock of its frames was set.
        is_hidden = unseen_s - stamped.step_s[0] > within_s and not self._stamps.silence_tells(within_s)
        is_set[0] |= is_hidden
        guessed = stamped.reset | is_set
        guessed[0] |= went_round
        estimated = int(lost[0]) if went_round or is_hidden else 0
        flags = np.where((lost > 0) & ~guessed, np.uint32(Status.AFTER_GAP), np.uint32(0))
        flags[guessed] |= np.uint32(Status.GAP_ESTIMATED)
        flags[is_set] |= np.uint32(Status.CLOCK_SET)
        statistics = self._statistics
        statistics.samples_lost += int(lost.sum()) - estimated
        statistics.losses_estimated += estimated
        statistics.gaps += int(np.count_nonzero(flags))
        statistics.clock_resets += int(np.count_nonzero(is_set))
        mean_s = self._mean.by_stamps(stamped, self._steps.step)
        statistics.nominal_rate_hz = 1 / mean_s if mean_s else None
        return self._timed(block, stamped.time_s, flags)

    def _filled(self, ticks: Ticks, step: float) -> Ticks:
        """Put a regular step where the message with the time was lost."""
        self._widen(ticks)
        known = self._are_times(ticks)
        if not known.all():
            ticks = filled_in(ticks, known, self._last, step)
        self._last = float(ticks[-1])
        return self._whole(ticks)

    def _widen(self, ticks: Ticks) -> None:
        """Let stamps that rise beyond their stated end go on to the next power of two: ranges of DBC files may be wrong."""
        sent = np.append(self._sent, ticks)
        self._sent = sent[-2:]
        steps = np.diff(sent)
        # By steps alike: what stands for no value may be two numbers one behind the other.
        rising = (steps[1:] > 0) & (np.abs(np.diff(steps)) <= 2 * TOLERANCE * steps[1:])
        beyond = sent[2:][rising & (sent[1:-1] >= self._stamps.modulus) & (sent[2:] < MOST_TICKS)]
        if self._stamps.modulus and len(beyond):
            self._stamps.widen(1 << int(beyond.max()).bit_length(), int(self._last))

    def _are_times(self, ticks: Ticks) -> NDArray[np.bool_]:
        """Return which are times: a single number beyond the end is none."""
        return np.asarray(np.isfinite(ticks) & (ticks < (self._stamps.modulus or math.inf)))

    def _whole(self, ticks: Ticks) -> Ticks:
        # Stamps that wrap are whole numbers from 0 on, with a sign or without, and are unwrapped without rounding as such.
        return np.rint(ticks).astype(np.int64) % self._stamps.modulus if self._stamps.modulus else ticks
