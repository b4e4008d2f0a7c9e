"""Where the calibration is done: gravity from what the user typed, the session, or nothing."""

from __future__ import annotations

from imufield.acquire.recording.session_record import SiteRecord
from imufield.dataclass import asdict, dataclass, fields, replace
from imufield.earth import (
    GRAVITIES_DIFFER_SIGMA,
    Gravity,
    choose_gravity,
    height_words,
    recorded_sigma,
)
from imufield.errors import UsageError
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

NOWHERE = SiteRecord()
"""A place of which nothing is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteOptions(SiteRecord):
    """What was typed of the place; None where nothing was.

    ``usual`` holds the defaults of file and variables, for a session that knows no place of its own.
    """

    usual: SiteRecord = NOWHERE

    @property
    def is_typed(self) -> bool:
        """Whether any of it was typed."""
        return self.record() != NOWHERE

    def check(self) -> None:
        """Refuse a value that exists nowhere on Earth; raises as ``gravity``. A height may still stand alone."""
        choose_gravity(self.gravity_m_s2, self.latitude_deg, self.height_m)

    def gravity(self, recorded: SiteRecord = NOWHERE) -> Gravity:
        """Return gravity at the place of a session, the assumed value where nothing is known of it.

        Parameters
        ----------
        recorded : SiteRecord
            What the session knows.

        Raises
        ------
        UsageError, CalibrationError
            If a value exists nowhere on Earth, or a typed height stands alone.
        """
        place = self.place(recorded)
        if self.height_m is not None and not place.is_known:
            raise UsageError(sentence("site.height_alone", height_m=self.height_m))
        # A value that is typed is as good as its digits; one that follows from a latitude has its own uncertainty.
        sigma_m_s2 = None if place.gravity_m_s2 is None else place.gravity_sigma_m_s2
        return choose_gravity(place.gravity_m_s2, place.latitude_deg, place.height_m, sigma_m_s2)

    def another_place(self, recorded: SiteRecord) -> Sentence | None:
        """Return a sentence where gravity at the typed place is not that at the recorded one."""
        if not recorded.is_known:
            return None
        now, before = self.gravity(recorded), SiteOptions().gravity(recorded)
        if before.lacks_height:
            # A height contradicts none that was unknown: both at the one that is typed.
            before = SiteOptions(height_m=now.height_m).gravity(recorded)
        # A value that is typed is compared with its latitude elsewhere.
        if now.source != "normal" or before.source == "assumed":
            return None
        apart_ppm = abs(now.gravity_m_s2 - before.gravity_m_s2) / before.gravity_m_s2 * 1e6
        # A height that is not given may explain what differs.
        limit_ppm = GRAVITIES_DIFFER_SIGMA * now.sigma_m_s2 / before.gravity_m_s2 * 1e6
        if apart_ppm <= limit_ppm:
            return None
        values = {"now": now, "height": height_words(now), "before": before}
        return sentence("site.another_place", **values, apart_ppm=apart_ppm, limit_ppm=limit_ppm)

    def place(self, recorded: SiteRecord = NOWHERE) -> SiteOptions:
        """Return all that is known of a session's place: what is typed before what it recorded, that before the defaults.

        A session has one place: what is not typed of it stays known, but for gravity where another latitude is typed.
        """
        if self.gravity_m_s2 is not None or self.latitude_deg not in (None, recorded.latitude_deg):
            # A typed latitude with the height of a default would be nowhere: of these nothing is taken.
            latitude_deg = recorded.latitude_deg if self.latitude_deg is None else self.latitude_deg
            known = replace(self, usual=NOWHERE, latitude_deg=latitude_deg, height_m=recorded.height_m)
        elif recorded.is_known:
            known = SiteOptions(**asdict(recorded))
            if not recorded.gravity_sigma_is_given:
                sigma_m_s2 = recorded_sigma(recorded.gravity_m_s2, recorded.gravity_sigma_m_s2)
                known = replace(known, gravity_sigma_m_s2=sigma_m_s2)
        else:
            known = SiteOptions(**asdict(self.usual))
            if recorded.height_m is not None:
                known = replace(known, height_m=recorded.height_m)
        return known if self.height_m is None else replace(known, height_m=self.height_m)

    def record(self) -> SiteRecord:
        """Return what was typed, as a session keeps it: nothing computed."""
        return SiteRecord(**{entry.name: getattr(self, entry.name) for entry in fields(SiteRecord)})
