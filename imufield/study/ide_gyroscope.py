"""IDE Figs. 6 and 8, Table 4: the gyroscope at rest, and on a turntable.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 3.3.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from imufield.calibrate.solvers.evolution import solve_ide
from imufield.calibrate.solvers.triad_costs import TriadProblem, TurnsProblem
from imufield.dataclass import dataclass, replace
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.ide_runs import fitness
from imufield.study.instruments import (
    GYROSCOPE_TRUTH,
    gyroscope_static_problem,
    gyroscope_turns_problem,
    per_deg_h,
)
from imufield.study.optimum import ComparedRun, compare
from imufield.study.report import CsvTable, Findings

PATHS = ("static", "norm", "vector")
_TURNED_PARAMETERS = 9  # K and E.
_STATIC_PARAMETERS = 12  # K, E and the bias; turns say nothing of the bias, so the other paths have nine.


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeRun:
    """One run of IDE on one of the three costs."""

    compared: ComparedRun
    rank: int
    errors: FloatArray
    """Errors of the 9 or 12 parameters, those of K relative."""


def make_problem(path: str, rng: np.random.Generator) -> TriadProblem | TurnsProblem:
    """Return the static problem (L_g), eq. 26 as printed (L_gm, "norm"), or the vector form of eq. 25 (L_gv, "vector")."""
    return gyroscope_static_problem(rng) if path == "static" else gyroscope_turns_problem(rng, path)


def run_gyroscope(path: str, rng: np.random.Generator) -> GyroscopeRun:
    """Draw a data set and solve it with IDE."""
    problem = make_problem(path, rng)
    compared = compare(solve_ide, problem, rng)
    # At rest the unit is deg/h, on the turntable deg/s; only K depends on it.
    truth = per_deg_h(GYROSCOPE_TRUTH) if path == "static" else GYROSCOPE_TRUTH[:9]
    reach = (problem.upper - problem.lower) / 2
    # Columns scaled by half the width of the bounds: an entry that cannot move the cost within them counts as undetermined.
    rank = int(np.linalg.matrix_rank(problem.jacobian(truth) * reach, rtol=1e-9))
    errors = compared.found.x - truth
    # Scale factors are compared by their relative error, in ppm; the entries of E are angles already.
    errors[:3] /= truth[:3]
    return GyroscopeRun(compared=compared, rank=rank, errors=errors)


@cache
def runs_of(context: StudyContext) -> dict[str, list[GyroscopeRun]]:
    """Return the runs of all three paths; studies of the same context share them."""
    return dict(zip(PATHS, context.campaign_of_each("ide-table4", run_gyroscope, PATHS, context.runs(30, 2)), strict=True))


def table_4(context: StudyContext) -> Findings:
    """Compare static and dynamic path."""
    found = runs_of(context)
    costs = {path: np.array([run.compared.found.cost for run in runs]) for path, runs in found.items()}
    optima = {path: np.array([run.compared.optimum for run in runs]) for path, runs in found.items()}
    # RMSE over runs and parameters: the scale factors K (relative, in ppm) and the entries of E (rad).
    rmse_k = {path: 1e6 * float(np.sqrt(np.mean([run.errors[:3] ** 2 for run in runs]))) for path, runs in found.items()}
    rmse_e = {path: float(np.sqrt(np.mean([run.errors[3:9] ** 2 for run in runs]))) for path, runs in found.items()}
    names = dict(zip(PATHS, ("static path", "eq. 26", "vector form"), strict=True))
    rows = tuple(
        (
            path,
            i + 1,
            run.compared.found.cost,
            run.compared.optimum,
            *run.errors,
            *[""] * (_STATIC_PARAMETERS - len(run.errors)),
        )
        for path, runs in found.items()
        for i, run in enumerate(runs)
    )
    columns = ("path", "run", "cost", "optimum", *(f"error {i + 1}" for i in range(_STATIC_PARAMETERS)))
    bars = {path: np.array([rmse_k[path], rmse_e[path] * 1e6]) for path in PATHS}
    return Findings(
        values={
            "costs": costs,
            "ranks": [runs[0].rank for runs in found.values()],
            "reached": [(costs[path] <= optima[path] * (1 + 1e-6)).sum() for path in PATHS],
            "over": [costs[path] / optima[path] for path in PATHS],
            "rmse": {name: (rmse_k[path], rmse_e[path]) for path, name in names.items()},
            "of_paper": (costs["static"].mean() / 0.4935, costs["norm"].mean() / 0.003075),
            "deficient": found["norm"][0].rank < _TURNED_PARAMETERS,
            "short": np.median(costs["norm"] / optima["norm"]),
            "stops_short": np.median(costs["norm"] / optima["norm"]) > 1.01,
            "full": found["vector"][0].rank == _TURNED_PARAMETERS,
            "runs": len(found["static"]),
        },
        tables=(CsvTable("runs", columns, rows),),
        draw=figures.bars(("K, ppm", "E, µrad"), bars, "RMSE", log=True),
    )


def figure(context: StudyContext, *, path: str) -> Findings:
    """Show the fitness of three runs over the generations."""
    runs = [run.compared for run in runs_of(context)[path]]
    reached = sum(run.found.cost <= run.optimum * (1 + 1e-6) for run in runs)
    shown = fitness(runs[:3], "fitness 1 / L")
    return replace(shown, values={**shown.values, "reached": reached, "runs": len(runs), "mostly": 2 * reached > len(runs)})
