"""Reading recordings: as a stream in file order, whole or torn, sound or damaged.

A part is walked record by record. A chunk whose checksum is wrong is skipped; where a length is damaged and the walk loses its
way, the next chunk is found by its signature. Either is one ``Damage`` with its place, and everything else is read.
"""

from __future__ import annotations

import filecmp
import itertools
import math
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Protocol

import numpy as np

from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, SystemClock
from imufield.acquire.recording.mcap_format import ARRIVAL, EVENTS_CHANNEL, LINK_CHANNEL, DamageError, messages
from imufield.acquire.recording.part_file import Content, PartFile, open_part
from imufield.acquire.recording.part_file import Damage as Damage  # noqa: PLC0414  (handed on)
from imufield.errors import LinkError, Reason, UsageError
from imufield.json_files import parse_json
from imufield.progress import Task, task
from imufield.samples import FloatArray, IntArray
from imufield.sentences import Sentences

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


@dataclass(frozen=True, slots=True, kw_only=True)
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


class Parts(Protocol):
    """What has parts to read: a ``Session``."""

    @property
    def parts(self) -> list[Path]:
        """Paths of the parts, in order."""
        ...


class EndOfRecordingError(LinkError):
    """The recording is read to its end; not a fault."""


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
        if isinstance(item, _Reads):
            yield from item.chunks()
        else:
            yield item


def read_session(session: Parts, damage: list[Damage] | None = None) -> Iterator[PartStart | Chunk | RecordedEvent]:
    """Read all parts of a session in order.

    Raises
    ------
    RecordingError
        As ``read_part``; a part that ends before its first block is damage, not an error.
    """
    for path in _parts_begun(session, damage):
        yield from read_part(path, damage)


def read_blocks(
    session: Parts, damage: list[Damage] | None = None, *, block_bytes: int = 1 << 20, span_s: float = BLOCK_SPAN_S
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
    with task("reading", _size(session.parts)) as reading:
        yield from _blocks(session, damage, _Joiner(block_bytes=block_bytes, span_s=span_s), reading)


def _blocks(
    session: Parts, damage: list[Damage] | None, joiner: _Joiner, reading: Task
) -> Iterator[PartStart | RecordedBlock | RecordedEvent]:
    for path in _parts_begun(session, damage):
        begun = reading.done
        for item in _items_of(path, damage):
            if isinstance(item, _Reads):
                for block in joiner.add(item):
                    reading.done = begun + joiner.done_bytes
                    yield block
                continue
            # An operator's mark is about the bytes before it: they must be decoded first.
            if joiner.pieces:
                yield joiner.take()
            yield item
        # A block never runs over the end of a part, where the decoder begins anew.
        if joiner.pieces:
            reading.done = begun + joiner.done_bytes
            yield joiner.take()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reads:
    """Consecutive chunks of the link, k of them; what is read of millions makes no object of each.

    Attributes
    ----------
    data : list of bytes
    monotonic_s : ndarray, shape (k,)
    utc_ns : tuple of int
        Beyond what a signed integer of NumPy holds where a recording is damaged.
    done_bytes : ndarray, shape (k,)
        How far the file was read at the end of each.
    """

    data: list[bytes]
    monotonic_s: FloatArray
    utc_ns: tuple[int, ...]
    done_bytes: FloatArray

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, rows: slice) -> _Reads:
        return _Reads(
            data=self.data[rows],
            monotonic_s=self.monotonic_s[rows],
            utc_ns=self.utc_ns[rows],
            done_bytes=self.done_bytes[rows],
        )

    def chunks(self) -> Iterator[Chunk]:
        """Yield one after the other."""
        return map(Chunk, self.data, self.monotonic_s.tolist(), self.utc_ns)


@dataclass(slots=True, kw_only=True)
class _Joiner:
    """Collects chunks until they make a block."""

    block_bytes: int
    span_s: float
    pieces: list[_Reads] = field(default_factory=list)
    done_bytes: float = 0.0

    def add(self, reads: _Reads) -> Iterator[RecordedBlock]:
        """Yield the blocks that these chunks complete; the others are kept."""
        while (rows := self._that_fit(reads)) < len(reads):
            self._keep(reads[:rows])
            yield self.take()
            reads = reads[rows:]
        self._keep(reads)

    def _that_fit(self, reads: _Reads) -> int:
        """Return how many chunks belong to the block that is being collected."""
        times_s, before = reads.monotonic_s, self.pieces
        first_s, last_s = (before[0].monotonic_s[0], before[-1].monotonic_s[-1]) if before else (times_s[0], times_s[0])
        size = np.cumsum(np.fromiter(map(len, reads.data), dtype=np.int64, count=len(reads)))
        size += sum(len(data) for piece in before for data in piece.data)
        # Either way: a time that runs back, as in logs of other programs, must not be smoothed over.
        paused = np.abs(np.diff(times_s, prepend=last_s)) > SILENCE_S
        ends = (size > self.block_bytes) | (times_s - first_s > self.span_s) | paused
        # However long the first is.
        ends[0] &= bool(before)
        return int(np.argmax(ends)) if ends.any() else len(reads)

    def _keep(self, reads: _Reads) -> None:
        if len(reads):
            self.pieces.append(reads)
            self.done_bytes = float(reads.done_bytes[-1])

    def take(self) -> RecordedBlock:
        pieces, self.pieces = self.pieces, []
        data = [chunk for piece in pieces for chunk in piece.data]
        return RecordedBlock(
            data=b"".join(data),
            end=np.cumsum(np.fromiter(map(len, data), dtype=np.int64, count=len(data))),
            monotonic_s=np.concatenate([piece.monotonic_s for piece in pieces]),
            first_utc_ns=pieces[0].utc_ns[0],
            utc_ns=pieces[-1].utc_ns[-1],
        )


def _parts_begun(session: Parts, damage: list[Damage] | None) -> Iterator[Path]:
    """Leave out parts without a byte: what a program leaves that is killed in the moment it creates one; and copies of others.

    A copy would count as evidence of its own and make every uncertainty too small.
    """
    begun: dict[Path, int] = {}
    before = 0
    found: list[Damage] = [] if damage is None else damage
    for path in session.parts:
        digits = path.stem.rpartition("-")[2]
        # A file that a person named otherwise has no place in the count.
        if digits.isdecimal():
            # Numbers are given one after the other.
            if int(digits) > before + 1:
                first, last = (path.with_name(f"part-{gone:03d}{path.suffix}") for gone in (before + 1, int(digits) - 1))
                what = sentence("reader.part_gone" if first == last else "reader.parts_gone", path=first, last=last.name)
                found.append(Damage(path=first, offset=0, length_bytes=0, what=what))
            before = int(digits)
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


def _size(paths: Iterable[Path]) -> int:
    """Return the bytes of files; one that is gone is missed by whoever opens it."""
    return sum(path.stat().st_size for path in paths if path.is_file())


def _items_of(path: Path, damage: list[Damage] | None) -> Iterator[PartStart | _Reads | RecordedEvent]:
    """Yield the start of a part, then what our two channels hold."""
    with PartFile(path) as part:
        contents = _one_ahead(part.contents())
        # The metadata stand before the first chunk: reading that far makes them known.
        first = next(contents, None)
        yield PartStart(path, part.metadata)
        for content in itertools.chain([] if first is None else [first], contents):
            try:
                # All of a chunk is checked before any of it is given away: half of one would be lost samples without a trace.
                items = _items_in(content)
            except DamageError as error:
                part.note(content.offset, error)
                continue
            yield from items
        if damage is not None:
            # What cannot be used may have been noted after a place further on.
            damage.extend(sorted(part.damage, key=lambda place: place.offset))


def _one_ahead(contents: Iterator[Content]) -> Iterator[Content]:
    """Yield what there is, a thread unpacking the next meanwhile."""
    with ThreadPoolExecutor(1) as thread:
        following = thread.submit(next, contents, None)
        while (content := following.result()) is not None:
            following = thread.submit(next, contents, None)
            yield content


def _items_in(content: Content) -> list[_Reads | RecordedEvent]:
    """Return what our two channels hold in a chunk; raise DamageError where it cannot be used."""
    items: list[_Reads | RecordedEvent] = []
    for channel, found in itertools.groupby(messages(content.messages), key=itemgetter(0)):
        if channel == LINK_CHANNEL:
            items.append(_reads_in(content, *zip(*found, strict=True)))
        elif channel == EVENTS_CHANNEL:
            items += [RecordedEvent(_event(content.messages[start:end]), utc_ns) for _, utc_ns, start, end in found]
    return items


def _reads_in(
    content: Content, _: tuple[int, ...], utc_ns: tuple[int, ...], starts: tuple[int, ...], ends: tuple[int, ...]
) -> _Reads:
    text, start, end = content.messages, np.array(starts), np.array(ends)
    if (end - start).min() < ARRIVAL.size:
        raise DamageError(sentence("reader.no_arrival"))
    stamps = np.frombuffer(text, dtype=np.uint8)[start[:, np.newaxis] + np.arange(ARRIVAL.size)]
    return _Reads(
        data=[text[begin + ARRIVAL.size : stop] for begin, stop in zip(starts, ends, strict=True)],
        monotonic_s=stamps.view("<f8")[:, 0].astype(np.float64),
        utc_ns=utc_ns,
        done_bytes=content.offset + (content.end - content.offset) * end / len(text),
    )


def _event(text: bytes) -> dict[str, object]:
    try:
        event = parse_json(text)
    except ValueError:
        event = None
    if not isinstance(event, dict):
        raise DamageError(sentence("reader.no_json"))
    return event


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


class RecordingLink:
    """A recording that poses as a link.

    Parameters
    ----------
    session : Session or iterable of parts
        What to read.
    pace : float, optional
        1 delivers as fast as it was recorded, 8 eight times faster; as fast as possible by default.
    clock : HostClock, optional
        Waits for the pace.
    """

    def __init__(self, session: Parts | Iterable[Path], *, pace: float | None = None, clock: HostClock | None = None) -> None:
        paths = list(session) if isinstance(session, Iterable) else session.parts
        self.name = str(paths[0].parent) if paths else "recording"
        self.damage: list[Damage] = []
        self._items = self._read(paths)
        self._pacer = Pacer(pace, clock)
        # Whether what was read so far says when it arrived; an imported dump does not, and has no pace.
        self.has_arrival_times = True

    def _read(self, paths: list[Path]) -> Iterator[PartStart | Chunk | RecordedEvent]:
        with task("sending", _size(paths)) as sending:
            for path in paths:
                begun = sending.done
                for item in _items_of(path, self.damage):
                    if not isinstance(item, _Reads):
                        yield item
                        continue
                    for chunk, done_bytes in zip(item.chunks(), item.done_bytes.tolist(), strict=True):
                        sending.done = begun + done_bytes
                        yield chunk

    def read(self) -> Chunk | None:
        """Return the next chunk with the arrival times of the recording.

        Raises
        ------
        EndOfRecordingError
            There is no more.
        RecordingError
            As ``read_part``.
        """
        for item in self._items:
            if isinstance(item, PartStart):
                # Each run has a monotonic clock of its own, and the pause between runs is not waited for.
                self._pacer.begin_anew()
            elif isinstance(item, Chunk):
                if math.isnan(item.monotonic_s):
                    self.has_arrival_times = False
                else:
                    self._pacer.wait(item.monotonic_s)
                return item
        raise EndOfRecordingError(sentence("reader.end", name=self.name), Reason.DISCONNECTED)

    def write(self, data: bytes) -> None:
        """Refuse: a recording takes no commands."""
        raise LinkError(sentence("reader.no_commands", name=self.name, size=len(data)), Reason.USAGE)

    def close(self) -> None:
        """Stop reading; may be called again."""
        self._items = iter(())
