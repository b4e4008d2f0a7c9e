"""What holds show together of the outputs: ends of the range, outputs that stand still, codes that stick."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from imufield.guide.cross_checks.outputs import Outputs
from imufield.guide.events import RefusalCode
from imufield.guide.hold.output import HoldOutput
from imufield.guide.stillness.cells import join_cells
from imufield.samples import FloatArray, Samples, SampleUnits, make_samples
from tests.guide.guided import cells_of, find_still_intervals, key_of, values_of

NOISE_M_S2 = 0.01
STEP_M_S2 = 0.002
RANGE_M_S2 = 9.81
# Three tilts from +x up: none, 0.9 deg and 5.1 deg, then other sides.
TILTS = ([1, 0, 0], [1, 0.016, 0], [1, 0.09, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1])


def session(make_path: Any, sides: Any = TILTS, *, step: float = STEP_M_S2, sigma: float = NOISE_M_S2, seed: int = 1) -> Any:
    path = make_path(100.0).hold(sides[0], 6.0)
    for before, side in pairwise(sides):
        # Away from where it was, or the next side is the same placement.
        away = np.cross(before, [0.3, 0.5, 0.8])
        path.turn(away, 1.5).turn(side, 1.5).hold(side, 6.0)
    return path.samples(sigma, 1e-3, seed=seed, step=step)


def hold_of(columns: FloatArray, rate_hz: float = 100.0) -> Any:
    """Return the cells of one hold; columns (n, 6)."""
    time_s = np.arange(len(columns)) / rate_hz
    samples = make_samples(time_s, columns[:, :3], columns[:, 3:], units=SampleUnits())
    return join_cells(list(cells_of([samples])))


def noise_of(sigma_steps: float, mean_steps: Any, *, n: int = 800, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(np.rint(np.asarray(mean_steps) + sigma_steps * rng.standard_normal((n, 6))))


def outputs_of(holds: Any) -> tuple[Outputs, list[HoldOutput]]:
    outputs, found = Outputs(), []
    for columns in holds:
        cells = hold_of(columns)
        outputs.follow(cells)
        found.append(HoldOutput.of(cells))
        outputs.add(found[-1])
    return outputs, found


def clip(samples: Samples) -> Samples:
    samples.accelerometer[:, 0] = np.minimum(samples.accelerometer[:, 0], RANGE_M_S2)
    return samples


@pytest.mark.parametrize(
    "order", [(0, 1, 2, 3, 4, 5), (1, 0, 2, 3, 4, 5), (2, 1, 3, 4, 5, 0)], ids=["found first", "later", "last"]
)
def test_an_end_of_the_range_applies_to_every_hold(make_path: Any, order: Any) -> None:
    """The truth is counted in the samples themselves: every hold with three and 0.1 % of them at the end is refused."""
    samples = clip(session(make_path, [TILTS[k] for k in order]))
    found = find_still_intervals([samples])
    assert len(found.observations) == 4
    for start_s, duration_s in zip(found.observations.start_s, found.observations.duration_s, strict=True):
        inside = (samples.time_s >= start_s) & (samples.time_s <= start_s + duration_s)
        at_end = int((samples.accelerometer[inside, 0] == RANGE_M_S2).sum())
        assert at_end < max(3, 0.001 * inside.sum())
    for _, refusal in found.refused:
        assert refusal.reason in (RefusalCode.SATURATED, RefusalCode.STUCK)
        assert refusal.axis == "x"


def test_few_samples_at_a_known_end_are_refused_and_fewer_are_not() -> None:
    """A hold 2.6 sigma below an end that another hold shows: 0.6 % of its samples stand there, 5 of 800."""
    rng = np.random.default_rng(5)
    free = rng.standard_normal((800, 6)) * 10
    at_end, near, far = free.copy(), np.minimum(free, 26.0), np.minimum(free, 40.0)
    at_end[:, 0] = 26.0
    outputs, (clipped, few, none) = outputs_of(map(np.rint, (at_end, near, far * 0.6)))
    assert few.at_high[0] == 5
    assert none.high[0] < 26.0
    assert [refusal and refusal.reason for refusal in map(outputs.refusal, (clipped, few, none))] == [
        RefusalCode.STUCK,
        RefusalCode.SATURATED,
        None,
    ]
    # Alone it shows no end: so many may stand there by chance.
    alone, (few,) = outputs_of([np.rint(near)])
    assert alone.refusal(few) is None


def test_an_end_is_none_where_the_output_goes_beyond() -> None:
    """Half of the samples on the highest code, but a move went past it: a code, and no end of the range."""
    piled = np.minimum(noise_of(10, 0.0), 0.0)
    beyond = noise_of(10, 200.0, seed=1)
    outputs, (first, second) = outputs_of([piled, beyond])
    assert outputs.refusal(first) is None
    assert outputs.refusal(second) is None
    lonely, (first,) = outputs_of([piled])
    assert outputs.refusal(second) is None
    refusal = lonely.refusal(first)
    assert refusal is not None
    assert refusal.reason is RefusalCode.SATURATED


@pytest.mark.parametrize("amplitude_steps", [2.0, 5.0, 20.0])
def test_vibration_of_one_amplitude_is_no_end(amplitude_steps: float) -> None:
    """A sine stands at both of its ends longer than anywhere else."""
    time_s = np.arange(6000) / 100
    sine = amplitude_steps * np.sin(2 * np.pi * 7.3 * time_s)[:, None]
    outputs, found = outputs_of([np.rint(sine + 0.3 * np.random.default_rng(k).standard_normal((6000, 6))) for k in range(3)])
    assert [outputs.refusal(hold) for hold in found] == [None] * 3


@pytest.mark.numerical
def test_clean_outputs_of_any_noise_are_never_refused_and_never_stick() -> None:
    """Noise from 1/20 of a step to 200 steps, means anywhere between two codes, white and slow."""
    rng = np.random.default_rng(11)
    for sigma_steps in (0.05, 0.15, 0.3, 0.6, 1.0, 3.0, 30.0, 200.0):
        holds = []
        for _ in range(24):
            mean = rng.uniform(-3000, 3000, 6)
            # Flicker to the eye: a random walk of half the noise over the hold.
            slow = 0.5 * sigma_steps * np.cumsum(rng.standard_normal((600, 6)), axis=0) / 24
            # One output at least must change, or the hold is refused.
            lively = np.array([0, 0, 0, 0, 0, 2.0])
            holds.append(np.rint(mean + slow + np.maximum(sigma_steps, lively) * rng.standard_normal((600, 6))))
        outputs, found = outputs_of(holds)
        assert [outputs.refusal(hold) for hold in found] == [None] * 24, sigma_steps
        assert outputs.sticking() == (), sigma_steps


def test_repeated_frames_are_refused_however_quiet_the_instrument_is() -> None:
    outputs, (hold,) = outputs_of([np.tile([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], (300, 1))])
    refusal = outputs.refusal(hold)
    assert refusal is not None
    assert refusal.reason is RefusalCode.FROZEN
    assert refusal.measured == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("columns", "reason"), [([0, 1, 2, 3, 4, 5], RefusalCode.FROZEN), ([1], RefusalCode.STUCK), ([4], RefusalCode.STUCK)]
)
@pytest.mark.parametrize("share", [1.0, 0.2])
def test_an_output_that_stops_is_refused_by_the_noise_of_other_holds(columns: Any, reason: RefusalCode, share: float) -> None:
    """A fifth of a hold that repeats one sample is off by a fifth of its noise: five sigma of the mean."""
    stopped = noise_of(5, 0.0)
    rows = round(share * len(stopped))
    stopped[:rows, columns] = stopped[0, columns]
    holds = [noise_of(5, 100.0 * k, seed=k) for k in range(1, 4)]
    outputs, (first, *others) = outputs_of([stopped, *holds])
    refusal = outputs.refusal(first)
    assert refusal is not None
    assert refusal.reason is reason
    assert refusal.axis == (None if len(columns) == 6 else "xyzxyz"[columns[0]])
    assert [outputs.refusal(hold) for hold in others] == [None] * 3


def test_a_gyroscope_that_shows_zero_for_every_slow_rate_is_no_fault() -> None:
    holds = [noise_of(5, 0.0, seed=k) for k in range(4)]
    holds[2][:, 3:], holds[3][:500, 4] = 0.0, 0.0
    outputs, found = outputs_of(holds)
    assert [outputs.refusal(hold) for hold in found] == [None] * 4
    assert outputs.sticking() == ()


def test_an_output_that_stands_still_may_be_a_coarse_one() -> None:
    """Two neighbouring codes in another hold show no noise of half a step."""
    still, toggling = noise_of(0.02, 0.0), noise_of(0.02, 0.5, seed=1)
    still[:, 5] = toggling[:, 5] = noise_of(3, 0.0)[:, 5]
    outputs, found = outputs_of([still, toggling])
    assert np.count_nonzero(found[0].still) == 5
    assert [outputs.refusal(hold) for hold in found] == [None, None]


@pytest.mark.numerical
@pytest.mark.parametrize("seed", [0, 1])
def test_a_coarse_output_is_known_to_its_step_and_no_better(make_path: Any, seed: int) -> None:
    """Noise of a fiftieth of a step: the errors of the means are spread evenly over it, 1 sigma of step / sqrt(12)."""
    step = 0.05
    rng = np.random.default_rng(seed)
    sides = [side / np.linalg.norm(side) for side in rng.standard_normal((30, 3))]
    samples = session(make_path, sides, step=step, sigma=0.001, seed=seed)
    found = find_still_intervals([samples]).observations
    # A side every nine seconds; where an output turns from one code to the next, a hold may seem knocked.
    shown = np.rint(found.start_s / 9.0).astype(int)
    assert len(set(shown)) == len(found) >= len(sides) - 1
    true = 9.80665 * np.array(sides)[shown]
    error = found.mean_raw - true
    sigma = np.sqrt(np.diagonal(found.covariance_raw, axis1=1, axis2=2))
    still = sigma > 0.9 * step / math.sqrt(12)
    assert np.count_nonzero(still) > 60
    np.testing.assert_allclose(sigma[still].min(), step / math.sqrt(12), rtol=0.1)
    assert np.sqrt(np.mean((error / sigma)[still] ** 2)) == pytest.approx(1.0, abs=0.2)


def sticking(codes: FloatArray) -> FloatArray:
    return np.where(np.mod(codes, 256) < 32, codes - np.mod(codes, 256), codes)


@pytest.mark.parametrize("sigma_steps", [10.0, 35.0])
def test_codes_that_stick_are_said(sigma_steps: float) -> None:
    rng = np.random.default_rng(2)
    holds = [noise_of(sigma_steps, rng.uniform(-3000, 3000, 6), seed=k) for k in range(24)]
    for columns in holds:
        columns[:, 1] = sticking(columns[:, 1])
    outputs, _ = outputs_of(holds)
    (said,) = outputs.sticking()
    assert key_of(said) == "outputs.sticks"
    assert values_of(said)["axis"] == "y"
    assert values_of(said)["value"] % 256 == 0


def test_the_outputs_of_a_hold_are_those_of_its_samples() -> None:
    columns = noise_of(2, [0.0, 10.0, 20.0, 0.0, 0.0, 0.0])
    columns[:, 4] = np.nan
    columns[300:340, 0] = columns[299, 0]
    hold = HoldOutput.of(hold_of(columns))
    assert (hold.cells, hold.samples) == (80, 800)
    np.testing.assert_array_equal(hold.low, columns.min(axis=0))
    np.testing.assert_array_equal(hold.at_high, (columns == columns.max(axis=0)).sum(axis=0)[:3])
    np.testing.assert_array_equal(hold.at_low, (columns == columns.min(axis=0)).sum(axis=0)[:3])
    assert hold.run[0] == 4
    assert hold.run[1] == hold.run_of_all == 1
    # One value of each tenth.
    values, counts = np.unique(columns[::10, 2], return_counts=True)
    assert (hold.commonest[2], hold.begun_with_it[2]) == (values[counts.argmax()], counts.max())
    assert not hold.still.any()


def test_three_outputs_are_all_where_there_is_no_gyroscope(make_path: Callable[..., Any]) -> None:
    samples = make_path(50.0).hold([0, 0, 1], 8).samples(gyroscope=False)
    samples.accelerometer[:] = samples.accelerometer[0]
    outputs = Outputs()
    hold = HoldOutput.of(join_cells(list(cells_of([samples]))))
    outputs.add(hold)
    refusal = outputs.refusal(hold)
    assert refusal is not None
    assert refusal.reason is RefusalCode.FROZEN


def test_a_hold_that_is_measured_again_counts_once() -> None:
    """One quiet hold of five leaves the noise that of the others, however often it is repeated."""
    loud = [HoldOutput.of(hold_of(noise_of(8, 0.0, seed=k))) for k in range(4)]
    quiet = HoldOutput.of(hold_of(noise_of(0.7, 0.0, seed=9)))
    stalled = noise_of(8, 0.0, seed=10)
    stalled[:150] = stalled[0]
    reasons = []
    for again in (True, False):
        outputs = Outputs()
        outputs.follow(hold_of(noise_of(8, 0.0)), slice(1))
        for hold in loud:
            outputs.add(hold)
        outputs.add(quiet)
        for _ in range(10):
            outputs.add(quiet, again=again)
        refusal = outputs.refusal(HoldOutput.of(hold_of(stalled)))
        reasons.append(refusal and refusal.reason)
    assert reasons == [RefusalCode.FROZEN, None]
