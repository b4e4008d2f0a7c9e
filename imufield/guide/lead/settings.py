"""Settings of a guided session: targets, holds and gravity; what the targets ask of the holds is in ``session_time``."""

from __future__ import annotations

from imufield.dataclass import dataclass
from imufield.earth import Gravity, choose_gravity
from imufield.guide.hold.hold_time import LONGEST_HOLD_S, HoldTarget

# A unit that moved for less than both was not lifted: it rests where it was.
MOVED_S = 1.0
MOVED_DEG = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GuideSettings:
    """Settings of a guided session.

    Attributes
    ----------
    hold_s : float or None
        Fixes the length of a hold; None: as ``session_time`` finds it for the targets, or the usual one without.
    target_bias_ug, target_scale_ppm : float or None
        Uncertainty wanted of the result, 1 sigma; once met, finishing early is offered.
    revisit_first : bool
        Come back to the first position at the end: a check for drift.
    rotations : str or None
        Whole turns after the positions, about a "horizontal" (rolled) or "vertical" axis: see ``turns``.
    gravity : Gravity
        For the running fit and its forecast; by default that of an unknown place.
    earlier_scale_raw, earlier_scale_sigma : float
        Common scale of an earlier calibration of this instrument, raw rate per m/s^2, which a wrong gravity contradicts,
        and its relative 1 sigma.
    grade : str
        Class of the instrument; empty where its protocol does not say it.
    """

    hold_s: float | None = None
    target_bias_ug: float | None = None
    target_scale_ppm: float | None = None
    revisit_first: bool = False
    rotations: str | None = None
    gravity: Gravity = choose_gravity()  # Frozen, so one default may be shared.
    earlier_scale_raw: float | None = None
    earlier_scale_sigma: float = 0.0
    grade: str = ""

    @property
    def targets(self) -> dict[str, float]:
        """What is wanted, by the names that a forecast has for it."""
        wanted = {"bias_ug": self.target_bias_ug, "scale_ppm": self.target_scale_ppm}
        return {name: value for name, value in wanted.items() if value is not None}

    @property
    def hold_target(self) -> HoldTarget:
        """What ends a hold without a target, or as long as the noise is not known that tells what a target needs."""
        return HoldTarget() if self.hold_s is None else HoldTarget.fixed(self.hold_s)

    @property
    def longest_hold_s(self) -> float:
        """Length that no hold exceeds."""
        return LONGEST_HOLD_S if self.targets and self.hold_s is None else self.hold_target.longest_s
