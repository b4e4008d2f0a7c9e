"""One part of a recording as a file: walking its records, finding the way again after damage, naming what was lost."""

from __future__ import annotations

import os
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.opcode import Opcode

from imufield.acquire.recording.mcap_format import (
    CHUNK,
    CHUNK_LIMIT_BYTES,
    CHUNK_SIGNATURE,
    END_SIZE,
    MAGIC,
    PROFILE,
    RECORD,
    SIGNATURE_OFFSET,
    VERSION,
    DamageError,
    read_metadata,
    unpack_chunk,
)
from imufield.dataclass import dataclass
from imufield.errors import Reason, RecordingError
from imufield.files import Origin, open_to_read
from imufield.sentences import Sentences

sentence = Sentences(__package__)

RECORD_LIMIT_BYTES = CHUNK_LIMIT_BYTES + (1 << 20)
"""Largest record accepted, a packed chunk being a little larger than an unpacked one at worst: limits what is allocated."""
# Windows of the search for the next chunk.
_FIRST_SEARCH_BYTES = 4 << 10  # Many damaged places cost little.
_LARGEST_SEARCH_BYTES = 1 << 20  # As large as a usual chunk, so that one read finds its end.
_SEARCH_GROWTH = 16
_PROFILE_AT = len(MAGIC) + RECORD.size  # Where it stands in the file, behind the start of the Header record.
_START_BYTES = 64  # Enough for the magic and the Header record up to its profile.
_HEAD_LIMIT_BYTES = 64  # Header and Channel records have about 35: with a damaged length they must not swallow a chunk.
_BYTES_MAY_DIFFER = 2  # Damaged bytes at which the start of a file is still taken for ours; foreign files differ in nearly all.


def is_part(path: str | Path) -> bool:
    """Tell by its first bytes whether a file is a recording of ours."""
    try:
        with open_to_read(path) as file:
            start = file.read(_START_BYTES)
    except OSError:
        return False
    return start.startswith(MAGIC) and start[_PROFILE_AT : _PROFILE_AT + len(PROFILE)] == PROFILE


def open_part(path: Path) -> BufferedReader:
    """Open a part of a session for reading.

    Raises
    ------
    RecordingError
        It is not there, no regular file, or cannot be opened.
    """
    try:
        return open_to_read(path, Origin.INSIDE)
    except OSError as error:
        unreadable = sentence("part_file.unreadable", path=str(path), cause=error.strerror)
        raise RecordingError(unreadable, Reason.NOT_A_RECORDING) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """A stretch of a part that could not be read.

    Attributes
    ----------
    path : Path
    offset, length_bytes : int
        Where in the file, and how much was skipped.
    what : str
        The sentence for people.
    torn_end : bool
        The recording was cut off here: what a killed program leaves behind.
    """

    path: Path
    offset: int
    length_bytes: int
    what: str
    torn_end: bool = False


class PartFile:
    """A part opened for reading.

    Attributes
    ----------
    metadata : dict
        Known once the first content was read.
    damage : list of Damage
    finished : bool
        Whether the proper end was found.
    read_bytes : int
        Where what was read last ends.

    Raises
    ------
    RecordingError
        The file cannot be opened, or is not a recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, object] = {}
        self.damage: list[Damage] = []
        self.finished = False
        self.read_bytes = 0
        self._in_head = True
        self._file = open_part(path)
        try:
            # As it is now: a part that is being recorded grows, and what comes later is not read.
            self._size = os.fstat(self._file.fileno()).st_size
            self._check_start(self._file.read(_START_BYTES))
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._file.close()

    def contents(self) -> Iterator[tuple[int, bytes]]:
        """Yield place and Message records of every sound chunk."""
        position = len(MAGIC)
        while position < self._size and not self.finished:
            self._file.seek(position)
            try:
                opcode, body = self._record(position)
                self.read_bytes = self._file.tell()
                content = self._handle(opcode, body)
            except DamageError as error:
                position = self._skip(position, error)
                continue
            if content is not None:
                yield position, content
            position += RECORD.size + len(body)
        if not self.finished and (not self.damage or not self.damage[-1].torn_end):
            self._note("part_file.no_end", self._size, torn_end=True)

    def note(self, offset: int, why: DamageError) -> None:
        """Record that the chunk at ``offset`` is sound in itself but cannot be used."""
        self._note("part_file.left_out", offset, cause=why)

    def _record(self, position: int) -> tuple[int, bytes]:
        """Read one record; the file stands at it."""
        head = self._file.read(RECORD.size)
        if len(head) < RECORD.size:
            raise DamageError(sentence("part_file.ends_inside"))
        opcode, length = RECORD.unpack(head)
        # Checked before reading: a damaged length must not ask for memory that nobody has.
        if length > min(RECORD_LIMIT_BYTES, self._size - position - RECORD.size):
            raise DamageError(sentence("part_file.ends_inside"))
        return opcode, self._file.read(length)

    def _handle(self, opcode: int, body: bytes) -> bytes | None:
        """Take one record in; return the content of a chunk."""
        if opcode == Opcode.CHUNK:
            self._in_head = False
            if len(body) < CHUNK.size:
                raise DamageError(sentence("part_file.too_short"))
            return unpack_chunk(body)
        if opcode == Opcode.METADATA:
            self._in_head = False
            version, self.metadata = read_metadata(body)
            # A newer one may pack its chunks otherwise: to guess would be to call a sound file damaged.
            if version > VERSION:
                raise self._refused("part_file.newer", Reason.NEWER, version=version, limit=VERSION)
        elif opcode == Opcode.DATA_END:
            # A chunk whose opcode was damaged into this one must not end the reading.
            self.finished = self._file.tell() == self._size - END_SIZE + RECORD.size + 4
            if not self.finished:
                raise DamageError(sentence("part_file.early_end"))
        elif not self._in_head or opcode not in (Opcode.HEADER, Opcode.CHANNEL) or len(body) > _HEAD_LIMIT_BYTES:
            raise DamageError(sentence("part_file.unknown_kind"))
        return None

    def _skip(self, position: int, error: DamageError) -> int:
        """Note the damage and return where to go on: the next chunk that can be recognised."""
        # One byte on and not behind the record: it is its length that may be damaged.
        follows = self._next_chunk(position + 1)
        end = self._size if follows is None else follows
        key = "part_file.cut_off" if follows is None else "part_file.damaged"
        self._note(key, position, end - position, torn_end=follows is None, cause=error)
        return end

    def _note(self, key: str, offset: int, length: int = 0, *, torn_end: bool = False, **values: object) -> None:
        what = sentence(key, path=self.path, offset=offset, length=length, **values)
        self.damage.append(Damage(path=self.path, offset=offset, length_bytes=length, what=what, torn_end=torn_end))

    def _next_chunk(self, position: int) -> int | None:
        """Find the next Chunk record at or after ``position`` by its signature and matching lengths."""
        window_start, size = position, _FIRST_SEARCH_BYTES
        while window_start < self._size:
            self._file.seek(window_start)
            # A signature may lie across two windows, with the head it is checked with before it.
            window = self._file.read(size + SIGNATURE_OFFSET + CHUNK.size)
            found = window.find(CHUNK_SIGNATURE, SIGNATURE_OFFSET)
            while found >= 0:
                start = found - SIGNATURE_OFFSET
                if self._is_chunk(window[start : start + RECORD.size + CHUNK.size], window_start + start):
                    return window_start + start
                found = window.find(CHUNK_SIGNATURE, found + 1)
            window_start += size
            size = min(_SEARCH_GROWTH * size, _LARGEST_SEARCH_BYTES)
        # Damage in the last chunk: DataEnd, Footer and magic say that nothing else is missing.
        start = self._size - END_SIZE
        if start < position:
            return None
        self._file.seek(start)
        tail = self._file.read(END_SIZE)
        return start if tail.startswith(RECORD.pack(Opcode.DATA_END, 4)) and tail.endswith(MAGIC) else None

    def _is_chunk(self, head: bytes, position: int) -> bool:
        if len(head) < RECORD.size + CHUNK.size:
            return False
        opcode, length = RECORD.unpack_from(head)
        packed_size = CHUNK.unpack_from(head, RECORD.size)[-1]
        # The signature alone may come up in what was recorded; with lengths that agree it hardly does.
        fits = length == CHUNK.size + packed_size and position + RECORD.size + length <= self._size
        return bool(opcode == Opcode.CHUNK and fits)

    def _check_start(self, start: bytes) -> None:
        """Refuse what is not ours; a few damaged bytes are forgiven."""
        expected = MAGIC + bytes([Opcode.HEADER])
        there = start[: len(expected)] + start[_PROFILE_AT : _PROFILE_AT + len(PROFILE)]
        differ = sum(a != b for a, b in zip(there, expected + PROFILE, strict=False))
        if not start:
            raise self._refused("part_file.empty")
        # The sixth byte of the magic is the version of MCAP, "0" up to now.
        if start[:5] == MAGIC[:5] and start[6:8] == MAGIC[6:8] and start[5] > MAGIC[5] and differ > _BYTES_MAY_DIFFER:
            raise self._refused("part_file.newer_mcap", Reason.NEWER, version=chr(start[5]), limit=VERSION)
        if differ > _BYTES_MAY_DIFFER:
            raise self._refused("part_file.other_mcap" if start.startswith(MAGIC) else "part_file.foreign")
        if differ:
            self._note("part_file.start", 0, len(expected), found=differ)

    def _refused(self, key: str, reason: Reason = Reason.NOT_A_RECORDING, **values: object) -> RecordingError:
        return RecordingError(sentence(key, path=str(self.path), **values), reason)
