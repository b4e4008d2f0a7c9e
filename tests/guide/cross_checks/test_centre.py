"""The centre of the stills, against simulated truth and against the plain fit of the same sphere."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from imufield.calibrate.model.models import predict
from imufield.guide.cross_checks.centre import centred
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray
from imufield.simulate.truth.grades import draw_truth, find_grade

pytestmark = pytest.mark.numerical

G = 9.80665
KNOWN = RoughScale(accelerometer=1.0, gyroscope=1.0)


def stills(offset_g: Any, up: FloatArray, seed: int = 0) -> FloatArray:
    """Return the outputs of a MEMS instrument with this offset at rest."""
    truth = draw_truth(find_grade("mems"), np.random.default_rng(seed)).accelerometer
    return predict(replace(truth, bias_m_s2=G * np.array(offset_g)), G * up)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("offset_g", [(0.5, 0.5, 0.5), (0.0, 0.42, 0.49), (-0.5, 0.5, -0.5), (0.0, 0.0, 0.8)])
def test_six_sides_show_an_offset(offset_g: Any, seed: int) -> None:
    found = centred(KNOWN, stills(offset_g, scheme("paper24").directions()[:6], seed))
    assert found.centred
    assert np.linalg.norm(found.raw_zero / G - offset_g) < 0.06
    assert found.accelerometer == 1.0


def test_it_is_the_sphere_that_a_nonlinear_fit_finds() -> None:
    outputs = stills((0.3, -0.4, 0.5), scheme("corners24").directions())

    def residuals(p: FloatArray) -> FloatArray:
        return np.linalg.norm(outputs - p[:3], axis=1) - p[3]

    fit = least_squares(residuals, [0, 0, 0, G])
    found = centred(replace(KNOWN, learned=True), outputs)
    assert np.abs(found.raw_zero - fit.x[:3]).max() < 0.005 * G
    assert found.accelerometer is not None
    assert found.accelerometer * G == pytest.approx(fit.x[3], rel=0.005)


@pytest.mark.parametrize("factor", [0.2, 0.5, 2.0, 3.0])
@pytest.mark.parametrize("spoilt", [(5,), (0, 9), (1, 2, 3)])
def test_stills_that_are_none_move_nothing(spoilt: tuple[int, ...], factor: float) -> None:
    outputs = stills((0.5, -0.4, 0.5), scheme("corners24").directions())
    found = centred(KNOWN, outputs)
    outputs[list(spoilt)] *= factor
    assert np.linalg.norm(centred(KNOWN, outputs).raw_zero - found.raw_zero) < 0.03 * G


def test_one_still_to_spare_cannot_say_which_is_wrong() -> None:
    outputs = stills((0.5, -0.4, 0.5), scheme("corners24").directions()[:6])
    outputs[3] *= 2.0
    assert centred(KNOWN, outputs).raw_zero is KNOWN.raw_zero


def test_an_axis_that_ends_at_0_7_g_is_no_offset() -> None:
    """Of two faces both are short, which no centre explains: they are judged by the centre there is."""
    up = scheme("faces6").directions() + np.random.default_rng(0).normal(0, 0.02, (6, 3))
    found = centred(KNOWN, np.clip(G * up, [-99, -7, -99], [99, 7, 99]))
    assert found.centred
    assert found.raw_zero is KNOWN.raw_zero


def test_a_centre_that_is_found_stays() -> None:
    outputs = stills((0.5, 0.5, 0.5), scheme("paper24").directions())
    once = centred(KNOWN, outputs)
    np.testing.assert_array_equal(centred(once, outputs).raw_zero, once.raw_zero)


def test_a_scale_learned_from_a_still_with_an_offset_is_learned_anew() -> None:
    outputs = 1000 * stills((0.5, 0.5, 0.5), scheme("paper24").directions())
    first = RoughScale().learn(max(outputs, key=np.linalg.norm))
    found = centred(first, outputs)
    assert first.accelerometer == pytest.approx(1780, rel=0.1)
    assert found.accelerometer == pytest.approx(1000, rel=0.03)
    np.testing.assert_allclose(found.up(outputs[0]), scheme("paper24").directions()[0], atol=0.06)


@pytest.mark.parametrize("counts_per_g", [300.0, 8000.0])
def test_the_middle_of_a_converter_is_an_offset_of_many_g(counts_per_g: float) -> None:
    """Beside it all sides look like one."""
    outputs = counts_per_g / G * stills((0.3, -0.2, 0.1), scheme("paper24").directions()) + 32768
    found = centred(RoughScale().learn(outputs[0]), outputs)
    assert found.centred
    assert found.accelerometer == pytest.approx(counts_per_g / G, rel=0.03)
    np.testing.assert_allclose(found.raw_zero, 32768 + counts_per_g * np.array([0.3, -0.2, 0.1]), atol=0.06 * counts_per_g)


@pytest.mark.parametrize(
    "up",
    [
        pytest.param([*scheme("paper24").directions()[:5]] * 2, id="five sides"),
        pytest.param([[0, np.sin(angle), np.cos(angle)] for angle in np.radians(np.arange(0, 360, 30))], id="in a plane"),
        pytest.param([[0.1, 0.1, 1.0]] * 12, id="one side"),
        pytest.param([[0.5 * np.sin(a), 0.5 * np.cos(a), 0.8] for a in np.radians(np.arange(0, 360, 30))], id="on a cone"),
    ],
)
def test_stills_that_do_not_show_a_centre_change_nothing(up: Any) -> None:
    directions = np.array(up) / np.linalg.norm(up, axis=1)[:, None]
    assert centred(KNOWN, stills((0.5, 0.5, 0.5), directions)) is KNOWN


@pytest.mark.parametrize("scale", [KNOWN, RoughScale()])
def test_stills_of_one_pose_show_no_centre_in_their_noise(scale: RoughScale) -> None:
    for seed in range(100):
        rng = np.random.default_rng(seed)
        outputs = stills((0.0, 0.0, 0.0), np.array([[0.0, 0.0, 1.0]] * 14)) + 1e-3 * rng.normal(size=(14, 3))
        known = scale.learn(outputs[0])
        assert centred(known, outputs) is known


def test_a_small_offset_stays_for_the_fit() -> None:
    found = centred(KNOWN, stills((0.05, -0.05, 0.05), scheme("paper24").directions()))
    assert found.centred
    assert found.raw_zero is KNOWN.raw_zero


def test_without_outputs_nothing_is_shown() -> None:
    assert centred(KNOWN, np.zeros((10, 3))) is KNOWN
