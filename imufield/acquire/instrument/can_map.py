"""Choose the protocol of a CAN bus: of a driver, of a protocol file, or made from a user's DBC file and signal names.

``--dbc FILE --map accelerometer.x=SIGNAL ...`` is written as the text of a protocol.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import tomli_w

from imufield.acquire.instrument.recognise import Candidate
from imufield.acquire.protocol.can_protocol import dbc_table
from imufield.acquire.protocol.protocol import DBC_LIMIT_BYTES, Protocol, decode_dbc, load_protocol, parse_protocol
from imufield.acquire.protocol.toml import near
from imufield.acquire.protocol.units import unit_name
from imufield.acquire.registry import load_driver
from imufield.errors import ProtocolError, Reason, SettingError, UsageError
from imufield.files import read_start
from imufield.samples import AXES, TRIADS
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_MAP_TEXTS = ("accelerometer.unit", "gyroscope.unit", "temperature", "temperature.unit", "counter", "time")
_ASSEMBLY_LISTS = ("needs", "counters")
_IDENTIFIERS = ("auto", "exact", "j1939")
_TRIAD_KEYS = {triad: [f"{triad}.{axis}" for axis in AXES] for triad in TRIADS}
KEYS = (
    *(key for keys in _TRIAD_KEYS.values() for key in keys),
    *_MAP_TEXTS,
    "starts_with",
    *_ASSEMBLY_LISTS,
    "limit_s",
    "time.ticks_per_s",
    "identifiers",
)
"""Keys of ``--map``."""
# The option that states each key of the protocol that is made of them.
_OPTIONS = {
    "map": "--map",
    **{f"map.{key.replace('.', '_')}": f"--map {key}" for key in (*TRIADS, *_MAP_TEXTS)},
    **{f"assembly.{key}": f"--map {key}" for key in ("starts_with", *_ASSEMBLY_LISTS, "limit_s")},
    "clock.time_ticks_per_s": "--map time.ticks_per_s",
}


def parse_map(texts: Iterable[str]) -> dict[str, str]:
    """Read ``--map KEY=VALUE``, e.g. ``accelerometer.x=-AccLong``; a minus turns the sign.

    Raises
    ------
    UsageError
        If a key is not known, given twice, or has no value.
    """
    found: dict[str, str] = {}
    for text in texts:
        key, _, value = (part.strip() for part in text.partition("="))
        if key not in KEYS:
            raise UsageError(sentence("can_map.unknown_key", map=text, key=key, near=near(key, KEYS), known=KEYS))
        if key in found:
            raise UsageError(sentence("can_map.twice", map=text, key=key))
        if not value:
            raise UsageError(sentence("can_map.no_value", map=text, key=key))
        found[key] = value
    return found


def protocol_from_dbc(path: str | Path, mapping: Mapping[str, str], settings: Mapping[str, object] | None = None) -> Protocol:
    """Return the protocol of an instrument described by a DBC file.

    Parameters
    ----------
    path : Path
    mapping : mapping
        As ``parse_map`` returns it. Signals are named SIGNAL or MESSAGE.SIGNAL.
    settings : mapping, optional
        ``rate_hz`` and ``source_address``.

    Raises
    ------
    ProtocolError
        The file is no DBC.
    UsageError
        An axis is missing, a signal is not in the file, or its unit is not one of what it is mapped to.
    """
    path = Path(path)
    try:
        # One byte more than allowed, so that a file which is too long shows.
        content = read_start(path, DBC_LIMIT_BYTES + 1)
    except OSError as error:
        raise ProtocolError(sentence("can_map.unreadable", path=str(path), cause=error.strerror)) from error
    text = protocol_text(path.stem, path.name, mapping) + dbc_table(decode_dbc(content, path.name))
    protocol = parse_protocol(text, settings, label=f"{path.name} with --map", options=_OPTIONS)
    if protocol.can is not None and "time" in mapping and "time.ticks_per_s" not in mapping:
        _, signal = protocol.can.dbc.find(mapping["time"])
        if unit_name(signal.unit, "time") is None:
            shown = repr(signal.unit) if signal.unit else "no unit"
            raise SettingError(sentence("can_map.time_unit", path=path.name, signal=signal.name, unit=shown), Reason.UNITS)
    return protocol


def protocol_text(name: str, dbc: str, mapping: Mapping[str, str]) -> str:
    """Return the protocol file, without the DBC, that says the same as ``--map``: a start for one's own."""
    identifiers = mapping.get("identifiers", "auto")
    if identifiers not in _IDENTIFIERS:
        raise UsageError(sentence("can_map.identifiers", identifiers=identifiers, known=_IDENTIFIERS))
    axes: dict[str, object] = {}
    for triad, keys in _TRIAD_KEYS.items():
        missing = [key for key in keys if key not in mapping]
        # A triad that is not named at all is not there; half a triad is a mistake.
        if 0 < len(missing) < len(keys):
            raise UsageError(sentence("can_map.missing", missing=missing))
        if not missing:
            axes[triad] = [mapping[key] for key in keys]
    assembly: dict[str, object] = {key: mapping[key] for key in ("starts_with",) if key in mapping}
    for key in _ASSEMBLY_LISTS:
        if key in mapping:
            assembly[key] = [part.strip() for part in mapping[key].split(",") if part.strip()]
    document = {
        "format": "imufield-protocol",
        "version": 1,
        # Names of protocols are words of small letters.
        "name": re.sub(r"[^a-z0-9_]+", "_", name.lower()).strip("_") or "dbc",
        "title": f"signals of {dbc}",
        "manual": dbc,
        "kind": "can",
        "settings": {
            "source_address": {"default": 255, "minimum": 0, "maximum": 255},
            "rate_hz": {"default": 0.0, "minimum": 0},
        },
        "can": {"dbc": dbc, "identifiers": identifiers, "source_address": {"setting": "source_address"}},
        "map": {**axes, **{key.replace(".", "_"): mapping[key] for key in _MAP_TEXTS if key in mapping}},
        "assembly": {**assembly, **_number(mapping, "limit_s")},
        "clock": {"rate_hz": {"setting": "rate_hz"}, **_number(mapping, "time.ticks_per_s")},
    }
    return tomli_w.dumps(document)


def _number(mapping: Mapping[str, str], key: str) -> dict[str, float]:
    """Return the entry of a number, none where it is not given."""
    if key not in mapping:
        return {}
    try:
        return {key.replace(".", "_"): float(mapping[key])}
    except ValueError:
        raise UsageError(sentence("can_map.no_number", map=key, value=mapping[key])) from None


def bus_candidate(
    *,
    driver: str | None = None,
    protocol: str | Path | Protocol | None = None,
    dbc: str | Path | None = None,
    mapping: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
) -> Candidate:
    """Return the way to read a bus by one of a driver, a protocol, or a DBC file with its mapping.

    Its ``bauds`` are the usual bit rate, or nothing where that is not known.

    Raises
    ------
    UsageError
        Not exactly one of the three is given.
    ProtocolError
        It cannot be understood, or is not of a CAN bus.
    """
    if sum(way is not None for way in (driver, protocol, dbc)) != 1:
        raise UsageError(sentence("can_map.one_way"))
    known = None if driver is None else load_driver(driver)
    if known is not None:
        found = known.load_protocol(settings)
    elif dbc is not None:
        found = protocol_from_dbc(dbc, mapping or {}, settings)
    else:
        found = protocol if isinstance(protocol, Protocol) else load_protocol(protocol or "", settings)
    name = driver or found.name
    if found.can is None:
        raise ProtocolError(sentence("can_map.no_bus", name=name), Reason.BAD_PROTOCOL)
    bit_rate = known.default_baud if known else found.can.bit_rate
    title = known.title if known else found.title
    return Candidate(name=name, title=title, protocol=found, bauds=(bit_rate,) if bit_rate else (), driver=known)
