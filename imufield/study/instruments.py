"""The simulated instruments that stand in for the hardware of the two papers, and the measurements made with them.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: Table 1 (true values).
.. [2] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: Tables 1 and 3 (separate calibration, taken as true values here; bounds).
"""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.model.models import (
    BIAS,
    MISALIGNMENT,
    PARAMETERS,
    QUADRATIC,
    SCALE,
    from_vector,
    predict,
    unit_diagonal_matrices,
)
from imufield.calibrate.model.result import QuadraticAxes
from imufield.calibrate.solvers.triad_costs import TriadProblem, TurnsProblem
from imufield.dataclass import dataclass
from imufield.earth import EARTH_RATE_RAD_S, MICRO_G_M_S2, normal_gravity
from imufield.guide.positions import scheme
from imufield.samples import FloatArray

HARBIN_LATITUDE_DEG = 45.77
"""Where [1]_ was written; the paper gives no latitude."""
BEIJING_LATITUDE_DEG = 39.98
"""Where [2]_ was written; the paper gives no latitude."""

BSAS_GRAVITY_M_S2 = normal_gravity(HARBIN_LATITUDE_DEG)
BSAS_TRUTH = np.array([
    -734.949141, -738.738914, -714.409875,
    0.00654668, -0.04285332, 0.01471738,
    # Eq. 9 names the entries of T in the order xy, xz, yx, yz, zx, zy: S_axz, S_axy, S_ayz, S_ayx, S_azy, S_azx. The paper
    # heads them "(deg)", but its equations use them as they are.
    0.00050230, 0.00068317, -0.00048500, -0.00035363, 0.00023193, -0.00003365,
    0.003654, 0.000644, -0.002654,
])  # fmt: skip
"""Table 1 of [1]_, in the order of ACCELEROMETER_NAMES."""
BSAS_NAMES = (
    "K_ax", "K_ay", "K_az", "b_x0", "b_y0", "b_z0",
    "S_axz", "S_axy", "S_ayz", "S_ayx", "S_azy", "S_azx", "K_2ax", "K_2ay", "K_2az",
)  # fmt: skip
BSAS_AXES: QuadraticAxes = "body"
BSAS_NOISE_M_S2 = 3e-8
"""1 sigma of the norm at each position: with it the truth costs about 5.8e-7 (eq. 13), near the paper's 7.2e-7 to 7.4e-7."""

IDE_GRAVITY_M_S2 = normal_gravity(BEIJING_LATITUDE_DEG)
IDE_TRUTH = np.array([
    13942.35422951, 13345.72485877, 13062.44709817,
    0.00336420, 0.00191168, 0.00271530, -0.00204019, -0.00739421, -0.00044851,
    -206.59251066, 87.24553607, 333.71033323,
])  # fmt: skip
"""Table 1 of [2]_, "separate calibration results", in the order of its eq. 8."""
IDE_LOWER = np.array([13000.0] * 3 + [-0.01] * 6 + [-400.0] * 3)
IDE_UPPER = np.array([14000.0] * 3 + [0.01] * 6 + [400.0] * 3)
IDE_NOISE_M_S2 = 3e-4
"""Per axis and position: puts the optimum of eq. 7 at 0.004 to 0.005, where the paper's IDE ends."""

GYROSCOPE_TRUTH = np.array([
    7921.74760617, 7911.54386049, 7924.57007346,
    -0.00489132, 0.00096090, 0.00058152, 0.00018519, 0.00449350, 0.00137873,
    -208.33680363, -33.24299533, -54.56475774,
])  # fmt: skip
"""Table 3 of [2]_; pulses per deg/s are assumed, the paper does not say."""
GYROSCOPE_LOWER = np.array([7800.0] * 3 + [-0.01] * 6 + [-500.0] * 3)
GYROSCOPE_UPPER = np.array([8000.0] * 3 + [0.01] * 6 + [100.0] * 3)
GYROSCOPE_ARW_DEG_PER_ROOT_HOUR = 0.003
DEG_H_PER_DEG_S = 3600.0
NOMINAL_GYROSCOPE_SCALE = 7900.0
"""Middle of the bounds."""
STATIC_HOLD_S = 60.0
TURN_RATES_DEG_S = (10.0, 20.0, 30.0)
TURN_SECONDS = 72.0
"""Two whole turns at 10 deg/s; the paper says n circles."""


@dataclass(frozen=True, slots=True)
class PresetError:
    """How far the preset may be off, each entry drawn uniformly within plus and minus this."""

    scale: float
    """Share of K."""
    bias_m_s2: float
    misalignment_rad: float
    quadratic: float
    """Share of K2."""

    def of_each(self) -> FloatArray:
        """Return the size of the error of each parameter of [1]_, shape (15,)."""
        size = np.empty(PARAMETERS)
        size[SCALE] = self.scale * np.abs(BSAS_TRUTH[SCALE])
        size[BIAS] = self.bias_m_s2
        size[MISALIGNMENT] = self.misalignment_rad
        size[QUADRATIC] = self.quadratic * np.abs(BSAS_TRUTH[QUADRATIC])
        return size


FIELD_PRESET = PresetError(500e-6, 1000 * MICRO_G_M_S2, 100e-6, 1.0)
"""An instrument long after its factory calibration: 500 ppm, 1 mg, 100 urad, all of K2."""


def bsas_directions(name: str = "paper24") -> FloatArray:
    """Return the "up" directions of a scheme, shape (m, 3)."""
    return scheme(name).directions()


def bsas_outputs(rng: np.random.Generator, noise_m_s2: float = BSAS_NOISE_M_S2, positions: str = "paper24") -> FloatArray:
    """Return mean outputs of the instrument of [1]_ at rest, shape (m, 3), noise given as sigma of the norm."""
    a = bsas_directions(positions) * BSAS_GRAVITY_M_S2
    clean = predict(from_vector(BSAS_TRUTH, None, BSAS_AXES), a)
    # The norm sees the noise along the direction that points up, which has the sigma of each axis; K makes it raw units.
    return clean + BSAS_TRUTH[SCALE] * noise_m_s2 * rng.standard_normal(a.shape)


def bsas_preset(rng: np.random.Generator, error: PresetError = FIELD_PRESET) -> FloatArray:
    """Return the true parameters of [1]_, off by ``error``, shape (15,)."""
    return BSAS_TRUTH + error.of_each() * rng.uniform(-1, 1, PARAMETERS)


def ide_problem(rng: np.random.Generator, noise_m_s2: float = IDE_NOISE_M_S2) -> TriadProblem:
    """Return the accelerometer problem of [2]_ (eq. 7) with fresh noise."""
    # Noise on the inputs, in m/s^2 per axis; the outputs follow by eq. 1.
    a = bsas_directions() * IDE_GRAVITY_M_S2
    a = a + noise_m_s2 * rng.standard_normal(a.shape)
    return TriadProblem(triad_outputs(IDE_TRUTH, a), IDE_GRAVITY_M_S2, IDE_LOWER, IDE_UPPER)


def triad_outputs(truth: FloatArray, inputs: FloatArray) -> FloatArray:
    """Return N = K E w + n0 (eq. 1 and 3 of [2]_), shape (m, 3)."""
    turned = inputs @ unit_diagonal_matrices(truth[None, 3:9])[0].T
    outputs: FloatArray = turned * truth[:3] + truth[9:]
    return outputs


def static_rates_deg_s(latitude_deg: float = BEIJING_LATITUDE_DEG) -> FloatArray:
    """Return the Earth's rate in the body frame at the 24 positions, rotation axis north as in [2]_, shape (24, 3)."""
    latitude = math.radians(latitude_deg)
    rate = math.degrees(EARTH_RATE_RAD_S)
    up = bsas_directions()
    # Each position of the scheme has one body axis horizontal; that axis points north.
    names = [position.name[0] for position in scheme("paper24").positions]
    north = np.eye(3)[["xyz".index(name) for name in names]]
    return rate * (math.cos(latitude) * north + math.sin(latitude) * up)


def gyroscope_static_problem(rng: np.random.Generator) -> TriadProblem:
    """Return the static gyroscope problem of [2]_ (L_g of eq. 7), rates in deg/h: K is in pulses per deg/h."""
    rates = static_rates_deg_s() * DEG_H_PER_DEG_S
    # A random walk of N deg/sqrt(h) leaves N sqrt(3600 / T) deg/h in the mean of T seconds.
    noise = GYROSCOPE_ARW_DEG_PER_ROOT_HOUR * math.sqrt(3600 / STATIC_HOLD_S)
    rates = rates + noise * rng.standard_normal(rates.shape)
    truth, lower, upper = (per_deg_h(x) for x in (GYROSCOPE_TRUTH, GYROSCOPE_LOWER, GYROSCOPE_UPPER))
    return TriadProblem(triad_outputs(truth, rates), math.degrees(EARTH_RATE_RAD_S) * DEG_H_PER_DEG_S, lower, upper)


def per_deg_h(x: FloatArray) -> FloatArray:
    """Return parameters with K in pulses per deg/h instead of pulses per deg/s, shape (9,) or (12,)."""
    return np.concatenate([x[:3] / DEG_H_PER_DEG_S, x[3:]])


def gyroscope_turns_problem(rng: np.random.Generator, form: str) -> TurnsProblem:
    """Return the dynamic gyroscope problem: both ways about each axis at three rates (nine pairs)."""
    rates = np.concatenate([np.eye(3) * rate for rate in TURN_RATES_DEG_S])
    # N / 60 deg/sqrt(s), so N / 60 / sqrt(T) deg/s in the mean of a turn, sqrt(2) of that in a difference.
    noise = GYROSCOPE_ARW_DEG_PER_ROOT_HOUR / 60 / math.sqrt(TURN_SECONDS)
    # Earth rate and bias are the same in both turns of a pair and cancel in the difference (eq. 23 to 25).
    difference = 2 * (triad_outputs(GYROSCOPE_TRUTH, rates) - GYROSCOPE_TRUTH[9:])
    difference = difference + math.sqrt(2) * noise * GYROSCOPE_TRUTH[:3] * rng.standard_normal(rates.shape)
    lower, upper = GYROSCOPE_LOWER[:9], GYROSCOPE_UPPER[:9]
    return TurnsProblem(
        difference=difference,
        rate=rates,
        lower=lower,
        upper=upper,
        form="norm" if form == "norm" else "vector",
        unit=NOMINAL_GYROSCOPE_SCALE,
    )
