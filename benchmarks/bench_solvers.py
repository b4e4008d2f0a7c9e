"""Solvers on one core, and campaigns on two, in one run: ``OMP_NUM_THREADS=1 python benchmarks/bench_solvers.py``."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import differential_evolution

from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.solvers.beetles import BasSettings, solve_bas, solve_bsas
from imufield.calibrate.solvers.evolution import solve_ide
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.calibrate.solvers.triad_costs import TriadProblem
from imufield.campaign import run_campaign
from imufield.samples import FloatArray
from imufield.study.bsas_runs import run_whitened
from imufield.study.instruments import BSAS_AXES, BSAS_GRAVITY_M_S2, bsas_outputs, bsas_preset, ide_problem
from imufield.study.optimum import exact_absolute_minimum, squares_optimum

NEAR = 1 + 1e-6


def median_time_s(call: Callable[[int], object], runs: int) -> float:
    call(0)
    times = []
    for seed in range(runs):
        start = time.perf_counter()
        call(seed)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def table_3_problem(seed: int) -> tuple[NormProblem, np.random.Generator]:
    rng = np.random.default_rng(seed)
    raw, preset = bsas_outputs(rng), bsas_preset(rng)
    return whitened_problem(preset, raw, BSAS_GRAVITY_M_S2, quadratic_axes=BSAS_AXES), rng


def time_to_cost_s(
    solve: Callable[[TriadProblem, Callable[[float], bool]], object], problem: TriadProblem, optimum: float
) -> float:
    """Return the time until the best cost is within 1e-6 of the optimum."""
    start = time.perf_counter()
    reached: list[float] = []

    def near(cost: float) -> bool:
        if cost <= optimum * NEAR and not reached:
            reached.append(time.perf_counter() - start)
        return bool(reached)

    solve(problem, near)
    return reached[0] if reached else float("nan")


def ide_until(problem: TriadProblem, near: Callable[[float], bool]) -> None:
    class Watched(TriadProblem):
        def cost(self, candidates: FloatArray) -> FloatArray:
            costs = super().cost(candidates)
            near(float(costs.min()))
            return costs

    # It goes on to its end, but the time that counts is noted when it is near.
    watched = Watched(problem.raw, problem.reference, problem.lower, problem.upper)
    solve_ide(watched, rng=np.random.default_rng(0))


def scipy_until(problem: TriadProblem, near: Callable[[float], bool]) -> None:
    best = [np.inf]

    def cost(x: FloatArray) -> FloatArray:
        costs = problem.cost(np.ascontiguousarray(x.T))
        best[0] = min(best[0], float(costs.min()))
        return costs

    def stop(_x: FloatArray, /, convergence: float = 0.0) -> bool:
        del convergence
        return near(best[0])

    # The stubs know neither a cost of whole populations nor a plain list of bounds.
    minimise: Any = differential_evolution
    minimise(
        cost,
        list(zip(*problem.bounds, strict=True)),
        vectorized=True,
        updating="deferred",
        popsize=5,
        maxiter=20000,
        tol=0,
        polish=False,
        init="random",
        callback=stop,
        rng=np.random.default_rng(0),
    )


def on_one_core(runs: int) -> None:
    problems = [table_3_problem(seed)[0] for seed in range(runs)]
    swarm = [solve_bsas(problem, rng=np.random.default_rng(seed)) for seed, problem in enumerate(problems)]
    worst = max(found.cost / exact_absolute_minimum(problem)[0] for found, problem in zip(swarm, problems, strict=True))
    rows = [
        ("least squares, 24 positions", median_time_s(lambda s: solve_least_squares(table_3_problem(s)[0]), runs), 0.010),
        ("bsas to the optimum", median_time_s(lambda s: solve_bsas(problems[s], rng=np.random.default_rng(s)), runs), 0.2),
        (
            "bas, 300 iterations",
            median_time_s(lambda s: solve_bas(problems[s], rng=np.random.default_rng(s), settings=BasSettings()), runs),
            None,
        ),
        ("ide, 60 x 1200", median_time_s(lambda s: solve_ide(ide_problem(np.random.default_rng(s))), runs), 0.4),
    ]
    for name, seconds, limit in rows:
        print(f"{name:<34}{seconds * 1e3:9.1f} ms" + (f"   limit {limit * 1e3:.0f} ms" if limit else ""))
    print(f"bsas over the exact minimum, worst {worst:.5f}")


def against_scipy(runs: int) -> None:
    ours, theirs, whole = [], [], []
    for seed in range(runs):
        problem = ide_problem(np.random.default_rng(seed))
        optimum, _ = squares_optimum(problem)
        ours.append(time_to_cost_s(ide_until, problem, optimum))
        theirs.append(time_to_cost_s(scipy_until, problem, optimum))
        start = time.perf_counter()
        solve_ide(problem, rng=np.random.default_rng(seed))
        whole.append(time.perf_counter() - start)
    to_cost, whole_run = np.array(theirs) / ours, np.array(theirs) / whole
    print(
        f"time to 1e-6 above the optimum: ide {np.median(ours):.3f} s, scipy differential_evolution {np.median(theirs):.3f} s"
    )
    print(
        f"scipy over ide: {np.median(to_cost):.2f} to that cost, {np.median(whole_run):.2f} over all 1200 generations (limit 2)"
    )


def campaigns(runs: int) -> None:
    seconds = []
    for workers in (1, 2):
        start = time.perf_counter()
        results = run_campaign(run_whitened, range(runs), seed=0, workers=workers)
        seconds.append(time.perf_counter() - start)
        total = sum(result.swarm.cost for result in results)
        print(f"campaign of {runs} runs, {workers} worker(s): {seconds[-1]:.1f} s, sum of costs {total:.12e}")
    print(f"speed-up {seconds[0] / seconds[1]:.2f} (limit 1.6)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="runs of each solver")
    parser.add_argument("--campaign", type=int, default=200, help="runs of the campaign; 0 leaves it out")
    options = parser.parse_args()
    on_one_core(options.runs)
    against_scipy(options.runs)
    if options.campaign:
        campaigns(options.campaign)


if __name__ == "__main__":
    main()
