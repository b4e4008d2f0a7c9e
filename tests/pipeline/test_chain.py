"""What a recorded session is told of itself again: marks as they were said, and only those that can be meant."""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path

import pytest

from imufield.acquire.decoded_session import session_blocks
from imufield.acquire.recording.reader import RecordedEvent
from imufield.guide.events import Event, Marked
from imufield.pipeline.chain import MARK, Chain, ReadingPlan, replay_into
from tests.commands.conftest import simulated_session


@pytest.mark.parametrize(
    ("said", "is_meant"),
    [
        ({"action": "skip"}, True),
        ({"action": "dance"}, False),
        ({"action": ["skip"]}, False),
        ({}, False),
        ({"action": "skip", "position": "nowhere"}, True),
        ({"action": "retake", "position": 7}, True),
        ({"action": "undo", "time_s": float("inf")}, True),
        ({"action": "undo", "time_s": 10**400}, True),
        ({"action": "undo", "time_s": "soon"}, True),
    ],
)
def test_a_mark_that_was_edited_ends_no_replay(tmp_path: Path, said: dict[str, object], *, is_meant: bool) -> None:
    session = simulated_session(tmp_path / "here", "faces6", visits=2)
    recorded = session_blocks(session, [])
    mark = RecordedEvent({"event": MARK, **said}, 0)
    events: list[Event] = []
    items = chain(list(islice(recorded, 3)), [mark], recorded)
    replay_into(Chain(ReadingPlan.of(session)), session, [], events.extend, items=items)
    assert sum(isinstance(event, Marked) for event in events) == is_meant


def test_a_guided_session_has_no_still_intervals_of_an_unguided_one(tmp_path: Path) -> None:
    session = simulated_session(tmp_path / "here", "faces6", visits=2)
    with pytest.raises(ValueError, match="guided"):
        Chain(ReadingPlan.of(session)).still_intervals()
