"""The price of an export: how far the target's corrected values are from ours, in mg and mrad/s."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.deliver.exports.conventions import Corrections
from imufield.deliver.exports.target import Target
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2
from imufield.errors import UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

DIRECTIONS = 500  # Of the sphere: the mean of a square over them is exact to a per mille.
_NOTHING = 1e-9  # Relative difference that counts as none: what rounding in a text of 12 digits leaves.


def directions(count: int = DIRECTIONS) -> FloatArray:
    """Return unit vectors spread evenly over all directions (Fibonacci lattice), shape (count, 3)."""
    rank = np.arange(count) + 0.5
    z = 1 - 2 * rank / count
    azimuth = np.pi * (1 + np.sqrt(5)) * rank
    radius = np.sqrt(1 - z**2)
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z])


def loss_sentences(
    parameters: Parameters, target: Corrections, accelerometer_lacks: str, gyroscope_lacks: str
) -> tuple[str, ...]:
    """Return one sentence for each thing the target cannot hold; none where it computes the same.

    What the target computes is compared with the truth of the model, in the target's frame: the accelerometer at 1 g, the
    gyroscope at 1 rad/s and free of specific force, and its g-sensitivity at 1 g without rotation, with the force that the
    target takes for the true one.
    """
    calibration, sentences = parameters.calibration, []
    unit = directions()
    force = calibration.gravity.gravity_m_s2 * unit
    raw = predict(calibration.accelerometer, force)
    rms, largest = _length(target.apply_accelerometer(raw) - force @ target.rotation.T)
    if largest > _NOTHING * calibration.gravity.gravity_m_s2:
        quadratic, higher = np.any(calibration.accelerometer.quadratic), calibration.accelerometer.higher is not None
        lacks = accelerometer_lacks or sentence("loss.quadratic" if quadratic else "loss.model")
        if higher:
            lacks = f"{lacks}; {sentence('loss.higher')}" if accelerometer_lacks or quadratic else sentence("loss.higher")
        sizes = {"rms": rms / MILLI_G_M_S2, "largest": largest / MILLI_G_M_S2}
        at_positions = _at_positions(parameters, target)
        sentences.append(sentence("loss.accelerometer", lacks=lacks, at_positions=at_positions, **sizes))
    if calibration.gyroscope is None or not parameters.gyroscope_is_complete:
        return tuple(sentences)
    gyroscope = calibration.gyroscope.parameters
    still = np.zeros_like(unit)
    turning = target.apply_gyroscope(predict_gyroscope(gyroscope, unit), still) - unit @ target.rotation.T
    standing = target.apply_gyroscope(predict_gyroscope(gyroscope, still, force), target.gyroscope_force(raw))
    at_rest = target.apply_gyroscope(predict_gyroscope(gyroscope, still), still)
    sensitivity = sentence("loss.sensitivity_by_force" if target.has_g_sensitivity else "loss.sensitivity")
    for difference, lacks, where in (
        (turning, gyroscope_lacks, "1 rad/s"),
        (standing - at_rest, sensitivity, "1 g"),
    ):
        rms, largest = _length(difference)
        if largest > _NOTHING:
            sentences.append(sentence("loss.gyroscope", lacks=lacks, rms=rms * 1e3, largest=largest * 1e3, where=where))
    return tuple(sentences)


def _length(vectors: FloatArray) -> tuple[float, float]:
    """Return the length of vectors over all directions: root mean square, and the largest."""
    length = np.linalg.norm(vectors, axis=-1)
    return float(np.sqrt(np.mean(length**2))), float(length.max())


def _at_positions(parameters: Parameters, target: Corrections) -> str:
    """Say what became of the residual at the positions the calibration rests on."""
    raw = np.array([row["mean_raw"] for row in parameters.document.get("position", []) if row["used"]])
    if not len(raw):
        return ""
    positions, scale = parameters.calibration.positions, parameters.calibration.accelerometer.scale
    # Residuals are those of the bias that is exported: a drift of it was fitted beside it.
    raw = raw - scale * positions.bias_drift_m_s2[positions.used]
    g = parameters.calibration.gravity.gravity_m_s2
    # Rounded to a nano-g: what is left below of an exact model differs from machine to machine.
    ours, theirs = (
        round(float(np.sqrt(np.mean((np.linalg.norm(force, axis=1) - g) ** 2)) / MILLI_G_M_S2), 6)
        for force in (parameters.apply_accelerometer(raw), target.apply_accelerometer(raw))
    )
    return sentence("loss.positions", positions=len(raw), theirs=theirs, ours=ours)


def at_one_temperature(
    parameters: Parameters, target: Target, temperature_degc: float | None
) -> tuple[Parameters, tuple[str, ...]]:
    """Return what a target gets of parameters over temperature, and what it costs where that is one temperature only.

    Raises
    ------
    UsageError
        If a temperature is asked for where there is nothing to choose, or one outside the range measured.
    """
    models = parameters.temperature_models
    if temperature_degc is not None and (target.over_temperature or not models):
        key = "loss.all_temperatures" if models else "loss.no_temperature"
        raise UsageError(sentence(key, target=target.name, value=temperature_degc))
    if target.over_temperature or not models:
        return parameters, ()
    chosen_degc = models[0].reference_degc if temperature_degc is None else temperature_degc
    low, high = parameters.temperature_range_degc
    # Not by a comparison that nan passes.
    if not low <= chosen_degc <= high:
        raise UsageError(sentence("loss.outside", value=chosen_degc, low=low, high=high))
    return parameters.at(chosen_degc), _cost_of(parameters, chosen_degc)


def _cost_of(parameters: Parameters, temperature_degc: float) -> tuple[str, ...]:
    """Say what a target that knows one temperature only is off by at the ends of the range."""
    models, chosen = parameters.temperature_models, parameters.at(temperature_degc)
    force = parameters.calibration.gravity.gravity_m_s2 * directions()
    said = []
    for end_degc in sorted({end for model in models for end in model.range_degc}):
        there = parameters.at(end_degc).calibration
        off = chosen.apply_accelerometer(predict(there.accelerometer, force)) - force
        values = {"force_mg": float(np.linalg.norm(off, axis=1).max()) / MILLI_G_M_S2, "rate_deg_h": 0.0}
        if there.gyroscope is not None and parameters.gyroscope_is_complete:
            still = predict_gyroscope(there.gyroscope.parameters, np.zeros((1, 3)))
            rate = chosen.apply_gyroscope(still, np.zeros((1, 3)))
            values["rate_deg_h"] = float(np.linalg.norm(rate)) / DEG_PER_HOUR_RAD_S
        said.append(sentence("loss.one_temperature", at=temperature_degc, end=end_degc, **values))
    return tuple(said)
