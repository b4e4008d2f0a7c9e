"""The states of the guide as a table: (state, input) -> what to do and where to go.

The guide looks up every input here; an input that is not in the table does nothing. An action may answer with another input,
which is looked up in the new state: ``recognise`` answers ``near``, ``refused`` or ``same``. The table is data so that the
picture in the documentation and the tests are made from it.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class State(Enum):
    """States of a session."""

    LEARNING = "learning"
    """Waiting for a quiet stretch, the noise floor."""
    TURNING = "turning"
    """Waiting for the unit to lie still."""
    RECOGNISING = "recognising"
    """Passing: which position is it?"""
    HOLDING = "holding"
    JUDGING = "judging"
    """Passing: is the hold good?"""
    RESTING = "resting"
    """Still, but nothing more to measure here: waiting for the unit to be moved."""
    ROLLING = "rolling"
    """The positions are done: whole turns for the gyroscope."""
    PAUSED = "paused"
    LOST = "lost"
    """No link."""
    DONE = "done"


class Input(Enum):
    """Inputs of the table."""

    FLOOR = "floor"
    MOVING = "moving"
    """A cell that is not still."""
    STILL = "still"
    """A cell of a still stretch."""
    ENDED = "ended"
    """The still stretch is over."""
    NEAR = "near"
    SAME = "same"
    REFUSED = "refused"
    LONG_ENOUGH = "long enough"
    GOOD = "good"
    AGAIN = "again"
    TURNS = "turns"
    """All positions are done, whole turns are wanted."""
    COMPLETE = "complete"
    REOPENED = "reopened"
    RESUMED = "resumed"
    """A session that was finished early is to go on."""
    PAUSE = "pause"
    FINISH = "finish"
    LINK_LOST = "link lost"
    LINK_BACK = "link back"


class Transition(NamedTuple):
    """Name of the method of ``GuideActions``, and the state to go to first."""

    action: str
    to: State


# What can happen in any state of a running session.
_ANY = {
    Input.PAUSE: Transition("pause", State.PAUSED),
    Input.FINISH: Transition("finish", State.DONE),
    Input.LINK_LOST: Transition("lose_link", State.LOST),
    Input.COMPLETE: Transition("finish", State.DONE),
    Input.TURNS: Transition("propose_turn", State.ROLLING),
    Input.FLOOR: Transition("announce_floor", State.TURNING),
}

TABLE: dict[State, dict[Input, Transition]] = {
    State.LEARNING: _ANY,
    State.TURNING: _ANY
    | {
        Input.MOVING: Transition("show_turning", State.TURNING),
        Input.STILL: Transition("recognise", State.RECOGNISING),
    },
    State.RECOGNISING: {
        Input.NEAR: Transition("begin_hold", State.HOLDING),
        Input.REFUSED: Transition("refuse", State.RESTING),
        Input.SAME: Transition("rest", State.RESTING),
    },
    State.HOLDING: _ANY
    | {
        Input.STILL: Transition("count", State.HOLDING),
        Input.LONG_ENOUGH: Transition("judge", State.JUDGING),
        Input.ENDED: Transition("interrupt", State.TURNING),
    },
    State.JUDGING: {
        Input.GOOD: Transition("accept", State.RESTING),
        Input.REFUSED: Transition("refuse", State.RESTING),
        Input.AGAIN: Transition("measure_again", State.TURNING),
    },
    State.RESTING: _ANY
    | {
        Input.STILL: Transition("rest", State.RESTING),
        Input.ENDED: Transition("lift", State.TURNING),
        Input.REOPENED: Transition("propose", State.TURNING),
    },
    State.ROLLING: _ANY
    | {
        Input.MOVING: Transition("follow_turn", State.ROLLING),
        Input.STILL: Transition("see_turn", State.ROLLING),
        Input.ENDED: Transition("begin_turn", State.ROLLING),
        Input.REOPENED: Transition("propose", State.TURNING),
    },
    State.PAUSED: {
        Input.PAUSE: Transition("resume", State.TURNING),
        Input.FINISH: Transition("finish", State.DONE),
        Input.LINK_LOST: Transition("lose_link", State.LOST),
    },
    State.LOST: {
        Input.LINK_BACK: Transition("find_link", State.TURNING),
        Input.FINISH: Transition("finish", State.DONE),
    },
    State.DONE: {
        Input.REOPENED: Transition("propose", State.TURNING),
        Input.RESUMED: Transition("reopen", State.LOST),
    },
}
