"""IDE Figs. 6 and 8, Table 4: the gyroscope at rest, and on a turntable.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from imufield.calibrate.solvers.evolution import solve_ide
from imufield.calibrate.solvers.triad_costs import TriadProblem, TurnsProblem
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    GYROSCOPE_ARW_DEG_PER_ROOT_HOUR,
    GYROSCOPE_TRUTH,
    STATIC_HOLD_S,
    TURN_RATES_DEG_S,
    gyroscope_static_problem,
    gyroscope_turns_problem,
    per_deg_h,
)
from imufield.study.optimum import squares_optimum
from imufield.study.report import Comparison, CsvTable, StudyReport, curves_table, make_report

SETTING = (
    "Gyroscope of IDE Table 3, simulated, K taken as pulses per deg/s (the paper prints no unit): "
    f"{GYROSCOPE_ARW_DEG_PER_ROOT_HOUR:g} deg/sqrt(h), {STATIC_HOLD_S:.0f} s at each of 24 positions, two turns "
    f"both ways about each axis at {', '.join(f'{rate:g}' for rate in TURN_RATES_DEG_S)} deg/s; bounds of Table 3, "
    "IDE as for the accelerometer."
)
PATHS = ("static", "norm", "vector")
_STATIC_PARAMETERS = 12  # K, E and the bias; turns say nothing of the bias, so the other paths have nine.


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeRun:
    """One run of IDE on one of the three costs."""

    cost: float
    optimum: float
    converged: bool
    rank: int
    errors: FloatArray
    """Errors of the 9 or 12 parameters, those of K relative."""
    history: FloatArray


def make_problem(path: str, rng: np.random.Generator) -> TriadProblem | TurnsProblem:
    """Return the static problem (L_g), eq. 26 as printed (L_gm, "norm"), or the vector form of eq. 25 (L_gv, "vector")."""
    return gyroscope_static_problem(rng) if path == "static" else gyroscope_turns_problem(rng, path)


def run_gyroscope(path: str, rng: np.random.Generator) -> GyroscopeRun:
    """Draw a data set and solve it with IDE."""
    problem = make_problem(path, rng)
    optimum, _ = squares_optimum(problem)
    found = solve_ide(problem, rng=rng)
    # At rest the unit is deg/h, on the turntable deg/s; only K depends on it.
    truth = per_deg_h(GYROSCOPE_TRUTH) if path == "static" else GYROSCOPE_TRUTH[:9]
    reach = (problem.upper - problem.lower) / 2
    # Columns scaled by half the width of the bounds: an entry that cannot move the cost within them counts as undetermined.
    rank = int(np.linalg.matrix_rank(problem.jacobian(truth) * reach, rtol=1e-9))
    errors = found.x - truth
    # Scale factors are compared by their relative error, in ppm; the entries of E are angles already.
    errors[:3] /= truth[:3]
    return GyroscopeRun(
        cost=found.cost, optimum=optimum, converged=found.converged, rank=rank, errors=errors, history=found.history
    )


@cache
def runs_of(context: StudyContext) -> dict[str, list[GyroscopeRun]]:
    """Return the runs of all three paths; studies of the same context share them."""
    return dict(zip(PATHS, context.campaign_of_each("ide-table4", run_gyroscope, PATHS, context.runs(30, 3)), strict=True))


def table_4(context: StudyContext) -> StudyReport:
    """Compare static and dynamic path."""
    found = runs_of(context)
    costs = {path: np.array([run.cost for run in runs]) for path, runs in found.items()}
    optima = {path: np.array([run.optimum for run in runs]) for path, runs in found.items()}
    mean_sd = {path: f"{values.mean():.4g} ({values.std(ddof=1):.1e})" for path, values in costs.items()}
    # RMSE over runs and parameters: the scale factors K (relative) and the entries of E (rad).
    rmse_k = {path: float(np.sqrt(np.mean([run.errors[:3] ** 2 for run in runs]))) for path, runs in found.items()}
    rmse_e = {path: float(np.sqrt(np.mean([run.errors[3:9] ** 2 for run in runs]))) for path, runs in found.items()}
    ranks = ", ".join(f"{found[path][0].rank}" for path in PATHS)
    reached = ", ".join(f"{(costs[path] <= optima[path] * (1 + 1e-6)).sum()} of {len(found[path])}" for path in PATHS)
    over = ", ".join(f"{np.median(costs[path] / optima[path]):.6f}" for path in PATHS)
    comparisons = [
        Comparison("L_g, static path, mean (SD)", "0.4935 (4.0e-06)", f"{mean_sd['static']} (deg/h)^2"),
        Comparison("L_gm, eq. 26 as printed, mean (SD)", "0.003075 (7.8e-04)", f"{mean_sd['norm']} (deg/s)^2"),
        Comparison("L_gv, vector form of eq. 25, mean (SD)", "not done", f"{mean_sd['vector']} deg/s"),
        Comparison("rank of the Jacobian: static, eq. 26, vector", "not given", ranks),
        Comparison("runs at or below the least-squares optimum: static, eq. 26, vector", "not given", reached),
        Comparison("cost over the optimum, median: static, eq. 26, vector", "not given", over),
    ]
    for path, label in zip(PATHS, ("static path", "eq. 26", "vector form"), strict=True):
        ours = f"{rmse_k[path] * 1e6:.3g} ppm, {rmse_e[path]:.2g} rad"
        comparisons.append(Comparison(f"RMSE of K (ppm) and E (rad), {label}", "not given", ours))
    rows = tuple(
        (path, i + 1, run.cost, run.optimum, *run.errors, *[""] * (_STATIC_PARAMETERS - len(run.errors)))
        for path, runs in found.items()
        for i, run in enumerate(runs)
    )
    columns = ("path", "run", "cost", "optimum", *(f"error {i + 1}" for i in range(_STATIC_PARAMETERS)))
    bars = {path: np.array([rmse_k[path] * 1e6, rmse_e[path] * 1e6]) for path in PATHS}
    return make_report(
        "ide-table4",
        comparisons,
        tables=(CsvTable("runs", columns, rows),),
        draw=figures.bars(("K (ppm)", "E (µrad)"), bars, "RMSE", log=True),
        instrument=SETTING,
        runs=len(found["static"]),
    )


def _figure(context: StudyContext, *, name: str, path: str, paper: str) -> StudyReport:
    """Show the fitness of three runs over the generations."""
    runs = runs_of(context)[path][:3]
    curves = {f"test {i + 1}": 1 / run.history for i, run in enumerate(runs)}
    final = np.array([run.cost for run in runs])
    comparisons = (Comparison("final cost of three tests", paper, f"{final.min():.4g} to {final.max():.4g}"),)
    return make_report(
        name,
        comparisons,
        tables=(curves_table("fitness", "generation", curves),),
        draw=figures.convergence({"": curves}, "fitness 1 / L", xlabel="generation", log=False),
        instrument=SETTING,
    )


figure_6 = partial(_figure, name="ide-fig6", path="static", paper="L_g 0.4935")
figure_8 = partial(_figure, name="ide-fig8", path="norm", paper="L_gm 0.003075")
