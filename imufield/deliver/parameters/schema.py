"""The rules of a parameter file: ``parameters.schema.json`` decides, here it is enforced.

The same schema ships for other programs. It keeps to the keywords in ``KEYWORDS``, so a page of code can enforce it and
say, for a person, which key is wrong; the tests hold this page against a full JSON Schema validator.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple, TypeGuard

from imufield.errors import Reason
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# What TOML and JSON hold; the schema says which types stand where, and no type checker reads that.
Document = dict[str, Any]
"""A table of a parameter file, a document of JSON, or the schema of one."""

KEYWORDS = frozenset(
    {"$ref", "type", "const", "enum", "pattern", "minimum", "exclusiveMinimum", "maximum", "anyOf", "description"}
    | {"properties", "required", "additionalProperties", "items", "minItems", "maxItems"}
)
"""What ``first_fault`` understands."""
LARGEST_EXACT_INTEGER = 2**53
"""A larger integer does not fit a float64 exactly."""


class Fault(NamedTuple):
    """One broken rule: where (dotted key), what is wrong with it in words, and the reason for programs."""

    key: str
    what: str
    reason: Reason


@cache
def parameter_schema() -> Document:
    """Return the JSON Schema of the parameter file."""
    text = (files("imufield.deliver.parameters") / "parameters.schema.json").read_text(encoding="utf-8")
    schema: Document = json.loads(text)
    return schema


def json_ready(document: Document) -> Document:
    """Return a document with every NaN replaced by None, which JSON calls null."""
    return {key: _json_value(item) for key, item in document.items()}


def _json_value(value: object) -> object:
    if isinstance(value, dict):
        return json_ready(value)
    if isinstance(value, list):
        return [_json_value(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def first_fault(document: object) -> Fault | None:
    """Return the first rule of the schema that ``document`` breaks, or None."""
    schema = parameter_schema()
    return next(_faults(_json_value(document), schema, "", schema["$defs"]), None)


def _faults(value: object, rule: Document, key: str, definitions: Document) -> Iterator[Fault]:
    if "$ref" in rule:
        rule = definitions[rule["$ref"].rpartition("/")[2]]
    wrong = _type_fault(value, rule, key) or _value_fault(value, rule, key)
    if wrong:
        yield wrong
    elif isinstance(value, dict):
        above = f"{key}." if key else ""
        for name, item in value.items():
            if name in rule["properties"]:
                yield from _faults(item, rule["properties"][name], above + name, definitions)
            else:
                yield _fault(above + name, "schema.unknown", Reason.UNKNOWN_KEY)
        yield from (_fault(above + name, "schema.missing") for name in rule.get("required", ()) if name not in value)
    elif isinstance(value, list):
        fewest, most = rule.get("minItems", 0), rule.get("maxItems", math.inf)
        if not fewest <= len(value) <= most:
            yield _fault(key, "schema.entries", found=len(value), wanted=fewest if len(value) < fewest else most)
        for index, item in enumerate(value):
            yield from _faults(item, rule["items"], f"{key}[{index}]", definitions)


def _fault(key: str, name: str, reason: Reason = Reason.DAMAGED, **values: object) -> Fault:
    return Fault(key, sentence(name, key=key, **values), reason)


def _is_number(value: object) -> TypeGuard[float]:
    if isinstance(value, bool):  # an int in Python, and none in a file
        return False
    return isinstance(value, float) or (isinstance(value, int) and abs(value) <= LARGEST_EXACT_INTEGER)


_TYPE_CHECKS: dict[str, tuple[str, Callable[[object], bool]]] = {
    "object": ("a table", lambda value: isinstance(value, dict)),
    "array": ("an array", lambda value: isinstance(value, list)),
    "string": ("a text", lambda value: isinstance(value, str)),
    "boolean": ("true or false", lambda value: isinstance(value, bool)),
    "integer": ("a whole number", lambda value: _is_number(value) and float(value).is_integer()),
    "number": ("a number", _is_number),
    "null": ("nan", lambda value: value is None),
}


def _type_fault(value: object, rule: Document, key: str) -> Fault | None:
    if isinstance(value, float) and math.isinf(value):
        return _fault(key, "schema.infinite", Reason.NOT_FINITE)
    wanted = rule.get("type", ())
    # A schema names one type, or several of which one must fit.
    checks = [_TYPE_CHECKS[name] for name in ([wanted] if isinstance(wanted, str) else wanted)]
    if not checks or any(fits(value) for _, fits in checks):
        return None
    # None stands for NaN here (json_ready).
    if value is None:
        return _fault(key, "schema.nan", Reason.NOT_FINITE)
    return _fault(key, "schema.type", shown=shown(value), wanted=" or ".join(words for words, _ in checks))


# By keyword: the sentence where a value breaks the rule, and whether a value keeps it.
_VALUE_CHECKS: dict[str, tuple[str, Callable[[object, Any], bool]]] = {
    "const": ("schema.const", lambda value, limit: value == limit and not isinstance(value, bool)),
    "enum": ("schema.enum", lambda value, limit: value in limit),
    "pattern": ("schema.pattern", lambda value, limit: re.search(limit, str(value)) is not None),
    "minimum": ("schema.minimum", lambda value, limit: not _is_number(value) or value >= limit),
    "maximum": ("schema.maximum", lambda value, limit: not _is_number(value) or value <= limit),
    "exclusiveMinimum": ("schema.above", lambda value, limit: not _is_number(value) or value > limit),
    "anyOf": ("schema.between", lambda value, rules: any(_value_fault(value, rule, "") is None for rule in rules)),
}


def _value_fault(value: object, rule: Document, key: str) -> Fault | None:
    for keyword, (name, holds) in _VALUE_CHECKS.items():
        if keyword in rule and not holds(value, rule[keyword]):
            # An empty text stands for what is not known, which is nothing to choose.
            limit = [*filter(None, rule[keyword])] if keyword == "enum" else rule[keyword]
            return _fault(key, name, shown=shown(value), value=value, limit=limit)
    return None


def shown(value: object) -> str:
    """Return a value short enough for an error message."""
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
