"""The schema of the events, and the pages that describe them."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from imufield.guide.event_schema import build_schema, read_schema
from imufield.guide.events import EVENTS, RefusalCode
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import mermaid
from imufield.guide.positions import scheme

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_shipped_schema_is_that_of_the_classes() -> None:
    assert read_schema() == build_schema()


def test_events_of_a_session_fit_the_schema(make_path: Any) -> None:
    path = make_path(100.0).hold([0, 0, 1], 6)
    for up in ([1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 1, 0]):
        path.turn(up, 1.5).hold(up, 5)
    samples = path.samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0, rotations="horizontal"))
    events = guide.feed(samples) + guide.mark("skip", float("nan")) + guide.link_lost() + guide.link_back()
    events += guide.mark("finish", float("nan"))
    kinds = {event.kind for event in events}
    assert kinds >= {"noise_floor", "accepted", "rejected", "turn", "marked", "link_lost", "link_back", "done"}
    validator = jsonschema.Draft202012Validator(read_schema())
    for event in events:
        validator.validate(event.to_dict())
    broken = {**events[0].to_dict(), "rate_hz": "fast"}
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(broken)


def test_the_page_names_every_event_key_and_reason() -> None:
    text = (DOCS / "events.md").read_text(encoding="utf-8")
    for kind, event in EVENTS.items():
        row = re.search(rf"^\| `{kind}` \|.*$", text, flags=re.MULTILINE)
        assert row is not None, kind
        assert all(f"`{field.name}`" in row[0] for field in fields(event) if field.name != "time_s"), kind
    assert re.findall(r"^\| `(\w+)` \|", text.split("## Reasons")[1], flags=re.MULTILINE) == [one.value for one in RefusalCode]


def test_the_state_table_is_drawn_as_it_is() -> None:
    assert mermaid() in (DOCS / "guide.md").read_text(encoding="utf-8")
