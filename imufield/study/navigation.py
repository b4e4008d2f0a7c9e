"""Five hours of navigation at rest: a simulated strapdown INS that stands still, aligned by itself or told its attitude.

At rest the true specific force and rate in the body frame are constant; what the instrument's errors add is constant too, apart
from noise. So a second a step is fine enough: with it the position after five hours agrees with steps of 0.1 s to 1e-6 deg.
Mechanisation and Earth model are those of python-ins (the ``nav`` extra), without the vertical channel, which diverges.

Alignment is that of a unit at rest: down from the mean specific force, north from the mean rate. It absorbs what the
accelerometer's errors do to level, so that they hardly show afterwards: what remains is what the gyroscope does.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 5.2, eq. 23.
"""

from __future__ import annotations

import importlib
import math
import warnings
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from imufield.earth import MICRO_G_M_S2
from imufield.errors import Reason, UsageError
from imufield.samples import FloatArray

NAUTICAL_MILE_M = 1852.0
EARTH_RADIUS_M = 6371000.0
STEP_S = 1.0
ALIGNMENT_S = 600.0
LONGITUDE_DEG = 120.0
DOWN_UP = np.diag([1.0, -1.0, -1.0])
"""From our body axes (z up at rest) to those of python-ins (x forward, y right, z down)."""


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of the instrument that navigates."""

    accelerometer_m_s2_per_root_hz: float = 10 * MICRO_G_M_S2
    gyroscope_deg_per_root_hour: float = 0.003


@dataclass(frozen=True, slots=True)
class NavigationErrors:
    """Errors over time, arrays of shape (n,)."""

    hours: FloatArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    north_velocity_m_s: FloatArray
    east_velocity_m_s: FloatArray
    position_nmi: FloatArray
    """Eq. 23 of [1]_."""


def pyins() -> Any:
    """Return the modules of python-ins as one namespace.

    Raises
    ------
    UsageError
        If it is not installed.
    """
    names = {"earth": "pyins.earth", "strapdown": "pyins.strapdown", "transform": "pyins.transform", "util": "pyins.util"}
    try:
        return SimpleNamespace(
            pandas=importlib.import_module("pandas"),
            **{name: importlib.import_module(module) for name, module in names.items()},
        )
    except ModuleNotFoundError as error:
        raise UsageError(
            f"navigation needs the package python-ins, which is not installed ({error}); install imufield[nav]",
            Reason.MISSING_PACKAGE,
            package="python-ins",
        ) from error


def rest_inputs(latitude_deg: float, heading_deg: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return specific force (m/s^2) and rate (rad/s) of a level unit at rest in our body axes, shape (3,) each."""
    modules = pyins()
    rotation = modules.transform.mat_from_rph([0.0, 0.0, heading_deg])
    force = rotation.T @ np.array([0.0, 0.0, -modules.earth.gravity(latitude_deg, 0.0)])
    rate = rotation.T @ modules.earth.rate_n(latitude_deg)
    return DOWN_UP @ force, DOWN_UP @ rate


def align(force: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the attitude matrix (north, east, down from the body of python-ins) of a unit at rest, shape (3, 3).

    Parameters
    ----------
    force, rate : ndarray, shape (3,)
        Means at rest in the body axes of python-ins.
    """
    down = -force / np.linalg.norm(force)
    north = rate - (rate @ down) * down
    north = north / np.linalg.norm(north)
    return np.array([north, np.cross(down, north), down])


def navigate_at_rest(
    force_m_s2: FloatArray,
    rate_rad_s: FloatArray,
    latitude_deg: float,
    *,
    hours: float,
    noise: Noise,
    rng: np.random.Generator,
    attitude_rph_deg: FloatArray | None = None,
) -> NavigationErrors:
    """Align, navigate, and return the errors.

    Parameters
    ----------
    force_m_s2, rate_rad_s : ndarray, shape (3,)
        What the calibrated instrument shows at rest, noise apart, in our body axes.
    latitude_deg : float
    hours : float
    noise : Noise
    rng : Generator
    attitude_rph_deg : ndarray, shape (3,), optional
        Roll, pitch, heading to start with; without it the unit aligns itself for ten minutes first.
    """
    modules = pyins()
    n = round(hours * 3600 / STEP_S)
    force, rate = DOWN_UP @ force_m_s2, DOWN_UP @ rate_rad_s
    sigma_force = noise.accelerometer_m_s2_per_root_hz
    sigma_rate = math.radians(noise.gyroscope_deg_per_root_hour) / 60
    if attitude_rph_deg is None:
        shown = [
            mean + sigma / math.sqrt(ALIGNMENT_S) * rng.standard_normal(3)
            for mean, sigma in ((force, sigma_force), (rate, sigma_rate))
        ]
        attitude_rph_deg = modules.transform.mat_to_rph(align(*shown))
    root = math.sqrt(STEP_S)
    theta = rate * STEP_S + sigma_rate * root * rng.standard_normal((n, 3))
    velocity = force * STEP_S + sigma_force * root * rng.standard_normal((n, 3))
    velocity += 0.5 * np.cross(theta, velocity)  # the unit turns with the Earth during a step
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    increments = modules.pandas.DataFrame(
        np.column_stack([np.full(n, STEP_S), theta, velocity]), index=np.arange(1, n + 1) * STEP_S, columns=columns
    )
    start = [latitude_deg, LONGITUDE_DEG, 0.0, 0.0, 0.0, 0.0, *np.asarray(attitude_rph_deg)]
    state = modules.pandas.Series(start, index=modules.util.TRAJECTORY_COLS, name=0.0)
    with warnings.catch_warnings():
        # python-ins 1.0 is older than pandas 3, which no longer needs to be told to copy.
        warnings.filterwarnings("ignore", message="The copy keyword is deprecated")
        trajectory = modules.strapdown.Integrator(state, with_altitude=False).integrate(increments)
    return _errors(trajectory, latitude_deg)


def _errors(trajectory: Any, latitude_deg: float) -> NavigationErrors:
    latitude = trajectory.lat.to_numpy() - latitude_deg
    longitude = trajectory.lon.to_numpy() - LONGITUDE_DEG
    metres = EARTH_RADIUS_M * np.radians(np.hypot(latitude, longitude * math.cos(math.radians(latitude_deg))))
    return NavigationErrors(
        trajectory.index.to_numpy() / 3600,
        latitude,
        longitude,
        trajectory.VN.to_numpy(),
        trajectory.VE.to_numpy(),
        metres / NAUTICAL_MILE_M,
    )
