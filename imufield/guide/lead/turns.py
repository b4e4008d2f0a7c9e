"""Whole turns for the gyroscope: which are wanted, what the guide says of them, and whether a move was one (docs/gyroscope.md).

Rolled edge over edge about a horizontal axis, gravity itself closes a turn; on a turntable or flat surface the axis is vertical
and the stop must be the same. Here a turn is only recognised, from the uncalibrated gyroscope; ``calibrate`` computes its exact
angle from the samples between the times of the event.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.dataclass import dataclass, field
from imufield.guide import refusals
from imufield.guide.events import HORIZONTAL, VERTICAL, Turn, Turned
from imufield.guide.hold.observe import Observation, observe, trim_stretch
from imufield.guide.positions import angle_deg
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import cells_in
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Judgement
from imufield.samples import AXES, CELL_S, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_NOT_A_TURN_DEG = 180.0  # A move that turned by less is the way to another side.
# Largest distance from whole turns: an uncalibrated scale and a bad stop; the solver decides on the exact angle.
_WHOLE_DEG = 45.0
_TILT_DEG = 20.0  # Between up before and up after: a turn ends on the side it began on, but not exactly.
_ASIDE_DEG = 60.0  # Net turn about the other axes: a roll by hand is never about one axis alone.
_REST_S = 1.0  # Stillness wanted after a turn, guard bands off: it closes the turn.


@dataclass(frozen=True, slots=True)
class WantedTurn:
    """One whole turn about a body axis."""

    axis: int
    sense: int
    about: str

    @property
    def words(self) -> str:
        """What to do."""
        standing = "turns.standing" if self.sense > 0 else "turns.standing_other_way"
        return self._say("turns.rolled" if self.about == HORIZONTAL else standing)

    @property
    def name(self) -> str:
        """Which turn it is."""
        return self._say("turns.name")

    def _say(self, key: str) -> str:
        first, second = (AXES[(self.axis + self.sense * k) % 3] for k in (1, 2))
        return sentence(key, about=self.about, axis=AXES[self.axis], first=first, second=second)


@dataclass(slots=True, kw_only=True)
class _Move:
    """A move since the last still: up before it, the gyroscope's bias, and the sum of the gyroscope."""

    up: FloatArray
    bias: FloatArray
    start_s: float
    end_s: float = math.nan
    slot: int | None = None
    angle: FloatArray = field(default_factory=lambda: np.zeros(3))


def plan_turns(about: str | None) -> list[WantedTurn]:
    """Return the turns of a session: each axis once in each sense."""
    return [] if about is None else [WantedTurn(axis, sense, about) for axis in range(3) for sense in (1, -1)]


class TurnLeader:
    """The turns of a session: which are left, the rests between them, and the move in progress.

    Parameters
    ----------
    about : str or None
        ``HORIZONTAL``, ``VERTICAL`` or None where no turns are wanted.
    """

    def __init__(self, about: str | None) -> None:
        self.left = plan_turns(about)
        self.planned, self.made = len(self.left), 0
        self.rests: list[Observation] = []  # The stills before, between and after the turns; they belong to no position.
        self._move: _Move | None = None
        self._moved = False
        self._resting = False
        self.given_up: list[WantedTurn] = []  # Those that were left when the session was ended.

    def give_up(self) -> None:
        """Ask for no more turns: the session is over."""
        self.left, self.given_up = [], self.left

    def take_up(self) -> None:
        """Ask again for those that were given up: the session continues."""
        self.left, self.given_up = self.given_up or self.left, []

    def forget_move(self) -> None:
        """Forget the move in progress: the link is gone."""
        self._move, self._resting = None, False

    def skip(self) -> WantedTurn:
        """Leave out the next turn, and return it."""
        skipped, *self.left = self.left
        return skipped

    def next(self, now_s: float) -> list[Turn]:
        """Return the event of the next turn; none when no turn is left."""
        return [
            Turn(
                time_s=now_s,
                axis=AXES[turn.axis],
                sense=turn.sense,
                about=turn.about,
                words=turn.words,
                done=self.planned - len(self.left),
                planned=self.planned,
            )
            for turn in self.left[:1]
        ]

    def begin(self, judgement: Judgement, scale: RoughScale) -> None:
        """Follow a move from the end of a still stretch."""
        self._moved, self._resting = True, False
        if judgement.ended is not None:
            mean = np.array(judgement.ended.mean)
            start_s = float(judgement.cells.start_s[judgement.row])
            self._move = _Move(up=scale.specific_force(mean[:3]), bias=mean[3:], start_s=start_s)
            self.follow(judgement, scale)

    def follow(self, judgement: Judgement, scale: RoughScale) -> None:
        """Add one cell of a move."""
        move, cells, row = self._move, judgement.cells, judgement.row
        if move is None or not scale.gyroscope:
            return
        slot = int(cells.slot[row])
        # A lost cell counts with the rate of the next one.
        steps = 1 if move.slot is None else slot - move.slot
        move.slot, move.end_s = slot, float(cells.end_s[row])
        rate = (cells.mean[row, 3:] - move.bias) / scale.gyroscope
        move.angle = move.angle + np.where(np.isfinite(rate), rate, 0.0) * CELL_S * steps

    def rest(self, detector: StillnessDetector) -> bool:
        """Measure the rest in progress, again with each second; return whether it is long enough now, once for each rest."""
        # The still before the first move is the last position's.
        if not self._moved or (self._resting and detector.stretch.judged % cells_in(_REST_S)):
            return False
        cells = detector.stretch.cells()
        cells = cells[trim_stretch(cells, detector.limits)]
        if len(cells) < cells_in(_REST_S):
            return False
        if self._resting and self.rests:
            self.rests.pop()
        self.rests.append(observe(cells, detector.limits, f"turn rest {len(self.rests) + 1}"))
        first, self._resting = not self._resting, True
        return first

    def end(self, now_s: float, still_mean: list[float], scale: RoughScale) -> Turned | Refusal | None:
        """Return what the move was, now that the unit is still: a wanted turn, another or a bad one, or only a move (None)."""
        move, self._move = self._move, None
        if move is None or not scale.gyroscope:
            return None
        angle = np.degrees(move.angle)
        axis = int(np.argmax(np.abs(angle)))
        size = abs(float(angle[axis]))
        if size < _NOT_A_TURN_DEG:
            return None
        tilt = angle_deg(move.up, scale.specific_force(np.array(still_mean[:3])))
        turns = round(size / 360.0) * int(np.sign(angle[axis]))
        aside = float(np.linalg.norm(np.delete(angle, axis)))
        off = abs(size - 360.0 * max(abs(turns), 1))
        refusal = (
            refusals.TURN_TILTED.beyond(tilt, _TILT_DEG, axis=AXES[axis])
            or refusals.TURN_ASIDE.beyond(aside, _ASIDE_DEG, axis=AXES[axis])
            or refusals.TURN_SHORT.beyond(off, _WHOLE_DEG, axis=AXES[axis], angle=float(angle[axis]))
        )
        if refusal is not None:
            return refusal
        up = move.up / np.linalg.norm(move.up)
        about = VERTICAL if abs(float(up[axis])) > math.cos(math.radians(_TILT_DEG)) else HORIZONTAL
        made, asked = WantedTurn(axis, int(np.sign(turns)), about), self.left[0]
        if made not in self.left:
            return refusals.OTHER_TURN.refusal(
                float(angle[axis]), 360.0 * asked.sense, axis=AXES[axis], made=made.name, left=len(self.left), asked=asked.name
            )
        self.left.remove(made)
        self.made += 1
        return Turned(
            time_s=now_s,
            axis=AXES[axis],
            turns=turns,
            about=about,
            start_s=move.start_s,
            end_s=move.end_s,
            angle_deg=float(angle[axis]),
            tilt_deg=tilt,
            done=self.planned - len(self.left),
            planned=self.planned,
        )
