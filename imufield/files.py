"""Small files that are either the old or the new one, never half of each.

``write_atomically`` guarantees, on a local file system: after a crash at any moment the path holds the whole old or the
whole new content; after it returns, the new content survives a power cut. It does not guard against a file system that
ignores fsync (some network and FUSE file systems do); the hash inside the file is what finds that out.
"""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from imufield.errors import ImufieldError, ParameterFileError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

AnError = TypeVar("AnError", bound=ImufieldError)

# Names of what a session was recorded as; no command computes them again.
_RECORDED = re.compile(r"part-\d+\.mcap|session\.toml|positions\.toml")


DEFAULT_ROOT = Path("imufield-sessions")
"""Folder of sessions, in the working folder, where no other is named."""
SMALL_FILE_LIMIT_BYTES = 1 << 24
"""A thousand positions take half a mebibyte; what is read whole is never larger than this."""


# What a failed write means: error numbers of the system, the reason, and the sentence.
_WRITE_FAULTS: tuple[tuple[frozenset[int], Reason, str], ...] = (
    # EDQUOT is the quota of one user; Windows has it under the same name.
    (frozenset({errno.ENOSPC, errno.EDQUOT}), Reason.DISK_FULL, "files.disk_full"),
    # A limit of the file system (4 GiB on FAT) or of the process (ulimit -f); the disk itself may have space.
    (frozenset({errno.EFBIG}), Reason.DISK_FULL, "files.size_limit"),
    (frozenset({errno.EACCES, errno.EPERM, errno.EROFS}), Reason.NO_PERMISSION, "files.no_permission"),
    # The system gives ENOENT for a name below /proc, too, though that folder exists.
    (frozenset({errno.ENOENT, errno.ENOTDIR}), Reason.FOREIGN, "files.no_folder"),
    (frozenset({errno.EEXIST, errno.EISDIR}), Reason.FOREIGN, "files.exists"),
    (frozenset({errno.ENAMETOOLONG}), Reason.USAGE, "files.long_name"),
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


def read_small_file(path: str | Path) -> bytes:
    """Return the content of a file that is read whole.

    Raises
    ------
    OSError
        As the system reports it, or the file is larger than ``SMALL_FILE_LIMIT_BYTES``: a device may have no end.
    """
    with Path(path).open("rb") as file:
        content = file.read(SMALL_FILE_LIMIT_BYTES + 1)
    if len(content) > SMALL_FILE_LIMIT_BYTES:
        raise OSError(errno.EFBIG, f"it is larger than {SMALL_FILE_LIMIT_BYTES} bytes", str(path))
    return content


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
    refuse_what_is_no_file(path)
    # The same folder, because a rename is only atomic inside one file system.
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".new", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(_usual_mode(path))
        Path(name).replace(path)
    except BaseException:
        with suppress(OSError):
            Path(name).unlink()
        raise
    sync_folder(path.parent)


def refuse_overwriting(output: Path, inputs: Iterable[Path] = ()) -> None:
    """Keep a result from replacing what it comes from, or any file of a recording.

    Parameters
    ----------
    output : Path
        Where the result is to go; it need not exist.
    inputs : iterable of Path
        Files it is computed from. Other names and links of the same file count.

    Raises
    ------
    UsageError
        If it would.
    """
    if any(_RECORDED.fullmatch(name) for name in (output.name, Path(os.path.realpath(output)).name)):
        raise UsageError(sentence("files.name_of_recording", output=output))
    for path in inputs:
        # Where one of them is not there they are not the same.
        with suppress(OSError):
            if output.samefile(path):
                raise UsageError(sentence("files.is_input", output=output))


def refuse_what_is_no_file(path: Path) -> None:
    """Raise OSError for a folder or device, which a rename would move out of its place."""
    if path.exists() and not path.is_file():
        raise FileExistsError(errno.EEXIST, "it is a folder or device, not a file", str(path))


def _usual_mode(path: Path) -> int:
    """Return the permissions of the file replaced, or what the umask gives a new one (mkstemp gives 0600)."""
    try:
        return path.stat().st_mode & 0o777
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask


def write_keeping(path: str | Path, data: bytes) -> Path | None:
    """Write as ``write_atomically`` does; a file with other content that stood there is kept as by ``keep_previous``.

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
    kept = None if path.is_file() and path.read_bytes() == data else keep_previous(path)
    try:
        write_atomically(path, data)
    except OSError:
        if kept is not None:
            kept.rename(path)
        raise
    return kept


def keep_previous(path: str | Path) -> Path | None:
    """Rename an existing ``parameters.toml`` to the next free ``parameters-<n>.toml``; return the new name, or None."""
    path = Path(path)
    if not path.exists():
        return None
    refuse_what_is_no_file(path)
    number = 1
    while (kept := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
        number += 1
    path.rename(kept)
    sync_folder(path.parent)
    return kept
