"""The bytes of a recording: MCAP (https://mcap.dev/spec), restricted to what survives a crash and a bad disk.

A part is magic, Header (profile ``imufield``), two Channels, one Metadata record, Chunks, DataEnd, Footer, magic::

    channel 1, link     8 bytes little-endian float64 = monotonic arrival time in seconds, then the bytes as they came
    channel 2, events   one JSON object
    log time            UTC arrival in nanoseconds

Every Chunk is zstd with the CRC of its content and stands alone, so any prefix of a part can be read and any damaged chunk
skipped. There is no index: it would grow with the recording, and a reader that follows it fails on a torn file. The ``Writer``
of the ``mcap`` package would keep an index entry of each chunk in memory even when told to write none, and its record classes
take 6 ms to import, so all seven kinds of records are packed here.

Nothing here opens a file or reads a clock.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import PurePath

import zstandard
from mcap.opcode import Opcode

from imufield.files import utf8_text
from imufield.sentences import Sentences
from imufield.toml_and_json import parse_json
from imufield.version import __version__

sentence = Sentences(__package__)

MAGIC = b"\x89MCAP0\r\n"
PROFILE = b"\x08\x00\x00\x00imufield"  # In the Header, by the specification of MCAP: tells our files from those of others.
FORMAT = "imufield-recording"
VERSION = 1
LINK_CHANNEL = 1
EVENTS_CHANNEL = 2

RECORD = struct.Struct("<BQ")
"""Opcode and content length: what every record starts with."""
_MESSAGE_HEAD = struct.Struct("<HIQQ")
MESSAGE = struct.Struct("<BQHIQQ")
"""A Message record up to its data: opcode, length, channel, sequence, log time, publish time."""
ARRIVAL = struct.Struct("<d")  # Before the bytes of a link message; NaN where nobody knows when they came.
CHUNK = struct.Struct("<QQQII4sQ")
"""Content of a Chunk record up to its records: start, end, size, CRC, length of the next string, "zstd", compressed size."""
CHUNK_SIGNATURE = b"\x04\x00\x00\x00zstd"
SIGNATURE_OFFSET = RECORD.size + 28
"""Where the signature stands, counted from the opcode of the Chunk record."""
END_SIZE = RECORD.size + 4 + RECORD.size + 20 + len(MAGIC)
"""DataEnd, Footer and magic: what follows the last chunk of a finished part."""

CHUNK_LIMIT_BYTES = 64 << 20
"""Largest chunk, unpacked. The recorder makes 1 MiB; the rest is room for one long message, and a damaged length field
cannot make the reader ask for more memory than this."""
_ZSTD_LEVEL = 1  # Measured on 2000 Hz of STIM300 bytes: level 1 is within 2 % of the size of level 3 at half of its time.
_LATEST_NS = 2**64 - 1  # The largest time that a message of MCAP holds.


class DamageError(Exception):
    """A record is not what its checksum, length or version says; never leaves the reader."""


def start_of_part(metadata: Mapping[str, object]) -> bytes:
    """Return everything before the first chunk.

    Parameters
    ----------
    metadata : mapping
        JSON-compatible values: all that is needed to decode the part without the outside.
    """
    # Records outside of chunks have no checksum in MCAP, and without this one no byte can be decoded.
    text = to_json(metadata)
    kept = {"format": FORMAT, "version": str(VERSION), "json": text, "crc32": str(zlib.crc32(text.encode()))}
    entries = b"".join(_prefixed(each.encode()) for entry in kept.items() for each in entry)
    channels = ((LINK_CHANNEL, b"link", b"imufield-chunk"), (EVENTS_CHANNEL, b"events", b"json"))
    return b"".join(
        [
            MAGIC,
            _record(Opcode.HEADER, PROFILE, _prefixed(f"imufield {__version__}".encode())),
            # Without a schema, number 0, and without metadata.
            *(
                _record(Opcode.CHANNEL, struct.pack("<HH", number, 0), *map(_prefixed, (topic, encoding, b"")))
                for number, topic, encoding in channels
            ),
            _record(Opcode.METADATA, PROFILE, _prefixed(entries)),
        ]
    )


def end_of_part() -> bytes:
    """Return everything after the last chunk."""
    # Zero says "not computed": each chunk has its own, and one over all would have to be kept through a crash.
    return _record(Opcode.DATA_END, bytes(4)) + _record(Opcode.FOOTER, bytes(20)) + MAGIC


def link_message(data: bytes, monotonic_s: float, utc_ns: int, sequence: int) -> bytes:
    """Return the Message record of one chunk of the link."""
    return _message(LINK_CHANNEL, ARRIVAL.pack(monotonic_s) + data, utc_ns, sequence)


def event_message(event: Mapping[str, object], utc_ns: int, sequence: int) -> bytes:
    """Return the Message record of one event."""
    return _message(EVENTS_CHANNEL, to_json(event).encode(), utc_ns, sequence)


def _message(channel: int, data: bytes, utc_ns: int, sequence: int) -> bytes:
    # A clock set before 1970, or a damaged time stamp beyond 2554, is not worth losing bytes for.
    time_ns = min(max(utc_ns, 0), _LATEST_NS)
    return _record(Opcode.MESSAGE, _MESSAGE_HEAD.pack(channel, sequence & 0xFFFFFFFF, time_ns, time_ns), data)


def chunk_record(messages: Sequence[bytes]) -> bytes:
    """Return the Chunk record of some Message records, at least one."""
    times = [MESSAGE.unpack_from(message)[4] for message in messages]
    content = b"".join(messages)
    data = zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(content)
    head = CHUNK.pack(min(times), max(times), len(content), zlib.crc32(content), 4, b"zstd", len(data))
    return _record(Opcode.CHUNK, head, data)


def unpack_chunk(body: bytes) -> bytes:
    """Return the Message records of a Chunk record's content.

    Raises
    ------
    DamageError
        If lengths, compression or CRC do not fit.
    """
    _, _, size, crc, _, _, packed_size = CHUNK.unpack_from(body)
    packed = body[CHUNK.size :]
    if len(packed) != packed_size or size > CHUNK_LIMIT_BYTES:
        raise DamageError(sentence("mcap_format.lengths"))
    try:
        # The size inside the zstd frame decides what is allocated, so it is checked before unpacking.
        if zstandard.frame_content_size(packed) != size:
            raise DamageError(sentence("mcap_format.lengths"))
        content = zstandard.ZstdDecompressor().decompress(packed)
    except zstandard.ZstdError as error:
        raise DamageError(sentence("mcap_format.packing")) from error
    if zlib.crc32(content) != crc:
        raise DamageError(sentence("mcap_format.checksum"))
    return content


def messages(content: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Walk through the Message records of a chunk.

    Yields
    ------
    channel, utc_ns, start, end : int
        The data of the message are ``content[start:end]``.

    Raises
    ------
    DamageError
        If the records do not fill the chunk.
    """
    # By hand and not by the package, which makes an object of each message: hours of recording have millions.
    position, size = 0, len(content)
    while position + MESSAGE.size <= size:
        opcode, length, channel, _, utc_ns, _ = MESSAGE.unpack_from(content, position)
        end = position + RECORD.size + length
        if opcode != Opcode.MESSAGE or length < _MESSAGE_HEAD.size or end > size:
            raise DamageError(sentence("mcap_format.no_messages"))
        yield channel, utc_ns, position + MESSAGE.size, end
        position = end
    if position != size:
        raise DamageError(sentence("mcap_format.no_messages"))


def read_metadata(body: bytes) -> tuple[int, dict[str, object]]:
    """Return version and metadata of a Metadata record's content.

    Raises
    ------
    DamageError
        If it is not ours, or its checksum is wrong.
    """
    try:
        # Strings with a 32-bit length before each: the name, which is known, and behind the size of the map its entries.
        position, strings = 4 + int.from_bytes(body[:4], "little") + 4, []
        while position < len(body):
            (size,) = struct.unpack_from("<I", body, position)
            strings.append(body[position + 4 : position + 4 + size].decode())
            position += 4 + size
        entries = dict(zip(strings[::2], strings[1::2], strict=False))
        if entries["format"] != FORMAT or int(entries["crc32"]) != zlib.crc32(entries["json"].encode()):
            raise DamageError(sentence("mcap_format.checksum"))
        version, metadata = int(entries["version"]), parse_json(entries["json"])
    except (struct.error, KeyError, ValueError) as error:
        raise DamageError(sentence("mcap_format.unreadable")) from error
    if not isinstance(metadata, dict):
        raise DamageError(sentence("mcap_format.unreadable"))
    return version, metadata


def to_json(value: object) -> str:
    """Return JSON text; NumPy values, paths and enumerations as plain values."""
    return utf8_text(json.dumps(value, default=_plain, ensure_ascii=False))


def _plain(value: object) -> object:
    convert: Callable[[], object] | None = getattr(value, "tolist", None)
    if convert is not None:
        return convert()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _record(opcode: Opcode, *contents: bytes) -> bytes:
    return b"".join([RECORD.pack(opcode, sum(map(len, contents))), *contents])


def _prefixed(content: bytes) -> bytes:
    """Return a string, or the entries of a map, behind its length."""
    return len(content).to_bytes(4, "little") + content
