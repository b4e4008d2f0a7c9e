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

    @property
    def is_typed(self) -> bool:
        """Whether any of it was typed for this command."""
        return not self.is_default and (self.is_known or self.height_m is not None)

    def gravity(self, recorded: SiteRecord | None = None) -> Gravity:
        """Return gravity from the options, else from what the session recorded, else the assumed value.

        Parameters
        ----------
        recorded : SiteRecord, optional
            What the session knows.

        Raises
        ------
        UsageError, CalibrationError
            If a value exists nowhere on Earth, or a typed height stands alone.
        """
        site = self.over(recorded or SiteRecord())
        if self.is_typed and not site.is_known:
            raise UsageError(sentence("site.height_alone", height_m=self.height_m))
        # A value that is typed is as good as its digits; one that follows from a latitude has its own uncertainty.
        sigma_m_s2 = None if site.gravity_m_s2 is None else site.gravity_sigma_m_s2
        return choose_gravity(site.gravity_m_s2, site.latitude_deg, site.height_m, sigma_m_s2)

    def over(self, recorded: SiteRecord) -> SiteOptions:
        """Return what is known of a session's place: each thing that is typed instead of what it recorded.

        A session has one place: what is not typed of it stays known, but for the gravity of another latitude.
        """
        if recorded.is_known and (self.is_default or not self.is_known):
            known = SiteOptions(**asdict(recorded))
            if self.is_typed:
                known = replace(known, height_m=self.height_m)
            if recorded.gravity_sigma_is_given:
                return known
            return replace(known, gravity_sigma_m_s2=recorded_sigma(recorded.gravity_m_s2, recorded.gravity_sigma_m_s2))
        latitude_deg = recorded.latitude_deg if self.latitude_deg is None else self.latitude_deg
        return replace(self, latitude_deg=latitude_deg, height_m=recorded.height_m if self.height_m is None else self.height_m)

    def record(self) -> SiteRecord:
        """Return what a session keeps: what was typed, nothing computed."""
        return SiteRecord(**{entry.name: getattr(self, entry.name) for entry in fields(SiteRecord)})
