"""The schema of the events, and the pages that describe them."""

from __future__ import annotations

import json
import re
import types
from dataclasses import fields
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import jsonschema
import pytest

from imufield.guide.events import EVENT_VERSION, EVENTS, Event, RefusalCode
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import TABLE, State
from imufield.guide.positions import scheme

DOCS = Path(__file__).resolve().parents[2] / "docs"


def build_schema() -> dict[str, Any]:
    """Return the schema of one line of ``capture --json``."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "imufield guide event",
        "description": "One line of JSON for each event. Within one version keys are only added; null means not known.",
        "oneOf": [_session(), _page(), *(_schema_of(event) for event in EVENTS.values())],
    }


def read_schema() -> Any:
    """Return the schema shipped with the package."""
    return json.loads((files("imufield.guide") / "events.schema.json").read_text(encoding="utf-8"))


def _session() -> dict[str, Any]:
    return _object("session", {"session": {"type": "string"}})


def _page() -> dict[str, Any]:
    return _object("page", {"url": {"type": "string"}, "watch_url": {"type": "string"}})


def _schema_of(event: type[Event]) -> dict[str, Any]:
    hints = get_type_hints(event)
    return _object(event.kind, {field.name: _type(hints[field.name]) for field in fields(event)})


def _object(kind: str, properties: dict[str, Any]) -> dict[str, Any]:
    named = {"version": {"const": EVENT_VERSION}, "event": {"const": kind}, **properties}
    return {"title": kind, "type": "object", "properties": named, "required": list(named)}


def _type(hint: Any) -> dict[str, Any]:
    """Return the schema of one annotation; a float may be null, because what is not finite is."""
    simple: dict[Any, dict[str, Any]] = {
        str: {"type": "string"},
        bool: {"type": "boolean"},
        int: {"type": "integer"},
        float: {"type": ["number", "null"]},
    }
    if hint in simple:
        return dict(simple[hint])
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [member.value for member in hint]}
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        kinds = [_type(member) for member in inner if member is not type(None)]
        return {"anyOf": [*kinds, {"type": "null"}]}
    if origin is tuple:
        count = None if inner[-1] is Ellipsis else len(inner)
        size = {} if count is None else {"minItems": count, "maxItems": count}
        return {"type": "array", "items": _type(inner[0]), **size}
    if origin is dict:
        return {"type": "object", "additionalProperties": _type(inner[1])}
    raise TypeError(f"no JSON Schema for {hint!r}")


def mermaid() -> str:
    """Return the table as a state diagram in Mermaid, inputs that lead to the same state joined."""
    lines = ["stateDiagram-v2", f"    [*] --> {State.LEARNING.value}"]
    for state, row in TABLE.items():
        by_target: dict[State, list[str]] = {}
        for happened, transition in row.items():
            # What can happen in any state is drawn at the first one only.
            if TABLE[State.LEARNING].get(happened) == transition and state is not State.LEARNING:
                continue
            by_target.setdefault(transition.to, []).append(f"{happened.value} / {transition.action.replace('_', ' ')}")
        lines += [f"    {state.value} --> {to.value}: {', '.join(inputs)}" for to, inputs in by_target.items()]
    return "\n".join(lines)


def test_the_shipped_schema_is_that_of_the_classes() -> None:
    assert read_schema() == build_schema()


def test_events_of_a_session_fit_the_schema(make_path: Any) -> None:
    path = make_path(100.0).hold([0, 0, 1], 6)
    for up in ([1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 1, 0]):
        path.turn(up, 1.5).hold(up, 5)
    samples = path.samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0, rotations="horizontal"))
    events = guide.feed(samples) + guide.mark("skip", float("nan")) + guide.link_lost() + guide.feed(samples[-50:])
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
