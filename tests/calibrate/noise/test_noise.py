"""Allan deviation as a stream, what is identified from it, and what is said where it cannot be."""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.coverage_factors import deviation_limits_95
from imufield.calibrate.noise import allan
from imufield.calibrate.noise.allan import AllanStream, EvenGrid, degrees_of_freedom, interval_and_slack
from imufield.calibrate.noise.noise import measure_noise
from imufield.calibrate.noise.noise_fit import FLICKER, identify, terms
from imufield.calibrate.noise.noise_texts import NoiseFormat, draw_plot, noise_text
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason, RecordingError, UsageError
from imufield.samples import FloatArray, Samples, SampleUnits, concatenate, make_samples
from tests.refused import refused
from tests.told import told

RATE_HZ = 20.0
DENSITY = np.repeat([1e-3, 1e-4], 3)
WALK = np.repeat([3e-5, 3e-6], 3)


@pytest.fixture(autouse=True)
def allantools() -> None:
    """Skip where it is absent; imported only where a test runs, as it brings half of SciPy."""
    pytest.importorskip("allantools")


def standstill(hours: float, seed: int = 0, walk: FloatArray = WALK, step: float = 0.0, block: int = 5000) -> Iterator[Samples]:
    rng = np.random.default_rng(seed)
    n, level = int(hours * 3600 * RATE_HZ), np.array([0.0, 0.0, 9.8, 0.0, 0.0, 0.0])
    for first in range(0, n, block):
        count = min(block, n - first)
        path = level + np.cumsum(rng.standard_normal((count, 6)) * walk / np.sqrt(RATE_HZ), axis=0)
        level = path[-1]
        values = path + rng.standard_normal((count, 6)) * DENSITY * np.sqrt(RATE_HZ)
        values = values if step == 0 else step * np.rint(values / step)
        yield make_samples((first + np.arange(count)) / RATE_HZ, values[:, :3], values[:, 3:], units=SampleUnits())


def test_data_sheets_state_the_same_in_their_units() -> None:
    result = measure_noise(standstill(0.5))
    sheet = {(each.title, each.unit): figures for each, figures in result.data_sheet()}
    # 1e-3 m/s^2/sqrt(Hz) is 102 ug/sqrt(Hz), and 0.06 m/s/sqrt(h); 1e-4 rad/s/sqrt(Hz) is 0.344 deg/sqrt(h).
    for (title, unit), value in {
        ("velocity random walk", "ug/sqrt(Hz)"): 101.97,
        ("velocity random walk", "m/s/sqrt(h)"): 0.06,
        ("angle random walk", "deg/sqrt(h)"): 0.34377,
    }.items():
        assert [figure.value for figure in sheet[title, unit]] == pytest.approx([value] * 3, rel=0.05)
    limits = result.upper_limits("gyroscope", "instability")
    assert [figure.high for figure in sheet["bias instability", "deg/h"]] == pytest.approx(np.degrees(limits) * 3600)
    assert not any(figure.observed for figure in sheet["bias instability", "ug"])
    raw = SampleUnits(accelerometer="count", gyroscope="count")
    counts = measure_noise(
        make_samples(block.time_s, block.accelerometer, block.gyroscope, units=raw) for block in standstill(0.1)
    )
    assert list(counts.data_sheet()) == []


def test_stream_agrees_with_allantools_on_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(allan, "CHUNK", 1 << 13)
    rng = np.random.default_rng(1)
    values = rng.standard_normal((120_000, 2))
    values[:, 1] += np.cumsum(values[:, 0]) * 1e-3
    stream = AllanStream(0.05, 2)
    for first in range(0, len(values), 7777):
        stream.feed(values[first : first + 7777])
    found = stream.finish()
    for column in range(2):
        reference = importlib.import_module("allantools").oadev(
            values[:, column], rate=20.0, data_type="freq", taus=found.tau_s
        )
        # Chunks of 8192 samples lose the terms that straddle them: up to 128 / 8192 of all.
        assert found.deviation[: len(reference[1]), column] == pytest.approx(reference[1], rel=0.015)


def test_short_recordings_are_taken_whole() -> None:
    values = np.random.default_rng(2).standard_normal((5000, 1))
    stream = AllanStream(1.0, 1)
    stream.feed(values)
    found = stream.finish()
    reference = importlib.import_module("allantools").oadev(values[:, 0], rate=1.0, data_type="freq", taus=found.tau_s)
    assert found.deviation[:, 0] == pytest.approx(reference[1], rel=1e-9)


def test_terms_are_the_textbook_ones() -> None:
    # At 1 s the deviation of white noise is its density; the floor of flicker 0.664 B; a random walk K / sqrt(3).
    row = terms(np.array([1.0]))[0]
    assert np.sqrt(row) == pytest.approx([math.sqrt(3), 1, 0.664, 1 / math.sqrt(3), 1 / math.sqrt(2)], rel=1e-3)
    assert math.sqrt(FLICKER) == pytest.approx(0.664, abs=1e-3)


def test_exact_curve_gives_its_figures_back() -> None:
    tau_s: FloatArray = np.asarray(0.05 * 2.0 ** np.arange(18))
    truth = np.array([1e-6, 2e-3, 4e-4, 5e-6, 0.0])
    model = identify(tau_s, np.sqrt(terms(tau_s) @ truth**2), 1e9 * tau_s[0] / tau_s)
    assert model.density.value == pytest.approx(2e-3, rel=1e-3)
    assert model.instability.value == pytest.approx(4e-4, rel=0.01)
    assert model.walk.value == pytest.approx(5e-6, rel=0.1)
    assert model.deviation(tau_s) == pytest.approx(np.sqrt(terms(tau_s) @ truth**2), rel=1e-3)


def test_intervals_hold_the_truth() -> None:
    inside = []
    for seed in range(3):
        result = measure_noise(standstill(2.0, seed))
        for axis, density, walk in zip(result.axes, DENSITY, WALK, strict=True):
            inside += [axis.density.low <= density <= axis.density.high, axis.walk.low <= walk <= axis.walk.high]
            assert axis.density.value == pytest.approx(density, rel=0.02)
    assert np.mean(inside) > 0.85


def test_limits_of_the_deviation() -> None:
    stream = AllanStream(1.0, 1)
    stream.feed(np.random.default_rng(0).standard_normal((4096, 1)))
    found = stream.finish()
    freedom = degrees_of_freedom(found, 0)
    low, high = deviation_limits_95(found.deviation[:, 0], freedom)
    white = 1 / np.sqrt(found.tau_s)
    assert np.mean((low < white) & (white < high)) > 0.8
    assert np.all(np.diff(freedom) < 0)


def test_times_that_repeat_tell_no_rate() -> None:
    (samples,) = standstill(0.05)
    coarse = make_samples(np.floor(samples.time_s), samples.accelerometer, samples.gyroscope, units=SampleUnits())
    with refused(RecordingError, Reason.BAD_DATA, key="noise.no_rate"):
        measure_noise([coarse])
    # Stamps of whole milliseconds at 1600 Hz: three of eight samples have the time of the one before, and 1 ms is no interval.
    with refused(RecordingError, Reason.BAD_DATA, "37.5%", key="noise.no_rate"):
        samples = at_rest(1600.0, 8000)
        samples.time_s[:] = np.floor(samples.time_s * 1000) / 1000
        measure_noise([samples])


def test_too_short_is_said() -> None:
    result = measure_noise(standstill(0.1))
    # One sentence for each figure, whatever the number of axes.
    for key in ("noise.no_walk", "noise.no_instability"):
        (one,) = told(result.sentences, key)
        assert one.values["names"] == ["any axis"]
    assert np.isnan(result.values("gyroscope", "walk")).all()
    assert np.all(result.upper_limits("gyroscope", "walk") > 0)
    with refused(CalibrationError, Reason.TOO_FEW, "60 s", key="noise.too_short") as caught:
        measure_noise(standstill(0.01))
    assert caught.value.values["longest_s"] < 60
    assert caught.value.reason is Reason.TOO_FEW
    for blocks in ([], [at_rest(20.0, 1)]):
        with refused(RecordingError, Reason.NOT_A_RECORDING, key="noise.no_samples"):
            measure_noise(blocks)


def test_quantisation_is_said() -> None:
    result = measure_noise(standstill(0.2, step=0.014, walk=0 * WALK))
    quantised = [axis for axis in result.axes if told(axis.sentences[:1], "noise.quantised")]
    assert {axis.name[0] for axis in quantised} == {"a"}
    assert not quantised[0].density.observed
    assert quantised[0].density.high > DENSITY[0]
    dead = [axis for axis in result.axes if not np.isfinite(axis.step)]
    assert all(told(axis.sentences[:1], "noise.dead") for axis in dead)
    assert len(dead) == 3


def test_moved_units_are_cut_and_the_longest_stretch_is_used() -> None:
    blocks = []
    for block in standstill(0.5):
        turned = block.time_s > 1500
        block.accelerometer[turned] = block.accelerometer[turned][:, [1, 2, 0]]
        blocks.append(block)
    result = measure_noise(blocks)
    assert result.duration_s == pytest.approx(1500, abs=2)
    assert told(result.sentences[:1], "noise.moved")
    assert "1500 s" in result.sentences[0]
    assert result.triad("accelerometer")[2].density.value == pytest.approx(1e-3, rel=0.05)


def test_the_raw_zero_of_a_converter_is_no_part_of_what_tells_a_move() -> None:
    units, zero = SampleUnits(accelerometer="count", gyroscope="count"), 32_768.0
    blocks = []
    for block in standstill(0.2):
        # By 1 degree: of the length with the raw zero in it that is a thousandth.
        block.accelerometer[block.time_s > 500, 0] += 9.8 * np.sin(np.radians(1.0))
        counts = 100 * block.accelerometer + zero
        blocks.append(make_samples(block.time_s, counts, 5000 * block.gyroscope, units=units))
    result = measure_noise(blocks, 100.0, 5000.0, np.full(3, zero))
    assert told(result.sentences[:1], "noise.moved")
    assert not told(result.sentences, "noise.no_gravity")
    assert result.triad("accelerometer")[0].density.value == pytest.approx(1e-3, rel=0.05)


@pytest.mark.parametrize(("factor", "is_told"), [(0.5, True), (0.85, False), (1.2, False), (2.0, True)])
def test_a_scale_with_which_nothing_shows_gravity_is_told(factor: float, is_told: bool) -> None:
    result = measure_noise(standstill(0.1), factor, 1.0)
    found_m_s2 = [each.values["found_m_s2"] for each in told(result.sentences, "noise.no_gravity")]
    assert found_m_s2 == pytest.approx([9.8 / factor] if is_told else [], rel=0.02)


def test_losses_are_bridged_or_cut() -> None:
    def lossy() -> Iterator[Samples]:
        for block in standstill(0.3):
            kept = np.flatnonzero((np.arange(len(block)) % 997 != 0) & ~((block.time_s > 100) & (block.time_s < 103)))
            yield block[kept]

    result = measure_noise(lossy())
    # What follows the loss, of 1080 s.
    assert result.duration_s == pytest.approx(1080 - 103, abs=2)
    assert result.bridged > 10
    assert told(result.sentences[:1], "noise.missing_samples")
    assert told(result.sentences, "noise.bridged")
    assert result.values("gyroscope", "density") == pytest.approx(DENSITY[3:], rel=0.05)


def at_rest(rate_hz: float, n: int, scatter: float = 1e-3, seed: int = 0) -> Samples:
    """Return white noise of one scatter on all axes."""
    values = np.array([0.0, 0.0, 9.8, 0.0, 0.0, 0.0]) + scatter * np.random.default_rng(seed).standard_normal((n, 6))
    return make_samples(np.arange(n) / rate_hz, values[:, :3], values[:, 3:], units=SampleUnits())


def in_blocks(samples: Samples, size: int) -> list[Samples]:
    return [samples[slice(first, first + size)] for first in range(0, len(samples), size)]


@pytest.mark.parametrize("size", [1, 2, 20, 333, 8000])
def test_blocks_do_not_matter(size: int) -> None:
    # Steps, an unsteady clock, losses, a time that stands and a move: whatever may look at the sample before.
    rng, samples = np.random.default_rng(5), at_rest(2.0, 9000, 0.006)
    samples.time_s[:] += 2e-3 * rng.standard_normal(len(samples))
    samples.time_s[4000] = samples.time_s[3999]
    for triad in (samples.accelerometer, samples.gyroscope):
        triad[:] = 0.01 * np.rint(triad / 0.01)
    samples.accelerometer[7777:, 0] += 1.0
    samples = samples[np.flatnonzero(rng.random(len(samples)) > 0.02)]
    whole = measure_noise([samples])
    found = measure_noise(in_blocks(samples, size))
    assert [found.samples, found.bridged, found.rate_hz] == [whole.samples, whole.bridged, whole.rate_hz]
    for one, other in zip(found.axes, whole.axes, strict=True):
        assert one.step == other.step == pytest.approx(0.01)
        # Levels and spread of rounded white noise: the variance of both is added.
        assert one.density.value == other.density.value == pytest.approx(math.hypot(0.006, 0.01 / 12**0.5) / 2**0.5, rel=0.1)
        assert one.deviation == pytest.approx(other.deviation, rel=1e-12)
    assert [told(found.sentences, key)[0] for key in ("noise.moved", "noise.bridged")]


def test_a_line_over_a_loss_has_no_steps() -> None:
    samples = at_rest(20.0, 4000, 0.003)
    samples.accelerometer[:] = 0.01 * np.rint(samples.accelerometer / 0.01)
    result = measure_noise([samples[np.flatnonzero(np.arange(4000) % 7 != 0)]])
    # Half a step between two values would be taken for the step of the output.
    assert result.bridged > 500
    for axis in result.triad("accelerometer"):
        assert axis.step == pytest.approx(0.01)
        assert told(axis.sentences, "noise.quantised")


@pytest.mark.parametrize("lost", [0.01, 0.2])
@pytest.mark.parametrize("is_known", [False, True])
def test_losses_of_an_unsteady_clock_are_bridged(lost: float, is_known: bool) -> None:
    samples, rng = at_rest(100.0, 60_000), np.random.default_rng(5)
    samples.time_s[:] += 0.001 * rng.uniform(-1, 1, 60_000)
    kept = rng.random(60_000) >= lost
    kept[[0, -1]] = True
    known_s = 0.01 if is_known else None
    assert interval_and_slack(np.diff(samples.time_s[kept])[:5000], known_s)[0] == pytest.approx(0.01, rel=2e-3)
    result = measure_noise([samples[np.flatnonzero(kept)]])
    assert result.bridged == pytest.approx(60_000 - kept.sum(), rel=0.02)
    assert result.duration_s == pytest.approx(600.0, rel=3e-3)


@pytest.mark.parametrize(
    ("rate_hz", "tick_s", "jitter"),
    [
        (60.0, 1e-3, 0.0),
        (400.0, 1e-3, 0.0),
        (333.3, 1e-3, 0.0),
        (100.0, 1e-9, 0.15),
    ],
)
def test_coarse_and_unsteady_times_are_no_losses(rate_hz: float, tick_s: float, jitter: float) -> None:
    samples = at_rest(rate_hz, 60_000)
    times_s = samples.time_s + jitter / rate_hz * np.random.default_rng(4).standard_normal(60_000)
    samples.time_s[:] = tick_s * np.floor(np.sort(times_s) / tick_s + 1e-6)
    result, even = measure_noise([samples]), measure_noise([at_rest(rate_hz, 60_000)])
    assert bool(told(result.sentences, "noise.coarse")) == (rate_hz == 400.0)
    assert not told(even.sentences, "noise.coarse")
    assert result.bridged < 0.005 * result.samples
    assert result.duration_s == pytest.approx(60_000 / rate_hz, rel=5e-3)
    found, expected = (np.array([axis.density.value for axis in each.axes]) for each in (result, even))
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_a_rate_that_changes_is_told() -> None:
    samples = at_rest(100.0, 40_000)
    assert not told(measure_noise([samples]).sentences, "noise.other_rate")
    samples.time_s[:6001] = 2 * samples.time_s[:6001] - samples.time_s[6000]
    (said,) = told(measure_noise([samples]).sentences, "noise.other_rate")
    assert said.values["lasted_s"] == pytest.approx(460.0, abs=0.1)
    assert said.values["counted_s"] == pytest.approx(800.0, rel=1e-3)


@pytest.mark.parametrize("is_copy", [True, False])
def test_a_time_that_stands_for_a_sample_ends_nothing(is_copy: bool) -> None:
    samples = at_rest(100.0, 20_000)
    if is_copy:
        samples = concatenate([samples[:10_001], samples[10_000:]])
    else:
        samples.time_s[10_001] = samples.time_s[10_000]
    result = measure_noise([samples])
    assert result.samples == 20_000
    # A sample whose time came late is on a line; of one that was sent twice nothing is missing.
    assert result.bridged == (0 if is_copy else 1)
    assert not told(result.sentences, "noise.missing_samples")
    assert result.values("gyroscope", "density") == pytest.approx([1e-4] * 3, rel=0.03)


@pytest.mark.parametrize("rate_hz", [2.0, 1.0, 0.5, 0.2])
@pytest.mark.parametrize("jitter_s", [0.0, 2e-3])
def test_slow_instruments_are_measured(rate_hz: float, jitter_s: float) -> None:
    # Single samples of such an instrument scatter by a third of what tells a move.
    samples = at_rest(rate_hz, 4000, 0.017)
    samples.time_s[:] += jitter_s * np.random.default_rng(1).standard_normal(4000)
    result = measure_noise(in_blocks(samples, 3))
    assert not told(result.sentences, "noise.moved")
    assert not told(result.sentences, "noise.missing_samples")
    assert result.samples == 4000
    assert result.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    assert result.values("accelerometer", "density") == pytest.approx([0.017 / math.sqrt(rate_hz)] * 3, rel=0.05)
    # Two lost samples are on a line, three are a gap.
    for lost in (2, 3):
        holed = measure_noise([samples[np.r_[0:900, 900 + lost : 4000]]])
        gaps = [each.values["bridged_s"] for each in told(holed.sentences, "noise.missing_samples")]
        assert gaps == pytest.approx([] if lost == 2 else [max(1.0, 3.5 / rate_hz)], rel=1e-3)
        assert holed.bridged == (2 if lost == 2 else 0)


def test_a_slow_unit_that_was_moved_is_cut() -> None:
    samples = at_rest(0.2, 4000)
    samples.accelerometer[1500:, 0] += 9.8 * np.sin(np.radians(1.0))
    result = measure_noise([samples])
    (moved,) = told(result.sentences, "noise.moved")
    assert moved.values["at_s"] == pytest.approx(7500, abs=50)
    assert result.samples == 2500


@pytest.mark.parametrize(("rate_hz", "least_s"), [(100.0, 60.0), (16.0, 63.0), (12.8, 78.203125), (2.0, 500.0), (0.2, 5000.0)])
def test_the_least_length_is_that_of_the_rate(rate_hz: float, least_s: float) -> None:
    least = round(least_s * rate_hz)
    assert measure_noise([at_rest(rate_hz, least)]).duration_s == pytest.approx(least_s)
    with refused(CalibrationError, Reason.TOO_FEW, f"{least_s:.4g} s", f"{rate_hz:g} Hz", key="noise.too_short") as caught:
        measure_noise([at_rest(rate_hz, least - 1)])
    assert caught.value.values["least_s"] == pytest.approx(least_s)


def test_an_accelerometer_alone() -> None:
    blocks = [make_samples(block.time_s, block.accelerometer, units=block.units) for block in standstill(0.1)]
    result = measure_noise(blocks)
    assert len(result.axes) == 3
    assert np.isnan(result.values("gyroscope", "density")).all()
    with refused(UsageError, Reason.UNITS, key="noise_texts.not_si"):
        noise_text(result, "kalibr")


def test_raw_units_need_a_scale() -> None:
    units = SampleUnits(accelerometer="count", gyroscope="count")
    blocks = [make_samples(b.time_s, 100 * b.accelerometer, 5000 * b.gyroscope, units=units) for b in standstill(0.1)]
    raw, scaled = measure_noise(blocks), measure_noise(blocks, 100.0, np.full(3, 5000.0))
    assert raw.axes[0].unit == "count"
    assert not raw.is_si
    assert scaled.values("gyroscope", "density") == pytest.approx(DENSITY[3:], rel=0.05)
    with refused(UsageError, Reason.UNITS, key="noise_texts.not_si"):
        noise_text(raw, "vins")


def test_texts_hold_what_filters_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = measure_noise(standstill(0.5))
    kalibr, openvins, vins = (noise_text(result, form) for form in ("kalibr", "openvins", "vins"))
    for text in (kalibr, openvins):
        found = dict(line.strip().split(": ", 1) for line in text.splitlines() if ": " in line and line[0] != "#")
        assert float(found["gyroscope_noise_density"].split()[0]) == pytest.approx(1e-4, rel=0.05)
        assert float(found["accelerometer_random_walk"].split()[0]) > 0
        assert float(found["update_rate"]) == RATE_HZ
        assert found["rostopic"] == "/imu0"
    # cv::FileStorage tells the format by this line.
    assert openvins.splitlines()[::2][:2] == ["%YAML:1.0", "imu0:"]
    found = dict(line.split(": ", 1) for line in vins.splitlines()[1:])
    assert float(found["g_norm"]) == STANDARD_GRAVITY_M_S2
    # After a second at rest VINS holds the variance of white noise and of a random walk (integration_base.h, V and noise).
    step_s, steps = 1 / RATE_HZ, int(RATE_HZ)
    for name, triad, figure, added in (
        ("acc_n", "accelerometer", "density", 0.5 * step_s**2),
        ("gyr_n", "gyroscope", "density", 0.5 * step_s**2),
        ("acc_w", "accelerometer", "walk", step_s**2),
        ("gyr_w", "gyroscope", "walk", step_s**2),
    ):
        seen = result.values(triad, figure)
        largest = np.nanmax(seen if np.isfinite(seen).any() else result.upper_limits(triad, figure))
        assert steps * added * float(found[name].split()[0]) ** 2 == pytest.approx(largest**2, rel=1e-5)
    covariances = dict(line.split("  #")[0].split(": ") for line in noise_text(result, "ros2").splitlines()[1:])
    for k, name in ((0, "linear_acceleration_covariance"), (3, "angular_velocity_covariance")):
        matrix = np.array(json.loads(covariances[name])).reshape(3, 3)
        assert np.diag(matrix) == pytest.approx(DENSITY[k : k + 3] ** 2 * RATE_HZ, rel=0.1)
        assert np.count_nonzero(matrix) == 3
    assert "95 %" in noise_text(measure_noise(standstill(0.1)), "kalibr")
    pytest.importorskip("matplotlib")
    assert draw_plot(result, "png")[:4] == b"\x89PNG"
    with refused(UsageError, Reason.USAGE, ".exe", ".png") as caught:
        draw_plot(result, "exe")

    assert caught.value.values["kind"] == "exe"
    for date in ("99999999999999999999", "9" * 5000, "-1", "x"):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", date)
        with refused(UsageError, Reason.USAGE, "SOURCE_DATE_EPOCH", key="files.source_date"):
            draw_plot(result, "pdf")


@pytest.mark.parametrize(("triad", "value"), [("accelerometer", 9.8), ("gyroscope", 0.0)])
def test_a_triad_that_never_changed_is_not_known(triad: str, value: float) -> None:
    blocks = list(standstill(0.1))
    for block in blocks:
        getattr(block, triad)[:] = value
    result = measure_noise(blocks)
    forms: tuple[NoiseFormat, ...] = ("kalibr", "openvins", "vins", "ros2")
    for form in forms:
        with refused(CalibrationError, Reason.TOO_FEW, triad, key="noise_texts.dead"):
            noise_text(result, form)
    pytest.importorskip("matplotlib")
    assert draw_plot(result, "png")[:4] == b"\x89PNG"


def test_missing_allantools_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "allantools", None)
    with refused(UsageError, Reason.MISSING_PACKAGE, "allantools", "pip install '.[noise]'", key="errors.missing_package"):
        AllanStream(1.0, 1)


def test_even_grid() -> None:
    grid = EvenGrid(1.0)
    runs = grid.feed(np.array([0.0, 1.0, 1.9]), np.array([[0.0], [1.0], [2.0]]))
    assert [len(run.rows) for run in runs] == [3]
    later = EvenGrid(0.1)
    later.feed(np.array([0.0]), np.array([[0.0]]))
    (run,) = later.feed(np.array([0.4]), np.array([[4.0]]))
    assert run.rows[:, 0] == pytest.approx([1, 2, 3, 4])
    assert run.bridged.tolist() == [True, True, True, False]
    assert run.start_s == pytest.approx(0.1)
    (back,) = later.feed(np.array([0.1]), np.array([[7.0]]))
    assert back.broken
