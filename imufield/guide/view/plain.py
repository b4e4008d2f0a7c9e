"""Plain lines and JSON lines of the events of the guide.

Plain lines: one for each event worth a line, without colour and cursor; for logs and where there is no terminal.

JSON lines: one event, one line; for other programs as front ends.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import singledispatch

from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2
from imufield.guide import events
from imufield.guide.events import Event, RefusalCode, Topic
from imufield.guide.view.marks import with_keys
from imufield.sentences import Sentences

sentence = Sentences(__package__)

NOT_TOLD = "not known yet"
_LARGE = 999.5  # Three digits of the smaller unit end here.
KNOWN_UNITS = {"bias_ug": ("ug", 1e3, "mg"), "scale_ppm": ("ppm", 1e4, "%"), "misalignment_urad": ("urad", 1e3, "mrad")}
_PROGRESS = (events.Turning, events.Holding)
_EVERY_S = 5.0  # Least time between two lines of progress: a log stays readable.


class JsonLinesView:
    """Writes every event as one line of JSON.

    Parameters
    ----------
    write : callable
        Is given one line without its end.
    """

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write

    def show(self, events: list[Event]) -> None:
        """Write events."""
        for event in events:
            self._write(json.dumps(event.to_dict(), allow_nan=False))


class PlainView:
    """Writes events as lines.

    Parameters
    ----------
    write : callable
        Is given one line without its end.
    origin_s : callable, optional
        Returns the sample clock at the first sample: the lines count from there, whatever the instrument's clock began with.
    """

    def __init__(self, write: Callable[[str], object], origin_s: Callable[[], float] = lambda: 0.0) -> None:
        self._origin_s = origin_s
        self._write = write
        self._last_s = -math.inf

    def show(self, events: list[Event]) -> None:
        """Write events; those of progress now and then."""
        for event in said_once(events):
            is_progress = isinstance(event, _PROGRESS)
            if is_progress and 0 <= event.time_s - self._last_s < _EVERY_S:
                continue
            # Any line starts the wait for the next line of progress.
            if is_progress or not math.isnan(event.time_s):
                self._last_s = event.time_s
            self._write(line(event, self._origin_s()))


def line(event: Event, origin_s: float = 0.0) -> str:
    """Return the line of an event: time since ``origin_s``, then words."""
    time = f"{event.time_s - origin_s:9.1f} s" if math.isfinite(event.time_s) else " " * 9 + "- s"
    return f"{time}  {with_keys(words(event))}"


def said_once(some: list[Event]) -> list[Event]:
    """Return events for a person: the line of an accepted hold that is suspect says so itself."""
    suspects = {event.position for event in some if isinstance(event, events.Accepted) and event.suspect}
    return [
        event
        for event in some
        if not (isinstance(event, events.Advice) and event.topic is Topic.DOUBTFUL and event.position in suspects)
    ]


def suspect_words(event: events.Accepted) -> str:
    """Return what the line of an accepted hold says of a suspect, else nothing."""
    off_m_s2 = event.leave_one_out_m_s2
    return sentence("plain.suspect", off_mg=off_m_s2 / MILLI_G_M_S2) if event.suspect and off_m_s2 is not None else ""


def known_words(forecast: dict[str, float], name: str) -> str:
    """Return how well a group of parameters is known, 1 sigma, in a unit by its size: 172 ug, 25.8 mg, 2.6 %."""
    return _in_unit(forecast[name], *KNOWN_UNITS[name]) if name in forecast else NOT_TOLD


def _in_unit(value: float, unit: str, larger: float, larger_unit: str) -> str:
    return f"{value:.3g} {unit}" if value < _LARGE else f"{value / larger:.3g} {larger_unit}"


# Sentences of the events whose words depend on nothing but their values; the others have a function below.
_KEYS: dict[type[Event], str] = {
    events.NoiseFloorMeasured: "plain.words",
    events.Move: "plain.move",
    events.Hold: "plain.hold",
    events.Advice: "plain.advice",
    events.Turn: "plain.turn",
    events.Turned: "plain.turned",
    events.Marked: "plain.marked",
    events.LinkLost: "plain.link_lost",
    events.LinkBack: "plain.words",
}


@singledispatch
def words(event: Event) -> str:
    """Return the words of an event, marks by their names; a test walks ``EVENTS``."""
    return sentence(_KEYS[type(event)], event=event)


@words.register
def _turning(event: events.Turning) -> str:
    return sentence("plain.turning" if event.position == event.target else "plain.turning_elsewhere", event=event)


@words.register
def _holding(event: events.Holding) -> str:
    return sentence("plain.holding", event=event, percent=100 * event.fraction)


@words.register
def _accepted(event: events.Accepted) -> str:
    details, known = "", ""
    if math.isfinite(event.sigma_m_s2):
        details += f", {sentence('plain.mean_known', sigma=_in_unit(event.sigma_m_s2 / MICRO_G_M_S2, 'ug', 1e3, 'mg'))}"
    if math.isfinite(event.temperature_degc):
        details += f", {event.temperature_degc:.1f} degC"
    if event.tremor_deg is not None:
        details += f", {sentence('plain.in_hand', tremor_deg=event.tremor_deg)}"
    if event.forecast is not None:
        bias, scale = known_words(event.forecast, "bias_ug"), known_words(event.forecast, "scale_ppm")
        known = f"; {sentence('plain.known', bias=bias, scale=scale)}"
    again = f" {sentence('plain.again')}" if event.replaces else ""
    suspect = f"{suspect_words(event)} " if event.suspect else ""
    return sentence("plain.accepted", event=event, again=again, suspect=suspect, details=details, known=known)


@words.register
def _rejected(event: events.Rejected) -> str:
    found = f"{event.words}; {event.remedy}"
    if event.reason in (RefusalCode.ALREADY_DONE, RefusalCode.NOT_QUIET, RefusalCode.OTHER_SIDE):
        return found
    if event.reason in (RefusalCode.START_UP, RefusalCode.WARMING_UP):
        return f"wait: {found}"
    return f"refused: {event.position}: {found}" if event.position else f"refused: {found}"


@words.register
def _done(event: events.Done) -> str:
    return sentence("plain.done_without" if event.skipped else "plain.done", event=event)
