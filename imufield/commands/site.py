"""Where the calibration is done: gravity from what the user typed, the session, or nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from imufield.earth import Gravity, choose_gravity
from imufield.errors import UsageError


@dataclass(frozen=True, slots=True)
class SiteOptions:
    """Options of the command line; None where not given."""

    gravity_m_s2: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None

    @property
    def is_known(self) -> bool:
        """Whether gravity follows from these."""
        return self.gravity_m_s2 is not None or self.latitude_deg is not None

    def gravity(self, recorded: Mapping[str, Any] | None = None) -> Gravity:
        """Return gravity from the options, else from what the session recorded, else the assumed value.

        Parameters
        ----------
        recorded : mapping, optional
            The session's ``site`` table.

        Raises
        ------
        UsageError, CalibrationError
            If a value exists nowhere on Earth, or a height stands alone.
        """
        if self.height_m is not None and not self.is_known:
            raise UsageError(f"a height of {self.height_m:g} m alone tells no gravity; give --latitude too, or --gravity")
        if self.is_known or not recorded:
            return choose_gravity(self.gravity_m_s2, self.latitude_deg, self.height_m)
        return choose_gravity(recorded.get("gravity_m_s2"), recorded.get("latitude_deg"), recorded.get("height_m"))

    def table(self) -> dict[str, float]:
        """Return the session's ``site`` table: what was typed, nothing computed."""
        pairs = {"gravity_m_s2": self.gravity_m_s2, "latitude_deg": self.latitude_deg, "height_m": self.height_m}
        return {key: value for key, value in pairs.items() if value is not None}
