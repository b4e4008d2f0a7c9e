"""Polynomials of bias and scale through what sessions and ramps saw.

For each axis, with d degrees above the reference, a session finds bias and scale themselves, up to constants that all sessions
share; a ramp sees both in its output y, up to a constant of its own, as y = (1 + k) (omega + B). With q = k / (1 + k):

    session   bias = beta + B(d),   scale / (1 + scale) = kappa + q(d)        ramp   y = omega + B(d) + y q(d)

That is linear in the coefficients of B and q: one weighted least-squares fit. A ramp alone cannot tell ``B`` from ``y q``;
sessions at two temperatures, or ramps in poses that differ, can. What q leaves beyond a polynomial k of its order is a few ppm.

The orders are those of the lowest Bayesian information criterion [1]_, over the three axes together. The variances given count
as lower bounds: the profile likelihood of one factor f >= 1 on all of them stands in the criterion, so that scatter beyond
them asks for lower orders and luck in few points does not ask for higher ones.

References
----------
.. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.temperature import (
    HIGHEST_ORDER,
    NewDay,
    Polynomials,
    SessionChanges,
    TriadTemperature,
    powers,
)
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

SAME_TEMPERATURE_DEGC = 0.5
"""Temperatures nearer than this are one block: half a degree is what thermometers of instruments are good for."""
WIDEST_GAP_DEGC = 5.0
"""Between the reference and what was measured: beyond, what joins the two is a guess."""
MOST_SCATTER = 4.0
"""Factor on the sigmas given; days that differ as the sessions' own sigma make 2 of it."""
_FEWEST_FREEDOM = 0.5  # Of one kind of rows: with fewer the others fit them, and they show no scatter.
_OTHER_POSE_M_S2 = 0.5 * STANDARD_GRAVITY_M_S2  # Along each axis: below, bias and scale share what the ramps see.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SessionPoints:
    """What sessions at m temperatures found of a triad."""

    temperature_degc: FloatArray
    """Shape (m,)."""
    bias: FloatArray
    """m/s^2 or rad/s, shape (m, 3)."""
    scale: FloatArray
    """Relative to the scale at the reference, less 1, shape (m, 3); NaN where a session does not show it."""
    covariance: FloatArray
    """Of bias and scale of each axis, shape (m, 3, 2, 2)."""
    reference: int | None = None
    """Which of them is the session whose numbers hold at the reference; None where it is none of these."""

    def __len__(self) -> int:
        return len(self.temperature_degc)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RampBlocks:
    """What a triad gave in one pose while its temperature changed, as means over n blocks of temperature."""

    temperature_degc: FloatArray
    """Shape (n,)."""
    output: FloatArray
    """Raw output over the scale at the reference, m/s^2 or rad/s, shape (n, 3)."""
    sigma: FloatArray
    """Of ``output``, shape (n, 3)."""
    direction: FloatArray
    """1 where the temperature rises, -1 where it falls, 0 where it stands, shape (n,)."""
    specific_force_m_s2: FloatArray
    """Along the sensing axes in this pose, shape (3,); zeros for a gyroscope."""

    def __len__(self) -> int:
        return len(self.temperature_degc)


_BIAS, _SCALE, _RAMP = range(3)


class _System(NamedTuple):
    """Whitened equations of one axis: rows by unknowns, and what they must give."""

    matrix: FloatArray
    values: FloatArray
    kind: NDArray[np.intp]
    """Of each row: bias or scale of a session, or a ramp."""


class _Scatter(NamedTuple):
    """Scatter of bias and scale of sessions, and of ramps, about the polynomials."""

    factor: FloatArray
    """On the sigma given, 1 at least, shape (3,)."""
    freedom: FloatArray
    """Degrees of freedom, shape (3,)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TemperatureFit:
    """Bias and scale of a triad over temperature, and how they were found."""

    temperature: TriadTemperature
    blocks: int
    """Distinct temperatures."""
    factor: float
    """By which the scatter about the polynomials is beyond the sigma given; 1 at least."""
    gap_degc: float
    """From the reference to the nearest temperature that was measured: there the polynomials only join the two."""


class Orders(NamedTuple):
    """Highest powers of temperature."""

    bias: int
    scale: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Evidence:
    """All that is known of a triad over temperature."""

    reference_degc: float
    points: SessionPoints | None = None
    ramps: Sequence[RampBlocks] = ()

    @property
    def temperature_degc(self) -> FloatArray:
        """Every temperature that there is."""
        points = () if self.points is None else (self.points.temperature_degc,)
        return np.concatenate([np.empty(0), *points, *(ramp.temperature_degc for ramp in self.ramps)])

    def highest_orders(self) -> Orders:
        """Return the highest order of bias and of scale that these temperatures and poses can show."""
        bias = min(HIGHEST_ORDER, distinct(self.temperature_degc) - 2)
        scale = 0
        if self.points is not None:
            seen = distinct(self.points.temperature_degc[np.isfinite(self.points.scale).all(axis=1)])
            # Where a ramp sees both, it checks what two sessions say of each.
            scale = seen - 2 + self._ramps_feel
        if len(self.ramps) > 1 and np.all(np.ptp([ramp.specific_force_m_s2 for ramp in self.ramps], axis=0) > _OTHER_POSE_M_S2):
            scale = max(scale, bias)
        return Orders(max(bias, 0), min(max(scale, 0), HIGHEST_ORDER))

    @property
    def separates_scale(self) -> bool:
        """Whether no drift of the scale can pose as one of the bias: it does in ramps, by the specific force of their pose."""
        return not self._ramps_feel or self.highest_orders().scale > 0

    @property
    def _ramps_feel(self) -> bool:
        """Whether ramps show the scale beside the bias: those of a gyroscope at rest do not."""
        return any(np.any(ramp.specific_force_m_s2) for ramp in self.ramps)


def distinct(temperature_degc: FloatArray) -> int:
    """Return how many temperatures there are that differ."""
    count, first_degc = 0, -math.inf
    for value in sorted(temperature_degc[np.isfinite(temperature_degc)].tolist()):
        if value - first_degc >= SAME_TEMPERATURE_DEGC:
            count, first_degc = count + 1, value
    return count


def fit_temperature(evidence: Evidence) -> TemperatureFit:
    """Return bias and scale of a triad over temperature, of the orders that the data ask for.

    Raises
    ------
    CalibrationError
        If there are fewer than three distinct temperatures: nothing would check a straight line.
    """
    temperature_degc = evidence.temperature_degc
    blocks = distinct(temperature_degc)
    if evidence.highest_orders().bias == 0:
        span = float(np.ptp(temperature_degc)) if blocks else 0.0
        raise CalibrationError(sentence("fit.too_few", blocks=blocks, span=span), Reason.TOO_FEW)
    return fit_orders(evidence, *_chosen_orders(evidence))


def fit_warnings(found: TemperatureFit, triad: str) -> tuple[str, ...]:
    """Return what keeps a fit from being good."""
    told = []
    if found.factor > MOST_SCATTER:
        told.append(sentence("fit.scatter", triad=triad, factor=found.factor, limit=MOST_SCATTER))
    if found.gap_degc > WIDEST_GAP_DEGC:
        reference = found.temperature.reference_degc
        told.append(sentence("fit.gap", triad=triad, gap=found.gap_degc, reference=reference, limit=WIDEST_GAP_DEGC))
    return tuple(told)


def _chosen_orders(evidence: Evidence) -> Orders:
    """Return the orders with the lowest information criterion."""
    most_bias, most_scale = evidence.highest_orders()
    full = [_system(evidence, most_bias, most_scale, axis) for axis in range(3)]
    rows = sum(len(system.values) for system in full)
    criteria: dict[Orders, float] = {}
    for bias in range(most_bias + 1):
        for scale in range(most_scale + 1):
            # Constants come last, and every model has them.
            kept = np.r_[0:bias, most_bias : most_bias + scale, most_bias + most_scale : full[0].matrix.shape[1]]
            misfit = sum(_misfit(system._replace(matrix=system.matrix[:, kept])) for system in full)
            beyond = misfit if misfit <= rows else rows * (1 + math.log(misfit / rows))
            criteria[Orders(bias, scale)] = beyond + 3 * (bias + scale) * math.log(rows)
    return min(criteria, key=criteria.__getitem__)


def _misfit(system: _System) -> float:
    solution = np.linalg.lstsq(system.matrix, system.values, rcond=None)[0]
    return float(np.sum((system.values - system.matrix @ solution) ** 2))


def fit_orders(evidence: Evidence, bias: int, scale: int) -> TemperatureFit:
    """Return the fit of polynomials of these orders."""
    systems = [_system(evidence, bias, scale, axis) for axis in range(3)]
    spare = sum(len(system.values) - system.matrix.shape[1] for system in systems)
    factor = math.sqrt(max(1.0, sum(map(_misfit, systems)) / max(spare, 1)))
    span = _span(evidence)
    unit = np.concatenate([span ** -np.arange(1.0, order + 1) for order in (bias, scale)])
    coefficients, covariances = np.zeros((bias + scale, 3)), np.zeros((3, bias + scale, bias + scale))
    scatter, inverses = _scatter(systems), []
    for axis, system in enumerate(systems):
        inverse = np.linalg.pinv(system.matrix)[: bias + scale] * unit[:, None]
        coefficients[:, axis] = inverse @ system.values
        # Days that differ, and blocks of a ramp that do, have errors of their own sizes.
        inverses.append(inverse * scatter.factor[system.kind])
        covariances[axis] = inverses[-1] @ inverses[-1].T
    measured_degc = evidence.temperature_degc
    range_degc = (
        min(float(measured_degc.min()), evidence.reference_degc),
        max(float(measured_degc.max()), evidence.reference_degc),
    )
    temperature = TriadTemperature(
        reference_degc=evidence.reference_degc,
        range_degc=range_degc,
        bias=Polynomials(coefficients[:bias], covariances[:, :bias, :bias]),
        scale=Polynomials(
            _scale_of_share(coefficients[bias:], np.array(range_degc) - evidence.reference_degc), covariances[:, bias:, bias:]
        ),
        hysteresis=_hysteresis(evidence.ramps),
        scale_separated=evidence.separates_scale,
        new_day=None if evidence.points is None else _new_day(evidence.points, scatter, inverses, bias),
        sessions=None if evidence.points is None else _changes(evidence.points),
    )
    gap_degc = float(np.abs(measured_degc - evidence.reference_degc).min())
    return TemperatureFit(temperature=temperature, blocks=distinct(measured_degc), factor=factor, gap_degc=gap_degc)


def _scatter(systems: Sequence[_System]) -> _Scatter:
    """Return how far the rows of each kind are from the fit."""
    squares, freedom = np.zeros(3), np.zeros(3)
    for matrix, values, kind in systems:
        hat = matrix @ np.linalg.pinv(matrix)
        squares += np.bincount(kind, (values - hat @ values) ** 2, minlength=3)
        freedom += np.bincount(kind, 1 - np.diagonal(hat), minlength=3)
    shown = freedom >= _FEWEST_FREEDOM
    factor = np.sqrt(np.maximum(squares, freedom) / np.where(shown, freedom, 1.0))
    return _Scatter(np.where(shown, factor, 1.0), np.where(shown, freedom, 0.0))


def _new_day(points: SessionPoints, scatter: _Scatter, inverses: Sequence[FloatArray], bias: int) -> NewDay | None:
    """Return how bias and scale of a day that was not measured differ, by inverses whose rows are the coefficients."""
    if not scatter.freedom[_BIAS]:
        return None
    order = len(inverses[0])
    days, covariances = np.full((2, 3), np.nan), np.zeros((2, 3, order + 1, order + 1))
    row = points.reference or 0
    for axis, inverse in enumerate(inverses):
        shown = np.isfinite(points.scale[:, axis])
        # Rows of sessions come first: one of each bias, one of each scale that is shown.
        place = row + int(shown[:row].sum())
        kinds = np.array([_BIAS, _SCALE] if shown[row] else [_BIAS])
        # Whitened rows scatter, each kind by its factor; a scale that is correlated with the bias scatters with both.
        own = np.linalg.cholesky(points.covariance[row, axis][np.ix_(kinds, kinds)])
        root = own * scatter.factor[kinds]
        for quantity in kinds if scatter.freedom[_SCALE] else (_BIAS,):
            days[quantity, axis] = np.linalg.norm(own[quantity] * np.sqrt(scatter.factor[kinds] ** 2 - 1))
            covariances[quantity, axis, 0, 0] = root[quantity] @ root[quantity]
            covariances[quantity, axis, 1:, 1:] = inverse @ inverse.T
            if points.reference is not None:
                shared = inverse[:, place : place + len(kinds)] @ root[quantity]
                covariances[quantity, axis, 0, 1:] = covariances[quantity, axis, 1:, 0] = shared
    of_bias, of_scale = np.arange(bias + 1), np.r_[0, bias + 1 : order + 1]
    return NewDay(
        bias=days[_BIAS],
        scale=days[_SCALE],
        bias_covariance=covariances[_BIAS][:, of_bias[:, None], of_bias],
        scale_covariance=covariances[_SCALE][:, of_scale[:, None], of_scale],
        bias_freedom=float(scatter.freedom[_BIAS]),
        scale_freedom=float(scatter.freedom[_SCALE]),
    )


def _changes(points: SessionPoints) -> SessionChanges | None:
    row = points.reference
    if row is None:
        return None
    bias, scale = points.bias - points.bias[row], points.scale - points.scale[row]
    return SessionChanges(temperature_degc=points.temperature_degc, bias=bias, scale=scale)


def _scale_of_share(coefficients: FloatArray, range_d_degc: FloatArray) -> FloatArray:
    """Return the coefficients of k for those of q = k / (1 + k), of the same order."""
    order = len(coefficients)
    V = powers(np.linspace(range_d_degc[0], range_d_degc[1], 10 * HIGHEST_ORDER), order)
    share = V @ coefficients
    return np.asarray(np.linalg.lstsq(V, share / (1 - share), rcond=None)[0], float) if order else coefficients


def _span(evidence: Evidence) -> float:
    """Return the largest distance from the reference, degC: powers of d over it are of one size."""
    return float(np.abs(evidence.temperature_degc - evidence.reference_degc).max())


def _system(evidence: Evidence, bias: int, scale: int, axis: int) -> _System:
    """Return the equations of one axis; the unknowns are B and q in powers of d over the span, then the constants."""
    points, ramps, span = evidence.points, evidence.ramps, _span(evidence)
    constants = 2 * (points is not None) + len(ramps)
    matrices, values, kinds = [], [], list[NDArray[np.intp]]()
    if points is not None:
        d = (points.temperature_degc - evidence.reference_degc) / span
        for row in range(len(points)):
            pair = np.zeros((2, bias + scale + constants))
            pair[0, :bias] = powers(d[row : row + 1], bias)
            pair[1, bias : bias + scale] = powers(d[row : row + 1], scale)
            pair[0, bias + scale] = pair[1, bias + scale + 1] = 1.0
            scaled = points.scale[row, axis]
            found = np.array([points.bias[row, axis], scaled / (1 + scaled)])
            shown = np.isfinite(found)
            white = np.linalg.inv(np.linalg.cholesky(points.covariance[row, axis][np.ix_(shown, shown)]))
            matrices.append(white @ pair[shown])
            values.append(white @ found[shown])
            kinds.append(np.flatnonzero(shown))
    for number, ramp in enumerate(ramps):
        d = (ramp.temperature_degc - evidence.reference_degc) / span
        block = np.zeros((len(ramp), bias + scale + constants))
        block[:, :bias] = powers(d, bias)
        block[:, bias : bias + scale] = ramp.output[:, axis, None] * powers(d, scale)
        block[:, constants + bias + scale - len(ramps) + number] = 1.0
        matrices.append(block / ramp.sigma[:, axis, None])
        values.append(ramp.output[:, axis] / ramp.sigma[:, axis])
        kinds.append(np.full(len(ramp), _RAMP))
    return _System(np.vstack(matrices), np.concatenate(values), np.concatenate(kinds))


def _hysteresis(ramps: Sequence[RampBlocks]) -> FloatArray:
    """Return half the difference between the branches, RMS over the temperatures that both have, shape (3,)."""
    halves, noise = [], []
    for ramp in ramps:
        rising, falling = ramp.direction > 0, ramp.direction < 0
        if rising.sum() < 2 or falling.sum() < 2:
            continue
        up, down = (np.argsort(ramp.temperature_degc[branch]) for branch in (rising, falling))
        up_degc, down_degc = ramp.temperature_degc[rising][up], ramp.temperature_degc[falling][down]
        common = (up_degc >= down_degc[0]) & (up_degc <= down_degc[-1])
        if not common.any():
            continue
        # Rows interpolate the falling branch; their squares its variances.
        there = np.column_stack([np.interp(up_degc[common], down_degc, unit) for unit in np.eye(len(down_degc))])
        halves.append((ramp.output[rising][up][common] - there @ ramp.output[falling][down]) / 2)
        variances = ramp.sigma[rising][up][common] ** 2 + there**2 @ ramp.sigma[falling][down] ** 2
        noise.append(variances / 4)
    if not halves:
        return np.full(3, np.nan)
    # Blocks' own noise is no difference of the branches.
    variance: FloatArray = np.mean(np.vstack(halves) ** 2 - np.vstack(noise), axis=0)
    return np.sqrt(np.maximum(variance, 0.0))
