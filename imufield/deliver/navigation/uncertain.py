"""What may be wrong with an instrument that was corrected: draws of its errors, for a Monte-Carlo forecast.

The calibration's joint covariance says how far the true parameters may be from the file's. For each draw the error of the
corrected values is computed with the models themselves: raw output of the file's parameters at the true input, corrected with
the drawn ones, less the true input.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imufield.calibrate.model.models import predict, predict_gyroscope, recover_vectors, to_vector
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, Calibration
from imufield.dataclass import dataclass
from imufield.samples import AXES, FloatArray

_GYROSCOPE_FIELDS = ("scale", "misalignment_rad", "bias", "g_sensitivity")


@dataclass(frozen=True, slots=True)
class DrawnParameters:
    """m draws of the true parameters about those of a calibration."""

    calibration: Calibration
    vector: FloatArray
    """Shape (m, 15)."""
    gyroscope: dict[str, FloatArray]
    """Scale and bias of shape (m, 3), misalignment and g-sensitivity of shape (m, 3, 3); empty without a gyroscope."""

    def errors(self, force: FloatArray, rate: FloatArray) -> FloatArray:
        """Return the errors of corrected values at a true input, both of shape (3,); m/s^2 and rad/s, shape (m, 6)."""
        p = self.calibration.accelerometer
        raw = predict(p, force) - p.raw_zero
        recovered = recover_vectors(self.vector, raw[None], p.quadratic_axes, p.higher)[:, 0]
        errors = np.zeros((len(self.vector), 6))
        errors[:, :3] = recovered - force
        if self.calibration.gyroscope is not None and self.gyroscope:
            drawn, own = self.gyroscope, self.calibration.gyroscope.parameters
            raw = predict_gyroscope(own, rate, force) - own.raw_zero
            unbiased = raw - drawn["bias"] - np.einsum("mij,mj->mi", drawn["g_sensitivity"], recovered)
            matrix = np.eye(3) + drawn["misalignment_rad"]
            errors[:, 3:] = np.linalg.solve(matrix, (unbiased / drawn["scale"])[:, :, None])[:, :, 0] - rate
        return errors


def draw_parameters(
    calibration: Calibration, count: int, rng: np.random.Generator, triads: Sequence[str] = ("accelerometer", "gyroscope")
) -> DrawnParameters:
    """Draw parameters from the joint covariance; of a triad not named the file's are kept.

    Parameters that have no sigma (not fitted, or taken from the driver) do not vary.
    """
    names = calibration.covariance_names
    offsets = _normal(calibration.covariance, count, rng)
    vector = np.tile(to_vector(calibration.accelerometer), (count, 1))
    drawn: dict[str, FloatArray] = {}
    if calibration.gyroscope is not None:
        own = calibration.gyroscope.parameters
        drawn = {field: np.repeat(getattr(own, field)[None], count, axis=0) for field in _GYROSCOPE_FIELDS}
    for name, column in zip(names, offsets.T, strict=True):
        triad = name.partition(".")[0]
        # Drawn all the same, so that the other triad gets the numbers it would get with both.
        if triad not in triads:
            continue
        if name in ACCELEROMETER_NAMES:
            vector[:, ACCELEROMETER_NAMES.index(name)] += column
        elif drawn and triad == "gyroscope":
            # As in gyroscope.misalignment_rad.xy: the field, and the place in it.
            _, field, place = name.split(".")
            np.moveaxis(drawn[field], 0, -1)[tuple(AXES.index(axis) for axis in place)] += column
    return DrawnParameters(calibration, vector, drawn)


def _normal(covariance: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw from a covariance that may have no full rank, shape (count, n); the diagonal may span 30 orders of magnitude."""
    # In units of sigma first: eigenvalues of a bias in m/s^2 and of a scale in counts do not compare.
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigma > 0, sigma, 1.0)
    # As written in digits some eigenvalues are below zero, which `multivariate_normal` would warn of and take the size of.
    value, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    return np.asarray(sigma * (rng.standard_normal((count, len(sigma))) @ (vectors * np.sqrt(np.maximum(value, 0.0))).T))
