"""From frames to samples without a time: values in the units of the sample, flags, counter and time stamp as sent.

Samples that take several frames: acceleration in one, angular rate in the next.

A sample begins with one kind of frame and is complete when each kind it needs has come, before the next one begins and
without any bytes passed over in between: frames carry no number, so behind a gap nothing tells what belongs together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.clock.stamp_clock import NO_TICKS
from imufield.acquire.protocol.frame_schema import JoinRule
from imufield.acquire.protocol.layout import Field, Layout, Rows
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import NANOSECONDS, FlagRule
from imufield.samples import INSTRUMENT_STATUS_SHIFT, LARGEST_OUTPUT, NO_COUNTER, FloatArray, IntArray, Status

Kinds = NDArray[np.int64]
Flags = NDArray[np.bool_]


class FrameJoin:
    """Joins frames of several kinds, in the order of the stream.

    Parameters
    ----------
    rule : JoinRule
    """

    def __init__(self, rule: JoinRule) -> None:
        self.kinds = rule.needs  # Kinds that take part; their place here is their number.
        self._start = rule.needs.index(rule.starts_with)
        # Frames of a sample that is not complete yet, at most one of each kind.
        self._open: tuple[Kinds, RawBlock] | None = None
        self._lost = 0  # Samples that were not completed since the last good one.
        self._was_complete = False  # Whether the newest frame belongs to a complete sample.

    def add(self, kinds: Kinds, block: RawBlock) -> RawBlock | None:
        """Return the samples that are complete now.

        Parameters
        ----------
        kinds : ndarray, shape (n,)
            Number of the kind of each frame.
        block : RawBlock
            What each of the n frames has; NaN for what it has not.
        """
        carried = 0
        if self._open is not None:
            carried = len(self._open[0])
            kinds, block = np.concatenate([self._open[0], kinds]), join([self._open[1], block])
            self._open = None
        begins = kinds == self._start
        gaps = (block.skipped_before > 0) & ~begins
        # The gap before frames carried over was taken note of when they came.
        gaps[:carried] = False
        group = np.cumsum(begins | gaps)
        group -= group[0]
        rows = self._first_of_each(kinds, group)
        begun, behind_gap = np.zeros((2, len(rows)), dtype=np.bool_)
        begun[group[begins]] = True
        behind_gap[group[gaps]] = True
        complete = begun & (rows >= 0).all(axis=1)
        if begun[-1] and not complete[-1]:
            last = np.flatnonzero(group == group[-1])
            self._open = (kinds[last], block[last])
        lost = self._count_lost(begun, behind_gap, complete)
        return self._samples(block, rows[complete], lost) if complete.any() else None

    def _first_of_each(self, kinds: Kinds, group: Kinds) -> Kinds:
        """Return the row of the first frame of each kind in each group, -1 where there is none; shape (groups, kinds)."""
        rows = np.full((int(group[-1]) + 1, len(self.kinds)), -1, dtype=np.int64)
        rows[group[::-1], kinds[::-1]] = np.arange(len(kinds))[::-1]
        return rows

    def _count_lost(self, begun: Flags, behind_gap: Flags, complete: Flags) -> Kinds:
        """Return how many samples were lost before each complete one, and keep the count of those behind the last."""
        state = complete.copy()
        state[0] |= self._was_complete & ~(begun[0] | behind_gap[0])
        previous = np.append(self._was_complete, state[:-1])
        # What follows a gap without a beginning is the rest of the sample before, unless that one was complete.
        failed = (begun & ~complete) | (behind_gap & previous)
        if self._open is not None:
            failed[-1] = False
        self._was_complete = bool(state[-1])
        total = np.cumsum(failed) + self._lost
        at = np.flatnonzero(complete)
        lost: Kinds = np.diff(total[at], prepend=0) if len(at) else np.empty(0, dtype=np.int64)
        self._lost = int(total[-1] - (total[at[-1]] if len(at) else 0))
        return lost

    def _samples(self, block: RawBlock, rows: Kinds, lost: Kinds) -> RawBlock:
        first = block[rows[:, self._start]]
        last = rows.max(axis=1)
        accelerometer, gyroscope, temperature = first.accelerometer, first.gyroscope, first.temperature_degc
        status, ticks = first.status, first.ticks
        for kind in range(len(self.kinds)):
            other = block[rows[:, kind]]
            accelerometer = np.where(np.isnan(accelerometer), other.accelerometer, accelerometer)
            gyroscope = np.where(np.isnan(gyroscope), other.gyroscope, gyroscope)
            temperature = np.where(np.isnan(temperature), other.temperature_degc, temperature)
            status = status | other.status
        return replace(
            first,
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            temperature_degc=temperature,
            status=status,
            ticks=ticks,
            lost_before=lost,
            skipped_before=lost.astype(np.float64),
            stream_end=block.stream_end[last],
        )


_FAR = 2.0**62  # Bound on time stamps in ns, for bits that are no time.


@dataclass(frozen=True, slots=True, kw_only=True)
class RawBlock:
    """n samples that have no time yet. NaN where a value is not available."""

    accelerometer: FloatArray
    gyroscope: FloatArray
    temperature_degc: FloatArray
    counter: IntArray
    """As sent; ``NO_COUNTER`` where there is none."""
    ticks: NDArray[Any]
    """Time stamp as sent, int64 or float64, shape (n,); shape (0,) where there is none."""
    status: NDArray[np.uint32]
    lost_before: IntArray
    """Samples known to be lost just before this one, whatever the counter says (bad lines). Shape (n,)."""
    skipped_before: FloatArray
    """Bytes passed over just before this sample, as a number of samples. Shape (n,)."""
    stream_end: IntArray
    """Offset in the stream just behind the last byte of this sample. Shape (n,)."""

    def __len__(self) -> int:
        return len(self.temperature_degc)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> RawBlock:
        return RawBlock(
            accelerometer=self.accelerometer[rows],
            gyroscope=self.gyroscope[rows],
            temperature_degc=self.temperature_degc[rows],
            counter=self.counter[rows],
            ticks=self.ticks[rows] if len(self.ticks) else self.ticks,
            status=self.status[rows],
            lost_before=self.lost_before[rows],
            skipped_before=self.skipped_before[rows],
            stream_end=self.stream_end[rows],
        )


def join(blocks: list[RawBlock]) -> RawBlock:
    """Join at least one block."""
    if len(blocks) == 1:
        return blocks[0]
    return RawBlock(
        accelerometer=np.concatenate([block.accelerometer for block in blocks]),
        gyroscope=np.concatenate([block.gyroscope for block in blocks]),
        temperature_degc=np.concatenate([block.temperature_degc for block in blocks]),
        counter=np.concatenate([block.counter for block in blocks]),
        ticks=np.concatenate([block.ticks for block in blocks]),
        status=np.concatenate([block.status for block in blocks]),
        lost_before=np.concatenate([block.lost_before for block in blocks]),
        skipped_before=np.concatenate([block.skipped_before for block in blocks]),
        stream_end=np.concatenate([block.stream_end for block in blocks]),
    )


class FrameReader:
    """Reads the samples out of frames of one kind. Made once for each kind.

    Parameters
    ----------
    protocol : Protocol
    layout : Layout
    """

    def __init__(self, protocol: Protocol, layout: Layout) -> None:
        rule = protocol.samples
        self.length = layout.length
        self._accelerometer = _fields(layout, rule.accelerometer.fields)
        self._gyroscope = _fields(layout, rule.gyroscope.fields)
        self._factors = {
            part: protocol.factor(part, fields[0]) if fields else 1.0
            for part, fields in (("accelerometer", self._accelerometer), ("gyroscope", self._gyroscope))
        }
        self._temperature = _fields(layout, rule.temperature.fields)[:1]
        self._counter = layout.field(protocol.clock.counter_field)
        self._ticks = _TickReader(protocol, layout)
        self._scale_when = {
            part: (field, when.mask, when.scale / getattr(protocol.samples, part).scale)
            for part in ("accelerometer", "gyroscope")
            if (when := getattr(protocol.samples, part).scale_when) and (field := layout.field(when.field))
        }
        self._may_be_garbage = any(field.type[0] == "f" for field in (*self._accelerometer, *self._gyroscope))
        # False for frames that carry other things, e.g. a magnetometer alone.
        self.has_samples = bool(self._accelerometer or self._gyroscope)
        names = dict.fromkeys([flag.field for flag in rule.flags] + [name for name, _ in rule.instrument_status])
        self._status = [
            _StatusReader(field, [flag for flag in rule.flags if flag.field == name], dict(rule.instrument_status).get(name))
            for name in names
            if (field := layout.field(name)) is not None
        ]

    def read(self, rows: Rows, skipped_before: IntArray, starts: IntArray) -> RawBlock:
        """Return the samples of n frames, which begin at offsets ``starts`` of the stream."""
        n = len(rows)
        with np.errstate(over="ignore", invalid="ignore"):
            # Without a checksum any bits arrive as numbers; what is none is flagged below.
            accelerometer = _triad(rows, self._accelerometer, self._factors["accelerometer"])
            gyroscope = _triad(rows, self._gyroscope, self._factors["gyroscope"])
            for part, (field, mask, ratio) in self._scale_when.items():
                values = accelerometer if part == "accelerometer" else gyroscope
                values[(field.raw(rows) & mask) != 0] *= ratio
            temperature_degc = self._read_temperature(rows)
        status = self._read_status(rows)
        if self._may_be_garbage:
            status |= _not_numbers(accelerometer, gyroscope)
        return RawBlock(
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            temperature_degc=temperature_degc,
            counter=np.full(n, NO_COUNTER) if self._counter is None else self._counter.raw(rows).astype(np.int64),
            ticks=self._ticks.read(rows),
            status=status,
            lost_before=np.zeros(n, dtype=np.int64),
            skipped_before=skipped_before / self.length,
            stream_end=starts + self.length,
        )

    def _read_temperature(self, rows: Rows) -> FloatArray:
        if not self._temperature:
            return np.full(len(rows), np.nan)
        field = self._temperature[0]
        raw = field.raw(rows)
        total: FloatArray = raw.astype(np.float64) if raw.ndim == 1 else raw.sum(axis=1, dtype=np.float64)
        return total * (field.factor / field.count) + field.offset

    def _read_status(self, rows: Rows) -> NDArray[np.uint32]:
        status = np.zeros(len(rows), dtype=np.uint32)
        for reader in self._status:
            status |= reader.read(rows)
        return status


class _StatusReader:
    """Turns one status field into flags and instrument bits; by table where the field is a byte."""

    def __init__(self, field: Field, flags: list[FlagRule], shift: int | None) -> None:
        self._field = field
        self._flags = flags
        self._shift = shift
        self._table = self._translate(np.arange(256)) if field.size == 1 else None

    def read(self, rows: Rows) -> NDArray[np.uint32]:
        raw = self._field.raw(rows)
        return self._translate(raw.astype(np.int64)) if self._table is None else self._table[raw]

    def _translate(self, raw: IntArray) -> NDArray[np.uint32]:
        status = np.zeros(len(raw), dtype=np.uint32)
        for flag in self._flags:
            is_set = (raw & flag.mask) != 0
            status |= np.where(is_set ^ flag.when_clear, np.uint32(flag.flag), np.uint32(0))
        if self._shift is not None:
            upper = (raw << (INSTRUMENT_STATUS_SHIFT + self._shift)) & 0xFFFF0000
            status |= upper.astype(np.uint32)
        return status


def _fields(layout: Layout, names: tuple[str, ...]) -> list[Field]:
    return [field for name in names if (field := layout.field(name)) is not None]


def _triad(rows: Rows, fields: list[Field], factor: float) -> FloatArray:
    """Return three axes from one field of three values or from three fields of one. Shape (n, 3)."""
    if not fields or sum(field.count for field in fields[:3]) < 3:
        return np.full((len(rows), 3), np.nan)
    if fields[0].count == 3:
        return _scaled(rows, fields[0], factor)
    return np.column_stack([_scaled(rows, field, factor) for field in fields])


def _not_numbers(accelerometer: FloatArray, gyroscope: FloatArray) -> NDArray[np.uint32]:
    """Return the flags of samples with NaN or too large a number, shape (n,). Three NaN of a gyroscope mean there is none."""
    bad = ~(np.abs(accelerometer) <= LARGEST_OUTPUT).all(axis=1)
    bad_gyroscope = ~(np.abs(gyroscope) <= LARGEST_OUTPUT).all(axis=1) & ~np.isnan(gyroscope).all(axis=1)
    flags = np.zeros(len(accelerometer), dtype=np.uint32)
    flags[bad] |= np.uint32(Status.ACCELEROMETER_INVALID)
    flags[bad_gyroscope] |= np.uint32(Status.GYROSCOPE_INVALID)
    return flags


def _scaled(rows: Rows, field: Field, factor: float) -> FloatArray:
    values: FloatArray = np.multiply(field.raw(rows), field.factor * factor, dtype=np.float64)
    return values + field.offset * factor if field.offset else values


class _TickReader:
    """Reads the time stamp, or the first of several in ns; fills in where a frame has none but the protocol knows one."""

    def __init__(self, protocol: Protocol, layout: Layout) -> None:
        rule = protocol.clock
        self._has_time = bool(rule.time_field)
        self._field = layout.field(rule.time_field)
        self._factor = 0.0
        for time in reversed(rule.times):
            if found := layout.field(time.field):
                self._field, self._factor = found, NANOSECONDS / time.ticks_per_s
        known = protocol.frame.all_fields() if protocol.frame and not rule.times else []
        fractions = any(field.name == rule.time_field and field.type[0] == "f" for field in known)
        self._missing: float | int = np.nan if fractions else NO_TICKS

    def read(self, rows: Rows) -> NDArray[Any]:
        if self._field is None:
            return np.full(len(rows), self._missing) if self._has_time else np.empty(0)
        raw = self._field.raw(rows)
        if not self._factor:
            return raw.astype(np.float64 if raw.dtype.kind == "f" else np.int64)
        if raw.dtype.kind == "f":
            # Seconds of a week: in ns they stay below 2^53, so nothing is lost by rounding.
            ticks: NDArray[Any] = np.nan_to_num(np.rint(raw * self._factor), nan=0, posinf=0, neginf=0).clip(-_FAR, _FAR)
            return ticks.astype(np.int64)
        return raw.astype(np.int64) * np.int64(self._factor)
