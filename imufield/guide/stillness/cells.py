"""Cells: fixed slots of 0.1 s of the sample clock, and the statistics of the samples in each.

Stillness, observations and the guide work on cells, never on single samples. A cell's slot is floor(time / length), so
its content does not depend on how the samples were cut into blocks; the unfinished cell at the end of a block waits for
the next one. All sums of a block are computed at once (``numpy.add.reduceat``), so Python's own work is per cell: a
40-minute recording at 2000 Hz has 24 000 cells and 5 million samples.

Deviations are summed from the first sample of the cell, not from zero: the variance of a navigation-grade accelerometer
(1e-8 of its reading squared) would drown in the rounding of plain sums.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass, fields
from imufield.samples import CELL_S, UNUSABLE, FloatArray, IntArray, Samples, Status, concatenate, every, interval_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Statistics of m finished cells; all arrays have m rows, in the order of arrival.

    Attributes
    ----------
    slot : ndarray of int64, shape (m,)
        floor(time / length); the next cell of an unbroken stream has the next number.
    start_s, end_s : ndarray, shape (m,)
        Sample clock of the first and the last sample.
    count : ndarray of int64, shape (m,)
        Samples that arrived.
    usable, gyroscope_usable : ndarray of int64, shape (m,)
        Samples that entered the statistics: status good, accelerometer finite; and the gyroscope finite too.
    flags : ndarray of uint32, shape (m,)
        All ``Status`` flags seen.
    clipped : ndarray of int64, shape (m,)
        Samples whose accelerometer is flagged as saturated.
    mean : ndarray, shape (m, 6)
        Accelerometer and gyroscope as rates, raw unit; NaN without usable samples.
    variance : ndarray, shape (m, 6)
        Of single samples, raw unit squared; 0 with fewer than two samples.
    step : ndarray, shape (m, 6)
        Smallest distance of a value from the cell's first value, zero apart: bounds one step of the output from above;
        inf where nothing changed.
    first : ndarray, shape (m, 6)
        The first usable value; NaN without one.
    low, high : ndarray, shape (m, 6)
        Extremes of all samples, unusable ones included; NaN where no value is finite.
    at_low, at_high : ndarray of int64, shape (m, 3)
        Samples of the accelerometer that stand at these extremes.
    temperature_degc : ndarray, shape (m,)
    """

    slot: IntArray
    start_s: FloatArray
    end_s: FloatArray
    count: IntArray
    usable: IntArray
    gyroscope_usable: IntArray
    flags: NDArray[np.uint32]
    clipped: IntArray
    mean: FloatArray
    variance: FloatArray
    step: FloatArray
    first: FloatArray
    low: FloatArray
    high: FloatArray
    at_low: IntArray
    at_high: IntArray
    temperature_degc: FloatArray

    def __len__(self) -> int:
        return len(self.slot)

    def __getitem__(self, rows: slice | IntArray) -> Cells:
        if isinstance(rows, slice) and rows.indices(len(self)) == (0, len(self), 1):
            return self  # Live, nearly every block is one cell.
        return Cells(**{name: getattr(self, name)[rows] for name in _FIELDS})


_FIELDS = tuple(field.name for field in fields(Cells))


def join_cells(parts: Sequence[Cells]) -> Cells:
    """Join cells in order; at least one part is needed."""
    if len(parts) == 1:
        return parts[0]
    return Cells(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS})


class CellRun:
    """Cells one after the other as they are judged; they are joined when somebody asks for them."""

    def __init__(self) -> None:
        self._parts: list[tuple[Cells, int, int]] = []  # Blocks, and the rows of each: first and behind the last.
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, cells: Cells, row: int, count: int = 1) -> None:
        """Append cells of a block."""
        begin = row
        if self._parts and self._parts[-1][0] is cells and self._parts[-1][2] == row:
            begin = self._parts.pop()[1]
        self._parts.append((cells, begin, row + count))
        self._count += count

    def cells(self) -> Cells:
        """Return them all; at least one was added."""
        joined = join_cells([cells[begin:end] for cells, begin, end in self._parts])
        # Asked again and again of a run that grows cell by cell.
        self._parts = [(joined, 0, len(joined))]
        return joined


def cells_in(duration_s: float) -> int:
    """Return a duration as a whole number of cells."""
    return round(duration_s / CELL_S)


class CellBuilder:
    """Cuts samples into cells."""

    def __init__(self) -> None:
        self._pending: list[Samples] = []
        self._pending_slot: int | None = None

    def feed(self, samples: Samples) -> Cells | None:
        """Return the cells finished by these samples, None when there are none."""
        if not len(samples):
            return None
        slot = interval_of(samples.time_s, CELL_S)
        first, last = int(slot[0]), int(slot[-1])
        if first == last == self._pending_slot and every(slot == first):
            self._pending.append(samples)
            return None
        if self._pending:
            samples = concatenate([*self._pending, samples])
            slot = interval_of(samples.time_s, CELL_S)
        changes = (slot[1:] != slot[:-1]).nonzero()[0]
        cut = int(changes[-1]) + 1 if len(changes) else 0
        self._pending, self._pending_slot = [samples[cut:]], last
        return measure_cells(samples[:cut], slot[:cut]) if cut else None

    def flush(self) -> Cells | None:
        """Return the unfinished cell as if it ended here; for the end of a recording or of a link."""
        if not self._pending:
            return None
        samples = concatenate(self._pending)
        self._pending, self._pending_slot = [], None
        return measure_cells(samples, interval_of(samples.time_s, CELL_S))


def measure_cells(samples: Samples, slot: IntArray) -> Cells:
    """Return the statistics of each run of equal slots; ``slot`` has shape (n,), n at least 1."""
    edges = np.concatenate(([0], (slot[1:] != slot[:-1]).nonzero()[0] + 1, [len(slot)]))
    starts, count = edges[:-1], edges[1:] - edges[:-1]
    # Filled in place: joining two transposed arrays takes three times as long.
    values = np.empty((6, len(slot)))
    values[:3], values[3:] = samples.accelerometer_rate().T, samples.gyroscope_rate().T
    flagged = np.count_nonzero(samples.status & np.uint32(UNUSABLE))
    least: np.ufunc = np.fmin
    largest: np.ufunc = np.fmax
    # A sum is finite only if every term is: one pass instead of a mask. The usual case.
    if not flagged and np.isfinite(values.sum()):
        # Where nothing is NaN, these are twice as fast.
        least, largest = np.minimum, np.maximum
        counts, first, clipped = count[np.newaxis].repeat(6, axis=0), values[:, starts], np.zeros_like(count)
        deviation = values - np.repeat(first, count, axis=1)
    else:
        usable = samples.usable & np.isfinite(values[:3]).all(axis=0)
        gyroscope_usable = usable & np.isfinite(values[3:]).all(axis=0)
        saturated = (samples.status & np.uint32(Status.ACCELEROMETER_SATURATED)) != 0
        clipped = np.add.reduceat(saturated, starts, dtype=np.int64)
        mask = np.repeat(np.stack((usable, gyroscope_usable)), 3, axis=0)
        counts = np.add.reduceat(mask, starts, axis=1, dtype=np.int64)
        # The first usable value; behind the last sample stands a zero, which a cell without a usable sample refers to.
        first_usable = np.minimum.reduceat(np.where(mask, np.arange(len(slot)), len(slot)), starts, axis=1)
        padded = np.concatenate((np.where(mask, values, 0.0), np.zeros((6, 1))), axis=1)
        first = np.take_along_axis(padded, first_usable, axis=1)
        deviation = np.where(mask, padded[:, :-1] - np.repeat(first, count, axis=1), 0.0)
    total = np.add.reduceat(deviation, starts, axis=1)
    squares = np.add.reduceat(deviation * deviation, starts, axis=1)
    # A cell without usable samples divides by one and is NaN afterwards.
    some = np.maximum(counts, 1)
    mean = np.where(counts > 0, first + total / some, np.nan)
    # Rounding makes the scatter of equal samples a little negative.
    scatter = np.maximum(squares - total * total / some, 0.0)
    distance = np.abs(deviation)
    # Zero distance shows no step of the output.
    distance[distance == 0] = np.inf
    low, high = least.reduceat(values, starts, axis=1), largest.reduceat(values, starts, axis=1)
    at_low, at_high = (
        np.add.reduceat(values[:3] == np.repeat(end[:3], count, axis=1), starts, axis=1, dtype=np.int64) for end in (low, high)
    )
    return Cells(
        slot=slot[starts],
        start_s=samples.time_s[starts],
        end_s=samples.time_s[starts + count - 1],
        count=count,
        usable=counts[0],
        gyroscope_usable=counts[3],
        flags=np.bitwise_or.reduceat(samples.status, starts),
        clipped=clipped,
        mean=np.ascontiguousarray(mean.T),
        variance=np.ascontiguousarray((scatter / np.maximum(counts - 1, 1)).T),
        step=np.ascontiguousarray(np.minimum.reduceat(distance, starts, axis=1).T),
        first=np.ascontiguousarray(np.where(counts > 0, first, np.nan).T),
        low=np.ascontiguousarray(low.T),
        high=np.ascontiguousarray(high.T),
        at_low=np.ascontiguousarray(at_low.T),
        at_high=np.ascontiguousarray(at_high.T),
        temperature_degc=_means_of_known(samples.temperature_degc, starts, count),
    )


def _means_of_known(values: FloatArray, starts: IntArray, count: IntArray) -> FloatArray:
    """Return the mean of the finite values of each cell, NaN where there is none. Shape (m,)."""
    known = np.isfinite(values)
    if not every(known):
        values, count = np.where(known, values, 0.0), np.add.reduceat(known, starts, dtype=np.int64)
    return np.where(count > 0, np.add.reduceat(values, starts) / np.maximum(count, 1), np.nan)
