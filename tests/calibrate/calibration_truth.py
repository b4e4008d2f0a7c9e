"""Simulated truth for the tests of calibration: a small generator of its own, and a still detector in twenty lines."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters
from imufield.samples import FloatArray, SampleUnits

GRAVITY = 9.81


def paper24() -> FloatArray:
    """8 steps of 45 deg about each axis held horizontal: 6 faces twice and 12 edges."""
    angle = np.pi / 4 * np.arange(8)
    axes = np.eye(3)
    return np.vstack(
        [np.outer(np.cos(angle), axes[(k + 1) % 3]) + np.outer(np.sin(angle), axes[(k + 2) % 3]) for k in range(3)]
    )


def faces(times: int = 1) -> FloatArray:
    return np.vstack([np.eye(3), -np.eye(3)] * times)


def edges() -> FloatArray:
    return np.array([d for d in paper24() if np.abs(d).max() < 0.9])


def tilted(direction: FloatArray, rng: np.random.Generator, sigma_rad: float) -> FloatArray:
    moved = direction + rng.normal(0, sigma_rad, direction.shape)
    return moved / np.linalg.norm(moved, axis=1)[:, None]


def random_parameters(rng: np.random.Generator, quadratic: float = 0.0) -> AccelerometerParameters:
    """K near 400, b up to 0.3 m/s^2, T up to 20 mrad; ``quadratic`` in m/s^2 at 1 g."""
    misalignment = rng.normal(0, 0.008, (3, 3))
    np.fill_diagonal(misalignment, 0)
    scale = 400 * (1 + rng.normal(0, 0.02, 3))
    K2 = scale * quadratic / GRAVITY**2 * rng.normal(0, 1, 3)
    return AccelerometerParameters(scale=scale, bias_m_s2=rng.normal(0, 0.1, 3), misalignment_rad=misalignment, quadratic=K2)


def outputs(parameters: AccelerometerParameters, a: FloatArray) -> FloatArray:
    """The measurement equation written out axis by axis, apart from the code under test."""
    raw = np.empty_like(a)
    for i in range(3):
        T_row = np.eye(3)[i] + parameters.misalignment_rad[i]
        s = a @ T_row
        squared = s if parameters.quadratic_axes == "sensing" else a[:, i]
        raw[:, i] = (
            parameters.scale[i] * (s + parameters.bias_m_s2[i]) + parameters.quadratic[i] * squared**2 + parameters.raw_zero[i]
        )
    return raw


def observe(
    mean: FloatArray,
    covariance: FloatArray | None = None,
    direction: FloatArray | None = None,
    gyroscope: FloatArray | None = None,
    name: tuple[str, ...] | None = None,
) -> Observations:
    m = len(mean)
    nan = np.full(m, np.nan)
    return Observations(
        name=tuple(f"p{k + 1:02d}" for k in range(m)) if name is None else name,
        mean_raw=mean,
        covariance_raw=np.full((m, 3, 3), np.nan) if covariance is None else covariance,
        gyroscope_mean_raw=np.full((m, 3), np.nan) if gyroscope is None else gyroscope,
        gyroscope_covariance_raw=np.full((m, 3, 3), np.nan),
        gyroscope_rounding_raw=np.zeros((m, 3)),
        gyroscope_noise_raw=np.full((m, 3), np.nan),
        direction=np.full((m, 3), np.nan) if direction is None else direction,
        start_s=nan,
        duration_s=nan,
        middle_s=np.full(m, np.nan),
        middle_rad=np.zeros((m, 3)),
        temperature_degc=nan,
        units=SampleUnits(accelerometer="count", gyroscope="count"),
    )


def campaign(
    parameters: AccelerometerParameters,
    rng: np.random.Generator,
    *,
    within_m_s2: float = 3e-4,
    between_m_s2: float = 0.0,
    planned: FloatArray | None = None,
    placement_rad: float = 0.03,
) -> Observations:
    """One session: placement error, noise of the mean (known), scatter between positions (not known)."""
    planned = paper24() if planned is None else planned
    a = GRAVITY * tilted(planned, rng, placement_rad)
    a = a + rng.normal(0, between_m_s2, a.shape)
    noise = within_m_s2 * np.abs(parameters.scale) * rng.uniform(0.7, 1.3, (len(a), 1))
    mean = outputs(parameters, a) + noise * rng.normal(0, 1, a.shape)
    covariance = np.einsum("mi,ij->mij", noise**2, np.eye(3))
    return observe(mean, covariance, planned)


def load_columns(path: Path) -> FloatArray:
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file)


def still_means(acc: FloatArray, noise: float, *, window: int = 51, shortest: int = 100, trim: int = 20) -> Observations:
    """Position means of a recording: still where the moving standard deviation of a window stays below ``noise``."""
    centred = acc - acc[0]
    total = np.vstack([np.zeros(3), np.cumsum(centred, axis=0)])
    square = np.vstack([np.zeros(3), np.cumsum(centred**2, axis=0)])
    variance = (square[window:] - square[:-window]) / window - ((total[window:] - total[:-window]) / window) ** 2
    still = np.zeros(len(acc) + 2, dtype=int)
    first = window // 2 + 1
    still[first : first + len(variance)] = np.sqrt(variance.sum(axis=1)) < noise
    change = np.flatnonzero(np.diff(still))
    pairs = [(a + trim, b - trim) for a, b in zip(change[::2], change[1::2], strict=True) if b - a - 2 * trim >= shortest]
    mean = np.array([acc[a:b].mean(axis=0) for a, b in pairs])
    return observe(mean, np.array([np.cov(acc[a:b].T) / (b - a) for a, b in pairs]))


def numeric_jacobian(residuals: Callable[[FloatArray], FloatArray], z: FloatArray, step: FloatArray) -> FloatArray:
    """Return the derivatives by central differences, shape (m, n)."""
    return np.stack(
        [(residuals(z + e) - residuals(z - e)) / (2 * size) for e, size in zip(np.diag(step), step, strict=True)], axis=1
    )
