"""What a certificate states: who, what, when, under which conditions, how uncertain, and what it goes back to."""

from __future__ import annotations

import math
import re
from calendar import monthrange
from collections.abc import Iterator
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np

from imufield.dataclass import dataclass
from imufield.deliver.parameters.context import JoinedSession
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import with_sigma
from imufield.deliver.parameters.schema import Document
from imufield.deliver.parameters.write import content_sha256
from imufield.deliver.report.budget import (
    COVERAGE,
    Group,
    ParameterBudget,
    budget_of,
    covariance_of,
    is_mostly_time_base,
    not_in_budget,
    scale_words,
    share_words,
)
from imufield.deliver.verification.result import read_verification, verification_note
from imufield.earth import STANDARD_GRAVITY_M_S2, height_words
from imufield.files import source_date, utf8_text
from imufield.sentences import Sentence, Sentences, printable
from imufield.version import __version__

sentence = Sentences(__package__)

FORMAT = "imufield-certificate"
VERSION = 1
_SHORT_HASH = 12  # Hexadecimal digits that a person compares on a label.
_CLOCKS = {"host": "references.host", "compared": "references.compared", "unchecked": "references.unchecked"}
# What XML 1.0 can hold no character of, beside what ``printable`` shows: two code points that are none.
_NO_XML = re.compile("[\ufffe\uffff]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parties:
    """Who is concerned; empty where nobody says."""

    laboratory: str = ""
    customer: str = ""
    operator: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """A certificate of the parameters in one file."""

    parameters: Parameters
    parties: Parties
    protocol: str = ""
    """Name and hash of how the recording was read; empty where it is not at hand."""
    issued: str
    """ISO 8601."""
    due_months: int | None = None
    verified: tuple[str, ...] = ()
    """What their verification says, ``verification_statements``."""

    @property
    def sha256(self) -> str:
        """Of the content of the parameter file."""
        return content_sha256(self.parameters.document)

    @property
    def short_sha256(self) -> str:
        """Its first digits."""
        return self.sha256[:_SHORT_HASH]

    @property
    def number(self) -> str:
        """Of the certificate: one for each content of a parameter file."""
        return f"imufield-{self.sha256[:16]}"

    @property
    def serial_number(self) -> str:
        """Printable, and said where it is not known."""
        return printable(self.parameters.context.instrument.serial_number) or unknown()

    @property
    def instrument(self) -> str:
        """Model, or what else is known of its kind."""
        instrument = self.parameters.context.instrument
        return printable(instrument.model or instrument.driver) or unknown()

    @property
    def calibrated(self) -> str:
        """Day of the recording, ISO 8601; that of the solution where nobody knows."""
        return self.parameters.context.measured[:10]

    @property
    def due(self) -> str:
        """Day of the next calibration, ISO 8601; empty where no interval is given, or a file has a day that is none."""
        return "" if self.due_months is None else _months_later(self.calibrated, self.due_months)

    @property
    def groups(self) -> tuple[Group, ...]:
        """The budget of each parameter."""
        return budget_of(self.parameters)


def unknown() -> Sentence:
    """Return what stands in place of what nobody says."""
    return sentence("identity.unknown")


def xml_text(text: str) -> str:
    """Return a text of somebody else in characters that XML 1.0 can hold."""
    return _NO_XML.sub("\ufffd", printable(utf8_text(text)))


def issue_date() -> str:
    """Return today, or the day of SOURCE_DATE_EPOCH, UTC; raises UsageError where that is no date."""
    return (source_date() or datetime.now(UTC)).date().isoformat()


def _months_later(text: str, months: int) -> str:
    try:
        day = date.fromisoformat(text)
        years, month = divmod(day.month - 1 + months, 12)
        year = day.year + years
        # The last of a month has no namesake in a shorter one.
        return date(year, month + 1, min(day.day, monthrange(year, month + 1)[1])).isoformat()
    except ValueError:
        return ""


def verification_statements(results: Path, sha256: str) -> Iterator[str]:
    """Yield the requirements with their outcome and the objections, from the results for parameters of this content."""
    if note := verification_note(results, sha256):
        yield note
    document = read_verification(results, sha256) or {}
    for requirement in document.get("requirement", []):
        outcome = "not_measured" if requirement["measured"] is None else "met" if requirement["passed"] else "not_met"
        yield sentence(f"requirement.{outcome}", **{key: requirement[key] for key in ("name", "limit", "measured")})
    yield from (sentence("requirement.objection", objection=objection) for objection in document.get("objections", []))


def statements(certificate: Certificate) -> tuple[str, ...]:
    """Return what the certificate claims, and what it does not."""
    quality = certificate.parameters.calibration.quality
    told: list[str] = [sentence("certificate.in_house"), sentence("certificate.coverage")]
    told += [sentence("certificate.verdict", verdict=quality.verdict), *certificate.verified]
    if scale_words(certificate.parameters):
        told.append(sentence("certificate.true_seconds"))
    clock = certificate.parameters.context.clock
    if clock is not None and is_mostly_time_base(certificate.parameters):
        told.append(sentence("certificate.time_base", sigma_ppm=1e6 * clock.sigma))
    if certificate.parameters.edited:
        told.append(sentence("certificate.edited"))
    return (*told, *not_in_budget(certificate.parameters))


def identity(certificate: Certificate) -> Iterator[tuple[Sentence, str]]:
    """Yield what was calibrated, who is concerned, and the days."""
    parties = certificate.parties
    facts = {
        "identity.instrument": certificate.instrument,
        "identity.serial_number": certificate.serial_number,
        "identity.firmware": certificate.parameters.context.instrument.firmware,
        "identity.laboratory": parties.laboratory or unknown(),
        "identity.customer": parties.customer,
        "identity.calibrated": certificate.calibrated,
        "identity.issued": certificate.issued,
        "identity.due": certificate.due,
    }
    yield from ((sentence(key), fact) for key, fact in facts.items() if fact)


def conditions(certificate: Certificate) -> Iterator[tuple[Sentence, str]]:
    """Yield under which conditions it was calibrated, and the range in which it holds."""
    parameters = certificate.parameters
    gravity, session = parameters.calibration.gravity, parameters.context.session
    low, high = session.temperature_degc
    is_known = math.isfinite(low + high)
    at = sentence("conditions.between", low=low, high=high) if is_known else sentence("conditions.temperature_unknown")
    yield sentence("conditions.temperature"), at
    positions = parameters.calibration.positions.count or sum(each.positions for each in _sessions(parameters))
    yield sentence("conditions.positions"), str(positions)
    up_to = sentence("conditions.up_to_gravity", limit_g=gravity.gravity_m_s2 / STANDARD_GRAVITY_M_S2)
    yield sentence("conditions.valid_acceleration"), up_to
    gyroscope = parameters.calibration.gyroscope
    if gyroscope is not None and np.isfinite(gyroscope.range_rad_s).all():
        up_to = sentence("conditions.up_to_rates", limits=np.degrees(gyroscope.range_rad_s).tolist())
        yield sentence("conditions.valid_rate"), up_to
    if is_known or parameters.temperature_models:
        yield sentence("conditions.valid_temperature"), _valid_temperature(parameters)


def _sessions(parameters: Parameters) -> tuple[JoinedSession, ...]:
    return () if parameters.context.together is None else parameters.context.together.session


def _valid_temperature(parameters: Parameters) -> Sentence:
    if not parameters.temperature_models:
        return sentence("conditions.one_temperature")
    low, high = parameters.temperature_range_degc
    return sentence("conditions.over_temperature", low=low, high=high)


def references(certificate: Certificate) -> Iterator[tuple[Sentence, Sentence]]:
    """Yield the standards that the numbers go back to."""
    gravity, clock = certificate.parameters.calibration.gravity, certificate.parameters.context.clock
    value = with_sigma(gravity.gravity_m_s2, gravity.sigma_m_s2)
    if gravity.latitude_deg is None:
        stated = sentence("references.stated", value=value, source=gravity.source_words)
    else:
        place = {"latitude_deg": gravity.latitude_deg, "height": height_words(gravity)}
        stated = sentence("references.stated_at", value=value, source=gravity.source_words, **place)
    yield sentence("references.gravity"), stated
    if clock is not None:
        ticks = sentence("references.period", clock=sentence(_CLOCKS[clock.source]), sigma_ppm=1e6 * clock.sigma)
        yield sentence("references.time_base"), ticks


def identification(certificate: Certificate) -> Iterator[tuple[Sentence, str]]:
    """Yield which data and programs the numbers are of."""
    context = certificate.parameters.context
    yield sentence("identification.parameters"), sentence("identification.content", sha256=certificate.sha256)
    if context.session.sha256:
        yield sentence("identification.recording"), _hashed(context.session.name, context.session.sha256)
    for session in _sessions(certificate.parameters):
        yield sentence("identification.session"), _hashed(session.name, session.sha256)
    yield sentence("identification.protocol"), certificate.protocol or unknown()
    yield sentence("identification.solved_by"), printable(context.software)
    yield sentence("identification.certificate_by"), f"imufield {__version__}"


def _hashed(name: str, sha256: str) -> Sentence:
    return sentence("identification.recorded", name=name, sha256=sha256)


def to_json(certificate: Certificate) -> Document:
    """Return the certificate as plain values; what is not known is null."""
    instrument, parties = certificate.parameters.context.instrument, certificate.parties
    return {
        "format": FORMAT,
        "version": VERSION,
        "number": certificate.number,
        "accredited": False,
        "issued": certificate.issued,
        "calibrated": certificate.calibrated,
        "due": certificate.due,
        "laboratory": parties.laboratory,
        "customer": parties.customer,
        "operator": parties.operator,
        "instrument": {
            "model": instrument.model,
            "driver": instrument.driver,
            "serial_number": instrument.serial_number,
            "firmware": instrument.firmware,
        },
        "statements": [*statements(certificate)],
        "conditions": dict(conditions(certificate)),
        "reference": [[name, value] for name, value in references(certificate)],
        "identification": [[name, value] for name, value in identification(certificate)],
        "coverage_probability": COVERAGE,
        "units": sentence("certificate.units"),
        "budget": [_parameter_json(parameter) for group in certificate.groups for parameter in group.parameters],
        # In the order of the budget.
        "covariance": [[_finite(value) for value in row] for row in covariance_of(certificate.parameters).tolist()],
    }


def _parameter_json(parameter: ParameterBudget) -> Document:
    return {
        "name": parameter.name,
        "value": parameter.value,
        "standard_uncertainty": _finite(parameter.sigma),
        "degrees_of_freedom": _finite(parameter.degrees_of_freedom),
        "coverage_factor": _finite(parameter.coverage_factor),
        "expanded_uncertainty": _finite(parameter.expanded),
        "share": [
            {
                "name": entry.share.name,
                "words": share_words(entry.share),
                "type": entry.share.kind,
                "degrees_of_freedom": _finite(entry.share.degrees_of_freedom),
                "residuals": entry.share.residuals,
                "input_uncertainty": _finite(entry.share.input_sigma),
                "input_unit": entry.share.input_unit,
                "sensitivity": _finite(entry.sensitivity),
                "contribution": _finite(entry.sigma),
            }
            for entry in parameter.entries
            if entry.sigma != 0
        ],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
