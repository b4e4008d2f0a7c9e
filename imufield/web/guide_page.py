"""The guide for the page: what the terminal shows, as values that a browser draws, and the marks that it sends back.

One more view of the same events and one more keyboard: the session is the same with and without it.
"""

from __future__ import annotations

import math
from queue import Empty, SimpleQueue

import numpy as np

from imufield.guide.events import Event
from imufield.guide.lead.guide import Snapshot
from imufield.guide.lead.state_table import State
from imufield.guide.positions import Scheme
from imufield.guide.view.plain import known_words, said_once
from imufield.guide.view.screen import Screen, instruct, stillness_words
from imufield.guide.view.sound import heard
from imufield.web.board import Board, Json

LOG_LINES = 200
TRACE_BLOCKS = 300
"""Of 0.1 s: half a minute."""
KEYS = frozenset("rsupgf")
"""Marks that a page may make; a session is ended where its instrument is, at the terminal."""
_DIGITS = 5
_FORECAST = ("bias_ug", "scale_ppm", "misalignment_urad")


class GuidePage:
    """Puts the session on a board, and hands the marks of the pages to whoever asks for keys.

    Parameters
    ----------
    scheme : Scheme
    session, instrument : str
        Shown as they are.
    cable : str or None
        Face where the cable leaves, "-x".
    shape : str or None
        Triangles to be drawn in place of a box, see ``shape.read_stl``.
    """

    def __init__(
        self, scheme: Scheme, *, session: str, instrument: str, cable: str | None = None, shape: str | None = None
    ) -> None:
        self._screen = Screen()
        self._scheme = scheme
        self._marks: SimpleQueue[str] = SimpleQueue()
        self._forecasts: dict[int, list[float | None]] = {}
        self._log: list[object] = []
        self._trace_until_s = -math.inf
        positions = [
            {"name": position.name, "up": _rounded(position.direction), "words": position.words}
            for position in scheme.positions
        ]
        head: Json = {
            "session": session,
            "instrument": instrument,
            "cable": cable,
            "shape": shape,
            "scheme": scheme.name,
            "positions": positions,
        }
        self.board = Board(head, trace_blocks=TRACE_BLOCKS, log_lines=LOG_LINES)

    def mark(self, key: str | bytes) -> None:
        """Take a key from a page; called from its thread."""
        if isinstance(key, str) and key in KEYS:
            self._marks.put(key)

    def read(self) -> str:
        """Return the keys since the last call, as a keyboard does."""
        keys = ""
        while True:
            try:
                keys += self._marks.get_nowait()
            except Empty:
                return keys

    def tell(self, text: str) -> None:
        """Show a message that is no event."""
        self._screen.tell(text)
        self._log.append({"text": text, "kind": "told", "tones": [], "spoken": ""})

    def show(self, events: list[Event]) -> None:
        """Take events; they are shown with the next state."""
        for event in said_once(events):
            before = self._screen.message_number
            self._screen.follow([event])
            text = self._screen.messages[-1] if self._screen.message_number > before else ""
            cue, spoken = heard(event)
            if text or cue or spoken:
                tones = [] if cue is None else cue.tones
                self._log.append({"text": text, "kind": event.kind, "tones": tones, "spoken": spoken or ""})

    def refresh(self, snapshot: Snapshot, *, silent: bool, samples_lost: int) -> None:
        """Show the state between events."""
        screen = self._screen
        now = instruct(screen, snapshot)
        activity, forecast = snapshot.activity, snapshot.forecast
        holding = snapshot.state is State.HOLDING
        state: Json = {
            "state": snapshot.state.value,
            "headline": now.headline,
            "details": now.details,
            "big": list(now.big),
            "mood": now.style.replace("bold", "").strip() or "plain",
            "target": snapshot.target,
            "position": snapshot.position,
            "fraction": _number(snapshot.fraction) if holding else None,
            "remaining_s": _number(screen.remaining_s) if holding else None,
            "angle_deg": _number(screen.angle_deg) if snapshot.state is State.TURNING else None,
            "up": None if snapshot.direction is None else _rounded(snapshot.direction),
            "target_up": None if snapshot.target_direction is None else _rounded(snapshot.target_direction),
            "stillness": None if activity is None else {"ratio": _number(activity.ratio), "words": stillness_words(activity)},
            "temperature_degc": _number(snapshot.temperature_degc),
            "rate_hz": _number(snapshot.rate_hz),
            "known": None if forecast is None else {name: known_words(forecast, name) for name in _FORECAST},
            "done": len(snapshot.accepted),
            "planned": snapshot.planned,
            "link": "lost" if not screen.link else "silent" if silent else "there",
            "samples_lost": samples_lost,
        }
        # Of what was undone the page knows nothing.
        self._forecasts = {done: values for done, values in self._forecasts.items() if done < len(snapshot.accepted)}
        if forecast is not None:
            self._forecasts[len(snapshot.accepted)] = [_number(forecast.get(name, math.nan)) for name in _FORECAST]
        positions: Json = {
            "accepted": {
                name: {"residual_m_s2": _number(snapshot.residuals.get(name, math.nan))} for name in snapshot.accepted
            },
            "suspects": list(snapshot.suspects),
            "skipped": list(snapshot.skipped),
            "again": list(snapshot.again),
            "forecasts": [[done, *values] for done, values in self._forecasts.items()],
        }
        log, self._log = self._log, []
        self.board.put(state, positions=positions, trace=self._new_blocks(snapshot), log=log)

    def _new_blocks(self, snapshot: Snapshot) -> list[object]:
        """Return the blocks of the signals that no page has had: time, six means, and the temperature as it is now."""
        signals = snapshot.signals
        if signals is None:
            return []
        time_s = signals.newest_s - signals.age_s
        # A clock that was set back begins anew.
        since_s = self._trace_until_s if self._trace_until_s <= time_s[-1] else -math.inf
        self._trace_until_s = float(time_s[-1])
        new = time_s > since_s + 1e-6
        return [
            [round(float(at_s), 2), *(_number(value) for value in (*row, snapshot.temperature_degc))]
            for at_s, row in zip(time_s[new], signals.mean[new], strict=True)
        ]


def _number(value: float) -> float | None:
    """Return a number of few digits for JSON; None where it is none."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


def _rounded(direction: object) -> list[float]:
    return [round(float(value), 4) for value in np.asarray(direction)]
