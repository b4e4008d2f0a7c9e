"""The screen of the live view, drawn from events and a snapshot; 80 columns by 24 lines, readable without colour.

Colour only repeats what signs and words say already. Nothing here decides anything.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from rich.box import ROUNDED
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from imufield.drawing.box import turn_shortest
from imufield.earth import MILLI_G_M_S2
from imufield.guide import events
from imufield.guide.events import Event, RefusalCode
from imufield.guide.lead.guide import Snapshot
from imufield.guide.lead.state_table import State
from imufield.guide.positions import Scheme, nearest_cube_direction
from imufield.guide.refusals import quantities
from imufield.guide.view.pictures import big_lines, draw_box
from imufield.guide.view.plain import NOT_TOLD, known_words, words
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

WIDTH = 80
HEIGHT = 24
_MAP_WIDTH = 34  # Three columns of the longest names.
_LEFT_WIDTH = WIDTH - _MAP_WIDTH
_PANEL_HEIGHT = 18  # Of 24 lines: link, four messages and keys stand below.
_PICTURE_WIDTH = 20
_PICTURE_HEIGHT = 8
_BAR_WIDTH = 16
_BAR_ROWS = 4
_DETAIL_ROWS = 3
_MAP_ROWS = 12
_MESSAGES = 4
_BIG_MESSAGES = 2  # Below the big letters.
_KEPT = 20  # Messages that a large window shows.
_READ_S = 4.0  # A refusal stays on the screen for this long although the unit moves on.
# A refusal that is nobody's mistake: words, style, and the word in big letters.
_REFUSED = {
    RefusalCode.ALREADY_DONE: ("DONE BEFORE", "bold green", "TURN"),
    RefusalCode.OTHER_SIDE: ("OTHER SIDE", "bold yellow", "TURN"),
    RefusalCode.START_UP: ("WAIT", "bold yellow", "WAIT"),
    RefusalCode.WARMING_UP: ("WAIT", "bold yellow", "WAIT"),
}
# Messages of these no longer hold once a hold begins.
_WAITS = (RefusalCode.START_UP, RefusalCode.WARMING_UP, RefusalCode.NOT_QUIET)
# Events that the rest of the screen shows.
_NO_MESSAGE = (events.Turning, events.Hold, events.Holding, events.Move, events.Turn)
# Events after which a refusal is over.
_ANSWERS = (events.Hold, events.Accepted, events.Marked, events.Done, events.Turn, events.Turned)

_KEYS = "r retake  s skip  u undo  p pause  f finish  ? keys  q quit (resume later)"
_NARROW_KEYS = "r retake s skip u undo p pause f finish q quit ? keys"


@dataclass(frozen=True, slots=True)
class LinkState:
    """State of the link, which the events do not tell."""

    lost_samples: int | None = None
    silent: bool = False
    """The port is there, but nothing arrives."""
    cable: str | None = None
    """Face of the unit where the cable leaves, "-x"; None where it is not known."""


@dataclass(slots=True, kw_only=True)
class Screen:
    """State of the screen by the events so far.

    Attributes
    ----------
    move, hold, turn, refused
        The latest event of each kind; ``refused`` as long as it is to be read.
    angle_deg, remaining_s : float
        To the target, and of the hold.
    link_paused : bool
        A cable was pulled, or the session is resumed: nobody knows how many samples that cost.
    attitude : ndarray, shape (3, 3)
        Of the box as it is drawn; its heading is kept from frame to frame.
    """

    move: events.Move | None = None
    hold: events.Hold | None = None
    turn: events.Turn | None = None
    refused: events.Rejected | None = None
    angle_deg: float = math.nan
    remaining_s: float = math.nan
    link: bool = True
    link_paused: bool = False
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _waits: set[str] = field(default_factory=set)

    def tell(self, text: str) -> None:
        """Add a message that is no event."""
        self.messages.append(text)

    def follow(self, events: list[Event]) -> None:
        """Update the screen with events in order."""
        for event in events:
            self._update(event)
            self._update_messages(event)

    def _update(self, event: Event) -> None:
        if isinstance(event, _ANSWERS):
            self.refused = None
        if isinstance(event, events.Move):
            self.move, self.angle_deg = event, math.nan
        elif isinstance(event, events.Turning):
            self.angle_deg = event.target_angle_deg
            if self.refused is not None and event.time_s - self.refused.time_s > _READ_S:
                self.refused = None
        elif isinstance(event, events.Hold):
            self.hold, self.remaining_s = event, event.hold_s
        elif isinstance(event, events.Holding):
            self.remaining_s = event.remaining_s
        elif isinstance(event, events.Rejected):
            self.refused = event
        elif isinstance(event, events.Turn):
            self.turn = event
        elif isinstance(event, (events.LinkLost, events.LinkBack)):
            self.link, self.link_paused = isinstance(event, events.LinkBack), True

    def _update_messages(self, event: Event) -> None:
        if not isinstance(event, _NO_MESSAGE):
            self.messages.append(_accepted(event) if isinstance(event, events.Accepted) else words(event))
        if isinstance(event, events.Rejected) and event.reason in _WAITS:
            self._waits.add(self.messages[-1])
        elif isinstance(event, (events.Hold, events.Accepted)) and self._waits:
            self.messages = deque((text for text in self.messages if text not in self._waits), self.messages.maxlen)
            self._waits.clear()


def _accepted(event: events.Accepted) -> str:
    """Return one short line; the panel of positions shows the rest."""
    off_m_s2 = event.leave_one_out_m_s2
    fits = "" if off_m_s2 is None else f", {sentence('screen.off_fit', off_mg=off_m_s2 / MILLI_G_M_S2)}"
    return sentence("screen.accepted_in_hand" if event.held else "screen.accepted", event=event, fits=fits)


class Instruction(NamedTuple):
    """What to do now: a headline, the words below it, and two words of six letters at most for big letters."""

    headline: str
    details: str
    style: str
    big: tuple[str, str]


# States with one instruction each, the details by their key.
_BY_STATE = {
    State.LEARNING: Instruction("LEAVE IT STILL", "screen.learning", "bold yellow", ("LEAVE", "IT")),
    State.PAUSED: Instruction("PAUSED", "screen.paused", "bold", ("PAUSED", "")),
    State.LOST: Instruction("NO LINK", "screen.lost", "bold red", ("NO", "LINK")),
    State.DONE: Instruction("DONE", "screen.done", "bold green", ("DONE", "")),
}


def instruct(screen: Screen, snapshot: Snapshot) -> Instruction:
    """Return what to do now."""
    state, refused, turn, hold = snapshot.state, screen.refused, screen.turn, screen.hold
    if (now := _BY_STATE.get(state)) is not None:
        return now._replace(details=sentence(now.details))
    target, side = (f"{screen.move.position}: {screen.move.words}", screen.move.position) if screen.move else (": ", "")
    if snapshot.target_direction is not None:
        side = nearest_cube_direction(np.array(snapshot.target_direction))
    if refused is not None and state in (State.RESTING, State.TURNING, State.ROLLING):
        headline, style, big = _REFUSED.get(refused.reason, ("NOT TAKEN", "bold red", "AGAIN"))
        return Instruction(headline, f"{refused.words}; {refused.remedy}", style, (big, side))
    if state is State.HOLDING:
        place = f"{hold.position}: {hold.words}" if hold else ": "
        left = f"{screen.remaining_s:.0f}" if math.isfinite(screen.remaining_s) else ""
        return Instruction("HOLD STILL", place + " (in the hand)" * snapshot.in_hand, "bold yellow", ("HOLD", left))
    if state is State.ROLLING and turn is not None:
        return Instruction("ROLL", turn.words, "bold cyan", ("ROLL", f"{'+' if turn.sense > 0 else '-'}{turn.axis}"))
    if state is State.RESTING:
        return Instruction("GOOD - TURN", target, "bold green", ("GOOD", side))
    return Instruction("TURN", target, "bold cyan", ("TURN", side))


def draw(
    screen: Screen,
    snapshot: Snapshot,
    scheme: Scheme,
    link: LinkState,
    *,
    ascii_only: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> RenderableType:
    """Return the whole screen; what the window (columns, lines) has beyond the least size is for messages."""
    now = instruct(screen, snapshot)
    details = textwrap.wrap(now.details, _LEFT_WIDTH - 4, max_lines=_DETAIL_ROWS, placeholder="...", break_on_hyphens=False)
    left = Group(
        Text(" ".join(now.headline), style=now.style, no_wrap=True),
        Text("\n".join([*details, *[""] * (_DETAIL_ROWS - len(details))]), no_wrap=True),
        _pictures(screen, snapshot, link.cable, ascii_only=ascii_only),
        _bars(screen, snapshot),
    )
    right = Group(_map(snapshot, scheme), _dim("screen.legend"), *_known(snapshot.forecast))
    middle = Table.grid(padding=0, expand=False)
    middle.add_column(width=_LEFT_WIDTH)
    middle.add_column(width=_MAP_WIDTH)
    middle.add_row(
        *(
            Panel(content, box=ROUNDED, title=title, title_align="left", height=_PANEL_HEIGHT)
            for content, title in ((left, f"{scheme.name}: {_done(snapshot)}"), (right, "positions"))
        )
    )
    messages = _messages(screen, _MESSAGES + size[1] - HEIGHT, size[0])
    return Group(middle, _link_line(screen, snapshot, link), *messages, _keys(size[0]))


def draw_big(screen: Screen, snapshot: Snapshot, link: LinkState) -> RenderableType:
    """Return the screen in letters to be read from three metres."""
    now = instruct(screen, snapshot)
    first, second = (big_lines(word, WIDTH) for word in now.big)
    text = f"{now.headline}: {now.details}"
    return Group(
        *(Text(line, style=now.style, no_wrap=True) for line in (*first, "", *second)),
        Text(),
        Text(text if len(text) <= WIDTH else f"{text[: WIDTH - 3]}...", no_wrap=True, overflow="crop"),
        Text.assemble(" still ", _stillness_bar(snapshot), "  hold ", bar(snapshot.fraction, "green"), f"  {_done(snapshot)}"),
        Text(),
        _link_line(screen, snapshot, link),
        *_messages(screen, _BIG_MESSAGES, WIDTH),
        _keys(WIDTH),
    )


def draw_small(
    screen: Screen, snapshot: Snapshot, link: LinkState, *, width: int, height: int, ascii_only: bool = False
) -> RenderableType:
    """Return what matters in a window too small for the map: what to do, pictures, bars, the link, the newest words, keys."""
    now = instruct(screen, snapshot)
    messages = [textwrap.wrap(message, width, break_on_hyphens=False) for message in reversed(screen.messages)]
    lines: list[RenderableType] = [
        Text(now.headline, style=now.style, no_wrap=True),
        *(Text(line, no_wrap=True) for line in textwrap.wrap(now.details, width, break_on_hyphens=False)),
        Text(_done(snapshot)),
        _link_line(screen, snapshot, link),
    ]
    # What to do and the newest words stand whole before there are bars, and these before there are pictures.
    room = height - len(lines) - 1
    needed = len(messages[0] if messages else [])
    if room >= _BAR_ROWS + needed:
        lines.append(_bars(screen, snapshot))
        room -= _BAR_ROWS
    if room >= _PICTURE_HEIGHT + needed and width >= 2 * _PICTURE_WIDTH + 2:
        lines.insert(-2, _pictures(screen, snapshot, link.cable, ascii_only=ascii_only))
        room -= _PICTURE_HEIGHT
    newest = _newest(messages, room)[: max(room, 0)]
    return Group(*lines, *(Text(line, no_wrap=True) for line in newest), _keys(width))


def _keys(width: int) -> Text:
    return Text(_KEYS if width >= len(_KEYS) else _NARROW_KEYS, style="dim", no_wrap=True, overflow="crop")


def _dim(key: str, **values: object) -> Text:
    return Text(sentence(key, **values), style="dim", no_wrap=True)


def _done(snapshot: Snapshot) -> str:
    return f"{len(snapshot.accepted)} of {snapshot.planned} done"


def _pictures(screen: Screen, snapshot: Snapshot, cable: str | None, *, ascii_only: bool) -> Text:
    """Return two boxes side by side: how the unit is held, and how it should be."""
    now: list[str] = [""] * _PICTURE_HEIGHT
    goal = list(now)
    if snapshot.direction is not None:
        screen.attitude = turn_shortest(screen.attitude, np.array(snapshot.direction))
        now = draw_box(screen.attitude, _PICTURE_WIDTH, _PICTURE_HEIGHT, cable=cable, ascii_only=ascii_only)
    if snapshot.target_direction is not None and snapshot.state is not State.HOLDING:
        wanted = turn_shortest(screen.attitude, np.array(snapshot.target_direction))
        goal = draw_box(wanted, _PICTURE_WIDTH, _PICTURE_HEIGHT, cable=cable, ascii_only=ascii_only)
    text = Text(no_wrap=True)
    shows_goal = any(goal)
    for row in range(_PICTURE_HEIGHT):
        between = "->" if shows_goal and row == _PICTURE_HEIGHT // 2 else "  "
        left, right = now[row].ljust(_PICTURE_WIDTH), goal[row].ljust(_PICTURE_WIDTH)
        if row == 0:
            # In the corner, where nothing is drawn there.
            left = left if left[:4].strip() else f"now {left[4:]}"
            right = right if right[:4].strip() else f"goal{right[4:]}"
        text.append(left).append(between, style="bold").append(right if shows_goal else "", style="cyan")
        text.append("\n" if row < _PICTURE_HEIGHT - 1 else "")
    return text


def _bars(screen: Screen, snapshot: Snapshot) -> RenderableType:
    """Return three bars, and what moves most against its limit, in words and physical units."""
    table = Table.grid(padding=(0, 1))
    table.add_column(width=9, no_wrap=True)
    table.add_column(width=_BAR_WIDTH, no_wrap=True)
    table.add_column(no_wrap=True)
    turning = snapshot.state is State.TURNING and math.isfinite(screen.angle_deg)
    holding = snapshot.state is State.HOLDING
    angle = f"{screen.angle_deg:.0f} deg" if turning else ""
    left = f"{screen.remaining_s:.0f} s left" if holding and math.isfinite(screen.remaining_s) else ""
    # At the target it stays full, and it is drawn with another sign than the hold's.
    there = 1 - screen.angle_deg / 180 if turning else float(holding)
    table.add_row("to target", bar(there, "cyan", sign="="), angle)
    table.add_row("hold", bar(snapshot.fraction if holding else 0.0, "green"), left)
    activity = snapshot.activity
    state = "" if activity is None else "still" if activity.ratio <= 1 else "moving"
    table.add_row("stillness", _stillness_bar(snapshot), state)
    if activity is None:
        return Group(table, Text())
    measured, limit = quantities(activity.measured, activity.limit, activity.unit)
    measured = measured.partition(" ")[0]
    sensor = "acc" if activity.triad == "accelerometer" else "gyro"
    cause = {"motion": activity.motion, "measured": measured, "limit": limit, "sensor": sensor, "axis": activity.axis}
    return Group(table, _dim("screen.cause", **cause))


def bar(fraction: float, style: str, sign: str = "#") -> Text:
    """Return a bar that reads without colour."""
    full = round(min(max(fraction, 0.0), 1.0) * _BAR_WIDTH)
    return Text(sign * full, style=style).append("." * (_BAR_WIDTH - full), style="dim")


def _stillness_bar(snapshot: Snapshot) -> Text:
    """Return activity against the limit, which stands in the middle of the bar."""
    ratio = 0.0 if snapshot.activity is None else snapshot.activity.ratio
    shown = bar(ratio / 2, "green" if ratio <= 1 else "red")
    middle = _BAR_WIDTH // 2
    return Text.assemble(shown[:middle], "|", shown[middle + 1 :])


def _known(forecast: dict[str, float] | None) -> list[Text]:
    """Return how well the parameters are known, in two lines as wide as the map."""
    if forecast is None:
        return [_dim("screen.not_known")]
    bias, scale, angles = (known_words(forecast, name) for name in ("bias_ug", "scale_ppm", "misalignment_urad"))
    # Thirty columns do not hold the words twice.
    both = f"bias {bias}, scale {scale}".replace(NOT_TOLD, "unknown")
    both = f"bias, scale {NOT_TOLD}" if bias == scale == NOT_TOLD else both
    sigma = "" if angles == NOT_TOLD else " (1 sigma)"
    return [Text(both, no_wrap=True), Text(f"angles {angles}{sigma}", no_wrap=True)]


def _map(snapshot: Snapshot, scheme: Scheme) -> RenderableType:
    """Return the positions in groups by their names, not in the order asked for."""
    names = sorted((position.name for position in scheme.positions), key=_natural)
    width = max(len(name) for name in names) + 4
    columns = max(1, (_MAP_WIDTH - 3) // width)
    rows = min(math.ceil(len(names) / columns), _MAP_ROWS)
    # The first that applies.
    signs = (
        ("@", "bold yellow", (snapshot.position,)),
        (">", "bold cyan", (snapshot.target,)),
        ("-", "dim", snapshot.skipped),
        ("?", "bold red", snapshot.suspects),
        ("x", "green", snapshot.accepted),
        (" ", "", names),
    )
    table = Table.grid(padding=0)
    for row in range(rows):
        cells = []
        for name in names[row::rows][:columns]:
            sign, style = next((sign, style) for sign, style, those in signs if name in those)
            cells.append(Text(f"[{sign}]{name}".ljust(width), style=style, no_wrap=True))
        table.add_row(*cells)
    return table


def _natural(name: str) -> tuple[int, str, int]:
    """Sort key: x+45 before x+135, faces before corners, +x (2) after +x."""
    turn = re.fullmatch(r"([xyz])\+(\d+)", name)
    return (0, turn[1], int(turn[2])) if turn else (len(name.split(maxsplit=1)[0]), name, 0)


def _link_line(screen: Screen, snapshot: Snapshot, state: LinkState) -> Text:
    arrives = screen.link and not state.silent
    rate = f"{snapshot.rate_hz:.0f} Hz" if arrives and math.isfinite(snapshot.rate_hz) else "- Hz"
    lost = f"{state.lost_samples} samples lost" if state.lost_samples is not None else f"{snapshot.lost_cells} gaps"
    if screen.link_paused and not state.silent:
        lost += ", pauses not counted"
    warmth = f"{snapshot.temperature_degc:.1f} degC" if math.isfinite(snapshot.temperature_degc) else "no temperature"
    link = "link ok" if arrives else sentence("screen.nothing_arrives") if screen.link else "LINK LOST"
    return Text(f" {link}   {rate}   {lost}   {warmth}", style="bold" if arrives else "bold red", no_wrap=True)


def _messages(screen: Screen, count: int, width: int) -> list[Text]:
    """Return the newest messages in a number of lines, the newest last and in full; older ones as far as there is room."""
    folded = [
        textwrap.wrap(message, width, initial_indent=" ", subsequent_indent="   ", break_on_hyphens=False)[:count]
        for message in reversed(screen.messages)
    ]
    lines = _newest(folded, count)
    return [Text(line, no_wrap=True, overflow="crop") for line in (*lines, *[""] * (count - len(lines)))]


def _newest(messages: list[list[str]], room: int) -> list[str]:
    """Return the lines of the newest messages, which come first, in their order; the newest in any case."""
    lines: list[str] = []
    for rows in messages:
        if lines and len(lines) + len(rows) > room:
            break
        lines = [*rows, *lines]
    return lines
