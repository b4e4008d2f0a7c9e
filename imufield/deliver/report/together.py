"""What changes from day to day, as a table for terminal and report: one row for each kind of parameter."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imufield.deliver.parameters.context import DayToDay
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.joined import shown_name, shown_unit

HEADINGS = ("1 sigma", "unit", "day to day", "95 %", "mean", "new day")
"""Of ``together_rows``."""
_DIGITS = 2  # Of a sigma.


def together_rows(parameters: Parameters) -> Iterator[tuple[str, ...]]:
    """Yield kind, unit, change from day to day with its interval, and sigma of mean and new day on the worst axis."""
    together = parameters.context.together
    for kind in () if together is None else together.repeatability:
        unit, size = shown_unit(kind.kind)
        # Sessions that agree better than their own sigma give no limit.
        interval = f"{_short(kind.low / size)} to {_short(kind.high / size)}" if kind.high > 0 else "no limit"
        largest = (_short(np.nanmax(sigmas) / size) for sigmas in (kind.mean_sigma, kind.day_sigma))
        yield (shown_name(kind.kind), unit, _seen(kind, size), interval, *largest)


def session_rows(parameters: Parameters) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, time, number of positions and hash of each session."""
    together = parameters.context.together
    for session in () if together is None else together.session:
        when = session.recorded.replace("T", " ").replace("Z", " UTC") or "not known"
        yield session.name, when, str(session.positions), session.sha256


def _seen(kind: DayToDay, size: float) -> str:
    """Return the estimate; that none is seen where it is zero, as the data say no more than the limit."""
    return _short(kind.sigma / size) if kind.sigma > 0 else "not seen"


def _short(value: float) -> str:
    return f"{value:.{_DIGITS}g}" if abs(value) < 10**_DIGITS else f"{value:.0f}"
