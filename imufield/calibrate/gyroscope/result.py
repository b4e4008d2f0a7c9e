"""The result of a gyroscope calibration: parameters, joint covariance with the accelerometer, moves, sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.gyroscope.fit import JointFit, fit_jointly
from imufield.calibrate.gyroscope.input import GyroscopeInput, make_data
from imufield.calibrate.gyroscope.model_choice import SCALES, ChosenModel, Linearity
from imufield.calibrate.gyroscope.move_integration import BIAS, INVERSE, PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.observability import Observability
from imufield.calibrate.gyroscope.residual_covariance import gyroscope_share, input_sigmas, turns_tell_scatter
from imufield.calibrate.gyroscope.residuals import Evaluation, GyroscopeData, evaluate
from imufield.calibrate.gyroscope.stills_alone import StaticData, StaticFit, contradicts, latitude_words
from imufield.calibrate.gyroscope.whole_turns import find_whole_turns
from imufield.calibrate.model.budget import Share, joined_shares, picked, root_of
from imufield.calibrate.model.coverage_factors import degrees_of_freedom
from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS
from imufield.calibrate.model.models import PARAMETERS as ACCELEROMETER_PARAMETERS
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    GYROSCOPE_BIAS_NAMES,
    GYROSCOPE_NAMES,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
)
from imufield.calibrate.model.uncertainty import bounded_cross_covariance, rms
from imufield.dataclass import dataclass, field, replace
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

# Share of the closing error before that is left where a fit has gained little; a session of placed positions leaves 0.12.
_HARDLY_BETTER = 0.8
_WORSE = 1.1
_FOUND_SIGMAS = 4.0  # A term as large on one axis is found in two of three sessions.
_SHOWN_BELOW = 0.01  # Of a scale: where a term has to be as large to be found, these turns are said not to show it.
_COMMON_SCALE_LIMIT = 0.1  # Makers of consumer chips state 3 % (MPU-6050).
_MOVE_ERROR_LIMIT_DEG = 5.0  # RMS: a move that ends further from where gravity says was not seen whole, or not by this unit.
_SCALE_SIGMA_LIMIT_PPM = 5000.0  # The better data sheets of chips promise as much without a calibration.
_MISALIGNMENT_SIGMA_LIMIT_MRAD = 5.0  # An axis that is off by as much makes as large an error of a rate across it.
_SUSPICIOUS_SIGMAS = 4.5  # A residual has two components; one good move in 25 000 is further off.


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveReport:
    """Every move that was used, arrays of shape (m,)."""

    before_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    """Angle between the measured and the integrated direction of gravity, with the parameters in force before, if any."""
    after_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    """The same with the new parameters."""
    sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    """Length of the residual over its own sigma; 1.4 is typical, more than 4.5 is suspicious."""

    @property
    def rms_before_deg(self) -> float:
        """Root mean square of ``before_deg``; NaN without moves."""
        return rms(self.before_deg)

    @property
    def rms_after_deg(self) -> float:
        """Root mean square of ``after_deg``; NaN without moves."""
        return rms(self.after_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeResult:
    """The gyroscope half of a calibration."""

    calibration: GyroscopeCalibration
    names: tuple[str, ...]
    """Names of the parameters in ``covariance``, from ``GYROSCOPE_NAMES``."""
    covariance: FloatArray
    with_accelerometer: FloatArray
    """Covariance of ``names`` with the 15 accelerometer parameters and gravity, shape (n, 16)."""
    moves: MoveReport = field(default_factory=MoveReport)
    turns: tuple[Sentence, ...] = ()
    """The whole turns among the moves."""
    unobservable: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    """Sentences: every warning, and what the result rests on."""
    cautions: tuple[str, ...] = ()
    """Sentences that make the verdict on the whole no better than usable."""
    faults: tuple[str, ...] = ()
    """Sentences that make it poor."""
    budget: tuple[Share, ...] = ()
    """What the diagonal of ``covariance`` is the sum of."""
    basis: JointSolution | StaticSolution | None = None
    """What it was fitted to, for other methods; None for a static bias."""

    @property
    def knows_scale(self) -> bool:
        """Whether that of any axis was found."""
        return bool(np.isfinite(self.calibration.sigma.scale).any())

    @property
    def verdict(self) -> str:
        """The verdict on this triad."""
        return "poor" if self.faults else "usable" if self.cautions else "good" if self.knows_scale else "bias only"

    def join(self, calibration: Calibration) -> Calibration:
        """Return the calibration with this gyroscope and one covariance matrix for all."""
        old = calibration.covariance_names
        accelerometer = [k for k, name in enumerate(old) if name in ACCELEROMETER_NAMES]
        gravity = [k for k, name in enumerate(old) if name == GRAVITY_NAME]
        names = (*(old[k] for k in accelerometer), *self.names, *(old[k] for k in gravity))
        # The gyroscope stands between the accelerometer and gravity; `outer` are the places of those two.
        a, n = len(accelerometer), len(self.names)
        outer = [*range(a), *range(a + n, len(names))]
        theirs = calibration.covariance[np.ix_([*accelerometer, *gravity], [*accelerometer, *gravity])]
        columns = [*(ACCELEROMETER_NAMES.index(old[k]) for k in accelerometer), *(ACCELEROMETER_PARAMETERS for _ in gravity)]
        cross = bounded_cross_covariance(self.with_accelerometer[:, columns], self.covariance, theirs)
        covariance = np.zeros((len(names), len(names)))
        covariance[a : a + n, a : a + n] = self.covariance
        covariance[np.ix_(outer, outer)] = theirs
        covariance[a : a + n, outer], covariance[np.ix_(outer, range(a, a + n))] = cross, cross.T
        quality = calibration.quality.with_reasons(*self.reasons)
        quality = quality.lowered("usable", *self.cautions) if self.cautions else quality
        budget = picked(calibration.budget, [*accelerometer, *gravity])
        return replace(
            calibration,
            gyroscope=self.calibration,
            covariance_names=names,
            covariance=covariance,
            budget=joined_shares(budget, outer, self.budget, range(a, a + n)) if budget else (),
            quality=quality.lowered("poor", *self.faults) if self.faults else quality,
            unobservable=(*calibration.unobservable, *self.unobservable),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSolution:
    """Input, data and fit of moves, stills, stops and turntable rates together."""

    given: GyroscopeInput
    data: GyroscopeData
    chosen: ChosenModel
    linearity: Linearity
    start: FloatArray
    observability: Observability
    warnings: tuple[str, ...]
    cautions: tuple[str, ...] = ()
    """Warnings that make the verdict no better than usable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSolution:
    """Input, data and fit of the static norm path."""

    given: GyroscopeInput
    data: StaticData
    fitted: StaticFit


def joint_result(solution: JointSolution) -> GyroscopeResult:
    """Return the result of a joint fit."""
    chosen, fitted, observability = solution.chosen, solution.chosen.fit, solution.observability
    linearity = solution.linearity
    # The covariance of the fit in all 21 parameters; what a rejected g-sensitivity or one scale for all rates hides adds more.
    places = np.flatnonzero(fitted.free < PARAMETERS)
    columns = fitted.free[places]
    own = {}
    for name, part in fitted.shares.items():
        # Parameters that were not fitted have no variance of their own.
        own[name] = np.zeros((PARAMETERS, PARAMETERS))
        own[name][np.ix_(columns, columns)] = part[np.ix_(places, places)]
    hidden = {"g_sensitivity_not_fitted": chosen.hidden_change[:, None], "rate_nonlinearity": linearity.hidden_root}
    own |= {name: root[:PARAMETERS] @ root[:PARAMETERS].T for name, root in hidden.items()}
    # An error of the accelerometer moves the residuals, and the fit follows with -gain.
    with_accelerometer = np.zeros((PARAMETERS, ACCELEROMETER_PARAMETERS + 1))
    with_accelerometer[columns] = -fitted.gain[places] @ fitted.parts.with_accelerometer
    known = np.array([name not in observability.hidden_names for name in GYROSCOPE_NAMES])
    known[12:] &= chosen.g_sensitive
    data, now, m = solution.data, fitted.evaluation, len(solution.given.moves)
    x = fitted.p - linearity.moved
    before = _before(solution.given, data, fitted)
    turns = find_whole_turns(now, data, before)
    S = fitted.parts.total(fitted.scatter)
    blocks = np.array([S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(m)]).reshape(m, 2, 2)
    residual = now.residual[: 2 * m].reshape(m, 2)
    moves = MoveReport(
        before_deg=_angles_deg(before, data),
        after_deg=_angles_deg(now.moved(-linearity.moved[:PARAMETERS]), data),
        sigma=np.sqrt(np.einsum("mi,mij,mj->m", residual, np.linalg.inv(blocks), residual)),
    )
    result = _result(solution, x[:PARAMETERS], own, known, path=_path(solution, turns))
    are_enough = turns_tell_scatter(fitted.scatter, now.jacobian[:, fitted.free], fitted.parts)
    few = (sentence("result.few_moves", moves=m),) if m and not are_enough else ()
    gyroscope = result.calibration
    nominal = solution.given.nominal_scale or (
        1.0 if solution.given.observations.units.gyroscope_rate_unit == "rad/s" else np.nan
    )
    # A wrong rate or unit multiplies all axes, so the axis that is least off decides.
    smallest_off = float(np.nan_to_num(np.abs(gyroscope.parameters.scale / nominal - 1.0)).min())
    off_unit = _beyond("result.off_unit", smallest_off, _COMMON_SCALE_LIMIT)
    apart = _beyond("result.apart", moves.rms_after_deg, _MOVE_ERROR_LIMIT_DEG)
    worse = (sentence("result.worse", earlier=_earlier(solution.given)),) if is_worse(moves) else ()
    unsettled = () if fitted.solved.converged else (_unsettled(fitted.solved.message, solution.given.latitude_deg),)
    return replace(
        result,
        calibration=replace(result.calibration, range_rad_s=linearity.range_rad_s),
        with_accelerometer=(forward(x[:PARAMETERS], data.rest_raw)[1] @ with_accelerometer)[known],
        moves=moves,
        turns=turns,
        unobservable=observability.hidden_names,
        reasons=_reasons(solution, moves, turns),
        cautions=(
            *solution.cautions,
            *few,
            *coarse_sentences(gyroscope),
            *off_unit,
            *worse,
            *(linearity.sentences if linearity.matters else ()),
        ),
        faults=(*unsettled, *apart),
    )


def coarse_sentences(gyroscope: GyroscopeCalibration, remedy: Sentence | None = None) -> tuple[Sentence, ...]:
    """Return what is too uncertain for a good verdict, of one session or of several as one; nothing if nothing is."""
    # NaN where a number is not observable, which is said elsewhere.
    scale_ppm = 1e6 * np.nan_to_num(np.abs(gyroscope.sigma.scale / gyroscope.parameters.scale))
    skew_mrad = 1e3 * np.nan_to_num(gyroscope.sigma.misalignment_rad).max(axis=1)
    remedy = remedy or sentence("result.more_positions")
    scale_axis, skew_axis = AXES[scale_ppm.argmax()], AXES[skew_mrad.argmax()]
    return (
        *_beyond("result.coarse", float(scale_ppm.max()), _SCALE_SIGMA_LIMIT_PPM, remedy=remedy, axis=scale_axis),
        *_beyond("result.skewed", float(skew_mrad.max()), _MISALIGNMENT_SIGMA_LIMIT_MRAD, remedy=remedy, axis=skew_axis),
    )


def _beyond(key: str, found: float, limit: float, **told: str) -> tuple[Sentence, ...]:
    return (sentence(key, found=found, limit=limit, **told),) if found > limit else ()


def static_bias_result(
    gyroscope: GyroscopeCalibration, sentences: tuple[str, ...], *, stills: int, earth_rate: FloatArray
) -> GyroscopeResult:
    """Return the result of a path that sees the bias alone; ``earth_rate`` is what its 1 sigma holds of the Earth's rate."""
    scatter = np.sqrt(np.maximum(gyroscope.sigma.bias**2 - earth_rate**2, 0.0))
    parts = {"gyroscope_between_holds": scatter, "earth_rate": earth_rate}
    return GyroscopeResult(
        calibration=gyroscope,
        names=GYROSCOPE_BIAS_NAMES,
        covariance=np.diag(gyroscope.sigma.bias**2),
        with_accelerometer=np.zeros((len(GYROSCOPE_BIAS_NAMES), ACCELEROMETER_PARAMETERS + 1)),
        budget=tuple(
            gyroscope_share(name, sigma, stills=stills, accelerometer_freedom=math.inf, input_sigma=math.nan)
            for name, sigma in parts.items()
        ),
        unobservable=GYROSCOPE_NAMES[:9],
        reasons=sentences,
    )


def static_norm_result(solution: StaticSolution) -> GyroscopeResult:
    """Return the result of the static norm path."""
    given, fitted = solution.given, solution.fitted
    own = {name: np.pad(part, (0, PARAMETERS - len(part))) for name, part in fitted.shares.items()}
    everything = given.static_free == "all"
    known = np.array([name in GYROSCOPE_BIAS_NAMES or (everything and k < 9) for k, name in enumerate(GYROSCOPE_NAMES)])
    path = sentence("result.norm_all" if everything else "result.norm_bias", stills=len(given.observations))
    observed = (given.latitude_deg or 0.0, fitted.vertical_rad_s, fitted.vertical_sigma_rad_s)
    latitude, is_contradicted = latitude_words(*observed), contradicts(*observed)
    return replace(
        _result(solution, np.concatenate([fitted.x, np.zeros(9)]), own, known, path=path),
        unobservable=() if everything else GYROSCOPE_NAMES[:9],
        reasons=given.moves.dropped if is_contradicted else (latitude, *given.moves.dropped),
        cautions=(latitude,) if is_contradicted else (),
        faults=() if fitted.converged else (_unsettled(sentence("result.static_moves"), given.latitude_deg),),
    )


def _result(
    solution: JointSolution | StaticSolution, x: FloatArray, own: dict[str, FloatArray], known: NDArray[np.bool_], *, path: str
) -> GyroscopeResult:
    """Return what holds for every fit: the parameters at ``x`` with shares ``own``, and the sigma of the known ones."""
    values, J = forward(x, solution.given.rest_raw)
    # What no turn shows keeps the preset's value: the inverse of A would mix the others into it.
    preset = solution.given.preset
    before = np.zeros((3, 3)) if preset is None else preset.misalignment_rad
    angles = slice(3, 9)
    values[angles] = np.where(known[angles], values[angles], before[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS])
    shares = {name: J @ part @ J.T for name, part in own.items()}
    covariance = np.sum([*shares.values()], axis=0)
    sigma = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    unit = solution.given.observations.units.gyroscope_rate_unit
    return GyroscopeResult(
        calibration=GyroscopeCalibration(
            parameters=GyroscopeParameters.from_vector(values),
            sigma=GyroscopeParameters.from_vector(sigma),
            path=path,
            raw_unit=unit,
        ),
        names=tuple(name for name, kept in zip(GYROSCOPE_NAMES, known, strict=True) if kept),
        covariance=covariance[np.ix_(known, known)],
        with_accelerometer=np.zeros((int(known.sum()), ACCELEROMETER_PARAMETERS + 1)),
        budget=picked(_shares(solution, shares), np.flatnonzero(known).tolist()),
        basis=solution,
    )


def _shares(solution: JointSolution | StaticSolution, parts: dict[str, FloatArray]) -> Iterator[Share]:
    given, data = solution.given, solution.data
    inputs: dict[str, float] = {}
    if isinstance(solution, JointSolution):
        inputs = input_sigmas(solution.chosen.fit.parts, solution.chosen.fit.scatter)
    stills = len(data.up)
    freedom = degrees_of_freedom(given.calibration.quality.student_factor_95)
    for name, part in parts.items():
        known = inputs.get(name, math.nan)
        sigma = root_of(np.diag(part))
        yield gyroscope_share(name, sigma, stills=stills, accelerometer_freedom=freedom, input_sigma=known)


def _unsettled(how: str, latitude_deg: float | None) -> Sentence:
    """Say that a fit has not ended, and what usually helps."""
    return sentence("result.unsettled_without_latitude" if latitude_deg is None else "result.unsettled", how=how)


def forward(x: FloatArray, rest_raw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the 21 parameters in the order of ``GYROSCOPE_NAMES`` and d parameters / d x.

    With M = A^-1 = K E: dM = -M dA M, K = diag M, E = M / K, e = N0 + M b, G = M H.
    """
    A, b, H = x[INVERSE].reshape(3, 3), x[BIAS], x[SENSITIVITY].reshape(3, 3)
    M = np.linalg.inv(A)
    K = np.diag(M).copy()
    rows, columns = MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS
    values = np.concatenate([K, M[rows, columns] / K[rows], rest_raw + M @ b, (M @ H).ravel()])
    J = np.zeros((PARAMETERS, PARAMETERS))
    for k in range(PARAMETERS):
        unit = np.zeros(PARAMETERS)
        unit[k] = 1.0
        dM = -M @ unit[INVERSE].reshape(3, 3) @ M  # d A^-1 = -A^-1 dA A^-1
        dK = np.diag(dM)
        dE = (dM[rows, columns] - M[rows, columns] * dK[rows] / K[rows]) / K[rows]
        dG = dM @ H + M @ unit[SENSITIVITY].reshape(3, 3)
        J[:, k] = np.concatenate([dK, dE, dM @ b + M @ unit[BIAS], dG.ravel()])
    return np.asarray(values, dtype=np.float64), J


def vector_of(parameters: GyroscopeParameters, rest_raw: FloatArray) -> FloatArray:
    """Return the 21 numbers of a fit with the output at rest taken off, as ``forward`` takes them."""
    A = np.linalg.inv(parameters.scale[:, None] * (np.eye(3) + parameters.misalignment_rad))
    x = np.zeros(PARAMETERS)
    x[INVERSE] = A.ravel()
    x[BIAS] = A @ (parameters.offset - rest_raw)
    x[SENSITIVITY] = (A @ parameters.g_sensitivity).ravel()
    return x


def parameters_before(given: GyroscopeInput) -> GyroscopeParameters | None:
    """Return what was in force before; without a preset the driver's scale, or the unit, and the mean at rest for a bias.

    None where nothing says the scale.
    """
    if given.preset is not None and np.isfinite(given.preset.scale).all():
        return given.preset
    inverse = given.preset_inverse()
    if inverse is None:
        return None
    return GyroscopeParameters(1 / np.diag(inverse), np.zeros((3, 3)), given.rest_raw, np.zeros((3, 3)))


def angle_errors_deg(given: GyroscopeInput, parameters: GyroscopeParameters) -> tuple[FloatArray, FloatArray]:
    """Return how far each move, integrated with the parameters before and with these, ends from where gravity says.

    The Earth's rate is found as a calibration finds it. Both of shape (m,); NaN where nothing says what was in force before.
    """
    data = make_data(given)
    start = np.zeros(data.parameters)
    start[:PARAMETERS] = vector_of(parameters, data.rest_raw)
    fitted = fit_jointly(data, start, np.empty(0, dtype=np.int64))
    before = _before(given, data, fitted)
    return _angles_deg(before, data), _angles_deg(fitted.evaluation, data)


def _before(given: GyroscopeInput, data: GyroscopeData, fitted: JointFit) -> Evaluation | None:
    """Return the moves with the parameters before, under the Earth's rate that was found; None where nothing says them."""
    old = parameters_before(given)
    return None if old is None else evaluate(np.concatenate([vector_of(old, data.rest_raw), fitted.p[PARAMETERS:]]), data)


def _angles_deg(evaluation: Evaluation | None, data: GyroscopeData) -> FloatArray:
    after = data.moves.after
    return np.full(len(after), np.nan) if evaluation is None else np.degrees(evaluation.angle_error_rad(data.up[after]))


def _path(solution: JointSolution, turns: tuple[Sentence, ...]) -> str:
    data = solution.data
    rolled = sum(turn.key.startswith("whole_turns.rolled") for turn in turns)
    counts = (
        (len(data.moves.before), sentence("result.moves", moves=len(data.moves.before), stills=len(data.force))),
        (rolled, sentence("result.rolled", turns=rolled)),
        (len(data.stops), sentence("result.stops", stops=len(data.stops))),
        (len(data.table), sentence("result.table", pairs=len(data.table))),
    )
    earth = "result.no_latitude" if solution.given.latitude_deg is None else "result.vertical"
    if solution.chosen.fit.heading_fitted:
        earth = "result.azimuth"
    model = sentence("result.g_sensitivity" if solution.chosen.g_sensitive else "result.no_g_sensitivity")
    return "; ".join([*(told for count, told in counts if count), sentence(earth), model])


def _reasons(solution: JointSolution, moves: MoveReport, turns: tuple[Sentence, ...]) -> tuple[str, ...]:
    linearity = solution.linearity
    found_from = dict(zip(("asymmetry", "nonlinearity"), _FOUND_SIGMAS * linearity.sigma * [2, 1], strict=True))
    key = "result.range" if max(found_from.values()) < _SHOWN_BELOW else "result.range_not_shown"
    if linearity.sentences and key == "result.range":
        key = "result.range_of_named"  # A limit of detection says nothing beside a term that was found.
    not_shown = " and ".join(kind for kind, size in found_from.items() if not size < _SHOWN_BELOW)
    rates_deg_s = np.degrees(linearity.range_rad_s).tolist()
    sentences: list[str] = [sentence(key, rates_deg_s=rates_deg_s, not_shown=not_shown, **found_from)]
    if solution.given.grade is not None:
        M = np.diag(np.linalg.inv(solution.chosen.fit.p[INVERSE].reshape(3, 3)))
        by_scale = np.linalg.norm(linearity.hidden_root[SCALES], axis=1) * np.abs(M)
        sentences.append(sentence("result.typical", scale_ppm=1e6 * float(by_scale.max()), grade=solution.given.grade))
    sentences += [solution.chosen.sentence, *solution.warnings, *(() if linearity.matters else linearity.sentences)]
    if len(moves.after_deg):
        before_deg, after_deg = moves.rms_before_deg, moves.rms_after_deg
        key = "result.angle_errors" if np.isfinite(before_deg) else "result.angle_error"
        earlier = _earlier(solution.given)
        told = sentence(key, moves=len(moves.after_deg), before_deg=before_deg, after_deg=after_deg, earlier=earlier)
        gained = sentence("result.hardly_better", earlier=earlier)
        sentences.append(f"{told}: {gained}" if is_hardly_better(moves) else told)
    if solution.observability.hidden:
        sentences.append(sentence("result.hidden", names=solution.observability.hidden_names))
    if solution.data.chains > 1:
        sentences.append(sentence("result.chains", chains=solution.data.chains))
    sentences += [*solution.given.moves.dropped, *turns]
    start_s, off_deg = solution.given.moves.start_s, moves.after_deg
    sentences += [
        sentence("result.odd_move", start_s=start_s[k], off_deg=off_deg[k], sigmas=moves.sigma[k], limit=_SUSPICIOUS_SIGMAS)
        for k in np.flatnonzero(moves.sigma > _SUSPICIOUS_SIGMAS)
    ]
    return tuple(sentences)


def is_worse(moves: MoveReport) -> bool:
    """Whether the moves agree less than with the earlier parameters: a calibration is to make them better."""
    return moves.rms_after_deg > _WORSE * moves.rms_before_deg


def is_hardly_better(moves: MoveReport) -> bool:
    """Whether they agree hardly better than with the earlier parameters."""
    return moves.rms_after_deg > _HARDLY_BETTER * moves.rms_before_deg and not is_worse(moves)


def _earlier(given: GyroscopeInput) -> Sentence:
    """Return what the closing error before is of, in words."""
    return sentence("result.preset" if parameters_before(given) is given.preset else "result.nominal")
