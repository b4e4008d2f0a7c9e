"""Noise of an instrument from hours of standstill: what ``imufield noise`` finds.

Samples go onto an even grid (lost ones are bridged by a straight line up to 1 s, and counted), the longest stretch in which
nothing was moved goes into the Allan deviation, and each axis is identified by itself. Memory does not grow with the length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from imufield.calibrate.model.coverage_factors import deviation_limits_95
from imufield.calibrate.noise.allan import (
    BRIDGED_S,
    AllanDeviation,
    AllanStream,
    EvenGrid,
    EvenRows,
    degrees_of_freedom,
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
REFERENCE_S = 60.0
"""The mean that a second is compared with follows the last minute: warm-up passes, a touch does not."""
LEAST_SAMPLES = 1000
"""The deviation at one sample interval is then known to 3 %."""
LEAST_S = 60.0
"""In less, nothing but white noise can be seen."""
QUANTISED = 0.5
"""Scatter of samples below this many steps of the output: the steps do not average out, the true noise is hidden."""
_IDENTIFIED_POINTS = 6  # Octaves that tell the five kinds of noise of ``noise_fit`` apart: one more than there are kinds.
_FIRST_BLOCK = 3  # Samples that tell the interval where nothing else does.
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
        self._waiting: list[FloatArray] = []
        self._waiting_s = 0.0
        self._splits: list[str] = []

    def feed(self, samples: Samples) -> None:
        """Take the next samples."""
        values = np.hstack([samples.accelerometer_rate() - self._zero, samples.gyroscope_rate()]) / self._scale
        if self._grid is None:
            if len(samples) < _FIRST_BLOCK:
                return
            interval_s = self._units.interval_s or float(median(np.diff(samples.time_s)))
            if interval_s <= 0:
                raise RecordingError(sentence("noise.no_rate"), Reason.BAD_DATA)
            self._grid = EvenGrid(interval_s)
            # An instrument without a gyroscope has NaN there all along.
            self._columns = 6 if np.isfinite(values[:, 3:]).any() else 3
        values = values[:, : self._columns]
        good = samples.usable & np.isfinite(values).all(axis=1)
        if not good.any():
            return
        for run in self._grid.feed(samples.time_s[good], values[good]):
            self._take(run, self._grid.interval_s)

    def finish(self) -> NoiseResult:
        """Return what the longest undisturbed stretch shows.

        Raises
        ------
        CalibrationError
            If no stretch is long enough to say anything.
        """
        self._end_run()
        best = self._best
        if best is None or best.stream.samples < LEAST_SAMPLES or best.duration_s < LEAST_S:
            longest_s = 0.0 if best is None else best.duration_s
            short = sentence("noise.too_short", longest_s=longest_s, least_s=LEAST_S, least_samples=LEAST_SAMPLES)
            raise CalibrationError(short, Reason.TOO_FEW)
        allan = best.stream.finish()
        raw = {"accelerometer": self._units.accelerometer_rate_unit, "gyroscope": self._units.gyroscope_rate_unit}
        si = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
        axes: list[AxisNoise] = []
        for triad, unit in list((si if self.is_si else raw).items())[: best.stream.columns // 3]:
            axes += [_axis(f"{triad} {axis}", len(axes) + k, best, allan, unit=unit) for k, axis in enumerate(AXES)]
        sentences = self._splits[:_SPLITS_NAMED]
        if len(self._splits) > _SPLITS_NAMED:
            sentences.append(sentence("noise.more_disturbances", count=len(self._splits) - _SPLITS_NAMED))
        if best.bridged:
            sentences.append(sentence("noise.bridged", count=best.bridged))
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

    def _take(self, run: EvenRows, interval_s: float) -> None:
        """Take even rows: whole seconds go into the stretch, which ends where the unit was moved; the rest waits."""
        if run.broken:
            self._end_run()
            self._splits.append(sentence("noise.missing_samples", bridged_s=BRIDGED_S, at_s=run.start_s))
        if not self._waiting:
            self._waiting_s = run.start_s
        self._waiting.append(run.rows)
        second = max(round(1 / interval_s), 1)
        if sum(len(part) for part in self._waiting) < second:
            return
        joined = np.concatenate(self._waiting)
        whole = len(joined) // second * second
        seconds = joined[:whole].reshape(-1, second, self._columns)
        begin = 0
        for k, mean in enumerate(seconds[:, :, :3].mean(axis=1)):
            at_s = self._waiting_s + k * second * interval_s
            if self._now is not None and self._now.is_moved(mean):
                self._now.feed(seconds[begin:k].reshape(-1, self._columns))
                self._splits.append(sentence("noise.moved", at_s=at_s))
                self._end_stretch()
                begin = k
            if self._now is None:
                self._now = _Stretch(AllanStream(interval_s, self._columns), interval_s)
            self._now.follow(mean)
        if self._now is not None:
            self._now.feed(seconds[begin:].reshape(-1, self._columns))
            self._now.bridged += run.bridged
        self._waiting = [joined[whole:]]
        self._waiting_s += whole * interval_s

    def _end_run(self) -> None:
        """End the stretch; the second that was not full is given up."""
        self._waiting = []
        self._end_stretch()

    def _end_stretch(self) -> None:
        if self._now is not None and (self._best is None or self._now.stream.samples > self._best.stream.samples):
            self._best = self._now
        self._now = None


class _Stretch:
    """One undisturbed stretch."""

    def __init__(self, stream: AllanStream, interval_s: float) -> None:
        self.stream = stream
        self.interval_s = interval_s
        self.bridged = 0
        self.step = np.full(stream.columns, np.inf)
        self.squares = np.zeros(stream.columns)
        self._reference: FloatArray | None = None
        self._seconds = 0

    @property
    def duration_s(self) -> float:
        """From the first to the last sample."""
        return self.stream.samples * self.interval_s

    @property
    def mean_force(self) -> float:
        """Length of the accelerometer's mean of the last minute, m/s^2 or raw."""
        return math.nan if self._reference is None else float(np.linalg.norm(self._reference))

    def is_moved(self, mean: FloatArray) -> bool:
        """Whether the mean of a second (3,) is that of a unit that was moved."""
        if self._reference is None:
            return False
        return float(np.abs(mean - self._reference).max()) > MOVED * self.mean_force

    def follow(self, mean: FloatArray) -> None:
        """Let the reference follow the mean of a second."""
        self._seconds = min(self._seconds + 1, int(REFERENCE_S))
        # A mean over the first minute, then an exponential one.
        before = mean if self._reference is None else self._reference
        self._reference = before + (mean - before) / self._seconds

    def feed(self, rows: FloatArray) -> None:
        """Take even rows."""
        if not len(rows):
            return
        change = np.abs(np.diff(rows, axis=0))
        self.squares += np.sum(change**2, axis=0)
        change[change == 0] = np.inf  # the smallest step is that of an output that changed
        self.step = np.minimum(self.step, change.min(axis=0, initial=np.inf))
        self.stream.feed(rows)


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
        If there are no samples.
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
    sigma = math.sqrt(best.squares[column] / max(2 * (best.stream.samples - 1), 1))
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
