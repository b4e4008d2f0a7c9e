"""The rules of a parameter file: ``parameters.schema.json`` decides, here it is enforced.

The same schema ships for other programs. It keeps to the keywords that ``first_fault`` understands, so a page of code can
enforce it and say, for a person, which key is wrong; the tests hold this page against a full JSON Schema validator.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

from imufield.dataclass import dataclass
from imufield.errors import Reason
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# What TOML and JSON hold; the schema says which types stand where, and no type checker reads that.
Document = dict[str, Any]
"""A table of a parameter file, a document of JSON, or the schema of one."""

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
    text = Path(__file__).with_name("parameters.schema.json").read_text(encoding="utf-8")
    schema: Document = json.loads(text)
    return schema


def json_ready(document: Document) -> Document:
    """Return a document with every NaN replaced by None, which JSON calls null."""
    return {key: _json_value(item) for key, item in document.items()}


def _json_value(value: object) -> object:
    if isinstance(value, dict):
        return json_ready(value)
    if isinstance(value, list):
        # Without a call for each number but NaN, which alone differs from itself.
        return [item if isinstance(item, float) and item == item else _json_value(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def first_fault(document: object) -> Fault | None:
    """Return the first rule of the schema that ``document`` breaks, or None."""
    return next(_faults(document, _parameter_rule(), ""), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rule:
    """A rule of the schema with its references resolved: a document has some 2000 values, a schema far fewer rules."""

    types: tuple[tuple[str, Callable[[object], bool]], ...]
    """Words and check of each type that a value may have; empty where it may have any."""
    limits: tuple[tuple[str, object], ...]
    """Keywords of ``_VALUE_CHECKS`` with their values."""
    is_kept: Callable[[object], bool]
    """Whether a value keeps the rule, as most do; where it is false the checks decide."""
    properties: Mapping[str, _Rule]
    required: tuple[str, ...]
    items: _Rule | None
    fewest: float
    most: float


@cache
def _parameter_rule() -> _Rule:
    schema = parameter_schema()
    return _resolved(schema, schema["$defs"])


def _resolved(rule: Document, definitions: Document) -> _Rule:
    if "$ref" in rule:
        rule = definitions[rule["$ref"].rpartition("/")[2]]
    wanted = rule.get("type", ())
    # A schema names one type, or several of which one must fit.
    names = [wanted] if isinstance(wanted, str) else wanted
    return _Rule(
        types=tuple(_TYPE_CHECKS[name] for name in names),
        limits=_limits(rule),
        is_kept=_first_look(rule, names),
        properties={name: _resolved(inner, definitions) for name, inner in rule.get("properties", {}).items()},
        required=tuple(rule.get("required", ())),
        items=_resolved(rule["items"], definitions) if "items" in rule else None,
        fewest=rule.get("minItems", 0),
        most=rule.get("maxItems", math.inf),
    )


def _first_look(rule: Document, types: Sequence[str]) -> Callable[[object], bool]:
    """Return what accepts at once the values that most of a document consists of: numbers within limits, and texts."""
    limits = rule.keys() & _VALUE_CHECKS
    if "number" in types and limits <= {"minimum", "maximum"}:
        largest = sys.float_info.max
        low, high, nan_too = rule.get("minimum", -largest), rule.get("maximum", largest), "null" in types
        return lambda value: type(value) is float and (low <= value <= high or (nan_too and math.isnan(value)))
    if "string" in types and not limits:
        return lambda value: type(value) is str
    return lambda _: False


def _faults(value: object, rule: _Rule, key: str) -> Iterator[Fault]:
    if isinstance(value, float) and math.isnan(value):
        value = None
    wrong = _type_fault(value, rule, key) or _value_fault(value, rule.limits, key)
    if wrong:
        yield wrong
    elif isinstance(value, dict):
        yield from _table_faults(value, rule, key)
    elif isinstance(value, list) and rule.items is not None:
        if not rule.fewest <= len(value) <= rule.most:
            wanted = rule.fewest if len(value) < rule.fewest else rule.most
            yield _fault(key, "schema.entries", found=len(value), wanted=wanted)
        for index, item in enumerate(value):
            if not rule.items.is_kept(item):
                yield from _faults(item, rule.items, f"{key}[{index}]")


def _table_faults(table: Document, rule: _Rule, key: str) -> Iterator[Fault]:
    above = f"{key}." if key else ""
    for name, item in table.items():
        if name not in rule.properties:
            yield _fault(above + name, "schema.unknown", Reason.UNKNOWN_KEY)
        elif not rule.properties[name].is_kept(item):
            yield from _faults(item, rule.properties[name], above + name)
    yield from (_fault(above + name, "schema.missing") for name in rule.required if name not in table)


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


def _type_fault(value: object, rule: _Rule, key: str) -> Fault | None:
    if isinstance(value, float) and math.isinf(value):
        return _fault(key, "schema.infinite", Reason.NOT_FINITE)
    if not rule.types or any(fits(value) for _, fits in rule.types):
        return None
    # None stands for NaN here, as in JSON.
    if value is None:
        return _fault(key, "schema.nan", Reason.NOT_FINITE)
    return _fault(key, "schema.type", shown=shown(value), wanted=" or ".join(words for words, _ in rule.types))


# By keyword: the sentence where a value breaks the rule, and whether a value keeps it.
_VALUE_CHECKS: dict[str, tuple[str, Callable[[object, Any], bool]]] = {
    "const": ("schema.const", lambda value, limit: value == limit and not isinstance(value, bool)),
    "enum": ("schema.enum", lambda value, limit: value in limit),
    "pattern": ("schema.pattern", lambda value, limit: re.search(limit, str(value)) is not None),
    "minimum": ("schema.minimum", lambda value, limit: not _is_number(value) or value >= limit),
    "maximum": ("schema.maximum", lambda value, limit: not _is_number(value) or value <= limit),
    "exclusiveMinimum": ("schema.above", lambda value, limit: not _is_number(value) or value > limit),
    "anyOf": ("schema.between", lambda value, rules: any(_value_fault(value, _limits(rule), "") is None for rule in rules)),
}


def _limits(rule: Document) -> tuple[tuple[str, object], ...]:
    return tuple((keyword, rule[keyword]) for keyword in _VALUE_CHECKS if keyword in rule)


def _value_fault(value: object, limits: tuple[tuple[str, object], ...], key: str) -> Fault | None:
    for keyword, limit in limits:
        name, holds = _VALUE_CHECKS[keyword]
        if not holds(value, limit):
            # An empty text stands for what is not known, which is nothing to choose.
            told = [*filter(None, limit)] if isinstance(limit, list) else limit
            return _fault(key, name, shown=shown(value), value=value, limit=told)
    return None


def shown(value: object) -> str:
    """Return a value short enough for an error message."""
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
