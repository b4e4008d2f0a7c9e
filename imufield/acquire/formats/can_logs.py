"""Read logs of CAN buses (candump, Vector ASC and BLF, PEAK TRC, MF4, CSV), and replay recordings to a bus."""

from __future__ import annotations

import contextlib
import gzip
import importlib.util
import math
import re
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import IO, cast

import can
from can.io.blf import BLFParseError

from imufield.acquire.formats import array_file_reader
from imufield.acquire.formats.table_arrays import missing_package
from imufield.acquire.formats.tables import ChunkWriter
from imufield.acquire.link.can import make_message, open_bus, pack_message, parse_bus
from imufield.acquire.link.host_clock import NANOSECONDS
from imufield.acquire.link.serial import WRITE_TIMEOUT_S, Chunk
from imufield.acquire.protocol.can_frames import ERROR, LATEST_S, MOST_DATA, SENT, Frame, Unpacker, unpack_frames
from imufield.acquire.recording.reader import EndOfRecordingError, Pacer, RecordingLink
from imufield.errors import LinkError, Reason, RecordingError, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

CHUNK_S = 0.05
"""Frames of this much time make a chunk, as they do when a bus is recorded live."""
CHUNK_FRAMES = 2048


@dataclass(frozen=True, slots=True)
class _Kind:
    """A kind of log: what reads it, and what it begins with."""

    reader: Callable[..., Iterable[can.Message]]
    head: bytes
    is_binary: bool = False


_TABLE = ".csv"
_KINDS = {
    ".log": _Kind(can.CanutilsLogReader, rb"\s*\(\d+\.\d+\)\s"),
    # ASC counts from its start unless told otherwise; the date in its head makes it a time of day.
    ".asc": _Kind(partial(can.ASCReader, relative_timestamp=False), rb"(?i)\s*(date|base)\s"),
    ".blf": _Kind(can.BLFReader, rb"LOGG", is_binary=True),
    ".trc": _Kind(can.TRCReader, rb"\s*;"),
    # A process of its own makes candump's text of it.
    ".mf4": _Kind(can.CanutilsLogReader, rb"MDF"),
    _TABLE: _Kind(can.CSVReader, rb"timestamp,arbitration_id,"),
}
SUFFIXES = tuple(suffix for suffix in _KINDS if suffix != _TABLE)
"""Logs this module reads, packed with gzip too; besides, tables of python-can."""
_HEAD_BYTES = 256
# What python-can's readers raise in files that are cut short or of another kind.
_DAMAGE = (*array_file_reader.DAMAGE, can.CanError, BLFParseError)
_LONGEST_WAIT_S = 5.0  # Parts have clocks of their own: a jump of the stamps beyond this begins anew.
_EPOCH_S = 1e8  # Time stamps below 1973 count from the start of the log, not from 1970.


def is_can_log(path: str | Path) -> bool:
    """Tell by the name whether a file is a log of a CAN bus."""
    return any(suffix in SUFFIXES for suffix in Path(path).suffixes[-2:])


def begins_as_can_log(path: str | Path) -> bool:
    """Tell by name and first lines whether a file is a log of a CAN bus: others' logs and grids have the same suffixes."""
    suffixes = Path(path).suffixes[-2:]
    heads = [kind.head for suffix, kind in _KINDS.items() if suffix in suffixes]
    if not heads:
        return False
    try:
        with _opened(Path(path)) as file:
            begin = file.read(_HEAD_BYTES)
    except (OSError, EOFError, zlib.error):
        return False
    return any(re.match(head, begin) for head in heads)


def _opened(path: Path) -> IO[bytes]:
    """Open a file that may be packed."""
    return cast("IO[bytes]", gzip.open(path)) if path.suffix == ".gz" else path.open("rb")


def read_log(path: str | Path, *, channel: str | None = None, losses: list[str] | None = None) -> Iterator[Chunk]:
    """Read a log as chunks of packed frames; they arrive when the log says.

    Parameters
    ----------
    path : Path
    channel : str, optional
        Needed where the log holds more than one bus.
    losses : list of str, optional
        Receives a sentence where the log is cut or damaged behind its beginning; without it that is an error.

    Raises
    ------
    RecordingError
        The file cannot be read, or is damaged.
    UsageError
        The log holds several buses and none is chosen.
    """
    pieces: list[bytes] = []
    begin_s = last_s = 0.0
    for message in _messages(Path(path), channel, losses):
        # Stamps that go back by more than jitter begin a new chunk, too.
        if pieces and (message.timestamp - begin_s > CHUNK_S or len(pieces) >= CHUNK_FRAMES or message.timestamp < last_s - 1):
            yield _chunk(pieces, last_s)
            pieces = []
        if not pieces:
            begin_s = message.timestamp
        last_s = message.timestamp
        pieces.append(pack_message(message, message.timestamp))
    if pieces:
        yield _chunk(pieces, last_s)


def import_log(path: str | Path, recorder: ChunkWriter, *, channel: str | None = None, losses: list[str] | None = None) -> int:
    """Write a log into a recording; return the number of frames. Parameters and errors are those of ``read_log``."""
    count = 0
    for chunk in read_log(path, channel=channel, losses=losses):
        recorder.write_chunk(chunk)
        count += len(Unpacker().feed(chunk.data, last=True))
    return count


def _chunk(pieces: list[bytes], last_s: float) -> Chunk:
    is_time_of_day = _EPOCH_S < last_s < LATEST_S
    return Chunk(b"".join(pieces), last_s, round(last_s * NANOSECONDS) if is_time_of_day else 0)


def _messages(path: Path, channel: str | None, losses: list[str] | None) -> Iterator[can.Message]:
    """Yield the frames of one bus, raise or note what is lost behind them."""
    if not path.is_file():
        raise RecordingError(sentence("can_logs.no_file", path=str(path)), Reason.NOT_A_RECORDING)
    count, lost = 0, ""
    try:
        with contextlib.closing(_Reader(path)) as reader:
            for message in _of_channel(reader, path, channel):
                if not math.isfinite(message.timestamp) or len(message.data) > MOST_DATA:
                    raise ValueError(f"a frame at {message.timestamp} s, of {len(message.data)} bytes")
                count += 1
                yield message
            lost = reader.cut(count)
    except (UsageError, RecordingError):
        raise
    except _DAMAGE as error:
        if not count:
            foreign = sentence("can_logs.from_the_first", path=str(path), cause=error, frames=0)
            raise RecordingError(foreign, Reason.DAMAGED) from error
        lost = sentence("can_logs.damaged", path=str(path), frames=count, cause=array_file_reader.first_line(error))
    if count == 0:
        key = "can_logs.no_frame" if channel is None else "can_logs.no_frame_of_channel"
        raise RecordingError(sentence(key, path=str(path), channel=channel), Reason.NOT_A_RECORDING)
    if lost and losses is None:
        raise RecordingError(lost, Reason.DAMAGED)
    if lost and losses is not None:
        losses.append(lost)


def _of_channel(reader: Iterable[can.Message], path: Path, channel: str | None) -> Iterator[can.Message]:
    """Yield the messages of one bus; refuse a log of several where none is chosen."""
    first = None
    for message in reader:
        if channel is None and first is not None and message.channel != first:
            channels = (str(first), str(message.channel))
            raise UsageError(sentence("can_logs.several_buses", path=str(path), channels=channels))
        first = message.channel
        if channel is None or str(first) == channel:
            yield message


class _Reader:
    """A reader of python-can on a file of ours, which is closed in any case."""

    def __init__(self, path: Path) -> None:
        suffixes = path.suffixes[-2:]
        suffix = next((suffix for suffix in reversed(suffixes) if suffix in _KINDS), "")
        if not suffix:
            raise UsageError(sentence("can_logs.suffix", path=str(path), known=[*_KINDS]))
        kind = _KINDS[suffix]
        self._path = path
        self._size = None if path.suffix == ".gz" else path.stat().st_size
        self._process: subprocess.Popen[bytes] | None = None
        if suffix == ".mf4":
            if importlib.util.find_spec("asammdf") is None:
                raise missing_package(f"{path} is MF4, which", "asammdf", "mf4")
            # A process of its own, which writes what candump would have. -P: what stands in the present folder is nothing to
            # import.
            command = [sys.executable, "-P", array_file_reader.__file__, "mf4", str(path)]
            quiet = subprocess.DEVNULL
            self._process = subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet)  # noqa: S603  (our own)
        content = _opened(path) if self._process is None else cast("IO[bytes]", self._process.stdout)
        self._file = content if kind.is_binary else TextIOWrapper(content, encoding="utf-8", errors="replace")
        try:
            self._reader = kind.reader(self._file)
        except BaseException:
            self._file.close()
            raise

    def __iter__(self) -> Iterator[can.Message]:
        return iter(self._reader)

    def cut(self, count: int) -> str:
        """Say what is missing at the end of a BLF or MF4 file that was read to its end with ``count`` frames; "" for nothing.

        The reader stops without an error where a file ends in the middle. What the whole file holds stands in its head, or
        nothing does where the logger was never stopped.
        """
        here: dict[str, object] = {"path": str(self._path), "frames": count}
        ended = 0 if self._process is None else self._process.wait()
        if ended == array_file_reader.TOO_LARGE:
            limit = array_file_reader.memory_limit_bytes(self._path.stat().st_size) >> 20
            raise RecordingError(sentence("can_logs.memory", limit_mib=limit, **here), Reason.DAMAGED)
        if ended:
            return sentence("can_logs.broken", **here)
        reader = self._reader
        if not isinstance(reader, can.BLFReader):
            return ""
        if not reader.object_count:
            return sentence("can_logs.never_closed", **here)
        # A packed file that is cut cannot be unpacked to its end, which is an error of its own.
        if self._size is None or self._size >= reader.file_size:
            return ""
        return sentence("can_logs.cut", size=self._size, whole=reader.file_size, most=reader.object_count, **here)

    def close(self) -> None:
        self._file.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def replay_to_bus(
    link: RecordingLink,
    bus: str,
    *,
    pace: float | None = 1.0,
    bit_rate: int | None = None,
    on_chunk: Callable[[int], None] | None = None,
) -> int:
    """Send the frames of a recorded session to a bus; return how many were sent.

    Frames that were error frames stay away, and so do those the host itself sent.

    Parameters
    ----------
    link : RecordingLink
        Without a pace of its own.
    bus : str
        ``INTERFACE:CHANNEL``.
    pace : float, optional
        1 keeps the recorded pace, 8 is eight times faster, None as fast as the bus accepts frames.
    bit_rate : int, optional
    on_chunk : callable, optional
        Told the number of frames sent so far after each chunk.

    Raises
    ------
    LinkError
        The bus cannot be opened, or is gone.
    RecordingError
        As ``RecordingLink.read``.
    """
    target = open_bus(parse_bus(bus), bit_rate)
    sent = 0

    def send(frame: Frame) -> None:
        nonlocal sent
        target.send(make_message(frame.can_id, frame.data, frame.flags), timeout=WRITE_TIMEOUT_S)
        sent += 1

    try:
        return replay_frames(link, send, pace=pace, on_chunk=on_chunk)
    except can.CanError as error:
        raise LinkError(sentence("can_logs.bus_gone", bus=bus, sent=sent, cause=error), Reason.DISCONNECTED) from error
    finally:
        target.shutdown()


def replay_frames(
    link: RecordingLink,
    send: Callable[[Frame], None],
    *,
    pace: float | None = 1.0,
    on_chunk: Callable[[int], None] | None = None,
) -> int:
    """Hand the frames of a recorded session to ``send`` when they are due; otherwise like ``replay_to_bus``."""
    sent = 0
    pacer = Pacer(pace, longest_s=_LONGEST_WAIT_S)
    try:
        while True:
            chunk = link.read()
            for frame in unpack_frames(chunk.data) if chunk is not None else ():
                if frame.can_id & ERROR or frame.flags & SENT:
                    continue
                pacer.wait(frame.time_s)
                send(frame)
                sent += 1
            if on_chunk is not None:
                on_chunk(sent)
    except EndOfRecordingError:
        return sent
