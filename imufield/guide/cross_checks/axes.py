"""Do the gyroscope's axes belong to the accelerometer's? A check by the moves between stills.

A unit that turns with the body rate w carries a direction fixed in the room, such as up, through the body frame as
du/dt = -w x u. So the up measured before a move, carried through it by the gyroscope, must arrive at the up measured after it.
All 48 signed permutations of the gyroscope's axes are tried (24 of them left-handed): if another one than the identity brings
the directions together, axes are swapped, a sign is wrong, or a triad is left-handed.

The check cannot find that all three accelerometer signs are wrong together (u and -u turn alike), nor which of the two triads
is the wrong one.

The rate is constant within a cell (0.1 s) here; at 180 deg/s this misjudges a move by about a degree, far below the tens of
degrees that a wrong axis gives. Where the gyroscope's scale is not known, or no arrangement fits with the given one, one common
factor is searched with each permutation, which tells a wrong unit or range from wrong axes. That needs stills: where in a wrong
unit the gyroscope's noise is none of a unit at rest, they are found as if its scale were not known.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from imufield.calibrate.model.rotation import misfits_rad, signed_permutations
from imufield.dataclass import dataclass, replace
from imufield.errors import CalibrationError, Reason
from imufield.guide import refusals
from imufield.guide.cross_checks.centre import centred
from imufield.guide.positions import angle_rad
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import CellRun, Cells
from imufield.guide.stillness.detector import LONGEST_WAIT_S, StillnessDetector
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Judgement, Phase
from imufield.samples import AXES, CELL_S, FloatArray, Status, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

ENOUGH_MOVES = 4  # Moves about one or two axes fit several permutations alike.
ENOUGH_FOR_UNITS = 2  # With a unit that is often confused and the axes as given they fit by chance in 1 of 10,000.
_SURE_DEG = 10.0
_LEAST_TURN_DEG = 20.0  # A move that turns up by less says nothing about axes.
GOOD_DEG = 20.0  # Largest RMS misfit of the right axes: 1 m/s^2 of bias on each accelerometer axis alone makes 14 degrees.
_MARGIN = 3.0  # The right permutation must fit better than any other by this factor.
_LONGEST_MOVE_CELLS = 600  # A minute: over a longer one the gyroscope drifts, and it is more than one move.
_ONE_MAY_BE_DAMAGED = 10  # Moves: with fewer, the only one about an axis may be the worst.
_MOVES_KEPT = 24  # As many as a scheme has positions; the search costs in proportion.
_SCALES = 25  # Steps of each of the two searches for a scale: the second resolves 1 %.
_SAME_FACTOR = 0.1  # Of a logarithm: an uncalibrated scale is off by less.
# Units that are confused, by the ratio that this makes.
_CONFUSED = ((math.degrees(1.0), "rad/s taken for deg/s"), (math.radians(1.0), "deg/s taken for rad/s"))
_MOVES_FOR_SCALE = 12  # The shortest ones: one factor needs no more, and they cost least.
# Total angle turned over the angle between the ups, as the range in which an unknown scale is searched.
_TURNS_OF_UP = (0.5, 4.0)


@dataclass(frozen=True, slots=True)
class MoveBetweenStills:
    """Up before and after, unit vectors (3,), and the cell-mean rates between, shape (k, 3), raw, without the bias."""

    up_before: FloatArray
    up_after: FloatArray
    rate_raw: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class AxesCheck:
    """The result of the check.

    Attributes
    ----------
    agrees : bool or None
        None where the moves do not decide (``words`` says why).
    permutation : ndarray, shape (3, 3)
        The signed permutation that fits best: right rates = permutation @ given rates.
    misfit_deg, best_misfit_deg : float
        RMS angle between predicted and measured up with the axes as given, and with the best permutation.
    gyroscope_scale : float
        Raw per rad/s, given or found.
    words : str
    refusal : Refusal or None
        The warning that gyroscope and accelerometer do not belong together, in the same words; None where they agree, or where
        the moves are too few or too alike.
    turns_ratio : float
        True rate over the gyroscope's, where its scale is contradicted; otherwise 1.
    """

    agrees: bool | None
    permutation: FloatArray
    words: str
    refusal: Refusal | None = None
    misfit_deg: float = math.nan
    best_misfit_deg: float = math.nan
    gyroscope_scale: float = math.nan
    turns_ratio: float = 1.0

    @property
    def is_contradicted(self) -> bool:
        """Whether axes or scale of the gyroscope are not as given, or no arrangement fits its rates."""
        nothing_fits = self.agrees is None and self.misfit_deg > GOOD_DEG and self.best_misfit_deg > GOOD_DEG
        return self.agrees is False or self.turns_ratio != 1.0 or nothing_fits

    @property
    def fits(self) -> bool:
        """Whether the moves come together with ``gyroscope_scale``: the axes as given, or another arrangement alone."""
        return self.agrees is not None or self.misfit_deg <= GOOD_DEG

    @property
    def error(self) -> CalibrationError | None:
        """The refusal, where the axes do not agree."""
        if self.agrees is not False:
            return None
        return CalibrationError(self.words, Reason.HANDEDNESS, misfit_deg=self.misfit_deg, best_misfit_deg=self.best_misfit_deg)


class MoveLog:
    """Collects moves from judgements, the newest 24, each up to a minute long."""

    def __init__(self) -> None:
        self._before: list[float] = []
        self._last: tuple[Cells, int] | None = None  # The cell before and its row.
        self._move = CellRun()  # From the last cell of a still on.
        self._finished: deque[tuple[list[float], list[float], FloatArray]] = deque(maxlen=_MOVES_KEPT)

    def follow(self, judgement: Judgement, still_mean: list[float]) -> None:
        """Add one judgement and the running mean of the stretch in progress (6 raw rates; empty when there is none)."""
        last, self._last = self._last, (judgement.cells, judgement.row)
        if judgement.ended is not None and last is not None:
            self._before, self._move = judgement.ended.mean, CellRun()
            self._move.add(*last)
        if not self._before:
            return
        self._move.add(*self._last)
        if judgement.phase is Phase.STILL:
            move = self._move.cells()
            # In a gap the unit may have turned; where its clock was set, for as long as nobody knows.
            is_set = move.flags[1:] & np.uint32(Status.CLOCK_SET)
            if len(move) > 2 and (np.diff(move.slot) == 1).all() and not is_set.any():
                self._finished.append((self._before, list(still_mean), move.mean[1:-1, 3:]))
            self._before = []
        elif len(self._move) > _LONGEST_MOVE_CELLS + 1:
            self._before = []

    def moves(self, scale: RoughScale) -> list[MoveBetweenStills]:
        """Return the moves with a gyroscope that turned up by enough to tell axes apart."""
        found = []
        for before, after, rates in self._finished:
            start, end = (scale.up(np.array(mean[:3])) for mean in (before, after))
            bias = (np.array(before[3:]) + np.array(after[3:])) / 2
            rate = rates - bias
            if np.isfinite(rate).all() and angle_rad(start, end) > math.radians(_LEAST_TURN_DEG):
                found.append(MoveBetweenStills(start, end, rate))
        return found


def check_while_waiting(waiting: StillnessDetector) -> AxesCheck:
    """Compare the turns so far while there is no noise floor by the given scales; at least one cell was judged."""
    detector, moves, stills = StillnessDetector(replace(waiting.scale, gyroscope=None)), MoveLog(), []
    for judgement in detector.judge(waiting.waited(LONGEST_WAIT_S)):
        moves.follow(judgement, detector.stretch.mean)
        stills += [] if judgement.ended is None else [judgement.ended.mean[:3]]
    scale = centred(detector.scale, np.array(stills))
    return check_axes(moves.moves(scale), waiting.scale.gyroscope)


def check_axes(moves: list[MoveBetweenStills], gyroscope_scale: float | None) -> AxesCheck:
    """Compare the turns of up by the accelerometer with those by the gyroscope, over all signed permutations.

    Parameters
    ----------
    moves : list of MoveBetweenStills
    gyroscope_scale : float or None
        Raw per rad/s; None where it is not known.
    """
    if len(moves) < ENOUGH_MOVES:
        few = sentence("axes.few_moves", moves=len(moves), least_deg=_LEAST_TURN_DEG, needed=ENOUGH_MOVES)
        unknown = AxesCheck(agrees=None, permutation=np.eye(3), words=few)
        return _confused(unknown, moves, gyroscope_scale) if gyroscope_scale and len(moves) >= ENOUGH_FOR_UNITS else unknown
    given = _arrange(moves, gyroscope_scale)
    if gyroscope_scale is None and given.agrees:
        count_deg_s = math.degrees(1 / given.gyroscope_scale)
        return replace(given, words=sentence("axes.agree_with", agree=given.words, count_deg_s=count_deg_s))
    if gyroscope_scale is None or given.fits:
        return given
    scaled = _arrange(moves, None)
    ratio = gyroscope_scale / scaled.gyroscope_scale
    # Turns about one axis leave others open, but that the given ones fit with a factor is enough to contradict the scale.
    if not scaled.fits or abs(math.log(ratio)) < _SAME_FACTOR:
        return _motionless(moves, gyroscope_scale, given)
    return _contradicted(scaled, given.misfit_deg, ratio)


def _motionless(moves: list[MoveBetweenStills], scale: float, given: AxesCheck) -> AxesCheck:
    """Return the check with its cause where the gyroscope moved by less than half of the way in every move."""
    ways_deg = np.degrees([np.linalg.norm(move.rate_raw, axis=1).sum() * CELL_S / scale for move in moves])
    turns_deg = np.degrees([angle_rad(move.up_before, move.up_after) for move in moves])
    if (ways_deg > turns_deg / 2).any():
        return given
    most = int(np.argmax(turns_deg))
    refusal = refusals.MOTIONLESS.refusal(turns_deg[most], 2 * ways_deg[most], way=ways_deg[most])
    return replace(given, words=refusal.words, refusal=refusal)


def _confused(unknown: AxesCheck, moves: list[MoveBetweenStills], scale: float) -> AxesCheck:
    """Return the check with a unit that is often confused with the given one, where a few moves fit it and not the given."""
    scales = scale / np.array([1.0, *(factor for factor, _ in _CONFUSED)])
    given, *others = np.degrees(_misfit(moves, np.eye(3)[None], scales)[:, 0]).tolist()
    best = int(np.argmin(others))
    if given <= GOOD_DEG or others[best] > _SURE_DEG:
        return unknown
    scaled = replace(unknown, best_misfit_deg=others[best], gyroscope_scale=float(scales[1 + best]))
    return _contradicted(scaled, given, _CONFUSED[best][0])


def _contradicted(scaled: AxesCheck, given_deg: float, ratio: float) -> AxesCheck:
    """Return the check with another scale than the given one, with which the moves misfit by ``given_deg``."""
    kind = refusals.SCALE_AND_AXES if scaled.agrees is False else refusals.SCALE_DIFFERS
    refusal = kind.refusal(
        given_deg,
        GOOD_DEG,
        ratio=ratio,
        cause=next((f" ({cause})" for factor, cause in _CONFUSED if abs(math.log(ratio / factor)) < _SAME_FACTOR), ""),
        axes=axes_words(scaled.permutation),
        best=scaled.best_misfit_deg,
    )
    # The scale as given is contradicted, so the misfit is the one that it makes.
    return replace(scaled, misfit_deg=given_deg, words=refusal.words, refusal=refusal, turns_ratio=ratio)


def _arrange(moves: list[MoveBetweenStills], scale: float | None) -> AxesCheck:
    """Return the arrangement of axes that fits best with a scale; None: with the one that fits best."""
    check = _arrangement(moves, scale)
    if check.agrees is not None or len(moves) < _ONE_MAY_BE_DAMAGED:
        return check
    # Where all moves decide nothing: one damaged sample speaks against axes that all other moves bear out.
    spared = _arrangement(moves, scale, spared=1)
    return check if spared.agrees is None else spared


def _arrangement(moves: list[MoveBetweenStills], scale: float | None, spared: int = 0) -> AxesCheck:
    permutations, scale = signed_permutations(), scale or _find_scale(moves, spared)
    (misfit,) = _misfit(moves, permutations, np.array([scale]), spared)
    order = np.argsort(misfit)
    identity = int(np.flatnonzero((permutations == np.eye(3)).all(axis=(1, 2)))[0])
    best, given, second = (math.degrees(float(misfit[i])) for i in (order[0], identity, order[1]))
    clear = best <= GOOD_DEG and second >= _MARGIN * best
    agrees = bool(order[0] == identity) if clear else None
    permutation, refusal = permutations[order[0]], None
    if agrees is None and given <= GOOD_DEG:
        # They may belong together, and so may others.
        other = next(i for i in order if i != identity)
        other_deg = math.degrees(float(misfit[other]))
        words: str = sentence("axes.ambiguous", within_deg=given, other_deg=other_deg, axes=axes_words(permutations[other]))
    elif agrees:
        words = sentence("axes.agree", within_deg=given, other_deg=second)
    else:
        differ = refusals.AXES_LEFT_HANDED if np.linalg.det(permutation) < 0 else refusals.AXES_DIFFER
        kind = refusals.AXES_OPEN if agrees is None else differ
        # The same correction on the accelerometer: P^T and -P^T turn alike; named is the one that changes fewer axes.
        own = axes_words(permutation.T if np.trace(permutation) >= 0 else -permutation.T)
        told = {"axes": axes_words(permutation), "accelerometer": own}
        refusal = kind.refusal(given, GOOD_DEG, best=best, second=second, **told)
        words = refusal.words
    return AxesCheck(
        agrees=agrees,
        permutation=permutation,
        words=words,
        refusal=refusal,
        misfit_deg=given,
        best_misfit_deg=best,
        gyroscope_scale=scale,
    )


def _misfit(moves: list[MoveBetweenStills], permutations: FloatArray, scales: FloatArray, spared: int = 0) -> FloatArray:
    """Return the RMS angle between predicted and measured up for each scale and permutation, rad, shape (n, 48).

    So many moves are ``spared``: the worst of each.
    """
    # Filled up with cells that turn about nothing, all moves are one array.
    rates = np.zeros((len(moves), max(len(move.rate_raw) for move in moves), 3))
    for row, move in zip(rates, moves, strict=True):
        row[: len(move.rate_raw)] = move.rate_raw
    before, after = (np.array([getattr(move, name) for move in moves]) for name in ("up_before", "up_after"))
    squares = misfits_rad(rates * CELL_S, before, after, permutations=permutations, scales=scales) ** 2
    return np.asarray(np.sqrt(np.sort(squares, axis=1)[:, : len(moves) - spared].mean(axis=1)))


def _find_scale(moves: list[MoveBetweenStills], spared: int) -> float:
    """Return the common scale (raw per rad/s) with which some permutation brings the moves together best."""
    permutations = signed_permutations()
    turned = [float(np.linalg.norm(move.rate_raw, axis=1).sum() * CELL_S) for move in moves]
    needed = [angle_rad(move.up_before, move.up_after) for move in moves]
    typical = max(float(median(np.array(turned) / needed)), 1e-12)
    few = sorted(moves, key=lambda move: len(move.rate_raw))[:_MOVES_FOR_SCALE]
    candidates = typical / np.geomspace(*_TURNS_OF_UP, _SCALES)
    misfit = _misfit(few, permutations, candidates, spared)
    row, column = np.unravel_index(int(misfit.argmin()), misfit.shape)
    step = candidates[0] / candidates[1]
    finer = candidates[row] * np.geomspace(1 / step, step, _SCALES)
    best = permutations[column : column + 1]
    return float(finer[np.argmin(_misfit(few, best, finer, spared))])


def axes_words(permutation: FloatArray) -> str:
    """Return a signed permutation in words: "x = +y, y = -x, z = +z"."""
    return ", ".join(
        f"{AXES[i]} = {'+' if row.sum() > 0 else '-'}{AXES[int(np.abs(row).argmax())]}" for i, row in enumerate(permutation)
    )
