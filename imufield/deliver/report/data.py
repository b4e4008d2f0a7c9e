"""What a report is made from, besides the parameter file: things that only the recording can tell."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.accelerometer.methods import problem_for, restart
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.result import angle_errors_deg
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, Calibration, GyroscopeParameters, without_drift
from imufield.calibrate.moves.moves import Moves
from imufield.calibrate.solvers.registry import load_solver
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.schema import Document
from imufield.deliver.report.stillness_trace import Trace
from imufield.errors import CalibrationError
from imufield.progress import task
from imufield.samples import FloatArray, SampleUnits

SHOWN_METHODS = ("bsas", "ide")
"""Methods whose convergence is shown where they found the result."""


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
    convergence: Convergence | None = None
    verification: Document | None = None
    provenance: tuple[tuple[str, str], ...] = ()
    """Name and value."""
    operator: str = ""
    notes: tuple[str, ...] = ()


def with_gyroscope(file: Observations, reading: Observations) -> Observations:
    """Return the observations of a file with the gyroscope's means of those read of the recording; NaN for one not found there.

    A file has no means of the gyroscope. The same still is the one under way in the middle of the file's position.
    """
    middle_s = (file.start_s + file.duration_s / 2)[:, None]
    same = (reading.start_s <= middle_s) & (middle_s <= reading.start_s + reading.duration_s)
    row, found = np.argmax(same, axis=1), np.asarray(same.any(axis=1))
    mean, covariance = reading.gyroscope_mean_raw[row], reading.gyroscope_covariance_raw[row]
    return replace(
        file,
        gyroscope_mean_raw=np.where(found[:, None], mean, np.nan),
        gyroscope_covariance_raw=np.where(found[:, None, None], covariance, np.nan),
        gyroscope_rounding_raw=np.where(found[:, None], reading.gyroscope_rounding_raw[row], 0.0),
        gyroscope_noise_raw=np.where(found[:, None], reading.gyroscope_noise_raw[row], np.nan),
        middle_s=np.where(found, reading.middle_s[row], np.nan),
        middle_rad=np.where(found[:, None], reading.middle_rad[row], 0.0),
        units=reading.units,
    )


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
        gyroscope_rounding_raw=np.zeros((m, 3)),
        gyroscope_noise_raw=np.full((m, 3), np.nan),
        direction=column("direction"),
        start_s=column("start_s"),
        duration_s=column("duration_s"),
        middle_s=np.full(m, np.nan),
        middle_rad=np.zeros((m, 3)),
        temperature_degc=column("temperature_degc"),
        units=SampleUnits(accelerometer=parameters.calibration.accelerometer_raw_unit),
    )


def convergence(
    observations: Observations, calibration: Calibration, preset: AccelerometerParameters | None
) -> Convergence | None:
    """Solve again with the method of a paper that found the result, from a start of its own, and return how it got there.

    Nothing for other methods: least squares is there after one step, and a picture of what was not run shows nothing.
    """
    method, seed = calibration.solver.method, calibration.solver.seed or 0
    if method not in SHOWN_METHODS:
        return None
    # A start of its own: from the result itself there would be no way to show.
    try:
        again = restart(observations, calibration, preset)
    except CalibrationError:
        return None
    with task(f"solving with {method}"):
        result = load_solver(method)(problem_for(again, method), rng=np.random.default_rng(seed))
    history = result.history
    # To a cost of zero, of a simulation without noise, there is no ratio.
    if not len(history) or not history[-1] > 0:
        return None
    excess = history / history[-1] - 1
    return Convergence(method=method, excess=excess, evaluations=result.evaluations, converged=result.converged)


def closure(
    observations: Observations,
    moves: Moves,
    parameters: Parameters,
    preset: GyroscopeParameters | None,
    *,
    nominal: float | None,
) -> Closure | None:
    """Return the closing errors of the moves with the file's gyroscope and with what was in force before; None without moves.

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
        rests=len(observations) - calibration.positions.count,
    )
    return Closure(moves.start_s, *angle_errors_deg(given, calibration.gyroscope.parameters))
