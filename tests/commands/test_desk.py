"""The commands that need no operator: record, import, replay, solve, export-data, emulate, devices, demo."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import read_session
from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.commands import demo
from imufield.commands.emulate import make_emulation
from imufield.commands.options.acquire_commands import VIRTUAL_SEED, DemoOptions, EmulateOptions
from imufield.commands.terminal import emulated
from imufield.errors import LinkError
from imufield.guide.positions import scheme
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into, session_samples
from imufield.pipeline.reading_cache import CACHE_FILE
from imufield.samples import AXES, SAMPLE_COLUMNS, concatenate
from imufield.sentences import Sentences
from imufield.simulate.truth.motion import Site
from tests.commands.told import missing, says
from tests.conftest import PROJECT
from tests.refused import refused

if TYPE_CHECKING:
    from tests.commands.conftest import Program


@pytest.fixture
def short(program: Program, short_session: Path) -> Path:
    """Where nothing is asked that only all positions show."""
    shutil.copytree(short_session, program.folder / "short")
    return program.folder / "short"


def document(program: Program, *arguments: object) -> dict[str, Any]:
    ended = program.run("solve", *arguments, "--json")
    assert ended.returncode == 0, ended.stderr
    content: dict[str, Any] = json.loads(ended.stdout)
    return content


def test_record_for_a_time(program: Program) -> None:
    port = program.emulate("--positions", "none", "--wait")
    typed = ("--duration-s", 20, "--clock-speed", 16, "--json", "--session", "here", "--latitude", 45, "--height", 300)
    ended = program.run("record", "--port", port, *typed)
    assert ended.returncode == 0, ended.stderr
    *progress, last = [json.loads(line) for line in ended.stdout.splitlines()]
    assert {line["event"] for line in progress} == {"recording"}
    assert (last["event"], last["session"], last["samples_lost"]) == ("recorded", "here", 0)
    # Listening comes on top, and a busy machine counts in time, not in samples.
    assert 0.8 * 20 * 125 < last["samples"] < 60 * 125
    session = Session.open(program.folder / "here")
    assert session.finished
    assert session.metadata["kind"] == "record"
    assert session.metadata["site"] == {"latitude_deg": 45.0, "height_m": 300.0}
    assert session.metadata["instrument"]["serial_number"].startswith("N")
    assert session.record.link.is_virtual, "by its clock"
    solved = program.run("solve", "here")
    assert solved.returncode == 6
    assert not missing(solved.stderr, "scale and bias need 6")


def test_a_session_that_is_still_being_recorded_is_called_that(program: Program, whole_session: Path) -> None:
    """The lock of the capture is held, and its part has no end yet: that is no damage."""
    # Of more blocks than one: the last goes with its end.
    whole = Path(shutil.copytree(whole_session, program.folder / "whole"))
    part = whole / "part-001.mcap"
    part.write_bytes(part.read_bytes()[:-2000])
    cut = document(program, "whole")["quality"]["reasons"]
    assert any("cut off" in reason or "no end marker" in reason for reason in cut)
    with Session.open(whole).lock():
        reasons = document(program, "whole")["quality"]["reasons"]
        others = [program.run("replay", "whole"), program.run("export-data", "whole")]
    for ended in others:
        assert says(ended.stderr, "pipeline", "damage.goes_on", path="whole/part-001.mcap")
        assert "cut off" not in ended.stderr
    assert "cut off" in program.run("replay", "whole").stderr
    assert Sentences("imufield.pipeline")("damage.goes_on", path="whole/part-001.mcap") in reasons
    assert not any("cut off" in reason or "end marker" in reason for reason in reasons)


def test_solve_twice_gives_the_same_and_leaves_the_file(program: Program, whole_session: Path) -> None:
    # Once from a replay, once from what was kept of it.
    whole = Path(shutil.copytree(whole_session, program.folder / "whole", ignore=shutil.ignore_patterns(CACHE_FILE)))
    first, file = document(program, "whole"), (whole / "parameters.toml").read_bytes()
    while time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()) <= first["created"]:
        time.sleep(0.05)
    second = document(program, "whole")
    for varies in ("created", "integrity"):
        first.pop(varies, None)
        second.pop(varies, None)
    assert first == second
    assert {path.name: path.read_bytes() for path in whole.glob("parameters*.toml")} == {"parameters.toml": file}
    assert first["site"]["gravity_source"] == "typed"
    assert first["quality"]["verdict"] == "good"


def test_the_site_typed_goes_before_the_sessions_own_and_that_before_defaults(program: Program, short: Path) -> None:
    (program.folder / "imufield.toml").write_text("latitude = 10\n")
    variables = {"IMUFIELD_GRAVITY_M_S2": "9.79"}

    def site(*options: object) -> dict[str, Any]:
        ended = program.run("solve", "short", "--json", *options, variables=variables)
        assert ended.returncode == 0, ended.stderr
        found: dict[str, Any] = json.loads(ended.stdout)["site"]
        return found

    assert site()["gravity_m_s2"] == 9.80665
    assert site("--latitude", 60)["latitude_deg"] == 60
    assert site("--latitude", 60)["gravity_source"] == "normal"
    settings = (short / "session.toml").read_text()
    (short / "session.toml").write_text(settings.replace("gravity_m_s2 = 9.80665\n", ""))
    assert site()["gravity_m_s2"] == 9.79


def test_solve_takes_the_newest_session(program: Program, short: Path) -> None:
    root = program.folder / "imufield-sessions"
    root.mkdir()
    for stamp in ("20250101T000000Z-old", "20250102T000000Z-new"):
        shutil.copytree(short, root / stamp)
    ended = program.run("solve")
    assert ended.returncode == 0, ended.stderr
    assert [path.parent.name for path in root.glob("*/parameters.toml")] == ["20250102T000000Z-new"]


def test_the_means_of_a_parameter_file_give_the_same_parameters(program: Program, short: Path) -> None:
    from_session = document(program, "short", "--model", "linear")
    with (program.folder / "means.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([f"a{axis}" for axis in AXES] + [f"sigma_a{axis}" for axis in AXES] + ["name"])
        for position in from_session["position"]:
            table.writerow([*map(repr, position["mean_raw"] + position["sigma_raw"]), position["name"]])
    options = ("--model", "linear", "--gravity", 9.80665)
    from_means = document(program, "--observations", "means.csv", *options)
    assert (program.folder / "parameters.toml").is_file()
    for key in ("scale", "bias_m_s2", "misalignment_rad"):
        sigma = np.array(from_session["accelerometer"]["uncertainty"][key])
        difference = np.array(from_means["accelerometer"][key]) - np.array(from_session["accelerometer"][key])
        # Between the axes of one mean the session knows a covariance that a table of sigmas does not hold.
        assert np.all(np.abs(difference) <= 0.1 * sigma + 1e-12), key
    assert any("axis signs and order" in reason for reason in from_means["quality"]["reasons"])


def test_exported_samples_come_back_as_they_were(program: Program, short: Path) -> None:
    exported = program.run("export-data", "short", "-o", "samples.csv")
    assert exported.returncode == 0, exported.stderr
    original = concatenate(session_samples(Session.open(short), []))
    with (program.folder / "samples.csv").open() as file:
        assert file.readline().strip().split(",") == list(SAMPLE_COLUMNS)
        assert sum(1 for _ in file) == len(original)
    units = ("--set", "accelerometer_unit=m/s^2", "--set", "gyroscope_unit=rad/s")
    imported = program.run("import", "samples.csv", "-o", "back", *units, "--json")
    assert imported.returncode == 0, imported.stderr
    assert json.loads(imported.stdout)["session"] == "back"
    back = concatenate(session_samples(Session.open(program.folder / "back"), []))
    assert len(back) == len(original)
    assert np.array_equal(back.accelerometer, original.accelerometer)
    assert np.array_equal(back.gyroscope, original.gyroscope)
    assert np.allclose(back.time_s - back.time_s[0], original.time_s - original.time_s[0], rtol=0, atol=1e-9)
    # Neither session's positions are planned here, so both find every still interval for themselves.
    settings = (short / "session.toml").read_text()
    (short / "session.toml").write_text(settings.replace('scheme = "paper24"\n', ""))
    site = ("--gravity", 9.80665)
    first, second = document(program, "short", *site), document(program, "back", *site)
    means = [[position["mean_raw"] for position in one["position"]] for one in (first, second)]
    assert len(means[0]) >= 13
    assert np.allclose(means[0], means[1], rtol=0, atol=1e-9)


def test_a_dump_of_the_bytes_gives_the_same_samples(program: Program, short: Path) -> None:
    data = b"".join(item.data for item in read_session(Session.open(short)) if isinstance(item, Chunk))
    (program.folder / "dump.bin").write_bytes(b"not yet" + data)
    settings = ("--set", "accelerometer_range_g=10", "--set", "rate_hz=125")
    imported = program.run("import", "dump.bin", "--protocol", "stim300", *settings, "-o", "dump")
    assert imported.returncode == 0, imported.stderr
    assert "7 of" in imported.stderr
    samples = [concatenate(session_samples(Session.open(folder), [])) for folder in (short, program.folder / "dump")]
    assert np.array_equal(samples[0].accelerometer, samples[1].accelerometer)


def test_replayed_to_a_port_a_capture_measures_the_same(program: Program, make_session: Callable[..., Session]) -> None:
    session = make_session("faces6")
    # Of a program that was killed in the moment it created a part.
    (session.folder / "part-002.mcap").touch()
    process = program.start("replay", session.folder, "--to-pty", "--speed", 16)
    assert process.stdout is not None
    found = re.search(r"waiting for a reader of (\S+)", process.stdout.readline())
    assert found is not None
    common = ("--driver", "stim300", "--set", "accelerometer_range_g=10", "--set", "rate_hz=125")
    plan = ("--positions", "faces6", "--hold-s", 4, "--session", "again", "--clock-speed", 16)
    ended = program.run("capture", "--port", found[1], *common, *plan)
    assert ended.returncode == 0, ended.stderr
    original, again = positions(session), positions(Session.open(program.folder / "again"))
    assert original.keys() == again.keys()
    # A port is emptied when it is opened: a busy machine may lose the first samples there, and holds are cut elsewhere then.
    for name, mean in original.items():
        assert np.allclose(mean, again[name], rtol=0, atol=2e-3), name
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "part-002.mcap" in said


def positions(session: Session) -> dict[str, Any]:
    chain = Chain(ReadingPlan.of(session))
    replay_into(chain, session, [])
    found = chain.observations()
    return dict(zip(found.name, found.mean_raw, strict=True))


def test_replay_counts(program: Program, short: Path) -> None:
    ended = program.run("replay", "short")
    assert ended.returncode == 0
    samples = len(concatenate(session_samples(Session.open(short), [])))
    assert ended.stdout.splitlines()[-1].startswith(f"{samples} samples of {samples} frames; 0 lost")


def test_devices(program: Program) -> None:
    ended = program.run("devices", "--json")
    content = json.loads(ended.stdout)
    assert content.keys() == {"ports", "buses", "drivers"}
    assert {"stim300", "text"} <= {driver["name"] for driver in content["drivers"]}
    shown = program.run("devices").stdout
    assert "Sensonor" in shown
    assert max(map(len, shown.splitlines())) <= 80


def test_emulate_says_that_it_is_fast_and_that_its_reader_has_left(program: Program) -> None:
    process = program.start("emulate", "stim300", "--speed", 8, "--link", "imu")
    assert process.stdout is not None
    while "Ctrl-C" not in process.stdout.readline():
        pass
    with (program.folder / "imu").open("rb") as port:
        assert port.read(1)
        time.sleep(1.5)  # It looks for its reader twice a second.
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    told = " ".join(process.communicate(timeout=120)[1].split())
    sentence = Sentences("imufield.commands")
    assert sentence("emulate.fast", rate_hz=16000.0, limit=8000.0, remedies="--speed 4 or --rate-hz 1000") in told
    assert sentence("emulate.left") in told


def test_emulate_says_where_and_how(program: Program) -> None:
    process = program.start("emulate", "stim300", "--speed", 4, "--link", "imu")
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(5)]
    assert "stim300 at 2000 Hz, 4 times real time, on imu" in lines[0]
    assert "imufield capture --port imu" in lines[2]
    assert (lines[2][-2:], lines[3]) == ("\\\n", "    --clock-speed 4\n")
    assert lines[4] == "it begins when a program opens the port; Ctrl-C ends it\n"
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 130
    assert not (program.folder / "imu").is_symlink()


@pytest.fixture
def lines_of_numbers() -> Iterator[str]:
    """A table with six stills of 8 s at 50 Hz."""
    rng = np.random.default_rng(1)
    rows = ["time,ax,ay,az"]
    number = 0
    for axis in range(3):
        for sign in (1, -1):
            for _ in range(400):
                force = rng.normal(0, 0.005, 3)
                force[axis] += sign * 9.81
                rows.append(f"{number / 50:.2f}," + ",".join(f"{value:.5f}" for value in force))
                number += 1
            for _ in range(50):
                rows.append(f"{number / 50:.2f}," + ",".join(f"{value:.5f}" for value in rng.normal(0, 6, 3)))
                number += 1
    return iter(rows)


def test_a_table_becomes_a_session_and_what_was_assumed_is_said(program: Program, lines_of_numbers: Iterator[str]) -> None:
    (program.folder / "log.csv").write_text("\n".join(lines_of_numbers))
    imported = program.run("import", "log.csv", "--set", "accelerometer_unit=m/s^2")
    assert imported.returncode == 0, imported.stderr
    assert imported.stdout.splitlines()[-1].startswith("next:  imufield solve imufield-sessions/")
    content = document(program, "--gravity", 9.81)
    assert len(content["position"]) == 6
    assert np.abs(np.array(content["accelerometer"]["bias_m_s2"])).max() < 0.01
    assert "gyroscope" not in content


def shown_in_readme(session: Session) -> bool:
    """Whether README shows the parameters of this session."""
    found = tomllib.loads((session.folder / "parameters.toml").read_text())["accelerometer"]
    readme = (PROJECT / "README.md").read_text(encoding="utf-8")
    shown = tomllib.loads(re.findall("```toml\n(format.*?)```", readme, re.DOTALL)[0])["accelerometer"]
    return all(
        (found[key], found["uncertainty"][key])
        == (pytest.approx(shown[key], rel=1e-6), pytest.approx(shown["uncertainty"][key], rel=1e-6))
        for key in ("scale", "bias_m_s2")
    )


def run_demo(program: Program, monkeypatch: pytest.MonkeyPatch, speed: int, at_start: Sequence[Sequence[object]] = ()) -> int:
    """Run a demo here, and its instrument in a fork instead of an interpreter of its own; return the exit code."""

    def start(command: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        assert command[:4] == [sys.executable, "-P", "-m", "imufield"]
        assert options.pop("text")
        program.start(*command[4:], at_start=at_start, **options)
        return program.started.pop()  # The demo ends it.

    with monkeypatch.context() as patch:
        patch.chdir(program.folder)
        patch.setattr(emulated, "subprocess", SimpleNamespace(**(vars(subprocess) | {"Popen": start})))
        return run(["demo", "--plain", "--speed", str(speed)])


def test_demo(program: Program, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for speed in (4, 2):
        code = run_demo(program, monkeypatch, speed)
        told = capsys.readouterr()
        # A machine busy beyond its strength says that the speed is too high, or starves the port, which ends a hold early.
        if code == 0 and shown_in_readme(Session.newest(program.folder / "imufield-sessions")):
            break
    else:
        pytest.fail(f"README does not show the demo's parameters: {told.out}{told.err}")
    site = Site()
    assert says(told.out, "commands", "demo.site", latitude_deg=site.latitude_deg, gravity_m_s2=site.gravity_m_s2)
    largest = float(re.findall(r"largest difference (\S+) sigma", " ".join(told.out.split()))[0])
    counts = {"accepted": 24, "planned": 24, "seed": VIRTUAL_SEED}
    assert says(told.out, "commands", "demo.passed", limit=4.0, largest=largest, **counts)
    assert largest <= 4.0
    readme = (PROJECT / "README.md").read_text(encoding="utf-8")
    verdict = re.findall("```text\n(Accelerometer.*?)```", readme, re.DOTALL)[0]
    assert not missing(told.out, *(" ".join(line.split()) for line in verdict.splitlines()))


def test_a_demo_that_is_faster_than_the_machine_says_so(
    program: Program, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The fastest there is: the emulator falls behind (2), or the capture, and then the emulator ends before it (3).
    assert run_demo(program, monkeypatch, 1000, [("tell_slowness_within_a_second",)]) in {2, 3}
    assert not missing(capsys.readouterr().err, "--speed", "smaller")


def test_a_demo_whose_instrument_ends_does_not_wait_for_it(
    program: Program, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # At no more than real time: a busy machine would be told that it is too slow.
    monkeypatch.setattr(emulated, "LONGEST_S", 8.0)
    with refused(LinkError, key="emulated.ended"):
        demo.run_demo(DemoOptions(speed=1.0, plain=True, root=program.folder))
    # Its session cannot go on.
    told = capsys.readouterr().out
    assert not missing(told, "imufield demo")
    assert "--resume" not in told


def test_the_instrument_of_a_demo_has_a_name_that_goes_with_it(tmp_path: Path) -> None:
    with emulated.emulator(DemoOptions(), tmp_path / "truth.json") as (port, _):
        assert Path(port).is_symlink()
    # The number of its terminal is another's by then.
    assert not Path(port).is_symlink()


def test_an_emulated_instrument_says_that_it_is_slow(program: Program) -> None:
    process = program.start("emulate", "stim300", "--json", "--wait")
    assert process.stdout is not None
    port = json.loads(process.stdout.readline())["port"]
    # Opened and never read: what it sends is lost, as by a reader that is too slow.
    descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        event = json.loads(process.stdout.readline())
    finally:
        os.close(descriptor)
    assert (event["event"], event["speed"]) == ("slow", 1.0)
    assert 0 <= event["reached"] < 0.5


def test_an_emulated_operator_begins_again_and_ends_where_he_began() -> None:
    options = EmulateOptions(
        driver="stim300", rate_hz=None, speed=1.0, grade="tactical", seed=1, positions="paper24", hold_s=14.0, link=None,
        truth=None, duration_s=None, faults=[], wait=False, style="placed", as_json=False, rounds=3,
    )  # fmt: skip
    shown = np.asarray(make_emulation(options).directions)
    planned = scheme("paper24").directions()
    np.testing.assert_array_equal(shown, np.concatenate([planned, planned, planned, planned[:1]]))
