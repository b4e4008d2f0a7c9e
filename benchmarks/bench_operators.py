"""Two hundred simulated operators, placed and held, clumsy in every way: what the guide accepts, and how good it is.

Each seed draws grade, rate, habits and faults. The operator waits for "accepted", goes where the guide proposes, shows wrong
sides, pauses, bumps what he holds. Truth is known: an accepted interval must not overlap true motion, and its mean must agree
with the instrument's own parameters.

What is true stillness? A unit that is put down is still when the ring-down of the put-down is over. A unit in the hand never
is: it sways about the attitude in which it is held, and a turn fades into that sway (minimum jerk: it ends with rate and angle
zero). Before the turn's end there is a moment when what is left of it, an angle, is as small as the rms angle by which this
hand strays anyway; from then on nobody could tell. So the true start of a hold in the hand is known as a range, from that
moment to the end of the turn, and the true end likewise; what is found is compared with the nearer end of the range.

What a bump does: an accepted hold with a bump in it is measured again on the same noise with the bump taken out of the motion
(for a shift: what comes after it stays where it was before). The difference of the two norms is the bump's own share.
"""

from __future__ import annotations

import argparse
import math
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.operator_truth import Edges, EdgeWatch, Standards, bump_shares, outside, true_edges
from imufield.calibrate.model.models import recover
from imufield.earth import MICRO_G_M_S2
from imufield.guide.events import Accepted, Advice, Done, Event, Move, RefusalCode, Rejected, Topic
from imufield.guide.hold.in_hand import HAND_GUARD_S
from imufield.guide.hold.observe import Observation, guard_cells
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import State
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import CELL_S
from imufield.simulate.truth.grades import GRADES, draw_truth
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings

BLOCK_S = 0.3
"""What the guide gets at once, and how late the operator may hear it."""
LONGEST_S = 3600.0
LONG_ENOUGH_S = 3.0
"""Stills shorter than this are pauses in a turn."""


@dataclass
class Run:
    """What one operator achieved."""

    seed: int
    style: str
    grade: str
    rate_hz: float
    accepted: int = 0
    overlaps: int = 0
    bumped: int = 0
    """Holds with a bump in them that were accepted."""
    bump_share_sigma: float = 0.0
    """The largest that a bump did to a mean that was accepted, in units of its sigma."""
    worst_sigma: float = 0.0
    error_ug: float = 0.0
    sigma_ug: float = 0.0
    used: float = 0.0
    used_worst: float = math.nan
    starts_s: tuple[float, ...] = ()
    """Of accepted holds, guard band added, after (positive) or before the truth."""
    found_s: tuple[tuple[float, float, int], ...] = ()
    """The detector alone: start and end against the truth, and the stretches that it broke the hold into."""
    session_s: float = 0.0
    ideal_s: float = 0.0
    doubts: int = 0
    refusals: str = ""


def draw(seed: int) -> tuple[Operator, Imu, GuideSettings, Run]:
    rng = np.random.default_rng([seed, 900])
    style = ("placed", "held")[seed % 2]
    grade = list(GRADES.values())[(seed // 2) % 4]
    instrument = replace(draw_truth(grade, rng), triad_delay_s=rng.uniform(-0.002, 0.002))
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


@dataclass
class Played:
    """What happened in a session."""

    events: list[Event]
    taken: list[tuple[Accepted, Observation]]
    watch: EdgeWatch


def play(operator: Operator, imu: Imu, guide: Guide) -> Played:
    """Feed the guide, and let the operator hear it."""
    names = [position.name for position in guide.plan.scheme.positions]
    played = Played([], [], EdgeWatch(guide.detector.scale))
    target: int | None = None
    size = max(1, round(BLOCK_S * imu.settings.rate_hz))
    first, resting_s = 0, 0.0
    while not guide.done and first / imu.settings.rate_hz < LONGEST_S:
        samples = imu.feed(operator.block(first, size, imu.interval_s))
        said = guide.feed(samples)
        played.watch.feed(samples)
        first += size
        for event in said:
            if isinstance(event, Move):
                target = names.index(event.position)
            if isinstance(event, Accepted):
                played.taken.append((event, guide.plan.accepted[names.index(event.position)]))
        leave = any(isinstance(event, Accepted) or (isinstance(event, Rejected) and event.reason in _LEAVE) for event in said)
        resting_s = 0.0 if guide.state is not State.RESTING else resting_s + BLOCK_S
        # Whoever lingers on a side that is done reads the screen and goes on.
        if leave or resting_s > 3.0:
            operator.accepted(target)
        played.events += said
    return played


_LEAVE = (RefusalCode.ALREADY_DONE, RefusalCode.NOT_NEAR)


def examine(run: Run, operator: Operator, imu: Imu, guide: Guide, played: Played) -> None:
    """Hold what the guide said against the truth."""
    moves = [(imu.to_sample_clock(move.start_s), imu.to_sample_clock(move.end_s), move.kind) for move in operator.moves]
    edges = true_edges(operator, imu)
    run.accepted = len(guide.plan.accepted)
    bumped = []
    errors, sigmas = [], []
    for event, found in played.taken:
        end_s = event.start_s + event.duration_s
        inside = [kind for a, b, kind in moves if a < end_s and b > event.start_s]
        run.overlaps += "turn" in inside
        if any(kind != "turn" for kind in inside):
            bumped.append((event, found))
        error, sigma = norm_error(operator, imu, found)
        errors.append(error)
        sigmas.append(sigma)
    run.error_ug = float(np.sqrt(np.mean(np.square(errors)))) / MICRO_G_M_S2 if errors else math.nan
    run.sigma_ug = float(np.sqrt(np.mean(np.square(sigmas)))) / MICRO_G_M_S2 if sigmas else math.nan
    run.worst_sigma = float(np.max(np.abs(errors) / np.array(sigmas))) if errors else math.nan
    examine_bumps(run, operator, imu, guide, bumped)
    examine_edges(run, guide, played, edges)
    examine_words(run, played.events)
    turned_s = sum(b - a for a, b, kind in moves if kind == "turn")
    run.ideal_s = sum(event.duration_s for event, _ in played.taken) + turned_s


def norm_error(operator: Operator, imu: Imu, found: Observation) -> tuple[float, float]:
    """Return error and sigma of the norm of a mean, m/s^2, by the instrument's own parameters."""
    force = recover(imu.instrument.accelerometer, found.mean_raw[None, :])[0]
    norm = float(np.linalg.norm(force))
    along = force / norm
    sigma = math.sqrt(float(along @ found.covariance_raw @ along)) / float(imu.instrument.accelerometer.scale[0])
    return norm - operator.site.gravity_m_s2, sigma


def examine_bumps(run: Run, operator: Operator, imu: Imu, guide: Guide, bumped: list[tuple[Accepted, Observation]]) -> None:
    """Measure what the bumps in accepted holds did to them."""
    floor = guide.detector.floor
    run.bumped = len(bumped)
    if floor is None or not bumped:
        return
    standards = Standards(guide.detector.scale, floor, guide.detector.limits)
    shares = bump_shares(operator, imu, bumped, standards)
    sigmas = [norm_error(operator, imu, found)[1] for _, found in bumped]
    run.bump_share_sigma = max(abs(share) / sigma for share, sigma in zip(shares, sigmas, strict=True))


def examine_edges(run: Run, guide: Guide, played: Played, edges: list[Edges]) -> None:
    """Compare starts and ends found with the true ones, and see how much of the stillness was used."""
    placed_guard_s = guard_cells(guide.detector.limits) * CELL_S
    starts, used = [], []
    for event, _ in played.taken:
        inside = [edge for edge in edges if edge.begin_s[0] <= event.start_s + 0.01 and event.start_s < edge.end_s[1]]
        if not inside or inside[-1].bumped:
            continue
        begin_s = inside[-1].begin_s
        guard_s = HAND_GUARD_S if event.held else placed_guard_s
        used.append(event.duration_s / max(event.time_s - begin_s[1] - 2 * guard_s, 0.1))
        starts.append(outside(event.start_s - guard_s, begin_s))
    run.starts_s = tuple(starts)
    run.used = float(np.mean(used)) if used else math.nan
    run.used_worst = min(used, default=math.nan)
    found = []
    for edge in edges[1:]:
        stretches = [pair for pair in played.watch.found if pair[0] < edge.end_s[0] - 0.5 and pair[1] > edge.begin_s[1] + 0.5]
        if stretches and not edge.bumped and math.isfinite(edge.end_s[1]) and edge.end_s[0] - edge.begin_s[1] > LONG_ENOUGH_S:
            found.append((outside(stretches[0][0], edge.begin_s), outside(stretches[-1][1], edge.end_s), len(stretches)))
    run.found_s = tuple(found)


def examine_words(run: Run, events: list[Event]) -> None:
    """Count what was said."""
    run.doubts = sum(isinstance(event, Advice) and event.topic is Topic.DOUBTFUL for event in events)
    refused = [event.reason.value for event in events if isinstance(event, Rejected)]
    run.refusals = " ".join(f"{name}:{refused.count(name)}" for name in sorted(set(refused)))
    run.session_s = next((event.time_s for event in events if isinstance(event, Done)), math.nan)


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
    examine(run, operator, imu, guide, play(operator, imu, guide))
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
        starts = np.concatenate([run.starts_s for run in some])
        found = np.array([stretch for run in some for stretch in run.found_s])
        row(f"{style}: stillness used, guard bands aside, mean", 100 * float(np.mean([run.used for run in some])), "%")
        row(f"{style}: the same, worst session", 100 * min(run.used for run in some), "%")
        row(f"{style}: the same, worst hold", 100 * min(run.used_worst for run in some), "%")
        row(f"{style}: accepted start late by at most", max(starts.max(), 0), "s")
        row(f"{style}: accepted start early by at most", max(-starts.min(), 0), "s")
        row(f"{style}: accepted starts within 0.3 s", 100 * np.mean(np.abs(starts) <= 0.3), "%")
        for column, edge in enumerate(("start", "end")):
            row(f"{style}: detector {edge} late by at most", max(found[:, column].max(), 0), "s")
            row(f"{style}: detector {edge} early by at most", max(-found[:, column].min(), 0), "s")
            row(f"{style}: detector {edge}s within 0.3 s", 100 * np.mean(np.abs(found[:, column]) <= 0.3), "%")
        row(f"{style}: holds that the detector broke", 100 * float(np.mean(found[:, 2] > 1)), "%")
        row(f"{style}: error of the norm, rms over sessions' rms", np.sqrt(np.mean([run.error_ug**2 for run in some])), "ug")
        row(f"{style}: sigma stated, the same way", np.sqrt(np.mean([run.sigma_ug**2 for run in some])), "ug")
        row(f"{style}: worst error over its sigma", max(run.worst_sigma for run in some), "sigma")
        row(f"{style}: holds accepted with a bump in them", sum(run.bumped for run in some))
        row(f"{style}: most that a bump did to one", max(run.bump_share_sigma for run in some), "sigma")
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
        for session in pool.map(run_seed, range(options.first, options.first + options.count)):
            runs.append(session)
            if options.verbose:
                print(session, flush=True)
    for line in summarise(runs):
        print(f"{line['name']:60} {line['value']:>10} {line['unit']}")
    print(f"{time.perf_counter() - begin:.0f} s")
