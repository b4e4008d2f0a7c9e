"""Correlations of the parameters, from the joint covariance of a calibration."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.result import GRAVITY_NAME, Calibration
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

# Names of the file, in the words of a drawing.
_SHORT = (
    ("accelerometer.", "acc "),
    ("gyroscope.", "gyro "),
    ("bias_m_s2.", "bias "),
    ("misalignment_rad.", "misalignment "),
    ("g_sensitivity.", "g-sensitivity "),
    (GRAVITY_NAME, "gravity"),
    (".", " "),
)


@dataclass(frozen=True, slots=True)
class Correlations:
    """Correlations of n parameters that are known neither exactly nor not at all."""

    names: tuple[str, ...]
    matrix: FloatArray
    """Shape (n, n), ones on the diagonal."""

    def strongest(self, count: int) -> list[tuple[str, str, float]]:
        """Return the pairs with the largest correlation, largest first."""
        rows, columns = np.tril_indices(len(self.names), -1)
        values = self.matrix[rows, columns]
        # Stable: equal correlations come in the order of the file on every machine.
        order = np.argsort(-np.abs(values), kind="stable")[:count]
        return [(self.names[columns[k]], self.names[rows[k]], float(values[k])) for k in order]


def correlations(calibration: Calibration) -> Correlations:
    """Return the correlations of every parameter with a sigma."""
    variance = np.diag(calibration.covariance)
    known = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    sigma = np.sqrt(variance[known])
    matrix: FloatArray = calibration.covariance[np.ix_(known, known)] / np.outer(sigma, sigma)
    names = [calibration.covariance_names[k] for k in known]
    for long, short in _SHORT:
        names = [name.replace(long, short) for name in names]
    return Correlations(tuple(names), matrix)
