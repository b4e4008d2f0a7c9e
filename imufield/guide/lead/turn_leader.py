"""Leads through the whole turns: which are left, what is said of them, what a move was."""

from __future__ import annotations

from imufield.guide.events import Turn, Turned
from imufield.guide.hold.checks import Refusal
from imufield.guide.hold.observe import Observation, observe, trim_stretch
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.turns import MadeTurn, TurnFollower, plan_turns
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Judgement, Stretch
from imufield.samples import AXES

REST_S = 1.0
"""Stillness wanted after a turn, guard bands off: it closes the turn."""


class TurnLeader:
    """The turns of a session.

    Parameters
    ----------
    settings : GuideSettings
    cell_s : float
    """

    def __init__(self, settings: GuideSettings, cell_s: float) -> None:
        self.left = plan_turns(settings.rotations, settings.turns_each_way)
        self.planned = len(self.left)
        self.rests: list[Observation] = []  # The stills before, between and after the turns; they belong to no position.
        self._cell_s = cell_s
        self._follower = TurnFollower(cell_s)
        self._moved = False
        self._resting = False
        self._given_up = self.left[:0]

    @property
    def was_given_up(self) -> bool:
        """Whether turns were left when the session was ended."""
        return bool(self._given_up)

    def give_up(self) -> None:
        """Ask for no more turns: the session is over."""
        self.left, self._given_up = [], self.left

    def take_up(self) -> None:
        """Ask again for those that were given up: the session goes on."""
        self.left, self._given_up = self._given_up or self.left, []

    def forget_move(self) -> None:
        """Forget the move under way: the link is gone."""
        self._follower = TurnFollower(self._cell_s)
        self._resting = False

    def skip(self) -> None:
        """Leave out the next one."""
        self.left = self.left[1:]

    def next(self, now_s: float) -> list[Turn]:
        """Return what to say of the next one; nothing when none is left."""
        if not self.left:
            return []
        turn = self.left[0]
        done = self.planned - len(self.left)
        return [
            Turn(
                time_s=now_s,
                axis=AXES[turn.axis],
                sense=turn.sense,
                about=turn.about,
                words=turn.words,
                done=done,
                planned=self.planned,
            )
        ]

    def begin(self, judgement: Judgement, scale: RoughScale) -> None:
        """Follow a move from the end of a still stretch."""
        self._moved, self._resting = True, False
        if judgement.ended is not None:
            self._follower.begin(judgement.ended.mean, judgement.cells, judgement.row, scale)

    def follow(self, judgement: Judgement, scale: RoughScale) -> None:
        """Take one cell of a move."""
        self._follower.follow(judgement.cells, judgement.row, scale)

    def rest(self, detector: StillnessDetector) -> bool:
        """Measure the rest under way, again with each second; return whether it is long enough now, once for each rest.

        The still before the first move is the last position's.
        """
        stretch = detector.stretch
        due = not self._resting or stretch.judged % detector.settings.cells(REST_S) == 0
        if not (self._moved and due and self._measure(stretch, detector)):
            return False
        first, self._resting = not self._resting, True
        return first

    def _measure(self, stretch: Stretch, detector: StillnessDetector) -> bool:
        cells = stretch.cells()
        cells = cells[trim_stretch(cells, detector.limits, detector.settings)]
        if len(cells) < detector.settings.cells(REST_S):
            return False
        if self._resting and self.rests:
            self.rests.pop()
        self.rests.append(observe(cells, detector.limits, f"turn rest {len(self.rests) + 1}"))
        return True

    def end(self, still_mean: list[float], scale: RoughScale) -> MadeTurn | Refusal | None:
        """Return what the move was, now that the unit is still; a wanted turn is no longer left."""
        made = self._follower.end(still_mean, self.left, scale)
        if isinstance(made, MadeTurn):
            self.left.remove(made.wanted)
        return made

    def turned(self, now_s: float, made: MadeTurn) -> Turned:
        """Return what to say of a turn that was made."""
        return Turned(
            time_s=now_s,
            axis=AXES[made.wanted.axis],
            turns=made.turns,
            about=made.wanted.about,
            start_s=made.start_s,
            end_s=made.end_s,
            angle_deg=made.turned_deg,
            tilt_deg=made.tilt_deg,
            done=self.planned - len(self.left),
            planned=self.planned,
        )
