"""What the terminal shows, drawn from events and a snapshot; 80 columns by 24 lines, readable without colour.

Colour only repeats what signs and words say already. Nothing here decides anything.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass, field

from rich.box import ROUNDED
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from imufield.guide.events import Accepted, Done, Event, Hold, Holding, LinkBack, LinkLost, Marked, Move, Rejected, Turning
from imufield.guide.guide import Snapshot
from imufield.guide.plain import words
from imufield.guide.positions import Scheme
from imufield.guide.state_table import State
from imufield.guide.wording import quantity

WIDTH, HEIGHT = 80, 24
MAP_WIDTH = 34
BAR_WIDTH = 20
MAP_ROWS = 12
MESSAGES = 5
READ_S = 4.0
"""A refusal stays on the screen for this long although the unit moves on."""
KEYS = "r retake   s skip   u undo   p pause   f finish early   q quit (resume later)"


@dataclass(slots=True)
class Screen:
    """What the events have said so far, as far as it is shown."""

    target: str = ""
    target_words: str = ""
    position: str = ""
    position_words: str = ""
    angle_deg: float = math.nan
    remaining_s: float = math.nan
    refused: Rejected | None = None
    link: bool = True
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=MESSAGES))

    def follow(self, events: list[Event]) -> None:
        """Take the events in order."""
        for event in events:
            self._take(event)
            if not isinstance(event, (Turning, Hold, Holding, Move)):
                self.messages.append(words(event))

    def _take(self, event: Event) -> None:
        if isinstance(event, Move):
            self.target, self.target_words, self.angle_deg = event.position, event.words, math.nan
        elif isinstance(event, Turning):
            self.angle_deg = event.target_angle_deg
            if self.refused is not None and event.time_s - self.refused.time_s > READ_S:
                self.refused = None
        elif isinstance(event, Hold):
            self.position, self.position_words, self.refused = event.position, event.words, None
            self.remaining_s = event.hold_s
        elif isinstance(event, Holding):
            self.remaining_s = event.remaining_s
        elif isinstance(event, Rejected):
            self.refused = event
        elif isinstance(event, (Accepted, Marked, Done)):
            self.refused = None
        elif isinstance(event, (LinkLost, LinkBack)):
            self.link = isinstance(event, LinkBack)


def draw(
    screen: Screen, snapshot: Snapshot, scheme: Scheme, lost_samples: int | None = None, *, silent: bool = False
) -> RenderableType:
    """Return the whole screen."""
    middle = Table.grid(padding=0, expand=False)
    middle.add_column(width=WIDTH - MAP_WIDTH)
    middle.add_column(width=MAP_WIDTH)
    left = Panel(_now(screen, snapshot), box=ROUNDED, title=_title(snapshot, scheme), title_align="left", height=14)
    right = Panel(_map(snapshot, scheme), box=ROUNDED, title="positions", title_align="left", height=14)
    middle.add_row(left, right)
    return Group(
        middle, _link_line(screen, snapshot, lost_samples, silent), _messages(screen), Text(KEYS, style="dim", no_wrap=True)
    )


def _title(snapshot: Snapshot, scheme: Scheme) -> str:
    return f"{scheme.name}: {len(snapshot.accepted)} of {snapshot.planned} done"


def headline(screen: Screen, snapshot: Snapshot) -> tuple[str, str, str]:
    """Return the big words, the words below them, and the style: what to do now."""
    target = f"{screen.target}: {screen.target_words}"
    if snapshot.state is State.LEARNING:
        return "LEAVE IT STILL", "measuring the noise floor; hands off for some seconds", "bold yellow"
    if screen.refused is not None and snapshot.state in (State.RESTING, State.TURNING):
        return "NOT TAKEN", f"{screen.refused.words}; {screen.refused.remedy}", "bold red"
    if snapshot.state is State.HOLDING:
        return "HOLD STILL", f"{screen.position}: {screen.position_words}", "bold yellow"
    if snapshot.state is State.RESTING:
        return "GOOD - TURN", target, "bold green"
    fixed = {
        State.PAUSED: ("PAUSED", "press p to go on", "bold"),
        State.LOST: ("NO LINK", "plug it in again; nothing measured is lost", "bold red"),
        State.DONE: ("DONE", "all that was asked for is measured", "bold green"),
    }
    return fixed.get(snapshot.state, ("TURN", target, "bold cyan"))


def _now(screen: Screen, snapshot: Snapshot) -> RenderableType:
    """Return the left panel: what to do, and three bars."""
    big, small, style = headline(screen, snapshot)
    table = Table.grid(padding=(0, 1))
    table.add_column(width=9, no_wrap=True)
    table.add_column(width=BAR_WIDTH, no_wrap=True)
    table.add_column(no_wrap=True)
    turning = snapshot.state is State.TURNING and math.isfinite(screen.angle_deg)
    holding = snapshot.state is State.HOLDING
    angle = f"{screen.angle_deg:.0f} deg" if turning else ""
    left = f"{screen.remaining_s:.0f} s left" if holding and math.isfinite(screen.remaining_s) else ""
    table.add_row("to target", bar(1 - screen.angle_deg / 180 if turning else 0.0, "cyan"), angle)
    table.add_row("hold", bar(snapshot.fraction if holding else 0.0, "green"), left)
    table.add_row("stillness", _stillness_bar(snapshot), _stillness_words(snapshot))
    what = Text(small, overflow="fold")
    what.truncate(4 * (WIDTH - MAP_WIDTH - 4), overflow="ellipsis")
    return Group(Text(), Text("  ".join((" ".join(big), "")), style=style), Text(), what, Text(), table, _cause(snapshot))


def bar(fraction: float, style: str) -> Text:
    """Return a bar that reads without colour."""
    full = round(min(max(fraction, 0.0), 1.0) * BAR_WIDTH)
    return Text("#" * full, style=style).append("." * (BAR_WIDTH - full), style="dim")


def _stillness_bar(snapshot: Snapshot) -> Text:
    """Return activity against the limit, which stands in the middle of the bar."""
    ratio = 0.0 if snapshot.activity is None else snapshot.activity.ratio
    shown = bar(ratio / 2, "green" if ratio <= 1 else "red")
    middle = BAR_WIDTH // 2
    return Text.assemble(shown[:middle], "|", shown[middle + 1 :])


def _stillness_words(snapshot: Snapshot) -> str:
    if snapshot.activity is None:
        return ""
    return "still" if snapshot.activity.ratio <= 1 else "moving"


def _cause(snapshot: Snapshot) -> Text:
    """Return the largest activity in physical units against its limit, two lines under the bar."""
    activity = snapshot.activity
    if activity is None:
        return Text()
    measured, limit = quantity(activity.measured, activity.unit), quantity(activity.limit, activity.unit)
    return Text(f"{'':10}{measured}, limit {limit}\n{'':10}{activity.triad} {activity.axis}, {activity.kind}", no_wrap=True)


_SIGNS = {
    "done": ("x", "green"),
    "here": ("@", "bold yellow"),
    "next": (">", "bold cyan"),
    "skipped": ("-", "dim"),
    "open": (" ", ""),
}


def _map(snapshot: Snapshot, scheme: Scheme) -> RenderableType:
    """Return the positions in groups as they are named, not in the order asked for."""
    names = sorted((position.name for position in scheme.positions), key=_natural)
    width = max(len(name) for name in names) + 4
    columns = max(1, (MAP_WIDTH - 3) // width)
    rows = min(math.ceil(len(names) / columns), MAP_ROWS)
    table = Table.grid(padding=0)
    for row in range(rows):
        table.add_row(*(_cell(names[i], snapshot, width) for i in range(row, len(names), rows)[:columns]))
    legend = Text("[x] done [>] next [@] here", style="dim", no_wrap=True)
    return Group(table, legend) if rows < MAP_ROWS else table


def _natural(name: str) -> tuple[int, str, int]:
    """Sort key: x+45 before x+135, faces before corners, +x (2) after +x."""
    turn = re.fullmatch(r"([xyz])\+(\d+)", name)
    return (0, turn[1], int(turn[2])) if turn else (len(name.split(maxsplit=1)[0]), name, 0)


def _cell(name: str, snapshot: Snapshot, width: int) -> Text:
    kind = "open"
    if name in snapshot.accepted:
        kind = "done"
    if name in snapshot.skipped:
        kind = "skipped"
    if name == snapshot.target:
        kind = "next"
    if name == snapshot.position:
        kind = "here"
    sign, style = _SIGNS[kind]
    return Text(f"[{sign}]{name}".ljust(width), style=style, no_wrap=True)


def _link_line(screen: Screen, snapshot: Snapshot, lost_samples: int | None, silent: bool) -> Text:
    rate = f"{snapshot.rate_hz:.0f} Hz" if math.isfinite(snapshot.rate_hz) else "- Hz"
    lost = f"{lost_samples} samples lost" if lost_samples is not None else f"{snapshot.lost_cells} gaps"
    warmth = f"{snapshot.temperature_degc:.1f} degC" if math.isfinite(snapshot.temperature_degc) else "no temperature"
    bad = silent or not screen.link
    link = "link ok" if not bad else "NOTHING ARRIVES: check power and cable" if screen.link else "LINK LOST"
    return Text(f" {link}   {rate}   {lost}   {warmth}", style="bold red" if bad else "", no_wrap=True)


def _messages(screen: Screen) -> Panel:
    lines = [Text(message, no_wrap=True, overflow="ellipsis") for message in screen.messages]
    return Panel(Group(*lines, *[Text()] * (MESSAGES - len(lines))), box=ROUNDED, height=MESSAGES + 2)
