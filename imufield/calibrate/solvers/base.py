"""One interface for every solver: a problem in, a result out.

A solver is a function ``solve(problem, *, rng, **options) -> SolverResult``. It sees coordinates ``z`` only, never
parameters, positions or gauges. Not converging is a status of the result, not an exception, and nothing is printed.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

import numpy as np

from imufield.dataclass import dataclass, field, replace
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)


class SolverStatus(IntEnum):
    """How a solver ended; as in scipy.optimize positive means converged, so the numbers in files tell it too."""

    STALLED = -3
    FAILED = -1
    ITERATION_LIMIT = 0
    CONVERGED = 1


class Problem(Protocol):
    """What a solver may ask. All methods work in n coordinates."""

    @property
    def start(self) -> FloatArray:
        """Coordinates to start from, shape (n,)."""
        ...

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper limits, shape (n,) each; infinite where there are none."""
        ...

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Cost of a whole population, shape (c, n) -> (c,); inf where the model cannot be inverted."""
        ...

    def residuals(self, z: FloatArray) -> FloatArray:
        """Weighted residuals, shape (n,) -> (m,)."""
        ...

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (n,) -> (m, n)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverResult:
    """How a solver ended."""

    x: FloatArray
    """Best coordinates ever seen, shape (n,)."""
    cost: float
    status: SolverStatus
    message: str
    evaluations: int
    """Candidates whose cost or residuals were computed."""
    history: FloatArray = field(default_factory=lambda: np.empty(0))
    """Best cost after each iteration; empty where the method does not tell."""

    @property
    def converged(self) -> bool:
        """Whether the result may be believed."""
        return self.status is SolverStatus.CONVERGED

    def as_polish_of(self, found: SolverResult) -> SolverResult:
        """Return this result of least squares as the last step of a method that found where it started."""
        message = sentence("base.polished", found=found.message, message=self.message)
        return replace(self, message=message, evaluations=found.evaluations + self.evaluations)


class Solver(Protocol):
    """The signature every solver has."""

    def __call__(self, problem: Problem, /, *, rng: np.random.Generator | None = None) -> SolverResult:
        """Solve the problem."""
        ...
