"""``imufield verify`` as a user runs it: positions, hours of rest, and what is refused with which exit code."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from imufield.acquire.formats.tables import row_chunks
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.recorder import Recorder, packed, part_metadata
from imufield.acquire.recording.session import Session
from imufield.calibrate.model.gauge import intrinsic, make_intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.observability import WEAKEST_COLUMN
from imufield.cli.run import run
from imufield.commands.options.result_commands import VerifyOptions
from imufield.commands.verify import run_verify
from imufield.deliver.navigation.static_navigation import SHORTEST_S
from imufield.deliver.parameters.file import from_document, load
from imufield.deliver.parameters.temperature_tables import add_temperature
from imufield.deliver.parameters.write import content_sha256, to_toml, write_document
from imufield.earth import EARTH_RATE_RAD_S
from imufield.errors import ParameterFileError, Reason, RecordingError, VerificationError
from imufield.files import DEFAULT_ROOT
from imufield.pipeline.site import SiteOptions
from imufield.samples import FloatArray, Samples
from tests.commands.told import fails, missing, says
from tests.parameter_files import over_temperature
from tests.refused import refused
from tests.told import told

GRAVITY_M_S2 = 9.80665
LATITUDE_DEG = 48.0


@pytest.fixture
def solved(solved_session: Path, tmp_path: Path) -> Path:
    """Return a solved session of 24 positions of one's own."""
    return Path(shutil.copytree(solved_session, tmp_path / "solved"))


@pytest.fixture
def short(short_solved: Path, tmp_path: Path) -> Path:
    """Return the same of 13 positions, where nothing is asked of how they fit."""
    return Path(shutil.copytree(short_solved, tmp_path / "short"))


def rest_session(
    folder: Path,
    duration_s: float = 500.0,
    unit: str = "m/s^2",
    temperature_degc: float = np.nan,
    noise_m_s2: float = 1e-4,
    turned_s: float = np.inf,
    *,
    rate_hz: float = 20.0,
    **metadata: Any,
) -> Session:
    """Record an instrument at rest, level, heading east of north, with the noise of a good one."""
    rng, n = np.random.default_rng(1), round(duration_s * rate_hz)
    latitude = np.radians(LATITUDE_DEG)
    north, up = EARTH_RATE_RAD_S * np.cos(latitude), EARTH_RATE_RAD_S * np.sin(latitude)
    rows: FloatArray = np.zeros((n, 8))
    rows[:, 0] = np.arange(n) / rate_hz
    rows[:, 1:4] = [0.001, 0.002, GRAVITY_M_S2] + noise_m_s2 * rng.standard_normal((n, 3))
    rows[:, 4:7] = [0.8 * north, 0.6 * north, up] + 1e-6 * rng.standard_normal((n, 3))
    rows[:, 7] = temperature_degc
    rows[rows[:, 0] > turned_s, 1:7] *= [1, -1, -1, 1, -1, -1]
    protocol = load_protocol("rows_f64", {"accelerometer_unit": unit, "gyroscope_unit": "rad/s", "rate_hz": rate_hz})
    content: dict[str, Any] = {
        "kind": "import",
        "instrument": {"driver": "rows_f64", "model": "bench"},
        "site": {"gravity_m_s2": GRAVITY_M_S2, "latitude_deg": LATITUDE_DEG},
        "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
        "settings": {name: {"value": one.value, "origin": one.origin} for name, one in protocol.settings.items()},
        "finished": True,
    }
    session = Session.create_in(folder, "bench", content | metadata)
    Recorder(session.add_part(), part_metadata(protocol, {}), first=packed(row_chunks(rows))).close()
    return session


def with_document(path: Path, target: Path, **changes: Any) -> Path:
    """Write a parameter file with tables of it changed, hash and all."""
    document = load(path).document
    for table, values in changes.items():
        document[table] = document[table] | values
    document.pop("integrity", None)
    target.write_text(to_toml(document))
    return target


def test_own_session_is_cross_validated(solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "found.json"
    found = run_verify(VerifyOptions(parameters=solved / "parameters.toml", session=solved, output=output))
    assert found.left_out is not None
    assert len(found.left_out.name) == 24
    assert "4" in found.left_out.how.split()
    assert found.left_out.before_rms_m_s2 > 3 * found.left_out.rms_m_s2
    assert found.navigation is None
    (why,) = told(found.notes, "verify.turned")
    assert why.values["least_s"] == VerifyOptions().align_s + SHORTEST_S
    assert not missing(capsys.readouterr().out, "imufield record")
    assert json.loads(output.read_text())["positions"]["as_forecast"]


@pytest.fixture
def imported(short: Path, tmp_path: Path) -> Path:
    """Return the same as a table of another program, imported and solved: nobody says that it was guided, or where."""
    table, session = tmp_path / "table.csv", tmp_path / "imported"
    assert run(["export-data", str(short), "-o", str(table)]) == 0
    assert run(["import", str(table), "-o", str(session)]) == run(["solve", str(session), "--gravity", "9.8"]) == 0
    return session


@pytest.mark.parametrize("align_s", [600.0, 60.0, 10.0])
def test_positions_that_were_imported_are_not_navigated_as_guided_ones_are(
    short: Path, imported: Path, tmp_path: Path, align_s: float
) -> None:
    for parameters in (imported, short):
        site = SiteOptions() if parameters == imported else SiteOptions(latitude_deg=LATITUDE_DEG)
        path, output = parameters / "parameters.toml", tmp_path / "found.json"
        found = run_verify(VerifyOptions(parameters=path, session=imported, align_s=align_s, site=site, output=output))
        assert found.left_out is not None
        assert len(found.left_out.name) == 14
        (why,) = told([note for note in found.notes if "navigation" in note], "verify.turned")
        assert why.values["least_s"] == align_s + SHORTEST_S


def test_a_standstill_that_is_turned_over_is_told_of_turned(short: Path, tmp_path: Path) -> None:
    """It has two positions, and is no session of them."""
    rest = rest_session(tmp_path / "rest", turned_s=300.0).folder
    options = VerifyOptions(parameters=short / "parameters.toml", session=rest, align_s=200.0, output=tmp_path / "found.json")
    assert told(run_verify(options).notes, "check.moved")


def test_of_positions_that_show_no_quadratic_term_without_some_that_is_told(
    short: Path, imported: Path, tmp_path: Path
) -> None:
    for session in (short, imported):
        path, output = tmp_path / f"{session.name}.toml", ["-o", str(tmp_path / "found.json")]
        assert run(["solve", str(session), "--gravity", "9.8", "--model", "quadratic", "-o", str(path)]) == 0
        error = fails(["verify", str(path), str(session), *output], 6, Reason.UNOBSERVABLE, key="left_out.without")
        assert error.values["positions"] == 14


def test_where_nothing_can_be_checked_every_cause_is_told(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """That of the positions first, of which every recording has some."""
    moving = rest_session(tmp_path / "moving", 60.0, noise_m_s2=5.0).folder
    command = ["verify", str(short / "parameters.toml"), str(moving), "-o", str(tmp_path / "found.json")]
    capsys.readouterr()
    fails(command, 6, Reason.TOO_FEW)
    values = {"duration_s": 59.95, "needed_s": 660.0, "align_s": 600.0}
    assert says(capsys.readouterr().err, "deliver.navigation", "check.too_short", **values)


def test_alone_it_takes_the_newest_session_and_its_parameters(
    solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    newest = tmp_path / DEFAULT_ROOT / "20260301T101500Z-newest"
    shutil.copytree(solved, newest, ignore=shutil.ignore_patterns("*.json"))
    monkeypatch.chdir(tmp_path)
    assert run(["verify"]) == 0
    named = run_verify(VerifyOptions(parameters=solved / "parameters.toml", session=solved, output=tmp_path / "named.json"))
    kept = json.loads((newest / "parameters.verification.json").read_text())["positions"]
    assert named.left_out is not None
    assert kept["misfit"] == pytest.approx(named.left_out.misfit, rel=1e-12)


def test_another_session_of_36_positions_proves_the_parameters(
    solved: Path, make_session: Callable[..., Session], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole way: bytes of another day on the wire, decoded, held still, compared with what the file forecasts."""
    held_out = make_session("paper36", hold_s=6.0, day=1)
    output = tmp_path / "found.json"
    arguments = ["verify", str(solved / "parameters.toml"), str(held_out.folder), "--latitude", "48", "-o", str(output)]
    assert run([*arguments, "--require", "residual-ug=200"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "36 positions" in text
    found = json.loads(output.read_text())["positions"]
    assert found["as_forecast"]
    assert len(found["residual_m_s2"]) == 36
    assert found["before_rms_m_s2"] > 5 * found["rms_m_s2"]
    # Forecast: so many micro-g from covariance, hold and scatter. The residual is about that, on data it has never seen.
    assert 0.6 < found["rms_m_s2"] / found["forecast_rms_m_s2"] < 1.4
    inside = np.abs(found["residual_m_s2"]) < 1.96 * np.array(found["sigma_m_s2"])
    assert inside.sum() >= 31


def test_parameters_of_another_instrument_are_called_so(
    solved: Path, make_session: Callable[..., Session], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def other(samples: Samples) -> Samples:
        return replace(samples, accelerometer=samples.accelerometer * 1.01)

    session = make_session("faces6", change=other)
    arguments = ["verify", str(solved / "parameters.toml"), str(session.folder), "-o", str(tmp_path / "found.json")]
    assert run([*arguments, "--latitude", "48"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert not missing(text, "FORECAST", "1000", "instrument")
    assert not json.loads((tmp_path / "found.json").read_text())["positions"]["as_forecast"]


def test_results_are_kept_beside_the_parameters(solved: Path) -> None:
    run_verify(VerifyOptions(parameters=solved / "parameters.toml", session=solved, hold_out=6, as_json=True))
    assert (solved / "parameters.verification.json").is_file()


def test_failed_requirement_leaves_with_7_and_says_what(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with refused(VerificationError, Reason.FAILED_REQUIREMENT, "residual-ug") as caught:
        run_verify(VerifyOptions(parameters=short / "parameters.toml", session=short, require="residual-ug=1"))
    values = caught.value.values
    assert values["requirement"] == "residual-ug"
    assert values["measured"] > values["limit"] == 1
    assert run(["verify", str(short / "parameters.toml"), str(short), "--require", "residual-ug=1"]) == 7
    output = capsys.readouterr()
    assert "Verdict: FAIL" in output.out
    assert run(["verify", str(short / "parameters.toml"), str(short), "--require", "residual-ug=5000"]) == 0


def test_a_requirement_stays_until_it_is_verified_again(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rest = rest_session(tmp_path / "rest").folder
    path = short / "parameters.toml"
    navigated, positions = (["verify", str(path), str(session), "--align-s", "200"] for session in (rest, short))

    def kept() -> dict[str, Any]:
        document: dict[str, Any] = json.loads((short / "parameters.verification.json").read_text())
        return {"passed": document["passed"]} | {one["name"]: (one["limit"], one["session"]) for one in document["requirement"]}

    assert run([*navigated, "--require", "nav-nmi-per-h=0.000001"]) == 7
    capsys.readouterr()
    for limits in ([], ["--require", "residual-ug=5000"]):
        assert run([*positions, *limits]) == 0
        name = "parameters.verification.json"
        assert says(capsys.readouterr().out, "commands", "verify.earlier", name=name, earlier=["nav-nmi-per-h"])
    assert kept() == {"passed": False, "nav-nmi-per-h": (1e-6, rest.name), "residual-ug": (5000.0, short.name)}
    assert run(["report", str(short)]) == 0
    words = " ".join((short / "report.html").read_text(encoding="utf-8").split())
    assert not missing(
        words, "<strong>fail</strong>: nav-nmi-per-h", "(limit 1e-06), NOT MET; residual-ug", "(limit 5000), met"
    )
    assert run([*navigated, "--require", "nav-nmi-per-h=1000000"]) == 0
    assert kept() == {"passed": True, "nav-nmi-per-h": (1e6, rest.name), "residual-ug": (5000.0, short.name)}


def test_a_standstill_in_a_wrong_unit_proves_nothing(solved: Path, tmp_path: Path) -> None:
    # m/s^2 that are called g: gravity is ten times too large.
    rest = rest_session(tmp_path / "rest", 700.0, unit="g")
    command = ["verify", str(solved / "parameters.toml"), str(rest.folder), "--require", "nav-nmi-per-h=1000"]
    fails(command, 6, Reason.GRAVITY, key="verify.refused")
    fails([*command, "--turned"], 4, Reason.GRAVITY, key="check.no_gravity")


def test_positions_that_hide_an_error_meet_no_requirement(
    solved: Path, make_session: Callable[..., Session], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rest, faces = rest_session(tmp_path / "rest", 60.0), make_session("faces6", day=1)
    common = ["verify", str(solved / "parameters.toml")]
    output = ["-o", str(tmp_path / "found.json"), "--latitude", "48"]
    limit = ["--require", "residual-ug=1000000"]
    assert run([*common, str(rest.folder), *output]) == 0
    error = fails([*common, str(rest.folder), *output, *limit], 7, Reason.FAILED_REQUIREMENT, key="verify.not_measured")
    assert error.values["requirement"] == "residual-ug"
    sides = [f"+{axis} up and -{axis} up" for axis in "xyz"]
    hidden = {"found": 1, "axes": list("xyz"), "limit": WEAKEST_COLUMN, "sides": sides}
    assert says(capsys.readouterr().out, "deliver.verification", "left_out.hidden", **hidden)
    document = json.loads((tmp_path / "found.json").read_text())
    assert document["requirement"][0]["measured"] is None
    assert document["positions"]["rms_m_s2"] > 0
    assert run([*common, str(faces.folder), *output, *limit]) == 0
    assert not json.loads((tmp_path / "found.json").read_text())["positions"]["hidden"]


def edited(path: Path, target: Path, **changes: Any) -> Path:
    """Write a file as somebody does who changes values and says so; intrinsic values follow where scale and bias change."""
    document = load(path).document
    for table, values in changes.items():
        document[table] = document[table] | values
    if "accelerometer" in changes:
        of_file = from_document(document).calibration.accelerometer
        values = intrinsic(to_vector(of_file), of_file.quadratic_axes)[0]
        follows = make_intrinsic(values, values)
        own = {key: getattr(follows, key).tolist() for key in ("scale", "bias_raw", "angle_rad", "quadratic")}
        document["accelerometer"]["intrinsic"] = document["accelerometer"]["intrinsic"] | own
    del document["integrity"]
    text = to_toml(document)
    target.write_text(text.replace(content_sha256(document), "edited"))
    return target


@pytest.mark.parametrize("limits", [[], ["--require", "residual-ug=1000000"], ["--hold-out", "6"]])
def test_parameters_that_the_own_session_does_not_give_fail_on_it(
    solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], limits: list[str]
) -> None:
    """The positions predict one another whatever stands in the file; the file itself must be held against them."""
    before = load(solved / "parameters.toml").document["accelerometer"]
    wrong = {"scale": [1.1, *before["scale"][1:]], "bias_m_s2": [1.0, *before["bias_m_s2"][1:]]}
    path = edited(solved / "parameters.toml", tmp_path / "bad.toml", accelerometer=wrong)
    output = tmp_path / "found.json"
    assert run(["verify", str(path), str(solved), "-o", str(output), *limits]) == 7
    printed = capsys.readouterr()
    assert "FAIL" in printed.out
    assert "FAIL" in printed.err
    document = json.loads(output.read_text())
    assert document["passed"] is False
    assert document["positions"]["rms_m_s2"] > 0.1
    assert not document["positions"]["as_forecast"]


def test_a_common_scale_that_gravity_would_hide_fails_too(solved: Path, tmp_path: Path) -> None:
    """The sigma of gravity is in every scale and says nothing of whether these positions gave this scale."""
    assert run(["solve", str(solved), "--gravity", "9.8", "-o", str(tmp_path / "coarse.toml")]) == 0
    scale = np.array(load(tmp_path / "coarse.toml").document["accelerometer"]["scale"]) * 1.003
    path = edited(tmp_path / "coarse.toml", tmp_path / "bad.toml", accelerometer={"scale": scale.tolist()})
    assert run(["verify", str(tmp_path / "coarse.toml"), str(solved), "-o", str(tmp_path / "found.json")]) == 0
    assert run(["verify", str(path), str(solved), "-o", str(tmp_path / "found.json")]) == 7


def test_what_the_file_says_of_itself_goes_into_the_verdict(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stalled = {"status": -3, "message": "stalled"}
    path = with_document(short / "parameters.toml", tmp_path / "stalled.toml", solver=stalled, quality={"verdict": "poor"})
    common = ["verify", str(path), str(short), "-o", str(tmp_path / "found.json")]
    assert run([*common, "--require", "residual-ug=5000"]) == 7
    assert not missing(capsys.readouterr().out, "status -3", "stalled", "FAIL")
    assert run(common) == 0
    assert not missing(capsys.readouterr().out, "status -3", "stalled")
    poor = with_document(short / "parameters.toml", tmp_path / "poor.toml", quality={"verdict": "poor"})
    arguments = ["verify", str(poor), str(short), "-o", str(tmp_path / "found.json"), "--require", "residual-ug=5000"]
    assert run(arguments) == 7
    assert "POOR" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["export", "apply"])
def test_a_poor_file_says_so_where_it_is_used(
    command: str, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poor = with_document(short / "parameters.toml", tmp_path / "poor.toml", quality={"verdict": "poor"})
    to = {
        "export": ["--to", "vectornav", "-o", str(tmp_path / "made")],
        "apply": [str(short), "-o", str(tmp_path / "made.csv")],
    }
    for path, is_poor in ((poor, True), (short / "parameters.toml", False)):
        assert run([command, str(path), *to[command]]) == 0
        assert ("POOR" in capsys.readouterr().out) is is_poor


def test_samples_that_the_calibrated_temperatures_do_not_cover_are_counted(short: Path, tmp_path: Path) -> None:
    parameters = load(short / "parameters.toml")
    document = add_temperature(parameters.document, over_temperature(parameters.calibration, 1e-4), ())
    document.pop("integrity")
    (tmp_path / "over.toml").write_text(to_toml(document))
    found = run_verify(VerifyOptions(parameters=tmp_path / "over.toml", session=short, output=tmp_path / "found.json"))
    # Its instrument sends no temperature.
    (note,) = told(found.notes, "apply_session.unknown")
    assert note.values["samples"] > 1000
    hot = rest_session(tmp_path / "hot", 60.0, temperature_degc=70.0)
    found = run_verify(VerifyOptions(parameters=tmp_path / "over.toml", session=hot.folder, output=tmp_path / "found.json"))
    (note,) = told(found.notes, "apply_session.outside")
    assert note.values["samples"] == 1200
    broken = rest_session(tmp_path / "broken", 60.0, temperature_degc=5000.0)
    with refused(RecordingError, Reason.BAD_DATA, key="samples.impossible"):
        run_verify(VerifyOptions(parameters=tmp_path / "over.toml", session=broken.folder))


def test_options_that_would_change_nothing_are_refused(short: Path, tmp_path: Path) -> None:
    foreign = with_document(short / "parameters.toml", tmp_path / "foreign.toml", session={"sha256": "0" * 64})
    output = ["-o", str(tmp_path / "found.json")]
    error = fails(["verify", str(foreign), str(short), "--hold-out", "4", *output], 2, Reason.USAGE, "--hold-out 4")
    assert error.values["hold_out"] == 4
    own = ["verify", str(short / "parameters.toml"), str(short), *output]
    for site in (["--gravity", "9.83"], ["--latitude", "10"]):
        error = fails([*own, *site], 2, Reason.USAGE, "--gravity", "--latitude")
        assert error.values["typed"] != error.values["solved"]
    assert run([*own, "--latitude", "48"]) == 0


def test_an_instrument_without_serial_number_is_said_not_to_be_checked(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    named = with_document(
        short / "parameters.toml", tmp_path / "named.toml", session={"sha256": "0" * 64}, instrument={"serial_number": "A1"}
    )
    found = run_verify(VerifyOptions(parameters=named, session=short, output=tmp_path / "found.json"))
    (note,) = [one for one in found.notes if "serial number" in one]
    assert not missing(capsys.readouterr().out, note)
    own = run_verify(VerifyOptions(parameters=short / "parameters.toml", session=short, output=tmp_path / "found.json"))
    assert not [one for one in own.notes if "serial number" in one]


@pytest.mark.parametrize("text", ["", ",", "residual-ug=50,", "residual-ug=50,residual-ug=500"])
def test_requirements_that_amount_to_nothing_are_refused(short: Path, tmp_path: Path, text: str) -> None:
    arguments = ["verify", str(short / "parameters.toml"), str(short), "-o", str(tmp_path / "found.json")]
    assert run([*arguments, "--require", text]) == 2


def test_rest_is_navigated_before_and_after(solved: Path, tmp_path: Path) -> None:
    session = rest_session(tmp_path / "rest")
    options = VerifyOptions(
        parameters=solved / "parameters.toml", session=session.folder, align_s=200.0, output=tmp_path / "found.json"
    )
    found = run_verify(options)
    assert found.navigation is not None
    assert list(found.navigation.drifts) == ["before", "after"]
    assert found.navigation.navigated_s == pytest.approx(299, abs=2)
    # The simulated rest has no errors, the file of another instrument puts some in.
    drifts = found.navigation.drifts
    assert drifts["before"].position_nmi.max() < drifts["after"].position_nmi.max()
    document = json.loads(options.output.read_text())
    assert set(document["navigation"]["drift"]) == {"before", "after"}


def test_short_rest_is_checked_as_a_position_and_the_reason_told(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = rest_session(tmp_path / "rest", 60.0)
    arguments = ["verify", str(short / "parameters.toml"), str(session.folder), "-o", str(tmp_path / "found.json")]
    assert run(arguments) == 0
    assert not missing(capsys.readouterr().out, "60 s", "660 s")
    assert run([*arguments, "--require", "nav-nmi-per-h=1"]) == 7


def test_unannounced_options_are_refused(short: Path, tmp_path: Path) -> None:
    session = rest_session(tmp_path / "rest")
    common = ["verify", str(short / "parameters.toml"), str(session.folder), "-o", str(tmp_path / "found.json")]
    assert run([*common, "--turned", "--align-s", "200"]) == 4
    assert run([*common, "--require", "speed=1"]) == 2
    assert run([*common, "--hold-out", "3"]) == 2


def test_parameters_of_another_instrument_are_refused(solved: Path, tmp_path: Path) -> None:
    other = with_document(solved / "parameters.toml", tmp_path / "other.toml", instrument={"serial_number": "A1"})
    session = rest_session(tmp_path / "rest", instrument={"driver": "rows_f64", "model": "bench", "serial_number": "B2"})
    with refused(ParameterFileError, Reason.FOREIGN, "A1", "B2"):
        run_verify(VerifyOptions(parameters=other, session=session.folder))


def test_parameters_in_other_units_are_refused(solved: Path, tmp_path: Path) -> None:
    session = rest_session(tmp_path / "rest", unit="count")
    with refused(ParameterFileError, Reason.UNITS, "m/s^2", "count"):
        run_verify(VerifyOptions(parameters=solved / "parameters.toml", session=session.folder))


def test_edited_file_is_refused_and_the_results_left_alone(short: Path, tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text((short / "parameters.toml").read_text().replace("bias_m_s2 = [", "bias_m_s2 = [1.", 1))
    old = tmp_path / "parameters.verification.json"
    old.write_text("old")
    assert run(["verify", str(path), str(short)]) == 5
    assert old.read_text() == "old"


def test_latitude_is_asked_for(short: Path, tmp_path: Path) -> None:
    session = rest_session(tmp_path / "rest")
    metadata = dict(session.metadata)
    metadata["site"] = {"gravity_m_s2": GRAVITY_M_S2}
    (session.folder / "session.toml").write_bytes(tomli_w.dumps(metadata).encode())
    nowhere = with_document(short / "parameters.toml", tmp_path / "nowhere.toml", site={"latitude_deg": float("nan")})
    arguments = ["verify", str(nowhere), str(session.folder), "--align-s", "200", "-o", str(tmp_path / "found.json")]
    assert run([*arguments, "--require", "nav-nmi-per-h=100"]) == 2
    assert run([*arguments, "--require", "nav-nmi-per-h=1000000", "--latitude", "48"]) == 0


def test_a_known_heading_is_taken_instead_of_found(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = rest_session(tmp_path / "rest")
    output = tmp_path / "found.json"
    common = ["verify", str(short / "parameters.toml"), str(session.folder), "--align-s", "200", "-o", str(output)]
    assert run([*common, "--heading", "-36.87", "--heading-sigma", "1"]) == 0
    assert "-36.87 deg" in capsys.readouterr().out
    document = json.loads(output.read_text())
    assert document["navigation"]["heading_deg"] == pytest.approx(-36.87)
    assert run([*common, "--heading", "400"]) == 2


def test_a_wrong_gravity_is_named(solved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document: dict[str, Any] = load(solved / "parameters.toml").document
    del document["integrity"]
    # As if they came from another session.
    document["session"]["sha256"] = "0" * 64
    write_document(solved / "foreign.toml", document)
    wrong = document["site"]["gravity_m_s2"] + 0.02
    site = SiteOptions(gravity_m_s2=wrong, gravity_sigma_m_s2=1e-5)
    found = run_verify(VerifyOptions(parameters=solved / "foreign.toml", session=solved, site=site))
    (note,) = [one for one in found.notes if f"{wrong:.6f}" in one]
    assert not missing(note, f"{wrong - 0.02:.6f} m/s^2")
    assert not missing(capsys.readouterr().out, note)
