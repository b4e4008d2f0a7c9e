"""The whole check on simulated recordings: what it finds, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from at_rest import DEG_PER_HOUR, GRAVITY_M_S2, LATITUDE_DEG, MICRO_G, as_sent, perfect, random_attitude, recording

from imufield.calibrate.model.result import Calibration
from imufield.deliver.navigation.alignment import Heading, rotation
from imufield.deliver.navigation.static_navigation import CheckSettings, NavigationResult, StaticNavigation
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import Samples, Status, concatenate
from tests.refused import refused
from tests.told import keys

SETTINGS = CheckSettings(latitude_deg=LATITUDE_DEG, gravity_m_s2=GRAVITY_M_S2, align_s=300.0, runs=200)


def check(
    samples: Samples, settings: CheckSettings = SETTINGS, calibration: Calibration | None = None, block: int = 500
) -> NavigationResult:
    run = StaticNavigation({"after": as_sent}, settings)
    for first in range(0, len(samples), block):
        run.feed(samples[first : first + block])
    return run.finish(calibration)


def turned_over(duration_s: float, at_s: float, **errors: Any) -> Samples:
    """Half a turn in 4 s about the body x axis, which is level."""
    attitude = rotation(np.array([0, 0, 0.7]))
    rate_hz, turn_s = 10.0, 4.0
    before = recording(attitude, at_s, rate_hz, **errors)
    after = recording(attitude @ rotation(np.array([np.pi, 0, 0])), duration_s - at_s - turn_s, rate_hz, **errors)
    n = round(turn_s * rate_hz)
    angle = np.pi * np.arange(1, n) / n
    during = recording(attitude, (n - 2) / rate_hz, rate_hz, **errors)
    turns = [rotation(np.array([one, 0, 0])).T for one in angle]
    force = np.array([R @ row for R, row in zip(turns, during.accelerometer, strict=True)])
    rate = np.array([R @ row for R, row in zip(turns, during.gyroscope, strict=True)])
    # Trapezoids between rest and full speed: half a sample is missing at both ends.
    rate[:, 0] += np.pi / ((n - 1) / rate_hz)
    during = replace(during, time_s=at_s + np.arange(1, n) / rate_hz, accelerometer=force, gyroscope=rate)
    after = replace(after, time_s=after.time_s + at_s + turn_s)
    return concatenate([before, during, after])


def test_constant_force_error_is_hidden_by_the_alignment() -> None:
    drift = check(recording(random_attitude(1), 4 * 3600, force=(100 * MICRO_G, 0, 0))).drifts["after"]
    # docs/maths.md, static navigation: about half of the 0.9 nmi that it makes with the true attitude.
    assert drift.position_nmi.max() < 0.6


def test_noise_alone_is_within_its_forecast_in_most_seeds() -> None:
    inside = 0
    for seed in range(6):
        result = check(recording(random_attitude(seed), 1800, 5.0, noise=1.0, seed=seed), calibration=perfect())
        inside += result.forecast.holds(result.drifts["after"])
    assert inside >= 5


def test_an_error_beyond_the_stated_uncertainty_is_found() -> None:
    samples = recording(random_attitude(3), 3600, 2.0, rate=(0.5 * DEG_PER_HOUR, 0.5 * DEG_PER_HOUR, 0), noise=1.0)
    settings = replace(SETTINGS, instability=np.zeros(6))
    result = check(samples, settings, perfect(10 * MICRO_G, 0.005 * DEG_PER_HOUR))
    assert not result.forecast.holds(result.drifts["after"])
    assert result.forecast.sources["gyroscope calibration"] > result.forecast.sources["accelerometer calibration"]


def test_a_turn_on_bias_that_is_not_given_is_the_instability() -> None:
    samples = recording(random_attitude(3), 900, 2.0, noise=1.0)
    instability = np.repeat([5 * MICRO_G, 0.02 * DEG_PER_HOUR], 3)
    settings = replace(SETTINGS, instability=instability)

    def turn_on_part(*given: float) -> float:
        turned_on = replace(settings, turn_on=np.repeat(given, 3))
        return check(samples, turned_on, perfect(10 * MICRO_G, 0.005 * DEG_PER_HOUR)).forecast.sources["turn-on bias"]

    one = turn_on_part(50 * MICRO_G, np.nan)
    assert one == turn_on_part(50 * MICRO_G, instability[3])
    assert one > 1.1 * turn_on_part(50 * MICRO_G, 0.0)


def test_turning_over_shows_the_accelerometer() -> None:
    error = (200 * MICRO_G, 200 * MICRO_G, 0)
    turned = check(turned_over(1800, 320, force=error), replace(SETTINGS, turned=True)).drifts["after"]
    untouched = check(recording(rotation(np.array([0, 0, 0.7])), 1800, 10.0, force=error)).drifts["after"]
    assert turned.position_nmi.max() > 3 * untouched.position_nmi.max()


def test_moves_are_refused_unless_announced() -> None:
    samples = turned_over(900, 400)
    with refused(RecordingError, Reason.BAD_DATA, "--turned", key="check.moved") as caught:
        check(samples)
    assert caught.value.values["at_s"] == 400
    with refused(RecordingError, Reason.BAD_DATA, "--turned", "20 deg", key="check.not_turned") as caught:
        check(recording(random_attitude(0), 900, 10.0), replace(SETTINGS, turned=True))
    assert "turned_deg" in caught.value.values
    with refused(RecordingError, Reason.BAD_DATA, "--align-s", key="check.moves_in_alignment") as caught:
        check(turned_over(900, 100), replace(SETTINGS, turned=True))
    assert caught.value.values["at_s"] == 100


def test_too_short_a_recording_says_what_it_needs() -> None:
    with refused(RecordingError, Reason.TOO_FEW, key="check.too_short") as caught:
        check(recording(random_attitude(0), 200))
    assert caught.value.values["duration_s"] == 200
    assert caught.value.values["needed_s"] == 360
    assert caught.value.reason is Reason.TOO_FEW


def test_too_short_an_alignment_is_refused() -> None:
    with refused(UsageError, Reason.USAGE, "--align-s", key="check.align_s") as caught:
        StaticNavigation({"after": as_sent}, replace(SETTINGS, align_s=5.0))
    assert caught.value.values["align_s"] == 5


def test_values_that_are_no_numbers_are_bridged_up_to_a_limit() -> None:
    samples = recording(random_attitude(0), 900, 10.0)
    samples.accelerometer[4000:4010] = np.nan
    samples.status[5000] |= np.uint32(Status.GYROSCOPE_SATURATED)
    samples.gyroscope[5000] = 5.0
    result = check(samples)
    assert result.lost == 11
    assert result.drifts["after"].position_nmi.max() < 1e-4
    samples.gyroscope[::20] = np.nan
    with refused(RecordingError, Reason.NOT_FINITE, "1%", key="check.lost") as caught:
        check(samples)
    assert caught.value.values["lost"] > 0.01 * caught.value.values["total"]
    assert caught.value.reason is Reason.NOT_FINITE


def test_a_recording_without_gyroscope_is_refused_for_that() -> None:
    samples = recording(random_attitude(0), 900, 10.0)
    samples.gyroscope[:] = np.nan
    with refused(RecordingError, Reason.BAD_DATA, key="check.no_gyroscope"):
        check(samples)


@pytest.mark.parametrize("factor", [0.0, 0.1, 1.1, 1e6])
def test_force_that_is_not_gravity_is_refused(factor: float) -> None:
    samples = recording(random_attitude(0), 900, 10.0)
    samples = replace(samples, accelerometer=factor * samples.accelerometer)
    with refused(RecordingError, Reason.GRAVITY, "5%", key="check.no_gravity") as caught:
        check(samples)
    assert caught.value.values["force_m_s2"] == pytest.approx(9.8 * factor, rel=0.01)


def test_parameters_that_are_only_compared_with_may_be_nominal_but_not_absurd() -> None:
    samples = recording(random_attitude(0), 900, 10.0)

    def off(factor: float) -> NavigationResult:
        navigation = StaticNavigation(
            {"before": lambda block: as_sent(replace(block, accelerometer=factor * block.accelerometer)), "after": as_sent},
            SETTINGS,
        )
        navigation.feed(samples)
        return navigation.finish()

    assert off(1.2).drifts["before"].position_nmi.max() < 1.0
    with refused(RecordingError, Reason.NOT_FINITE, key="mechanise.diverged"):
        off(1e12)


def test_a_hole_is_refused() -> None:
    samples = recording(random_attitude(0), 900, 10.0)
    with refused(RecordingError, Reason.DAMAGED, "5 s", key="check.gap") as caught:
        check(concatenate([samples[:5000], samples[5200:]]))
    assert caught.value.values["gap_s"] == pytest.approx(20.1)
    # Milliseconds that are taken for seconds: navigated, such steps would end at no attitude.
    slow = replace(samples, time_s=1000 * samples.time_s)
    with refused(RecordingError, Reason.DAMAGED, "5 s", key="check.gap"):
        check(slow, replace(SETTINGS, align_s=60.0))


def test_no_forecast_where_north_is_a_guess() -> None:
    result = check(recording(random_attitude(1), 900, 5.0, noise=1.0), calibration=perfect(0.0, 15 * DEG_PER_HOUR))
    assert result.forecast is None
    assert keys(result.notes) == ["check.no_heading"]


def test_a_told_heading_gives_a_poor_gyroscope_its_forecast() -> None:
    attitude = rotation(np.array([0.0, 0.0, 0.7]))
    samples = recording(attitude, 1200, 5.0, rate=(8 * DEG_PER_HOUR, -6 * DEG_PER_HOUR, 5 * DEG_PER_HOUR), noise=1.0)
    calibration = perfect(0.0, 15 * DEG_PER_HOUR)
    told = check(samples, replace(SETTINGS, heading=Heading(0.7)), calibration)
    assert told.forecast is not None
    assert told.forecast.holds(told.drifts["after"])
    # A rate error b makes g b t^3 / 6 of position; 95 % of two such errors together are within 2.45 sigma.
    expected_nmi = 2.45 * GRAVITY_M_S2 * 15 * DEG_PER_HOUR * 900**3 / 6 / 1852
    assert told.forecast.position_95_nmi[-1] == pytest.approx(expected_nmi, rel=0.15)
    wrong = check(samples, replace(SETTINGS, heading=Heading(0.7 + np.pi)), calibration)
    assert wrong.drifts["after"].position_nmi.max() != told.drifts["after"].position_nmi.max()


def test_no_forecast_without_uncertainty() -> None:
    unknown = replace(perfect(), covariance=np.full((6, 6), np.nan))
    result = check(recording(random_attitude(1), 900, 5.0), calibration=unknown)
    assert result.forecast is None
    assert keys(result.notes) == ["check.no_uncertainty"]
