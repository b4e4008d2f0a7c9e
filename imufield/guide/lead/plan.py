"""The list of positions of a session: what is pending, measured, skipped, wanted again. Nothing measured is erased."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.guide.hold.observe import Observation
from imufield.guide.positions import Position, Scheme, angle_deg
from imufield.samples import FloatArray

TOLERANCE_DEG = 15.0
"""Placement that the schemes bear: it costs 1 to 9 % of the uncertainty (docs/maths.md, positions)."""
RECOGNITION_MARGIN_DEG = 5.0
"""Added for what an uncalibrated accelerometer misjudges: 1 m/s^2 of bias turns the apparent direction by 6 degrees."""


@dataclass(frozen=True, slots=True)
class Found:
    """A position and how far off it the unit is."""

    index: int
    angle_deg: float


class Plan:
    """Positions of a scheme and what became of them.

    Parameters
    ----------
    scheme : Scheme
    tolerance_deg : float
        A hold further than this (and the margin) from every position belongs to none. Never more than half the angle
        between neighbouring positions.
    """

    def __init__(self, scheme: Scheme, tolerance_deg: float = TOLERANCE_DEG) -> None:
        self.scheme = scheme
        self.tolerance_deg = min(tolerance_deg + RECOGNITION_MARGIN_DEG, scheme.separation_deg() / 2)
        self.skipped: set[int] = set()
        self.wanted_again: set[int] = set()
        self.withdrawn: list[Observation] = []  # Replaced or undone; kept, not used.
        self.first: int | None = None  # Asked for before all others: where the unit lies when the session begins.
        self.preferred: int | None = None  # Asked for next instead of the proposed order: where a hold helps most.
        # Asked for once more at the end, as a check for drift; what is measured there replaces nothing.
        self.revisiting: int | None = None
        self.revisited: Observation | None = None
        self._accepted: dict[int, Observation] = {}
        self._directions = scheme.directions()
        self._history: list[tuple[str, int]] = []

    @property
    def accepted(self) -> dict[int, Observation]:
        """Observations by position, in order of acceptance."""
        return dict(self._accepted)

    @property
    def last_accepted(self) -> int | None:
        """The position accepted last, None before the first."""
        return next(reversed(self._accepted), None)

    def position(self, index: int) -> Position:
        """Return a position by its place in the proposed order."""
        return self.scheme.positions[index]

    def is_pending(self, index: int) -> bool:
        """Whether a hold there would be taken; skipped ones would."""
        return index not in self._accepted or index in self.wanted_again or index == self.revisiting

    def proposed(self) -> int | None:
        """Return the next position in the proposed order, None when nothing is left to ask for."""
        before = (index for index in (self.first, self.preferred) if index is not None)
        order = (*before, *range(len(self.scheme)))
        return next((index for index in order if self.is_pending(index) and index not in self.skipped), None)

    def pending(self) -> list[int]:
        """Return what is asked for, in the proposed order."""
        return [index for index in range(len(self.scheme)) if self.is_pending(index) and index not in self.skipped]

    @property
    def first_accepted(self) -> int | None:
        """The position accepted first that still counts."""
        return next(iter(self._accepted), None)

    def missing(self) -> tuple[str, ...]:
        """Return the names of positions without an observation."""
        return tuple(self.position(i).name for i in range(len(self.scheme)) if i not in self._accepted)

    def nearest(self, direction: FloatArray, *, pending: bool) -> Found | None:
        """Return the nearest position, of the pending ones or of all; of equals the one asked for, then the first.

        ``direction`` is a unit vector.
        """
        target = self.proposed()
        angles = np.degrees(np.arccos(np.clip(self._directions @ direction, -1, 1))).tolist()
        found = [
            (round(angle, 3), index != target, index)
            for index, angle in enumerate(angles)
            if self.is_pending(index) or not pending
        ]
        if not found:
            return None
        angle, _, index = min(found)
        return Found(index, angle)

    def accept(self, index: int, observation: Observation) -> bool:
        """Take an observation; return whether it replaces an older one."""
        if index == self.revisiting and index not in self.wanted_again:
            self.revisiting, self.revisited = None, observation
            self._history.append(("revisit", index))
            return False
        older = self._accepted.pop(index, None)
        if older is not None:
            self.withdrawn.append(older)
        self._accepted[index] = observation
        self.wanted_again.discard(index)
        self.skipped.discard(index)
        self._history.append(("accept", index))
        return older is not None

    def want_again(self, index: int) -> None:
        """Ask for a position once more; its observation stays until the new one is accepted."""
        self.wanted_again.add(index)
        self._history.append(("retake", index))

    def skip(self, index: int) -> None:
        """Do not ask for a position any more; shown all the same, it is taken."""
        if index == self.revisiting:
            self.revisiting = None
        if index not in self._accepted:
            self.skipped.add(index)
        self.wanted_again.discard(index)
        self._history.append(("skip", index))

    def undo(self) -> tuple[str, int] | None:
        """Take back the last accept, retake or skip; return what it was, None when there is nothing."""
        if not self._history:
            return None
        action, index = self._history.pop()
        if action == "skip":
            self.skipped.discard(index)
        elif action == "retake":
            self.wanted_again.discard(index)
        elif action == "revisit":
            self.revisiting, self.revisited = index, None
        elif index in self._accepted:
            self._take_back(index)
        return action, index

    def _take_back(self, index: int) -> None:
        """Withdraw an observation; the one that it had replaced counts again."""
        name = self.position(index).name
        undone = self._accepted.pop(index)
        before = next((one for one in reversed(self.withdrawn) if one.name == name), None)
        if before is not None:
            self.withdrawn = [one for one in self.withdrawn if one is not before]
            self._accepted[index] = before
            self.wanted_again.add(index)
        self.withdrawn.append(undone)

    def find(self, name: str) -> int | None:
        """Return the index of a position by name."""
        return next((i for i, position in enumerate(self.scheme.positions) if position.name == name), None)

    def same_direction(self, first: int, second: int) -> bool:
        """Whether two positions show the same side."""
        return angle_deg(self.position(first).direction, self.position(second).direction) < 1.0
