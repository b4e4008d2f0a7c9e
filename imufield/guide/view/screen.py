"""What the terminal shows, drawn from events and a snapshot; 80 columns by 24 lines, readable without colour.

Colour only repeats what signs and words say already. Nothing here decides anything.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from rich.box import ROUNDED
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from imufield.earth import MILLI_G_M_S2
from imufield.guide.events import (
    Accepted,
    Done,
    Event,
    Hold,
    Holding,
    LinkBack,
    LinkLost,
    Marked,
    Move,
    RefusalCode,
    Rejected,
    Turn,
    Turned,
    Turning,
)
from imufield.guide.lead.guide import Snapshot
from imufield.guide.lead.state_table import State
from imufield.guide.positions import Scheme, nearest_cube_direction
from imufield.guide.refusals import quantity
from imufield.guide.stillness.limits import Activity
from imufield.guide.view.pictures import big_lines, draw_box, turn_shortest
from imufield.guide.view.plain import NOT_TOLD, known_words, words
from imufield.samples import FloatArray

WIDTH = 80
HEIGHT = 24
MAP_WIDTH = 34
LEFT_WIDTH = WIDTH - MAP_WIDTH
PANEL_HEIGHT = 18
PICTURE_WIDTH = 20
PICTURE_HEIGHT = 8
BAR_WIDTH = 16
MAP_ROWS = 12
MESSAGES = 4
_BAR_ROWS = 4
_KEPT = 20  # Messages that a large window shows.
READ_S = 4.0
"""A refusal stays on the screen for this long although the unit moves on."""
# Words and style for a refusal that is nobody's mistake.
_REFUSED = {
    RefusalCode.ALREADY_DONE: ("DONE BEFORE", "bold green"),
    RefusalCode.OTHER_SIDE: ("OTHER SIDE", "bold yellow"),
    RefusalCode.START_UP: ("WAIT", "bold yellow"),
    RefusalCode.WARMING_UP: ("WAIT", "bold yellow"),
}
_WAITS = (RefusalCode.START_UP, RefusalCode.WARMING_UP, RefusalCode.NOT_QUIET)
_REFUSED_BIG = {
    RefusalCode.ALREADY_DONE: "TURN",
    RefusalCode.OTHER_SIDE: "TURN",
    RefusalCode.START_UP: "WAIT",
    RefusalCode.WARMING_UP: "WAIT",
}
KEYS = "r retake  s skip  u undo  p pause  f finish  b big  q quit (resume later)"


@dataclass(frozen=True, slots=True)
class LinkState:
    """What the view is told about the link."""

    lost_samples: int | None = None
    silent: bool = False
    """The port is there, but nothing arrives."""
    cable: str | None = None
    """Face of the unit where the cable leaves, "-x"; None where nobody said."""


@dataclass(slots=True, kw_only=True)
class Screen:
    """What the events have said so far, as far as it is shown."""

    target: str = ""
    target_words: str = ""
    position: str = ""
    position_words: str = ""
    angle_deg: float = math.nan
    remaining_s: float = math.nan
    turn: Turn | None = None
    refused: Rejected | None = None
    link: bool = True
    link_paused: bool = False
    """A cable was pulled, or the session is resumed: nobody knows how many samples that cost."""
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    """Of the box as it is drawn; its heading is kept from frame to frame."""
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _waits: set[str] = field(default_factory=set)  # Messages that no longer hold once a hold begins.

    def follow(self, events: list[Event]) -> None:
        """Take the events in order."""
        for event in events:
            self._take(event)
            if not isinstance(event, (Turning, Hold, Holding, Move, Turn)):
                self.messages.append(_message(event))
            if isinstance(event, Rejected) and event.reason in _WAITS:
                self._waits.add(self.messages[-1])
            elif isinstance(event, (Hold, Accepted)) and self._waits:
                # What was waited for is over.
                self.messages = deque((one for one in self.messages if one not in self._waits), self.messages.maxlen)
                self._waits.clear()

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
        elif isinstance(event, (Turn, Turned)):
            self.turn, self.refused = event if isinstance(event, Turn) else self.turn, None
        elif isinstance(event, (LinkLost, LinkBack)):
            self.link = isinstance(event, LinkBack)
            self.link_paused = True


def _message(event: Event) -> str:
    """Return an event in one short line."""
    if not isinstance(event, Accepted):
        return words(event)
    off_m_s2 = event.leave_one_out_m_s2
    fits = "" if off_m_s2 is None else f", {off_m_s2 / MILLI_G_M_S2:+.2f} mg off the others' fit"
    held = ", in the hand" if event.held else ""
    return f"accepted {event.position}{held}: {event.duration_s:.1f} s{fits}"


def draw(
    screen: Screen,
    snapshot: Snapshot,
    scheme: Scheme,
    link: LinkState | None = None,
    *,
    ascii_only: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> RenderableType:
    """Return the whole screen; what the window (columns, lines) has beyond the least size is for messages."""
    width, rows = size[0], MESSAGES + size[1] - HEIGHT
    link = link or LinkState()
    middle = Table.grid(padding=0, expand=False)
    middle.add_column(width=LEFT_WIDTH)
    middle.add_column(width=MAP_WIDTH)
    now = _now(screen, snapshot, link.cable, ascii_only=ascii_only)
    left = Panel(now, box=ROUNDED, title=_title(snapshot, scheme), title_align="left", height=PANEL_HEIGHT)
    right = Panel(_right(snapshot, scheme), box=ROUNDED, title="positions", title_align="left", height=PANEL_HEIGHT)
    middle.add_row(left, right)
    return Group(
        middle, _link_line(screen, snapshot, link), *_messages(screen, rows, width), Text(KEYS, style="dim", no_wrap=True)
    )


def draw_big(screen: Screen, snapshot: Snapshot, link: LinkState | None = None) -> RenderableType:
    """Return the screen in letters to be read from three metres."""
    big, small, style = headline(screen, snapshot)
    first, second = big_words(screen, snapshot)
    lines = [Text(line, style=style, no_wrap=True) for line in (*big_lines(first, WIDTH), "", *big_lines(second, WIDTH))]
    said = _line(f"{big}: {small}")
    done = f"{len(snapshot.accepted)} of {snapshot.planned} done"
    bars = Text.assemble(" still ", _stillness_bar(snapshot), "  hold ", bar(snapshot.fraction, "green"), f"  {done}")
    return Group(
        *lines,
        Text(),
        said,
        bars,
        Text(),
        _link_line(screen, snapshot, link or LinkState()),
        *_messages(screen, 2),
        Text(KEYS, style="dim"),
    )


def draw_small(screen: Screen, snapshot: Snapshot, link: LinkState | None = None, *, width: int, height: int) -> RenderableType:
    """Return what matters in a window too small for pictures and map: what to do, three bars, the link, the newest words."""
    big, small, style = headline(screen, snapshot)
    said = [textwrap.wrap(message, width, break_on_hyphens=False) for message in reversed(screen.messages)]
    lines: list[RenderableType] = [
        Text(big, style=style, no_wrap=True),
        *(Text(line, no_wrap=True) for line in textwrap.wrap(small, width, break_on_hyphens=False)),
        Text(f"{len(snapshot.accepted)} of {snapshot.planned} done"),
        _link_line(screen, snapshot, link or LinkState()),
    ]
    # What to do and the newest words stand whole before there are bars, which have four rows; the last row tells the size.
    room = height - len(lines) - 1
    if room >= _BAR_ROWS + len(said[0] if said else []):
        lines.append(_bars(screen, snapshot))
        room -= _BAR_ROWS
    newest: list[str] = []
    for rows in said:
        if newest and len(newest) + len(rows) > room:
            break
        newest = [*rows, *newest]
    size = f"window {width} x {height}: pictures need {WIDTH} x {HEIGHT}"
    return Group(*lines, *(Text(line, no_wrap=True) for line in newest[: max(room, 0)]), Text(size, style="dim", no_wrap=True))


def big_words(screen: Screen, snapshot: Snapshot) -> tuple[str, str]:
    """Return two words of six letters at most: what to do, and the side or the seconds left."""
    side = screen.target
    if snapshot.target_direction is not None:
        side = nearest_cube_direction(np.array(snapshot.target_direction))
    if snapshot.state is State.LEARNING:
        return "LEAVE", "IT"
    if snapshot.state is State.HOLDING:
        return "HOLD", f"{screen.remaining_s:.0f}" if math.isfinite(screen.remaining_s) else ""
    if screen.refused is not None and snapshot.state in (State.RESTING, State.TURNING, State.ROLLING):
        return _REFUSED_BIG.get(screen.refused.reason, "AGAIN"), side
    if snapshot.state is State.ROLLING and screen.turn is not None:
        return "ROLL", f"{'+' if screen.turn.sense > 0 else '-'}{screen.turn.axis}"
    fixed = {State.PAUSED: ("PAUSED", ""), State.LOST: ("NO", "LINK"), State.DONE: ("DONE", "")}
    return fixed.get(snapshot.state, ("GOOD" if snapshot.state is State.RESTING else "TURN", side))


def _title(snapshot: Snapshot, scheme: Scheme) -> str:
    return f"{scheme.name}: {len(snapshot.accepted)} of {snapshot.planned} done"


def headline(screen: Screen, snapshot: Snapshot) -> tuple[str, str, str]:
    """Return the big words, the words below them, and the style: what to do now."""
    target = f"{screen.target}: {screen.target_words}"
    if snapshot.state is State.LEARNING:
        return "LEAVE IT STILL", "measuring the noise floor; hands off for some seconds", "bold yellow"
    if screen.refused is not None and snapshot.state in (State.RESTING, State.TURNING, State.ROLLING):
        big, style = _REFUSED.get(screen.refused.reason, ("NOT TAKEN", "bold red"))
        return big, f"{screen.refused.words}; {screen.refused.remedy}", style
    if snapshot.state is State.HOLDING:
        where = " (in the hand)" if snapshot.in_hand else ""
        return "HOLD STILL", f"{screen.position}: {screen.position_words}{where}", "bold yellow"
    if snapshot.state is State.RESTING:
        return "GOOD - TURN", target, "bold green"
    if snapshot.state is State.ROLLING and screen.turn is not None:
        return "ROLL", screen.turn.words, "bold cyan"
    fixed = {
        State.PAUSED: ("PAUSED", "press p to go on", "bold"),
        State.LOST: ("NO LINK", "plug it in again; nothing measured is lost", "bold red"),
        State.DONE: ("DONE", "all that was asked for is measured", "bold green"),
    }
    return fixed.get(snapshot.state, ("TURN", target, "bold cyan"))


def _now(screen: Screen, snapshot: Snapshot, cable: str | None, *, ascii_only: bool) -> RenderableType:
    """Return the left panel: what to do, how it is held and should be, and three bars."""
    big, small, style = headline(screen, snapshot)
    what = Text("\n".join(_wrap(small, LEFT_WIDTH - 4, 3)), no_wrap=True)
    return Group(
        Text(" ".join(big), style=style, no_wrap=True),
        what,
        _pictures(screen, snapshot, cable, ascii_only=ascii_only),
        _bars(screen, snapshot),
    )


def _wrap(text: str, width: int, rows: int) -> list[str]:
    """Return exactly so many rows of whole words; what does not fit ends in an ellipsis."""
    lines, rest = [""], text.split()
    for word in rest:
        if len(lines[-1]) + len(word) + 1 <= width or not lines[-1]:
            lines[-1] = f"{lines[-1]} {word}".strip()
        else:
            lines.append(word)
    if len(lines) > rows:
        lines = [*lines[: rows - 1], f"{lines[rows - 1][: width - 3]}..."]
    return [line[:width] for line in (*lines, *[""] * (rows - len(lines)))]


def _pictures(screen: Screen, snapshot: Snapshot, cable: str | None, *, ascii_only: bool) -> Text:
    """Return two boxes side by side: how the unit is held, and how it should be."""
    now: list[str] = [""] * PICTURE_HEIGHT
    goal = list(now)
    if snapshot.direction is not None:
        screen.attitude = turn_shortest(screen.attitude, np.array(snapshot.direction))
        now = draw_box(screen.attitude, PICTURE_WIDTH, PICTURE_HEIGHT, cable=cable, ascii_only=ascii_only)
    if snapshot.target_direction is not None and snapshot.state is not State.HOLDING:
        wanted = turn_shortest(screen.attitude, np.array(snapshot.target_direction))
        goal = draw_box(wanted, PICTURE_WIDTH, PICTURE_HEIGHT, cable=cable, ascii_only=ascii_only)
    text = Text(no_wrap=True)
    shows_goal = any(goal)
    for row in range(PICTURE_HEIGHT):
        between = "->" if shows_goal and row == PICTURE_HEIGHT // 2 else "  "
        head = ("now ", "goal") if row == 0 else ("", "")
        left, right = (_under(head[k], one[row]) for k, one in enumerate((now, goal)))
        text.append(left).append(between, style="bold").append(right if shows_goal else "", style="cyan")
        text.append("\n" if row < PICTURE_HEIGHT - 1 else "")
    return text


def _under(head: str, line: str) -> str:
    """Return a row of a picture with a word in its left corner where nothing is drawn."""
    line = line.ljust(PICTURE_WIDTH)
    return head + line[len(head) :] if head and not line[: len(head)].strip() else line


def _bars(screen: Screen, snapshot: Snapshot) -> RenderableType:
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
    return Group(table, _cause(snapshot))


def bar(fraction: float, style: str) -> Text:
    """Return a bar that reads without colour."""
    full = round(min(max(fraction, 0.0), 1.0) * BAR_WIDTH)
    return Text("#" * full, style=style).append("." * (BAR_WIDTH - full), style="dim")


def _activity(snapshot: Snapshot) -> Activity | None:
    """Return what moves now; without a link nobody knows."""
    return None if snapshot.state is State.LOST else snapshot.activity


def _stillness_bar(snapshot: Snapshot) -> Text:
    """Return activity against the limit, which stands in the middle of the bar."""
    activity = _activity(snapshot)
    ratio = 0.0 if activity is None else activity.ratio
    shown = bar(ratio / 2, "green" if ratio <= 1 else "red")
    middle = BAR_WIDTH // 2
    return Text.assemble(shown[:middle], "|", shown[middle + 1 :])


def _stillness_words(snapshot: Snapshot) -> str:
    activity = _activity(snapshot)
    if activity is None:
        return ""
    return "still" if activity.ratio <= 1 else "moving"


def _cause(snapshot: Snapshot) -> Text:
    """Return what moves most, in words and physical units, against its limit."""
    activity = _activity(snapshot)
    if activity is None:
        return Text()
    measured, limit = quantity(activity.measured, activity.unit), quantity(activity.limit, activity.unit)
    if measured.split()[1:] == limit.split()[1:]:
        measured = measured.split()[0]
    sensor = "acc" if activity.triad == "accelerometer" else "gyro"
    words = f"{activity.verb} {measured}, {limit} allowed ({sensor} {activity.axis})"
    return Text(words, no_wrap=True, style="dim")


_SIGNS = {
    "done": ("x", "green"),
    "here": ("@", "bold yellow"),
    "next": (">", "bold cyan"),
    "skipped": ("-", "dim"),
    "doubtful": ("?", "bold red"),
    "open": (" ", ""),
}


def _right(snapshot: Snapshot, scheme: Scheme) -> RenderableType:
    """Return the right panel: the map, its legend, and how well the parameters are known."""
    lines = [Text("x done > next @ here ? doubt", style="dim", no_wrap=True), *_known(snapshot.forecast)]
    return Group(_map(snapshot, scheme), *lines)


def _known(forecast: dict[str, float] | None) -> list[Text]:
    """Return how well the parameters are known, in two lines as wide as the map."""
    if forecast is None:
        return [Text("known from the 4th position on", style="dim", no_wrap=True)]
    bias, scale, angles = (known_words(forecast, name) for name in ("bias_ug", "scale_ppm", "misalignment_urad"))
    # Thirty columns do not hold the words twice.
    both = f"bias {bias}, scale {scale}".replace(NOT_TOLD, "unknown")
    both = f"bias, scale {NOT_TOLD}" if bias == scale == NOT_TOLD else both
    sigma = "" if angles == NOT_TOLD else " (1 sigma)"
    return [Text(both, no_wrap=True), Text(f"angles {angles}{sigma}", no_wrap=True)]


def _map(snapshot: Snapshot, scheme: Scheme) -> RenderableType:
    """Return the positions in groups as they are named, not in the order asked for."""
    names = sorted((position.name for position in scheme.positions), key=_natural)
    width = max(len(name) for name in names) + 4
    columns = max(1, (MAP_WIDTH - 3) // width)
    rows = min(math.ceil(len(names) / columns), MAP_ROWS)
    table = Table.grid(padding=0)
    for row in range(rows):
        table.add_row(*(_cell(names[i], snapshot, width) for i in range(row, len(names), rows)[:columns]))
    return table


def _natural(name: str) -> tuple[int, str, int]:
    """Sort key: x+45 before x+135, faces before corners, +x (2) after +x."""
    turn = re.fullmatch(r"([xyz])\+(\d+)", name)
    return (0, turn[1], int(turn[2])) if turn else (len(name.split(maxsplit=1)[0]), name, 0)


def _cell(name: str, snapshot: Snapshot, width: int) -> Text:
    kind = "open"
    if name in snapshot.accepted:
        kind = "done"
    if name in snapshot.suspects:
        kind = "doubtful"
    if name in snapshot.skipped:
        kind = "skipped"
    if name == snapshot.target:
        kind = "next"
    if name == snapshot.position:
        kind = "here"
    sign, style = _SIGNS[kind]
    return Text(f"[{sign}]{name}".ljust(width), style=style, no_wrap=True)


def _link_line(screen: Screen, snapshot: Snapshot, state: LinkState) -> Text:
    arrives = screen.link and not state.silent
    rate = f"{snapshot.rate_hz:.0f} Hz" if arrives and math.isfinite(snapshot.rate_hz) else "- Hz"
    lost = f"{state.lost_samples} samples lost" if state.lost_samples is not None else f"{snapshot.lost_cells} gaps"
    if screen.link_paused and not state.silent:
        lost += ", pauses not counted"
    warmth = f"{snapshot.temperature_degc:.1f} degC" if math.isfinite(snapshot.temperature_degc) else "no temperature"
    link = "link ok" if arrives else "NOTHING ARRIVES: check power and cable" if screen.link else "LINK LOST"
    return Text(f" {link}   {rate}   {lost}   {warmth}", style="bold" if arrives else "bold red", no_wrap=True)


def _line(text: str, width: int = WIDTH) -> Text:
    """Return one line of the screen; dots say that it goes on."""
    return Text(text if len(text) <= width else f"{text[: width - 3]}...", no_wrap=True, overflow="crop")


def _messages(screen: Screen, count: int, width: int = WIDTH) -> list[Text]:
    """Return the newest messages in so many lines, the newest last and in full; older ones as far as there is room."""
    lines: list[str] = []
    for message in reversed(screen.messages):
        rows = _folded(message, width)
        if lines and len(rows) + len(lines) > count:
            break
        lines = [*rows[:count], *lines]
    return [_line(line, width) for line in (*lines, *[""] * (count - len(lines)))]


def _folded(message: str, width: int) -> list[str]:
    """Return a message in lines that the screen holds, those behind the first set in."""
    return textwrap.wrap(message, width, initial_indent=" ", subsequent_indent="   ", break_on_hyphens=False)
