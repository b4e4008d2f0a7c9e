"""CSV by blocks against lines made one by one with ``repr``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imufield.deliver.samples.export_csv import ROWS, write_csv
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, Samples, SampleUnits


def made(n: int) -> Samples:
    """Return samples of every kind of number that an instrument can give."""
    rng = np.random.default_rng(n)
    return Samples(
        time_s=np.arange(n) / 2000.0,
        accelerometer=np.column_stack([rng.normal(size=n), rng.integers(-(2**23), 2**23, n), np.full(n, np.nan)]),
        gyroscope=rng.normal(size=(n, 3)) * [1e-3, 1e-5, 1e-9],
        temperature_degc=np.where(np.arange(n) % 2, np.nan, np.round(rng.uniform(-40, 85, n), 2)),
        counter=np.where(np.arange(n) % 3, rng.integers(0, 2**32, n), NO_COUNTER),
        status=rng.integers(0, 2**32, n).astype(np.uint32),
        units=SampleUnits(),
    )


def lines_of(samples: Samples) -> str:
    floats = np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc])
    lines = []
    for numbers, counter, status in zip(floats.tolist(), samples.counter.tolist(), samples.status.tolist(), strict=True):
        texts = ["" if number != number else repr(number) for number in numbers]
        lines.append(",".join([*texts, "" if counter == NO_COUNTER else str(counter), str(status)]) + "\n")
    return "".join(lines)


def test_the_text_is_that_of_python(tmp_path: Path) -> None:
    samples = made(5 * ROWS + 7)
    blocks = [samples[start : start + ROWS] for start in range(0, len(samples), ROWS)]
    assert write_csv(blocks, tmp_path / "out.csv", {}) == len(samples)
    assert (tmp_path / "out.csv").read_bytes().decode() == ",".join(SAMPLE_COLUMNS) + "\n" + lines_of(samples)
