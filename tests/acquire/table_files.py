"""Tables of text for the tests that read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

N = 50
RNG = np.random.default_rng(5)
TIME = np.arange(N) * 0.01
ACCELEROMETER = RNG.normal(size=(N, 3)) + np.array([0.0, 0.0, 9.8])
GYROSCOPE = RNG.normal(size=(N, 3)) * 0.1


def text_of(*columns: np.ndarray, delimiter: str = " ", header: str = "", end: str = "\n") -> str:
    rows = np.column_stack(columns).tolist()
    return header + "".join(delimiter.join(map(repr, row)) + end for row in rows)


def write(folder: Path, text: str, name: str = "table.txt") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path
