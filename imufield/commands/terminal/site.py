"""Where the instrument is: asked for at the terminal, the place of the last session offered again."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from imufield.acquire.recording.session import Session
from imufield.commands.terminal.output import say
from imufield.commands.terminal.questions import ask_until
from imufield.errors import RecordingError, UsageError
from imufield.pipeline.site import SiteOptions
from imufield.sentences import Sentences

sentence = Sentences(__package__)

NOT_KNOWN = "-"
"""The answer that takes nothing of what is offered."""


def ask_site(site: SiteOptions, root: Path) -> SiteOptions:
    """Return the place that is typed or taken over from the newest session that has one; ``site`` where it is not known.

    Raises
    ------
    NoAnswer
        At the end of the input.
    """
    last = _last_site(root)

    def read(answer: str) -> SiteOptions:
        if not answer and last is not None:
            return last
        if answer in ("", NOT_KNOWN):
            return site
        place = SiteOptions(latitude_deg=read_answer(answer), height_m=site.height_m)
        # Refuses a place that is nowhere on Earth.
        place.gravity()
        return place

    say(sentence("site.why"))
    return ask_until(sentence("site.unknown") if last is None else sentence("site.last", place=words(last)), read)


def read_answer(answer: str) -> float:
    """Return the number that was typed; raises UsageError."""
    try:
        return float(answer)
    except ValueError as error:
        raise UsageError(sentence("site.no_number", answer=answer)) from error


def words(site: SiteOptions) -> str:
    """Return what is known of a place, e.g. "latitude 48.1, height 520 m"."""
    names = {"latitude": (site.latitude_deg, ""), "height": (site.height_m, " m"), "gravity": (site.gravity_m_s2, " m/s^2")}
    return ", ".join(f"{name} {value:g}{unit}" for name, (value, unit) in names.items() if value is not None)


def _last_site(root: Path) -> SiteOptions | None:
    for folder in Session.newest_first(root):
        # A session that cannot be read is no reason not to offer the place of another.
        with suppress(RecordingError):
            record = Session.open(folder).record.site
            if record.is_known:
                return SiteOptions(**asdict(record))
    return None
