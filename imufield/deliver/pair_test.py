"""Whether two calibrations of one instrument differ: the largest of all their numbers against what unchanged pairs show.

Each of up to 33 numbers has a difference D and its sigma s. By chance one of 33 is far off more often than a single one,
and sigma is itself found from few residuals. So the whole family is tested at once (max-T, [1]_): the limit is what
``max_k |D_k| / s_k`` of an unchanged pair passes in 5 %. Its distribution is drawn, 20,000 times with a fixed seed:

    D = z_1 + z_2,   s^2 = s_1^2 w_1 + s_2^2 w_2,   z_i normal with the joint covariance of calibration i,
    w_i = chi^2(n_i) / n_i with the degrees of freedom of its sigmas, one draw for all numbers of a triad

(their sigmas come from the same residuals). That is exact for one calibration, and for two the usual answer to the problem of
Behrens and Fisher, with estimated variances in place of true ones.

What both sessions share is no part of it: gravity where both took the same (where not, each adds its own, common to all its
scales), and, where positions and model are the same, what the model leaves out. So sessions of the same positions are compared
in the linear model where their own models differ.

References
----------
.. [1] P. H. Westfall, S. S. Young, "Resampling-Based Multiple Testing", Wiley, 1993: section 2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imufield.calibrate.model.grades import Grade
from imufield.calibrate.sessions.draws import FAMILY_CHANCE, symmetric_root, variance_share
from imufield.calibrate.sessions.kinds import kind_of
from imufield.dataclass import dataclass
from imufield.deliver.parameters.gauge_free import GaugeFree, Number
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray

_DRAWS = 20_000  # They tell the limit to 0.3 % and the chance to 0.15 %.


def typical_turn_on(grade: Grade, name: str) -> float:
    """Return how much a number typically changes from one power-on to another, 1 sigma, in its unit; infinite: not known."""
    biases = {
        "bias": grade.accelerometer.turn_on / MILLI_G_M_S2,
        "gyroscope bias": grade.gyroscope.turn_on / DEG_PER_HOUR_RAD_S,
    }
    return biases.get(kind_of(name), math.inf)


@dataclass(frozen=True, slots=True)
class Change:
    """One number from one calibration to another."""

    name: str
    unit: str
    difference: float
    sigma: float
    """Of the difference."""

    @property
    def in_sigma(self) -> float:
        """The difference in units of its sigma; NaN where that is not known."""
        return self.difference / self.sigma if self.sigma > 0 else math.nan


@dataclass(frozen=True, slots=True)
class Family:
    """The changes from one calibration to another that can be tested, and the limit of the largest of them."""

    changes: tuple[Change, ...]
    limit_sigma: float

    @property
    def beyond(self) -> tuple[Change, ...]:
        """The changes that unchanged calibrations do not show; in 5 % of such pairs there is one all the same."""
        return tuple(change for change in self.changes if abs(change.in_sigma) > self.limit_sigma)

    def exceeds(self, change: Change, turn_on: float) -> bool:
        """Whether a change is beyond what two turn-ons of this size (1 sigma) add to it."""
        return abs(change.difference) > self.limit_sigma * math.hypot(change.sigma, math.sqrt(2) * turn_on)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shared:
    """What two sessions have in common."""

    gravity: bool
    setup: bool
    """Positions and model."""


def compare(old: GaugeFree, new: GaugeFree, shared: Shared) -> tuple[Change, ...]:
    """Return the change of every number that both have, in the same unit."""
    before = {(number.name, number.unit): k for k, number in enumerate(old.numbers)}
    changes = []
    for k, number in enumerate(new.numbers):
        earlier = before.get((number.name, number.unit))
        if earlier is None:
            continue
        variance = _own(old, shared)[earlier, earlier] + _own(new, shared)[k, k]
        if not shared.gravity:
            variance += old.numbers[earlier].common ** 2 + number.common**2
        difference = number.value - old.numbers[earlier].value
        changes.append(Change(number.name, number.unit, difference, math.sqrt(max(variance, 0.0))))
    return tuple(changes)


def family_of(old: GaugeFree, new: GaugeFree, shared: Shared) -> Family:
    """Test whether two calibrations differ."""
    # Without a residual to spare nothing tells how sure sigma is.
    open_ended = {number.name for side in (old, new) for number in side.numbers if not _freedom(number, shared) > 0}
    changes = tuple(change for change in compare(old, new, shared) if change.sigma > 0 and change.name not in open_ended)
    if not changes:
        return Family((), math.inf)
    rng = np.random.default_rng(0)
    sides = [_drawn(side, [change.name for change in changes], rng, shared) for side in (old, new)]
    (error, variance), (more_error, more_variance) = sides
    largest = np.max(np.abs(error + more_error) / np.sqrt(variance + more_variance), axis=1)
    return Family(changes, float(np.quantile(largest, 1 - FAMILY_CHANCE)))


def _own(side: GaugeFree, shared: Shared) -> FloatArray:
    return side.scatter if shared.setup else side.error


def _freedom(number: Number, shared: Shared) -> float:
    return number.scatter_freedom if shared.setup else number.freedom


def _drawn(side: GaugeFree, names: Sequence[str], rng: np.random.Generator, shared: Shared) -> tuple[FloatArray, FloatArray]:
    """Return errors and estimated variances of a calibration, shape (draws, n) each."""
    places = {number.name: k for k, number in enumerate(side.numbers)}
    rows = [places[name] for name in names]
    numbers = [side.numbers[row] for row in rows]
    covariance = _own(side, shared)[np.ix_(rows, rows)]
    error = rng.standard_normal((_DRAWS, len(names))) @ symmetric_root(covariance)
    freedom = np.array([_freedom(number, shared) for number in numbers])
    variance = variance_share(freedom, _DRAWS, rng) * np.maximum(np.diag(covariance), 0.0)
    if not shared.gravity:
        # K goes with 1/g: all scales of a session are off the same way.
        common = np.array([number.common * math.copysign(1.0, number.value) for number in numbers])
        error += rng.standard_normal((_DRAWS, 1)) * common
        variance += common**2
    return error, variance
