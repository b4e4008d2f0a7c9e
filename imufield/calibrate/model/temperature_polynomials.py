"""How bias and scale of a triad go with its temperature.

With d degrees C above the reference, the temperature at which the other parameters hold, the raw output is

    N(d) - raw_zero = (1 + k(d)) (N(0) - raw_zero + K B(d))

``N(0)`` is what the same motion gives at the reference, ``B`` the change of the bias (m/s^2, rad/s), ``k`` the relative one of
the scale. Both are polynomials without a constant term, so that the parameters at the reference stay what they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass
from imufield.samples import FloatArray

HIGHEST_ORDER = 5
"""The bias of an ICM-42688 needs it (ArduPilot#27295); beyond, a polynomial swings between the temperatures measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Polynomials:
    """p(d) = c_1 d + c_2 d^2 + ... of three axes, without a constant term."""

    coefficients: FloatArray
    """Shape (order, 3), row n - 1 in the unit of the quantity per degC^n."""
    covariance: FloatArray
    """Of the coefficients of each axis, shape (3, order, order)."""

    @property
    def order(self) -> int:
        """The highest power of d; 0 where the quantity stays as it is."""
        return len(self.coefficients)

    def at(self, d_degc: FloatArray) -> FloatArray:
        """Return the values for degrees above the reference, of shape (n,) or (n, 3): one for each axis. Shape (n, 3)."""
        if d_degc.ndim == 1:
            return powers(d_degc, self.order) @ self.coefficients
        return np.column_stack([powers(own, self.order) @ of for own, of in zip(d_degc.T, self.coefficients.T, strict=True)])

    def sigma_at(self, d_degc: FloatArray) -> FloatArray:
        """Return 1 sigma of ``at``, shape (n, 3)."""
        V = powers(d_degc, self.order)
        variance: FloatArray = np.einsum("np,apq,nq->na", V, self.covariance, V)
        return np.sqrt(np.maximum(variance, 0.0))


def powers(d_degc: FloatArray, order: int) -> FloatArray:
    """Return d, d^2, ... of shape (n,), shape (n, order)."""
    return np.asarray(np.asarray(d_degc, dtype=np.float64)[:, None] ** np.arange(1, order + 1))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NewDay:
    """What bias and scale at a temperature are known to on a day that was not measured, as sessions on several days show it.

    The parameters at the reference are those of one session, which differs from the days of all by u. What is stated for
    another day is off by u and the errors of the coefficients, which share sessions, and by what that day differs.
    """

    bias: FloatArray
    """From day to day, 1 sigma, m/s^2 or rad/s, shape (3,)."""
    scale: FloatArray
    """The same, relative; NaN where the sessions do not show it."""
    bias_covariance: FloatArray
    """Of u and the coefficients of B, each axis, shape (3, order + 1, order + 1)."""
    scale_covariance: FloatArray
    bias_scale_covariance: FloatArray
    """Between the two, shape (3, order of B + 1, order of k + 1)."""
    bias_freedom: float
    """Degrees of freedom of the scatter that all this comes from."""
    scale_freedom: float

    def bias_sigma_at(self, d_degc: FloatArray) -> FloatArray:
        """Return 1 sigma of the bias for shape (n,) of degrees above the reference, shape (n, 3)."""
        return _sigma_of_day(d_degc, self.bias, self.bias_covariance)

    def scale_sigma_at(self, d_degc: FloatArray) -> FloatArray:
        """Return 1 sigma of the scale, relative, for shape (n,) of degrees above the reference, shape (n, 3)."""
        return _sigma_of_day(d_degc, self.scale, self.scale_covariance)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SessionChanges:
    """What m sessions found of bias and scale themselves, less the session at the reference."""

    temperature_degc: FloatArray
    """Shape (m,)."""
    bias: FloatArray
    """m/s^2 or rad/s, shape (m, 3)."""
    scale: FloatArray
    """Relative, shape (m, 3); NaN where a session does not show it."""


def _sigma_of_day(d_degc: FloatArray, day: FloatArray, covariance: FloatArray) -> FloatArray:
    V = np.column_stack([np.ones(len(d_degc)), powers(d_degc, covariance.shape[1] - 1)])
    variance: FloatArray = np.einsum("np,apq,nq->na", V, covariance, V)
    return np.sqrt(np.maximum(variance, 0.0) + day**2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TriadTemperature:
    """Bias and scale of a triad over temperature."""

    reference_degc: float
    range_degc: tuple[float, float]
    """Measured, lowest and highest: outside, the values at its ends are taken."""
    bias: Polynomials
    """B, m/s^2 or rad/s."""
    scale: Polynomials
    """k, relative."""
    hysteresis: FloatArray
    """1 sigma of the bias by the way to a temperature: half the difference of the branches, shape (3,); NaN: not known."""
    scale_separated: bool
    """False where one pose alone was seen: the drift of the scale, times its specific force, is in the bias."""
    new_day: NewDay | None = None
    """None where no sessions show how days differ: fewer than three, or none to spare."""
    sessions: SessionChanges | None = None
    """None where ramps alone were seen."""
    sensor_offset_degc: FloatArray | None = None
    """The curves belong to each axis' own sensor's temperature less this, shape (3,); None: to that of the instrument."""
    bias_scale_covariance: FloatArray | None = None
    """Of the coefficients of B and k, each axis, shape (3, order of B, order of k); None where it is not known."""

    def degrees_above(self, temperature_degc: FloatArray) -> FloatArray:
        """Return d for temperatures of any shape: clamped into the range, and zero where the temperature is not known."""
        clamped = np.clip(np.asarray(temperature_degc, dtype=np.float64), *self.range_degc)
        return np.asarray(np.where(np.isnan(clamped), 0.0, clamped - self.reference_degc))

    def is_outside(self, temperature_degc: FloatArray) -> NDArray[np.bool_]:
        """Return where a temperature was clamped, shape (n,)."""
        low, high = self.range_degc
        return np.asarray((temperature_degc < low) | (temperature_degc > high))

    def bias_sigma_at(self, temperature_degc: FloatArray) -> FloatArray:
        """Return 1 sigma of the change of the bias from the reference, hysteresis included, shape (n, 3)."""
        return np.hypot(self.bias.sigma_at(self.degrees_above(temperature_degc)), np.nan_to_num(self.hysteresis))

    def sigma_there(
        self, temperature_degc: float, bias_sigma: FloatArray, scale_sigma: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return 1 sigma of bias and scale (relative) at a temperature for those at the reference, all of shape (3,).

        It is that of a day that was not measured, where sessions show how days differ; else that of the reference's own day.
        """
        at_degc = np.array([temperature_degc])
        d_degc = self.degrees_above(at_degc)
        scale_of_own_day = np.hypot(scale_sigma, self.scale.sigma_at(d_degc)[0])
        if self.new_day is None:
            return np.hypot(bias_sigma, self.bias_sigma_at(at_degc)[0]), scale_of_own_day
        of_day = np.hypot(self.new_day.bias_sigma_at(d_degc)[0], np.nan_to_num(self.hysteresis))
        # Never below what the session at the reference states: its gravity is as uncertain on all days.
        scale_of_day = self.new_day.scale_sigma_at(d_degc)[0]
        # Sessions may show how the bias differs from day to day, and not the scale.
        scale = np.where(np.isnan(scale_of_day), scale_of_own_day, np.fmax(scale_sigma, scale_of_day))
        return np.fmax(bias_sigma, of_day), scale

    def covariance_there(self, temperature_degc: float) -> FloatArray:
        """Return the covariance of bias and scale (relative) at a temperature, for what ``sigma_there`` is of, shape (3,).

        What the reference's own day has of it comes to that, where sessions do not show how days differ.
        """
        d_degc = self.degrees_above(np.array([temperature_degc]))
        if self.new_day is not None and np.isfinite(self.new_day.scale).all():
            between, one = self.new_day.bias_scale_covariance, np.ones(1)
        elif self.bias_scale_covariance is not None:
            between, one = self.bias_scale_covariance, np.empty(0)
        else:
            return np.zeros(3)
        V, W = (np.concatenate([one, powers(d_degc, size - len(one))[0]]) for size in between.shape[1:])
        return np.asarray(np.einsum("p,apq,q->a", V, between, W))

    def to_reference(
        self, raw: FloatArray, temperature_degc: FloatArray, *, scale: FloatArray, raw_zero: FloatArray | float
    ) -> FloatArray:
        """Return N(0) for raw outputs N, both of shape (n, 3), at temperatures of shape (n,), or (n, 3) of the axes.

        ``scale`` is K at the reference, shape (3,).
        """
        d_degc = self.degrees_above(temperature_degc)
        unscaled = (raw - raw_zero) / (1 + self.scale.at(d_degc))
        return np.asarray(unscaled + raw_zero - scale * self.bias.at(d_degc))

    def change_at(self, temperature_degc: float) -> tuple[FloatArray, FloatArray]:
        """Return 1 + k and B at a temperature, both of shape (3,)."""
        d_degc = self.degrees_above(np.array([temperature_degc]))
        return 1 + self.scale.at(d_degc)[0], self.bias.at(d_degc)[0]
