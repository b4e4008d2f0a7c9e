"""Runs that the tests of campaigns send to other processes."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from imufield.errors import UsageError


def draw(argument: int, rng: np.random.Generator) -> tuple[int, float]:
    return argument, float(rng.random())


def slow_draw(argument: int, rng: np.random.Generator) -> tuple[int, float]:
    time.sleep(0.1)
    return draw(argument, rng)


def sleep(seconds: float, _rng: np.random.Generator) -> float:
    time.sleep(seconds)
    return seconds


def interrupt_itself(argument: int, _rng: np.random.Generator) -> int:
    os.kill(os.getpid(), signal.SIGINT)
    return argument


def live(_marker: str, rng: np.random.Generator) -> float:
    return float(rng.random())


def die_once(marker: str, rng: np.random.Generator) -> float:
    value = float(rng.random())
    try:
        Path(marker).touch(exist_ok=False)
    except FileExistsError:
        return value
    os.kill(os.getpid(), signal.SIGKILL)
    return value


def die(_argument: int, _rng: np.random.Generator) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail(_argument: int, _rng: np.random.Generator) -> None:
    raise UsageError("no good", number=7)


def blas_threads(_argument: int, _rng: np.random.Generator) -> str:
    return os.environ["OMP_NUM_THREADS"]
