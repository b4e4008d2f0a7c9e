"""Positions of a calibration: which side is up, in which order, and in which words for a person.

A position is the direction of "up" in the body frame; heading does not matter. The proposed order is not the scheme's
own: drift of the bias over the session would look like the parameter whose column grows with the position number
(docs/maths.md, weights and uncertainty), so the order is the best of many seeded shuffles: the terms of the error model
uncorrelated with time and time squared, repeats of one direction far apart.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imufield.errors import UsageError
from imufield.files import read_small_file
from imufield.samples import AXES, FloatArray

_SHUFFLES = 2000  # The best of more is hardly better, and it is improved afterwards.
_SEED = 24  # The same order for the same scheme, today and tomorrow.
_SAME_DIRECTION_DEG = 1.0  # Repeats of one direction differ by rounding, neighbours of a scheme by 30 degrees and more.
_SAME_SIZE = 0.02  # Parts of a direction that differ by less are those of an edge or a corner.
_APART = 1 / 3  # Of a session: repeats of one direction at least so far apart show a drift between them.
_CLOSE_COSTS = 10  # Against terms that are at most 1.


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


def angle_deg(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two vectors."""
    (ax, ay, az), (bx, by, bz) = first.tolist(), second.tolist()
    # As numpy.cross, without its two dozen calls for arrays of any shape: the guide asks this for every cell.
    across = np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    sine, cosine = np.linalg.norm(across), np.dot(first, second)
    return math.degrees(math.atan2(float(sine), float(cosine)))


def describe(direction: FloatArray) -> str:
    """Return in words which side of the unit is up."""
    parts = [f"{'+' if direction[i] > 0 else '-'}{AXES[i]}" for i in np.argsort(-np.abs(direction), kind="stable")]
    size = np.sort(np.abs(direction))[::-1]
    if size[1] < math.sin(math.radians(_SAME_DIRECTION_DEG)):
        opposite = parts[0].translate(str.maketrans("+-", "-+"))
        return f"{parts[0]} up, standing on the {opposite} face"
    upright = sorted(parts[:2], key=lambda part: part[1])
    if np.ptp(size[:2]) < _SAME_SIZE and size[2] < _SAME_SIZE:
        return f"edge between {upright[0]} and {upright[1]} up"
    if np.ptp(size) < _SAME_SIZE:
        return "corner " + " ".join(sorted(parts, key=lambda part: part[1])) + " up"
    if size[2] < _SAME_SIZE:
        return f"{parts[0]} up, leaning {math.degrees(math.atan2(size[1], size[0])):.0f} deg towards {parts[1]}"
    lean = math.degrees(math.acos(min(size[0], 1.0)))
    return f"{parts[0]} up, leaning {lean:.0f} deg towards {parts[1]} and {parts[2]}"


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


def _turns(step_deg: int) -> list[Position]:
    """Return the positions of the papers: one axis horizontal, the unit turned about it in steps; x, y, then z."""
    found = []
    for axis in range(3):
        for angle in range(0, 360, step_deg):
            direction = np.zeros(3)
            # x horizontal starts with +z up and comes to +y; the others follow by cyclic exchange.
            direction[(axis + 2) % 3] = math.cos(math.radians(angle))
            direction[(axis + 1) % 3] = math.sin(math.radians(angle))
            direction[np.abs(direction) < 1e-12] = 0.0
            found.append(Position(f"{AXES[axis]}+{angle}", direction, describe(direction)))
    return found


_FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]
_CORNERS = [f"{x}x{y}y{z}z" for x in "+-" for y in "+-" for z in "+-"]
# The corners measured twice are those of a regular tetrahedron: no direction is favoured.
_TWICE = ["+x+y+z", "+x-y-z", "-x+y-z", "-x-y+z"]

SCHEMES = ("paper24", "paper36", "corners24", "faces6")


@cache
def _interleaved(name: str) -> tuple[Position, ...]:
    if name in ("paper24", "paper36"):
        positions = _turns(45 if name == "paper24" else 30)
        return tuple(positions[i] for i in interleave(np.array([position.direction for position in positions])))
    names = _FACES if name == "faces6" else _FACES * 2 + _CORNERS + _TWICE
    directions = cube_directions()
    names = [names[i] for i in interleave(np.array([directions[name] for name in names]))]
    found: list[Position] = []
    for i, side in enumerate(names):
        # Numbered in this order, so that "+x (2)" comes after "+x".
        times = names[:i].count(side)
        unique = side if not times else f"{side} ({times + 1})"
        found.append(Position(unique, directions[side], describe(directions[side])))
    return tuple(found)


def scheme(name_or_path: str | Path, *, revisit_first: bool = False) -> Scheme:
    """Return a shipped scheme, or the user's own from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        One of ``SCHEMES``, or a file with a table ``[[position]]`` for each: ``up`` (three numbers), ``name``, ``words``
        (optional). A file's positions keep their order.
    revisit_first : bool
        Append the first position again: a check for drift over the session.

    Raises
    ------
    UsageError
        If there is no such scheme or file, or the file says something that makes no sense.
    """
    if str(name_or_path) in SCHEMES:
        name = str(name_or_path)
        positions = _interleaved(name)
    else:
        positions, name = read_positions(Path(name_or_path))
    if revisit_first:
        first = positions[0]
        positions = (*positions, Position(f"{first.name} again", first.direction, first.words))
    return Scheme(name, positions)


def interleave(directions: FloatArray) -> list[int]:
    """Return an order of the directions (n, 3) that a drift cannot imitate; the same for the same input.

    The best of many shuffles is improved by exchanging two positions, the best exchange each time, until none helps.
    """
    n = len(directions)
    orders = np.argsort(np.random.default_rng(_SEED).random((_SHUFFLES, n)), axis=1)
    best = orders[np.argmin(_cost(directions, orders))]
    first, second = np.triu_indices(n, 1)
    rows = np.arange(len(first))
    for _ in range(4 * n):
        swapped = np.tile(best, (len(first), 1))
        swapped[rows, first], swapped[rows, second] = best[second], best[first]
        cost = _cost(directions, np.concatenate(([best], swapped)))
        if not len(first) or int(np.argmin(cost)) == 0:
            break
        best = swapped[np.argmin(cost) - 1]
    return [int(i) for i in best]


def _cost(directions: FloatArray, orders: NDArray[np.intp]) -> FloatArray:
    """Return the cost of each order: correlation of a drift with the error terms, and repeats that are not far apart."""
    x, y, z = directions.T
    terms = np.stack([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z, x**3, y**3, z**3], axis=1)
    terms = terms - terms.mean(axis=0)
    size = np.linalg.norm(terms, axis=0)
    terms = terms[:, size > 1e-9] / size[size > 1e-9]
    time = np.linspace(-1, 1, len(directions))
    drifts = np.stack([time, time**2 - np.mean(time**2)])
    drifts /= np.maximum(np.linalg.norm(drifts, axis=1, keepdims=True), 1e-9)
    same = np.triu(directions @ directions.T > math.cos(math.radians(_SAME_DIRECTION_DEG)), 1)
    place = np.argsort(orders, axis=1)
    first, second = np.nonzero(same)
    apart = np.abs(place[:, first] - place[:, second]) / len(directions)
    penalty = _CLOSE_COSTS * np.square(np.maximum(_APART - apart, 0)).sum(axis=1)
    cost: FloatArray = np.square(drifts @ terms[orders]).sum(axis=(1, 2)) + penalty
    return cost


def read_positions(path: Path) -> tuple[tuple[Position, ...], str]:
    """Return the positions of a user's TOML file and the name of its scheme.

    Raises
    ------
    UsageError
        Naming file, line and key.
    """
    if not path.is_file():
        raise UsageError(
            f"there is no position scheme {str(path)!r}; use one of {', '.join(SCHEMES)}, or the path of a TOML file",
            path=str(path),
        )
    try:
        text = read_small_file(path).decode()
        content = tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); check its permissions", path=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path.name} is no valid TOML: {error}; correct it and try again", path=str(path)) from error
    tables = content.get("position", [])
    unknown = sorted(set(content) - {"name", "position"})
    if unknown or not isinstance(tables, list) or not tables:
        problem = f"has an unknown key {unknown[0]!r}" if unknown else "lists no [[position]]"
        raise UsageError(f"{path.name} {problem}; it holds a name and one [[position]] table each, with up = [x, y, z]")
    lines = [number for number, line in enumerate(text.splitlines(), 1) if re.match(r"\s*\[\[\s*position\s*\]\]", line)]
    found: list[Position] = []
    for i, table in enumerate(tables):
        where = f"{path.name}, line {lines[i] if i < len(lines) else '?'}"
        found.append(_read_position(table, where, {position.name for position in found}))
    return tuple(found), str(content.get("name", path.stem))


def _read_position(table: object, where: str, taken: set[str]) -> Position:
    if not isinstance(table, dict):
        raise UsageError(f"{where}: a position is a table [[position]] with up = [x, y, z], not {table!r}", where=where)
    unknown = sorted(set(table) - {"name", "up", "words"})
    if unknown:
        raise UsageError(f"{where}: unknown key {unknown[0]!r}; a position has up, name and words", where=where, key=unknown[0])
    up = table.get("up")
    numbers = isinstance(up, list) and len(up) == 3 and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in up)
    vector = np.array(up if numbers else [np.nan] * 3, dtype=np.float64)
    norm = float(np.linalg.norm(vector))
    if not math.isfinite(norm) or norm == 0:
        message = f"{where}: up = {up!r} is no direction; give three numbers, the part of each body axis that points up"
        raise UsageError(message, where=where, key="up")
    direction = vector / norm
    name = table.get("name", nearest_cube_direction(direction))
    words = table.get("words", describe(direction))
    if not isinstance(name, str) or not isinstance(words, str) or not name:
        raise UsageError(f"{where}: name and words must be text, got {name!r} and {words!r}", where=where, key="name")
    if name in taken:
        raise UsageError(f"{where}: the name {name!r} is used twice; give each position its own", where=where, key="name")
    return Position(name, direction, words)
