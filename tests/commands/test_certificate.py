"""``imufield certificate`` of a solved session."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from imufield.cli.run import run
from imufield.commands.certificate import run_certificate
from imufield.commands.options.result_commands import CertificateOptions
from imufield.deliver.certificate.certificate import Certificate, Parties, statements, verification_statements
from imufield.deliver.parameters.context import ClockFacts
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.write import content_sha256
from imufield.deliver.report.budget import budget_of, budget_tables, scale_words
from imufield.deliver.verification.result import FORMAT, VERSION, write_verification
from imufield.errors import ParameterFileError, Reason
from imufield.sentences import Sentences
from tests.refused import refused
from tests.told import key_of, told

DAY = "1764000000"  # 2025-11-24


def test_files_are_written_beside_the_parameters(solved_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", DAY)
    folder = Path(shutil.copytree(solved_session, tmp_path / "solved"))
    (tmp_path / "imufield.toml").write_text('laboratory = "Our laboratory"\noperator = "A. Person"\n')
    monkeypatch.chdir(tmp_path)
    assert run(["certificate", "solved", "--due-months", "6", "--pdf"]) == 0
    written = {name: (folder / name).read_bytes() for name in sorted(path.name for path in folder.glob("certificate.*"))}
    assert list(written) == ["certificate.html", "certificate.json", "certificate.pdf", "certificate.xml"]
    document = json.loads(written["certificate.json"])
    assert (document["issued"], document["laboratory"], document["operator"]) == ("2025-11-24", "Our laboratory", "A. Person")
    assert written["certificate.pdf"].startswith(b"%PDF")
    assert b"dataBase64" in written["certificate.xml"]
    traced = dict(document["identification"])
    assert "stim300, SHA-256 " in traced["Protocol"]
    assert load(folder).context.session.sha256 in traced["Recording"]
    page = written["certificate.html"].decode()
    assert "Our laboratory" in page
    assert (folder / "label.svg").read_text(encoding="utf-8").strip() in page
    # Nothing in a second one is from the hour it was made.
    run_certificate(
        CertificateOptions(source=folder, output=folder, due_months=6, laboratory="Our laboratory", operator="A. Person")
    )
    assert (folder / "certificate.html").read_bytes() == written["certificate.html"]
    assert (folder / "certificate.json").read_bytes() == written["certificate.json"]


@pytest.mark.parametrize(("sigma", "dominates"), [(1e-7, False), (0.03, True)])
def test_a_time_base_that_dominates_is_said_with_its_remedy(solved_session: Path, sigma: float, dominates: bool) -> None:
    """What a file states of its rate is known to 3 %, and a scale of +114 ppm is then rounded to thousands."""
    parameters = load(solved_session)
    clock = ClockFacts(source="unchecked", sample_period_s=8e-3, sigma=sigma)
    parameters = replace(parameters, context=replace(parameters.context, clock=clock))
    scales = next(table for table in budget_tables(parameters) if table.title.startswith("Gyroscope scale"))
    assert all(float(value) % 1000 == 0 for value in scales.values) is dominates
    said = told(statements(Certificate(parameters=parameters, parties=Parties(), issued="2026-02-01")), "certificate.time_base")
    assert [one.values["sigma_ppm"] for one in said] == ([1e6 * sigma] if dominates else [])


def test_the_budget_of_a_session_is_in_file_and_report(solved_session: Path, tmp_path: Path) -> None:
    parameters = load(solved_session)
    for group in budget_of(parameters):
        for parameter in group.parameters:
            triad, key, place = parameter.name.split(".")
            table = parameters.document[triad]["uncertainty"]
            stated = table["scale_absolute" if parameter.name.startswith("gyroscope.scale") else key]
            for axis in place:
                stated = stated["xyz".index(axis)]
            assert parameter.sigma == pytest.approx(stated, rel=1e-9)
    (gyroscope,) = [group for group in budget_of(parameters) if group.key == "gyroscope.scale"]
    by_clock = [parameter.sigma_by_clock for parameter in gyroscope.parameters]
    assert by_clock == pytest.approx(parameters.document["gyroscope"]["uncertainty"]["scale"], rel=1e-6)
    # Report, record and budget name both.
    figures = scale_words(parameters)
    assert figures is not None
    pages = ["-o", str(tmp_path / "page.html"), "--record", str(tmp_path / "record.html")]
    assert run(["report", "--parameters", str(solved_session / "parameters.toml"), *pages]) == 0
    texts = [unescape((tmp_path / name).read_text(encoding="utf-8")) for name in ("page.html", "record.html")]
    assert "<summary>Uncertainty budget</summary>" in texts[0]
    assert all(figures in text for text in texts)
    # Three entries of a matrix at a time: six are wider than the page.
    tables, printed = budget_tables(parameters), re.findall(r"<th>u\(source\)</th>((?:<th>\w+</th>)+)", texts[0])
    assert max(row.count("<th>") for row in printed) == 3
    assert sum(row.count("<th>") for row in printed) == sum(len(table.places) for table in tables)
    assert any(len(table.places) == 6 for table in tables)
    (table,) = [table for table in tables if table.title == "Gyroscope scale"]
    own, true = table.sums[:2]
    assert max(own[1:], key=float) == figures.values["by_clock"]
    assert max(true[1:], key=float) == figures.values["true"]


def verified(folder: Path, capsys: pytest.CaptureFixture[Any], *limits: str) -> tuple[list[str], str]:
    """Verify and issue a certificate; return its statements, and what is printed beside."""
    run(["verify", str(folder / "parameters.toml"), str(folder), *limits])
    capsys.readouterr()
    assert run(["certificate", str(folder)]) == 0
    document = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    for name in ("certificate.html", "certificate.xml"):
        text = unescape((folder / name).read_text(encoding="utf-8")).lower()
        assert all(statement.lower() in text for statement in document["statements"] if "requirement" in statement.lower())
    return document["statements"], " ".join(capsys.readouterr().err.split())


def test_a_requirement_is_stated_with_its_outcome(
    solved_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[Any]
) -> None:
    """The same words as the report has: whoever sees the verdict alone takes a failed calibration for a good one."""
    folder = Path(shutil.copytree(solved_session, tmp_path / "solved"))
    stated = Sentences("imufield.deliver.certificate")
    said, _ = verified(folder, capsys)
    assert not [one for one in said if "requirement" in one.lower()]
    for limit, outcome in ((0.5, "not_met"), (5000.0, "met")):
        said, printed = verified(folder, capsys, "--require", f"residual-ug={limit}")
        (kept,) = json.loads((folder / "parameters.verification.json").read_text(encoding="utf-8"))["requirement"]
        assert kept["passed"] is (outcome == "met")
        told_so = stated(f"requirement.{outcome}", name="residual-ug", limit=limit, measured=kept["measured"])
        assert told_so in said
        assert told_so in printed
    # One that was not measured has failed as well.
    said, _ = verified(folder, capsys, "--require", "nav-nmi-per-h=1", "--latitude", "48")
    assert stated("requirement.not_measured", name="nav-nmi-per-h", limit=1.0, measured=None) in said
    # Of results that somebody changed nothing is believed.
    results = folder / "parameters.verification.json"
    results.write_text(results.read_text(encoding="utf-8").replace("false", "true"), encoding="utf-8")
    assert run(["certificate", str(folder)]) == 0
    said = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))["statements"]
    assert Sentences("imufield.deliver.verification")("result.left_out", name=results.name) in said


def test_an_objection_is_stated(solved_session: Path, tmp_path: Path) -> None:
    """Of parameters that the session does not give, whatever is required."""
    results = tmp_path / "parameters.verification.json"
    parameters = load(solved_session)
    sha256 = content_sha256(parameters.document)
    content = {
        "format": FORMAT,
        "version": VERSION,
        "parameters_sha256": sha256,
        "passed": False,
        "objections": ["solve again"],
    }
    write_verification(results, content | {"requirement": []})
    (said,) = verification_statements(results, sha256)
    assert key_of(said) == "requirement.objection"
    assert "solve again" in said


def test_a_file_alone_has_a_certificate_without_the_protocol(solved_session: Path, tmp_path: Path) -> None:
    file = Path(shutil.copy(solved_session / "parameters.toml", tmp_path / "mine.toml"))
    paths = run_certificate(CertificateOptions(source=file))
    assert {path.parent for path in paths} == {tmp_path}
    document = json.loads((tmp_path / "certificate.json").read_text(encoding="utf-8"))
    assert dict(document["identification"])["Protocol"] == "not known"


def test_parameters_of_another_recording_are_refused(solved_session: Path, short_solved: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(short_solved, tmp_path / "other"))
    shutil.copy(solved_session / "parameters.toml", folder)
    with refused(ParameterFileError, Reason.FOREIGN, key="certificate.other_recording"):
        run_certificate(CertificateOptions(source=folder))
    # Named by itself it is a file that somebody put there.
    run_certificate(CertificateOptions(source=folder / "parameters.toml", output=tmp_path))


def test_without_its_package_there_is_no_label_and_it_is_said(
    solved_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[Any]
) -> None:
    monkeypatch.setitem(sys.modules, "segno", None)
    paths = run_certificate(CertificateOptions(source=solved_session, output=tmp_path))
    assert {path.name for path in paths} == {"certificate.html", "certificate.json", "certificate.xml"}
    assert "segno" in capsys.readouterr().err
