"""IDE Figs. 2 to 5 and Table 2: the accelerometer by four strategies of differential evolution.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from imufield.calibrate.solvers.registry import load_solver
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import IDE_NOISE_M_S2, ide_problem
from imufield.study.optimum import squares_optimum
from imufield.study.report import Comparison, CsvTable, StudyReport, curves_table, make_report

SETTING = (
    f"Accelerometer of IDE Table 1, simulated: 24 positions, bounds of Table 1, noise of {IDE_NOISE_M_S2:g} m/s^2 "
    "per axis and position; NP 60, EG 1200, F 1.2, CR 0.6; for IDE F_max 1.2, F_min 0.35."
)
STRATEGIES = ("de-rand-1", "de-current-to-best-1", "de-combined", "ide")
# Table 2 of [1]_: mean and standard deviation of L_a; it has no row for current-to-best/1.
_PAPER = {"de-rand-1": (0.045558, 0.015841), "de-combined": (0.008171, 6.1852e-4), "ide": (0.004854, 8.5377e-4)}


@dataclass(frozen=True, slots=True)
class Evolution:
    """One run of one strategy."""

    cost: float
    optimum: float
    converged: bool
    history: FloatArray
    """Best cost after each generation."""


def run_strategy(name: str, rng: np.random.Generator) -> Evolution:
    """Draw a data set and solve it with one strategy."""
    # Fresh noise in every run; the optimum of the same data is what the strategy is compared with.
    problem = ide_problem(rng)
    optimum, _ = squares_optimum(problem)
    found = load_solver(name)(problem, rng=rng)
    return Evolution(found.cost, optimum, found.converged, found.history)


@cache
def _evolutions(context: StudyContext) -> dict[str, list[Evolution]]:
    found = context.campaign_of_each("ide-table2", run_strategy, STRATEGIES, context.runs(30, 3))
    return dict(zip(STRATEGIES, found, strict=True))


def table_2(context: StudyContext) -> StudyReport:
    """Compare L_a of the strategies."""
    found = _evolutions(context)
    costs = {name: np.array([run.cost for run in runs]) for name, runs in found.items()}
    optima = {name: np.array([run.optimum for run in runs]) for name, runs in found.items()}
    ratios = {name: costs[name] / optima[name] for name in found}
    excess = ratios["ide"] - 1
    converged = ", ".join(f"{name} {sum(run.converged for run in runs)}" for name, runs in found.items())
    comparisons = [
        Comparison(
            f"L_a of {name}, mean (SD)",
            f"{_PAPER[name][0]:.6f} ({_PAPER[name][1]:.1e})" if name in _PAPER else "not given",
            f"{values.mean():.6f} ({values.std(ddof=1):.1e})",
        )
        for name, values in costs.items()
    ]
    comparisons += [
        Comparison("global optimum of the data of ide, mean", "not given", f"{optima['ide'].mean():.6f}"),
        Comparison("ide within 1e-6 of the global optimum", "not given", f"{(np.abs(excess) <= 1e-6).sum()} of {len(excess)}"),
        Comparison("ide above the optimum, worst, relative", "not given", f"{excess.max():.1e}"),
    ]
    comparisons += [
        Comparison(f"L_a over the optimum, {name}, median", "not given", f"{np.median(ratios[name]):.2f}")
        for name in STRATEGIES[:3]
    ]
    comparisons.append(Comparison("runs that say they converged", "not said", converged))
    rows = tuple((name, i + 1, run.cost, run.optimum) for name, runs in found.items() for i, run in enumerate(runs))
    # NaN leaves a gap among the bars.
    paper = np.array([_PAPER.get(name, (np.nan,))[0] for name in STRATEGIES])
    ours = np.array([costs[name].mean() for name in STRATEGIES])
    return make_report(
        "ide-table2",
        comparisons,
        tables=(CsvTable("runs", ("strategy", "run", "L_a", "optimum"), rows),),
        draw=figures.bars(STRATEGIES, {"paper": paper, "ours": ours}, "mean L$_a$", log=True),
        instrument=SETTING,
        runs=len(costs["ide"]),
    )


def _figure(context: StudyContext, *, name: str, strategy: str, tests: int, paper: str) -> StudyReport:
    """Show the fitness of a strategy over the generations."""
    runs = _evolutions(context)[strategy][:tests]
    fitness = {f"test {i + 1}": 1 / run.history for i, run in enumerate(runs)}
    ends = np.array([curve[-1] for curve in fitness.values()])
    # The fitness is 1 / L_a, as the paper draws it; half of the final one says how early the search is nearly done.
    half = np.median([int(np.argmax(curve >= curve[-1] / 2)) + 1 for curve in fitness.values()])
    comparisons = (
        Comparison(f"final L_a of {len(runs)} tests", paper, f"{1 / ends.max():.6f} to {1 / ends.min():.6f}"),
        Comparison("final fitness 1 / L_a", "curve only", f"{ends.min():.1f} to {ends.max():.1f}"),
        Comparison("generations to half the final fitness, median", "curve only", f"{half:.0f}"),
    )
    return make_report(
        name,
        comparisons,
        tables=(curves_table("fitness", "generation", fitness),),
        draw=figures.convergence({"": fitness}, "fitness 1 / L$_a$", xlabel="generation", log=False),
        instrument=SETTING,
    )


figure_2 = partial(_figure, name="ide-fig2", strategy="de-rand-1", tests=5, paper="mean 0.045558 in Table 2")
figure_3 = partial(
    _figure, name="ide-fig3", strategy="de-current-to-best-1", tests=5, paper='fitness "much smaller" than DE/rand/1'
)
figure_4 = partial(_figure, name="ide-fig4", strategy="de-combined", tests=5, paper="0.007656 to 0.008999")
figure_5 = partial(_figure, name="ide-fig5", strategy="ide", tests=3, paper="0.004162 to 0.005808")
