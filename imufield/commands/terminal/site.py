"""Where the instrument is: asked for at the terminal, the place of the last session offered again."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from imufield.acquire.recording.session import Session
from imufield.commands.terminal.output import say
from imufield.commands.terminal.questions import ask_until
from imufield.dataclass import replace
from imufield.errors import RecordingError, UsageError
from imufield.pipeline.site import SiteOptions
from imufield.sentences import Sentences

sentence = Sentences(__package__)

NOT_KNOWN = "-"
"""The answer that takes nothing of what is offered."""


def ask_site(site: SiteOptions, root: Path) -> SiteOptions:
    """Return the place, asked for as far as it is not known; that of the newest session that has one can be taken over.

    Raises
    ------
    NoAnswer
        At the end of the input.
    """
    place = site.place()
    known = place if place.is_known else _asked_latitude(site, root)
    return _asked_height(known) if known.gravity().lacks_height else known


def _asked_latitude(site: SiteOptions, root: Path) -> SiteOptions:
    last = _last_site(root)

    def read(answer: str) -> SiteOptions:
        if answer == NOT_KNOWN or not (answer or last):
            return _on_earth(site)
        place = last if last and not answer else SiteOptions(latitude_deg=read_answer(answer))
        return _on_earth(place if site.height_m is None else replace(place, height_m=site.height_m))

    say(sentence("site.why"))
    return ask_until(sentence("site.unknown") if last is None else sentence("site.last", place=words(last)), read)


def _asked_height(site: SiteOptions) -> SiteOptions:
    def read(answer: str) -> SiteOptions:
        return site if answer in ("", NOT_KNOWN) else _on_earth(replace(site, height_m=read_answer(answer)))

    return ask_until(sentence("site.height"), read)


def _on_earth(site: SiteOptions) -> SiteOptions:
    """Return the place; raises ``UsageError`` where it is nowhere on Earth."""
    site.gravity()
    return site


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
            record = Session.open(folder).record
            if record.site.is_known and not record.link.is_virtual:
                return SiteOptions().place(record.site)
    return None
