"""The error simulator: equations, noise, quantisation, saturation, loss, streaming."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.models import recover
from imufield.deliver.parameters.apply import correct_gyroscope
from imufield.errors import Reason, UsageError
from imufield.samples import SampleUnits, Status
from imufield.simulate.truth.grades import (
    GRADES,
    REFERENCE_TEMPERATURE_DEGC,
    TACTICAL,
    Grade,
    TrueInstrument,
    draw_truth,
    find_grade,
    perfect_instrument,
)
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import TrueMotion
from tests.refused import refused

RNG = np.random.default_rng(3)
QUIET = ImuSettings(rate_hz=100.0, noise=False, drift=False, quantise=False, saturate=False)


def motion_of(force: np.ndarray, rate: np.ndarray | None = None, rate_hz: float = 100.0) -> TrueMotion:
    n = len(force)
    time_s = np.arange(n) / rate_hz
    return TrueMotion(time_s, np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 3)) if rate is None else rate, force)


def drawn(grade_name: str = "mems", delay_s: float = 0.0) -> TrueInstrument:
    return replace(draw_truth(find_grade(grade_name), np.random.default_rng(1)), triad_delay_s=delay_s)


@pytest.mark.parametrize("grade", GRADES)
def test_quiet_instrument_is_undone_by_its_parameters(grade: str) -> None:
    instrument = drawn(grade)
    force, rate = 9.8 * RNG.standard_normal((100, 3)), RNG.standard_normal((100, 3))
    samples = Imu(instrument, 1, QUIET).feed(motion_of(force, rate))
    np.testing.assert_allclose(recover(instrument.accelerometer, samples.accelerometer), force, atol=1e-10)
    np.testing.assert_allclose(correct_gyroscope(instrument.gyroscope, samples.gyroscope, force), rate, atol=1e-10)
    assert np.all(samples.status == Status.GOOD)


def test_equations_by_hand() -> None:
    """One sample worked out with pencil and paper: T yz = 0.01, K 2, b 0.5, K2 0.001; E xz = 0.02, e 0.1, G zx = 0.003."""
    instrument = perfect_instrument(TACTICAL)
    misaligned, turned, sensitive = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    misaligned[1, 2], turned[0, 2], sensitive[2, 0] = 0.01, 0.02, 0.003
    accelerometer = replace(
        instrument.accelerometer,
        scale=np.full(3, 2.0),
        bias_m_s2=np.full(3, 0.5),
        misalignment_rad=misaligned,
        quadratic=np.full(3, 0.001),
        raw_zero=np.full(3, 100.0),
    )
    gyroscope = replace(instrument.gyroscope, bias=np.full(3, 0.1), misalignment_rad=turned, g_sensitivity=sensitive)
    unit = replace(instrument, accelerometer=accelerometer, gyroscope=gyroscope)
    samples = Imu(unit, 1, QUIET).feed(motion_of(np.array([[1.0, 2.0, 10.0]]), np.array([[0.1, 0.2, 0.3]])))
    # The misaligned y axis feels 2.1.
    np.testing.assert_allclose(samples.accelerometer, [[103.001, 105.20441, 121.1]])
    np.testing.assert_allclose(samples.gyroscope, [[0.206, 0.3, 0.403]])


def test_temperature_moves_bias_and_scale() -> None:
    instrument = replace(
        perfect_instrument(TACTICAL),
        accelerometer_bias_per_degc=np.full(3, 0.01),
        gyroscope_scale_per_degc=np.full(3, 1e-3),
    )
    settings = replace(QUIET, temperature_degc=REFERENCE_TEMPERATURE_DEGC + 10)
    samples = Imu(instrument, 1, settings).feed(motion_of(np.full((2, 3), 5.0), np.ones((2, 3))))
    np.testing.assert_allclose(samples.accelerometer, 5.1)
    np.testing.assert_allclose(samples.gyroscope, 1.01)
    np.testing.assert_allclose(samples.temperature_degc, 35.0)


def test_warm_up_starts_cold_and_ends_warm() -> None:
    settings = replace(QUIET, rate_hz=0.1, warm_up=True)
    samples = Imu(perfect_instrument(TACTICAL), 1, settings).feed(motion_of(np.zeros((1000, 3)), rate_hz=0.1))
    assert samples.temperature_degc[0] == REFERENCE_TEMPERATURE_DEGC - TACTICAL.warm_up_degc
    assert samples.temperature_degc[60] == pytest.approx(REFERENCE_TEMPERATURE_DEGC - TACTICAL.warm_up_degc / np.e)
    assert samples.temperature_degc[-1] == pytest.approx(REFERENCE_TEMPERATURE_DEGC, abs=1e-5)


@pytest.mark.parametrize("rate_hz", [100.0, 2000.0])
def test_white_noise_has_the_density_at_any_rate(rate_hz: float) -> None:
    """Allan deviation of 0.5 s means: density / sqrt(0.5)."""
    settings = ImuSettings(rate_hz=rate_hz, drift=False, quantise=False)
    samples = Imu(perfect_instrument(TACTICAL), 1, settings).feed(motion_of(np.zeros((int(400 * rate_hz), 3)), rate_hz=rate_hz))
    for values, density in (
        (samples.accelerometer, TACTICAL.accelerometer.noise_density),
        (samples.gyroscope, TACTICAL.gyroscope.noise_density),
    ):
        means = values.reshape(800, -1, 3).mean(axis=1)
        allan = np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2))
        # 799 x 3 differences: 2 % of statistical spread
        assert allan == pytest.approx(density / np.sqrt(0.5), rel=0.06)


@pytest.mark.parametrize("grade", [TACTICAL, GRADES["mems"]], ids=lambda grade: grade.name)
def test_outputs_are_whole_steps(grade: Grade) -> None:
    samples = Imu(drawn(grade.name), 1, ImuSettings()).feed(motion_of(np.full((500, 3), 5.0)))
    for values, triad in ((samples.accelerometer, grade.accelerometer), (samples.gyroscope, grade.gyroscope)):
        steps = values / triad.lsb_si
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        assert len(np.unique(steps)) > 2


def test_quantisation_error_is_uniform() -> None:
    settings = replace(QUIET, quantise=True)
    force = RNG.uniform(-10, 10, (20000, 3))
    error = (Imu(perfect_instrument(GRADES["mems"]), 1, settings).feed(motion_of(force)).accelerometer - force) / GRADES[
        "mems"
    ].accelerometer.lsb_si
    assert np.abs(error).max() <= 0.5 + 1e-9
    assert error.std() == pytest.approx(1 / np.sqrt(12), rel=0.02)


def test_saturation_clips_and_flags() -> None:
    force = np.zeros((4, 3))
    force[1, 0], force[2, 2] = 200.0, -200.0
    rate = np.zeros((4, 3))
    rate[2, 1] = 30.0
    limit = TACTICAL.accelerometer.range_si
    samples = Imu(perfect_instrument(TACTICAL), 1, replace(QUIET, saturate=True)).feed(motion_of(force, rate))
    assert samples.accelerometer[1, 0] == limit
    assert samples.accelerometer[2, 2] == -limit
    assert samples.gyroscope[2, 1] == TACTICAL.gyroscope.range_si
    both = Status.ACCELEROMETER_SATURATED | Status.GYROSCOPE_SATURATED
    assert samples.status.tolist() == [0, Status.ACCELEROMETER_SATURATED, both, 0]


def test_delay_shifts_the_gyroscope_only() -> None:
    ramp = np.repeat(np.arange(50.0)[:, np.newaxis], 3, axis=1)
    instrument = replace(perfect_instrument(TACTICAL), triad_delay_s=0.0025)
    samples = Imu(instrument, 1, replace(QUIET, rate_hz=1000.0)).feed(motion_of(ramp, ramp))
    np.testing.assert_allclose(samples.accelerometer, ramp)
    np.testing.assert_allclose(samples.gyroscope[6:], ramp[6:] - 2.5, atol=1e-9)
    assert np.all(np.abs(samples.gyroscope[:6]) < 6)


def test_a_negative_delay_shifts_the_accelerometer_only() -> None:
    ramp = np.repeat(np.arange(50.0)[:, np.newaxis], 3, axis=1)
    instrument = replace(perfect_instrument(TACTICAL), triad_delay_s=-0.0025)
    samples = Imu(instrument, 1, replace(QUIET, rate_hz=1000.0)).feed(motion_of(ramp, ramp))
    np.testing.assert_allclose(samples.gyroscope, ramp)
    np.testing.assert_allclose(samples.accelerometer[6:], ramp[6:] - 2.5, atol=1e-9)


@pytest.mark.parametrize("delay_s", [0.0005, 0.002, 0.005, 0.01])
def test_a_delay_takes_nothing_from_a_tremor(delay_s: float) -> None:
    """Sampled at 100 Hz, 12 Hz is as large after the delay as before, and late by it."""
    time_s = np.arange(500) / 100.0
    instrument = replace(perfect_instrument(TACTICAL), triad_delay_s=delay_s)
    rate = np.repeat(np.sin(2 * np.pi * 12 * time_s)[:, np.newaxis], 3, axis=1)
    found = Imu(instrument, 1, replace(QUIET, rate_hz=100.0)).feed(motion_of(np.zeros_like(rate), rate)).gyroscope[10:]
    late = np.sin(2 * np.pi * 12 * (time_s[10:] - delay_s))
    np.testing.assert_allclose(found, np.repeat(late[:, np.newaxis], 3, axis=1), atol=0.006)


def test_losses_leave_gaps_that_are_marked() -> None:
    imu = Imu(perfect_instrument(TACTICAL), 1, replace(QUIET, loss_probability=0.05))
    samples = imu.feed(motion_of(np.zeros((5000, 3))))
    assert 150 < imu.samples_lost < 350
    assert len(samples) + imu.samples_lost == 5000
    after_gap = np.diff(samples.counter) > 1
    assert np.array_equal((samples.status[1:] & np.uint32(Status.AFTER_GAP)) != 0, after_gap)


def test_clock_error_changes_the_true_interval_not_the_stamps() -> None:
    imu = Imu(replace(perfect_instrument(TACTICAL), clock_error_ppm=100.0), 1, QUIET)
    assert imu.interval_s == pytest.approx(0.01 * (1 - 1e-4), rel=1e-7)
    assert imu.feed(motion_of(np.zeros((3, 3)))).time_s.tolist() == [0.0, 0.01, 0.02]
    assert imu.to_sample_clock(1000 * imu.interval_s) == pytest.approx(10.0)


def test_increments_lose_nothing_to_quantisation() -> None:
    units = SampleUnits(accelerometer="pulse", gyroscope="pulse", accelerometer_is_increment=True, gyroscope_is_increment=True)
    fine = replace(TACTICAL.accelerometer, lsb_si=0.5)
    grade = replace(TACTICAL, units=units, accelerometer=fine, accelerometer_scale=2.0)
    imu = Imu(perfect_instrument(grade), 1, replace(QUIET, quantise=True))
    samples = [imu.feed(motion_of(np.full((70, 3), 1.234))) for _ in range(10)]
    pulses = np.concatenate([block.accelerometer for block in samples])
    # 0.5 m/s^2 at scale 2 is one pulse per second, hence 0.01 pulses per sample are one step.
    total = pulses.sum(axis=0)
    np.testing.assert_allclose(total, 700 * 0.01 * 2.468, atol=0.01)
    assert samples[0].units.interval_s == 0.01
    np.testing.assert_allclose(samples[0].accelerometer_rate().mean(axis=0), 2.468, atol=0.02)


def test_blocks_of_any_size_give_the_same_samples() -> None:
    settings = ImuSettings(rate_hz=100.0, warm_up=True, loss_probability=0.01)
    force, rate = 9.8 * RNG.standard_normal((3000, 3)), RNG.standard_normal((3000, 3))
    instrument = drawn(delay_s=0.015 / 2)
    whole = Imu(instrument, 5, settings).feed(motion_of(force, rate))
    imu = Imu(instrument, 5, settings)
    cuts = [0, 1, 2, 10, 640, 641, 1999, 3000]
    parts = [imu.feed(motion_of(force[a:b], rate[a:b])) for a, b in itertools.pairwise(cuts)]
    for name in ("time_s", "accelerometer", "gyroscope", "temperature_degc", "counter", "status"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_allclose(joined, getattr(whole, name), rtol=1e-12, atol=1e-12)


def test_mean_drift_is_what_a_calibration_sees_on_top_of_the_bias() -> None:
    imu = Imu(perfect_instrument(TACTICAL), 1, replace(QUIET, drift=True))
    samples = [imu.feed(motion_of(np.full((1000, 3), 1.0))) for _ in range(3)]
    mean = np.concatenate([np.hstack([block.accelerometer - 1.0, block.gyroscope]) for block in samples]).mean(axis=0)
    np.testing.assert_allclose(imu.mean_drift, mean, rtol=1e-9)
    assert np.all(np.abs(mean) > 0)


def test_seed_decides() -> None:
    force = np.zeros((100, 3))
    first, again, other = (Imu(drawn(), seed, ImuSettings()).feed(motion_of(force)) for seed in (1, 1, 2))
    assert np.array_equal(first.gyroscope, again.gyroscope)
    assert not np.array_equal(first.gyroscope, other.gyroscope)


def test_empty_block() -> None:
    assert len(Imu(drawn(), 1).feed(motion_of(np.empty((0, 3))))) == 0


@pytest.mark.parametrize(
    ("settings", "delay_s", "fact", "key"),
    [
        (ImuSettings(rate_hz=0.0), 0.0, "0 Hz", "imu.rate"),
        (ImuSettings(loss_probability=1.0), 0.0, "0 to 1", "imu.loss"),
        (ImuSettings(), 0.5, "0.5 s", "imu.delay"),
    ],
    ids=["rate", "loss", "delay"],
)
def test_senseless_settings_are_refused(settings: ImuSettings, delay_s: float, fact: str, key: str) -> None:
    with refused(UsageError, Reason.USAGE, fact, key=key):
        Imu(drawn(delay_s=delay_s), 1, settings)
