"""Run one benchmark and hand its figures to the caller as JSON: ``python -m benchmarks.collect NAME FILE``.

A benchmark has ``run()``, which returns rows of name, value, unit, peer and ratio; one that has only a program prints.
"""

from __future__ import annotations

import importlib
import json
import runpy
import sys
from pathlib import Path
from typing import Any


def numbers(row: dict[str, Any]) -> dict[str, Any] | None:
    """Return a row as plain numbers, None where it holds words."""
    try:
        value = float(row["value"])
    except (TypeError, ValueError):
        return None
    peer = row.get("peer")
    return {"what": str(row["name"]), "value": value, "unit": str(row["unit"]), "peer": None if peer is None else float(peer)}


def main(name: str, output: str) -> None:
    """Measure, and write the rows."""
    sys.argv = sys.argv[:1]
    module = f"benchmarks.bench_{name}"
    run = getattr(importlib.import_module(module), "run", None)
    rows: list[dict[str, Any]] = []
    if run is None or getattr(sys.modules[module], "PRINTS", False):
        del sys.modules[module]
        runpy.run_module(module, run_name="__main__")
    else:
        rows = [row for row in map(numbers, run()) if row is not None]
    Path(output).write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:3])
