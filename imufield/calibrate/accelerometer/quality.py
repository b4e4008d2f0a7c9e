"""Quality of an accelerometer calibration: the verdict good, usable or poor, and the sentences that say why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.calibrate.accelerometer.fit import Fit, FitData
from imufield.calibrate.accelerometer.model_choice import ChosenModel
from imufield.calibrate.model.models import BIAS, SCALE
from imufield.calibrate.model.observability import Observability
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, Quality
from imufield.calibrate.model.uncertainty import Influence, single_positions, student_factor
from imufield.earth import MEASURED_GRAVITY_SIGMA_M_S2, MILLI_G_M_S2, Gravity, contradiction
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray
from imufield.sentences import counted

POOR_RESIDUAL_M_S2 = 5 * MILLI_G_M_S2
"""Leave-one-out RMS above this: a hold that was touched or a wrong column, not a consumer-grade sensor's noise."""
USABLE_SCALE_SIGMA = 1e-3
USABLE_BIAS_SIGMA_M_S2 = 2 * MILLI_G_M_S2
"""Above these, 1 sigma, a consumer-grade factory calibration is as good."""
SPARE_POSITIONS = 4
"""Degrees of freedom below this give Student factors of 3.2 and more."""
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
# Share of an axis' span within which two means are the same number: the mean of a constant is that to rounding.
_SAME_OUTPUT = 1e-9
_OUTLIER_LEVEL = 0.01  # Chance that one of all positions of a good session is called an outlier (both sides, Bonferroni).


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What the verdict rests on."""

    observations: Observations
    gravity: Gravity
    data: FitData
    chosen: ChosenModel
    fitted: Fit
    """In the wanted gauge; that of ``chosen`` is in the lower one."""
    spread: Influence
    factors: FloatArray
    """By how much the sigma of each coordinate is raised, shape (n,)."""
    observability: Observability
    unobservable: tuple[str, ...]
    sign_source: str
    scale_ratio: float | None
    """Common scale over the preset's; None without a preset."""
    sigma: FloatArray
    """1 sigma of the 15 parameters."""

    @property
    def leave_one_out_m_s2(self) -> FloatArray:
        """Residual of each position with parameters fitted without it, shape (m,)."""
        return self.spread.leave_one_out * self.fitted.sigma_m_s2


def judge(evidence: Evidence) -> Quality:
    """Return figures, verdict and reasons."""
    fitted, freedom = evidence.fitted, evidence.fitted.degrees_of_freedom
    residual_rms, without = _rms(fitted.residual_m_s2), _rms(evidence.leave_one_out_m_s2)
    positions, parameters = len(evidence.observations), len(evidence.chosen.free)
    summary = (
        f"{counted(positions, 'position')}, {counted(parameters, 'parameter')}, {freedom} to spare: "
        f"residual {residual_rms / MILLI_G_M_S2:.3f} mg RMS"
        + (f", {without / MILLI_G_M_S2:.3f} mg with each position left out" if np.isfinite(without) else "")
    )
    poor = poor_sentences(None if fitted.solved.converged else fitted.solved.message, freedom, without)
    cautions = [*_position_sentences(evidence), *_cautions(evidence), *_sigma_sentences(evidence)]
    return Quality(
        residual_rms_m_s2=residual_rms,
        residual_max_m_s2=float(np.abs(fitted.residual_m_s2).max()),
        leave_one_out_rms_m_s2=without,
        between_position_sigma_m_s2=fitted.tau_m_s2,
        degrees_of_freedom=freedom,
        student_factor_95=student_factor(fitted.effective_degrees_of_freedom),
        rank=evidence.observability.rank,
        parameters_fitted=parameters,
        condition=evidence.observability.condition,
        verdict="poor" if poor else "usable" if cautions else "good",
        reasons=(summary, *poor, *cautions, *_notes(evidence)),
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
        raise CalibrationError(
            f"the common scale is {ratio:.4g} times the preset's (at most {SCALE_REFUSED:.0%} off is accepted); check raw "
            "unit, range setting and preset",
            Reason.UNITS,
            ratio=ratio,
        )
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
            raise CalibrationError(
                f"axis {AXES[axis]} stops at {limit:g} in {count} positions while the norm is wrong by up to "
                f"{worst / MILLI_G_M_S2:.0f} mg (limit {SATURATION_RESIDUAL_M_S2 / MILLI_G_M_S2:.0f} mg): it is saturated; "
                "choose a larger range and take them again",
                Reason.SATURATED,
                axis=AXES[axis],
                limit=limit,
            )


def _rms(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def poor_sentences(unsettled: str | None, degrees_of_freedom: int, leave_one_out_rms_m_s2: float) -> list[str]:
    """Return why a calibration is poor; none where it is not.

    ``unsettled`` is what a solver says that did not converge, None where it did.
    """
    reasons = []
    if unsettled is not None:
        reasons.append(f"the solver did not converge: {unsettled}")
    if degrees_of_freedom < 1:
        reasons.append("no position is left over to check the others: the uncertainty leaves out the scatter between positions")
    if leave_one_out_rms_m_s2 > POOR_RESIDUAL_M_S2:
        reasons.append(
            f"positions disagree by {leave_one_out_rms_m_s2 / MILLI_G_M_S2:.1f} mg RMS "
            f"(limit {POOR_RESIDUAL_M_S2 / MILLI_G_M_S2:.0f} mg): retake the worst, and hold it still"
        )
    return reasons


def _cautions(evidence: Evidence) -> list[str]:
    """Return what lowers the verdict beside single positions, outliers and large sigmas."""
    reasons = []
    if evidence.unobservable:
        reasons.append(_unobservable_sentence(evidence))
    freedom = evidence.fitted.degrees_of_freedom
    if 0 < freedom < SPARE_POSITIONS:
        factor = student_factor(evidence.fitted.effective_degrees_of_freedom)
        reasons.append(f"only {counted(freedom, 'position')} to spare: a 95 % interval is {factor:.1f} sigma")
    condition = evidence.observability.condition
    if condition > HIGH_CONDITION:
        reasons.append(f"the positions are one-sided (condition {condition:.0f}, limit {HIGH_CONDITION:.0f})")
    if evidence.gravity.source == "assumed":
        share = evidence.gravity.sigma_m_s2 / evidence.gravity.gravity_m_s2
        reasons.append(
            f"gravity is not known and {evidence.gravity.gravity_m_s2:g} m/s^2 was assumed: the common scale is uncertain by "
            f"{share * 1e6:.0f} ppm; give the latitude or gravity"
        )
    if differ := contradiction(evidence.gravity):
        reasons.append(differ)
    ratio = evidence.scale_ratio
    if ratio is not None and abs(ratio - 1) > SCALE_CHANGE:
        reasons.append(
            f"the common scale is {ratio - 1:+.1%} off the preset's (limit {SCALE_CHANGE:.0%}): check gravity and preset"
        )
    temperature = evidence.observations.temperature_degc
    known = temperature[np.isfinite(temperature)]
    if known.size and np.ptp(known) > TEMPERATURE_SPAN_DEGC:
        reasons.append(
            f"the temperature went from {known.min():.1f} to {known.max():.1f} degC over the positions (limit "
            f"{TEMPERATURE_SPAN_DEGC:g} degC): the parameters are a mean over it, and a chip's bias moves by 0.5 to 1 mg per "
            "degC; warm it up first, and calibrate at the temperature of use"
        )
    return reasons


def _unobservable_sentence(evidence: Evidence) -> str:
    """Return what the positions do not show and what that costs."""
    hidden = evidence.unobservable
    verb = "is" if len(hidden) == 1 else "are"
    kept = f"{verb} taken as zero" if evidence.scale_ratio is None else f"{verb} left at the preset's"
    cost = []
    if any("misalignment" in name for name in hidden):
        # Data sheets of Bosch and InvenSense.
        cost.append(
            "each mrad of misalignment left is 1 mg of error on an axis across gravity, so 10 to 20 mg for a chip whose data "
            "sheet gives 1 to 2 % of cross-axis sensitivity"
        )
    if any("quadratic" in name for name in hidden):
        cost.append("each 100 ug/g^2 of quadratic term left is 0.1 mg at 1 g")
    costs = "; ".join(cost) or "what is wrong there is in every measurement"
    return f"these positions cannot show {', '.join(map(_words, hidden))}, which {kept}: {costs}; 24 positions show it"


def _sigma_sentences(evidence: Evidence) -> list[str]:
    relative = evidence.sigma[SCALE] / np.abs(evidence.fitted.vector[SCALE])
    bias = evidence.sigma[BIAS]
    reasons = []
    # Written so that NaN (no uncertainty at all) counts as too large.
    if not np.all(relative <= USABLE_SCALE_SIGMA) and evidence.gravity.source != "assumed":
        finite = np.isfinite(relative).all()
        known = f"is known to {relative.max() * 1e6:.0f} ppm only" if finite else "has no known uncertainty"
        reasons.append(f"scale {known} (limit {USABLE_SCALE_SIGMA * 1e6:.0f} ppm)")
    if not np.all(bias <= USABLE_BIAS_SIGMA_M_S2):
        finite = np.isfinite(bias).all()
        known = f"is known to {bias.max() / MILLI_G_M_S2:.2f} mg only" if finite else "has no known uncertainty"
        reasons.append(f"bias {known} (limit {USABLE_BIAS_SIGMA_M_S2 / MILLI_G_M_S2:.0f} mg)")
    return reasons


def _position_sentences(evidence: Evidence) -> list[str]:
    """Name positions that parameters rest on alone, and those whose externally studentised residual is too large for m."""
    freedom, fitted = evidence.fitted.degrees_of_freedom, evidence.fitted
    sentences: list[str] = []
    if freedom < 1:
        return sentences
    for single in single_positions(evidence.spread):
        names = ", ".join(_words(ACCELEROMETER_NAMES[evidence.chosen.free[k]]) for k in single.coordinates)
        raised = float(evidence.factors[list(single.coordinates)].max())
        effect = f"; uncertainty there is raised up to {raised:.1f} times (jackknife)" if raised > 1.05 else ""
        sentences.append(
            f"position {evidence.observations.name[single.position]} carries {names} nearly alone (leverage "
            f"{single.leverage:.2f}){effect}; repeat it"
        )
    if freedom < 3:
        return sentences
    residual = fitted.residual_m_s2 / fitted.sigma_m_s2
    # Each residual over its own sigma, which leverage makes smaller, and over the scatter of the fit without it.
    student = residual / np.sqrt(np.maximum(1 - evidence.spread.leverage, 1e-6))
    without = np.maximum((np.sum(residual**2) - student**2) / (freedom - 1), 1e-12)
    if evidence.data.covariance_raw is not None and fitted.tau_m_s2 == 0:
        without = np.maximum(without, 1.0)
    student = student / np.sqrt(without)
    limit = student_factor(freedom - 1, of=len(student), chance=_OUTLIER_LEVEL)
    off_mg = evidence.leave_one_out_m_s2 / MILLI_G_M_S2
    return sentences + [
        f"position {evidence.observations.name[i]} does not fit the others (off by {off_mg[i]:+.2f} mg, "
        f"{abs(student[i]):.1f} sigma, limit {limit:.1f}): retake or remove it"
        for i in np.flatnonzero(np.abs(student) > limit)
    ]


def _notes(evidence: Evidence) -> list[str]:
    notes = [evidence.chosen.sentence]
    if evidence.data.covariance_raw is None:
        notes.append("no uncertainty came with the positions: all weigh the same, and sigma is from the residuals")
    if evidence.sign_source == "assumed":
        notes.append(
            "the signs of the axes are assumed positive, their order x, y, z and right-handed: the norm is the "
            "same for reversed or swapped ones, and neither planned positions nor a preset tell"
        )
    gravity = evidence.gravity
    if gravity.source != "assumed":
        share = gravity.sigma_m_s2 / gravity.gravity_m_s2
        digits = gravity.source == "typed" and gravity.sigma_m_s2 > MEASURED_GRAVITY_SIGMA_M_S2
        notes.append(
            f"the residual cannot check gravity: its sigma of {gravity.sigma_m_s2:.2g} m/s^2 is "
            f"{share * 1e6:{'.0f' if share >= 1e-5 else '.2g'}} ppm of common scale"
            + (", which is what its last digit leaves open: give more digits where they are known" if digits else "")
        )
    return notes


def _words(name: str) -> str:
    """Return "bias x" for "accelerometer.bias_m_s2.x"."""
    _, quantity, axis = name.split(".")
    return f"{quantity.removesuffix('_m_s2').removesuffix('_rad')} {axis}"
