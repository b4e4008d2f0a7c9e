"""The certificate as a page."""

from __future__ import annotations

from imufield.deliver.certificate.certificate import Certificate, conditions, identification, identity, references, statements
from imufield.deliver.parameters.document import GYROSCOPE_EQUATION
from imufield.deliver.report.budget import budget_tables
from imufield.deliver.report.page import render
from imufield.deliver.report.rows import GAUGE_WORDS
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def render_certificate(certificate: Certificate, label: str) -> str:
    """Return the page as one self-contained HTML text, without a label where it is empty.

    Raises
    ------
    UsageError
        If jinja2 is not installed.
    """
    calibration = certificate.parameters.calibration
    values = {
        "title": f"{certificate.instrument} {certificate.serial_number}",
        "number": certificate.number,
        "claim": sentence("certificate.in_house"),
        "identity": [*identity(certificate)],
        "budget": budget_tables(certificate.parameters),
        "equation": calibration.equation,
        "gyroscope_equation": "" if calibration.gyroscope is None else GYROSCOPE_EQUATION,
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
