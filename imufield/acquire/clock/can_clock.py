"""The sample clock of a bus: when each sample was taken, by the time stamps of its frames.

A CAN instrument seldom sends a time, and often no counter; what there is are the time stamps that the adapter or the kernel
gives to frames. They are late, never early: a frame waits for the bus, a driver hands over a burst. With i the number of the
sample, T the period and s the stamp, the lag

    L(i) = s(i) - i T

is therefore the true phase plus a delay, and its minimum over the samples that are stamped within the next quarter second,

    E(i) = min L(j)  over  j >= i  with  s(j) <= s(i) + 0.25 s,

is the phase without the delay of bursts, however long the host stood still before it handed one over. The time of a sample
is E(i) + i T. Where k samples are missing, L rises by k T and stays there, so E makes a step; a delay that passes makes none.
Such losses are estimates and flagged so. Where frames come in bursts longer than a period (an adapter without stamps of its
own), only steps beyond that delay can be told from it; a cable that becomes slower for good looks like a loss.

A counter in the messages numbers the samples itself: losses below half a wrap of it are exact. How many samples a longer one
took follows from the counter and the step of E together, and is an estimate. A time stamp of the instrument replaces all this.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.clock.can_period import LEARN_S, LEARN_SAMPLES, learned_from, sample_period_s
from imufield.acquire.clock.clock import Arrival, Arrivals, Clock, filled_in
from imufield.acquire.clock.frame_stamps import FrameStamps
from imufield.acquire.clock.stamp_clock import steps_between
from imufield.acquire.decode.assembly import RawBlock, join
from imufield.acquire.decode.statistics import NO_COUNT, DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.dataclass import dataclass, field, replace
from imufield.samples import FloatArray, IntArray, Samples, SampleUnits, Status, concatenate, every, median

_WINDOW_S = 0.25  # Longer than the delays of a busy host, as for serial ports.
_LEAST_WINDOW = 2  # Periods; slow instruments send less than that in a quarter second.
_USUAL_DELAY = 0.95
_BURST_S = 0.02  # Least step that counts where frames come in bursts: a host under load is late by as much at any time.
_DRIFT = 0.1  # Part of a period: a sample that moves the phase by more is off.
_DRIFT_RUN = 64  # Samples off in a row from which the rate has changed.
_LARGEST_MODULUS = 1 << 62  # Arithmetic is done in 64 bits with a sign.
_LEAST_ROUND = 2  # Counts; what goes to and fro between two numbers is noise, or one bit.
# Equal restarts, of the last twice as many: losses falsify some. A single one may be a restart of the instrument.
_SAME_RESTARTS = 4
_SAME_UNEVEN = 6  # Where the time stamps do not show what was lost at a restart: without losses most are equal.
_RECENT = 33  # Stamps that tell the usual step where samples come one by one.
_UNEVEN = 0.25  # Part of the usual step by which stamps may be off, and share of them that may be further off.
_LEAST_REGULAR = 0.25  # Share of the samples that follow by a step of a counter that counts them: three of four may be lost.
_MOST_STANDING = 0.25  # Share of samples that repeat the count before and are no copies.
_DISPROVED_S = 0.25  # A count that is further ahead of the stamps before it than this: the instrument was restarted.
_PERIOD_ERROR = 0.25  # Share of a gap to which the period is known: learned from bursts, or changed meanwhile.
_LATER = 0.02  # s/s by which the phase may rise: the period is not known exactly.
_FIRST_PART = 64  # Of a round: shorter rounds, whose losses are told to a few samples all the same, have no first counts.
_OUT_OF_ORDER = 4  # Most counts by which an overtaken frame is behind.
_LEAST_STEP = 0.25  # Part of a period by which time goes on from one sample to the next.


@dataclass(slots=True, kw_only=True)
class _Phase:
    """What is known once the period is learned."""

    period_s: float
    window_s: float
    unit: int = 1  # Samples in the smallest loss that only time shows: 1, or a wrap of the counter.
    number: float = 0.0  # Number of the next sample.
    delay_s: float = 0.0  # By which nearly all samples are late at most.
    visible_s: float = 0.0  # Smallest step of the phase that counts as loss.
    burst: int = 0  # How many samples usually come at once.
    is_blind: bool = False  # The stamps stand still: there is nothing but the number of the sample.
    base_s: float = 0.0  # Phase at the last sample given out.
    last_lag_s: float = 0.0  # By how much its own stamp lay behind its number.
    earliest_s: float = 0.0  # The earliest phase, less ``_LATER`` times its stamp.
    # Phases of the last samples given out: one more than a burst has.
    before_s: FloatArray = field(default_factory=lambda: np.empty(0))
    last_time_s: float = -np.inf
    run: int = 0


class CanClock(Clock):
    """Gives samples their time, block by block."""

    def __init__(self, rule: ClockRule, units: SampleUnits, statistics: DecoderStatistics) -> None:
        super().__init__(rule, units, statistics)
        self._pending: list[RawBlock] = []
        self._phase: _Phase | None = None
        self._tried = LEARN_SAMPLES  # Samples from which no period could be learned yet.
        self._stamps = FrameStamps()
        self._last_time_s = -np.inf
        self._late_s = 0.0  # How far the phase was above the earliest one when the last period ended.
        self._last_counter: int | None = None
        self._modulus = rule.counter_modulus
        self._first = 0  # The count that it begins anew with.
        # The last counts that came, and their stamps.
        self._newest, self._newest_s = np.empty(0, dtype=np.int64), np.empty(0)
        # Of the last restarts that the modulus does not explain: the modulus that does, and the count behind it.
        self._restarts: deque[tuple[int, int]] = deque(maxlen=2 * _SAME_RESTARTS)
        self._counter_step = 1
        self._unnumbered = 0  # Samples that passed and are not in ``number``.
        # Number and time of the first sample since the period was learned.
        self._begin: tuple[float, float] | None = None

    def push(self, block: RawBlock, arrivals: Arrival | Arrivals) -> Samples | None:  # noqa: ARG002  frames have their own stamps
        """Return the samples whose time is settled now, None if there are none."""
        self._settle_modulus(block)
        self._pending.append(self._continuous(block))
        return self._release(last=False)

    def flush(self) -> Samples | None:
        """Return what is kept back; nothing will follow."""
        return self._release(last=True) if self._pending else None

    def _settle_modulus(self, block: RawBlock) -> None:
        """Correct the stated modulus by the restarts that came: ranges of DBC files may be wrong, and many state none."""
        if not self._modulus:
            return
        seen, stamp_s = np.concatenate([self._newest, block.counter]), np.concatenate([self._newest_s, block.stamp_s])
        self._newest, self._newest_s = seen[-_RECENT:], stamp_s[-_RECENT:]
        before, fresh = self._modulus, seen[-len(block) - 2 :]
        if fresh[fresh.argmax()] >= self._first + before:
            self._widen(fresh)
        if not every(fresh[:-1] <= fresh[1:]):
            self._narrow(seen, np.diff(stamp_s), len(block))
        if self._modulus != before and self._phase is not None:
            self._set_unit(self._phase)

    def _narrow(self, seen: IntArray, steps_s: FloatArray, new_count: int) -> None:
        """Shorten the modulus when restarts show the same shorter one, and none between fits that in force.

        Time stamps show how many samples were lost at a restart. Where they are uneven, as in bursts, a restart counts only if
        the loss that the modulus in force implies could not have been so short.
        """
        steps = np.diff(seen)
        regular = np.isin(steps, self._rule.counter_steps)
        if np.count_nonzero(regular) < _RECENT // 2 or not (period_s := float(np.mean(steps_s[regular]))) > 0:
            return
        step = int(median(steps[regular].astype(np.float64)))
        is_even = float(np.quantile(np.abs(steps_s[regular] - period_s), 1 - _UNEVEN)) <= _UNEVEN * period_s
        # With all losses that the counter shows, a period is as short as it can be; a burst hides no more than it lasts.
        least_s = float(np.sum(steps_s)) / float(np.sum(steps % self._modulus)) * step
        burst_s = float(steps_s[regular].max()) + period_s / 2
        is_count = self._is_count(seen)
        falls = (steps[1:] < 0) & regular[:-1] & is_count[1:-1] & is_count[2:]
        for place in np.flatnonzero(falls).tolist():
            if place + 2 < len(seen) - new_count:
                continue
            last, first, passed_s = int(seen[place + 1]), int(seen[place + 2]), float(steps_s[place + 1])
            forward = (first - last) % self._modulus
            shown = max(round(passed_s / period_s), 1) if is_even else 1
            if forward in self._rule.counter_steps or forward <= shown * step or last - first < _LEAST_ROUND:
                self._restarts.clear()
            elif passed_s < ((1 + forward / step) / 2 * period_s if is_even else forward / step * least_s - burst_s):
                length = last - first + shown * step
                self._restarts.append((length, first))
                begins = [begin for known, begin in self._restarts if known == length]
                if len(begins) >= (_SAME_RESTARTS if is_even else _SAME_UNEVEN):
                    self._modulus, self._first = length, min(begins)

    def _widen(self, seen: IntArray) -> None:
        """Let a counter that goes on beyond its stated end go on to the next power of two.

        A number beyond the end is a count where those before and behind it fit; else it stands for something (15: none).
        """
        steps, end = np.diff(seen), self._first + self._modulus
        fits = (seen[1:-1] >= end) & (seen[:-2] >= 0) & np.isin(steps[:-1], self._rule.counter_steps)
        # From the number beyond the end the counter goes on by the same step, or begins anew behind it.
        goes_on = fits & (steps[1:] == steps[:-1])
        ends = [int(seen[2:][goes_on].max(initial=-1))]
        for place in np.flatnonzero(fits & (steps[1:] < 0) & (seen[2:] >= 0)).tolist():
            count, behind = int(seen[place + 1]), int(seen[place + 2])
            ends += [count] if (behind - count) % (1 << count.bit_length()) == steps[place] else []
        if max(ends) >= end:
            self._modulus, self._first = min(1 << max(ends).bit_length(), _LARGEST_MODULUS), 0

    def _is_count(self, counter: IntArray) -> NDArray[np.bool_]:
        return np.asarray((counter >= self._first) & (counter < self._first + self._modulus))

    def _continuous(self, block: RawBlock) -> RawBlock:
        """Take out jumps of the clock that made the stamps, and flag the samples behind them."""
        stamp_s, is_set = self._stamps.continuous(block.stamp_s)
        if is_set is None:
            return block if stamp_s is block.stamp_s else replace(block, stamp_s=stamp_s)
        self._statistics.clock_resets += int(np.count_nonzero(is_set))
        status = block.status | np.where(is_set, np.uint32(Status.CLOCK_SET), np.uint32(0))
        return replace(block, stamp_s=stamp_s, status=status)

    def _release(self, *, last: bool) -> Samples | None:
        done: list[Samples] = []
        # A period ends with the very sample that shows that it is wrong, in whatever pieces the samples come.
        while self._pending and (samples := self._release_period(last=last)) is not None:
            done.append(samples)
            if self._phase is not None:
                break
        return concatenate(done) if done else None

    def _release_period(self, *, last: bool) -> Samples | None:
        """Return the samples that are settled now, up to where the period is to be learned anew."""
        block = join(self._pending)
        self._pending = [block]
        if self._phase is None:
            samples, self._tried = learned_from(block.stamp_s, self._tried)
            if not last and not samples:
                return None
            self._tried = LEARN_SAMPLES
            self._phase = self._learn(block[: samples or len(block)])
            self._phase.last_time_s = self._last_time_s
        phase = self._phase
        ready = len(block) if last or phase.is_blind else _settled(block.stamp_s, phase.window_s)
        if ready <= 0:
            return None
        done = self._time(block, ready, phase)
        self._pending = [block[len(done) :]] if len(done) < len(block) else []
        return done

    def _learn(self, block: RawBlock) -> _Phase:
        """Learn the period, and the usual step of a counter."""
        known = np.flatnonzero(self._is_count(block.counter))
        if len(known) and self._modulus:
            steps, apart, steps_s = (np.diff(values[known]) for values in (block.counter, np.arange(len(block)), block.stamp_s))
            steps %= self._modulus
            counts = [np.count_nonzero(steps == step * apart % self._modulus) for step in self._rule.counter_steps]
            self._counter_step = self._rule.counter_steps[int(np.argmax(counts))]
            # The copy of a frame follows at once.
            standing = int(np.count_nonzero((steps == 0) & (steps_s * len(steps) > _UNEVEN * steps_s.sum())))
            is_odd = sum(counts) < _LEAST_REGULAR * len(steps) or standing > _MOST_STANDING * len(steps)
            if len(steps) >= LEARN_SAMPLES and is_odd:
                # It stands, runs back, or counts something else.
                self._modulus, self._last_counter = 0, None
                self._statistics.count(NO_COUNT, len(block))
            elif len(known) > len(block) / 2:
                first = int(known[0])
                self._last_counter = int(block.counter[first]) - (first + 1) * self._counter_step
        steps = self._without_steps_back(self._all_forward(self._filled(block.counter)))
        period_s = sample_period_s(block.stamp_s, np.cumsum(steps), self._rule.rate_hz)
        window_s = max(_WINDOW_S, _LEAST_WINDOW * period_s)
        phase = _Phase(period_s=period_s, window_s=window_s)
        lag_s = block.stamp_s - np.cumsum(steps) * period_s
        envelope_s = _minimum_ahead(lag_s, block.stamp_s, window_s, len(block))
        phase.base_s, phase.last_lag_s = float(envelope_s[0]), float(lag_s[0])
        phase.earliest_s = phase.base_s - self._late_s - _LATER * float(block.stamp_s[0])
        phase.delay_s = float(np.quantile(lag_s - envelope_s, _USUAL_DELAY))
        self._set_unit(phase)
        # An adapter or a log without time: nothing can be seen as missing, and nothing is waited for.
        if block.stamp_s[-1] <= block.stamp_s[0]:
            phase.is_blind, phase.base_s = True, 0.0
        return phase

    def _set_unit(self, phase: _Phase) -> None:
        """Settle which losses only time shows, and from which step of the phase on it does."""
        unit = self._modulus // self._counter_step if self._last_counter is not None else 1
        phase.unit = max(unit, 1)
        unit_s = phase.unit * phase.period_s
        # From half a wrap on the counter seems to go back, and the phase moves by one sample less.
        phase.visible_s, phase.burst = max(phase.unit / 2 - 1, 0.5) * phase.period_s, 0
        if 2 * phase.delay_s >= unit_s:
            phase.visible_s = max(2 * phase.delay_s, _BURST_S)
            phase.burst = math.ceil(phase.delay_s / phase.period_s)
            if self._last_counter is None:
                self._statistics.least_loss_s = max(self._statistics.least_loss_s, phase.visible_s)

    def _without_steps_back(self, forward: FloatArray) -> FloatArray:
        # More than half a round forward is a step back: frames out of order, or a restart.
        return np.where(forward > self._modulus / self._counter_step / 2, 1.0, np.rint(forward))

    def _are_anew(self, forward: FloatArray, block: RawBlock, phase: _Phase) -> NDArray[np.bool_]:
        """Return which steps are restarts: frames come late, never early, so a count far ahead of its stamp did not go on.

        Nor did one of the first counts of a long round whose stamp, and those behind it, are as far behind: a late hand-over
        catches up.
        """
        anew, stamp_s, T = np.zeros(len(forward), dtype=np.bool_), block.stamp_s, phase.period_s
        if phase.is_blind or self._last_counter is None:
            return anew
        # Not where a frame has overtaken another, nor where the clock of the stamps was set.
        long = (forward * T > _DISPROVED_S) & (self._modulus - forward * self._counter_step > _OUT_OF_ORDER)
        is_first = (block.counter - self._first) % self._modulus <= self._modulus / _FIRST_PART
        is_first &= (forward > 1) & self._is_count(block.counter) & (self._modulus >= _FIRST_PART * self._counter_step)
        places = np.flatnonzero((long | is_first) & ((block.status & np.uint32(Status.CLOCK_SET)) == 0)).tolist()
        if not places:
            return anew
        steps, tolerance_s = self._without_steps_back(forward), max(_DISPROVED_S, 2 * phase.delay_s)
        before = phase.number + np.cumsum(steps) - steps
        early_s = stamp_s - (before + steps) * T - _LATER * stamp_s
        earliest_s, shift_s, done = phase.earliest_s, 0.0, 0
        for place in places:
            earliest_s = min(earliest_s, float(early_s[done:place].min(initial=math.inf)) + shift_s)
            done, leap_s = place, float(forward[place]) * T
            lag_s = float(stamp_s[place] - before[place] * T) - leap_s + shift_s
            last_s = float(stamp_s[place - 1] - before[place] * T) + shift_s if place else phase.last_lag_s
            is_ahead = long[place] and earliest_s + _LATER * stamp_s[place] - lag_s > tolerance_s + _PERIOD_ERROR * leap_s
            behind = stamp_s[place:] <= stamp_s[place] + phase.window_s
            later_s = (stamp_s[place:] - (before[place:] + steps[place:]) * T)[behind].min() + float(steps[place]) * T - leap_s
            if is_ahead or (is_first[place] and later_s + shift_s - last_s > tolerance_s):
                anew[place] = True
                shift_s += float(steps[place] - 1) * T
        return anew

    def _filled(self, counter: IntArray) -> NDArray[np.int64 | np.float64]:
        """Return the counts, those of lost counter messages as if it went on from the last one known."""
        known = self._is_count(counter)
        return counter if every(known) else filled_in(counter, known, self._last_counter or 0, self._counter_step)

    def _all_forward(self, counts: NDArray[np.int64 | np.float64]) -> FloatArray:
        """Return the steps as if all went forward, from 0 up to one wrap, in samples; 1 without a counter. Shape (n,)."""
        if self._last_counter is None:
            return np.ones(len(counts))
        return np.asarray(steps_between(counts, self._last_counter) % self._modulus / self._counter_step, dtype=np.float64)

    def _time(self, block: RawBlock, ready: int, phase: _Phase) -> Samples:
        """Give the first ``ready`` samples of the block their time, fewer where the rate has changed behind them."""
        counts = self._filled(block.counter)
        forward = self._all_forward(counts)
        anew = self._are_anew(forward, block, phase)
        forward[anew] = 1.0
        steps = self._without_steps_back(forward)
        number = phase.number + np.cumsum(steps)
        lag_s = block.stamp_s - number * phase.period_s
        envelope_s = np.zeros(ready) if phase.is_blind else _minimum_ahead(lag_s, block.stamp_s, phase.window_s, ready)
        moved_s = steps_between(envelope_s, phase.base_s)
        least_s, most_s = moved_s.item(moved_s.argmin()), moved_s.item(moved_s.argmax())
        is_steady = max(-least_s, most_s) <= _DRIFT * phase.period_s
        if is_steady:
            phase.run = 0
        else:
            ready = _until_rate_changes(moved_s, phase)
            envelope_s, moved_s = envelope_s[:ready], moved_s[:ready]
        time_s = envelope_s + number[:ready] * phase.period_s
        forward, steps, anew = forward[:ready], steps[:ready], anew[:ready]
        if self._last_counter is not None:
            # Not modulo: the counter may turn out to go on beyond the end that it has so far.
            self._last_counter = int(counts[ready - 1])
        phase.earliest_s = min(phase.earliest_s, float((lag_s[:ready] - _LATER * block.stamp_s[:ready]).min()))
        phase.base_s, phase.number, phase.last_lag_s = float(envelope_s[-1]), float(number[ready - 1]), float(lag_s[ready - 1])
        stands = is_steady and most_s < phase.visible_s
        if stands and every(steps >= 1) and time_s[0] >= phase.last_time_s + _LEAST_STEP * phase.period_s:
            # No loss by time, and time runs forward, from the end of a period learned before as well.
            phase.last_time_s = float(time_s[-1])
            estimated = None
        else:
            estimated = _losses(envelope_s, moved_s, phase, forward=forward, steps=steps, anew=anew)
            time_s = _forward(time_s, phase)
        before_s = envelope_s if ready > phase.burst else np.concatenate([phase.before_s, envelope_s])
        phase.before_s = before_s[-phase.burst - 1 :]
        self._begin = self._begin or (float(number[0]) + self._unnumbered, float(time_s[0]))
        if estimated is not None:
            # A count that comes again behind a loss is that of another sample.
            self._unnumbered += int(estimated.sum()) + int(np.count_nonzero(estimated[steps == 0]))
        samples = self._samples(block[:ready], time_s, steps, estimated)
        # The rate as learned, and as measured since the first sample.
        self._statistics.nominal_rate_hz = self._rule.rate_hz or 1 / phase.period_s
        span_s = phase.last_time_s - self._begin[1]
        self._statistics.follows_host = not phase.is_blind
        if span_s >= 2 * LEARN_S:
            self._statistics.rate_sigma = phase.delay_s / span_s
            self._statistics.rate_hz = (phase.number + self._unnumbered - self._begin[0]) / span_s
        self._last_time_s = phase.last_time_s
        # A wrong period moves the phase at every sample; it is learned anew, with time going on where it was.
        if phase.run >= _DRIFT_RUN:
            self._late_s = max(phase.base_s - phase.earliest_s - _LATER * float(block.stamp_s[ready - 1]), 0.0)
            self._phase = self._begin = None
        return samples

    def _samples(self, block: RawBlock, time_s: FloatArray, steps: FloatArray, estimated: IntArray | None) -> Samples:
        flags = np.empty(len(block), dtype=np.uint32)
        flags.fill(Status.TIME_ESTIMATED)
        statistics = self._statistics
        gaps = steps > 1
        if gaps.any():
            flags[gaps] |= np.uint32(Status.AFTER_GAP)
            statistics.samples_lost += int(steps[gaps].sum()) - int(np.count_nonzero(gaps))
        if estimated is not None and np.count_nonzero(estimated):
            flags[estimated > 0] |= np.uint32(Status.GAP_ESTIMATED)
            statistics.losses_estimated += int(estimated.sum())
            gaps = gaps | (estimated > 0)
        statistics.gaps += int(np.count_nonzero(gaps))
        return self._timed(block, time_s, flags)


def _until_rate_changes(moved_s: FloatArray, phase: _Phase) -> int:
    """Return how many samples there are before the phase has run away, which a wrong period makes it do: all if it has not."""
    place = np.arange(len(moved_s))
    # Where the phase last stood still, at or before each sample.
    stood = np.maximum.accumulate(np.where(np.abs(moved_s) > _DRIFT * phase.period_s, -1 - phase.run, place))
    run = place - stood
    count = int(np.argmax(run >= _DRIFT_RUN)) + 1 if run.max() >= _DRIFT_RUN else len(run)
    phase.run = int(run[count - 1])
    return count


def _losses(
    envelope_s: FloatArray,
    moved_s: FloatArray,
    phase: _Phase,
    *,
    forward: FloatArray,
    steps: FloatArray,
    anew: NDArray[np.bool_],
) -> IntArray:
    """Return how many samples are missing before each one by the steps of the phase. Shape (n,).

    Whole units of them, and what the counter shows if a step that seemed to go back, or none, was one forward; what the stamps
    show where the counter began ``anew``.
    """
    lost = np.zeros(len(moved_s), dtype=np.int64)
    for place in np.flatnonzero(moved_s >= np.where(anew, phase.period_s / 2, phase.visible_s)).tolist():
        # The last burst before a loss has nothing behind it that shows how late it was.
        before = np.concatenate([phase.before_s, envelope_s[:place]])[-phase.burst - 1 :]
        step_s = envelope_s[place] - before.min() if len(before) else moved_s[place]
        step = round(float(steps[place]))
        # What the counter went on by if the step that was taken for one back was forward.
        unseen = round(float(forward[place])) - step
        unit = 1 if anew[place] else phase.unit
        units = round((float(step_s) / phase.period_s - unseen) / unit)
        # A count that was repeated is one sample less.
        lost[place] = max(units * unit + unseen + min(step - 1, 0), 0)
    return lost


def _settled(stamp_s: FloatArray, window_s: float) -> int:
    """Return how many samples have all those behind them that are stamped within the window."""
    order_s = np.maximum.accumulate(stamp_s)
    return int(order_s.searchsorted(order_s[-1] - window_s, side="left"))


def _minimum_ahead(values: FloatArray, stamp_s: FloatArray, window_s: float, count: int) -> FloatArray:
    """Return the least of each of the first ``count`` values and those that follow it with stamps within the window."""
    order_s = np.maximum.accumulate(stamp_s)
    end = order_s.searchsorted(order_s[:count] + window_s, side="right")
    if count <= end[0]:
        # All windows have the values from the last of their beginnings to the first of their ends in common.
        before = np.minimum.accumulate(values[count - 1 :: -1])[::-1]
        behind = np.minimum.accumulate(values[end[0] - 1 : end[-1]])
        least = np.minimum(before, np.minimum.reduce(values[count - 1 : end[0]]))
        return np.asarray(np.minimum(least, behind[end - end[0]]))
    begin = np.arange(count)
    # The largest power of two that fits into each window; two such stretches, one at either end, cover it.
    power = np.frexp((end - begin).astype(np.float64))[1] - 1
    least, stretch = values[:count].copy(), values
    # Nearly always all windows hold about as many samples, and the shorter stretches are steps on the way only.
    shortest = int(power.min())
    for exponent in range(int(power.max()) + 1):
        if exponent:
            half = 1 << (exponent - 1)
            stretch = np.minimum(stretch[:-half], stretch[half:])
        if exponent >= shortest:
            here = power == exponent
            least[here] = np.minimum(stretch[begin[here]], stretch[end[here] - (1 << exponent)])
    return least


def _forward(time_s: FloatArray, phase: _Phase) -> FloatArray:
    """Keep time from running backwards: by a quarter of a period at least from one sample to the next."""
    least_s, kept = _LEAST_STEP * phase.period_s, time_s.tolist()
    # One by one: sums over a block would round otherwise with every way to cut it.
    for place, wanted_s in enumerate(kept):
        kept[place] = phase.last_time_s = max(wanted_s, phase.last_time_s + least_s)
    return np.array(kept)
