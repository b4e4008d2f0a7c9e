"""Simulated navigation at rest over five hours, with the attitude aligned or given: outputs of the instrument, and its drift.

At rest the true specific force and rate in the body frame are constant; what the instrument's errors add is constant too, apart
from noise. So a second a step is fine enough: with it the position after five hours agrees with steps of 0.1 s to 1e-6 deg.
Alignment, mechanisation and the position error are those of ``imufield verify``; the alignment is the coarse one, which absorbs
what the accelerometer's errors do to level, so that they hardly show afterwards: what remains is what the gyroscope does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imufield.dataclass import dataclass
from imufield.deliver.navigation.alignment import coarse_attitude
from imufield.deliver.navigation.drift import Drift
from imufield.deliver.navigation.mechanise import integrate, load_pyins
from imufield.earth import MICRO_G_M_S2
from imufield.samples import FloatArray
from imufield.study.report import CsvTable

STEP_S = 1.0
HOURS = 5.0
"""As in BSAS Table 6 and IDE Fig. 10."""
ALIGNMENT_S = 600.0
LONGITUDE_DEG = 120.0
DOWN_UP = np.diag([1.0, -1.0, -1.0])
"""From our body axes (z up at rest) to those of python-ins (x forward, y right, z down)."""


@dataclass(frozen=True, slots=True)
class WhiteNoise:
    """White noise of the instrument that navigates."""

    accelerometer_m_s2_per_root_hz: float = 10 * MICRO_G_M_S2
    gyroscope_deg_per_root_hour: float = 0.003


INSTRUMENT_NOISE = WhiteNoise()


def rest_inputs(latitude_deg: float, heading_deg: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return specific force (m/s^2) and rate (rad/s) of a level unit at rest in our body axes, shape (3,) each."""
    modules = load_pyins()
    rotation = modules.transform.mat_from_rph([0.0, 0.0, heading_deg])
    force = rotation.T @ np.array([0.0, 0.0, -modules.earth.gravity(latitude_deg, 0.0)])
    rate = rotation.T @ modules.earth.rate_n(latitude_deg)
    return DOWN_UP @ force, DOWN_UP @ rate


def navigate_at_rest(
    force_m_s2: FloatArray,
    rate_rad_s: FloatArray,
    latitude_deg: float,
    *,
    hours: float = HOURS,
    noise: WhiteNoise = INSTRUMENT_NOISE,
    rng: np.random.Generator,
    attitude_rph_deg: FloatArray | None = None,
) -> Drift:
    """Align, navigate, and return the errors.

    Parameters
    ----------
    force_m_s2, rate_rad_s : ndarray, shape (3,)
        What the calibrated instrument shows at rest, noise apart, in our body axes.
    latitude_deg : float
    hours : float, optional
    noise : WhiteNoise, optional
    rng : Generator
    attitude_rph_deg : ndarray, shape (3,), optional
        Roll, pitch, heading to start with; without it the unit aligns itself for ten minutes first.
    """
    modules = load_pyins()
    n = round(hours * 3600 / STEP_S)
    force, rate = DOWN_UP @ force_m_s2, DOWN_UP @ rate_rad_s
    sigma_force = noise.accelerometer_m_s2_per_root_hz
    sigma_rate = math.radians(noise.gyroscope_deg_per_root_hour) / 60
    if attitude_rph_deg is None:
        # The mean over the alignment: noise of a density N averages to N / sqrt(T).
        shown = [
            mean + sigma / math.sqrt(ALIGNMENT_S) * rng.standard_normal(3)
            for mean, sigma in ((force, sigma_force), (rate, sigma_rate))
        ]
        attitude_rph_deg = modules.transform.mat_to_rph(coarse_attitude(*shown))
    root = math.sqrt(STEP_S)
    # Increments of one step: the integral of the rate, and of its noise, which grows with the root of the time.
    theta = rate * STEP_S + sigma_rate * root * rng.standard_normal((n, 3))
    velocity = force * STEP_S + sigma_force * root * rng.standard_normal((n, 3))
    # The unit turns with the Earth during a step, and its velocity increment with it: half a step in the mean.
    velocity += 0.5 * np.cross(theta, velocity)
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    increments = modules.pandas.DataFrame(
        np.column_stack([np.full(n, STEP_S), theta, velocity]), index=np.arange(1, n + 1) * STEP_S, columns=columns
    )
    start = np.array([latitude_deg, LONGITUDE_DEG, 0.0, 0.0, 0.0, 0.0, *np.asarray(attitude_rph_deg)])
    flown = integrate(start, 0.0, increments)
    latitude, longitude, north, east = (flown[name].to_numpy() for name in ("lat", "lon", "VN", "VE"))
    return Drift(
        time_s=flown.index.to_numpy(),
        latitude_deg=latitude - latitude_deg,
        longitude_deg=longitude - LONGITUDE_DEG,
        north_velocity_m_s=north,
        east_velocity_m_s=east,
        true_latitude_deg=latitude_deg,
    )


def minute_curves(runs: Mapping[str, Drift], names: Sequence[str]) -> CsvTable:
    """Return the errors of these names over time as a table, one row a minute, for each labelled run."""
    hours = next(iter(runs.values())).hours[::60]
    columns = [getattr(run, name)[::60] for run in runs.values() for name in names]
    heads = tuple(f"{label} {name}" for label in runs for name in names)
    return CsvTable("curves", ("hours", *heads), tuple(zip(hours, *columns, strict=True)))
