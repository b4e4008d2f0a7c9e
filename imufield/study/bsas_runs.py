"""BSAS Figs. 5 to 7 and Table 3: fifty runs of the staged swarm, and two hundred of the whitened one.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 4.2.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.uncertainty import rms
from imufield.calibrate.solvers.base import Solver, SolverResult
from imufield.calibrate.solvers.beetles import BasSettings, BsasSettings, solve_bas, solve_bsas
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.staged import PAPER_CATEGORIES, solve_stages
from imufield.dataclass import dataclass
from imufield.samples import FloatArray
from imufield.sentences import counted
from imufield.study import figures
from imufield.study.bsas_bound import TURN_SIGMA_RAD, bound
from imufield.study.bsas_stages import CATEGORIES, CATEGORY_OFF, stage_problem
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
from imufield.study.report import CsvTable, Findings, keyed_table, numbered_table, texts

_ONE_DATA_SET = 20200210  # Seed of the one data set that all of the paper's runs seem to share.


@dataclass(frozen=True, slots=True, kw_only=True)
class StagedRun:
    """Each category on its own, the others at the truth: the setting in which the paper's figures are reached."""

    vectors: FloatArray
    """All 15, each from the stage of its category, by swarm and by single beetle, shape (2, 15)."""
    costs: FloatArray
    """Final cost of each category, shape (2, 4)."""
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
    return StagedRun(vectors=vectors, costs=costs, truth_cost=truth_cost)


@cache
def _categories(context: StudyContext, one_data_set: bool) -> list[StagedRun]:
    name = "bsas-table3 one" if one_data_set else "bsas-table3 fresh"
    return context.campaign(name, run_categories, [one_data_set] * context.runs(50, 2))


def figure_5(context: StudyContext) -> Findings:
    """Show final costs of the swarm."""
    shared, fresh = _categories(context, True), _categories(context, False)
    # The quadratic terms are the last of the four categories: their cost is the final one.
    last, all_fresh = (np.array([run.costs[0, 3] for run in runs]) for runs in (shared, fresh))
    exact = np.array([run.exact for run in _whitened(context)])
    return Findings(
        values={
            "one": last,
            "fresh": all_fresh,
            "fresh_spread": all_fresh.max() / all_fresh.min() - 1,
            "one_spread": last.max() / last.min() - 1,
            "categories": np.median([run.costs[0] for run in shared], axis=0),
            "truth": np.array([run.truth_cost for run in fresh]),
            "exact": exact,
            "exact_lowest": np.median(exact) < min(np.median(last), np.median(all_fresh)),
            "one_cost": last.max() / last.min() < all_fresh.max() / all_fresh.min(),
            "printed": _printed_cost("mean"),
            "runs": len(shared),
        },
        tables=(numbered_table("costs", ("run", "one data set", "fresh noise"), zip(last, all_fresh, strict=True)),),
        draw=figures.runs({"one data set": last, "fresh noise": all_fresh}, "final cost, m/s²"),
    )


def figure_6(context: StudyContext) -> Findings:
    """Show final costs of the single beetle."""
    runs = _categories(context, True)
    costs = np.array([run.costs[1] for run in runs])
    final = costs.max(axis=1)
    worst = np.bincount(costs.argmax(axis=1), minlength=4)
    return Findings(
        values={
            "final": final,
            "categories": dict(zip(CATEGORIES, costs.T, strict=True)),
            "worst": ", ".join(f"{name} {times}" for name, times in zip(CATEGORIES, worst, strict=True)),
            "highest": CATEGORIES[int(np.argmax(costs.max(axis=0)))],
            "highest_median": CATEGORIES[int(np.argmax(np.median(costs, axis=0)))],
            "printed": _printed_cost("bas_scale"),
            "runs": len(runs),
        },
        tables=(numbered_table("costs", ("run", *(f"category {k + 1}" for k in range(4))), costs),),
        draw=figures.runs({"BAS": final}, "final cost, m/s²", log=True),
    )


def _printed_cost(which: str) -> float:
    """Return the cost of parameters that the paper prints, the others at the truth, on outputs without noise."""
    printed = np.array(texts()["bsas-table3"]["paper"][which])
    vector = np.concatenate([printed, BSAS_TRUTH[len(printed) :]])
    clean = bsas_outputs(np.random.default_rng(0), 0.0)
    return float(stage_problem(vector, clean).cost(np.zeros((1, 15)))[0])


def figure_7(context: StudyContext) -> Findings:
    """Show errors of the three scale factors over the runs."""
    runs = _categories(context, True)
    errors = np.array([run.vectors[0, :3] - BSAS_TRUTH[:3] for run in runs])
    of_scale: dict[str, FloatArray] = dict(zip(BSAS_NAMES[:3], errors.T, strict=True))
    ours = np.sqrt(np.mean(errors**2, axis=0))
    smaller = np.all(ours < np.array(texts()["bsas-fig7"]["paper"]["errors"]))
    return Findings(
        values={"errors": of_scale, "runs": len(runs), "ours": ours, "smaller": smaller},
        tables=(numbered_table("errors", ("run", *of_scale), errors),),
        draw=figures.runs(of_scale, "error, raw per m/s²"),
    )


def table_3(context: StudyContext) -> Findings:
    """Compare the 15 parameters of 50 runs."""
    shared, fresh = _categories(context, True), _categories(context, False)
    errors = np.array([run.vectors[0] for run in shared]) - BSAS_TRUTH
    bas_errors = np.array([run.vectors[1] for run in shared]) - BSAS_TRUTH
    fresh_errors = np.array([run.vectors[0] for run in fresh]) - BSAS_TRUTH
    paper = texts()["bsas-table3"]["paper"]
    parameters = {
        name: {
            "truth": BSAS_TRUTH[k],
            "paper RMSE": paper["rmse"][k],
            "paper SD": paper["sd"][k],
            "mean": BSAS_TRUTH[k] + errors[:, k].mean(),
            "RMSE": rms(errors[:, k]),
            "SD": float(errors[:, k].std()),
            "RMSE fresh noise": rms(fresh_errors[:, k]),
            "RMSE BAS": rms(bas_errors[:, k]),
        }
        for k, name in enumerate(BSAS_NAMES)
    }
    ours = np.array([row["RMSE"] for row in parameters.values()])
    # Without the misalignments, of which half are turns of the frame.
    seen = [row for name, row in parameters.items() if not name.startswith("S_")]
    pairs = [np.corrcoef(errors[:, 6 + i], errors[:, 6 + j])[0, 1] for i, j in _PAIRS]
    return Findings(
        values={
            "parameters": parameters,
            "runs": counted(len(shared), "run"),
            "fresh": len(fresh),
            "better": sum(row["RMSE"] < row["paper RMSE"] for row in seen),
            "narrow": sum(row["SD"] < row["RMSE"] / 2 for row in seen),
            "narrow_paper": sum(row["paper SD"] < row["paper RMSE"] / 2 for row in seen),
            "seen": len(seen),
            "pairs": np.array(pairs),
            "paired": max(pairs) < -_PAIRED,
        },
        tables=(keyed_table("parameters", "parameter", parameters),),
        draw=figures.bars(BSAS_NAMES, {"paper": np.array(paper["rmse"]), "ours": ours}, "RMSE", log=True),
    )


_PAIRS = ((0, 2), (1, 4), (3, 5))  # Misalignments of which only the sum is seen: xy and yx, xz and zx, yz and zy.
_PAIRED = 0.9
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
    return context.campaign("bsas-whitened", run_whitened, range(context.runs(200, 2)))


def whitened(context: StudyContext) -> Findings:
    """Hold BSAS in whitened coordinates against exact minimum and Cramér-Rao bound."""
    runs = _whitened(context)
    known, uncertain = bound(), bound(TURN_SIGMA_RAD)
    ratio = np.array([run.swarm.cost / run.exact for run in runs])
    # RMSE of the three methods over the bound of a known frame, and over that of a frame known only as the preset says.
    rmse = np.sqrt(np.mean([run.errors**2 for run in runs], axis=0)) / known
    both = np.vstack([rmse, rmse * (known / uncertain)])
    columns = ("number", "bound", "bound with frame as the preset", *_METHODS)
    rows = tuple(zip(INTRINSIC_NAMES, known, uncertain, *rmse, strict=True))
    return Findings(
        values={
            "ratio": ratio,
            "within": (ratio <= 1.1).sum(),
            "converged": sum(run.swarm.converged for run in runs),
            "evaluations": [run.swarm.evaluations for run in runs],
            "single": [run.bas_cost / run.exact for run in runs],
            "rmse": dict(zip(INTRINSIC_NAMES, both.T, strict=True)),
            "over_squares": rmse[0] / rmse[1] - 1,
            "less_efficient": np.mean(rmse[0]) > np.mean(rmse[1]),
            "corner_worse": np.mean(rmse[2]) > np.mean(rmse[0]),
            "leak": np.sqrt(np.maximum((uncertain / known) ** 2 - 1, 0.0)),
            "runs": len(runs),
        },
        tables=(CsvTable("gauge-free", columns, rows),),
        draw=figures.bars(INTRINSIC_NAMES, {"bsas": rmse[0], "least squares": rmse[1]}, "RMSE over Cramér-Rao bound"),
    )
