"""How often things are done to the program, and the table of what came of it.

``pytest`` runs a short form; ``make torture`` sets ``TORTURE=full``, which does everything as often as docs/reliability.md says
and writes that page anew. What passed leaves its rows in ``build/torture/``, a file for each test with the commit it was made
on. A run that was interrupted goes on with what is missing: a test that has done its rows there on the present code is not run
again. At the end ``rows.json`` takes them in, so that a part can be run alone anywhere and the rest of the page stays.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from imufield import __version__
from imufield.files import write_atomically
from tests.commands.conftest import program, solved_session, whole_session

__all__ = ["program", "solved_session", "whole_session"]

FULL = os.environ.get("TORTURE") == "full"
PROJECT = Path(__file__).resolve().parents[2]
PAGE = PROJECT / "docs" / "reliability.md"
DONE = PROJECT / "build" / "torture"
ROWS = Path(__file__).with_name("rows.json")
CODE = ("imufield", "drivers", "protocols", "tests/torture", "tests/commands/conftest.py")
"""What decides how a test ends."""
NO_CODE = ":(exclude)tests/torture/rows.json"
"""Written by the tests themselves."""
HEAD = """# Reliability

What was done to the program, how often, and what was lost. `make torture` does all of it again (the tests of these rows took
{minutes:.0f} min one after another, some on a busy machine) and writes this page, `make torture PART=link` does one file of
`tests/torture`; `make test` runs a short form of every line. Instruments are simulated; ports, files, processes and kills are
real. A row stands for tests that passed; what failed, or has not been run in full, has none. The last columns name the
commit a row was made on, and the day.

Version {version}, Python {python}.

| what was done | how often | what was lost, or what came of it (MiB: memory gained after the first minute) | commit | day |
|---|---|---|---|---|
"""
ORDER = ("killed", "cut", "faults", "link", "sequences", "files", "reproductions", "second_corpus", "web", "claims")


@dataclass
class Row:
    """One line of the table; lines of several tests that did the same become one, with their numbers added."""

    what: str
    times: int
    unit: str
    came: str
    numbers: dict[str, int]

    def add(self, other: Row) -> None:
        """Take the numbers of another test into this row."""
        self.times += other.times
        self.numbers = {name: number + other.numbers[name] for name, number in self.numbers.items()}

    def cells(self) -> tuple[str, ...]:
        """Return what was done, how often and what came of it."""
        return self.what, f"{self.times:,} {self.unit}", self.came.format(**self.numbers)


@dataclass
class Campaign:
    """Counts for a test in its present form, and its rows of the table."""

    rows: list[Row] = field(default_factory=list)
    full: bool = FULL

    def times(self, short: int, full: int) -> int:
        """Return how often to do it."""
        return full if self.full else short

    def tell(self, what: str, times: int, unit: str, came: str, **numbers: int) -> None:
        """Add a row; ``came`` has the names of ``numbers`` in braces."""
        self.rows.append(Row(what, times, unit, came, numbers))


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *arguments], cwd=PROJECT, capture_output=True, text=True, check=False)


def present_commit() -> str:
    """Return the commit of the code as it lies here, with a + where it was changed since, "" outside a repository."""
    commit = _git("rev-parse", "--short=9", "HEAD").stdout.strip()
    return commit + "+" * bool(commit and _git("status", "--porcelain", "--", *CODE, NO_CODE).stdout)


def holds_still(commit: str) -> bool:
    """Whether the code is what it was on that commit."""
    known = bool(commit) and not commit.endswith("+")
    return known and _git("diff", "--quiet", commit, "--", *CODE, NO_CODE).returncode == 0


def rows_file(node: str) -> Path:
    """Where the rows of a test are kept."""
    return DONE / f"{re.sub(r'[^a-z0-9]+', '-', node.rpartition('torture/')[2].lower()).strip('-')}.json"


def kept_entries() -> dict[str, dict[str, Any]]:
    """Return what each test has left, now or in an earlier run."""
    kept: dict[str, dict[str, Any]] = json.loads(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else {}
    return kept | {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in DONE.glob("*.json")}


def page(kept: dict[str, dict[str, Any]]) -> str:
    """Return the page from what the tests have left."""
    entries = sorted(kept.values(), key=lambda entry: (ORDER.index(entry["part"]), entry["place"]))
    rows: dict[tuple[str, str, str], Row] = {}
    for entry in entries:
        for one in entry["rows"]:
            row, where = Row(**one), (one["what"], entry["commit"], entry["day"])
            if where in rows:
                rows[where].add(row)
            else:
                rows[where] = row
    minutes = sum(entry["seconds"] for entry in entries) / 60
    head = HEAD.format(version=__version__, python=platform.python_version(), minutes=minutes)
    lines = (f"| {' | '.join((*row.cells(), commit, day))} |\n" for (_, commit, day), row in rows.items())
    return head + "".join(lines)


@pytest.fixture
def campaign(request: pytest.FixtureRequest) -> Iterator[Campaign]:
    """Counts and rows; the rows of a test that passes in full are kept, those of one that fails are not."""
    campaign = Campaign()
    began_s, path = time.monotonic(), rows_file(request.node.nodeid)
    if campaign.full:
        path.unlink(missing_ok=True)
    yield campaign
    if campaign.full and campaign.rows:
        variant = getattr(request.node, "callspec", None)
        entry = {
            "part": request.path.stem.removeprefix("test_"),
            "place": [request.node.location[1], *(variant.indices.values() if variant else ())],
            "commit": present_commit(),
            "day": str(datetime.now(UTC).date()),
            "seconds": time.monotonic() - began_s,
            "rows": [asdict(row) for row in campaign.rows],
        }
        DONE.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps(entry, indent=1).encode())


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave out what was done on this very code."""
    path = rows_file(item.nodeid)
    if FULL and path.exists() and holds_still(json.loads(path.read_text(encoding="utf-8"))["commit"]):
        pytest.skip(f"done on this code; remove {path.relative_to(PROJECT)} to do it again")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the page, from the rows of this run and of earlier ones."""
    if FULL and DONE.is_dir() and not hasattr(session.config, "workerinput"):
        kept = kept_entries()
        ROWS.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        PAGE.write_text(page(kept), encoding="utf-8")
