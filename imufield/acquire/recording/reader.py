"""Reading recordings: as a stream in file order, whole or torn, sound or damaged.

A part is walked record by record. A chunk whose checksum is wrong is skipped; where a length is damaged and the walk loses its
way, the next chunk is found by its signature. Either is one ``Damage`` with its place, and everything else is read.
"""

from __future__ import annotations

import filecmp
import itertools
import json
import math
import os
from collections.abc import Generator, Iterable, Iterator
from pathlib import Path

import numpy as np

from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, SystemClock
from imufield.acquire.recording.mcap_format import ARRIVAL, EVENTS_CHANNEL, LINK_CHANNEL, DamageError, messages
from imufield.acquire.recording.part_file import Damage as Damage  # noqa: PLC0414  (handed on)
from imufield.acquire.recording.part_file import PartFile, open_part
from imufield.acquire.recording.session import Session
from imufield.dataclass import dataclass, field
from imufield.errors import UsageError
from imufield.progress import Task, task
from imufield.samples import FloatArray, IntArray
from imufield.sentences import Sentences
from imufield.toml_and_json import parse_json

sentence = Sentences(__package__)

BLOCK_SPAN_S = 1.0
"""A block joins at most this much of the wire."""
SILENCE_S = 0.25
"""A pause of the wire longer than this ends a block, so that the bytes before it keep their arrival time."""


@dataclass(frozen=True, slots=True)
class PartStart:
    """The first item of each part. Clocks, counters and half frames do not carry over from the part before.

    Attributes
    ----------
    path : Path
    metadata : dict
        What the recorder was given; empty where the file is torn or damaged there.
    """

    path: Path
    metadata: dict[str, object]


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """One event, in file order between the chunks."""

    event: dict[str, object]
    utc_ns: int


@dataclass(slots=True, kw_only=True)  # One for each block: a frozen one takes five times as long to make.
class RecordedBlock:
    """Consecutive chunks of k reads, joined.

    Attributes
    ----------
    data : bytes
    end : ndarray of int64, shape (k,)
        Where each chunk ends in ``data``; the last is ``len(data)``.
    monotonic_s : ndarray, shape (k,)
        Arrival of the last byte of each chunk.
    first_utc_ns, utc_ns : int
        Arrival of the first and of the last chunk.
    """

    data: bytes
    end: IntArray
    monotonic_s: FloatArray
    first_utc_ns: int
    utc_ns: int


def read_part(path: str | Path, damage: list[Damage] | None = None) -> Iterator[PartStart | Chunk | RecordedEvent]:
    """Read one part in file order.

    Parameters
    ----------
    path : Path
    damage : list of Damage, optional
        Receives what was skipped, and a torn end.

    Raises
    ------
    RecordingError
        Not a recording, a newer version, or the file cannot be read.
    """
    for item in _items_of(Path(path), damage):
        yield Chunk(*item) if isinstance(item, tuple) else item


def read_session(session: Session, damage: list[Damage] | None = None) -> Iterator[PartStart | Chunk | RecordedEvent]:
    """Read all parts of a session in order.

    Raises
    ------
    RecordingError
        As ``read_part``; a part that ends before its first block is damage, not an error.
    """
    for path in _parts_begun(session, damage):
        yield from read_part(path, damage)


def read_blocks(
    session: Session, damage: list[Damage] | None = None, *, block_bytes: int = 1 << 20, span_s: float = BLOCK_SPAN_S
) -> Iterator[PartStart | RecordedBlock | RecordedEvent]:
    """Read all parts of a session with consecutive chunks joined, which is what decodes fast.

    Parameters
    ----------
    session : Session
    damage : list of Damage, optional
        Receives what was skipped.
    block_bytes : int
        A block is not continued beyond this size.
    span_s : float
        Nor beyond this time of the wire, nor over a pause of 0.25 s, nor over an event.
    """
    with task("reading", size_bytes(session.parts)) as reading:
        yield from _blocks(session, damage, ReadJoiner(block_bytes=block_bytes, span_s=span_s), reading)


def _blocks(
    session: Session, damage: list[Damage] | None, joiner: ReadJoiner, reading: Task
) -> Iterator[PartStart | RecordedBlock | RecordedEvent]:
    for path in _parts_begun(session, damage):
        for item in _items_of(path, damage, reading):
            if isinstance(item, tuple):
                data, monotonic_s, utc_ns = item
                if joiner.must_end_before(monotonic_s, len(data)):
                    yield joiner.take()
                joiner.add(data, monotonic_s, utc_ns)
                continue
            # An operator's mark is about the bytes before it: they must be decoded first.
            if joiner.pieces:
                yield joiner.take()
            yield item
        # A block never runs over the end of a part, where the decoder begins anew.
        if joiner.pieces:
            yield joiner.take()


@dataclass(slots=True, kw_only=True)
class ReadJoiner:
    """Collects reads until they make a block."""

    span_s: float
    block_bytes: int = 1 << 20
    pieces: list[bytes] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    size: int = 0
    first_utc_ns: int = 0
    utc_ns: int = 0

    def must_end_before(self, monotonic_s: float, size: int) -> bool:
        """Whether a read of this time and size begins a new block."""
        return bool(self.pieces) and (
            self.size + size > self.block_bytes
            or monotonic_s - self.times[0] > self.span_s
            # Either way: a time that runs back, as in logs of other programs, must not be smoothed over.
            or abs(monotonic_s - self.times[-1]) > SILENCE_S
        )

    def add(self, data: bytes, monotonic_s: float, utc_ns: int) -> None:
        """Take the next read."""
        if not self.pieces:
            self.first_utc_ns = utc_ns
        self.pieces.append(data)
        self.times.append(monotonic_s)
        self.size += len(data)
        self.utc_ns = utc_ns

    def take(self) -> RecordedBlock:
        """Return what was collected, and begin anew."""
        ends = np.array(list(itertools.accumulate(map(len, self.pieces))), dtype=np.int64)
        data, times_s = b"".join(self.pieces), np.array(self.times)
        block = RecordedBlock(data=data, end=ends, monotonic_s=times_s, first_utc_ns=self.first_utc_ns, utc_ns=self.utc_ns)
        self.pieces, self.times, self.size = [], [], 0
        return block


def _parts_begun(session: Session, damage: list[Damage] | None) -> Iterator[Path]:
    """Leave out parts without a byte: what a program leaves that is killed in the moment it creates one; and copies of others.

    A copy would count as evidence of its own and make every uncertainty too small.
    """
    begun: dict[Path, int] = {}
    before = 0
    found: list[Damage] = [] if damage is None else damage
    for path in session.parts:
        number = int(path.stem.rpartition("-")[2])
        # Numbers are given one after the other.
        if number > before + 1:
            first, last = (path.with_name(f"part-{gone:03d}{path.suffix}") for gone in (before + 1, number - 1))
            what = sentence("reader.part_gone" if first == last else "reader.parts_gone", path=first, last=last.name)
            found.append(Damage(path=first, offset=0, length_bytes=0, what=what))
        before = number
        with open_part(path) as file:
            size = os.fstat(file.fileno()).st_size
        # Bytes are compared only where the sizes agree, so that sound sessions are not read twice.
        original = next((other for other in begun if begun[other] == size and filecmp.cmp(path, other, shallow=False)), None)
        if original is not None:
            what = sentence("reader.copy", path=path, original=original.name)
            found.append(Damage(path=path, offset=0, length_bytes=size, what=what))
        elif not size:
            what = sentence("reader.empty", path=path)
            found.append(Damage(path=path, offset=0, length_bytes=0, what=what, torn_end=True))
        else:
            begun[path] = size
            yield path


# Bytes of a chunk, its arrival on the monotonic clock and in UTC: fields of ``Chunk``, an object of which costs more.
_Chunk = tuple[bytes, float, int]


def size_bytes(paths: Iterable[Path]) -> int:
    """Return the size of parts together; one that is gone is missed by whoever opens it."""
    return sum(path.stat().st_size for path in paths if path.is_file())


def _items_of(
    path: Path, damage: list[Damage] | None, reading: Task | None = None
) -> Iterator[PartStart | _Chunk | RecordedEvent]:
    """Yield the start of a part, then what our two channels hold."""
    with PartFile(path) as part:
        contents = part.contents()
        # The metadata stand before the first chunk: reading that far makes them known.
        first = next(contents, None)
        yield PartStart(path, part.metadata)
        begun = 0 if reading is None else reading.done
        for offset, content in itertools.chain([] if first is None else [first], contents):
            try:
                checked = [message for message in messages(content) if _is_sound(content, message)]
            except DamageError as error:
                part.note(offset, error)
                continue
            # Nothing of a chunk is given away before all of it is checked: half of one would be lost samples without a trace.
            for channel, utc_ns, start, end in checked:
                if reading is not None:
                    reading.done = begun + offset + (part.read_bytes - offset) * end / len(content)
                if channel == EVENTS_CHANNEL:
                    yield RecordedEvent(json.loads(content[start:end]), utc_ns)
                else:
                    yield content[start + ARRIVAL.size : end], ARRIVAL.unpack_from(content, start)[0], utc_ns
        if damage is not None:
            damage.extend(part.damage)


def _is_sound(content: bytes, message: tuple[int, int, int, int]) -> bool:
    """Tell whether a message is of one of our channels; raise DamageError where it is but cannot be used."""
    channel, _, start, end = message
    if channel == EVENTS_CHANNEL:
        try:
            is_object = isinstance(parse_json(content[start:end]), dict)
        except ValueError:
            is_object = False
        if not is_object:
            raise DamageError(sentence("reader.no_json"))
        return True
    if channel == LINK_CHANNEL and end - start < ARRIVAL.size:
        raise DamageError(sentence("reader.no_arrival"))
    return channel == LINK_CHANNEL


class Pacer:
    """Waits until what was recorded is due.

    Parameters
    ----------
    pace : float, optional
        1 is as fast as it was recorded, 8 eight times faster; by default nothing is waited for.
    clock : HostClock, optional
    longest_s : float
        A jump of the times beyond this begins anew.
    """

    _SHORTEST_S = 0.001  # Below what a system sleeps reliably.

    def __init__(self, pace: float | None, clock: HostClock | None = None, *, longest_s: float = math.inf) -> None:
        if pace is not None and not pace > 0.0:
            raise UsageError(sentence("reader.pace", pace=pace))
        self._pace = pace
        self._clock = clock or SystemClock()
        self._longest_s = longest_s
        self._offset_s: float | None = None

    def begin_anew(self) -> None:
        """Take the next time for due at once."""
        self._offset_s = None

    def wait(self, time_s: float) -> None:
        """Wait until a time of the recording."""
        if self._pace is None:
            return
        due_s, now_s = time_s / self._pace, self._clock.monotonic_s()
        ahead_s = None if self._offset_s is None else due_s + self._offset_s - now_s
        if ahead_s is None or abs(ahead_s) > self._longest_s:
            self._offset_s, ahead_s = now_s - due_s, 0.0
        if ahead_s >= self._SHORTEST_S:
            self._clock.sleep(ahead_s)


def recorded_chunks(
    session: Session, damage: list[Damage] | None = None, *, pace: float | None = None, clock: HostClock | None = None
) -> Generator[Chunk]:
    """Yield what the link delivered, each chunk when it is due; one without an arrival time, as of an imported dump, at once.

    Parameters
    ----------
    session : Session
    damage : list of Damage, optional
        As of ``read_part``.
    pace : float, optional
        1 is as fast as it was recorded, 8 eight times faster; as fast as possible by default.
    clock : HostClock, optional
        Waits for the pace.

    Raises
    ------
    RecordingError
        As ``read_session``.
    UsageError
        The pace is not above 0.
    """
    pacer = Pacer(pace, clock)
    with task("sending", size_bytes(session.parts)) as sending:
        for path in _parts_begun(session, damage):
            # Each run has a monotonic clock of its own, and the pause between runs is not waited for.
            pacer.begin_anew()
            for item in _items_of(path, damage, sending):
                if isinstance(item, tuple):
                    chunk = Chunk(*item)
                    if not math.isnan(chunk.monotonic_s):
                        pacer.wait(chunk.monotonic_s)
                    yield chunk
