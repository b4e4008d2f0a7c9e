"""The certificate: its XML as documented, its label, dates, and texts of somebody else in all of them."""

from __future__ import annotations

import base64
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from imufield.calibrate.model.budget import Share
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.certificate.certificate import Certificate, Parties, conditions, issue_date, references, to_json
from imufield.deliver.certificate.dcc import DCC, SI, to_xml, unit_of, unit_words
from imufield.deliver.certificate.label import label_svg, label_text
from imufield.deliver.certificate.page import render_certificate
from imufield.deliver.parameters.consistency import contradiction
from imufield.deliver.parameters.context import ClockFacts, Context, InstrumentFacts, SessionFacts
from imufield.deliver.parameters.file import Parameters, from_document, load, to_document
from imufield.deliver.parameters.printed_numbers import rounded
from imufield.deliver.parameters.schema import json_ready
from imufield.deliver.report.budget import budget_of, budget_tables, not_in_budget, short
from imufield.deliver.report.rows import parameter_rows
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import Reason, UsageError
from imufield.sentences import Sentences
from tests.deliver.certificate.qr import Modules, decoded
from tests.refused import refused
from tests.told import key_of

HOSTILE = '<script>alert(1)</script>&]]>"\x1b[2J\u202e\x00'


def parameters_of(calibration: Calibration, observations: Observations, **instrument: str) -> Parameters:
    context = Context(
        instrument=InstrumentFacts(**{"model": "STIM300", "serial_number": "N1", **instrument}),
        session=SessionFacts(
            name="one", sha256=64 * "a", sample_rate_hz=125.0, temperature_degc=(20.5, 22.0), recorded="2026-01-31T10:00:00Z"
        ),
        clock=ClockFacts(source="host", sample_period_s=8e-3, sigma=5e-5),
    )
    return from_document(to_document(calibration, observations, context))


@pytest.fixture
def solved(calibration: Calibration, observations: Observations) -> Parameters:
    return parameters_of(calibration, observations)


def certified(parameters: Parameters, due_months: int | None = None, **parties: str) -> Certificate:
    return Certificate(parameters=parameters, parties=Parties(**parties), issued="2026-02-01", due_months=due_months)


def parsed(text: str | bytes) -> ET.Element:
    return ET.fromstring(text)  # noqa: S314 - written by the program under test


def names(element: ET.Element) -> list[str]:
    return [child.tag.partition("}")[2] for child in element]


def found(root: ET.Element, path: str) -> ET.Element:
    element = root.find(path, {"dcc": DCC, "si": SI})
    assert element is not None, path
    return element


def test_the_xml_has_the_documented_structure(solved: Parameters) -> None:
    certificate = certified(solved, 12, laboratory="Lab", customer="Who asked", operator="J. Doe")
    root = parsed(to_xml(certificate, b"%PDF-1.7 made up"))
    assert root.tag == f"{{{DCC}}}digitalCalibrationCertificate"
    assert root.get("schemaVersion") == "3.2.0"
    assert names(root) == ["administrativeData", "measurementResults", "document"]
    administrative = ["dccSoftware", "coreData", "items", "calibrationLaboratory", "respPersons", "customer", "statements"]
    assert names(root[0]) == administrative
    result = found(root, "dcc:measurementResults/dcc:measurementResult")
    assert names(result) == ["name", "usedMethods", "measuringEquipments", "influenceConditions", "results"]
    core = {child.tag.partition("}")[2]: child.text for child in found(root, "dcc:administrativeData/dcc:coreData")}
    assert core["uniqueIdentifier"] == certificate.number
    assert (core["beginPerformanceDate"], core["issueDate"]) == ("2026-01-31", "2026-02-01")
    assert base64.b64decode(found(root, "dcc:document/dcc:dataBase64").text or "") == b"%PDF-1.7 made up"
    assert names(parsed(to_xml(certificate))) == ["administrativeData", "measurementResults"]
    texts = [element.text or "" for element in found(root, "dcc:administrativeData/dcc:statements").iter()]
    sentence = Sentences("imufield.deliver.certificate")
    assert {sentence("certificate.in_house"), sentence("certificate.not_validated")} <= {*texts}


def test_lists_are_as_long_as_their_names_and_in_si(solved: Parameters) -> None:
    root = parsed(to_xml(certified(solved)))
    *quantities, _ = root.iter(f"{{{DCC}}}quantity")
    groups = budget_of(solved)
    assert len(quantities) == len(groups) > 3
    for quantity, group in zip(quantities, groups, strict=True):
        title = found(quantity, "dcc:name/dcc:content").text or ""
        places = title.partition(": ")[2].split()
        assert places == [parameter.place for parameter in group.parameters]
        numbers = found(quantity, "si:realListXMLList")
        assert names(numbers) == ["valueXMLList", "unitXMLList", "expandedUncXMLList"]
        assert names(numbers[2]) == ["uncertaintyXMLList", "coverageFactorXMLList", "coverageProbabilityXMLList"]
        values, uncertainties, factors = (
            [float(text) for text in (element.text or "").split()] for element in (numbers[0], numbers[2][0], numbers[2][1])
        )
        assert len(values) == len(uncertainties) == len(factors) == len(places)
        # The raw units of the fixture are SI.
        assert values == [parameter.value for parameter in group.parameters]
        assert uncertainties == [parameter.expanded for parameter in group.parameters]
        assert all(1.95 < factor < 4 for factor in factors)
        assert numbers[2][2].text == "0.95"


@pytest.mark.parametrize(
    ("key", "raw_unit", "unit", "size"),
    [
        ("accelerometer.bias_m_s2", "count", r"\metre\second\tothe{-2}", 1.0),
        ("accelerometer.misalignment_rad", "count", r"\radian", 1.0),
        ("accelerometer.scale", "m/s^2", r"\one", 1.0),
        ("accelerometer.scale", "g", r"\one", STANDARD_GRAVITY_M_S2),
        ("accelerometer.scale", "count", r"\metre\tothe{-1}\second\tothe{2}", 1.0),
        ("accelerometer.quadratic", "m/s^2", r"\metre\tothe{-1}\second\tothe{2}", 1.0),
        ("gyroscope.bias", "rad/s", r"\radian\second\tothe{-1}", 1.0),
        ("gyroscope.scale", "count/s", r"\radian\tothe{-1}", 1.0),
        ("gyroscope.g_sensitivity", "rad/s", r"\radian\second\metre\tothe{-1}", 1.0),
    ],
)
def test_units_are_powers_of_si(key: str, raw_unit: str, unit: str, size: float) -> None:
    exponents, found_size = unit_of(key, raw_unit)
    assert (unit_words(exponents), found_size) == (unit, size)


def test_texts_of_somebody_else_are_texts(calibration: Calibration, observations: Observations) -> None:
    hostile = parameters_of(calibration, observations, serial_number=HOSTILE, model=HOSTILE + "\ufffe\ud800")
    certificate = certified(hostile, 1, laboratory=HOSTILE, customer=HOSTILE, operator=HOSTILE)
    text = to_xml(certificate)
    root = parsed(text)
    assert b"<!" not in text
    serial = found(root, ".//dcc:item/dcc:identifications/dcc:identification/dcc:value").text or ""
    assert serial.startswith("<script>alert(1)</script>&]]>")
    label = label_svg(certificate)
    parsed(label)
    page = render_certificate(certificate, label)
    for shown in (label, page):
        assert "<script" not in shown
        assert not re.search("[\x00\x1b\u202e]", shown)
    json.loads(json.dumps(to_json(certificate), allow_nan=False))


@pytest.mark.parametrize("serial_number", ["\ufffe1\uffff", 10_000 * "7", 10_000 * "\U0001f600"])
def test_a_label_holds_any_serial_number(calibration: Calibration, observations: Observations, serial_number: str) -> None:
    certificate = certified(parameters_of(calibration, observations, serial_number=serial_number), 12)
    assert len(parsed(label_svg(certificate)).findall(".//{*}text")) == 5
    assert certificate.short_sha256 in label_text(certificate)


def test_a_page_names_the_reference_once_and_nobody_unknown(calibration: Calibration, observations: Observations) -> None:
    known = parameters_of(calibration, observations)
    session = replace(known.context.session, temperature_degc=(math.nan, math.nan))
    unknown = replace(known, context=replace(known.context, session=session))
    for parameters, rows in ((known, 2), (unknown, 1)):
        certificate = certified(parameters)
        document = to_json(certificate)
        stated = {name.key: value for name, value in references(certificate)}
        assert [*stated] == ["references.gravity", "references.time_base"]
        assert document["reference"][1][1] == stated["references.time_base"]
        assert stated["references.time_base"].values["sigma_ppm"] == pytest.approx(50)
        keys = [name.key for name, _ in conditions(certificate)]
        assert [*document["conditions"]] == [name for name, _ in conditions(certificate)]
        assert sum("temperature" in key for key in keys) == rows
        page = render_certificate(certificate, "")
        assert "<dt>Customer</dt>" not in page
        assert "Approved by" in page
        assert calibration.equation in page
    assert "<dt>Customer</dt><dd>Who asked</dd>" in render_certificate(certified(known, customer="Who asked"), "")


def test_a_sensitivity_has_a_unit_where_its_source_is_one_quantity(solved: Parameters) -> None:
    for table in budget_tables(solved):
        for row in table.rows:
            assert bool(row.sensitivity_unit) is bool(row.source) is any(sensitivity for _, sensitivity in row.cells)
            unit = row.source.partition(" ")[2].replace("µg", "mg")
            assert row.sensitivity_unit == (f"{table.unit} per {unit}" if unit else "")


def drawn_code(certificate: Certificate) -> Modules:
    """Return the code as it is drawn, with its quiet zone."""
    svg = parsed(label_svg(certificate)).find("{*}svg")
    assert svg is not None
    size = int((svg.get("viewBox") or "").split()[2])
    dark = np.zeros((size, size), dtype=np.bool_)
    for x, y, width in re.findall(r"M(\d+) (\d+)h(\d+)v1h-\d+z", svg[0].get("d") or ""):
        dark[int(y), int(x) : int(x) + int(width)] = True
    return dark


@pytest.mark.parametrize("serial_number", ["N1", "N-2025/0012345678 rev. C", "Gerät 7", "計測 7", ""])
@pytest.mark.parametrize("due_months", [None, 12])
def test_the_code_of_the_label_reads_as_its_text(
    calibration: Calibration, observations: Observations, serial_number: str, due_months: int | None
) -> None:
    certificate = certified(parameters_of(calibration, observations, serial_number=serial_number), due_months)
    dark = drawn_code(certificate)
    assert not dark[[0, 1, 2, 3, -4, -3, -2, -1]].any()
    assert not dark[:, [0, 1, 2, 3, -4, -3, -2, -1]].any()
    code = dark[4:-4, 4:-4]
    due = "" if due_months is None else " due=2027-01-31"
    known = f"serial={serial_number or 'not known'} calibrated=2026-01-31{due} sha256={certificate.sha256[:12]}"
    assert decoded(code) == label_text(certificate) == f"imufield {known}"
    # The reader passes nothing over.
    code[12, 12] ^= True
    with pytest.raises(AssertionError):
        decoded(code)


@pytest.mark.parametrize(
    ("months", "due"), [(1, "2026-02-28"), (12, "2027-01-31"), (25, "2028-02-29"), (11, "2026-12-31"), (None, "")]
)
def test_a_due_day_is_one_that_the_month_has(solved: Parameters, months: int | None, due: str) -> None:
    assert certified(solved, months).due == due


def test_a_day_that_is_none_has_no_due_day(solved: Parameters) -> None:
    session = replace(solved.context.session, recorded="2026-13-45T00:00:00Z")
    never = replace(solved, context=replace(solved.context, session=session))
    assert certified(never, 12).due == ""


def test_the_day_of_issue_is_the_one_that_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1764000000")
    assert issue_date() == "2025-11-24"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with refused(UsageError, Reason.USAGE, key="files.source_date"):
        issue_date()


def test_a_file_without_covariance_gives_the_reason_and_no_empty_section() -> None:
    parameters = load(Path(__file__).resolve().parents[3] / "docs" / "exports" / "example.toml")
    page = render_certificate(certified(parameters), "")
    assert "This file has no [covariance]" in page
    assert "<h2>Results" not in page
    assert "Uncertainty budget" not in page


def test_a_file_without_shares_has_gravity_s_and_the_rest(solved: Parameters) -> None:
    assert not solved.calibration.budget
    C, names = solved.calibration.covariance, solved.calibration.covariance_names
    for group in budget_of(solved):
        for parameter in group.parameters:
            row = names.index(parameter.name)
            # The time base stands beside the covariance.
            own = [entry.sigma**2 for entry in parameter.entries if entry.share.name != "time_base"]
            assert sum(own) == pytest.approx(C[row, row], rel=1e-9)
    assert not_in_budget(solved)[0].key == "budget.not_apart"


def test_the_json_has_every_share_with_type_freedom_and_sensitivity(solved: Parameters) -> None:
    document = json.loads(json.dumps(to_json(certified(solved)), allow_nan=False))
    assert document["accredited"] is False
    for parameter in document["budget"]:
        total = math.fsum(share["contribution"] ** 2 for share in parameter["share"])
        assert math.sqrt(total) == pytest.approx(parameter["standard_uncertainty"], rel=1e-9)
        expanded = parameter["coverage_factor"] * parameter["standard_uncertainty"]
        assert parameter["expanded_uncertainty"] == pytest.approx(expanded, rel=1e-12)
        for share in parameter["share"]:
            assert share["type"] in ("A", "B")
            if share["sensitivity"] is not None:
                assert share["sensitivity"] * share["input_uncertainty"] == pytest.approx(share["contribution"], rel=1e-9)


def test_tables_name_each_share(solved: Parameters) -> None:
    for table, group in zip(budget_tables(solved), budget_of(solved), strict=True):
        assert len(table.rows) == len(group.shares)
        assert [key_of(row.words) for row in table.rows] == [f"shares.{share.name}" for share in group.shares]
        assert len(table.results) == len(group.parameters)
        # The values stand in another table, of the certificate or the report, rounded as there.
        assert key_of(table.sums[-1][0]) == "budget.expanded"


def test_a_number_has_one_uncertainty_wherever_it_stands(calibration: Calibration, observations: Observations) -> None:
    """A bias as a rate is e / K: what is not known of K is in it."""
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    both = np.diag([*np.diag(calibration.covariance), *(0.02 * gyroscope.parameters.scale) ** 2])
    both[: len(calibration.covariance), : len(calibration.covariance)] = calibration.covariance
    turned = replace(
        calibration,
        covariance_names=(*calibration.covariance_names, *(f"gyroscope.scale.{axis}" for axis in "xyz")),
        covariance=both,
        gyroscope=replace(gyroscope, sigma=replace(gyroscope.sigma, scale=0.02 * gyroscope.parameters.scale)),
    )
    parameters = parameters_of(turned, observations)
    tables, rows = {key_of(table.title): table for table in budget_tables(parameters)}, parameter_rows(turned, None)
    for title, triad, name in (
        ("titles.gyroscope_bias", "Gyroscope", "bias"),
        ("titles.gyroscope_scale", "Gyroscope", "scale error"),
        ("titles.accelerometer_scale", "Accelerometer", "scale error"),
    ):
        of_title = [row for row in rows if row.triad == triad and row.name.startswith(f"{name} ")]
        sums = {key_of(words): texts for words, *texts in tables[title].sums}
        # The table of the parameters is for the clock of the samples.
        own = sums.get("budget.combined_by_clock") or sums["budget.combined"]
        assert own == [short(row.sigma) for row in of_title]
        values = [rounded(row.value, float(U), sign=True) for row, U in zip(of_title, [*sums.values()][-1], strict=True)]
        assert [value for _, value, *_ in tables[title].results] == values


def test_a_scale_that_only_the_maker_knows_has_its_own_unit(calibration: Calibration, observations: Observations) -> None:
    counts = replace(calibration, accelerometer_raw_unit="count")
    by_title = {key_of(table.title): table for table in budget_tables(parameters_of(counts, observations))}
    assert by_title["titles.accelerometer_scale"].results[0][1].endswith(" count per m/s²")
    by_title = {key_of(table.title): table for table in budget_tables(parameters_of(calibration, observations))}
    assert by_title["titles.accelerometer_scale"].results[0][1] == "+120"  # of 1.000123456789, U = 110 ppm


def test_shares_survive_the_file_and_add_up(solved: Parameters, observations: Observations) -> None:
    calibration = solved.calibration
    sigma = np.sqrt(np.diag(calibration.covariance))
    shares = (
        Share(
            name="within_hold",
            kind="A",
            residuals="one",
            degrees_of_freedom=7.5,
            input_sigma=2e-4,
            input_unit="m",
            sigma=0.6 * sigma,
        ),
        Share(name="gravity", kind="B", sigma=0.8 * sigma),
    )
    document = to_document(replace(calibration, budget=shares), observations, solved.context)
    again = from_document(json_ready(document)).calibration.budget
    assert [(share.name, share.kind, share.residuals) for share in again] == [("within_hold", "A", "one"), ("gravity", "B", "")]
    assert [share.degrees_of_freedom for share in again] == [7.5, math.inf]
    assert again[0].input_sigma == 2e-4
    assert np.isnan(again[1].input_sigma)
    np.testing.assert_array_equal(again[0].sigma, shares[0].sigma)
    assert key_of(contradiction(document)) != "consistency.budget"
    document["budget"]["share"][0]["sigma"][0] *= 1.1
    # Also where a person says "edited": what follows from a value must be changed with it.
    for is_edited in (False, True):
        assert key_of(contradiction(document, is_edited=is_edited)) == "consistency.budget"
    document["budget"]["share"][0]["sigma"][0] = math.nan
    assert key_of(contradiction(document)) == "consistency.budget"
    document["budget"]["share"][0]["sigma"].pop()
    assert key_of(contradiction(document)) == "consistency.budget_size"
