"""Where the calibration is done: gravity from what the user typed, the session, or nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

from imufield.acquire.recording.document import SiteRecord
from imufield.earth import Gravity, choose_gravity
from imufield.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteOptions:
    """Options of the command line; None where not given.

    ``is_default`` says that they are defaults of file and variables: what a session knows of its own site goes before them.
    """

    gravity_m_s2: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None
    is_default: bool = False
    gravity_sigma_m_s2: float | None = None
    """By the digits typed; None where gravity has none of its own."""

    @property
    def is_known(self) -> bool:
        """Whether gravity follows from these."""
        return self.gravity_m_s2 is not None or self.latitude_deg is not None

    def gravity(self, recorded: SiteRecord | None = None) -> Gravity:
        """Return gravity from the options, else from what the session recorded, else the assumed value.

        Parameters
        ----------
        recorded : SiteRecord, optional
            What the session knows.

        Raises
        ------
        UsageError, CalibrationError
            If a value exists nowhere on Earth, or a height stands alone.
        """
        if self.height_m is not None and not (self.is_known or self.is_default):
            raise UsageError(f"a height of {self.height_m:g} m alone tells no gravity; give --latitude too, or --gravity")
        site = self.over(recorded or SiteRecord())
        sigma_m_s2 = None if site.gravity_m_s2 is None else site.gravity_sigma_m_s2
        return choose_gravity(site.gravity_m_s2, site.latitude_deg, site.height_m, sigma_m_s2)

    def over(self, recorded: SiteRecord) -> SiteOptions:
        """Return these, or what a session recorded where that goes before them.

        A value of gravity does not tell the place: latitude and height of the session stay known with it.
        """
        if recorded.is_known and (self.is_default or not self.is_known):
            return SiteOptions(
                gravity_m_s2=recorded.gravity_m_s2,
                latitude_deg=recorded.latitude_deg,
                height_m=recorded.height_m,
                gravity_sigma_m_s2=recorded.gravity_sigma_m_s2,
            )
        if self.gravity_m_s2 is not None and self.latitude_deg is None:
            return replace(self, latitude_deg=recorded.latitude_deg, height_m=self.height_m or recorded.height_m)
        return self

    def record(self) -> SiteRecord:
        """Return what a session keeps: what was typed, nothing computed."""
        return SiteRecord(
            gravity_m_s2=self.gravity_m_s2,
            gravity_sigma_m_s2=self.gravity_sigma_m_s2,
            latitude_deg=self.latitude_deg,
            height_m=self.height_m,
        )
