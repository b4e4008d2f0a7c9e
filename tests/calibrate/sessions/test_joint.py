"""The joint adjustment against weighted means by hand, and what is found between sessions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.sessions.joint import FEWEST_WITHOUT_PRIOR, Joint, SessionNumbers, adjust
from imufield.calibrate.sessions.kinds import DAILY

NAMES = (*(f"{kind} {axis}" for kind in ("bias", "scale") for axis in "xyz"), *(f"angle {pair}" for pair in ("xy", "xz", "yz")))
OPEN = dict.fromkeys(DAILY, math.inf)


def session(
    rng: np.random.Generator, *, day: float = 0.0, own: float = 0.1, site: str = "here", gravity: float = 0.0
) -> SessionNumbers:
    """Return a session whose true numbers are zero, bias and scale on its day aside."""
    by_gravity = np.array([-gravity if name.startswith("scale") else 0.0 for name in NAMES])
    daily = np.array([day * (not name.startswith("angle")) for name in NAMES])
    return SessionNumbers(
        names=NAMES,
        values=np.hypot(daily, own) * rng.standard_normal(len(NAMES)),
        covariance=own**2 * np.eye(len(NAMES)),
        by_gravity=by_gravity,
        site=site,
        freedom=12,
    )


def sessions(count: int, *, seed: int = 0, day: float = 0.0, gravity: float = 0.0) -> list[SessionNumbers]:
    rng = np.random.default_rng(seed)
    return [session(rng, day=day, gravity=gravity) for _ in range(count)]


def value(joint: Joint, name: str) -> tuple[float, float]:
    k = joint.names.index(name)
    return float(joint.values[k]), math.sqrt(joint.covariance[k, k])


def test_what_the_sessions_share_is_their_weighted_mean() -> None:
    rng = np.random.default_rng(1)
    each = [session(rng, day=1.0, own=own) for own in (0.1, 0.2, 0.4)]
    found = adjust(each, OPEN)
    weights = np.array([100.0, 25.0, 6.25])
    angles = np.array([one.values[6] for one in each])
    assert value(found, "angle xy") == pytest.approx((weights @ angles / weights.sum(), weights.sum() ** -0.5), rel=1e-9)


def test_days_far_apart_count_alike_however_well_each_is_measured() -> None:
    rng = np.random.default_rng(2)
    each = [session(rng, day=100.0, own=own) for own in (0.1, 0.2, 0.4)]
    found = adjust(each, OPEN)
    assert value(found, "bias x")[0] == pytest.approx(np.mean([one.values[0] for one in each]), rel=1e-4)


def test_a_common_gravity_is_no_change_and_does_not_average_out() -> None:
    plain, same = (adjust(sessions(4, gravity=gravity), OPEN) for gravity in (0.0, 50.0))
    known, own = plain.daily["scale"].repeatability, same.daily["scale"].repeatability
    assert (own.sigma, own.high) == pytest.approx((known.sigma, known.high), rel=1e-6)
    assert value(same, "scale x")[1] == pytest.approx(math.hypot(value(plain, "scale x")[1], 50.0), rel=0.01)
    assert same.with_gravity["here"][NAMES.index("scale x")] == pytest.approx(-50.0)
    assert same.gravity_variance["here"] == pytest.approx(1.0)


def test_gravity_of_two_sites_is_half_averaged_out() -> None:
    rng = np.random.default_rng(3)
    each = [session(rng, site=site, gravity=50.0) for site in ("here", "here", "there", "there")]
    found = adjust(each, OPEN)
    assert value(found, "scale x")[1] == pytest.approx(50 / math.sqrt(2), rel=0.05)
    assert found.gravity_variance["here"] == pytest.approx(0.5, rel=0.05)


def test_a_number_that_one_session_lacks_is_that_of_the_others() -> None:
    each = sessions(3, day=1.0)
    short = replace(
        each[0], names=NAMES[:6], values=each[0].values[:6], covariance=each[0].covariance[:6, :6], by_gravity=np.zeros(6)
    )
    found = adjust([short, *each[1:]], OPEN)
    assert value(found, "angle xy")[0] == pytest.approx(np.mean([one.values[6] for one in each[1:]]))


def test_an_outlying_session_is_named_where_the_others_outvote_it() -> None:
    each = sessions(7, day=1.0)
    off = replace(each[3], values=each[3].values + 12.0 * (np.arange(len(NAMES)) == 1))
    found = adjust([*each[:3], off, *each[4:]], OPEN)
    assert [(number.session, number.name) for number in found.outlying] == [(3, "bias y")]
    assert not adjust(each, OPEN).outlying
    assert not adjust([off, *each[: FEWEST_WITHOUT_PRIOR - 2]], OPEN).outlying


def test_an_angle_that_has_changed_is_said() -> None:
    each = sessions(4, day=1.0)
    bent = replace(each[3], values=each[3].values + 2.0 * (np.arange(len(NAMES)) == 6))
    assert adjust([*each[:3], bent], OPEN).differs
    assert not adjust(each, OPEN).differs


def test_a_number_that_only_rises_is_told() -> None:
    each = [replace(one, values=one.values + k * (np.arange(len(NAMES)) == 2)) for k, one in enumerate(sessions(3))]
    assert adjust(each, OPEN).trends == ("bias z",)
    assert adjust(each[:2], OPEN).trends == ()


def test_a_new_day_is_less_sure_than_the_mean() -> None:
    found = adjust(sessions(10, day=1.0), OPEN)
    bias = found.daily["bias"]
    assert bias.day_sigma == pytest.approx(np.full(3, math.hypot(1.0, 1.0 / math.sqrt(10))), rel=0.25)
    assert bias.mean_sigma == pytest.approx(np.full(3, 1.0 / math.sqrt(10)), rel=0.25)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0
