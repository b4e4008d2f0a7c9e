"""Every benchmark can be loaded: nothing checks them between releases but `make bench`, which takes long."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("bench_*.py")))
def test_it_loads(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER.parent))
    module = importlib.import_module(f"benchmarks.{name}")
    assert any(hasattr(module, entry) for entry in ("run", "main", "PARTS"))
