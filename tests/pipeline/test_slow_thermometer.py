"""A thermometer that lags behind the sensor, in ramps and in sessions whose temperature changes: both are corrected for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.models import at_temperature, predict, predict_gyroscope
from imufield.calibrate.model.result import GyroscopeCalibration, GyroscopeParameters
from imufield.calibrate.model.temperature_polynomials import Polynomials
from imufield.calibrate.temperature.fit import TemperatureData, TemperatureFit, fit_temperature
from imufield.calibrate.temperature.ramp import Ramp, RampWindows, cut_ramp
from imufield.deliver.parameters.context import Context, InstrumentFacts, SessionFacts
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.pipeline import temperature
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.pipeline.temperature import RampMeans, with_temperature
from tests.pipeline.test_over_temperature import GRAVITY, NOISE_M_S2, OVER_TEMPERATURE, TRUTH, UP, observed
from tests.told import told

pytestmark = pytest.mark.numerical

LAG_S = 240.0
SCALE_SIGMA = 5e-5
NONE = np.zeros((3, 3))
RATES = GyroscopeParameters(np.ones(3), NONE, np.array([1e-3, -2e-3, 3e-3]), NONE)
RATES_OVER_TEMPERATURE = replace(
    OVER_TEMPERATURE,
    bias=Polynomials(np.array([[1e-5, -2e-5, 1.5e-5], [1e-7, 1e-7, -1e-7]]), np.zeros((3, 2, 2))),
    scale=Polynomials(np.array([[1e-4, -8e-5, 1.2e-4]]), np.zeros((3, 1, 1))),
)


def session(sensor_degc: float, degc_per_min: float, rng: np.random.Generator) -> Parameters:
    """Return a session at a temperature of the sensor; the thermometer is behind by as much as it changes in the lag."""
    at_rest = observed(sensor_degc)
    since_s = at_rest.start_s - at_rest.start_s.mean()
    observations = replace(at_rest, temperature_degc=sensor_degc + degc_per_min / 60 * (since_s - LAG_S))
    facts = SessionFacts(
        name=f"at {sensor_degc:g}", sha256=64 * "b", sample_rate_hz=100.0, temperature_degc=(sensor_degc, sensor_degc)
    )
    context = Context(instrument=InstrumentFacts(serial_number="A1"), session=facts)
    settings = SolveSettings(model="linear", grade="industrial")
    solved = calibrate(SolveInput(observations=observations, gravity=GRAVITY, context=context), settings)
    truth = at_temperature(RATES, RATES_OVER_TEMPERATURE, sensor_degc)
    found = replace(truth, scale=truth.scale * (1 + SCALE_SIGMA * rng.normal(size=3)))
    sigma = GyroscopeParameters(np.full(3, SCALE_SIGMA), NONE, np.full(3, 2e-5), NONE)
    gyroscope = GyroscopeCalibration(parameters=found, sigma=sigma, path="made up")
    quality = replace(solved.calibration.quality, gyroscope_verdict="good")
    calibration = replace(solved.calibration, gyroscope=gyroscope, quality=quality)
    return from_document(to_document(calibration, observations, context))


def ramp(rng: np.random.Generator) -> RampMeans:
    """Return a ramp of two hours up and two down, one pose."""
    time_s = np.arange(0.0, 14400.0, 10.0)
    at_degc = 20 - 40 * np.cos(2 * np.pi * time_s / 14400)
    force = GRAVITY.gravity_m_s2 * UP / np.linalg.norm(UP)
    output = np.vstack([predict(at_temperature(TRUTH, OVER_TEMPERATURE, degc), force) for degc in at_degc])
    rates = np.vstack([predict_gyroscope(at_temperature(RATES, RATES_OVER_TEMPERATURE, degc), NONE[:1]) for degc in at_degc])
    return RampMeans(
        name="ramp",
        sha256=64 * "c",
        time_s=time_s,
        temperature_degc=at_degc - LAG_S * np.gradient(at_degc, time_s),
        accelerometer=output + NOISE_M_S2 * rng.normal(size=output.shape),
        gyroscope=rates + 1e-6 * rng.normal(size=rates.shape),
    )


@pytest.mark.parametrize("degc_per_min", [(0.6, 0.0, -0.6), (0.6, 0.6, 0.6), (-0.6, 0.0, 0.6)])
def test_sessions_that_warm_or_cool_are_where_the_sensor_was(degc_per_min: Sequence[float]) -> None:
    rng, off = np.random.default_rng(4), []
    for _ in range(3):
        found = [session(degc, rate, rng) for degc, rate in zip((-18.0, 20.0, 55.0), degc_per_min, strict=True)]
        joint = with_temperature(found[1], found, [ramp(rng)])
        assert joint.calibration.quality.verdict == "good"
        for degc in (-15.0, 50.0):
            there = joint.at(degc).calibration
            assert there.gyroscope is not None
            truth = (
                at_temperature(RATES, RATES_OVER_TEMPERATURE, degc).scale,
                at_temperature(TRUTH, OVER_TEMPERATURE, degc).scale,
            )
            off.append((there.gyroscope.parameters.scale - truth[0]) / there.gyroscope.sigma.scale)
            off.append((there.accelerometer.scale - truth[1]) / there.accelerometer_sigma.scale)
    assert np.abs(off).max() < 4
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.4


@pytest.mark.parametrize("flat", ["accelerometer", "gyroscope"])
def test_a_lag_that_one_triad_shows_is_taken_out_of_both_and_told(flat: str) -> None:
    """The other triad hardly changes with temperature: that none was found there is no lag of zero."""
    rng = np.random.default_rng(4)
    found, shown = [session(degc, 0.6, rng) for degc in (-18.0, 20.0, 55.0)], ramp(rng)
    still = np.mean(getattr(shown, flat), axis=0) + 1e-4 * rng.normal(size=(len(shown.time_s), 3))
    fitted: list[TemperatureData] = []
    lags_s: list[float] = []

    def seen_fit(data: TemperatureData) -> TemperatureFit:
        fitted.append(data)
        return fit_temperature(data)

    def seen_cut(windows: RampWindows, *known_lag_s: float) -> Ramp:
        cut = cut_ramp(windows, *known_lag_s)
        lags_s.append(cut.lag_s)
        return cut

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(temperature, "fit_temperature", seen_fit)
        patch.setattr(temperature, "cut_ramp", seen_cut)
        joint = with_temperature(found[1], found, [replace(shown, **{flat: still})])
    assert [words.values["lag_s"] for words in told(joint.calibration.quality.reasons, "ramp.lag")] == [
        pytest.approx(LAG_S, abs=15)
    ]
    assert lags_s[-2:] == pytest.approx([LAG_S, LAG_S], abs=15)
    for data in fitted:
        assert data.points is not None
        np.testing.assert_allclose(data.points.temperature_degc, (-18, 20, 55), atol=0.2)
