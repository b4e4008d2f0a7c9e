"""What a gyroscope calibration returns: parameters, covariance, every move before and after, and the path in words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from imufield.calibrate.gyroscope.fit import EarthKnowledge, JointFit
from imufield.calibrate.gyroscope.model import GyroscopeData, evaluate
from imufield.calibrate.gyroscope.move_integration import BIAS, INVERSE, PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.moves import DroppedMove
from imufield.calibrate.gyroscope.sight import Sight
from imufield.calibrate.gyroscope.static_bias import GYROSCOPE_BIAS_NAMES, with_gyroscope
from imufield.calibrate.gyroscope.static_norm import StaticData, StaticFit, latitude_words
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

if TYPE_CHECKING:
    from imufield.calibrate.gyroscope.calibrate import GyroscopeInput

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


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveReport:
    """Every move that was used, arrays of shape (m,)."""

    start_s: FloatArray
    end_s: FloatArray
    before_deg: FloatArray
    """Angle between the measured and the integrated direction of gravity, with the parameters in force before, if any."""
    after_deg: FloatArray
    """The same with the new parameters."""
    sigma: FloatArray
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
    moves: MoveReport
    turns: tuple[WholeTurn, ...]
    dropped: tuple[DroppedMove, ...]
    g_sensitive: bool
    unobservable: tuple[str, ...]
    heading_fitted: bool
    drift_rad_s: float
    """Scatter of the bias from still to still, beyond noise."""
    reasons: tuple[str, ...]
    """Sentences: every warning, and what the result rests on."""
    cautions: tuple[str, ...] = ()
    """Sentences that make the verdict on the whole no better than usable."""
    basis: Described | StaticNorm | None = None
    """What it was fitted to, for other methods; None for a static bias."""

    def join(self, calibration: Calibration) -> Calibration:
        """Return the calibration with this gyroscope and one covariance matrix for all."""
        if not len(self.with_accelerometer):
            return _with_reasons(with_gyroscope(calibration, self.calibration), self)
        old = calibration.covariance_names
        keep = [k for k, name in enumerate(old) if name in ACCELEROMETER_NAMES]
        last = [k for k, name in enumerate(old) if name == GRAVITY_NAME]
        names = (*(old[k] for k in keep), *self.names, *(old[k] for k in last))
        places = [ACCELEROMETER_NAMES.index(old[k]) for k in keep]
        a, n = len(keep), len(self.names)
        covariance = np.zeros((len(names), len(names)))
        covariance[a : a + n, a : a + n] = self.covariance
        outer = [*range(a), *range(a + n, len(names))]
        covariance[np.ix_(outer, outer)] = calibration.covariance[np.ix_([*keep, *last], [*keep, *last])]
        theirs = covariance[np.ix_(outer, outer)]
        cross = bounded_cross_covariance(
            self.with_accelerometer[:, [*places, *([15] if last else [])]], self.covariance, theirs
        )
        covariance[a : a + n, outer], covariance[np.ix_(outer, range(a, a + n))] = cross, cross.T
        joined = replace(calibration, gyroscope=self.calibration, covariance_names=names, covariance=covariance)
        return _with_reasons(joined, self)


def _with_reasons(calibration: Calibration, result: GyroscopeResult) -> Calibration:
    quality = replace(calibration.quality, reasons=(*calibration.quality.reasons, *result.reasons))
    if result.cautions:
        quality = quality.lowered("usable", *result.cautions)
    return replace(calibration, quality=quality, unobservable=(*calibration.unobservable, *result.unobservable))


@dataclass(frozen=True, slots=True, kw_only=True)
class Described:
    """What a result is made of."""

    given: GyroscopeInput
    data: GyroscopeData
    fit: JointFit
    start: FloatArray
    sight: Sight
    fit_g: bool
    doubt: FloatArray
    words: tuple[str, ...]
    earth: EarthKnowledge


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticNorm:
    """What a result of the static norm path is made of."""

    given: GyroscopeInput
    data: StaticData
    start: FloatArray
    """A, b and v, shape (13,)."""
    columns: list[int]
    fitted: StaticFit
    rest_raw: FloatArray


def describe(what: Described) -> GyroscopeResult:
    """Return the result of a joint fit."""
    fitted = what.fit
    values, J = forward(fitted.p[:PARAMETERS], what.data.rest_raw)
    own = np.zeros((PARAMETERS, PARAMETERS))
    places = np.flatnonzero(fitted.free < PARAMETERS)
    columns = fitted.free[places]
    own[np.ix_(columns, columns)] = fitted.covariance[np.ix_(places, places)]
    own += np.outer(what.doubt[:PARAMETERS], what.doubt[:PARAMETERS])
    with_accelerometer = np.zeros((PARAMETERS, 16))
    with_accelerometer[columns] = -fitted.gain[places] @ fitted.parts.with_accelerometer
    covariance = J @ own @ J.T
    known = np.array([name not in what.sight.hidden_names for name in GYROSCOPE_NAMES])
    known[12:] &= what.fit_g
    sigma = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    calibration = GyroscopeCalibration(
        as_parameters(values), as_parameters(sigma), _path(what), what.given.observations.units.gyroscope_rate_unit
    )
    return GyroscopeResult(
        calibration=calibration,
        names=tuple(name for name, kept in zip(GYROSCOPE_NAMES, known, strict=True) if kept),
        covariance=covariance[np.ix_(known, known)],
        with_accelerometer=(J @ with_accelerometer)[known],
        moves=_move_report(what),
        turns=_whole_turns(what),
        dropped=what.given.moves.dropped,
        g_sensitive=what.fit_g,
        unobservable=what.sight.hidden_names,
        heading_fitted=fitted.heading_fitted,
        drift_rad_s=fitted.scatter.drift_rad_s,
        reasons=_reasons(what),
        cautions=() if fitted.solved.converged else (_unsettled(fitted.solved.message, what.given.latitude_deg),),
        basis=what,
    )


def static_result(gyroscope: GyroscopeCalibration, sentences: tuple[str, ...]) -> GyroscopeResult:
    """Return the result of a path that sees the bias alone."""
    none = np.empty(0)
    return GyroscopeResult(
        calibration=gyroscope,
        names=GYROSCOPE_BIAS_NAMES,
        covariance=np.diag(gyroscope.sigma.bias**2),
        with_accelerometer=np.empty((0, 16)),
        moves=MoveReport(start_s=none, end_s=none, before_deg=none, after_deg=none, sigma=none),
        turns=(),
        dropped=(),
        g_sensitive=False,
        unobservable=tuple(name for name in GYROSCOPE_NAMES[:9]),
        heading_fitted=False,
        drift_rad_s=float("nan"),
        reasons=sentences,
    )


def static_norm_result(what: StaticNorm) -> GyroscopeResult:
    """Return the result of the static norm path."""
    given, fitted = what.given, what.fitted
    values, J = forward(np.concatenate([fitted.x, np.zeros(9)]), what.rest_raw)
    own = np.zeros((PARAMETERS, PARAMETERS))
    own[:12, :12] = fitted.covariance
    covariance = J @ own @ J.T
    free = given.static_free == "all"
    known = np.array([name in GYROSCOPE_BIAS_NAMES or (free and k < 9) for k, name in enumerate(GYROSCOPE_NAMES)])
    sigma = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    seen = "scale, misalignment and bias" if free else "bias; scale and misalignment as given, not calibrated"
    path = f"static norm of the Earth rate at {len(given.observations)} still positions, any heading: {seen}"
    unsettled = () if fitted.converged else (_unsettled("it still moves after the last step", given.latitude_deg),)
    latitude = latitude_words(given.latitude_deg or 0.0, fitted.vertical_rad_s, fitted.vertical_sigma_rad_s)
    none = np.empty(0)
    return GyroscopeResult(
        calibration=GyroscopeCalibration(
            as_parameters(values), as_parameters(sigma), path, given.observations.units.gyroscope_rate_unit
        ),
        names=tuple(name for name, kept in zip(GYROSCOPE_NAMES, known, strict=True) if kept),
        covariance=covariance[np.ix_(known, known)],
        with_accelerometer=np.zeros((int(known.sum()), 16)),
        moves=MoveReport(start_s=none, end_s=none, before_deg=none, after_deg=none, sigma=none),
        turns=(),
        dropped=given.moves.dropped,
        g_sensitive=False,
        unobservable=() if free else GYROSCOPE_NAMES[:9],
        heading_fitted=True,
        drift_rad_s=fitted.scatter.drift_rad_s,
        reasons=(*latitude, *(one.sentence for one in given.moves.dropped)),
        cautions=unsettled,
        basis=what,
    )


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
        dM = -M @ unit[INVERSE].reshape(3, 3) @ M
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


def _move_report(what: Described) -> MoveReport:
    data, fitted, moves = what.data, what.fit, what.given.moves
    up = data.up[data.after]
    now, m = fitted.evaluation, len(moves)
    S = fitted.parts.total(fitted.scatter)
    blocks = np.array([S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(m)]).reshape(m, 2, 2)
    residual = now.residual[: 2 * m].reshape(m, 2)
    sigma = np.sqrt(np.einsum("mi,mij,mj->m", residual, np.linalg.inv(blocks), residual))
    before = np.full(m, np.nan)
    if what.sight.known:
        before = np.degrees(evaluate(what.start, data).angle_error_rad(up))
    after = np.degrees(now.angle_error_rad(up))
    return MoveReport(start_s=moves.start_s, end_s=moves.end_s, before_deg=before, after_deg=after, sigma=sigma)


def _whole_turns(what: Described) -> tuple[WholeTurn, ...]:
    before = evaluate(what.start, what.data) if what.sight.known else None
    return find_whole_turns(what.fit.evaluation, what.data, before)


def _path(what: Described) -> str:
    data = what.data
    parts = [f"{len(data.before)} moves between {len(data.force)} still positions against gravity"] if len(data.before) else []
    rolled = sum(turn.about == "horizontal" for turn in find_whole_turns(what.fit.evaluation, data))
    if rolled:
        parts.append(f"{rolled} of them whole turns closed by gravity")
    if len(data.stops):
        parts.append(f"{len(data.stops)} whole turns about the vertical against a stop")
    if len(data.table):
        parts.append(f"{len(data.table)} pairs of turntable rates")
    parts.append(_earth_words(what))
    parts.append("g-sensitivity fitted" if what.fit_g else "no g-sensitivity")
    return "; ".join(parts)


def _earth_words(what: Described) -> str:
    if what.fit.heading_fitted:
        return "Earth rate seen: one azimuth fitted for each unbroken chain of moves"
    if what.earth.vertical_sigma_rad_s > 0:
        return "Earth rate in the sigma, because the latitude is not known"
    return "vertical Earth rate taken off, horizontal part with unknown azimuth in the sigma"


def _reasons(what: Described) -> tuple[str, ...]:
    sentences = list(what.words)
    report = _move_report(what)
    if len(report.after_deg):
        before = f"{report.rms_before_deg:.3f} deg RMS before, " if np.isfinite(report.rms_before_deg) else ""
        sentences.append(
            f"gyroscope: angle error of {len(report.after_deg)} moves {before}{report.rms_after_deg:.3f} deg RMS after"
            + gain_words(report)
        )
    if what.sight.hidden:
        names = ", ".join(what.sight.hidden_names)
        sentences.append(f"these moves cannot show {names}; left at the preset's value")
    if what.data.chains > 1:
        sentences.append(f"the moves form {what.data.chains} separate chains, each with an azimuth of its own")
    sentences += [dropped.sentence for dropped in what.given.moves.dropped]
    sentences += [turn.sentence for turn in _whole_turns(what)]
    suspicious = np.flatnonzero(report.sigma > 4.5)
    sentences += [
        f"the move at {report.start_s[k]:.1f} s does not fit the others ({report.after_deg[k]:.2f} deg, {report.sigma[k]:.1f} "
        "sigma): repeat it"
        for k in suspicious
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
