"""The forecast's equations against python-ins, its Monte-Carlo against single errors worked out another way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from at_rest import DEG_PER_HOUR, GRAVITY_M_S2, LATITUDE_DEG, MICRO_G, perfect, random_attitude, recording

from imufield.deliver.navigation.alignment import Alignment, earth_rate, rotation
from imufield.deliver.navigation.drift_forecast import RandomErrors, Scene, forecast, simulate, system, transition
from imufield.deliver.navigation.mechanise import Mechanisation
from imufield.samples import FloatArray

pytestmark = pytest.mark.numerical

HOUR_S = 3600.0
NOTHING = RandomErrors(np.zeros(6), np.zeros(6), np.zeros(6))


def scene(
    attitude: FloatArray,
    hours: float = 3.0,
    alignment: Alignment | None = None,
    attitudes: Callable[[FloatArray], FloatArray] | None = None,
) -> Scene:
    time_s = np.arange(0, hours * HOUR_S + 1)
    known = Alignment(attitude, np.zeros((3, 3)), np.zeros((3, 6)))
    every = np.broadcast_to(attitude, (len(time_s), 3, 3)) if attitudes is None else attitudes(time_s)
    return Scene(
        latitude_deg=LATITUDE_DEG,
        height_m=0.0,
        gravity_m_s2=GRAVITY_M_S2,
        alignment=alignment or known,
        time_s=time_s,
        attitudes=every,
    )


ERRORS = {
    "force north": ((100 * MICRO_G, 0, 0), (0, 0, 0)),
    "force east": ((0, 100 * MICRO_G, 0), (0, 0, 0)),
    "rate north": ((0, 0, 0), (0.01 * DEG_PER_HOUR, 0, 0)),
    "rate east": ((0, 0, 0), (0, 0.01 * DEG_PER_HOUR, 0)),
    "rate down": ((0, 0, 0), (0, 0, 0.01 * DEG_PER_HOUR)),
}


@pytest.mark.parametrize("name", ERRORS)
def test_equations_agree_with_the_mechanisation(name: str) -> None:
    force, rate = (np.array(part) for part in ERRORS[name])
    samples = recording(np.eye(3), 5 * HOUR_S, 0.5, force=force, rate=rate)
    run = Mechanisation(np.eye(3), 0.0, LATITUDE_DEG, 0.0)
    run.feed(samples.time_s, samples.accelerometer, samples.gyroscope)
    run.finish()
    step_s, x = 60.0, np.zeros(7)
    forward, gain = transition(scene(np.eye(3)), step_s)
    states = [x]
    for _ in range(int(5 * HOUR_S / step_s)):
        x = forward @ x + gain @ [*force[:2], *rate]
        states.append(x)
    time_s = step_s * np.arange(len(states))
    for column, measured in ((0, run.drift.latitude_deg), (1, run.drift.longitude_deg)):
        expected = np.degrees(np.array(states)[:, column])
        found = np.interp(time_s, run.drift.time_s, measured)
        assert np.abs(found - expected).max() < 3e-3 * np.abs(run.drift.position_nmi).max() / 60


def test_transition_is_the_limit_of_small_steps() -> None:
    F, G = system(LATITUDE_DEG, 0.0, GRAVITY_M_S2)
    forward, gain = transition(scene(np.eye(3)), 10.0)
    x, b = np.eye(7), np.zeros((7, 5))
    for _ in range(10_000):
        middle = x + 0.5e-3 * F @ x, b + 0.5e-3 * (F @ b + G)
        x, b = x + 1e-3 * F @ middle[0], b + 1e-3 * (F @ middle[1] + G)
    np.testing.assert_allclose(forward, x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(gain, b, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "true_nmi", "aligned_nmi", "turned_nmi"),
    [
        ("force north", 0.69, 0.35, 1.37),
        ("force east", 0.69, 0.0, 1.37),
        ("rate north", 2.91, 2.91, None),
        ("rate east", 2.56, 0.0, None),
        ("rate down", 1.26, 1.26, None),
    ],
)
def test_errors_of_one_axis_drift_as_the_documentation_says(
    name: str, true_nmi: float, aligned_nmi: float, turned_nmi: float | None
) -> None:
    # docs/verify.md; the figures are those of the phi-angle equations (Titterton and Weston, 12.3), integrated apart.
    force, rate = (np.array(part) for part in ERRORS[name])
    north, _, down = earth_rate(LATITUDE_DEG)
    tilt = np.array([force[1], -force[0]]) / GRAVITY_M_S2
    forward, gain = transition(scene(np.eye(3)), 60.0)

    def largest_nmi(x: FloatArray, force: FloatArray) -> float:
        farthest = 0.0
        for _ in range(5 * 60):
            x = forward @ x + gain @ [*force[:2], *rate]
            farthest = max(farthest, np.hypot(x[0], x[1] * np.cos(np.radians(LATITUDE_DEG))))
        return np.degrees(farthest) * 60

    aligned = np.array([0, 0, 0, 0, *tilt, (rate[1] + down * tilt[0]) / north])
    assert largest_nmi(np.zeros(7), force) == pytest.approx(true_nmi, abs=0.02)
    assert largest_nmi(aligned, force) == pytest.approx(aligned_nmi, abs=0.02)
    if turned_nmi is not None:
        assert largest_nmi(aligned, -force) == pytest.approx(turned_nmi, abs=0.02)


def test_alignment_takes_off_what_it_caused() -> None:
    attitude = random_attitude(4)
    tilt = np.zeros((3, 6))
    tilt[0, :3], tilt[1, :3] = attitude[1] / GRAVITY_M_S2, -attitude[0] / GRAVITY_M_S2
    tilt[2] = tilt[0] * earth_rate(LATITUDE_DEG)[2] / earth_rate(LATITUDE_DEG)[0]
    aligned = Alignment(attitude, np.zeros((3, 3)), tilt)
    rng = np.random.default_rng(1)
    own = simulate(perfect(100 * MICRO_G), scene(attitude, 5.0, aligned), NOTHING, rng, runs=200)[0]
    true = simulate(perfect(100 * MICRO_G), scene(attitude, 5.0), NOTHING, rng, runs=200)[0]

    def over(time_s: FloatArray) -> FloatArray:
        turned = attitude @ rotation(np.array([np.pi, 0, 0]))
        return np.where((time_s < 60)[:, None, None], attitude, turned)

    turned = simulate(perfect(100 * MICRO_G), scene(attitude, 5.0, aligned, over), NOTHING, rng, runs=200)[0]
    sizes = [np.sqrt(np.mean(one.position_nmi.max(axis=1) ** 2)) for one in (own, true, turned)]
    assert sizes[0] < 0.75 * sizes[1] < 0.75 * sizes[2]


def test_scale_error_of_the_gyroscope_counts_in_a_turn() -> None:
    attitude = np.eye(3)
    calibration = perfect()
    calibration = replace(calibration, covariance_names=("gyroscope.scale.x",), covariance=np.array([[1e-8]]))

    def over(time_s: FloatArray) -> FloatArray:
        return np.where((time_s < 60)[:, None, None], attitude, attitude @ rotation(np.array([np.pi, 0, 0])))

    still = simulate(calibration, scene(attitude, 1.0), NOTHING, np.random.default_rng(2), runs=200)[0]
    turned = simulate(calibration, scene(attitude, 1.0, attitudes=over), NOTHING, np.random.default_rng(2), runs=200)[0]
    # 100 ppm of half a turn tilt by 0.314 mrad about x, north: east velocity oscillates by g phi / w = R w phi.
    tilt = 1e-4 * np.pi
    assert np.sqrt(np.mean(turned.east_velocity_m_s**2, axis=0)).max() == pytest.approx(tilt * np.sqrt(9.8 * 6.38e6), rel=0.15)
    assert still.position_nmi.max() < 5e-2 * turned.position_nmi.max()


def test_bands_hold_as_many_as_they_say_and_sources_are_told_apart() -> None:
    random = RandomErrors(
        np.repeat([5 * MICRO_G, 6e-7], 3),
        np.repeat([3 * MICRO_G, 0.003 * DEG_PER_HOUR], 3),
        np.repeat([0, 0.003 * DEG_PER_HOUR], 3),
    )
    calibration, place = perfect(50 * MICRO_G, 0.005 * DEG_PER_HOUR), scene(random_attitude(3), 2.0)
    found = forecast(calibration, place, random, np.random.default_rng(0), runs=600)
    drift, _ = simulate(calibration, place, random, np.random.default_rng(99), runs=600)
    rates = drift.position_nmi.max(axis=1) / 2.0
    assert np.mean(rates <= found.rate_95_nmi_per_h) == pytest.approx(0.95, abs=0.03)
    inside = (drift.latitude_deg >= found.low["latitude_deg"]) & (drift.latitude_deg <= found.high["latitude_deg"])
    assert np.mean(inside[:, 1:]) == pytest.approx(0.95, abs=0.03)
    assert max(found.sources, key=found.sources.__getitem__) == "gyroscope calibration"
    assert max(found.sources.values()) < found.rate_95_nmi_per_h


def test_the_same_seed_gives_the_same_forecast() -> None:
    place = scene(random_attitude(3), 1.0)
    first, second = (forecast(perfect(1e-5, 1e-8), place, NOTHING, np.random.default_rng(5), runs=50) for _ in range(2))
    np.testing.assert_array_equal(first.position_95_nmi, second.position_95_nmi)
