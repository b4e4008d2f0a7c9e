"""What a report is made from, besides the parameter file: things that only the recording can tell."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from imufield.calibrate.accelerometer.methods import problem_for, restart
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.moves import Moves
from imufield.calibrate.gyroscope.report import angle_errors_deg
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, Calibration, GyroscopeParameters, without_drift
from imufield.calibrate.solvers.registry import load_solver
from imufield.deliver.navigation.rest import IntervalMeans
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.schema import Document
from imufield.errors import CalibrationError
from imufield.progress import one_by_one
from imufield.samples import FloatArray, Samples, SampleUnits, TemperatureHold

CELL_S = 0.5
"""Of the stillness trace: short against a hold, long against the interval between samples."""
SHOWN_METHODS = ("bsas", "ide")
"""Methods that tell their convergence; least squares is there after one step."""


@dataclass(frozen=True, slots=True)
class Trace:
    """How still the instrument was, arrays of shape (n,)."""

    time_s: FloatArray
    scatter_m_s2: FloatArray
    """Standard deviation of the specific force inside each cell, root sum of squares over the axes."""
    rate_rad_s: FloatArray
    """Size of the mean rate less the rate at rest; NaN without a complete gyroscope."""


@dataclass(frozen=True, slots=True)
class Closure:
    """How far each move, integrated from the gyroscope, ends from where gravity says, arrays of shape (m,), deg."""

    start_s: FloatArray
    before_deg: FloatArray
    """With the preset, or the nominal scale and no bias but the mean at rest; NaN where neither is known."""
    after_deg: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence:
    """Best cost over the iterations of a method, relative to its last."""

    method: str
    excess: FloatArray
    """Cost over final cost, less 1, after each iteration."""
    evaluations: int
    converged: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportData:
    """Everything that is shown; what is not there is left out of the page."""

    parameters: Parameters
    preset: Parameters | None = None
    trace: Trace | None = None
    closure: Closure | None = None
    convergence: tuple[Convergence, ...] = ()
    verification: Document | None = None
    provenance: tuple[tuple[str, str], ...] = ()
    """Name and value."""
    operator: str = ""
    notes: tuple[str, ...] = field(default=())


class TraceCollector:
    """Makes the trace from a stream of samples."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._temperature = TemperatureHold()
        self._means: IntervalMeans | None = None
        self._centre = np.zeros(6)

    def feed(self, samples: Samples) -> None:
        """Take the next block."""
        # Before any is left out: its temperature may be the last one known.
        samples = self._temperature.fill(samples)
        # One sample that is not finite would make a whole cell NaN.
        kept = samples[samples.usable & np.isfinite(samples.accelerometer).all(axis=1)]
        if not len(kept):
            return
        corrected = self._parameters.apply(kept)
        values = np.hstack([corrected.specific_force_m_s2, np.nan_to_num(corrected.angular_rate_rad_s)])
        if self._means is None:
            self._means = IntervalMeans(float(kept.time_s[0]), 12, CELL_S)
            self._centre = values[0]  # squares of what is left lose no digits
        values = values - self._centre
        self._means.feed(corrected.time_s, np.hstack([values, values**2]))

    def finish(self) -> Trace | None:
        """Return the trace; None without a sample."""
        means = np.empty((0, 12)) if self._means is None else self._means.finish()
        if self._means is None or not len(means):
            return None
        time_s = self._means.start_s + (np.arange(len(means)) + 0.5) * CELL_S
        variance = np.maximum(means[:, 6:9] - means[:, :3] ** 2, 0.0)
        rate = means[:, 3:6] - np.nanmedian(means[:, 3:6], axis=0)
        size = np.linalg.norm(rate, axis=1)
        # Without a scale the rates are no rates; the plot leaves the panel out.
        known = self._parameters.gyroscope_is_complete
        scatter = np.asarray(np.sqrt(variance.sum(axis=1)))
        return Trace(np.asarray(time_s, dtype=np.float64), scatter, np.where(known, size, np.nan))


class RestCollector:
    """Means of the gyroscope over the positions of a parameter file, from a stream of samples.

    The file states when each position was taken, so stillness is not evaluated again; the file has no means of the gyroscope.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._observations = observations_of(parameters)
        self._start_s = self._observations.start_s
        self._end_s = self._start_s + self._observations.duration_s
        m = len(self._observations)
        self._count, self._sum, self._square = np.zeros((m, 1)), np.zeros((m, 3)), np.zeros((m, 3))
        self._centre: FloatArray | None = None

    def feed(self, samples: Samples) -> None:
        """Take the next block."""
        kept = samples[samples.usable & np.isfinite(samples.gyroscope).all(axis=1)]
        inside = (self._start_s <= samples.time_s[-1]) & (self._end_s >= samples.time_s[0])
        if not len(kept) or not inside.any():
            return
        rate = kept.gyroscope_rate()
        # Squares of what is left lose no digits.
        centre = rate[0] if self._centre is None else self._centre
        self._centre = centre
        rate = rate - centre
        for k in np.flatnonzero(inside):
            first, last = np.searchsorted(kept.time_s, (self._start_s[k], self._end_s[k]))
            self._count[k] += last - first
            self._sum[k] += rate[first:last].sum(axis=0)
            self._square[k] += np.square(rate[first:last]).sum(axis=0)

    def finish(self) -> Observations:
        """Return the file's observations with the gyroscope, NaN for a position without samples."""
        if self._centre is None:
            return self._observations
        # A position without samples divides by its count of zero, and NaN is what is said of it.
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self._sum / self._count
            variance = np.maximum(self._square / self._count - mean**2, 0.0) / self._count
        covariance = variance[:, :, None] * np.eye(3)
        return replace(self._observations, gyroscope_mean_raw=mean + self._centre, gyroscope_covariance_raw=covariance)


def observations_of(parameters: Parameters) -> Observations:
    """Return the observations that a parameter file comes from; they have no gyroscope."""
    tables = [table for table in parameters.document["position"] if table["used"]]
    m = len(tables)

    def column(key: str) -> FloatArray:
        return np.array([table[key] for table in tables], dtype=np.float64)

    return Observations(
        name=tuple(table["name"] for table in tables),
        mean_raw=column("mean_raw"),
        covariance_raw=np.array([np.diag(np.square(table["sigma_raw"])) for table in tables], dtype=np.float64),
        gyroscope_mean_raw=np.full((m, 3), np.nan),
        gyroscope_covariance_raw=np.full((m, 3, 3), np.nan),
        direction=column("direction"),
        start_s=column("start_s"),
        duration_s=column("duration_s"),
        temperature_degc=column("temperature_degc"),
        units=SampleUnits(accelerometer=parameters.calibration.accelerometer_raw_unit),
    )


def convergence(
    observations: Observations, calibration: Calibration, preset: AccelerometerParameters | None, seed: int
) -> tuple[Convergence, ...]:
    """Solve again with the methods of the papers, from a start of their own, and return how they got there."""
    runs = []
    for method in one_by_one("solving with every method", SHOWN_METHODS):
        # A start of their own: from the result itself there would be no way to show.
        try:
            again = restart(observations, calibration, preset)
        except CalibrationError:
            return ()
        result = load_solver(method)(problem_for(again, method), rng=np.random.default_rng(seed))
        history = result.history
        # To a cost of zero, of a simulation without noise, there is no ratio.
        if len(history) and history[-1] > 0:
            excess = history / history[-1] - 1
            runs.append(Convergence(method=method, excess=excess, evaluations=result.evaluations, converged=result.converged))
    return tuple(runs)


def closure(
    observations: Observations,
    moves: Moves,
    parameters: Parameters,
    preset: GyroscopeParameters | None,
    *,
    nominal: float | None,
) -> Closure | None:
    """Return the angle errors of the moves with the file's gyroscope and with what was in force before; None without moves.

    ``observations`` are all stills between the moves, those of whole turns included.
    """
    calibration = parameters.calibration
    there = np.isfinite(observations.gyroscope_mean_raw).all()
    if calibration.gyroscope is None or not parameters.gyroscope_is_complete or not len(moves) or not there:
        return None
    given = GyroscopeInput(
        observations=without_drift(observations, calibration),
        moves=moves,
        calibration=calibration,
        latitude_deg=calibration.gravity.latitude_deg,
        preset=preset,
        nominal_scale=nominal,
        rests=len(observations) - int(calibration.positions.used.sum()),
    )
    return Closure(moves.start_s, *angle_errors_deg(given, calibration.gyroscope.parameters))
