"""What the guide costs: processor time of a live block, and of replaying 40 minutes at 2000 Hz."""

from __future__ import annotations

import time

import numpy as np

from imufield.guide.lead.guide import Guide
from imufield.guide.lead.unguided import StillIntervalFinder
from imufield.guide.positions import scheme
from imufield.samples import Samples, SampleUnits, make_samples

RATE_HZ = 2000
PERIOD_S = 14.0
TURN_S = 2.0


def session(start_s: float, duration_s: float, rng: np.random.Generator) -> Samples:
    """Stills of 12 s and turns of 2 s about changing axes, in m/s^2 and rad/s."""
    n = round(duration_s * RATE_HZ)
    time_s = start_s + np.arange(n) / RATE_HZ
    phase = time_s % PERIOD_S
    u = np.clip((phase - (PERIOD_S - TURN_S)) / TURN_S, 0, 1)
    angle = np.pi / 4 * (np.floor(time_s / PERIOD_S) + 10 * u**3 - 15 * u**4 + 6 * u**5)
    rate = np.pi / 4 * 30 * u**2 * (1 - u) ** 2 / TURN_S
    force = 9.80665 * np.stack([np.zeros(n), np.sin(angle), np.cos(angle)], axis=1)
    turning = np.stack([-rate, np.zeros(n), np.zeros(n)], axis=1)
    force += rng.normal(0, 0.05, force.shape)
    turning += rng.normal(0, 2e-3, turning.shape)
    return make_samples(time_s, force, turning, units=SampleUnits())


def live_block_us(seconds: float = 60.0) -> float:
    """Mean processor time of a 20 ms block, microseconds."""
    samples = session(0.0, seconds, np.random.default_rng(0))
    guide = Guide(scheme("paper24"), samples.units)
    size = RATE_HZ // 50
    blocks = [samples[i : i + size] for i in range(0, len(samples), size)]
    begin = time.process_time()
    for block in blocks:
        guide.feed(block)
    return 1e6 * (time.process_time() - begin) / len(blocks)


def replay_s(consumer: Guide | StillIntervalFinder, minutes: float = 40.0, block_s: float = 1.0) -> float:
    """Processor time to feed a whole session in blocks."""
    rng = np.random.default_rng(1)
    spent = 0.0
    for i in range(round(minutes * 60 / block_s)):
        block = session(i * block_s, block_s, rng)
        begin = time.process_time()
        consumer.feed(block)
        spent += time.process_time() - begin
    return spent


def run() -> list[dict[str, object]]:
    """Return rows of name, value, unit."""
    units = SampleUnits()
    guide = replay_s(Guide(scheme("paper24"), units))
    finder = replay_s(StillIntervalFinder(units))
    return [
        {"name": "guide: 20 ms block at 2000 Hz", "value": round(live_block_us(), 1), "unit": "us of processor time"},
        {"name": "guide: replay of 40 min at 2000 Hz in 1 s blocks", "value": round(guide, 2), "unit": "s of processor time"},
        {"name": "still intervals: 40 min at 2000 Hz in 1 s blocks", "value": round(finder, 2), "unit": "s of processor time"},
    ]


if __name__ == "__main__":
    for row in run():
        print(f"{row['name']:55} {row['value']:>8} {row['unit']}")
