"""What a clock is: it takes samples without a time, with when their bytes arrived, and gives them back with one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import RawBlock
from imufield.samples import FloatArray, IntArray, Samples, SampleUnits


@dataclass(frozen=True, slots=True)
class Arrivals:
    """When the bytes of a stream came."""

    ends: IntArray
    """Offset in the stream just behind each read, ascending. Shape (k,)."""
    arrival_s: FloatArray
    """Host time when its last byte arrived, s; NaN where not known. Shape (k,)."""

    def reads_of(self, block: RawBlock) -> list[tuple[int, float]]:
        """Return (rows up to its end, arrival) of each read that completed a sample of this block."""
        if len(self.ends) == 1:
            return [(len(block), float(self.arrival_s[0]))] if len(block) else []
        until = np.searchsorted(block.stream_end, self.ends, side="right")
        until[-1] = len(block)
        with_rows = np.flatnonzero(np.diff(until, prepend=0))
        return list(zip(until[with_rows].tolist(), self.arrival_s[with_rows].tolist(), strict=True))


class Clock(Protocol):
    """Gives the samples of one source their time, block by block."""

    def push(self, block: RawBlock, arrivals: Arrivals) -> Samples | None:
        """Return the samples whose time is settled now, None if there are none.

        Parameters
        ----------
        block : RawBlock
        arrivals : Arrivals
            Of the reads that this block comes from; the frames of a bus have time stamps instead.
        """
        ...

    def flush(self) -> Samples | None:
        """Return what is kept back; nothing will follow."""
        ...


def samples_of(block: RawBlock, time_s: FloatArray, flags: NDArray[np.uint32], units: SampleUnits) -> Samples:
    """Return the samples of a block with their time, and with what the clock knows of gaps and of the time."""
    return Samples(
        time_s=time_s,
        accelerometer=block.accelerometer,
        gyroscope=block.gyroscope,
        temperature_degc=block.temperature_degc,
        counter=block.counter,
        status=block.status | flags,
        units=units,
    )
