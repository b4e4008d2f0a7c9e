"""Polynomials of bias and scale through what sessions and ramps saw.

For each axis, with d degrees above the reference, a session finds bias and scale themselves, up to constants that all sessions
share; a ramp sees both in its output y, up to a constant of its own, as y = (1 + k) (omega + B). With q = k / (1 + k):

    session   bias = beta + B(d),   scale / (1 + scale) = kappa + q(d)        ramp   y = omega + B(d) + y q(d)

That is linear in the coefficients of B and q: one weighted least-squares fit. A ramp alone cannot tell ``B`` from ``y q``;
sessions at two temperatures, or ramps in poses that differ, can. What q leaves beyond a polynomial k of its order is a few ppm.

The orders are those of the lowest Bayesian information criterion [1]_, over the three axes together. The variances given count
as lower bounds: the profile likelihood of one factor f >= 1 on all of them stands in the criterion, so that scatter beyond
them asks for lower orders and luck in few points does not ask for higher ones. Where few rows are free the highest orders are
taken without a choice: the order chosen would be that whose scatter is small by luck, and stated intervals too narrow.

References
----------
.. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.temperature_polynomials import (
    HIGHEST_ORDER,
    NewDay,
    Polynomials,
    SessionChanges,
    TriadTemperature,
    powers,
)
from imufield.calibrate.temperature.scatter import (
    BIAS,
    FEWEST_FREEDOM,
    RAMP,
    SCALE,
    Equations,
    Scatter,
    scatter_of,
    scatter_ratio,
    shares_of,
    whitened,
)
from imufield.dataclass import dataclass, replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

SAME_TEMPERATURE_DEGC = 0.5
"""Temperatures nearer than this are one block: half a degree is what thermometers of instruments are good for."""
WIDEST_GAP_DEGC = 5.0
"""Between the reference and what was measured: beyond, what joins the two is a guess."""
MOST_SCATTER = 4.0
"""Factor on the sigmas given; days that differ as the sessions' own sigma make 2 of it."""
_BIAS_OF_REFERENCE = 0  # Places in a joint covariance; the coefficients follow.
_SCALE_OF_REFERENCE = 1
_STEPS = 21  # Over the range of temperature.
# Free rows of a kind on all axes, those of six sessions or of a ramp. Where the days of three sessions differ by more than the
# slope, the stated 95 % held 92 % after a choice, and 85 % where it was a line.
_FEWEST_TO_CHOOSE = 8.0
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
    sensor_degc: FloatArray | None = None
    """By the sensor of each axis, at its offset of the reference, shape (m, 3); None: as the instrument's."""
    sensor_offset_degc: FloatArray | None = None
    """That offset: the sensor of each axis less the instrument, shape (3,)."""
    reference: int | None = None
    """Which of them is the session whose numbers hold at the reference; None where it is none of these."""

    @property
    def shows_scale(self) -> NDArray[np.bool_]:
        """Which of them show the scale of all axes, shape (m,)."""
        return np.asarray(np.isfinite(self.scale).all(axis=1))

    @property
    def temperatures_of_scale(self) -> int:
        """At how many distinct temperatures they do."""
        return distinct(self.temperature_degc[self.shows_scale])

    def __len__(self) -> int:
        return len(self.temperature_degc)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RampBlocks:
    """What a triad gave in one pose while its temperature changed, as means over n blocks of temperature."""

    temperature_degc: FloatArray
    """Shape (n,)."""
    output: FloatArray
    """Raw output less the raw zero, over the scale at the reference, m/s^2 or rad/s, shape (n, 3)."""
    sigma: FloatArray
    """Of ``output``, shape (n, 3)."""
    direction: FloatArray
    """1 where the temperature rises, -1 where it falls, 0 where it stands, shape (n,)."""
    specific_force_m_s2: FloatArray
    """Along the sensing axes in this pose, shape (3,); zeros for a gyroscope."""

    def __len__(self) -> int:
        return len(self.temperature_degc)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TemperatureFit:
    """Bias and scale of a triad over temperature, and how they were found."""

    temperature: TriadTemperature
    blocks: int
    """Distinct temperatures."""
    factor: float
    """By which sessions or ramps scatter about the polynomials beyond the sigma given; 1 at least."""
    gap_degc: float
    """From the reference to the nearest temperature that was measured: there the polynomials only join the two."""


class Orders(NamedTuple):
    """Highest powers of temperature."""

    bias: int
    scale: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TemperatureData:
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
        bias = min(HIGHEST_ORDER, _highest_order(distinct(self.temperature_degc)))
        scale = 0
        if self.points is not None:
            # Where a ramp sees both, it checks what two sessions say of each.
            scale = _highest_order(self.points.temperatures_of_scale + self.ramps_show_scale)
        if len(self.ramps) > 1 and np.all(np.ptp([ramp.specific_force_m_s2 for ramp in self.ramps], axis=0) > _OTHER_POSE_M_S2):
            scale = max(scale, bias)
        return Orders(max(bias, 0), min(max(scale, 0), HIGHEST_ORDER))

    @property
    def separates_scale(self) -> bool:
        """Whether no drift of the scale can pose as one of the bias: it does in ramps, by the specific force of their pose."""
        return not self.ramps_show_scale or self.highest_orders().scale > 0

    @property
    def ramps_show_scale(self) -> bool:
        """Whether ramps show the scale beside the bias: those of a gyroscope at rest do not."""
        return any(np.any(ramp.specific_force_m_s2) for ramp in self.ramps)


def _highest_order(temperatures: int) -> int:
    """Return the highest order that leaves as many temperatures as it has coefficients: fewer make a small scatter by luck."""
    return (temperatures - 1) // 2


def distinct(temperature_degc: FloatArray) -> int:
    """Return how many temperatures there are that differ."""
    count, first_degc = 0, -math.inf
    for value in sorted(temperature_degc[np.isfinite(temperature_degc)].tolist()):
        if value - first_degc >= SAME_TEMPERATURE_DEGC:
            count, first_degc = count + 1, value
    return count


def fit_temperature(data: TemperatureData) -> TemperatureFit:
    """Return bias and scale of a triad over temperature, of the orders that the data ask for.

    Raises
    ------
    CalibrationError
        If there are fewer than three distinct temperatures: nothing would check a straight line.
    """
    temperature_degc = data.temperature_degc
    blocks = distinct(temperature_degc)
    if data.highest_orders().bias == 0:
        span = float(np.ptp(temperature_degc)) if blocks else 0.0
        raise CalibrationError(sentence("fit.too_few", blocks=blocks, span=span), Reason.TOO_FEW)
    return fit_orders(data, *_chosen_orders(data))


def fit_warnings(found: TemperatureFit, triad: str) -> tuple[str, ...]:
    """Return what keeps a fit from being good."""
    told = []
    if found.factor > MOST_SCATTER:
        told.append(sentence("fit.scatter", triad=triad, factor=found.factor, limit=MOST_SCATTER))
    if found.gap_degc > WIDEST_GAP_DEGC:
        reference = found.temperature.reference_degc
        told.append(sentence("fit.gap", triad=triad, gap=found.gap_degc, reference=reference, limit=WIDEST_GAP_DEGC))
    return tuple(told)


def _chosen_orders(data: TemperatureData) -> Orders:
    """Return the orders with the lowest information criterion, of a kind with few free rows the highest."""
    most_bias, most_scale = data.highest_orders()
    full = [_equations(data, most_bias, most_scale, axis) for axis in range(3)]
    scatter = scatter_of(full)
    white = [whitened(each, scatter.variances) for each in full]
    rows = sum(len(each.values) for each in white)
    # A ramp shows the bias, and of an accelerometer the scale beside it.
    by_ramps = scatter.freedom[RAMP] * np.array([1, data.ramps_show_scale])
    is_open = scatter.freedom[[BIAS, SCALE]] + by_ramps >= _FEWEST_TO_CHOOSE
    criteria: dict[Orders, float] = {}
    for bias in range(0 if is_open[BIAS] else most_bias, most_bias + 1):
        for scale in range(0 if is_open[SCALE] else most_scale, most_scale + 1):
            # Constants come last, and every model has them.
            kept = np.r_[0:bias, most_bias : most_bias + scale, most_bias + most_scale : full[0].matrix.shape[1]]
            misfit = sum(_square(each._replace(matrix=each.matrix[:, kept]).residual()) for each in white)
            beyond = misfit if misfit <= rows else rows * (1 + math.log(misfit / rows))
            criteria[Orders(bias, scale)] = beyond + 3 * (bias + scale) * math.log(rows)
    return min(criteria, key=criteria.__getitem__)


def _square(values: FloatArray) -> float:
    return float(values @ values)


def fit_orders(data: TemperatureData, bias: int, scale: int) -> TemperatureFit:
    """Return the fit of polynomials of these orders."""
    axes = [_equations(data, bias, scale, axis) for axis in range(3)]
    scatter = scatter_of(axes)
    unit = np.concatenate([_span(data) ** -np.arange(1.0, order + 1) for order in (bias, scale)])
    # The unknowns behind the coefficients are constants.
    inverses = [whitened(each, scatter.variances).inverse()[: bias + scale] * unit[:, None] for each in axes]
    coefficients = np.stack([inverse @ each.values for inverse, each in zip(inverses, axes, strict=True)], axis=1)
    shares = np.array([_shares(data.points, axis, *each) for axis, each in enumerate(zip(axes, inverses, strict=True))])
    covariance = np.einsum("s,aspq->apq", scatter.weights, shares)
    of_bias, of_scale = np.r_[_BIAS_OF_REFERENCE, 2 : 2 + bias], np.r_[_SCALE_OF_REFERENCE, 2 + bias : 2 + bias + scale]
    measured_degc = data.temperature_degc
    sensor_degc = None if data.points is None else data.points.sensor_degc
    reached_degc = [data.reference_degc, *measured_degc, *(() if sensor_degc is None else sensor_degc.ravel())]
    range_degc = float(min(reached_degc)), float(max(reached_degc))
    range_d_degc = np.array(range_degc) - data.reference_degc
    temperature = TriadTemperature(
        reference_degc=data.reference_degc,
        range_degc=range_degc,
        bias=Polynomials(coefficients[:bias], _block(covariance, of_bias[1:], of_bias[1:])),
        scale=Polynomials(_scale_of_share(coefficients[bias:], range_d_degc), _block(covariance, of_scale[1:], of_scale[1:])),
        hysteresis=_hysteresis(data.ramps),
        scale_separated=data.separates_scale,
        new_day=None,
        sensor_offset_degc=None if data.points is None else data.points.sensor_offset_degc,
        sessions=None if data.points is None else _changes(data.points),
        bias_scale_covariance=_block(covariance, of_bias[1:], of_scale[1:]),
    )
    if scatter.freedom[BIAS] >= FEWEST_FREEDOM:
        is_shown = scatter.freedom[SCALE] >= FEWEST_FREEDOM
        days = np.sqrt(scatter.variances)
        left = np.array([_variance_in_residuals(data.points, axis, each, scatter.variances) for axis, each in enumerate(axes)])
        d = np.linspace(range_d_degc[0], range_d_degc[1], _STEPS)
        freedom = [
            _freedom(scatter, shares[:, :, of[:, None], of], left[:, kind], kind=kind, d=d)
            for kind, of in ((BIAS, of_bias), (SCALE, of_scale))
        ]
        new_day = NewDay(
            bias=np.full(3, days[BIAS]),
            scale=np.full(3, days[SCALE] if is_shown else np.nan),
            bias_covariance=_block(covariance, of_bias, of_bias),
            scale_covariance=_block(covariance, of_scale, of_scale) * is_shown,
            bias_scale_covariance=_block(covariance, of_bias, of_scale) * is_shown,
            bias_freedom=freedom[BIAS],
            scale_freedom=freedom[SCALE] if is_shown else 0.0,
        )
        temperature = replace(temperature, new_day=new_day)
    gap_degc = float(np.abs(measured_degc - data.reference_degc).min())
    return TemperatureFit(
        temperature=temperature, blocks=distinct(measured_degc), factor=scatter_ratio(axes), gap_degc=gap_degc
    )


def _block(covariance: FloatArray, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> FloatArray:
    return np.asarray(covariance[:, rows[:, None], columns])


def _places(points: SessionPoints, axis: int, equations: Equations) -> NDArray[np.intp]:
    """Return the rows of bias and, where it is shown, scale of the session that stands for the reference."""
    row = points.reference or 0
    place = np.flatnonzero(equations.kind == BIAS)[row]
    return np.arange(place, place + 1 + int(np.isfinite(points.scale[row, axis])))


def _shares(points: SessionPoints | None, axis: int, equations: Equations, inverse: FloatArray) -> FloatArray:
    """Return the shares of the covariance of bias and scale of the reference and of the coefficients, by their inverse."""
    reference = np.zeros((2, len(equations.values)))
    if points is not None:
        places = _places(points, axis, equations)
        reference[range(len(places)), places] = 1.0
    shares = shares_of(np.vstack([reference, inverse]), equations)
    if points is None or points.reference is None:
        # It is none of the sessions, so it has no errors in common with them.
        shares[:, :2, 2:] = shares[:, 2:, :2] = 0.0
    return shares


def _variance_in_residuals(points: SessionPoints | None, axis: int, equations: Equations, variances: FloatArray) -> FloatArray:
    """Return the variance of the part of bias and scale of the reference that residuals of the fit show, shape (2,)."""
    found = np.zeros(2)
    if points is not None and points.reference is not None:
        white, kept = whitened(equations, variances), np.zeros(len(equations.values))
        root = np.linalg.inv(white.root)
        for quantity, place in enumerate(_places(points, axis, equations)):
            kept[: len(root)] = root[place]
            found[quantity] = _square(white._replace(values=kept).residual())
    return found


def _freedom(scatter: Scatter, shares: FloatArray, left: FloatArray, *, kind: int, d: FloatArray) -> float:
    """Return the degrees of freedom of bias or scale of a new day: the middle of those of all axes over the range."""
    V = np.column_stack([np.ones(len(d)), powers(d, shares.shape[-1] - 1)])
    of_day = np.einsum("np,aspq,nq->san", V, shares, V)
    # What is stated for another day is off by what that day differs, too.
    of_day[1 + kind] += 1.0
    return float(median(np.concatenate([scatter.freedom_of(of_day[:, axis], kind, left[axis, None]) for axis in range(3)])))


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


def _span(data: TemperatureData) -> float:
    """Return the largest distance from the reference, degC: powers of d over it are of one size."""
    return float(np.abs(data.temperature_degc - data.reference_degc).max())


def _equations(data: TemperatureData, bias: int, scale: int, axis: int) -> Equations:
    """Return the equations of one axis; the unknowns are B and q in powers of d over the span, then the constants."""
    points, ramps, span = data.points, data.ramps, _span(data)
    unknowns = bias + scale + 2 * (points is not None) + len(ramps)
    matrices, values, kinds, own = [np.empty((0, unknowns))], [np.empty(0)], [np.empty(0, np.intp)], np.empty((0, 0))
    if points is not None:
        m = len(points)
        at_degc = points.temperature_degc if points.sensor_degc is None else points.sensor_degc[:, axis]
        d = (at_degc - data.reference_degc) / span
        pairs = np.zeros((m, 2, unknowns))
        pairs[:, 0, :bias], pairs[:, 1, bias : bias + scale] = powers(d, bias), powers(d, scale)
        pairs[:, 0, bias + scale] = pairs[:, 1, bias + scale + 1] = 1.0
        found = np.column_stack([points.bias[:, axis], points.scale[:, axis] / (1 + points.scale[:, axis])]).ravel()
        shown = np.isfinite(found)
        every = np.zeros((m, 2, m, 2))
        every[range(m), :, range(m)] = points.covariance[:, axis]
        own = every.reshape(2 * m, 2 * m)[np.ix_(shown, shown)]
        matrices.append(pairs.reshape(2 * m, unknowns)[shown])
        values.append(found[shown])
        kinds.append(np.tile([BIAS, SCALE], m)[shown])
    for number, ramp in enumerate(ramps):
        d = (ramp.temperature_degc - data.reference_degc) / span
        block = np.zeros((len(ramp), unknowns))
        block[:, :bias] = powers(d, bias)
        block[:, bias : bias + scale] = ramp.output[:, axis, None] * powers(d, scale)
        block[:, unknowns - len(ramps) + number] = 1.0
        matrices.append(block)
        values.append(ramp.output[:, axis])
        kinds.append(np.full(len(ramp), RAMP))
    return Equations(
        matrix=np.vstack(matrices),
        values=np.concatenate(values),
        own=own,
        sigma=np.concatenate([np.empty(0), *(ramp.sigma[:, axis] for ramp in ramps)]),
        kind=np.concatenate(kinds),
    )


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
