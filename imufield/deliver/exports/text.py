"""Numbers, matrices and strings as other programs' files want them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

import numpy as np

from imufield.samples import FloatArray


def number(value: float) -> str:
    """Return the shortest text that reads back as the same float64, with a decimal point: YAML 1.1 wants 1.0e-05."""
    mantissa, exponent, power = repr(float(value)).partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{exponent}{power}"


def row(values: Iterable[float], separator: str = ", ") -> str:
    """Return numbers in one line."""
    return separator.join(map(number, values))


def rows(matrix: FloatArray, start: str, end: str, separator: str = ", ") -> list[str]:
    """Return one line for each row of a matrix."""
    return [f"{start}{row(values, separator)}{end}" for values in matrix]


def comment(lines: Iterable[str], mark: str = "#") -> list[str]:
    """Return lines as comments."""
    return [f"{mark} {line}".rstrip() for line in lines]


def text_file(lines: Iterable[str], end: str = "\n") -> bytes:
    """Return the bytes of a text file in ASCII."""
    return "".join(f"{line}{end}" for line in lines).encode("ascii")


def json_file(document: object) -> bytes:
    """Return the bytes of a JSON file; numbers read back exactly, arrays are lists."""
    return (json.dumps(document, indent=2, allow_nan=False, default=np.ndarray.tolist) + "\n").encode("ascii")


def yaml_lines(table: Mapping[str, object], indent: int = 0) -> list[str]:
    """Return block YAML of dictionaries whose leaves are numbers, strings, None, lists of them, or arrays.

    Strings are written in double quotes with JSON escapes, which YAML reads the same way.
    """
    lines = []
    for key, value in table.items():
        item = value.tolist() if isinstance(value, np.ndarray) else value
        start = f"{' ' * indent}{key}:"
        if isinstance(item, dict):
            lines += [start, *yaml_lines(item, indent + 2)]
        # A matrix: one line for each row, as ROS tools and OpenCV lay it out.
        elif isinstance(item, list) and item and isinstance(item[0], list):
            lines += [start, *(f"{' ' * (indent + 2)}- {_scalar(entry)}" for entry in item)]
        else:
            lines.append(f"{start} {_scalar(item)}")
    return lines


def _scalar(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_scalar, value))}]"
    if isinstance(value, float):
        return number(value)
    return json.dumps(value)
