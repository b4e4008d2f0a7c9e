"""A small simulated stream for the guide's tests: stills joined by turns about one body axis each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from imufield.samples import FloatArray, Samples, SampleUnits, make_samples

G = 9.80665


@dataclass
class Path:
    """Up in the body frame and body rate over time, and where it is truly still."""

    rate_hz: float
    lever_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    up: list[FloatArray] = field(default_factory=list)
    rate: list[FloatArray] = field(default_factory=list)
    still: list[tuple[float, float]] = field(default_factory=list)

    @property
    def count(self) -> int:
        return sum(len(part) for part in self.up)

    @property
    def time_s(self) -> float:
        return self.count / self.rate_hz

    def hold(self, up: Iterable[float], duration_s: float) -> Path:
        n = round(duration_s * self.rate_hz)
        direction = np.asarray(list(up), dtype=float)
        start = self.time_s
        self.up.append(np.tile(direction / np.linalg.norm(direction), (n, 1)))
        self.rate.append(np.zeros((n, 3)))
        self.still.append((start, self.time_s))
        return self

    def turn(self, up: Iterable[float], duration_s: float) -> Path:
        """Turn by the shortest way with minimum jerk."""
        start = self.up[-1][-1]
        goal = np.asarray(list(up), dtype=float)
        goal = goal / np.linalg.norm(goal)
        cross = np.cross(goal, start)
        if np.linalg.norm(cross) < 1e-9:
            cross = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
            if start @ goal > 0:  # lift it, tilt it and put it back
                half = math.cos(0.5) * start + math.sin(0.5) * cross / np.linalg.norm(cross)
                return self.turn(half, duration_s / 2).turn(goal, duration_s / 2)
        axis = cross / np.linalg.norm(cross)
        angle = math.atan2(np.linalg.norm(np.cross(goal, start)), goal @ start)
        n = round(duration_s * self.rate_hz)
        u = np.arange(n) / n
        phi = angle * (10 * u**3 - 15 * u**4 + 6 * u**5)
        speed = angle * (30 * u**2 - 60 * u**3 + 30 * u**4) / duration_s
        across = np.cross(axis, start)
        self.up.append(start * np.cos(phi)[:, None] - across * np.sin(phi)[:, None])
        self.rate.append(axis * speed[:, None])
        return self

    def samples(
        self,
        sigma_m_s2: float = 0.01,
        sigma_rad_s: float = 1e-3,
        *,
        seed: int = 1,
        gyroscope: bool = True,
        gyroscope_bias: float = 0.002,
        units: SampleUnits | None = None,
        scale: tuple[float, float] = (1.0, 1.0),
        raw_zero: float = 0.0,
        step: float = 0.0,
        start_s: float = 0.0,
    ) -> Samples:
        """Turn the path into raw samples; ``step`` quantises the raw accelerometer."""
        rng = np.random.default_rng(seed)
        up, rate = np.concatenate(self.up), np.concatenate(self.rate)
        angular = np.gradient(rate, 1 / self.rate_hz, axis=0)
        force = G * up + np.cross(rate, np.cross(rate, self.lever_m)) + np.cross(angular, self.lever_m)
        force = force * scale[0] + raw_zero + rng.normal(0, 1, up.shape) * sigma_m_s2 * scale[0]
        if step:
            force = np.round(force / step) * step
        turning = (rate + gyroscope_bias + rng.normal(0, 1, up.shape) * sigma_rad_s) * scale[1]
        time_s = start_s + np.arange(self.count) / self.rate_hz
        return make_samples(time_s, force, turning if gyroscope else None, units=units or SampleUnits())


def cut(samples: Samples, sizes: Iterable[int]) -> Iterator[Samples]:
    """Cut samples into blocks of these sizes; the last takes the rest."""
    start = 0
    for size in sizes:
        yield samples[start : start + size]
        start += size
    yield samples[start:]


@pytest.fixture
def make_path() -> Callable[..., Path]:
    return Path


@pytest.fixture
def cut_blocks() -> Callable[[Samples, Iterable[int]], Iterator[Samples]]:
    return cut
