"""Plain lines and JSON lines, on the events of one simulated session."""

import json
import re
from dataclasses import replace
from typing import Any

import pytest

from imufield.guide.events import (
    EVENT_VERSION,
    EVENTS,
    LinkLost,
)
from imufield.guide.view.plain import JsonLinesView, PlainView, line


def test_every_event_has_a_line_and_a_dictionary(session: Any) -> None:
    events = [event for some, _ in session() for event in some]
    events.append(LinkLost(1.0, 2, 6))
    kinds = {event.kind for event in events}
    assert {"noise_floor", "move", "turning", "hold", "holding", "accepted", "rejected", "link_lost"} <= kinds <= set(EVENTS)
    for event in events:
        told = event.to_dict()
        assert told["version"] == EVENT_VERSION
        assert told["event"] == event.kind
        assert len(line(event)) > 15
        assert "\n" not in line(event)


def test_a_lost_link_says_what_to_do_wherever_it_is_told() -> None:
    lost = LinkLost(1.0, 2, 6)
    assert "reconnect" in line(lost)
    assert "reconnect" in str(lost.to_dict()["words"])


def test_json_lines_are_strict_json(session: Any) -> None:
    lines: list[str] = []
    JsonLinesView(lines.append).show([event for some, _ in session() for event in some])
    told = [json.loads(one, parse_constant=pytest.fail) for one in lines]
    assert [one["event"] for one in told[:2]] == ["noise_floor", "move"]
    accepted = next(one for one in told if one["event"] == "accepted")
    assert accepted["position"] == "+z"
    assert accepted["residual_m_s2"] is None
    assert accepted["temperature_degc"] is None
    assert [one["reason"] for one in told if one["event"] == "rejected"] == ["moved", "not_near"]


def test_plain_lines_tell_progress_now_and_then(session: Any) -> None:
    lines: list[str] = []
    view = PlainView(lines.append)
    for events, _ in session():
        view.show(events)
    text = "\n".join(lines)
    assert "accepted +z: 3.0 s" in text
    assert "refused: none of the open positions is near" in text
    assert sum("turning:" in one for one in lines) <= 3
    assert not re.search(r"\x1b", text)


def test_plain_lines_count_from_the_first_sample(session: Any) -> None:
    written: list[str] = []
    events = [replace(event, time_s=event.time_s + 26000) for some, _ in session(6.0) for event in some]
    PlainView(written.append, origin_s=lambda: 26000.0).show(events)
    assert all(float(one.split(" s  ")[0]) < 6.5 for one in written)
