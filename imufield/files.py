"""Files: small ones written as a whole or not at all, and the one place where files of other people and programs are opened.

``write_atomically`` guarantees, on a local file system: after a crash at any moment the path holds the whole old or the
whole new content; after it returns, the new content survives a power cut. It does not guard against a file system that
ignores fsync (some network and FUSE file systems do); the hash inside the file is what finds that out.

``write_error`` is the one place that says what a failed write means: disk full, no right to write, a folder that is absent.

``open_regular`` is the one place where files are opened that people or other programs made: nothing blocks there, and no link
leads out of a folder that may come from somebody else.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from enum import Enum
from io import BufferedReader
from itertools import chain, count
from pathlib import Path
from typing import TypeVar

from imufield.errors import ImufieldError, ParameterFileError, Reason, UsageError
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

AnError = TypeVar("AnError", bound=ImufieldError)

# Names of what a session was recorded as; no command computes them again.
_RECORDED = re.compile(r"part-\d+\.mcap|session\.(toml|lock)|positions\.toml")


DEFAULT_ROOT = Path("imufield-sessions")
"""Folder of sessions, in the working folder, where no other is named."""
SMALL_FILE_LIMIT_BYTES = 1 << 24
"""A thousand positions take half a mebibyte; what is read whole is never larger than this."""
PIPE_LIMIT_S = 60.0
"""A pipe that a person names may wait for a password or a slow network; a minute is longer than either."""
PIPE_OPEN_LIMIT_S = 5.0
"""A shell starts both ends of a pipe at once: whoever has not opened it to write by then, never will."""

# Windows has none of the first two: names are looked at before the opening there, and what was opened after it everywhere.
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)
_BINARY = getattr(os, "O_BINARY", 0)
# What file systems without hard links say (FAT, some network and FUSE ones).
_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
_NAME_KEPT = 32  # Characters of a name that its temporary file repeats: at four bytes each both fit into the 255 of a name.
_NO_UTF8 = re.compile("[\ud800-\udfff]")  # What Python makes of bytes in names that are no UTF-8.


class Origin(Enum):
    """Who chose the name of a file that is read: what nobody chose may not block, and not lead elsewhere."""

    TYPED = "typed"
    """A person: links are followed, and a small file may be a pipe, as ``<(...)`` of a shell is one."""
    FOUND = "found"
    """The program, in a place of the user's own: a regular file, or a link to one."""
    INSIDE = "inside"
    """The program, in a folder that may come from somebody else: a regular file and no link."""


# What a failed write means: error numbers of the system, the reason, and the sentence.
_WRITE_FAULTS: tuple[tuple[frozenset[int], Reason, str], ...] = (
    # EDQUOT is the quota of one user; Windows has it under the same name.
    (frozenset({errno.ENOSPC, errno.EDQUOT}), Reason.DISK_FULL, "files.disk_full"),
    # A limit of the file system (4 GiB on FAT) or of the process (ulimit -f); the disk itself may have space.
    (frozenset({errno.EFBIG}), Reason.DISK_FULL, "files.size_limit"),
    (frozenset({errno.EACCES, errno.EPERM, errno.EROFS}), Reason.NO_PERMISSION, "files.no_permission"),
    # The system gives ENOENT for a name below /proc, too, though that folder exists.
    (frozenset({errno.ENOENT, errno.ENOTDIR}), Reason.FOREIGN, "files.no_folder"),
    (frozenset({errno.EISDIR}), Reason.FOREIGN, "files.folder"),
    (frozenset({errno.EEXIST}), Reason.FOREIGN, "files.exists"),
    (frozenset({errno.ENAMETOOLONG}), Reason.USAGE, "files.long_name"),
    # Of ``open_regular``: a link, pipe or device stands where a file belongs.
    (frozenset({errno.ELOOP, errno.ENXIO}), Reason.FOREIGN, "files.no_file"),
)


def write_error(path: str | Path, error: OSError, kind: type[AnError], *, advice: str = "") -> AnError:
    """Return the error that a failed write is, one sentence with its cause and remedy.

    Parameters
    ----------
    path : str or Path
        What could not be written.
    error : OSError
        As the system reports it.
    kind : type of ImufieldError
        ``RecordingError`` for recordings and samples, ``ParameterFileError`` for all else: the exit code follows from it.
    advice : str
        What else the person can do, appended to the sentence.
    """
    cause = error.strerror or str(error)
    named = ((reason, key) for numbers, reason, key in _WRITE_FAULTS if error.errno in numbers)
    reason, key = next(named, (Reason.DAMAGED, "files.cannot_write"))
    return kind(sentence(key, path=str(path), cause=cause, advice=advice), reason, errno=error.errno)


@contextmanager
def typed_write_errors(path: str | Path, kind: type[ImufieldError] = ParameterFileError, *, advice: str = "") -> Iterator[None]:
    """Raise the ``write_error`` of an OSError that comes up inside the block."""
    try:
        yield
    except OSError as error:
        raise write_error(path, error, kind, advice=advice) from error


def open_regular(path: str | Path, flags: int, *, follow: bool) -> int:
    """Return the descriptor of a regular file.

    Parameters
    ----------
    path : str or Path
    flags : int
        Those of ``os.open``.
    follow : bool
        Whether ``path`` may be a link.

    Raises
    ------
    OSError
        As the system reports it, or it is a link (ELOOP), a pipe or a device (ENXIO).
    """
    # Looked at before: to open a device may do something. Looked at after: another file may stand there by then.
    with suppress(FileNotFoundError):
        _refuse_irregular(Path(path).stat(follow_symlinks=follow).st_mode, path)
    file = os.open(path, flags | _NO_WAIT | _BINARY | (0 if follow else _NO_LINK), 0o666)
    try:
        _refuse_irregular(os.fstat(file).st_mode, path)
    except OSError:
        os.close(file)
        raise
    return file


def _refuse_irregular(mode: int, path: str | Path) -> None:
    if stat.S_ISLNK(mode):
        raise OSError(errno.ELOOP, "it is a link, which may lead elsewhere", str(path))
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.ENXIO, "it is a pipe or device, not a file", str(path))


def open_to_read(path: str | Path, origin: Origin = Origin.TYPED) -> BufferedReader:
    """Open a regular file; raises as ``open_regular``."""
    return os.fdopen(open_regular(path, os.O_RDONLY, follow=origin is not Origin.INSIDE), "rb")


def read_start(path: str | Path, size: int, origin: Origin = Origin.TYPED) -> bytes:
    """Return the first ``size`` bytes of a file, or of a pipe that a person named.

    Raises
    ------
    OSError
        As ``open_regular``, or nobody opens the pipe to write in ``PIPE_OPEN_LIMIT_S``, or it has not ended after
        ``PIPE_LIMIT_S``.
    """
    if origin is Origin.TYPED and stat.S_ISFIFO(Path(path).stat().st_mode):
        return _read_pipe(path, size)
    with open_to_read(path, origin) as file:
        return file.read(size)


def _read_pipe(path: str | Path, size: int) -> bytes:
    import selectors  # Here, as nearly no run reads a pipe.

    content = bytearray()
    end_s = time.monotonic() + PIPE_LIMIT_S
    pipe = os.fdopen(os.open(path, os.O_RDONLY | _NO_WAIT), "rb", buffering=0)
    with pipe, selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        if not selector.select(PIPE_OPEN_LIMIT_S):
            # Blocked by a writer that has nothing yet; without one it ends at once.
            with suppress(BlockingIOError):
                content += os.read(pipe.fileno(), 1)
                if not content:
                    raise TimeoutError(
                        errno.ETIMEDOUT, f"nobody opened the pipe to write in {PIPE_OPEN_LIMIT_S:g} s", str(path)
                    )
        while len(content) < size:
            left_s = end_s - time.monotonic()
            if left_s <= 0 or not selector.select(left_s):
                raise TimeoutError(errno.ETIMEDOUT, f"the pipe has not ended after {PIPE_LIMIT_S:g} s", str(path))
            piece = os.read(pipe.fileno(), size - len(content))
            if not piece:
                break
            content += piece
    return bytes(content)


def read_small_file(path: str | Path, origin: Origin = Origin.TYPED) -> bytes:
    """Return the content of a file that is read whole.

    Raises
    ------
    OSError
        As ``read_start``, or the file is larger than ``SMALL_FILE_LIMIT_BYTES``.
    """
    content = read_start(path, SMALL_FILE_LIMIT_BYTES + 1, origin)
    if len(content) > SMALL_FILE_LIMIT_BYTES:
        raise OSError(errno.EFBIG, f"it is larger than {SMALL_FILE_LIMIT_BYTES} bytes", str(path))
    return content


def utf8_text(name: object) -> str:
    """Return a name for a text that is written: bytes of it that are no UTF-8 become U+FFFD."""
    return _NO_UTF8.sub("\ufffd", str(name))


def source_date() -> datetime | None:
    """Return the date, UTC, that SOURCE_DATE_EPOCH gives to files, None without it.

    Raises
    ------
    UsageError
        If it is none.
    """
    date = os.environ.get("SOURCE_DATE_EPOCH")
    if not date:
        return None
    # Of 11 digits, in the year 5138, is the last that every system makes a date of.
    if not re.fullmatch("[0-9]{1,11}", date):
        raise UsageError(sentence("files.source_date", date=shortened(date)))
    return datetime.fromtimestamp(int(date), UTC)


def sync_folder(folder: Path) -> None:
    """Make a creation or renaming inside ``folder`` durable; without effect where a folder cannot be opened (Windows)."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        # Some file systems refuse fsync on a folder; their renames are ordered by the journal.
        return
    finally:
        os.close(descriptor)


def write_atomically(path: str | Path, data: bytes) -> None:
    """Replace the content of ``path`` in one step.

    Raises
    ------
    OSError
        As the system reports it (disk full, no permission), or ``path`` is a folder or device; it is untouched then.
    """
    path = Path(path)
    with _written_beside(path, data) as whole:
        whole.replace(path)
    sync_folder(path.parent)


@contextmanager
def _written_beside(path: Path, data: bytes) -> Iterator[Path]:
    """Write the temporary file that takes the name of ``path`` inside the block; where it does not, it is removed."""
    descriptor, name = make_beside(path)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(usual_mode(path))
        yield Path(name)
    except BaseException:
        with suppress(OSError):
            Path(name).unlink()
        raise


def publish(whole: Path, path: Path) -> None:
    """Give a temporary file the name of ``path`` in one step, which replaces nothing.

    Raises
    ------
    OSError
        As the system reports it, ``FileExistsError`` where anything has that name; both are untouched then.
    """
    if os.name == "nt":
        whole.rename(path)  # It replaces nothing there.
        return
    try:
        os.link(whole, path)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        # The name is taken first: only what is written into this empty file at the same moment could be lost.
        path.touch(exist_ok=False)
        whole.replace(path)
    else:
        whole.unlink()
    sync_folder(path.parent)


def publish_beside_others(whole: Path, path: Path) -> Path:
    """Give a temporary file the name of ``path``, or that with the first free number; return it. Raises as ``publish``."""
    return next(free for free in chain([path], _numbered(path)) if _is_published(whole, free))


def _is_published(whole: Path, path: Path) -> bool:
    with suppress(FileExistsError):
        publish(whole, path)
        return True
    return False


def make_beside(path: Path) -> tuple[int, str]:
    """Make the temporary file that takes the name of ``path`` later; return its descriptor and name.

    Raises
    ------
    OSError
        As the system reports it, or ``path`` is a folder or device.
    """
    refuse_what_is_no_file(path)
    # The same folder, because a rename is only atomic inside one file system.
    return tempfile.mkstemp(prefix=f".{path.name[:_NAME_KEPT]}.", suffix=".new", dir=path.parent)


def refuse_overwriting(
    output: Path, inputs: Iterable[Path] = (), kind: type[ImufieldError] = ParameterFileError, *, advice: str = ""
) -> None:
    """Keep a result from replacing what it comes from or any file of a recording, and from being computed for no place.

    Parameters
    ----------
    output : Path
        Where the result is to go; it need not exist.
    inputs : iterable of Path
        Files it is computed from. Other names and links of the same file count.
    kind, advice
        As ``write_error`` takes them.

    Raises
    ------
    UsageError
        If it would.
    ImufieldError
        Of the given kind, where nothing can be written.
    """
    if any(map(is_recorded, (output, real_path(output)))):
        raise UsageError(sentence("files.name_of_recording", output=output))
    for path in inputs:
        # Where one of them is not there they are not the same.
        with suppress(OSError):
            if output.samefile(path):
                raise UsageError(sentence("files.is_input", output=output))
    with typed_write_errors(output, kind, advice=advice):
        descriptor, name = make_beside(output)
        os.close(descriptor)
        Path(name).unlink()


def is_recorded(path: Path) -> bool:
    """Whether a file has a name of what a session was recorded as."""
    return _RECORDED.fullmatch(path.name) is not None


def refuse_what_is_no_file(path: Path) -> None:
    """Raise OSError for a folder or device, which a rename would move out of its place."""
    if not path.exists():
        return
    _refuse_irregular(path.stat().st_mode, path)
    place = path
    # /dev/stdout leads there, and to a file only where the shell has put one.
    while not place.parent.resolve().is_relative_to("/proc"):
        if not place.is_symlink():
            return
        place = place.parent / place.readlink()
    _refuse_irregular(stat.S_IFIFO, path)


def usual_mode(path: Path) -> int:
    """Return the permissions of the file replaced, or those of a new one."""
    try:
        return path.stat().st_mode & 0o777
    # Not there, or a link that leads nowhere.
    except OSError:
        return new_mode()


def new_mode() -> int:
    """Return the permissions that the umask gives a new file; ``make_beside`` gives 0600."""
    mask = os.umask(0)  # To be read only by setting it.
    os.umask(mask)
    return 0o666 & ~mask


def write_keeping(path: str | Path, data: bytes) -> Path | None:
    """Write as ``write_atomically`` does; a file with other content that stood there is kept as by ``keep_previous``.

    Several programs may write at once: each result is kept, the last one has the name.

    Returns
    -------
    Path or None
        Where it is kept.

    Raises
    ------
    OSError
        As the system reports it; what stood there stands there again.
    """
    path = Path(path)
    if _holds(path, data):
        # As new as what it was made of. In a folder of several people it may be somebody else's.
        with suppress(PermissionError):
            path.touch()
        return None
    kept = None
    with _written_beside(path, data) as whole:
        while True:
            kept = keep_previous(path) or kept
            try:
                publish(whole, path)
            # Another program was quicker: its result is kept, too.
            except FileExistsError:
                continue
            except OSError:
                if kept is not None:
                    with suppress(FileExistsError):
                        publish(kept, path)
                raise
            return kept


def _holds(path: Path, data: bytes) -> bool:
    with suppress(OSError):
        return read_start(path, len(data) + 1, Origin.INSIDE) == data
    return False


def keep_previous(path: str | Path) -> Path | None:
    """Rename an existing ``parameters.toml`` to the next free ``parameters-<n>.toml``; return the new name, or None."""
    path = Path(path)
    # A link that leads nowhere has the name, too.
    if not os.path.lexists(path):
        return None
    refuse_what_is_no_file(path)
    # Taken before the renaming, which would replace what another program has kept there since a mere look.
    kept = next(filter(_take, _numbered(path)))
    try:
        path.replace(kept)
    except OSError as error:
        kept.unlink()
        # Another program was quicker to keep it.
        if isinstance(error, FileNotFoundError):
            return None
        raise
    sync_folder(path.parent)
    return kept


def _numbered(path: Path) -> Iterator[Path]:
    """Yield the names of what is kept beside a file."""
    return (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(1))


def is_kept(path: Path) -> bool:
    """Whether a file has a name under which ``keep_previous`` keeps another that is there."""
    found = re.fullmatch(r"(.+)-[1-9]\d*", path.stem)
    return found is not None and path.with_name(f"{found[1]}{path.suffix}").exists()


def _take(path: Path) -> bool:
    """Make an empty file of a name that is free; return whether it was."""
    with suppress(FileExistsError):
        path.touch(exist_ok=False)
        return True
    return False


def real_path(path: str | Path) -> Path:
    """Return where a path leads, links followed; one that leads to itself, at which ``resolve`` fails, stays as it is."""
    return Path(os.path.realpath(path))
