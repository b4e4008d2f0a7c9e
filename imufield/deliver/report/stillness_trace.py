"""Data of the stillness plot: force and rate over the session, collected without parameters and scaled by them later."""

from __future__ import annotations

import numpy as np

from imufield.dataclass import dataclass
from imufield.deliver.navigation.rest import IntervalMeans
from imufield.deliver.parameters.file import Parameters
from imufield.samples import FloatArray, Samples, TemperatureHold, every

CELL_S = 0.5
"""Of the stillness trace: short against a hold, long against the interval between samples."""
# Both factors of each entry of a symmetric matrix, those beside the diagonal once.
_FIRST = np.array([0, 1, 2, 0, 0, 1])
_SECOND = np.array([0, 1, 2, 1, 2, 2])
_STEP_M_S2 = 0.01  # Of the slope of the correction: the model is linear over it, and its rounding is far away.


@dataclass(frozen=True, slots=True)
class Trace:
    """How still the instrument was, arrays of shape (n,)."""

    time_s: FloatArray
    scatter_m_s2: FloatArray
    """Standard deviation of the specific force inside each cell, root sum of squares over the axes."""
    rate_rad_s: FloatArray
    """Size of the mean rate less the rate at rest; NaN without a complete gyroscope."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceCells:
    """Means over n cells of equal length, raw rates; a pause is one cell of NaN, however long, so times are not evenly spaced.

    Attributes
    ----------
    time_s, temperature_degc : ndarray, shape (n,)
    accelerometer, gyroscope : ndarray, shape (n, 3)
    covariance : ndarray, shape (n, 6)
        Of the accelerometer inside the cell: xx, yy, zz, xy, xz, yz.
    """

    time_s: FloatArray
    temperature_degc: FloatArray
    accelerometer: FloatArray
    gyroscope: FloatArray
    covariance: FloatArray


class TraceCollector:
    """Makes cells from a stream of samples."""

    def __init__(self) -> None:
        self._temperature = TemperatureHold()
        self._means: IntervalMeans | None = None
        self._centre = np.zeros(7)

    def feed(self, samples: Samples) -> None:
        """Take the next block."""
        # Before any is left out: its temperature may be the last one known.
        samples = self._temperature.fill(samples)
        # One sample that is not finite would make a whole cell NaN.
        finite, usable = np.isfinite(samples.accelerometer), samples.usable
        samples = samples if every(finite) and every(usable) else samples[usable & finite.all(axis=1)]
        if not len(samples):
            return
        # One row for each column of the means: loops of NumPy along a row are long.
        values = np.empty((13, len(samples)))
        values[:3], values[3:6] = samples.accelerometer_rate().T, np.nan_to_num(samples.gyroscope_rate()).T
        values[6] = samples.temperature_degc
        if self._means is None:
            self._means = IntervalMeans(float(samples.time_s[0]), 13, CELL_S)
            self._centre = np.append(values[:6, 0], 0.0)  # squares of what is left lose no digits
        values[:7] -= self._centre[:, np.newaxis]
        for row, (first, second) in enumerate(zip(_FIRST, _SECOND, strict=True), 7):
            np.multiply(values[first], values[second], out=values[row])
        self._means.feed(samples.time_s, values.T)

    def finish(self) -> TraceCells:
        """Return the cells; none without a sample."""
        collected = self._means or IntervalMeans(0.0, 13, CELL_S)
        numbers, means = collected.filled()
        # One cell without a sample stands for all in a row: a pause may be of days.
        pauses = np.flatnonzero(np.diff(numbers) > 1) + 1
        numbers, means = np.insert(numbers, pauses, numbers[pauses] - 1), np.insert(means, pauses, np.nan, axis=0)
        values = means[:, :7] + self._centre
        return TraceCells(
            time_s=np.asarray(collected.start_s + (numbers + 0.5) * CELL_S, dtype=np.float64),
            temperature_degc=values[:, 6],
            accelerometer=values[:, :3],
            gyroscope=values[:, 3:6],
            covariance=means[:, 7:] - means[:, _FIRST] * means[:, _SECOND],
        )


def trace(cells: TraceCells, parameters: Parameters) -> Trace | None:
    """Return the trace with the parameters of a file; None without a cell."""
    if not len(cells.time_s):
        return None
    at_degc = cells.temperature_degc
    force = parameters.apply_accelerometer(cells.accelerometer, temperature_degc=at_degc)
    steps = np.diag(parameters.calibration.accelerometer.scale * _STEP_M_S2)
    slopes = [
        (parameters.apply_accelerometer(cells.accelerometer + step, temperature_degc=at_degc) - force) / step.sum()
        for step in steps
    ]
    # Sum over the axes of slope C slope^T; entries beside the diagonal of C stand for two.
    products = np.stack([np.sum(slopes[a] * slopes[b], axis=1) for a, b in zip(_FIRST, _SECOND, strict=True)], axis=1)
    variance = np.sum(products * cells.covariance * [1, 1, 1, 2, 2, 2], axis=1)
    rate = np.full_like(force, np.nan)
    # Without a scale the rates are no rates; the plot leaves the panel out.
    if parameters.gyroscope_is_complete:
        rate = parameters.apply_gyroscope(cells.gyroscope, force, temperature_degc=at_degc)
        rate = rate - np.nanmedian(rate, axis=0)
    return Trace(cells.time_s, np.sqrt(np.maximum(variance, 0.0)), np.linalg.norm(rate, axis=1))
