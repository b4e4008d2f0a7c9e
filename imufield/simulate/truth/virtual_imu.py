"""Sources of the samples of an emulated instrument: the interface, and a simulated instrument in the hands of an operator."""

from __future__ import annotations

from typing import Protocol

from imufield.samples import Samples
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import Operator


class SampleSource(Protocol):
    """A source of samples in blocks of any length."""

    @property
    def interval_s(self) -> float:
        """True time between samples."""
        ...

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost; ``counter`` is the number of the sample."""
        ...

    def set_rate(self, rate_hz: float) -> None:
        """Go on at another nominal rate, from the next whole sample of it since the beginning."""


class VirtualImu:
    """A simulated instrument in the hands of a simulated operator."""

    def __init__(self, imu: Imu, operator: Operator) -> None:
        self.imu = imu
        self.operator = operator
        self._next = 0

    @property
    def interval_s(self) -> float:
        """True time between samples."""
        return self.imu.interval_s

    @property
    def time_s(self) -> float:
        """True time of the next sample."""
        return self._next * self.interval_s

    def next_block(self, count: int) -> Samples:
        """Return the next ``count`` samples, fewer where some are lost."""
        motion = self.operator.block(self._next, count, self.interval_s)
        self._next += count
        return self.imu.feed(motion)

    def set_rate(self, rate_hz: float) -> None:
        """Go on at another nominal rate, from the next whole sample of it since the beginning."""
        self._next = self.imu.set_rate(rate_hz)
