"""What the live views show, without drawing it: the state by the events so far, and what is to be done now.

The screen draws it in a terminal, the page in a browser; both say the same because it is made here. The sentences stand in
``sentences.toml`` beside this module, those of the events in ``imufield/guide/sentences.toml``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from imufield.dataclass import dataclass, field
from imufield.earth import MILLI_G_M_S2
from imufield.guide import events
from imufield.guide.events import Event, RefusalCode
from imufield.guide.lead.guide import Snapshot
from imufield.guide.lead.state_table import State
from imufield.guide.positions import nearest_cube_direction
from imufield.guide.refusals import quantities
from imufield.guide.stillness.limits import Activity
from imufield.guide.view.marks import NAMES, with_keys
from imufield.guide.view.plain import said_once, suspect_words, words
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_KEPT = 80  # Messages that a large window shows.
_READ_S = 4.0  # A refusal stays on the screen for this long although the unit moves on.


class Mood(Enum):
    """What kind of thing is to be done: its colour, in every view."""

    MOVE = "move"
    CARE = "care"
    GOOD = "good"
    WRONG = "wrong"
    NONE = "none"


_STYLES = {Mood.MOVE: "bold cyan", Mood.CARE: "bold yellow", Mood.GOOD: "bold green", Mood.WRONG: "bold red", Mood.NONE: "bold"}
# A refusal that is nobody's mistake: its headline, its mood, and the word in big letters.
MILD_REFUSALS = {
    RefusalCode.ALREADY_DONE: ("headline.already_done", Mood.GOOD, "TURN"),
    RefusalCode.OTHER_SIDE: ("headline.other_side", Mood.CARE, "TURN"),
    RefusalCode.START_UP: ("headline.start_up", Mood.CARE, "WAIT"),
    RefusalCode.WARMING_UP: ("headline.warming_up", Mood.CARE, "WAIT"),
}
# Messages of these no longer hold once a hold begins.
_WAITS = (RefusalCode.START_UP, RefusalCode.WARMING_UP, RefusalCode.NOT_QUIET)
# Events that the rest of the screen shows.
_NO_MESSAGE = (events.Turning, events.Hold, events.Holding, events.Move, events.Turn)
# Events after which a refusal is over.
_ANSWERS = (events.Hold, events.Accepted, events.Marked, events.Done, events.Turn, events.Turned)
# Events after which the hold accepted last is no longer what the screen speaks of.
_AFTER = (events.Hold, events.Rejected, events.Marked)
# What the screen keeps the latest of, under these names.
_LATEST: dict[type[Event], str] = {
    events.Move: "move",
    events.Hold: "hold",
    events.Turn: "turn",
    events.Rejected: "refused",
    events.Accepted: "accepted",
    events.Done: "finished",
}


@dataclass(slots=True, kw_only=True)
class Screen:
    """State of the screen by the events so far.

    Attributes
    ----------
    move, hold, turn, refused, accepted, finished
        The latest event of each kind; ``refused`` as long as it is to be read, ``accepted`` until something else happens.
    angle_deg, remaining_s : float
        To the target, and of the hold.
    link_paused : bool
        A cable was pulled, or the session is resumed: nobody knows how many samples that cost.
    attitude : ndarray, shape (3, 3)
        Of the box as it is drawn; its heading is kept from frame to frame.
    say : callable
        Returns a sentence of the guide as this view says it, the marks in it above all.
    """

    move: events.Move | None = None
    hold: events.Hold | None = None
    turn: events.Turn | None = None
    refused: events.Rejected | None = None
    accepted: events.Accepted | None = None
    finished: events.Done | None = None
    angle_deg: float = math.nan
    remaining_s: float = math.nan
    link: bool = True
    link_paused: bool = False
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT))
    message_number: int = 0  # Of the newest; those before it may be gone.
    say: Callable[[str], str] = with_keys
    _waits: set[str] = field(default_factory=set)

    def tell(self, text: str) -> None:
        """Add a message that is no event; where it stands already, it only becomes the newest."""
        if text in self.messages:
            self.messages.remove(text)
        self._add(text)

    def follow(self, events: list[Event]) -> None:
        """Update the screen with events in order."""
        for event in said_once(events):
            self._update(event)
            self._update_messages(event)

    def _add(self, text: str) -> None:
        self.messages.append(text)
        self.message_number += 1

    def _update(self, event: Event) -> None:
        if isinstance(event, _ANSWERS):
            self.refused = None
        if isinstance(event, _AFTER):
            self.accepted = None
        if (name := _LATEST.get(type(event))) is not None:
            setattr(self, name, event)
        if isinstance(event, events.Move):
            self.angle_deg = math.nan
        elif isinstance(event, events.Turning):
            self.angle_deg = event.target_angle_deg
            if self.refused is not None and event.time_s - self.refused.time_s > _READ_S:
                self.refused = None
        elif isinstance(event, events.Hold):
            self.remaining_s = event.hold_s
        elif isinstance(event, events.Holding):
            self.remaining_s = event.remaining_s
        elif isinstance(event, (events.LinkLost, events.LinkBack)):
            self.link, self.link_paused = isinstance(event, events.LinkBack), True

    def _update_messages(self, event: Event) -> None:
        if not isinstance(event, _NO_MESSAGE):
            self._add(self.say(_accepted(event) if isinstance(event, events.Accepted) else words(event)))
        if isinstance(event, events.Rejected) and event.reason in _WAITS:
            self._waits.add(self.messages[-1])
        elif isinstance(event, (events.Hold, events.Accepted)) and self._waits:
            self.messages = deque((text for text in self.messages if text not in self._waits), self.messages.maxlen)
            self._waits.clear()


def _accepted(event: events.Accepted) -> str:
    """Return one short line; the panel of positions shows the rest."""
    if event.suspect:
        return sentence("instruction.accepted_suspect", event=event, suspect=suspect_words(event))
    off_m_s2 = event.leave_one_out_m_s2
    fits = "" if off_m_s2 is None else f", {sentence('instruction.off_fit', off_mg=off_m_s2 / MILLI_G_M_S2)}"
    return sentence("instruction.accepted_in_hand" if event.held else "instruction.accepted", event=event, fits=fits)


class Instruction(NamedTuple):
    """What to do now.

    ``key`` is that of its headline, ``details`` stand below it, ``big`` are two words of six letters at most for big letters,
    and ``side`` is what has to come up, where a side has to.
    """

    key: str
    details: str
    mood: Mood
    big: tuple[str, str]
    side: str = ""

    @property
    def code(self) -> str:
        """Its name for programs."""
        return self.key.partition(".")[2]

    @property
    def headline(self) -> str:
        """The words for it, in capitals."""
        return sentence(self.key)

    @property
    def style(self) -> str:
        """Its colour in a terminal."""
        return _STYLES[self.mood]


# States with one instruction each, the details by their key.
_BY_STATE = {
    State.LEARNING: Instruction("headline.learning", "instruction.learning", Mood.CARE, ("LEAVE", "IT")),
    State.PAUSED: Instruction("headline.paused", "instruction.paused", Mood.NONE, ("PAUSED", "")),
    State.LOST: Instruction("headline.lost", "instruction.lost", Mood.WRONG, ("NO", "LINK")),
    State.DONE: Instruction("headline.done", "instruction.done", Mood.GOOD, ("DONE", "")),
}


def instruct(screen: Screen, snapshot: Snapshot) -> Instruction:
    """Return what to do now, as the view of this screen says it."""
    now = _instruct(screen, snapshot)
    return now._replace(details=screen.say(now.details))


def _instruct(screen: Screen, snapshot: Snapshot) -> Instruction:
    state, refused, turn, hold = snapshot.state, screen.refused, screen.turn, screen.hold
    if (now := _BY_STATE.get(state)) is not None:
        finished = screen.finished if state is State.DONE else None
        return now._replace(details=sentence(now.details) if finished is None else finished.words)
    checks_drift = snapshot.revisiting is not None and snapshot.revisiting == (snapshot.position or snapshot.target)
    target, side = _place(screen.move, checks_drift=checks_drift), screen.move.position if screen.move else ""
    if snapshot.target_direction is not None:
        side = nearest_cube_direction(np.array(snapshot.target_direction))
    if refused is not None and state in (State.RESTING, State.TURNING, State.ROLLING):
        key, mood, big = MILD_REFUSALS.get(refused.reason, ("headline.not_taken", Mood.WRONG, "AGAIN"))
        return Instruction(key, f"{refused.words}; {refused.remedy}", mood, (big, side), side)
    if state is State.HOLDING:
        place = _place(hold, checks_drift=checks_drift)
        left = f"{screen.remaining_s:.0f}" if math.isfinite(screen.remaining_s) else ""
        key = "headline.check_hold" if checks_drift else "headline.hold"
        return Instruction(key, place + " (in the hand)" * snapshot.in_hand, Mood.CARE, ("HOLD", left))
    if state is State.ROLLING and turn is not None:
        return Instruction("headline.roll", turn.words, Mood.MOVE, ("ROLL", f"{'+' if turn.sense > 0 else '-'}{turn.axis}"))
    if state is State.RESTING and (accepted := screen.accepted) is not None:
        if accepted.suspect:
            off_mg = (accepted.leave_one_out_m_s2 or 0.0) / MILLI_G_M_S2
            details = sentence("instruction.suspect", position=accepted.position, off_mg=off_mg, target=target)
            return Instruction("headline.suspect", details, Mood.WRONG, ("PRESS", NAMES["retake"].upper()))
        key = "headline.check_turn" if checks_drift else "headline.good"
        return Instruction(key, target, Mood.GOOD, ("GOOD", side), side)
    key = "headline.check_turn" if checks_drift else "headline.turn"
    return Instruction(key, target, Mood.MOVE, ("TURN", side), side)


def _place(shown: events.Move | events.Hold | None, *, checks_drift: bool) -> str:
    """Return the position of an event and its words, and why it is shown once more."""
    place = f"{shown.position}: {shown.words}" if shown else ": "
    return sentence("instruction.check", place=place) if checks_drift else place


def stillness_words(activity: Activity) -> str:
    """Return what moves most, and its limit."""
    measured, limit = quantities(activity.measured, activity.limit, activity.unit)
    measured = measured.partition(" ")[0]
    sensor = "acc" if activity.triad == "accelerometer" else "gyro"
    return sentence(
        "instruction.cause", motion=activity.motion, measured=measured, limit=limit, sensor=sensor, axis=activity.axis
    )
