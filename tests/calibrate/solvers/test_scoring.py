"""A step of scoring is left as it is where the likelihood bends as expected, and ends at the top where it bends much more."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.solvers.scoring import cut_at_top

STEP = np.array([2.0, -1.0])


def test_a_step_that_climbs_is_left() -> None:
    # From a slope of 3 the top is at 0.6 of the step.
    assert cut_at_top(STEP, np.array([1.0, -1.0]), np.diag([1.0, 1.0])) is STEP


def test_a_step_far_beyond_the_top_ends_there() -> None:
    np.testing.assert_allclose(cut_at_top(STEP, np.array([1.0, -1.0]), np.diag([2.0, 2.0])), 0.3 * STEP)


def test_a_step_that_no_parabola_bounds_is_left() -> None:
    assert cut_at_top(STEP, np.array([1.0, -1.0]), np.diag([-1.0, -1.0])) is STEP
    assert cut_at_top(STEP, np.array([-1.0, 1.0]), np.diag([9.0, 9.0])) is STEP
