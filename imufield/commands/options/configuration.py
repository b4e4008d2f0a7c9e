"""Defaults from ``imufield.toml`` and options of the form NAME=VALUE.

The file in the working folder goes before the one in the user's configuration folder; ``IMUFIELD_*`` variables go
before both, options before everything.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

from imufield.errors import Reason, UsageError
from imufield.files import Origin, read_small_file
from imufield.sentences import Sentences, shortened
from imufield.toml_and_json import decode_toml, parse_toml

sentence = Sentences(__package__)

FILE_NAME = "imufield.toml"
KEYS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("port", "bus", "dbc", "mapping", "baud"), ("capture", "record")),
    "driver": ("capture", "record", "plan"),
    **dict.fromkeys(("positions", "hold_s"), ("capture", "plan")),
    **dict.fromkeys(("target_bias_ug", "target_scale_ppm"), ("capture", "plan", "history")),
    **dict.fromkeys(("gravity", "latitude", "height"), ("capture", "record", "solve", "plan")),
    **dict.fromkeys(("laboratory", "customer"), ("certificate",)),
    "operator": ("certificate", "report"),
    "settings": ("capture", "record"),
    "instrument": (),
}
"""Keys of the file, and the commands each is a default of."""
# Keys that are tables, each with an example.
_TABLES = {
    "settings": "accelerometer_range_g = 30",
    "mapping": '"accelerometer.x" = "AccLong"',
    "instrument": 'stl = "housing.stl"',
}
_TEXTS = ("port", "bus", "dbc", "driver", "positions", "laboratory", "customer", "operator")
_NUMBERS = ("baud", "hold_s", "target_bias_ug", "target_scale_ppm", "gravity", "latitude", "height")


def default_map() -> dict[str, dict[str, object]]:
    """Return the file's defaults per command.

    Raises
    ------
    UsageError
        If the file is not TOML, or has an unknown key.
    """
    commands: dict[str, dict[str, object]] = {}
    for _, content in _contents():
        for key, value in content.items():
            # A table as it is typed: an option for each row.
            rows = value.items() if isinstance(value, dict) else ()
            default = [f"{name}={entry}" for name, entry in rows] if key in _TABLES else value
            for command in KEYS[key]:
                commands.setdefault(command, {})[key] = default
    return commands


def instrument_stl() -> Path | None:
    """Return the drawing of the instrument that the file names, beside the file; None where it names none.

    Raises
    ------
    UsageError
        As ``default_map``, or for another key of that table.
    """
    drawing = None
    for path, content in _contents():
        match content.get("instrument", {}):
            case {"stl": str(name)}:
                drawing = path.parent / name
            case {"stl": value}:
                raise UsageError(sentence("configuration.no_path", path=str(path), value=value))
    return drawing


def _contents() -> Iterator[tuple[Path, dict[str, object]]]:
    """Yield the files that are there, checked; what is set last stands."""
    # Looked for here and not at the top: most starts of the program ask for help or a version.
    import platformdirs

    # The file in the working folder comes last.
    for path in (platformdirs.user_config_path("imufield") / FILE_NAME, Path(FILE_NAME)):
        # Also what is no file: somebody put it there, and it would be passed over without a word.
        if not os.path.lexists(path):
            continue
        try:
            text = decode_toml(read_small_file(path, Origin.FOUND), str(path), UsageError)
        except OSError as error:
            raise UsageError(sentence("configuration.unreadable", path=str(path), cause=error.strerror)) from error
        content = parse_toml(text, str(path), UsageError)
        for key, value in sorted(content.items()):
            if key not in KEYS:
                unknown = sentence("configuration.unknown_key", path=str(path), unknown=key, known=[*KEYS])
                raise UsageError(unknown, Reason.UNKNOWN_KEY, key=key)
            shown = {"path": str(path), "name": key, "value": shortened(str(value))}
            if key in _TEXTS and not isinstance(value, str):
                raise UsageError(sentence("configuration.no_text", **shown))
            if key in _NUMBERS and not _is_number(key, value):
                raise UsageError(sentence("configuration.no_number", **shown))
            if key in _TABLES and not isinstance(value, dict):
                raise UsageError(sentence("configuration.no_table", name=key, file=FILE_NAME, example=_TABLES[key]))
            foreign = sorted(map(str, value.keys() - {"stl"})) if key == "instrument" and isinstance(value, dict) else []
            if foreign:
                unknown = sentence("configuration.unknown_key", path=str(path), unknown=foreign, known=["stl"])
                raise UsageError(unknown, Reason.UNKNOWN_KEY, key=key)
        yield path, dict(sorted(content.items()))


def _is_number(key: str, value: object) -> bool:
    text = str(value)
    if key == "gravity":
        # It may be a text with its uncertainty, "9.8089+-0.0001".
        text = text.replace("±", "+-").partition("+-")[0]
    try:
        return math.isfinite(int(text) if key == "baud" else float(text))
    except ValueError:
        return False


def parse_settings(options: list[str] | None) -> dict[str, str]:
    """Split options of the form NAME=VALUE.

    Raises
    ------
    UsageError
        If one has no equals sign or no name.
    """
    parsed: dict[str, str] = {}
    for option in options or []:
        name, equals, value = option.partition("=")
        if not equals or not name.strip():
            raise UsageError(sentence("configuration.no_setting", option=option))
        parsed[name.strip()] = value.strip()
    return parsed


def parse_zero(text: str | None) -> list[float] | None:
    """Read the raw zero: one number, three of the accelerometer's axes, or six of both triads.

    Raises
    ------
    UsageError
        If it is anything else.
    """
    if text is None:
        return None
    try:
        values = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) not in (1, 3, 6) or not all(math.isfinite(value) for value in values):
        raise UsageError(sentence("configuration.zero", zero=text))
    return values * 3 if len(values) == 1 else values
