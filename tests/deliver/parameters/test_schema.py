from __future__ import annotations

import copy
from typing import Any

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.document import to_document
from imufield.deliver.parameters.schema import first_fault, json_ready, parameter_schema
from imufield.errors import Reason
from tests.told import key_of

KEYWORDS = frozenset(
    {"$ref", "type", "const", "enum", "pattern", "minimum", "exclusiveMinimum", "maximum", "anyOf", "description"}
    | {"properties", "required", "additionalProperties", "items", "minItems", "maxItems"}
)
"""What ``first_fault`` understands."""


@pytest.fixture
def document(calibration: Calibration, observations: Observations, context: Context) -> dict[str, Any]:
    return to_document(calibration, observations, context)


def rules(schema: Any) -> list[dict[str, Any]]:
    """Return every rule inside a schema, the names of properties being no rules."""
    inner = [*schema.get("properties", {}).values(), *schema.get("$defs", {}).values()]
    inner += [schema["items"]] if "items" in schema else []
    return [schema, *(rule for part in inner for rule in rules(part))]


def test_the_schema_is_one_and_uses_only_what_is_enforced() -> None:
    jsonschema.Draft202012Validator.check_schema(parameter_schema())
    used = {keyword for rule in rules(parameter_schema()) for keyword in rule}
    assert used <= KEYWORDS | {"$schema", "title", "$defs"}
    assert all(rule["additionalProperties"] is False for rule in rules(parameter_schema()) if "properties" in rule)


def test_every_number_has_the_limits_of_what_can_be() -> None:
    """Numbers of any size would be computed with: one that a person mistyped must not reach a navigation system."""
    numbers = [rule for rule in rules(parameter_schema()) if "number" in rule.get("type", ())]
    assert len(numbers) > 10
    assert not [rule for rule in numbers if not ({"minimum", "exclusiveMinimum"} & rule.keys() and "maximum" in rule)]


def test_a_written_document_passes_both_validators(document: dict[str, Any]) -> None:
    assert first_fault(document) is None
    jsonschema.validate(json_ready(document), parameter_schema())


def places(value: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the way to every value inside a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for key, item in items for place in [(*way, key), *places(item, (*way, key))]]


WRONG = [None, True, -1, 1, 0.0, -1e300, 1e9, float("inf"), "", "good", [], [1.0, 2.0, 3.0], {}, {"scale": 1}]


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(choice=st.integers(0, 10**6), wrong=st.sampled_from(WRONG), how=st.sampled_from(["set", "delete", "add"]))
def test_agrees_with_a_full_validator_on_damage(document: dict[str, Any], choice: int, wrong: Any, how: str) -> None:
    damaged = copy.deepcopy(document)
    ways = places(damaged)
    *above, last = ways[choice % len(ways)]
    holder = damaged
    for step in above:
        holder = holder[step]
    if how == "delete":
        del holder[last]
    elif how == "set" or isinstance(holder, list):
        holder[last] = wrong
    else:
        holder[f"{last}_x"] = wrong
    validator = jsonschema.Draft202012Validator(parameter_schema())
    infinite = how != "delete" and wrong == float("inf")
    assert (first_fault(damaged) is not None) == (infinite or not validator.is_valid(json_ready(damaged)))


@pytest.mark.parametrize(
    ("table", "key", "value", "reason", "rule", "facts"),
    [
        ("accelerometer", "scale", [1.0, 2.0], Reason.DAMAGED, "entries", ["accelerometer.scale", "2", "3"]),
        ("accelerometer", "scale", [1.0, 2.0, float("nan")], Reason.NOT_FINITE, "nan", ["accelerometer.scale[2]"]),
        ("accelerometer", "gauge", "left", Reason.DAMAGED, "enum", ["'left'", "preset, lower, upper, symmetric"]),
        ("accelerometer", "colour", "red", Reason.UNKNOWN_KEY, "unknown", ["accelerometer.colour"]),
        ("site", "latitude_deg", 91.0, Reason.DAMAGED, "maximum", ["site.latitude_deg", "91", "90"]),
        ("quality", "rank", 12.5, Reason.DAMAGED, "type", ["quality.rank", "12.5", "a whole number"]),
        ("quality", "rank", 2**60, Reason.DAMAGED, "type", ["a whole number"]),
        ("site", "gravity_sigma_m_s2", -1.0, Reason.DAMAGED, "minimum", ["-1", "0"]),
        ("site", "gravity_m_s2", 0.0, Reason.DAMAGED, "minimum", ["0", "9.76"]),
        ("instrument", "grade", "golden", Reason.DAMAGED, "enum", ["'golden'", "one of navigation, tactical"]),
        ("session", "sample_rate_hz", 1e300, Reason.DAMAGED, "maximum", ["session.sample_rate_hz", "1e+06"]),
        ("accelerometer", "bias_m_s2", [0.0, 1e300, 0.0], Reason.DAMAGED, "maximum", ["accelerometer.bias_m_s2[1]", "1e+15"]),
        ("solver", "cost", float("inf"), Reason.NOT_FINITE, "infinite", ["solver.cost"]),
    ],
)
def test_says_what_is_wrong(
    document: dict[str, Any], table: str, key: str, value: Any, reason: Reason, rule: str, facts: list[str]
) -> None:
    document[table][key] = value
    fault = first_fault(document)
    assert fault is not None
    assert key_of(fault.what) == f"schema.{rule}"
    assert fault.what.startswith(fault.key)
    assert all(fact in fault.what for fact in facts), fault
    assert fault.reason is reason


@pytest.mark.parametrize(("freedom", "key"), [(0, ""), (1e-3, ""), (5e-324, "schema.between"), (9e-4, "schema.between")])
def test_degrees_of_freedom_are_none_or_some(document: dict[str, Any], freedom: float, key: str) -> None:
    sigma = [0.0] * len(document["covariance"]["names"])
    document["budget"] = {"share": [{"name": "gravity", "type": "B", "degrees_of_freedom": freedom, "sigma": sigma}]}
    fault = first_fault(document)
    assert (key_of(fault.what) if fault else "") == key
    assert jsonschema.Draft202012Validator(parameter_schema()).is_valid(json_ready(document)) is (not key)
