"""Noise of an instrument from hours of standstill: what ``imufield noise`` finds.

Samples go onto an even grid: lost ones are bridged by a straight line up to 1 s or two samples, and counted. The longest
stretch in which nothing was moved goes into the Allan deviation, and each axis is identified by itself. Memory does not grow
with the length, and the result does not depend on how the samples were cut into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from imufield.calibrate.model.coverage_factors import deviation_limits_95
from imufield.calibrate.noise.allan import (
    COARSE,
    AllanDeviation,
    AllanStream,
    EvenGrid,
    EvenRows,
    degrees_of_freedom,
    interval_and_slack,
)
from imufield.calibrate.noise.noise_fit import NoiseFigure, NoiseModel, identify
from imufield.dataclass import dataclass, replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason, RecordingError
from imufield.samples import AXES, FloatArray, Samples, SampleUnits, median
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

MOVED = 0.005
"""Change of the mean output of a second, over the length of the accelerometer's mean: 5 mg. More is a unit that was moved."""
LEAST_AVERAGED = 10
"""Samples in such a mean at least: below 10 Hz it covers more than a second, as single samples scatter by up to 5 mg."""
REFERENCE_S = 60.0
"""The mean that a second is compared with follows the last minute: warm-up passes, a touch does not."""
LEAST_SAMPLES = 1000
"""The deviation at one sample interval is then known to 3 %."""
LEAST_S = 60.0
"""In less, nothing but white noise can be seen."""
QUANTISED = 0.5
"""Scatter of samples below this many steps of the output: the steps do not average out, the true noise is hidden."""
_IDENTIFIED_POINTS = 6  # Octaves that tell the five kinds of noise of ``noise_fit`` apart: one more than there are kinds.
_FIRST_SAMPLES = 5000  # Tell the interval where nothing else does: the median of as many is known to 2 % of the jitter.
_OTHER_RATE = 0.01  # Of the time that the samples take; half of it is the error of a density.
_MOST_STANDING = 0.05  # Share of them without a later time: the rate is off by as much, a density by half of it.
_HOURS = 3600.0
_SPLITS_NAMED = 3  # Disturbances that are named one by one; the others are counted.
# Of gravity, by which the force at rest may differ: offsets of MEMS reach 0.2 g, a wrong unit or range makes 0.5 at least.
_GRAVITY_TOLERANCE = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisNoise:
    """One axis. Figures are SI where the scale is known, else raw unit.

    Attributes
    ----------
    name : str
        "accelerometer x".
    unit : str
    tau_s, deviation, low, high : ndarray, shape (n,)
        Overlapped Allan deviation with 95 % limits.
    model : NoiseModel or None
        None for an axis that never changed, or is too short to say anything.
    step : float
        Smallest change of the output.
    sentences : tuple of str
    """

    name: str
    unit: str
    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    model: NoiseModel | None
    step: float
    sentences: tuple[str, ...] = ()

    @property
    def density(self) -> NoiseFigure:
        """White noise, unit per sqrt(Hz)."""
        return _NOT_KNOWN if self.model is None else self.model.density

    @property
    def instability(self) -> NoiseFigure:
        """Bias instability, unit."""
        return _NOT_KNOWN if self.model is None else self.model.instability

    @property
    def walk(self) -> NoiseFigure:
        """Rate random walk, unit per sqrt(s)."""
        return _NOT_KNOWN if self.model is None else self.model.walk


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetFigure:
    """A figure as data sheets state it: ``figure`` of an axis times ``factor``."""

    triad: str
    title: str
    figure: str
    unit: str
    factor: float


_MICRO_G = 1e6 / STANDARD_GRAVITY_M_S2
_SQRT_HOUR = math.sqrt(_HOURS)
DATA_SHEET = (
    SheetFigure(triad="accelerometer", title="velocity random walk", figure="density", unit="ug/sqrt(Hz)", factor=_MICRO_G),
    SheetFigure(triad="accelerometer", title="velocity random walk", figure="density", unit="m/s/sqrt(h)", factor=_SQRT_HOUR),
    SheetFigure(triad="accelerometer", title="bias instability", figure="instability", unit="ug", factor=_MICRO_G),
    SheetFigure(
        triad="gyroscope", title="angle random walk", figure="density", unit="deg/sqrt(h)", factor=math.degrees(_SQRT_HOUR)
    ),
    SheetFigure(triad="gyroscope", title="bias instability", figure="instability", unit="deg/h", factor=math.degrees(_HOURS)),
)


_NOT_KNOWN = NoiseFigure(math.nan, 0.0, math.nan, False)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseResult:
    """What a recording at rest showed."""

    axes: tuple[AxisNoise, ...]
    """Accelerometer x, y, z, then gyroscope x, y, z where there is one."""
    duration_s: float
    """Of the stretch that was used."""
    rate_hz: float
    samples: int
    bridged: int
    """Lost samples that were bridged."""
    is_si: bool
    sentences: tuple[str, ...] = ()

    @property
    def source(self) -> str:
        """Where the figures come from, in words."""
        return f"Allan deviation of {self.duration_s / _HOURS:.2f} h at rest, {self.rate_hz:.4g} Hz"

    def triad(self, name: str) -> tuple[AxisNoise, ...]:
        """Return the axes of "accelerometer" or "gyroscope"."""
        return tuple(axis for axis in self.axes if axis.name.startswith(name))

    def data_sheet(self) -> Iterator[tuple[SheetFigure, tuple[NoiseFigure, ...]]]:
        """Yield the figures of data sheets, each with those of its three axes; none where the noise is in raw units."""
        for sheet in DATA_SHEET if self.is_si else ():
            if axes := self.triad(sheet.triad):
                yield sheet, tuple(getattr(axis, sheet.figure).times(sheet.factor) for axis in axes)

    def values(self, triad: str, figure: str) -> FloatArray:
        """Return "density", "instability" or "walk" of a triad, shape (3,); NaN where it was not observed."""
        return np.array([getattr(axis, figure).value for axis in self.triad(triad)] or [np.nan] * 3)

    def upper_limits(self, triad: str, figure: str) -> FloatArray:
        """Return the upper 95 % limits, shape (3,)."""
        return np.array([getattr(axis, figure).high for axis in self.triad(triad)] or [np.nan] * 3)


class NoiseStream:
    """Collects the noise of a recording from a stream of samples.

    Parameters
    ----------
    units : SampleUnits
    accelerometer_scale, gyroscope_scale : float or ndarray, shape (3,), optional
        Raw unit per SI, from a calibration or the driver; without them figures stay in raw units.
    raw_zero : ndarray, shape (3,), optional
        Accelerometer output at zero input, as a rate; subtracted before a move is looked for.
    """

    def __init__(
        self,
        units: SampleUnits,
        accelerometer_scale: FloatArray | float | None = None,
        gyroscope_scale: FloatArray | float | None = None,
        raw_zero: FloatArray | None = None,
    ) -> None:
        self._units = units
        given = ((accelerometer_scale, units.accelerometer, "m/s"), (gyroscope_scale, units.gyroscope, "rad"))
        known = [scale is not None or unit.startswith(si) for scale, unit, si in given]
        self.is_si, self._knows_force = all(known), known[0]
        self._scale = np.concatenate([np.broadcast_to(1.0 if scale is None else scale, 3) for scale, _, _ in given])
        self._zero = np.zeros(3) if raw_zero is None else raw_zero
        self._grid: EvenGrid | None = None
        self._columns = 6
        self._best: _Stretch | None = None
        self._now: _Stretch | None = None
        self._first: list[Samples] = []
        self._averaged = LEAST_AVERAGED
        self._waiting: list[FloatArray] = []
        self._waiting_s = 0.0
        self._splits: list[str] = []
        self._assumed: list[str] = []

    def feed(self, samples: Samples) -> None:
        """Take the next samples.

        Raises
        ------
        RecordingError
            If the time of too many of the first samples stands still.
        """
        if self._grid is not None:
            self._put(samples, self._grid)
            return
        self._first.append(samples)
        if sum(map(len, self._first)) >= _FIRST_SAMPLES:
            self._begin()

    def _begin(self) -> EvenGrid:
        """Find the interval, and take the samples that waited for it."""
        step_s = np.diff(np.concatenate([np.empty(0), *(block.time_s for block in self._first)])[:_FIRST_SAMPLES])
        if not len(step_s):
            raise RecordingError(sentence("noise.no_samples"), Reason.NOT_A_RECORDING)
        standing = float(np.mean(step_s <= 0))
        if standing > _MOST_STANDING:
            raise RecordingError(sentence("noise.no_rate", share=standing, limit=_MOST_STANDING), Reason.BAD_DATA)
        self._grid = EvenGrid(*interval_and_slack(step_s, self._units.interval_s))
        middle_s = float(median(step_s[step_s > 0]))
        if self._grid.interval_s > COARSE * middle_s:
            told = {"middle_ms": 1e3 * middle_s, "rate_hz": 1 / self._grid.interval_s}
            self._assumed.append(sentence("noise.coarse", **told))
        self._averaged = max(round(1 / self._grid.interval_s), LEAST_AVERAGED)
        # An instrument without a gyroscope has NaN there all along.
        gyroscope = np.concatenate([block.gyroscope for block in self._first])[:_FIRST_SAMPLES]
        self._columns = 6 if np.isfinite(gyroscope).any() else 3
        for block in self._first:
            self._put(block, self._grid)
        self._first = []
        return self._grid

    def _put(self, samples: Samples, grid: EvenGrid) -> None:
        values = np.hstack([samples.accelerometer_rate() - self._zero, samples.gyroscope_rate()]) / self._scale
        values = values[:, : self._columns]
        good = samples.usable & np.isfinite(values).all(axis=1)
        if not good.any():
            return
        for run in grid.feed(samples.time_s[good], values[good]):
            self._take(run, grid)

    def finish(self) -> NoiseResult:
        """Return what the longest undisturbed stretch shows.

        Raises
        ------
        RecordingError
            If there are no samples, or no rate is known.
        CalibrationError
            If no stretch is long enough to say anything.
        """
        grid = self._grid or self._begin()
        self._end_run()
        # Only whole means count.
        least = -(-max(LEAST_SAMPLES, round(LEAST_S / grid.interval_s)) // self._averaged) * self._averaged
        best = self._best
        if best is None or best.stream.samples < least:
            longest_s = 0.0 if best is None else best.duration_s
            told = {"longest_s": longest_s, "least_s": least * grid.interval_s, "rate_hz": 1 / grid.interval_s}
            raise CalibrationError(sentence("noise.too_short", **told), Reason.TOO_FEW)
        allan = best.stream.finish()
        raw = {"accelerometer": self._units.accelerometer_rate_unit, "gyroscope": self._units.gyroscope_rate_unit}
        si = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
        axes: list[AxisNoise] = []
        for triad, unit in list((si if self.is_si else raw).items())[: best.stream.columns // 3]:
            axes += [_axis(f"{triad} {axis}", len(axes) + k, best, allan, unit=unit) for k, axis in enumerate(AXES)]
        sentences = [*self._assumed, *self._splits[:_SPLITS_NAMED]]
        if len(self._splits) > _SPLITS_NAMED:
            sentences.append(sentence("noise.more_disturbances", count=len(self._splits) - _SPLITS_NAMED))
        if best.bridged:
            sentences.append(sentence("noise.bridged", count=best.bridged))
        counted_s = grid.rows * grid.interval_s
        if abs(grid.lasted_s / counted_s - 1) > _OTHER_RATE:
            told = {"lasted_s": grid.lasted_s, "counted_s": counted_s, "rate_hz": 1 / grid.interval_s, "limit": _OTHER_RATE}
            sentences.append(sentence("noise.other_rate", **told))
        off = abs(best.mean_force / STANDARD_GRAVITY_M_S2 - 1)
        if self._knows_force and off > _GRAVITY_TOLERANCE:
            values = {"found_m_s2": best.mean_force, "expected_m_s2": STANDARD_GRAVITY_M_S2, "limit": _GRAVITY_TOLERANCE}
            sentences.append(sentence("noise.no_gravity", **values))
        sentences += _hidden(axes, best.duration_s / _HOURS)
        return NoiseResult(
            axes=tuple(axes),
            duration_s=best.duration_s,
            rate_hz=1 / best.interval_s,
            samples=best.stream.samples,
            bridged=best.bridged,
            is_si=self.is_si,
            sentences=tuple(sentences),
        )

    def _take(self, run: EvenRows, grid: EvenGrid) -> None:
        """Take even rows: whole means go into the stretch, which ends where the unit was moved; the rest waits."""
        if run.broken:
            self._end_run()
            self._splits.append(sentence("noise.missing_samples", bridged_s=grid.bridged_s, at_s=run.start_s))
        if not self._waiting:
            self._waiting_s = run.start_s
        self._waiting.append(np.column_stack([run.rows, run.bridged.astype(np.float64)]))
        if sum(len(part) for part in self._waiting) < self._averaged:
            return
        joined = np.concatenate(self._waiting)
        whole = len(joined) // self._averaged * self._averaged
        parts = joined[:whole].reshape(-1, self._averaged, self._columns + 1)
        averaged_s = self._averaged * grid.interval_s
        begin = 0
        for k, mean in enumerate(parts[:, :, :3].mean(axis=1)):
            if self._now is not None and self._now.is_moved(mean):
                self._now.feed(parts[begin:k].reshape(-1, self._columns + 1))
                self._splits.append(sentence("noise.moved", at_s=self._waiting_s + k * averaged_s))
                self._end_stretch()
                begin = k
            if self._now is None:
                self._now = _Stretch(AllanStream(grid.interval_s, self._columns), averaged_s)
            self._now.follow(mean)
        if self._now is not None:
            self._now.feed(parts[begin:].reshape(-1, self._columns + 1))
        self._waiting = [joined[whole:]]
        self._waiting_s += whole * grid.interval_s

    def _end_run(self) -> None:
        """End the stretch; the mean that was not full is given up."""
        self._waiting = []
        self._end_stretch()

    def _end_stretch(self) -> None:
        if self._now is not None and (self._best is None or self._now.stream.samples > self._best.stream.samples):
            self._best = self._now
        self._now = None


class _Stretch:
    """One undisturbed stretch."""

    def __init__(self, stream: AllanStream, averaged_s: float) -> None:
        self.stream = stream
        self.interval_s = stream.interval_s
        self.bridged = 0
        self.step = np.full(stream.columns, np.inf)
        self.changes = 0
        self.squares = np.zeros(stream.columns)
        self._last = np.empty((0, stream.columns + 1))
        self._reference: FloatArray | None = None
        self._means, self._most_means = 0, max(round(REFERENCE_S / averaged_s), 1)

    @property
    def duration_s(self) -> float:
        """From the first to the last sample."""
        return self.stream.samples * self.interval_s

    @property
    def mean_force(self) -> float:
        """Length of the accelerometer's mean of the last minute, m/s^2 or raw."""
        return math.nan if self._reference is None else float(np.linalg.norm(self._reference))

    def is_moved(self, mean: FloatArray) -> bool:
        """Whether the mean of a second or more (3,) is that of a unit that was moved."""
        if self._reference is None:
            return False
        return float(np.abs(mean - self._reference).max()) > MOVED * self.mean_force

    def follow(self, mean: FloatArray) -> None:
        """Let the reference follow the mean of the next samples, shape (3,)."""
        self._means = min(self._means + 1, self._most_means)
        # A mean over the first minute, then an exponential one.
        before = mean if self._reference is None else self._reference
        self._reference = before + (mean - before) / self._means

    def feed(self, rows: FloatArray) -> None:
        """Take even rows, shape (n, c + 1); the last column is 1 where a row is bridged."""
        if not len(rows):
            return
        # From the row before, which may have come with another block.
        values, bridged = np.split(np.vstack([self._last, rows]), [self.stream.columns], axis=1)
        self._last = rows[-1:]
        self.bridged += int(rows[:, -1].sum())
        # A straight line has neither the scatter nor the steps of the output.
        change = np.abs(np.diff(values, axis=0))[(bridged[1:] + bridged[:-1])[:, 0] == 0]
        self.changes += len(change)
        self.squares += np.sum(change**2, axis=0)
        change[change == 0] = np.inf  # the smallest step is that of an output that changed
        self.step = np.minimum(self.step, change.min(axis=0, initial=np.inf))
        self.stream.feed(rows[:, :-1])


def measure_noise(
    blocks: Iterable[Samples],
    accelerometer_scale: FloatArray | float | None = None,
    gyroscope_scale: FloatArray | float | None = None,
    raw_zero: FloatArray | None = None,
) -> NoiseResult:
    """Return the noise of a recording; see ``NoiseStream``.

    Raises
    ------
    RecordingError
        If there are fewer than two samples, or too many of the first times repeat.
    CalibrationError
        If no stretch is long enough.
    UsageError
        If allantools is not installed.
    """
    stream: NoiseStream | None = None
    for block in blocks:
        stream = stream or NoiseStream(block.units, accelerometer_scale, gyroscope_scale, raw_zero)
        stream.feed(block)
    if stream is None:
        raise RecordingError(sentence("noise.no_samples"), Reason.NOT_A_RECORDING)
    return stream.finish()


def _hidden(axes: Sequence[AxisNoise], hours: float) -> Iterator[Sentence]:
    """Yield a sentence for each figure that the recording was too short for, whatever the number of axes."""
    known = [axis for axis in axes if axis.model is not None]
    for key, names in (
        ("noise.axis_too_short", [axis.name for axis in axes if axis.model is None and math.isfinite(axis.step)]),
        ("noise.no_instability", [axis.name for axis in known if not axis.instability.observed]),
        ("noise.no_walk", [axis.name for axis in known if not axis.walk.observed]),
    ):
        if names:
            yield sentence(key, hours=hours, names=names if len(names) < len(axes) else ["any axis"])


def _axis(name: str, column: int, best: _Stretch, allan: AllanDeviation, *, unit: str) -> AxisNoise:
    deviation, freedom = allan.deviation[:, column], degrees_of_freedom(allan, column)
    low, high = deviation_limits_95(deviation, freedom)
    step = float(best.step[column])
    # Differences of neighbours have twice the variance of a sample, and no drift.
    sigma = math.sqrt(best.squares[column] / max(2 * best.changes, 1))
    quantised = math.isfinite(step) and sigma < QUANTISED * step
    model = None
    if len(deviation) >= _IDENTIFIED_POINTS and deviation.min() > 0:
        model = identify(allan.tau_s, deviation, freedom)
        if quantised:
            limit = max(QUANTISED * step * math.sqrt(best.interval_s), model.density.high)
            model = replace(model, density=NoiseFigure(math.nan, 0.0, limit, False))
    sentences: list[str] = []
    if not math.isfinite(step):
        sentences.append(sentence("noise.dead", name=name))
    elif quantised:
        sentences.append(sentence("noise.quantised", name=name, sigma=sigma, step=step, unit=unit))
    return AxisNoise(
        name=name,
        unit=unit,
        tau_s=allan.tau_s,
        deviation=deviation,
        low=low,
        high=high,
        model=model,
        step=step,
        sentences=tuple(sentences),
    )
