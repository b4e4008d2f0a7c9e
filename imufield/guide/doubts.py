"""Positions that the others contradict: each doubt is said, and withdrawn aloud when the others come to agree."""

from __future__ import annotations

from imufield.guide.advice import doubtful_advice, settled_advice
from imufield.guide.events import Advice
from imufield.guide.plan import Plan
from imufield.guide.running_fit import Disagreement, RunningFit


class Doubts:
    """What the running fit doubts, and what was said of it."""

    def __init__(self) -> None:
        self.now: list[Disagreement] = []
        """The worst first."""
        self._told: set[str] = set()
        self._asked: set[str] = set()

    def follow(self, fit: RunningFit | None) -> None:
        """Take the newest fit."""
        found = [] if fit is None else [one for one in fit.disagreements() if one.doubtful]
        self.now = sorted(found, key=lambda one: -abs(one.sigmas))

    def say(self, now_s: float, fit: RunningFit, plan: Plan) -> list[Advice]:
        """Return what to say: doubts that no longer stand, and the worst one where it was not said."""
        standing = {one.name for one in self.now}
        settled = [one for one in fit.disagreements() if one.name in self._told - standing]
        self._told &= standing
        # What the guide asked for because of it, it asks for no longer; what the operator wants again stays.
        asked = {one.name for one in settled} & self._asked
        plan.wanted_again = {index for index in plan.wanted_again if plan.position(index).name not in asked}
        new = [one for one in self.now[:1] if one.name not in self._told]
        self._told.update(one.name for one in new)
        return [*(settled_advice(now_s, one) for one in settled), *(doubtful_advice(now_s, one) for one in new)]

    def ask_again(self) -> list[str]:
        """Return what is to be measured once more: what is doubted, each position once."""
        names = [one.name for one in self.now if one.name not in self._asked]
        self._asked.update(names)
        return names
