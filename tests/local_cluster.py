"""A small Dask cluster for the tests that send work to one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@contextlib.contextmanager
def local_cluster(on_path: Path) -> Iterator[Any]:
    """Two workers that find modules in a folder; the nanny gives the path to a worker that replaces a killed one, too."""
    distributed = pytest.importorskip("distributed", reason="needs the study extra")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",  # Any free port: without one it wants 8787, which another run may have.
        worker_dashboard_address=None,
        silence_logs=50,
        env={"PYTHONPATH": str(on_path)},
    ) as cluster:
        yield cluster
