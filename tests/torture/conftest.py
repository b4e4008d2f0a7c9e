"""How often things are done to the program, and the table of what came of it.

``pytest`` runs a short form; ``make torture`` sets ``TORTURE=full``, which does everything as often as docs/reliability.md says
and writes that page anew.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import pytest

from imufield import __version__
from tests.commands.conftest import program, solved_session, whole_session

__all__ = ["program", "solved_session", "whole_session"]

FULL = os.environ.get("TORTURE") == "full"
PROJECT = Path(__file__).resolve().parents[2]
PAGE = PROJECT / "docs" / "reliability.md"
ROWS = PROJECT / "build" / "torture.json"
HEAD = """# Reliability

What was done to the program, how often, and what was lost. `make torture` does all of it again (about half an hour on two
cores) and writes this page; `make test` runs a short form of every line. Instruments are simulated; ports, files,
processes and kills are real. What has not been run in full has no row.

Version {version}, Python {python}, {date}.

| what was done | how often | what was lost, or what came of it (memory: growth after the first minute) |
|---|---|---|
"""


@dataclass
class Campaign:
    """Counts for a test in its present form, and rows of the table."""

    rows: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    """Module of the test, what was done, (how often, what was lost)."""
    full: bool = FULL
    module: str = ""

    def times(self, short: int, full: int) -> int:
        """Return how often to do it."""
        return full if self.full else short

    def tell(self, what: str, how_often: object, lost: str) -> None:
        """Add a row, or replace the one of an earlier run."""
        self.rows.setdefault(self.module, {})[what] = [str(how_often), lost]

    def write(self) -> None:
        """Write the page; rows of tests that were not run this time are those of their last run."""
        ROWS.parent.mkdir(exist_ok=True)
        kept = json.loads(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else {}
        for module, rows in self.rows.items():
            kept[module] = {**kept.get(module, {}), **rows}
        ROWS.write_text(json.dumps(kept, indent=1), encoding="utf-8")
        head = HEAD.format(version=__version__, python=platform.python_version(), date=datetime.now(UTC).date())
        lines = [f"| {what} | {' | '.join(row)} |\n" for name in sorted(kept) for what, row in kept[name].items()]
        PAGE.write_text(head + "".join(lines), encoding="utf-8")


@pytest.fixture(scope="session")
def whole_campaign() -> Iterator[Campaign]:
    campaign = Campaign()
    yield campaign
    if campaign.full and campaign.rows:
        campaign.write()


@pytest.fixture
def campaign(whole_campaign: Campaign, request: pytest.FixtureRequest) -> Campaign:
    whole_campaign.module = request.path.stem
    return whole_campaign
