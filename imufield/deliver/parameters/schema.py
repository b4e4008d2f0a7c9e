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
from typing import Any, NamedTuple

from imufield.errors import Reason

Rule = dict[str, Any]

KEYWORDS = frozenset(
    {"$ref", "type", "const", "enum", "pattern", "minimum", "exclusiveMinimum", "maximum", "description"}
    | {"properties", "required", "additionalProperties", "items", "minItems", "maxItems"}
)
"""What ``first_fault`` understands."""
LARGEST_EXACT_INTEGER = 2**53
"""A larger integer does not fit a float64 exactly."""


class Fault(NamedTuple):
    """One broken rule: where (dotted key), what is wrong, and the reason for programs."""

    key: str
    what: str
    reason: Reason


@cache
def parameter_schema() -> Rule:
    """Return the JSON Schema of the parameter file."""
    text = (files("imufield.deliver.parameters") / "parameters.schema.json").read_text(encoding="utf-8")
    schema: Rule = json.loads(text)
    return schema


def json_ready(value: Any) -> Any:
    """Return a document with every NaN replaced by None, which JSON calls null."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def first_fault(document: Any) -> Fault | None:
    """Return the first rule of the schema that ``document`` breaks, or None."""
    schema = parameter_schema()
    return next(_faults(json_ready(document), schema, "", schema["$defs"]), None)


def _faults(value: Any, rule: Rule, key: str, definitions: Rule) -> Iterator[Fault]:
    if "$ref" in rule:
        rule = definitions[rule["$ref"].rpartition("/")[2]]
    wrong = _type_fault(value, rule, key) or _value_fault(value, rule, key)
    if wrong:
        yield wrong
    elif isinstance(value, dict):
        yield from _table_faults(value, rule, key, definitions)
    elif isinstance(value, list):
        yield from _array_faults(value, rule, key, definitions)


def _table_faults(table: Rule, rule: Rule, key: str, definitions: Rule) -> Iterator[Fault]:
    known = rule["properties"]
    for name, value in table.items():
        if name not in known:
            yield Fault(_join(key, name), "is not a key of this format", Reason.UNKNOWN_KEY)
        else:
            yield from _faults(value, known[name], _join(key, name), definitions)
    for name in rule.get("required", ()):
        if name not in table:
            yield Fault(_join(key, name), "is missing", Reason.DAMAGED)


def _array_faults(array: list[Any], rule: Rule, key: str, definitions: Rule) -> Iterator[Fault]:
    fewest, most = rule.get("minItems", 0), rule.get("maxItems", math.inf)
    if not fewest <= len(array) <= most:
        yield Fault(key, f"has {len(array)} entries instead of {fewest}", Reason.DAMAGED)
    for index, value in enumerate(array):
        yield from _faults(value, rule["items"], f"{key}[{index}]", definitions)


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _is_number(value: Any) -> bool:
    if isinstance(value, bool):
        return False
    return isinstance(value, float) or (isinstance(value, int) and abs(value) <= LARGEST_EXACT_INTEGER)


_TYPE_CHECKS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "object": ("a table", lambda value: isinstance(value, dict)),
    "array": ("an array", lambda value: isinstance(value, list)),
    "string": ("a text", lambda value: isinstance(value, str)),
    "boolean": ("true or false", lambda value: isinstance(value, bool)),
    "integer": ("a whole number", lambda value: _is_number(value) and float(value).is_integer()),
    "number": ("a number", _is_number),
    "null": ("nan", lambda value: value is None),
}


def _type_fault(value: Any, rule: Rule, key: str) -> Fault | None:
    if isinstance(value, float) and math.isinf(value):
        return Fault(key, "is infinite", Reason.NOT_FINITE)
    wanted = rule.get("type", ())
    checks = [_TYPE_CHECKS[name] for name in ([wanted] if isinstance(wanted, str) else wanted)]
    if not checks or any(fits(value) for _, fits in checks):
        return None
    if value is None:
        return Fault(key, "is nan where a number is needed", Reason.NOT_FINITE)
    return Fault(key, f"is {shown(value)} instead of {' or '.join(words for words, _ in checks)}", Reason.DAMAGED)


def _value_fault(value: Any, rule: Rule, key: str) -> Fault | None:
    what = ""
    if "const" in rule and (value != rule["const"] or isinstance(value, bool)):
        what = f"is {shown(value)} instead of {rule['const']!r}"
    elif "enum" in rule and value not in rule["enum"]:
        what = f"is {shown(value)}, not one of {', '.join(rule['enum'])}"
    elif "pattern" in rule and not re.search(rule["pattern"], value):
        what = f"is {shown(value)}, which has not the form {rule['pattern']}"
    elif _is_number(value):
        what = _range_fault(value, rule)
    return Fault(key, what, Reason.DAMAGED) if what else None


def _range_fault(value: float, rule: Rule) -> str:
    if value < rule.get("minimum", -math.inf):
        return f"is {value:g}, below {rule['minimum']:g}"
    if value > rule.get("maximum", math.inf):
        return f"is {value:g}, above {rule['maximum']:g}"
    if value <= rule.get("exclusiveMinimum", -math.inf):
        return f"is {value:g} and must be above {rule['exclusiveMinimum']:g}"
    return ""


def shown(value: Any) -> str:
    """Return a value short enough for an error message."""
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
