"""What sets of positions show, against what is known of them."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import GRAVITY, edges, faces, outputs, paper24, random_parameters, tilted

from imufield.calibrate.model.models import BIAS, norm_derivatives, to_vector
from imufield.calibrate.model.observability import Observability, observe, require_scale_and_bias, require_space
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from tests.refused import refused

pytestmark = pytest.mark.numerical


def seen_from(directions: FloatArray, *, quadratic: bool = True, seed: int = 1, tilt_rad: float = 0.03) -> Observability:
    rng = np.random.default_rng(seed)
    parameters = random_parameters(rng)
    raw = outputs(parameters, GRAVITY * tilted(directions, rng, tilt_rad))
    vector = to_vector(parameters)
    return observe(norm_derivatives(vector, raw), vector, GRAVITY, quadratic=quadratic)


def test_paper24_shows_12_of_15_and_9_of_12() -> None:
    quadratic, linear = seen_from(paper24()), seen_from(paper24(), quadratic=False)
    assert (quadratic.rank, linear.rank) == (12, 9)
    assert quadratic.unobservable == linear.unobservable == ()
    assert linear.condition < quadratic.condition < 10


@pytest.mark.parametrize("times", [2, 4])
@pytest.mark.parametrize("seed", range(5))
def test_faces_show_scale_and_bias_only(times: int, seed: int) -> None:
    seen = seen_from(faces(times), seed=seed)
    assert seen.rank == 6
    assert all("misalignment" in name or "quadratic" in name for name in seen.unobservable)
    assert len(seen.unobservable) == 6
    require_scale_and_bias(seen)


@pytest.mark.parametrize("seed", range(5))
def test_edges_alone_show_no_quadratic_term(seed: int) -> None:
    seen = seen_from(np.vstack([edges(), edges()]), seed=seed)
    assert seen.rank == 9
    assert seen.unobservable == tuple(f"accelerometer.quadratic.{axis}" for axis in "xyz")


def test_a_large_quadratic_term_on_body_axes_does_not_hide_the_turns() -> None:
    # There the norm does see a turn a little; the generators are taken out all the same.
    rng = np.random.default_rng(1)
    parameters = random_parameters(rng)
    vector = to_vector(parameters)
    vector[12:] = 400 * 0.3 / GRAVITY**2
    raw = outputs(parameters, GRAVITY * paper24())
    seen = observe(norm_derivatives(vector, raw, "body"), vector, GRAVITY, quadratic=True)
    assert seen.rank == 12


@pytest.mark.parametrize("quadratic", [False, True])
def test_a_raw_zero_that_is_not_stated_changes_nothing(quadratic: bool) -> None:
    rng = np.random.default_rng(3)
    parameters = random_parameters(rng)
    raw, vector = outputs(parameters, GRAVITY * tilted(paper24(), rng, 0.03)), to_vector(parameters)
    seen = observe(norm_derivatives(vector, raw), vector, GRAVITY, quadratic=quadratic)
    # The same outputs about a mid-scale of 40 m/s^2, as a large bias.
    shifted = vector.copy()
    shifted[BIAS] += 40.0
    there = observe(norm_derivatives(shifted, raw + 40.0 * parameters.scale), shifted, GRAVITY, quadratic=quadratic)
    assert (there.rank, there.free, there.unobservable) == (seen.rank, seen.free, seen.unobservable)
    assert there.condition == pytest.approx(seen.condition, rel=1e-9)
    assert seen.condition < 10


def test_one_side_of_an_axis_is_refused_by_name() -> None:
    up = np.vstack([paper24(), tilted(paper24(), np.random.default_rng(0), 0.3)])
    seen = seen_from(up[up[:, 2] > 0.9])
    with refused(CalibrationError, Reason.UNOBSERVABLE, key="observability.scale_and_bias") as caught:
        require_scale_and_bias(seen)
    assert caught.value.values["axes"] == ("x", "y", "z")
    assert caught.value.reason is Reason.UNOBSERVABLE


def test_positions_in_one_plane_are_refused() -> None:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle), 0.3 * np.cos(angle)])
    with refused(CalibrationError, Reason.UNOBSERVABLE, "24 positions", key="observability.one_plane") as caught:
        require_space(400 * GRAVITY * circle)
    assert caught.value.values["thickness"] < 0.1


def test_a_dead_axis_is_refused() -> None:
    raw = 400 * GRAVITY * paper24()
    raw[:, 1] = 32767
    with refused(CalibrationError, Reason.SATURATED, "32767", key="observability.dead_axis") as caught:
        require_space(raw)
    assert caught.value.values["axis"] == "y"
    assert caught.value.reason is Reason.SATURATED
