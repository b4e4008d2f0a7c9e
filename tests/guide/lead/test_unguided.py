"""Still intervals of the real recordings, against the reference in the folder beside the project."""

import gzip
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.model.models import recover
from imufield.calibrate.moves.moves import cut_moves
from imufield.earth import Gravity
from imufield.errors import CalibrationError, Reason
from imufield.guide.events import RefusalCode
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.pipeline.reading import ReadingCollector
from imufield.samples import Samples, SampleUnits, make_samples, no_samples
from imufield.simulate.truth.grades import draw_truth, find_grade, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu
from tests.guide.guided import find_still_intervals
from tests.refused import refused

REFERENCE = {
    "xsens": (9.81744, [414.4455, 412.1213, 414.5082], [0.858606, 1.230565, -0.973426], [0.003579, 0.009249, 0.021334]),
    "imu0": (9.81, [1.003668, 1.002879, 1.006557], [0.1022, 0.0977, 0.3433], [0.43e-3, 5.49e-3, 2.00e-3]),
    "imu2": (9.81, [1.003965, 1.003496, 1.007804], [0.0946, 0.0071, -0.0456], [0.09e-3, 5.07e-3, 4.04e-3]),
}


def load(path: Any) -> Any:
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file)


def fit_norms(mean_raw: Any, raw_zero: Any, start: Any, gravity: Any) -> Any:
    """Unweighted least squares on the norms, lower triangular T: scale, bias, misalignment and residuals."""

    def residuals(p: Any) -> Any:
        matrix = np.eye(3)
        matrix[1, 0], matrix[2, 0], matrix[2, 1] = p[6:]
        return np.linalg.norm(np.linalg.solve(matrix, ((mean_raw - raw_zero) / p[:3] - p[3:6]).T), axis=0) - gravity

    return least_squares(residuals, start, x_scale=np.abs(start) + 1e-3, xtol=1e-15, ftol=1e-15, gtol=1e-15)


@pytest.fixture(scope="module")
def xsens(shared_folder: Any) -> Any:
    force = load(shared_folder / "data" / "imu_tk" / "xsens_acc.mat.gz")
    turning = load(shared_folder / "data" / "imu_tk" / "xsens_gyro.mat.gz")
    return make_samples(force[:, 0], force[:, 1:], turning[:, 1:], units=SampleUnits(accelerometer="count", gyroscope="count"))


def test_xsens_session(xsens: Any) -> None:
    found = find_still_intervals([xsens], scale=RoughScale(raw_zero=np.full(3, 32768.0)))
    assert 36 <= len(found.observations) <= 46
    assert not found.refused
    gravity, scale, bias, misalignment = REFERENCE["xsens"]
    start = np.array([*scale, *bias, *misalignment])
    fit = fit_norms(found.observations.mean_raw, 32768, start, gravity)
    assert np.abs(fit.x[:3] / scale - 1).max() < 50e-6
    assert np.abs(fit.x[3:6] - bias).max() < 0.05 * 9.81e-3
    assert np.abs(fit.x[6:] - misalignment).max() < 0.2e-3
    assert 0.09 < 1e3 * np.sqrt(np.mean(fit.fun**2)) / 9.81 < 0.12
    assert found.axes.agrees
    assert found.axes.gyroscope_scale == pytest.approx(4770, rel=0.05)
    assert found.scale.learned


def test_xsens_session_does_not_depend_on_the_cuts(xsens: Any, cut_blocks: Any) -> None:
    scale = RoughScale(raw_zero=np.full(3, 32768.0))
    whole = find_still_intervals([xsens], scale=scale).observations
    parts = find_still_intervals(cut_blocks(xsens, [7] * 300 + [1000] * 20), scale=scale).observations
    assert parts.name == whole.name
    np.testing.assert_array_equal(parts.mean_raw, whole.mean_raw)
    np.testing.assert_array_equal(parts.covariance_raw, whole.covariance_raw)


@pytest.mark.parametrize(("name", "residual_mg"), [("imu0", 0.193), ("imu2", 0.203)])
def test_mpu_9150_session(shared_folder: Any, name: str, residual_mg: float) -> None:
    table = load(shared_folder / "data" / "mikoff" / f"{name}.log.gz")
    samples = make_samples(np.arange(len(table)) / 100, table[:, :3], table[:, 3:], units=SampleUnits())
    found = find_still_intervals([samples])
    assert 17 <= len(found.observations) <= 23
    assert not found.refused
    gravity, scale, bias, misalignment = REFERENCE[name]
    fit = fit_norms(found.observations.mean_raw, 0, np.array([*scale, *bias, *misalignment]), gravity)
    # The reference moves by so much when the settings of its own detector are swept.
    assert np.abs(fit.x[:3] - scale).max() < 2.9e-4
    assert np.abs(fit.x[3:6] - bias).max() < 1.9e-3
    assert np.abs(fit.x[6:] - misalignment).max() < 5.1e-4
    assert 1e3 * np.sqrt(np.mean(fit.fun**2)) / 9.80665 == pytest.approx(residual_mg, rel=0.1)
    assert found.axes.agrees


@pytest.mark.parametrize(("settling_deg", "settling_s"), [(3.0, 5.0), (5.0, 8.0)])
def test_a_unit_that_settles_was_put_down_once(settling_deg: float, settling_s: float) -> None:
    """Foam that gives way by degrees ends a stretch again and again; the unit was put down six times, and lay there before."""
    grade = find_grade("industrial")
    habits = OperatorSettings(hold_s=20.0, settling_rad=math.radians(settling_deg), settling_s=settling_s)
    operator = Operator(scheme("faces6").directions(), 1, habits)
    source = VirtualImu(Imu(perfect_instrument(grade), 1, ImuSettings(rate_hz=50.0)), operator)
    end_s = operator.plan_all()
    samples = source.next_block(int((end_s + 1) * 50))
    found = find_still_intervals(
        [samples], scale=RoughScale(accelerometer=grade.accelerometer_scale, gyroscope=grade.gyroscope_scale)
    )
    begins_s = np.array([still.start_s for still in operator.stills])
    placement = np.searchsorted(begins_s, found.observations.start_s) - 1
    assert placement.tolist() == list(range(len(begins_s)))
    # The longest rest of each, when it has settled.
    assert (found.observations.duration_s > 3.0).all()


def test_a_knock_makes_no_second_observation(make_path: Any) -> None:
    path = make_path(100.0).hold([0, 0, 1], 8).turn([0.01, 0.2, 1], 0.3).turn([0, 0, 1], 0.3).hold([0, 0, 1], 5)
    path.turn([1, 0, 0], 2).hold([1, 0, 0], 5)
    found = find_still_intervals([path.samples()]).observations
    assert found.name == ("free 1: near +z", "free 2: near +x")
    assert found.duration_s[0] > 6.0


def test_what_was_put_down_anew_is_another_observation(make_path: Any) -> None:
    """The same side again, and a tilt of 20 degrees that takes half a second; samples that are missing tell nothing."""
    path = (
        make_path(100.0).hold([0, 0, 1], 8).turn([0, 0, 1], 2).hold([0, 0, 1], 5).turn([0, 0.36, 1], 0.5).hold([0, 0.36, 1], 5)
    )
    samples = path.samples()
    assert len(find_still_intervals([samples]).observations) == 3
    later = replace(samples, time_s=samples.time_s + np.where(samples.time_s > 12.0, 1.5, 0.0))
    assert len(find_still_intervals([later]).observations) == 4


@pytest.mark.parametrize("units", [SampleUnits(), SampleUnits(accelerometer="count", gyroscope="count")], ids=["SI", "counts"])
@pytest.mark.parametrize("offset_g", [(0.0, 0.42, 0.49), (0.5, -0.5, 0.5)])
def test_offsets_of_half_a_g_lose_no_hold(offset_g: Any, units: SampleUnits) -> None:
    rng = np.random.default_rng(3)
    truth = draw_truth(find_grade("mems"), rng)
    truth = replace(truth, accelerometer=replace(truth.accelerometer, bias_m_s2=9.80665 * np.array(offset_g)))
    operator = Operator(rng.standard_normal((40, 3)), 3, OperatorSettings(hold_s=4.0, initial_still_s=4.0, turn_s=(1.0, 1.5)))
    samples = VirtualImu(Imu(truth, 3, ImuSettings(rate_hz=50.0)), operator).next_block(50 * 300)
    found = find_still_intervals([replace(samples, units=units)])
    assert found.refused == ()
    starts = found.observations.start_s
    # The stay before the first move is one more.
    assert sum(any(still.start_s <= start < still.end_s for start in starts) for still in operator.stills) == 41
    assert found.axes.agrees
    assert found.axes.misfit_deg < 3
    np.testing.assert_allclose(found.scale.raw_zero / 9.80665, offset_g, atol=0.06)


@pytest.mark.parametrize("name", ["imu0", "imu2"])
def test_an_offset_added_to_a_real_recording_changes_nothing_else(shared_folder: Any, name: str) -> None:
    """N + c has the observations of N, moved by c."""
    table = load(shared_folder / "data" / "mikoff" / f"{name}.log.gz")
    offset = 9.80665 * np.array([0.1, 0.42, 0.49])

    def find(added: Any) -> Any:
        return find_still_intervals(
            [make_samples(np.arange(len(table)) / 100, table[:, :3] + added, table[:, 3:], units=SampleUnits())]
        )

    without, found = find(0.0), find(offset)
    assert found.refused == without.refused
    np.testing.assert_allclose(found.observations.mean_raw - offset, without.observations.mean_raw, atol=1e-9)
    assert found.axes.agrees


def test_a_wrong_unit_is_no_offset(shared_folder: Any) -> None:
    table = load(shared_folder / "data" / "mikoff" / "imu0.log.gz")
    samples = make_samples(np.arange(len(table)) / 100, table[:, :3] / 9.80665, table[:, 3:], units=SampleUnits())
    found = find_still_intervals([samples])
    assert len(found.observations) == 0
    assert {refusal.reason for _, refusal in found.refused} == {RefusalCode.GRAVITY}
    assert all(refusal.measured == pytest.approx(1.0, abs=0.1) for _, refusal in found.refused)


def test_observations_are_named_after_the_nearest_side(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 5).turn([1, 0.1, 0], 1).hold([1, 0.1, 0], 4).samples()
    found = find_still_intervals([samples]).observations
    assert found.name == ("free 1: near +z", "free 2: near +x")
    assert np.isnan(found.direction).all()


def test_a_recording_without_a_quiet_stretch_is_refused(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 8).samples()
    samples.accelerometer[:] += np.random.default_rng(0).normal(0, 2, samples.accelerometer.shape)
    with refused(CalibrationError, Reason.TOO_FEW, "3 s", "m/s^2", key="unguided.never_quiet"):
        find_still_intervals([samples])


@pytest.mark.parametrize("scale", [None, RoughScale(), RoughScale(accelerometer=1.0, gyroscope=1.0)])
def test_an_accelerometer_that_shows_zero_is_no_rest(make_path: Any, scale: RoughScale | None) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 5).turn([1, 0.1, 0], 1).hold([1, 0.1, 0], 5).samples()
    dead = replace(samples, accelerometer=np.zeros_like(samples.accelerometer))
    with refused(CalibrationError, Reason.TOO_FEW, key="unguided.zero"):
        find_still_intervals([dead], scale=scale)
    # Where it dies in a session, that hold alone is refused.
    later = samples.time_s > samples.time_s[0] + 7.0
    found = find_still_intervals([replace(samples, accelerometer=np.where(later[:, None], 0.0, samples.accelerometer))])
    assert len(found.observations) == 1
    assert [refusal.reason for _, refusal in found.refused] == [RefusalCode.STUCK]


def test_a_recording_without_an_accelerometer_is_named(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 8).samples()
    with refused(CalibrationError, Reason.TOO_FEW, key="unguided.no_accelerometer"):
        find_still_intervals([replace(samples, accelerometer=np.full_like(samples.accelerometer, np.nan))])


def test_an_empty_recording_is_refused() -> None:
    with refused(CalibrationError, Reason.TOO_FEW, "3 s", "m/s^2", key="unguided.never_quiet"):
        find_still_intervals([no_samples(SampleUnits())])


@pytest.fixture(scope="module")
def in_hand() -> tuple[Samples, Imu, float]:
    """Return a session of one rest on a table and 13 holds in the hand, the instrument, and gravity."""
    habits = OperatorSettings(style="held", hold_s=8.0, initial_still_s=6.0, turn_s=(1.0, 3.0), sway_rad=math.radians(0.4))
    operator = Operator(scheme("paper24").directions()[:13], 4, habits)
    imu = Imu(perfect_instrument(find_grade("tactical")), 4, ImuSettings(rate_hz=100.0, drift=False))
    count = int(operator.plan_all() * 100)
    return imu.feed(operator.block(0, count, imu.interval_s)), imu, operator.site.gravity_m_s2


def test_holds_in_the_hand_are_measured_as_by_the_guide(in_hand: tuple[Samples, Imu, float]) -> None:
    samples, imu, gravity_m_s2 = in_hand
    found = find_still_intervals([samples]).observations
    # The first hold is of the side that the unit lay on, where the table tells more.
    assert len(found) == 13
    force = recover(imu.instrument.accelerometer, found.mean_raw)
    norm = np.linalg.norm(force, axis=1)
    up = force / norm[:, None]
    sigma = np.sqrt(np.einsum("ki,kij,kj->k", up, found.covariance_raw, up))
    assert np.abs((norm - gravity_m_s2) / sigma).max() < 4
    # The first was on the table.
    assert (sigma[1:] > sigma[0]).all()


@pytest.mark.parametrize(("hole_s", "closing_deg", "most"), [(0.0, 0.1, 1e-3), (0.06, 0.3, 4e-3)])
def test_moves_reach_from_a_hold_in_the_hand_to_the_next(
    in_hand: tuple[Samples, Imu, float], hole_s: float, closing_deg: float, most: float
) -> None:
    """The unit sways by 0.4 deg; its moves tell the scale of the gyroscope as if it did not, also where samples are lost."""
    samples, imu, gravity_m_s2 = in_hand
    holds = find_still_intervals([samples]).observations
    from_hole_s = np.abs(samples.time_s - (holds.start_s + holds.duration_s / 2 + 1)[:, None]).min(axis=0)
    samples = samples[np.flatnonzero(from_hole_s >= hole_s / 2)]
    found, collector = find_still_intervals([samples]).observations, ReadingCollector()
    collector.feed(samples)
    slots, ends = collector.slots(found)
    gravity = Gravity(gravity_m_s2=gravity_m_s2, sigma_m_s2=1e-5, source="typed")
    moves = cut_moves(slots, found.start_s, found.duration_s, ends, middle_s=found.middle_s)
    calibration = calibrate_accelerometer(found, gravity)
    result = calibrate_gyroscope(GyroscopeInput(observations=found, moves=moves, calibration=calibration))
    off = result.calibration.parameters.scale / imu.instrument.gyroscope.scale - 1
    sigma = result.calibration.sigma.scale / imu.instrument.gyroscope.scale
    assert len(moves) == 12
    assert result.moves.rms_after_deg < closing_deg
    assert sigma.max() < most
    assert np.abs(off / sigma).max() < 4


def test_holds_in_the_hand_do_not_depend_on_the_cuts(in_hand: tuple[Samples, Imu, float], cut_blocks: Any) -> None:
    samples = in_hand[0]
    whole = find_still_intervals([samples]).observations
    parts = find_still_intervals(cut_blocks(samples, [37] * 200 + [1500] * 20)).observations
    assert parts.name == whole.name
    np.testing.assert_allclose(parts.mean_raw, whole.mean_raw, atol=1e-12)
    np.testing.assert_allclose(parts.covariance_raw, whole.covariance_raw, rtol=1e-9)


def test_holds_in_the_hand_before_the_first_rest_count_at_any_rate(in_hand: tuple[Samples, Imu, float]) -> None:
    """The same in reverse, 20 times as fast: the rest comes 230,000 samples after the first hold."""
    samples, _, gravity_m_s2 = in_hand
    n, rng = len(samples), np.random.default_rng(3)
    at = np.linspace(0, n - 1, 20 * n)
    force, rate = (
        np.stack([np.interp(at, np.arange(n), column[::-1]) for column in values.T], axis=1)
        + sigma * rng.normal(size=(20 * n, 3))
        for values, sigma in ((samples.accelerometer, 3e-3), (-samples.gyroscope, 3e-4))
    )
    fast = make_samples(at / 100, force, rate, units=samples.units)
    found = find_still_intervals([fast[slice(first, first + 20_000)] for first in range(0, len(fast), 20_000)]).observations
    assert len(found) == 14
    assert np.abs(np.linalg.norm(found.mean_raw, axis=1) - gravity_m_s2).max() < 0.01


def test_a_rest_but_for_the_gyroscope_is_told_by_its_scatter(in_hand: tuple[Samples, Imu, float]) -> None:
    """Numbers in deg/s that are said to be rad/s: what is 0.4 deg/s of noise scatters by 23 there."""
    samples, _, _ = in_hand
    noise = np.radians(0.4) * np.random.default_rng(2).standard_normal(samples.gyroscope.shape)
    in_degrees = replace(samples, gyroscope=np.degrees(samples.gyroscope + noise))
    with refused(CalibrationError, Reason.UNITS, "gyroscope_unit", key="unguided.gyroscope_scatters"):
        find_still_intervals([in_degrees])


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("hold_s", "style", "short"), [(3.0, "held", 22), (5.0, "held", 22), (5.0, "placed", 0), (8.0, "held", 0)]
)
def test_holds_in_the_hand_that_are_too_short_are_told(hold_s: float, style: Any, short: int) -> None:
    habits = OperatorSettings(style=style, hold_s=hold_s, initial_still_s=6.0, turn_s=(1.0, 3.0), sway_rad=math.radians(0.4))
    operator = Operator(scheme("paper24").directions(), 3, habits)
    count = round(operator.plan_all() * 100)
    imu = Imu(draw_truth(find_grade("industrial"), np.random.default_rng(3)), 3, ImuSettings(rate_hz=100))
    found = find_still_intervals([imu.feed(operator.block(0, count, imu.interval_s))])
    told = [refusal for _, refusal in found.refused if refusal.limit == 6.0]
    # Where two sides in a row are near to each other they pass for one.
    assert short - 1 <= len(told) <= short + 1 if short else not told
    assert all(hold_s - 1 < refusal.measured < hold_s + 1 for refusal in told)


def test_without_a_gyroscope_a_hand_is_no_rest(in_hand: tuple[Samples, Imu, float]) -> None:
    samples = in_hand[0]
    found = find_still_intervals([replace(samples, gyroscope=np.full_like(samples.gyroscope, np.nan))])
    # The rest on the table.
    assert len(found.observations) == 1


def test_without_the_scale_of_the_gyroscope_a_hand_is_no_rest(in_hand: tuple[Samples, Imu, float]) -> None:
    samples = in_hand[0]
    counts = replace(samples, units=SampleUnits(accelerometer="m/s^2", gyroscope="count"))
    assert len(find_still_intervals([counts]).observations) == 1


@pytest.mark.parametrize("raw_zero", [0.0, 32768.0])
@pytest.mark.parametrize("deg_s_per_g", [0.16, 1.5])
def test_g_sensitivity_in_counts_loses_no_hold(deg_s_per_g: float, raw_zero: float) -> None:
    """A rate at rest that changes with the side that is up, as instruments for consumers have it, and worse ones."""
    quiet = perfect_instrument(find_grade("tactical"))
    g_sensitivity = np.full((3, 3), math.radians(deg_s_per_g) / 9.8)
    sensitive = replace(quiet, gyroscope=replace(quiet.gyroscope, g_sensitivity=g_sensitivity))
    operator = Operator(scheme("faces6").directions(), 2, OperatorSettings(hold_s=6.0, initial_still_s=4.0))
    imu = Imu(sensitive, 2, ImuSettings(rate_hz=100.0, drift=False))
    samples = imu.feed(operator.block(0, int(operator.plan_all() * 100), imu.interval_s))
    rng = np.random.default_rng(2)
    rate = 20_000 * (samples.gyroscope + 6e-4 * rng.standard_normal(samples.gyroscope.shape))
    force = 400 * samples.accelerometer + raw_zero
    units = SampleUnits(accelerometer="count", gyroscope="count")
    counts = replace(samples, accelerometer=force, gyroscope=np.rint(rate), units=units)
    assert len(find_still_intervals([counts], scale=RoughScale(raw_zero=np.full(3, raw_zero))).observations) == 7


@pytest.mark.parametrize("seed", range(4))
def test_what_travels_as_it_is_is_not_held(seed: int) -> None:
    """A car between two stops: its acceleration, at levels of 6 to 18 s, is no sway of a hand."""
    rng = np.random.default_rng(seed)
    levels = np.concatenate([np.full(int(rng.uniform(600, 1800)), rng.uniform(-1.2, 1.2)) for _ in range(30)])[:24_000]
    smooth = np.hanning(400) / np.hanning(400).sum()
    drives = np.concatenate([np.zeros(1000), np.ones(22_000), np.zeros(1000)])
    force = np.array([0.0, 0.0, 9.81]) + 0.02 * rng.standard_normal((24_000, 3))
    force[:, 0] += drives * np.convolve(levels, smooth, "same")
    road = np.stack([np.convolve(column, np.ones(4) / 2, "same") for column in rng.standard_normal((24_000, 6)).T], axis=1)
    force += 0.2 * drives[:, None] * road[:, :3]
    rate = np.radians(0.05) * rng.standard_normal((24_000, 3)) + np.radians(0.6) * drives[:, None] * road[:, 3:]
    found = find_still_intervals([make_samples(np.arange(24_000) / 100, force, rate, units=SampleUnits())]).observations
    assert len(found) == 2
    assert np.abs(np.linalg.norm(found.mean_raw, axis=1) - 9.81).max() < 0.003


def test_a_slow_turn_in_counts_is_no_rest_of_the_side_that_was_up_before() -> None:
    """About the vertical, which the accelerometer does not feel: 2 deg/s after a rest, on the second of two sides."""
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, 26.0, 0.01)
    is_second = time_s >= 8.0
    force = np.where(is_second[:, None], [9.8, 0.0, 0.0], [0.0, 0.0, 9.8]) + 0.01 * rng.standard_normal((len(time_s), 3))
    rate = 6e-4 * rng.standard_normal((len(time_s), 3)) + np.where(is_second[:, None], math.radians(1.5), 0.0)
    rate[time_s >= 16.0, 0] += math.radians(2.0)
    force[(time_s >= 7.5) & ~is_second] += rng.standard_normal((50, 3))
    counts = make_samples(time_s, force, np.rint(20_000 * rate), units=SampleUnits(gyroscope="count"))
    found = find_still_intervals([counts]).observations
    assert len(found) == 2
    assert (found.start_s + found.duration_s < [7.6, 16.2]).all()
