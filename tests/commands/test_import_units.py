"""Units that nobody stated, by the stills of a table or a dump: what ``import`` takes, says, and is solved to."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.commands.import_files import import_session
from imufield.commands.options.acquire_commands import ImportOptions
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.solving import solve_session
from imufield.pipeline.table_samples import table_samples
from imufield.samples import FloatArray
from imufield.simulate.truth.grades import TrueInstrument, draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu
from tests.commands.told import fails, missing
from tests.refused import refused
from tests.told import key_of, told

G = 9.80665
RATE_HZ = 50.0
OFFSET_G = (0.3, -0.42, 0.49)


def truth() -> TrueInstrument:
    """Return a MEMS instrument with a large offset."""
    drawn = draw_truth(find_grade("mems"), np.random.default_rng(7))
    return replace(drawn, accelerometer=replace(drawn.accelerometer, bias_m_s2=G * np.array(OFFSET_G)))


@cache
def recorded() -> tuple[FloatArray, Operator]:
    """Return time, accelerometer in m/s^2 and gyroscope in rad/s, and the person, who turns no faster than 50 deg/s."""
    habits = OperatorSettings(hold_s=4.0, initial_still_s=5.0, turn_s=(2.0, 3.0), peak_rate_rad_s=np.radians(50))
    ups = np.random.default_rng(7).standard_normal((16, 3))
    person = Operator(ups, 7, habits)
    samples = VirtualImu(Imu(truth(), 7, ImuSettings(rate_hz=RATE_HZ)), person).next_block(int(130 * RATE_HZ))
    return np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope]), person


def table(
    folder: Path, accelerometer: float = 1.0, gyroscope: float = 1.0, *, header: str = "", count: int | None = None
) -> Path:
    path = folder / "table.csv"
    scale = np.repeat([1.0, accelerometer, gyroscope], [1, 3, 3])
    np.savetxt(path, recorded()[0] * scale, delimiter=",", fmt="%.9g", header=header, comments="")
    return path


def imported(path: Path, **settings: str) -> tuple[Session, list[str]]:
    """Import a table; return the session and what was assumed, behind what was read."""
    session, said = import_session(ImportOptions(files=[path], output=path.parent / "session", settings=settings))
    first, *assumed = [key_of(one) for one in said]
    assert first == "import_files.imported"
    return session, assumed


@pytest.mark.parametrize(
    ("accelerometer", "gyroscope", "units"),
    [
        pytest.param(1.0, 1.0, ("m/s^2", "rad/s"), id="SI"),
        # Its norms, of 0.3 to 1.7 g, are neither m/s^2 nor g, and its rates are those of a fast hand in rad/s.
        pytest.param(1 / G, np.degrees(1.0), ("g", "deg/s"), id="g and deg/s"),
        pytest.param(1.0, np.degrees(1.0) / 8, ("m/s^2", "count"), id="a range that is set wrong"),
        pytest.param(1000.0, 938.7, ("count", "count"), id="raw numbers"),
    ],
)
def test_units_that_nobody_stated(tmp_path: Path, accelerometer: float, gyroscope: float, units: tuple[str, str]) -> None:
    session, said = imported(table(tmp_path, accelerometer, gyroscope))
    chosen = tuple(session.record.setting_values[f"{triad}_unit"] for triad in ("accelerometer", "gyroscope"))
    assert chosen == units
    for triad, unit in zip(("accelerometer", "gyroscope"), units, strict=True):
        assert f"still_scales.{triad}" + ("_count" if unit == "count" else "") in said
    assert not [key for key in said if key.startswith("table_columns.") and "_by_" in key]
    # Who corrects the table without an import is told the same.
    assumed: list[str] = []
    blocks = list(table_samples(tmp_path / "table.csv", None, assumed))
    assert [key_of(one) for one in assumed] == said
    assert blocks[0].units.gyroscope == ("count" if units[1] == "count" else "rad/s")
    solved = solve_session(session, SolveSettings(), SiteOptions(gravity_m_s2=G)).calibration
    nominal = {"m/s^2": accelerometer, "g": accelerometer * G, "count": accelerometer}[units[0]]
    assert np.abs(solved.accelerometer.bias_m_s2 / G - OFFSET_G).max() < 2e-3
    assert np.abs(solved.accelerometer.scale / nominal / truth().accelerometer.scale - 1).max() < 2e-3
    assert solved.gyroscope is not None
    nominal = gyroscope if units[1] == "count" else 1.0
    assert np.abs(solved.gyroscope.parameters.scale / nominal / truth().gyroscope.scale - 1).max() < 5e-3


@pytest.mark.parametrize("stated", [{}, {"accelerometer_unit": "count"}])
def test_small_fractions_in_which_stills_show_gravity_are_solved_next(tmp_path: Path, stated: dict[str, str]) -> None:
    options = ImportOptions(files=[table(tmp_path, 0.15 / G)], output=tmp_path / "session", settings=stated)
    session, said = import_session(options)
    assert "tables.no_gravity" not in map(key_of, said)
    assert session.record.setting_values["accelerometer_unit"] == "count"


def test_the_common_scale_is_said(tmp_path: Path) -> None:
    _, said = import_session(ImportOptions(files=[table(tmp_path, gyroscope=1.07)], output=tmp_path / "session"))
    (words,) = (one for one in said if key_of(one) == "still_scales.gyroscope")
    assert words.values["ratio"] == pytest.approx(1.07, rel=0.02)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("stated", "is_next"), [("m/s^2", True), ("g", False)])
def test_what_cannot_be_solved_is_not_the_next_step(
    tmp_path: Path, stated: str, is_next: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    setting = f"accelerometer_unit={stated}"
    assert run(["import", str(table(tmp_path)), "-o", str(tmp_path / "session"), "--set", setting]) == 0
    assert ("imufield solve" in capsys.readouterr().out) == is_next


def test_a_stated_unit_that_the_stills_contradict_is_kept_and_told(tmp_path: Path) -> None:
    header = "time_s,ax (m/s^2),ay (m/s^2),az (m/s^2),gx (rad/s),gy (rad/s),gz (rad/s)"
    session, said = imported(table(tmp_path, 1 / G, np.degrees(1.0), header=header))
    assert session.record.setting_values["gyroscope_unit"] == "rad/s"
    assert said == ["still_scales.other_accelerometer", "still_scales.other_gyroscope"]


@pytest.mark.parametrize(
    ("accelerometer", "stated", "key", "right"),
    [
        (1 / G, "m/s^2", "still_scales.other_accelerometer", "g"),
        (1000 / G, "g", "still_scales.other_accelerometer", "mg"),
        (1 / G, "mg", "still_scales.other_accelerometer", "g"),
        (0.612 / G, "g", "still_scales.no_accelerometer_unit", ""),
    ],
)
def test_only_a_unit_that_fits_is_named(tmp_path: Path, accelerometer: float, stated: str, key: str, right: str) -> None:
    options = ImportOptions(
        files=[table(tmp_path, accelerometer)], output=tmp_path / "session", settings={"accelerometer_unit": stated}
    )
    _, said = import_session(options)
    (words,) = (one for one in said if key_of(one) == key)
    assert words.values["right"] == right  # type: ignore[attr-defined]
    assert words.values["stated"] == stated  # type: ignore[attr-defined]
    assert "tables.no_gravity" not in map(key_of, said)


def test_an_import_in_a_wrong_unit_is_not_sent_to_a_driver(tmp_path: Path) -> None:
    session, _ = imported(table(tmp_path, 1 / G), accelerometer_unit="m/s^2")
    with refused(
        CalibrationError, Reason.TOO_FEW, "accelerometer_unit=g --replace --output", str(session.folder), key="solving.too_few"
    ):
        solve_session(session, SolveSettings(), SiteOptions(gravity_m_s2=G))


def test_a_unit_that_is_none_is_refused_with_all_that_are_taken(tmp_path: Path) -> None:
    with refused(UsageError, Reason.UNITS, "'gs'", "mg", key="table_columns.unknown_unit"):
        imported(table(tmp_path, 1 / G), accelerometer_unit="gs")


def test_a_setting_that_is_none_is_refused_with_all_that_are_taken(tmp_path: Path) -> None:
    with refused(UsageError, Reason.UNKNOWN_KEY, "gyroscope_unit", "time_unit", key="settings.unknown"):
        imported(table(tmp_path), gyro_unit="deg/s")


def test_a_stated_unit_that_is_right_needs_no_word(tmp_path: Path) -> None:
    _, said = imported(table(tmp_path, 1 / G), accelerometer_unit="g", gyroscope_unit="rad/s")
    assert not [key for key in said if key.startswith("still_scales.")]


@pytest.mark.parametrize(("fastest", "unit"), [(51.83, "deg/s"), (5.2, "rad/s")])
def test_without_stills_to_decide_by_a_size_is_said_in_deg_s(tmp_path: Path, fastest: float, unit: str) -> None:
    """51.83 rad/s would be 2970 deg/s."""
    time = np.arange(2000) / 100
    rate = fastest * 1.001 * np.sin(2 * np.pi * time[:, None] * [0.5, 0.7, 1.1])
    force = np.random.default_rng(0).normal([0, 0, G], 0.5, (2000, 3))
    path = tmp_path / "moving.csv"
    np.savetxt(path, np.column_stack([time, force, rate]), delimiter=",")
    session, said = import_session(ImportOptions(files=[path], output=tmp_path / "session"))
    assert session.record.setting_values["gyroscope_unit"] == unit
    (words,) = (one for one in said if key_of(one) in ("table_columns.deg_by_fastest", "table_columns.rad_by_fastest"))
    assert words.values["found_deg"] == pytest.approx(np.degrees(fastest), rel=0.01)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("gravity", "unit"), [(1.1, "deg/s"), (G, "rad/s")])
def test_at_rest_the_unit_of_the_accelerometer_decides(tmp_path: Path, gravity: float, unit: str) -> None:
    rest = np.random.default_rng(0).normal([0, 0, gravity, 2.1, -1.4, 0.6], [*[0.003] * 3, *[0.1] * 3], (3000, 6))
    path = tmp_path / "rest.csv"
    np.savetxt(path, np.column_stack([np.arange(3000) / 100, rest]), delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="")
    session, _ = import_session(ImportOptions(files=[path], output=tmp_path / "session"))
    assert session.record.setting_values["gyroscope_unit"] == unit


@pytest.mark.parametrize(
    ("setting", "unit", "key"),
    [({}, "deg/s", "still_scales.gyroscope"), ({"gyroscope_unit": "rad/s"}, "rad/s", "still_scales.other_gyroscope")],
    ids=["assumed", "stated"],
)
def test_lines_of_an_unknown_logger(tmp_path: Path, setting: dict[str, str], unit: str, key: str) -> None:
    path = table(tmp_path, gyroscope=np.degrees(1.0))
    options = ImportOptions(files=[path], driver="text", output=tmp_path / "session", settings=setting)
    session, said = import_session(options)
    assert session.record.setting_values["gyroscope_unit"] == unit
    assert key in map(key_of, said)


def test_a_wrong_unit_of_the_gyroscope_is_told_by_solve_with_its_factor(tmp_path: Path) -> None:
    """Rates that are too small leave the accelerometer; in those too large no noise is that of a unit at rest."""
    session, _ = imported(table(tmp_path), gyroscope_unit="deg/s")
    quality = solve_session(session, SolveSettings(), SiteOptions(gravity_m_s2=G)).calibration.quality
    assert quality.verdict == "usable"
    (words,) = told(quality.reasons, "refusals.scale_differs")
    assert words.values["ratio"] == pytest.approx(57.3, rel=0.03)
    path = table(tmp_path, gyroscope=np.degrees(1.0))
    session, _ = import_session(ImportOptions(files=[path], output=tmp_path / "large", settings={"gyroscope_unit": "rad/s"}))
    with refused(CalibrationError, Reason.UNITS, key="refusals.scale_differs") as caught:
        solve_session(session, SolveSettings(), SiteOptions(gravity_m_s2=G))
    assert "deg/s taken for rad/s" in caught.value.message


def test_without_a_gyroscope_nobody_is_told_of_its_turns(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    np.savetxt(path, recorded()[0][:, :4], delimiter=",", fmt="%.9g")
    session, _ = imported(path)
    reasons = solve_session(session, SolveSettings(), SiteOptions(gravity_m_s2=G)).calibration.quality.reasons
    assert told(reasons, "quality.assumed_signs")
    assert not told(reasons, "axes.few_moves")


def test_what_was_refused_stands_in_the_verdict(tmp_path: Path) -> None:
    """One still of twice its length, which no offset explains."""
    path, values = tmp_path / "table.csv", recorded()[0].copy()
    still = recorded()[1].stills[5]
    values[(values[:, 0] > still.start_s - 1) & (values[:, 0] < still.end_s + 1), 1:4] *= 2.0
    np.savetxt(path, values, delimiter=",", fmt="%.9g")
    session, _ = imported(path)
    solved = solve_session(session, SolveSettings(), SiteOptions(gravity_m_s2=G))
    (told,) = (reason for reason in solved.calibration.quality.reasons if "2.45 m/s^2" in reason)
    assert not missing(told, "1 still interval")
    assert still.start_s < float(re.findall(r"at ([\d.]+) s", told)[0]) < still.end_s


def test_positions_of_an_accelerometer_alone_are_verified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savetxt(tmp_path / "alone.csv", recorded()[0][:, :4], delimiter=",", header="time_s,ax,ay,az", comments="")
    session = tmp_path / "session"
    assert run(["import", str(tmp_path / "alone.csv"), "-o", str(session)]) == 0
    assert run(["solve", str(session), "--latitude", "45", "--height", "0"]) == 0
    assert run(["verify", str(session), "--latitude", "45", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert len(found["positions"]["name"]) > 12
    assert run(["verify", str(session), "--latitude", "45", "--require", "residual-ug=5000"]) == 0
    fails(["verify", str(session), "--latitude", "45", "--require", "nav-nmi-per-h=1"], 5, Reason.UNITS, "gyroscope")


@pytest.mark.parametrize("counts", [False, True])
def test_triads_in_each_other_s_place_are_refused(tmp_path: Path, *, counts: bool) -> None:
    values = recorded()[0] * np.repeat([1.0, 1000 / G, 50.0], [1, 3, 3]) if counts else recorded()[0]
    values = np.rint(values * [100.0, *[1.0] * 6]) / [100.0, *[1.0] * 6] if counts else values
    files = [tmp_path / "first.txt", tmp_path / "second.txt"]
    for path, columns in zip(files, ([0, 4, 5, 6], [0, 1, 2, 3]), strict=True):
        np.savetxt(path, values[:, columns])
    with refused(UsageError, Reason.USAGE, "--columns", key="still_units.swapped"):
        import_session(ImportOptions(files=files, output=tmp_path / "swapped"))
    assert not (tmp_path / "swapped").exists()
    session, _ = import_session(ImportOptions(files=files[::-1], output=tmp_path / "right"))
    assert len(session.parts) == 1
