"""Plain lines: one for each event worth a line, no colour, no cursor; for logs and where there is no terminal.

JSON lines: one event, one line; for other programs as front ends.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from imufield.earth import MICRO_G_M_S2
from imufield.guide.events import (
    Accepted,
    Advice,
    Done,
    Event,
    Hold,
    Holding,
    LinkBack,
    LinkLost,
    Marked,
    Move,
    NoiseFloorMeasured,
    RefusalCode,
    Rejected,
    Turn,
    Turned,
    Turning,
)


class JsonLinesView:
    """Writes every event as one line of JSON.

    Parameters
    ----------
    write : callable
        Takes one line without its end.
    """

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write

    def show(self, events: list[Event]) -> None:
        """Write events."""
        for event in events:
            self._write(json.dumps(event.to_dict(), allow_nan=False))


NOT_TOLD = "not known yet"
_LARGE = 999.5  # Three digits of the smaller unit end here.
_KNOWN_UNITS = {"bias_ug": ("ug", 1e3, "mg"), "scale_ppm": ("ppm", 1e4, "%"), "misalignment_urad": ("urad", 1e3, "mrad")}


class PlainView:
    """Writes events as lines.

    Parameters
    ----------
    write : callable
        Takes one line without its end.
    every_s : float
        Least time between two lines that only tell progress.
    origin_s : callable, optional
        Returns the sample clock at the first sample: the lines count from there, whatever the instrument's clock began with.
    """

    def __init__(
        self, write: Callable[[str], object], every_s: float = 5.0, origin_s: Callable[[], float] = lambda: 0.0
    ) -> None:
        self._origin_s = origin_s
        self._write = write
        self._every_s = every_s
        self._last_s = -math.inf

    def show(self, events: list[Event]) -> None:
        """Write what there is to say."""
        for event in events:
            if isinstance(event, (Turning, Holding)):
                if 0 <= event.time_s - self._last_s < self._every_s:
                    continue
                self._last_s = event.time_s
            elif not math.isnan(event.time_s):
                # A line of its own starts the wait for the next line of progress.
                self._last_s = event.time_s
            self._write(line(event, self._origin_s()))


def line(event: Event, origin_s: float = 0.0) -> str:
    """Return the line for an event: time since ``origin_s``, then words."""
    time = f"{event.time_s - origin_s:9.1f} s" if math.isfinite(event.time_s) else " " * 9 + "- s"
    return f"{time}  {words(event)}"


def words(event: Event) -> str:
    """Return the words for an event."""
    return _WORDS[type(event)](event)


def force_words(value_m_s2: float) -> str:
    """Return a specific force in micro-g or milli-g, as its size asks."""
    return _in_unit(value_m_s2 / MICRO_G_M_S2, "ug", 1e3, "mg")


def known_words(forecast: dict[str, float], name: str) -> str:
    """Return how well a group of parameters is known, 1 sigma, in the unit its size asks for: 172 ug, 25.8 mg, 2.6 %."""
    if name not in forecast:
        return NOT_TOLD
    return _in_unit(forecast[name], *_KNOWN_UNITS[name])


def _in_unit(value: float, unit: str, larger: float, larger_unit: str) -> str:
    return f"{value:.3g} {unit}" if value < _LARGE else f"{value / larger:.3g} {larger_unit}"


def _move(event: Move) -> str:
    return f"next ({event.accepted} of {event.planned} done): {event.position}, {event.words}; {event.why}"


def _turning(event: Turning) -> str:
    nearest = f"; nearest pending {event.position} at {event.angle_deg:.0f} deg" if event.position != event.target else ""
    return f"turning: {event.target_angle_deg:.0f} deg from {event.target}{nearest}"


def _hold(event: Hold) -> str:
    return f"hold still: {event.position}, {event.words} ({event.angle_deg:.0f} deg off), {event.hold_s:g} s"


def _holding(event: Holding) -> str:
    return f"holding {event.position}: {100 * event.fraction:.0f} %, {event.remaining_s:.0f} s left"


def _rejected(event: Rejected) -> str:
    if event.reason in (RefusalCode.ALREADY_DONE, RefusalCode.NOT_QUIET, RefusalCode.OTHER_SIDE):
        return f"{event.words}; {event.remedy}"
    if event.reason in (RefusalCode.START_UP, RefusalCode.WARMING_UP):
        return f"wait: {event.words}; {event.remedy}"
    where = f"{event.position}: " if event.position else ""
    return f"refused: {where}{event.words}; {event.remedy}"


def _marked(event: Marked) -> str:
    return f"{event.action}: {event.words}"


def _link_lost(event: LinkLost) -> str:
    return f"{event.words} ({event.accepted} of {event.planned} done)"


def _done(event: Done) -> str:
    missing = f"; without {', '.join(event.skipped)}" if event.skipped else ""
    return f"done: {event.words}{missing}"


def _accepted(event: Accepted) -> str:
    sigma = f", mean known to {force_words(event.sigma_m_s2)}" if math.isfinite(event.sigma_m_s2) else ""
    warmth = f", {event.temperature_degc:.1f} degC" if math.isfinite(event.temperature_degc) else ""
    again = " (replaces the older one)" if event.replaces else ""
    held = f", in the hand (tremor {event.tremor_deg:.2f} deg)" if event.tremor_deg is not None else ""
    done = f"; {event.accepted} of {event.planned} done"
    return f"accepted {event.position}{again}: {event.duration_s:.1f} s{sigma}{warmth}{held}{done}{_forecast(event)}"


def _forecast(event: Accepted) -> str:
    if event.forecast is None:
        return ""
    return f"; known now: bias {known_words(event.forecast, 'bias_ug')}, scale {known_words(event.forecast, 'scale_ppm')}"


def _turn(event: Turn) -> str:
    return f"next turn ({event.done} of {event.planned} done): {event.words}"


def _turned(event: Turned) -> str:
    return (
        f"turned {event.turns:+d} about {event.axis}: {event.angle_deg:.0f} deg by the uncalibrated gyroscope, "
        f"{event.tilt_deg:.1f} deg off where it began; {event.done} of {event.planned} done"
    )


# One entry for each event; the tests walk ``EVENTS`` against it.
_WORDS: dict[type[Event], Callable[[Any], str]] = {
    NoiseFloorMeasured: lambda event: event.words,
    Move: _move,
    Turning: _turning,
    Hold: _hold,
    Holding: _holding,
    Accepted: _accepted,
    Rejected: _rejected,
    Advice: lambda event: f"{event.words}; {event.remedy}",
    Turn: _turn,
    Turned: _turned,
    Marked: _marked,
    LinkLost: _link_lost,
    LinkBack: lambda event: event.words,
    Done: _done,
}
