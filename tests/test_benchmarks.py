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


def test_accounts_of_damage_are_collected_as_they_are_printed() -> None:
    module = importlib.import_module("benchmarks.bench_damage")
    rows = module.run(2.0, only="stim300")
    assert rows
    assert module.PRINTS or all("value" in row for row in rows), "what `benchmarks.collect` cannot take as figures"
