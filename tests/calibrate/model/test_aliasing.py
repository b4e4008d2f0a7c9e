"""Typical errors in place of what a session does not show: the alias is the shift, and intervals hold the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import faces
from drifting_sessions import GRAVITY_M_S2, Session, proposed
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.aliasing import open_terms
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.models import to_vector
from imufield.earth import Gravity
from imufield.samples import FloatArray
from tests.told import told

EXACT = Gravity(gravity_m_s2=GRAVITY_M_S2, sigma_m_s2=1e-9, source="measured")
MEMS = GRADES["mems"]


def drawn(rng: np.random.Generator) -> FloatArray:
    """Return |s|, s^3 and six products of each axis, as large as is typical."""
    sizes = [MEMS.asymmetry, MEMS.cubic, *[MEMS.cross] * 3]
    return np.array([size * rng.standard_normal(3) for size in sizes])


@pytest.mark.numerical
def test_the_alias_is_how_far_a_term_moves_the_parameters() -> None:
    session = Session(directions=proposed("paper24"))
    observations, _ = session.take(np.random.default_rng(3))
    scale = calibrate_accelerometer(observations, EXACT, model="linear").accelerometer.scale
    up = observations.direction
    plain = calibrate_accelerometer(observations, EXACT, model="linear")
    # A scale that differs by 2 mg/g between the sides of x, as the equation of the term says.
    more = np.zeros_like(up)
    more[:, 0] = 1e-3 * GRAVITY_M_S2 * np.abs(up[:, 0]) * scale[0]
    moved = calibrate_accelerometer(replace(observations, mean_raw=observations.mean_raw + more), EXACT, model="linear")
    columns = open_terms(up, replace(MEMS, asymmetry=1e-3), np.zeros(6, dtype=np.bool_))
    jacobian = np.hstack([up**2, up, up[:, [0, 0, 1]] * up[:, [1, 2, 2]]])
    alias = np.linalg.lstsq(jacobian, columns[:, 0], rcond=None)[0]
    # Of the asymmetry of x, on the bias of x; placed within 5 degrees, so to a tenth.
    shift = moved.accelerometer.bias_m_s2[0] - plain.accelerometer.bias_m_s2[0]
    assert shift == pytest.approx(alias[3], rel=0.1)
    assert shift > 0.5e-3 * GRAVITY_M_S2


@pytest.mark.parametrize(
    ("directions", "has_noise_known", "quadratic_ug"),
    [
        (proposed("paper24"), True, 0.0),
        (proposed("corners24"), True, 0.0),
        (faces(), True, 500.0),
        (faces(), False, 500.0),
        (proposed("corners24")[:12], False, 500.0),
    ],
    ids=["paper24", "corners24", "six faces", "six faces, means alone", "twelve, means alone"],
)
def test_intervals_hold_instruments_of_the_grade(directions: FloatArray, has_noise_known: bool, quadratic_ug: float) -> None:
    session = Session(
        directions=directions,
        has_noise_known=has_noise_known,
        quadratic_ug=quadratic_ug,
        placement_deg=6.0,
        misalignment_rad=MEMS.accelerometer.misalignment_rad,
    )
    rng = np.random.default_rng(12)
    inside: list[NDArray[np.bool_]] = []
    for _ in range(30):
        observations, truth = session.take(rng, drawn(rng))
        calibration = calibrate_accelerometer(observations, EXACT, grade="mems")
        found = calibration.intrinsic
        sigma = np.concatenate([found.scale_sigma, found.bias_raw_sigma])
        # Known at all, and to what a user would call known.
        assert np.all(found.bias_raw_sigma / truth.scale < 0.02 * GRAVITY_M_S2)
        error = np.concatenate([found.scale, found.bias_raw]) - intrinsic(to_vector(truth), "sensing")[0][:6]
        inside.append(np.abs(error) < calibration.quality.student_factor_95 * sigma)
    # Priors that are right on average cover more; 180 numbers know a share of 0.95 to 1.6 %.
    assert np.mean(inside) > 0.91


def test_the_verdict_says_what_the_priors_add() -> None:
    session = Session(directions=proposed("paper24"))
    observations, _ = session.take(np.random.default_rng(3))
    # Of a quadratic term that may be there the grade says something, too.
    with_priors, without = (
        calibrate_accelerometer(observations, EXACT, model="quadratic", grade=grade) for grade in ("mems", None)
    )
    (told_once,) = told(with_priors.quality.reasons, "quality.typical")
    assert not told(without.quality.reasons, "quality.typical")

    def largest_added(name: str) -> float:
        more, less = (getattr(found.accelerometer_sigma, name) for found in (with_priors, without))
        return float(np.sqrt(np.max(more**2 - less**2)))

    assert told_once.values["bias_mg"] == pytest.approx(largest_added("bias_m_s2") / (1e-3 * 9.80665), rel=1e-6)
    scale = with_priors.accelerometer.scale[0]
    assert told_once.values["scale_ppm"] == pytest.approx(1e6 * largest_added("scale") / scale, rel=0.02)


@pytest.mark.numerical
def test_the_factor_is_smaller_where_more_is_known_beforehand() -> None:
    observations, _ = Session(directions=proposed("paper24")).take(np.random.default_rng(3))
    grades = (None, "tactical", "mems")
    factors = [calibrate_accelerometer(observations, EXACT, grade=grade).quality.student_factor_95 for grade in grades]
    assert factors[0] > factors[1] > factors[2] > 1.95
