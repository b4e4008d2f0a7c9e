"""Input of the gyroscope calibration: what a session knows, made ready for fitting, and refused where it contradicts itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imufield.calibrate.gyroscope.move_integration import centre
from imufield.calibrate.gyroscope.residuals import ForceErrors, GyroscopeData, chains_of
from imufield.calibrate.gyroscope.stills_alone import StaticFree
from imufield.calibrate.gyroscope.turntable import TurntableRun, no_table, pair_runs
from imufield.calibrate.gyroscope.whole_turns import Stop
from imufield.calibrate.model.models import PARAMETERS as ACCELEROMETER_PARAMETERS
from imufield.calibrate.model.models import SCALE, norm_derivatives, recover, recover_vectors, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    Calibration,
    GyroscopeParameters,
)
from imufield.calibrate.model.rotation import exponential, rotate
from imufield.calibrate.moves.moves import Moves
from imufield.calibrate.moves.slots import SHORTEST_SLOT_S, Slots
from imufield.dataclass import dataclass, replace
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray, median
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

FEWEST_STILLS = 2
"""One alone says nothing about its scatter."""
# The preset's scale is not believed where the rough one differs by more than this factor: the raw unit is another.
_WRONG_START = 3.0
_MOVED = 0.05  # Share of all turning that an axis must have to be compared.
# Of the output: more than sums of equal numbers differ by, and less than the last bit of any instrument.
_CONSTANT = 1e-9
_NOISE_ONLY = 3.0  # Turns of the slots beyond what noise gives; a hand that turns a unit is hundreds of times beyond.
# Relative step for the derivative of the specific force by the accelerometer's parameters; it is nearly linear in them.
_DIFFERENCE = 1e-6
# Means of a slot, 5 ms or one sample: ten times what a hand makes, and beyond the usual ranges of 16 g and 2000 deg/s.
_LARGEST_FORCE_M_S2 = 500.0
_FASTEST_DEG_S = 4500.0
_MOST_DAMAGED = 0.25  # Share of the moves.
_TURNED = 0.98  # Cosine of 11 deg between the directions of gravity before and after a move.


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeInput:
    """What a session knows about its gyroscope.

    Attributes
    ----------
    observations : Observations
        The stills, the same that ``calibration`` came from, and after them ``rests`` more.
    moves : Moves
        Between these stills (``MoveCollector``), rows of ``observations``.
    calibration : Calibration
        Of the accelerometer; its body frame and gauge are the gyroscope's.
    latitude_deg : float, optional
    preset : GyroscopeParameters, optional
        In force before, in the body frame of the calibration.
    nominal_scale : float, optional
        Raw unit per rad/s, from the driver.
    stops : sequence of Stop
        Whole turns about the vertical, against a stop.
    turntable : sequence of TurntableRun
    static_free : {"bias", "all"}
        What the static norm path fits.
    rests : int
        Stills between whole turns, which had no say in ``calibration``.
    grade : {"navigation", "tactical", "industrial", "mems"}, optional
        Whose typical nonlinearity stands in the uncertainty for what these rates do not show; without it nothing does.
    """

    observations: Observations
    moves: Moves
    calibration: Calibration
    latitude_deg: float | None = None
    preset: GyroscopeParameters | None = None
    nominal_scale: float | None = None
    stops: Sequence[Stop] = ()
    turntable: Sequence[TurntableRun] = ()
    static_free: StaticFree = "bias"
    rests: int = 0
    grade: str | None = None

    @property
    def rest_raw(self) -> FloatArray:
        """Mean output over the stills, shape (3,)."""
        return np.asarray(self.observations.gyroscope_mean_raw.mean(axis=0))

    @property
    def force_m_s2(self) -> FloatArray:
        """Specific force of each still, body frame, shape (s, 3)."""
        return recover(self.calibration.accelerometer, self.observations.mean_raw)

    def preset_inverse(self) -> FloatArray | None:
        """Return A = (K E)^-1 of the preset, else of the driver's scale or the unit; None where nothing says it."""
        if self.preset is not None and np.isfinite(self.preset.scale).all():
            M: FloatArray = self.preset.scale[:, None] * (np.eye(3) + self.preset.misalignment_rad)
            return np.asarray(np.linalg.inv(M), dtype=np.float64)
        if self.nominal_scale is not None:
            return np.eye(3) / self.nominal_scale
        return np.eye(3) if self.observations.units.gyroscope_rate_unit == "rad/s" else None

    def require_stills(self) -> None:
        """Refuse too few stills with a gyroscope mean, and stills of which only some have one."""
        known = np.isfinite(self.observations.gyroscope_mean_raw).all(axis=1)
        count = int(known.sum())
        if count < FEWEST_STILLS:
            few = sentence("input.too_few_stills", positions=count, fewest=FEWEST_STILLS)
            raise CalibrationError(few, Reason.TOO_FEW)
        if not known.all():
            missing = sentence("input.missing_mean", position=self.observations.name[int(np.argmin(known))])
            raise CalibrationError(missing, Reason.NOT_FINITE, positions=int((~known).sum()))


def without_impossible(given: GyroscopeInput) -> GyroscopeInput:
    """Return the input without moves in which an output shows what no hand makes: one such sample would turn the whole fit."""
    moves = given.moves
    if not len(moves):
        return given
    shown = {"accelerometer": (_force_of_slots(given), _LARGEST_FORCE_M_S2, "m/s^2")}
    if (preset := given.preset_inverse()) is not None:
        rate_raw = _means(moves.slots, moves.slots.turn) - given.rest_raw
        shown["gyroscope"] = np.degrees(rate_raw @ preset.T), _FASTEST_DEG_S, "deg/s"
    found, most = dict[int, Sentence](), max(1, _MOST_DAMAGED * len(moves))
    for triad, (values, limit, unit) in shown.items():
        largest = np.fmax.reduceat(np.linalg.norm(values, axis=1), moves.first)
        beyond = np.flatnonzero(largest > limit)
        # More are no damage: the unit is another, which is told elsewhere.
        for k in beyond if len(beyond) <= most else ():
            told = {"triad": triad, "found": largest[k], "limit": limit, "unit": unit}
            found.setdefault(int(k), sentence("input.impossible", begin_s=moves.start_s[k], end_s=moves.end_s[k], **told))
    if not 0 < len(found) < len(moves):
        return given
    out = np.isin(np.arange(len(moves)), [*found])
    left_out = list(zip(moves.start_s[out], moves.end_s[out], strict=True))
    stops = [stop for stop in given.stops if not any(begin_s <= stop.time_s <= end_s for begin_s, end_s in left_out)]
    return replace(given, moves=moves.without(out, [*found.values()]), stops=stops)


def make_data(given: GyroscopeInput) -> GyroscopeData:
    """Return stills and moves with the output at rest taken off."""
    observations, moves = given.observations, given.moves
    rest = given.rest_raw
    # What rounding leaves is no noise that a longer mean makes smaller.
    variance = np.maximum(np.diagonal(observations.gyroscope_unrounded_covariance, 0, 1, 2), 0.0)
    own = observations.gyroscope_noise_raw
    density = np.sqrt(median(np.where(np.isfinite(own), own**2, variance * observations.duration_s[:, None])))
    return GyroscopeData(
        rate_raw=observations.gyroscope_mean_raw - rest,
        rate_covariance=observations.gyroscope_unrounded_covariance,
        rounding_covariance=observations.gyroscope_rounding(),
        # At the attitude where moves begin and end.
        force=rotate(exponential(-observations.middle_rad), given.force_m_s2),
        moves=centre(moves, rest, _force_of_slots(given)),
        chain=chains_of(len(observations), moves.before, moves.after),
        noise_density_raw=density,
        rest_raw=rest,
        time_s=observations.start_s + observations.duration_s / 2,
        errors=force_errors(observations, given.calibration, given.rests),
        latitude_deg=given.latitude_deg,
        table=pair_runs(given.turntable) if given.turntable else no_table(),
    )


def _means(slots: Slots, sums: FloatArray) -> FloatArray:
    return np.asarray(sums / np.maximum(slots.duration_s, SHORTEST_SLOT_S)[:, None])


def _force_of_slots(given: GyroscopeInput) -> FloatArray:
    """Return the specific force of the slot means of the moves, no quadratic term, shape (k, 3): enough for g-sensitivity."""
    parameters, slots = given.calibration.accelerometer, given.moves.slots
    s = (_means(slots, slots.force) - parameters.raw_zero) / parameters.scale - parameters.bias_m_s2
    return np.asarray(s @ np.linalg.inv(np.eye(3) + parameters.misalignment_rad).T)


def force_errors(observations: Observations, calibration: Calibration, rests: int = 0) -> ForceErrors:
    """Return how errors of the accelerometer and its calibration reach the specific force of each still.

    The calibration came from all stills but the last ``rests``.
    """
    parameters, n = calibration.accelerometer, ACCELEROMETER_PARAMETERS
    p, axes = to_vector(parameters), parameters.quadratic_axes
    raw = observations.mean_raw - parameters.raw_zero

    def difference(change: FloatArray, shift: FloatArray) -> FloatArray:
        size = float(np.abs(change).max() + np.abs(shift).max())
        ends = (recover_vectors(p + sign * change, raw + sign * shift, axes, parameters.higher) for sign in (1.0, -1.0))
        return (next(ends) - next(ends)) / (2 * size)

    raw_step = _DIFFERENCE * np.abs(raw).max()
    by_noise = np.stack([difference(np.zeros(n), np.eye(3)[k] * raw_step) for k in range(3)], axis=2)
    # Parameters may be zero: a bias counts by m/s^2, a misalignment by rad, a quadratic term by a tenth of the scale.
    K = np.abs(p[SCALE])
    steps = _DIFFERENCE * np.maximum(np.abs(p), np.concatenate([K, np.ones(9), K / 10]))
    by_parameters = np.stack([difference(np.eye(n)[k] * steps[k], np.zeros(3)) for k in range(n)], axis=2)
    covariance, with_gravity, by_gravity = _accelerometer_covariance(calibration)
    # Known beforehand, so the gain does not weigh it.
    for root in calibration.left_out.values():
        fitted = root * np.any(covariance, axis=1)[:, None]
        covariance -= fitted @ fitted.T
    tau = calibration.quality.between_position_sigma_m_s2
    noise = np.nan_to_num(observations.covariance_raw) + np.diag((tau * parameters.scale) ** 2)
    # The gain of the accelerometer fit: weighted least squares moves its parameters by -C J^T v / s^2 for noise in a mean.
    derivatives = norm_derivatives(p, raw, axes, parameters.higher)
    v = derivatives.raw_gradient
    variance = np.einsum("mi,mij,mj->m", v, noise, v)
    measured = len(raw) - rests
    usable = (variance > 0) & (np.count_nonzero(calibration.positions.used) == measured) & (np.arange(len(raw)) < measured)
    weight = np.where(usable, 1 / np.where(variance > 0, variance, 1.0), 0.0)
    gain = -(derivatives.jacobian * weight[:, None] @ (covariance - by_gravity))[:, :, None] * v[:, None, :]
    # What the covariance holds beyond the noise of these means; rounding must not make it negative.
    values, vectors = np.linalg.eigh(covariance - by_gravity - np.einsum("mij,mjk,mlk->il", gain, noise, gain))
    beyond = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return ForceErrors(
        by_noise=by_noise,
        noise=noise,
        by_parameters=by_parameters,
        gain=gain,
        rest=beyond + by_gravity,
        with_gravity=with_gravity,
        by_gravity=by_gravity,
        left_out=calibration.left_out,
    )


def _accelerometer_covariance(calibration: Calibration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the covariance of the parameters, shape (15, 15), that with gravity, (15,), and what of the first is gravity's."""
    both = calibration.covariance_in((*ACCELEROMETER_NAMES, GRAVITY_NAME))
    with_gravity, variance = both[:-1, -1], both[-1, -1]
    if not variance > 0:
        return both[:-1, :-1], np.zeros_like(with_gravity), np.zeros_like(both[:-1, :-1])
    return both[:-1, :-1], with_gravity, np.outer(with_gravity, with_gravity) / variance


def refuse_dead(given: GyroscopeInput, data: GyroscopeData) -> None:
    """Refuse outputs that show no rotation: constant, or nothing but noise while gravity shows that the unit was turned."""
    if not len(given.moves):
        return
    moves = len(given.moves)
    # The same number in all moves is what no rotating gyroscope gives.
    slots = given.moves.slots
    slots = slots[slots.duration_s > SHORTEST_SLOT_S]
    rate_raw = slots.turn / slots.duration_s[:, None]
    low, high = rate_raw.min(axis=0, initial=np.inf), rate_raw.max(axis=0, initial=-np.inf)
    dead = high - low <= _CONSTANT * np.maximum(np.abs(rate_raw).max(axis=0, initial=0.0), np.finfo(float).tiny)
    if dead.any():
        axes = ", ".join(axis for axis, is_dead in zip(AXES, dead, strict=True) if is_dead)
        raise CalibrationError(sentence("input.constant", axes=axes, moves=moves), Reason.SATURATED)
    noise = data.noise_density_raw * np.sqrt(data.moves.slots.duration_s.sum())
    noisy = np.sqrt(np.sum(data.moves.slots.turn**2, axis=0)) <= _NOISE_ONLY * noise
    along = np.sum(data.up[data.moves.before] * data.up[data.moves.after], axis=1)
    if noisy.all() and along.min(initial=1.0) <= _TURNED:
        noisy_moves = sentence("input.only_noise", moves=moves, turned_deg=np.degrees(np.arccos(along.min())))
        raise CalibrationError(noisy_moves, Reason.SATURATED, axes=", ".join(AXES))


def refuse_foreign(data: GyroscopeData, estimate: FloatArray, preset: FloatArray) -> None:
    """Refuse a preset that turns clearly slower, faster or the other way than an A that the stills bear out."""
    expected, shown = data.moves.slots.turn @ preset.T, data.moves.slots.turn @ estimate.T
    energy = np.sum(expected**2, axis=0)
    moved = energy > _MOVED * energy.sum()
    ratio = np.sum(expected * shown, axis=0)[moved] / energy[moved]
    # Two reversed axes are a wrong preset; one or three make a triad of the other hand.
    if np.count_nonzero(ratio < -1 / _WRONG_START) % 2:
        raise handedness_error()
    if np.any(ratio < 1 / _WRONG_START) or np.any(ratio > _WRONG_START):
        raise CalibrationError(sentence("input.foreign_scale", ratio=ratio.tolist(), limit=_WRONG_START), Reason.UNITS)


def handedness_error() -> CalibrationError:
    """Return the refusal of a gyroscope whose axes turn the other way than the accelerometer's."""
    return CalibrationError(sentence("input.handedness"), Reason.HANDEDNESS)
