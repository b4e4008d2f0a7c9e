"""Static navigation: time and memory of 5 h at 100 Hz, difference from a direct run, and whether forecasts hold."""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.model.result import AccelerometerParameters, Calibration, GyroscopeParameters
from imufield.calibrate.model.rotation import exponential, multiply
from imufield.deliver.navigation.drift import Drift
from imufield.deliver.navigation.mechanise import load_pyins
from imufield.deliver.navigation.static_navigation import Apply, CheckSettings, NavigationResult, ParameterSet, StaticNavigation
from imufield.deliver.parameters.apply import correct_accelerometer, correct_gyroscope
from imufield.deliver.parameters.file import Corrected
from imufield.samples import FloatArray, Samples
from imufield.simulate.truth.grades import GRADES, TrueInstrument, draw_truth
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import Site, sample_motion
from imufield.simulate.truth.motion_pieces import Piece

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "calibrate"))
from gyroscope_sessions import simulate, steady

EQUATOR_RADIUS_M = 6378137.0
HOURS = 5.0
SEEDS = 100
BLOCK = 6000


def apply_with(accelerometer: AccelerometerParameters, gyroscope: GyroscopeParameters) -> Apply:
    def apply(samples: Samples) -> Corrected:
        force = correct_accelerometer(accelerometer, samples.accelerometer_rate())
        return Corrected(samples.time_s, force, correct_gyroscope(gyroscope, samples.gyroscope_rate(), force))

    return apply


class Rest:
    """Lies on a table, and is turned over once where a time is given."""

    lever_arm_m = np.zeros(3)

    def __init__(self, seed: int, turned_s: float | None = None) -> None:
        heading = exponential(np.array([0.0, 0.0, np.random.default_rng(seed).uniform(0, 2 * np.pi)]))
        start = multiply(heading, exponential(np.array([np.pi, 0.0, 0.0])))
        end_s = 1e6 if turned_s is None else turned_s
        self._pieces = [Piece(start_s=0.0, end_s=end_s, quaternion_nb=start, turn_rad=np.zeros(3), wobble_rad=np.zeros(3))]
        if turned_s is not None:
            turn = Piece(
                start_s=end_s,
                end_s=end_s + 4.0,
                quaternion_nb=start,
                turn_rad=np.array([np.pi, 0.0, 0.0]),
                wobble_rad=np.zeros(3),
            )
            self._pieces += [
                turn,
                Piece(
                    start_s=turn.end_s,
                    end_s=1e6,
                    quaternion_nb=turn.final_quaternion,
                    turn_rad=np.zeros(3),
                    wobble_rad=np.zeros(3),
                ),
            ]

    def attitude(self, time_s: FloatArray) -> FloatArray:
        out = np.empty((len(time_s), 4))
        for piece in self._pieces:
            inside = (time_s >= piece.start_s) & (time_s <= piece.end_s)
            if inside.any():
                out[inside] = piece.attitude(time_s[inside])
        out[time_s < 0] = self._pieces[0].quaternion_nb
        return out

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        return np.zeros((len(time_s), 3))

    def resting_attitude(self, start_s: float, end_s: float) -> FloatArray | None:
        for piece in self._pieces:
            still = not np.any(piece.turn_rad)
            if still and (start_s >= piece.start_s or piece is self._pieces[0]) and end_s <= piece.end_s:
                return piece.quaternion_nb
        return None


def recording(
    instrument: TrueInstrument, seed: int, *, hours: float = HOURS, rate_hz: float = 100.0, turned_s: float | None = None
) -> Iterator[Samples]:
    imu = Imu(instrument, seed, ImuSettings(rate_hz=rate_hz))
    path = Rest(seed, turned_s)
    for first in range(0, int(hours * 3600 * rate_hz), BLOCK):
        yield imu.feed(sample_motion(path, first, BLOCK, 1 / rate_hz, site=Site()))


def calibrated(seed: int, hold_s: float = 20.0) -> tuple[TrueInstrument, Calibration]:
    """A navigation-grade instrument and what a session of 24 positions finds out about it."""
    instrument = steady(draw_truth(GRADES["navigation"], np.random.default_rng([seed, 7])))
    session = simulate(seed, grade="navigation", hold_s=hold_s)
    return instrument, calibrate_gyroscope(session.given).join(session.calibration)


def navigate(
    instrument: TrueInstrument,
    calibration: Calibration,
    seed: int,
    *,
    rate_hz: float,
    hours: float = HOURS,
    turned: bool = False,
) -> NavigationResult:
    nominal = apply_with(
        AccelerometerParameters(scale=np.ones(3), bias_m_s2=np.zeros(3), misalignment_rad=np.zeros((3, 3))),
        GyroscopeParameters(np.ones(3), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))),
    )
    new = apply_with(calibration.accelerometer, calibration.gyroscope.parameters)
    settings = CheckSettings(latitude_deg=Site().latitude_deg, gravity_m_s2=Site().gravity_m_s2, turned=turned)
    check = StaticNavigation({"before": nominal, "new": new}, settings)
    turned_s = 630.0 if turned else None
    for block in recording(instrument, 1000 + seed, hours=hours, rate_hz=rate_hz, turned_s=turned_s):
        check.feed(block)
    return check.finish(calibration)


def speed() -> list[dict[str, Any]]:
    """Return time and memory of 5 h with two sets, and how far the positions are from those of a direct run."""
    instrument, calibration = calibrated(0)
    blocks = list(recording(instrument, 1))
    begin, begin_cpu = time.perf_counter(), time.process_time()
    gyroscope = GyroscopeParameters(np.ones(3), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)))
    before = apply_with(
        AccelerometerParameters(scale=np.ones(3), bias_m_s2=np.zeros(3), misalignment_rad=np.zeros((3, 3))), gyroscope
    )
    new = apply_with(calibration.accelerometer, calibration.gyroscope.parameters)
    check = StaticNavigation({"before": before, "new": new}, CheckSettings(latitude_deg=Site().latitude_deg))
    for block in blocks:
        check.feed(block)
    drift = check.finish(calibration).drifts["new"]
    wall_s, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    name = "5 h at 100 Hz, two parameter sets"
    return [
        {"name": f"{name}: time", "value": wall_s, "unit": "s"},
        {"name": f"{name}: processor", "value": cpu_s, "unit": "s"},
        {"name": f"{name}: memory, 200 MiB of it the samples", "value": peak, "unit": "MiB"},
        {
            "name": "5 h: largest distance from a direct run of python-ins",
            "value": distance_mm(blocks, new, drift),
            "unit": "mm",
        },
    ]


def distance_mm(blocks: list[Samples], apply: Apply, drift: Drift) -> float:
    """Return the largest distance from python-ins run in one piece over the same corrected samples, same alignment."""
    pyins = load_pyins()
    settings = CheckSettings(latitude_deg=Site().latitude_deg)
    navigated = ParameterSet(apply, settings, checks_gravity=True)
    for block in blocks:
        navigated.feed(block)
        if navigated.alignment is not None:
            break
    corrected = [apply(block) for block in blocks]
    time_s, force, rate = (np.concatenate([getattr(c, name) for c in corrected]) for name in Corrected._fields)
    start_s = float(blocks[0].time_s[0]) + settings.align_s
    first = int(np.searchsorted(time_s, start_s))
    columns = [*pyins.util.GYRO_COLS, *pyins.util.ACCEL_COLS]
    imu = pyins.pandas.DataFrame(np.hstack([rate, force])[first:], index=time_s[first:], columns=columns)
    start = [settings.latitude_deg, 0.0, 0.0, 0.0, 0.0, 0.0, *pyins.transform.mat_to_rph(navigated.alignment.attitude)]
    state = pyins.pandas.Series(start, index=pyins.util.TRAJECTORY_COLS, name=float(time_s[first]))
    increments = pyins.strapdown.compute_increments_from_imu(imu, "rate")
    trajectory = pyins.strapdown.Integrator(state, with_altitude=False).integrate(increments)
    rows = np.minimum(np.searchsorted(trajectory.index.to_numpy(), time_s[first] + drift.time_s), len(trajectory) - 1)
    latitude = trajectory.lat.to_numpy()[rows] - settings.latitude_deg - drift.latitude_deg
    longitude = trajectory.lon.to_numpy()[rows] - drift.longitude_deg
    return float(1e3 * EQUATOR_RADIUS_M * np.radians(max(np.abs(latitude).max(), np.abs(longitude).max())))


def coverage(seeds: int, *, turned: bool) -> list[dict[str, Any]]:
    """Return in how many seeds the drift was within its band."""
    inside, rates, shares = 0, [], []
    for seed in range(seeds):
        instrument, calibration = calibrated(seed)
        result = navigate(instrument, calibration, seed, rate_hz=10.0, turned=turned)
        inside += result.forecast.holds(result.drifts["new"])
        shares.append(result.drifts["new"].rate_nmi_per_h / result.forecast.rate_95_nmi_per_h)
        rates.append(
            [result.drifts["before"].rate_nmi_per_h, result.drifts["new"].rate_nmi_per_h, result.forecast.rate_95_nmi_per_h]
        )
    before, new, most = np.median(rates, axis=0)
    words = "turned over" if turned else "not touched"
    return [
        {"name": f"{words}: within the 95 % band", "value": inside, "unit": f"of {seeds} seeds"},
        {"name": f"{words}: median drift (peer: without calibration)", "value": new, "unit": "nmi/h drift", "peer": before},
        {"name": f"{words}: median of the 95 % forecast", "value": most, "unit": "nmi/h drift"},
        {"name": f"{words}: median drift over its 95 % forecast (forecast itself)", "value": np.median(shares), "unit": "of 1"},
    ]


def run(seeds: int = SEEDS) -> list[dict[str, Any]]:
    """Return one row for each figure."""
    return [*speed(), *coverage(seeds, turned=False), *coverage(max(1, seeds // 4), turned=True)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=SEEDS)
    for line in run(parser.parse_args().seeds):
        print(f"{line['name']:<60} {line['value']:10.4g} {line['unit']}")
