"""What Kalibr, OpenVINS and Basalt have in common: noise figures beside the intrinsics, biases estimated at run time."""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import Corrections
from imufield.deliver.exports.job import Job, sentence
from imufield.deliver.exports.text import number, row, yaml_lines
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray


def imu_lines(job: Job) -> tuple[list[str], tuple[str, ...]]:
    """Return how the YAML table of an IMU begins, with noise figures and rate, and what to say about those not known."""
    figures = noise_figures(job)
    unknown = [name for name, value in figures.items() if value is None]
    # The first IMU is the reference: T_i_b is the identity.
    lines = yaml_lines({"imu0": {"T_i_b": np.eye(4)}})
    lines += [f"  {name}: {number(value)}" for name, value in figures.items() if value is not None]
    lines += [f"  # {name}: not known, fill in" for name in unknown]
    return lines, (sentence("vio.unknown", names=unknown),) if unknown else ()


def noise_figures(job: Job) -> dict[str, float | None]:
    """Return the noise figures under Kalibr's names (root mean square over the axes); None where not known."""
    noise, options = job.parameters.context.noise, job.options
    rate_hz = job.parameters.context.session.sample_rate_hz
    return {
        "accelerometer_noise_density": None if noise is None else _rms(noise.accelerometer_density_m_s2_per_sqrt_hz),
        "accelerometer_random_walk": options.accelerometer_random_walk,
        "gyroscope_noise_density": None if noise is None else _rms(noise.gyroscope_density_rad_s_per_sqrt_hz),
        "gyroscope_random_walk": options.gyroscope_random_walk,
        # NaN where the recording did not show its rate.
        "update_rate": rate_hz if np.isfinite(rate_hz) else None,
    }


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if np.isfinite(values).all() else None


def bias_lines(si: Corrections) -> list[str]:
    """Return the biases as lines for a comment."""
    units = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
    return [f"{triad} bias, {units[triad]}: [{row(correction.offset)}]" for triad, correction in si.triads.items()]


def bias_loss(si: Corrections) -> tuple[str, ...]:
    """Say how large the biases are that the target does not store."""
    units = {"accelerometer": ("mg", MILLI_G_M_S2), "gyroscope": ("mrad/s", 1e-3)}
    losses = []
    for triad, correction in si.triads.items():
        unit, size = units[triad]
        losses.append(sentence("vio.bias", triad=triad, size=np.linalg.norm(correction.offset) / size, unit=unit))
    return tuple(losses)
