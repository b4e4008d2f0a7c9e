"""Known attitudes: the truth comes back, and what the turntable is off goes into misalignment."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.model.models import from_vector, predict
from imufield.calibrate.model.result import QuadraticAxes
from imufield.guide.positions import scheme
from imufield.study.instruments import BSAS_TRUTH
from imufield.study.known_attitudes import fit_known_attitudes

FORCE = 9.8 * scheme("paper24").directions()
pytestmark = pytest.mark.numerical


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_exact_outputs_give_the_exact_parameters(axes: QuadraticAxes) -> None:
    raw = predict(from_vector(BSAS_TRUTH, None, axes), FORCE)
    found = fit_known_attitudes(raw, FORCE, quadratic_axes=axes)
    np.testing.assert_allclose(found, BSAS_TRUTH, rtol=1e-8, atol=1e-11)


def test_a_linear_model_has_no_quadratic_term() -> None:
    truth = BSAS_TRUTH * np.repeat([1.0, 0.0], [12, 3])
    found = fit_known_attitudes(predict(from_vector(truth), FORCE), FORCE, quadratic=False)
    np.testing.assert_allclose(found, truth, rtol=1e-9, atol=1e-12)


def test_a_table_that_is_mounted_askew_turns_the_frame_and_nothing_else() -> None:
    small = np.array([1e-3, -2e-3, 5e-4])
    askew = FORCE + np.cross(small, FORCE)
    found = fit_known_attitudes(predict(from_vector(BSAS_TRUTH), askew), FORCE)
    off = found - BSAS_TRUTH
    # A turn by d adds to T_xy what it takes off T_yx; scale and bias feel it in second order.
    np.testing.assert_allclose(off[[6, 7, 9]], -off[[8, 10, 11]], atol=1e-5)
    np.testing.assert_allclose(np.abs(off[[6, 7, 9]]), np.abs(small[[2, 1, 0]]), rtol=0.01)
    np.testing.assert_allclose(found[:3], BSAS_TRUTH[:3], rtol=1e-5)
