"""Whether a history has changed: limits by closed forms, shares of false alarms and of found changes by drawn histories."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtri, ndtri

from imufield.calibrate.sessions.accuracy_forecast import Forecast, NoForecast, forecast
from imufield.calibrate.sessions.changes import DatedNumbers, Judged, KindTest, day_to_day, judge
from imufield.samples import FloatArray

pytestmark = pytest.mark.numerical
EVERY_DAYS = 30.0


def history(values: FloatArray, kind: str = "bias", sigma: float = 0.1, **facts: object) -> list[DatedNumbers]:
    """Return sessions of one kind from values, shape (h, a)."""
    a = values.shape[1]
    given: dict[str, object] = {
        "covariance": sigma**2 * np.eye(a),
        "freedom": np.full(a, math.inf),
        "setup": "",
        "hidden": np.zeros((a, a)),
        "site": "",
        "by_gravity": np.zeros(a),
    } | facts
    names = tuple(f"{kind} {axis}" for axis in "xyz"[:a])
    return [DatedNumbers(day=EVERY_DAYS * k, names=names, values=row, **given) for k, row in enumerate(values)]  # type: ignore[arg-type]


def drawn(rng: np.random.Generator, h: int = 10, s: float = 0.3) -> FloatArray:
    return math.hypot(s, 0.1) * rng.standard_normal((h, 3))


def test_a_step_of_what_days_do_not_change_has_the_stated_sigma() -> None:
    judged = judge(history(np.array([[0.0], [1.0], [1.0]]), kind="angle"))
    (change,) = judged.changes
    assert change.first_after == 1
    assert change.size == pytest.approx(1.0)
    assert change.sigma == pytest.approx(0.1 * math.sqrt(1.5))
    # Steps at two places and a drift are correlated: less than three independent ones.
    assert ndtri(0.975) < change.limit_sigma < ndtri(0.5 + 0.95 ** (1 / 3) / 2)


def test_a_step_is_studentised_by_what_it_leaves() -> None:
    values = drawn(np.random.default_rng(1))
    values[8:, 0] += 50.0
    (change, *_) = judge(history(values, sigma=1e-6)).changes
    split = [values[:8], values[8:]]
    rest = sum(float(np.sum((part - part.mean(axis=0)) ** 2)) for part in split) / (3 * 8)
    assert change.first_after == 8
    assert change.size == pytest.approx(values[8:, 0].mean() - values[:8, 0].mean(), rel=1e-6)
    assert change.sigma == pytest.approx(math.sqrt(rest * (1 / 8 + 1 / 2)), rel=1e-4)


def test_a_shock_of_all_axes_does_not_hide_itself() -> None:
    values = drawn(np.random.default_rng(2))
    values[8:] += 5 * 0.3
    judged = judge(history(values))
    assert {change.name for change in judged.news} == {"bias x", "bias y", "bias z"}
    assert judged.repeatability["bias"].freedom == 24
    assert day_to_day(history(values))["bias"] > 1.5 * judged.repeatability["bias"].sigma


def test_a_drift_is_told_from_a_step() -> None:
    values = drawn(np.random.default_rng(3))
    values[:, 2] += 0.02 * EVERY_DAYS * np.arange(10)
    (change,) = judge(history(values)).news
    assert (change.name, change.first_after) == ("bias z", None)
    assert abs(change.size - 0.02) < 3 * change.sigma


@pytest.mark.statistical
def test_unchanged_histories_are_called_changed_in_five_percent() -> None:
    runs = 60
    called = sum(bool(judge(history(drawn(np.random.default_rng(k)))).news) for k in range(runs))
    # 5 % of 60 are 3, +-1.7: more than 10 are four sigma above, and none at all comes up once in 20 times.
    assert 0 < called <= 10


@pytest.mark.parametrize(("excess", "is_shown"), [(0.9, False), (1.2, False), (1.40, False), (1.45, True), (9.0, True)])
def test_days_that_noise_alone_explains_make_no_limit_wider(excess: float, is_shown: bool) -> None:
    """By chi squared: 27 contrasts of the sigma that is stated have a mean square above 38.5 / 27 in 7 of 100 histories."""
    values = drawn(np.random.default_rng(5))
    values -= values.mean(axis=0)
    test = KindTest.of(history(values * 0.1 * math.sqrt(27 * excess / np.sum(values**2))), "bias")
    assert test is not None
    assert test.variance == pytest.approx(0.1**2 * max(excess - 1, 0.0), abs=1e-9)
    days = test.drawn_variance(10_000, np.random.default_rng(1))
    # The median of the posterior, by scipy: what scatters in all is n / chi squared times what was found.
    expected = excess * 27 / chdtri(27, 0.5) - 1 if is_shown else 0.0
    assert np.median(days) == pytest.approx(0.1**2 * expected, abs=0.001)
    assert days.any() == is_shown


def test_two_sessions_say_nothing_and_days_need_three() -> None:
    assert judge(history(np.zeros((2, 3)))) == Judged((), {})
    assert day_to_day(history(np.zeros((2, 3)))) == {}


def test_a_sigma_that_nothing_tells_is_left_out() -> None:
    assert judge(history(drawn(np.random.default_rng(4)), freedom=np.zeros(3))).changes == ()


def test_gravity_of_another_place_is_no_change_of_scale() -> None:
    values = drawn(np.random.default_rng(5), s=0.0)
    values[5:] += 3.0
    here = history(values, kind="scale", by_gravity=np.full(3, 3.0))
    there = history(values, kind="scale", by_gravity=np.full(3, 3.0), site="there")
    assert judge(here).news
    assert not judge([*here[:5], *there[5:]]).news


def test_another_setup_adds_what_both_models_hide() -> None:
    values = drawn(np.random.default_rng(6), s=0.0)
    values[5:] += 3.0
    one = history(values, kind="angle", hidden=4.0 * np.eye(3))
    other = history(values, kind="angle", hidden=4.0 * np.eye(3), setup="other")
    assert judge(one).news
    assert not judge([*one[:5], *other[5:]]).news


def test_a_forecast_follows_a_drift_by_hand() -> None:
    values = drawn(np.random.default_rng(7))
    values[:, 2] += 0.05 * EVERY_DAYS * np.arange(10)
    sessions = history(values)
    found = forecast(sessions, judge(sessions), "bias", file_sigma=0.1, wanted=5.0)
    assert isinstance(found, Forecast)
    assert found.days == pytest.approx(5.0 / 0.05, rel=0.1)
    assert found.low_days < 100 < found.high_days
    assert found.span_days == 270


def test_a_forecast_follows_a_random_walk() -> None:
    rng = np.random.default_rng(8)
    values = drawn(rng, 20, s=0.05) + np.cumsum(0.5 * rng.standard_normal((20, 3)), axis=0)
    sessions = history(values)
    found = forecast(sessions, Judged((), {}), "bias", file_sigma=0.1, wanted=1.0)
    assert isinstance(found, Forecast)
    # 0.25 of variance in 30 days: 1 less what is there from the first takes some 118 days.
    assert found.low_days < 118 < found.high_days
    assert found.days == pytest.approx(118, rel=0.5)


def test_without_enough_sessions_nothing_is_forecast() -> None:
    sessions = history(drawn(np.random.default_rng(9), 4))
    assert forecast(sessions, judge(sessions), "bias", file_sigma=0.1, wanted=5.0) == NoForecast("short", 4)
    assert forecast(sessions, judge(sessions), "scale", file_sigma=0.1, wanted=5.0) == NoForecast("short", 4)


def test_an_accuracy_below_what_days_do_is_never_reached() -> None:
    sessions = history(drawn(np.random.default_rng(10)))
    found = forecast(sessions, judge(sessions), "bias", file_sigma=0.1, wanted=0.2)
    assert isinstance(found, NoForecast)
    assert found.why == "now"
    assert found.now > 0.2


def test_a_hidden_variance_below_zero_is_none() -> None:
    values = drawn(np.random.default_rng(5))
    hidden = np.diag([-2.0, 1.0, 4.0])
    hidden[0, 1] = hidden[1, 0] = 0.5
    judged = [
        judge([*history(values[:5], hidden=part), *history(values[5:], hidden=part, setup="other")])
        for part in (hidden, np.diag([0.0, 1.0, 4.0]))
    ]
    assert judged[0] == judged[1]
