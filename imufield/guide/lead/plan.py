"""The plan of a session: which positions are pending, measured, skipped or wanted again, and how near a hold must be to one.

Nothing measured is erased. Which position comes first (``preferred``) is found by ``advice`` with ``next_best``, and whether
the targets are met.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from imufield.calibrate.accelerometer.drift import MOST_CONFUSION, order_confusion
from imufield.dataclass import dataclass, replace
from imufield.guide.cross_checks.running_fit import RunningFit
from imufield.guide.hold.observe import Observation
from imufield.guide.positions import Position, Scheme, angle_deg
from imufield.samples import FloatArray

# Error of placement that the schemes allow: it costs up to 10 % of the linear model's uncertainty (docs/maths.md, positions).
_TOLERANCE_DEG = 15.0
# Added for the error of an uncalibrated accelerometer: 1 m/s^2 of bias turns the apparent direction by 6 degrees.
_RECOGNITION_MARGIN_DEG = 5.0
_SAME_SIDE_DEG = 1.0  # Positions nearer than this show the same side: far less than schemes part their positions by.
# A position is proposed before its turn where its gain is larger by this factor: the order that drift cannot imitate is worth
# more than a little gain.
_CLEARLY_MORE = 1.5
_ALIKE = 1e-6  # Gains of mirrored positions differ by rounding.


@dataclass(frozen=True, slots=True)
class Nearest:
    """The nearest position and the angle of the unit from it."""

    index: int
    angle_deg: float


@dataclass(frozen=True, slots=True)
class _Done:
    """What can be undone: accept, retake, skip or revisit, its position, and the observation that was replaced."""

    action: str
    index: int
    replaced: Observation | None = None


class Plan:
    """Positions of a scheme and their measurements.

    Parameters
    ----------
    scheme : Scheme
    """

    def __init__(self, scheme: Scheme) -> None:
        self.scheme = scheme
        # A hold farther than this from every position belongs to none; at most half the angle between neighbours.
        self.tolerance_deg = min(_TOLERANCE_DEG + _RECOGNITION_MARGIN_DEG, scheme.separation_deg() / 2)
        self.accepted: dict[int, Observation] = {}  # By position, in order of acceptance.
        self.skipped: set[int] = set()
        self.wanted_again: set[int] = set()
        self.doubted: set[int] = set()  # Told as contradicted by the others, and not settled since.
        self.asked_again: set[int] = set()  # Asked for once more because of that, each once.
        self.first: int | None = None  # Asked for before all others: where the unit is when the session begins.
        self.preferred: int | None = None  # Asked for next instead of the proposed order: see ``next_best``.
        # Asked for once more at the end, as a check for drift; its measurement replaces nothing.
        self.revisiting: int | None = None
        self.revisited: Observation | None = None
        self._directions = scheme.directions()
        self._history: list[_Done] = []

    def position(self, index: int) -> Position:
        """Return a position by its place in the proposed order."""
        return self.scheme.positions[index]

    def is_pending(self, index: int) -> bool:
        """Whether a hold there would be accepted; at a skipped position it would."""
        return index not in self.accepted or index in self.wanted_again or index == self.revisiting

    def proposed(self) -> int | None:
        """Return what is wanted again, else the next in the proposed order, None when nothing is left to ask for."""
        pending = self.pending()
        again = [index for index in pending if index in self.wanted_again]
        return next((index for index in (*again, self.first, self.preferred, *pending) if index in pending), None)

    def pending(self) -> list[int]:
        """Return the positions that are asked for, in the proposed order."""
        return [index for index in range(len(self.scheme)) if self.is_pending(index) and index not in self.skipped]

    def missing(self) -> tuple[str, ...]:
        """Return the names of positions without an observation."""
        return tuple(self.position(i).name for i in range(len(self.scheme)) if i not in self.accepted)

    def nearest(self, direction: FloatArray, *, pending: bool) -> Nearest | None:
        """Return the nearest position, of the pending ones or of all; of equals the proposed one, then the first.

        ``direction`` is a unit vector.
        """
        return self._nearest_of([i for i in range(len(self.scheme)) if self.is_pending(i) or not pending], direction)

    def _nearest_of(self, candidates: Iterable[int], direction: FloatArray) -> Nearest | None:
        target = self.proposed()
        angles = np.degrees(np.arccos(np.clip(self._directions @ direction, -1, 1))).tolist()
        # Rounded, so that repeats of one direction are equal.
        ranked = [(round(angles[index], 3), index != target, index) for index in candidates]
        if not ranked:
            return None
        angle, _, index = min(ranked)
        return Nearest(index, angle)

    def accept(self, index: int, observation: Observation) -> bool:
        """Add an observation; return whether it replaces an older one."""
        if index == self.revisiting and index not in self.wanted_again:
            self.revisiting, self.revisited = None, observation
            self._history.append(_Done("revisit", index))
            return False
        older = self.accepted.pop(index, None)
        self.accepted[index] = observation
        self.wanted_again.discard(index)
        self.skipped.discard(index)
        self._history.append(_Done("accept", index, older))
        return older is not None

    def take_back(self, index: int) -> None:
        """Withdraw an observation that does not count any more; the position is pending again."""
        del self.accepted[index]
        for marked in (self.wanted_again, self.doubted, self.asked_again):
            marked.discard(index)
        if index == self.revisiting:
            self.revisiting = None
        # Nothing that led to it is left to undo.
        self._history = [done for done in self._history if done.index != index]

    def place_anew(self, up: Callable[[Observation], FloatArray], among: Iterable[int] | None = None) -> int:
        """Move observations to the positions that they show now that the offset is known; return how many were elsewhere.

        ``up`` returns the direction that an observation shows. One that belongs to no free position is withdrawn. ``among``
        are the positions looked at, by default all.
        """
        shown = {index: up(self.accepted[index]) for index in (self.accepted if among is None else among)}
        strays = [i for i, direction in shown.items() if angle_deg(self.position(i).direction, direction) > self.tolerance_deg]
        free = set(range(len(self.scheme))).difference(self.accepted).union(strays)
        moved: dict[int, int] = {}
        for index in strays:
            nearest = self._nearest_of(free, shown[index])
            if nearest is None or nearest.angle_deg > self.tolerance_deg:
                self.take_back(index)
            else:
                moved[index] = nearest.index
                free.discard(nearest.index)
        self._move(moved)
        return len(strays)

    def _move(self, moved: dict[int, int]) -> None:
        """Give observations other positions, old index to new one, and with them all that refers to them."""
        self.accepted = {
            moved.get(i, i): self._named(observation, moved[i]) if i in moved else observation
            for i, observation in self.accepted.items()
        }
        marks = (self.wanted_again, self.doubted, self.asked_again)
        self.wanted_again, self.doubted, self.asked_again = ({moved.get(i, i) for i in marked} for marked in marks)
        self.revisiting = None if self.revisiting is None else moved.get(self.revisiting, self.revisiting)
        self.skipped.difference_update(moved.values())
        # A position is skipped whatever was measured where.
        self._history = [
            done if done.action == "skip" else replace(done, index=moved.get(done.index, done.index)) for done in self._history
        ]

    def _named(self, observation: Observation, index: int) -> Observation:
        position = self.position(index)
        return replace(observation, name=position.name, direction=position.direction)

    def want_again(self, index: int) -> None:
        """Ask for a position once more; its observation stays until the new one is accepted."""
        self.wanted_again.add(index)
        self._history.append(_Done("retake", index))

    def skip(self, index: int) -> None:
        """Do not ask for a position any more; a hold there is accepted all the same."""
        if index == self.revisiting:
            self.revisiting = None
        if index not in self.accepted:
            self.skipped.add(index)
        self.wanted_again.discard(index)
        self._history.append(_Done("skip", index))

    @property
    def can_undo(self) -> bool:
        """Whether there is something to reverse."""
        return bool(self._history)

    def undo(self) -> tuple[str, int] | None:
        """Reverse the last accept, retake, skip or revisit; return it and its position, None when there is none."""
        if not self._history:
            return None
        done = self._history.pop()
        action, index, replaced = done.action, done.index, done.replaced
        if action == "skip":
            self.skipped.discard(index)
        elif action == "retake":
            self.wanted_again.discard(index)
        elif action == "revisit":
            self.revisiting, self.revisited = index, None
        elif index in self.accepted:
            del self.accepted[index]
            if replaced is not None:
                # It counts again, under the name that the position has by now.
                self.accepted[index] = self._named(replaced, index)
                self.wanted_again.add(index)
            elif index == self.revisiting:
                self.revisiting = None
        return action, index

    def find(self, name: str) -> int | None:
        """Return the index of a position by name."""
        return next((i for i, position in enumerate(self.scheme.positions) if position.name == name), None)

    def same_direction(self, first: int, second: int) -> bool:
        """Whether two positions show the same side."""
        return angle_deg(self.position(first).direction, self.position(second).direction) < _SAME_SIDE_DEG


def next_best(fit: RunningFit, done: FloatArray, left: FloatArray, *, hurried: bool) -> int:
    """Return which of the positions that are left is asked for next: the first, or one that helps clearly more.

    Where drift and quadratic term then look alike to the end, it is the first of those that tell them apart best.

    Parameters
    ----------
    fit : RunningFit
        Of those that are done.
    done, left : ndarray, shape (m, 3), (n, 3)
        Directions of up, unit vectors.
    hurried : bool
        Somebody with a target wants to be there soon.
    """
    gain = fit.gain(left)
    # The first of those that help alike: rounding must not choose.
    best = int(np.argmax(gain > (1 - _ALIKE) * gain.max()))
    helps_more = gain[best] > (1.0 if hurried else _CLEARLY_MORE) * gain[0]

    def confusion(place: int) -> float:
        return order_confusion(np.concatenate([done, left[place : place + 1], np.delete(left, place, axis=0)]))

    for place in [best, 0] if helps_more else [0]:
        if confusion(place) <= MOST_CONFUSION:
            return place
    all_of_them = np.array([confusion(place) for place in range(len(left))])
    return int(np.argmax(all_of_them < (1 + _ALIKE) * all_of_them.min()))
