"""A clock of the samples that is wrong: the gyroscope's scale in true seconds, with and without the sigma of the clock."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.acquire.clock.loss_watch import HostBaseline
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.uncertainty import NORMAL_FACTOR_95
from imufield.deliver.parameters.clock import HOST_SIGMA, clock_facts
from imufield.guide.positions import scheme
from imufield.samples import FloatArray
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import OperatorSettings
from imufield.study.answers.sessions import imported_moves
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

RATE_HZ = 100.0
LATE_S = 2e-3
"""Mean delay of a read beyond the least: a USB adapter of a computer at work."""
WAITED_S = 0.3
"""What lay at the port when it was opened."""
_READ = 4  # Samples.


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockKind:
    """A kind of clock: how far its oscillator may be off, and whether a host stood beside it."""

    error: float
    """Relative; the oscillator is uniform within it."""
    has_host: bool = False
    is_exact: bool = False
    """Whether it is off by just so much."""


KINDS = {
    "typed rate, exactly 0.5 % off": ClockKind(error=0.005, is_exact=True),
    "typed rate, exactly 3 % off": ClockKind(error=0.03, is_exact=True),
    "typed rate, within 1 %": ClockKind(error=0.01),
    "typed rate, within 5 %": ClockKind(error=0.05),
    "instrument's time beside the host's, within 1 %": ClockKind(error=0.01, has_host=True),
}


@dataclass(frozen=True, slots=True)
class ClockRun:
    """Error of the scale of each axis over its 95 % limits, shape (3,): without and with the clock; and of the host's rate."""

    alone: FloatArray
    absolute: FloatArray
    own_clock: FloatArray
    """In seconds of the sample clock, over the limit without the clock's sigma."""
    rate_error: float
    """Of the rate by the host, relative; NaN without one."""


def run_clock(kind: ClockKind, rng: np.random.Generator) -> ClockRun:
    """Calibrate the gyroscope of one session by moves between 24 positions."""
    error = kind.error if kind.is_exact else float(rng.uniform(-kind.error, kind.error))
    habits = OperatorSettings(hold_s=5.0, initial_still_s=8.0)
    seed = int(rng.integers(2**31))
    drawn = make_virtual_imu(
        Emulation(rate_hz=RATE_HZ, seed=seed, grade="mems", directions=scheme("paper24").directions(), operator=habits)
    )
    truth = replace(drawn.imu.instrument, clock_error_ppm=1e6 * error)
    imu = Imu(truth, seed, drawn.imu.settings)
    count = int(drawn.operator.plan_all() / imu.interval_s)
    found = calibrate_gyroscope(imported_moves(imu, drawn.operator)).calibration
    scale, sigma = found.parameters.scale, found.sigma.scale
    true_scale = turn_gyroscope(truth.gyroscope, change_gauge(to_vector(truth.accelerometer), "lower").rotation).scale
    statistics = DecoderStatistics(samples=count, nominal_rate_hz=RATE_HZ)
    rate_error = np.nan
    if kind.has_host:
        host_error = HOST_SIGMA * float(rng.standard_normal())
        baseline = _arrivals(count, imu.interval_s * (1 + host_error), rng)
        statistics.rate_hz, statistics.rate_sigma = (1 - (baseline.slope or 0.0)) * RATE_HZ, baseline.slope_sigma
        rate_error = statistics.rate_hz * imu.interval_s - 1
    by_clock = scale * clock_facts(statistics).sigma
    off = scale - true_scale
    return ClockRun(
        alone=off / (NORMAL_FACTOR_95 * sigma),
        absolute=off / (NORMAL_FACTOR_95 * np.hypot(sigma, by_clock)),
        # Only K over the period is found.
        own_clock=(scale / (1 + error) - true_scale) / (NORMAL_FACTOR_95 * sigma),
        rate_error=rate_error,
    )


def _arrivals(count: int, interval_s: float, rng: np.random.Generator) -> HostBaseline:
    """Return what the host knows of samples that it stamps late, the first of which had waited."""
    baseline = HostBaseline()
    taken = np.arange(_READ, count, _READ)
    true_s = taken * interval_s
    late_s = np.maximum(rng.exponential(LATE_S, len(taken)), WAITED_S - true_s)
    for number, arrival_s in zip(taken, true_s + late_s, strict=True):
        baseline.add(float(arrival_s), float(number) / RATE_HZ)
    return baseline


def wrong_clock(context: StudyContext) -> Findings:
    """Count how often the scale is inside its limits."""
    runs = context.runs(200, 2)
    found = context.campaign_of_each("answers-clock", run_clock, [*KINDS.values()], runs)
    rows = {name: _figures(of_kind) for name, of_kind in zip(KINDS, found, strict=True)}
    of_host = {name: row for name, row in rows.items() if KINDS[name].has_host}
    return Findings(values={"rows": rows, "of_host": of_host, "runs": runs}, tables=(keyed_table("shares", "clock", rows),))


def _figures(runs: list[ClockRun]) -> dict[str, float]:
    def inside(values: list[FloatArray]) -> float:
        return float(np.mean(np.abs(values) <= 1))

    alone = np.array([run.alone for run in runs])
    return {
        "alone": inside([run.alone for run in runs]),
        "sigmas": float(np.sqrt(np.mean(alone**2))) * NORMAL_FACTOR_95,
        "absolute": inside([run.absolute for run in runs]),
        "own_clock": inside([run.own_clock for run in runs]),
        "rate_ppm": float(np.sqrt(np.mean(np.square([run.rate_error for run in runs])))) * 1e6,
    }
