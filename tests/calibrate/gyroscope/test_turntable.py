"""Turntable pairs: the vector form gives all nine entries, the printed form three."""

from __future__ import annotations

import numpy as np
import pytest
from gyroscope_sessions import matrix_from_pairs, turns_problem

from imufield.calibrate.gyroscope.turntable import TurntableRun, pair_runs
from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS
from imufield.calibrate.solvers.evolution import IdeSettings, solve_ide
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from tests.refused import refused

pytestmark = pytest.mark.numerical

M = np.array([[1.002, 0.003, -0.001], [0.002, 0.997, 0.004], [-0.003, 0.001, 1.005]])
BIAS = np.array([0.01, -0.02, 0.005])


def runs(axes: FloatArray) -> list[TurntableRun]:
    """Runs both ways, with bias and a centripetal g-sensitivity that is the same both ways."""
    return [
        TurntableRun(
            axis=axis,
            rate_rad_s=way * w,
            mean_raw=M @ axis * way * w + BIAS + 1e-3 * w**2,
            covariance_raw=1e-14 * np.eye(3),
            rate_sigma_rad_s=1e-7,
            axis_sigma_rad=1e-5,
        )
        for axis in axes
        for w in np.radians((10.0, 20.0, 30.0))
        for way in (1.0, -1.0)
    ]


def test_pairs_are_free_of_bias_and_centripetal_force() -> None:
    table = pair_runs(runs(np.eye(3)))
    assert len(table) == 9
    assert matrix_from_pairs(table) == pytest.approx(M, abs=1e-12)
    assert np.linalg.eigvalsh(table.rate_covariance).min() > 0


def test_the_order_of_the_runs_does_not_matter() -> None:
    both_ways = runs(np.eye(3))
    table = pair_runs([*both_ways[::2], *both_ways[:0:-2]])
    assert len(table) == 9
    assert matrix_from_pairs(table) == pytest.approx(M, abs=1e-12)


def test_a_run_without_counterpart_is_refused() -> None:
    with refused(CalibrationError, Reason.TOO_FEW, "+10.0 deg/s", key="turntable.no_counterpart") as caught:
        pair_runs(runs(np.eye(3))[:1])
    assert caught.value.values["rate_deg_s"] == 10


def test_printed_form_is_rank_three_and_vector_form_rank_nine() -> None:
    table = pair_runs(runs(np.eye(3)))
    z = np.concatenate([np.diag(M), (M / np.diag(M)[:, None])[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]])
    assert np.linalg.matrix_rank(turns_problem(table, form="norm").jacobian(z), tol=1e-9) == 3
    assert np.linalg.matrix_rank(turns_problem(table).jacobian(z), tol=1e-9) == 9


def test_differential_evolution_reaches_the_optimum() -> None:
    problem = turns_problem(pair_runs(runs(np.eye(3))))
    found = solve_ide(problem, rng=np.random.default_rng(1), settings=IdeSettings(EG=400))
    assert found.x[:3] == pytest.approx(np.diag(M), abs=1e-4)
