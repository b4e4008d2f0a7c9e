"""Every command line in README and documentation is run, or says which other test runs it."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.cli.run import run
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.write import write_document
from imufield.earth import EARTH_RATE_RAD_S

PROJECT = Path(__file__).resolve().parents[2]
PAGES = sorted([PROJECT / "README.md", *(PROJECT / "docs").rglob("*.md")])
LINE = re.compile(r"^(?:    |\$ )(imufield [a-z].*?)(?:  +#.*)?$", re.MULTILINE)
ELSEWHERE = {
    "imufield demo": "tests/commands/test_desk.py runs it to its end",
    "imufield capture --resume": "tests/commands/test_capture.py resumes",
    "imufield capture --port /dev/ttyUSB0 --baud 115200 --protocol my_imu.toml": "tests/test_docs_protocols.py decodes it",
    "imufield capture --port /dev/ttyUSB0 --driver text": "tests/commands/test_capture.py reads lines of numbers",
    "--ramp": "tests/commands/test_record.py leads a ramp",
    "--together": "tests/commands/test_solve_together.py solves sessions together",
    "--bus": "tests/commands/test_can.py has the buses",
    "imufield replay my-session --to-pty": "tests/commands/test_desk.py and test_can.py read such a port",
    "imufield import bench.": "tests/commands/test_import.py and tests/acquire/formats/test_table_arrays.py read such files",
    "imufield import dr": "tests/commands/test_import.py and tests/acquire/formats/test_ros_bags.py read logs and bags",
    "imufield import dump.bin": "tests/commands/test_desk.py reads bytes of instruments",
    "imufield web": "tests/web/test_workbench.py starts and ends it",
    "--web": "tests/web/test_guide_page.py does a session from its page",
    "imufield study": "tests/study runs every study",
    "imufield solve room": "tests/pipeline/test_over_temperature.py solves a session with another and a ramp",
    "imufield probe": "tests/commands/test_probe.py finds instruments on ports",
    "--poses": "tests/commands/test_emulate_poses.py leads a capture by them",
    "imufield emulate xsens_can": "tests/simulate/emulator/test_slcan.py opens its adapter, which waits for somebody to do so",
    "imufield emulate my_imu.toml": "tests/simulate/instruments/test_protocol_device.py emulates formats of the user's own",
    "imufield emulate my_logger.toml": "tests/commands/test_emulate_own.py emulates and captures it",
    "imufield capture --port /tmp/imu --protocol my_logger.toml": "tests/commands/test_emulate_own.py emulates and captures it",
    "imufield emulate my_imu --link": "tests/commands/test_emulate_own.py emulates and captures it",
    "imufield capture --port /tmp/imu --clock-speed": "tests/commands/test_capture.py captures at this speed",
    "imufield capture --port /tmp/imu --driver my_imu": "tests/commands/test_emulate_own.py emulates and captures it",
}
"""Beginnings of lines, or options, and where they are run."""
LIVE = "imufield capture --port /dev/ttyUSB0 --latitude 48.1 --height 520"
MAY_FAIL = {"--require": 7}
"""What a line may say beside 0: a requirement is met or not."""


def command_lines() -> dict[str, str]:
    """Return every command line with the page it stands in first."""
    found: dict[str, str] = {}
    for page in PAGES:
        for line in LINE.findall(page.read_text(encoding="utf-8")):
            for one in re.split(r"\s&&\s", line):
                found.setdefault(one.strip(), page.relative_to(PROJECT).as_posix())
    return found


def elsewhere(line: str) -> bool:
    return any(line.startswith(key) or f" {key} " in f"{line} " for key in ELSEWHERE)


LINES = command_lines()
HERE = [line for line in LINES if line != LIVE and not elsewhere(line)]


@pytest.fixture(scope="module")
def furnished(solved_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that holds everything the pages speak of."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("my-session", "OTHER-SESSION", "imufield-sessions/20260304T100000Z-stim300"):
        shutil.copytree(solved_session, folder / name)
    shutil.copy(solved_session / "parameters.toml", folder)
    (folder / "docs").mkdir()
    shutil.copytree(PROJECT / "docs" / "exports", folder / "docs" / "exports")
    write_kept(solved_session / "parameters.toml", folder / "calibrations")
    write_table(folder / "bench-17.csv")
    write_logs(solved_session, folder)
    assert run(["import", str(folder / "bench-17.csv"), "--rate-hz", "20", "-o", str(folder / "rest-of-1-hour")]) == 0
    return folder


def write_kept(parameters: Path, folder: Path) -> None:
    for month in ("03", "08"):
        document: dict[str, Any] = load(parameters).document
        del document["integrity"]
        document["instrument"]["serial_number"] = "1234"
        document["created"] = f"2026-{month}-01T10:00:00Z"
        document["session"]["sha256"] = month * 32
        (folder / month).mkdir(parents=True)
        write_document(folder / month / "parameters.toml", document)


def write_table(path: Path) -> None:
    """Write 700 s at rest, level, x axis to the north."""
    rng, n = np.random.default_rng(2), 14000
    latitude = np.radians(48.0)
    rate = EARTH_RATE_RAD_S * np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    force = np.array([0.01, 0.02, 9.809]) + 1e-3 * rng.standard_normal((n, 3))
    rows = np.hstack([force, rate + 1e-5 * rng.standard_normal((n, 3))])
    header = "ax (m/s^2),ay (m/s^2),az (m/s^2),gx (rad/s),gy (rad/s),gz (rad/s)"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")


def write_logs(session: Path, folder: Path) -> None:
    """Write the session as logs of two instruments."""
    assert run(["export-data", str(session), "-o", str(folder / "both.csv")]) == 0
    rows = np.loadtxt(folder / "both.csv", delimiter=",", skiprows=1, usecols=range(7))
    np.savetxt(folder / "accelerometer.csv", rows[:, :4], delimiter=",", header="time_s,ax,ay,az", comments="")
    np.savetxt(folder / "gyroscope.csv", rows[:, [0, 4, 5, 6]], delimiter=",", header="time_s,gx,gy,gz", comments="")


def test_there_are_lines_and_reasons_are_used() -> None:
    assert len(HERE) > 25
    assert LIVE in LINES
    for key in ELSEWHERE:
        if not key.startswith("imufield study"):
            assert any(line.startswith(key) or f" {key} " in f"{line} " for line in LINES), f"{key} is in no page any more"


def ending(arguments: list[str]) -> list[str]:
    """Return the arguments so that an emulated instrument ends by itself; its link goes where the test is."""
    if arguments[0] != "emulate":
        return arguments
    kept = [one.replace("/tmp/imu", "imu") for one in arguments if one != "--wait"]
    return [*kept, "--duration-s", "0.2"]


@pytest.mark.parametrize("line", HERE)
def test_line_of_a_page(
    furnished: Path, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(furnished)
    code = run(ending(shlex.split(line)[1:]))
    allowed = {0, *(other for option, other in MAY_FAIL.items() if option in line)}
    assert code in allowed, f"{LINES[line]}: {capsys.readouterr().err}"


def test_one_command_line_gives_page_header_and_parameters(furnished: Path) -> None:
    chain = next(line for line in LINE.findall((PROJECT / "README.md").read_text(encoding="utf-8")) if line.count("&&") == 3)
    assert [part.split()[1] for part in chain.split("&&")] == ["solve", "report", "export", "export"]
    # The lines above were its parts, in this folder.
    assert (furnished / "drift.svg").read_text(encoding="utf-8").startswith("<svg")
    assert (furnished / "my-session" / "report.html").stat().st_size > 100_000
    assert "imufield_apply" in (furnished / "calibration.h").read_text(encoding="utf-8")
    assert "CAL_ACC0_XOFF" in (furnished / "imu.params").read_text(encoding="utf-8")


def test_first_capture_of_the_readme(program: Any) -> None:
    """As a person types it, on an emulated instrument that runs fast, with six short holds in place of 24."""
    port = program.emulate("--positions", "faces6", "--wait")
    typed = shlex.split(LIVE.replace("/dev/ttyUSB0", port))[1:]
    more = program.capture(port)[3:]
    done = program.run(*typed, *more)
    assert done.returncode == 0, done.stderr
    assert "done" in done.stdout
