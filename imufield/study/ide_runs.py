"""IDE Figs. 2 to 5 and Table 2: the accelerometer by four strategies of differential evolution.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from imufield.calibrate.solvers.registry import load_solver
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import ide_problem
from imufield.study.optimum import ComparedRun, compare
from imufield.study.report import CsvTable, Findings, curves_table, texts

STRATEGIES = ("de-rand-1", "de-current-to-best-1", "de-combined", "ide")


def run_strategy(name: str, rng: np.random.Generator) -> ComparedRun:
    """Draw a data set and solve it with one strategy."""
    return compare(load_solver(name), ide_problem(rng), rng)


@cache
def _evolutions(context: StudyContext) -> dict[str, list[ComparedRun]]:
    found = context.campaign_of_each("ide-table2", run_strategy, STRATEGIES, context.runs(30, 3))
    return dict(zip(STRATEGIES, found, strict=True))


def table_2(context: StudyContext) -> Findings:
    """Compare L_a of the strategies."""
    found = _evolutions(context)
    costs = {name: np.array([run.found.cost for run in runs]) for name, runs in found.items()}
    optima = {name: np.array([run.optimum for run in runs]) for name, runs in found.items()}
    excess = costs["ide"] / optima["ide"] - 1
    rows = tuple((name, i + 1, run.found.cost, run.optimum) for name, runs in found.items() for i, run in enumerate(runs))
    means = {"paper": np.array(texts()["ide-table2"]["paper"]["mean"]), "ours": np.array([c.mean() for c in costs.values()])}
    return Findings(
        values={
            "costs": costs,
            "optimum": optima["ide"],
            "within": (np.abs(excess) <= 1e-6).sum(),
            "excess": excess,
            "ratios": {name: costs[name] / optima[name] for name in STRATEGIES[:3]},
            "converged": ", ".join(f"{name} {sum(run.found.converged for run in runs)}" for name, runs in found.items()),
            "runs": len(excess),
        },
        tables=(CsvTable("runs", ("strategy", "run", "L_a", "optimum"), rows),),
        draw=figures.bars(STRATEGIES, means, "mean L$_a$", log=True),
    )


def figure(context: StudyContext, *, strategy: str, tests: int) -> Findings:
    """Show the fitness of a strategy over the generations."""
    return fitness(_evolutions(context)[strategy][:tests], "fitness 1 / L$_a$")


def fitness(runs: Sequence[ComparedRun], label: str) -> Findings:
    """Show the fitness of runs over the generations: 1 over the cost, as the paper draws it."""
    curves = {f"test {i + 1}": 1 / run.found.history for i, run in enumerate(runs)}
    return Findings(
        values={
            "tests": len(runs),
            "final": np.array([run.found.cost for run in runs]),
            "fitness": np.array([curve[-1] for curve in curves.values()]),
            # Half of the final fitness says how early the search is nearly done.
            "half": [int(np.argmax(curve >= curve[-1] / 2)) + 1 for curve in curves.values()],
        },
        tables=(curves_table("fitness", "generation", curves),),
        draw=figures.convergence({"": curves}, label, xlabel="generation", log=False),
    )
