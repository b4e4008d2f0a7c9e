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

import numpy as np

from imufield.calibrate.gyroscope.residuals import Evaluation, GyroscopeData
from imufield.calibrate.model.rotation import from_matrix, logarithm
from imufield.dataclass import dataclass
from imufield.errors import UsageError
from imufield.samples import AXES, FloatArray, IntArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

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
            raise UsageError(sentence("whole_turns.no_move", time_s=stop.time_s))
        if not 0 < stop.repeatability_rad < 0.1:
            raise UsageError(sentence("whole_turns.repeatability", sigma_deg=np.degrees(stop.repeatability_rad)))
        moves.append(int(inside[0]))
    return np.array(moves, dtype=np.int64), np.array([stop.repeatability_rad for stop in stops])


def closures(evaluation: Evaluation, data: GyroscopeData) -> FloatArray:
    """Return by how much each move misses returning to its attitude about the vertical, shape (m,), rad within pi."""
    return np.asarray(np.sum(logarithm(from_matrix(evaluation.carry)) * data.up[data.moves.after], axis=1))


def misses_and_limits(
    evaluation: Evaluation, data: GyroscopeData, moves: IntArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return by how much each stop misses a whole turn, and the limit, rad, shape (c,): from a fit without them.

    The scale that such a fit finds is good enough to tell a missed stop from a wrong scale.
    """
    missed = closures(evaluation, data)[moves]
    noise = np.sqrt(np.einsum("mi,mij,mj->m", data.up[data.moves.after], evaluation.turns.spread, data.up[data.moves.after]))[
        moves
    ]
    # Beyond noise and repeatability, and beyond what a hand can tell.
    return missed, np.maximum(NOT_WHOLE_RAD, NOT_WHOLE_SIGMAS * np.hypot(sigma, noise))


def find_whole_turns(evaluation: Evaluation, data: GyroscopeData, before: Evaluation | None = None) -> tuple[Sentence, ...]:
    """Return the whole turns among the moves, with the closure of each; ``before``: with the parameters in force before."""
    net = np.linalg.norm(evaluation.turns.net_rad, axis=1)
    tilt = np.arccos(np.clip(np.sum(data.up[data.moves.before] * data.up[data.moves.after], axis=1), -1, 1))
    fits = [evaluation] if before is None else [evaluation, before]
    # An upright turn closes at its stop, a rolled one in the direction of gravity.
    upright_rad = [closures(fit, data) for fit in fits]
    rolled_rad = [fit.angle_error_rad(data.up[data.moves.after]) for fit in fits]
    turns = []
    for k in np.flatnonzero((net > LEAST_TURN_RAD) & (tilt < MOST_TILT_RAD)):
        axis = evaluation.turns.net_rad[k] / net[k]
        body = int(np.argmax(np.abs(axis)))
        count = round(net[k] / (2 * np.pi)) * int(np.sign(axis[body]))
        if abs(float(axis @ data.up[data.moves.after[k]])) > _VERTICAL:
            keys, closed_rad = ("whole_turns.upright", "whole_turns.upright_and_before"), upright_rad
        else:
            keys, closed_rad = ("whole_turns.rolled", "whole_turns.rolled_and_before"), rolled_rad
        noun = "turn" if abs(count) == 1 else "turns"
        degrees = np.degrees([closed_rad[0][k], closed_rad[-1][k], tilt[k]])
        closed = dict(zip(("closure_deg", "before_deg", "off_deg"), degrees, strict=True))
        turns.append(sentence(keys[len(fits) - 1], turns=count, noun=noun, axis=AXES[body], **closed))
    return tuple(turns)
