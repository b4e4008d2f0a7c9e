"""Report and record of a session of 24 positions at 2000 Hz: time, size; 8 minutes, and 40 as with an hour-long warm-up."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks import bench_commands
from benchmarks.bench_commands import run_program, write_long_session

ROUNDS = 3
MINUTES = (8.0, 40.0)


def run() -> list[dict[str, Any]]:
    """Return rows of time, processor time, memory and size."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for minutes in MINUTES:
            bench_commands.LONG_SESSION_S = 60 * minutes
            session = write_long_session(folder / f"{minutes:g}").folder
            run_program(folder, "solve", session, "--latitude", "48.1")
            run_program(folder, "verify", session / "parameters.toml", session)
            ended = [run_program(folder, "report", session) for _ in range(ROUNDS)]
            what = f"report, 24 positions in {minutes:g} min at 2000 Hz"
            rows += [
                {"name": f"{what}: time", "value": min(program.wall_s for program in ended), "unit": "s"},
                {"name": f"{what}: processor", "value": min(program.cpu_s for program in ended), "unit": "s"},
                {"name": f"{what}: memory", "value": max(program.memory_mib for program in ended), "unit": "MiB"},
                {"name": f"{what}: size", "value": (session / "report.html").stat().st_size / 2**20, "unit": "MiB"},
            ]
    return rows


if __name__ == "__main__":
    for line in run():
        print(f"{line['name']:<60} {line['value']:8.2f} {line['unit']}")
