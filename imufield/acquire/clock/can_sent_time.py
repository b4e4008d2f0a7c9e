"""The clock of a CAN bus whose instrument sends the time in one of its messages."""

from __future__ import annotations

import math

import numpy as np

from imufield.acquire.clock.clock import Arrival, Arrivals, Clock, filled_in
from imufield.acquire.clock.missing_samples import LEARN_FROM, StepRule, steps_in_silence
from imufield.acquire.clock.stamp_clock import MeanStep, StampClock, steps_between
from imufield.acquire.decode.assembly import RawBlock, Ticks, join
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.samples import Samples, SampleUnits, Status


class CanSentTime(Clock):
    """Gives the samples of a bus the time that the instrument sent."""

    def __init__(self, rule: ClockRule, units: SampleUnits, statistics: DecoderStatistics) -> None:
        super().__init__(rule, units, statistics)
        self._stamps = StampClock(rule)
        self._steps = StepRule()
        self._mean = MeanStep()
        self._early: list[RawBlock] = []
        self._started = False
        self._last = 0.0
        self._last_stamp_s = math.nan  # Of the bus.

    def push(self, block: RawBlock, arrivals: Arrival | Arrivals) -> Samples | None:  # noqa: ARG002  the instrument tells the time
        """Return the samples whose time is settled now, None if there are none."""
        if self._started:
            return self._time(block)
        self._early.append(block)
        return self._start() if sum(map(len, self._early)) > LEARN_FROM else None

    def flush(self) -> Samples | None:
        """Return what is kept back; nothing will follow."""
        return self._start() if self._early else None

    def _start(self) -> Samples:
        """Learn the regular step from the first stamps, then time their samples like all others."""
        block, self._early, self._started = join(self._early), [], True
        # Of as many in any case, so that it does not matter in what pieces they come.
        first = block.ticks[: LEARN_FROM + 1]
        known = first[np.isfinite(first)] if np.isfinite(first).any() else np.zeros(1)
        self._last = float(known[0])
        self._steps.learn(self._stamps.start(self._whole(known)))
        return self._time(block)

    def _time(self, block: RawBlock) -> Samples:
        step_s = self._steps.step or 1.0
        ticks = self._filled(block.ticks, step_s * self._rule.time_ticks_per_s)
        silence_s = steps_between(block.stamp_s, self._last_stamp_s)
        self._last_stamp_s = float(block.stamp_s[-1])
        stamped = self._stamps.time(ticks, lambda row: steps_in_silence(silence_s[row], step_s) * step_s)
        lost = self._steps.examine(stamped.step_s).lost
        is_set = stamped.reset & (stamped.step_s <= step_s)
        flags = np.where((lost > 0) & ~stamped.reset, np.uint32(Status.AFTER_GAP), np.uint32(0))
        flags[stamped.reset] |= np.uint32(Status.GAP_ESTIMATED)
        flags[is_set] |= np.uint32(Status.CLOCK_SET)
        statistics = self._statistics
        statistics.samples_lost += int(lost.sum())
        statistics.gaps += int(np.count_nonzero(flags))
        statistics.clock_resets += int(np.count_nonzero(is_set))
        mean_s = self._mean.by_stamps(stamped, self._steps.step)
        statistics.nominal_rate_hz = 1 / mean_s if mean_s else None
        return self._timed(block, stamped.time_s, flags)

    def _filled(self, ticks: Ticks, step: float) -> Ticks:
        """Put a regular step where the message with the time was lost."""
        known = np.isfinite(ticks)
        if not known.all():
            ticks = filled_in(ticks, known, self._last, step)
        if self._rule.time_modulus:
            ticks = ticks % self._rule.time_modulus
        self._last = float(ticks[-1])
        return self._whole(ticks)

    def _whole(self, ticks: Ticks) -> Ticks:
        # Stamps that wrap are whole numbers, and are unwrapped without rounding as such.
        return np.rint(ticks).astype(np.int64) if self._rule.time_modulus else ticks
