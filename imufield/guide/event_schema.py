"""The JSON Schema of the events, made from their classes; the file shipped with the package is compared with it in a test."""

from __future__ import annotations

import json
import types
from dataclasses import fields
from enum import Enum
from importlib.resources import files
from typing import Any, Union, cast, get_args, get_origin, get_type_hints

from imufield.guide.events import EVENT_VERSION, EVENTS, Event

SCHEMA_FILE = "events.schema.json"


def build_schema() -> dict[str, Any]:
    """Return the schema of one line of ``capture --json`` after the first, which names the session."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "imufield guide event",
        "description": "One line of JSON for each event. Within one version keys are only added; null means not known.",
        "oneOf": [_session(), *(_schema_of(event) for event in EVENTS.values())],
    }


def read_schema() -> dict[str, Any]:
    """Return the schema shipped with the package."""
    return cast("dict[str, Any]", json.loads((files("imufield.guide") / SCHEMA_FILE).read_text(encoding="utf-8")))


def _session() -> dict[str, Any]:
    return _object("session", {"session": {"type": "string"}})


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
        return {"enum": [one.value for one in hint]}
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        kinds = [_type(one) for one in inner if one is not type(None)]
        return {"anyOf": [*kinds, {"type": "null"}]}
    if origin is tuple:
        count = None if inner[-1] is Ellipsis else len(inner)
        size = {} if count is None else {"minItems": count, "maxItems": count}
        return {"type": "array", "items": _type(inner[0]), **size}
    if origin is dict:
        return {"type": "object", "additionalProperties": _type(inner[1])}
    raise TypeError(f"no JSON Schema for {hint!r}")
