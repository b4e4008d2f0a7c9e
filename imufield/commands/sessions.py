"""``imufield sessions``: the sessions of a folder, from what stands beside the recordings; nothing is decoded."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import TypedDict

from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.commands.options.commands import SessionsOptions
from imufield.commands.terminal.output import echo, say
from imufield.deliver.parameters.file import PARAMETER_FILE
from imufield.deliver.parameters.read import read_document
from imufield.errors import ImufieldError, ParameterFileError, RecordingError, UsageError
from imufield.files import DEFAULT_ROOT, Origin
from imufield.guide.positions import SCHEME_FILE, SCHEMES, scheme
from imufield.sentences import Sentences

sentence = Sentences(__package__)


class Row(TypedDict):
    """What is listed of a session, in JSON under the same names; null where it is not known."""

    folder: str
    created: str
    instrument: str
    serial_number: str
    kind: str
    state: str
    """finished, unfinished, recording or damaged."""
    planned: int | None
    """Positions that were asked for."""
    positions: int | None
    """Positions that the parameters come from."""
    verdict: str | None
    fault: str | None


def list_sessions(options: SessionsOptions) -> None:
    """Print the sessions of a folder, the newest first; one that cannot be read is listed as damaged, with its error.

    Raises
    ------
    UsageError
        If the folder that was named is none.
    """
    folder = options.folder
    if not folder.is_dir() and folder != DEFAULT_ROOT:
        raise UsageError(sentence("sessions.no_folder", folder=folder))
    rows = sorted((_describe(path.parent) for path in folder.glob(f"*/{SETTINGS_FILE}")), key=_age, reverse=True)
    words = (options.find or "").lower().split()
    found = [row for row in rows if all(word in f"{_line(row)} {row['folder']}".lower() for word in words)]
    if options.as_json:
        echo(json.dumps({"folder": str(folder), "sessions": found}))
        return
    for row in found:
        echo(f"{_line(row)}\n  {row['folder']}")
        if row["fault"]:
            say(f"  {row['fault']}", indent=2)
    if not found:
        key = "sessions.none_such" if rows else "sessions.none"
        say(sentence(key, folder=folder, sessions=len(rows), find=options.find), err=True)


def _age(row: Row) -> tuple[str, str]:
    return row["created"], row["folder"]


def _describe(folder: Path) -> Row:
    row = Row(
        folder=str(folder),
        created="",
        instrument="",
        serial_number="",
        kind="",
        state="damaged",
        planned=None,
        positions=None,
        verdict=None,
        fault=None,
    )
    try:
        session = Session.open(folder)
    except RecordingError as error:
        row["fault"] = error.message
        return row
    record = session.record
    row["created"], row["instrument"], row["serial_number"] = record.created, record.model, record.instrument.serial_number
    row["kind"], row["planned"] = record.kind, _planned(session)
    row["state"] = "recording" if session.is_being_recorded else "finished" if record.finished else "unfinished"
    try:
        document = read_document(folder / PARAMETER_FILE, Origin.INSIDE).document
        row["verdict"], row["positions"] = document["quality"]["verdict"], len(document["position"])
    except ParameterFileError as error:
        # Most are not solved yet.
        row["fault"] = error.message if (folder / PARAMETER_FILE).exists() else None
    return row


def _planned(session: Session) -> int | None:
    name = session.record.scheme
    with suppress(ImufieldError):
        if name:
            return len(scheme(name) if name in SCHEMES else scheme(session.folder / SCHEME_FILE, Origin.INSIDE))
    return None


def _line(row: Row) -> str:
    state = f"{row['state']}, not solved" if row["verdict"] is None else row["verdict"].upper()
    complete = "" if row["positions"] is None else f"{row['positions']} of {row['planned'] or '?'} positions"
    return (
        f"{row['created'][:16].replace('T', ' '):<16}  {state:<22}  {complete:<18}  {row['instrument']} {row['serial_number']}"
    )
