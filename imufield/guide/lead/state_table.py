"""The states of the guide as a table: (state, input) -> what to do and where to go.

The guide looks up every input here; an input that is not in the table does nothing. An action may answer with another input,
which is looked up in the new state: ``recognise`` answers ``near``, ``refused`` or ``same``. The table is data,
``state_table.toml``: the picture in the documentation and the tests are made from it.
"""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import NamedTuple

import tomli


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
    """Still, but nothing to measure here: waiting for the unit to be moved, or for its temperature to be steady."""
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
    UNWANTED = "unwanted"
    """The operator does not want the hold under way, or not any more."""
    RESUMED = "resumed"
    """A session that was finished is to go on."""
    PAUSE = "pause"
    FINISH = "finish"
    LINK_LOST = "link lost"
    LINK_BACK = "link back"


class Transition(NamedTuple):
    """Name of the method of ``GuideActions``, and the state to go to first."""

    action: str
    to: State


def _read_table() -> dict[State, dict[Input, Transition]]:
    groups = tomli.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    always = groups.pop("any")
    rows = {state: always | row if name == "running" else row for name, group in groups.items() for state, row in group.items()}
    return {
        state: {Input(happened): Transition(action, State(to)) for happened, (action, to) in rows[state.value].items()}
        for state in State
    }


TABLE = _read_table()
"""What to do and where to go, by state and input."""
