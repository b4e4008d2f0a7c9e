"""Recorded sessions and ramps, solved over temperature as they come."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.deliver.parameters.file import Parameters, load, write_document
from imufield.errors import CalibrationError, ParameterFileError, Reason
from imufield.guide.positions import scheme
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.solving import lost_by_replacing, solve_session
from imufield.pipeline.temperature import read_ramp, with_temperature
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.imu import ImuSettings
from imufield.simulate.truth.operator import OperatorSettings
from tests.pipeline.test_over_temperature import solved
from tests.refused import refused
from tests.told import told

pytestmark = pytest.mark.numerical


@pytest.fixture(scope="module")
def sessions() -> tuple[Parameters, ...]:
    return solved(-18.0), solved(20.0), solved(55.0)


def import_table(folder: Path, name: str, table: np.ndarray, head: str = "time_s,ax,ay,az,gx,gy,gz,temperature_degc") -> Path:
    np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=head, comments="", fmt="%.9g")
    assert run(["import", str(folder / f"{name}.csv"), "-o", str(folder / name), "--latitude", "48", "--height", "500"]) == 0
    return folder / name


def recorded(folder: Path, temperature_degc: float) -> Path:
    """Return an imported session of one simulated instrument, 24 positions at a temperature."""
    options = Emulation(
        device="text",
        rate_hz=50.0,
        grade="industrial",
        directions=scheme("paper24").directions(),
        operator=OperatorSettings(hold_s=5.5, initial_still_s=6.0, begins_in_first_position=True),
        imu=ImuSettings(temperature_degc=temperature_degc),
    )
    source = make_virtual_imu(options)
    samples = source.next_block(int((source.operator.plan_all() + 2) / source.interval_s))
    columns = (samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc)
    return import_table(folder, f"at{temperature_degc:g}", np.column_stack(columns))


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Return a session at 25 degC, one at 0 degC, and a ramp; copy what is solved."""
    folder = tmp_path_factory.mktemp("recorded")
    return recorded(folder, 25.0), recorded(folder, 0.0), warming_up(folder)


def warming_up(folder: Path) -> Path:
    """Return an imported recording of one pose over 30 degC and back."""
    time_s = np.arange(0.0, 4000.0, 2.0)
    at_degc = 10 + 30 * (1 - np.abs(time_s / 2000 - 1))
    outputs = np.array([0.1, 0.2, 9.8, 0, 0, 0]) + np.outer(at_degc, [1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])
    noise = 1e-4 * np.random.default_rng(3).normal(size=(len(time_s), 6))
    return import_table(folder, "warm-up", np.column_stack([time_s, outputs + noise, at_degc]))


def test_a_ramp_alone_is_refused_as_what_it_is(folders: tuple[Path, Path, Path]) -> None:
    with refused(CalibrationError, Reason.TOO_FEW, f"--temperature {folders[2]}", key="solving.one_pose"):
        solve_session(Session.open(folders[2]), SolveSettings())


def test_a_rest_alone_is_refused_with_what_it_is_good_for(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 400.0, 0.01)
    outputs = np.array([0.1, 0.2, 9.8, 0, 0, 0]) + 1e-3 * np.random.default_rng(4).normal(size=(len(time_s), 6))
    rest = import_table(tmp_path, "rest", np.column_stack([time_s, outputs, np.full(len(time_s), 20.0)]))
    with refused(CalibrationError, Reason.TOO_FEW, f"imufield noise {rest}", "imufield verify", key="solving.one_rest"):
        solve_session(Session.open(rest), SolveSettings())


def test_a_file_over_temperature_is_not_replaced_without_a_word(
    sessions: tuple[Parameters, ...], folders: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = shutil.copytree(folders[0], tmp_path / "at25")
    path, joint = session / "parameters.toml", with_temperature(sessions[1], sessions, [])
    write_document(path, joint.document)
    (lost,) = told(lost_by_replacing(path, sessions[1]), "solving.lost_temperature")
    assert (lost.values["low"], lost.values["high"]) == (-18.0, 55.0)
    assert not lost_by_replacing(path, joint)
    capsys.readouterr()
    # One session, as the workbench solves it, and several.
    assert run(["solve", "--json", str(session)]) == 0
    assert "--temperature 'at -18'" in json.loads(capsys.readouterr().out)["notes"][-1]
    assert not load(path).temperature_models
    write_document(path, joint.document)
    capsys.readouterr()
    assert run(["solve", "--json", "--workers", "1", str(session), str(shutil.copytree(folders[1], tmp_path / "at0"))]) == 0
    solved = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "--temperature 'at -18'" in solved[0]["notes"][-1]
    assert not solved[1]["notes"]


def test_solve_takes_sessions_and_ramps_as_they_come(
    folders: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (base, cold, warm_up), output = folders, tmp_path / "parameters.toml"
    # Each of them twice, under another name.
    copies = [shutil.copytree(session, tmp_path / f"{session.name}-copy") for session in (base, cold, warm_up)]
    given = [word for session in (cold, warm_up, *copies) for word in ("--temperature", str(session))]
    capsys.readouterr()
    assert run(["solve", str(base), *given, "-o", str(output)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    joint = load(output)
    # Said once, though it is no word of the first session.
    assert all(shown.count(reason) == 1 for reason in joint.calibration.quality.reasons if "polynomial" in reason)
    reasons = joint.calibration.quality.reasons
    assert all(
        any(f"{copy.name} " in reason and session.name in reason for reason in reasons)
        for session, copy in zip((base, cold, warm_up), copies, strict=True)
    )
    assert [source.kind for source in joint.context.temperature_sources] == ["session", "session", "ramp"]
    accelerometer, gyroscope = joint.temperature_models
    assert accelerometer.scale_separated
    # At rest the ramp shows the gyroscope's bias alone, and it is most of what is known of it.
    assert gyroscope.bias.order >= 1
    change = gyroscope.bias.at(np.array([10.0])) - gyroscope.bias.at(np.array([0.0]))
    np.testing.assert_allclose(change, 1e-4, atol=5e-5)
    means = read_ramp(Session.open(warm_up), joint)
    assert 399 <= len(means.time_s) <= 401
    np.testing.assert_allclose(means.accelerometer[:, 0], 0.1 + 1e-3 * means.temperature_degc, atol=3e-4)
    assert run(["solve", str(base), str(cold), "--temperature", str(warm_up)]) == 2


def test_a_ramp_without_accelerometer_shows_the_gyroscope(
    sessions: tuple[Parameters, ...], folders: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    base, _, warm_up = folders
    table = np.loadtxt(warm_up.parent / "warm-up.csv", delimiter=",", skiprows=1)[:, [0, 4, 5, 6, 7]]
    # Of another day: its noise is its own. It only rises.
    table[:, 1:4] += 1e-4 * np.random.default_rng(9).normal(size=(len(table), 3))
    folder = import_table(tmp_path, "rates", table[: len(table) // 2], "time_s,gx,gy,gz,temperature_degc")
    output = tmp_path / "parameters.toml"
    assert run(["solve", str(base), "--temperature", str(warm_up), "--temperature", str(folder), "-o", str(output)]) == 0
    joint = load(output)
    assert [source.name for source in joint.context.temperature_sources] == ["warm-up", "rates"]
    change = joint.temperature_models[1].bias.at(np.array([10.0])) - joint.temperature_models[1].bias.at(np.array([0.0]))
    np.testing.assert_allclose(change, 1e-4, atol=5e-5)
    rates = replace(read_ramp(Session.open(folder), joint), remarks=("cut short",))
    assert np.isnan(rates.accelerometer).all()
    reasons = with_temperature(joint, [], [read_ramp(Session.open(warm_up), joint), rates]).calibration.quality.reasons
    assert "cut short" in reasons
    assert [words.values["name"] for words in told(reasons, "ramp.one_way")] == ["rates"]
    counts = replace(joint, document=joint.document | {"gyroscope": joint.document["gyroscope"] | {"raw_unit": "count"}})
    with refused(ParameterFileError, Reason.UNITS, "gyroscope", key="file.unit"):
        read_ramp(Session.open(warm_up), counts)
    assert joint.calibration.gyroscope is not None
    of_counts = replace(joint.calibration.gyroscope, raw_unit="count")
    other = replace(joint, calibration=replace(joint.calibration, gyroscope=of_counts))
    with refused(CalibrationError, Reason.UNITS, "gyroscope", key="temperature.differs"):
        with_temperature(joint, [joint, other], [])
    # Alone it does not show the accelerometer, and an instrument without gyroscope has no use for it.
    with refused(CalibrationError, Reason.TOO_FEW, key="fit.too_few"):
        with_temperature(joint, [], [rates])
    with refused(CalibrationError, Reason.NOT_FINITE, "rates", key="temperature.no_output"):
        with_temperature(sessions[1], sessions, [rates])
