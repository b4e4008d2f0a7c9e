"""What the numbers of a line are, where nobody said it: by a heading, by gravity, and by how the unit turns.

Three numbers whose norm stays at 9.8, 1 or 1000 are the accelerometer, in m/s^2, g or mg. While the unit turns, gravity's
direction u moves in the body by du/dt = u x w: the factor between both sides is the unit of the gyroscope. What is found is a
setting with its reason; a unit that nothing shows is assumed, and said to be.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from imufield.acquire.formats.table_cells import delimiter_of, is_number, split_cells
from imufield.acquire.formats.table_columns import FASTEST_RAD_S, HEADERLESS
from imufield.acquire.formats.table_names import TIME, named_column
from imufield.acquire.instrument.recognise import CERTAIN_SAMPLES, FEWEST_SAMPLES, RATE_S, Candidate, Listener, usual_rate
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.protocol.settings import with_origin
from imufield.acquire.protocol.units import nominal_scale
from imufield.dataclass import dataclass, replace
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, LARGEST_OUTPUT, FloatArray, median
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_LINES_SHOWN = 3
_LONGEST_SHOWN = 160  # Characters; two lines of a terminal.
_DELETE = 127
_WORD = re.compile(r"(?!nan|inf)[$A-Z]\w*:?", re.IGNORECASE)  # Before the numbers of every line: "$IMU,", "Raw:".
_CHECKSUM = re.compile(r"\*[0-9A-F]{2}$", re.IGNORECASE)
_LABEL = re.compile(r"[A-Z_]\w*[\"']?\s*[=:]\s*[\[({]?\s*[+-]?\.?\d", re.IGNORECASE)  # "ax=0.05", "G: 1 2 3", '"acc":[1,2,3]'.
_MOST = 0.9  # Of the lines: the first may be cut, and some damaged.
_A = ACCELEROMETER_COLUMNS
_G = GYROSCOPE_COLUMNS
_T = ("temperature",)
_NONE = ("-",) * 3
# Orders of triads and temperature in boards' examples, by how many numbers there are beside time and counter.
_ORDERS: dict[int, list[tuple[str, ...]]] = {
    3: [_A],
    6: [_A + _G, _G + _A],
    7: [_A + _G + _T, _A + _T + _G, _G + _A + _T, _G + _T + _A, _T + _A + _G, _T + _G + _A],
    # The last triad is then the magnetometer.
    9: [_A + _G + _NONE, _G + _A + _NONE],
}
_GRAVITY = {"m/s^2": 9.8, "g": 1.0, "mg": 1000.0}
_SAME_GRAVITY = 1.25  # Of an accelerometer that was never calibrated, most of the time at rest.
_SAME_NORM = 0.2  # Median departure from the median norm: what a hand does not exceed.
_LARGER = 20.0  # Norm of an accelerometer in counts over that of a gyroscope that lies still.
_STEADY_DEGC = 5.0
_MEAN_S = 0.1  # Shorter than any turn, longer than a tremor.
_TURNED_RAD = 0.2
_CORRELATED = 0.8
_SAME_UNIT = 2.0  # Units are a factor of 57 apart.
_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines of numbers that arrived, as rows (n, width), the cells of a heading, the word in front of each line."""

    rows: FloatArray
    heading: tuple[str, ...]
    prefix: str


@dataclass(frozen=True, slots=True)
class Columns:
    """Settings of driver ``text``, why each was taken, and whether nothing of it is a guess."""

    settings: dict[str, str]
    reasons: dict[str, str]
    is_shown: bool


def first_lines(data: bytes) -> list[str]:
    """Return the first lines of a text; nothing of bytes that are none."""
    characters = np.frombuffer(data, dtype=np.uint8)
    if np.mean((characters >= ord(" ")) & (characters < _DELETE) | np.isin(characters, list(b"\t\r\n"))) < _MOST:
        return []
    lines = [line.strip() for line in data.decode("latin-1").split("\n")]
    return [line[:_LONGEST_SHOWN] for line in lines if line][:_LINES_SHOWN]


def are_labelled(lines: Sequence[str]) -> bool:
    """Return whether most lines of a text have several numbers, or groups of them, each behind a label."""
    return 2 * sum(len(_LABEL.findall(line)) > 1 for line in lines) > len(lines)


def read_lines(data: bytes) -> Lines | None:
    """Return the lines of numbers in bytes that arrived; None where most of them are something else."""
    # What has no end is not whole yet.
    *lines, _ = data.decode("latin-1").split("\n")
    parted = [(line.strip(), *_parted(line.strip())) for line in lines if line.strip() and line.lstrip()[0] not in "#%/"]
    numbers = [(line, prefix, cells) for line, prefix, cells in parted if any(cells) and all(map(is_number, cells))]
    kinds = Counter((prefix, len(cells)) for _, prefix, cells in numbers)
    (prefix, width), count = max(kinds.items(), key=lambda kind: kind[1], default=(("", 0), 0))
    rows = [(line, cells) for line, word, cells in numbers if (word, len(cells)) == (prefix, width)]
    if count < FEWEST_SAMPLES or 2 * sum(len(line) for line, _ in rows) < len(data):
        return None
    words = (split_cells(line, delimiter_of(line)[0]) for line, _, _ in parted)
    heading = next((cells for cells in words if len(cells) == width and not any(map(is_number, cells))), ())
    table = np.array([[float(cell or "nan") for cell in cells] for _, cells in rows])
    table[np.abs(table) > LARGEST_OUTPUT] = np.nan
    # A line that lacks what the others have tells nothing, and its gaps would spread through every sum.
    usual = np.mean(np.isfinite(table), axis=0) > _MOST
    return Lines(table[np.isfinite(table[:, usual]).all(axis=1)], tuple(heading), prefix)


def other_lines(source: str, lines: Lines | None, protocol: Protocol) -> Sentence | None:
    """Return how lines of numbers differ from those of a protocol by their number and the word in front; None else."""
    rule = protocol.lines
    if lines is None or rule is None or rule.sentences:
        return None
    both = ((lines.prefix, lines.rows.shape[1]), (rule.prefix, len(rule.columns)))
    found, expected = (f"{number} numbers" + (f" behind {prefix!r}" if prefix else "") for prefix, number in both)
    values = {"source": source, "found": found, "expected": expected, "protocol": protocol.name}
    return None if found == expected else sentence("text_columns.other_lines", **values)


def _parted(line: str) -> tuple[str, list[str]]:
    """Return the word before the numbers of a line, and its cells."""
    word = _WORD.match(line)
    prefix = word[0] if word else ""
    body = _CHECKSUM.sub("", line.removeprefix(prefix).lstrip(" \t,;"))
    delimiter, decimal_comma = delimiter_of(body)
    return prefix, split_cells(body.replace(",", ".") if decimal_comma else body, delimiter)


def usual_columns(width: int) -> str:
    """Return what so many numbers would usually be: an example for the user to correct."""
    named = HEADERLESS.get(width, HEADERLESS[6] if width > 6 else HEADERLESS[3])
    return ",".join([*named, *["-"] * (width - len(named))])


def find_columns(lines: Lines, rate_hz: float) -> Columns | None:
    """Return what the numbers of lines that arrive at a rate are; None where no three of them are gravity."""
    rows, names = lines.rows, ["-"] * lines.rows.shape[1]
    settings: dict[str, str] = {"prefix": lines.prefix} if lines.prefix else {}
    reasons: dict[str, str] = {}
    left = [place for place in range(len(names)) if np.mean(np.isfinite(rows[:, place])) > _MOST]
    while left and (clock := _clock(rows[:, left[0]], rate_hz)) and clock["name"] not in names:
        names[left.pop(0)] = clock.pop("name")
        settings |= clock
    if "counter" in names and TIME not in names:
        settings["rate_hz"] = f"{usual_rate(rate_hz):.3g}"
        reasons["rate_hz"] = sentence("text_columns.rate", rate_hz=rate_hz)
    units = _by_heading(lines.heading, names)
    if units:
        why = sentence("text_columns.heading")
        units["accelerometer"] = units["accelerometer"] or _unit_of(rows[:, [names.index(name) for name in _A]])
    else:
        order = min(_orders(rows, left), default=None)
        if order is None:
            return None
        for place, name in zip(left, order[1], strict=True):
            names[place] = name
        units, first = {"accelerometer": order[2]}, names.index("ax")
        why = sentence("text_columns.gravity", first=first + 1, last=first + 3, norm=order[3])
    reasons |= dict.fromkeys(("columns", *(f"{triad}_unit" for triad, unit in units.items() if unit)), why)
    is_shown = "gx" not in names or bool(units.get("gyroscope"))
    if not is_shown:
        force, rate = (rows[:, [names.index(name) for name in triad]] for triad in (_A, _G))
        units["gyroscope"], reasons["gyroscope_unit"], is_shown = _gyroscope_unit(force, rate, units["accelerometer"], rate_hz)
    settings |= {"columns": ",".join(names), **{f"{triad}_unit": unit for triad, unit in units.items() if unit}}
    return Columns(settings, reasons, is_shown)


def _clock(values: FloatArray, rate_hz: float) -> dict[str, str]:
    """Return name and settings of a column that counts samples or time; empty for any other."""
    step = np.diff(values[np.isfinite(values)])
    typical = float(median(step)) if len(step) else 0.0
    if typical <= 0 or np.mean(step > 0) < _MOST:
        return {}
    if typical == 1 and np.array_equal(step, np.rint(step)):
        wraps = step.min() < 0
        return {"name": "counter", **({"counter_modulus": f"{1 - step.min():.0f}"} if wraps else {})}
    fits = (unit for unit, scale in _TIME_UNITS.items() if abs(math.log(typical * scale * rate_hz)) < math.log(_SAME_UNIT))
    return {"name": TIME, "time_unit": unit} if (unit := next(fits, "")) else {}


def _by_heading(heading: Sequence[str], names: list[str]) -> dict[str, str]:
    """Put the names of a heading into ``names``; return the units it states, empty where it names no accelerometer."""
    named = [column for place, cell in enumerate(heading) if (column := named_column(cell, place)) is not None]
    if not set(_A) <= {column.field for column in named}:
        return {}
    for column in named:
        names[column.index] = column.field
    return {column.quantity: column.unit or "" for column in named if column.field in ("ax", "gx")}


def _orders(rows: FloatArray, left: list[int]) -> Iterator[tuple[float, tuple[str, ...], str, float]]:
    """Yield the orders in which three numbers are gravity: how much the other three are, names, unit and norm of gravity."""
    for order in _ORDERS.get(len(left), ()):
        of = {name: rows[:, place] for place, name in zip(left, order, strict=True)}
        force = np.column_stack([of[name] for name in _A])
        norm, unit = float(median(np.linalg.norm(force, axis=1))), _unit_of(force)
        other = float(median(np.linalg.norm([of[name] for name in _G], axis=0))) if "gx" in of else 0.0
        is_raw = norm > _LARGER * other and np.array_equal(rows[:, left], np.rint(rows[:, left]))
        if (unit or is_raw) and np.ptp(of.get("temperature", 0.0)) < _STEADY_DEGC:
            yield other, order, unit or "count", norm


def _unit_of(force: FloatArray) -> str:
    """Return the unit in which this is gravity, whichever way it points; empty for none."""
    norms = np.linalg.norm(force, axis=1)
    norm = float(median(norms))
    if median(np.abs(norms - norm)) > _SAME_NORM * norm:
        return ""
    return next((unit for unit, g in _GRAVITY.items() if 1 / _SAME_GRAVITY < norm / g < _SAME_GRAVITY), "")


def _gyroscope_unit(force: FloatArray, rate: FloatArray, force_unit: str, rate_hz: float) -> tuple[str, str, bool]:
    """Return the unit of the gyroscope, why, and whether a turn has shown it."""
    ratio = _turn_over_tilt(force, rate, rate_hz)
    if ratio is not None:
        sizes = {unit: nominal_scale(unit) or 1.0 for unit in ("rad/s", "deg/s")}
        near = (unit for unit, size in sizes.items() if abs(math.log(ratio / size)) < math.log(_SAME_UNIT))
        return next(near, "count"), sentence("text_columns.turn", ratio=ratio), True
    fastest = float(np.nanquantile(np.abs(rate), _MOST))
    if force_unit == "count":
        return "count", sentence("text_columns.like_accelerometer", unit=force_unit), False
    if fastest > FASTEST_RAD_S:
        return "deg/s", sentence("text_columns.fastest", fastest=fastest), False
    unit = "deg/s" if force_unit in ("g", "mg") else "rad/s"
    return unit, sentence("text_columns.like_accelerometer", unit=force_unit or "m/s^2"), False


def _turn_over_tilt(force: FloatArray, rate: FloatArray, rate_hz: float) -> float | None:
    """Return what of the gyroscope's numbers is 1 rad/s; None where the unit was not turned."""
    step = max(round(_MEAN_S * rate_hz), 1)
    count = len(force) // step
    mean_force, mean_rate = (part[: count * step].reshape(count, step, 3).mean(axis=1) for part in (force, rate))
    up = mean_force / np.linalg.norm(mean_force, axis=1, keepdims=True)
    tilt = np.diff(up, axis=0)
    turn = np.cross(up[1:] + up[:-1], mean_rate[1:] + mean_rate[:-1]) / 4 * step / rate_hz
    both, turned, tilted = (float(np.nansum(product)) for product in (turn * tilt, turn**2, tilt**2))
    if math.sqrt(tilted) < _TURNED_RAD or both < _CORRELATED * math.sqrt(turned * tilted):
        return None
    return turned / both


class LineListener(Listener):
    """Finds out what the numbers of a line are before it judges them; parameters as for ``Listener``."""

    def __init__(self, candidate: Candidate, *, is_given: bool = False) -> None:
        super().__init__(candidate, is_given=is_given)
        self._open = candidate
        self._found: Columns | None = None
        self._rows = 0
        self._next_look = 1

    def feed(self, chunk: Chunk) -> None:
        """Take the bytes of one read."""
        super().feed(chunk)
        # Twice as many each time: all that was looked at is a small multiple of what arrived.
        if len(self._chunks) >= self._next_look:
            self._next_look *= 2
            self._look()

    def close(self) -> None:
        """Look at all there is, and count the samples that the decoder kept back."""
        self._look()
        super().close()

    @property
    def is_promising(self) -> bool:
        """Whether longer listening is worth it."""
        return self._rows > 0 or super().is_promising

    @property
    def is_certain(self) -> bool:
        """Whether listening longer would add nothing: a turn may yet show the unit of the gyroscope."""
        return self._found is not None and (self._is_given or self._found.is_shown) and super().is_certain

    def _look(self) -> None:
        span_s = self._chunks[-1].monotonic_s - self._chunks[0].monotonic_s if self._chunks else 0.0
        lines = read_lines(b"".join(chunk.data for chunk in self._chunks))
        self._rows = 0 if lines is None else len(lines.rows)
        if lines is None or span_s < RATE_S or self._rows < CERTAIN_SAMPLES:
            return
        found = find_columns(lines, sum(chunk.data.count(b"\n") for chunk in self._chunks[1:]) / span_s)
        driver, known = self._open.driver, self._open.protocol.settings
        if found is None or found == self._found or driver is None:
            return
        self._found = found
        given = with_origin(known, "given")
        new = {name: text for name, text in found.settings.items() if name not in given}
        protocol = load_protocol(driver.protocol, given, read={**driver.settings, **new})
        variant = {name: text for name, text in new.items() if protocol.settings[name].value != known[name].value}
        reasons = {name: why for name, why in found.reasons.items() if name not in given}
        self._begin(replace(self._open, protocol=protocol, variant=variant, reasons=reasons))
        self._decode(self._chunks)
