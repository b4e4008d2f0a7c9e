"""A manufacturer's many units: ``history`` of up to 10,000 parameter files; ``solve`` of many sessions, on processes and Dask.

Ten calibrations of each unit, copies of one that was solved, with other serial numbers and dates. Sessions are copies of one
of 24 positions, 8 minutes at 2000 Hz. Two workers are held against half the time of one: ratio 1.25 is an efficiency of 0.8.
"""

from __future__ import annotations

import hashlib
import importlib
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from benchmarks import bench_commands
from benchmarks.bench_commands import Ended, run_program, unit_s, write_long_session
from benchmarks.rows import Row, row
from imufield.acquire.recording.session import Session
from imufield.deliver.parameters import to_toml
from imufield.deliver.parameters.read import read_document
from imufield.pipeline.reading_cache import CACHE_FILE

FILES = (100, 1000, 10_000)
CALIBRATIONS = 10
SESSIONS = (4, 16)
MINUTES = 8.0
ROUNDS = 3
_LEAST_S = 0.01  # The clock of processes ticks so.
BEGIN = datetime(2016, 1, 1, tzinfo=UTC)


def write_files(folder: Path, source: Path, count: int) -> None:
    """Copy a parameter file for ``CALIBRATIONS`` of each unit."""
    document = read_document(source).document
    for number in range(count):
        unit, calibration = divmod(number, CALIBRATIONS)
        when = (BEGIN + timedelta(days=365 * calibration + unit % 365)).strftime("%Y-%m-%dT%H:%M:%SZ")
        sha256 = hashlib.sha256(f"{number}".encode()).hexdigest()
        made = document | {
            "created": when,
            "instrument": document["instrument"] | {"serial_number": f"{unit:06d}"},
            "session": document["session"] | {"recorded": when, "sha256": sha256},
        }
        path = folder / f"{unit:06d}" / f"{when[:10]}.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(to_toml(made), encoding="utf-8")


def growth(command: str, times: dict[int, float]) -> Row:
    """Return the exponent between the last two sizes."""
    *_, smaller, larger = times
    exponent = math.log(times[larger] / times[smaller]) / math.log(larger / smaller)
    return row(f"{command}: growth from {smaller} to {larger}", exponent, "exponent")


def history_rows(folder: Path, source: Path) -> list[Row]:
    """Return what the history of one unit among many takes, with nothing and with everything in the index."""
    unit, rows = unit_s(), []
    start_s = run_program(folder, "history", "--help").cpu_s
    above: dict[str, dict[int, float]] = {"cold": {}, "warm": {}}
    for count in FILES:
        files = folder / f"{count}-files"
        write_files(files, source, count)
        cold, *warm = (run_program(folder, "history", files, "--serial", "000003") for _ in range(1 + ROUNDS))
        best = min(warm, key=lambda program: program.wall_s)
        for what, ended in (("cold", cold), ("warm", best)):
            # With everything in the index the program does less than for its help.
            above[what][count] = max(ended.cpu_s - start_s, _LEAST_S)
            rows.append(row(f"history of one unit in {count} files, {what}", ended.wall_s, "s", unit))
        rows.append(row(f"history of one unit in {count} files, cold: processor", cold.cpu_s, "s", unit))
    rows.append(row("history, cold: largest resident memory of a process", cold.memory_mib, "MiB"))
    return [*rows, *(growth(f"history, {what}", times) for what, times in above.items())]


def solve_rows(folder: Path, session: Session) -> list[Row]:
    """Return what ``solve`` of copies of a session takes on one and two workers."""
    copies = [folder / f"copy-{number}" for number in range(max(SESSIONS))]
    for copy in copies:
        copy.mkdir()
        for path in (*session.parts, session.folder / "session.toml"):
            (copy / path.name).hardlink_to(path)

    def solve(count: int, *options: object) -> Ended:
        for copy in copies:
            (copy / CACHE_FILE).unlink(missing_ok=True)
        return run_program(folder, "solve", *copies[:count], *options)

    few, one = (solve(count, "--workers", 1) for count in SESSIONS)
    two = solve(max(SESSIONS), "--workers", 2)
    on_cluster = []
    for workers in (1, 2):
        with dask_cluster(workers) as address:
            on_cluster.append(solve(max(SESSIONS), "--scheduler", address).wall_s)
    name = f"solve of {max(SESSIONS)} sessions of {MINUTES:g} min"
    return [
        row(f"{name}, one process", one.wall_s, "s"),
        row(f"{name}, 2 processes (peer: half of one)", two.wall_s, "s", one.wall_s / 2),
        row(f"{name}, Dask, 2 workers (peer: half of one)", on_cluster[1], "s", on_cluster[0] / 2),
        growth("solve of many", dict(zip(SESSIONS, (few.cpu_s, one.cpu_s), strict=True))),
    ]


@contextmanager
def dask_cluster(workers: int) -> Iterator[str]:
    """Run a cluster on this machine; yield its address."""
    distributed: Any = importlib.import_module("distributed")  # only here: it takes a second
    options = {"threads_per_worker": 1, "worker_dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(n_workers=workers, processes=True, dashboard_address="127.0.0.1:0", **options) as cluster:
        yield str(cluster.scheduler_address)


def run() -> list[Row]:
    """Return one row for each figure."""
    bench_commands.LONG_SESSION_S = 60 * MINUTES
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Nothing is left in the user's own cache.
        os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
        session = write_long_session(folder / "session")
        run_program(folder, "solve", session.folder)
        return [*history_rows(folder, session.folder / "parameters.toml"), *solve_rows(folder, session)]


if __name__ == "__main__":
    for line in run():
        peer = "" if line["peer"] is None else f"{line['peer']:9.3f} {line['ratio']:7.2f}"
        print(f"{line['name']:<70} {line['value']:9.3f} {line['unit']:<9} {peer}")
