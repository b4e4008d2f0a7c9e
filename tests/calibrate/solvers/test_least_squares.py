"""Least squares through the interface that every solver has."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy.optimize

from imufield.calibrate.solvers.base import Solver, SolverStatus
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.samples import FloatArray
from tests.told import key_of

pytestmark = pytest.mark.numerical


@dataclass
class Line:
    """y = z0 + z1 x: the exact answer is the normal equations'."""

    x: FloatArray
    y: FloatArray

    start: FloatArray = field(default_factory=lambda: np.zeros(2))
    bounds = property(lambda self: (np.full(2, -np.inf), np.full(2, np.inf)))

    def residuals(self, z: FloatArray) -> FloatArray:
        return z[0] + z[1] * self.x - self.y

    def jacobian(self, z: FloatArray) -> FloatArray:
        return np.column_stack([np.ones_like(self.x), self.x])

    def cost(self, candidates: FloatArray) -> FloatArray:
        return np.array([np.sum(self.residuals(z) ** 2) for z in candidates])


@dataclass
class Nowhere(Line):
    def residuals(self, z: FloatArray) -> FloatArray:
        return np.full(len(self.x), np.nan)


@pytest.fixture
def line() -> Line:
    return Line(np.arange(6.0), np.array([1.0, 3.0, 5.0, 7.0, 9.0, 60.0]))


def test_the_signature_is_that_of_every_solver() -> None:
    solver: Solver = solve_least_squares
    assert callable(solver)


def test_minimum_is_that_of_the_normal_equations(line: Line) -> None:
    result = solve_least_squares(line)
    expected = np.asarray(np.linalg.lstsq(line.jacobian(line.start), line.y, rcond=None)[0], dtype=np.float64)
    assert result.x == pytest.approx(expected, rel=1e-9)
    assert result.cost == pytest.approx(float(line.cost(expected[None])[0]))
    assert result.converged
    assert result.status is SolverStatus.CONVERGED
    assert result.evaluations > 0
    assert result.history[-1] == result.cost


def test_too_few_evaluations_is_a_status(line: Line) -> None:
    result = solve_least_squares(line, max_evaluations=1)
    assert not result.converged
    assert result.message


def test_outside_the_model_is_a_status() -> None:
    result = solve_least_squares(Nowhere(np.arange(3.0), np.zeros(3)))
    assert result.status is SolverStatus.FAILED
    assert result.x.tolist() == [0.0, 0.0]
    assert key_of(result.message) in {"least_squares.left_domain", "least_squares.refused_values"}


@dataclass
class Misshapen(Line):
    def jacobian(self, z: FloatArray) -> FloatArray:
        return super().jacobian(z)[1:]


def test_a_jacobian_of_a_wrong_shape_is_a_defect() -> None:
    # A mistake of the program is not told as one of the data.
    with pytest.raises(ValueError, match="mismatch"):
        solve_least_squares(Misshapen(np.arange(3.0), np.zeros(3)))


@dataclass
class Valley(Line):
    """Rosenbrock's valley, from a start outside of it, with residuals left over at the end."""

    def residuals(self, z: FloatArray) -> FloatArray:
        return np.array([100 * (z[1] - z[0] ** 2), 1 - z[0], 0.3 * z[1] + 1, z[0] * z[1]])

    def jacobian(self, z: FloatArray) -> FloatArray:
        return np.array([[-200 * z[0], 100.0], [-1.0, 0.0], [0.0, 0.3], [z[1], z[0]]])


@pytest.mark.parametrize("start", [(-1.2, 1.0), (5.0, -7.0), (0.0, 0.0), (30.0, 900.0)])
def test_a_curved_problem_ends_where_that_of_scipy_does(start: tuple[float, float]) -> None:
    valley = Valley(np.empty(0), np.empty(0), np.array(start))
    ours = solve_least_squares(valley)
    theirs = scipy.optimize.least_squares(valley.residuals, start, jac=valley.jacobian, method="lm", ftol=1e-15, xtol=1e-15)
    assert ours.converged
    # In units of sigma, as the residuals are.
    assert np.linalg.norm(valley.jacobian(theirs.x) @ (ours.x - theirs.x)) < 1e-6


@dataclass
class Counted(Valley):
    rows: int = 4
    calls: int = 0

    def residuals(self, z: FloatArray) -> FloatArray:
        self.calls += 1
        return super().residuals(z)[: self.rows]

    def jacobian(self, z: FloatArray) -> FloatArray:
        self.calls += 1
        return super().jacobian(z)[: self.rows]


@pytest.mark.parametrize("rows", [4, 1], ids=["enough", "fewer than coordinates"])
def test_every_evaluation_is_counted(rows: int) -> None:
    valley = Counted(np.empty(0), np.empty(0), np.array([-1.2, 1.0]), rows)
    found = solve_least_squares(valley)
    assert found.converged
    assert found.evaluations == valley.calls


def test_a_jacobian_is_decomposed_once_however_many_dampings_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    decomposed: list[bytes] = []
    svd = np.linalg.svd

    def noting(matrix: FloatArray, *, full_matrices: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        decomposed.append(matrix.tobytes())
        return svd(matrix, full_matrices=full_matrices)

    monkeypatch.setattr(np.linalg, "svd", noting)
    valley = Valley(np.empty(0), np.empty(0), np.array([-1.2, 1.0]))
    result = solve_least_squares(valley)
    # Beside the first of both: a residual for each damping, a Jacobian for each that was taken.
    assert len(decomposed) < result.evaluations / 2
    assert len(set(decomposed)) == len(decomposed)
