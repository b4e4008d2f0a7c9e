"""Rows of a benchmark, and the table that its own program prints of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

Row = dict[str, Any]


def row(name: str, value: float, unit: str, peer: float | None = None) -> Row:
    """Return one figure, beside that of a peer where there is one."""
    return {"name": name, "value": value, "unit": unit, "peer": peer, "ratio": value / peer if peer else None}


def print_rows(rows: Iterable[Row], width: int = 58) -> None:
    """Print the figures as a table."""
    print(f"{'':{width}} {'imufield':>10} {'peer':>10} {'ratio':>7}")
    for each in rows:
        peer = "" if each["peer"] is None else f"{each['peer']:10.3f}"
        ratio = "" if each["ratio"] is None else f"{each['ratio']:7.2f}"
        print(f"{each['name']:{width}} {each['value']:10.3f} {peer:>10} {ratio:>7}  {each['unit']}")
