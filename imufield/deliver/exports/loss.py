"""The price of an export: how far the target's corrected values are from ours, in mg and mrad/s."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray

if TYPE_CHECKING:
    from imufield.deliver.exports.job import Held
    from imufield.deliver.parameters.file import Parameters

DIRECTIONS = 500
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


def measure_loss(parameters: Parameters, held: Held) -> Loss:
    """Compare what the target computes with the truth of the model, in the target's frame."""
    calibration = parameters.calibration
    unit = directions()
    force = calibration.gravity.gravity_m_s2 * unit
    raw = predict(calibration.accelerometer, force)
    recovered = held.apply_accelerometer(raw)
    accelerometer = _difference(recovered - force @ held.rotation.T)
    if calibration.gyroscope is None or not parameters.gyroscope_is_complete:
        nothing = Difference(0.0, 0.0)
        return Loss(accelerometer, nothing, nothing)
    gyroscope = calibration.gyroscope.parameters
    still = np.zeros_like(unit)
    turning = held.apply_gyroscope(predict_gyroscope(gyroscope, unit), still) - unit @ held.rotation.T
    standing = held.apply_gyroscope(predict_gyroscope(gyroscope, still, force), held.gyroscope_force(raw))
    at_rest = held.apply_gyroscope(predict_gyroscope(gyroscope, still), still)
    return Loss(accelerometer, _difference(turning), _difference(standing - at_rest))


def _difference(vectors: FloatArray) -> Difference:
    length = np.linalg.norm(vectors, axis=-1)
    return Difference(float(np.sqrt(np.mean(length**2))), float(length.max()))


def loss_sentences(parameters: Parameters, held: Held, accelerometer_lacks: str, gyroscope_lacks: str) -> tuple[str, ...]:
    """Return one sentence for each thing the target cannot hold; none where it computes the same."""
    loss = measure_loss(parameters, held)
    sentences = []
    if loss.accelerometer_m_s2.largest > _NOTHING * parameters.calibration.gravity.gravity_m_s2:
        rms, largest = (f"{value / MILLI_G_M_S2:.3g}" for value in loss.accelerometer_m_s2)
        sentences.append(
            f"accelerometer: {accelerometer_lacks or _quadratic(parameters)}: {rms} mg rms, {largest} mg at most at 1 g"
            f"{_at_positions(parameters, held)}"
        )
    if loss.gyroscope_rad_s.largest > _NOTHING:
        rms, largest = (f"{value * 1e3:.3g}" for value in loss.gyroscope_rad_s)
        sentences.append(f"gyroscope: {gyroscope_lacks}: {rms} mrad/s rms, {largest} mrad/s at most at 1 rad/s")
    if loss.g_sensitivity_rad_s.largest > _NOTHING:
        rms, largest = (f"{value * 1e3:.3g}" for value in loss.g_sensitivity_rad_s)
        lacks = "is held with a force that lacks the quadratic term" if held.holds_g_sensitivity else "cannot be held"
        sentences.append(f"gyroscope: the g-sensitivity {lacks}: {rms} mrad/s rms, {largest} mrad/s at most at 1 g")
    return tuple(sentences)


def _quadratic(parameters: Parameters) -> str:
    has_term = np.any(parameters.calibration.accelerometer.quadratic)
    return "the quadratic term was replaced by the straight line nearest to it" if has_term else "the model cannot be held"


def _at_positions(parameters: Parameters, held: Held) -> str:
    """Say what became of the residual at the positions the calibration rests on."""
    raw = np.array([row["mean_raw"] for row in parameters.document.get("position", []) if row["used"]])
    if not len(raw):
        return ""
    g = parameters.calibration.gravity.gravity_m_s2
    ours, theirs = (
        round(float(np.sqrt(np.mean((np.linalg.norm(force, axis=1) - g) ** 2)) / MILLI_G_M_S2), 6)
        for force in (parameters.apply_accelerometer(raw), held.apply_accelerometer(raw))
    )
    return f" (residual of its {len(raw)} positions {theirs:.3g} mg rms, {ours:.3g} mg with the whole model)"
