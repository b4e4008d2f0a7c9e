"""``imufield sessions``: the sessions of a folder, from what stands beside the recordings; nothing is decoded."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.calibrate.model.result import VERDICTS
from imufield.commands.options.acquire_commands import SessionsOptions
from imufield.commands.terminal.output import echo, say
from imufield.deliver.parameters.file import PARAMETER_FILE
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import ImufieldError, ParameterFileError, RecordingError, UsageError
from imufield.files import DEFAULT_ROOT, Origin, read_small_file, real_path
from imufield.guide.positions import SCHEME_FILE, SCHEMES, scheme
from imufield.sentences import Sentences, printable
from imufield.toml_and_json import decode_toml, parse_toml

sentence = Sentences(__package__)


Row = dict[str, Any]  # Texts and numbers, in JSON under the same names.
# The others of a parameter file are most of it, and take most of the time.
_TABLES = re.compile(r"^\[(?:session|quality|integrity)\]\n(?:(?!\[).*\n)*", re.MULTILINE)
_NOT_KNOWN = (
    "created",
    "instrument",
    "serial_number",
    "port",
    "kind",
    "planned",
    "positions",
    "used",
    "verdict",
    "fault",
    "leads_to",
)


def list_sessions(options: SessionsOptions) -> None:
    """Print the sessions of a folder, the newest first; one that cannot be read is listed as damaged, with its error.

    Raises
    ------
    UsageError
        If the folder that was named is none.
    """
    folder, words = options.folder, (options.find or "").lower().split()
    if not folder.is_dir() and folder != DEFAULT_ROOT:
        raise UsageError(sentence("sessions.no_folder", folder=folder))
    listed = [_row(path.parent, folder) for path in folder.glob(f"*/{SETTINGS_FILE}")]
    if (folder / SETTINGS_FILE).exists():
        listed.append(_row(folder, real_path(folder).parent))
    listed.sort(key=lambda row: (row["created"] or "", row["folder"]), reverse=True)
    found = [row for row in listed if all(word in f"{_what(row)} {_who(row)} {row['folder']}".lower() for word in words)]
    if options.as_json:
        echo(json.dumps({"folder": str(folder), "sessions": found}))
        return
    for row in found:
        # Folded between its columns: a terminal of 80 columns would break it in a word.
        echo(beside(_what(row), _who(row), indent=2).rstrip())
        echo(f"  {printable(row['folder'])}")
        if row["fault"]:
            say(f"  {row['fault']}", indent=2)
    if not found:
        key = "sessions.none_such" if listed else "sessions.none"
        say(sentence(key, folder=folder, sessions=len(listed), find=options.find), err=True)


def _row(folder: Path, root: Path) -> Row:
    """Return what is listed of a session: ``planned`` positions were asked for, ``positions`` measured, ``used`` to solve it.

    ``leads_to`` is where a link leads that stands for a folder of elsewhere.
    """
    row: Row = {"folder": str(folder), "state": "damaged", **dict.fromkeys(_NOT_KNOWN)}
    place = real_path(folder)
    if place.parent != real_path(root):
        row["leads_to"] = str(place)
    try:
        session = Session.open(folder)
    except RecordingError as error:
        return row | {"fault": error.message}
    record = session.record
    row |= {"created": record.created, "instrument": record.model, "serial_number": record.instrument.serial_number}
    row |= {"port": record.link.port, "kind": record.kind, "planned": _planned(session)}
    row["state"] = "recording" if session.is_being_recorded else "finished" if record.finished else "unfinished"
    # Most have no parameters because nobody has solved them yet.
    path = folder / PARAMETER_FILE
    row |= _solved(path) if path.exists() else {}
    # Whoever was not guided counted none.
    return row | {"positions": row["used"] if record.accepted is None else record.accepted}


def _solved(path: Path) -> Row:
    """Return what a parameter file says of itself; whoever uses it checks all of it, which takes ten times as long."""
    cut = {"fault": sentence("sessions.cut", path=path)}
    try:
        text = decode_toml(read_small_file(path, Origin.INSIDE), str(path), ParameterFileError)
        tables: Row = parse_toml("".join(_TABLES.findall(text)), str(path), ParameterFileError)
    except (OSError, ParameterFileError):
        return cut
    verdict, positions = tables.get("quality", {}).get("verdict"), tables.get("session", {}).get("positions")
    is_whole = verdict in VERDICTS and isinstance(positions, int) and "integrity" in tables
    return {"verdict": verdict, "used": positions} if is_whole else cut


def _planned(session: Session) -> int | None:
    name = session.record.scheme
    with suppress(ImufieldError):
        if name:
            return len(scheme(name) if name in SCHEMES else scheme(session.folder / SCHEME_FILE, Origin.INSIDE))
    return None


def _what(row: Row) -> str:
    """Return all but instrument, folder and fault."""
    state = f"{row['state']}, not solved" if row["verdict"] is None else row["verdict"].upper()
    if row["used"] is not None and row["used"] != row["positions"]:
        # Measured since, or left out.
        state += f" ({row['used']} used)"
    if row["verdict"] is not None and row["state"] == "recording":
        state = f"recording, {state}"
    planned = f" of {row['planned']}" if row["planned"] else ""
    complete = "" if row["positions"] is None else f"{row['positions']}{planned} positions"
    when = (row["created"] or "")[:16].replace("T", " ")
    return f"{when:<16}  {state:<22}  {complete:<18} "


def _who(row: Row) -> str:
    return f"{row['instrument'] or ''} {row['serial_number'] or ''}".strip()
