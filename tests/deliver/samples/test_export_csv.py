"""CSV by blocks against lines made one by one with ``repr``, and what happens when the samples or the disk end early."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imufield.deliver.samples import export_csv
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
    samples = made(20 * ROWS + 7)
    blocks = [samples[start : start + ROWS] for start in range(0, len(samples), ROWS)]
    assert write_csv(blocks, tmp_path / "out.csv", {}) == len(samples)
    assert (tmp_path / "out.csv").read_bytes().decode() == ",".join(SAMPLE_COLUMNS) + "\n" + lines_of(samples)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_samples_that_end_with_an_error(tmp_path: Path, error: type[BaseException]) -> None:
    def blocks() -> Iterator[Samples]:
        yield made(100)
        yield made(100)
        raise error

    threads = threading.active_count()
    with pytest.raises(error):
        write_csv(blocks(), tmp_path / "out.csv", {})
    assert threading.active_count() == threads


def test_text_that_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(samples: Samples) -> bytes:
        raise MemoryError(len(samples))

    monkeypatch.setattr(export_csv, "rows_text", fail)
    with pytest.raises(MemoryError, match="100"):
        write_csv([made(100)] * 20, tmp_path / "out.csv", {})
