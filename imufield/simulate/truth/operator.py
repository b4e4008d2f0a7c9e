"""A virtual operator who turns the unit by hand from position to position.

The motion is a chain of pieces (``motion_pieces.py``), planned one visit ahead. Each visit draws from its own stream of random
numbers, so what happens in a visit depends on the seed and the number of the visit only. ``stills`` and ``moves`` record what
the operator did: the truth that a detector is compared with.

By default the operator stays ``hold_s`` in each position and goes on. With ``waits=True`` it stays until ``accepted`` is
called.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from imufield.calibrate.model.rotation import conjugate, exponential, logarithm, multiply, rotate
from imufield.dataclass import dataclass, replace
from imufield.errors import UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences
from imufield.simulate.truth.motion import Site, TrueMotion, sample_motion, shortest_turn, up_direction
from imufield.simulate.truth.motion_pieces import Hand, Piece, Shock, draw_hand

sentence = Sentences(__package__)

DEG = math.radians(1.0)
SPIN_S = (3.0, 4.0)
SPIN_REST_S = 5.0
NO_POSITION = -1
"""``StillInterval.position`` of a unit that is in no planned position."""

StillKind = Literal["placed", "held"]
BumpKind = Literal["knock", "shift"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorSettings:
    """Habits of the operator. Ranges are drawn from uniformly."""

    style: StillKind = "placed"
    hold_s: float = 12.0
    """Stay in a position, from put-down to pick-up."""
    initial_still_s: float = 12.0
    """On the table before the first move, for the noise floor; in the attitude of the first position."""
    begins_in_first_position: bool = False
    """The initial still is the first position as well, as a person does who follows the guide; it lasts ``hold_s`` longer."""
    turn_s: tuple[float, float] = (1.0, 3.0)
    peak_rate_rad_s: float = 250 * DEG
    """A turn takes longer rather than go faster than this."""
    placement_error_rad: float = 3 * DEG
    """Largest tilt away from the planned direction."""
    settling_rad: float = 0.0
    """Tilt by which a soft support, such as foam, gives way under a unit that is put down."""
    settling_s: float = 5.0
    """Time constant of that."""
    random_headings: bool = True
    wobble_rad: float = 3 * DEG
    """1 sigma of the wobble amplitude of a turn, each axis."""
    lift_m: tuple[float, float] = (0.02, 0.15)
    lever_arm_m: tuple[float, float, float] = (0.03, -0.02, 0.04)
    """Sensor from the pivot of rotation, body frame."""
    put_down_m_s2: float = 3.0
    """Peak of the shock when the unit is put down."""
    tremor_rad: float = 0.04 * DEG
    """RMS of each axis in the hand."""
    tremor_band_hz: tuple[float, float] = (8.0, 12.0)
    sway_rad: float = 0.2 * DEG
    """RMS of each axis in the hand."""
    sway_m: float = 0.002
    """RMS of each axis in the hand."""
    bump_probability: float = 0.0
    """Chance of each hold to be bumped."""
    bump_kinds: tuple[BumpKind, ...] = ("knock", "shift")
    repeats_after_bump: bool = True
    wrong_probability: float = 0.0
    """Chance to show a wrong side (an old position or one that was never planned) before the right one."""
    pause_probability: float = 0.0
    pause_s: tuple[float, float] = (5.0, 30.0)
    """A pause lengthens the hold."""
    reaction_s: tuple[float, float] = (0.3, 0.8)
    """From ``accepted`` to picking up."""
    waits: bool = False
    rotations: Literal["rolled", "table"] | None = None
    """Whole turns after the last position, about each axis, both ways: over the edges, or upright on the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StillInterval:
    """An interval, in true time, in which the unit is still (placed) or as still as a hand can be (held).

    ``bumped`` marks both sides of a bump; the bump itself belongs to no interval.
    """

    start_s: float
    end_s: float
    direction: FloatArray
    """True "up" in the body frame, shape (3,); of a unit in the hand, the mean direction."""
    position: int
    """Number of the planned position, ``NO_POSITION`` for the initial still and wrong sides."""
    kind: StillKind
    bumped: bool


@dataclass(frozen=True, slots=True)
class TrueMove:
    """An interval of motion, in true time: a turn with its put-down, or a bump."""

    start_s: float
    end_s: float
    kind: Literal["turn", "knock", "shift"]


@dataclass(frozen=True, slots=True)
class Visit:
    """What the operator does next: turn the unit, and hold it."""

    position: int
    direction: FloatArray
    # Instead of a visit: a whole turn where the unit is, rotation vector in the body frame.
    spin_rad: FloatArray | None = None
    # Instead of the direction: by how much the unit is turned, rotation vector in the body frame.
    turn_rad: FloatArray | None = None


class Operator:
    """A person with a plan: hold the unit with each of the directions up, in the order given.

    Parameters
    ----------
    directions : array_like, shape (m, 3)
        Planned directions of "up" in the body frame; empty for a unit that stays on the table.
    seed : int
    settings : OperatorSettings, optional
    site : Site, optional

    Raises
    ------
    UsageError
        If a direction is not a finite vector of some length.
    """

    def __init__(
        self, directions: ArrayLike, seed: int, settings: OperatorSettings | None = None, site: Site | None = None
    ) -> None:
        self.settings = settings or OperatorSettings()
        self.site = site or Site()
        rows = np.asarray(directions, dtype=np.float64).reshape(-1, 3)
        length = np.linalg.norm(rows, axis=1, keepdims=True)
        if not np.all(np.isfinite(rows)) or np.any(length == 0):
            row = int(np.flatnonzero(~np.isfinite(length) | (length == 0))[0])
            raise UsageError(sentence("operator.direction", row=row, direction=rows[row]))
        self.directions: FloatArray = rows / length
        self.lever_arm_m = np.array(self.settings.lever_arm_m)
        self._seed = seed
        self._agenda = [Visit(index, row) for index, row in enumerate(self.directions)]
        self._agenda += _spins(self.settings.rotations) if len(self.directions) else []
        self._visit_number = 0
        self._heard: deque[int | None] = deque()
        self._asked: deque[Visit] = deque()
        self._generated_s = 0.0
        # True time when the last planned hold ends, None while not known; the unit then stays where it is.
        self.finished_s: float | None = None
        # What he did so far, in time order; the last still interval may end at infinity.
        self.stills: list[StillInterval] = []
        self.moves: list[TrueMove] = []
        habits, rng = self.settings, np.random.default_rng([seed, 201])
        self._hand = draw_hand(rng, habits.tremor_rad, habits.sway_rad, habits.sway_m, tremor_band_hz=habits.tremor_band_hz)
        self._pieces: list[Piece] = []
        self._lie_down()

    def plan(self, until_s: float) -> None:
        """Plan the motion up to a time at least."""
        while self._pieces[-1].end_s <= until_s:
            if self._agenda:
                self._next_visit()
            else:
                self._stay_for_ever()

    def plan_all(self) -> float:
        """Plan everything and return when the last hold ends; infinity for an operator who waits or has no plan."""
        while self._agenda and math.isfinite(self._pieces[-1].end_s):
            self._next_visit()
        if not self._agenda and self.finished_s is None:
            self._stay_for_ever()
        return math.inf if self.finished_s is None else self.finished_s

    def accepted(self, next_position: int | None = None) -> None:
        """Hear that the position is accepted: leave it soon, for ``next_position`` if given.

        Takes effect in the next ``block``, so another thread may call it. Does nothing unless the operator waits then.
        """
        self._heard.append(next_position)

    def show(self, visit: Visit) -> None:
        """Hear what to do when all that was planned or asked before is done.

        Takes effect in the next ``block``, so another thread may call it.
        """
        self._asked.append(visit)

    def block(self, first: int, count: int, interval_s: float) -> TrueMotion:
        """Return the true motion at samples ``first`` to ``first + count - 1``."""
        while self._asked:
            self._agenda.append(self._asked.popleft())
            self._leave(None)
        while self._heard:
            self._leave(self._heard.popleft())
        # Two samples more than asked: the differences of ``sample_motion`` reach over the end of the block.
        self._generated_s = max(self._generated_s, (first + count + 2) * interval_s)
        self.plan(self._generated_s)
        return sample_motion(self, first, count, interval_s, site=self.site)

    def attitude(self, time_s: FloatArray) -> FloatArray:
        """Return ``quaternion_nb`` at rising true times, shape (n, 4)."""
        return np.concatenate([piece.attitude(part) for piece, part in self._split(time_s)])

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        """Return the acceleration of the pivot at rising true times, shape (n, 3), m/s^2, local level frame."""
        return np.concatenate([piece.acceleration(part) for piece, part in self._split(time_s)])

    def resting_attitude(self, start_s: float, end_s: float) -> FloatArray | None:
        """Return the attitude if nothing moves from ``start_s`` to ``end_s``, otherwise None."""
        parts = self._split(np.array([start_s, end_s]))
        if len(parts) > 1 or not parts[0][0].is_rest:
            return None
        return parts[0][0].quaternion_nb

    def _split(self, time_s: FloatArray) -> list[tuple[Piece, FloatArray]]:
        starts = [piece.start_s for piece in self._pieces]
        first, last = np.searchsorted(starts, [time_s[0], time_s[-1]], side="right") - 1
        cuts = np.searchsorted(time_s, starts[first + 1 : last + 1], side="left")
        return list(zip(self._pieces[first : last + 1], np.split(time_s, cuts), strict=True))

    def _rng(self) -> np.random.Generator:
        # One stream for each visit: what happens in a visit does not depend on how much was drawn before it.
        return np.random.default_rng([self._seed, 202, self._visit_number])

    def _lie_down(self) -> None:
        """Begin: the unit is on the table, the first position up."""
        direction = self.directions[0] if len(self.directions) else np.array([0.0, 0.0, 1.0])
        quaternion = self._target(np.array([1.0, 0.0, 0.0, 0.0]), direction, self._rng())
        end_s, position = self.settings.initial_still_s if self._agenda else math.inf, NO_POSITION
        if self._agenda and self.settings.begins_in_first_position:
            end_s, position = end_s + self.settings.hold_s, self._agenda.pop(0).position
        # The differences of the first sample reach to before time zero.
        self._be_still(_rest(-1.0, end_s, quaternion), position, "placed")

    def _be_still(self, piece: Piece, position: int, kind: StillKind, *, bumped: bool = False) -> None:
        """Add a piece without motion and note it among the true still intervals."""
        self._pieces.append(piece)
        up, start_s = up_direction(piece.quaternion_nb), max(piece.start_s, 0.0)
        self.stills.append(
            StillInterval(start_s=start_s, end_s=piece.end_s, direction=up, position=position, kind=kind, bumped=bumped)
        )

    def _stay_for_ever(self) -> None:
        last = self._pieces[-1]
        if math.isinf(last.end_s):
            return
        self.finished_s = last.end_s
        self.stills[-1] = replace(self.stills[-1], end_s=math.inf)
        self._pieces.append(_rest(last.end_s, math.inf, last.final_quaternion, last.hand))

    def _next_visit(self) -> None:
        self._visit_number += 1
        rng = self._rng()
        spin_rad = self._agenda[0].spin_rad
        if spin_rad is None:
            visit = self._choose(rng)
            self._turn_to(visit, rng)
            self._hold(visit, rng)
            return
        # A whole turn: turn the unit once around, put it down where it was, and let it rest.
        self._agenda.pop(0)
        self._pieces.append(self._turn(spin_rad, rng.uniform(*SPIN_S), 0.3 * self.settings.wobble_rad, rng))
        self._put_down(rng)
        self._hold_still(NO_POSITION, SPIN_REST_S)

    def _choose(self, rng: np.random.Generator) -> Visit:
        if rng.random() < self.settings.wrong_probability:
            if rng.random() < 0.5:
                index = int(rng.integers(len(self.directions)))
                return Visit(index, self.directions[index])
            return Visit(NO_POSITION, _random_direction(rng))
        return self._agenda.pop(0)

    def _target(self, quaternion: FloatArray, direction: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the attitude with ``direction`` up that is nearest to ``quaternion``, with placement error and heading."""
        limit, bearing = self.settings.placement_error_rad, rng.uniform(0, 2 * math.pi)
        # The square root spreads the tilts evenly over the disc.
        tilt = limit * math.sqrt(rng.random()) * np.array([math.cos(bearing), math.sin(bearing), 0.0])
        tilted = rotate(exponential(tilt), np.array([0.0, 0.0, 1.0]))
        missed = rotate(exponential(shortest_turn([0.0, 0.0, 1.0], direction)), tilted)
        turned = multiply(quaternion, conjugate(exponential(shortest_turn(up_direction(quaternion), missed))))
        heading = rng.uniform(-math.pi, math.pi) if self.settings.random_headings else 0.0
        return multiply(exponential(np.array([0.0, 0.0, heading])), turned)

    def _turn(self, turn_rad: FloatArray, duration_s: float, wobble_rad: float, rng: np.random.Generator) -> Piece:
        """Note a turn that begins where the last piece ends, and return its piece."""
        last = self._pieces[-1]
        end_s = last.end_s + duration_s
        self.moves.append(TrueMove(last.end_s, end_s, "turn"))
        return Piece(
            start_s=last.end_s,
            end_s=end_s,
            quaternion_nb=last.final_quaternion,
            turn_rad=turn_rad,
            wobble_rad=wobble_rad * rng.standard_normal(3),
            wobble_hz=rng.uniform(0.7, 2.0),
            lift_m=rng.uniform(*self.settings.lift_m),
        )

    def _turn_to(self, visit: Visit, rng: np.random.Generator) -> None:
        settings, last = self.settings, self._pieces[-1]
        start, in_hand = last.final_quaternion, settings.style == "held"
        turn_rad = visit.turn_rad
        if turn_rad is None:
            turn_rad = logarithm(multiply(conjugate(start), self._target(start, visit.direction, rng)))
        # A minimum-jerk turn peaks at 15/8 of its mean rate: d/du (10 u^3 - 15 u^4 + 6 u^5) at u = 1/2.
        shortest_s = 15 / 8 * float(np.linalg.norm(turn_rad)) / settings.peak_rate_rad_s
        piece = self._turn(turn_rad, max(rng.uniform(*settings.turn_s), shortest_s), settings.wobble_rad, rng)
        # 5 cm (1 sigma) to the side: where one puts a thing down is not where one picked it up.
        travel_m = (*(0.05 * rng.standard_normal(2)), 0.0)
        at_start = last.hand is not None
        self._pieces.append(replace(piece, travel_m=travel_m, hand=self._hand, hand_at_start=at_start, hand_at_end=in_hand))
        if not in_hand:
            self._put_down(rng)

    def _put_down(self, rng: np.random.Generator) -> None:
        """Add the shock of a unit that is put on the table; it belongs to the turn before it."""
        last = self._pieces[-1]
        shock = self._draw_shock(last.end_s, self.settings.put_down_m_s2, rng)
        self._pieces.append(replace(_rest(last.end_s, shock.end_s, last.final_quaternion), shocks=(shock,)))
        self.moves[-1] = replace(self.moves[-1], end_s=shock.end_s)

    def _draw_shock(self, start_s: float, peak_m_s2: float, rng: np.random.Generator) -> Shock:
        acceleration = peak_m_s2 * rng.uniform(0.3, 1.0) * _random_direction(rng)
        # The unit turns as well, by up to 1e-4 rad for 1 m/s^2: chosen small against the tremor of a hand (7e-4 rad).
        rotation = 1e-4 * peak_m_s2 * rng.uniform(0.3, 1.0) * _random_direction(rng)
        return Shock(
            start_s=start_s,
            acceleration=acceleration,
            rotation_rad=rotation,
            frequency_hz=rng.uniform(15.0, 40.0),
            decay_s=rng.uniform(0.01, 0.03),
        )

    def _hold(self, visit: Visit, rng: np.random.Generator) -> None:
        settings = self.settings
        duration_s = settings.hold_s
        if rng.random() < settings.pause_probability:
            duration_s += rng.uniform(*settings.pause_s)
        if rng.random() < settings.bump_probability:
            self._hold_still(visit.position, duration_s * rng.uniform(0.2, 0.8), bumped=True)
            self._bump(rng)
            self._hold_still(visit.position, 0.5 * duration_s, bumped=True)
            if settings.repeats_after_bump and visit.position != NO_POSITION:
                self._agenda.insert(0, visit)
            return
        # Nobody accepts a wrong side, so an operator who waits does not wait there.
        waiting = settings.waits and visit.position != NO_POSITION
        self._hold_still(visit.position, math.inf if waiting else duration_s)

    def _hold_still(self, position: int, duration_s: float, *, bumped: bool = False) -> None:
        last, kind = self._pieces[-1], self.settings.style
        hand = self._hand if kind == "held" else None
        piece = _rest(last.end_s, last.end_s + duration_s, last.final_quaternion, hand)
        if self.settings.settling_rad:
            bearing = self._rng().uniform(0, 2 * math.pi)
            tilt = self.settings.settling_rad * np.array([math.cos(bearing), math.sin(bearing), 0.0])
            # A tilt in the room, told in the body.
            tilt_b = rotate(conjugate(piece.quaternion_nb), tilt)
            piece = replace(piece, settling_rad=tilt_b, settling_s=self.settings.settling_s)
        self._be_still(piece, position, kind, bumped=bumped)

    def _bump(self, rng: np.random.Generator) -> None:
        last = self._pieces[-1]
        kind = self.settings.bump_kinds[int(rng.integers(len(self.settings.bump_kinds)))]
        shock = self._draw_shock(last.end_s, rng.uniform(0.5, 5.0), rng)
        turn = rng.uniform(0.1, 1.0) * DEG * _random_direction(rng) if kind == "shift" else np.zeros(3)
        start = last.final_quaternion
        piece = replace(last, start_s=last.end_s, end_s=shock.end_s, quaternion_nb=start, turn_rad=turn, shocks=(shock,))
        self._pieces.append(piece)
        self.moves.append(TrueMove(piece.start_s, piece.end_s, kind))

    def _leave(self, next_position: int | None) -> None:
        """End the hold after a reaction time, if waiting; the last hold does not end, but the plan is finished."""
        last = self._pieces[-1]
        if math.isfinite(last.end_s) or self._generated_s < last.start_s:
            return
        if not self._agenda:
            self.finished_s = self.finished_s or self._generated_s
            return
        # Without a visit to that position the agenda stays as it is.
        place = next((k for k, visit in enumerate(self._agenda) if visit.position == next_position), 0)
        self._agenda.insert(0, self._agenda.pop(place))
        end_s = self._generated_s + self._rng().uniform(*self.settings.reaction_s)
        self._pieces[-1] = replace(last, end_s=end_s)
        self.stills[-1] = replace(self.stills[-1], end_s=end_s)


def _spins(kind: str | None) -> list[Visit]:
    """Return what is done for whole turns: lay each axis level (or up), and turn about it, both ways."""
    visits: list[Visit] = []
    for axis in range(3) if kind is not None else ():
        body = np.eye(3)
        visits.append(Visit(NO_POSITION, body[axis if kind == "table" else (axis + 1) % 3]))
        visits += [Visit(NO_POSITION, body[axis], sense * 2 * math.pi * body[axis]) for sense in (1, -1)]
    return visits


def _rest(start_s: float, end_s: float, quaternion_nb: FloatArray, hand: Hand | None = None) -> Piece:
    return Piece(start_s=start_s, end_s=end_s, quaternion_nb=quaternion_nb, hand=hand, hand_at_start=True, hand_at_end=True)


def _random_direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)
