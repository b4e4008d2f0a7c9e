"""CSV by pyarrow against CSV by Python: one text, byte for byte, whatever the numbers are."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imufield.deliver.samples.export_csv import arrow_writer, write_csv, write_rows
from imufield.samples import NO_COUNTER, FloatArray, Samples, SampleUnits, make_samples

pytest.importorskip("pyarrow")

EDGES = (
    *(0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 5e-324, 2.2250738585072014e-308, np.finfo(float).max, 0.1, 1 / 3),
    *(1e-4, 9.999999999999999e-05, 1e-05, 1.5e-7, 1e9, 9999999999.0, 9999999999.5, 1e10, 10000000000.5, 1e15, 1e16, 1e17),
    *(123456789012345680.0, 9007199254740993.0, 1e21, 1e22, 1e23, 1234567.0, 12345678.9, 100.0),
)


def of_numbers(numbers: FloatArray) -> Samples:
    """Return samples that hold the numbers in each of their columns of floats."""
    n = len(numbers)
    return Samples(
        time_s=numbers,
        accelerometer=np.column_stack([numbers, -numbers, numbers[::-1]]),
        gyroscope=np.column_stack([np.full(n, np.nan), np.rint(numbers), numbers / 7]),
        temperature_degc=np.where(np.arange(n) % 2, np.nan, numbers),
        counter=np.where(np.arange(n) % 3, np.arange(n), NO_COUNTER),
        status=np.arange(n, dtype=np.uint32) << np.uint32(16),
        units=SampleUnits(),
    )


def texts(samples: Samples) -> tuple[bytes, bytes]:
    by_arrow, write = io.BytesIO(), arrow_writer()
    assert write is not None
    write(samples, by_arrow)
    by_python = io.BytesIO()
    write_rows(samples, by_python)
    return by_arrow.getvalue(), by_python.getvalue()


def test_edges() -> None:
    by_arrow, by_python = texts(of_numbers(np.array([*EDGES, *(-edge for edge in EDGES)])))
    assert by_arrow == by_python


@given(st.lists(st.floats(), min_size=1, max_size=40))
def test_any_numbers(numbers: list[float]) -> None:
    by_arrow, by_python = texts(of_numbers(np.array(numbers)))
    assert by_arrow == by_python


@pytest.mark.parametrize("exponent", [-320, -12, -5, -4, -1, 0, 3, 8, 9, 10, 14, 15, 17, 290])
def test_many_numbers_of_one_size(exponent: int) -> None:
    rng = np.random.default_rng(exponent + 400)
    digits = rng.integers(1, 10 ** rng.integers(1, 17, 3000)) / 10.0 ** rng.integers(0, 17, 3000)
    by_arrow, by_python = texts(of_numbers(digits * 10.0**exponent))
    assert by_arrow == by_python


def test_pandas_is_not_loaded() -> None:
    code = """
import io, sys
import numpy as np
from imufield.deliver.samples.export_csv import arrow_writer
from imufield.samples import SampleUnits, make_samples
arrow_writer()(make_samples(np.array([0.5, 1.0, 1e-9]), np.ones((3, 3)), units=SampleUnits()), io.BytesIO())
print("pandas" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_a_long_file_is_the_same_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    block = make_samples(np.arange(40_000) / 2000.0, rng.normal(size=(40_000, 3)), units=SampleUnits())
    assert write_csv([block, block[:10]], tmp_path / "with.csv", {}) == 40_010
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert write_csv([block, block[:10]], tmp_path / "without.csv", {}) == 40_010
    assert (tmp_path / "with.csv").read_bytes() == (tmp_path / "without.csv").read_bytes()
