"""The verdict on a calibration, in words: good, usable or poor, and why."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imufield.calibrate.accelerometer.fit import Fit
from imufield.calibrate.model.models import BIAS, SCALE
from imufield.calibrate.model.observability import Observability
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, PositionResult, Quality
from imufield.calibrate.model.uncertainty import Influence, SinglePosition, student_factor_95
from imufield.earth import MEASURED_GRAVITY_SIGMA_M_S2, MILLI_G_M_S2, Gravity, contradiction
from imufield.errors import CalibrationError, Reason, counted
from imufield.samples import AXES, FloatArray

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

    name: tuple[str, ...]
    gravity: Gravity
    fitted: Fit
    free: tuple[int, ...]
    spread: Influence
    singles: tuple[SinglePosition, ...]
    factors: FloatArray
    positions: PositionResult
    seen: Observability
    unobservable: tuple[str, ...]
    sign_source: str
    model_sentence: str
    covariance_known: bool
    scale_ratio: float | None
    """Common scale over the preset's; None without a preset."""
    sigma: FloatArray
    """1 sigma of the 15 parameters."""
    temperature_degc: FloatArray
    """Of each position; NaN where not known."""


def judge(evidence: Evidence) -> Quality:
    """Return figures, verdict and reasons."""
    solved, freedom = evidence.fitted.solved, evidence.fitted.degrees_of_freedom
    without = _rms(evidence.positions.leave_one_out_m_s2)
    poor = poor_sentences(None if solved.converged else solved.message, freedom, without)
    caution, note = _cautions(evidence), _notes(evidence)
    verdict = "poor" if poor else "usable" if caution else "good"
    fitted, positions = evidence.fitted, evidence.positions
    return Quality(
        residual_rms_m_s2=_rms(positions.residual_m_s2),
        residual_max_m_s2=float(np.abs(positions.residual_m_s2).max()),
        leave_one_out_rms_m_s2=without,
        between_position_sigma_m_s2=fitted.tau_m_s2,
        degrees_of_freedom=freedom,
        student_factor_95=_student_factor(fitted),
        rank=evidence.seen.rank,
        parameters_fitted=len(evidence.free),
        condition=evidence.seen.condition,
        verdict=verdict,
        reasons=(_summary(evidence), *poor, *caution, *note),
    )


def _student_factor(fitted: Fit) -> float:
    """Return the factor from sigma to the 95 % limit; NaN where nothing is to spare."""
    return student_factor_95(fitted.effective_degrees_of_freedom) if fitted.degrees_of_freedom > 0 else float("nan")


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
        for limit, count in _stops(np.sort(raw[:, axis])):
            raise CalibrationError(
                f"axis {AXES[axis]} stops at {limit:g} in {count} positions while the norm is wrong by up to "
                f"{worst / MILLI_G_M_S2:.0f} mg (limit {SATURATION_RESIDUAL_M_S2 / MILLI_G_M_S2:.0f} mg): it is saturated; "
                "choose a larger range and take them again",
                Reason.SATURATED,
                axis=AXES[axis],
                limit=limit,
            )


def _stops(ordered: FloatArray) -> Iterator[tuple[float, int]]:
    """Yield each end at which values pile up, and how many; none where coarse steps make values equal anywhere."""
    same = np.diff(ordered) <= _SAME_OUTPUT * (ordered[-1] - ordered[0])
    low = int(np.argmin(np.append(same, False))) + 1
    high = int(np.argmin(np.append(same[::-1], False))) + 1
    if same[low - 1 : len(same) - high + 1].any():
        return
    for limit, count in ((ordered[0], low), (ordered[-1], high)):
        if count >= _SATURATED_POSITIONS:
            yield float(limit), count


def _rms(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def _summary(evidence: Evidence) -> str:
    positions = evidence.positions
    left_out = _rms(positions.leave_one_out_m_s2) / MILLI_G_M_S2
    return (
        f"{counted(len(evidence.name), 'position')}, {counted(len(evidence.free), 'parameter')}, "
        f"{evidence.fitted.degrees_of_freedom} to spare: "
        f"residual {_rms(positions.residual_m_s2) / MILLI_G_M_S2:.3f} mg RMS"
        + (f", {left_out:.3f} mg with each position left out" if np.isfinite(left_out) else "")
    )


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
    reasons = [*_single_sentences(evidence), *_outlier_sentences(evidence)]
    if evidence.unobservable:
        reasons.append(_unobservable_sentence(evidence))
    freedom = evidence.fitted.degrees_of_freedom
    if 0 < freedom < SPARE_POSITIONS:
        spare = counted(freedom, "position")
        reasons.append(f"only {spare} to spare: a 95 % interval is {_student_factor(evidence.fitted):.1f} sigma")
    if evidence.seen.condition > HIGH_CONDITION:
        reasons.append(f"the positions are one-sided (condition {evidence.seen.condition:.0f}, limit {HIGH_CONDITION:.0f})")
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
    return reasons + _temperature_sentences(evidence.temperature_degc) + _sigma_sentences(evidence)


def _temperature_sentences(temperature_degc: FloatArray) -> list[str]:
    known = temperature_degc[np.isfinite(temperature_degc)]
    low, high = (known.min(), known.max()) if known.size else (0.0, 0.0)
    if high - low <= TEMPERATURE_SPAN_DEGC:
        return []
    went = f"the temperature went from {low:.1f} to {high:.1f} degC over the positions (limit {TEMPERATURE_SPAN_DEGC:g} degC)"
    advice = "warm it up first, and calibrate at the temperature of use"
    return [f"{went}: the parameters are a mean over it, and a chip's bias moves by 0.5 to 1 mg per degC; {advice}"]


def _unobservable_sentence(evidence: Evidence) -> str:
    """Say what cannot be seen and what that costs: Bosch and InvenSense state cross-axis sensitivities of 1 to 2 %."""
    hidden = evidence.unobservable
    verb = "is" if len(hidden) == 1 else "are"
    kept = f"{verb} taken as zero" if evidence.scale_ratio is None else f"{verb} left at the preset's"
    cost = []
    if any("misalignment" in name for name in hidden):
        cost.append(
            "each mrad of misalignment left is 1 mg of error on an axis across gravity, so 10 to 20 mg for a chip whose data "
            "sheet gives 1 to 2 % of cross-axis sensitivity"
        )
    if any("quadratic" in name for name in hidden):
        cost.append("each 100 ug/g^2 of quadratic term left is 0.1 mg at 1 g")
    if not cost:
        cost.append("what is wrong there is in every measurement")
    names = ", ".join(_words(name) for name in hidden)
    return f"these positions cannot show {names}, which {kept}: {'; '.join(cost)}; 24 positions show it"


def _sigma_sentences(evidence: Evidence) -> list[str]:
    relative = evidence.sigma[SCALE] / np.abs(evidence.fitted.vector[SCALE])
    bias = evidence.sigma[BIAS]
    reasons = []
    # Written so that NaN (no uncertainty at all) counts as too large.
    if not np.all(relative <= USABLE_SCALE_SIGMA) and evidence.gravity.source != "assumed":
        known = (
            f"is known to {relative.max() * 1e6:.0f} ppm only" if np.isfinite(relative).all() else "has no known uncertainty"
        )
        reasons.append(f"scale {known} (limit {USABLE_SCALE_SIGMA * 1e6:.0f} ppm)")
    if not np.all(bias <= USABLE_BIAS_SIGMA_M_S2):
        known = (
            f"is known to {bias.max() / MILLI_G_M_S2:.2f} mg only" if np.isfinite(bias).all() else "has no known uncertainty"
        )
        reasons.append(f"bias {known} (limit {USABLE_BIAS_SIGMA_M_S2 / MILLI_G_M_S2:.0f} mg)")
    return reasons


def _single_sentences(evidence: Evidence) -> list[str]:
    if evidence.fitted.degrees_of_freedom < 1:
        return []
    sentences = []
    for single in evidence.singles:
        names = ", ".join(_words(ACCELEROMETER_NAMES[evidence.free[k]]) for k in single.coordinates)
        raised = float(evidence.factors[list(single.coordinates)].max())
        effect = f"; uncertainty there is raised up to {raised:.1f} times (jackknife)" if raised > 1.05 else ""
        sentences.append(
            f"position {evidence.name[single.position]} carries {names} nearly alone (leverage {single.leverage:.2f}){effect}; "
            "repeat it"
        )
    return sentences


def _outlier_sentences(evidence: Evidence) -> list[str]:
    """Name positions whose externally studentised residual is too large for the best of m."""
    freedom = evidence.fitted.degrees_of_freedom
    if freedom < 3:
        return []
    from scipy.special import stdtrit  # slow to load

    residual = evidence.positions.residual_m_s2 / evidence.fitted.sigma_m_s2
    rest = np.maximum(1 - evidence.spread.leverage, 1e-6)
    student = residual / np.sqrt(rest)
    without = np.maximum((np.sum(residual**2) - student**2) / (freedom - 1), 1e-12)
    if evidence.covariance_known and evidence.fitted.tau_m_s2 == 0:
        without = np.maximum(without, 1.0)
    student = student / np.sqrt(without)
    limit = float(stdtrit(freedom - 1, 1 - _OUTLIER_LEVEL / (2 * len(student))))
    off_mg = evidence.positions.leave_one_out_m_s2 / MILLI_G_M_S2
    return [
        f"position {evidence.name[i]} does not fit the others (off by {off_mg[i]:+.2f} mg, "
        f"{abs(student[i]):.1f} sigma, limit {limit:.1f}): retake or remove it"
        for i in np.flatnonzero(np.abs(student) > limit)
    ]


def _notes(evidence: Evidence) -> list[str]:
    notes = [evidence.model_sentence]
    if not evidence.covariance_known:
        notes.append("no uncertainty came with the positions: all weigh the same, and sigma is from the residuals")
    if evidence.sign_source == "assumed":
        notes.append(
            "the signs of the axes are assumed positive, their order x, y, z and right-handed: the norm is the "
            "same for reversed or swapped ones, and neither planned positions nor a preset tell"
        )
    gravity = evidence.gravity
    if gravity.source != "assumed":
        digits = gravity.source == "typed" and gravity.sigma_m_s2 > MEASURED_GRAVITY_SIGMA_M_S2
        notes.append(
            f"the residual cannot check gravity: its sigma of {gravity.sigma_m_s2:.2g} m/s^2 is "
            f"{_ppm(gravity.sigma_m_s2 / gravity.gravity_m_s2)} of common scale"
            + (", which is what its last digit leaves open: give more digits where they are known" if digits else "")
        )
    return notes


def _ppm(share: float) -> str:
    return f"{share * 1e6:.0f} ppm" if share >= 1e-5 else f"{share * 1e6:.2g} ppm"


def _words(name: str) -> str:
    """Return "bias x" for "accelerometer.bias_m_s2.x"."""
    _, quantity, axis = name.split(".")
    return f"{quantity.removesuffix('_m_s2').removesuffix('_rad')} {axis}"
