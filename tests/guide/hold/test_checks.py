import numpy as np
import pytest

from imufield.guide.hold.checks import change_over, largest_step


def test_change_over_a_line_is_the_change_and_its_sigma_is_honest() -> None:
    rng = np.random.default_rng(0)
    pulls = []
    for _ in range(300):
        change, sigma = change_over(np.linspace(0, 3.0, 100) + rng.normal(0, 0.5, 100))
        pulls.append((change - 3.0) / sigma)
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.15)
    assert change_over(np.ones(3)) == (0.0, np.inf)


def test_largest_step_finds_where_and_how_far() -> None:
    rng = np.random.default_rng(1)
    series = rng.normal(0, 0.1, (100, 3))
    series[63:] += [0.5, 0, -0.2]
    step, sigma, row = largest_step(series)
    assert abs(row - 63) <= 1
    np.testing.assert_allclose(step, [0.5, 0, -0.2], atol=0.08)
    assert 0.03 < sigma < 0.06


def test_noise_alone_has_no_step_of_six_sigma() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        step, sigma, _ = largest_step(rng.normal(0, 0.1, (100, 3)))
        assert np.linalg.norm(step) < 6 * sigma
    assert largest_step(np.ones((6, 3)))[1] == np.inf
