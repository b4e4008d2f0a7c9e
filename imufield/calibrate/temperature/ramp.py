"""A ramp: the output of an instrument in one pose while its temperature changes, cut into blocks of temperature.

Lag. A thermometer that follows its sensor with a delay tau reads ``T - tau dT/dt``. Where the rate changes, and best where the
temperature rises and falls, ``output = p(T_read + tau dT/dt)`` shows tau; what a lag cannot explain of the difference between
the branches is hysteresis, which is a constant of each branch. The better of the two explanations counts, if it is one at all.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.temperature_polynomials import HIGHEST_ORDER
from imufield.calibrate.temperature.fit import SAME_TEMPERATURE_DEGC, RampBlocks
from imufield.dataclass import dataclass
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

FASTEST_DEGC_PER_MIN = 2.0
"""Above, sensor and thermometer differ, and a branch depends on the rate (ArduPilot's forum: 90 s over 80 degC was useless)."""
TOO_FAST_DEGC_PER_MIN = 1.1 * FASTEST_DEGC_PER_MIN
"""Told from here on: a ramp at the limit itself is estimated above it half of the time."""
LEAST_SPAN_DEGC = 10.0
"""ArduPilot's limit: below, the drift of the bias with time is as large as that with temperature."""
RATE_OVER_S = 60.0
"""The step of a thermometer, 0.1 degC, over a minute stays far below the limit of the rate."""
_MOST_BLOCKS = 40  # Over the span, each branch for itself: 20 show the order, more do not make it better.
_FEWEST_WINDOWS = 20
_TREND_OVER = 1 / 60  # Of the whole ramp: several steps of a coarse thermometer.
_SAME_READING_DEGC = 1e-6
_MOST_ALIKE = 0.5  # Of the windows read as the one before: then the steps of the thermometer are what changes.
# Of the span, in the time of a trend: an eighth of what a steady ramp of an hour or more does. Below, the ramp stands.
_STANDS = 0.002
_LONGEST_LAG_S = 300.0
_LAG_STEPS = 61  # 10 s apart: a parabola through three of them gives the rest.
_TURNED = 0.05  # Rad between two windows: 3 degrees, another pose.
_MOVED = 0.002  # Rad between two windows: 2 mg, ten times what a bias of 0.5 mg/degC does in 10 s at the fastest rate.
_LEAST_SIGMA = 1e-7  # Of the output: an axis that stands still has no noise to tell.
_CLEARLY = 1.5  # Hysteresis is taken where it explains clearly more; on a ramp that slows down the two look much alike.
_FEWEST_TO_TELL = 2  # Windows of a branch: their difference has a scatter.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RampWindows:
    """Means over n windows of some seconds, in order of time."""

    time_s: FloatArray
    """Shape (n,)."""
    temperature_degc: FloatArray
    """Shape (n,)."""
    output: FloatArray
    """Raw output less the raw zero, over the scale at the reference, m/s^2 or rad/s, shape (n, 3)."""
    specific_force_m_s2: FloatArray
    """Along the sensing axes, shape (n, 3); zeros for a gyroscope."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Ramp:
    """A ramp in blocks, and what it tells of itself."""

    blocks: RampBlocks
    fastest_degc_per_min: float
    lag_s: float
    """Of the thermometer behind the sensor; 0 where none was found or known."""

    @property
    def goes_both_ways(self) -> bool:
        """Whether the temperature rises and falls: else nothing shows a lag or hysteresis."""
        return {-1.0, 1.0} <= set(self.blocks.direction.tolist())


def cut_ramp(windows: RampWindows, known_lag_s: float = 0.0) -> Ramp:
    """Return a ramp in blocks of temperature, the lag of the thermometer taken out: its own, else a known one.

    Raises
    ------
    CalibrationError
        If there are too few windows, the temperature spans too little, or the instrument was moved.
    """
    known = np.isfinite(windows.temperature_degc) & np.isfinite(windows.output).all(axis=1)
    count, span = int(known.sum()), float(np.ptp(windows.temperature_degc[known])) if known.any() else 0.0
    if count < _FEWEST_WINDOWS or span < LEAST_SPAN_DEGC:
        short = sentence("ramp.short", windows=count, span=span, fewest=_FEWEST_WINDOWS, limit=LEAST_SPAN_DEGC)
        raise CalibrationError(short, Reason.TOO_FEW)
    time_s, read_degc, output = (a[known] for a in (windows.time_s, windows.temperature_degc, windows.output))
    force = windows.specific_force_m_s2[known]
    _require_one_pose(time_s, force)
    long_s = max(RATE_OVER_S, _TREND_OVER * float(np.ptp(time_s)))
    even_degc, trend = _smoothed(time_s, read_degc, long_s)
    direction = np.where(np.abs(trend) * long_s < _STANDS * span, 0.0, np.sign(trend))
    # The steps of a coarse thermometer are no changes; a fine one follows turns that a straight line would cut.
    is_coarse = np.mean(np.abs(np.diff(read_degc)) < _SAME_READING_DEGC) > _MOST_ALIKE
    degc, rate = (even_degc, trend) if is_coarse else (read_degc, _smoothed(time_s, read_degc, RATE_OVER_S)[1])
    lag_s = _lag(degc, rate, direction, output) or known_lag_s
    blocks = _blocks(degc + lag_s * rate, direction, output, force.mean(axis=0))
    return Ramp(blocks=blocks, fastest_degc_per_min=60 * float(np.abs(rate).max()), lag_s=lag_s)


def _require_one_pose(time_s: FloatArray, force: FloatArray) -> None:
    """Raise ``CalibrationError`` where the specific force turns from one window to the next."""
    turn = _turn_rad(force)
    if np.any(turn > _MOVED):
        row = int(np.argmax(turn))
        moved = sentence("ramp.moved", time_s=float(time_s[row]), turn=math.degrees(turn[row]), limit=math.degrees(_MOVED))
        raise CalibrationError(moved, Reason.BAD_DATA)


def turns(force: FloatArray) -> bool:
    """Return whether the specific force of windows, shape (n, 3), is that of more than one pose."""
    return bool(np.any(_turn_rad(force) > _TURNED))


def moved_windows(force: FloatArray) -> NDArray[np.intp]:
    """Return behind which of the windows, shape (n, 3), the instrument is not as it was, as a ramp must be."""
    return np.flatnonzero(_turn_rad(force) > _MOVED)


def in_one_pose(force: FloatArray) -> slice:
    """Return the longest run of windows, shape (n, 3), without a move: setting up and taking away are none of a ramp."""
    edges = np.concatenate([[0], moved_windows(force) + 1, [len(force)]])
    longest = int(np.argmax(np.diff(edges)))
    return slice(int(edges[longest]), int(edges[longest + 1]))


def _turn_rad(force: FloatArray) -> FloatArray:
    """Return the turn from each window to the next, shape (n - 1,); zeros for a triad that feels none."""
    size = np.linalg.norm(force, axis=1, keepdims=True)
    return np.asarray(np.linalg.norm(np.diff(force / np.where(size > 0, size, 1.0), axis=0), axis=1))


def _smoothed(time_s: FloatArray, read_degc: FloatArray, over_s: float) -> tuple[FloatArray, FloatArray]:
    """Return temperature and its rate, degC/s, by a straight line over some seconds about each window."""
    first = np.searchsorted(time_s, time_s - over_s / 2)
    behind = np.searchsorted(time_s, time_s + over_s / 2, side="right")
    # At least two windows, about gaps of a recording.
    first, behind = np.maximum(np.minimum(first, behind - 2), 0), np.maximum(behind, np.minimum(first + 2, len(time_s)))
    middle_s, middle_degc = float(time_s.mean()), float(read_degc.mean())
    t, x = time_s - middle_s, read_degc - middle_degc

    def mean(values: FloatArray) -> FloatArray:
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray((sums[behind] - sums[first]) / (behind - first))

    mean_t, mean_x = mean(t), mean(x)
    rate = (mean(t * x) - mean_t * mean_x) / (mean(t * t) - mean_t**2)
    return middle_degc + mean_x + rate * (t - mean_t), rate


def _lag(read_degc: FloatArray, rate: FloatArray, direction: FloatArray, output: FloatArray) -> float:
    """Return the lag of the thermometer behind the sensor in s; 0 where the branches do not ask for one."""
    if min((direction > 0).sum(), (direction < 0).sum()) < _FEWEST_TO_TELL + HIGHEST_ORDER:
        return 0.0
    nothing = np.zeros((len(rate), 0))
    lags = np.linspace(-_LONGEST_LAG_S, _LONGEST_LAG_S, _LAG_STEPS)
    misfits = np.array([_misfit(read_degc + lag * rate, output, nothing) for lag in lags])
    best = int(np.argmin(misfits))
    # Where the temperature stands, the hysteresis is that of the branch before.
    branch = direction[np.maximum.accumulate(np.where(direction != 0, np.arange(len(direction)), 0))]
    by_branch = _misfit(read_degc, output, branch[:, None])
    none = misfits[_LAG_STEPS // 2]
    # One parameter for all axes: as in the choice of orders, it must pay by the logarithm of what there is.
    pays = output.size * math.log(none / misfits[best]) > math.log(output.size)
    if not pays or misfits[best] > _CLEARLY * by_branch or best in (0, _LAG_STEPS - 1):
        return 0.0
    left, middle, right = misfits[best - 1 : best + 2]
    return float(lags[best] + (lags[1] - lags[0]) * (left - right) / (2 * (left - 2 * middle + right)))


def _misfit(temperature_degc: FloatArray, output: FloatArray, beside: FloatArray) -> float:
    """Return the sum of squares about a polynomial of the highest order, with more columns ``beside`` it."""
    unit = (temperature_degc - temperature_degc.mean()) / np.ptp(temperature_degc)
    columns = np.hstack([np.vander(unit, HIGHEST_ORDER + 1), beside])
    solution = np.linalg.lstsq(columns, output, rcond=None)[0]
    return float(np.sum((output - columns @ solution) ** 2))


def _blocks(temperature_degc: FloatArray, direction: FloatArray, output: FloatArray, force: FloatArray) -> RampBlocks:
    """Return the means over blocks of temperature, rising, falling and standing apart."""
    width = max(SAME_TEMPERATURE_DEGC, float(np.ptp(temperature_degc)) / _MOST_BLOCKS)
    number = np.floor((temperature_degc - temperature_degc.min()) / width).astype(int)
    label = 3 * number + (direction + 1).astype(int)
    _, block = np.unique(label, return_inverse=True)
    count = np.bincount(block).astype(np.float64)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(block, weights=values) / count)

    # Second differences are noise alone, 1 + 4 + 1 times its variance: a steady change of temperature drops out.
    noise = np.sqrt(np.mean(np.diff(output, n=2, axis=0) ** 2, axis=0) / 6)
    return RampBlocks(
        temperature_degc=mean(temperature_degc),
        output=np.column_stack([mean(column) for column in output.T]),
        sigma=np.maximum(noise, _LEAST_SIGMA * np.abs(output).max(axis=0) + np.finfo(np.float64).eps) / np.sqrt(count)[:, None],
        direction=mean(direction),
        specific_force_m_s2=force,
    )


def ramp_sentences(ramp: Ramp, name: str) -> tuple[str, ...]:
    """Return what a person must know of a ramp: too fast, or a thermometer that lags."""
    told = []
    if ramp.fastest_degc_per_min > TOO_FAST_DEGC_PER_MIN:
        limits = {"rate": ramp.fastest_degc_per_min, "limit": FASTEST_DEGC_PER_MIN}
        told.append(sentence("ramp.fast", name=name, **limits))
    if ramp.lag_s:
        told.append(sentence("ramp.lag", name=name, lag_s=ramp.lag_s))
    if not ramp.goes_both_ways:
        told.append(sentence("ramp.one_way", name=name))
    return tuple(told)
