"""IDE equations 27 to 30: what differential evolution costs, in evaluations and in time, over population and generations.

The paper counts basic statements: with N generations, M coordinates and 5 M members, mutation O(N M) (of IDE O(N M^2), for the
best of the population), crossover O(5 N M^2), selection O(N M); both are O(N M^2), and differ by a constant factor only.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 4.3.
"""

from __future__ import annotations

import time
from itertools import product

import numpy as np

from imufield.calibrate.solvers.registry import load_solver
from imufield.dataclass import dataclass
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import ide_problem
from imufield.study.report import CsvTable, Findings

METHODS = ("de-rand-1", "ide")
_MEMBERS = (30, 60, 120, 240)
_GENERATIONS = (75, 150, 300)
_BEST_OF = 5  # Runs of which the shortest counts: what else the machine does only adds.


@dataclass(frozen=True, slots=True)
class Effort:
    """A method with so many members and generations."""

    method: str
    members: int
    generations: int


def run_effort(effort: Effort, rng: np.random.Generator) -> tuple[int, float]:
    """Return evaluations and processor time, s of one run."""
    problem = ide_problem(rng)
    solver = load_solver(effort.method, {"NP": str(effort.members), "EG": str(effort.generations)})
    start_s = time.process_time()
    found = solver(problem, rng=rng)
    return found.evaluations, time.process_time() - start_s


def complexity(context: StudyContext) -> Findings:
    """Measure how evaluations and time grow with members and generations."""
    efforts = [Effort(*values) for values in product(METHODS, _MEMBERS, _GENERATIONS)]
    found = context.campaign_of_each("ide-complexity", run_effort, efforts, context.runs(_BEST_OF, 1))
    counts = {effort: runs[0][0] for effort, runs in zip(efforts, found, strict=True)}
    times_s = {effort: min(seconds for _, seconds in runs) for effort, runs in zip(efforts, found, strict=True)}
    expected = sum(counts[effort] == effort.members * (effort.generations + 1) for effort in efforts)
    ratio = np.array([
        times_s[Effort("ide", members, generations)] / times_s[Effort("de-rand-1", members, generations)]
        for members, generations in product(_MEMBERS, _GENERATIONS)
    ])  # fmt: skip
    rows = tuple((e.method, e.members, e.generations, counts[e], times_s[e]) for e in efforts)
    curves = {
        f"{method}, NP = {members}": np.array([times_s[Effort(method, members, generations)] for generations in _GENERATIONS])
        for method, members in product(METHODS, _MEMBERS)
    }
    powers = {method: _powers([effort for effort in efforts if effort.method == method], times_s) for method in METHODS}
    per_evaluation = {method: [times_s[e] / counts[e] * 1e6 for e in efforts if e.method == method] for method in METHODS}
    return Findings(
        values={
            "expected": expected,
            "efforts": len(efforts),
            "powers": powers,
            "per_evaluation": {method: np.array(values) for method, values in per_evaluation.items()},
            "ratio": ratio,
            "constant": ratio.max() < 2 * ratio.min(),
            "members": ", ".join(map(str, _MEMBERS)),
            "generations": ", ".join(map(str, _GENERATIONS)),
        },
        tables=(CsvTable("times", ("method", "NP", "G", "evaluations", "processor time, s"), rows),),
        draw=figures.bars(tuple(map(str, _GENERATIONS)), curves, "processor time, s", log=True),
    )


def _powers(efforts: list[Effort], times_s: dict[Effort, float]) -> FloatArray:
    """Return the powers of NP and G in the time, by least squares of logarithms, shape (2,)."""
    A = np.log([[np.e, effort.members, effort.generations] for effort in efforts])
    return np.asarray(np.linalg.lstsq(A, np.log([times_s[effort] for effort in efforts]), rcond=None)[0][1:])
