"""The sample clock: when each sample was taken, and how many are missing before it.

Three sources, in this order of trust:

* a *time stamp* of the instrument, unwrapped; whole wraps of it that are missing show as those of a counter;
* a *counter* of known rate, unwrapped: fewer losses than one wrap of it are counted exactly. More cannot be seen in it
  (256 counts at 2000 Hz are 128 ms). They show as a lag against the host clock that does not go away; samples are kept
  back until it is clear whether the lag is a burst of late data (nothing is missing) or whole wraps are;
* the *host clock*: samples in even steps at the measured rate, kept to the line of earliest arrivals.

Time never runs backwards. A time stamp that does (the instrument restarted, or set its clock) becomes a gap, as long as the
silence before it by the host's clock. On a CAN bus ``can_clock`` unwraps counters, and ``can_sent_time`` time stamps.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.acquire.clock.clock import Arrival, Arrivals, Clock, Reads
from imufield.acquire.clock.host_lag import LossWatch, TimedBlock
from imufield.acquire.clock.missing_samples import FREE_LAG_S, LEARN_FROM, StepRule, steps_in_silence
from imufield.acquire.clock.stamp_clock import LONGEST_PAUSE_S, MeanStep, StampClock, Stamped, steps_between
from imufield.acquire.decode.assembly import RawBlock, join
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.errors import ProtocolError, Reason
from imufield.samples import NO_COUNTER, FloatArray, IntArray, Samples, SampleUnits, Status, every, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_HALF_A_SAMPLE = 0.5
_MEASURE_RATE_S = 0.5  # Host time over which the rate is first measured where the instrument sends neither counter nor time.
# Share by which a stated rate may differ from the learned one before it is wrong: coarse time stamps learn badly.
LARGEST_RATE_ERROR = 0.25
# A step of a counter that puts a sample so far ahead of its arrival is none: above what waits in buffers, and drift.
_DISPROVED_S = 2.0
_SLEW = 0.1  # Largest part by which steps are stretched to follow the host clock.


class SampleClock(Clock):
    """Gives samples their time, block by block."""

    def __init__(self, rule: ClockRule, units: SampleUnits, statistics: DecoderStatistics) -> None:
        super().__init__(rule, units, statistics)
        self._has_time = bool(rule.time_field)
        self._has_counter = bool(rule.counter_field)
        # Which of time stamp, counter and host clock to go by is settled: not every stream has what its protocol has.
        self._chosen = False
        self._steps = StepRule()
        self._watch = LossWatch(1.0, 1.0)
        self._early: list[tuple[RawBlock, float]] = []
        self._started = False
        self._stamps = StampClock(rule)
        self._mean = MeanStep()
        self._mean_step_s = 0.0  # Of the time stamps; 0 while not known.
        self._last_counter = 0
        self._stamped_step_s = 0.0  # Regular step by the first time stamps, where a counter comes beside them.
        self._stamped_tick_s = 0.0  # The same of one tick of the counter.
        # Without time stamps, time is origin_s + ticks / tick_rate_hz: whole numbers, so that nothing adds up.
        self._tick_rate_hz = 1.0
        self._ticks = 0
        self._block_ticks: IntArray = np.empty(0, dtype=np.int64)  # Of the samples of the newest block, shape (n,).
        self._even: IntArray = np.zeros(1, dtype=np.int64)  # Multiples of the regular step, as many as a block needed.
        self._unit_ticks = 1
        self._unit_s = 1.0  # Of the smallest loss that only the host's clock shows; infinite where stamps show all.
        self._origin_s = 0.0
        self._shift_s = 0.0  # Added to even steps to follow the host clock, where there is neither time nor counter.

    def push(self, block: RawBlock, arrivals: Arrival | Arrivals) -> Samples | None:
        """Return the samples whose time is settled now, None if there are none.

        Parameters
        ----------
        block : RawBlock
        arrivals : Arrival or Arrivals
            Of the reads that this block comes from.
        """
        reads = arrivals.reads_of(block)
        if self._started:
            return self._emit(self._settle(block, reads))
        done: list[TimedBlock] = []
        begin = 0
        while not self._started and reads:
            end, arrival_s = reads.pop(0)
            self._early.append((block[begin:end], arrival_s))
            begin = end
            if self._enough_to_start():
                done = self._start_blocks()
        if reads:
            done += self._settle(block[begin:] if begin else block, [(end - begin, at_s) for end, at_s in reads])
        return self._emit(done)

    def flush(self) -> Samples | None:
        """Return what is still kept back; nothing will follow."""
        done = [] if self._started or not self._early else self._start_blocks()
        released = self._watch.finish()
        self._bend_each(released)
        done += released
        self._count_losses(np.empty(0), len(self._block_ticks))
        return self._emit(done)

    def _enough_to_start(self) -> bool:
        count = sum(len(block) for block, _ in self._early)
        if count > LEARN_FROM:
            self._choose()
        if self._has_counter or self._has_time:
            return count > LEARN_FROM
        span_s = self._early[-1][1] - self._early[0][1]
        return count > LEARN_FROM and (not math.isfinite(span_s) or span_s >= _MEASURE_RATE_S or count > 1 << 16)

    def _choose(self) -> None:
        """Settle by what the first samples have which clock to go by."""
        if self._chosen:
            return
        self._chosen = True
        first = join([block for block, _ in self._early])[: LEARN_FROM + 1]
        self._has_time &= self._stamps.tells_time(first.ticks, has_host=math.isfinite(self._early[0][1]))
        counted = bool(2 * np.count_nonzero(first.counter != NO_COUNTER) > len(first))
        others = self._has_time and self._rule.counter_counts_others
        # A counter whose rate nobody told counts samples and tells no time: the clock of the host does.
        paced = self._has_time or bool(self._rule.counter_ticks_per_s or self._rule.rate_hz)
        self._has_counter = self._has_counter and counted and paced and not others
        by_stamps = self._has_time and not self._has_counter
        self._steps = StepRule() if by_stamps else StepRule(self._rule.counter_steps, self._rule.counter_jitter)

    def _start_blocks(self) -> list[TimedBlock]:
        """Learn the regular step from the first samples, then time them like all others."""
        self._started = True
        self._choose()
        first = join([block for block, _ in self._early])[: LEARN_FROM + 1]
        first_steps_s = self._stamps.start(first.ticks) if self._has_time else np.empty(0)
        if self._has_counter:
            self._last_counter = int(first.counter[0])
            self._steps.learn(self._counter_steps(first)[1:].astype(np.float64))
            self._last_counter = int(first.counter[0]) - int(self._steps.step)
            self._stamped_step_s = _usual(first_steps_s)
            self._stamped_tick_s = self._stamped_step_s / self._steps.step
            told_hz = self._rule.counter_ticks_per_s or self._rule.rate_hz
            self._tick_rate_hz = told_hz or 1 / (self._stamped_tick_s or 1.0)
            self.by_rate = not self._has_time and self._tick_rate_hz == self._rule.rate_hz
        elif self._has_time:
            self._steps.learn(first_steps_s)
        else:
            self._start_by_host()
        self._ticks = -int(self._steps.step)
        self._unit_ticks = self._rule.counter_modulus if self._has_counter else 1
        self._unit_s = self._stamps.wrap_s if self._has_time else self._unit_ticks / self._tick_rate_hz
        self._watch = LossWatch(self._unit_s, self._unit_s / 2 if self._has_time or self._has_counter else FREE_LAG_S)
        self._check_interval(len(first))
        early, self._early = self._early, []
        return [timed for block, arrival_s in early for timed in self._settle(block, [(len(block), arrival_s)])]

    def _start_by_host(self) -> None:
        """Take the sample rate of the first blocks by the host's clock; the nominal one where that tells nothing."""
        (first, begin_s), (_, end_s) = self._early[0], self._early[-1]
        count = sum(len(block) for block, _ in self._early) - len(first)
        nominal = self._rule.rate_hz or 1.0
        measured = count / (end_s - begin_s) if end_s - begin_s >= _MEASURE_RATE_S and count else nominal
        # Near the nominal rate the first half second measures worse than the maker's crystal.
        self._tick_rate_hz = nominal if abs(measured / nominal - 1) < 2 * _SLEW else measured
        self._steps.step = 1.0
        self.by_rate = not math.isfinite(begin_s)
        self._statistics.follows_host = not self.by_rate
        if math.isfinite(begin_s):
            self._origin_s = begin_s - (len(first) - 1) / self._tick_rate_hz

    def _check_interval(self, learned_from: int) -> None:
        """Refuse a wrong sample interval of increments: every value would be wrong by that factor."""
        interval_s, step_s = self._units.interval_s, self._step_s
        if interval_s is None or learned_from <= LEARN_FROM or step_s <= 0 or not (self._has_counter or self._has_time):
            return
        if abs(step_s / interval_s - 1) > LARGEST_RATE_ERROR:
            wrong = sentence("sample_clock.rate", rate_hz=1 / step_s, stated_hz=1 / interval_s)
            raise ProtocolError(wrong, Reason.UNITS)

    @property
    def _step_s(self) -> float:
        """The regular step in s; 0 while not known."""
        return self._steps.step if self._has_time and not self._has_counter else self._steps.step / self._tick_rate_hz

    def _time(self, block: RawBlock, reads: Reads) -> TimedBlock:
        """Put one block on the clock."""
        stamped = None
        if self._has_time:
            stamped = self._stamps.time(block.ticks, lambda row: self._steps_of_silence(row, reads) * self._step_s)
        return self._time_evenly(block, stamped) or self._time_with_gaps(block, stamped, reads)

    def _time_evenly(self, block: RawBlock, stamped: Stamped | None) -> TimedBlock | None:
        """Put a block on the clock whose samples are all a regular step apart, as nearly always; None where they are not."""
        if self._rule.gaps_told or np.count_nonzero(block.skipped_before):
            return None
        if self._has_counter and self._steps.step > self._rule.counter_modulus:
            return None  # A step as long as a wrap stands still.
        if stamped is not None and not self._stamps_go_on(stamped):
            return None
        if self._has_counter:
            if not self._counter_goes_on(block.counter):
                return None
        elif stamped is None and (np.count_nonzero(block.lost_before) or not self._steps.are_regular(1.0, 1.0)):
            return None
        if stamped is None:
            self._block_ticks = self._even_ticks(len(block)) + self._ticks
            self._ticks = int(self._block_ticks[-1])
        else:
            self._learn_mean(stamped, np.full(len(block), self._steps.step) if self._has_counter else None)
        flags = np.zeros(len(block), dtype=np.uint32)
        if not (self._has_time or self._has_counter):
            flags.fill(Status.TIME_ESTIMATED)
        return TimedBlock(
            block=block,
            time_s=self._time_of(self._block_ticks) if stamped is None else stamped.time_s,
            flags=flags,
            fault=np.zeros(len(block), dtype=np.bool_),
            arrival_s=math.nan,
        )

    def _stamps_go_on(self, stamped: Stamped) -> bool:
        """Whether all steps of the time stamps are regular, or do not show that a counter beside them went round."""
        if stamped.range_s is None:
            return False
        lowest_s, highest_s = stamped.range_s
        return not self._shows_wraps(highest_s) if self._has_counter else self._steps.are_regular(lowest_s, highest_s)

    def _counter_goes_on(self, counter: IntArray) -> bool:
        """Whether a counter makes nothing but regular steps; if it does, they are taken note of."""
        step, modulus = self._steps.step, self._rule.counter_modulus
        # A counter with a sign goes below 0.
        if not every((self._even_ticks(len(counter)) + self._last_counter - counter) % modulus == 0):
            return False
        self._last_counter = int(counter[-1])
        return self._steps.are_regular(step, step)

    def _even_ticks(self, n: int) -> IntArray:
        """Return the ticks from the sample before to each of the next n if all are a regular step apart, shape (n,)."""
        step = int(self._steps.step)
        if len(self._even) < n or self._even[0] != step:
            self._even = step * np.arange(1, n + 1, dtype=np.int64)
        return self._even[:n]

    def _time_with_gaps(self, block: RawBlock, stamped: Stamped | None, reads: Reads) -> TimedBlock:
        flags = np.zeros(len(block), dtype=np.uint32)
        ticks = self._counter_steps(block) if self._has_counter else block.lost_before + 1
        by_silence = self._as_arrival_allows(ticks, stamped, reads) if self._has_counter else []
        steps = ticks.astype(np.float64)
        if stamped is not None:
            time_s = stamped.time_s
            flags[stamped.reset] |= np.uint32(Status.GAP_ESTIMATED)
            lasted = stamped.step_s > self._step_s
            flags[stamped.reset & ~lasted] |= np.uint32(Status.CLOCK_SET)
            self._statistics.clock_resets += int(np.count_nonzero(stamped.reset & ~lasted))
            by_silence += np.flatnonzero(stamped.reset & lasted).tolist()
            # The counter is exact but goes round; the stamps beside it tell how often it did.
            steps = self._add_wraps(steps, stamped.step_s) if self._has_counter else stamped.step_s
            self._learn_mean(stamped, steps if self._has_counter else None)
        else:
            # A counter that began anew without a silence is a clock that was set, too.
            is_set = [row for row in by_silence if ticks[row] == self._steps.step]
            flags[is_set] |= np.uint32(Status.GAP_ESTIMATED | Status.CLOCK_SET)
            self._statistics.clock_resets += len(is_set)
            self._block_ticks = self._ticks + ticks.cumsum()
            self._ticks = int(self._block_ticks[-1])
            time_s = self._time_of(self._block_ticks)
        found = self._steps.examine(steps)
        found.inexact[by_silence] = found.irregular[by_silence]
        fault = np.zeros(len(block), dtype=np.bool_)
        if self._rule.gaps_told:
            # The samples themselves tell of the losses; how many there are is in the time.
            estimated = (block.status & np.uint32(Status.GAP_ESTIMATED)) != 0
            counted = ((block.status & np.uint32(Status.AFTER_GAP)) != 0) & ~estimated
            self._statistics.gaps += int(np.count_nonzero(estimated | counted))
            self._statistics.samples_lost += int(found.lost[counted].sum())
            self._statistics.losses_estimated += int(found.lost[estimated].sum())
        else:
            if np.count_nonzero(found.irregular) or np.count_nonzero(block.skipped_before):
                flags[found.irregular & ~found.inexact] |= np.uint32(Status.AFTER_GAP)
                flags[found.inexact] |= np.uint32(Status.GAP_ESTIMATED)
                # A gap as long as the bytes that were passed over there needs no other explanation.
                unaccounted = np.abs(block.skipped_before - found.lost) > _HALF_A_SAMPLE
                fault = unaccounted & (found.irregular | (block.skipped_before > 0))
                self._statistics.samples_lost += int(found.lost.sum())
            self._statistics.gaps += int(np.count_nonzero(flags))
            if not (self._has_time or self._has_counter):
                flags |= np.uint32(Status.TIME_ESTIMATED)
        return TimedBlock(block=block, time_s=time_s, flags=flags, fault=fault, arrival_s=math.nan)

    def _learn_mean(self, stamped: Stamped, ticks: FloatArray | None) -> None:
        """Take note of how long samples take by their stamps; ``ticks`` are the steps of a counter beside them."""
        step = self._steps.step
        if ticks is None:
            self._mean_step_s = self._mean.by_stamps(stamped, step)
        elif self._stamped_tick_s > 0:
            self._mean_step_s = self._mean.by_counter(stamped, ticks, step, self._stamped_tick_s)

    def _counter_steps(self, block: RawBlock) -> IntArray:
        """Return how far the counter went to each sample; a standing one went round once. Shape (n,)."""
        steps = steps_between(block.counter, self._last_counter)
        self._last_counter = int(block.counter[-1])
        return (steps - 1) % self._rule.counter_modulus + 1

    def _as_arrival_allows(self, ticks: IntArray, stamped: Stamped | None, reads: Reads) -> list[int]:
        """Correct steps of a counter that arrival, or the time stamp beside it, disproves, in place, and return their rows.

        Nothing arrives before it was measured: at such a step the instrument began to count anew, or noise passed the
        checksum. As many samples are missing as the silence before it had room for.
        """
        step, rows = int(self._steps.step), []
        for row in np.flatnonzero(ticks > _DISPROVED_S * self._tick_rate_hz).tolist():
            if self._begins_anew(ticks, row, reads) if stamped is None else stamped.reset[row]:
                ticks[row] = step * self._steps_of_silence(row, reads)
                rows.append(row)
        return rows

    def _begins_anew(self, ticks: IntArray, row: int, reads: Reads) -> bool:
        """Whether a sample arrived before it was measured, by its counter; without arrival, whether the step is too long."""
        arrival_s = next(arrival_s for end, arrival_s in reads if end > row)
        if not math.isfinite(arrival_s):
            return bool(ticks[row] > LONGEST_PAUSE_S * self._tick_rate_hz)
        time_s = float(self._time_of(self._ticks + ticks[: row + 1].sum()))
        return self._watch.baseline.lag_s(arrival_s, time_s) < -_DISPROVED_S

    def _steps_of_silence(self, row: int, reads: Reads) -> int:
        """Return how many regular steps the silence before a row takes; 1 where there was none, or arrival is not known."""
        number = next(number for number, (end, _) in enumerate(reads) if end > row)
        begin, before_s = reads[number - 1] if number else (0, self._watch.last_arrival_s)
        end, arrival_s = reads[number]
        # Up to the last sample of the read, whose arrival it is; within a read nothing was silent.
        silence_s = arrival_s - before_s - (end - 1 - row) * self._step_s if row == begin else 0.0
        return steps_in_silence(silence_s, self._step_s)

    def _add_wraps(self, steps: FloatArray, step_s: FloatArray) -> FloatArray:
        """Return the steps of a counter with the whole wraps that the time stamps beside it show."""
        if self._stamped_step_s <= 0:
            return steps
        expected = step_s / self._stamped_step_s * self._steps.step
        wraps = np.maximum(np.rint((expected - steps) / self._rule.counter_modulus), 0)
        return np.asarray(steps + wraps * self._rule.counter_modulus)

    def _shows_wraps(self, step_s: float) -> bool:
        """Whether the time to a regular step of a counter shows that it went round meanwhile, as ``_add_wraps``."""
        expected = step_s / self._stamped_step_s * self._steps.step if self._stamped_step_s > 0 else 0.0
        return round((expected - self._steps.step) / self._rule.counter_modulus) > 0

    def _settle(self, block: RawBlock, reads: Reads) -> list[TimedBlock]:
        """Put a block on the clock; return what is settled now. ``reads`` has the last row and arrival of each read."""
        timed = self._time(block, reads)
        settled: list[TimedBlock] = []
        shifts = [(0, self._shift_s)]
        for end, arrival_s in reads:
            at = shifts[-1][0]
            if self._watch.passes(arrival_s, float(timed.time_s[end - 1])):
                shifts.append((end, self._follow_host(arrival_s, end - at)))
                continue
            settled += self._followed(timed, shifts)
            released = self._watch.push(timed.part(at, end, arrival_s))
            self._bend_each(released)
            settled += released
            self._count_losses(timed.time_s, end)
            shifts = [(end, self._shift_s)]
        return [*settled, *self._followed(timed, shifts)]

    def _time_of(self, ticks: IntArray) -> FloatArray:
        return np.asarray(ticks / self._tick_rate_hz + self._origin_s)

    def _count_losses(self, time_s: FloatArray, following: int) -> None:
        """Move on by what the host clock showed to be missing, with the samples of the newest block from a row on."""
        units, self._watch.lost_units = self._watch.lost_units, 0
        taken_back, self._watch.units_taken_back = self._watch.units_taken_back, 0
        self._statistics.gaps += self._watch.gaps
        self._watch.gaps = 0
        if taken_back:
            self._statistics.losses_estimated -= round(taken_back * self._unit_s / self._step_s)
        if units:
            self._statistics.losses_estimated += round(units * self._unit_s / self._step_s)
        if units and self._has_time:
            time_s[following:] = self._stamps.add_wraps(units, time_s[following:])
        elif units:
            self._ticks += units * self._unit_ticks
            # From whole ticks again: a sum of times would depend in its last bit on how reads were joined into blocks.
            self._block_ticks[following:] += units * self._unit_ticks
            time_s[following:] = self._time_of(self._block_ticks[following:])

    def _emit(self, done: list[TimedBlock]) -> Samples | None:
        if not done:
            return None
        self._measure()
        if len(done) == 1:
            return self._timed(done[0].block, done[0].time_s, done[0].flags)
        time_s, flags = np.concatenate([each.time_s for each in done]), np.concatenate([each.flags for each in done])
        return self._timed(join([each.block for each in done]), time_s, flags)

    def _bend_each(self, released: list[TimedBlock]) -> None:
        for timed in released:
            before_s, count = self._shift_s, len(timed.block)
            self._bend(timed.time_s, [(0, before_s), (count, self._follow_host(timed.arrival_s, count))])

    def _follow_host(self, arrival_s: float, count: int) -> float:
        """Move the shift of even steps towards the line of earliest arrivals, by the last read and its samples; return it.

        At once, as the line is another after the next read. Device time is left as it is. Without a slope, as where everything
        came at once (a dump), the rate learned at the start is the best there is.
        """
        baseline = self._watch.baseline
        by_host = math.isfinite(arrival_s) and not (self._has_time or self._has_counter)
        if by_host and baseline.slope is not None:
            wanted_s = baseline.offset_at(arrival_s) or 0.0
            largest_s = _SLEW * count / self._tick_rate_hz
            self._shift_s += min(max(wanted_s - self._shift_s, -largest_s), largest_s)
        return self._shift_s

    def _followed(self, timed: TimedBlock, shifts: list[tuple[int, float]]) -> list[TimedBlock]:
        """Bend the times of the samples between these rows, and return them; nothing where it is one row."""
        begin, end = shifts[0][0], shifts[-1][0]
        if begin == end:
            return []
        self._bend(timed.time_s, shifts)
        return [timed if end - begin == len(timed.block) else timed.part(begin, end, math.nan)]

    def _bend(self, time_s: FloatArray, shifts: list[tuple[int, float]]) -> None:
        """Shift even steps in place: up to each of these rows by as much as is given for it, evenly between them."""
        rows, shifts_s = zip(*shifts, strict=True)
        if shifts_s[0] or shifts_s[-1]:
            time_s[rows[0] : rows[-1]] += np.interp(self._even_ticks(rows[-1])[rows[0] :], rows, shifts_s)

    def _measure(self) -> None:
        """Write the sample rate by the instrument's clock and by the host's into the statistics."""
        step_s = self._mean_step_s or self._step_s
        if step_s <= 0:
            return
        self._statistics.nominal_rate_hz = 1 / step_s
        slope, sigma = self._watch.baseline.slope, self._watch.baseline.slope_sigma
        if slope is not None:
            self._statistics.rate_hz, self._statistics.rate_sigma = (1 - slope) / step_s, sigma


def _usual(steps_s: FloatArray) -> float:
    """Return the mean of the steps that are near the middle one; 0 where there are none at all."""
    positive = steps_s[steps_s > 0]
    if len(positive) == 0:
        return 0.0
    middle = float(median(positive))
    near = positive[np.abs(positive - middle) <= LARGEST_RATE_ERROR * middle]
    return float(np.mean(near)) if len(near) else middle
