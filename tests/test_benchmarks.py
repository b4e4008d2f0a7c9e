"""What the benchmarks write down: comparable, kept, and what became worse is named."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmarks import collect
from benchmarks.ledger import Figure, Ledger, Machine, describe_machine, page_lines, regressions

MACHINE = Machine("a processor", 4, 16, "3.12.1", "numpy 2", "load average 0")
OTHER = Machine("another", 4, 16, "3.12.1", "numpy 2", "load average 0")
RATE = Figure("decode", "frames", 5.0, "million frames/s", 0.1)
TIME = Figure("commands", "solve", 2.0, "s")


def ledger(*figures: Figure) -> Ledger:
    one = Ledger()
    for figure in figures:
        one.add(MACHINE, figure.benchmark, [figure], "")
    return one


def test_history_is_read_as_it_was_written(tmp_path: Path) -> None:
    before = ledger(RATE, TIME)
    before.write(tmp_path / "history.csv")
    assert Ledger.read(tmp_path / "history.csv").entries == before.entries
    assert Ledger.read(tmp_path / "none.csv").entries == []


@pytest.mark.parametrize(
    ("figure", "told"),
    [
        (Figure("decode", "frames", 4.3, "million frames/s", 0.1), None),
        (Figure("decode", "frames", 4.0, "million frames/s", 0.1), "1.25 times worse beside its peer"),
        # A busy machine slows the peer, too.
        (Figure("decode", "frames", 2.5, "million frames/s", 0.05), None),
        (Figure("decode", "frames", 10.0, "million frames/s", 0.1), None),
        (Figure("commands", "solve", 2.3, "s"), None),
        (Figure("commands", "solve", 3.0, "s"), "1.50 times worse (2 on "),
        (Figure("commands", "solve", 1.0, "s"), None),
        (Figure("commands", "solve", 3.0, "s", 1.0), None),
        (Figure("commands", "solve", 3000.0, "ms"), None),
        (Figure("commands", "apply", 9.0, "s"), None),
    ],
)
def test_worse_by_a_fifth_is_told_as_a_ratio(figure: Figure, told: str | None) -> None:
    found = list(regressions(ledger(RATE, TIME), MACHINE, [figure]))
    assert len(found) == (told is not None)
    assert told is None or told in found[0]


def test_runs_of_other_machines_are_not_compared() -> None:
    assert not list(regressions(ledger(TIME), OTHER, [Figure("commands", "solve", 9.0, "s")]))


def test_the_page_has_the_newest_figures_with_peers() -> None:
    text = "\n".join(page_lines(ledger(RATE, TIME, Figure("commands", "solve", 1.5, "s"))))
    assert "| frames | 5 | million frames/s | 0.1 | 50.00 |" in text
    assert "| solve | 1.5 | s |" in text
    assert "| solve | 2 | s |" not in text
    assert MACHINE.key in text


def test_this_machine_can_be_described() -> None:
    found = describe_machine()
    assert found.cores > 0
    assert "numpy" in found.packages


def test_rows_of_a_benchmark_are_numbers() -> None:
    assert collect.numbers({"name": "a", "value": "12.5", "unit": "us"}) == {
        "what": "a",
        "value": 12.5,
        "unit": "us",
        "peer": None,
    }
    assert collect.numbers({"name": "a", "value": "12 of 15", "unit": ""}) is None
