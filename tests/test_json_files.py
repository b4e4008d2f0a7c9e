"""JSON of others: a value or ValueError, whatever its nesting."""

from __future__ import annotations

import json

import pytest

from imufield.json_files import parse_json
from imufield.toml_files import DEEPEST


@pytest.mark.parametrize("value", [7, None, "text", [1, {"a": [2.5, []]}], {"a": {"b": [{}]}}])
def test_what_is_json_comes_back(value: object) -> None:
    assert parse_json(json.dumps(value)) == value


def test_the_deepest_that_is_taken() -> None:
    assert parse_json("[" * DEEPEST + "]" * DEEPEST) is not None


# The last is beyond what the parser itself can take.
@pytest.mark.parametrize("levels", [DEEPEST + 1, 900, 100_000])
@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ('{"a":', "}")])
def test_what_is_nested_deeper_is_refused(begin: str, end: str, levels: int) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of any kind
        parse_json(begin * levels + "1" + end * levels)


def test_what_is_none_is_refused() -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of any kind
        parse_json(b"\xff{")
