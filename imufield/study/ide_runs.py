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

from imufield.calibrate.model.models import BIAS, MISALIGNMENT, SCALE
from imufield.calibrate.solvers.registry import load_solver
from imufield.dataclass import replace
from imufield.study import figures
from imufield.study.bsas_hardware import TURNTABLE_RAD
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    IDE_GRAVITY_M_S2,
    IDE_NOISE_M_S2,
    IDE_TRUTH,
    bsas_directions,
    ide_problem,
    triad_outputs,
)
from imufield.study.known_attitudes import fit_known_attitudes
from imufield.study.optimum import ComparedRun, compare, squares_optimum
from imufield.study.report import CsvTable, Findings, curves_table, texts

STRATEGIES = ("de-rand-1", "de-current-to-best-1", "de-combined", "ide")
SLOWER = "de-combined, F = 1.05"
"""The combination with the factor at which its L_a is the paper's."""
_SLOWER_FACTOR = 1.05
PAPER_COMBINED = 0.008171
"""Mean L_a of the combination in Table 2."""
_AT_OPTIMUM = 1e-6  # Relative: far below what noise or another data set would change.


def run_strategy(name: str, rng: np.random.Generator) -> ComparedRun:
    """Draw a data set and solve it with one strategy."""
    method, comma, _ = name.partition(",")
    return compare(load_solver(method, {"F": str(_SLOWER_FACTOR)} if comma else None), ide_problem(rng), rng)


@cache
def _evolutions(context: StudyContext) -> dict[str, list[ComparedRun]]:
    runs = context.runs(30, 2)
    found = dict(zip(STRATEGIES, context.campaign_of_each("ide-table2", run_strategy, STRATEGIES, runs), strict=True))
    # A campaign of its own: the others keep the data sets that they had without it.
    return found | {SLOWER: context.campaign("ide-table2 slower", run_strategy, [SLOWER] * runs)}


def run_turntable(_number: int, rng: np.random.Generator) -> tuple[float, float]:
    """Return L_a of the parameters that a turntable gives (the papers' separate calibration), and the optimum of the data."""
    problem = ide_problem(rng)
    up = bsas_directions()
    # A small turn by d adds d x up.
    force = IDE_GRAVITY_M_S2 * (up + np.cross(TURNTABLE_RAD * rng.standard_normal(up.shape), up))
    outputs = triad_outputs(IDE_TRUTH, force + IDE_NOISE_M_S2 * rng.standard_normal(force.shape))
    # N = K E a + n0: the bias of the linear model is b = n0 / K.
    vector = fit_known_attitudes(outputs, IDE_GRAVITY_M_S2 * up, quadratic=False)
    found = np.concatenate([vector[SCALE], vector[MISALIGNMENT], vector[SCALE] * vector[BIAS]])
    return float(problem.cost(found[None])[0]), squares_optimum(problem)[0]


def table_2(context: StudyContext) -> Findings:
    """Compare L_a of the strategies."""
    found = _evolutions(context)
    costs = {name: np.array([run.found.cost for run in runs]) for name, runs in found.items()}
    optima = {name: np.array([run.optimum for run in runs]) for name, runs in found.items()}
    excess = costs["ide"] / optima["ide"] - 1
    rows = tuple((name, i + 1, run.found.cost, run.optimum) for name, runs in found.items() for i, run in enumerate(runs))
    means = {"paper": np.array(texts()["ide-table2"]["paper"]["mean"]), "ours": np.array([c.mean() for c in costs.values()])}
    converged = {name: sum(run.found.converged for run in runs) for name, runs in found.items()}
    turntable = np.array(context.campaign("ide-table2 turntable", run_turntable, range(len(excess))))
    mean = {name: of_name.mean() for name, of_name in costs.items()}
    return Findings(
        values={
            "costs": costs,
            "optimum": optima["ide"],
            "within": (np.abs(excess) <= _AT_OPTIMUM).sum(),
            "excess": excess,
            "ratios": {name: costs[name] / optima[name] for name in found if name != "ide"},
            "converged": ", ".join(f"{name} {count}" for name, count in converged.items()),
            "turntable": turntable[:, 0],
            "turntable_ratio": turntable[:, 0] / turntable[:, 1],
            "as_paper": mean["de-rand-1"] > mean["de-combined"] > mean["ide"],
            "is_optimum": np.all(np.abs(excess) <= _AT_OPTIMUM),
            "spreading": not any(converged[name] for name in STRATEGIES[:3]) and converged["ide"] == len(excess),
            "slower": mean[SLOWER],
            "plain": mean["de-combined"],
            "to_paper": abs(mean[SLOWER] - PAPER_COMBINED) < abs(mean["de-combined"] - PAPER_COMBINED),
            "runs": len(excess),
        },
        tables=(CsvTable("runs", ("strategy", "run", "L_a", "optimum"), rows),),
        draw=figures.bars(tuple(found), means, "mean L_a", log=True),
    )


def figure(context: StudyContext, *, strategy: str, tests: int) -> Findings:
    """Show the fitness of a strategy over the generations."""
    found = {name: runs[:tests] for name, runs in _evolutions(context).items()}
    shown = fitness(found[strategy], "fitness 1 / L_a")
    mean = {name: float(np.mean([run.found.cost for run in runs])) for name, runs in found.items()}
    runs = found[strategy]
    above = max(run.found.cost / run.optimum for run in runs) - 1
    more = {
        "over_rand": mean[strategy] / mean["de-rand-1"],
        "over_current": mean[strategy] / mean["de-current-to-best-1"],
        "slower": mean[SLOWER],
        "slower_better": mean[SLOWER] < mean[strategy],
        "optima": np.array([run.optimum for run in runs]),
        "at_optimum": above <= _AT_OPTIMUM,
        "single_basin": all(run.found.cost <= run.optimum * (1 + _AT_OPTIMUM) for run in found["ide"]),
    }
    return replace(shown, values={**shown.values, **more})


def fitness(runs: Sequence[ComparedRun], label: str) -> Findings:
    """Show the fitness of runs over the generations: 1 over the cost, as the paper draws it."""
    curves = {f"test {i + 1}": 1 / run.found.history for i, run in enumerate(runs)}
    return Findings(
        values={
            "tests": len(runs),
            "converged": sum(run.found.converged for run in runs),
            "final": np.array([run.found.cost for run in runs]),
            "fitness": np.array([curve[-1] for curve in curves.values()]),
            # Half of the final fitness says how early the search is nearly done.
            "half": [int(np.argmax(curve >= curve[-1] / 2)) + 1 for curve in curves.values()],
        },
        tables=(curves_table("fitness", "generation", curves),),
        draw=figures.convergence({"": curves}, label, xlabel="generation", log=False),
    )
