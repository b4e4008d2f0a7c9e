"""The certificate as a page."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from imufield.deliver.certificate.certificate import Certificate, conditions, identification, identity, references, statements
from imufield.deliver.parameters.document import gyroscope_equation
from imufield.deliver.report.budget import BudgetTable, budget_tables
from imufield.deliver.report.page import render
from imufield.deliver.report.rows import GAUGE_WORDS
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_POINT = 0.5  # Width of a decimal point over that of a digit: Helvetica, Arial and their substitutes.


def render_certificate(certificate: Certificate, label: str) -> str:
    """Return the page as one self-contained HTML text, without a label where it is empty.

    Raises
    ------
    UsageError
        If jinja2 is not installed.
    """
    calibration = certificate.parameters.calibration
    tables = budget_tables(certificate.parameters)
    values = {
        "title": f"{certificate.instrument} {certificate.serial_number}",
        "number": certificate.number,
        "claim": sentence("certificate.in_house"),
        "identity": [*identity(certificate)],
        "budget": tables,
        "results": [*_results(tables)],
        "equation": calibration.equation,
        "gyroscope_equation": "" if calibration.gyroscope is None else gyroscope_equation(calibration.gyroscope.parameters),
        "frame": f"{GAUGE_WORDS[calibration.gauge]} (gauge {calibration.gauge})",
        "conditions": [*conditions(certificate)],
        "statements": statements(certificate)[1:],
        "method": sentence("certificate.method"),
        "symbols": sentence("certificate.symbols"),
        "gyroscope_path": "" if calibration.gyroscope is None else calibration.gyroscope.path,
        "references": [*references(certificate)],
        "identification": [*identification(certificate)],
        "label": label,
        "operator": certificate.parties.operator,
    }
    return render("certificate.html", values, "imufield.deliver.certificate")


def _results(tables: Sequence[BudgetTable]) -> Iterator[list[tuple[str, str, tuple[tuple[str, float], ...]]]]:
    """Yield for each kind of parameters the rows: name, unit, and the texts with the space after them, in digits."""
    columns = zip(*(texts for table in tables for _, *texts in table.results), strict=True)
    rows = zip(*(zip(column, after_points(column), strict=True) for column in columns), strict=True)
    for table in tables:
        yield [(f"{table.title} {place}", table.unit, next(rows)) for place in table.places]


def after_points(column: Sequence[str]) -> list[float]:
    """Return the space, in digits, behind each number that puts the decimal points of a column below one another.

    What is no plain number ends the column where it may.
    """
    numbers = [re.fullmatch(r"[+-]?\d+(\.\d+)?", text) for text in column]
    widths = [len(number[1] or "") - (1 - _POINT if number[1] else 0) if number else None for number in numbers]
    widest = max((width for width in widths if width is not None), default=0.0)
    return [0.0 if width is None else widest - width for width in widths]
