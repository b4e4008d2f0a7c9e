"""The period of a bus that sends no time, by the stamps of its first samples.

Steps of an adapter's own stamps are even; those of a host come in bursts, with sleeps in between, and a bus falls silent.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.samples import FloatArray, median

LEARN_SAMPLES = 8
LEARN_S = 1.0
"""It takes more samples, for slow instruments, and as long: of bursts every 0.1 s a second shows the period within 1.5 %."""
_LONGEST_LEARN_S = 3.0  # Shorter than a bus is listened to before it counts as not understood.
# A step that many times the usual one is a host that slept; a rate takes so many sleeps.
_UNEVEN = 4.0
_SLEEPS = 8.0
_TRY_PART = 16  # It is tried anew with so much more of them; else a fast bus would try too often.
_MOST_LEARNED = 4096  # Samples after which the period is learned even if the stamps stand still.
_REGULAR = 0.25  # Part of a step by which stamps of an adapter jitter; bursts of a host are beyond.
_REGULAR_SHARE = 0.75  # Of the steps; the others are losses.
# Where so many steps are that long, and the others differ by that part, a sender may have been held up, with nothing lost.
_LONG_STEP = 1.5
_LONG_SHARE = 0.04
_LOOSE = 0.05
# Kuiper's statistic over the square root of the count: n independent losses leave an even pace by less in 1 of 1000.
_EVEN_RANGE = 0.55
_SHORTEST_OUTAGE_S = 0.1  # A host under load pauses as long at any time.
_MOST_OUTAGES = 8  # So many of the shortest fill most of the second that is learned from.
# A host that slept hands over half of what it owes, and more, within this part of its sleep; a bus that was silent sends no
# more than that part of it meanwhile.
_OWED_WITHIN = 0.15
_OWED_PART = 0.5
# It takes no longer for that; a pace is measured beside it if so much is left.
_LONGEST_OWED_S = 0.5
_LEAST_OUTSIDE_S = 0.25
# Part by which bursts may miss the nominal rate, which then is right: an outage of 0.1 s among them makes up to 17 %.
_NOMINAL_WITHIN = 0.2
_UNKNOWN_S = 0.01  # Where neither stamps nor a nominal rate tell.
_SHORTEST_S = 1e-6  # Shorter than any frame: stamps may nearly stand still, and lags are divided by the period.


def learned_from(stamp_s: FloatArray, tried: int) -> tuple[int, int]:
    """Tell from how many samples a period is learned; in whatever pieces they come, these are the same.

    Parameters
    ----------
    stamp_s : ndarray, shape (n,)
        All so far.
    tried : int
        What the call before returned second, ``LEARN_SAMPLES`` before the first.

    Returns
    -------
    samples : int
        0 if it takes more than there are.
    tried : int
    """
    while (following := tried + 1 + tried // _TRY_PART) <= len(stamp_s):
        tried = following
        if _enough(stamp_s[:tried]):
            return tried, tried
    return 0, tried


def _enough(stamp_s: FloatArray) -> bool:
    span_s = float(stamp_s[-1] - stamp_s[0])
    if len(stamp_s) <= LEARN_SAMPLES or span_s < LEARN_S:
        return len(stamp_s) >= _MOST_LEARNED
    steps_s = np.diff(stamp_s)
    longest_s = float(steps_s.max())
    # A host that sleeps hands over many samples at once: a rate takes several such sleeps, not a part of one.
    is_even = longest_s <= _UNEVEN * span_s / len(stamp_s)
    if is_even:
        long = int(np.count_nonzero(steps_s > _LONG_STEP * median(steps_s)))
        return long <= _LONG_SHARE * len(steps_s) or span_s >= _LONGEST_LEARN_S
    if span_s < min(_SLEEPS * longest_s, _LONGEST_LEARN_S):
        return False
    # An outage makes any span long, and shows nothing of the pace.
    pauses_s = np.sort(steps_s[steps_s >= max(LEARN_S, _UNEVEN * float(median(steps_s)))])[-_MOST_OUTAGES:]
    listened_s = span_s - float(pauses_s.sum())
    return listened_s >= LEARN_S * max(len(pauses_s), 1)


def sample_period_s(stamp_s: FloatArray, number: FloatArray, rate_hz: float) -> float:
    """Return the time from one sample to the next.

    Parameters
    ----------
    stamp_s : ndarray, shape (n,)
    number : ndarray, shape (n,)
        Of each sample, by the counter.
    rate_hz : float
        Nominal; 0 where not known.
    """
    nominal_s = 1 / rate_hz if rate_hz else 0.0
    if len(stamp_s) < 2 or stamp_s[-1] <= stamp_s[0]:
        return nominal_s or _UNKNOWN_S
    if number[-1] <= number[0]:
        # A counter that stands still numbers nothing.
        number = np.arange(len(stamp_s), dtype=np.float64)
    stamp_s = _without_outages(stamp_s, number)
    steps_s = np.diff(stamp_s) / np.maximum(np.diff(number), 1.0)
    middle_s = float(median(steps_s))
    regular = np.abs(steps_s - middle_s) <= _REGULAR * middle_s
    mean_s = float((stamp_s[-1] - stamp_s[0]) / (number[-1] - number[0]))
    # Frames read out of a buffer are evenly spaced too, but more closely than they come on the whole.
    if np.count_nonzero(regular) >= _REGULAR_SHARE * len(steps_s) and middle_s > max(mean_s / 2, 0.0):
        return _held_up_period(stamp_s, number, middle_s) or float(steps_s[regular].mean())
    # Bursts: the ends of the first and of the last ones are the least late.
    lag_s = stamp_s - number * mean_s
    third = max(len(lag_s) // 3, 1)
    early, late = int(np.argmin(lag_s[:third])), len(lag_s) - third + int(np.argmin(lag_s[-third:]))
    if late > early:
        mean_s += float((lag_s[late] - lag_s[early]) / max(number[late] - number[early], 1.0))
    return nominal_s if nominal_s and abs(mean_s / nominal_s - 1) < _NOMINAL_WITHIN else max(mean_s, _SHORTEST_S)


def _without_outages(stamp_s: FloatArray, number: FloatArray) -> FloatArray:
    """Return the stamps as if the bus had not been silent for a while: a pause after which nothing comes at once is a loss.

    A host that slept, or a sender that was held up, makes the same pause, and then hands over what it owes.
    """
    stamp_s = stamp_s.copy()
    steps_s = np.diff(stamp_s)
    pauses = [place for place in np.argsort(steps_s)[::-1][:_MOST_OUTAGES].tolist() if steps_s[place] >= _SHORTEST_OUTAGE_S]
    owed_s = [min(_OWED_WITHIN * float(steps_s[place]), _LONGEST_OWED_S) for place in pauses]
    behind = np.searchsorted(stamp_s, stamp_s[1:][pauses] + owed_s, side="right") - 1
    pace_s = _pace_without(stamp_s, number, list(zip(pauses, behind.tolist(), strict=True)))
    for place, last in zip(pauses, behind.tolist(), strict=True):
        pause_s = float(steps_s[place])
        if pause_s < _UNEVEN * pace_s:
            break
        if number[last] - number[place] < _OWED_PART * pause_s / pace_s:
            stamp_s[place + 1 :] -= pause_s - pace_s
    return stamp_s


def _pace_without(stamp_s: FloatArray, number: FloatArray, stretches: list[tuple[int, int]]) -> float:
    """Return the mean time from one sample to the next outside some stretches of them, or of all where little is left."""
    steps_s, counted = np.diff(stamp_s), np.diff(number)
    outside = np.ones(len(steps_s), dtype=np.bool_)
    for first, last in stretches:
        outside[first:last] = False
    if steps_s[outside].sum() < _LEAST_OUTSIDE_S or counted[outside].sum() <= 0:
        outside[:] = True
    # The steps of damaged stamps may cancel out.
    return max(float(steps_s[outside].sum() / max(counted[outside].sum(), 1.0)), _SHORTEST_S)


def _held_up_period(stamp_s: FloatArray, number: FloatArray, middle_s: float) -> float | None:
    """Return the period of a sender that wakes at intervals of its host, shorter than the period; None if it is none.

    Its steps are mostly such an interval, and now and then two: as with lost samples, but in turn, so that no stamp is far
    from an even pace. Independent losses leave it as a bridge of random steps does (Kuiper 1960), and with stamps that are
    good to a few percent a long step is a loss whatever its turn.
    """
    steps_s = np.diff(stamp_s)
    ratio = steps_s / np.maximum(np.diff(number), 1.0) / middle_s
    long = int(np.count_nonzero((ratio > _LONG_STEP) & (ratio < _UNEVEN)))
    low, high = np.quantile(ratio[np.abs(ratio - 1) <= _REGULAR], [0.1, 0.9])
    if long <= _LONG_SHARE * len(ratio) or high - low < _LOOSE:
        return None
    # A long pause is a loss or a delay: without it the rest tells the pace.
    missing = np.concatenate([[0.0], np.cumsum(np.where(ratio >= _UNEVEN, np.rint(ratio) - 1, 0.0))])
    found: list[tuple[float, float]] = []
    for counted in (number, number + missing):
        centred = counted - counted.mean()
        period_s = float(centred @ (stamp_s - stamp_s.mean()) / (centred @ centred))
        found.append((float(np.ptp(stamp_s - counted * period_s)) / max(period_s, _SHORTEST_S), period_s))
    spread, period_s = min(found)
    return period_s if period_s > middle_s and spread < _EVEN_RANGE * math.sqrt(long) else None
