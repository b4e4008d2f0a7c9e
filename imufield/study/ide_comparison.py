"""IDE Table 5 and Fig. 10: genetic algorithm, particle swarm and IDE, and navigation with the parameters of each.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 4.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from imufield.calibrate.model.models import unit_diagonal_matrices
from imufield.calibrate.solvers.base import Solver
from imufield.calibrate.solvers.registry import load_solver
from imufield.calibrate.solvers.triad_costs import TriadProblem, TurnsProblem
from imufield.dataclass import dataclass, replace
from imufield.deliver.navigation.drift import Drift
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.ide_gyroscope import make_problem
from imufield.study.instruments import (
    BEIJING_LATITUDE_DEG,
    GYROSCOPE_TRUTH,
    IDE_GRAVITY_M_S2,
    IDE_TRUTH,
    gyroscope_static_problem,
    ide_problem,
    per_deg_h,
    triad_outputs,
)
from imufield.study.navigation import minute_curves, navigate_at_rest, rest_inputs
from imufield.study.optimum import ComparedRun, compare
from imufield.study.report import CsvTable, Findings

METHODS = ("ga", "pso", "ide")
COSTS = ("accelerometer", "norm", "vector")
SUCCESS = 1.1
"""A run counts as a success within this many times the global optimum; the paper does not define its success."""
_NAMES = {"accelerometer": "accelerometer, L_a", "norm": "gyroscope, L_gm as printed", "vector": "gyroscope, vector form"}
_PAPER_SUCCESS = (0.7333, 0.8667)  # Of GA and PSO on the accelerometer.
_FLOWN = (*METHODS, "ide, vector form")
_QUICK_GENERATIONS = 15  # Of GA and PSO in a quick study: enough to see that they work.


@dataclass(frozen=True, slots=True)
class MethodJob:
    """A method on a cost; the library's methods are slow, so a quick study gives them fewer generations."""

    method: str
    cost_name: str
    quick: bool

    def solver(self) -> Solver:
        """Return the solver behind the method."""
        name = self.method.partition(",")[0]
        shortened = self.quick and name in ("ga", "pso")
        return load_solver(name, {"generations": str(_QUICK_GENERATIONS)} if shortened else None)


def run_method(job: MethodJob, rng: np.random.Generator) -> ComparedRun:
    """Draw a data set and solve it."""
    cost_name = job.cost_name
    problem: TriadProblem | TurnsProblem = ide_problem(rng) if cost_name == "accelerometer" else make_problem(cost_name, rng)
    return compare(job.solver(), problem, rng)


@cache
def _runs(context: StudyContext) -> dict[tuple[str, str], list[ComparedRun]]:
    jobs = [MethodJob(method, cost, context.quick) for cost in COSTS for method in METHODS]
    found = context.campaign_of_each("ide-table5", run_method, jobs, context.runs(30, 2))
    return {(job.method, job.cost_name): runs for job, runs in zip(jobs, found, strict=True)}


def table_5(context: StudyContext) -> Findings:
    """Compare success rate, mean and standard deviation of GA, PSO and IDE."""
    rows = {}
    for (method, cost), runs in _runs(context).items():
        values = np.array([run.found.cost for run in runs])
        success = np.mean([run.found.cost <= SUCCESS * run.optimum for run in runs])
        # Within 1e-6 of the optimum: far below what noise or another data set would change.
        at_optimum = sum(run.found.cost <= run.optimum * (1 + 1e-6) for run in runs)
        ratio = float(np.median([run.found.cost / run.optimum for run in runs]))
        name = f"{_NAMES[cost]}, {method.upper()}"
        rows[name] = (cost, method, success, values.mean(), values.std(ddof=1), ratio, at_optimum)
    columns = ("cost", "method", "success rate", "mean", "SD", "median over optimum", "at the optimum")
    of = {(row[0], row[1]): row for row in rows.values()}
    reached = ", ".join(f"{method.upper()} in {of['vector', method][6]}" for method in METHODS)
    swarms = tuple(of["accelerometer", method][2] for method in ("ga", "pso"))
    return Findings(
        values={
            "methods": rows,
            "runs": len(_runs(context)["ide", "norm"]),
            "success": SUCCESS,
            "swarms": swarms,
            "better": all(share > paper for share, paper in zip(swarms, _PAPER_SUCCESS, strict=True)),
            "short": of["norm", "ide"][5],
            "stops_short": of["norm", "ide"][5] > max(SUCCESS, of["norm", "ga"][5], of["norm", "pso"][5]),
            "reached": reached,
        },
        tables=(CsvTable("methods", columns, tuple(rows.values())),),
        draw=figures.bars(
            [f"{_NAMES[cost].split(',')[0]} {cost} {method.upper()}" for method, cost in _runs(context)],
            {"median cost over the optimum": np.array([row[5] for row in rows.values()])},
            "cost / optimum",
            log=True,
        ),
    )


def run_flight(job: MethodJob, rng: np.random.Generator) -> Drift:
    """Calibrate both triads by one method and navigate at rest with the result, the attitude given as in the paper.

    The method "ide, vector form" is IDE with the vector form in place of eq. 26.
    """
    solver = job.solver()
    accelerometer = _in_frame(solver(ide_problem(rng), rng=rng).x)
    turns = solver(make_problem(job.cost_name, rng), rng=rng).x
    gyroscope = np.concatenate([turns, _static_bias(turns, rng)])
    force, rate = rest_inputs(BEIJING_LATITUDE_DEG)
    # The Earth model of the mechanisation and the gravity of the calibration must be the same.
    force = force * IDE_GRAVITY_M_S2 / np.linalg.norm(force)
    shown_force = _inputs(accelerometer, triad_outputs(IDE_TRUTH, force[None]))
    shown_rate = np.radians(_inputs(gyroscope, triad_outputs(GYROSCOPE_TRUTH, np.degrees(rate)[None])))
    return navigate_at_rest(shown_force, shown_rate, BEIJING_LATITUDE_DEG, rng=rng, attitude_rph_deg=np.zeros(3))


def _static_bias(turns: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the bias with K and E fixed, from the static cost of eq. 7 (section 3.3, last paragraph)."""
    problem = gyroscope_static_problem(rng)
    fixed = per_deg_h(turns)
    # Bounds this narrow fix an entry; equal ones would leave the solver nothing to draw from.
    narrow = 1e-12 * np.maximum(np.abs(fixed), 1e-6)
    lower = np.concatenate([fixed - narrow, problem.lower[9:]])
    upper = np.concatenate([fixed + narrow, problem.upper[9:]])
    return load_solver("ide")(replace(problem, lower=lower, upper=upper), rng=rng).x[9:]


def _in_frame(x: FloatArray) -> FloatArray:
    """Return parameters of the same instrument in the frame nearest to the truth's: the frame is not the method's to find."""
    unit = unit_diagonal_matrices(x[None, 3:9])[0]
    target = unit_diagonal_matrices(IDE_TRUTH[None, 3:9])[0]
    left, _, right = np.linalg.svd(target.T @ unit)
    # The rotation R that minimises |unit R^T - target| (orthogonal Procrustes problem, solved by the SVD).
    turned = unit @ (left @ right).T
    diagonal = np.diag(turned)
    # Back to a unit diagonal: what the turn moved into it belongs to the scale factors.
    entries = (turned / diagonal[:, None])[(0, 0, 1, 1, 2, 2), (1, 2, 0, 2, 0, 1)]
    return np.concatenate([x[:3] * diagonal, entries, x[9:]])


def _inputs(x: FloatArray, raw: FloatArray) -> FloatArray:
    # Gravity and bounds play no part in the inverse of the model.
    problem = TriadProblem(raw, 1.0, x, x)
    return np.asarray(problem.inputs(x[None])[0, :, 0])


@cache
def _flights(context: StudyContext) -> dict[str, list[Drift]]:
    jobs = [MethodJob(method, "vector" if "vector" in method else "norm", context.quick) for method in _FLOWN]
    return dict(zip(_FLOWN, context.campaign_of_each("ide-fig10", run_flight, jobs, context.runs(10, 1)), strict=True))


def figure_10(context: StudyContext) -> Findings:
    """Show velocity and position errors of five hours at rest by method."""
    flights = _flights(context)
    largest = {
        method: np.transpose(
            [
                [np.abs(curve).max() for curve in (run.north_velocity_m_s, run.east_velocity_m_s, run.position_nmi)]
                for run in runs
            ]
        )
        for method, runs in flights.items()
    }
    first = {method: runs[0] for method, runs in flights.items()}
    quantities = {
        "east velocity error, m/s": "east_velocity_m_s",
        "north velocity error, m/s": "north_velocity_m_s",
        "latitude error, deg": "latitude_deg",
        "longitude error, deg": "longitude_deg",
    }
    panels = {label: {m: (run.hours, getattr(run, name)) for m, run in first.items()} for label, name in quantities.items()}
    drift = {method: float(np.median(of_method[2])) for method, of_method in largest.items()}
    smallest = min(METHODS, key=lambda method: drift[method])
    vector = drift["ide, vector form"]
    return Findings(
        values={
            "methods": largest,
            "runs": len(flights["ide"]),
            "smallest": smallest,
            "as_paper": smallest == "ide",
            "not_as_paper": smallest != "ide",
            "vector": vector / drift["ide"],
            "removed": vector < drift["ide"] / 2,
        },
        tables=(minute_curves(first, tuple(quantities.values())),),
        draw=figures.over_time(panels),
    )
