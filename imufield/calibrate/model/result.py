"""What a calibration returns, and what the parameter file, report and exports are written from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from imufield.calibrate.model.budget import Share
from imufield.calibrate.model.higher_terms import HigherTerms
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.dataclass import dataclass, field, replace
from imufield.earth import Gravity
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

Gauge = Literal["preset", "lower", "upper", "symmetric"]
QuadraticAxes = Literal["sensing", "body"]
ModelChoice = Literal["linear", "quadratic", "extended", "auto"]

ANGLES = ("xy", "xz", "yz")
MISALIGNMENTS = ("xy", "xz", "yx", "yz", "zx", "zy")
PAIRS = tuple(row + column for row in AXES for column in AXES)
"""Of a whole matrix, row by row."""


def names_of(form: str, **places: Sequence[str]) -> tuple[str, ...]:
    """Return a name for each place of each kind: ``form`` with both, such as "{} {}"."""
    return tuple(form.format(kind, place) for kind, of_kind in places.items() for place in of_kind)


ACCELEROMETER_NAMES = names_of(
    "accelerometer.{}.{}", scale=AXES, bias_m_s2=AXES, misalignment_rad=MISALIGNMENTS, quadratic=AXES
)
"""The 15 accelerometer parameters in the order of every vector and covariance matrix.

``misalignment_rad.xy`` is row x, column y of T - I.
"""
GYROSCOPE_BIAS_NAMES = names_of("gyroscope.{}.{}", bias=AXES)
"""Names of the static gyroscope parameters, raw unit."""
GYROSCOPE_NAMES = names_of("gyroscope.{}.{}", scale=AXES, misalignment_rad=MISALIGNMENTS, bias=AXES, g_sensitivity=PAIRS)
"""The 21 gyroscope parameters in the order of every vector and covariance matrix."""
GRAVITY_NAME = "gravity_m_s2"
VERDICTS = ("good", "usable", "poor")
"""From the best to the worst."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AccelerometerParameters:
    """N - raw_zero = K (T a + b) + K2 (T a)**2, or with a**2 where ``quadratic_axes`` is "body".

    With higher terms T a + h(T a) stands in place of T a.
    """

    scale: FloatArray
    """K, shape (3,), raw unit per m/s^2."""
    bias_m_s2: FloatArray
    misalignment_rad: FloatArray
    """T - I, shape (3, 3), zero diagonal."""
    quadratic: FloatArray = field(default_factory=lambda: np.zeros(3))
    """K2, shape (3,), raw unit per (m/s^2)^2."""
    raw_zero: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Raw output that counts as zero, shape (3,), raw unit; per second for increments."""
    quadratic_axes: QuadraticAxes = "sensing"
    higher: HigherTerms | None = None
    """h; None where there are none."""

    @property
    def offset(self) -> FloatArray:
        """Raw output at zero input, shape (3,)."""
        return self.raw_zero + self.scale * self.bias_m_s2


@dataclass(frozen=True, slots=True, kw_only=True)
class Intrinsic:
    """Gauge-free accelerometer parameters with 1 sigma: row lengths of K T, K b, angles between the sensing axes, K2."""

    scale: FloatArray
    """Row lengths of K T, shape (3,), raw unit per m/s^2."""
    bias_raw: FloatArray
    """K b, shape (3,), raw unit."""
    angle_rad: FloatArray
    """Angles between sensing axes x-y, x-z, y-z minus a right angle, shape (3,)."""
    quadratic: FloatArray
    scale_sigma: FloatArray
    bias_raw_sigma: FloatArray
    angle_sigma_rad: FloatArray
    quadratic_sigma: FloatArray

    @property
    def values(self) -> FloatArray:
        """Return the 12 numbers in this order, shape (12,)."""
        return np.concatenate([self.scale, self.bias_raw, self.angle_rad, self.quadratic])

    @property
    def sigmas(self) -> FloatArray:
        """1 sigma of each, shape (12,)."""
        return np.concatenate([self.scale_sigma, self.bias_raw_sigma, self.angle_sigma_rad, self.quadratic_sigma])


@dataclass(frozen=True, slots=True)
class GyroscopeParameters:
    """N - raw_zero = K E w + e + G a."""

    scale: FloatArray
    """K, shape (3,), raw unit per rad/s."""
    misalignment_rad: FloatArray
    """E - I, shape (3, 3), zero diagonal."""
    bias: FloatArray
    """e, shape (3,), raw unit."""
    g_sensitivity: FloatArray
    """G, shape (3, 3), raw unit per m/s^2."""
    raw_zero: FloatArray = field(default_factory=lambda: np.zeros(3))
    """As the accelerometer's."""

    @property
    def offset(self) -> FloatArray:
        """Raw output at zero input, shape (3,)."""
        return self.raw_zero + self.bias

    @classmethod
    def from_vector(cls, vector: FloatArray) -> GyroscopeParameters:
        """Return the parameters of a vector in the order of ``GYROSCOPE_NAMES``, shape (21,)."""
        scale, off_diagonal, bias, sensitivity = np.split(vector.copy(), (3, 9, 12))
        misalignment = np.zeros((3, 3))
        misalignment[~np.eye(3, dtype=np.bool_)] = off_diagonal  # Row by row, as their names are.
        return cls(scale, misalignment, bias, sensitivity.reshape(3, 3))

    def about(self, raw_zero: FloatArray) -> GyroscopeParameters:
        """Return the same with another raw zero, shape (3,): the bias changes by the difference."""
        return replace(self, bias=self.bias + (self.raw_zero - raw_zero), raw_zero=raw_zero)


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeCalibration:
    """Gyroscope parameters, their 1 sigma (same shapes; NaN where not estimated) and the path taken."""

    parameters: GyroscopeParameters
    sigma: GyroscopeParameters
    path: str
    """In words, e.g. "static bias, Earth rate accounted for"."""
    raw_unit: str = "rad/s"
    range_rad_s: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """Largest rate about each axis that the scale comes from, shape (3,); NaN where it comes from none."""
    temperature: TriadTemperature | None = None
    """None where the parameters are known at one temperature only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionResult:
    """Residuals of m positions, arrays of shape (m,), in the order of the observations."""

    residual_m_s2: FloatArray
    """norm(a) - g with the final parameters."""
    leave_one_out_m_s2: FloatArray
    """The same with parameters fitted without this position; NaN where it cannot be left out."""
    leverage: FloatArray
    """Diagonal of the hat matrix; 1 means nothing checks this position."""
    used: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """False where the user left a position out: of it only ``leave_one_out_m_s2`` is known."""
    bias_drift_m_s2: FloatArray
    """Bias at this position less the calibration's, which is the mean over the positions, shape (m, 3)."""

    @property
    def count(self) -> int:
        """How many were used."""
        return int(np.count_nonzero(self.used))

    @classmethod
    def none(cls) -> PositionResult:
        """Return the result of no position: of parameters that were solved from elsewhere."""
        nothing = np.zeros(0)
        return cls(
            residual_m_s2=nothing,
            leave_one_out_m_s2=nothing,
            leverage=nothing,
            used=np.zeros(0, dtype=np.bool_),
            bias_drift_m_s2=np.zeros((0, 3)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSummary:
    """How the solver ended."""

    method: str
    status: int
    message: str
    cost: float
    evaluations: int
    seed: int | None = None

    @property
    def converged(self) -> bool:
        """Whether the result may be believed."""
        return self.status > 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """Figures by which the calibration is judged."""

    residual_rms_m_s2: float
    residual_max_m_s2: float
    leave_one_out_rms_m_s2: float
    between_position_sigma_m_s2: float
    """tau: scatter between positions beyond what the holds themselves show."""
    degrees_of_freedom: int
    student_factor_95: float
    rank: int
    parameters_fitted: int
    condition: float
    verdict: str
    """Of ``VERDICTS``."""
    reasons: tuple[str, ...]
    """Sentences: what the verdict rests on, then what lowered it, then every other one."""
    warnings: tuple[str, ...] = ()
    """Those of them that lowered the verdict."""
    accelerometer_verdict: str = ""
    """The verdict on this triad alone; empty in files of before."""
    gyroscope_verdict: str = ""
    """The same, or "bias only", "not calibrated"; empty without a gyroscope."""
    suspects: tuple[str, ...] = ()
    """Names of positions that the others contradict; empty in files of before."""

    @property
    def details(self) -> tuple[str, ...]:
        """The reasons that neither sum up nor warn."""
        return tuple(reason for reason in self.reasons[1:] if reason not in self.warnings)

    @property
    def main_reason(self) -> str:
        """What lowered the verdict, or what a good one rests on."""
        return self.reasons[min(1, len(self.reasons) - 1) if self.verdict != "good" else 0] if self.reasons else ""

    def with_reasons(self, *more: str) -> Quality:
        """Return the same verdict with more sentences."""
        return replace(self, reasons=(*self.reasons, *more))

    def lowered(self, verdict: str, *why: str) -> Quality:
        """Return the same with a verdict no better than ``verdict``, and the sentences that say why."""
        worst = max(self.verdict, verdict, key=VERDICTS.index)
        # Behind the first of a verdict that is worse already: it is quoted as what made it.
        behind = min(len(self.warnings), 1) if worst != verdict else 0
        reasons = (*self.reasons[: 1 + behind], *why, *self.reasons[1 + behind :])
        return replace(self, verdict=worst, reasons=reasons, warnings=(*self.warnings[:behind], *why, *self.warnings[behind:]))

    def triad_lowered(self, triad: str, verdict: str) -> Quality:
        """Return the same with a verdict on a triad no better than ``verdict``, where both are of ``VERDICTS``."""
        name = f"{triad}_verdict"
        both = (getattr(self, name), verdict)
        return replace(self, **{name: max(both, key=VERDICTS.index)}) if set(both) <= set(VERDICTS) else self

    def triad_doubted(self, triad: str, why: Sequence[str]) -> Quality:
        """Return the same with no verdict better than usable, of the whole and of a triad, where there are sentences why."""
        return self.lowered("usable", *why).triad_lowered(triad, "usable") if why else self

    def joined(self, session: str, other: Quality) -> Quality:
        """Return the same with no verdict better than those of another session, whose warnings are told with its name."""
        quality = self.lowered(other.verdict, *(of_session(session, warning) for warning in other.warnings))
        for triad in ("accelerometer", "gyroscope"):
            quality = quality.triad_lowered(triad, getattr(other, f"{triad}_verdict"))
        return quality


def of_session(session: str, reason: str) -> Sentence:
    """Return what is said of one session among others."""
    return sentence("result.of_session", session=session, reason=reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """The result of ``imufield solve``: parameters, uncertainty, and what they rest on."""

    accelerometer: AccelerometerParameters
    accelerometer_sigma: AccelerometerParameters
    """1 sigma in the same shapes; NaN where a parameter was not fitted and is not fixed by the gauge, 0 where it is fixed."""
    accelerometer_raw_unit: str
    equation: str
    gauge: Gauge
    intrinsic: Intrinsic
    covariance_names: tuple[str, ...]
    covariance: FloatArray
    """Joint covariance in the order of ``covariance_names`` (accelerometer, gyroscope, gravity_m_s2)."""
    gravity: Gravity
    positions: PositionResult
    solver: SolverSummary
    quality: Quality
    quadratic_fitted: bool
    gyroscope: GyroscopeCalibration | None = None
    unobservable: tuple[str, ...] = ()
    """Names of parameters left at the preset because these positions cannot show them."""
    accelerometer_temperature: TriadTemperature | None = None
    """None where the parameters are known at one temperature only."""
    budget: tuple[Share, ...] = ()
    """What the diagonal of ``covariance`` is the sum of, in the order of ``covariance_names``; empty in files of before."""
    left_out: dict[str, FloatArray] = field(default_factory=dict)
    """Roots of what typical terms that the positions leave open do to the 15 parameters, their own entries included, (15, k).

    By the name of the share. Not in files.
    """

    @property
    def model(self) -> ModelChoice:
        """What was fitted."""
        if self.accelerometer.higher is not None:
            return "extended"
        return "quadratic" if self.quadratic_fitted else "linear"

    def covariance_in(self, names: Sequence[str]) -> FloatArray:
        """Return the covariance of n parameters in the order of their names, zero for what was not fitted, shape (n, n)."""
        places = [place for place, name in enumerate(names) if name in self.covariance_names]
        rows = [self.covariance_names.index(names[place]) for place in places]
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(places, places)] = self.covariance[np.ix_(rows, rows)]
        return covariance


def without_drift(observations: Observations, calibration: Calibration) -> Observations:
    """Return the observations as they were with the bias of the calibration; the drift in between is interpolated.

    Parameters
    ----------
    observations : Observations
        The ones calibrated from come first, in their order; others follow.
    calibration : Calibration
    """
    drift = calibration.positions.bias_drift_m_s2[calibration.positions.used]
    count = len(drift)
    if not np.any(drift):
        return observations
    middle_s = observations.start_s + observations.duration_s / 2
    if len(observations) > count:
        order = np.argsort(middle_s[:count])
        others = [np.interp(middle_s[count:], middle_s[:count][order], column[order]) for column in drift.T]
        drift = np.vstack([drift, np.transpose(others)])
    return replace(observations, mean_raw=observations.mean_raw - calibration.accelerometer.scale * drift)
