"""A start loads what its command uses: by the packages, and rooms of imufield, that are slow to import."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imufield.cli.run import run

# All that takes longer than some milliseconds and is not used by every command.
SLOW = {
    *("typer", "pydantic", "rich", "numpy", "numpy.random", "scipy", "serial", "can", "cantools", "mcap.records", "zstandard"),
    *("crccheck", "matplotlib", "jinja2", "tomli_w", "importlib.metadata", "concurrent.futures", "asyncio", "subprocess"),
    *("orjson", "difflib", "numpy.ma", "_strptime", "imufield.acquire.clock.can_clock"),
    *("imufield.calibrate.accelerometer.methods", "imufield.calibrate.gyroscope.methods", "imufield.calibrate.temperature.fit"),
    *("imufield.acquire.decoder", "imufield.calibrate.gyroscope", "imufield.calibrate.moves", "imufield.guide.lead.guide"),
    *("imufield.simulate", "imufield.web", "imufield.study", "imufield.deliver.exports", "imufield.deliver.report"),
}
DECODING = {"numpy", "zstandard", "imufield.acquire.decoder"}
READING = {*DECODING, "crccheck"}
# What is kept of a session needs no guide.
SOLVING = {
    *READING,
    "imufield.calibrate.gyroscope",
    "imufield.calibrate.moves",
    "imufield.deliver.report",
    "concurrent.futures",
}
USED = {
    "--version": set[str](),
    "--help": {"rich"},
    "devices": {"serial", "importlib.metadata"},
    "devices stim300": {"numpy", "serial", "crccheck", "importlib.metadata"},
    "plan": {"numpy"},
    "sessions .": {"numpy"},
    "import table.csv --rate-hz 125 -o imported": {*DECODING, "mcap.records", "tomli_w", "imufield.calibrate.gyroscope"},
    "solve session": SOLVING,
    "replay session": {*READING, "imufield.guide.lead.guide", "imufield.calibrate.gyroscope"},
    "export session/parameters.toml --to c -o calibration.h": {"numpy", "imufield.deliver.exports"},
    "export-data session --to csv -o samples.csv": {*READING, "orjson"},
    "apply session/parameters.toml session -o corrected.csv": {*READING, "orjson"},
    "history session": {
        *("numpy", "numpy.random", "concurrent.futures", "subprocess", "imufield.calibrate.gyroscope", "_strptime"),
    },
    "report session": {*SOLVING, "jinja2", "numpy.ma", "importlib.metadata", "imufield.calibrate.accelerometer.methods"},
}


@pytest.fixture(scope="module")
def solved_here(short_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session solved by this process, to be changed."""
    folder = tmp_path_factory.mktemp("starts") / "session"
    shutil.copytree(short_session, folder)
    assert run(["solve", str(folder), "--latitude", "48"]) == 0
    return folder


@pytest.mark.parametrize("line", USED)
def test_a_start_loads_what_it_uses(line: str, solved_here: Path, tmp_path: Path) -> None:
    shutil.copytree(solved_here, tmp_path / "session")  # Some commands write into it.
    np.savetxt(tmp_path / "table.csv", np.ones((500, 6)), delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")
    code = f"""
import sys
sys.argv[1:] = {line.split()}
from imufield.cli import main
try:
    main()
finally:
    print(sorted({SLOW - USED[line]} & set(sys.modules)), file=sys.stderr)
"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("IMUFIELD_", "_TYPER", "FORCE_"))}
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment, cwd=tmp_path
    )
    assert ended.stderr.splitlines()[-1] == "[]"
