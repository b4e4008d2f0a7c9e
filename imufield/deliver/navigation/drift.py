"""Navigation errors of an instrument that stands still, over time.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: equation 23.
"""

from __future__ import annotations

import numpy as np

from imufield.dataclass import dataclass
from imufield.samples import FloatArray

NAUTICAL_MILE_M = 1852.0  # By definition (International Hydrographic Conference, 1929).
EARTH_RADIUS_M = 6371000.0
"""R of eq. 23: the mean radius."""
QUANTITIES = ("latitude_deg", "longitude_deg", "north_velocity_m_s", "east_velocity_m_s")
"""Errors that have a sign."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Errors since the end of the alignment, arrays of shape (..., n), the first two as angles off the true place."""

    time_s: FloatArray
    """Shape (n,)."""
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    north_velocity_m_s: FloatArray
    east_velocity_m_s: FloatArray
    true_latitude_deg: float

    @property
    def position_nmi(self) -> FloatArray:
        """Position error of eq. 23 of [1]_."""
        # The latitude of the moment, as printed, is the true one to first order; with it errors add up linearly.
        east_deg = self.longitude_deg * np.cos(np.radians(self.true_latitude_deg))
        position_m = EARTH_RADIUS_M * np.radians(np.hypot(self.latitude_deg, east_deg))
        return np.asarray(position_m / NAUTICAL_MILE_M)

    @property
    def hours(self) -> FloatArray:
        """Time as it is plotted."""
        return self.time_s / 3600

    @property
    def rate_nmi_per_h(self) -> float:
        """Largest position error over the time it was navigated; the last one alone may be a zero of an oscillation."""
        return float(self.position_nmi.max() / (self.time_s[-1] / 3600))
