"""Means of a recording over windows of some seconds: what a ramp of temperature is cut from, and what shows that it is one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.dataclass import dataclass, fields
from imufield.pipeline.chain import session_samples
from imufield.samples import UNUSABLE, FloatArray, Samples, Status, TemperatureHold

RAMP = "ramp"
"""What a session recorded as a ramp says of its kind."""
WINDOW_S = 10.0
"""Means of a ramp: at 2 degC/min the temperature moves by a third of a degree."""
# What keeps a sample out of the mean of either triad: flags of the other one do not.
_NOT_OF_ACCELEROMETER = UNUSABLE & ~(Status.GYROSCOPE_INVALID | Status.GYROSCOPE_SATURATED)
_NOT_OF_GYROSCOPE = UNUSABLE & ~(Status.ACCELEROMETER_INVALID | Status.ACCELEROMETER_SATURATED)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WindowMeans:
    """Means over n windows in order of time, as raw rates; NaN where no sample is usable."""

    time_s: FloatArray
    """Shape (n,)."""
    temperature_degc: FloatArray
    """Shape (n,)."""
    accelerometer: FloatArray
    """Shape (n, 3)."""
    gyroscope: FloatArray
    """Shape (n, 3)."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> WindowMeans:
        return WindowMeans(**{name: getattr(self, name)[rows] for name in _FIELDS})


_FIELDS = tuple(field.name for field in fields(WindowMeans))


class WindowSums:
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

    def means(self) -> WindowMeans:
        """Return the means of every window that has a sample."""
        sums = np.array([self._sums[window] for window in sorted(self._sums)]).reshape(-1, 2, 8)
        counts = sums[:, 1]
        means = np.divide(sums[:, 0], counts, out=np.full(counts.shape, np.nan), where=counts > 0)
        return WindowMeans(
            time_s=means[:, 0], temperature_degc=means[:, 1], accelerometer=means[:, 2:5], gyroscope=means[:, 5:8]
        )


def is_ramp(session: Session, raw_zero: FloatArray | float) -> bool:
    """Tell whether a recording is of one pose from the first to the last window, and its temperature changes."""
    from imufield.calibrate.temperature.fit import SAME_TEMPERATURE_DEGC  # late: asked only of a session without positions
    from imufield.calibrate.temperature.ramp import moved_windows

    windows = WindowSums()
    damage: list[Damage] = []  # Dropped: the solve that asks has read the same parts and names what they lack.
    for samples in session_samples(session, damage):
        windows.feed(samples)
    means = windows.means()
    means = means[np.isfinite(means.temperature_degc) & np.isfinite(means.accelerometer).all(axis=1)]
    if len(means) <= 1 or np.ptp(means.temperature_degc) < SAME_TEMPERATURE_DEGC:
        return False
    return not len(moved_windows(means.accelerometer - raw_zero))
