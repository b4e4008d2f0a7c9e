"""Cubic and cross terms: against the equation written out, differences, the simulator, and ranks of functions of the sphere."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from calibration_truth import GRAVITY, random_parameters

from imufield.calibrate.model.gauge import turn_accelerometer
from imufield.calibrate.model.higher_terms import HigherTerms, shown_terms
from imufield.calibrate.model.models import norm_derivatives, predict, recover, to_vector, without_higher
from imufield.calibrate.model.result import AccelerometerParameters, QuadraticAxes
from imufield.deliver.parameters.apply import correct_accelerometer
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason
from imufield.guide.positions import scheme
from imufield.samples import FloatArray
from imufield.simulate.truth.effects import Effects
from tests.refused import refused

pytestmark = pytest.mark.numerical


def bent(seed: int = 5, axes: QuadraticAxes = "sensing") -> AccelerometerParameters:
    rng = np.random.default_rng(seed)
    higher = HigherTerms(cubic=2e-5 * rng.standard_normal(3), cross=2e-4 * rng.standard_normal((3, 3)))
    return replace(random_parameters(rng, quadratic=0.002), quadratic_axes=axes, higher=higher)


def forces(seed: int = 6, count: int = 40) -> FloatArray:
    up = np.random.default_rng(seed).standard_normal((count, 3))
    return np.asarray(GRAVITY * up / np.linalg.norm(up, axis=1)[:, None])


def test_the_equation_written_out() -> None:
    p, a = bent(), forces()
    assert p.higher is not None
    c, d = p.higher.cubic, p.higher.cross
    for force, output in zip(a, predict(p, a), strict=True):
        x, y, z = (np.eye(3) + p.misalignment_rad) @ force
        for i, s in enumerate((x, y, z)):
            f = s + c[i] * s**3 + d[0, i] * x * y + d[1, i] * x * z + d[2, i] * y * z
            assert output[i] == pytest.approx(p.scale[i] * (f + p.bias_m_s2[i]) + p.quadratic[i] * f**2, rel=1e-13)


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_what_is_predicted_is_recovered(axes: QuadraticAxes) -> None:
    p, a = bent(axes=axes), forces()
    np.testing.assert_allclose(recover(p, predict(p, a)), a, atol=1e-12)
    np.testing.assert_allclose(without_higher(p, predict(p, a)), predict(replace(p, higher=None), a), rtol=1e-13)
    # No force at all has outputs too.
    np.testing.assert_allclose(recover(p, predict(p, np.zeros((1, 3)))), 0, atol=1e-12)


def test_apply_undoes_the_simulator_to_rounding() -> None:
    effects = Effects(cubic=(2e-3, -1e-3, 5e-4), cross=((1e-3, 0.0, -5e-4), (0.0, 7e-4, 0.0), (2e-4, -1e-3, 0.0)))
    p, a = random_parameters(np.random.default_rng(2), quadratic=0.002), forces()
    raw = predict(p, effects.distorted(a, p.misalignment_rad))
    g = STANDARD_GRAVITY_M_S2
    higher = HigherTerms(cubic=np.array(effects.cubic) / g**2, cross=np.array(effects.cross) / g)
    np.testing.assert_allclose(correct_accelerometer(replace(p, higher=higher), raw), a, atol=1e-12)
    assert np.abs(correct_accelerometer(p, raw) - a).max() > 1e-2


def test_an_output_far_beyond_is_refused() -> None:
    p = replace(bent(), quadratic=np.zeros(3))
    raw = p.scale * np.array([[3000.0, 0.0, 0.0]])
    with refused(CalibrationError, Reason.NOT_CONVERGED, key="models.no_higher_inverse"):
        recover(p, raw)
    assert np.isnan(recover(p, np.full((1, 3), np.nan))).all()


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_derivatives_of_the_norm(axes: QuadraticAxes) -> None:
    p, a = bent(axes=axes), forces(count=8)
    assert p.higher is not None
    raw, vector, terms = predict(p, a), to_vector(p), p.higher.to_vector()
    found = norm_derivatives(vector, raw, axes, p.higher)
    np.testing.assert_allclose(found.norm, GRAVITY, rtol=1e-13)

    def norm(vector: FloatArray, terms: FloatArray) -> FloatArray:
        return norm_derivatives(vector, raw, axes, HigherTerms.from_vector(terms)).norm

    for k, size in enumerate(1e-6 * np.maximum(np.abs(vector), 1e-2)):
        step = np.eye(15)[k] * size
        slope = (norm(vector + step, terms) - norm(vector - step, terms)) / (2 * size)
        np.testing.assert_allclose(found.jacobian[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())
    for k, step in enumerate(np.eye(12) * 1e-7):
        slope = (norm(vector, terms + step) - norm(vector, terms - step)) / 2e-7
        np.testing.assert_allclose(found.by_higher[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


def test_a_turn_of_the_body_frame_changes_no_output() -> None:
    p, a = bent(), forces()
    angle = 0.3
    rotation = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turned = turn_accelerometer(p, rotation)
    np.testing.assert_allclose(predict(turned, a @ rotation.T), predict(p, a), rtol=1e-12)


def rank(name: str, *kinds: str) -> int:
    """Return the rank of the norms that kinds of terms make: each term put into the simulator, one after the other."""
    up = scheme(name).directions()
    columns = [*(up**2).T, *up.T, up[:, 0] * up[:, 1], up[:, 0] * up[:, 2], up[:, 1] * up[:, 2], *(up**3).T]
    one = [tuple(float(v) for v in row) for row in np.eye(3)]
    zero = (0.0, 0.0, 0.0)
    effects = {
        "asymmetry": [Effects(asymmetry=(x, y, z)) for x, y, z in one],
        "cubic": [Effects(cubic=(x, y, z)) for x, y, z in one],
        "cross": [
            Effects(cross=tuple((x, y, z) if row == pair else zero for row in range(3)))
            for pair, (x, y, z) in product(range(3), one)
        ],
    }
    g = STANDARD_GRAVITY_M_S2
    for effect in (effect for kind in kinds for effect in effects[kind]):
        # The small effect of the term on the norm, by the force that it stands for.
        more = effect.distorted(g * up, np.zeros((3, 3))) - g * up
        columns.append(np.sum(up * more, axis=1) / g)
    return int(np.linalg.matrix_rank(np.stack(columns, axis=1), tol=1e-9))


@pytest.mark.parametrize(
    ("name", "ranks"), [("paper24", (15, 15, 12, 18)), ("corners24", (13, 13, 12, 14)), ("all26", (15, 16, 15, 22))]
)
def test_ranks_of_the_schemes(name: str, ranks: tuple[int, ...]) -> None:
    kinds = (("cubic",), ("cross",), ("asymmetry",), ("cubic", "cross", "asymmetry"))
    assert tuple(rank(name, *each) for each in kinds) == ranks
    up = scheme(name).directions()
    quadratic = np.hstack([up**2, up, up[:, [0, 0, 1]] * up[:, [1, 2, 2]], up**3])
    shown = shown_terms(quadratic, up, np.ones(len(up)), least=1e-9)
    assert shown.counts == (ranks[0] - 12, rank(name, "cubic", "cross") - ranks[0])


def test_the_part_that_is_shown_has_the_least_squares() -> None:
    """x y z on three axes alike; the difference as +c of x y on x and -c of y z on z; no sum of two."""
    up = scheme("all26").directions()
    quadratic = np.hstack([up**2, up, up[:, [0, 0, 1]] * up[:, [1, 2, 2]], up**3])
    shown = shown_terms(quadratic, up, np.full(26, 0.01), least=0.15).combinations
    alike, difference, total = np.zeros((3, 12))
    alike[[3 + 2, 6 + 1, 9 + 0]] = 1 / np.sqrt(3)  # xy on z, xz on y, yz on x
    difference[[3 + 0, 9 + 2]] = np.array([1, -1]) / np.sqrt(2)  # xy on x, yz on z: x^2 y - z^2 y
    total[[3 + 0, 9 + 2]] = np.array([1, 1]) / np.sqrt(2)
    assert np.linalg.norm(shown.T @ alike) == pytest.approx(1)
    assert np.linalg.norm(shown.T @ difference) == pytest.approx(1)
    assert np.linalg.norm(shown.T @ total) == pytest.approx(0, abs=1e-9)
