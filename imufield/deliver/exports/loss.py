"""The price of an export: how far the target's corrected values are from ours, in mg and mrad/s."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.deliver.exports.target import TargetModel
from imufield.deliver.parameters.file import Parameters
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray

DIRECTIONS = 500  # Of the sphere: the mean of a square over them is exact to a per mille.
_NOTHING = 1e-9  # Relative difference that counts as none: what rounding in a text of 12 digits leaves.


class Difference(NamedTuple):
    """Length of the difference of two vectors over all directions."""

    rms: float
    largest: float


class Loss(NamedTuple):
    """What a target's correction differs from ours by."""

    accelerometer_m_s2: Difference
    """At 1 g."""
    gyroscope_rad_s: Difference
    """At 1 rad/s, free of specific force."""
    g_sensitivity_rad_s: Difference
    """At 1 g, without rotation, with the force that the target takes for the true one."""


def directions(count: int = DIRECTIONS) -> FloatArray:
    """Return unit vectors spread evenly over all directions (Fibonacci lattice), shape (count, 3)."""
    rank = np.arange(count) + 0.5
    z = 1 - 2 * rank / count
    azimuth = np.pi * (1 + np.sqrt(5)) * rank
    radius = np.sqrt(1 - z**2)
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z])


def measure_loss(parameters: Parameters, target: TargetModel) -> Loss:
    """Compare what the target computes with the truth of the model, in the target's frame."""
    calibration = parameters.calibration
    unit = directions()
    force = calibration.gravity.gravity_m_s2 * unit
    raw = predict(calibration.accelerometer, force)
    recovered = target.apply_accelerometer(raw)
    accelerometer = _difference(recovered - force @ target.rotation.T)
    if calibration.gyroscope is None or not parameters.gyroscope_is_complete:
        nothing = Difference(0.0, 0.0)
        return Loss(accelerometer, nothing, nothing)
    gyroscope = calibration.gyroscope.parameters
    still = np.zeros_like(unit)
    turning = target.apply_gyroscope(predict_gyroscope(gyroscope, unit), still) - unit @ target.rotation.T
    standing = target.apply_gyroscope(predict_gyroscope(gyroscope, still, force), target.gyroscope_force(raw))
    at_rest = target.apply_gyroscope(predict_gyroscope(gyroscope, still), still)
    return Loss(accelerometer, _difference(turning), _difference(standing - at_rest))


def _difference(vectors: FloatArray) -> Difference:
    length = np.linalg.norm(vectors, axis=-1)
    return Difference(float(np.sqrt(np.mean(length**2))), float(length.max()))


def loss_sentences(
    parameters: Parameters, target: TargetModel, accelerometer_lacks: str, gyroscope_lacks: str
) -> tuple[str, ...]:
    """Return one sentence for each thing the target cannot hold; none where it computes the same."""
    loss = measure_loss(parameters, target)
    sentences = []
    if loss.accelerometer_m_s2.largest > _NOTHING * parameters.calibration.gravity.gravity_m_s2:
        has_term = np.any(parameters.calibration.accelerometer.quadratic)
        quadratic = "the quadratic term was replaced by the straight line nearest to it"
        lacks = accelerometer_lacks or (quadratic if has_term else "the model cannot be held")
        rms, largest = (f"{value / MILLI_G_M_S2:.3g}" for value in loss.accelerometer_m_s2)
        at_positions = _at_positions(parameters, target)
        sentences.append(f"accelerometer: {lacks}: {rms} mg rms, {largest} mg at most at 1 g{at_positions}")
    force = "is held with a force that lacks the quadratic term" if target.has_g_sensitivity else "cannot be held"
    for difference, lacks, where in (
        (loss.gyroscope_rad_s, gyroscope_lacks, "1 rad/s"),
        (loss.g_sensitivity_rad_s, f"the g-sensitivity {force}", "1 g"),
    ):
        if difference.largest > _NOTHING:
            rms, largest = (f"{value * 1e3:.3g}" for value in difference)
            sentences.append(f"gyroscope: {lacks}: {rms} mrad/s rms, {largest} mrad/s at most at {where}")
    return tuple(sentences)


def _at_positions(parameters: Parameters, target: TargetModel) -> str:
    """Say what became of the residual at the positions the calibration rests on."""
    raw = np.array([row["mean_raw"] for row in parameters.document.get("position", []) if row["used"]])
    if not len(raw):
        return ""
    g = parameters.calibration.gravity.gravity_m_s2
    # Rounded to a nano-g: what is left below of an exact model differs from machine to machine.
    ours, theirs = (
        round(float(np.sqrt(np.mean((np.linalg.norm(force, axis=1) - g) ** 2)) / MILLI_G_M_S2), 6)
        for force in (parameters.apply_accelerometer(raw), target.apply_accelerometer(raw))
    )
    return f" (residual of its {len(raw)} positions {theirs:.3g} mg rms, {ours:.3g} mg with the whole model)"
