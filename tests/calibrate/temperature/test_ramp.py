"""Ramps in windows of time: blocks, rate, lag, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.temperature.fit import TemperatureData, fit_temperature
from imufield.calibrate.temperature.ramp import RampWindows, cut_ramp, ramp_sentences
from imufield.errors import CalibrationError, Reason
from tests.refused import refused
from tests.told import keys

pytestmark = pytest.mark.numerical

NOISE = 1e-4


def windows(*, lag_s: float = 0.0, hysteresis: float = 0.0, span: float = 70.0, seconds: float = 7200.0) -> RampWindows:
    """Return a warming that slows down and a cooling, as a freezer and a room make them."""
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, seconds, 10.0)
    half = seconds / 2
    warming = -20 + span * (1 - np.exp(-time_s / (half / 3)))
    top = -20 + span * (1 - np.exp(-3.0))
    true = np.where(time_s < half, warming, -20 + (top + 20) * np.exp(-(time_s - half) / (half / 3)))
    rate = np.gradient(true, time_s)
    force = np.tile([0.0, 5.0, 8.4], (len(time_s), 1))
    slope = np.array([2e-3, -1e-3, 3e-3])
    output = force + slope * true[:, None] + 1e-5 * true[:, None] ** 2 + NOISE * rng.normal(size=force.shape)
    output += hysteresis * np.sign(rate)[:, None]
    return RampWindows(time_s=time_s, temperature_degc=true - lag_s * rate, output=output, specific_force_m_s2=force)


def test_blocks_are_means_of_both_branches() -> None:
    ramp = cut_ramp(windows())
    assert 40 <= len(ramp.blocks) <= 84
    assert set(ramp.blocks.direction) >= {-1.0, 1.0}
    assert np.median(ramp.blocks.sigma) < NOISE
    assert abs(ramp.lag_s) < 2
    truth = (
        ramp.blocks.temperature_degc[:, None] * [2e-3, -1e-3, 3e-3]
        + [0, 5, 8.4]
        + 1e-5 * ramp.blocks.temperature_degc[:, None] ** 2
    )
    assert np.sqrt(np.mean(((ramp.blocks.output - truth) / ramp.blocks.sigma) ** 2)) < 1.6


def test_a_lagging_thermometer_is_found_and_taken_out() -> None:
    ramp = cut_ramp(windows(lag_s=40.0))
    assert ramp.lag_s == pytest.approx(40, abs=4)
    assert "ramp.lag" in keys(ramp_sentences(ramp, "warm"))


def test_hysteresis_is_no_lag() -> None:
    assert cut_ramp(windows(hysteresis=2e-3)).lag_s == 0.0


def test_a_coarse_thermometer_neither_hides_hysteresis_nor_lags() -> None:
    slow = windows(hysteresis=2e-3, seconds=40000.0)
    ramp = cut_ramp(replace(slow, temperature_degc=np.round(slow.temperature_degc * 2) / 2))
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[ramp.blocks])).temperature
    assert ramp.lag_s == 0.0
    np.testing.assert_allclose(found.hysteresis, 2e-3, rtol=0.25)


def test_a_soak_at_the_end_is_no_way_back() -> None:
    whole = windows(seconds=20000.0)
    rising = whole.time_s < 8000
    top = float(whole.temperature_degc[rising][-1])
    soaked = replace(whole, temperature_degc=np.where(rising, whole.temperature_degc, top))
    assert "ramp.one_way" in keys(ramp_sentences(cut_ramp(soaked), "soaked"))


def test_an_axis_that_stands_still_leaves_the_others_their_orders() -> None:
    still = windows()
    still.output[:, 0] = 1.25
    found = fit_temperature(TemperatureData(reference_degc=20.0, ramps=[cut_ramp(still).blocks])).temperature
    assert found.bias.order >= 1
    np.testing.assert_allclose(found.bias.coefficients[0][1:], [-1e-3 + 4e-4, 3e-3 + 4e-4], atol=2e-4)
    np.testing.assert_allclose(found.bias.coefficients[0][0], 0.0, atol=1e-6)


def test_a_fast_ramp_and_one_way_are_told() -> None:
    fast = cut_ramp(windows(seconds=1600.0))
    assert fast.fastest_degc_per_min > 2
    assert "ramp.fast" in keys(ramp_sentences(fast, "dryer"))
    whole = windows(seconds=20000.0)
    rising = whole.time_s < 10000
    one_way = RampWindows(**{name: getattr(whole, name)[rising] for name in RampWindows.__slots__})
    assert keys(ramp_sentences(cut_ramp(one_way), "one")) == ["ramp.one_way"]


def test_too_little_and_a_turn_are_refused() -> None:
    with refused(CalibrationError, Reason.TOO_FEW, key="ramp.short"):
        cut_ramp(windows(span=8.0))
    turned = windows()
    force = turned.specific_force_m_s2.copy()
    force[300:] = [5.0, 0.0, 8.4]
    with refused(CalibrationError, Reason.BAD_DATA, key="ramp.moved"):
        cut_ramp(replace(turned, specific_force_m_s2=force))
    # One degree is 17 mg, more than the drift of most instruments.
    force = turned.specific_force_m_s2.copy()
    force[300:] += [0.15, 0.0, 0.0]
    with refused(CalibrationError, Reason.BAD_DATA, key="ramp.moved"):
        cut_ramp(replace(turned, specific_force_m_s2=force))
    # A gyroscope feels none.
    cut_ramp(replace(turned, specific_force_m_s2=np.zeros_like(force)))
