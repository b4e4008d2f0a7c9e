"""Every benchmark can be loaded: nothing checks them between releases but `make bench`, which takes long."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

from tests.simulate import accounting

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("bench_*.py")))
def test_it_loads(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER.parent))
    module = importlib.import_module(f"benchmarks.{name}")
    assert any(hasattr(module, entry) for entry in ("run", "main", "PARTS"))


def test_accounts_of_damage_are_collected_as_they_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What `benchmarks.collect` cannot take as figures is printed by the benchmark's own program, and no rows are written."""
    monkeypatch.syspath_prepend(str(FOLDER.parent))
    monkeypatch.setattr(sys, "argv", ["collect"])
    wires = [wire for wire in accounting.serial_wires() if str(wire).startswith("stim300")][:1]
    count = accounting.account_for
    monkeypatch.delitem(sys.modules, "benchmarks.bench_damage", raising=False)
    monkeypatch.setattr(accounting, "serial_wires", lambda: wires)
    monkeypatch.setattr(accounting, "account_for", lambda wire, _, *, outages: count(wire, 2.0, outages=outages))
    importlib.import_module("benchmarks.collect").main("damage", str(tmp_path / "rows.json"))
    assert json.loads((tmp_path / "rows.json").read_text()) == []
    assert str(wires[0]) in capsys.readouterr().out
