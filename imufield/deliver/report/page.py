"""From ``ReportData`` to HTML: the page of a session, and the calibration record on one sheet."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import ModuleType

import numpy as np

from imufield.calibrate.model.result import Calibration
from imufield.dataclass import dataclass
from imufield.deliver.parameters.printed_numbers import acceleration_unit, with_sigma
from imufield.deliver.parameters.schema import Document
from imufield.deliver.parameters.write import content_sha256
from imufield.deliver.report import plots
from imufield.deliver.report.budget import budget_tables, not_in_budget, scale_words
from imufield.deliver.report.correlations import correlations
from imufield.deliver.report.data import ReportData
from imufield.deliver.report.gain import Gain, gain
from imufield.deliver.report.over_temperature import temperature_curves
from imufield.deliver.report.positions import directions, position_cards, with_minus
from imufield.deliver.report.rows import GAUGE_WORDS, VERDICT_WORDS, Row, parameter_rows
from imufield.deliver.report.summary import sigma_words
from imufield.deliver.report.together import HEADINGS, session_rows, together_rows
from imufield.deliver.verification.result import duration_words
from imufield.earth import MICRO_G_M_S2, height_words
from imufield.errors import load_package
from imufield.sentences import Sentences, folded, printable, three_digits

sentence = Sentences(__package__)

UNKNOWN = "not known"
_STRONGEST_SHOWN = 5  # As many as a caption can name.


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A drawing with its words."""

    title: str
    svg: str
    caption: str
    label: str
    """For those who cannot see it."""
    is_detail: bool = False
    """Of the method, not of the result."""


def render_report(data: ReportData) -> str:
    """Return the page as one self-contained HTML text.

    Raises
    ------
    UsageError
        If jinja2 is not installed.
    """
    gained = gain(data.parameters, data.preset)
    figures = list(_figures(data, gained))
    shown = {
        "budget": budget_tables(data.parameters),
        "budget_notes": not_in_budget(data.parameters),
        "figures": [each for each in figures if not each.is_detail],
        "details": [each for each in figures if each.is_detail],
    }
    return render("report.html", _facts(data, gained) | shown)


def render_record(data: ReportData) -> str:
    """Return the calibration record, one sheet of A4; raises as ``render_report``."""
    return render("record.html", _facts(data, gain(data.parameters, data.preset)))


def to_pdf(page: str) -> bytes:
    """Return a page as PDF.

    Raises
    ------
    UsageError
        If WeasyPrint is not installed.
    """
    return bytes(load_weasyprint().HTML(string=page).write_pdf())


def load_weasyprint() -> ModuleType:
    """Return the package; raises as ``to_pdf``."""
    return load_package("weasyprint", "--pdf", "pdf")


def render(template: str, values: Document, package: str = "imufield.deliver.report") -> str:
    """Return a template of a package, which may include those of the report, filled in; raises as ``render_report``."""
    jinja2 = load_package("jinja2", "a page", "report")
    # A name misspelt in a template is an error, and no empty cell; an instrument's name is text, no HTML, and in one order.
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name) for name in (package, "imufield.deliver.report")]),
        autoescape=True,
        finalize=_shown,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return str(environment.get_template(template).render(values))


def _shown(value: object) -> object:
    # What has markup is a drawing of ours.
    return printable(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def _facts(data: ReportData, gained: Gain | None) -> Document:
    parameters = data.parameters
    calibration, context = parameters.calibration, parameters.context
    instrument, quality = context.instrument, calibration.quality
    factor, clock = quality.student_factor_95, [*filter(None, [parameters.clock_note])]
    preset = None if data.preset is None else data.preset.calibration
    verification = data.verification or {}
    rows = parameter_rows(calibration, preset)
    positions, unit = position_cards(parameters)
    return {
        "title": " ".join(filter(None, (instrument.model or instrument.driver or "IMU", instrument.serial_number))),
        "facts_pairs": list(_identity(data)),
        "verdict": quality.verdict,
        "verdict_words": VERDICT_WORDS[quality.verdict],
        "edited": parameters.edited,
        "reasons": [*map(with_minus, folded([*quality.warnings, *clock, *quality.reasons[:1], *data.notes]))],
        "notes": [*map(with_minus, folded(reason for reason in quality.details if reason not in clock))],
        "triads": {"accelerometer": quality.accelerometer_verdict, "gyroscope": quality.gyroscope_verdict},
        "sigma": sigma_words(quality),
        "two_clocks": scale_words(parameters),
        "factor": f"{factor:.2f}" if math.isfinite(factor) else "",
        "gain": "" if gained is None else gained.words,
        "cells": _cells(rows, factor),
        "has_preset": preset is not None,
        "positions": positions,
        "positions_unit": unit,
        "positions_caption": sentence("page.residuals"),
        "quality": list(_quality(calibration)),
        "gyroscope_path": "not calibrated" if calibration.gyroscope is None else calibration.gyroscope.path,
        "frame": f"{GAUGE_WORDS[calibration.gauge]} (gauge {calibration.gauge})",
        "equation": calibration.equation,
        "symbols": sentence("page.symbols") + (sentence("page.symbols_extended") if "h(" in calibration.equation else ""),
        "approximate": sentence("page.approximate") if math.isfinite(factor) and calibration.covariance_names else "",
        "together": [*together_rows(parameters)],
        "together_headings": HEADINGS,
        "sessions": [*session_rows(parameters)],
        "checks": list(_checks(verification)),
        "requirements": _requirements(verification),
        "objections": verification.get("objections", []),
        "failed": verification.get("passed") is False,
        "passed": verification.get("passed"),
        "provenance": [*_provenance(data), *data.provenance],
        # The record is one sheet: the two hashes, not the whole environment.
        "record_provenance": [*_provenance(data), *data.provenance[:2]],
        "operator": data.operator,
    }


def _cells(rows: list[Row], factor_95: float) -> list[dict[str, str]]:
    """Return the table of parameters as text, its numbers in line at the decimal point."""
    values, sigmas = zip(*((*row.shown.partition(" ± ")[::2],) for row in rows), strict=True) if rows else ((), ())
    columns = {
        "value": values,
        "sigma": sigmas,
        "expanded": [row.expanded(factor_95) for row in rows],
        "preset": [row.preset_shown for row in rows],
        "change": [row.change for row in rows],
    }
    aligned = {name: _aligned([*texts]) for name, texts in columns.items()}
    return [
        {"triad": row.triad, "name": row.name, "unit": row.unit, **{name: texts[k] for name, texts in aligned.items()}}
        for k, row in enumerate(rows)
    ]


def _aligned(texts: list[str]) -> list[str]:
    """Return numbers with blanks of the width of a digit, and of a point, where others have decimals."""
    decimals = [len(text.partition(".")[2]) for text in texts]
    most = max(decimals, default=0)
    blank, point = "\u2007", "\u2008"
    return [
        text + point * (most > 0 and count == 0 and text != "") + blank * (most - count)
        for text, count in zip(texts, decimals, strict=True)
    ]


def _identity(data: ReportData) -> Iterator[tuple[str, str]]:
    context, gravity = data.parameters.context, data.parameters.calibration.gravity
    instrument, session = context.instrument, context.session
    yield "Instrument", instrument.model or instrument.driver or UNKNOWN
    yield "Serial number", instrument.serial_number or UNKNOWN
    if instrument.firmware:
        yield "Firmware", instrument.firmware
    yield from (("Measured", _when(context.session.recorded)),) if context.session.recorded else ()
    yield "Solved", _when(context.created)
    if data.operator:
        yield "By", data.operator
    place = UNKNOWN
    if gravity.latitude_deg is not None:
        place = f"latitude {gravity.latitude_deg:g}°, {height_words(gravity)}"
    yield "Place", place
    value = with_sigma(gravity.gravity_m_s2, gravity.sigma_m_s2)
    source: str = gravity.source_words
    if gravity.source == "typed" and gravity.latitude_deg is not None:
        source = sentence("page.gravity_given", source=source)
    yield "Gravity", f"{value} m/s², {source}"
    low, high = session.temperature_degc
    yield "Temperature", f"{low:.1f} to {high:.1f} °C" if math.isfinite(low + high) else UNKNOWN
    yield "Session", session.name or UNKNOWN
    yield "Positions", str(data.parameters.calibration.positions.count)
    if math.isfinite(session.sample_rate_hz):
        yield "Sample rate", f"{session.sample_rate_hz:.3f} Hz"


def _when(moment: str) -> str:
    return moment.replace("T", " ").replace("Z", " UTC")


def _quality(calibration: Calibration) -> Iterator[tuple[str, str]]:
    quality = calibration.quality
    unit, size = acceleration_unit(quality.residual_max_m_s2)
    # Zeros of as many parameters as positions would look like a perfect fit.
    if quality.degrees_of_freedom > 0:
        yield "Residual, RMS", f"{three_digits(quality.residual_rms_m_s2 / size)} {unit}"
        yield "Residual, largest", f"{three_digits(quality.residual_max_m_s2 / size)} {unit}"
    if math.isfinite(quality.leave_one_out_rms_m_s2):
        yield "Leave-one-out, RMS", f"{three_digits(quality.leave_one_out_rms_m_s2 / size)} {unit}"
    yield "Scatter between positions, chosen model", f"{three_digits(quality.between_position_sigma_m_s2 / size)} {unit}"
    yield "Degrees of freedom of the fit", str(quality.degrees_of_freedom)
    if math.isfinite(quality.condition):
        yield "Condition number", f"{quality.condition:.1f}"


def _checks(verification: Document) -> Iterator[tuple[str, str]]:
    """Yield name and outcome of each check on data the parameters have not seen."""
    positions, navigation = (verification.get(key) for key in ("positions", "navigation"))
    if positions:
        sigma = positions["forecast_rms_m_s2"]
        words = f"{three_digits(positions['rms_m_s2'] / MICRO_G_M_S2)} µg RMS"
        if positions["before_rms_m_s2"] is not None:
            words += f", before {three_digits(positions['before_rms_m_s2'] / MICRO_G_M_S2)} µg"
        if sigma is not None:
            words += f"; forecast {three_digits(sigma / MICRO_G_M_S2)} µg: {_forecast_words(positions)}"
        # Files of earlier versions do not say it.
        words = "; ".join(filter(None, (words, positions.get("hidden"))))
        yield f"Held-out positions ({positions['how']})", words
    if navigation:
        drifts = ", ".join(
            f"{name} {three_digits(drift['rate_nmi_per_h'])} nmi/h" for name, drift in navigation["drift"].items()
        )
        forecast = navigation.get("forecast")
        if forecast:
            verdict = "as forecast" if forecast["as_forecast"] else "more than forecast"
            drifts += f"; forecast at most {three_digits(forecast['rate_95_nmi_per_h'])} nmi/h (95 %): {verdict}"
        turned = ", turned over after the alignment" if navigation["turned"] else ""
        yield f"Static navigation, {duration_words(navigation['navigated_s'])}{turned}", drifts


def _forecast_words(positions: Document) -> str:
    """Return whether held-out positions are as forecast; files of earlier versions have no sentence of their own."""
    return str(positions.get("words") or ("as forecast" if positions["as_forecast"] else "larger than forecast"))


def _requirements(verification: Document) -> list[Document]:
    return [
        {
            "name": requirement["name"],
            "limit": f"{requirement['limit']:g}",
            "measured": "not measured" if requirement["measured"] is None else f"{requirement['measured']:.4g}",
            "word": "met" if requirement["passed"] else "NOT MET",
        }
        for requirement in verification.get("requirement", [])
    ]


def _provenance(data: ReportData) -> Iterator[tuple[str, str]]:
    parameters = data.parameters
    solver = parameters.calibration.solver
    yield "Parameters", f"content SHA-256 {content_sha256(parameters.document)}"
    if parameters.context.session.sha256:
        yield "Recording", f"SHA-256 {parameters.context.session.sha256}"
    if data.preset is not None:
        yield "Preset", f"content SHA-256 {content_sha256(data.preset.document)}"
    yield "Solved by", parameters.context.software
    seed = "" if solver.seed is None else f", seed {solver.seed}"
    # Earlier versions wrote down what the library said, which names settings in backquotes.
    how = "" if "`" in solver.message else f": {solver.message}"
    key = "page.method" if solver.converged else "page.method_open"
    yield "Method", sentence(key, method=solver.method, seed=seed, evaluations=solver.evaluations, how=how)


def _figures(data: ReportData, gained: Gain | None) -> Iterator[Figure]:
    tables = data.parameters.document["position"]
    results, names = data.parameters.calibration.positions, tuple(table["name"] for table in tables)
    if gained is not None:
        yield Figure(
            title="Before and after",
            svg=plots.before_and_after(gained),
            caption=sentence("page.before_after"),
            label="Errors by position",
        )
    if tables and data.parameters.calibration.quality.degrees_of_freedom > 0:
        up = directions(data.parameters, np.array([table["mean_raw"] for table in tables], dtype=np.float64))
        svg = plots.sphere_map(up, results.residual_m_s2, names)
        caption = sentence("page.sphere")
        yield Figure(title="Residual on the sphere", svg=svg, caption=caption, label="Map of residuals by direction")
    if data.trace is not None:
        start, duration = (np.array([table[key] for table in tables], dtype=np.float64) for key in ("start_s", "duration_s"))
        svg = plots.stillness(data.trace, start, duration)
        yield Figure(
            title="Stillness", svg=svg, caption=sentence("page.stillness"), label="Stillness over time", is_detail=True
        )
    if data.convergence is not None:
        key = "page.converged" if data.convergence.converged else "page.not_converged"
        caption = sentence(key, method=data.convergence.method)
        yield Figure(
            title="Convergence",
            svg=plots.convergence(data.convergence),
            caption=caption,
            label="Cost over iterations",
            is_detail=True,
        )
    if data.closure is not None and len(data.closure.after_deg):
        caption = sentence("page.closure")
        yield Figure(
            title="Gyroscope closing error",
            svg=plots.closure(data.closure),
            caption=caption,
            label="Closing error of each move",
        )
    for curves in temperature_curves(data.parameters):
        caption = sentence(
            "page.temperature_day" if curves.bias.is_of_new_day else "page.temperature", reference=curves.reference_degc
        )
        name = f"{curves.triad.capitalize()} over temperature"
        svg = plots.over_temperature(curves)
        yield Figure(title=name, svg=svg, caption=caption, label="Bias and scale over temperature")
    found = correlations(data.parameters.calibration)
    if len(found.names) > 1:
        pairs = found.strongest(_STRONGEST_SHOWN)
        strongest = "; ".join(f"{first} and {second} {value:+.2f}" for first, second, value in pairs)
        caption = sentence("page.correlations", least=plots.LEAST_CORRELATION, strongest=strongest)
        yield Figure(
            title="Correlations",
            svg=plots.correlations(found),
            caption=caption,
            label="Correlation of each pair of parameters",
            is_detail=True,
        )
    yield from _check_figures(data.verification or {})


def _check_figures(verification: Document) -> Iterator[Figure]:
    positions, navigation = verification.get("positions"), verification.get("navigation")
    if positions and positions["forecast_rms_m_s2"] is not None and len(positions["name"]) > 1:
        caption = sentence("page.left_out", how=positions["how"], forecast=_forecast_words(positions))
        yield Figure(
            title="Held-out positions", svg=plots.left_out(positions), caption=caption, label="Residuals of held-out positions"
        )
    if navigation:
        caption = sentence("page.navigation_turned" if navigation["turned"] else "page.navigation")
        svg = plots.navigation(navigation)
        yield Figure(title="Static navigation", svg=svg, caption=caption, label="Navigation errors over time")
