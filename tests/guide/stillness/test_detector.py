from typing import Any

import numpy as np
import pytest

from imufield.guide.hold.observe import guard_cells, trim_stretch
from imufield.guide.stillness.cells import CellBuilder
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.limits import scatter_of_variance
from imufield.guide.stillness.noise_floor import measure_floor
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Phase
from imufield.samples import SampleUnits, Status
from tests.guide.guided import cells_of

pytestmark = pytest.mark.numerical

SI = RoughScale(accelerometer=1.0, gyroscope=1.0)


def stretches(samples: Any, scale: Any = SI) -> Any:
    """Every still stretch, and the detector as it was at its end."""
    detector = StillnessDetector(scale)
    found = []
    for cells in cells_of([samples]):
        found += [judgement.ended for judgement in detector.judge(cells) if judgement.ended is not None]
    if detector.phase is Phase.STILL:
        found.append(detector.stretch)
    return found, detector


def session(make_path: Any, rate_hz: float, seed: int, positions: Any = 8) -> Any:
    rng = np.random.default_rng(seed)
    path = make_path(rate_hz, lever_m=rng.uniform(-0.07, 0.07, 3))
    up = np.array([0.0, 0.0, 1.0])
    path.hold(up, 6)
    for _ in range(positions):
        before = up
        while np.clip(up @ before, -1, 1) > np.cos(np.radians(30)):
            up = rng.normal(size=3)
            up /= np.linalg.norm(up)
        path.turn(up, rng.uniform(0.5, 5)).hold(up, rng.uniform(3, 8))
    return path


GRADES = {
    "navigation, 2000 Hz": (2000, 3e-3, 1e-5, 0.0, True),
    "quantised, variance 0": (200, 1e-7, 1e-8, 1e-4, True),
    "tactical, 2000 Hz": (2000, 0.05, 2e-3, 0.0, True),
    "MEMS, 100 Hz": (100, 0.045, 1e-3, 0.0, True),
    "MEMS, no gyroscope": (100, 0.045, 1e-3, 0.0, False),
    "unfiltered MEMS, 1000 Hz": (1000, 0.08, 8e-3, 0.0, True),
    "slow, 25 Hz": (25, 0.02, 1e-3, 0.0, True),
}


@pytest.mark.parametrize("grade", GRADES)
def test_every_still_is_found_within_its_true_ends(make_path: Any, grade: Any) -> None:
    rate_hz, sigma, sigma_gyroscope, step, gyroscope = GRADES[grade]
    for seed in (0, 1):
        path = session(make_path, rate_hz, seed)
        found, detector = stretches(path.samples(sigma, sigma_gyroscope, seed=seed, gyroscope=gyroscope, step=step))
        assert len(found) == len(path.still)
        guard = guard_cells(detector.limits)
        for stretch, (start, end) in zip(found, path.still, strict=True):
            cells = stretch.cells()
            rows = trim_stretch(cells, detector.limits)
            kept = cells[rows]
            assert kept.start_s[0] >= start
            assert kept.end_s[-1] <= end
            begin, stop = cells.start_s[rows.start - guard], cells.end_s[rows.stop + guard - 1]
            allowed = 0.3 if gyroscope else 0.8
            assert abs(begin - start) <= allowed
            assert abs(stop - end) <= allowed


def test_judgements_do_not_depend_on_the_cuts(make_path: Any, cut_blocks: Any) -> Any:
    samples = session(make_path, 200, 3).samples()
    samples.status[2000:2050] = np.uint32(Status.ACCELEROMETER_INVALID)

    def judged(sizes: Any) -> Any:
        detector = StillnessDetector(SI)
        told = []
        for cells in cells_of(cut_blocks(samples, sizes)):
            judged = detector.judge(cells)
            told += [(j.phase, detector.explain(j), float(j.cells.end_s[j.row]), j.ended is None) for j in judged]
        return told

    whole = judged([])
    assert judged([4] * (len(samples) // 4)) == whole
    assert judged([200] * (len(samples) // 200)) == whole
    rng = np.random.default_rng(0)
    assert judged(rng.integers(1, 700, 60).tolist()) == whole


def test_unknown_counts_are_judged_like_si(make_path: Any) -> None:
    path = session(make_path, 100, 5)
    units = SampleUnits(accelerometer="count", gyroscope="count")
    samples = path.samples(0.008, 0.005, units=units, scale=(414.0, 4780.0), raw_zero=32768.0, step=1.0)
    found, detector = stretches(samples, RoughScale(raw_zero=np.full(3, 32768.0)))
    assert len(found) == len(path.still)
    assert detector.scale.learned
    assert detector.scale.accelerometer == pytest.approx(414, rel=0.01)


def test_a_start_in_the_hand_is_no_noise_floor(make_path: Any) -> None:
    path = make_path(200.0).hold([0, 0, 1], 20)
    samples = path.samples(0.01, 1e-3)
    tremor = np.sin(2 * np.pi * 10 * samples.time_s[:2000]) * 0.3
    samples.accelerometer[:2000] += tremor[:, None]
    samples.gyroscope[:2000] += tremor[:, None] * 0.3
    _, detector = stretches(samples)
    assert detector.floor is not None
    assert detector.floor.start_s >= 9.9
    np.testing.assert_allclose(detector.floor.sigma[:3], 0.01, rtol=0.15)


def test_a_quieter_stretch_lowers_the_floor(make_path: Any) -> None:
    path = make_path(200.0).hold([0, 0, 1], 6).turn([1, 0, 0], 1).hold([1, 0, 0], 6).turn([0, 1, 0], 1).hold([0, 1, 0], 4)
    samples = path.samples(0.01, 1e-3)
    noisy = np.random.default_rng(7).normal(0, 0.04, (1200, 3))
    samples.accelerometer[:1200] += noisy
    _, detector = stretches(samples)
    np.testing.assert_allclose(detector.floor.sigma[:3], 0.01, rtol=0.15)


def test_the_limit_is_left_at_twice_what_it_is_entered_at(make_path: Any) -> None:
    """Hysteresis: vibration between 1 and 2 times the limit ends no stretch, and begins none."""
    path = make_path(1000.0).hold([0, 0, 1], 30)
    samples = path.samples(1e-3, 1e-5)
    shaking = 0.05 * 1.5 * np.sqrt(2) * np.sin(2 * np.pi * 50 * samples.time_s)
    late = samples.time_s >= 15
    samples.accelerometer[late] += shaking[late, None]
    found, _ = stretches(samples)
    assert [len(one) for one in found] == [300]
    early = samples.time_s < 15
    samples.accelerometer[~early] -= shaking[~early, None]
    samples.accelerometer[5000:10000] += 2 * shaking[5000:10000, None]
    samples.accelerometer[10000:15000] += shaking[10000:15000, None]
    found, _ = stretches(samples)
    assert [round(one.cells().start_s[0], 1) for one in found] == [0.0, 15.0]


def test_one_lost_cell_is_bridged_and_two_are_not(make_path: Any) -> None:
    path = make_path(200.0).hold([0, 0, 1], 20)
    samples = path.samples()
    keep = np.ones(len(samples), dtype=bool)
    keep[1600:1620] = False
    found, _ = stretches(samples[keep])
    assert len(found) == 1
    keep[1600:1645] = False
    found, _ = stretches(samples[keep])
    assert len(found) == 2


def test_a_clock_that_is_set_ends_a_still(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 12).samples()
    assert len(stretches(samples)[0]) == 1
    samples.status[700] |= np.uint32(Status.CLOCK_SET)
    found, _ = stretches(samples)
    assert [round(one.cells().start_s[0], 1) for one in found] == [0.0, 7.0]


def test_activity_names_triad_axis_value_and_limit(make_path: Any) -> None:
    path = make_path(200.0).hold([0, 0, 1], 8)
    samples = path.samples()
    samples.gyroscope[1400:, 1] += 0.2
    detector = StillnessDetector(SI)
    judgements = [judgement for cells in cells_of([samples]) for judgement in detector.judge(cells)]
    activity = next(detector.explain(j) for j in judgements if j.ended is not None)
    assert (activity.triad, activity.axis, activity.kind, activity.unit) == ("gyroscope", "y", "change", "rad/s")
    assert activity.measured == pytest.approx(0.2, rel=0.05)
    assert activity.limit == pytest.approx(np.radians(1.0))


def test_a_long_stretch_keeps_a_minute(make_path: Any) -> None:
    path = make_path(50.0).hold([0, 0, 1], 300)
    found, _ = stretches(path.samples())
    assert len(found) == 1
    assert found[0].judged == 3000
    assert len(found[0].cells()) == 600


def test_scatter_of_variance_bounds_chi_squared() -> None:
    rng = np.random.default_rng(1)
    for freedom in (3, 27, 597):
        ratio = np.sqrt(rng.chisquare(freedom, 200_000) / freedom)
        assert np.quantile(ratio, 0.99999) < scatter_of_variance(freedom)
    assert scatter_of_variance(1e9) == pytest.approx(1, abs=1e-3)


def test_floor_of_white_noise(make_path: Any) -> None:
    samples = make_path(200.0).hold([0, 0, 1], 3.0).samples(0.01, 1e-3)
    cells = CellBuilder().feed(samples)
    assert cells is not None
    floor = measure_floor(cells)
    np.testing.assert_allclose(floor.sigma, [0.01] * 3 + [1e-3] * 3, rtol=0.1)
    np.testing.assert_allclose(floor.cell_sigma, floor.sigma / np.sqrt(20), rtol=0.5)
    assert floor.samples_per_cell == 20
