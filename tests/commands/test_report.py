"""``imufield report`` of a solved session."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from imufield.acquire.recording.session import Session
from imufield.calibrate.model.uncertainty import rms
from imufield.cli.run import run
from imufield.commands.options.result_commands import ReportOptions
from imufield.commands.report import gather, run_report
from imufield.deliver.parameters.file import load
from imufield.earth import MICRO_G_M_S2
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from tests.commands.told import says
from tests.refused import refused

MIB = 2**20


@pytest.fixture
def solved(solved_session: Path, tmp_path: Path) -> Path:
    """Return a solved session of 24 positions of one's own."""
    return Path(shutil.copytree(solved_session, tmp_path / "solved"))


def test_pages_are_written_into_the_session(solved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report, record = run_report(ReportOptions(session=solved, operator="A. Person"))
    assert (report, record) == (solved / "report.html", solved / "calibration-record.html")
    shown = capsys.readouterr().out
    assert shown.count("written to") == 2
    assert says(shown, "commands", "report.record", record="calibration-record.html")
    assert report.stat().st_size < 3 * MIB
    text = report.read_text(encoding="utf-8")
    for title in ("Residual on the sphere", "Residual by position", "Stillness", "Gyroscope closing error"):
        assert f"<h3>{title}" in text
    assert "<h3>Convergence" not in text
    assert "A. Person" in record.read_text(encoding="utf-8")


def test_a_file_of_the_version_that_is_written_is_not_converted(solved: Path) -> None:
    data, _ = gather(ReportOptions(session=solved))
    assert dict(data.provenance)["Parameter file"] == str(solved / "parameters.toml")
    assert not data.parameters.is_converted


def test_recording_tells_what_the_file_cannot(solved: Path) -> None:
    data, _ = gather(ReportOptions(session=solved))
    assert data.trace is not None
    tables = data.parameters.document["position"]
    inside = [
        any(table["start_s"] + 0.5 < time_s < table["start_s"] + table["duration_s"] - 0.5 for table in tables)
        for time_s in data.trace.time_s
    ]
    still = data.trace.scatter_m_s2[inside]
    moving = data.trace.scatter_m_s2[[not one for one in inside]]
    assert still.max() < 0.2 * moving.max()
    assert data.closure is not None
    assert len(data.closure.after_deg) == 23
    assert data.closure.after_deg.mean() < 0.3 * data.closure.before_deg.mean()


@pytest.mark.parametrize("method", ["bsas", "ide"])
def test_convergence_is_that_of_the_method_that_was_run(solved: Path, method: str) -> None:
    assert run(["solve", str(solved), "--latitude=45", "--method", method]) == 0
    data, _ = gather(ReportOptions(session=solved))
    assert data.convergence is not None
    assert (data.convergence.method, data.convergence.converged) == (method, True)
    assert data.convergence.excess[0] > data.convergence.excess[-1] == 0


def test_errors_of_moves_are_those_that_solve_states(solved: Path) -> None:
    # What is left out, as what is taken again later, makes a long move, over which the Earth turns the unit by a degree.
    names = [table["name"] for table in load(solved).document["position"]]
    assert run(["solve", str(solved), "--latitude=45", *(f"--without={name}" for name in names[4:12])]) == 0
    data, _ = gather(ReportOptions(session=solved))
    assert data.closure is not None
    (reason,) = (reason for reason in data.parameters.calibration.quality.reasons if "closing error" in reason)
    stated_deg = [float(value) for value in re.findall(r"([\d.]+) deg RMS", reason)]
    assert [rms(data.closure.before_deg), rms(data.closure.after_deg)] == pytest.approx(stated_deg, rel=0.02, abs=0.001)
    assert data.closure.after_deg.max() < 5 * stated_deg[1]


def test_the_guide_forecasts_no_less_than_the_result_states(whole_session: Path, solved_session: Path) -> None:
    session = Session.open(whole_session)
    chain = Chain(ReadingPlan.of(session))
    replay_into(chain, session, [])
    assert chain.guide is not None
    forecast, stated = chain.guide.snapshot().forecast, load(solved_session).calibration.accelerometer_sigma
    assert forecast is not None
    # Quadratic terms count as open while measuring; the result has chosen a model without them.
    assert 0.9 < forecast["bias_ug"] / (stated.bias_m_s2.max() / MICRO_G_M_S2) < 2.0
    assert 0.7 < forecast["misalignment_urad"] / (1e6 * stated.misalignment_rad.max()) < 2.0


def test_parameters_alone_make_a_page_and_presets_a_column(solved: Path, tmp_path: Path) -> None:
    file = solved / "parameters.toml"
    pages = ["-o", str(tmp_path / "page.html"), "--record", str(tmp_path / "record.html")]
    assert run(["report", "--parameters", str(file), "--preset", str(file), *pages]) == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<th>preset</th>" in text
    assert "<h3>Stillness</h3>" not in text


def test_two_results_in_one_folder_keep_a_record_each(solved: Path, tmp_path: Path) -> None:
    first, second = (Path(shutil.copy(solved / "parameters.toml", tmp_path / f"{name}.toml")) for name in ("one", "two"))
    pages = {
        *run_report(ReportOptions(parameters=first)),
        *run_report(ReportOptions(parameters=second)),
        *run_report(ReportOptions(parameters=first, output=tmp_path / "a.html")),
        *run_report(ReportOptions(parameters=second, output=tmp_path / "b.html")),
    }
    names = {f"{name}{tail}.html" for name in ("one", "two", "a", "b") for tail in ("", "-record")}
    assert pages == {tmp_path / name for name in names}
    assert {path.name for path in tmp_path.glob("*.html")} == names


@pytest.mark.parametrize(("record", "pdf"), [("page.html", False), ("page.htm", True)])
def test_one_name_for_both_pages_is_refused(solved: Path, tmp_path: Path, record: str, pdf: bool) -> None:
    page = tmp_path / "page.html"
    with refused(UsageError, Reason.USAGE, key="report.one_name"):
        run_report(ReportOptions(parameters=solved / "parameters.toml", output=page, record=tmp_path / record, pdf=pdf))
    assert not page.exists()


def test_verification_gets_into_the_page(solved: Path) -> None:
    assert run(["verify", str(solved / "parameters.toml"), str(solved), "--require", "residual-ug=5000"]) == 0
    report, _ = run_report(ReportOptions(session=solved))
    text = report.read_text(encoding="utf-8")
    assert "<b>PASS</b>" in text
    assert "<h3>Held-out positions</h3>" in text


def test_results_of_other_parameters_are_left_out_and_said(solved: Path) -> None:
    assert run(["verify", str(solved / "parameters.toml"), str(solved), "--require", "residual-ug=5000"]) == 0
    results = solved / "parameters.verification.json"
    results.write_text(results.read_text(encoding="ascii").replace("5000", "5001"), encoding="ascii")
    data, _ = gather(ReportOptions(session=solved))
    assert data.verification is None
    assert "parameters.verification.json" in data.notes[-1]


def test_parameters_of_another_recording_are_refused(solved: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(solved, other)
    part = next(other.glob("part-*.mcap"))
    part.write_bytes(part.read_bytes()[:-4096])
    with refused(ParameterFileError, Reason.FOREIGN, str(other), "SHA-256") as caught:
        gather(ReportOptions(session=other))
    assert caught.value.values == {"parameters": str(other / "parameters.toml"), "session": str(other)}


def test_unwritable_page_is_one_sentence(solved: Path, tmp_path: Path) -> None:
    assert run(["report", str(solved), "-o", str(tmp_path / "nowhere" / "page.html")]) == 5


def test_unsolved_session_is_refused(whole_session: Path) -> None:
    assert run(["report", str(whole_session)]) == 5
