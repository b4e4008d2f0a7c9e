"""The box that stands for the instrument: three lengths, without perspective, each face with the name of its axis.

Only faces towards the onlooker are seen, so the box reads as solid. Gravity tells which way is up in the body, never the
heading; so a heading is chosen: a box turns by the shortest way that brings "up" to the top.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imufield.dataclass import dataclass
from imufield.samples import AXES, FloatArray

HALF_SIZE = (1.0, 0.72, 0.42)
"""Of the box along body x, y, z: three lengths, so that the sides are distinct."""
# The onlooker looks a little from above and from one side, which shows three faces in almost every attitude.
_CP, _SP = math.cos(math.radians(24.0)), math.sin(math.radians(24.0))
_CY, _SY = math.cos(math.radians(33.0)), math.sin(math.radians(33.0))
ONLOOKER = np.array([[1, 0, 0], [0, _CP, -_SP], [0, _SP, _CP]]) @ np.array([[_CY, -_SY, 0], [_SY, _CY, 0], [0, 0, 1]])
"""The turn from the room to the onlooker, x right, y away, z up: pitch after yaw."""
_UPSIDE_DOWN = -0.98  # Cosine: nearer than 11 degrees to a half turn.
_TOWARDS = -0.05  # Of a face's normal: one seen edge-on has no room for its name.


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A side of the box that the onlooker sees."""

    name: str
    corners: FloatArray
    """One after the other, in the onlooker's axes, shape (4, 3)."""
    up: float
    """Cosine between its normal and the vertical."""


def visible_faces(attitude: FloatArray) -> Iterator[Face]:
    """Yield the sides that are seen in an attitude (see ``turn_shortest``)."""
    view = ONLOOKER @ attitude
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = sign * np.eye(3)[axis]
            if (view @ normal)[1] < _TOWARDS:
                corners = np.full((4, 3), sign)
                corners[:, [(axis + 1) % 3, (axis + 2) % 3]] = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
                name = f"{'+' if sign > 0 else '-'}{AXES[axis]}"
                yield Face(name, corners * HALF_SIZE @ view.T, float((attitude @ normal)[2]))


def turn_shortest(attitude: FloatArray, up: FloatArray) -> FloatArray:
    """Turn an attitude by the shortest way so that ``up`` (body) points up in the room.

    Parameters
    ----------
    attitude : ndarray, shape (3, 3)
        Takes body vectors to the room: x right, y away, z up.
    up : ndarray, shape (3,)
        Unit vector.
    """
    goal = np.array([0.0, 0.0, 1.0])
    if (attitude @ up)[2] < _UPSIDE_DOWN:
        # The shortest way would be about an axis that noise chooses, another one in each frame.
        attitude = np.diag([1.0, -1.0, -1.0]) @ attitude
    now = attitude @ up
    axis = np.cross(now, goal)
    sine, cosine = float(np.linalg.norm(axis)), float(now @ goal)
    if sine < 1e-9:
        return attitude
    axis = axis / sine
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turned: FloatArray = (np.eye(3) + sine * K + (1 - cosine) * K @ K) @ attitude
    # Rounding adds up over thousands of frames.
    u, _, v = np.linalg.svd(turned)
    return np.asarray(u @ v)
