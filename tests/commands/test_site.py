"""Gravity as it is typed: its digits, its place, and what a session knows of either."""

from __future__ import annotations

import json
import math
import shutil
import tomllib
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from imufield.acquire.recording.session import Session
from imufield.acquire.recording.session_record import SiteRecord
from imufield.cli.run import run
from imufield.commands.options.result_commands import VerifyOptions
from imufield.commands.verify import _Task
from imufield.dataclass import replace
from imufield.earth import Gravity, choose_gravity, normal_gravity, sigma_as_typed, sigma_of_digits
from imufield.errors import Reason, UsageError
from imufield.pipeline import solving
from imufield.pipeline.site import SiteOptions
from tests.commands.told import fails, failure, missing


def solved(folder: Path, *options: str) -> dict[str, Any]:
    path = folder.parent / "solved.toml"
    path.unlink(missing_ok=True)
    assert run(["solve", str(folder), "-o", str(path), *options]) == 0
    return tomllib.loads(path.read_text())


def scales(document: dict[str, Any]) -> tuple[list[float], list[float]]:
    return document["accelerometer"]["uncertainty"]["scale"], document["accelerometer"]["scale"]


def reasons(document: dict[str, Any]) -> str:
    return " ".join(document["quality"]["reasons"])


@pytest.fixture(scope="module")
def read(whole_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session of which the reading is kept, so that not each test reads its samples."""
    folder = Path(shutil.copytree(whole_session, tmp_path_factory.mktemp("read") / "session"))
    solved(folder)
    return folder


@pytest.fixture(scope="module")
def read_nowhere(whole_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the same without a site."""
    folder = Path(shutil.copytree(whole_session, tmp_path_factory.mktemp("nowhere") / "session"))
    with_site(folder)
    solved(folder)
    return folder


@pytest.fixture
def session(read: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(read, tmp_path / "session"))


@pytest.fixture
def nowhere(read_nowhere: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(read_nowhere, tmp_path / "nowhere"))


def test_gravity_is_as_uncertain_as_its_digits(session: Path) -> None:
    document = solved(session, "--gravity", "9.82")
    assert document["site"]["gravity_sigma_m_s2"] == pytest.approx(0.01 / 12**0.5)
    assert "294 ppm" in reasons(document)
    document = solved(session, "--gravity", "9.8200")
    assert document["site"]["gravity_sigma_m_s2"] == pytest.approx(0.0001 / 12**0.5)
    document = solved(session, "--gravity", "9.816650")
    assert document["site"]["gravity_sigma_m_s2"] == pytest.approx(1e-5)
    assert "294 ppm" not in reasons(document)


@pytest.mark.parametrize(
    ("place", "ppm"),
    [
        ([], 1835.0),
        (["--latitude=45"], 163.0),
        (["--latitude=45", "--height=300"], 51.0),
        (["--gravity=9.8062"], 2.9),
        (["--gravity=9.8062+-0.001"], 102.0),
    ],
)
def test_a_plan_promises_no_scale_better_than_gravity(capsys: pytest.CaptureFixture[str], place: list[str], ppm: float) -> None:
    assert run(["plan", "--json", "--grade=navigation", "--target-scale-ppm=45", *place]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["forecast"]["scale_ppm"] > ppm
    assert told["is_met"] is (ppm < 45)
    assert bool(told["remedy"]) is not told["is_met"]
    assert ("--latitude" in told["assumed"]) is (not place)
    by = "--height" if place == ["--latitude=45"] else "--gravity"
    assert told["is_met"] or not missing(told["remedy"], f"{ppm:.0f} ppm", by, "45")


@pytest.mark.parametrize("value", ["9.80665", "9.81", "9.8", "9.807"])
def test_a_value_of_textbooks_is_an_assumed_one(nowhere: Path, value: str) -> None:
    document = solved(nowhere, "--gravity", value)
    assert (document["site"]["gravity_source"], document["site"]["gravity_sigma_m_s2"]) == ("assumed", 0.018)
    assert document["site"]["gravity_m_s2"] == float(value)
    assert document["quality"]["verdict"] != "good"
    assert not missing(document["quality"]["reasons"][1], f"{float(value):g} m/s^2", "--latitude", "--gravity")
    # The Earth's range, 9.764 to 9.834 m/s^2, is within what is said.
    assert all(sigma >= abs(scale) * 0.0018 for sigma, scale in zip(*scales(document), strict=True))


def test_a_sigma_that_is_given_makes_the_same_value_a_measured_one(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = ("typed", 9.81, 0.0002)
    for given in ("9.81+-0.0002", "9.81 ± 2e-4"):
        site = solved(nowhere, "--gravity", given)["site"]
        assert (site["gravity_source"], site["gravity_m_s2"], site["gravity_sigma_m_s2"]) == wanted
    # As a default in imufield.toml, and as a session keeps it.
    monkeypatch.chdir(nowhere.parent)
    Path("imufield.toml").write_text('gravity = "9.81+-0.0002"\n', encoding="utf-8")
    site = solved(nowhere)["site"]
    assert (site["gravity_source"], site["gravity_m_s2"], site["gravity_sigma_m_s2"]) == wanted
    kept = SiteOptions(gravity_m_s2=9.81, gravity_sigma_m_s2=0.0002).record()
    assert SiteOptions().gravity(kept).source == "typed"


@pytest.mark.parametrize("gravity_m_s2", [9.80665, 9.81, 9.8, 9.807])
def test_an_older_session_kept_the_digits_of_a_textbook_as_sigma(
    session: Path, read_nowhere: Path, gravity_m_s2: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The samples are those read with gravity assumed; the same samples once more for each site would tell nothing more.
    with solving.read_recording(Session.open(read_nowhere), []) as reading:
        monkeypatch.setattr(solving, "read_recording", lambda *_, **__: nullcontext(reading))
    sigma_m_s2 = sigma_of_digits(repr(gravity_m_s2))
    with_site(session, gravity_m_s2=gravity_m_s2, gravity_sigma_m_s2=sigma_m_s2)
    document = solved(session)
    assert (document["site"]["gravity_source"], document["site"]["gravity_sigma_m_s2"]) == ("assumed", 0.018)
    assert document["quality"]["verdict"] != "good"
    assert any("--latitude" in reason for reason in document["quality"]["reasons"])
    # What is solved with, as above.
    with_site(session, gravity_m_s2=gravity_m_s2, gravity_sigma_m_s2=sigma_m_s2, latitude_deg=45.5)
    assert SiteOptions().gravity(Session.open(session).record.site).sigma_m_s2 >= 5e-4
    with_site(session, gravity_m_s2=gravity_m_s2, gravity_sigma_m_s2=2e-5)
    assert SiteOptions().gravity(Session.open(session).record.site).source == "typed"


@pytest.mark.parametrize("value", ["9.80665", "9.81"])
def test_a_session_keeps_that_its_sigma_was_given(tmp_path: Path, value: str) -> None:
    """Also one that is just what the digits would leave open."""
    table, given_m_s2 = tmp_path / "table.csv", sigma_of_digits(value)
    rows = "".join(f"{k / 100},0.1,0.2,{9.8 + k % 2 / 100},{k % 3 / 100},0,0\n" for k in range(200))
    table.write_text(f"time_s,ax (m/s^2),ay (m/s^2),az (m/s^2),gx (rad/s),gy (rad/s),gz (rad/s)\n{rows}", encoding="utf-8")
    for gravity, wanted in ((f"{value}+-{given_m_s2!r}", ("typed", given_m_s2)), (value, ("assumed", 0.018))):
        folder = tmp_path / gravity
        assert run(["import", str(table), "-o", str(folder), "--gravity", gravity]) == 0
        found = SiteOptions().gravity(Session.open(folder).record.site)
        assert (found.source, found.sigma_m_s2) == wanted


@pytest.mark.parametrize("given", ["9.81+-0", "9.81+-nan", "9.81+--0.1", "9.81+-1"])
def test_a_sigma_that_is_none_is_refused(session: Path, given: str) -> None:
    fails(["solve", str(session), "--gravity", given], 2, Reason.USAGE, "--gravity")


def test_a_value_that_is_not_that_of_the_place_is_said_with_both(session: Path) -> None:
    document = solved(session, "--gravity", "9.80665", "--latitude", "48", "--height", "0")
    sentence = next(one for one in document["quality"]["reasons"] if "9.80665" in one)
    assert not missing(sentence, "9.80665 m/s^2", "48 deg", "0 m", "9.80891 m/s^2", "230 ppm")
    assert document["quality"]["verdict"] != "good"
    document = solved(session, "--gravity", "9.808", "--latitude", "48", "--height", "300")
    assert "WGS-84" not in reasons(document)


def test_a_value_of_textbooks_is_no_better_than_its_place() -> None:
    assert choose_gravity(9.80665, 45.5, 0.0).sigma_m_s2 == 5e-4
    assert choose_gravity(9.80665, 45.5, 0.0).source == "typed"
    assert choose_gravity(9.80665, 45.5, 0.0, sigma_m_s2=1e-5).sigma_m_s2 == 1e-5


def test_a_typed_value_leaves_the_session_its_place() -> None:
    recorded = SiteRecord(latitude_deg=48.0, height_m=300.0)
    gravity = SiteOptions(gravity_m_s2=9.80798).gravity(recorded)
    assert (gravity.source, gravity.latitude_deg, gravity.height_m) == ("typed", 48.0, 300.0)
    assert SiteOptions(gravity_m_s2=9.80798, height_m=0.0).gravity(recorded).height_m == 0.0
    gravity = SiteOptions(latitude_deg=10.0).gravity(SiteRecord(gravity_m_s2=9.81))
    assert (gravity.source, gravity.latitude_deg) == ("normal", 10.0)


def test_a_session_has_one_place_whatever_is_typed_of_it() -> None:
    recorded = SiteRecord(latitude_deg=48.0, height_m=300.0)
    corrected = SiteOptions(latitude_deg=47.0).gravity(recorded)
    assert (corrected.latitude_deg, corrected.height_m) == (47.0, 300.0)
    assert corrected.gravity_m_s2 == normal_gravity(47.0, 300.0)
    higher = SiteOptions(height_m=600.0).gravity(recorded)
    assert (higher.latitude_deg, higher.height_m, higher.gravity_m_s2) == (48.0, 600.0, normal_gravity(48.0, 600.0))
    # A measured value is not given up for a height, or for the latitude that is known.
    measured = SiteRecord(gravity_m_s2=9.8081, gravity_sigma_m_s2=1e-5, gravity_sigma_is_given=True, latitude_deg=48.0)
    higher = SiteOptions(height_m=600.0).gravity(measured)
    assert (higher.source, higher.gravity_m_s2, higher.sigma_m_s2, higher.height_m) == ("typed", 9.8081, 1e-5, 600.0)
    again = SiteOptions(latitude_deg=48.0).gravity(measured)
    assert (again.source, again.gravity_m_s2, again.sigma_m_s2) == ("typed", 9.8081, 1e-5)
    again = SiteOptions(latitude_deg=48.0).gravity(measured)
    assert (again.source, again.gravity_m_s2, again.sigma_m_s2) == ("typed", 9.8081, 1e-5)
    # The place where someone usually works says nothing of where a session was recorded.
    usual = SiteOptions(usual=SiteRecord(latitude_deg=60.0, height_m=10.0))
    assert usual.place(recorded).record() == recorded
    # Nor does a height that is typed beside it, and where nothing else is known it is that of the usual place.
    raised = replace(usual, height_m=310.0)
    assert raised.place(measured).record() == replace(measured, height_m=310.0)
    assert raised.place().record() == SiteRecord(latitude_deg=60.0, height_m=310.0)
    # A height that a session knows alone is its own.
    assert usual.place(SiteRecord(height_m=300.0)).record() == SiteRecord(latitude_deg=60.0, height_m=300.0)
    # With a typed place nothing is taken of the usual one.
    assert replace(usual, latitude_deg=10.0).place().record() == SiteRecord(latitude_deg=10.0)
    with pytest.raises(UsageError, match="600 m"):
        SiteOptions(height_m=600.0).gravity(SiteRecord(height_m=300.0))


@pytest.mark.parametrize(
    ("recorded", "typed", "is_another"),
    [
        ({"latitude_deg": 45.0, "height_m": 0.0}, {"latitude_deg": 48.1, "height_m": 0.0}, True),
        ({"latitude_deg": 45.0, "height_m": 0.0}, {"latitude_deg": 45.4}, False),
        # Of an unknown height nothing is known but the latitude.
        ({"latitude_deg": 45.0}, {"height_m": 3000.0}, False),
        ({"latitude_deg": 45.0}, {"latitude_deg": 75.0}, True),
        ({"gravity_m_s2": 9.8081, "gravity_sigma_m_s2": 1e-5}, {"latitude_deg": 10.0, "height_m": 0.0}, True),
        # Some hundred metres may be what differs.
        ({"gravity_m_s2": 9.80665, "gravity_sigma_m_s2": 1.1e-5}, {"latitude_deg": 48.0}, False),
        ({"gravity_m_s2": 9.80665, "gravity_sigma_m_s2": 1.1e-5}, {"latitude_deg": 48.0, "height_m": 0.0}, True),
        ({"gravity_m_s2": 9.81}, {"latitude_deg": 10.0}, False),
        ({}, {"latitude_deg": 10.0}, False),
        ({"latitude_deg": 45.0, "height_m": 0.0}, {}, False),
    ],
)
def test_another_place_than_the_recorded_one_is_said(
    recorded: dict[str, Any], typed: dict[str, Any], *, is_another: bool
) -> None:
    told = SiteOptions(**typed).another_place(SiteRecord(**recorded))
    assert (told is not None) is is_another
    if told is not None:
        now = normal_gravity(typed["latitude_deg"])
        before = recorded.get("gravity_m_s2") or normal_gravity(recorded["latitude_deg"])
        assert float(told.values["apart_ppm"]) == pytest.approx(1e6 * abs(now - before) / before, rel=1e-9)
        assert not missing(told, f"{now:.5f} m/s^2", f"{before:.5f}", "--latitude")


def test_a_height_is_added_to_the_latitude_of_a_session(nowhere: Path) -> None:
    with_site(nowhere, latitude_deg=45.0)
    assert math.isnan(solved(nowhere)["site"]["height_m"])
    elsewhere = solved(nowhere, "--latitude", "75")["quality"]
    assert "ppm apart" in elsewhere["warnings"][0]
    assert (elsewhere["verdict"], elsewhere["accelerometer_verdict"]) == ("usable", "usable")
    site = solved(nowhere, "--height", "300")["site"]
    assert (site["latitude_deg"], site["height_m"]) == (45.0, 300.0)
    assert site["gravity_m_s2"] == pytest.approx(normal_gravity(45.0, 300.0), abs=1e-9)
    fails(["verify", str(nowhere.parent / "solved.toml"), str(nowhere), "--height", "900"], 2, Reason.USAGE, "--height")


def test_a_usual_height_alone_is_no_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    line = ["capture", "--port", "socket://127.0.0.1:1", "--driver", "stim300"]
    fails([*line, "--height", "520"], 2, Reason.USAGE, "--latitude")
    monkeypatch.setenv("IMUFIELD_HEIGHT_M", "520")
    assert failure(*line).exit_code == 3  # Nobody listens there.


@pytest.mark.parametrize(
    ("text", "given", "has_few"), [("9.82", "", True), ("9.820", "", True), ("9.82", "0.003", False), ("9.81744", "", False)]
)
def test_only_digits_that_are_few_are_said_to_be_few(text: str, given: str, has_few: bool) -> None:
    assert choose_gravity(float(text), sigma_m_s2=sigma_as_typed(text, given)).has_few_digits is has_few


def test_the_height_0_of_an_earlier_version_is_not_proposed(nowhere: Path) -> None:
    before = Gravity(gravity_m_s2=9.80620, sigma_m_s2=5e-4, source="normal", latitude_deg=45.0, height_m=0.0)
    assert solving._better_gravity(before, choose_gravity(latitude_deg=45.0)) == ()
    (told,) = solving._better_gravity(before, choose_gravity())
    assert "--latitude 45 --height 0" in told
    measured = replace(before, source="typed", sigma_m_s2=1e-5)
    (told,) = solving._better_gravity(measured, choose_gravity(latitude_deg=45.0))
    assert "--gravity 9.8062" in told
    (told,) = solving._better_gravity(replace(before, height_m=520.0), choose_gravity(latitude_deg=45.0))
    assert "--latitude 45 --height 520" in told
    # A gravity that was typed beside the place goes before it.
    (told,) = solving._better_gravity(replace(before, height_m=520.0), choose_gravity(9.81, latitude_deg=45.0))
    assert "without --gravity" in told


def test_a_session_keeps_the_digits() -> None:
    record = SiteOptions(gravity_m_s2=9.81, gravity_sigma_m_s2=1e-4).record()
    assert SiteOptions().gravity(record).sigma_m_s2 == pytest.approx(1e-4)


def test_settings_edited_afterwards_are_said(short_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = Path(shutil.copytree(short_session, tmp_path / "session"))
    path = session / "session.toml"
    text = path.read_text()
    before, rest = text.split("[settings.accelerometer_range_g]\nvalue = 10", 1)
    path.write_text(f"{before}[settings.accelerometer_range_g]\nvalue = 30{rest}")
    document = solved(session)
    assert any(not missing(one, "accelerometer_range_g", "30", "part-001.mcap", "10") for one in document["quality"]["reasons"])
    path.write_text(f"{before}[settings.accelerometer_range_g]\nrange = 10{rest}")
    capsys.readouterr()
    fails(["solve", str(session)], 4, Reason.DAMAGED, "settings.accelerometer_range_g")


def with_site(session: Path, **site: float) -> None:
    path = session / "session.toml"
    metadata = tomllib.loads(path.read_text(encoding="utf-8"))
    metadata["site"] = site
    path.write_text(tomli_w.dumps(metadata), encoding="utf-8")


def test_a_default_goes_before_gravity_that_was_assumed(nowhere: Path) -> None:
    assert solved(nowhere)["site"]["gravity_source"] == "assumed"
    site = SiteOptions(usual=SiteRecord(latitude_deg=60.0, height_m=0.0))
    task = _Task(VerifyOptions(parameters=nowhere.parent / "solved.toml", session=nowhere, site=site))
    assert (task.gravity.source, task.latitude_deg, task.gravity.height_m) == ("normal", 60.0, 0.0)


def test_what_was_typed_to_solve_a_session_without_a_site_goes_before_a_default(nowhere: Path) -> None:
    site = solved(nowhere, "--latitude", "10", "--height", "300")["site"]
    assert (site["gravity_source"], site["latitude_deg"], site["height_m"]) == ("normal", 10.0, 300.0)
    parameters = nowhere.parent / "solved.toml"
    for options in (SiteOptions(), SiteOptions(usual=SiteRecord(latitude_deg=60.0, height_m=0.0))):
        task = _Task(VerifyOptions(parameters=parameters, session=nowhere, site=options))
        assert task.latitude_deg == 10.0
        assert task.gravity.height_m == 300.0
        assert task.gravity.gravity_m_s2 == site["gravity_m_s2"]
