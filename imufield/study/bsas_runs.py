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
from imufield.calibrate.solvers.base import Solver
from imufield.calibrate.solvers.beetles import BasSettings, BsasSettings, solve_bas, solve_bsas
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.staged import PAPER_CATEGORIES, solve_stages
from imufield.errors import counted
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.bsas_bound import TURN_SIGMA_RAD, bound
from imufield.study.bsas_stages import CATEGORY_OFF, SETTING, stage_problem
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
from imufield.study.report import Comparison, CsvTable, StudyReport

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
        preset = BSAS_TRUTH.copy()
        preset[list(members)] += CATEGORY_OFF[k] * rng.uniform(-1, 1, len(members))
        for row, solver in enumerate(solvers):
            found = solve_stages(stage_problem(preset, raw), (members,), rng=rng, solver=solver)[0]
            costs[row, k] = found.cost
            vectors[row, list(members)] += found.x[list(members)] + (preset - BSAS_TRUTH)[list(members)]
    truth_cost = float(stage_problem(BSAS_TRUTH, raw).cost(np.zeros((1, 15)))[0])
    return StagedRun(vector=vectors[0], costs=costs[0], bas_vector=vectors[1], bas_costs=costs[1], truth_cost=truth_cost)


@cache
def _categories(context: StudyContext, one_data_set: bool) -> list[StagedRun]:
    name = "bsas-table3 one" if one_data_set else "bsas-table3 fresh"
    return context.campaign(name, run_categories, [one_data_set] * context.runs(50, 3))


def _range(values: FloatArray) -> str:
    return f"{values.min():.3g} to {values.max():.3g} (median {np.median(values):.3g})"


_FIGURE_5_DIFFERENCES = (
    (
        "Where all runs share one data set they end at one cost, as in the paper; the level is that of "
        "the noise of that data set. With fresh noise the costs scatter by tens of per cent, so a range "
        "of 3 % as printed means one data set."
    ),
    (
        "The exact minimum over all parameters is lower than any of these: twelve free numbers fit part "
        "of the noise of 24 positions."
    ),
    "The paper's mean parameters (its Table 3) cost 1.04e-5 on noise-free data, 14 times the cost it prints for them.",
)


def figure_5(context: StudyContext) -> StudyReport:
    """Show final costs of the swarm."""
    one, fresh = _categories(context, True), _categories(context, False)
    whitened = _whitened(context)
    last = np.array([run.costs[3] for run in one])
    all_fresh = np.array([run.costs[3] for run in fresh])
    comparisons = (
        Comparison("final cost, 50 runs on one data set", "7.2e-7 to 7.4e-7", _range(last)),
        Comparison("final cost, fresh noise in every run", "not given", _range(all_fresh)),
        Comparison("the four categories, median", "7.3e-7 to 8.4e-7", ", ".join(f"{c:.3g}" for c in _medians(one))),
        Comparison(
            "cost of the true parameters, fresh noise", "not given", _range(np.array([run.truth_cost for run in fresh]))
        ),
        Comparison(
            "exact minimum over all parameters (linear programme)", "not given", _range(np.array([r.exact for r in whitened]))
        ),
    )
    return StudyReport(
        name="bsas-fig5",
        title="final cost of BSAS",
        setting=f"{SETTING} Each category starts off the truth, the other three hold it; {len(one)} runs.",
        comparisons=comparisons,
        differences=_FIGURE_5_DIFFERENCES,
        tables=(
            CsvTable(
                "costs",
                ("run", "one data set", "fresh noise"),
                tuple(zip(range(1, len(one) + 1), last, all_fresh, strict=True)),
            ),
        ),
        draw=figures.runs({"one data set": last, "fresh noise": all_fresh}, "final cost (m/s$^2$)"),
    )


def _medians(runs: list[StagedRun]) -> FloatArray:
    return np.asarray(np.median([run.costs for run in runs], axis=0))


def figure_6(context: StudyContext) -> StudyReport:
    """Show final costs of the single beetle."""
    runs = _categories(context, True)
    costs = np.array([run.bas_costs for run in runs])
    comparisons = (
        Comparison("final cost of BAS, 50 runs", "2e-2 to 3.5e-2", _range(costs.max(axis=1))),
        *(
            Comparison(f"final cost of the {name}", "not given", _range(costs[:, k]))
            for k, name in enumerate(("scale factors", "biases", "misalignments", "quadratic terms"))
        ),
    )
    return StudyReport(
        name="bsas-fig6",
        title="final cost of BAS",
        setting=f"{SETTING} One beetle, the same steps; the largest of the four categories counts; {len(runs)} runs.",
        comparisons=comparisons,
        differences=(
            (
                "The single beetle fails in the misalignments, here and in the paper; how far off it stops "
                "depends on the presets, which the paper does not print. Ours are off by 1e-5 rad in that "
                "category, and the beetle hardly improves on them."
            ),
            (
                "The paper contradicts itself here: the mean scale factors that its Table 3 gives for BAS, with "
                "all else at the truth, cost 0.6, twenty times what this figure shows."
            ),
        ),
        tables=(
            CsvTable(
                "costs", ("run", *(f"category {k + 1}" for k in range(4))), tuple((i + 1, *row) for i, row in enumerate(costs))
            ),
        ),
        draw=figures.runs({"BAS": costs.max(axis=1)}, "final cost (m/s$^2$)", log=True),
    )


def figure_7(context: StudyContext) -> StudyReport:
    """Show errors of the three scale factors over the runs."""
    runs = _categories(context, True)
    errors = np.array([run.vector[:3] - BSAS_TRUTH[:3] for run in runs])
    comparisons = tuple(
        Comparison(f"error of {BSAS_NAMES[k]}", f"RMSE {_PAPER_RMSE[k]:.3g}", f"RMSE {_rms(errors[:, k]):.3g}")
        for k in range(3)
    )
    return StudyReport(
        name="bsas-fig7",
        title="errors of the scale factors",
        setting=f"{SETTING} Others at the truth, one data set; {len(runs)} runs.",
        comparisons=comparisons,
        differences=(
            (
                "Our RMSE is smaller than the paper's: with the other twelve at the truth and this noise, scale "
                "is known to 1e-6 raw/(m/s^2). The paper's 2.5e-5 to 4.9e-5 with a standard deviation of 5e-9 is "
                "one constant offset in all runs: one data set, with presets that are not quite the truth."
            ),
        ),
        tables=(CsvTable("errors", ("run", *BSAS_NAMES[:3]), tuple((i + 1, *row) for i, row in enumerate(errors))),),
        draw=figures.runs({BSAS_NAMES[k]: errors[:, k] for k in range(3)}, "error (raw per m/s$^2$)"),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


_TABLE_3_DIFFERENCES = (
    (
        "Scale, bias and quadratic term are found better than in the paper, with a scatter on one data "
        "set (SD) far below the error (RMSE), as there: what all runs on one data set share is the error "
        "of that data set."
    ),
    (
        "The six misalignments are observable as three sums only. The paper shows it without saying so: "
        "its errors of S_axz and S_ayz are equal and opposite, and so are those of S_axy and S_azy. Ours "
        "pair up in the same way, and their size says only how far the swarm wandered."
    ),
    "Gauge-free figures against the Cramer-Rao bound, with all 15 parameters starting off, are in bsas-whitened.",
)


def table_3(context: StudyContext) -> StudyReport:
    """Compare the 15 parameters of 50 runs."""
    one, fresh = _categories(context, True), _categories(context, False)
    errors = {name: np.array([r.vector for r in runs]) - BSAS_TRUTH for name, runs in (("one", one), ("fresh", fresh))}
    bas = np.array([run.bas_vector for run in one]) - BSAS_TRUTH
    rows, comparisons = [], []
    for k, name in enumerate(BSAS_NAMES):
        rmse, sd = _rms(errors["one"][:, k]), float(errors["one"][:, k].std())
        paper = f"RMSE {_PAPER_RMSE[k]:.2e}, SD {_PAPER_SD[k]:.2e}"
        ours = f"RMSE {rmse:.2e}, SD {sd:.2e}; fresh noise {_rms(errors['fresh'][:, k]):.2e}; BAS {_rms(bas[:, k]):.2e}"
        comparisons.append(Comparison(name, f"{paper}; BAS {_PAPER_BAS_RMSE[k] or '-'}", ours))
        mean = BSAS_TRUTH[k] + errors["one"][:, k].mean()
        rows.append(
            (name, BSAS_TRUTH[k], _PAPER_RMSE[k], _PAPER_SD[k], mean, rmse, sd, _rms(errors["fresh"][:, k]), _rms(bas[:, k]))
        )
    columns = ("parameter", "truth", "paper RMSE", "paper SD", "mean", "RMSE", "SD", "RMSE fresh noise", "RMSE BAS")
    return StudyReport(
        name="bsas-table3",
        title=f"15 parameters of {counted(len(one), 'run')}",
        setting=f"{SETTING} Each category with the others at the truth (the only setting in which the paper's costs are "
        f"reached), {counted(len(one), 'run')} on one data set, and {len(fresh)} with fresh noise. BAS is the same search with "
        "one beetle in place of a swarm.",
        comparisons=tuple(comparisons),
        differences=_TABLE_3_DIFFERENCES,
        tables=(CsvTable("parameters", columns, tuple(rows)),),
        draw=figures.bars(
            BSAS_NAMES, {"paper": np.array(_PAPER_RMSE), "ours": np.array([row[5] for row in rows])}, "RMSE", log=True
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class WhitenedRun:
    """All parameters at once, from presets as they are in the field."""

    cost: float
    exact: float
    converged: bool
    evaluations: int
    bas_cost: float
    errors: FloatArray
    """Gauge-free errors of bsas, least squares and the exact minimum, shape (3, 12)."""


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
    return WhitenedRun(
        cost=swarm.cost,
        exact=exact,
        converged=swarm.converged,
        evaluations=swarm.evaluations,
        bas_cost=single.cost,
        errors=errors,
    )


@cache
def _whitened(context: StudyContext) -> list[WhitenedRun]:
    return context.campaign("bsas-whitened", run_whitened, range(context.runs(200, 4)))


_WHITENED_DIFFERENCES = (
    (
        "An absolute cost is less efficient than squares for normal noise (by up to a quarter in RMSE), "
        "and with the six faces seen twice its minimum is not unique: bsas ends somewhere in the flat "
        "part, the linear programme at one of its corners, which is worse."
    ),
    (
        "On body axes, as printed, a turn of the frame is not exactly invisible: the preset's frame, off "
        "by up to 100 urad, leaks into bias and quadratic term of y and z by up to 0.7 of the bound. No "
        "method can tell that from noise, so where the frame is known only as well as the preset says, "
        "the bound itself is higher (second figure in each row, Bayesian, turns of 41 urad RMS)."
    ),
    "On sensing axes, our default, there is no such leak; bsas-bound has least squares over more data sets.",
)


def whitened(context: StudyContext) -> StudyReport:
    """Hold BSAS in whitened coordinates against exact minimum and Cramér-Rao bound."""
    runs = _whitened(context)
    known, uncertain = bound(), bound(TURN_SIGMA_RAD)
    rmse = np.sqrt(np.mean([run.errors**2 for run in runs], axis=0)) / known
    rows = tuple((name, known[k], uncertain[k], *rmse[:, k]) for k, name in enumerate(INTRINSIC_NAMES))
    columns = ("number", "bound", "bound with frame as the preset", "bsas", "least squares", "exact minimum")
    return StudyReport(
        name="bsas-whitened",
        title="BSAS with all parameters at once, in whitened coordinates",
        setting="Instrument, noise and positions of Table 3, but all 15 parameters start off by up to 500 ppm of K, 1 mg, "
        f"100 urad and 100 % of K2; attenuation 0.965, at most 1200 iterations; {len(runs)} runs with fresh noise "
        "and presets.",
        comparisons=_compare_costs(runs) + _compare_with_bound(rmse, known / uncertain),
        differences=_WHITENED_DIFFERENCES,
        tables=(CsvTable("gauge-free", columns, rows),),
        draw=figures.bars(INTRINSIC_NAMES, {"bsas": rmse[0], "least squares": rmse[1]}, "RMSE over Cramér-Rao bound"),
    )


def _compare_costs(runs: list[WhitenedRun]) -> tuple[Comparison, ...]:
    ratio = np.array([run.cost / run.exact for run in runs])
    return (
        Comparison("cost over the exact minimum", "not given", f"median {np.median(ratio):.5f}, worst {ratio.max():.5f}"),
        Comparison("runs within 1.1 times", "not given", f"{int((ratio <= 1.1).sum())} of {len(runs)}"),
        Comparison("runs that converged", "not given", f"{sum(run.converged for run in runs)} of {len(runs)}"),
        Comparison("evaluations", "4 x 300 x 30", f"{np.mean([run.evaluations for run in runs]):.0f}"),
        Comparison(
            "BAS, cost over the exact minimum",
            "2.8e4 to 4.9e4",
            f"median {np.median([r.bas_cost / r.exact for r in runs]):.2g}",
        ),
    )


def _compare_with_bound(rmse: FloatArray, known_over_preset: FloatArray) -> tuple[Comparison, ...]:
    """Say for each gauge-free number the RMSE of three methods over the bound, shape (3, 12), in both frames.

    ``known_over_preset``, shape (12,): bound of a known frame over that of a frame known only as the preset says.
    """
    return tuple(
        Comparison(
            f"RMSE over the bound, frame known / as the preset: {name}",
            "not given",
            ", ".join(
                f"{label} {rmse[row, k]:.2f} / {rmse[row, k] * known_over_preset[k]:.2f}"
                for row, label in enumerate(("bsas", "least squares", "exact minimum"))
            ),
        )
        for k, name in enumerate(INTRINSIC_NAMES)
    )
