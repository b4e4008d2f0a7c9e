"""Settings of a guided session."""

from __future__ import annotations

from dataclasses import dataclass, field

from imufield.guide.checks import CheckSettings
from imufield.guide.plan import TOLERANCE_DEG
from imufield.guide.stillness import StillnessSettings

HOLD_S = 10.0


@dataclass(frozen=True, slots=True)
class GuideSettings:
    """Settings of a guided session."""

    hold_s: float = HOLD_S
    tolerance_deg: float = TOLERANCE_DEG
    stillness: StillnessSettings = field(default_factory=StillnessSettings)
    checks: CheckSettings = field(default_factory=CheckSettings)
    repeat_s: float = 0.2
    """Least time between two ``turning`` or ``holding`` events."""
    remind_s: float = 10.0
    """Least time between two complaints about the same thing."""
    moved_s: float = 1.0
    moved_deg: float = 10.0
    """A unit that moved for less than both was not lifted: it rests where it was."""
    silent_s: float = 1.0
    """A hold that ends within this time (guard bands off) was a pause in a turn; nobody needs to hear of it."""
    linger_s: float = 5.0
    linger_deg: float = 5.0
    """A unit that keeps its direction this long without becoming still is told what keeps it from being still."""
