"""Steps of counters and time stamps."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.clock.missing_samples import StepRule


def test_the_most_frequent_allowed_step_is_learned() -> None:
    rule = StepRule((1, 2, 4, 8, 16))
    rule.learn(np.array([4.0, 4, 8, 4, 32, 4, 4, 7]))
    assert rule.step == 4
    found = rule.examine(np.array([4.0, 12, 4, 6, 2]))
    assert found.lost.tolist() == [0, 2, 0, 1, 0]
    assert found.irregular.tolist() == [False, True, False, True, True]
    assert found.inexact.tolist() == [False, False, False, True, True]


def test_time_stamps_may_jitter() -> None:
    rule = StepRule()
    rule.learn(np.array([0.010, 0.011, 0.009, 0.010, 0.030, 0.010, 0.010, 0.010]))
    assert rule.step == pytest.approx(0.010)
    found = rule.examine(np.array([0.014, 0.006, 0.021, 0.0, 0.010]))
    assert found.lost.tolist() == [0, 0, 1, 0, 0]
    assert found.irregular.tolist() == [False, False, True, False, False]


@pytest.mark.parametrize("cut", [1, 3, 7, 40])
def test_a_new_rate_is_learned_at_the_same_place_however_cut(cut: int) -> None:
    steps = np.array([2.0] * 5 + [8.0] * 30 + [2.0, 8.0, 8.0])
    whole = StepRule((1, 2, 4, 8, 16))
    whole.step = 2
    wanted = whole.examine(steps)
    assert whole.step == 8
    assert wanted.lost.tolist() == [0] * 5 + [3] * 16 + [0] * 14 + [0] * 3
    rule = StepRule((1, 2, 4, 8, 16))
    rule.step = 2
    parts = [rule.examine(steps[at : at + cut]) for at in range(0, len(steps), cut)]
    assert np.concatenate([part.lost for part in parts]).tolist() == wanted.lost.tolist()
    assert np.concatenate([part.irregular for part in parts]).tolist() == wanted.irregular.tolist()
    assert rule.step == 8


def test_a_step_that_is_not_allowed_is_never_learned() -> None:
    rule = StepRule((1, 2))
    rule.learn(np.array([3.0] * 8))
    rule.examine(np.array([3.0] * 50))
    assert rule.step == 1


def test_standing_time_gives_no_gaps() -> None:
    rule = StepRule()
    rule.learn(np.zeros(8))
    assert not rule.examine(np.zeros(40)).irregular.any()
