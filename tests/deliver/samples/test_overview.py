"""Hours of samples in few rows: nothing that stood out is lost, however the samples come."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from imufield.deliver.samples.overview import MOST_BLOCKS, overview
from imufield.samples import Samples, SampleUnits, make_samples


def made(number: int) -> Samples:
    rng = np.random.default_rng(number)
    force = rng.normal(size=(number, 3))
    force[number // 3] = 50.0  # A knock of one sample.
    force[number // 2, 0] = np.inf
    force[::7, 1] = np.nan
    return make_samples(
        np.arange(number) / 2000,
        force,
        np.full((number, 3), np.nan),
        units=SampleUnits(),
        temperature_degc=np.where(np.arange(number) % 10 == 0, 25.0, np.nan),
    )


def in_pieces(samples: Samples) -> Iterator[Samples]:
    rng = np.random.default_rng(1)
    start = 0
    while start < len(samples):
        size = int(rng.integers(1, 40_000))
        yield samples[start : start + size]
        start += size


def test_few_samples_are_shown_as_they_are() -> None:
    samples = made(1000)
    columns, number = overview([samples])
    assert number == 1000
    np.testing.assert_array_equal(columns["time_s"], samples.time_s)
    for axis, name in enumerate(("ax", "ay", "az")):
        known = np.where(np.isfinite(samples.accelerometer[:, axis]), samples.accelerometer[:, axis], np.nan)
        for kind in ("min", "mean", "max"):
            np.testing.assert_array_equal(columns[f"{name}_{kind}"], known)
    np.testing.assert_array_equal(columns["temperature_degc"], samples.temperature_degc)


def test_many_samples_become_few_rows_and_no_knock_is_lost() -> None:
    samples = made(300_000)
    columns, number = overview(in_pieces(samples))
    time_s = columns["time_s"]
    assert number == 300_000
    assert MOST_BLOCKS / 2 < len(time_s) <= MOST_BLOCKS
    assert (np.diff(time_s) > 0).all()
    for axis, name in enumerate(("ax", "ay", "az")):
        force = samples.accelerometer[:, axis]
        known = force[np.isfinite(force)]
        assert columns[f"{name}_max"].max() == known.max() == 50.0
        assert columns[f"{name}_min"].min() == known.min()
        # A row stands for the same number of samples, but for the ends of pieces.
        assert columns[f"{name}_mean"].mean() == pytest.approx(known.mean(), abs=2e-3)
    knock = int(np.argmax(columns["az_max"]))
    assert time_s[knock] == pytest.approx(samples.time_s[100_000], abs=2 * float(np.diff(time_s).max()))
    assert all(np.isnan(columns[f"g{axis}_{kind}"]).all() for axis in "xyz" for kind in ("min", "mean", "max"))


def test_no_samples_give_no_rows() -> None:
    columns, number = overview([])
    assert number == 0
    assert {len(column) for column in columns.values()} == {0}
