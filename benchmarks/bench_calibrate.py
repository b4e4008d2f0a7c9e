"""Calibration from 24 positions: time of each step, and parameters against simulated truth.

The peer is the same fit as one writes it in an afternoon: scipy with a numerical Jacobian from a rough start, no weights, no
uncertainty. Both are timed in this run.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from benchmarks.rows import Row, print_rows
from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.accelerometer.ellipsoid_start import closed_form_start
from imufield.calibrate.accelerometer.fit import column_basis
from imufield.calibrate.model.models import from_vector, predict
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.earth import Gravity
from imufield.samples import FloatArray, SampleUnits

GRAVITY = Gravity(gravity_m_s2=9.81, sigma_m_s2=1e-5, source="typed")
ROUNDS = 20
SESSIONS = 100


def make_session(seed: int, quadratic: float = 0.0) -> tuple[FloatArray, Observations]:
    """Return true parameters (lower gauge) and the observations of paper24 with 30 micro-g of noise."""
    rng = np.random.default_rng(seed)
    vector = np.concatenate(
        [400 * (1 + rng.normal(0, 0.02, 3)), rng.normal(0, 0.1, 3), np.zeros(6), quadratic * rng.normal(0, 1, 3)]
    )
    vector[[8, 10, 11]] = rng.normal(0, 0.01, 3)
    angle, axes = np.pi / 4 * np.arange(8), np.eye(3)
    up = np.vstack([np.outer(np.cos(angle), axes[k - 2]) + np.outer(np.sin(angle), axes[k - 1]) for k in range(3)])
    tilted = up + rng.normal(0, 0.03, up.shape)
    a = 9.81 * tilted / np.linalg.norm(tilted, axis=1)[:, None]
    sigma = 400 * 3e-4
    mean = predict(from_vector(vector), a) + rng.normal(0, sigma, a.shape)
    nan = np.full(24, np.nan)
    covariance = np.broadcast_to(sigma**2 * np.eye(3), (24, 3, 3)).copy()
    nothing = np.full((24, 3), np.nan)
    names = tuple(f"p{k:02d}" for k in range(24))
    units = SampleUnits(accelerometer="count", gyroscope="count")
    return vector, Observations(
        name=names,
        mean_raw=mean,
        covariance_raw=covariance,
        gyroscope_mean_raw=nothing,
        gyroscope_covariance_raw=np.full((24, 3, 3), np.nan),
        gyroscope_rounding_raw=np.zeros((24, 3)),
        gyroscope_noise_raw=np.full((24, 3), np.nan),
        direction=up,
        start_s=nan,
        duration_s=nan,
        middle_s=np.full(24, np.nan),
        middle_rad=np.zeros((24, 3)),
        temperature_degc=nan,
        units=units,
    )


def best_ms(action: Callable[[], object]) -> float:
    """Return the best of some rounds, ms."""
    times = []
    for _ in range(ROUNDS):
        before = time.perf_counter()
        action()
        times.append(time.perf_counter() - before)
    return 1e3 * min(times)


def plain_problem(observations: Observations, columns: int) -> NormProblem:
    start = closed_form_start(observations.mean_raw, 9.81, np.ones(3))
    basis = column_basis(start, LOWER_GAUGE_COLUMNS[:columns], 9.81)
    return NormProblem(raw=observations.mean_raw, gravity_m_s2=9.81, sigma_m_s2=np.ones(24), origin=start, basis=basis)


def peer(observations: Observations) -> FloatArray:
    """Scipy with a numerical Jacobian from K = half the span, everything else zero."""
    raw = observations.mean_raw
    origin = np.zeros(15)
    origin[:3] = np.ptp(raw, axis=0) / 2 / 9.81
    problem = NormProblem(
        raw=raw,
        gravity_m_s2=9.81,
        sigma_m_s2=np.ones(24),
        origin=origin,
        basis=column_basis(origin, LOWER_GAUGE_COLUMNS[:9], 9.81),
    )
    return problem.vector(least_squares(problem.residuals, problem.start).x)


def import_ms(module: str) -> float:
    """Return the time to import a module in a fresh interpreter beyond what importing NumPy takes, ms."""

    def run(code: str) -> float:
        return min(best_of_process(code) for _ in range(3))

    return run(f"import numpy, {module}") - run("import numpy")


def best_of_process(code: str) -> float:
    before = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return 1e3 * (time.perf_counter() - before)


def worst_error_in_sigma(model: str, quadratic: float) -> tuple[float, float]:
    """Return RMS and largest error over sigma of scale and bias."""
    ratios = []
    for seed in range(SESSIONS):
        truth, observations = make_session(seed, quadratic)
        found = calibrate_accelerometer(observations, GRAVITY, model=model)  # type: ignore[arg-type]
        ratios.append((found.accelerometer.scale - truth[:3]) / found.accelerometer_sigma.scale)
        ratios.append((found.accelerometer.bias_m_s2 - truth[3:6]) / found.accelerometer_sigma.bias_m_s2)
    values = np.array(ratios)
    return float(np.sqrt(np.mean(values**2))), float(np.abs(values).max())


def row(name: str, value: float, unit: str, peer_value: float | None = None) -> Row:
    """Return one line of the table; the ratio is peer over ours, because less is better here."""
    return {
        "name": name,
        "value": value,
        "unit": unit,
        "peer": peer_value,
        "ratio": None if peer_value is None else peer_value / value,
    }


def run() -> list[Row]:
    """Return every figure as a row."""
    truth, observations = make_session(1)
    linear, quadratic = plain_problem(observations, 9), plain_problem(observations, 12)
    population = np.random.default_rng(0).normal(0, 1e-3, (60, 12))
    whole = {
        model: best_ms(partial(calibrate_accelerometer, observations, GRAVITY, model=model))
        for model in ("linear", "quadratic", "auto")
    }
    theirs = 1e6 * np.abs(peer(observations)[:3] / truth[:3] - 1).max()
    fitted = calibrate_accelerometer(observations, GRAVITY, model="linear").accelerometer
    ours = 1e6 * np.abs(fitted.scale / truth[:3] - 1).max()
    rows = [
        row("closed-form start", best_ms(lambda: plain_problem(observations, 9)), "ms"),
        row(
            "least squares, 9 parameters (peer: numerical Jacobian)",
            best_ms(lambda: solve_least_squares(linear)),
            "ms",
            best_ms(lambda: peer(observations)),
        ),
        row("least squares, 12 parameters", best_ms(lambda: solve_least_squares(quadratic)), "ms"),
        *(row(f"calibrate_accelerometer, 24 positions, {model}", value, "ms") for model, value in whole.items()),
        row("cost of 60 candidates in one call", best_ms(lambda: quadratic.cost(population)), "ms"),
        row("import of the room", import_ms("imufield.calibrate.accelerometer.accelerometer"), "ms"),
        row("import of scipy.optimize", import_ms("scipy.optimize"), "ms"),
        row("scale, largest error against truth", ours, "ppm", theirs),
    ]
    for model, term in (("linear", 0.0), ("quadratic", 0.02), ("auto", 0.02)):
        rms, worst = worst_error_in_sigma(model, term)
        rows.append(row(f"error over sigma, RMS of {SESSIONS} sessions, {model}", rms, "1"))
        rows.append(row(f"error over sigma, largest of {SESSIONS} sessions, {model}", worst, "1"))
    return rows


def main() -> None:
    """Print the figures as a table."""
    print_rows(run())


if __name__ == "__main__":
    main()
