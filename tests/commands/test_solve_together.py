"""``imufield solve --together``: one file from several sessions of one instrument, and what cannot be joined."""

from __future__ import annotations

import json
import shutil
import tomllib
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from imufield.acquire.recording import recorder
from imufield.acquire.recording.session import Session
from imufield.acquire.recording.session_record import InstrumentRecord
from imufield.calibrate.model.budget import combined_sigma
from imufield.cli.run import run
from imufield.commands import solve_together
from imufield.commands.certificate import run_certificate
from imufield.commands.options.result_commands import CertificateOptions, HistoryOptions, SolveOptions, VerifyOptions
from imufield.commands.solve import run_solve
from imufield.commands.verify import run_verify
from imufield.deliver.history import read_history
from imufield.deliver.parameters.file import Parameters, load
from imufield.deliver.parameters.gauge_free import GaugeFree
from imufield.deliver.report.budget import not_in_budget
from imufield.earth import MILLI_G_M_S2
from imufield.errors import CalibrationError, ParameterFileError, Reason, UsageError
from imufield.pipeline import together
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.chain import session_samples
from imufield.pipeline.same_recording import RecordingMarks
from imufield.pipeline.solving import solve_session
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from tests.commands.conftest import made_once, simulated_session
from tests.refused import refused
from tests.told import key_of

SERIAL = "N1"
VISITS = 14
"""Of 24 positions: enough for the linear model."""


@dataclass(frozen=True)
class Days:
    """Three sessions of one instrument, and the file they gave together."""

    folders: list[Path]
    file: Path
    parameters: Parameters


@pytest.fixture(scope="session")
def days(tmp_path_factory: pytest.TempPathFactory) -> Days:
    def make(folder: Path) -> None:
        sessions = [folder / f"day{day}" for day in range(3)]
        with pytest.MonkeyPatch.context() as patch:
            # Small ones: how long a block is else hangs on how fast this machine is, and so does what is lost with the last.
            patch.setattr(recorder, "BLOCK_BYTES", 1 << 15)
            for day, session in enumerate(sessions):
                visits = VISITS if day < 2 else 22
                simulated_session(session, visits=visits, day=day, serial_number=SERIAL if day else "")
        # Two or three positions.
        part = sessions[2] / "part-001.mcap"
        part.write_bytes(part.read_bytes()[: part.stat().st_size * 9 // 10])
        assert (
            run(
                [
                    "solve",
                    *map(str, sessions),
                    "--together",
                    "--model",
                    "linear",
                    "--workers",
                    "1",
                    "-o",
                    str(folder / "joint.toml"),
                ]
            )
            == 0
        )

    root = made_once(tmp_path_factory, "together", make)
    return Days([root / f"day{day}" for day in range(3)], root / "joint.toml", load(root / "joint.toml"))


def marks(folder: Path, first: float = 0.0, last: float = 1.0) -> RecordingMarks:
    """Return the marks of a part of a session, from a share of its blocks to another."""
    found, blocks = RecordingMarks(), [*session_samples(Session.open(folder), [])]
    for samples in blocks[int(first * len(blocks)) : int(last * len(blocks))]:
        found.feed(samples)
    return found


def test_the_file_says_from_what_it_is(days: Days) -> None:
    together = days.parameters.context.together
    assert together is not None
    assert [session.name for session in together.session] == ["day0", "day1", "day2"]
    assert [session.positions for session in together.session][:2] == [VISITS, VISITS]
    assert [kind.kind for kind in together.repeatability][:2] == ["accelerometer.bias_m_s2", "accelerometer.scale"]
    assert all(kind.low <= kind.sigma <= kind.high and kind.degrees_of_freedom == 6 for kind in together.repeatability)
    assert together.prior_grade == "tactical"
    assert days.parameters.context.instrument.serial_number == SERIAL
    keys = {getattr(reason, "key", None) for reason in days.parameters.calibration.quality.reasons}
    assert keys == {None}  # what a file holds is text


def test_only_other_recordings_are_asked_for_a_serial_number(days: Days) -> None:
    parameters, without = days.parameters, InstrumentRecord()
    assert parameters.context.together is not None
    for session in parameters.context.together.session:
        assert not parameters.instrument_note(without, partial(str, session.sha256))
    assert key_of(parameters.instrument_note(without, lambda: "another")) == "file.no_serial_number"


def test_damage_and_missing_positions_of_a_session_come_along(days: Days) -> None:
    reasons = days.parameters.calibration.quality.reasons
    assert all(any(reason.startswith(f"day{day}: ") and "x+270" in reason for reason in reasons) for day in range(3))
    assert any(reason.startswith("day2: ") and "part-001.mcap" in reason for reason in reasons)
    assert any("day0" in reason and "day1" not in reason and "serial" in reason for reason in reasons)


def test_parameters_of_a_new_day_are_the_instrument_s(days: Days) -> None:
    truth = make_virtual_imu(Emulation(seed=3)).imu.instrument.accelerometer
    calibration = days.parameters.calibration
    off = np.abs(calibration.accelerometer.scale / truth.scale - 1)
    assert np.all(off < 4 * calibration.accelerometer_sigma.scale)
    assert calibration.gauge == "lower"
    names = calibration.covariance_names
    assert {"accelerometer.misalignment_rad.yx", "gyroscope.scale.z", "gravity_m_s2"} <= set(names)
    assert "accelerometer.misalignment_rad.xy" not in names
    together = days.parameters.context.together
    assert together is not None
    bias = together.repeatability[0]
    assert np.all(np.array(bias.day_sigma) > bias.mean_sigma)
    assert np.all(calibration.accelerometer_sigma.bias_m_s2 >= 0.99 * np.array(bias.day_sigma))


def test_the_budget_of_a_new_day_is_its_covariance(days: Days) -> None:
    calibration = days.parameters.calibration
    assert combined_sigma(calibration.budget) ** 2 == pytest.approx(np.diag(calibration.covariance), rel=1e-9, abs=1e-24)
    assert [share.name for share in calibration.budget] == ["sessions", "gravity", "day_to_day", "no_session_shows"]
    assert [told.key for told in not_in_budget(days.parameters)] == ["budget.no_temperature"]


def test_a_certificate_states_the_repeatability_and_every_session(days: Days, tmp_path: Path) -> None:
    run_certificate(CertificateOptions(source=days.file, output=tmp_path))
    document = json.loads((tmp_path / "certificate.json").read_text(encoding="utf-8"))
    bias = next(parameter for parameter in document["budget"] if parameter["name"] == "accelerometer.bias_m_s2.x")
    shares = {share["name"]: share["contribution"] for share in bias["share"]}
    together = days.parameters.context.together
    assert together is not None
    kind = next(kind for kind in together.repeatability if kind.kind == "accelerometer.bias_m_s2")
    # What a new day is less sure than the mean; along the sensing axis, which the body axis is near.
    by_days = np.sqrt(kind.day_sigma[0] ** 2 - kind.mean_sigma[0] ** 2)
    assert shares["day_to_day"] == pytest.approx(by_days, rel=1e-3)
    assert bias["coverage_factor"] == pytest.approx(1.96, abs=1e-3)
    assert [name for name, _ in document["identification"]].count("Session") == 3


def test_a_history_holds_the_sessions_and_not_what_was_made_of_them(days: Days, tmp_path: Path) -> None:
    shutil.copy(days.file, tmp_path / "joint.toml")
    with refused(ParameterFileError, Reason.FOREIGN, key="history.none"):
        read_history(HistoryOptions(folder=tmp_path).folder)


def test_a_session_proves_nothing_about_a_file_that_came_from_it(days: Days) -> None:
    with refused(UsageError, Reason.USAGE, "day1", key="verify.one_of_them"):
        run_verify(VerifyOptions(parameters=days.file, session=days.folders[1]))


def test_the_report_has_the_table(days: Days, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert run(["report", "--parameters", str(days.file), "-o", str(page), "--record", str(tmp_path / "record.html")]) == 0
    text = page.read_text(encoding="utf-8")
    together = days.parameters.context.together
    assert together is not None
    assert all(session.sha256[:16] in text for session in together.session)
    assert "3 sessions together" in text


def test_a_copy_is_known_however_it_was_cut(days: Days) -> None:
    first, second = marks(days.folders[0]), marks(days.folders[1])
    assert not first.same_as(second)
    assert marks(days.folders[0], 0.3, 0.6).same_as(first)
    assert not marks(days.folders[0], 0.0, 0.4).same_as(marks(days.folders[0], 0.5, 1.0))


def test_a_copy_is_no_further_day(days: Days, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy, file = tmp_path / "copy", tmp_path / "o.toml"
    shutil.copytree(days.folders[0], copy)
    # Damaged behind its last block, so that its hash is another.
    with (copy / "part-001.mcap").open("ab") as part:
        part.write(bytes(100))
    sessions = [*days.folders[:2], copy]
    assert run_solve(SolveOptions(sessions=sessions, together=True, model="linear", output=file, workers=2, as_json=True)) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {session["name"] for session in printed["together"]["session"]} == {"day0", "day1"}
    assert any("copy" in reason and "day0" in reason for reason in printed["quality"]["reasons"])
    assert printed["quality"]["verdict"] == load(file).calibration.quality.verdict


def test_few_sessions_say_why_a_new_day_is_less_known_than_one(days: Days, capsys: pytest.CaptureFixture[str]) -> None:
    context = days.parameters.context
    assert context.together is not None
    bias = next(each for each in context.together.repeatability if each.kind == "accelerometer.bias_m_s2")
    high_mg = f"{bias.high / MILLI_G_M_S2:.2g} mg"
    # Where the sessions are enough to say how days differ, nothing else is counted.
    enough = replace(context, together=replace(context.together, prior_grade=""))
    told = []
    for each in (days.parameters, replace(days.parameters, context=enough)):
        solve_together._print(each)
        told.append(high_mg in " ".join(capsys.readouterr().out.split()))
    assert told == [True, False]


def test_what_made_the_worst_verdict_is_read_first(days: Days, monkeypatch: pytest.MonkeyPatch) -> None:
    verdicts = {"day0": "usable", "day1": "poor"}

    def judged(session: Session, *given: Any) -> Parameters:
        found, verdict = solve_session(session, *given), verdicts[session.name]
        quality = replace(found.calibration.quality, gyroscope_verdict="good", accelerometer_verdict=verdict)
        quality = replace(quality, verdict="good", warnings=()).lowered(verdict, f"it is {verdict}")
        return replace(found, calibration=replace(found.calibration, quality=quality))

    monkeypatch.setattr(together, "solve_session", judged)
    sessions = [Session.open(folder) for folder in days.folders[:2]]
    quality = together.solve_together(sessions, SolveSettings(model="linear"), workers=1).calibration.quality
    assert (quality.verdict, quality.accelerometer_verdict, quality.gyroscope_verdict) == ("poor", "poor", "good")
    assert quality.main_reason == "day1: it is poor"
    assert "day0: it is usable" in quality.warnings


def test_a_position_is_left_out_of_each_session_that_has_it(days: Days, monkeypatch: pytest.MonkeyPatch) -> None:
    solved: dict[str, list[dict[str, Any]]] = {}

    def solve(session: Session, *given: Any) -> Parameters:
        found = solve_session(session, *given)
        solved[session.name] = found.document["position"]
        return found

    monkeypatch.setattr(together, "solve_session", solve)
    sessions = [Session.open(folder) for folder in days.folders]
    together.solve_together(sessions[1:], SolveSettings(model="linear"), workers=1)
    # By name: the sessions are solved in order of their times, which a clock set back meanwhile turns round.
    names = {name: {table["name"] for table in tables} for name, tables in solved.items()}
    only = min(names["day2"] - names["day1"])
    together.solve_together(sessions[1:], SolveSettings(model="linear", without=(only,)), workers=1)
    left_out = {name: [table["name"] for table in tables if not table["used"]] for name, tables in solved.items()}
    assert left_out == {"day1": [], "day2": [only]}
    with refused(UsageError, Reason.USAGE, key="observations.not_there"):
        together.solve_together(sessions[1:], SolveSettings(model="linear", without=("nowhere",)), workers=1)


def test_one_session_is_too_few(days: Days, tmp_path: Path) -> None:
    with refused(CalibrationError, Reason.TOO_FEW, key="together.too_few"):
        run_solve(SolveOptions(sessions=days.folders[:1], together=True, output=tmp_path / "o.toml"))


@pytest.mark.parametrize(
    ("change", "reason", "key"),
    [
        ({"serial_number": "N2"}, Reason.FOREIGN, "together.instruments"),
        ({"serial_number": SERIAL, "range_g": 30}, Reason.UNITS, "together.setting"),
    ],
)
def test_other_instruments_and_ranges_are_refused(
    days: Days, tmp_path: Path, change: dict[str, object], reason: Reason, key: str
) -> None:
    simulated_session(tmp_path / "other", visits=1, **change)  # type: ignore[arg-type]
    with refused(CalibrationError, reason, "day1", "other", key=key):
        run_solve(SolveOptions(sessions=[days.folders[1], tmp_path / "other"], together=True, output=tmp_path / "o.toml"))


@pytest.mark.parametrize(
    ("raw_zero", "refusal"),
    [
        ([0.0] * 6, nullcontext()),
        ([0.01] * 3, refused(CalibrationError, Reason.UNITS, "day0", "day1", key="together.setting")),
    ],
    ids=["said otherwise", "another"],
)
def test_the_raw_zeros_of_sessions_that_are_joined_are_equal(
    days: Days, tmp_path: Path, raw_zero: list[float], refusal: AbstractContextManager[object]
) -> None:
    for folder in days.folders[:2]:
        shutil.copytree(folder, tmp_path / folder.name)
    record = tmp_path / "day1" / "session.toml"
    stated = tomllib.loads(record.read_text(encoding="utf-8"))
    stated["nominal"] = {"raw_zero": raw_zero}
    record.write_text(tomli_w.dumps(stated), encoding="utf-8")
    sessions = [tmp_path / "day0", tmp_path / "day1"]
    with refusal:
        run_solve(SolveOptions(sessions=sessions, together=True, model="linear", output=tmp_path / "o.toml", workers=1))


def test_a_session_without_gyroscope_has_no_zero_of_it(days: Days) -> None:
    alone = replace(days.parameters, calibration=replace(days.parameters.calibration, gyroscope=None))
    sessions, numbers = map(Session.open, days.folders), GaugeFree((), np.empty((0, 0)), np.empty((0, 0)))
    first, other = (
        together.SolvedSession(session, each, numbers, RecordingMarks())
        for session, each in zip(sessions, (days.parameters, alone), strict=False)
    )
    assert (len(first.raw_zero), len(other.raw_zero)) == (6, 3)
    together._check_numbers(first, other)


def test_sessions_are_found_by_serial_number(days: Days) -> None:
    root = days.folders[0].parent
    assert [session.name for session in together.sessions_of(SERIAL, root)] == ["day1", "day2"]
    with refused(UsageError, Reason.USAGE, "N2", key="together.none_of_serial"):
        together.sessions_of("N2", root)


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"serial_number": SERIAL}, "solve_together.serial_alone"),
        ({"together": True, "serial_number": SERIAL, "sessions": [Path("a")]}, "solve_together.both"),
        ({"together": True}, "solve_together.none"),
        ({"together": True, "observations": Path("means.csv")}, "together.option"),
        ({"together": True, "scheduler": "tcp://127.0.0.1:1"}, "together.option"),
        ({"together": True, "temperature": [Path("cold")]}, "together.option"),
    ],
)
def test_options_that_say_nothing_together_are_refused(options: dict[str, object], key: str) -> None:
    with refused(UsageError, Reason.USAGE, key=key):
        run_solve(SolveOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize("settings", [{"model": "extended"}, {"gauge": "upper"}])
def test_settings_of_single_sessions_are_refused(days: Days, tmp_path: Path, settings: dict[str, str]) -> None:
    with refused(UsageError, Reason.USAGE, key="together.option"):
        run_solve(SolveOptions(sessions=days.folders, together=True, output=tmp_path / "o.toml", **settings))  # type: ignore[arg-type]
