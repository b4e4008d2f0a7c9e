"""Whole turns by hand: found among the moves, and checked for being whole.

A unit that is turned once around between two stills has made a known angle at an unknown rate. Rolled about a *horizontal*
axis, gravity closes the turn by itself: such a turn is a move like any other, with 360 degrees of lever on the scale, and it
need not even be quite whole. About the *vertical* gravity sees nothing; there the unit must come back against a stop, whose
repeatability is stated, and the closure is a measurement of its own.

The axis of a turn is never taken from gravity at the stop (a table half a degree off level would put 8.7 mrad into a column of
K E), nor from the accelerometer while turning (centripetal force): the integration finds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.gyroscope.residuals import Evaluation, GyroscopeData
from imufield.calibrate.model.rotation import from_matrix, logarithm
from imufield.errors import UsageError
from imufield.samples import AXES, FloatArray, IntArray

LEAST_TURN_RAD = np.radians(330.0)
MOST_TILT_RAD = np.radians(20.0)
"""A move that turned less, or came to rest further from where it began, is no attempt at a whole turn."""
_VERTICAL = np.cos(np.radians(20.0))  # An axis nearer to up counts as vertical.
NOT_WHOLE_SIGMAS = 5.0
NOT_WHOLE_RAD = np.radians(0.3)
"""A turn against a stop that misses by more than both is refused."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The operator's word that a move was whole turns about the vertical, back against a stop.

    ``time_s`` is any time between its two stills (sample clock); ``repeatability_rad`` is 1 sigma of the stop.
    """

    time_s: float
    repeatability_rad: float


STOP_RAD = np.radians(0.1)
"""Repeatability taken where nobody states one: a box pushed against a stop by hand."""


def stops_at(times_s: Sequence[float], start_s: FloatArray, end_s: FloatArray) -> tuple[Stop, ...]:
    """Return stops of the usual repeatability for the times that lie in a usable move (times of their begins and ends)."""
    return tuple(Stop(time_s, float(STOP_RAD)) for time_s in times_s if np.any((start_s <= time_s) & (time_s <= end_s)))


@dataclass(frozen=True, slots=True)
class WholeTurn:
    """A whole turn, with the sentence that says how well it closed."""

    turns: int
    """Signed: about the body axis ``axis``."""
    axis: str
    about: str
    """"horizontal" or "vertical"."""
    sentence: str


def find_stops(stops: Sequence[Stop], start_s: FloatArray, end_s: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the moves that stops belong to, and the repeatability of each.

    Raises
    ------
    UsageError
        If a stop belongs to no move, or its repeatability makes no sense.
    """
    moves = []
    for stop in stops:
        inside = np.flatnonzero((start_s <= stop.time_s) & (stop.time_s <= end_s))
        if not len(inside):
            raise UsageError(
                f"no usable move holds {stop.time_s:g} s, where a turn against a stop is said to be; check the time"
            )
        if not 0 < stop.repeatability_rad < 0.1:
            raise UsageError(
                f"a stop that repeats to {np.degrees(stop.repeatability_rad):g} deg is outside 0 to 6 deg; give what it does"
            )
        moves.append(int(inside[0]))
    return np.array(moves, dtype=np.int64), np.array([stop.repeatability_rad for stop in stops])


def closures(evaluation: Evaluation, data: GyroscopeData) -> FloatArray:
    """Return by how much each move misses returning to its attitude about the vertical, shape (m,), rad within pi."""
    return np.asarray(np.sum(logarithm(from_matrix(evaluation.carry)) * data.up[data.after], axis=1))


def whole_stops(
    evaluation: Evaluation, data: GyroscopeData, moves: IntArray, sigma: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which stops closed, and by how much each misses, shape (c,): from a fit without them.

    The scale that such a fit finds is good enough to tell a missed stop from a wrong scale.
    """
    missed = closures(evaluation, data)[moves]
    noise = np.sqrt(np.einsum("mi,mij,mj->m", data.up[data.after], evaluation.turns.spread, data.up[data.after]))[moves]
    # Beyond noise and repeatability, and beyond what a hand can tell.
    allowed = np.maximum(NOT_WHOLE_RAD, NOT_WHOLE_SIGMAS * np.hypot(sigma, noise))
    return np.abs(missed) <= allowed, missed


def find_whole_turns(evaluation: Evaluation, data: GyroscopeData, before: Evaluation | None = None) -> tuple[WholeTurn, ...]:
    """Return the whole turns among the moves, with the closure of each; ``before``: with the parameters in force before."""
    net = np.linalg.norm(evaluation.turns.net_rad, axis=1)
    error = evaluation.angle_error_rad(data.up[data.after])
    missed = closures(evaluation, data)
    error_before = None if before is None else before.angle_error_rad(data.up[data.after])
    missed_before = None if before is None else closures(before, data)
    tilt = np.arccos(np.clip(np.sum(data.up[data.before] * data.up[data.after], axis=1), -1, 1))
    turns = []
    for k in np.flatnonzero((net > LEAST_TURN_RAD) & (tilt < MOST_TILT_RAD)):
        axis = evaluation.turns.net_rad[k] / net[k]
        body = int(np.argmax(np.abs(axis)))
        count = round(net[k] / (2 * np.pi)) * int(np.sign(axis[body]))
        upright = abs(float(axis @ data.up[data.after[k]])) > _VERTICAL
        # An upright turn closes at its stop, a rolled one in the direction of gravity.
        off = float(missed[k]) if upright else float(tilt[k])
        closure = float(missed[k]) if upright else float(error[k])
        earlier = missed_before if upright else error_before
        closure_before = float("nan") if earlier is None else float(earlier[k])
        degrees = np.degrees([closure, closure_before, off])
        before_words = f" ({degrees[1]:.3f} deg with the parameters before)" if np.isfinite(degrees[1]) else ""
        sentence = f"{count:+d} turn{'s' if abs(count) > 1 else ''} about {AXES[body]}, "
        if upright:
            sentence += f"about the vertical: misses its start by {degrees[0]:+.3f} deg{before_words}"
        else:
            sentence += (
                f"rolled: closes to {degrees[0]:.3f} deg{before_words}, came to rest {degrees[2]:.1f} deg from where it began"
            )
        turns.append(WholeTurn(count, AXES[body], "vertical" if upright else "horizontal", sentence))
    return tuple(turns)
