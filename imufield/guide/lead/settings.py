"""Settings of a guided session."""

from __future__ import annotations

from dataclasses import dataclass, field

from imufield.earth import MICRO_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.guide.hold.checks import CheckLimits
from imufield.guide.hold.hold_time import HoldWish
from imufield.guide.lead.plan import TOLERANCE_DEG
from imufield.guide.stillness.limits import StillnessSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class GuideSettings:
    """Settings of a guided session."""

    hold_s: float | None = None
    """Fixes the hold; None: as long as the uncertainty wanted needs, see ``wish``."""
    target_bias_ug: float | None = None
    target_scale_ppm: float | None = None
    """Uncertainty wanted of the result, 1 sigma; met, finishing early is offered."""
    revisit_first: bool = False
    """Come back to the first position at the end: a check for drift."""
    rotations: str | None = None
    """Whole turns after the positions, about a "horizontal" (rolled) or "vertical" axis: see ``rotations``."""
    turns_each_way: int = 1
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    """For the running fit only."""
    earlier_scale_raw: float | None = None
    """Common scale of an earlier calibration of this instrument, raw rate per m/s^2: what a wrong gravity shows against."""
    earlier_scale_sigma: float = 0.0
    """Its 1 sigma, relative."""
    warm_up_degc_min: float = 0.5
    """No position is accepted first while the temperature changes faster than this."""
    tolerance_deg: float = TOLERANCE_DEG
    stillness: StillnessSettings = field(default_factory=StillnessSettings)
    checks: CheckLimits = field(default_factory=CheckLimits)
    repeat_s: float = 0.2
    """Least time between two ``turning`` or ``holding`` events."""
    remind_s: float = 10.0
    """Least time between two complaints about the same thing."""
    moved_s: float = 1.0
    moved_deg: float = 10.0
    """A unit that moved for less than both was not lifted: it rests where it was."""
    moved_unseen_deg: float = 0.5
    """Nobody puts a unit down again within this while the link is gone; one that nobody touched stays within a tenth of it."""
    silent_s: float = 1.0
    """A hold that ends within this time (guard bands off) was a pause in a turn; nobody needs to hear of it."""
    linger_s: float = 5.0
    linger_deg: float = 5.0
    """A unit that keeps its direction this long without becoming still is told what keeps it from being still."""
    hand_guard_s: float = 1.5
    """Cut off at both ends of a hold in the hand: an arm comes to rest slowly, and a slow turn begins below its sway."""

    @property
    def wish(self) -> HoldWish:
        """What ends a hold: a bias or scale known to the target needs positions about as good."""
        wanted = [target for target in (self.target_bias_ug, self.target_scale_ppm) if target is not None]
        return HoldWish.of(self.hold_s, min(wanted) * MICRO_G_M_S2 if wanted else None)
