"""The workbench: what pages ask for, done by commands of imufield, and what becomes of it, for every page to see.

Nothing is computed here: a capture never waits for anything else, and whatever a page does is a command that a person can type.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from pathlib import Path

from imufield.errors import ImufieldError, UsageError
from imufield.files import is_recorded
from imufield.sentences import Sentences
from imufield.web.actions import ACTIONS, VIRTUAL, Sessions, command_line
from imufield.web.board import Board, Json
from imufield.web.jobs import Jobs
from imufield.web.server import Service
from imufield.web.transfers import Downloads, Uploads

sentence = Sentences(__package__)

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
            values = asked.get("values", {})
            action, words = str(asked["run"]), command_line(asked["run"], values, self._sessions)
            given = values if isinstance(values, dict) else {}
            return {"job": self._jobs.start(action, given, words, is_alone=ACTIONS[action].is_alone)}
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

    def close(self) -> None:
        """End the commands that run, and remove files that have not come whole."""
        self._jobs.close()
        self._uploads.close()


def _found(folder: Path) -> Json:
    """Return what the folder of a session holds now: the names of files that were made of it, and its parameters."""
    from imufield.deliver.parameters.file import PARAMETER_FILE, load
    from imufield.deliver.report.gain import document_with_gain

    made = [path for path in folder.iterdir() if path.is_file() and not (path.is_symlink() or is_recorded(path))]
    # What begins with a point is being written.
    names = [path.name for path in made if not path.name.startswith(".")]
    # Most have no parameters because nobody has solved them yet.
    parameters = document_with_gain(load(folder)) if PARAMETER_FILE in names else None
    return {"files": sorted(names, key=lambda name: (name != PARAMETER_FILE, name)), "parameters": parameters}


def _no_number(name: str) -> None:
    raise ValueError(name)


def _read(message: str) -> dict[str, object]:
    try:
        asked = json.loads(message, parse_constant=_no_number)
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise UsageError(sentence("workbench.unknown"))
    return asked
