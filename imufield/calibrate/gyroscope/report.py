"""What a gyroscope calibration returns: parameters, covariance, every move before and after, and the path in words."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.gyroscope.fit import EarthKnowledge
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.model_choice import ChosenModel
from imufield.calibrate.gyroscope.move_integration import BIAS, INVERSE, PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.observability import Observability
from imufield.calibrate.gyroscope.residuals import GyroscopeData, evaluate
from imufield.calibrate.gyroscope.static import GYROSCOPE_BIAS_NAMES, StaticData, StaticFit, latitude_words
from imufield.calibrate.gyroscope.whole_turns import WholeTurn, find_whole_turns
from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
)
from imufield.calibrate.model.uncertainty import bounded_cross_covariance
from imufield.samples import AXES, FloatArray

GYROSCOPE_NAMES = (
    *(f"gyroscope.scale.{axis}" for axis in AXES),
    *(f"gyroscope.misalignment_rad.{pair}" for pair in ("xy", "xz", "yx", "yz", "zx", "zy")),
    *GYROSCOPE_BIAS_NAMES,
    *(f"gyroscope.g_sensitivity.{row}{column}" for row in AXES for column in AXES),
)
"""The 21 gyroscope parameters in the order of every vector and covariance matrix."""

# Share of the angle error before that is left where a fit has gained little; a session of placed positions leaves 0.12.
_HARDLY_BETTER = 0.8
_WORSE = 1.1
_SUSPICIOUS_SIGMAS = 4.5  # A residual has two components; one good move in 25 000 is further off.


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveReport:
    """Every move that was used, arrays of shape (m,)."""

    start_s: FloatArray = field(default_factory=lambda: np.empty(0))
    end_s: FloatArray = field(default_factory=lambda: np.empty(0))
    before_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    """Angle between the measured and the integrated direction of gravity, with the parameters in force before, if any."""
    after_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    """The same with the new parameters."""
    sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    """Length of the residual over its own sigma; 1.4 is typical, 4 is suspicious."""

    @property
    def rms_before_deg(self) -> float:
        """Root mean square of ``before_deg``; NaN without moves."""
        return _rms(self.before_deg)

    @property
    def rms_after_deg(self) -> float:
        """Root mean square of ``after_deg``; NaN without moves."""
        return _rms(self.after_deg)


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
    turns: tuple[WholeTurn, ...] = ()
    g_sensitive: bool = False
    unobservable: tuple[str, ...]
    heading_fitted: bool = False
    drift_rad_s: float = float("nan")
    """Scatter of the bias from still to still, beyond noise."""
    reasons: tuple[str, ...]
    """Sentences: every warning, and what the result rests on."""
    cautions: tuple[str, ...] = ()
    """Sentences that make the verdict on the whole no better than usable."""
    basis: JointSolution | StaticSolution | None = None
    """What it was fitted to, for other methods; None for a static bias."""

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
        columns = [*(ACCELEROMETER_NAMES.index(old[k]) for k in accelerometer), *([15] if gravity else [])]
        cross = bounded_cross_covariance(self.with_accelerometer[:, columns], self.covariance, theirs)
        covariance = np.zeros((len(names), len(names)))
        covariance[a : a + n, a : a + n] = self.covariance
        covariance[np.ix_(outer, outer)] = theirs
        covariance[a : a + n, outer], covariance[np.ix_(outer, range(a, a + n))] = cross, cross.T
        quality = replace(calibration.quality, reasons=(*calibration.quality.reasons, *self.reasons))
        return replace(
            calibration,
            gyroscope=self.calibration,
            covariance_names=names,
            covariance=covariance,
            quality=quality.lowered("usable", *self.cautions) if self.cautions else quality,
            unobservable=(*calibration.unobservable, *self.unobservable),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSolution:
    """Input, data and fit of moves, stills, stops and turntable rates together."""

    given: GyroscopeInput
    data: GyroscopeData
    chosen: ChosenModel
    start: FloatArray
    observability: Observability
    earth: EarthKnowledge
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSolution:
    """Input, data and fit of the static norm path."""

    given: GyroscopeInput
    data: StaticData
    fitted: StaticFit
    rest_raw: FloatArray


def joint_result(solution: JointSolution) -> GyroscopeResult:
    """Return the result of a joint fit."""
    chosen, fitted, observability = solution.chosen, solution.chosen.fit, solution.observability
    # The covariance of the fit in all 21 parameters; what a rejected g-sensitivity may hide adds d d^T.
    own = np.zeros((PARAMETERS, PARAMETERS))
    places = np.flatnonzero(fitted.free < PARAMETERS)
    columns = fitted.free[places]
    # Parameters that were not fitted have no variance of their own.
    own[np.ix_(columns, columns)] = fitted.covariance[np.ix_(places, places)]
    own += np.outer(chosen.hidden_change[:PARAMETERS], chosen.hidden_change[:PARAMETERS])
    # An error of the accelerometer moves the residuals, and the fit follows with -gain.
    with_accelerometer = np.zeros((PARAMETERS, 16))
    with_accelerometer[columns] = -fitted.gain[places] @ fitted.parts.with_accelerometer
    known = np.array([name not in observability.hidden_names for name in GYROSCOPE_NAMES])
    known[12:] &= chosen.g_sensitive
    data, now, m = solution.data, fitted.evaluation, len(solution.given.moves)
    before = evaluate(solution.start, data) if observability.known else None
    turns = find_whole_turns(now, data, before)
    S = fitted.parts.total(fitted.scatter)
    blocks = np.array([S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(m)]).reshape(m, 2, 2)
    residual, up = now.residual[: 2 * m].reshape(m, 2), data.up[data.after]
    moves = MoveReport(
        start_s=solution.given.moves.start_s,
        end_s=solution.given.moves.end_s,
        before_deg=np.full(m, np.nan) if before is None else np.degrees(before.angle_error_rad(up)),
        after_deg=np.degrees(now.angle_error_rad(up)),
        sigma=np.sqrt(np.einsum("mi,mij,mj->m", residual, np.linalg.inv(blocks), residual)),
    )
    calibration, covariance, J = _calibration(fitted.p[:PARAMETERS], own, known, solution, path=_path(solution, turns))
    return GyroscopeResult(
        calibration=calibration,
        names=tuple(name for name, kept in zip(GYROSCOPE_NAMES, known, strict=True) if kept),
        covariance=covariance,
        with_accelerometer=(J @ with_accelerometer)[known],
        moves=moves,
        turns=turns,
        g_sensitive=chosen.g_sensitive,
        unobservable=observability.hidden_names,
        heading_fitted=fitted.heading_fitted,
        drift_rad_s=fitted.scatter.drift_rad_s,
        reasons=_reasons(solution, moves, turns),
        cautions=() if fitted.solved.converged else (_unsettled(fitted.solved.message, solution.given.latitude_deg),),
        basis=solution,
    )


def static_bias_result(gyroscope: GyroscopeCalibration, sentences: tuple[str, ...]) -> GyroscopeResult:
    """Return the result of a path that sees the bias alone."""
    return GyroscopeResult(
        calibration=gyroscope,
        names=GYROSCOPE_BIAS_NAMES,
        covariance=np.diag(gyroscope.sigma.bias**2),
        with_accelerometer=np.zeros((len(GYROSCOPE_BIAS_NAMES), 16)),
        unobservable=GYROSCOPE_NAMES[:9],
        reasons=sentences,
    )


def static_norm_result(solution: StaticSolution) -> GyroscopeResult:
    """Return the result of the static norm path."""
    given, fitted = solution.given, solution.fitted
    own = np.zeros((PARAMETERS, PARAMETERS))
    own[:12, :12] = fitted.covariance
    everything = given.static_free == "all"
    known = np.array([name in GYROSCOPE_BIAS_NAMES or (everything and k < 9) for k, name in enumerate(GYROSCOPE_NAMES)])
    fitted_words = "scale, misalignment and bias" if everything else "bias; scale and misalignment as given, not calibrated"
    path = f"static norm of the Earth rate at {len(given.observations)} still positions, any heading: {fitted_words}"
    calibration, covariance, _ = _calibration(np.concatenate([fitted.x, np.zeros(9)]), own, known, solution, path=path)
    latitude = latitude_words(given.latitude_deg or 0.0, fitted.vertical_rad_s, fitted.vertical_sigma_rad_s)
    unsettled = () if fitted.converged else (_unsettled("it still moves after the last step", given.latitude_deg),)
    return GyroscopeResult(
        calibration=calibration,
        names=tuple(name for name, kept in zip(GYROSCOPE_NAMES, known, strict=True) if kept),
        covariance=covariance,
        with_accelerometer=np.zeros((int(known.sum()), 16)),
        unobservable=() if everything else GYROSCOPE_NAMES[:9],
        heading_fitted=True,
        drift_rad_s=fitted.scatter.drift_rad_s,
        reasons=(*latitude, *(move.sentence for move in given.moves.dropped)),
        cautions=unsettled,
        basis=solution,
    )


def _calibration(
    x: FloatArray, own: FloatArray, known: NDArray[np.bool_], solution: JointSolution | StaticSolution, *, path: str
) -> tuple[GyroscopeCalibration, FloatArray, FloatArray]:
    """Return parameters and sigma at ``x`` of covariance ``own``, the covariance of the known ones, and d parameters / d x."""
    rest_raw = solution.data.rest_raw if isinstance(solution, JointSolution) else solution.rest_raw
    values, J = forward(x, rest_raw)
    covariance = J @ own @ J.T
    sigma = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    unit = solution.given.observations.units.gyroscope_rate_unit
    calibration = GyroscopeCalibration(as_parameters(values), as_parameters(sigma), path, unit)
    return calibration, covariance[np.ix_(known, known)], J


def _unsettled(how: str, latitude_deg: float | None) -> str:
    """Say that a fit has not ended, and what usually helps."""
    start = f"the gyroscope fit did not come to an end ({how}), so its parameters and their sigma are not final: "
    if latitude_deg is None:
        return start + "repeat the session with longer holds and slower turns"
    return start + (
        "most often the data do not show the Earth's rate that the latitude stands for (it was simulated without, or taken "
        "off before); solve again with --gravity in place of --latitude, and if it stays so, repeat the session"
    )


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


def as_parameters(vector: FloatArray) -> GyroscopeParameters:
    """Return the parameters of a vector in the order of ``GYROSCOPE_NAMES``."""
    misalignment = np.zeros((3, 3))
    misalignment[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS] = vector[3:9]
    return GyroscopeParameters(vector[:3].copy(), misalignment, vector[9:12].copy(), vector[12:].reshape(3, 3).copy())


def _path(solution: JointSolution, turns: tuple[WholeTurn, ...]) -> str:
    data, fitted = solution.data, solution.chosen.fit
    parts = [f"{len(data.before)} moves between {len(data.force)} still positions against gravity"] if len(data.before) else []
    rolled = sum(turn.about == "horizontal" for turn in turns)
    if rolled:
        parts.append(f"{rolled} of them whole turns closed by gravity")
    if len(data.stops):
        parts.append(f"{len(data.stops)} whole turns about the vertical against a stop")
    if len(data.table):
        parts.append(f"{len(data.table)} pairs of turntable rates")
    if fitted.heading_fitted:
        parts.append("Earth rate seen: one azimuth fitted for each unbroken chain of moves")
    elif solution.earth.vertical_sigma_rad_s > 0:
        parts.append("Earth rate in the sigma, because the latitude is not known")
    else:
        parts.append("vertical Earth rate taken off, horizontal part with unknown azimuth in the sigma")
    parts.append("g-sensitivity fitted" if solution.chosen.g_sensitive else "no g-sensitivity")
    return "; ".join(parts)


def _reasons(solution: JointSolution, moves: MoveReport, turns: tuple[WholeTurn, ...]) -> tuple[str, ...]:
    sentences = [solution.chosen.sentence, *solution.warnings]
    if len(moves.after_deg):
        before = f"{moves.rms_before_deg:.3f} deg RMS before, " if np.isfinite(moves.rms_before_deg) else ""
        sentences.append(
            f"gyroscope: angle error of {len(moves.after_deg)} moves {before}{moves.rms_after_deg:.3f} deg RMS after"
            + gain_words(moves)
        )
    if solution.observability.hidden:
        names = ", ".join(solution.observability.hidden_names)
        sentences.append(f"these moves cannot show {names}; left at the preset's value")
    if solution.data.chains > 1:
        sentences.append(f"the moves form {solution.data.chains} separate chains, each with an azimuth of its own")
    sentences += [move.sentence for move in solution.given.moves.dropped]
    sentences += [turn.sentence for turn in turns]
    sentences += [
        f"the move at {moves.start_s[k]:.1f} s does not fit the others ({moves.after_deg[k]:.2f} deg, {moves.sigma[k]:.1f} "
        "sigma): repeat it"
        for k in np.flatnonzero(moves.sigma > _SUSPICIOUS_SIGMAS)
    ]
    return tuple(sentences)


def gain_words(report: MoveReport) -> str:
    """Return what to add where the moves agree hardly better, or worse, than with the parameters in force before."""
    before, after = report.rms_before_deg, report.rms_after_deg
    if not after > _HARDLY_BETTER * before:
        return ""
    if after > before * _WORSE:
        return (
            ": worse than before, as each move weighs by its own uncertainty; these moves and positions are too few or too "
            "rough to better the gyroscope, so add to them, or keep the parameters before"
        )
    return (
        ": hardly better than before, so the parameters before were as good, or these moves are too rough to show it; to "
        "know the gyroscope better put the unit down between the turns"
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
