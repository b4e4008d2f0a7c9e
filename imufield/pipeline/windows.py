"""Means of a recording over windows of some seconds: what a ramp of temperature is cut from, and what shows that it is one."""

from __future__ import annotations

import numpy as np

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.calibrate.temperature.fit import SAME_TEMPERATURE_DEGC
from imufield.calibrate.temperature.ramp import moved_windows
from imufield.pipeline.chain import session_samples
from imufield.samples import UNUSABLE, FloatArray, Samples, Status, TemperatureHold

RAMP = "ramp"
"""What a session recorded as a ramp says of its kind."""
WINDOW_S = 10.0
"""Means of a ramp: at 2 degC/min the temperature moves by a third of a degree."""
# What keeps a sample out of the mean of either triad: flags of the other one do not.
_NOT_OF_ACCELEROMETER = UNUSABLE & ~(Status.GYROSCOPE_INVALID | Status.GYROSCOPE_SATURATED)
_NOT_OF_GYROSCOPE = UNUSABLE & ~(Status.ACCELEROMETER_INVALID | Status.ACCELEROMETER_SATURATED)


class WindowMeans:
    """Adds samples up by windows of time."""

    def __init__(self) -> None:
        self._sums: dict[int, FloatArray] = {}
        self._temperature = TemperatureHold()

    def feed(self, samples: Samples) -> None:
        """Take the next block."""
        at_degc = self._temperature.fill(samples).temperature_degc
        values = np.column_stack([samples.time_s, at_degc, samples.accelerometer_rate(), samples.gyroscope_rate()])
        of_triads = [(samples.status & np.uint32(flags)) == 0 for flags in (_NOT_OF_ACCELEROMETER, _NOT_OF_GYROSCOPE)]
        # Columns of time and temperature count where either triad does.
        counted = np.column_stack([np.logical_or(*of_triads), *of_triads])[:, [0, 0, 1, 1, 1, 2, 2, 2]]
        rows = np.stack([np.where(counted, values, 0.0), counted], axis=1)[counted[:, 0]]
        number = np.floor(rows[:, 0, 0] / WINDOW_S).astype(int)
        for window in np.unique(number):
            self._sums[int(window)] = self._sums.get(int(window), np.zeros((2, 8))) + rows[number == window].sum(axis=0)

    def __len__(self) -> int:
        return len(self._sums)

    def means(self) -> FloatArray:
        """Return time, temperature, accelerometer and gyroscope of every window, raw rates, shape (n, 8); NaN: none usable."""
        sums = np.array([self._sums[window] for window in sorted(self._sums)]).reshape(-1, 2, 8)
        counts = sums[:, 1]
        return np.asarray(np.divide(sums[:, 0], counts, out=np.full(counts.shape, np.nan), where=counts > 0))


def is_ramp(session: Session, raw_zero: FloatArray | float) -> bool:
    """Tell whether a recording is of one pose from the first to the last window, and its temperature changes."""
    windows, damage = WindowMeans(), list[Damage]()
    for samples in session_samples(session, damage):
        windows.feed(samples)
    means = windows.means()
    means = means[np.isfinite(means[:, 1:5]).all(axis=1)]
    if len(means) <= 1 or np.ptp(means[:, 1]) < SAME_TEMPERATURE_DEGC:
        return False
    return not len(moved_windows(means[:, 2:5] - raw_zero))
