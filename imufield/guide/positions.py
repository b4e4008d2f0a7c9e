"""Positions of a calibration: which side is up, in which order, and in which words for a person.

A position is the direction of "up" in the body frame; heading does not matter. ``schemes.toml`` holds the shipped positions in
an order that no drift over the session can imitate (docs/maths.md, weights and uncertainty).
"""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import tomli

from imufield.dataclass import dataclass
from imufield.errors import UsageError
from imufield.files import Origin, read_small_file
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentence, Sentences, printable
from imufield.toml_and_json import decode_toml, parse_toml

sentence = Sentences(__package__)

_SAME_DIRECTION_DEG = 1.0  # Repeats of one direction differ by rounding, neighbours of a scheme by 30 degrees and more.
_SAME_SIZE = 0.02  # Parts of a direction that differ by less are those of an edge or a corner.

DEFAULT_SCHEME = "paper24"  # What the README promises: 24 positions, hand-held.
REVISIT_FROM = 12
"""Schemes with at least this many positions end with the first one again, as a check for drift; a quick one does without."""
SCHEMES = ("paper24", "paper36", "corners24", "all26", "faces6")
"""Names of the shipped schemes."""
MOST_POSITIONS = 300
"""Of a scheme: an hour of holds and turns. The guide fits all that is measured after each of them."""
SCHEME_FILE = "positions.toml"
"""Copy, in the session's folder, of positions that are not shipped: the session must be solved again without their file."""


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """One planned orientation.

    Attributes
    ----------
    name : str
        Short and unique within the scheme.
    direction : ndarray, shape (3,)
        Unit vector that points up, in the body frame.
    words : str
        For the operator.
    """

    name: str
    direction: FloatArray
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Scheme:
    """Positions in their proposed order."""

    name: str
    positions: tuple[Position, ...]

    def __len__(self) -> int:
        return len(self.positions)

    def directions(self) -> FloatArray:
        """Return the directions, shape (n, 3)."""
        return np.array([position.direction for position in self.positions])

    def separation_deg(self) -> float:
        """Return the smallest angle between two different directions."""
        angle = np.degrees(np.arccos(np.clip(self.directions() @ self.directions().T, -1, 1)))
        different = angle[angle > _SAME_DIRECTION_DEG]
        return float(different.min()) if len(different) else 180.0


def angle_rad(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two vectors."""
    (ax, ay, az), (bx, by, bz) = first.tolist(), second.tolist()
    # As numpy.cross, without its two dozen calls for arrays of any shape: the guide asks this for every cell.
    across = np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    return math.atan2(float(np.linalg.norm(across)), float(np.dot(first, second)))


def angle_deg(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two vectors."""
    return math.degrees(angle_rad(first, second))


def describe(direction: FloatArray) -> Sentence:
    """Return in words which side of the unit is up."""
    parts = [f"{'+' if direction[i] > 0 else '-'}{AXES[i]}" for i in np.argsort(-np.abs(direction), kind="stable")]
    size = np.sort(np.abs(direction))[::-1]
    if size[1] < math.sin(math.radians(_SAME_DIRECTION_DEG)):
        return sentence("positions.face", up=parts[0], down=parts[0].translate(str.maketrans("+-", "-+")))
    if np.ptp(size[:2]) < _SAME_SIZE and size[2] < _SAME_SIZE:
        first, second = sorted(parts[:2], key=lambda part: part[1])
        return sentence("positions.edge", first=first, second=second)
    if np.ptp(size) < _SAME_SIZE:
        return sentence("positions.corner", sides=" ".join(sorted(parts, key=lambda part: part[1])))
    if size[2] < _SAME_SIZE:
        lean_deg = math.degrees(math.atan2(size[1], size[0]))
        return sentence("positions.leaning", up=parts[0], lean_deg=lean_deg, towards=parts[1])
    lean_deg = math.degrees(math.acos(min(size[0], 1.0)))
    return sentence("positions.leaning_between", up=parts[0], lean_deg=lean_deg, towards=parts[1], aside=parts[2])


@cache
def cube_directions() -> dict[str, FloatArray]:
    """Return the 26 directions to faces, edges and corners of a cube, named "+x", "+x-y", "+x-y+z"."""
    found = {}
    for code in np.ndindex(3, 3, 3):
        signs = np.array(code) - 1
        if signs.any():
            name = "".join(f"{'+' if sign > 0 else '-'}{axis}" for sign, axis in zip(signs, AXES, strict=True) if sign)
            found[name] = signs / np.linalg.norm(signs)
    return found


def nearest_cube_direction(direction: FloatArray) -> str:
    """Return the name of the nearest of the 26 directions of a cube."""
    names = cube_directions()
    return max(names, key=lambda name: float(names[name] @ direction))


@cache
def _shipped(name: str) -> tuple[Position, ...]:
    table = tomli.loads((Path(__file__).parent / "schemes.toml").read_text(encoding="utf-8"))
    named = [(entry, named_direction(entry)) for entry in table[name]]
    return tuple(Position(entry, direction, describe(direction)) for entry, direction in named)


def named_direction(name: str) -> FloatArray:
    """Return up at a position by its name: a side of a cube, "+z", "z+" or "+x-y (2)", or a turn about an axis, "x+45".

    Raises
    ------
    UsageError
        If that is no such name.
    """
    side = re.sub(r"^([xyz])([+-])$", r"\2\1", name.partition(" ")[0])
    known, turned = cube_directions(), re.fullmatch(r"([xyz])([+-]\d{1,3})", side)
    if turned is None:
        if side not in known:
            raise UsageError(sentence("positions.no_name", name=name))
        return known[side]
    axis, angle = AXES.index(turned[1]), math.radians(int(turned[2]))
    direction = np.zeros(3)
    # x horizontal starts with +z up and comes to +y; the others follow by cyclic exchange.
    direction[(axis + 2) % 3] = math.cos(angle)
    direction[(axis + 1) % 3] = math.sin(angle)
    direction[np.abs(direction) < 1e-12] = 0.0
    return direction


def scheme(name_or_path: str | Path, origin: Origin = Origin.TYPED) -> Scheme:
    """Return a shipped scheme, or the user's own from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        One of ``SCHEMES``, or a file with a table ``[[position]]`` for each: ``up`` (three numbers), ``name``, ``words``
        (optional). A file's positions keep their order.
    origin : Origin
        Who chose the file.

    Raises
    ------
    UsageError
        If there is no such scheme or file, or the file says something that makes no sense.
    """
    if str(name_or_path) in SCHEMES:
        return Scheme(str(name_or_path), _shipped(str(name_or_path)))
    positions, name = read_positions(Path(name_or_path), origin)
    return Scheme(name, positions)


def read_positions(path: Path, origin: Origin = Origin.TYPED) -> tuple[tuple[Position, ...], str]:
    """Return the positions of a user's TOML file and the name of its scheme.

    Raises
    ------
    UsageError
        Naming file, line and key.
    """
    if not path.is_file():
        # An empty name would lead to the present folder.
        is_named = path != Path()
        key = "positions.no_file" if is_named and path.exists() else "positions.no_scheme"
        raise UsageError(sentence(key, path=str(path) if is_named else "", schemes=SCHEMES))
    try:
        text = decode_toml(read_small_file(path, origin), path.name, UsageError)
    except OSError as error:
        raise UsageError(sentence("positions.cannot_read", path=str(path), cause=error.strerror)) from error
    content = parse_toml(text, path.name, UsageError)
    tables = content.get("position", [])
    if unknown := sorted(set(content) - {"name", "position"}):
        raise UsageError(sentence("positions.unknown_key_of_file", file=path.name, key=unknown[0]))
    if not isinstance(tables, list) or not tables:
        raise UsageError(sentence("positions.no_position", file=path.name))
    if len(tables) > MOST_POSITIONS:
        raise UsageError(sentence("positions.too_many", file=path.name, positions=len(tables), limit=MOST_POSITIONS))
    lines = [number for number, line in enumerate(text.splitlines(), 1) if re.match(r"\s*\[\[\s*position\s*\]\]", line)]
    found: list[Position] = []
    for i, table in enumerate(tables):
        where = f"{path.name}, line {lines[i] if i < len(lines) else '?'}"
        found.append(_read_position(table, where, {position.name for position in found}))
    return tuple(found), printable(str(content.get("name", path.stem)))


def _read_position(table: object, where: str, taken: set[str]) -> Position:
    if not isinstance(table, dict):
        raise UsageError(sentence("positions.no_table", where=where, table=table))
    if unknown := sorted(set(table) - {"name", "up", "words"}):
        raise UsageError(sentence("positions.unknown_key", where=where, key=unknown[0]))
    up = table.get("up")
    numbers = isinstance(up, list) and len(up) == 3 and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in up)
    vector = np.array(up if numbers else [np.nan] * 3, dtype=np.float64)
    # As numpy.linalg.norm, which is infinite or zero where squares are no numbers.
    norm = math.hypot(*vector)
    if not math.isfinite(norm) or norm == 0:
        raise UsageError(sentence("positions.no_direction", where=where, up=up, key="up"))
    direction = vector / norm
    name = table.get("name", nearest_cube_direction(direction))
    words = table.get("words", describe(direction))
    if not isinstance(name, str) or not isinstance(words, str) or not name:
        raise UsageError(sentence("positions.no_text", where=where, name=name, words=words, key="name"))
    name, words = printable(name), printable(words)
    if name in taken:
        raise UsageError(sentence("positions.name_twice", where=where, name=name, key="name"))
    return Position(name, direction, words)
