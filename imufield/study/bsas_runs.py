"""BSAS Figs. 5 to 7 and Table 3: fifty runs of the staged swarm, and two hundred of the whitened one.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 4.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from imufield.calibrate.accelerometer.whitening import whitened_problem
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.solvers.base import Solver, SolverResult
from imufield.calibrate.solvers.beetles import BasSettings, BsasSettings, solve_bas, solve_bsas
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.staged import PAPER_CATEGORIES, solve_stages
from imufield.samples import FloatArray
from imufield.sentences import counted
from imufield.study import figures
from imufield.study.bsas_bound import TURN_SIGMA_RAD, bound
from imufield.study.bsas_stages import CATEGORIES, CATEGORY_OFF, SETTING, stage_problem
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    BSAS_AXES,
    BSAS_GRAVITY_M_S2,
    BSAS_NAMES,
    BSAS_TRUTH,
    bsas_outputs,
    bsas_preset,
)
from imufield.study.optimum import INTRINSIC_NAMES, exact_absolute_minimum
from imufield.study.report import Comparison, CsvTable, StudyReport, make_report, numbered_table

# The paper's Table 3, in the order of BSAS_NAMES.
_PAPER_RMSE = (
    3.535e-5, 4.945e-5, 2.523e-5, 3.155e-8, 6.482e-7, 2.039e-7,
    6.973e-6, 4.350e-5, 6.945e-6, 3.499e-6, 4.350e-5, 3.442e-6, 1.107e-6, 6.373e-7, 8.715e-7,
)  # fmt: skip
_PAPER_SD = (
    4.717e-9, 8.574e-9, 1.709e-7, 2.329e-8, 2.013e-8, 1.550e-8,
    4.752e-6, 2.488e-5, 4.751e-6, 3.378e-6, 2.488e-5, 3.343e-6, 5.578e-9, 6.384e-8, 7.109e-9,
)  # fmt: skip
_PAPER_BAS_RMSE = (
    2.9442, 3.4575, 2.0935, 0.002, 0.00012, 0.0021, None, None, None, 5.285e-5, None, None, 0.0607, 0.0016, 0.0614,
)  # fmt: skip
_ONE_DATA_SET = 20200210  # Seed of the one data set that all of the paper's runs seem to share.


@dataclass(frozen=True, slots=True, kw_only=True)
class StagedRun:
    """Each category on its own, the others at the truth: the setting in which the paper's figures are reached."""

    vector: FloatArray
    """All 15, each from the stage of its category, shape (15,)."""
    costs: FloatArray
    """Final cost of each category, shape (4,)."""
    bas_vector: FloatArray
    bas_costs: FloatArray
    truth_cost: float


def run_categories(one_data_set: bool, rng: np.random.Generator) -> StagedRun:
    """Optimise each category with the others at the truth, by swarm and by single beetle."""
    raw = bsas_outputs(np.random.default_rng(_ONE_DATA_SET) if one_data_set else rng)
    vectors = np.tile(BSAS_TRUTH, (2, 1))
    costs = np.empty((2, 4))
    solvers: tuple[Solver, ...] = (partial(solve_bsas, settings=BsasSettings()), partial(solve_bas, settings=BasSettings()))
    for k, members in enumerate(PAPER_CATEGORIES):
        # Only the members of this category start off the truth: eq. 13 is minimised over them alone.
        preset = BSAS_TRUTH.copy()
        preset[list(members)] += CATEGORY_OFF[k] * rng.uniform(-1, 1, len(members))
        for row, solver in enumerate(solvers):
            found = solve_stages(stage_problem(preset, raw), (members,), rng=rng, solver=solver)[0]
            costs[row, k] = found.cost
            # Truth plus what is left of the error: x is counted from the preset.
            vectors[row, list(members)] += found.x[list(members)] + (preset - BSAS_TRUTH)[list(members)]
    truth_cost = float(stage_problem(BSAS_TRUTH, raw).cost(np.zeros((1, 15)))[0])
    return StagedRun(vector=vectors[0], costs=costs[0], bas_vector=vectors[1], bas_costs=costs[1], truth_cost=truth_cost)


@cache
def _categories(context: StudyContext, one_data_set: bool) -> list[StagedRun]:
    name = "bsas-table3 one" if one_data_set else "bsas-table3 fresh"
    return context.campaign(name, run_categories, [one_data_set] * context.runs(50, 3))


def _range(values: FloatArray) -> str:
    return f"{values.min():.3g} to {values.max():.3g} (median {np.median(values):.3g})"


def figure_5(context: StudyContext) -> StudyReport:
    """Show final costs of the swarm."""
    one, fresh = _categories(context, True), _categories(context, False)
    # The quadratic terms are the last of the four categories: their cost is the final one.
    last, all_fresh = (np.array([run.costs[3] for run in runs]) for runs in (one, fresh))
    truth = np.array([run.truth_cost for run in fresh])
    exact = np.array([run.exact for run in _whitened(context)])
    medians = ", ".join(f"{cost:.3g}" for cost in np.median([run.costs for run in one], axis=0))
    comparisons = (
        Comparison("final cost, 50 runs on one data set", "7.2e-7 to 7.4e-7", _range(last)),
        Comparison("final cost, fresh noise in every run", "not given", _range(all_fresh)),
        Comparison("the four categories, median", "7.3e-7 to 8.4e-7", medians),
        Comparison("cost of the true parameters, fresh noise", "not given", _range(truth)),
        Comparison("exact minimum over all parameters (linear programme)", "not given", _range(exact)),
    )
    rows = zip(last, all_fresh, strict=True)
    return make_report(
        "bsas-fig5",
        comparisons,
        tables=(numbered_table("costs", ("run", "one data set", "fresh noise"), rows),),
        draw=figures.runs({"one data set": last, "fresh noise": all_fresh}, "final cost (m/s$^2$)"),
        instrument=SETTING,
        runs=len(one),
    )


def figure_6(context: StudyContext) -> StudyReport:
    """Show final costs of the single beetle."""
    runs = _categories(context, True)
    costs = np.array([run.bas_costs for run in runs])
    comparisons = (
        Comparison("final cost of BAS, 50 runs", "2e-2 to 3.5e-2", _range(costs.max(axis=1))),
        *(Comparison(f"final cost of the {name}", "not given", _range(costs[:, k])) for k, name in enumerate(CATEGORIES)),
    )
    return make_report(
        "bsas-fig6",
        comparisons,
        tables=(numbered_table("costs", ("run", *(f"category {k + 1}" for k in range(4))), costs),),
        draw=figures.runs({"BAS": costs.max(axis=1)}, "final cost (m/s$^2$)", log=True),
        instrument=SETTING,
        runs=len(runs),
    )


def figure_7(context: StudyContext) -> StudyReport:
    """Show errors of the three scale factors over the runs."""
    runs = _categories(context, True)
    errors = np.array([run.vector[:3] - BSAS_TRUTH[:3] for run in runs])
    comparisons = tuple(
        Comparison(f"error of {BSAS_NAMES[k]}", f"RMSE {_PAPER_RMSE[k]:.3g}", f"RMSE {_rms(errors[:, k]):.3g}")
        for k in range(3)
    )
    return make_report(
        "bsas-fig7",
        comparisons,
        tables=(numbered_table("errors", ("run", *BSAS_NAMES[:3]), errors),),
        draw=figures.runs({BSAS_NAMES[k]: errors[:, k] for k in range(3)}, "error (raw per m/s$^2$)"),
        instrument=SETTING,
        runs=len(runs),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table_3(context: StudyContext) -> StudyReport:
    """Compare the 15 parameters of 50 runs."""
    one, fresh = _categories(context, True), _categories(context, False)
    errors = np.array([run.vector for run in one]) - BSAS_TRUTH
    bas_errors = np.array([run.bas_vector for run in one]) - BSAS_TRUTH
    fresh_errors = np.array([run.vector for run in fresh]) - BSAS_TRUTH
    rows, comparisons = [], []
    for k, name in enumerate(BSAS_NAMES):
        rmse, fresh_rmse, bas_rmse = (_rms(values[:, k]) for values in (errors, fresh_errors, bas_errors))
        sd, mean = float(errors[:, k].std()), BSAS_TRUTH[k] + errors[:, k].mean()
        paper = f"RMSE {_PAPER_RMSE[k]:.2e}, SD {_PAPER_SD[k]:.2e}; BAS {_PAPER_BAS_RMSE[k] or '-'}"
        ours = f"RMSE {rmse:.2e}, SD {sd:.2e}; fresh noise {fresh_rmse:.2e}; BAS {bas_rmse:.2e}"
        comparisons.append(Comparison(name, paper, ours))
        rows.append((name, BSAS_TRUTH[k], _PAPER_RMSE[k], _PAPER_SD[k], mean, rmse, sd, fresh_rmse, bas_rmse))
    ours_rmse = np.array([row[5] for row in rows])
    columns = ("parameter", "truth", "paper RMSE", "paper SD", "mean", "RMSE", "SD", "RMSE fresh noise", "RMSE BAS")
    return make_report(
        "bsas-table3",
        comparisons,
        tables=(CsvTable("parameters", columns, tuple(rows)),),
        draw=figures.bars(BSAS_NAMES, {"paper": np.array(_PAPER_RMSE), "ours": ours_rmse}, "RMSE", log=True),
        runs=counted(len(one), "run"),
        instrument=SETTING,
        fresh=len(fresh),
    )


_METHODS = ("bsas", "least squares", "exact minimum")


@dataclass(frozen=True, slots=True, kw_only=True)
class WhitenedRun:
    """All parameters at once, from presets as they are in the field."""

    swarm: SolverResult
    """What bsas ended with."""
    exact: float
    """The exact minimum of its cost."""
    bas_cost: float
    errors: FloatArray
    """Gauge-free errors of the three ``_METHODS``, shape (3, 12)."""


def run_whitened(_number: int, rng: np.random.Generator) -> WhitenedRun:
    """Solve one data set by bsas, bas, least squares and the linear programme."""
    raw, preset = bsas_outputs(rng), bsas_preset(rng)
    problem = whitened_problem(preset, raw, BSAS_GRAVITY_M_S2, quadratic_axes=BSAS_AXES)
    swarm = solve_bsas(problem, rng=rng)
    single = solve_bas(problem, rng=rng)
    exact, z = exact_absolute_minimum(problem)
    truth = intrinsic(BSAS_TRUTH, BSAS_AXES)[0]
    found = (swarm.x, solve_least_squares(problem).x, z)
    errors = np.array([intrinsic(problem.vector(x), BSAS_AXES)[0] - truth for x in found])
    return WhitenedRun(swarm=swarm, exact=exact, bas_cost=single.cost, errors=errors)


@cache
def _whitened(context: StudyContext) -> list[WhitenedRun]:
    return context.campaign("bsas-whitened", run_whitened, range(context.runs(200, 4)))


def whitened(context: StudyContext) -> StudyReport:
    """Hold BSAS in whitened coordinates against exact minimum and Cramér-Rao bound."""
    runs = _whitened(context)
    known, uncertain = bound(), bound(TURN_SIGMA_RAD)
    ratio = np.array([run.swarm.cost / run.exact for run in runs])
    single = np.median([run.bas_cost / run.exact for run in runs])
    evaluations = np.mean([run.swarm.evaluations for run in runs])
    comparisons = [
        Comparison("cost over the exact minimum", "not given", f"median {np.median(ratio):.5f}, worst {ratio.max():.5f}"),
        Comparison("runs within 1.1 times", "not given", f"{(ratio <= 1.1).sum()} of {len(runs)}"),
        Comparison("runs that converged", "not given", f"{sum(run.swarm.converged for run in runs)} of {len(runs)}"),
        Comparison("evaluations", "4 x 300 x 30", f"{evaluations:.0f}"),
        Comparison("BAS, cost over the exact minimum", "2.8e4 to 4.9e4", f"median {single:.2g}"),
    ]
    # RMSE of the three methods over the bound of a known frame, and over that of a frame known only as the preset says.
    rmse = np.sqrt(np.mean([run.errors**2 for run in runs], axis=0)) / known
    in_preset_frame = rmse * (known / uncertain)
    for k, name in enumerate(INTRINSIC_NAMES):
        ours = ", ".join(f"{method} {rmse[i, k]:.2f} / {in_preset_frame[i, k]:.2f}" for i, method in enumerate(_METHODS))
        comparisons.append(Comparison(f"RMSE over the bound, frame known / as the preset: {name}", "not given", ours))
    rows = tuple((name, known[k], uncertain[k], *rmse[:, k]) for k, name in enumerate(INTRINSIC_NAMES))
    columns = ("number", "bound", "bound with frame as the preset", *_METHODS)
    return make_report(
        "bsas-whitened",
        comparisons,
        tables=(CsvTable("gauge-free", columns, rows),),
        draw=figures.bars(INTRINSIC_NAMES, {"bsas": rmse[0], "least squares": rmse[1]}, "RMSE over Cramér-Rao bound"),
        runs=len(runs),
    )
