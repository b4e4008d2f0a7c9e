"""Files between a page and the folder of sessions: up in pieces, down by addresses that are good for one use.

The token of a page stands in no address, so that none of them is worth keeping.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from imufield.dataclass import dataclass
from imufield.errors import ImufieldError, UsageError
from imufield.files import Origin, make_beside, new_mode, open_to_read, publish_beside_others, typed_write_errors
from imufield.sentences import Sentences
from imufield.web.board import Json
from imufield.web.page_commands import UPLOADS, Sessions

sentence = Sentences(__package__)

LARGEST_UPLOAD = 1 << 30
"""Bytes: an hour of a fast instrument as text."""
LARGEST_DOWNLOAD = 1 << 26
"""Bytes: it is held in memory while it goes down; parameters, reports and overviews take some megabytes at most."""
UPLOADS_AT_ONCE = 4
ADDRESSES_AT_ONCE = 64
GOOD_FOR_S = 60.0
FILE = "/file/"
ID_BYTES = 16
"""Characters that begin each piece and say which upload it is of."""
_LONGEST_NAME = 100  # Bytes: with a number behind it, it fits into the 255 of a name.
_UNUSUAL = re.compile(r"[^\w.()+ -]+")


@dataclass(kw_only=True)
class _Upload:
    path: Path
    beside: Path
    file: BinaryIO
    left: int
    heard_s: float
    page: threading.Thread
    """Of its connection: it ends with that."""


class Uploads:
    """Files that come up.

    Parameters
    ----------
    sessions : Sessions
    """

    def __init__(self, sessions: Sessions) -> None:
        self._sessions = sessions
        self._lock = threading.Lock()
        self._open: dict[str, _Upload] = {}

    def begin(self, name: object, size: object, folder: object = None) -> Json:
        """Begin a file, in a folder of its own or one that an earlier file of the same recording was given.

        It ends with the thread that calls this, which is that of the page.

        Raises
        ------
        UsageError
            If it is too large or no recording, or too many are under way.
        """
        if not isinstance(name, str) or not isinstance(size, int) or isinstance(size, bool) or not 0 < size <= LARGEST_UPLOAD:
            raise UsageError(sentence("transfers.too_large", limit_mb=LARGEST_UPLOAD >> 20))
        # Among the sessions it would count as the parameters of an instrument.
        if (plain := _plain(name)).lower().endswith(".toml"):
            raise UsageError(sentence("transfers.no_recording", name=plain))
        with self._lock:
            self._forget_abandoned()
            if len(self._open) >= UPLOADS_AT_ONCE:
                raise UsageError(sentence("transfers.too_many", limit=UPLOADS_AT_ONCE))
            identity = secrets.token_hex(ID_BYTES // 2)
            where = self._sessions.root / UPLOADS / (_new_name() if folder is None else _known(folder))
            path = where / plain
            with typed_write_errors(path):
                # Before anything is made there.
                if not self._sessions.holds(where):
                    raise UsageError(sentence("page_commands.no_file", name=where, root=self._sessions.root))
                where.mkdir(parents=True, exist_ok=True)
                if path.exists() or any(upload.path == path for upload in self._open.values()):
                    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
                # It takes its name when it is whole: what a program that was killed leaves behind is no recording.
                descriptor, beside = make_beside(path)
                self._open[identity] = _Upload(
                    path=path,
                    beside=Path(beside),
                    file=os.fdopen(descriptor, "wb"),
                    left=size,
                    heard_s=time.monotonic(),
                    page=threading.current_thread(),
                )
        return {"upload": identity, "folder": where.name}

    def take(self, piece: bytes) -> Json:
        """Take a piece and say how much is left; with the last one, where the file is, below the folder of sessions.

        Raises
        ------
        UsageError
            If it belongs to none that is under way, or is more than was said.
        """
        identity, data = piece[:ID_BYTES].decode("ascii", "replace"), piece[ID_BYTES:]
        with self._lock:
            upload = self._open.get(identity)
            if upload is None:
                raise UsageError(sentence("transfers.unknown"))
            if len(data) > upload.left or not data:
                self._drop(identity)
                raise UsageError(sentence("transfers.more"))
            try:
                with typed_write_errors(upload.path):
                    upload.file.write(data)
                    # The last bytes are written when it is closed.
                    if len(data) == upload.left:
                        upload.file.close()
                        upload.beside.chmod(new_mode())
                        # Another program may have put a file there since it began: both stay.
                        upload.path = publish_beside_others(upload.beside, upload.path)
            except ImufieldError:
                self._drop(identity)
                raise
            upload.left -= len(data)
            upload.heard_s = time.monotonic()
            if upload.left:
                return {"upload": identity, "left": upload.left}
            del self._open[identity]
        return {"upload": identity, "left": 0, "file": str(upload.path.relative_to(self._sessions.root))}

    def close(self) -> None:
        """Remove what is not complete."""
        with self._lock:
            for identity in [*self._open]:
                self._drop(identity)

    def _forget_abandoned(self) -> None:
        """Drop the uploads of pages that went away, or send no more of a file."""
        for identity, upload in [*self._open.items()]:
            if not upload.page.is_alive() or time.monotonic() - upload.heard_s > GOOD_FOR_S:
                self._drop(identity)

    def _drop(self, identity: str) -> None:
        upload = self._open.pop(identity)
        # A folder that holds others stays; what is gone already need not go.
        for remove in (upload.file.close, upload.beside.unlink, upload.path.parent.rmdir):
            with suppress(OSError):
                remove()


def _plain(name: str) -> str:
    """Return a name of somebody's disk as one that is no hidden file, no option, and nothing that a shell would read."""
    last = re.split(r"[/\\]", name)[-1]
    kept = _UNUSUAL.sub("_", last).encode()[-_LONGEST_NAME:].decode(errors="ignore")
    return kept.lstrip(".- ") or "file"


def _new_name() -> str:
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(2)}"


def _known(folder: object) -> str:
    if not isinstance(folder, str) or not re.fullmatch(r"[0-9]{8}T[0-9]{6}Z-[0-9a-f]{4}", folder):
        raise UsageError(sentence("transfers.unknown"))
    return folder


class Downloads:
    """Files that go down, each at an address that somebody has to ask for."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._offered: dict[str, tuple[Path, float]] = {}

    def offer(self, path: Path) -> str:
        """Return an address at which the file can be had once, within a minute.

        Raises
        ------
        UsageError
            If it is too large.
        """
        size = path.stat().st_size
        if size > LARGEST_DOWNLOAD:
            sizes = {"size_mb": size >> 20, "limit_mb": LARGEST_DOWNLOAD >> 20}
            raise UsageError(sentence("transfers.too_long", name=path.name, **sizes))
        now_s = time.monotonic()
        with self._lock:
            known = {address: offer for address, offer in self._offered.items() if now_s - offer[1] < GOOD_FOR_S}
            self._offered = dict([*known.items()][-ADDRESSES_AT_ONCE + 1 :])
            address = f"{FILE}{secrets.token_urlsafe(16)}"
            self._offered[address] = path, now_s
        return address

    def take(self, address: str) -> tuple[str, bytes] | None:
        """Return the name and content of what is offered at an address, and withdraw it; None where nothing is."""
        with self._lock:
            path, offered_s = self._offered.pop(address, (None, 0.0))
        if path is None or time.monotonic() - offered_s > GOOD_FOR_S:
            return None
        try:
            # No link: since it was offered another file may stand there.
            with open_to_read(path, Origin.INSIDE) as file:
                return path.name, file.read(LARGEST_DOWNLOAD)
        # Gone, or no longer to be read: for the page there is nothing at this address.
        except OSError:
            return None
