from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.accelerometer.swarm_coordinates import observable_basis, whitened_problem
from imufield.calibrate.model.models import norm_derivatives
from imufield.calibrate.model.observability import generators, parameter_scale
from imufield.calibrate.model.result import QuadraticAxes
from imufield.errors import CalibrationError, Reason
from imufield.guide.positions import scheme
from imufield.samples import FloatArray
from imufield.study.instruments import BSAS_GRAVITY_M_S2 as G
from imufield.study.instruments import BSAS_TRUTH, bsas_outputs
from tests.refused import refused

pytestmark = pytest.mark.numerical


@pytest.fixture(scope="module")
def raw() -> FloatArray:
    return bsas_outputs(np.random.default_rng(0))


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_a_unit_step_moves_the_norms_by_a_unit_in_every_direction(raw: FloatArray, axes: QuadraticAxes) -> None:
    basis = observable_basis(BSAS_TRUTH, raw, G, axes)
    moved = norm_derivatives(BSAS_TRUTH, raw, axes).jacobian @ basis
    assert basis.shape == (15, 12)
    assert moved.T @ moved == pytest.approx(np.eye(12), abs=1e-9)


def test_no_coordinate_contains_a_turn_of_the_frame(raw: FloatArray) -> None:
    scale = parameter_scale(BSAS_TRUTH, G)
    basis = observable_basis(BSAS_TRUTH, raw, G, "body") / scale[:, None]
    turns = generators(BSAS_TRUTH) / scale[:, None]
    assert turns.T @ basis == pytest.approx(np.zeros((3, 12)), abs=1e-12 * np.abs(basis).max())


def test_the_linear_model_has_nine_coordinates(raw: FloatArray) -> None:
    assert observable_basis(BSAS_TRUTH, raw, G, "sensing", free=tuple(range(12))).shape == (15, 9)


def test_scale_and_bias_alone_need_no_gauge(raw: FloatArray) -> None:
    basis = observable_basis(BSAS_TRUTH, raw, G, "sensing", free=tuple(range(6)))
    assert basis.shape == (15, 6)
    assert np.all(basis[6:] == 0)


def test_the_solution_is_about_one_unit_away(raw: FloatArray) -> None:
    preset = BSAS_TRUTH.copy()
    preset[:3] *= 1 + 5e-4
    problem = whitened_problem(preset, raw, G, quadratic_axes="body")
    z = np.linalg.lstsq(problem.jacobian(problem.start), -problem.residuals(problem.start), rcond=None)[0]
    assert np.linalg.norm(z) == pytest.approx(1.0, rel=0.05)


def test_fewer_positions_than_coordinates(raw: FloatArray) -> None:
    with refused(CalibrationError, Reason.TOO_FEW, key="swarm_coordinates.too_few") as caught:
        observable_basis(BSAS_TRUTH, raw[:11], G, "body")
    assert caught.value.values["positions"] == 11
    assert caught.value.values["needed"] == 12
    assert caught.value.reason is Reason.TOO_FEW


def test_positions_in_one_plane_name_what_they_do_not_show(raw: FloatArray) -> None:
    directions = scheme("paper24").directions()
    flat = raw[np.abs(directions[:, 2]) < 1e-9]
    with refused(CalibrationError, Reason.UNOBSERVABLE, key="swarm_coordinates.hidden") as caught:
        observable_basis(BSAS_TRUTH, np.tile(flat, (3, 1)), G, "sensing")
    assert caught.value.values["parameter"].startswith("accelerometer.")
    assert caught.value.reason is Reason.UNOBSERVABLE


def test_a_preset_in_another_unit_is_named(raw: FloatArray) -> None:
    preset = BSAS_TRUTH.copy()
    preset[:3] *= 9.80665  # per g instead of per m/s^2
    with refused(CalibrationError, Reason.UNITS, key="swarm_coordinates.foreign_preset") as caught:
        whitened_problem(preset, raw, G)
    assert caught.value.values["parameter"] == "accelerometer.scale"
    assert caught.value.reason is Reason.UNITS


def test_a_value_that_is_not_finite_is_refused(raw: FloatArray) -> None:
    broken = raw.copy()
    broken[3, 1] = np.nan
    with refused(CalibrationError, Reason.UNITS, key="swarm_coordinates.foreign_preset") as caught:
        whitened_problem(BSAS_TRUTH, broken, G)
    assert np.isnan(caught.value.values["norm_m_s2"])
