"""The guide for the page: what the terminal shows, as values that a browser draws, and the marks that it sends back.

One more view of the same events and one more keyboard: the session is the same with and without it.
"""

from __future__ import annotations

import math
from queue import Empty, SimpleQueue

import numpy as np

from imufield.earth import MILLI_G_M_S2
from imufield.guide.events import Accepted, Event, LinkLost, Rejected
from imufield.guide.lead.guide import Snapshot
from imufield.guide.lead.state_table import State
from imufield.guide.positions import Scheme
from imufield.guide.view.instruction import MILD_REFUSALS, Screen, instruct, stillness_words
from imufield.guide.view.marks import AGAIN_WITHIN_S, KEYS
from imufield.guide.view.plain import KNOWN_UNITS, known_words, said_once
from imufield.guide.view.sound import heard
from imufield.samples import CELL_S
from imufield.web.board import Board, Json

LOG_LINES = 200
TRACE_BLOCKS = 300
"""Half a minute."""
_DIGITS = 5


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
        Triangles to be drawn in place of a box, see ``stl_file.read_stl``.
    replay_speed : float or None
        Of a recording, times its own; 0 is as fast as possible. None for a session that is measured now.
    """

    def __init__(
        self,
        scheme: Scheme,
        *,
        session: str,
        instrument: str,
        cable: str | None = None,
        shape: str | None = None,
        replay_speed: float | None = None,
    ) -> None:
        # A mark is named as the guide names it: which button that is, the page says.
        self._screen = Screen(say=str)
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
            "replay_speed": replay_speed,
            "finish_again_s": AGAIN_WITHIN_S,
            "log_lines": LOG_LINES,
            "trace_blocks": TRACE_BLOCKS,
            "trace_s": TRACE_BLOCKS * CELL_S,
        }
        self.board = Board(head, trace_blocks=TRACE_BLOCKS, log_lines=LOG_LINES)

    def mark(self, key: str | bytes) -> None:
        """Take a key from a page, called from its thread; a session is ended where its instrument is, at the terminal."""
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

    def show(self, events: list[Event]) -> None:
        """Take events; they are shown with the next state."""
        for event in said_once(events):
            before = self._screen.message_number
            self._screen.follow([event])
            text = self._screen.messages[-1] if self._screen.message_number > before else ""
            cue, spoken = heard(event)
            if text or cue or spoken:
                tones = [] if cue is None else cue.tones
                self._log.append({"text": text, "kind": _kind(event), "tones": tones, "spoken": spoken or ""})

    def refresh(self, snapshot: Snapshot, *, silent: bool, samples_lost: int) -> None:
        """Show the state between events."""
        screen = self._screen
        now = instruct(screen, snapshot)
        activity, forecast = snapshot.activity, snapshot.forecast
        holding = snapshot.state is State.HOLDING
        state: Json = {
            "state": snapshot.state.value,
            "now": now.code,
            "headline": now.headline,
            "details": now.details,
            "side": now.side,
            "mood": now.mood.value,
            "marks": list(snapshot.marks),
            "fraction": _number(snapshot.fraction) if holding else None,
            "remaining_s": _number(screen.remaining_s) if holding else None,
            "angle_deg": _number(screen.angle_deg) if snapshot.state is State.TURNING else None,
            "up": None if snapshot.direction is None else _rounded(snapshot.direction),
            "target_up": None if snapshot.target_direction is None else _rounded(snapshot.target_direction),
            "stillness": None if activity is None else {"ratio": _number(activity.ratio), "words": stillness_words(activity)},
            "temperature_degc": _number(snapshot.temperature_degc),
            "rate_hz": _number(snapshot.rate_hz),
            "known": None if forecast is None else {name: known_words(forecast, name) for name in KNOWN_UNITS},
            "done": len(snapshot.accepted),
            "planned": snapshot.planned,
            "link": "lost" if not screen.link else "silent" if silent else "there",
            "samples_lost": samples_lost,
        }
        # Of what was undone the page knows nothing.
        self._forecasts = {done: values for done, values in self._forecasts.items() if done < len(snapshot.accepted)}
        values = [_number((forecast or {}).get(name, math.nan)) for name in KNOWN_UNITS]
        if any(value is not None for value in values):
            self._forecasts[len(snapshot.accepted)] = values
        positions: Json = {
            "accepted": {
                name: {"leave_one_out_mg": _number(snapshot.leave_one_out_m_s2.get(name, math.nan) / MILLI_G_M_S2)}
                for name in snapshot.accepted
            },
            "suspects": list(snapshot.suspects),
            "skipped": list(snapshot.skipped),
            "again": list(snapshot.again),
            "target": snapshot.target,
            "position": snapshot.position,
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


def _kind(event: Event) -> str:
    """Return what a line of the log is: the event's name, but for those that are worse or better than others of that name."""
    if isinstance(event, Accepted) and event.suspect:
        return "suspect"
    is_mild = isinstance(event, Rejected) and event.reason in MILD_REFUSALS
    return "told" if is_mild or (isinstance(event, LinkLost) and event.resumed) else event.kind


def _number(value: float) -> float | None:
    """Return a number of few digits for JSON; None where it is none."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


def _rounded(direction: object) -> list[float]:
    return [round(float(value), 4) for value in np.asarray(direction)]
