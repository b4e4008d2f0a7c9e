"""A protocol: how to turn bytes of an instrument into samples, read from a TOML file.

``docs/protocols.md`` explains every key for someone who writes such a file.
"""

from __future__ import annotations

import hashlib
import importlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imufield.acquire.protocol.frame_schema import FrameRule, read_frames
from imufield.acquire.protocol.layout import Field
from imufield.acquire.protocol.references import References, complete_clock
from imufield.acquire.protocol.samples_and_clock import (
    COLUMN_FIELDS,
    PARTS,
    ClockRule,
    Quantity,
    SampleRule,
    TextRule,
    read_clock,
    read_samples,
    read_text,
    sample_units,
)
from imufield.acquire.protocol.settings import Setting, SettingRule, choose_settings, read_rules
from imufield.acquire.protocol.toml import FILE_LIMIT_BYTES, LEAST_SCALE, Source, Table, near
from imufield.acquire.protocol.units import SI_UNITS, TO_SI, UNITS_OF
from imufield.dataclass import dataclass, field, replace
from imufield.errors import ProtocolError, Reason, UnknownNameError
from imufield.files import Origin, read_start
from imufield.samples import FloatArray, SampleUnits
from imufield.sentences import Sentences, printable
from imufield.toml_and_json import decode_toml

sentence = Sentences(__package__)

if TYPE_CHECKING:
    from imufield.acquire.protocol.can_protocol import CanRule

SCHEMA_VERSION = 1
VERIFIED = "verified on real bytes"
DOCUMENT_ONLY = "document only"
FOLDER = "imufield.protocols"

_CAN_KIND = re.compile(r'^kind\s*=\s*"can"', re.MULTILINE)
GRADES = ("navigation", "tactical", "industrial", "mems")
"""Of what an instrument may be built; ``calibrate.model.grades`` has their figures."""
DBC_LIMIT_BYTES = 1 << 22
"""The largest public DBC files, of whole vehicles, are about 2 MiB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nominal:
    """What is known of an instrument before any calibration; None where it is not."""

    accelerometer_scale: float | None
    """Raw unit per m/s^2 (per m/s where it sends increments)."""
    gyroscope_scale: float | None
    """Raw unit per rad/s (per rad where it sends increments)."""
    raw_zero: FloatArray
    """Raw zero of the accelerometer, and of a gyroscope behind the same converter, shape (3,)."""
    accelerometer_range_m_s2: float | None
    gyroscope_range_rad_s: float | None
    rate_hz: float | None
    grade: str
    """Of what the instrument is built, for what a calibration cannot show; empty where it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """A protocol with its settings put in place. Get one from ``load_protocol``."""

    name: str
    title: str
    manual: str
    text: str
    """The file itself, to be kept with a recording."""
    sha256: str
    settings: dict[str, Setting]
    frame: FrameRule | None
    """None for lines of text."""
    lines: TextRule | None
    """None for frames."""
    samples: SampleRule
    clock: ClockRule
    units: SampleUnits
    factors: dict[str, float]
    """By "accelerometer", "gyroscope", "temperature": what a value in the unit of the part's first field is multiplied by."""
    nominal: Nominal
    can: CanRule | None = None
    """For frames of a CAN bus, which have neither ``frame`` nor ``lines``."""
    kind_names: Mapping[str, str] = field(default_factory=dict)
    """What the manual calls kinds of frames, by their key as ``[frames]`` writes it."""
    rules: Mapping[str, SettingRule] = field(default_factory=dict)
    """What each of ``settings`` may be."""
    status: str = VERIFIED
    """Or ``DOCUMENT_ONLY``: never tried on bytes of a real instrument."""

    def raw_zero_rate(self, raw_zero: FloatArray | None = None) -> FloatArray:
        """Return the raw output at zero input, the protocol's or another, as a rate: raw unit, per second for increments."""
        return self.units.raw_zero_rate(self.nominal.raw_zero if raw_zero is None else raw_zero)

    def factor(self, part: str, field: Field) -> float:
        """Return what a value of one field is multiplied by: fields of one part may come in different units."""
        quantity = self.samples.quantity(part)
        if quantity.unit is not None or not field.unit:
            return self.factors[part]
        return TO_SI[field.unit][1] * quantity.scale


def protocol_names() -> list[str]:
    """Return the names of the protocols that ship with imufield."""
    return sorted(path.stem for path in _shipped().glob("*.toml"))


def _shipped() -> Path:
    return Path(importlib.import_module(FOLDER).__path__[0])


def load_protocol(
    name_or_path: str | Path,
    settings: Mapping[str, object] | None = None,
    *,
    read: Mapping[str, object] | None = None,
    label: str | None = None,
) -> Protocol:
    """Load a protocol that ships with imufield by its name, or a user's by its path.

    Parameters
    ----------
    name_or_path : str or Path
    settings : mapping, optional
        What the user gave: values, or text as typed.
    read : mapping, optional
        What the instrument itself said. A value the user gave wins.
    label : str, optional
        What to call it in sentences, where its name means nothing to the user.

    Raises
    ------
    ProtocolError
        If there is no such protocol, the file is not understood (with line and key), or a setting is not allowed.
    """
    name, text = _find_text(name_or_path)
    if _CAN_KIND.search(text):
        from imufield.acquire.protocol.can_protocol import embed_dbc

        # A recording keeps this text, which must hold all that decodes it.
        text = embed_dbc(text, lambda dbc: _read_beside(name_or_path, dbc))
    return parse_protocol(text, settings, read=read, label=label or name)


def parse_protocol(
    text: str,
    settings: Mapping[str, object] | None = None,
    *,
    read: Mapping[str, object] | None = None,
    label: str = "protocol",
    options: Mapping[str, str] | None = None,
) -> Protocol:
    """Return the protocol written in ``text``, e.g. as kept in a recording; otherwise like ``load_protocol``.

    ``options`` names the option that states each key, where the text was made from options.
    """
    source = Source(label, text, options or {})
    top = Table(values=source.parse(), path=(), source=source)
    if top.text("format", "") != "imufield-protocol":
        raise top.error("format", sentence("protocol.format"))
    version = top.integer("version", 1, 1 << 31)
    if version > SCHEMA_VERSION:
        raise top.error("version", sentence("protocol.version", version=version, newest=SCHEMA_VERSION))
    # Settings first: every other value of the file may be taken from one.
    rules = read_rules(top.table("settings"))
    chosen = choose_settings(rules, settings or {}, read or {}, source)
    top.settings = {name: setting.value for name, setting in chosen.items()}
    top.given = [name for name, setting in chosen.items() if setting.origin == "given"]
    return replace(_build(top, chosen), rules=rules)


def _find_text(name_or_path: str | Path) -> tuple[str, str]:
    names = protocol_names()
    if str(name_or_path) in names:
        return f"protocol {name_or_path}", (_shipped() / f"{name_or_path}.toml").read_text(encoding="utf-8")
    path = Path(name_or_path)
    if not (path.suffix or path.parent.name or path.exists()):
        name = str(name_or_path)
        unknown = sentence("protocol.unknown_name", name=name, near=near(name, names), names=names)
        raise UnknownNameError(unknown, Reason.BAD_PROTOCOL)
    try:
        content = read_start(path, FILE_LIMIT_BYTES + 1)
        if len(content) > FILE_LIMIT_BYTES:
            raise ProtocolError(sentence("protocol.size", name=path.name, limit=FILE_LIMIT_BYTES), path=path)
        return path.name, decode_toml(content, path.name, ProtocolError)
    except OSError as error:
        raise ProtocolError(sentence("protocol.cannot_read", path=path, cause=error.strerror)) from error


def _read_beside(name_or_path: str | Path, name: str) -> str:
    """Return the text of a DBC file that stands beside a protocol; most are written on Windows, in its code page."""
    if str(name_or_path) in protocol_names():
        return decode_dbc((_shipped() / name).read_bytes(), name)
    # The protocol may come from somebody else, and so may what stands beside it.
    if Path(name).name != name:
        raise ProtocolError(sentence("protocol.dbc_elsewhere", path=name, protocol=name_or_path))
    try:
        content = read_start(Path(name_or_path).parent / name, DBC_LIMIT_BYTES + 1, Origin.INSIDE)
    except (OSError, ValueError) as error:
        # A name with a null character is none to Python.
        cause = getattr(error, "strerror", error)
        missing = sentence("protocol.no_dbc", path=name, protocol=name_or_path, cause=cause)
        raise ProtocolError(missing) from error
    return decode_dbc(content, name)


def decode_dbc(content: bytes, name: str) -> str:
    """Return the text of a DBC file.

    Raises
    ------
    ProtocolError
        If it is too large.
    """
    if len(content) > DBC_LIMIT_BYTES:
        raise ProtocolError(sentence("protocol.dbc_size", path=name, size=len(content), limit=DBC_LIMIT_BYTES))
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _build(top: Table, settings: dict[str, Setting]) -> Protocol:
    with top:
        kind = top.choice("kind", ("frames", "text", "can"))
        frame, lines, can = None, None, None
        if kind == "can":
            # cantools, which reads DBC files, is imported only where one is needed.
            from imufield.acquire.protocol.can_protocol import read_can

            can, units, clock = read_can(top)
            samples = SampleRule()
            factors: dict[str, float] = dict.fromkeys(map(str, PARTS), 1.0)
        else:
            frame = read_frames(top) if kind == "frames" else None
            lines = read_text(top) if kind == "text" else None
            fields = frame.sample_fields() if frame else COLUMN_FIELDS
            samples, clock = read_samples(top, of_text=frame is None), read_clock(top, of_text=frame is None)
            References(fields).check(top, samples, clock)
            # Of the columns that a line may have, those that it has.
            clock = complete_clock(clock, [field for field in fields if lines is None or field.name in lines.columns])
            units_of = {part: _unit_of(top, part, fields, samples.quantity(part)) for part in PARTS}
            factors = {str(part): factor for part, (_, factor) in units_of.items()}
            accelerometer, gyroscope = units_of["accelerometer"][0], units_of["gyroscope"][0]
            increments = samples.accelerometer.increment, samples.gyroscope.increment
            units = sample_units(top.table("clock"), clock, accelerometer, gyroscope, increments=increments)
        nominal = _read_nominal(top, units, clock)
        with top.table("names") as table:
            kind_names = {key: table.text(key) for key in table.values}
        # What the emulator reads, and frames of instruments whose protocol has only fields or masks.
        for key in ("emulate", *(("frame", "parts", "frames", "messages") if frame else ())):
            top.has(key)
        return Protocol(
            name=printable(top.text("name")),
            title=printable(top.text("title")),
            manual=top.text("manual"),
            text=top.source.text,
            sha256=hashlib.sha256(top.source.text.encode()).hexdigest(),
            settings=settings,
            frame=frame,
            lines=lines,
            samples=samples,
            clock=clock,
            units=units,
            factors=factors,
            nominal=nominal,
            can=can,
            kind_names=kind_names,
            status=top.choice("status", (VERIFIED, DOCUMENT_ONLY), VERIFIED),
        )


def _unit_of(top: Table, part: str, fields: Sequence[Field], quantity: Quantity) -> tuple[str, float]:
    """Return what unit a part of the sample has and the factor to it."""
    units = list(dict.fromkeys(field.unit for name in quantity.fields for field in fields if field.name == name))
    if quantity.unit is not None or not units:
        units = [UNITS_OF[part][0] if quantity.unit is None else quantity.unit]
    table = top.table("samples")
    found = [TO_SI.get(written, ("", 0.0)) for written in units]
    unit, factor = found[0]
    for written, (other, _) in zip(units, found, strict=True):
        if other not in UNITS_OF[part]:
            known = [name for name, (si, _) in TO_SI.items() if si in UNITS_OF[part]]
            raise table.error(part, sentence("protocol.unit", unit=written, near=near(written, known), known=known))
        if other != unit:
            raise table.error(part, sentence("protocol.two_units", unit=units[0], other=written))
    if quantity.increment and unit in ("m/s^2", "rad/s"):
        raise table.error(part, sentence("protocol.increment", unit=units[0]))
    return unit, factor * quantity.scale


def _read_nominal(top: Table, units: SampleUnits, clock: ClockRule) -> Nominal:
    scales: list[float | None] = []
    ranges: list[float | None] = []
    with top.table("nominal") as table:
        for part, unit in (("accelerometer", units.accelerometer), ("gyroscope", units.gyroscope)):
            perfect = 1.0 if unit in SI_UNITS else None
            _, factor = TO_SI[table.choice(f"{part}_range_unit", TO_SI, UNITS_OF[part][0])]
            scales.append(table.scale(f"{part}_scale") if table.has(f"{part}_scale") else perfect)
            ranges.append(table.number(f"{part}_range", low=LEAST_SCALE) * factor if table.has(f"{part}_range") else None)
        return Nominal(
            accelerometer_scale=scales[0],
            gyroscope_scale=scales[1],
            raw_zero=np.full(3, table.number("raw_zero", 0.0)),
            accelerometer_range_m_s2=ranges[0],
            gyroscope_range_rad_s=ranges[1],
            rate_hz=clock.rate_hz or None,
            grade=table.choice("grade", GRADES) if table.value("grade") else "",
        )
