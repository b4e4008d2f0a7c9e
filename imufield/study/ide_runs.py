"""IDE Figs. 2 to 5 and Table 2: the accelerometer by four strategies of differential evolution.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from imufield.calibrate.solvers.registry import load_solver
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import IDE_NOISE_M_S2, ide_problem
from imufield.study.optimum import squares_optimum
from imufield.study.report import Comparison, CsvTable, StudyReport, curves_table

SETTING = (
    f"Accelerometer of IDE Table 1, simulated: 24 positions, bounds of Table 1, noise of {IDE_NOISE_M_S2:g} m/s^2 "
    "per axis and position; NP 60, EG 1200, F 1.2, CR 0.6; for IDE F_max 1.2, F_min 0.35."
)
STRATEGIES = ("de-rand-1", "de-current-to-best-1", "de-combined", "ide")
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
    problem = ide_problem(rng)
    optimum, _ = squares_optimum(problem)
    found = load_solver(name)(problem, rng=rng)
    return Evolution(found.cost, optimum, found.converged, found.history)


@cache
def _evolutions(context: StudyContext) -> dict[str, list[Evolution]]:
    runs = context.runs(30, 3)
    jobs = [name for name in STRATEGIES for _ in range(runs)]
    found = context.campaign("ide-table2", run_strategy, jobs)
    return {name: found[k * runs : (k + 1) * runs] for k, name in enumerate(STRATEGIES)}


_TABLE_2_DIFFERENCES = (
    (
        "The order is the paper's. Its mean and standard deviation for IDE are those of the global "
        "optimum under fresh noise: 0.3 mm/s^2 per axis and position was chosen once, to put the optimum "
        "there."
    ),
    (
        "With F constant at 1.2 the other strategies are still spreading after 1200 generations, in every "
        "run. Only the falling factor lets the population contract, and then it ends on the global "
        "optimum."
    ),
    (
        "The combination ends further from the optimum than in the paper, level with current-to-best/1; "
        "its gain must come from an F below 1.2, which the paper does not print for it."
    ),
    (
        "F_min, not printed either, matters: with 0.3 about one run in a hundred froze 1e-5 above the "
        "optimum, with 0.5 half have not quite arrived; 0.35 is taken."
    ),
    ("Three of the nine entries of K E are a turn of the frame, so the parameters differ from run to run while L_a does not."),
)


def table_2(context: StudyContext) -> StudyReport:
    """Compare L_a of the strategies."""
    found = _evolutions(context)
    costs = {name: np.array([run.cost for run in runs]) for name, runs in found.items()}
    rows = tuple((name, i + 1, run.cost, run.optimum) for name, runs in found.items() for i, run in enumerate(runs))
    return StudyReport(
        name="ide-table2",
        title="L_a of DE/rand/1, the combination and IDE",
        setting=f"{SETTING} Fresh noise in every run, {len(costs['ide'])} runs.",
        comparisons=(*_costs_beside_the_paper(costs), *_costs_over_the_optimum(found)),
        differences=_TABLE_2_DIFFERENCES,
        tables=(CsvTable("runs", ("strategy", "run", "L_a", "optimum"), rows),),
        draw=figures.bars(
            STRATEGIES,
            {
                "paper": np.array([_PAPER.get(n, (np.nan,))[0] for n in STRATEGIES]),
                "ours": np.array([costs[n].mean() for n in STRATEGIES]),
            },
            "mean L$_a$",
            log=True,
        ),
    )


def _costs_beside_the_paper(costs: dict[str, FloatArray]) -> tuple[Comparison, ...]:
    return tuple(
        Comparison(
            f"L_a of {name}, mean (SD)",
            f"{_PAPER[name][0]:.6f} ({_PAPER[name][1]:.1e})" if name in _PAPER else "not given",
            f"{values.mean():.6f} ({values.std(ddof=1):.1e})",
        )
        for name, values in costs.items()
    )


def _costs_over_the_optimum(found: dict[str, list[Evolution]]) -> tuple[Comparison, ...]:
    ratios = {name: np.array([run.cost / run.optimum for run in runs]) for name, runs in found.items()}
    optimum = np.mean([run.optimum for run in found["ide"]])
    excess = ratios["ide"] - 1
    at_optimum = int((np.abs(excess) <= 1e-6).sum())
    return (
        Comparison("global optimum of the data of ide, mean", "not given", f"{optimum:.6f}"),
        Comparison("ide within 1e-6 of the global optimum", "not given", f"{at_optimum} of {len(excess)}"),
        Comparison("ide above the optimum, worst, relative", "not given", f"{excess.max():.1e}"),
        *(
            Comparison(f"L_a over the optimum, {name}, median", "not given", f"{np.median(ratios[name]):.2f}")
            for name in STRATEGIES[:3]
        ),
        Comparison(
            "runs that say they converged",
            "not said",
            ", ".join(f"{name} {sum(run.converged for run in runs)}" for name, runs in found.items()),
        ),
    )


def _figure(
    context: StudyContext, name: str, strategy: str, title: str, *, tests: int, paper: str, differences: tuple[str, ...]
) -> StudyReport:
    runs = _evolutions(context)[strategy][:tests]
    fitness = {f"test {i + 1}": 1 / run.history for i, run in enumerate(runs)}
    ends = np.array([curve[-1] for curve in fitness.values()])
    half = np.median([int(np.argmax(curve >= curve[-1] / 2)) + 1 for curve in fitness.values()])
    comparisons = (
        Comparison(f"final L_a of {len(runs)} tests", paper, f"{1 / ends.max():.6f} to {1 / ends.min():.6f}"),
        Comparison("final fitness 1 / L_a", "curve only", f"{ends.min():.1f} to {ends.max():.1f}"),
        Comparison("generations to half the final fitness, median", "curve only", f"{half:.0f}"),
    )
    return StudyReport(
        name=name,
        title=title,
        setting=SETTING,
        comparisons=comparisons,
        differences=differences,
        tables=(curves_table("fitness", "generation", fitness),),
        draw=figures.convergence({"": fitness}, "fitness 1 / L$_a$", xlabel="generation", log=False),
    )


def figure_2(context: StudyContext) -> StudyReport:
    """Show the fitness of DE/rand/1."""
    return _figure(
        context,
        "ide-fig2",
        "de-rand-1",
        "fitness of DE/rand/1",
        tests=5,
        paper="mean 0.045558 in Table 2",
        differences=(
            "Slow, and of poor repeatability, as in the paper: the population has not contracted after 1200 generations.",
        ),
    )


def figure_3(context: StudyContext) -> StudyReport:
    """Show the fitness of DE/current-to-best/1."""
    return _figure(
        context,
        "ide-fig3",
        "de-current-to-best-1",
        "fitness of DE/current-to-best/1",
        tests=5,
        paper='fitness "much smaller" than DE/rand/1',
        differences=(
            (
                "Here it ends a little better than DE/rand/1, not worse: the cost has a single basin within these "
                "bounds, so there is no local optimum to fall into. With F at 1.2, neither has converged."
            ),
        ),
    )


def figure_4(context: StudyContext) -> StudyReport:
    """Show the fitness of the combination."""
    return _figure(
        context,
        "ide-fig4",
        "de-combined",
        "fitness of the combined strategy",
        tests=5,
        paper="0.007656 to 0.008999",
        differences=(
            (
                "Better than DE/rand/1, as in the paper, but level with current-to-best/1 and not as near the "
                "optimum as there: with F held at 1.2 the difference term keeps the population apart to the end. "
                "The paper does not say whether its F stayed at 1.2 in this figure."
            ),
        ),
    )


def figure_5(context: StudyContext) -> StudyReport:
    """Show the fitness of IDE."""
    return _figure(
        context,
        "ide-fig5",
        "ide",
        "fitness of IDE",
        tests=3,
        paper="0.004162 to 0.005808",
        differences=(
            (
                "Every test ends on the global optimum of its data. The range is that of the optimum under fresh "
                "noise, so the paper's scatter of 8.5e-4 is the scatter of its data, not of the method."
            ),
        ),
    )
