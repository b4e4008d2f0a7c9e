"""JSON that others wrote, read within the limit of nesting that TOML files have."""

from __future__ import annotations

import json

from imufield.toml_files import DEEPEST


def parse_json(data: bytes | str) -> object:
    """Return the value.

    Raises
    ------
    ValueError
        It is no JSON, or nested deeper than ``DEEPEST``: what takes it apart afterwards would end in a RecursionError.
    """
    try:
        value = json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    layer = [value]
    for _ in range(DEEPEST):
        tables = [each.values() if isinstance(each, dict) else each for each in layer if isinstance(each, dict | list)]
        layer = [each for table in tables for each in table]
        if not layer:
            return value
    raise ValueError("nested too deep")
