r"""The certificate as a digital calibration certificate (DCC), XML in the namespaces of PTB [1]_.

Its structure is that of schema version 3.2.0 as documented: administrative data, one measurement result with a list of
quantities for each kind of parameter and one of all with their covariance, and the certificate as PDF. The schema's files are
not part of this program, so nothing is validated against them, and a statement inside says so.

Values are in SI, coherent units in the notation of siunitx. Counts and pulses are numbers, unit ``\one``.

References
----------
.. [1] Physikalisch-Technische Bundesanstalt, https://ptb.de/dcc and https://ptb.de/si (D-SI).
.. [2] JCGM 102:2011, 6.5: the region of several quantities. A common estimate of variance makes F of chi squared.
"""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from xml.etree import ElementTree as ET

import numpy as np

from imufield.calibrate.model.coverage_factors import f_quantile
from imufield.deliver.certificate.certificate import (
    Certificate,
    conditions,
    identification,
    references,
    statements,
    unknown,
    xml_text,
)
from imufield.deliver.report.budget import COVERAGE, Group, covariance_of
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.sentences import Sentences
from imufield.version import __version__

sentence = Sentences(__package__)

DCC = "https://ptb.de/dcc"
SI = "https://ptb.de/si"
SCHEMA_VERSION = "3.2.0"
_NO_COUNTRY = "ZZ"  # ISO 3166-1: a code that stands for no country; the country of the parties is not asked for.
_LANGUAGE = "en"
_SINGULAR = 1e-9  # Of a correlation matrix: less is rounding of the file.
_NORMAL = 1e6  # Degrees of freedom: with more, F is chi squared to five digits.
# Of a raw unit: its exponents of SI units, and its size.
_RAW: dict[str, tuple[Mapping[str, int], float]] = {
    "m/s^2": ({"metre": 1, "second": -2}, 1.0),
    "g": ({"metre": 1, "second": -2}, STANDARD_GRAVITY_M_S2),
    "rad/s": ({"radian": 1, "second": -1}, 1.0),
    "count": ({}, 1.0),
    "pulse": ({}, 1.0),
    "count/s": ({"second": -1}, 1.0),
    "pulse/s": ({"second": -1}, 1.0),
}
# Of a quantity: its exponents of SI units.
_FORCE = {"metre": 1, "second": -2}  # Specific force, m/s^2.
_RATE = {"radian": 1, "second": -1}  # Rate of turn, rad/s.
_ANGLE = {"radian": 1}
_FIXED = {"bias_m_s2": _FORCE, "misalignment_rad": _ANGLE}
# By what the raw unit of each other kind is divided.
_DIVISORS: dict[str, tuple[Mapping[str, int], ...]] = {
    "accelerometer.scale": (_FORCE,),
    "accelerometer.quadratic": (_FORCE, _FORCE),
    "gyroscope.bias": (),
    "gyroscope.scale": (_RATE,),
    "gyroscope.g_sensitivity": (_FORCE,),
}


def to_xml(certificate: Certificate, pdf: bytes | None = None) -> bytes:
    """Return the certificate as XML, UTF-8, with the PDF inside where there is one."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=SCHEMA_VERSION)
    root.append(_administrative_data(certificate))
    root.append(_dcc("measurementResults", _measurement_result(certificate)))
    if pdf is not None:
        parts = {
            "fileName": "certificate.pdf",
            "mimeType": "application/pdf",
            "dataBase64": base64.b64encode(pdf).decode("ascii"),
        }
        root.append(_dcc("document", *(_text(name, value) for name, value in parts.items())))
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _dcc(name: str, *children: ET.Element, **attributes: str) -> ET.Element:
    element = ET.Element(f"{{{DCC}}}{name}", attributes)
    element.extend(children)
    return element


def _text(name: str, value: str, namespace: str = DCC) -> ET.Element:
    element = ET.Element(f"{{{namespace}}}{name}")
    element.text = xml_text(value)
    return element


def _si(name: str, *children: ET.Element) -> ET.Element:
    element = ET.Element(f"{{{SI}}}{name}")
    element.extend(children)
    return element


def _named(name: str, value: str) -> ET.Element:
    """Return an element that holds a text in the language of the certificate."""
    return _dcc(name, _content(value))


def _administrative_data(certificate: Certificate) -> ET.Element:
    parties = certificate.parties
    software = _dcc("software", _named("name", "imufield"), _text("release", __version__))
    core = {
        "countryCodeISO3166_1": _NO_COUNTRY,
        "usedLangCodeISO639_1": _LANGUAGE,
        "mandatoryLangCodeISO639_1": _LANGUAGE,
        "uniqueIdentifier": certificate.number,
        "beginPerformanceDate": certificate.calibrated,
        "endPerformanceDate": certificate.calibrated,
        "performanceLocation": "other",
        "issueDate": certificate.issued,
    }
    person = _dcc("person", _named("name", parties.operator or unknown()))
    told = [*statements(certificate), sentence("certificate.not_validated")]
    if certificate.due:
        told.append(sentence("certificate.due", due=certificate.due))
    children = [
        _dcc("dccSoftware", software),
        _dcc("coreData", *(_text(name, value) for name, value in core.items())),
        _dcc("items", _item(certificate)),
        _dcc("calibrationLaboratory", _contact("contact", parties.laboratory)),
        _dcc("respPersons", _dcc("respPerson", person, _text("mainSigner", "true"))),
        _contact("customer", parties.customer),
        _dcc("statements", *(_dcc("statement", _named("declaration", text)) for text in told)),
    ]
    return _dcc("administrativeData", *children)


def _item(certificate: Certificate) -> ET.Element:
    serial = _identification("manufacturer", certificate.serial_number, sentence("identity.serial_number"))
    named = (_named("name", sentence("dcc.item")), _text("model", certificate.instrument))
    return _dcc("item", *named, _dcc("identifications", serial))


def _identification(issuer: str, value: str, name: str) -> ET.Element:
    return _dcc("identification", _text("issuer", issuer), _text("value", value), _named("name", name))


def _contact(kind: str, name: str) -> ET.Element:
    return _dcc(kind, _named("name", name or unknown()), _dcc("location", _text("countryCode", _NO_COUNTRY)))


def _measurement_result(certificate: Certificate) -> ET.Element:
    calibration = certificate.parameters.calibration
    units = {"accelerometer": calibration.accelerometer_raw_unit}
    if calibration.gyroscope is not None:
        units["gyroscope"] = calibration.gyroscope.raw_unit
    method = _dcc("usedMethod", _named("name", sentence("certificate.method")), _named("description", calibration.equation))
    equipment = [
        _dcc("measuringEquipment", _named("name", name), _dcc("identifications", _identification("other", value, name)))
        for name, value in (*references(certificate), *identification(certificate))
    ]
    influences = [
        _dcc("influenceCondition", _named("name", name), _dcc("data", _dcc("text", _content(value))))
        for name, value in conditions(certificate)
    ]
    children = [
        _named("name", sentence("dcc.calibration", instrument=certificate.instrument, serial_number=certificate.serial_number)),
        _dcc("usedMethods", method),
        _dcc("measuringEquipments", *equipment),
        _dcc("influenceConditions", *influences),
        _dcc("results", *(_result(group, units) for group in certificate.groups), *_joint_result(certificate, units)),
    ]
    return _dcc("measurementResult", *children)


def _content(value: str) -> ET.Element:
    content = _text("content", value)
    content.set("lang", _LANGUAGE)
    return content


def _result(group: Group, raw_units: Mapping[str, str]) -> ET.Element:
    """Return the values of one kind of parameters with their expanded uncertainty."""
    exponents, size = unit_of(group.key, raw_units[group.key.partition(".")[0]])
    places = " ".join(parameter.place for parameter in group.parameters)
    values = _list("valueXMLList", (parameter.value * size for parameter in group.parameters))
    numbers = _si("realListXMLList", values, _text("unitXMLList", unit_words(exponents), SI))
    # Without a degree of freedom nothing says how sure a number is.
    if all(math.isfinite(parameter.expanded) for parameter in group.parameters):
        uncertainties = _list("uncertaintyXMLList", (parameter.expanded * size for parameter in group.parameters))
        factors = _list("coverageFactorXMLList", (parameter.coverage_factor for parameter in group.parameters))
        chance = _text("coverageProbabilityXMLList", str(COVERAGE), SI)
        numbers.append(_si("expandedUncXMLList", uncertainties, factors, chance))
    return _listed(group.title, f"{group.title}: {places}", numbers)


def _joint_result(certificate: Certificate, raw_units: Mapping[str, str]) -> Iterator[ET.Element]:
    """Yield the values of all parameters with their covariance; nothing where one of them has no uncertainty."""
    parameters = [parameter for group in certificate.groups for parameter in group.parameters]
    freedom = min((parameter.degrees_of_freedom for parameter in parameters), default=0.0)
    covariance = covariance_of(certificate.parameters)
    if not (freedom > 0 and np.isfinite(covariance).all()):
        return
    units = [
        unit_of(group.key, raw_units[group.key.partition(".")[0]]) for group in certificate.groups for _ in group.parameters
    ]
    sizes = np.array([size for _, size in units])
    columns = (
        _si("column", *(_covariance(value, row, column) for value, (row, _) in zip(values, units, strict=True)))
        for values, (column, _) in zip((covariance * np.outer(sizes, sizes)).tolist(), units, strict=True)
    )
    # A gauge that states T by more numbers than are free leaves as many directions without variance.
    sigma = np.sqrt(np.diag(covariance))
    sigma[sigma == 0] = 1.0
    rank = int(np.linalg.matrix_rank(covariance / np.outer(sigma, sigma), tol=_SINGULAR, hermitian=True))
    # The least degrees of freedom among the parameters: the region is rather too large [2]_.
    factor = math.sqrt(rank * f_quantile(rank, min(freedom, _NORMAL), COVERAGE))
    region = _si(
        "ellipsoidalRegionXMLList",
        _si("covarianceMatrix", *columns),
        _text("coverageFactor", repr(factor), SI),
        _text("coverageProbability", str(COVERAGE), SI),
    )
    numbers = _si(
        "realListXMLList",
        _text("labelXMLList", " ".join(parameter.name for parameter in parameters), SI),
        _list("valueXMLList", (parameter.value * size for parameter, size in zip(parameters, sizes, strict=True))),
        _text("unitXMLList", " ".join(unit_words(exponents) for exponents, _ in units), SI),
        region,
    )
    yield _listed(sentence("dcc.covariance"), sentence("dcc.covariance"), numbers)


def _covariance(value: float, row: Mapping[str, int], column: Mapping[str, int]) -> ET.Element:
    exponents = Counter(row)
    exponents.update(column)
    return _si("covariance", _text("value", repr(value), SI), _text("unit", unit_words(exponents), SI))


def _listed(title: str, name: str, numbers: ET.Element) -> ET.Element:
    """Return a result that is one list of numbers."""
    quantity = _dcc("quantity", _named("name", name), numbers, refType="basic_measuredValue")
    return _dcc("result", _named("name", title), _dcc("data", _dcc("list", quantity)))


def _list(name: str, values: Iterable[float]) -> ET.Element:
    return _text(name, " ".join(repr(float(value)) for value in values), SI)


def unit_of(key: str, raw_unit: str) -> tuple[Mapping[str, int], float]:
    """Return the exponents of the SI unit of a kind of parameters, and the size of the parameter file's unit in it."""
    kind = key.partition(".")[2]
    if kind in _FIXED:
        return _FIXED[kind], 1.0
    exponents, size = _RAW[raw_unit]
    left = Counter(exponents)
    for divisor in _DIVISORS[key]:
        left.subtract(divisor)
    return left, size


def unit_words(exponents: Mapping[str, int]) -> str:
    r"""Return a product of powers in the notation of siunitx: ``\metre\second\tothe{-2}``."""
    powers = {name: power for name, power in exponents.items() if power}
    return "".join(rf"\{name}" if power == 1 else rf"\{name}\tothe{{{power}}}" for name, power in powers.items()) or r"\one"
