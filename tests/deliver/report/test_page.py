"""The pages: complete, self-contained, valid, and honest about what is missing."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.parameters.context import Context, InstrumentFacts
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.report.data import Closure, Convergence, ReportData
from imufield.deliver.report.page import render_record, render_report, to_pdf
from imufield.deliver.report.plots import label_offsets, sphere_map
from imufield.deliver.report.rows import Row, parameter_rows
from imufield.deliver.report.stillness_trace import Trace
from imufield.errors import Reason, UsageError
from tests.refused import refused

VOID = {"meta", "link", "br"}
MIB = 2**20


class Page(HTMLParser):
    """Checks nesting, and collects ids, addresses and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "action"):
                self.addresses.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text.append(data)


@pytest.fixture
def loaded(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    return from_document(to_document(calibration, observations, context))


@pytest.fixture
def data(loaded: Parameters) -> ReportData:
    time_s = np.arange(0, 400, 0.5)
    moves = np.arange(10.0, 300.0, 14.0)
    curve = Convergence(method="bsas", excess=np.logspace(1, -8, 49), evaluations=1000, converged=True)
    return ReportData(
        parameters=loaded,
        preset=loaded,
        trace=Trace(time_s, np.full(len(time_s), 1e-3), np.full(len(time_s), np.nan)),
        closure=Closure(moves, np.full(len(moves), 0.2), np.full(len(moves), 0.02)),
        convergence=curve,
        verification=None,
        provenance=(("Parameter file", "parameters.toml"),),
        operator="A. Person",
    )


def test_page_is_self_contained_and_well_formed(data: ReportData) -> None:
    text = render_report(data)
    page = Page(text)
    assert [one for one in page.addresses if not one.startswith(("#", "data:,"))] == []
    assert "url(http" not in text
    assert "@import" not in text
    assert "<script" not in text
    assert len(page.ids) == len(set(page.ids))
    assert {one[1:] for one in page.addresses if one.startswith("#")} <= set(page.ids)
    assert len(text) < 3 * MIB


def test_a_height_that_is_not_known_is_not_zero(data: ReportData) -> None:
    calibration = data.parameters.calibration
    gravity = replace(calibration.gravity, height_m=None)
    unknown = replace(data, parameters=replace(data.parameters, calibration=replace(calibration, gravity=gravity)))
    assert "latitude 48.1°" in " ".join(Page(render_report(unknown)).text)


def test_page_says_who_when_where_and_how_good(data: ReportData) -> None:
    words = " ".join(Page(render_report(data)).text)
    for expected in (
        "N25581234567890",
        "2025-03-01 10:55:00 UTC",
        "latitude 48.1°",
        "30.9 to 33.4 °C",
        "A. Person",
        "fit for use",
    ):
        assert expected in words
    for title in ("Residual on the sphere", "Correlations", "Stillness", "Convergence", "Gyroscope closing error"):
        assert title in words
    assert "a" * 64 in words


def test_names_cannot_break_out_of_the_page(data: ReportData, calibration: Calibration, observations: Observations) -> None:
    evil = '<script>alert("x")</script>&'
    context = Context(instrument=InstrumentFacts(driver="d", model=evil, serial_number=evil))
    named = replace(observations, name=tuple(f"{evil}{k}" for k in range(len(observations))))
    parameters = from_document(to_document(calibration, named, context))
    text = render_report(replace(data, parameters=parameters, operator=evil))
    Page(text)
    assert "<script" not in text
    assert "<script" not in render_record(replace(data, parameters=parameters, operator=evil))


def test_least_of_all_is_still_a_page(loaded: Parameters) -> None:
    page = Page(render_report(ReportData(parameters=loaded)))
    words = " ".join(page.text)
    assert "Stillness" not in words
    assert "preset" not in words.split("Parameters")[1][:200]


def test_without_a_position_to_spare_nothing_is_claimed(data: ReportData) -> None:
    calibration = data.parameters.calibration
    quality = replace(calibration.quality, degrees_of_freedom=0, residual_rms_m_s2=1e-18, residual_max_m_s2=1e-18)
    few = replace(data, parameters=replace(data.parameters, calibration=replace(calibration, quality=quality)))
    words = " ".join(Page(render_report(few)).text)
    for title in ("Error at rest", "Before and after", "Residual on the sphere", "Residual, RMS"):
        assert title not in words
    assert words.index("Residual by position") < words.index("Who, when, where") < words.index("Gyroscope closing error")
    assert not re.search(r"\de-\d", words[words.index("How good it is") : words.index("Details of the method")])


def test_verification_is_shown(data: ReportData) -> None:
    positions = {
        "how": "2 positions of another session",
        "rms_m_s2": 4e-4,
        "before_rms_m_s2": None,
        "forecast_rms_m_s2": 5e-4,
        "as_forecast": True,
        "name": ["a", "b"],
        "residual_m_s2": [4e-4, -4e-4],
        "before_m_s2": [None, None],
        "sigma_m_s2": [5e-4, 5e-4],
    }
    curves = {key: [0.0, 1.0] for key in ("time_s", "latitude_deg", "longitude_deg", "north_velocity_m_s", "east_velocity_m_s")}
    drift = {"rate_nmi_per_h": 0.4, "position_nmi": [0.0, 1.0], **curves}
    navigation = {"turned": True, "navigated_s": 3600.0, "drift": {"before": drift, "after": drift}}
    requirement = [{"name": "residual-ug", "limit": 50.0, "measured": 41.0, "passed": True}]
    verification = {"positions": positions, "navigation": navigation, "passed": True, "requirement": requirement}
    words = " ".join(Page(render_report(replace(data, verification=verification))).text)
    assert "PASS" in words
    assert "40.8 µg RMS" in words
    assert "51 µg" in words
    assert "turned over" in words
    assert "PASS" in " ".join(Page(render_record(replace(data, verification=verification))).text)


def test_an_objection_leads_where_every_requirement_is_met(data: ReportData) -> None:
    requirement = [{"name": "residual-ug", "limit": 50.0, "measured": 41.0, "passed": True}]
    objections = ["the file says itself that bas did not converge"]
    verified = replace(data, verification={"passed": False, "requirement": requirement, "objections": objections})
    for text in (render_report(verified), render_record(verified)):
        words = " ".join(" ".join(Page(text).text).split())
        assert f"fail : {objections[0]}; residual-ug 41 (limit 50), met" in words
        assert "PASS" not in words
        assert "not every requirement" not in words
    alone = replace(data, verification={"passed": False, "requirement": [], "objections": objections})
    assert f"fail : {objections[0]}" in " ".join(" ".join(Page(render_report(alone)).text).split())


def test_a_requirement_that_is_not_met_leads(data: ReportData) -> None:
    requirement = [{"name": "residual-ug", "limit": 50.0, "measured": 133.7, "passed": False}]
    verified = replace(data, verification={"passed": False, "requirement": requirement})
    for text in (render_report(verified), render_record(verified)):
        words = " ".join(" ".join(Page(text).text).split())
        assert words.index("fail : residual-ug 133.7 (limit 50), NOT MET") < words.lower().index("quality of the fit: ")
        assert "fit for use" not in words


def test_held_out_caption_says_what_the_test_found(data: ReportData) -> None:
    figures = {"name": ["a", "b"], "residual_m_s2": [4e-4, -4e-4], "before_m_s2": [None, None], "sigma_m_s2": [5e-4, 5e-4]}
    found = {"how": "2 positions of another session", "rms_m_s2": 4e-4, "before_rms_m_s2": None, "forecast_rms_m_s2": 5e-4}
    words = "larger than forecast, by chance so large in 1 of 50 sound checks"
    positions = {**figures, **found, "as_forecast": False, "words": words}
    assert render_report(replace(data, verification={"positions": positions})).count(words) == 2
    hidden = "1 position cannot show an error on x"
    assert hidden in render_report(replace(data, verification={"positions": positions | {"hidden": hidden}}))


def test_provenance_speaks_our_words(data: ReportData) -> None:
    solver = replace(data.parameters.calibration.solver, message="`ftol` termination condition is satisfied.", evaluations=25)
    calibration = replace(data.parameters.calibration, solver=solver)
    words = " ".join(Page(render_report(replace(data, parameters=replace(data.parameters, calibration=calibration)))).text)
    assert "25 evaluations" in words
    assert "ftol" not in words


def test_names_on_the_sphere_cover_neither_marks_nor_each_other() -> None:
    place = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, -1.0], [80.0, 0.0], [80.5, 1.0]])
    radius = np.array([8.0, 6.0, 5.0, 4.0, 4.0])
    names = {0: "z+180", 1: "x+270", 2: "y+270", 3: "y+270", 4: "x+180"}
    offsets = label_offsets(place, radius, names)
    half = np.array([0.29 * 5, 0.6]) * 7.5
    boxes = [(place[row] + offset - half, place[row] + offset + half) for row, offset in offsets.items()]
    boxes += [(at - one, at + one) for at, one in zip(place, radius, strict=True)]
    for k in range(len(offsets)):
        for other in range(k):
            assert np.any(np.maximum(boxes[k][0], boxes[other][0]) >= np.minimum(boxes[k][1], boxes[other][1]))
        for mark in boxes[len(offsets) :]:
            assert np.any(np.maximum(boxes[k][0], mark[0]) >= np.minimum(boxes[k][1], mark[1]))


def test_a_position_without_residual_is_not_on_the_map() -> None:
    drawn = sphere_map(np.eye(3), np.array([1e-3, np.nan, -1e-3]), ("one", "two", "three"))
    assert drawn.count("<circle") == 2
    assert "nan" not in drawn
    assert [name for name in ("one", "two", "three") if f">{name}<" in drawn] == ["one", "three"]


def test_record_has_all_parameters_and_lines_to_sign(data: ReportData) -> None:
    words = " ".join(Page(render_record(data)).text)
    for row in parameter_rows(data.parameters.calibration, None):
        value, _, sigma = row.shown.partition(" ± ")
        assert re.search(rf"{re.escape(row.name)}\s+{re.escape(row.unit)}\s+{re.escape(value)}\s+{re.escape(sigma)}\s", words)
    for expected in ("Approved by", "A. Person", "a" * 64):
        assert expected in words


def test_the_same_data_give_the_same_page(data: ReportData) -> None:
    assert render_report(data) == render_report(data)


def test_missing_package_is_named(data: ReportData, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with refused(UsageError, Reason.MISSING_PACKAGE, "pip install '.[report]'", key="errors.missing_package") as caught:
        render_report(data)
    assert caught.value.values["package"] == "jinja2"
    assert caught.value.reason is Reason.MISSING_PACKAGE


def test_rows_show_value_interval_preset_and_change() -> None:
    row = Row(triad="Accelerometer", name="bias x", unit="mg", value=1.2345, sigma=0.021, preset=1.3)
    assert (row.shown, row.expanded(2.18), row.preset_shown, row.change) == ("+1.234 ± 0.021", "0.046", "+1.300", "-3.1")
    fixed = Row(triad="Accelerometer", name="bias x", unit="mg", value=1.2345, sigma=0.0, preset=float("nan"))
    assert (fixed.expanded(2.0), fixed.preset_shown, fixed.change) == ("", "", "")


def test_rows_leave_out_what_the_gauge_fixes(calibration: Calibration) -> None:
    names = [row.name for row in parameter_rows(calibration, None) if row.triad == "Accelerometer"]
    assert "misalignment xy" not in names
    assert {"misalignment yx", "misalignment zx", "misalignment zy", "quadratic x"} <= set(names)


def test_a_page_becomes_a_pdf_of_sheets(data: ReportData) -> None:
    try:
        import weasyprint
    except OSError as error:
        pytest.skip(f"install Pango, which makes PDF: {error}")
    record = render_record(data)
    assert to_pdf(record).startswith(b"%PDF-")
    assert len(weasyprint.HTML(string=record).render().pages) == 1


@pytest.mark.parametrize(("error", "key"), [(ModuleNotFoundError, "missing_package"), (OSError, "broken_package")])
def test_what_pdf_needs_is_named(monkeypatch: pytest.MonkeyPatch, error: type[Exception], key: str) -> None:
    def missing(name: str) -> None:
        raise error(name)

    monkeypatch.setattr("importlib.import_module", missing)
    with refused(UsageError, Reason.MISSING_PACKAGE, "pip install '.[pdf]'", "weasyprint", key=f"errors.{key}"):
        to_pdf("")
