"""What the holds show together of the outputs: ends of the range, outputs that stand still, codes that stick.

One hold cannot tell a clipped or frozen output from a coarse one; the others show how far it reaches and what noise it has.

*Noise* of s steps is the lower quartile of the holds' sigma, that of rounding, step^2 / 12, taken off. Two neighbouring codes
show up to half a step of scatter whatever the noise is: below 0.6 steps nothing is known of it, and an output that stands still
is a coarse one. What it hides is spread evenly over a step: sigma is step / sqrt(12), and no averaging makes it less.

*Standing still.* Gaussian noise gives no code more than the share p = erf(1 / (s sqrt(8))) of the samples, so an output keeps
one value through r of m cells by chance at most m p^r. Cells are counted and not samples, which may depend on each other. Below
one in a million it was not read anew. Where no output changes through a whole hold, none shows that the instrument lives.

*Ends.* Let a share f of a hold's samples stand at its own highest (or lowest) value. Noise would put f there only where the
upper edge of that step lies z(f) + 1/s sigmas above the mean, z the inverse of the tail Q, and then puts Q(z(f) + 1/s) beyond.
That none of n independent samples is beyond has the chance (1 - Q(z(f) + 1/s))^n; n follows from what the means of the cells
scatter. Vibration of one amplitude piles up at both ends, clipping at one. Where nothing in the session lies beyond, moves
included, the place is an end of the range, and it applies to every hold, those before included. Clipping a share q takes
sigma (phi(z) - z q), z = z(q), from the mean.

*Codes that stick.* That k of n draws have a value with the share p has at most the chance exp(-n D(k/n, p)), D the relative
entropy [1]_; p is twice the share above, 10 % at least.

References
----------
.. [1] H. Chernoff, "A measure of asymptotic efficiency for tests of a hypothesis based on the sum of observations", Ann. Math.
   Statist. 23(4), 1952.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from statistics import NormalDist

import numpy as np

from imufield.calibrate.model.observations import ROUNDING
from imufield.dataclass import replace
from imufield.guide import refusals
from imufield.guide.events import RefusalCode
from imufield.guide.hold.checks import CLIPPED_SAMPLES, CLIPPED_SHARE
from imufield.guide.hold.observe import Observation
from imufield.guide.hold.output import HoldOutput
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import Cells
from imufield.samples import AXES, CELL_S, FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_UNLIKELY = 1e-6  # Chance of a hold without a fault.
_STALL_CELLS = 5  # Shorter ones are slow instruments, whose reader repeats what it has.
_ONE_SIDED = 3.0  # Samples at one end over those at the other: noise and vibration reach both.
_LEAST_NOISE = 0.6  # Of a step: less may be two neighbouring codes.
_QUIET = 0.25  # Share of the holds that are quieter than the noise taken: some tremble.
# Times the share that Gaussian noise gives its commonest code: tails of other noise are longer, and a hold quieter than most.
_COMMON = 2.0
_LEAST_COMMON = 0.1  # The same at least: an output finer than its digits shows finer steps than it has.
_HOLDS_KEPT = 1000  # A day of holds: memory and work do not grow with the session.
_NORMAL = NormalDist()
_End = tuple[int, bool, float]  # Axis of the accelerometer, whether the high end, value.


class Outputs:
    """The outputs of a session."""

    def __init__(self) -> None:
        self._low = np.full(6, np.nan)
        self._high = np.full(6, np.nan)
        self._step = np.full(6, np.inf)
        self._noted: tuple[Cells, int, int] | None = None  # Rows that these do not know yet: first and behind the last.
        self._holds: deque[HoldOutput] = deque(maxlen=_HOLDS_KEPT)
        self._shown: tuple[list[float], set[_End]] | None = None  # What they show, until there is another.

    def follow(self, cells: Cells, rows: slice = slice(None)) -> None:
        """Add cells, still or not."""
        begin, end, _ = rows.indices(len(cells))
        noted = self._noted
        if noted is not None and noted[0] is cells and noted[2] == begin:
            self._noted = cells, noted[1], end
        else:
            self._work_out()
            self._noted = cells, begin, end

    def _work_out(self) -> None:
        """Take the extremes and steps of what was noted: cell by cell they would cost as much as those of a block."""
        if self._noted is not None:
            cells, begin, end = self._noted
            self._low = np.fmin(self._low, np.fmin.reduce(cells.low[begin:end]))
            self._high = np.fmax(self._high, np.fmax.reduce(cells.high[begin:end]))
            self._step = np.minimum(self._step, np.minimum.reduce(cells.step[begin:end]))
            self._noted = None

    @property
    def extremes(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest output so far, shape (6,) each; NaN without one."""
        self._work_out()
        return self._low, self._high

    @property
    def step(self) -> FloatArray:
        """Smallest step of each output so far, shape (6,); inf where none was seen."""
        self._work_out()
        return self._step

    def add(self, hold: HoldOutput, *, again: bool = False) -> None:
        """Add a hold, whether it counts or not; ``again``: in place of the one before, where the unit still is."""
        if again and self._holds:
            self._holds.pop()
        self._holds.append(hold)
        self._shown = None

    def refusal(self, hold: HoldOutput, found: Refusal | None = None) -> Refusal | None:
        """Return why a hold does not count, by all that the session has shown so far; None where it does.

        ``found`` is the refusal without the other holds. It stands but for one: an output that stopped explains a wrong norm.
        """
        if found is not None and found.reason is not RefusalCode.GRAVITY:
            return found
        noise, piles = self._evidence()
        if hold.run_of_all == hold.cells or _stalls(hold.run_of_all, max(noise), hold):
            return refusals.FROZEN.refusal(hold.run_of_all * CELL_S, 0.0)
        for column in range(6):
            if _stalls(int(hold.run[column]), noise[column], hold) and not _is_rounded_off(column, hold):
                reading, sigma = float(hold.commonest[column]), float(noise[column] * self.step[column])
                return refusals.STUCK.refusal(0.0, sigma, axis=AXES[column % 3], triad=_triad(column), reading=reading)
        for end, count, _ in _ends(hold):
            share = count / hold.samples
            if count >= CLIPPED_SAMPLES and share > CLIPPED_SHARE and end in piles and self._is_outermost(end):
                kind, axis = refusals.SATURATED_ON_AXIS, AXES[end[0]]
                return kind.refusal(100 * share, 100 * CLIPPED_SHARE, axis=axis, triad=_triad(end[0]))
        return found

    def with_resolution(self, observation: Observation) -> Observation:
        """Return an observation whose outputs that stood still are known to the step that the session shows."""
        # An output that never changed has the step of the others of its triad.
        triads = np.where(np.isfinite(self.step), self.step, 0.0).reshape(2, 3)
        step = np.where(triads > 0, triads, triads.max(axis=1, keepdims=True)).ravel()
        rounding = np.where(observation.output.still, ROUNDING * step, 0.0)
        least = rounding**2
        force, rate = observation.covariance_raw, observation.gyroscope_covariance_raw
        return replace(
            observation,
            covariance_raw=force + np.diag(np.maximum(least[:3] - np.diag(force), 0.0)),
            gyroscope_covariance_raw=rate + np.diag(np.fmax(least[3:] - np.diag(rate), 0.0)),
            gyroscope_rounding_raw=np.maximum(observation.gyroscope_rounding_raw, rounding[3:]),
        )

    def sticking(self) -> tuple[Sentence, ...]:
        """Return a sentence for each output whose codes stick, with the hold that shows it best."""
        (noise, _), worst = self._evidence(), dict[int, tuple[float, float, float]]()
        for hold in self._holds:
            for column, (value, count) in enumerate(zip(hold.commonest.tolist(), hold.begun_with_it.tolist(), strict=True)):
                if _stalls(int(hold.run[column]), noise[column], hold) or _is_rounded_off(column, hold):
                    continue
                share = count / hold.cells
                limit = max(_COMMON * _most_common(noise[column]), _LEAST_COMMON)
                at_an_end = value in [end[column] for end in self.extremes]
                if not at_an_end and share > limit and hold.cells * _entropy(share, limit) > -math.log(_UNLIKELY):
                    worst[column] = max(worst.get(column, (0.0, 0.0, 0.0)), (share, limit, value))
        return tuple(
            sentence(
                "outputs.sticks",
                triad=_triad(column),
                axis=AXES[column % 3],
                value=value,
                percent=100 * share,
                limit=100 * limit,
            )
            for column, (share, limit, value) in sorted(worst.items())
        )

    def _evidence(self) -> tuple[list[float], set[_End]]:
        """Return the noise of each output in steps of it, 0 where it is not known, and the ends at which outputs stopped."""
        if self._shown is None:
            noise = [self._noise_steps(column) for column in range(6)]
            self._shown = noise, {end for hold in self._holds for end in _piles(hold, noise)}
        return self._shown

    def _noise_steps(self, column: int) -> float:
        # A hold in which the output mostly stood still shows none.
        sigma = [float(hold.sigma[column]) for hold in self._holds if hold.sigma[column] > 0]
        quiet = float(np.quantile(sigma, _QUIET, method="lower") / self.step[column]) if sigma else 0.0
        return math.sqrt(quiet**2 - 1 / 12) if quiet > _LEAST_NOISE else 0.0

    def _is_outermost(self, end: _End) -> bool:
        axis, is_high, value = end
        return bool(value == self.extremes[is_high][axis])


def _ends(hold: HoldOutput) -> Iterator[tuple[_End, int, int]]:
    """Yield both ends of the three axes with the samples there and those at the other end."""
    for axis in range(3):
        low, high = int(hold.at_low[axis]), int(hold.at_high[axis])
        yield (axis, False, float(hold.low[axis])), low, high
        yield (axis, True, float(hold.high[axis])), high, low


def _piles(hold: HoldOutput, noise: list[float]) -> Iterator[_End]:
    """Yield the ends at which the output stopped."""
    for end, count, other in _ends(hold):
        one_sided = hold.still[end[0]] or count > _ONE_SIDED * other
        if one_sided and _chance(count / hold.samples, noise[end[0]], hold, end[0]) < _UNLIKELY:
            yield end


def _chance(share: float, noise_steps: float, hold: HoldOutput, axis: int) -> float:
    """Return the chance that noise puts a share of a hold at its outermost value and nothing beyond."""
    if noise_steps == 0:
        return 1.0
    upper_edge = _NORMAL.inv_cdf(1 - min(share, 1 - 0.5 / hold.samples)) + 1 / noise_steps
    return float(_NORMAL.cdf(upper_edge) ** hold.independent[axis])


def _stalls(run: int, noise_steps: float, hold: HoldOutput) -> bool:
    """Whether an output with noise did not change for so many cells in a row that it was not read."""
    return run >= _STALL_CELLS and hold.cells * _most_common(noise_steps) ** run < _UNLIKELY


def _is_rounded_off(column: int, hold: HoldOutput) -> bool:
    """Whether it is a gyroscope's zero, which some instruments show for every slow rate."""
    return column >= 3 and float(hold.commonest[column]) == 0.0


def _most_common(noise_steps: float) -> float:
    """Return the largest share of the samples that Gaussian noise gives to one code; 1 where it is not known."""
    return math.erf(1 / (noise_steps * math.sqrt(8))) if noise_steps else 1.0


def _entropy(share: float, expected: float) -> float:
    """Return the relative entropy of two shares; ``expected`` is below 1."""
    rest = (1 - share) * math.log((1 - share) / (1 - expected)) if share < 1 else 0.0
    return share * math.log(share / expected) + rest


def _triad(column: int) -> str:
    return "accelerometer" if column < 3 else "gyroscope"
