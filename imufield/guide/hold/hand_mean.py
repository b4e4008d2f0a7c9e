"""The mean of a hold in the hand: every sample turned into one frame with the gyroscope, then a Hann-tapered mean.

A wobbling unit shortens the mean vector by half the squared tilt. That cannot be corrected from the variance: with the pivot
some centimetres off the sensor most of it is tangential acceleration (docs/maths.md, stillness). So the samples are turned:

    C_i = exp(d_1) exp(d_2) ... exp(d_i),    d_i = (w_i + w_{i-1}) / 2 - w_0, times the interval,
    f = sum h_i C_m^T C_i f_i / sum h_i,     h the Hann taper, C_m the mean attitude under that taper.

The frame is the mean attitude, because scale and misalignment are not known yet: what they do to a sample turned by a small
angle is linear in it, and vanishes in the mean. The rate taken off, ``w_0``, is the mean rate of the hold; it still holds the
net turn, and the drift of the turned force shows it, so its part across the vertical is taken off in a second pass.

What tremor leaves in the mean is a product of the turn and the acceleration of the arm, and both must be right to a percent at
12 Hz: 0.1 deg and 10 cm make 350 ug of it. So the turn is interpolated by polynomials, lost samples are bridged, means over
several samples are sharpened, and the gyroscope is moved by its delay, which the hold itself shows (``triad_delay``).

The covariance comes from the same taper shifted to 2, 3, 4 and 5 cycles per hold, where the mean itself has no power: the
power next to zero frequency, a multitaper estimate with eight degrees of freedom. The motion of the arm falls towards zero
frequency: a hand that stays in its place has a displacement that grows no faster than 1/f, hence an acceleration that
falls at least with f, and each of the four is extrapolated to 1 cycle by that law. The instrument's own noise, known from the
noise floor, does not fall and is added.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.rotation import cross, exponential, logarithm, matrix, multiply, running_turns
from imufield.dataclass import dataclass
from imufield.guide.hold.triad_delay import triad_delay
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import CELL_S, FloatArray, Samples, interval_of, median

_STEP_S = 0.004  # Samples closer than this are averaged first: tremor of 0.1 deg turns 0.03 deg in it.
_TREMOR_S = 0.25  # A running mean this long separates tremor (above 4 Hz) from sway.
_EDGE_S = 0.4  # Width of the edges of a hole in the taper: a sharp one would let the tremor through.
_CYCLES = (2, 3, 4, 5)  # Per hold: 1 is the mean's own, and more than 5 are farther from zero frequency than the sway.
_PASSES = 2  # The first leaves less than the square of the net turn, the second nothing that matters.
# The change of the mean by turning is known to this share: scale of the gyroscope before calibration, filters of both.
_GAIN_SIGMA = 0.01
_FEWEST = 20  # Samples and steps of a hold; the shortest hold of the slowest instrument has more.
_POINTS = 8  # Of an interpolation: with six, a sample lost at 100 Hz is known to 1 % of a tremor at 12 Hz, with eight to 0.2 %.
_REGULAR = 0.2  # Share of the sample interval: stamps that come closer do not tell where samples are missing.
_BRIDGED_S = 0.04  # Samples are bridged over holes up to this long; half a period of tremor at 12 Hz.
# Spacing of the second difference that tells a bump: it passes 30 Hz seven times better than the tremor at 10 Hz.
_JOLT_S = 0.01
_ACROSS_HOLE = 1.5  # Of the usual time between three forces.
_LEAST_SWAY_RAD = 1e-6  # The net turn about the vertical is known no better than to this.


@dataclass(frozen=True, slots=True, kw_only=True)
class HandMean:
    """The measurement of a hold in the hand.

    Attributes
    ----------
    force_raw : ndarray, shape (3,)
        Mean raw accelerometer rate in the frame of the mean attitude.
    covariance_raw : ndarray, shape (3, 3)
        Of that mean.
    gyroscope_raw : ndarray, shape (3,)
        Mean raw rate without the net turn across the vertical.
    gyroscope_covariance_raw : ndarray, shape (3, 3)
    gyroscope_noise_raw : ndarray, shape (3,)
        At rest, as given.
    middle_s : float
        First sample of the cell in the middle.
    middle_rad : ndarray, shape (3,)
        Turn from the mean attitude to that at ``middle_s``, rotation vector.
    tremor_deg, sway_deg : float
        RMS turn of each axis above and below 4 Hz.
    jolt_m_s2, usual_jolt_m_s2 : float
        Largest second difference of the turned force over steps of 10 ms, and the median one: that of the tremor.
    jolt_after_s : float
        From the begin of the hold to the largest one.
    """

    force_raw: FloatArray
    covariance_raw: FloatArray
    gyroscope_raw: FloatArray
    gyroscope_covariance_raw: FloatArray
    gyroscope_noise_raw: FloatArray
    middle_s: float
    middle_rad: FloatArray
    tremor_deg: float
    sway_deg: float
    jolt_m_s2: float
    usual_jolt_m_s2: float
    jolt_after_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Steps:
    """Means over whole numbers of samples, ``_STEP_S`` at most; rates in rad/s, forces raw less mid-scale."""

    time_s: FloatArray
    force: FloatArray
    rate: FloatArray
    edge_s: FloatArray  # Begin of each step and end of the last, shape (n + 1,).
    turned: FloatArray  # Integral of the rate up to each edge, rad, shape (n + 1, 3).
    keep: FloatArray  # Share by which the step counts: 0 in a knock, shape (n,).


def mean_in_hand(
    samples: Samples, scale: RoughScale, noise_density_raw: FloatArray, knocks_s: FloatArray | None = None
) -> HandMean | None:
    """Return the mean of a hold in the hand, None where it has too few samples or the gyroscope's scale is not known.

    Parameters
    ----------
    samples : Samples
        Of the hold, guard bands off, in time order.
    scale : RoughScale
    noise_density_raw : ndarray, shape (6,)
        Of accelerometer and gyroscope at rest, raw rate per sqrt(Hz).
    knocks_s : ndarray, shape (k, 2), optional
        Begin and end of knocks; their samples are followed by the gyroscope and left out of the mean.
    """
    steps = _average(samples, scale, np.empty((0, 2)) if knocks_s is None else knocks_s)
    if steps is None:
        return None
    # Hann weights that add up to 1, 0 in knocks.
    place = (steps.time_s - steps.time_s[0]) / np.ptp(steps.time_s)
    taper = np.sin(np.pi * place) ** 2 * steps.keep * np.diff(steps.edge_s)
    taper = taper / taper.sum()
    delay_s = triad_delay(steps.time_s, steps.force, steps.rate, steps.keep).delay_s
    rest, turned, attitude = _turn(steps, taper, delay_s)
    mean = taper @ turned
    angle = logarithm(attitude)
    tremor = angle - _running_mean(angle, steps.time_s)
    sway = angle - tremor
    white = noise_density_raw[:3] ** 2 * float(taper @ taper) / float(median(np.diff(steps.time_s)))
    tremor_rad = float(np.sqrt(np.mean(tremor.var(axis=0))))
    deviation = turned - mean
    # A wrong gain g of the turns leaves 1 - g of what they remove from the mean: the centripetal force of the arm.
    left = _GAIN_SIGMA * (taper @ cross(angle, deviation))
    cycles = np.exp(2j * np.pi * np.array(_CYCLES)[:, None] * place)
    amplitude = (cycles * taper) @ deviation / np.array(_CYCLES)[:, None]
    spread = np.real(amplitude.T @ amplitude.conj()) / len(_CYCLES) + np.diag(white) + np.outer(left, left)
    sway_rad = float(np.sqrt(np.mean(sway.var(axis=0))))
    gyroscope_scale = scale.gyroscope or math.nan
    # Gravity does not show heading: the net turn about the vertical stays in the mean rate, as large as the sway.
    turn_sigma = gyroscope_scale * math.sqrt(2) * max(sway_rad, _LEAST_SWAY_RAD) / float(np.ptp(steps.time_s))
    # Moves are cut where a cell begins, by the times of the gyroscope.
    slots = interval_of(samples.time_s, CELL_S)
    middle_s = float(samples.time_s[np.searchsorted(slots, slots[len(slots) // 2])])
    jolt, usual_jolt, jolt_after_s = _jolt(steps.time_s, turned / (scale.accelerometer or math.nan))
    return HandMean(
        force_raw=mean + scale.raw_zero,
        covariance_raw=spread,
        gyroscope_raw=rest * gyroscope_scale,
        gyroscope_covariance_raw=np.eye(3) * turn_sigma**2,
        gyroscope_noise_raw=noise_density_raw[3:],
        middle_s=middle_s,
        middle_rad=np.array([np.interp(middle_s, steps.time_s + delay_s, column) for column in angle.T]),
        tremor_deg=math.degrees(tremor_rad),
        sway_deg=math.degrees(sway_rad),
        jolt_m_s2=jolt,
        usual_jolt_m_s2=usual_jolt,
        jolt_after_s=jolt_after_s,
    )


def _jolt(time_s: FloatArray, force: FloatArray) -> tuple[float, float, float]:
    """Return the largest second difference of a force (n, 3), the median one, and when the largest was, from the begin."""
    stride = max(1, round(_JOLT_S / float(median(np.diff(time_s)))))
    if len(force) < 4 * stride:
        return 0.0, math.inf, math.nan
    size = np.linalg.norm(force[2 * stride :] - 2 * force[stride:-stride] + force[: -2 * stride], axis=1)
    # Across a hole the three are farther apart, and tremor makes more of it.
    span_s = time_s[2 * stride :] - time_s[: -2 * stride]
    size[span_s > _ACROSS_HOLE * median(span_s)] = 0.0
    largest = int(np.argmax(size))
    return float(size[largest]), float(median(size)), float(time_s[largest + stride] - time_s[0])


def _average(samples: Samples, scale: RoughScale, knocks_s: FloatArray) -> _Steps | None:
    """Return means of the samples that count, over whole numbers of them, ``_STEP_S`` at most, short holes bridged."""
    force, rate = samples.accelerometer_rate(), samples.gyroscope_rate()
    good = samples.usable & np.isfinite(force).all(axis=1) & np.isfinite(rate).all(axis=1)
    if scale.gyroscope is None or np.count_nonzero(good) < _FEWEST:
        return None
    force, rate = force[good] - scale.raw_zero, rate[good] / scale.gyroscope
    gap = np.diff(samples.time_s[good])
    sample_s = float(median(gap)) or float(gap.mean())
    if not sample_s > 0:
        return None
    time_s, force, rate = _bridged(samples.time_s[good], force, rate, sample_s)
    each = max(int(_STEP_S / sample_s + 1e-6), 1)
    # Half a sample off the border between two steps, where the rounding of a stamp would decide.
    step = np.floor((time_s - time_s[0]) / (each * sample_s) + 0.5 / each).astype(np.int64)
    first = np.flatnonzero(np.diff(step, prepend=step[0] - 1))
    count = np.diff(np.append(first, len(step)))[:, None]
    if len(first) < _FEWEST:
        return None
    mean_s = np.add.reduceat(time_s, first) / count[:, 0]
    spread = np.add.reduceat((time_s - np.repeat(mean_s, count[:, 0])) ** 2, first) / count[:, 0]
    # A sample of the rate is the mean over its own interval, so at the edges half-way nothing is interpolated.
    half = np.diff(time_s) / 2
    edge_s = np.concatenate([time_s[:1] - half[0], time_s[:-1] + half, time_s[-1:] + half[-1]])
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(rate * np.diff(edge_s)[:, None], axis=0)])
    at_edges = np.append(first, len(step))
    away = np.maximum(knocks_s[:, 0] - _STEP_S - mean_s[:, None], mean_s[:, None] - knocks_s[:, 1] - _STEP_S)
    keep = np.sin(np.pi / 2 * np.clip(away / _EDGE_S, 0.0, 1.0)) ** 2
    return _Steps(
        time_s=mean_s,
        force=_sharpened(mean_s, np.add.reduceat(force, first, axis=0) / count, spread),
        rate=np.add.reduceat(rate, first, axis=0) / count,
        edge_s=edge_s[at_edges],
        turned=turned[at_edges],
        keep=keep.min(axis=1, initial=1.0),
    )


def _bridged(
    time_s: FloatArray, force: FloatArray, rate: FloatArray, sample_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return samples with short holes filled.

    One lost at 100 Hz would let through up to 160 ug of a tremor of 0.1 deg at 12 Hz, 10 cm across.
    """
    gap = np.diff(time_s)
    lost = np.rint(gap / sample_s).astype(np.int64) - 1
    # Through means over a quarter of the hole: a polynomial through the nearest samples alone magnifies their noise.
    each, place = lost * 2 // _POINTS + 1, np.arange(1, len(time_s))
    # At an end, where the taper is zero, they do not lie on both sides.
    inside = np.minimum(place, len(time_s) - place) >= each * _POINTS // 2
    holes = np.flatnonzero((lost > 0) & (gap <= _BRIDGED_S) & inside)
    # Stamps too coarse for the rate come in pairs, and no two samples tell what is missing between them.
    if not len(holes) or gap.min() < _REGULAR * sample_s:
        return time_s, force, rate
    missing = np.concatenate([time_s[k] + gap[k] * np.arange(1, lost[k] + 1) / (lost[k] + 1) for k in holes])
    samples = np.concatenate([force, rate], axis=1)
    nodes, values = np.empty((len(holes), _POINTS)), np.empty((len(holes), _POINTS, 6))
    for size in np.unique(each[holes]).tolist():
        which = each[holes] == size
        rows = place[holes[which], None, None] + np.arange(-size * _POINTS // 2, size * _POINTS // 2).reshape(_POINTS, size)
        nodes[which], values[which] = time_s[rows].mean(axis=2), samples[rows].mean(axis=2)
    of_hole = np.repeat(np.arange(len(holes)), lost[holes])
    filled = _through(nodes[of_hole], values[of_hole], missing)
    places = np.searchsorted(time_s, missing)
    return (
        np.insert(time_s, places, missing),
        np.insert(force, places, filled[:, :3], axis=0),
        np.insert(rate, places, filled[:, 3:], axis=0),
    )


def _sharpened(time_s: FloatArray, mean: FloatArray, spread: FloatArray) -> FloatArray:
    """Return values in the middle of steps (n, 3) from means over samples with that spread of times (n,), s^2.

    The mean of a tremor at 12 Hz over 4 ms is 0.4 % too small, where the turn is not.
    """
    interval = np.diff(time_s)[:, None]
    slope = np.diff(mean, axis=0) / interval
    curvature = 2 * np.diff(slope, axis=0) / (interval[1:] + interval[:-1])
    middle = mean.copy()
    middle[1:-1] -= spread[1:-1, None] / 2 * curvature
    return middle


def _interpolate(nodes: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return values (n, 3) between nodes by the polynomial through the nearest; a straight line loses tremor."""
    rows = np.clip(np.searchsorted(nodes, at) - _POINTS // 2, 0, len(nodes) - _POINTS)[:, None] + np.arange(_POINTS)
    return _through(nodes[rows], values[rows], at)


def _through(nodes: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return the values at some times of polynomials through nodes, shape (n, p), and values there, (n, p, c)."""
    near = nodes - at[:, None]
    result = np.zeros((len(at), values.shape[2]))
    for k in range(_POINTS):
        others = np.delete(near, k, axis=1)
        share = np.prod(others / (others - near[:, k, None]), axis=1)
        result += share[:, None] * values[:, k]
    return result


def _turn(steps: _Steps, taper: FloatArray, delay_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rate subtracted (3,), the turned forces (n, 3) and the attitudes from the mean attitude (n, 4)."""
    interval = np.diff(steps.time_s)[:, None]
    turn = np.diff(_interpolate(steps.edge_s, steps.turned, steps.time_s + delay_s), axis=0)
    rest = np.sum(turn, axis=0) / interval.sum()
    since = steps.time_s - taper @ steps.time_s
    slope_weight = taper * since / (taper @ since**2)
    for _ in range(_PASSES):
        turned, _ = _with_rest(steps, turn - rest * interval, taper)
        mean = taper @ turned
        # The rest e of the rate turns the force at e x f: its part across f follows from the drift.
        drift = slope_weight @ turned
        rest = rest + np.cross(mean, drift) / (mean @ mean)
    return rest, *_with_rest(steps, turn - rest * interval, taper)


def _with_rest(steps: _Steps, turn: FloatArray, taper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the forces turned into the mean attitude (n, 3), and the attitudes (n, 4), for turns from step to step."""
    chain = running_turns(exponential(turn), np.zeros(1, dtype=np.int64))
    attitude = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], chain])
    # The mean of rotation vectors is that of the attitudes only about itself: the second time it is.
    for _ in range(2):
        mean = exponential(taper @ logarithm(attitude))
        attitude = multiply(mean * np.array([1.0, -1.0, -1.0, -1.0]), attitude)
    return (matrix(attitude) @ steps.force[:, :, None])[:, :, 0], attitude


def _running_mean(values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return the mean over ``_TREMOR_S`` about each row, shape (n, 3)."""
    low: NDArray[np.intp] = np.searchsorted(time_s, time_s - _TREMOR_S / 2)
    high: NDArray[np.intp] = np.searchsorted(time_s, time_s + _TREMOR_S / 2, side="right")
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    result: FloatArray = (total[high] - total[low]) / (high - low)[:, None]
    return result
