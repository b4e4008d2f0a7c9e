"""The workbench: what pages ask for, done by commands of imufield, and what becomes of it, for every page to see.

Nothing is computed here: a capture never waits for anything else, and whatever a page does is a command that a person can type.
"""

from __future__ import annotations

import json
import math
import os
import stat
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from imufield.acquire.recording.session import Session
from imufield.errors import ImufieldError, UsageError
from imufield.files import is_kept, is_recorded
from imufield.sentences import Sentences
from imufield.web.board import Board, Json
from imufield.web.jobs import Jobs
from imufield.web.page_commands import ACTIONS, VIRTUAL, Sessions, command_line
from imufield.web.server import Service
from imufield.web.transfers import Downloads, Uploads

sentence = Sentences(__package__)

# Files of a session that are nothing of its parameters, whatever they are older than.
_SAMPLES = "samples."
_OUTLINE = "samples.outline.csv"
_OVERVIEW = "samples.overview.csv"
# A report replaces the one before, which is not kept: one with a number beside it is somebody's own.
_REPLACED = (".html", ".pdf")
EVENTS_KEPT = 1000
"""Of all commands, for a page that comes: a session of 24 positions makes some 200."""
LARGEST_PIECE = 1 << 19
"""Bytes of a message: what a page sends of a file at a time."""
MESSAGES_A_SECOND = 50
"""Of one page: pieces of a file come one after the other, each when the one before was taken."""


class Workbench:
    """Takes what pages ask for.

    Parameters
    ----------
    root : Path
        The folder of sessions.
    """

    def __init__(self, root: Path) -> None:
        self._sessions = Sessions(root)
        self._jobs = Jobs(self._tell)
        self._uploads = Uploads(self._sessions)
        self._downloads = Downloads()
        self.service = Service(
            index="workbench.html",
            download=self._downloads.take,
            largest_message=LARGEST_PIECE,
            messages_a_second=MESSAGES_A_SECOND,
        )
        head: Json = {"root": str(root), "separator": os.sep, "virtual": VIRTUAL}
        self.board = Board(head, trace_blocks=1, log_lines=EVENTS_KEPT)
        self._telling = threading.Lock()

    def refresh(self) -> None:
        """Show what runs: a page that hears nothing believes that this program has ended."""
        self._tell()

    def _tell(self, *events: Json) -> None:
        # What ran when it was asked is shown before what ran later.
        with self._telling:
            self.board.put({"running": self._jobs.unfinished()}, log=[*events])

    def take(self, message: str | bytes) -> str:
        """Return the answer to a message of a page; called from its thread."""
        asked: object = None
        try:
            if isinstance(message, bytes):
                return json.dumps({"answer": self._uploads.take(message)})
            asked = _read(message)
            return json.dumps({"to": asked.get("id"), "answer": self._answer(asked)})
        except (ImufieldError, OSError) as error:
            refused = error.message if isinstance(error, ImufieldError) else str(error.strerror)
            return json.dumps({"to": asked.get("id") if isinstance(asked, dict) else None, "refused": refused})

    def _answer(self, asked: Mapping[str, object]) -> Json:
        """Do what a page asks for; raises ``ImufieldError``."""
        if "run" in asked:
            return {"job": self._run(asked["run"], asked.get("values", {}))}
        if "cancel" in asked:
            self._jobs.cancel(asked["cancel"])
            return {}
        if "file" in asked:
            return {"address": self._downloads.offer(self._sessions.file(asked["file"]))}
        if "session" in asked:
            return _found(self._sessions.existing(asked["session"]))
        if "upload" in asked:
            return self._uploads.begin(asked["upload"], asked.get("size"), asked.get("folder"))
        raise UsageError(sentence("workbench.unknown"))

    def _run(self, name: object, values: object) -> int:
        """Start a command and return its number; raises ``UsageError``."""
        action, given = str(name), values if isinstance(values, dict) else {}
        try:
            words = command_line(name, values, self._sessions)
            return self._jobs.start(action, given, words, is_alone=ACTIONS[action].is_alone)
        except UsageError:
            self._jobs.release(given.get("port"))
            raise

    def close(self) -> None:
        """End the commands that run, and remove files that have not come whole."""
        self._jobs.close()
        self._uploads.close()


def _found(folder: Path) -> Json:
    """Return what the folder of a session holds now.

    Returns
    -------
    dict
        ``files``, the names of what was made of it; ``earlier``, of those what is older than its parameters or was replaced;
        ``signals``, what of the formats of samples has to be made before they can be shown; ``parameters``;
        ``fault``, what is wrong with them; ``is_outdated``, whether the recording has grown since.
    """
    from imufield.deliver.parameters.file import PARAMETER_FILE, load
    from imufield.deliver.report.gain import document_with_gain

    written_ns = _written_ns(folder)
    made = [name for name in written_ns if not is_recorded(folder / name)]
    found: Json = {
        "files": sorted({*made} - {_OUTLINE}, key=lambda name: (name != PARAMETER_FILE, name)),
        "earlier": [],
        "is_outdated": False,
        "signals": _signals(folder, written_ns),
    }
    # Most have no parameters because nobody has solved them yet.
    if PARAMETER_FILE not in made:
        return {**found, "parameters": None, "fault": ""}
    is_older = {name: time_ns < written_ns[PARAMETER_FILE] for name, time_ns in written_ns.items()}
    found["earlier"] = [name for name in made if _is_earlier(folder / name, is_older=is_older[name])]
    try:
        parameters = load(folder)
        # A copy may have the time of the copying: then the recording itself is looked at.
        is_newer = any(not older for name, older in is_older.items() if _is_part(name))
        found["is_outdated"] = is_newer and Session.open(folder).sha256() != parameters.context.session.sha256
        return {**found, "parameters": document_with_gain(parameters), "fault": ""}
    # It can be solved again, whatever has become of its parameters.
    except ImufieldError as error:
        return {**found, "parameters": None, "fault": error.message}


def _signals(folder: Path, written_ns: Mapping[str, int]) -> list[str]:
    """Return what ``export-data`` has to make, one after the other, to show the signals: nothing where it was made already."""
    from imufield.pipeline.chain import OUTLINE_BYTES

    parts = [name for name in written_ns if _is_part(name)]
    if all(written_ns[name] < written_ns.get(_OVERVIEW, 0) for name in parts):
        return []
    is_long = sum((folder / name).stat().st_size for name in parts) > OUTLINE_BYTES
    # All of a long one takes long: some seconds of it are shown first.
    return ["outline", "overview"] if is_long else ["overview"]


def _is_part(name: str) -> bool:
    """Whether a file is of the recording itself; samples exported for ROS 2 have the same suffix."""
    return name.endswith(".mcap") and is_recorded(Path(name))


def _is_earlier(path: Path, *, is_older: bool) -> bool:
    """Whether a file is not of the present parameters: older than they are, or kept when another took its name."""
    return not path.name.startswith(_SAMPLES) and (is_older or (is_kept(path) and path.suffix not in _REPLACED))


def _written_ns(folder: Path) -> dict[str, int]:
    """Return when each file of a folder was written; not of those that are being written, whose names begin with a point."""
    times_ns: dict[str, int] = {}
    for path in folder.iterdir():
        # Another program may remove it or give it another name meanwhile.
        with suppress(FileNotFoundError):
            status = path.lstat()
            if stat.S_ISREG(status.st_mode) and not path.name.startswith("."):
                times_ns[path.name] = status.st_mtime_ns
    return times_ns


def _no_number(name: str) -> None:
    raise ValueError(name)


def _number(digits: str) -> float:
    """Return a number of JSON; "1e999" is none that could be one on its way back."""
    if math.isinf(value := float(digits)):
        _no_number(digits)
    return value


def _read(message: str) -> dict[str, object]:
    try:
        asked = json.loads(message, parse_constant=_no_number, parse_float=_number)
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise UsageError(sentence("workbench.unknown"))
    return asked
