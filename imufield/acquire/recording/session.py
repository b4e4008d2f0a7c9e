"""Session folders: ``session.toml``, ``part-001.mcap``, ``part-002.mcap`` (one part per run), results beside them.

What ``session.toml`` may hold is checked and typed in ``session_record``.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

from imufield.acquire.recording.session_record import FORMAT, VERSION, SessionRecord, Table, plain_table
from imufield.errors import Reason, RecordingError
from imufield.files import (
    DEFAULT_ROOT,
    Origin,
    open_regular,
    read_small_file,
    real_path,
    sync_folder,
    typed_write_errors,
    utf8_text,
    write_atomically,
)
from imufield.sentences import Sentences, printable
from imufield.toml_and_json import decode_toml, parse_toml
from imufield.version import __version__

sentence = Sentences(__package__)

SETTINGS_FILE = "session.toml"
LOCK_FILE = "session.lock"  # A file of its own: session.toml is replaced while it is locked.

_PART = re.compile(r"part-(\d{3,})\.mcap")
# Other folders below a root may be anything; these names are ours.
_FOLDER = re.compile(r"\d{8}T\d{6}Z-.+")
_STAMP = "%Y%m%dT%H%M%SZ"


class Session:
    """One session folder.

    Parameters
    ----------
    folder : Path
    metadata : dict
        Content of ``session.toml``, which is what is written.

    Attributes
    ----------
    record : SessionRecord
        The same checked and typed, which is what is read.

    Notes
    -----
    Made by ``create``, ``open`` and ``newest``.
    """

    def __init__(self, folder: Path, metadata: Table) -> None:
        self.folder = folder
        self.metadata = metadata
        self.record = SessionRecord.read(metadata, folder / SETTINGS_FILE)

    @classmethod
    def create(
        cls, root: str | Path, model: str, metadata: Mapping[str, object] | None = None, *, now: datetime | None = None
    ) -> Self:
        """Make ``<root>/<UTC>-<model>/`` with its ``session.toml``.

        Raises
        ------
        RecordingError
            The folder cannot be made, or a key of ``metadata`` is unknown.
        """
        moment = now or datetime.now(UTC)
        content = _new_metadata(model, metadata or {}, moment)
        with typed_write_errors(root, RecordingError):
            folder = _make_folder(Path(root), model, moment)
        return cls._written(folder, content)

    @classmethod
    def create_in(cls, folder: str | Path, model: str, metadata: Mapping[str, object] | None = None) -> Self:
        """Make a session in a folder of the user's choice, which must be empty or absent.

        Raises
        ------
        RecordingError
            There is something in the folder, it cannot be made, or a key of ``metadata`` is unknown.
        """
        folder = Path(folder)
        content = _new_metadata(model, metadata or {}, datetime.now(UTC))
        with typed_write_errors(folder, RecordingError):
            folder.mkdir(parents=True, exist_ok=True)
            is_empty = not any(folder.iterdir())
        if not is_empty:
            if (folder / SETTINGS_FILE).exists():
                raise RecordingError(sentence("session.exists", folder=str(folder)), Reason.UNFINISHED)
            raise RecordingError(sentence("session.not_empty", folder=str(folder)), Reason.FOREIGN)
        return cls._written(folder, content)

    @classmethod
    def _written(cls, folder: Path, content: Table) -> Self:
        session = cls(folder, content)
        session.write()
        # Without it a power cut can take the whole folder, however safe the files in it are.
        sync_folder(folder.parent)
        return session

    @classmethod
    def open(cls, folder: str | Path) -> Self:
        """Open an existing session; its ``session.toml`` may be given as well.

        Raises
        ------
        RecordingError
            No session there, or its ``session.toml`` is damaged, newer or has unknown keys.
        """
        folder = Path(folder)
        if folder.name == SETTINGS_FILE:
            folder = folder.parent
        path = folder / SETTINGS_FILE
        try:
            content = read_small_file(path, Origin.INSIDE)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise RecordingError(sentence("session.no_session", folder=str(folder)), Reason.NOT_A_RECORDING) from error
        except OSError as error:
            unreadable = sentence("session.unreadable", path=str(path), cause=error.strerror)
            raise RecordingError(unreadable, Reason.DAMAGED) from error
        return cls(folder, parse_toml(decode_toml(content, str(path), RecordingError), str(path), RecordingError))

    @classmethod
    def newest(cls, root: str | Path = DEFAULT_ROOT) -> Self:
        """Open the newest session below ``root``.

        Raises
        ------
        RecordingError
            There is none.
        """
        folders = cls.newest_first(root)
        if not folders:
            raise RecordingError(sentence("session.none", root=str(root)), Reason.NOT_A_RECORDING)
        return cls.open(folders[0])

    @staticmethod
    def newest_first(root: str | Path = DEFAULT_ROOT) -> list[Path]:
        """Return the folders below ``root`` that have the name and the ``session.toml`` of a session, newest first."""
        folders = [path.parent for path in Path(root).glob(f"*/{SETTINGS_FILE}") if _FOLDER.fullmatch(path.parent.name)]
        # Names start with the time of creation, and no two of them with the same.
        return sorted(folders, key=lambda folder: folder.name, reverse=True)

    @property
    def name(self) -> str:
        """Name of the folder, to be shown."""
        return printable(utf8_text(real_path(self.folder).name))

    @property
    def parts(self) -> list[Path]:
        """Paths of the parts, in the order of their numbers."""
        return [self.folder / name for _, name in sorted(self._numbered_parts())]

    def sha256(self) -> str:
        """Return the hash of the parts, in their order."""
        # With the format of a part, which a list of sessions does not need.
        from imufield.acquire.recording.part_file import open_part

        digest = hashlib.sha256()
        for path in self.parts:
            with open_part(path) as file:
                hashlib.file_digest(file, lambda: digest)
        return digest.hexdigest()

    @property
    def finished(self) -> bool:
        """Whether the session was ended by its program; an unfinished one can be resumed."""
        return self.record.finished

    @property
    def serial_number(self) -> str:
        """Of the instrument; empty where it is not known."""
        return self.record.instrument.serial_number

    def add_part(self) -> Path:
        """Return the path of the next part; the recorder creates it and refuses to overwrite."""
        last = max((number for number, _ in self._numbered_parts()), default=0)
        return self.folder / f"part-{last + 1:03d}.mcap"

    def update(self, changes: Mapping[str, object] | None = None, /, **more: object) -> None:
        """Set keys of ``session.toml``, replacing it in one step.

        Raises
        ------
        RecordingError
            A key is unknown, or the file cannot be written; nothing has changed then.
        """
        # Checked and written before this object changes, so that memory and disk never differ.
        changed = type(self)(self.folder, plain_table({**self.metadata, **(changes or {}), **more}))
        changed.write()
        self.metadata, self.record = changed.metadata, changed.record

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other programs from recording into this session.

        The lock belongs to the open file: it ends with the program, however that ends.

        Raises
        ------
        RecordingError
            Another program holds it (``LOCKED``).
        """
        path = self.folder / LOCK_FILE
        with typed_write_errors(path, RecordingError):
            # No link: what it leads to would be emptied.
            file = open_regular(path, os.O_RDWR | os.O_CREAT, follow=False)
        try:
            if not _lock(file):
                # Where there is no pread, as on Windows, the holder stays without a number.
                holder = os.pread(file, 20, 0).decode(errors="replace") if hasattr(os, "pread") else ""
                key = "session.locked_by" if holder.isdigit() else "session.locked"
                raise RecordingError(sentence(key, folder=str(self.folder), process=holder), Reason.LOCKED)
            # The number of the process only names the holder: a full disk is no reason not to hold the lock.
            with suppress(OSError):
                os.ftruncate(file, 0)
                os.write(file, str(os.getpid()).encode())
            yield
        finally:
            os.close(file)

    @property
    def is_being_recorded(self) -> bool:
        """Whether a program holds the lock now."""
        try:
            file = open_regular(self.folder / LOCK_FILE, os.O_RDWR, follow=False)
        except OSError:
            # Never recorded here, or not ours to write: whoever records made it for all.
            return False
        try:
            return not _lock(file)
        finally:
            os.close(file)

    @property
    def part_under_way(self) -> Path | None:
        """The part that a program writes now."""
        return next(reversed(self.parts), None) if self.is_being_recorded else None

    def _numbered_parts(self) -> list[tuple[int, str]]:
        found = ((_PART.fullmatch(path.name), path.name) for path in self.folder.iterdir())
        return [(int(match.group(1)), name) for match, name in found if match]

    def write(self) -> None:
        """Write ``session.toml`` in one step; raises RecordingError."""
        path = self.folder / SETTINGS_FILE
        with typed_write_errors(path, RecordingError):
            import tomli_w  # Only who writes needs it.

            write_atomically(path, tomli_w.dumps(self.metadata).encode())


def open_or_newest(folder: Path | None) -> Session:
    """Open the session in ``folder``, or the newest one below the working folder; raises RecordingError."""
    return Session.newest() if folder is None else Session.open(folder)


def create_session(folder: Path | None, root: Path, model: str, metadata: Mapping[str, object]) -> Session:
    """Make a session in ``folder``, or in a new folder below ``root``; raises RecordingError."""
    return Session.create(root, model, metadata) if folder is None else Session.create_in(folder, model, metadata)


def _new_metadata(model: str, metadata: Mapping[str, object], moment: datetime) -> Table:
    content: Mapping[str, object] = {
        "format": FORMAT,
        "version": VERSION,
        "created": moment.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        "software": f"imufield {__version__}",
        "model": model,
        "finished": False,
        **metadata,
    }
    content = plain_table(content)
    # Refused here, an impossible value leaves no folder behind.
    SessionRecord.read(content, Path(SETTINGS_FILE))
    return content


def _make_folder(root: Path, model: str, moment: datetime) -> Path:
    """Create a folder whose time stamp no other session has: of two in one second the later one gets the next second."""
    root.mkdir(parents=True, exist_ok=True)
    suffix = re.sub(r"[^A-Za-z0-9._+-]+", "-", model).strip("-.") or "imu"
    moment = moment.astimezone(UTC)
    while True:
        stamp = moment.strftime(_STAMP)
        folder = root / f"{stamp}-{suffix}"
        if not any(root.glob(f"{stamp}-*")):
            # Another program may have made the same one since the look.
            with suppress(FileExistsError):
                folder.mkdir()
                return folder
        moment += timedelta(seconds=1)


if sys.platform == "win32":
    import msvcrt

    # Windows locks bytes, and locked bytes cannot be read: one far behind the process number.
    _LOCKED_BYTE = 1 << 20

    def _lock(file: int) -> bool:
        os.lseek(file, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        os.lseek(file, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def _lock(file: int) -> bool:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
