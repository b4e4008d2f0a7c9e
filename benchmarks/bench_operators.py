"""Two hundred simulated operators, placed and held, clumsy in every way: what the guide accepts, and how good it is.

Each seed draws grade, rate, habits and faults. The operator waits for "accepted", goes where the guide proposes, shows wrong
sides, pauses, bumps what he holds. Truth is known: an accepted interval must not overlap true motion, and its mean must agree
with the instrument's own parameters.
"""

from __future__ import annotations

import argparse
import math
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.models import recover
from imufield.guide.events import Accepted, Advice, Done, Event, Move, RefusalCode, Rejected, Topic
from imufield.guide.guide import Guide
from imufield.guide.positions import scheme
from imufield.guide.scale import RoughScale
from imufield.guide.settings import GuideSettings
from imufield.guide.state_table import State
from imufield.simulate.grades import GRADES, draw_truth
from imufield.simulate.imu import Imu, ImuSettings
from imufield.simulate.operator import Operator, OperatorSettings

MICRO_G = 9.80665e-6
BLOCK_S = 0.1
LONGEST_S = 3600.0


@dataclass
class Run:
    """What one operator achieved."""

    seed: int
    style: str
    grade: str
    rate_hz: float
    accepted: int = 0
    overlaps: int = 0
    bumped_accepted: int = 0
    bumped_worst_sigma: float = 0.0
    worst_sigma: float = 0.0
    error_ug: float = 0.0
    sigma_ug: float = 0.0
    used: float = 0.0
    start_late_s: float = 0.0
    start_early_s: float = 0.0
    session_s: float = 0.0
    ideal_s: float = 0.0
    doubts: int = 0
    refusals: str = ""


def draw(seed: int) -> tuple[Operator, Imu, GuideSettings, Run]:
    rng = np.random.default_rng([seed, 900])
    style = ("placed", "held")[seed % 2]
    grade = list(GRADES.values())[(seed // 2) % 4]
    instrument = replace(draw_truth(grade, rng), triad_delay_s=rng.uniform(0, 0.002))
    lever = rng.standard_normal(3)
    lever *= rng.uniform(0, 0.1) / np.linalg.norm(lever)
    habits = OperatorSettings(
        style=style,  # type: ignore[arg-type]
        hold_s=20.0,
        initial_still_s=8.0,
        turn_s=(0.5, 5.0),
        placement_error_rad=math.radians(15),
        lever_arm_m=tuple(lever),
        tremor_rad=math.radians(rng.uniform(0.02, 0.1)),
        sway_rad=math.radians(rng.uniform(0.1, 1.0)),
        bump_probability=0.08,
        wrong_probability=0.08,
        pause_probability=0.05,
        waits=True,
    )
    rate_hz = float(rng.choice([100, 200, 500]))
    positions = scheme("paper24")
    operator = Operator(positions.directions(), seed, habits)
    imu = Imu(instrument, seed, ImuSettings(rate_hz=rate_hz, drift=False, loss_probability=0.001))
    hold_s = 10.0 if (seed // 8) % 2 else None
    return operator, imu, GuideSettings(hold_s=hold_s), Run(seed, style, grade.name, rate_hz)


def play(operator: Operator, imu: Imu, guide: Guide) -> list[Event]:
    """Feed the guide, and let the operator hear it."""
    names = [position.name for position in guide.plan.scheme.positions]
    events: list[Event] = []
    target: int | None = None
    size = max(1, round(BLOCK_S * imu.settings.rate_hz))
    first, resting_s = 0, 0.0
    while not guide.done and first / imu.settings.rate_hz < LONGEST_S:
        said = guide.feed(imu.feed(operator.block(first, size, imu.interval_s)))
        first += size
        for event in said:
            if isinstance(event, Move):
                target = names.index(event.position)
        leave = any(isinstance(event, Accepted) or (isinstance(event, Rejected) and event.reason in _LEAVE) for event in said)
        resting_s = 0.0 if guide.state is not State.RESTING else resting_s + BLOCK_S
        # Whoever lingers on a side that is done reads the screen and goes on.
        if leave or resting_s > 3.0:
            operator.accepted(target)
        events += said
    return events


_LEAVE = (RefusalCode.ALREADY_DONE, RefusalCode.NOT_NEAR)


def examine(run: Run, operator: Operator, imu: Imu, guide: Guide, events: list[Event]) -> None:
    taken = [event for event in events if isinstance(event, Accepted)]
    run.accepted = len(guide.plan.accepted)
    clock = imu.to_sample_clock
    stills = [(clock(one.start_s), clock(one.end_s), one) for one in operator.stills]
    moves = [(clock(one.start_s), clock(one.end_s), one.kind) for one in operator.moves]
    errors, sigmas, used = [], [], []
    rows = {one.name: one for one in guide.plan.accepted.values()}
    for event in taken:
        end_s = event.start_s + event.duration_s
        run.overlaps += any(kind == "turn" and a < end_s and b > event.start_s for a, b, kind in moves)
        bumped = any(kind != "turn" and a < end_s and b > event.start_s for a, b, kind in moves)
        inside = [(a, b, one) for a, b, one in stills if a <= event.start_s + 0.01 and event.start_s < b]
        if inside and not bumped:
            begin = inside[-1][0]
            guard = 1.0 if event.held else 0.3
            used.append(event.duration_s / max(event.time_s - begin - 2 * guard, 0.1))
            late = event.start_s - guard - begin
            run.start_late_s, run.start_early_s = max(run.start_late_s, late), max(run.start_early_s, -late)
        found = rows.get(event.position)
        if found is None or found.start_s != event.start_s:
            continue
        force = recover(imu.instrument.accelerometer, found.mean_raw[None, :])[0]
        error = float(np.linalg.norm(force)) - operator.site.gravity_m_s2
        along = force / np.linalg.norm(force)
        sigma = math.sqrt(float(along @ found.covariance_raw @ along)) / float(imu.instrument.accelerometer.scale[0])
        errors.append(error / MICRO_G)
        sigmas.append(sigma / MICRO_G)
        if bumped:
            run.bumped_accepted += 1
            run.bumped_worst_sigma = max(run.bumped_worst_sigma, abs(error / sigma))
        run.worst_sigma = max(run.worst_sigma, abs(error / sigma))
    run.error_ug = float(np.sqrt(np.mean(np.square(errors)))) if errors else math.nan
    run.sigma_ug = float(np.sqrt(np.mean(np.square(sigmas)))) if sigmas else math.nan
    run.used = float(np.mean(used)) if used else math.nan
    run.doubts = sum(isinstance(event, Advice) and event.topic is Topic.DOUBTFUL for event in events)
    refused = [event.reason.value for event in events if isinstance(event, Rejected)]
    run.refusals = " ".join(f"{name}:{refused.count(name)}" for name in sorted(set(refused)))
    run.session_s = next((event.time_s for event in events if isinstance(event, Done)), math.nan)
    run.ideal_s = sum(event.duration_s for event in taken) + sum(b - a for a, b, kind in moves if kind == "turn")


def run_seed(seed: int) -> Run:
    operator, imu, settings, run = draw(seed)
    units = imu.instrument.grade.units
    grade = imu.instrument.grade
    scale = replace(
        RoughScale.of_units(units),
        accelerometer=grade.accelerometer_scale,
        gyroscope=grade.gyroscope_scale,
    )
    guide = Guide(scheme("paper24"), units, scale=scale, settings=settings)
    events = play(operator, imu, guide)
    examine(run, operator, imu, guide, events)
    return run


def summarise(runs: list[Run]) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []

    def row(name: str, value: float | str, unit: str = "") -> None:
        rows.append({"name": name, "value": value if isinstance(value, str) else round(float(value), 3), "unit": unit})

    row("operators", len(runs))
    row("with all 24 positions accepted", sum(run.accepted == 24 for run in runs))
    row("accepted intervals that overlap true motion", sum(run.overlaps for run in runs))
    for style in ("placed", "held"):
        some = [run for run in runs if run.style == style]
        if not some:
            continue
        row(f"{style}: stillness used, guard bands aside, mean", 100 * np.mean([run.used for run in some]), "%")
        row(f"{style}: the same, worst session", 100 * min(run.used for run in some), "%")
        row(f"{style}: start found late by at most", max(run.start_late_s for run in some), "s")
        row(f"{style}: start found early by at most", max(run.start_early_s for run in some), "s")
        row(f"{style}: error of the norm, rms over sessions' rms", np.sqrt(np.mean([run.error_ug**2 for run in some])), "ug")
        row(f"{style}: sigma stated, the same way", np.sqrt(np.mean([run.sigma_ug**2 for run in some])), "ug")
        row(f"{style}: worst error over its sigma", max(run.worst_sigma for run in some), "sigma")
        row(f"{style}: bumped holds accepted", sum(run.bumped_accepted for run in some))
        row(f"{style}: worst of them", max(run.bumped_worst_sigma for run in some), "sigma")
        row(f"{style}: positions doubted without cause", sum(run.doubts for run in some))
    return rows


def run(count: int = 200, workers: int = 2) -> list[dict[str, object]]:
    """Return rows of name, value, unit."""
    with ProcessPoolExecutor(workers) as pool:
        return summarise(list(pool.map(run_seed, range(count))))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    begin = time.perf_counter()
    with ProcessPoolExecutor(options.workers) as pool:
        runs = []
        for one in pool.map(run_seed, range(options.first, options.first + options.count)):
            runs.append(one)
            if options.verbose:
                print(one, flush=True)
    for line in summarise(runs):
        print(f"{line['name']:60} {line['value']:>10} {line['unit']}")
    print(f"{time.perf_counter() - begin:.0f} s")
