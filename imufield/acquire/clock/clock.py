"""What a clock is: it takes samples without a time, with when their bytes arrived, and gives them back with one."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import RawBlock, Ticks
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray, Samples, SampleUnits

Reads = list[tuple[int, float]]
"""(Rows of a block up to its end, arrival) of each read that completed a sample of the block."""


@dataclass(slots=True)  # One for each read: a frozen one takes five times as long to make.
class Arrival:
    """When the bytes of one read came."""

    arrival_s: float
    """Host time when its last byte arrived, s; NaN where not known."""

    def reads_of(self, block: RawBlock) -> Reads:
        """Return (rows of the block, arrival): the read completed all there are."""
        return [(len(block), self.arrival_s)]


@dataclass(slots=True)  # As above.
class Arrivals:
    """When the bytes of several reads came."""

    ends: IntArray
    """Offset in the stream just behind each read, ascending. Shape (k,)."""
    arrival_s: FloatArray
    """Host time when its last byte arrived, s; NaN where not known. Shape (k,)."""

    def reads_of(self, block: RawBlock) -> Reads:
        """Return (rows up to its end, arrival) of each read that completed a sample of this block."""
        until = block.stream_end.searchsorted(self.ends, side="right").tolist()
        until[-1] = len(block)
        reads = zip([0, *until], until, self.arrival_s.tolist(), strict=False)
        return [(end, arrival_s) for begin, end, arrival_s in reads if end > begin]


class Clock(ABC):
    """Gives the samples of one source their time, block by block.

    Parameters
    ----------
    rule : ClockRule
        With the moduli filled in; fields that the stream does not have are empty.
    units : SampleUnits
    statistics : DecoderStatistics
        Counts of samples and losses are kept there.

    Attributes
    ----------
    by_rate : bool
        Time is counted at the stated rate: neither the stream nor its arrival tells it.
    """

    by_rate = False

    def __init__(self, rule: ClockRule, units: SampleUnits, statistics: DecoderStatistics) -> None:
        self._rule = rule
        self._units = units
        self._statistics = statistics

    @abstractmethod
    def push(self, block: RawBlock, arrivals: Arrival | Arrivals) -> Samples | None:
        """Return the samples whose time is settled now, None if there are none.

        Parameters
        ----------
        block : RawBlock
        arrivals : Arrival or Arrivals
            Of the reads that this block comes from; the frames of a bus have time stamps instead.
        """

    @abstractmethod
    def flush(self) -> Samples | None:
        """Return what is kept back; nothing will follow."""

    def _timed(self, block: RawBlock, time_s: FloatArray, flags: NDArray[np.uint32]) -> Samples:
        """Return the samples of a block with their time, and with what the clock knows of gaps and of the time."""
        self._statistics.samples += len(block)
        return Samples(
            time_s=time_s,
            accelerometer=block.accelerometer,
            gyroscope=block.gyroscope,
            temperature_degc=block.temperature_degc,
            counter=block.counter,
            status=block.status | flags,
            units=self._units,
            sensor_temperature_degc=block.sensor_temperature_degc if block.sensor_temperature_degc.ndim > 1 else None,
        )


def filled_in(values: Ticks, known: NDArray[np.bool_], before: float, step: float) -> Ticks:
    """Return counts or stamps with those that are not known a step behind the one before; ``before`` is that of the first."""
    places = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    last = np.where(places >= 0, values[np.maximum(places, 0)], before)
    return np.where(known, values, last + (np.arange(len(values)) - places) * step)
