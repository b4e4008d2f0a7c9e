"""How often things are done to the program, and the table of what came of it.

``pytest`` runs a short form; ``make torture`` sets ``TORTURE=full``, which does everything as often as docs/reliability.md says
and writes that page anew.
"""

from __future__ import annotations

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
PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"
HEAD = """# Reliability

What was done to the program, how often, and what was lost. `make torture` does all of it again (about an hour on two
cores) and writes this page; `make test` runs a short form of every line. Instruments are simulated; ports, files,
processes and kills are real.

Version {version}, Python {python}, {date}.

| what was done | how often | what was lost, or what came of it |
|---|---|---|
"""


@dataclass
class Campaign:
    """Counts for a test in its present form, and rows of the table."""

    rows: list[tuple[str, str, str]] = field(default_factory=list)
    full: bool = FULL

    def times(self, short: int, full: int) -> int:
        """Return how often to do it."""
        return full if self.full else short

    def tell(self, what: str, how_often: object, lost: str) -> None:
        """Add a row."""
        self.rows.append((what, str(how_often), lost))


@pytest.fixture(scope="session")
def campaign() -> Iterator[Campaign]:
    campaign = Campaign()
    yield campaign
    if campaign.full and campaign.rows:
        head = HEAD.format(version=__version__, python=platform.python_version(), date=datetime.now(UTC).date())
        PAGE.write_text(head + "".join(f"| {' | '.join(row)} |\n" for row in campaign.rows), encoding="utf-8")
