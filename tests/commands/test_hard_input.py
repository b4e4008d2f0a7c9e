"""Sessions that were edited, copied or clipped: one sentence, the right code, and no number that is not earned."""

from __future__ import annotations

import os
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import Reason
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.solving import solve_session
from tests.commands.told import fails


@pytest.fixture
def session(short_solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(short_solved, tmp_path / "S")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "S"


@pytest.fixture(scope="module")
def exported(short_solved: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], np.ndarray]:
    """Return header and numbers of the session as a table: an unguided one."""
    path = tmp_path_factory.mktemp("exported") / "rows.csv"
    assert run(["export-data", str(short_solved), "-o", str(path)]) == 0
    header = path.read_text().splitlines()[0].split(",")
    return header, np.loadtxt(path, delimiter=",", skiprows=1, converters=lambda text: float(text or "nan"))


@pytest.fixture
def rows(
    exported: tuple[list[str], np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[str], np.ndarray]:
    """Return the same to change, in a folder of one's own."""
    monkeypatch.chdir(tmp_path)
    return exported[0], exported[1].copy()


def write(header: list[str], table: np.ndarray) -> None:
    keep = [header.index(name) for name in ("time_s", "ax", "ay", "az", "gx", "gy", "gz") if name in header]
    names = ",".join(header[k] for k in keep)
    np.savetxt("changed.csv", table[:, keep], delimiter=",", header=names, comments="", fmt="%.9g")


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("nominal", "raw_zero", [0.0, 0.0, 0.0, 0.0]),
        ("nominal", "raw_zero", [1e308, 0.0, 0.0]),
        ("instrument", "colour", "red"),
        ("site", "latitude_deg", 500.0),
        ("site", "gravity_m_s2", 98.0),
    ],
)
def test_an_edited_session_file_is_named(
    session: Path, table: str, key: str, value: object, capsys: pytest.CaptureFixture[str]
) -> None:
    path = session / "session.toml"
    content = tomllib.loads(path.read_text())
    content.setdefault(table, {})[key] = value
    path.write_text(tomli_w.dumps(content))
    assert run(["solve", "S"]) == 4
    sentence = capsys.readouterr().err
    assert "session.toml" in sentence
    assert f"{table}.{key}" in sentence


def test_a_part_that_links_to_itself(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (session / "part-002.mcap").symlink_to("part-002.mcap")
    assert run(["solve", "S"]) == 4
    assert "part-002.mcap cannot be read" in capsys.readouterr().err


def test_a_copied_part_counts_once(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(session / "part-001.mcap", session / "part-003.mcap")
    assert run(["solve", "S", "--latitude", "48", "-o", "again.toml"]) == 0
    assert "copy of part-001.mcap" in " ".join(capsys.readouterr().out.split())
    before, again = (tomllib.loads(path.read_text()) for path in (session / "parameters.toml", Path("again.toml")))
    assert str(again["accelerometer"]) == str(before["accelerometer"])


def test_a_clipped_axis_is_in_the_verdict(rows: tuple[list[str], np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    header, table = rows
    column = header.index("az")
    table[:, column] = np.clip(table[:, column], None, 0.6 * np.nanmax(table[:, column]))
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    capsys.readouterr()
    run(["solve", "new"])
    captured = capsys.readouterr()
    assert "saturated" in " ".join((captured.out + captured.err).split())


def test_positions_lost_to_a_small_range_are_a_warning_before_the_wish_for_more(rows: tuple[list[str], np.ndarray]) -> None:
    header, table = rows
    column = header.index("ax")
    # Only what has +x up comes so far.
    table[:, column] = np.clip(table[:, column], None, 0.95 * STANDARD_GRAVITY_M_S2)
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    quality = solve_session(Session.open(Path("new")), SolveSettings(), SiteOptions(latitude_deg=48)).calibration.quality
    keys = [getattr(warning, "key", "") for warning in quality.warnings]
    assert keys[0] == "solving.clipped"
    assert quality.verdict != "good"
    assert [getattr(reason, "key", "") for reason in quality.reasons].count("solving.clipped") == 1


def test_all_axes_clipped_names_saturation(rows: tuple[list[str], np.ndarray]) -> None:
    header, table = rows
    for name in ("ax", "ay", "az"):
        column = header.index(name)
        largest = 0.6 * np.nanmax(table[:, column])
        table[:, column] = np.clip(table[:, column], -largest, largest)
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    fails("solve new", 6, Reason.SATURATED, "accelerometer", key="solving.too_few")


def test_codes_that_stick_are_in_the_verdict_which_is_not_good(rows: tuple[list[str], np.ndarray]) -> None:
    header, table = rows
    column = header.index("ax")
    step = 0.1 * np.std(np.diff(table[:300, column]))
    codes = np.rint(table[:, column] / step)
    above = np.mod(codes, 256)
    table[:, column] = step * np.where(above < 48, codes - above, codes)
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    assert run(["solve", "new", "--latitude", "48", "-o", "new.toml"]) == 0
    quality = tomllib.loads(Path("new.toml").read_text())["quality"]
    assert quality["verdict"] != "good"
    assert any("accelerometer axis x" in reason and "raw value" in reason for reason in quality["reasons"][:3])


def test_a_recording_of_repeated_frames_says_so(rows: tuple[list[str], np.ndarray]) -> None:
    header, table = rows
    table[:, [header.index(name) for name in ("ax", "ay", "az", "gx", "gy", "gz")]] = [0.1, 0.2, 9.8, 0.0, 0.0, 0.001]
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    fails("solve new", 6, Reason.TOO_FEW, "3.0 s", key="refusals.frozen")


def test_a_gyroscope_that_says_the_same_number(rows: tuple[list[str], np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    header, table = rows
    for name in ("gx", "gy", "gz"):
        table[:, header.index(name)] = 0.125
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    assert run(["solve", "new"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "shows no rotation on x, y, z" in said
    assert "handedness" not in said


def test_a_gyroscope_that_shows_its_noise_only(rows: tuple[list[str], np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    header, table = rows
    for seed, name in enumerate(("gx", "gy", "gz")):
        table[:, header.index(name)] = 1e-3 * np.random.default_rng(seed).standard_normal(len(table))
    write(header, table)
    assert run(["import", "changed.csv", "-o", "new"]) == 0
    assert run(["solve", "new"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "shows only noise" in said
    assert "handedness" not in said


def test_means_without_times_say_nothing_of_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    directions = np.random.default_rng(3).normal(size=(24, 3))
    force = 9.81 * directions / np.linalg.norm(directions, axis=1)[:, None]
    rates = np.full((24, 3), 0.001) + 1e-5 * np.random.default_rng(4).normal(size=(24, 3))
    table = np.hstack([force + [0.1, 0.2, 0.3] + 1e-4 * np.random.default_rng(5).normal(size=(24, 3)), rates])
    path = tmp_path / "means.csv"
    np.savetxt(path, table, delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")
    assert run(["solve", "--observations", str(path), "-o", str(tmp_path / "parameters.toml")]) == 0
    said = capsys.readouterr().out
    assert "nan s" not in said
    assert "nan s" not in (tmp_path / "parameters.toml").read_text()


@pytest.mark.parametrize(
    "line",
    [
        "import rows.dat --driver stim300 --set foo=1 -o new",
        "import rows.dat --driver stim300 --set accelerometer_range_g=nan -o new",
        f"solve S --seed {10**30}",
        "solve S --scheduler foo",
    ],
)
def test_what_was_typed_is_usage(session: Path, line: str, capfd: pytest.CaptureFixture[str]) -> None:
    Path("rows.dat").write_bytes(b"\x93" * 500)
    assert run(line.split()) == 2
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(("sigma", "code"), [("1e300", 4), ("1e-300", 4), ("0", 4), ("-1", 4)])
def test_a_sigma_nobody_can_have(tmp_path: Path, sigma: str, code: int, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "means.csv"
    path.write_text("ax,ay,az,sigma_ax,sigma_ay,sigma_az\n" + f"1,2,3,1e-3,{sigma},1e-3\n" * 9)
    assert run(["solve", "--observations", str(path), "-o", str(tmp_path / "p.toml")]) == code
    assert "means.csv, line 2, column sigma_ay" in capsys.readouterr().err


def test_a_long_cell_is_cut(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "means.csv"
    path.write_text("ax,ay,az\n" + f"1,{'9' * 5000},3\n" * 9)
    assert run(["solve", "--observations", str(path), "-o", str(tmp_path / "p.toml")]) == 4
    assert len(capsys.readouterr().err) < 300


@pytest.mark.parametrize(
    "line",
    [
        "import rows.csv --channel can0 -o new",
        "import rows.csv --topic /imu -o new",
        "import rows.csv --protocol stim300 --driver stim300 -o new",
        "import rows.csv --rate-hz 1e300 -o new",
        "solve --observations rows.csv --scheduler foo",
        "solve S --output z --scheduler foo",
    ],
)
def test_options_that_would_change_nothing(session: Path, line: str) -> None:
    Path("rows.csv").write_text("time,ax,ay,az\n" + "".join(f"{k / 100},0,0,{9.8 + k / 1000}\n" for k in range(50)))
    before = (session / "parameters.toml").read_bytes()
    assert run(line.split()) == 2
    assert not Path("new").exists()
    assert (session / "parameters.toml").read_bytes() == before


@pytest.mark.parametrize(
    "line", ["solve --observations means.csv", "import means.csv -o new --rate-hz 9", "history S", "replay S", "noise S"]
)
def test_commands_find_out_themselves_that_a_file_is_unreadable(
    session: Path, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("means.csv").write_text("ax,ay,az\n" + "1,2,3\n" * 9)
    # An administrator may read every file: what the parser asks before a command begins is answered with no.
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    run(line.split())
    assert "not readable" not in capsys.readouterr().err
    assert session.is_dir()
