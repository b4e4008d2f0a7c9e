"""Quality of an accelerometer calibration: the verdict good, usable or poor, and the sentences that say why."""

from __future__ import annotations

import shlex

import numpy as np

from imufield.calibrate.accelerometer.covariance import Uncertainty
from imufield.calibrate.accelerometer.fit import Fit, FitData
from imufield.calibrate.accelerometer.leave_one_out import PAIR_SHARE, position_pairs, single_positions
from imufield.calibrate.accelerometer.model_choice import VERDICT_LEVEL, ChosenModel
from imufield.calibrate.accelerometer.outliers import Outlier, find_outliers
from imufield.calibrate.accelerometer.unfitted_terms import Unshown
from imufield.calibrate.model.coverage_factors import student_factor
from imufield.calibrate.model.models import BIAS, SCALE
from imufield.calibrate.model.observability import Observability
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, Quality
from imufield.calibrate.model.uncertainty import SPARE_POSITIONS, estimated_share, rms
from imufield.dataclass import dataclass
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2, Gravity, contradiction
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, LARGEST_OFFSET_M_S2, FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

POOR_RESIDUAL_M_S2 = 5 * MILLI_G_M_S2
"""Leave-one-out RMS above this, or an outlier by more: a hold that was touched or a wrong column, not a consumer-grade sensor's
noise. One hold moves the bias by a third of what it is off."""
USABLE_SCALE_SIGMA = 1e-3
USABLE_BIAS_SIGMA_M_S2 = 2 * MILLI_G_M_S2
"""Above these, 1 sigma, a consumer-grade factory calibration is as good."""
MOST_DRIFT_M_S2 = MILLI_G_M_S2
"""What is left of a larger drift after time and its square shows in scale and misalignment."""
HIGH_CONDITION = 30.0
"""The schemes with 24 positions have 3 (linear) and 7 (quadratic)."""
SCALE_CHANGE = 0.01
SCALE_REFUSED = 0.2
"""A common scale further from the preset's than aging explains, and further than any instrument of that kind."""
SATURATION_RESIDUAL_M_S2 = POOR_RESIDUAL_M_S2
"""A fit bends around two clipped faces and leaves a tenth of what was cut off: 30 mg of 300 mg."""
TEMPERATURE_SPAN_DEGC = 5.0
"""Bias of a chip moves by 0.5 to 1 mg/degC (data sheets of MPU-6000 and BMI160): here as much as ``POOR_RESIDUAL_M_S2``."""
# Means at the same extreme of an axis: two different placements do not agree to the last digit by chance.
_SATURATED_POSITIONS = 2
# Share of an axis' span within which two means are the same number: the mean of a constant is that to rounding. Within 1e-9
# two of thousands of sessions agreed by chance.
_SAME_OUTPUT = 1e-12
# What paper24 leaves with drift and quadratic term. With four, as after two holds that were left out, terms are admitted that
# by chance leave no scatter where it is 100 ug, and sigma was up to 20 times too small.
_SPARE_WITH_DRIFT = 6
_LEAST_SHARE = 1e-3  # Below, the residuals tell nothing.
_WORTH_TELLING = 1.05  # A sigma that is raised by less is not told.


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What the verdict rests on."""

    observations: Observations
    gravity: Gravity
    data: FitData
    chosen: ChosenModel
    fitted: Fit
    """In the wanted gauge; that of ``chosen`` is in the lower one."""
    known: Uncertainty
    hidden: Unshown
    observability: Observability
    unobservable: tuple[str, ...]
    sign_source: str
    scale_ratio: float | None
    """Common scale over the preset's; None without a preset."""
    grade: str | None
    """Whose typical errors stand for what no residual shows."""

    @property
    def leave_one_out_m_s2(self) -> FloatArray:
        """Residual of each position with parameters fitted without it, shape (m,)."""
        return self.known.spread.leave_one_out * self.fitted.sigma_m_s2

    @property
    def student_factor_95(self) -> float:
        """From sigma to the 95 % limit: one for all numbers, so that of their mean."""
        freedom = self.fitted.effective_degrees_of_freedom * self.chosen.choice.freedom_ratio
        told = estimated_share(self.known.covariance, self.hidden.typical)
        return student_factor(freedom / max(told, _LEAST_SHARE) ** 2)


def judge(evidence: Evidence) -> Quality:
    """Return figures, verdict and reasons."""
    fitted, freedom = evidence.fitted, evidence.fitted.degrees_of_freedom
    residual_rms, without = rms(fitted.residual_m_s2), rms(evidence.leave_one_out_m_s2)
    parameters = fitted.basis.shape[1]
    of_model = len(evidence.chosen.free)
    parts = (
        "" if evidence.chosen.drift is None else sentence("quality.parts", of_model=of_model, of_drift=parameters - of_model)
    )
    summary = sentence(
        "quality.summary" if np.isfinite(without) else "quality.summary_none_to_spare",
        positions=len(evidence.observations),
        parameters=parameters,
        parts=parts,
        spare=freedom,
        residual_mg=residual_rms / MILLI_G_M_S2,
        left_out_mg=without / MILLI_G_M_S2,
    )
    outliers = find_outliers(fitted)
    gross = [outlier for outlier in outliers if abs(outlier.off_m_s2) > POOR_RESIDUAL_M_S2]
    # First: what else is poor, and large, is so because of them.
    poor = _outlier_sentences(evidence, "quality.gross_outlier", gross)
    poor += poor_sentences(None if fitted.solved.converged else fitted.solved.message, freedom, without)
    mild = _outlier_sentences(evidence, "quality.outlier", [outlier for outlier in outliers if outlier not in gross])
    coarse = sigma_sentences(fitted.vector, evidence.known.sigma, evidence.gravity)
    cautions = [*_position_sentences(evidence), *mild, *_cautions(evidence), *coarse]
    return Quality(
        residual_rms_m_s2=residual_rms,
        residual_max_m_s2=float(np.abs(fitted.residual_m_s2).max()),
        leave_one_out_rms_m_s2=without,
        between_position_sigma_m_s2=fitted.tau_m_s2,
        degrees_of_freedom=freedom,
        student_factor_95=evidence.student_factor_95,
        rank=evidence.observability.rank,
        parameters_fitted=parameters,
        condition=evidence.observability.condition,
        verdict="poor" if poor else "usable" if cautions else "good",
        reasons=(summary, *poor, *cautions, *_notes(evidence)),
        warnings=(*poor, *cautions),
        suspects=tuple(evidence.observations.name[outlier.position] for outlier in outliers),
    )


def common_scale_ratio(scale: FloatArray, preset_scale: FloatArray) -> float:
    """Return the common scale over the preset's.

    Raises
    ------
    CalibrationError
        If they differ so much that unit, gravity or preset must be wrong.
    """
    ratio = float(np.exp(np.mean(np.log(np.abs(scale / preset_scale)))))
    if not 1 / (1 + SCALE_REFUSED) <= ratio <= 1 + SCALE_REFUSED:
        raise CalibrationError(sentence("quality.preset_scale", ratio=ratio, limit=SCALE_REFUSED), Reason.UNITS)
    return ratio


def refuse_saturation(raw: FloatArray, residual_m_s2: FloatArray) -> None:
    """Refuse outputs that stop at one value where the fit says they should not.

    Raises
    ------
    CalibrationError
    """
    worst = float(np.abs(residual_m_s2).max())
    if worst < SATURATION_RESIDUAL_M_S2:
        return
    for axis in range(3):
        ordered = np.sort(raw[:, axis])
        same = np.diff(ordered) <= _SAME_OUTPUT * (ordered[-1] - ordered[0])
        low = int(np.argmin(np.append(same, False))) + 1
        high = int(np.argmin(np.append(same[::-1], False))) + 1
        # Coarse steps make values equal anywhere, not at the ends alone.
        if same[low - 1 : len(same) - high + 1].any():
            continue
        limit, count = (float(ordered[0]), low) if low >= _SATURATED_POSITIONS else (float(ordered[-1]), high)
        if count >= _SATURATED_POSITIONS:
            values = {"worst_mg": worst / MILLI_G_M_S2, "accepted_mg": SATURATION_RESIDUAL_M_S2 / MILLI_G_M_S2}
            clipped = sentence("quality.saturated", axis=AXES[axis], limit=limit, count=count, **values)
            raise CalibrationError(clipped, Reason.SATURATED)


def poor_sentences(unsettled: str | None, degrees_of_freedom: int, leave_one_out_rms_m_s2: float) -> list[str]:
    """Return why a calibration is poor; none where it is not.

    ``unsettled`` is what a solver says that did not converge, None where it did.
    """
    reasons: list[str] = []
    if unsettled is not None:
        reasons.append(sentence("quality.not_converged", message=unsettled))
    if degrees_of_freedom < 1:
        reasons.append(sentence("quality.none_to_spare"))
    if leave_one_out_rms_m_s2 > POOR_RESIDUAL_M_S2:
        off_mg, limit_mg = leave_one_out_rms_m_s2 / MILLI_G_M_S2, POOR_RESIDUAL_M_S2 / MILLI_G_M_S2
        # The residuals of few positions do not show which of them is wrong.
        key = "quality.few_disagree" if degrees_of_freedom < SPARE_POSITIONS else "quality.disagree"
        reasons.append(sentence(key, off_mg=off_mg, limit_mg=limit_mg))
    return reasons


def _cautions(evidence: Evidence) -> list[str]:
    """Return what lowers the verdict beside single positions, outliers and large sigmas."""
    reasons: list[str] = []
    if evidence.unobservable:
        reasons.append(_unobservable_sentence(evidence))
    freedom = evidence.fitted.degrees_of_freedom
    if 0 < freedom < (SPARE_POSITIONS if evidence.chosen.drift is None else _SPARE_WITH_DRIFT):
        reasons.append(sentence("quality.few_to_spare", spare=freedom, factor=evidence.student_factor_95))
    condition = evidence.observability.condition
    if condition > HIGH_CONDITION:
        reasons.append(sentence("quality.one_sided", condition=condition, limit=HIGH_CONDITION))
    reasons += _model_sentences(evidence)
    gravity = evidence.gravity
    if gravity.source == "assumed":
        share_ppm = gravity.sigma_m_s2 / gravity.gravity_m_s2 * 1e6
        reasons.append(sentence("quality.assumed_gravity", gravity_m_s2=gravity.gravity_m_s2, share_ppm=share_ppm))
    if differ := contradiction(gravity):
        reasons.append(differ)
    ratio = evidence.scale_ratio
    if ratio is not None and abs(ratio - 1) > SCALE_CHANGE:
        reasons.append(sentence("quality.scale_change", change=ratio - 1, limit=SCALE_CHANGE))
    temperature = evidence.observations.temperature_degc
    known = temperature[np.isfinite(temperature)]
    if known.size and np.ptp(known) > TEMPERATURE_SPAN_DEGC:
        span = {"low_degc": known.min(), "high_degc": known.max(), "limit_degc": TEMPERATURE_SPAN_DEGC}
        reasons.append(sentence("quality.temperature", **span))
    return reasons


def _model_sentences(evidence: Evidence) -> list[str]:
    """Return what the model says of drift, and of terms that it does not have."""
    chosen = evidence.chosen
    reasons: list[str] = [*chosen.cautions]
    drift_mg, most_mg = evidence.fitted.drift_span_m_s2 / MILLI_G_M_S2, MOST_DRIFT_M_S2 / MILLI_G_M_S2
    if drift_mg > most_mg:
        reasons.append(sentence("quality.drift", drift_mg=drift_mg, limit_mg=most_mg))
    if (left_out := chosen.left_out) is not None:
        sizes_mg = {"cubic_mg": left_out.cubic_m_s2 / MILLI_G_M_S2, "cross_mg": left_out.cross_m_s2 / MILLI_G_M_S2}
        reasons.append(sentence("quality.left_out_terms", p=left_out.p, limit=VERDICT_LEVEL, **sizes_mg))
    return reasons


def _unobservable_sentence(evidence: Evidence) -> str:
    """Return what the positions do not show and what that costs."""
    hidden = evidence.unobservable
    known_costs = {"misalignment": "quality.misalignment_cost", "quadratic": "quality.quadratic_cost"}
    costs = [sentence(key) for kind, key in known_costs.items() if any(kind in name for name in hidden)]
    key = "quality.hidden_as_zero" if evidence.scale_ratio is None else "quality.hidden_as_preset"
    told_costs = "; ".join(costs or [sentence("quality.other_cost")])
    return sentence(key, names=[_words(name) for name in hidden], costs=told_costs)


def sigma_sentences(vector: FloatArray, sigma: FloatArray, gravity: Gravity, remedy: Sentence | None = None) -> list[Sentence]:
    """Return what of scale and bias is too uncertain for a good verdict, of one session or of several as one.

    Parameters
    ----------
    vector, sigma : ndarray, shape (15,)
        Parameters and 1 sigma.
    gravity : Gravity
    remedy : Sentence, optional
        What makes them surer; by default more positions.
    """
    relative, bias = sigma[SCALE] / np.abs(vector[SCALE]), sigma[BIAS]
    remedy = remedy or sentence("quality.more_positions")
    reasons: list[Sentence] = []
    # Written so that NaN (no uncertainty at all) counts as too large.
    if not np.all(relative <= USABLE_SCALE_SIGMA) and gravity.source != "assumed":
        by_gravity = gravity.sigma_m_s2 / gravity.gravity_m_s2
        # Half of the variance: more positions leave that as it is.
        key = "quality.scale_sigma_by_gravity" if 2 * by_gravity**2 > relative.max() ** 2 else "quality.scale_sigma"
        key = key if np.isfinite(relative).all() else "quality.no_scale_sigma"
        sizes_ppm = {"sigma_ppm": relative.max() * 1e6, "gravity_ppm": by_gravity * 1e6, "limit_ppm": USABLE_SCALE_SIGMA * 1e6}
        reasons.append(sentence(key, remedy=remedy, **sizes_ppm))
    if not np.all(bias <= USABLE_BIAS_SIGMA_M_S2):
        key = "quality.bias_sigma" if np.isfinite(bias).all() else "quality.no_bias_sigma"
        sizes_mg = {"sigma_mg": bias.max() / MILLI_G_M_S2, "limit_mg": USABLE_BIAS_SIGMA_M_S2 / MILLI_G_M_S2}
        # Of so large a bias, the uncertainty of the scale makes most.
        if (largest := float(np.abs(vector[BIAS]).max())) > LARGEST_OFFSET_M_S2:
            bias_g = {"bias_g": largest / STANDARD_GRAVITY_M_S2, "most_g": LARGEST_OFFSET_M_S2 / STANDARD_GRAVITY_M_S2}
            remedy = sentence("quality.raw_zero", **bias_g)
        reasons.append(sentence(key, remedy=remedy, **sizes_mg))
    return reasons


def _position_sentences(evidence: Evidence) -> list[str]:
    """Name positions that parameters rest on alone."""
    free = evidence.chosen.free
    sentences: list[str] = []
    if evidence.fitted.degrees_of_freedom < 1:
        return sentences
    for single in single_positions(evidence.known.geometry):
        names = [_words(ACCELEROMETER_NAMES[free[k]]) for k in single.coordinates]
        raised = float(evidence.known.factors[list(single.coordinates)].max())
        key = "quality.carries_raised" if raised > _WORTH_TELLING else "quality.carries"
        position = evidence.observations.name[single.position]
        sentences.append(sentence(key, position=position, names=names, leverage=single.leverage, raised=raised))
    # Of two holds that were touched and two that were not the residuals often cannot say which are which: whoever left out the
    # wrong ones sees nothing more. Without a hold that was left out there is no reason to doubt two that agree.
    left_out = list(evidence.observations.left_out)
    for pair in position_pairs(evidence.known.geometry) if left_out else ():
        told = {"name": _words(ACCELEROMETER_NAMES[free[pair.coordinate]]), "share": pair.share, "limit": PAIR_SHARE}
        two = [evidence.observations.name[position] for position in pair.positions]
        sentences.append(sentence("quality.carried_by_two", positions=two, left_out=left_out, **told))
    return sentences


def _outlier_sentences(evidence: Evidence, key: str, outliers: list[Outlier]) -> list[str]:
    """Name the positions that the others contradict, and how to leave them out."""
    return [
        sentence(
            key,
            position=(name := evidence.observations.name[outlier.position]),
            off_mg=outlier.off_m_s2 / MILLI_G_M_S2,
            sigmas=outlier.sigmas,
            limit=outlier.limit,
            limit_mg=POOR_RESIDUAL_M_S2 / MILLI_G_M_S2,
            option=shlex.quote(f"--without={name}"),
        )
        for outlier in outliers
    ]


def _notes(evidence: Evidence) -> list[str]:
    notes: list[str] = [*evidence.chosen.sentences]
    if evidence.grade is not None:
        typical = np.linalg.norm(evidence.hidden.typical, axis=1)
        scale_ppm = 1e6 * np.max(typical[SCALE] / np.abs(evidence.fitted.vector[SCALE]))
        bias_mg = np.max(typical[BIAS]) / MILLI_G_M_S2
        notes.append(sentence("quality.typical", grade=evidence.grade, bias_mg=bias_mg, scale_ppm=scale_ppm))
    if evidence.data.covariance_raw is None:
        notes.append(sentence("quality.no_covariance"))
    if evidence.sign_source == "assumed":
        notes.append(sentence("quality.assumed_signs"))
    gravity = evidence.gravity
    if gravity.source != "assumed":
        share = gravity.sigma_m_s2 / gravity.gravity_m_s2
        key = "quality.few_digits" if gravity.has_few_digits else "quality.unchecked_gravity"
        share_ppm = f"{share * 1e6:{'.0f' if share >= 1e-5 else '.2g'}}"
        notes.append(sentence(key, sigma_m_s2=gravity.sigma_m_s2, share_ppm=share_ppm))
    return notes


def _words(name: str) -> str:
    """Return "bias x" for "accelerometer.bias_m_s2.x"."""
    _, quantity, axis = name.split(".")
    return f"{quantity.removesuffix('_m_s2').removesuffix('_rad')} {axis}"
