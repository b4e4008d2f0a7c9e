"""Blocks of IMU samples: what every room after the link works on.

A block holds n samples as arrays of one length; nothing here knows where they came from. Raw values are kept as the
instrument sent them (``SampleUnits`` says in what unit, and whether a value is an increment over one sample interval).
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imufield.dataclass import dataclass, fields, replace
from imufield.errors import Reason, RecordingError
from imufield.limits import TEMPERATURE_RANGE_DEGC
from imufield.sentences import Sentences

sentence = Sentences(__package__)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
UIntArray = NDArray[np.uint64]

AXES = ("x", "y", "z")
ACCELEROMETER_COLUMNS = ("ax", "ay", "az")
GYROSCOPE_COLUMNS = ("gx", "gy", "gz")
TRIADS = {"accelerometer": ACCELEROMETER_COLUMNS, "gyroscope": GYROSCOPE_COLUMNS}
SAMPLE_COLUMNS = ("time_s", *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS, "temperature_degc", "counter", "status")
"""Columns of exported samples, in this order (docs/file-formats.md)."""

LARGEST_OUTPUT = 1e12
"""A 40-bit converter: no instrument sends more, and squares of what it sends are numbers. Larger values count as invalid."""
LARGEST_OFFSET_M_S2 = 30.0
"""Of an accelerometer: none has one of 3 g. What is larger is the raw zero of a converter."""
NO_COUNTER = -1
"""Value of ``Samples.counter`` where the instrument sends none."""
EDGE_MARGIN = 1e-6
"""Of an interval, or s: a time such as 0.3 s is slightly below its edge in binary, and belongs to what begins there."""
CELL_S = 0.1
"""What stillness is told by: short against a turn (0.5 s and more), long against the tremor of a hand (8 to 12 Hz)."""


class Status(IntFlag):
    """Flags of one sample. The upper 16 bits hold the instrument's own status bits, as its protocol packs them."""

    GOOD = 0
    ACCELEROMETER_INVALID = 1
    GYROSCOPE_INVALID = 2
    ACCELEROMETER_SATURATED = 4
    GYROSCOPE_SATURATED = 8
    START_UP = 16
    AFTER_GAP = 32
    """Samples before this one were lost; the count is exact."""
    GAP_ESTIMATED = 64
    """Samples before this one were lost; the count comes from host time."""
    TIME_ESTIMATED = 128
    """``time_s`` comes from host arrival time, the instrument sends none."""
    INSTRUMENT_FAULT = 256
    """The instrument reports a fault that concerns the inertial values."""
    STANDING = 512
    """Acceleration or rate comes at a lower rate than the other: its values are those of a sample before."""
    TEMPERATURE_OUTSIDE = 1024
    """Of corrected samples: the temperature lies outside those of the calibration, and the nearest of them was taken."""
    TEMPERATURE_UNKNOWN = 2048
    """Of corrected samples: without a temperature, they were corrected as at the reference of the calibration."""
    CLOCK_SET = 4096
    """The instrument's clock was set anew before this sample; ``time_s`` does not show how long that took."""


INSTRUMENT_STATUS_SHIFT = 16
UNUSABLE = (
    Status.ACCELEROMETER_INVALID
    | Status.GYROSCOPE_INVALID
    | Status.ACCELEROMETER_SATURATED
    | Status.GYROSCOPE_SATURATED
    | Status.START_UP
    | Status.INSTRUMENT_FAULT
)
"""A sample with any of these never enters a mean."""


@dataclass(frozen=True, slots=True)
class SampleUnits:
    """Raw units of a block.

    ``accelerometer`` is "m/s^2", "g", "count" or "pulse" for rates, "m/s", "count" or "pulse" for increments;
    ``gyroscope`` is "rad/s", "count" or "pulse" for rates, "rad", "count" or "pulse" for increments.
    """

    accelerometer: str = "m/s^2"
    gyroscope: str = "rad/s"
    accelerometer_is_increment: bool = False
    gyroscope_is_increment: bool = False
    interval_s: float | None = None
    """Nominal sample interval; required where a triad sends increments."""

    @property
    def is_si(self) -> bool:
        """Whether the instrument scales both triads itself."""
        return self.accelerometer in ("m/s^2", "m/s") and self.gyroscope in ("rad/s", "rad")

    @property
    def words(self) -> str:
        """Return the units of both triads for sentences; of increments with the interval, without which they say nothing."""
        interval = f" per {self.interval_s:g} s" if self.interval_s else ""
        each = (
            self.accelerometer + interval * self.accelerometer_is_increment,
            self.gyroscope + interval * self.gyroscope_is_increment,
        )
        return f"accelerometer in {each[0]}, gyroscope in {each[1]}"

    def accelerometer_rate(self, raw: FloatArray) -> FloatArray:
        """Return raw outputs of the accelerometer as rates: raw unit, per second for increments."""
        return _as_rate(raw, self.accelerometer_is_increment, self.interval_s)

    def raw_zero_rate(self, raw_zero: FloatArray) -> FloatArray:
        """Return the raw zero of the accelerometer, shape (3,), or of both triads, shape (6,), as rates."""
        of_gyroscope = _as_rate(raw_zero[3:], self.gyroscope_is_increment, self.interval_s)
        return np.concatenate([self.accelerometer_rate(raw_zero[:3]), of_gyroscope])

    @property
    def accelerometer_rate_unit(self) -> str:
        """Unit of accelerometer means: that of the samples, per second for increments."""
        return _rate_unit(self.accelerometer, self.accelerometer_is_increment)

    @property
    def gyroscope_rate_unit(self) -> str:
        """The same of gyroscope means."""
        return _rate_unit(self.gyroscope, self.gyroscope_is_increment)


def _rate_unit(unit: str, is_increment: bool) -> str:
    return {"m/s": "m/s^2", "rad": "rad/s"}.get(unit, f"{unit}/s") if is_increment else unit


@dataclass(frozen=True, slots=True)
class Samples:
    """A block of n IMU samples.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Sample clock: device counter or time stamp, unwrapped; host arrival time where the device sends none.
    accelerometer, gyroscope : ndarray, shape (n, 3)
        Raw values in ``units``; NaN where not available.
    temperature_degc : ndarray, shape (n,)
        NaN where not available.
    counter : ndarray of int64, shape (n,)
        As sent (not unwrapped); ``NO_COUNTER`` where the instrument sends none.
    status : ndarray of uint32, shape (n,)
        ``Status`` flags.
    units : SampleUnits
    sensor_temperature_degc : ndarray, shape (n, 6), optional
        Of the thermometers of the axes, in the order ax ay az gx gy gz, NaN where not available; None where none is sent.
    """

    time_s: FloatArray
    accelerometer: FloatArray
    gyroscope: FloatArray
    temperature_degc: FloatArray
    counter: IntArray
    status: NDArray[np.uint32]
    units: SampleUnits
    sensor_temperature_degc: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Samples:
        own_degc = self.sensor_temperature_degc
        own_degc = None if own_degc is None else own_degc[rows]
        arrays = {name: getattr(self, name)[rows] for name in _ARRAYS}
        return Samples(units=self.units, sensor_temperature_degc=own_degc, **arrays)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Which samples may enter a mean, shape (n,)."""
        return np.asarray((self.status & np.uint32(UNUSABLE)) == 0)

    def accelerometer_rate(self) -> FloatArray:
        """Accelerometer as rates: raw unit, per second for increments. Shape (n, 3)."""
        return self.units.accelerometer_rate(self.accelerometer)

    def gyroscope_rate(self) -> FloatArray:
        """Gyroscope as rates: raw unit, per second for increments. Shape (n, 3)."""
        return _as_rate(self.gyroscope, self.units.gyroscope_is_increment, self.units.interval_s)


_ARRAYS = tuple(field.name for field in fields(Samples) if field.name not in ("units", "sensor_temperature_degc"))


def _as_rate(values: FloatArray, is_increment: bool, interval_s: float | None) -> FloatArray:
    # A rate needs no interval; an increment is a rate only by its interval.
    if not is_increment:
        return values
    if interval_s is None:
        raise ValueError("increments need `interval_s` in SampleUnits")
    return values / interval_s


def unknown(shape: int | tuple[int, ...]) -> FloatArray:
    """Return an array of NaN: ``np.full(shape, np.nan)``, at half of its price for a live block."""
    values = np.empty(shape)
    values.fill(np.nan)
    return values


def no_counters(n: int) -> IntArray:
    """Return the counters of n samples that have none, as ``unknown`` returns other values."""
    counters = np.empty(n, dtype=np.int64)
    counters.fill(NO_COUNTER)
    return counters


def every(flags: NDArray[np.bool_]) -> bool:
    """Whether all flags are set: ``flags.all()``, at a tenth of its price for the few of a live block."""
    return 0 not in flags.tobytes()


def sound_rows(values: FloatArray, is_sound: NDArray[np.bool_]) -> FloatArray:
    """Return the rows with sound values only, contiguous, shape (n, k) to (m, k): fast where all are."""
    return np.ascontiguousarray(values) if is_sound.all() else values[is_sound.all(axis=1)]


def is_possible_degc(temperature_degc: FloatArray) -> NDArray[np.bool_]:
    """Return which temperatures an instrument can have, of the shape given; one that is not known (NaN) counts as possible."""
    low, high = TEMPERATURE_RANGE_DEGC
    return np.asarray(~((temperature_degc < low) | (temperature_degc > high)))


def require_possible_degc(name: str, temperature_degc: FloatArray) -> None:
    """Raise ``RecordingError`` where a thermometer of the recording ``name`` shows what no instrument survives."""
    wrong_degc = temperature_degc[~is_possible_degc(temperature_degc)]
    if len(wrong_degc):
        low, high = TEMPERATURE_RANGE_DEGC
        impossible = sentence("samples.impossible", name=name, found=float(wrong_degc[0]), low=low, high=high)
        raise RecordingError(impossible, Reason.BAD_DATA)


class TemperatureHold:
    """Gives the samples of one recording, block after block, the last temperature known where they have none."""

    def __init__(self) -> None:
        self._last_degc = np.nan

    def fill(self, samples: Samples) -> Samples:
        """Return the next block with its temperatures filled in; NaN stays before the first one known."""
        if not len(samples):
            return samples
        known_degc = np.concatenate([[self._last_degc], samples.temperature_degc])
        row = np.maximum.accumulate(np.where(np.isnan(known_degc), 0, np.arange(len(known_degc))))
        held_degc = known_degc[row][1:]
        self._last_degc = float(held_degc[-1])
        return replace(samples, temperature_degc=held_degc)


def make_samples(
    time_s: FloatArray,
    accelerometer: FloatArray,
    gyroscope: FloatArray | None = None,
    *,
    units: SampleUnits,
    temperature_degc: FloatArray | None = None,
    counter: IntArray | None = None,
    status: NDArray[np.uint32] | None = None,
) -> Samples:
    """Build a block, filling what is not there with "not available"."""
    n = len(time_s)
    return Samples(
        time_s=np.asarray(time_s, dtype=np.float64),
        accelerometer=np.asarray(accelerometer, dtype=np.float64),
        gyroscope=unknown((n, 3)) if gyroscope is None else np.asarray(gyroscope, dtype=np.float64),
        temperature_degc=unknown(n) if temperature_degc is None else np.asarray(temperature_degc, dtype=np.float64),
        counter=no_counters(n) if counter is None else counter,
        status=np.zeros(n, dtype=np.uint32) if status is None else status,
        units=units,
    )


def interval_of(time_s: FloatArray, width_s: float) -> IntArray:
    """Return the numbers of the intervals of this width that hold some times, e.g. of cells."""
    return np.asarray(np.floor(time_s / width_s + EDGE_MARGIN).astype(np.int64))


def median(values: ArrayLike) -> FloatArray:
    """Return the median along the first axis, NaN where one value is NaN or none is there.

    ``numpy.median`` imports NumPy's masked arrays, which takes 30 ms.
    """
    ordered = np.array(values, dtype=np.float64)
    if not (count := len(ordered)):
        return np.full(ordered.shape[1:], np.nan)
    ordered.partition(((count - 1) // 2, count // 2, count - 1), axis=0)
    middle = (ordered[(count - 1) // 2] + ordered[count // 2]) / 2
    # NaN is sorted behind all numbers.
    return np.asarray(np.where(np.isnan(ordered[-1]), np.nan, middle))


def no_samples(units: SampleUnits) -> Samples:
    """Return a block of zero samples."""
    return make_samples(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), units=units)


def concatenate(blocks: Iterable[Samples]) -> Samples:
    """Join blocks of the same units in time order.

    Raises
    ------
    ValueError
        If there is no block, or the units differ.
    """
    parts = list(blocks)
    if not parts:
        raise ValueError("`blocks` is empty: the units are not known")
    if len(parts) == 1:
        return parts[0]
    units = parts[0].units
    if any(part.units != units for part in parts):
        raise ValueError("`blocks` have different units")
    own_degc = None
    if any(part.sensor_temperature_degc is not None for part in parts):
        each = [(len(part), part.sensor_temperature_degc) for part in parts]
        own_degc = np.concatenate([np.full((n, 6), np.nan) if own is None else own for n, own in each])
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
    return Samples(units=units, sensor_temperature_degc=own_degc, **arrays)
