"""Read logs of CAN buses (candump, Vector ASC and BLF, PEAK TRC, MF4, CSV), and replay recordings to a bus."""

from __future__ import annotations

import importlib.util
import io
import json
import math
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import IO, Any, cast

import can

from imufield.acquire.formats import foreign_file_reader
from imufield.acquire.formats.can_log_heads import CANDUMP, HEADS
from imufield.acquire.formats.table_arrays import start_reader
from imufield.acquire.formats.tables import ChunkWriter
from imufield.acquire.link.can import make_message, open_bus, pack_message, parse_bus
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import COUNTS_FROM_1970_S, NANOSECONDS
from imufield.acquire.link.serial import WRITE_TIMEOUT_S
from imufield.acquire.protocol.can_frame import ERROR, MOST_DATA, SENT, Frame
from imufield.acquire.protocol.can_frames import LATEST_S, Unpacker, unpack_frames
from imufield.acquire.recording.reader import Damage, Pacer, recorded_chunks
from imufield.acquire.recording.session import Session
from imufield.errors import LinkError, Reason, RecordingError, UsageError, missing_package
from imufield.sentences import Sentences

sentence = Sentences(__package__)

CHUNK_S = 0.05
"""Frames of this much time make a chunk, as they do when a bus is recorded live."""
CHUNK_FRAMES = 2048
_LONGEST_WAIT_S = 5.0  # Parts have clocks of their own: a jump of the stamps beyond this begins anew.
# First digit of an identifier with CAN_ERR_FLAG (0x20000000, linux/can/error.h), and that bit of it.
_ERROR_DIGIT = re.compile(r"(?<=\s)[2367ABEF](?=[\dA-F]{7}#)", re.IGNORECASE)
_ERROR_BIT = 2


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
    is_time_of_day = COUNTS_FROM_1970_S < last_s < LATEST_S
    return Chunk(b"".join(pieces), last_s, round(last_s * NANOSECONDS) if is_time_of_day else 0)


def _messages(path: Path, channel: str | None, losses: list[str] | None) -> Iterator[can.Message]:
    """Yield the frames of one bus, raise or note what is lost behind them."""
    if not path.is_file():
        raise RecordingError(sentence("can_logs.no_file", path=str(path)), Reason.NOT_A_RECORDING)
    chosen, lost = False, ""
    end: dict[str, Any] = {"read": 0}
    try:
        with closing(_frames(path, end)) as frames:
            for message in _of_channel(_counted(frames, end), path, channel):
                chosen = True
                yield message
        lost = _missing(path, end)
    except (UsageError, RecordingError):
        raise
    except foreign_file_reader.damage() as error:
        key = "can_logs.damaged" if end["read"] else "can_logs.from_the_first"
        lost = sentence(key, path=str(path), frames=end["read"], cause=foreign_file_reader.first_line(error))
    if not chosen and (end["read"] or not lost):
        key = "can_logs.no_frame_of_channel" if end["read"] else "can_logs.no_frame"
        none = sentence(key, path=str(path), channel=channel, frames=end["read"])
        raise RecordingError(none, Reason.NOT_A_RECORDING)
    if lost and (losses is None or not chosen):
        raise RecordingError(lost, Reason.DAMAGED)
    if lost and losses is not None:
        losses.append(lost)


def _counted(frames: Iterable[can.Message], end: dict[str, Any]) -> Iterator[can.Message]:
    """Yield frames that a bus can send, and count those of all buses as what was ``read``."""
    for message in frames:
        if not math.isfinite(message.timestamp) or len(message.data) > MOST_DATA:
            raise ValueError(f"a frame at {message.timestamp} s, of {len(message.data)} bytes")
        end["read"] += 1
        yield message


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


def _frames(path: Path, end: dict[str, Any]) -> Generator[can.Message, None, None]:
    """Yield the frames of a log; note in ``end`` what ``foreign_file_reader`` says of its end."""
    suffix = next((suffix for suffix in reversed(path.suffixes[-2:]) if suffix in HEADS), "")
    if not suffix:
        raise UsageError(sentence("can_logs.suffix", path=str(path), known=[*HEADS]))
    if suffix == CANDUMP:
        # Its reader looks at one line after the other and makes nothing of a length that stands there.
        with foreign_file_reader.open_log(path) as file:
            yield from _of_candump(foreign_file_reader.text_lines(file), end)
        return
    if suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        raise missing_package(f"{path} is MF4, which", "asammdf", "mf4")
    with start_reader(suffix, path) as process:
        try:
            for line in cast("IO[bytes]", process.stdout):
                if line.startswith(b"{"):
                    end |= json.loads(line)
                    return
                # The last line of a reader that breaks down may be cut.
                if line.endswith(b"\n"):
                    yield _message(line.decode())
        finally:
            process.kill()
    end["code"] = process.returncode


def _of_candump(lines: Iterable[str], end: dict[str, int]) -> Iterator[can.Message]:
    """Yield the frames of candump's lines, error frames with bus and data: python-can loses those, or takes them for data.

    Behind the first frame, lines that are none are skipped, and counted in ``end``: a logger whose power was cut goes on in the
    middle of one.
    """
    for number, line in enumerate(lines, 1):
        text, errors = _ERROR_DIGIT.subn(lambda digit: f"{int(digit[0], 16) ^ _ERROR_BIT:X}", line)
        try:
            messages = [*can.CanutilsLogReader(io.StringIO(text))]
        except foreign_file_reader.damage():
            if not end["read"]:
                raise
            end |= {"bad": end.get("bad", 0) + 1, "first_bad": end.get("first_bad", number)}
            continue
        for message in messages:
            message.is_error_frame = bool(errors)
            yield message


def _message(line: str) -> can.Message:
    """Return a frame as ``foreign_file_reader`` writes it."""
    stamp, identifier, flags, data, bus = line.rstrip().split(" ", 4)
    extended, error, remote, received, is_fd, bit_rate_switch, error_state = (flag == "1" for flag in flags)
    return can.Message(
        timestamp=float(stamp),
        arbitration_id=int(identifier),
        is_extended_id=extended,
        is_error_frame=error,
        is_remote_frame=remote,
        is_rx=received,
        is_fd=is_fd,
        bitrate_switch=bit_rate_switch,
        error_state_indicator=error_state,
        data=bytes.fromhex(data),
        channel=bus,
    )


def _missing(path: Path, end: Mapping[str, Any]) -> str:
    """Say what is missing at the end of a log that was read to its ``end``; "" for nothing.

    What a whole BLF file holds stands in its head, or nothing does where the logger was never stopped; its reader stops without
    an error where a file ends in the middle.

    Raises
    ------
    ValueError
        What is wrong, as the reader says.
    UsageError
        It could not import what reads the log.
    """
    here: dict[str, object] = {"path": str(path), "frames": end["read"]}
    size = path.stat().st_size
    if "missing" in end:
        raise missing_package(f"{path} is MF4, which", "asammdf", "mf4", end["missing"])
    if "cause" in end:
        raise ValueError(end["cause"])
    if end.get("code") == foreign_file_reader.TOO_LONG:
        return sentence("can_logs.stuck", limit_s=foreign_file_reader.longest_s(size), **here)
    if "code" in end:
        raise ValueError(f"its reader broke down ({end['code']})")
    if end.get("bad"):
        return sentence("can_logs.bad_lines", path=str(path), lines=end["bad"], first=end["first_bad"])
    if end.get("frames") == 0:
        return sentence("can_logs.never_closed", **here)
    # A packed file that is cut cannot be unpacked to its end, which is an error of its own.
    if "bytes" not in end or path.suffix == ".gz" or size >= end["bytes"]:
        return ""
    return sentence("can_logs.cut", size=size, whole=end["bytes"], most=end["frames"], **here)


def replay_to_bus(
    session: Session,
    bus: str,
    damage: list[Damage] | None = None,
    *,
    pace: float | None = 1.0,
    bit_rate: int | None = None,
) -> int:
    """Send the frames of a recorded session to a bus; return how many were sent.

    Frames that were error frames stay away, and so do those the host itself sent.

    Parameters
    ----------
    session : Session
    bus : str
        ``INTERFACE:CHANNEL``.
    damage : list of Damage, optional
        As of ``read_part``.
    pace : float, optional
        1 keeps the recorded pace, 8 is eight times faster, None as fast as the bus accepts frames.
    bit_rate : int, optional

    Raises
    ------
    LinkError
        The bus cannot be opened, or is gone.
    RecordingError
        As ``read_session``.
    """
    target = open_bus(parse_bus(bus), bit_rate)
    sent = 0

    def send(frame: Frame) -> None:
        nonlocal sent
        target.send(make_message(frame.can_id, frame.data, frame.flags), timeout=WRITE_TIMEOUT_S)
        sent += 1

    try:
        return replay_frames(session, send, damage, pace=pace)
    except can.CanError as error:
        raise LinkError(sentence("can_logs.bus_gone", bus=bus, sent=sent, cause=error), Reason.DISCONNECTED) from error
    finally:
        target.shutdown()


def replay_frames(
    session: Session,
    send: Callable[[Frame], None],
    damage: list[Damage] | None = None,
    *,
    pace: float | None = 1.0,
    on_chunk: Callable[[], object] = lambda: None,
) -> int:
    """Hand the frames of a recorded session to ``send`` when they are due; otherwise like ``replay_to_bus``."""
    sent = 0
    pacer = Pacer(pace, longest_s=_LONGEST_WAIT_S)
    # Closed, whatever ``send`` raises: an error holds the reading, and with it the line of progress.
    with closing(recorded_chunks(session, damage)) as chunks:
        for chunk in chunks:
            for frame in unpack_frames(chunk.data):
                if frame.can_id & ERROR or frame.flags & SENT:
                    continue
                pacer.wait(frame.time_s)
                send(frame)
                sent += 1
            on_chunk()
    return sent
