"""The order in which the shipped positions are proposed: how the lists of ``schemes.toml`` were found."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.guide.positions import cube_directions
from imufield.samples import AXES, FloatArray

_SHUFFLES = 2000  # The best of more is hardly better, and it is improved afterwards.
_SEED = 24
_SAME_DIRECTION_DEG = 1.0  # Repeats of one direction differ by rounding, neighbours of a scheme by 30 degrees and more.
_APART = 1 / 3  # Of a session: repeats of one direction at least so far apart show a drift between them.
_CLOSE_COSTS = 10  # Against terms that are at most 1.


_FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]
_CORNERS = [f"{x}x{y}y{z}z" for x in "+-" for y in "+-" for z in "+-"]
# The corners measured twice are those of a regular tetrahedron: no direction is favoured.
_TWICE = ["+x+y+z", "+x-y-z", "-x+y-z", "-x-y+z"]
IN_TURN = {
    "paper24": [f"{axis}+{angle}" for axis in AXES for angle in range(0, 360, 45)],
    "paper36": [f"{axis}+{angle}" for axis in AXES for angle in range(0, 360, 30)],
    "corners24": _FACES * 2 + _CORNERS + _TWICE,
    "all26": list(cube_directions()),
    "faces6": _FACES,
}
"""What each scheme is made of, without the numbers of repeats."""


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
