"""Figures of the gyroscope calibration and of the noise analysis: ``python benchmarks/bench_gyroscope.py [part ...]``.

Parts: real, seeds, turns, navigation, turntable, speed, noise. ``seeds`` takes some minutes (200 sessions), the rest seconds.
The real recordings are read from the folder ``shared`` beside the project.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput, make_data
from imufield.calibrate.gyroscope.move_integration import rough_inverse
from imufield.calibrate.gyroscope.stills_alone import StaticData, StaticFree, fit_static
from imufield.calibrate.gyroscope.turntable import TurntableRun, pair_runs
from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS
from imufield.calibrate.model.result import GYROSCOPE_NAMES, GyroscopeParameters
from imufield.calibrate.moves.moves import MoveCollector
from imufield.calibrate.noise.noise import NoiseStream
from imufield.calibrate.solvers.evolution import solve_ide
from imufield.earth import EARTH_RATE_RAD_S, Gravity
from imufield.guide.lead.unguided import StillIntervalFinder
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray, Samples, SampleUnits, make_samples
from imufield.simulate.truth.grades import GRADES, draw_truth
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.study.instruments import TURN_RATES_DEG_S

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT / "tests" / "calibrate"))
from gyroscope_sessions import (  # noqa: E402 (it lies beside the tests)
    BLOCK,
    Session,
    collect_moves,
    fit_turns_only,
    matrix_from_pairs,
    rolled,
    simulate,
    steady,
    turns_problem,
)

SHARED = PROJECT.parent / "shared" / "data"
LONG: dict[str, Any] = {"rate_hz": 200.0, "hold_s": 12.0}
DEG_PER_HOUR = np.radians(1.0) / 3600


def read_xsens() -> tuple[Samples, float, float]:
    a = np.loadtxt(SHARED / "imu_tk" / "xsens_acc.mat.gz")
    g = np.loadtxt(SHARED / "imu_tk" / "xsens_gyro.mat.gz")
    return (
        make_samples(a[:, 0], a[:, 1:], g[:, 1:], units=SampleUnits(accelerometer="count", gyroscope="count")),
        32768.0,
        9.81744,
    )


def read_mikoff(name: str) -> tuple[Samples, float, float]:
    rows = np.loadtxt(SHARED / "mikoff" / f"{name}.log.gz")
    return make_samples(np.arange(len(rows)) / 100, rows[:, :3], rows[:, 3:6], units=SampleUnits()), 0.0, 9.81


def prepare(samples: Samples, zero: float, gravity: float) -> GyroscopeInput:
    finder = StillIntervalFinder(samples.units, replace(RoughScale.of_units(samples.units), raw_zero=np.full(3, zero)))
    finder.feed(samples)
    found = finder.finish().observations
    calibration = calibrate_accelerometer(
        found, Gravity(gravity_m_s2=gravity, sigma_m_s2=1e-5, source="typed"), raw_zero=zero, model="linear"
    )
    return GyroscopeInput(
        observations=found, moves=collect_moves([samples], found.start_s, found.duration_s), calibration=calibration
    )


def as_imu_tk(samples: Samples, given: GyroscopeInput) -> FloatArray:
    """K E on imu_tk's model: bias of the first 50 s, no g-sensitivity, moves unweighted."""
    first = samples.gyroscope[samples.time_s < 50].mean(axis=0)
    observations = replace(given.observations, gyroscope_mean_raw=np.tile(first, (len(given.observations), 1)))
    data = make_data(replace(given, observations=observations))
    p = np.zeros(data.parameters)
    p[:9] = rough_inverse(data.moves).ravel()
    return np.asarray(np.linalg.inv(fit_turns_only(data, p)[:9].reshape(3, 3)), dtype=np.float64)


def real() -> None:
    samples, zero, gravity = read_xsens()
    given = prepare(samples, zero, gravity)
    M = as_imu_tk(samples, given)
    E = M / np.diag(M)[:, None] - np.eye(3)
    reference = np.array([[0, -0.009676, -0.010574], [-0.005567, 0, 0.032153], [-0.016155, 0.024104, 0]])
    rows = np.linalg.norm(M, axis=1) / [4778.42, 4772.14, 4775.28] - 1
    print(f"imu_tk's model: row lengths {np.abs(rows).max():.4%} off, angles {np.abs(E - reference).max() * 1e3:.2f} mrad off")
    for name, one in (("xsens", given), *((n, prepare(*read_mikoff(n))) for n in ("imu0", "imu2"))):
        begin = time.perf_counter()
        result = calibrate_gyroscope(one)
        took = time.perf_counter() - begin
        after = result.moves.after_deg
        print(f"{name}: {len(after)} moves, {result.moves.rms_after_deg:.3f} deg RMS, {after.max():.3f} deg max, {took:.2f} s")


def vector(p: GyroscopeParameters) -> FloatArray:
    off_diagonal = p.misalignment_rad[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
    return np.concatenate([p.scale, off_diagonal, p.bias, p.g_sensitivity.ravel()])


def campaign(sessions: Iterable[Session]) -> tuple[FloatArray, FloatArray]:
    """Error over sigma, and sigma, of every parameter; shape (sessions, 21)."""
    ratios, sigmas = [], []
    for session in sessions:
        result = calibrate_gyroscope(session.given)
        sigma = vector(result.calibration.sigma)
        ratios.append((vector(result.calibration.parameters) - vector(session.truth)) / sigma)
        sigmas.append(sigma)
    return np.array(ratios), np.array(sigmas)


def seeds(count: int = 200) -> None:
    ratios, sigmas = campaign(simulate(seed, **LONG) for seed in range(count))
    rms = np.sqrt(np.nanmean(ratios**2, axis=0))
    for name, value, sigma in zip(GYROSCOPE_NAMES, rms, np.nanmean(sigmas, axis=0), strict=True):
        print(f"  {name:34s} RMS(error/sigma) {value:.3f}   sigma {sigma:.3g}")
    print(f"{count} seeds: RMS of error/sigma from {rms.min():.3f} to {rms.max():.3f}")


def turns(count: int = 20) -> None:
    _, plain = campaign(simulate(seed, **LONG) for seed in range(count))
    ratios, rolled_over = campaign(simulate(seed, turns=rolled(3), **LONG) for seed in range(count))
    gain = plain[:, :3].mean(axis=0) / rolled_over[:, :3].mean(axis=0)
    rms = np.sqrt(np.mean(ratios[:, :3] ** 2))
    print(f"three rolled whole turns each way and axis: scale sigma {gain.round(2)} times smaller, error/sigma {rms:.2f} RMS")


def static_session(seed: int, seconds: float) -> tuple[StaticData, FloatArray, FloatArray]:
    """24 positions at 45 deg, any heading, 0.003 deg/sqrt(h), accelerometer 10 ug; K E and bias."""
    rng = np.random.default_rng(seed)
    up = scheme("paper24").directions() + 0.05 * rng.standard_normal((24, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    north = np.cross(up, rng.standard_normal((24, 3)))
    north /= np.linalg.norm(north, axis=1)[:, None]
    rate = EARTH_RATE_RAD_S * np.sqrt(0.5) * (up + north)
    M = np.diag(1 + 1e-5 * rng.standard_normal(3)) @ (np.eye(3) + 5e-5 * rng.standard_normal((3, 3)) * (1 - np.eye(3)))
    bias = 0.01 * DEG_PER_HOUR * rng.standard_normal(3)
    sigma = 0.003 * np.radians(1.0) / 60 / np.sqrt(seconds)
    raw = rate @ M.T + bias + sigma * rng.standard_normal((24, 3))
    seen = up + 1e-5 * rng.standard_normal((24, 3))
    seen /= np.linalg.norm(seen, axis=1)[:, None]
    return (
        StaticData(raw, sigma**2 * np.eye(72), seen, np.asarray(np.arange(24) * (seconds + 10.0))),
        M,
        bias,
    )


def navigation(count: int = 100) -> None:
    cases: tuple[tuple[float, StaticFree], ...] = ((10.0, "bias"), (60.0, "all"))
    for seconds, free in cases:
        errors, contradiction = [], []
        for seed in range(count):
            data, M, bias = static_session(seed, seconds)
            A: FloatArray = np.asarray(np.linalg.inv(M)) if free == "bias" else np.eye(3)
            fitted = fit_static(data, A, 45.0, free)
            found = np.linalg.inv(fitted.x[:9].reshape(3, 3)) @ fitted.x[9:12]
            errors.append((found - bias) / DEG_PER_HOUR)
            wrong = fit_static(data, A, 45.5, free)
            expected_rad_s = EARTH_RATE_RAD_S * np.sin(np.radians(45.5))
            contradiction.append(abs(wrong.vertical_rad_s - expected_rad_s) / wrong.vertical_sigma_rad_s)
        rms = np.sqrt(np.mean(np.square(errors)))
        print(
            f"static path, {seconds:g} s a position, free: {free}: bias {rms:.4f} deg/h RMS; "
            f"a latitude wrong by 0.5 deg stands out by {min(contradiction):.1f} sigma or more"
        )


def turntable(count: int = 30) -> None:
    hits, worst = 0, 0.0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        M = np.diag(1 + 1e-3 * rng.standard_normal(3)) @ (np.eye(3) + 1e-3 * rng.standard_normal((3, 3)) * (1 - np.eye(3)))
        sigma = 0.003 * np.radians(1.0) / 60 / np.sqrt(60.0)
        runs = [
            TurntableRun(
                axis=axis,
                rate_rad_s=way * w,
                mean_raw=M @ axis * way * w + sigma * rng.standard_normal(3),
                covariance_raw=sigma**2 * np.eye(3),
            )
            for axis in np.eye(3)
            for w in np.radians(TURN_RATES_DEG_S)
            for way in (1.0, -1.0)
        ]
        table = pair_runs(runs)
        best = matrix_from_pairs(table)
        found = solve_ide(turns_problem(table), rng=rng)
        exact = turns_problem(table).cost(np.concatenate([np.diag(best), _off_diagonal(best)])[None])[0]
        hits += found.cost <= exact * (1 + 1e-6)
        worst = max(worst, float(np.abs(best - M).max()))
    print(f"turntable: IDE on the vector form reaches the global optimum for {hits} of {count} seeds; K E within {worst:.1e}")


def _off_diagonal(M: FloatArray) -> FloatArray:
    off: FloatArray = np.asarray(M / np.diag(M)[:, None])[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
    return off


def speed() -> None:
    """A 40-minute session at 2000 Hz: the samples are made beforehand, block by block, and only our part is timed."""
    instrument = steady(draw_truth(GRADES["mems"], np.random.default_rng(1)))
    operator = Operator(scheme("paper24").directions(), 1, OperatorSettings(hold_s=97.0, initial_still_s=20.0))
    imu = Imu(instrument, 1, ImuSettings(rate_hz=2000.0))
    total = int(operator.plan_all() / imu.interval_s)
    finder, collector, took = StillIntervalFinder(SampleUnits()), MoveCollector(SampleUnits()), 0.0
    for first in range(0, total, BLOCK):
        block = imu.feed(operator.block(first, min(BLOCK, total - first), imu.interval_s))
        finder.feed(block)
        begin = time.perf_counter()
        collector.feed(block)
        took += time.perf_counter() - begin
    observations = finder.finish().observations
    calibration = calibrate_accelerometer(
        observations, Gravity(gravity_m_s2=operator.site.gravity_m_s2, sigma_m_s2=1e-5, source="typed")
    )
    begin = time.perf_counter()
    moves = collector.finish(observations.start_s, observations.duration_s)
    result = calibrate_gyroscope(
        GyroscopeInput(observations=observations, moves=moves, calibration=calibration, latitude_deg=45.0)
    )
    fit_s = time.perf_counter() - begin
    print(
        f"{total} samples ({total / 2000 / 60:.0f} min at 2000 Hz), {len(moves)} moves: {took:.1f} s for the sums, "
        f"{fit_s:.1f} s for the fit, peak {_peak_mib():.0f} MiB, {result.moves.rms_after_deg:.3f} deg RMS"
    )


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def noise(hours: float = 24.0, rate_hz: float = 200.0) -> None:
    stream, took = NoiseStream(SampleUnits(interval_s=1 / rate_hz)), 0.0
    for block in _standstill(hours, rate_hz):
        begin = time.perf_counter()
        stream.feed(block)
        took += time.perf_counter() - begin
    begin = time.perf_counter()
    result = stream.finish()
    took += time.perf_counter() - begin
    density = result.values("gyroscope", "density") / 1e-4
    print(
        f"{hours:g} h at {rate_hz:g} Hz, six axes: {took:.1f} s, peak {_peak_mib():.0f} MiB, density over truth "
        f"{density.round(4)}"
    )


def _standstill(hours: float, rate_hz: float) -> Iterator[Samples]:
    rng = np.random.default_rng(3)
    density, walk = np.repeat([1e-3, 1e-4], 3), np.repeat([2e-5, 1e-6], 3)
    n, level = int(hours * 3600 * rate_hz), np.array([0.0, 0.0, 9.8, 0.0, 0.0, 0.0])
    for first in range(0, n, 20000):
        count = min(20000, n - first)
        path = level + np.cumsum(rng.standard_normal((count, 6)) * walk / np.sqrt(rate_hz), axis=0)
        level = path[-1]
        values = path + rng.standard_normal((count, 6)) * density * np.sqrt(rate_hz)
        time_s = (first + np.arange(count)) / rate_hz
        yield make_samples(time_s, values[:, :3], values[:, 3:], units=SampleUnits(interval_s=1 / rate_hz))


PARTS: dict[str, Callable[[], None]] = {
    "real": real,
    "navigation": navigation,
    "turntable": turntable,
    "speed": speed,
    "noise": noise,
    "turns": turns,
    "seeds": seeds,
}

if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
