"""What ``session.toml`` holds, typed: the one place where it is checked and read, and the classes it is written from."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from enum import Enum
from pathlib import Path, PurePath
from typing import Any, TypeVar

import numpy as np

from imufield.dataclass import asdict, dataclass, field, fields, is_dataclass
from imufield.earth import GRAVITY_RANGE_M_S2, HEIGHT_RANGE_M, MEASURED_GRAVITY_SIGMA_M_S2
from imufield.errors import Reason, RecordingError
from imufield.files import utf8_text
from imufield.limits import BAUD_RANGE, HOLD_RANGE_S, RATE_RANGE_HZ, TARGET_RANGE
from imufield.samples import LARGEST_OUTPUT
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

FORMAT = "imufield-session"
VERSION = 1

KEYS: Mapping[str, type] = {
    "version": int,
    "accepted": int,
    "finished": bool,
    "notes": list,
    **dict.fromkeys(("format", "created", "software", "model", "name", "kind", "scheme"), str),
    **dict.fromkeys(("instrument", "link", "protocol", "settings", "units", "nominal", "guide", "site", "import"), dict),
}
"""What ``session.toml`` may hold: ``kind`` is "capture", "record", "ramp" or "import"; who uses a table fills it."""

Table = dict[str, Any]  # Of a TOML document, whose values have every type that TOML knows.


# Limits of numbers whose squares and quotients are finite.
_TINY = 1e-30
_HUGE = 1e30
_TYPES: Mapping[str, type] = {"str": str, "bool": bool, "int": int, "float": float}


# As written here: Python's reader also takes single digits, those of other scripts, and years that no plot can show.
_MOMENT = re.compile(r"(19[7-9]|20[0-9])[0-9](-[0-9]{2}){2}T[0-9]{2}(:[0-9]{2}){2}Z")

_Number = TypeVar("_Number", int, float)


def _number(low: _Number, high: _Number) -> _Number | None:
    """Declare a number that a person may edit and a program computes with; the limits are part of the sentence."""
    return field(default=None, metadata={"low": low, "high": high})


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentRecord:
    """Table ``instrument``: empty where not known."""

    driver: str = ""
    model: str = ""
    serial_number: str = ""
    firmware: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkRecord:
    """Table ``link``: the port with its baud rate, or the bus with its bit rate."""

    port: str | None = None
    bus: str | None = None
    baud: int | None = _number(*BAUD_RANGE)
    bit_rate: int | None = _number(*BAUD_RANGE)
    rate_hz: float | None = _number(*RATE_RANGE_HZ)
    # What a person sets again where a killed program did not: 0 where the output was off.
    rate_before_hz: float | None = _number(0.0, RATE_RANGE_HZ[1])
    is_virtual: bool = False
    """Read with a scaled clock, as only emulated instruments are: its site is nobody's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProtocolRecord:
    """Table ``protocol``: the definition that the bytes were recorded with, whole."""

    name: str = ""
    sha256: str = "not known"
    text: str = ""  # Whole, as the file of the user or a later imufield may say something else.


@dataclass(frozen=True, slots=True)
class SettingRecord:
    """One setting of the protocol; ``origin`` is "given" for what the user typed."""

    value: object
    """A number or a text, as the protocol declares it."""
    origin: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalRecord:
    """Table ``nominal``."""

    raw_zero: tuple[float, ...] | None = None
    """Accelerometer output at no input, one value for each axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuideRecord:
    """Table ``guide``: what was chosen when a guided session began, in the order in which it is written."""

    hold_s: float | None = _number(*HOLD_RANGE_S)
    target_bias_ug: float | None = _number(*TARGET_RANGE)
    target_scale_ppm: float | None = _number(*TARGET_RANGE)
    rotations: str | None = None
    earlier_scale_raw: float | None = _number(_TINY, _HUGE)
    earlier_scale_sigma: float | None = _number(_TINY, _HUGE)
    revisit_first: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteRecord:
    """Table ``site``: what was typed, nothing computed."""

    gravity_m_s2: float | None = _number(*GRAVITY_RANGE_M_S2)
    # By the digits typed, or as it was given beside them; None where gravity has none of its own.
    gravity_sigma_m_s2: float | None = _number(MEASURED_GRAVITY_SIGMA_M_S2, GRAVITY_RANGE_M_S2[1])
    gravity_sigma_is_given: bool | None = None
    latitude_deg: float | None = _number(-90.0, 90.0)
    height_m: float | None = _number(*HEIGHT_RANGE_M)

    @property
    def is_known(self) -> bool:
        """Whether gravity follows from these."""
        return self.gravity_m_s2 is not None or self.latitude_deg is not None


_TABLES: Mapping[str, type] = {"link": LinkRecord, "protocol": ProtocolRecord, "guide": GuideRecord, "site": SiteRecord}


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRecord:
    """Content of ``session.toml``.

    What programs of others may read and imufield never does (``units``, the other keys of ``import``) is in the file alone.
    """

    created: str
    model: str
    finished: bool
    software: str = "not known"
    kind: str = ""
    began: str = ""
    """When the recording of another program began, UTC, ISO 8601, where its own times tell it; of table ``import``."""
    scheme: str | None = None
    accepted: int | None = None
    """Positions measured so far, of a guided session."""
    instrument: InstrumentRecord = InstrumentRecord()
    link: LinkRecord = LinkRecord()
    protocol: ProtocolRecord = ProtocolRecord()
    settings: Mapping[str, SettingRecord] = field(default_factory=dict)
    nominal: NominalRecord = NominalRecord()
    guide: GuideRecord = GuideRecord()
    site: SiteRecord = SiteRecord()

    @property
    def recorded(self) -> str:
        """When the recording began, UTC, ISO 8601; empty where nobody knows, or where the file was edited."""
        moment = self.began if self.kind == "import" else self.created
        if not _MOMENT.fullmatch(moment):
            return ""
        try:
            datetime.fromisoformat(moment)
        except ValueError:
            return ""
        return moment

    @property
    def setting_values(self) -> dict[str, object]:
        """Values of the protocol's settings, whatever their origin."""
        return {name: setting.value for name, setting in self.settings.items()}

    @classmethod
    def read(cls, content: Table, path: Path) -> SessionRecord:
        """Check the content of ``session.toml`` and return it.

        Raises
        ------
        RecordingError
            It is of another format (``FOREIGN``) or a newer version (``NEWER``), has an unknown key (``UNKNOWN_KEY``), or lacks
            a key or has an impossible value (``DAMAGED``).
        """
        _check_keys(content, path)
        # A misspelt serial number would pass as one that is not known, a misspelt latitude as a place that is not known.
        for table, record in (("instrument", InstrumentRecord), ("site", SiteRecord)):
            known = [entry.name for entry in fields(record)]
            for name in content.get(table, {}):
                if name not in known:
                    key = f"{table}.{name}"
                    raise _refused("session_record.unknown_table_key", path, Reason.UNKNOWN_KEY, key=key, known=known)
        # A serial number of digits alone is a number in a file that a person has edited.
        instrument = {key: printable(str(value)) for key, value in content.get("instrument", {}).items()}
        tables = {name: _read_table(kind, name, content, path) for name, kind in _TABLES.items()}
        zero = content.get("nominal", {}).get("raw_zero")
        zeros: list[Any] = zero if isinstance(zero, list) and len(zero) in (3, 6) else [zero]
        for value in zeros if zero is not None else ():
            _check_number("nominal.raw_zero", value, path, low=-LARGEST_OUTPUT, high=LARGEST_OUTPUT)
        # One number stands for all axes.
        raw_zero = None if zero is None else tuple(map(float, zeros * 3 if len(zeros) == 1 else zeros))
        settings = {}
        for key, value in content.get("settings", {}).items():
            if not isinstance(value, dict) or "value" not in value:
                raise _refused("session_record.setting", path, key=key, value=value)
            settings[key] = SettingRecord(value["value"], str(value.get("origin", "")))
        texts: Table = {key: printable(content[key]) for key in ("created", "model", "software", "kind") if key in content}
        return cls(
            **texts,
            finished=content["finished"],
            began=printable(str(content.get("import", {}).get("began", ""))),
            scheme=content.get("scheme"),
            accepted=content.get("accepted"),
            instrument=InstrumentRecord(**instrument),
            settings=settings,
            nominal=NominalRecord(raw_zero=raw_zero),
            **tables,
        )


def plain_table(table: Mapping[str, object]) -> Table:
    """Return the table with values TOML knows: no NumPy types, no records, and no None, which is left out."""
    return {utf8_text(key): _plain(value) for key, value in table.items() if value is not None}


def plain_record(record: object) -> Table:
    """Return the table that a record is written as: its fields in their order, those that are None left out."""
    return plain_table(asdict(record))  # type: ignore[call-overload]  # records alone come here


def _plain(value: object) -> object:
    if is_dataclass(value):
        return plain_record(value)
    if isinstance(value, Mapping):
        return plain_table(value)
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, Enum):
        return value.value
    return utf8_text(value) if isinstance(value, str | PurePath) else value


def _read_table(kind: type, name: str, content: Table, path: Path) -> Any:
    """Return a table as a record; its values are of the types declared, keys that nothing reads stay in the file."""
    table = content.get(name, {})
    values = {}
    for entry in fields(kind):
        if entry.name in table:
            value, key = table[entry.name], f"{name}.{entry.name}"
            wanted = _TYPES[str(entry.type).partition(" ")[0]]
            if entry.metadata:
                _check_number(key, value, path, **entry.metadata)
                # Typed by hand a rate may be a whole number.
                value = wanted(value)
            elif not isinstance(value, wanted):
                raise _refused("session_record.type", path, key=key, value=value)
            values[entry.name] = value
    return kind(**values)


def _check_number(key: str, value: object, path: Path, *, low: float, high: float) -> None:
    """Refuse what nothing can be computed with."""
    # To Python a bool is an integer. Written so that nan, which TOML can spell, is outside.
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and low <= value <= high):  # type: ignore[operator]  # a number by now
        raise _refused("session_record.number", path, key=key, value=value, low=low, high=high)


def _check_keys(content: Table, path: Path) -> None:
    """Refuse what is foreign, newer or unknown, and what lacks the keys that every session has."""
    if content.get("format") != FORMAT:
        raise _refused("session_record.format", path, Reason.FOREIGN, found=content.get("format"), format=FORMAT)
    # Before the keys: a newer version may have some that are unknown here.
    version = content.get("version")
    if not isinstance(version, int) or version > VERSION:
        raise _refused("session_record.newer", path, Reason.NEWER, version=version, limit=VERSION)
    for key, value in content.items():
        if key not in KEYS:
            raise _refused("session_record.unknown_key", path, Reason.UNKNOWN_KEY, key=key)
        if not isinstance(value, KEYS[key]):
            raise _refused("session_record.type", path, key=key, value=value)
    for key in ("created", "model", "finished"):
        if key not in content:
            raise _refused("session_record.missing_key", path, key=key)


def _refused(sentence_key: str, path: Path, reason: Reason = Reason.DAMAGED, **values: object) -> RecordingError:
    return RecordingError(sentence(sentence_key, path=str(path), **values), reason)
