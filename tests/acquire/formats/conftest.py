"""Readers of files of other programs, forked from a process that has imported their libraries: half a second less for each."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from typing import Any

import pytest

from imufield.acquire.formats import can_logs, foreign_file_reader, ros_bags, table_arrays
from tests.commands.forks import Forked

READER, FOLDER, PYTHON_PATH = foreign_file_reader.__file__, Path.cwd(), os.environ.get("PYTHONPATH")
START = table_arrays.start_reader


def start_forked(kind: str, path: Path, *topic: str, **environment: str) -> Popen[Any]:
    """Start a reader as ``start_reader`` does; by itself where a test puts something in an interpreter's way."""
    as_ever = (foreign_file_reader.__file__, Path.cwd(), os.environ.get("PYTHONPATH")) == (READER, FOLDER, PYTHON_PATH)
    if not as_ever:
        return START(kind, path, *topic, **environment)
    return forked(kind, path, *topic, **environment)


def forked(kind: str, path: Path, *topic: str, **environment: str) -> Popen[Any]:
    """Start a reader as ``start_reader`` does, wherever the test is."""
    modules = ["asammdf" if kind == ".mf4" else "can.io"] if kind.startswith(".") else [foreign_file_reader.READERS[kind][0]]
    return Forked(
        [kind, str(path), *topic],
        program="reader",
        modules=modules,
        cwd=Path.cwd(),
        env={**os.environ, **environment},
        stdin=DEVNULL,
        stdout=PIPE,
        stderr=DEVNULL,
    )


def fork_readers(patch: pytest.MonkeyPatch, start: Callable[..., Popen[Any]] = start_forked) -> None:
    """Let forks read other programs' files; also for tests of other rooms."""
    for module in (can_logs, ros_bags, table_arrays):
        patch.setattr(module, "start_reader", start)


@pytest.fixture(autouse=True)
def forked_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    fork_readers(monkeypatch)
