"""Where the calibration is done: gravity from what the user typed, the session, or nothing."""

from __future__ import annotations

from imufield.acquire.recording.session_record import SiteRecord
from imufield.dataclass import asdict, dataclass, fields, replace
from imufield.earth import Gravity, choose_gravity, recorded_sigma
from imufield.errors import UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteOptions(SiteRecord):
    """Options of the command line; None where not given.

    ``is_default`` says that they are defaults of file and variables: what a session knows of its own site goes before them.
    """

    is_default: bool = False

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
            raise UsageError(sentence("site.height_alone", height_m=self.height_m))
        # A value that is typed is as good as its digits; one that follows from a latitude has its own uncertainty.
        site = self.over(recorded or SiteRecord())
        sigma_m_s2 = None if site.gravity_m_s2 is None else site.gravity_sigma_m_s2
        return choose_gravity(site.gravity_m_s2, site.latitude_deg, site.height_m, sigma_m_s2)

    def over(self, recorded: SiteRecord) -> SiteOptions:
        """Return these, or what a session recorded where that goes before them.

        A value of gravity does not tell the place: latitude and height of the session stay known with it.
        """
        if recorded.is_known and (self.is_default or not self.is_known):
            known = SiteOptions(**asdict(recorded))
            if recorded.gravity_sigma_is_given:
                return known
            return replace(known, gravity_sigma_m_s2=recorded_sigma(recorded.gravity_m_s2, recorded.gravity_sigma_m_s2))
        if self.gravity_m_s2 is not None and self.latitude_deg is None:
            height_m = recorded.height_m if self.height_m is None else self.height_m
            return replace(self, latitude_deg=recorded.latitude_deg, height_m=height_m)
        return self

    def record(self) -> SiteRecord:
        """Return what a session keeps: what was typed, nothing computed."""
        return SiteRecord(**{entry.name: getattr(self, entry.name) for entry in fields(SiteRecord)})
