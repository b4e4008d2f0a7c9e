"""The recorder: what the wire said goes to disk first, and any prefix of the file can be read.

``write_chunk`` only appends to a list; a thread of its own packs, writes and syncs every ``SYNC_INTERVAL_S``, so that a slow
disk never makes the wire wait. What that guarantees: a killed program loses what came in the last interval (plus the time of
one write), a power cut what came since the last sync, on disks that keep the promise of fsync. An error of the thread is
raised by the next call.
"""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Self

from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, SystemClock
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.mcap_format import (
    CHUNK_LIMIT_BYTES,
    chunk_record,
    end_of_part,
    event_message,
    link_message,
    start_of_part,
)
from imufield.dataclass import asdict
from imufield.errors import RecordingError
from imufield.files import open_regular, sync_folder, write_error
from imufield.sentences import Sentences

sentence = Sentences(__package__)

SYNC_INTERVAL_S = 0.3
"""With the time of one fsync, well below the one second that a crash may cost."""
BLOCK_BYTES = 1 << 20
"""A block is packed early when this much waits: bounds the memory, and what one damaged byte can cost."""
BACKLOG_LIMIT_BYTES = 16 << 20
"""Two minutes of a 1 Mbit/s wire: longer than a disk stalls. Beyond it the caller waits."""
MESSAGE_LIMIT_BYTES = CHUNK_LIMIT_BYTES - BLOCK_BYTES
"""One message more must not lift a block over what the reader accepts."""


def part_metadata(protocol: Protocol, extra: Mapping[str, object]) -> dict[str, object]:
    """Return what a part must hold to be decoded without the outside."""
    return {
        **extra,
        "protocol": protocol.name,
        "protocol_text": protocol.text,
        "protocol_sha256": protocol.sha256,
        "settings": {name: setting.value for name, setting in protocol.settings.items()},
    }


def protocol_tables(protocol: Protocol) -> dict[str, object]:
    """Return the tables of ``session.toml`` that say how its bytes are decoded, and the samples' units."""
    return {
        "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
        "settings": {name: {"value": setting.value, "origin": setting.origin} for name, setting in protocol.settings.items()},
        "units": asdict(protocol.units),
    }


class Recorder:
    """Writes one part of a session; safe to use from several threads.

    Parameters
    ----------
    path : Path
        Must not exist: nothing is ever overwritten.
    metadata : mapping
        All that is needed to decode the part without the outside: driver, protocol text and its hash, settings, port,
        identity, software. JSON-compatible values.
    clock : HostClock, optional
        Stamps the events; the system's clock by default.
    remedy : str
        What the person can do when it can be written again; what was written is safe.
    first : sequence of bytes
        Of chunks that were ``packed`` beforehand.

    Raises
    ------
    RecordingError
        If the file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: Mapping[str, object],
        *,
        clock: HostClock | None = None,
        remedy: str = "",
        first: Sequence[bytes] = (),
    ) -> None:
        self.path = Path(path)
        self._clock = clock or SystemClock()
        self._remedy = remedy
        self._file = _create(self.path, [start_of_part(metadata), *first], remedy)
        # Entered itself: a condition is entered by Python code, where an interrupt could leave the lock held for ever.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._waiting: list[bytes] = []
        self._waiting_bytes = 0
        self._sequence = count()  # Of all messages of the part, whatever thread they come from.
        self._closing = False
        self._failure: Exception | None = None
        self._failure_told = False
        self._thread = threading.Thread(target=self._run, name=f"recorder {self.path.name}", daemon=True)
        self._thread.start()

    def write_chunk(self, chunk: Chunk) -> None:
        """Record what one read returned.

        Raises
        ------
        RecordingError
            If something recorded before could not be written: disk full, file deleted, disk failing.
        """
        self._append(link_message(chunk.data, chunk.monotonic_s, chunk.utc_ns, next(self._sequence)))

    def write_event(self, event: Mapping[str, object]) -> None:
        """Record a guide event, an operator's mark or a fault of the link, stamped now.

        Raises
        ------
        RecordingError
            As ``write_chunk``.
        """
        self._append(event_message(event, self._clock.utc_ns(), next(self._sequence)))

    def close(self) -> None:
        """Write what waits and the proper end; may be called again.

        Raises
        ------
        RecordingError
            If writing failed and no call has said so yet.
        """
        with self._lock:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        # Told once: close runs at the end of a context too, where a second error would hide the first.
        if self._failure is not None and not self._failure_told:
            self._tell()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _append(self, message: bytes) -> None:
        if len(message) > MESSAGE_LIMIT_BYTES:
            raise ValueError(f"a message of {len(message)} bytes is too long to be read again: write it in pieces")
        with self._lock:
            while self._waiting_bytes > BACKLOG_LIMIT_BYTES and self._failure is None:
                self._changed.wait()
            if self._failure is not None:
                self._tell()
            if self._closing:
                raise ValueError("the recorder is closed")
            self._waiting.append(message)
            self._waiting_bytes += len(message)
            # Below a full block the thread wakes by itself, and need not at every read.
            if self._waiting_bytes >= BLOCK_BYTES:
                self._changed.notify_all()

    def _tell(self) -> None:
        if self._failure is not None:
            self._failure_told = True
            raise self._failure

    def _run(self) -> None:
        try:
            while self._write_waiting():
                pass
            _write_all(self._file, end_of_part())
            self._sync()
        except OSError as error:
            self._fail(_cannot_write(self.path, error, self._remedy))
        # A defect, too, must end the recording at its next chunk: one that ended only this thread would lose all that follows.
        except Exception as error:  # noqa: BLE001
            self._fail(error)
        finally:
            with suppress(OSError):
                os.close(self._file)

    def _write_waiting(self) -> bool:
        """Wait for the interval, or for a full block, then write; return whether to go on."""
        with self._lock:
            self._changed.wait_for(lambda: self._closing or self._waiting_bytes >= BLOCK_BYTES, SYNC_INTERVAL_S)
            taken, self._waiting, self._waiting_bytes = self._waiting, [], 0
            closing = self._closing
            self._changed.notify_all()
        # Packed and written without the lock: the thread that reads the wire must not wait for the disk.
        for messages in _blocks(taken):
            _write_all(self._file, chunk_record(messages))
        if taken:
            self._sync()
        return not closing

    def _sync(self) -> None:
        os.fsync(self._file)
        # An open file can be deleted on POSIX; writing would go on into nothing.
        if os.fstat(self._file).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.path))

    def _fail(self, failure: Exception) -> None:
        with self._lock:
            self._failure = failure
            self._changed.notify_all()


def packed(chunks: Iterable[Chunk]) -> list[bytes]:
    """Return chunks packed, which takes longer than to write them, and needs no file."""
    sequence = count()
    messages = (link_message(chunk.data, chunk.monotonic_s, chunk.utc_ns, next(sequence)) for chunk in chunks)
    return [chunk_record(block) for block in _blocks(messages)]


def _create(path: Path, content: Sequence[bytes], remedy: str) -> int:
    """Create a file that does not exist yet, make it durable and return its descriptor."""
    try:
        file = open_regular(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, follow=False)
    except OSError as error:
        raise _cannot_write(path, error, remedy) from error
    try:
        for data in content:
            _write_all(file, data)
        os.fsync(file)
        sync_folder(path.parent)
    except OSError as error:
        # Half a start is no part; left there it would be named as damage ever after.
        os.close(file)
        path.unlink(missing_ok=True)
        raise _cannot_write(path, error, remedy) from error
    return file


def _write_all(file: int, data: bytes) -> None:
    """Write all bytes; a disk that fills up takes some of them first."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]


def _blocks(messages: Iterable[bytes]) -> Iterator[list[bytes]]:
    """Cut a backlog into blocks of about ``BLOCK_BYTES``."""
    block: list[bytes] = []
    size = 0
    for message in messages:
        block.append(message)
        size += len(message)
        if size >= BLOCK_BYTES:
            yield block
            block, size = [], 0
    if block:
        yield block


def _cannot_write(path: Path, error: OSError, remedy: str) -> RecordingError:
    # A folder that was deleted, or a part that stands there already, leaves nothing to go on with.
    nothing_is_left = isinstance(error, FileNotFoundError | FileExistsError)
    advice = "" if nothing_is_left else sentence("recorder.safe", remedy=remedy)
    return write_error(path, error, RecordingError, advice=advice)
