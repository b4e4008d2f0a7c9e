"""What Kalibr, OpenVINS and Basalt have in common: noise figures beside the intrinsics, biases estimated at run time."""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import Corrections
from imufield.deliver.exports.job import Job
from imufield.deliver.exports.text import number, row
from imufield.earth import MILLI_G_M_S2


def noise_lines(job: Job, indent: int) -> tuple[list[str], tuple[str, ...]]:
    """Return the YAML lines of the four noise figures and the rate, and what to say about those that are not known."""
    known, unknown = [], []
    for name, value in noise_figures(job).items():
        if value is None:
            unknown.append(name)
        else:
            known.append(f"{' ' * indent}{name}: {number(value)}")
    if not unknown:
        return known, ()
    missing = [f"{' ' * indent}# {name}: not known, fill in" for name in unknown]
    return known + missing, (f"fill in before use, because nothing here knows them: {', '.join(unknown)}",)


def noise_figures(job: Job) -> dict[str, float | None]:
    """Return the noise figures under Kalibr's names (root mean square over the axes); None where not known."""
    noise, options = job.parameters.context.noise, job.options
    rate_hz = job.parameters.context.session.sample_rate_hz
    return {
        "accelerometer_noise_density": _mean(None if noise is None else noise.accelerometer_density_m_s2_per_sqrt_hz),
        "accelerometer_random_walk": options.accelerometer_random_walk,
        "gyroscope_noise_density": _mean(None if noise is None else noise.gyroscope_density_rad_s_per_sqrt_hz),
        "gyroscope_random_walk": options.gyroscope_random_walk,
        "update_rate": rate_hz if np.isfinite(rate_hz) else None,
    }


def _mean(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None) -> float | None:
    if values is None or not np.isfinite(values).all():
        return None
    return float(np.sqrt(np.mean(values**2)))


def bias_lines(si: Corrections) -> list[str]:
    """Return the biases as lines for a comment."""
    lines = [f"accelerometer bias, m/s^2: [{row(si.accelerometer.offset.tolist())}]"]
    if si.gyroscope is not None:
        lines.append(f"gyroscope bias, rad/s: [{row(si.gyroscope.offset.tolist())}]")
    return lines


def bias_loss(si: Corrections) -> tuple[str, ...]:
    """Say how large the biases are that the target does not store."""
    size = np.linalg.norm(si.accelerometer.offset) / MILLI_G_M_S2
    losses = [f"accelerometer: the bias of {size:.3g} mg is no part of the file, the target estimates it at run time"]
    if si.gyroscope is not None:
        size = np.linalg.norm(si.gyroscope.offset) * 1e3
        losses.append(f"gyroscope: the bias of {size:.3g} mrad/s is no part of the file, the target estimates it at run time")
    return tuple(losses)
