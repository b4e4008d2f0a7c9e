"""The screen of the live view, drawn from events and a snapshot, readable without colour.

80 columns by 24 lines show instruction, pictures, bars, map and the newest messages; a larger window has larger pictures, the
log beside them, and the traces of the six signals. Colour only repeats what signs and words say already. Nothing here decides
anything.
"""

from __future__ import annotations

import math
import re
import textwrap

import numpy as np
from rich.box import ROUNDED
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.style import Style
from rich.table import Table
from rich.text import Text

from imufield.dataclass import dataclass
from imufield.drawing.box import turn_shortest
from imufield.guide.lead.guide import Snapshot
from imufield.guide.lead.state_table import State
from imufield.guide.positions import Scheme
from imufield.guide.view.instruction import Screen, instruct, stillness_words
from imufield.guide.view.pictures import ROWS, big_lines, draw_box
from imufield.guide.view.plain import KNOWN_UNITS, NOT_TOLD, known_words
from imufield.guide.view.traces import draw_signals, signals_title
from imufield.sentences import Sentences

sentence = Sentences(__package__)

WIDTH = 80
HEIGHT = 24
_MAP_WIDTH = 34  # Three columns of the longest names.
_PANEL_HEIGHT = 18  # Of 24 lines: link, four messages and keys stand below.
_WIDE = 100  # Columns from which the log stands beside the pictures.
_LOG_SHARE = 0.4  # Of a wide window.
_LOG_WIDTH = 84  # At most: longer lines are not read better.
_TRACES_FROM = (34, 38)  # Lines from which the signals are drawn, in a wide window and in a narrow one.
_LINES_FOR_TRACE_ROW = 20  # Of a window, for each row of a trace.
_PICTURE_SIZE = (20, 8)  # Of the least picture.
_BAR_WIDTH = 16
_BAR_ROWS = 4
_BESIDE_BAR = 26  # Columns of its name and of what stands behind it.
_BESIDE_BIG_BARS = 30  # The same of both bars below big letters.
_DETAIL_ROWS = 3
_MAP_ROWS = 12
_BIG_WIDTH = 40  # Columns of six letters and a little more.
_FRAME = 2 * ROWS + 4  # Lines of big letters with what always stands with them: a blank, what to do, the bars, the keys.


_KEYS = "r retake  s skip  u undo  p pause  f finish  ? keys  q quit (resume later)"
_NARROW_KEYS = "? keys q quit r retake s skip u undo p pause f finish"  # What is cut off on the right, ? shows.


@dataclass(frozen=True, slots=True)
class LinkState:
    """State of the link, which the events do not tell."""

    lost_samples: int | None = None
    silent: bool = False
    """The port is there, but nothing arrives."""
    cable: str | None = None
    """Face of the unit where the cable leaves, "-x"; None where it is not known."""
    page: str = ""
    """Address of the page, where there is one: this screen covers what was printed of it."""


def draw(
    screen: Screen,
    snapshot: Snapshot,
    scheme: Scheme,
    link: LinkState,
    *,
    ascii_only: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> RenderableType:
    """Return the whole screen for a window (columns, lines) of ``WIDTH`` by ``HEIGHT`` at least."""
    columns, lines = size
    wide = columns >= _WIDE
    right_width = min(int(_LOG_SHARE * columns), _LOG_WIDTH) if wide else _MAP_WIDTH
    left_width = columns - right_width if wide else WIDTH - right_width
    link_lines = _link_lines(screen, snapshot, link, columns)
    traces = 0 if lines < _TRACES_FROM[not wide] else 6 * max(lines // _LINES_FOR_TRACE_ROW, 2) + 2
    height = lines - len(link_lines) - 1
    guide_height = height - traces if wide else _PANEL_HEIGHT
    title = f"{scheme.name}: {_done(snapshot)}"
    picture = _pictures_and_bars(screen, snapshot, link.cable, (left_width - 4, guide_height - 2), ascii_only=ascii_only)
    map_height = _map_shape(scheme)[0] + 6 if wide else guide_height
    positions = Group(_map(snapshot, scheme), _dim("screen.legend"), _dim("screen.legend_again"), *_known(snapshot.forecast))
    left, right = [_panel(picture, title, guide_height)], [_panel(positions, "positions", map_height)]
    below: list[RenderableType] = [*link_lines]
    signals: list[RenderableType] = []
    if traces:
        drawn = _traces(snapshot, (left_width if wide else WIDTH) - 4, traces - 2, ascii_only=ascii_only)
        signals = [_panel(drawn, signals_title(snapshot.signals), traces)]
    if wide:
        left += signals
        log = _messages(screen, height - 2 - map_height, right_width - 4)
        right.append(_panel(Group(*log), "log", height - map_height))
    else:
        below += [*_messages(screen, height - guide_height - traces, columns), *signals]
    middle = Table.grid(padding=0, expand=False)
    middle.add_column(width=left_width)
    middle.add_column(width=right_width)
    middle.add_row(Group(*left), Group(*right))
    return Group(middle, *below, _keys(columns))


def _panel(content: RenderableType, title: str, height: int) -> RenderableType:
    return Panel(content, box=ROUNDED, title=title, title_align="left", height=height)


def _pictures_and_bars(
    screen: Screen, snapshot: Snapshot, cable: str | None, size: tuple[int, int], *, ascii_only: bool
) -> RenderableType:
    """Return what to do, how the unit is held and should be, and how still it is, in a number of columns and lines."""
    width, height = size
    now = instruct(screen, snapshot)
    details = _whole(now.details, width, _DETAIL_ROWS)
    one = ((width - 2) // 2, height - 1 - _DETAIL_ROWS - _BAR_ROWS)
    return Group(
        Text(" ".join(now.headline), style=now.style, no_wrap=True),
        Text("\n".join([*details, *[""] * (_DETAIL_ROWS - len(details))]), no_wrap=True),
        _pictures(screen, snapshot, cable, one, ascii_only=ascii_only),
        _bars(screen, snapshot, width - _BESIDE_BAR),
    )


def _whole(text: str, width: int, rows: int) -> list[str]:
    """Return the lines of a text; where they are too many, those of its first clauses: the messages have it in full."""
    clauses = re.split(r"(?<=[;:]) ", text)
    for count in range(len(clauses), 0, -1):
        some = " ".join(clauses[:count])
        lines = textwrap.wrap(some.rstrip(";:") if count < len(clauses) else some, width, break_on_hyphens=False)
        if len(lines) <= rows:
            return lines or [""]
    return textwrap.wrap(clauses[0], width, max_lines=rows, placeholder="...", break_on_hyphens=False)


def _traces(snapshot: Snapshot, width: int, height: int, *, ascii_only: bool) -> RenderableType:
    lines = [] if snapshot.signals is None else draw_signals(snapshot.signals, width, height, ascii_only=ascii_only)
    return Text("\n".join(lines), no_wrap=True, overflow="crop")


def has_room_for_big(screen: Screen, snapshot: Snapshot, link: LinkState, size: tuple[int, int]) -> bool:
    """Return whether a window holds big letters with what stands below them."""
    width, height = size
    return width >= _BIG_WIDTH and height >= _FRAME + len(_link_lines(screen, snapshot, link, width))


def draw_big(screen: Screen, snapshot: Snapshot, link: LinkState, size: tuple[int, int] = (WIDTH, HEIGHT)) -> RenderableType:
    """Return the screen in letters to be read from three metres; from farther in a larger window."""
    width, height = size
    now = instruct(screen, snapshot)
    times = max(1, min(width // WIDTH, (height - HEIGHT) // (2 * ROWS) + 1))
    first, second = (big_lines(word, width, times) for word in now.big)
    space = height - _FRAME - 2 * ROWS * (times - 1)
    link_lines = _link_lines(screen, snapshot, link, width)
    room = space - len(link_lines)
    blank = [Text()] if room >= 4 else []
    messages = max(room - 2 * len(blank), 0)
    bar_width = min(_BAR_WIDTH, (width - _BESIDE_BIG_BARS) // 2)
    stillness, hold = _stillness_bar(snapshot, bar_width), bar(snapshot.fraction, "green", bar_width)
    return Group(
        *(Text(line, style=now.style, no_wrap=True) for line in (*first, "", *second)),
        *blank,
        Text(_whole(f"{now.headline}: {now.details}", width, 1)[0], no_wrap=True, overflow="crop"),
        Text.assemble(" still ", stillness, "  hold ", hold, f"  {_done(snapshot)}"),
        *blank,
        *link_lines,
        *_messages(screen, messages, width),
        _keys(width),
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
    ]
    above_link = len(lines)
    lines += _link_lines(screen, snapshot, link, width)
    # What to do and the newest words stand whole before there are bars, and these before there are pictures.
    room = height - len(lines) - 1
    needed = len(messages[0] if messages else [])
    if room >= _BAR_ROWS + needed:
        lines.append(_bars(screen, snapshot, _BAR_WIDTH))
        room -= _BAR_ROWS
    if room >= _PICTURE_SIZE[1] + needed and width >= 2 * _PICTURE_SIZE[0] + 2:
        lines.insert(above_link, _pictures(screen, snapshot, link.cable, _PICTURE_SIZE, ascii_only=ascii_only))
        room -= _PICTURE_SIZE[1]
    newest = _newest(messages, room)[: max(room, 0)]
    newest += [""] * (room - len(newest))
    return Group(*lines, *(Text(line, no_wrap=True) for line in newest), _keys(width))


def _keys(width: int) -> Text:
    return Text(_KEYS if width >= len(_KEYS) else _NARROW_KEYS, style="dim", no_wrap=True, overflow="crop")


def _dim(key: str, **values: object) -> Text:
    return Text(sentence(key, **values), style="dim", no_wrap=True)


def _done(snapshot: Snapshot) -> str:
    return f"{len(snapshot.accepted)} of {snapshot.planned} done"


def _pictures(screen: Screen, snapshot: Snapshot, cable: str | None, size: tuple[int, int], *, ascii_only: bool) -> Text:
    """Return two boxes of a size side by side: how the unit is held, and how it should be."""
    width, height = size
    now: list[str] = [""] * height
    goal = list(now)
    if snapshot.direction is not None:
        screen.attitude = turn_shortest(screen.attitude, np.array(snapshot.direction))
        now = draw_box(screen.attitude, width, height, cable=cable, ascii_only=ascii_only)
    if snapshot.target_direction is not None and snapshot.state is not State.HOLDING:
        wanted = turn_shortest(screen.attitude, np.array(snapshot.target_direction))
        goal = draw_box(wanted, width, height, cable=cable, ascii_only=ascii_only)
    text = Text(no_wrap=True)
    shows_goal = any(goal)
    for row in range(height):
        between = "->" if shows_goal and row == height // 2 else "  "
        left, right = now[row].ljust(width), goal[row].ljust(width)
        if row == 0:
            left, right = _in_corner(left, "now "), _in_corner(right, "goal")
        text.append(left).append(between, style="bold").append(right if shows_goal else "", style="cyan")
        text.append("\n" if row < height - 1 else "")
    return text


def _in_corner(row: str, word: str) -> str:
    """Return a row with a word in the left corner, or in the right one where something is drawn in the left."""
    if not row[: len(word)].strip():
        return word + row[len(word) :]
    return row if row[-len(word) :].strip() else row[: -len(word)] + word


def _bars(screen: Screen, snapshot: Snapshot, width: int) -> RenderableType:
    """Return three bars, and what moves most against its limit, in words and physical units."""
    table = Table.grid(padding=(0, 1))
    table.add_column(width=9, no_wrap=True)
    table.add_column(width=width, no_wrap=True)
    table.add_column(no_wrap=True)
    turning = snapshot.state is State.TURNING and math.isfinite(screen.angle_deg)
    holding = snapshot.state is State.HOLDING
    angle = f"{screen.angle_deg:.0f} deg" if turning else ""
    left = f"{screen.remaining_s:.0f} s left" if holding and math.isfinite(screen.remaining_s) else ""
    # At the target it stays full, and it is drawn with another sign than the hold's.
    there = 1 - screen.angle_deg / 180 if turning else float(holding)
    table.add_row("to target", bar(there, "cyan", width, sign="="), angle)
    table.add_row("hold", bar(snapshot.fraction if holding else 0.0, "green", width), left)
    activity = snapshot.activity
    state = "" if activity is None else "still" if activity.ratio <= 1 else "moving"
    table.add_row("stillness", _stillness_bar(snapshot, width), state)
    if activity is None:
        return Group(table, Text())
    return Group(table, Text(stillness_words(activity), style="dim", no_wrap=True))


def bar(fraction: float, style: str, width: int = _BAR_WIDTH, *, sign: str = "#") -> Text:
    """Return a bar that reads without colour."""
    full = round(min(max(fraction, 0.0), 1.0) * width)
    return Text(sign * full, style=style).append("." * (width - full), style="dim")


def _stillness_bar(snapshot: Snapshot, width: int = _BAR_WIDTH) -> Text:
    """Return activity against the limit, which stands in the middle of the bar."""
    ratio = 0.0 if snapshot.activity is None else snapshot.activity.ratio
    shown = bar(ratio / 2, "green" if ratio <= 1 else "red", width)
    middle = width // 2
    return Text.assemble(shown[:middle], "|", shown[middle + 1 :])


def _known(forecast: dict[str, float] | None) -> list[Text]:
    """Return how well the parameters are known, in two lines as wide as the map."""
    if not forecast:
        return [_dim("screen.not_known")]
    words = {name.partition("_")[0]: known_words(forecast, name).replace(NOT_TOLD, "unknown") for name in KNOWN_UNITS}
    return [Text(sentence(key, **words), no_wrap=True) for key in ("screen.known_scale", "screen.known_bias")]


def _map(snapshot: Snapshot, scheme: Scheme) -> RenderableType:
    """Return the positions in groups by their names, not in the order asked for."""
    names = sorted((position.name for position in scheme.positions), key=_natural)
    rows, columns, width = _map_shape(scheme)
    # The first that applies.
    signs = (
        ("@", "bold yellow", (snapshot.position,)),
        (">", "bold cyan", (snapshot.target,)),
        ("-", "dim", snapshot.skipped),
        ("r", "bold yellow", snapshot.again),
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


def _map_shape(scheme: Scheme) -> tuple[int, int, int]:
    """Return rows and columns of the map, and their width; the same in every window: a turn about one axis stays together."""
    width = max(len(position.name) for position in scheme.positions) + 4
    columns = max(1, (_MAP_WIDTH - 3) // width)
    return min(math.ceil(len(scheme) / columns), _MAP_ROWS), columns, width


def _natural(name: str) -> tuple[int, str, int]:
    """Sort key: x+45 before x+135, faces before corners, +x (2) after +x."""
    turn = re.fullmatch(r"([xyz])\+(\d+)", name)
    return (0, turn[1], int(turn[2])) if turn else (len(name.split(maxsplit=1)[0]), name, 0)


def _link_lines(screen: Screen, snapshot: Snapshot, state: LinkState, width: int) -> list[Text]:
    """Return the state of the link, from the left as much as there is room for; below it the address of the page in full."""
    arrives = screen.link and not state.silent
    rate = f"{snapshot.rate_hz:.0f} Hz" if arrives and math.isfinite(snapshot.rate_hz) else "- Hz"
    lost = f"{state.lost_samples} samples lost" if state.lost_samples is not None else f"{snapshot.lost_cells} gaps"
    if screen.link_paused and not state.silent:
        lost += ", pauses not counted"
    warmth = f"{snapshot.temperature_degc:.1f} degC" if math.isfinite(snapshot.temperature_degc) else "no temperature"
    link = "link ok" if arrives else sentence("screen.nothing_arrives") if screen.link else "LINK LOST"
    text = f" {link}"
    for part in (rate, lost, warmth):
        text += f"   {part}" if len(text) + 3 + len(part) <= width else ""
    return [Text(text, style="bold" if arrives else "bold red", no_wrap=True), *_page_lines(state.page, width)]


def _page_lines(url: str, width: int) -> list[Text]:
    """Return the address of the page in one line; where it has no room in one, in more that are one link in a terminal."""
    fits = len(url) <= width
    words = sentence("screen.page", url=url) if url else ""
    lines = textwrap.wrap(words, width, initial_indent=" ", break_long_words=not fits, break_on_hyphens=False)
    return [Text(line, style=Style(link=None if fits else url), no_wrap=True) for line in lines]


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
