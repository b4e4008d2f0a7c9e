"""Effects beyond the error model of an instrument: what a calibration does not fit, one field each."""

from __future__ import annotations

import math

import numpy as np

from imufield.dataclass import dataclass
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects:
    """What an instrument, or a hold, does beside its error model; by default nothing.

    A turn-on adds a constant to the bias, drawn at every power-on from a normal distribution with this 1 sigma, independently
    in each axis: ``b = b_0 + u``, ``u ~ N(0, s^2)`` [1]_.

    A hold that is touched reads the force of the hand with gravity. Of it the norm sees the part along gravity:
    ``f = f_0 (1 + d / |f_0|)``, so ``|f| = g + d`` [2]_.

    Warming up moves the bias by ``w (1 - exp(-t / tau))``: a body loses heat in proportion to its excess [4]_.

    Beside the quadratic term the output of an axis has odd and even terms of its input s in g [5]_: a scale that differs by 2 c
    between the sides adds ``c |s|``, a cubic term ``c s^3``, and cross terms ``c s_j s_k`` of two axes.

    A gyroscope whose scale differs by 2 c between the senses of rotation adds ``c |w|`` to the rate w about an axis, one whose
    scale changes with the rate ``c w^3`` [6]_.

    A converter with codes that stick gives the code ``n - n mod P`` for every n with ``n mod P < W``: of each P codes the first
    W read as the lowest of them, a differential nonlinearity of W - 1 steps, which the histogram of the codes shows [3]_.

    References
    ----------
    .. [1] IEEE Std 528-2019, "Standard for Inertial Sensor Terminology": turn-on to turn-on repeatability of bias.
    .. [2] I. Frosio, F. Pedersini, N. A. Borghese, "Autocalibration of MEMS accelerometers", IEEE Trans. Instrum. Meas. 58(6),
       2009: equation 5, the norm that a position is held against.
    .. [3] IEEE Std 1241-2010, "Terminology and test methods for analog-to-digital converters": code density histogram,
       differential nonlinearity, missing codes.
    .. [4] Newton's law of cooling, for the temperature; the bias follows it linearly.
    .. [5] IEEE Std 1293-2018, "Specification format guide and test procedure for linear single-axis nongyroscopic
       accelerometers": the model equation, with its odd quadratic and cross-coupling coefficients.
    .. [6] IEEE Std 528-2019: scale factor asymmetry and nonlinearity. IEEE Std 952: the model equation, in which the error of
       the scale factor holds a function of the input rate.
    """

    turn_on_m_s2: float = 0.0
    """Turn-on of the accelerometer's bias, 1 sigma of each axis."""
    turn_on_rad_s: float = 0.0
    """Turn-on of the gyroscope's bias, 1 sigma of each axis."""
    warm_up_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How far the bias of each axis of the accelerometer moves."""
    warm_up_s: float = 120.0
    asymmetry: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of each axis, g per g."""
    cubic: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of each axis, g per g^3."""
    cross: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),) * 3
    """Of each pair x y, x z, y z on each axis, g per g^2."""
    gyroscope_asymmetry: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of each axis, rad/s per rad/s."""
    gyroscope_cubic: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of each axis, rad/s per (rad/s)^3."""
    touched_holds: int = 0
    """How many holds of a session are touched."""
    touch_m_s2: float = 0.0
    """By how much the norm of each is off, d; with either sign."""
    silent_range_m_s2: float = math.inf
    """The accelerometer's output goes no farther than this from zero, and no flag says so."""
    frozen_s: tuple[float, float] | None = None
    """From when to when outputs repeat the value that they had before."""
    frozen_outputs: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    """Outputs that do: accelerometer x, y, z, gyroscope x, y, z."""
    sticking_period: int = 0
    """P of the accelerometer's codes that stick; 0: none does."""
    sticking_width: int = 0
    """W of these codes."""

    def draw_turn_on(self, rng: np.random.Generator) -> FloatArray:
        """Return what one power-on adds to the biases, shape (6,): m/s^2 of three axes, then rad/s."""
        sizes = np.repeat([self.turn_on_m_s2, self.turn_on_rad_s], 3)
        return sizes * rng.standard_normal(6)

    def warming(self, time_s: FloatArray) -> FloatArray:
        """Return what warming up adds to the bias of the accelerometer, shape (n,) to (n, 3), m/s^2."""
        return np.outer(1 - np.exp(-time_s / self.warm_up_s), self.warm_up_m_s2)

    def distorted(self, force_m_s2: FloatArray, misalignment_rad: FloatArray) -> FloatArray:
        """Return specific forces (n, 3) as an instrument without these terms would have to feel them to read the same.

        The terms stand on its sensing axes, the rows of the identity and ``misalignment_rad``, shape (3, 3).
        """
        if not np.any([*self.asymmetry, *self.cubic, *np.ravel(self.cross)]):
            return force_m_s2
        T = np.eye(3) + misalignment_rad
        s = force_m_s2 @ T.T / STANDARD_GRAVITY_M_S2
        pairs = s[:, [0, 0, 1]] * s[:, [1, 2, 2]]
        more = np.array(self.asymmetry) * np.abs(s) + np.array(self.cubic) * s**3 + pairs @ np.array(self.cross)
        return np.asarray(force_m_s2 + STANDARD_GRAVITY_M_S2 * np.linalg.solve(T, more.T).T)

    def distorted_rate(self, rate_rad_s: FloatArray) -> FloatArray:
        """Return angular rates (n, 3) as a gyroscope without these terms would have to feel them to read the same."""
        if not np.any([*self.gyroscope_asymmetry, *self.gyroscope_cubic]):
            return rate_rad_s
        more = np.array(self.gyroscope_asymmetry) * np.abs(rate_rad_s) + np.array(self.gyroscope_cubic) * rate_rad_s**3
        return np.asarray(rate_rad_s + more)

    def touch(self, force_m_s2: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
        """Return mean specific forces of holds, shape (m, 3), some of them touched, and which, ascending."""
        which = np.sort(rng.permutation(len(force_m_s2))[: self.touched_holds])
        touched: FloatArray = force_m_s2.copy()
        touched[which] *= 1 + self.touch_m_s2 * rng.choice([-1.0, 1.0], (len(which), 1)) / np.linalg.norm(
            force_m_s2[which], axis=1, keepdims=True
        )
        return touched, which


NO_EFFECTS = Effects()
