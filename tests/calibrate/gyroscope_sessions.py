"""Simulated sessions for the gyroscope: hand moves between positions, whole turns, and what the truth is in our gauge."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.residuals import GyroscopeData, evaluate
from imufield.calibrate.gyroscope.result import GyroscopeResult
from imufield.calibrate.gyroscope.turntable import TableRows
from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration, GyroscopeParameters
from imufield.calibrate.model.rotation import conjugate, logarithm, multiply
from imufield.calibrate.moves.moves import MoveCollector, Moves, cut_moves
from imufield.calibrate.moves.slots import no_slots
from imufield.calibrate.solvers.triad_costs import TurnsProblem
from imufield.earth import Gravity
from imufield.guide.lead.unguided import StillIntervalFinder
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray, Samples
from imufield.simulate.truth.drift import BiasDrift
from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import GRADES, TrueInstrument, draw_truth
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import Site
from imufield.simulate.truth.motion_pieces import Piece
from imufield.simulate.truth.operator import Operator, OperatorSettings

BLOCK = 4000
Damage = Callable[[Samples], Samples]


@dataclass(frozen=True)
class Session:
    given: GyroscopeInput
    truth: GyroscopeParameters
    calibration: Calibration
    turn_times_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Turn:
    """A whole turn that the operator makes at the end."""

    axis: FloatArray
    """Body axis, unit."""
    angle_rad: float = 2 * np.pi
    upright: bool = False
    """About the vertical instead of a horizontal axis."""


class Turner(Operator):
    """An operator who, at the end, turns the unit over: whole turns about body axes."""

    def __init__(
        self, directions: FloatArray, seed: int, settings: OperatorSettings, site: Site, turns: tuple[Turn, ...]
    ) -> None:
        super().__init__(directions, seed, settings, site)
        self._turns = turns
        self.turn_times_s: list[float] = []

    def plan_all(self) -> float:
        end_s = super().plan_all()
        if not self._turns:
            return end_s
        last = self._pieces.pop()
        self.stills[-1] = replace(self.stills[-1], end_s=last.start_s)
        rng = np.random.default_rng([self._seed, 303])
        at, end_s = last.quaternion_nb, last.start_s
        for turn in self._turns:
            at, end_s = self._place(turn, rng, at, end_s)
            wobble = self.settings.wobble_rad * rng.standard_normal(3)
            stop_s = end_s + rng.uniform(3.0, 4.0)
            piece = Piece(
                start_s=end_s,
                end_s=stop_s,
                quaternion_nb=at,
                turn_rad=turn.angle_rad * turn.axis,
                wobble_rad=wobble,
                wobble_hz=1.0,
                lift_m=0.05,
                travel_m=(0.05, 0.02, 0.0),
                hand=self._hand,
            )
            self.turn_times_s.append((end_s + stop_s) / 2)
            end_s, at = self._then_rest(piece), piece.final_quaternion
        self._pieces.append(replace(last, start_s=end_s, quaternion_nb=at))
        self.finished_s = end_s
        return end_s

    def _place(self, turn: Turn, rng: np.random.Generator, at: FloatArray, end_s: float) -> tuple[FloatArray, float]:
        """Lay the unit so that the axis is horizontal, or upright."""
        up = turn.axis if turn.upright else np.roll(turn.axis, 1)
        target = self._target(at, up, rng)
        piece = Piece(
            start_s=end_s,
            end_s=end_s + 3.0,
            quaternion_nb=at,
            turn_rad=logarithm(multiply(conjugate(at), target)),
            wobble_rad=np.zeros(3),
            lift_m=0.05,
            hand=self._hand,
        )
        return piece.final_quaternion, self._then_rest(piece)

    def _then_rest(self, piece: Piece) -> float:
        rest_s = piece.end_s + self.settings.hold_s
        self._pieces += [
            piece,
            Piece(
                start_s=piece.end_s,
                end_s=rest_s,
                quaternion_nb=piece.final_quaternion,
                turn_rad=np.zeros(3),
                wobble_rad=np.zeros(3),
            ),
        ]
        return rest_s


def rolled(times: int = 3) -> tuple[Turn, ...]:
    """Whole turns about each axis, both ways, as often as asked."""
    return tuple(Turn(np.eye(3)[axis], way * 2 * np.pi) for _ in range(times) for axis in range(3) for way in (1.0, -1.0))


def steady(instrument: TrueInstrument) -> TrueInstrument:
    """Return the instrument with an exact clock, at one temperature."""
    return replace(instrument, clock_error_ppm=0.0, triad_delay_s=0.0)


def mean_drift(instrument: TrueInstrument, seed: int, observations: Observations) -> FloatArray:
    """Return the mean drift of the gyroscope over the stills, rad/s: the bias of a session is what it was in that session."""
    grade = instrument.grade
    instability = np.repeat([grade.accelerometer.bias_instability, grade.gyroscope.bias_instability], 3)
    walk = np.repeat([grade.accelerometer.random_walk, grade.gyroscope.random_walk], 3)
    drift = BiasDrift(instability, walk, np.random.default_rng([seed, 102]))
    centre_s = np.sort(observations.start_s + observations.duration_s / 2)
    return np.asarray(np.mean([drift.at(np.array([time_s]))[0, 3:] for time_s in centre_s], axis=0))


def blocks(imu: Imu, operator: Operator) -> Iterator[Samples]:
    total = int(operator.plan_all() / imu.interval_s)
    for first in range(0, total, BLOCK):
        yield imu.feed(operator.block(first, min(BLOCK, total - first), imu.interval_s))


def record(seed: int, directions: FloatArray) -> tuple[Observations, Moves]:
    """Return the stills and moves of a session that need not be enough for an accelerometer."""
    drawn = steady(draw_truth(GRADES["mems"], np.random.default_rng([seed, 7])))
    habits = OperatorSettings(
        hold_s=8.0, initial_still_s=12.0, placement_error_rad=0.0, random_headings=False, wobble_rad=0.0, sway_rad=0.0
    )
    operator = Operator(directions, seed, habits, Site())
    imu = Imu(drawn, seed, ImuSettings(rate_hz=200.0))
    finder = StillIntervalFinder(drawn.grade.units, RoughScale.of_units(drawn.grade.units))
    collector = MoveCollector(drawn.grade.units)
    for block in blocks(imu, operator):
        finder.feed(block)
        collector.feed(block)
    observations = finder.finish().observations
    return observations, collector.finish(observations.start_s, observations.duration_s)


def simulate(
    seed: int,
    *,
    grade: str = "mems",
    rate_hz: float = 100.0,
    hold_s: float = 8.0,
    turns: tuple[Turn, ...] = (),
    settings: ImuSettings | None = None,
    latitude_deg: float | None = 45.0,
    positions: FloatArray | None = None,
    damage: Damage | None = None,
    effects: Effects = NO_EFFECTS,
) -> Session:
    """Simulate a session and bring it to where the gyroscope is calibrated; ``damage`` is done to every block."""
    drawn = replace(steady(draw_truth(GRADES[grade], np.random.default_rng([seed, 7]))), effects=effects)
    habits = OperatorSettings(hold_s=hold_s, initial_still_s=hold_s)
    directions = scheme("paper24").directions() if positions is None else positions
    operator = Turner(directions, seed, habits, Site(), turns)
    imu = Imu(drawn, seed, settings or ImuSettings(rate_hz=rate_hz))
    finder = StillIntervalFinder(drawn.grade.units, RoughScale.of_units(drawn.grade.units))
    collector = MoveCollector(drawn.grade.units)
    for block in blocks(imu, operator):
        finder.feed(block)
        collector.feed(block if damage is None else damage(block))
    observations = finder.finish().observations
    calibration = calibrate_accelerometer(
        observations, Gravity(gravity_m_s2=Site().gravity_m_s2, sigma_m_s2=1e-5, source="typed", latitude_deg=45.0)
    )
    moves = collector.finish(observations.start_s, observations.duration_s)
    truth = replace(drawn.gyroscope, bias=drawn.gyroscope.bias + drawn.gyroscope.scale * mean_drift(drawn, seed, observations))
    rotation = change_gauge(to_vector(drawn.accelerometer), "lower").rotation
    given = GyroscopeInput(observations=observations, moves=moves, calibration=calibration, latitude_deg=latitude_deg)
    return Session(given, turn_gyroscope(truth, rotation), calibration, tuple(operator.turn_times_s))


def vector(p: GyroscopeParameters) -> FloatArray:
    off_diagonal = p.misalignment_rad[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
    return np.concatenate([p.scale, off_diagonal, p.bias, p.g_sensitivity.ravel()])


def ratios(session: Session, result: GyroscopeResult) -> FloatArray:
    """Errors over sigma."""
    found = vector(result.calibration.parameters) - vector(session.truth)
    return np.asarray(found / vector(result.calibration.sigma))


def collect_moves(blocks: Iterable[Samples], start_s: FloatArray, duration_s: FloatArray) -> Moves:
    """The moves between still intervals of a recording whose blocks, in time order, are cut anywhere."""
    collector: MoveCollector | None = None
    for block in blocks:
        collector = collector or MoveCollector(block.units)
        collector.feed(block)
    if collector is None:
        return cut_moves(no_slots(), start_s, duration_s)
    return collector.finish(start_s, duration_s)


def fit_turns_only(data: GyroscopeData, start: FloatArray, *, iterations: int = 30) -> FloatArray:
    """``p`` with A fitted to the moves alone, unweighted, everything else held: the model of [1]_.

    For comparison with other programs; it knows no uncertainty.

    References
    ----------
    .. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU calibration without external
       equipments", ICRA 2014.
    """
    p = start.copy()
    for _ in range(iterations):
        now = evaluate(p, data)
        rows = 2 * now.moves
        change = -np.linalg.lstsq(now.jacobian[:rows, :9], now.residual[:rows], rcond=None)[0]
        p[:9] += change
        if np.abs(change).max() <= 1e-12 * np.abs(p[:9]).max():
            break
    return p


def matrix_from_pairs(table: TableRows) -> FloatArray:
    """K E by plain least squares over all pairs of turntable runs, shape (3, 3): eq. 25 of IDE in vector form."""
    return np.asarray(np.linalg.lstsq(table.rate_rad_s, table.half_difference_raw, rcond=None)[0], dtype=np.float64).T


def turns_problem(table: TableRows, reach: float = 0.05, form: Literal["norm", "vector"] = "vector") -> TurnsProblem:
    """Pairs as a problem for any solver, within ``reach`` of plain least squares: eq. 26 of IDE ("norm") or the vector form."""
    K = np.diag(matrix_from_pairs(table))
    half = np.concatenate([reach * np.abs(K), np.full(6, reach)])
    middle = np.concatenate([K, np.zeros(6)])
    return TurnsProblem(
        difference=2 * table.half_difference_raw, rate=table.rate_rad_s, lower=middle - half, upper=middle + half, form=form
    )
