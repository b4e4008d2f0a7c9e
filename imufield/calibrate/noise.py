"""Noise of an instrument from hours of standstill: what ``imufield noise`` finds.

Samples go onto an even grid (lost ones are bridged by a straight line up to 1 s, and counted), the longest stretch in which
nothing was moved goes into the Allan deviation, and each axis is identified by itself. Memory does not grow with the length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from imufield.calibrate.allan import AllanStream, degrees_of_freedom, interval_95
from imufield.calibrate.noise_fit import Figure, NoiseModel, identify
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray, IntArray, Samples, SampleUnits

BRIDGED_S = 1.0
"""Lost samples for longer than this end a stretch."""
MOVED = 0.005
"""Change of the mean output of a second, over the length of the accelerometer's mean: 5 mg. More is a unit that was moved."""
REFERENCE_S = 60.0
"""The mean that a second is held against follows the last minute: warm-up passes, a touch does not."""
LEAST_SAMPLES = 1000
LEAST_S = 60.0
QUANTISED = 0.5
"""Scatter of samples below this many steps of the output: the steps do not average out, the true noise is hidden."""
_IDENTIFIED_POINTS = 6
_HOURS = 3600.0


@dataclass(frozen=True, slots=True)
class AxisNoise:
    """One axis. Figures are SI where the scale is known, else raw unit.

    Attributes
    ----------
    name : str
        "accelerometer x".
    unit : str
    tau_s, deviation, low, high, freedom : ndarray, shape (n,)
        Overlapped Allan deviation with 95 % limits and equivalent degrees of freedom.
    model : NoiseModel or None
        None for an axis that never changed, or is too short to say anything.
    sample_sigma, step : float
        Scatter of single samples; smallest change of the output.
    quantised : bool
    sentences : tuple of str
    """

    name: str
    unit: str
    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    freedom: FloatArray
    model: NoiseModel | None
    sample_sigma: float
    step: float
    quantised: bool
    sentences: tuple[str, ...] = ()

    @property
    def density(self) -> Figure:
        """White noise, unit per sqrt(Hz)."""
        return _NOT_KNOWN if self.model is None else self.model.density

    @property
    def instability(self) -> Figure:
        """Bias instability, unit."""
        return _NOT_KNOWN if self.model is None else self.model.instability

    @property
    def walk(self) -> Figure:
        """Rate random walk, unit per sqrt(s)."""
        return _NOT_KNOWN if self.model is None else self.model.walk


_NOT_KNOWN = Figure(math.nan, 0.0, math.nan, False)


@dataclass(frozen=True, slots=True)
class NoiseResult:
    """What a recording at rest showed."""

    axes: tuple[AxisNoise, ...]
    """Accelerometer x, y, z, then gyroscope x, y, z where there is one."""
    start_s: float
    duration_s: float
    """Of the stretch that was used."""
    rate_hz: float
    samples: int
    bridged: int
    """Lost samples that were bridged."""
    is_si: bool
    sentences: tuple[str, ...] = field(default=())

    @property
    def source(self) -> str:
        """Where the figures come from, in words."""
        return f"Allan deviation of {self.duration_s / _HOURS:.2f} h at rest, {self.rate_hz:.4g} Hz"

    def triad(self, name: str) -> tuple[AxisNoise, ...]:
        """Return the axes of "accelerometer" or "gyroscope"."""
        return tuple(axis for axis in self.axes if axis.name.startswith(name))

    def values(self, triad: str, figure: str) -> FloatArray:
        """Return "density", "instability" or "walk" of a triad, shape (3,); NaN where it was not seen."""
        found = [getattr(axis, figure).value for axis in self.triad(triad)]
        return np.array(found) if found else np.full(3, np.nan)

    def upper_limits(self, triad: str, figure: str) -> FloatArray:
        """Return the upper 95 % limits, shape (3,)."""
        found = [getattr(axis, figure).high for axis in self.triad(triad)]
        return np.array(found) if found else np.full(3, np.nan)


class NoiseStream:
    """Collects the noise of a recording from a stream of samples.

    Parameters
    ----------
    units : SampleUnits
    accelerometer_scale, gyroscope_scale : float or ndarray, shape (3,), optional
        Raw unit per SI, from a calibration or the driver; without them figures stay in raw units.
    """

    def __init__(
        self,
        units: SampleUnits,
        accelerometer_scale: FloatArray | float | None = None,
        gyroscope_scale: FloatArray | float | None = None,
    ) -> None:
        self._units = units
        known = (_scale(accelerometer_scale, units.accelerometer, "m/s"), _scale(gyroscope_scale, units.gyroscope, "rad"))
        self.is_si = all(scale is not None for scale in known)
        self._scale = np.concatenate([np.ones(3) if scale is None else scale for scale in known])
        self._best: _Stretch | None = None
        self._now: _Stretch | None = None
        self._last: tuple[float, FloatArray] | None = None
        self._interval_s: float | None = None
        self._pending: list[FloatArray] = []
        self._pending_rows = 0
        self._pending_start_s = 0.0
        self._columns = 6
        self._splits: list[str] = []

    def feed(self, samples: Samples) -> None:
        """Take the next samples."""
        values = np.concatenate([samples.accelerometer_rate(), samples.gyroscope_rate()], axis=1) / self._scale
        if self._interval_s is None:
            self._begin(samples, values)
        if self._interval_s is None:
            return
        values = values[:, : self._columns]
        good = samples.usable & np.isfinite(values).all(axis=1)
        time_s, values = samples.time_s[good], values[good]
        if not len(time_s):
            return
        for part_s, part, bridged in self._onto_grid(time_s, values):
            self._take(part_s, part, bridged)

    def finish(self) -> NoiseResult:
        """Return what the longest undisturbed stretch shows.

        Raises
        ------
        CalibrationError
            If no stretch is long enough to say anything.
        """
        self._end_stretch()
        best = self._best
        if best is None or best.stream.samples < LEAST_SAMPLES or best.duration_s < LEAST_S:
            longest = 0.0 if best is None else best.duration_s
            raise CalibrationError(
                f"the longest undisturbed stretch lasts {longest:.0f} s and the noise needs {LEAST_S:.0f} s and {LEAST_SAMPLES} "
                "samples at least (an hour says something, six hours say more); record with the unit lying still",
                Reason.TOO_FEW,
                longest_s=longest,
            )
        return _result(best, self._units, self.is_si, tuple(self._splits))

    def _begin(self, samples: Samples, values: FloatArray) -> None:
        if len(samples) < 3:
            return
        self._interval_s = self._units.interval_s or float(np.median(np.diff(samples.time_s)))
        # An instrument without a gyroscope has NaN there all along.
        self._columns = 6 if np.isfinite(values[:, 3:]).any() else 3

    def _onto_grid(self, time_s: FloatArray, values: FloatArray) -> list[tuple[float, FloatArray, int]]:
        """Return stretches of even samples: where each begins, its rows, and how many of them are bridged."""
        interval = self._interval_s or 1.0
        begins_new = self._last is None
        if self._last is not None:
            time_s = np.concatenate([[self._last[0]], time_s])
            values = np.concatenate([self._last[1][None], values])
        self._last = (float(time_s[-1]), values[-1])
        steps = np.rint(np.diff(time_s) / interval).astype(np.int64)
        breaks = np.flatnonzero((steps * interval > BRIDGED_S) | (np.diff(time_s) <= 0)) + 1
        found = []
        for number, rows in enumerate(np.split(np.arange(len(time_s)), breaks)):
            if number:
                self._end_stretch(f"samples are missing for more than {BRIDGED_S:g} s at {time_s[rows[0]]:.1f} s")
            part_s, part, bridged = _bridge(time_s[rows], values[rows], steps[rows[:-1]])
            skip = 0 if number or begins_new else 1
            if len(part) > skip:
                found.append((part_s + skip * interval, part[skip:], bridged))
                if number + 1 < len(breaks) + 1:
                    self._take(*found.pop())
        return found

    def _take(self, start_s: float, rows: FloatArray, bridged: int) -> None:
        """Take even rows that follow those before; whole seconds are judged and go on."""
        interval = self._interval_s or 1.0
        second = max(round(1 / interval), 1)
        if self._now is None:
            self._now = _Stretch(AllanStream(interval, self._columns), start_s, interval)
            self._pending_start_s = start_s
        self._now.bridged += bridged
        self._pending.append(rows)
        self._pending_rows += len(rows)
        if self._pending_rows < second:
            return
        joined = np.concatenate(self._pending)
        whole = len(joined) // second * second
        self._pending, self._pending_rows = [joined[whole:]], len(joined) - whole
        self._judge(joined[:whole], second)
        self._pending_start_s += whole * interval

    def _judge(self, rows: FloatArray, second: int) -> None:
        """Feed whole seconds, cut where the unit was moved."""
        interval = self._interval_s or 1.0
        means = rows[:, :3].reshape(-1, second, 3).mean(axis=1)
        begin = 0
        for k, mean in enumerate(means):
            if self._now is None:
                self._now = _Stretch(
                    AllanStream(interval, self._columns), self._pending_start_s + k * second * interval, interval
                )
            if self._now.is_moved(mean):
                self._now.feed(rows[begin * second : k * second])
                begin = k
                self._end_stretch(
                    f"the unit was moved at {self._pending_start_s + k * second * interval:.0f} s", keep_pending=True
                )
                self._now = _Stretch(
                    AllanStream(interval, self._columns), self._pending_start_s + k * second * interval, interval
                )
                self._now.is_moved(mean)
        if self._now is not None:
            self._now.feed(rows[begin * second :])

    def _end_stretch(self, why: str | None = None, *, keep_pending: bool = False) -> None:
        if not keep_pending:
            if self._now is not None and self._pending_rows:
                self._now.feed(np.concatenate(self._pending))
            self._pending, self._pending_rows = [], 0
        if self._now is not None and (self._best is None or self._now.stream.samples > self._best.stream.samples):
            self._best = self._now
        self._now = None
        if why is not None:
            self._splits.append(why)


class _Stretch:
    """One undisturbed stretch."""

    def __init__(self, stream: AllanStream, start_s: float, interval_s: float) -> None:
        self.stream = stream
        self.start_s = start_s
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

    def is_moved(self, mean: FloatArray) -> bool:
        """Whether the mean of a second (3,) is that of a unit that was moved; follows it if not."""
        if self._reference is None:
            self._reference = mean.copy()
        if np.abs(mean - self._reference).max() > MOVED * max(float(np.linalg.norm(self._reference)), 1e-300):
            return True
        self._seconds = min(self._seconds + 1, int(REFERENCE_S))
        self._reference = self._reference + (mean - self._reference) / self._seconds
        return False

    def feed(self, rows: FloatArray) -> None:
        """Take even rows."""
        if not len(rows):
            return
        change = np.abs(np.diff(rows, axis=0))
        self.squares += np.sum(change**2, axis=0)
        change[change == 0] = np.inf
        self.step = np.minimum(self.step, change.min(axis=0, initial=np.inf))
        self.stream.feed(rows)


def _bridge(time_s: FloatArray, values: FloatArray, steps: IntArray) -> tuple[float, FloatArray, int]:
    missing = int(np.sum(steps - 1, where=steps > 1))
    if not missing:
        return float(time_s[0]), values, 0
    place = np.concatenate([[0], np.cumsum(np.maximum(steps, 1))])
    grid = np.arange(place[-1] + 1)
    return float(time_s[0]), np.stack([np.interp(grid, place, column) for column in values.T], axis=1), missing


def measure_noise(
    blocks: Iterable[Samples],
    accelerometer_scale: FloatArray | float | None = None,
    gyroscope_scale: FloatArray | float | None = None,
) -> NoiseResult:
    """Return the noise of a recording; see ``NoiseStream``.

    Raises
    ------
    CalibrationError
        If there are no samples, or no stretch is long enough.
    UsageError
        If allantools is not installed.
    """
    stream: NoiseStream | None = None
    for block in blocks:
        stream = stream or NoiseStream(block.units, accelerometer_scale, gyroscope_scale)
        stream.feed(block)
    if stream is None:
        raise CalibrationError("the recording holds no samples; check that it is the right one", Reason.TOO_FEW)
    return stream.finish()


def _scale(given: FloatArray | float | None, unit: str, si: str) -> FloatArray | None:
    if given is not None:
        return np.broadcast_to(np.asarray(given, dtype=np.float64), (3,))
    return np.ones(3) if unit.startswith(si) else None


def _result(best: _Stretch, units: SampleUnits, is_si: bool, splits: tuple[str, ...]) -> NoiseResult:
    allan = best.stream.finish()
    axes = []
    for column in range(best.stream.columns):
        triad = "accelerometer" if column < 3 else "gyroscope"
        unit = ("m/s^2" if column < 3 else "rad/s") if is_si else f"{getattr(units, triad)} as rate"
        sigma = math.sqrt(best.squares[column] / max(2 * (best.stream.samples - 1), 1))
        deviation, freedom = allan.deviation[:, column], degrees_of_freedom(allan, column)
        low, high = interval_95(deviation, freedom)
        quantised = sigma < QUANTISED * best.step[column] if np.isfinite(best.step[column]) else True
        model = _identify(allan.tau_s, deviation, freedom, best, column) if deviation.min() > 0 else None
        axis = AxisNoise(
            f"{triad} {AXES[column % 3]}", unit, allan.tau_s, deviation, low, high, freedom, model, sigma, float(best.step[column]),
            quantised,
        )  # fmt: skip
        axes.append(_with_sentences(axis, best.duration_s))
    sentences = tuple(f"{why}; the longest stretch without that is used" for why in splits[:3])
    if best.bridged:
        sentences += (f"{best.bridged} lost samples were bridged by a straight line",)
    return NoiseResult(
        tuple(axes), best.start_s, best.duration_s, 1 / best.interval_s, best.stream.samples, best.bridged, is_si, sentences
    )


def _identify(tau_s: FloatArray, deviation: FloatArray, freedom: FloatArray, best: _Stretch, column: int) -> NoiseModel | None:
    if len(tau_s) < _IDENTIFIED_POINTS:
        return None
    model = identify(tau_s, deviation, freedom)
    step = best.step[column]
    sigma = math.sqrt(best.squares[column] / max(2 * (best.stream.samples - 1), 1))
    if np.isfinite(step) and sigma < QUANTISED * step:
        limit = Figure(math.nan, 0.0, max(float(step) * QUANTISED * math.sqrt(best.interval_s), model.density.high), False)
        return NoiseModel(limit, model.instability, model.walk, model.quantisation, model.ramp, model.first, model.squares)
    return model


def _with_sentences(axis: AxisNoise, duration_s: float) -> AxisNoise:
    sentences = []
    if not np.isfinite(axis.step):
        sentences.append(f"{axis.name} never changed: a dead axis, or noise far below one step of its output")
    elif axis.quantised:
        sentences.append(
            f"{axis.name} is limited by quantisation (scatter {axis.sample_sigma:.3g}, one step {axis.step:.3g} {axis.unit}): its "
            "white noise is an upper limit"
        )
    if axis.model is not None:
        hours = duration_s / _HOURS
        for name, figure in (("bias instability", axis.instability), ("random walk", axis.walk)):
            if not figure.seen:
                sentences.append(
                    f"{hours:.2g} h are too short to see the {name} of {axis.name}: below {figure.high:.3g} {axis.unit}"
                    + ("" if name == "bias instability" else "/sqrt(s)")
                )
    elif np.isfinite(axis.step):
        sentences.append(f"{axis.name} is too short to identify anything; record longer")
    return AxisNoise(
        axis.name, axis.unit, axis.tau_s, axis.deviation, axis.low, axis.high, axis.freedom, axis.model, axis.sample_sigma,
        axis.step, axis.quantised, tuple(sentences),
    )  # fmt: skip
