"""Bytes to samples of every byte-stream format.

The STIM300 is timed against a careful parser of one frame at a time, MicroStrain against the maker's own C++ library
(``pip install pymscl``; left out where it is not there), both in this run. All streams are made here: those of the STIM300
are datagrams 0x93 with CR LF (40 bytes), counter stepping as at 2000 Hz.
"""

from __future__ import annotations

import multiprocessing
import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.rows import Row, print_rows, row
from benchmarks.wire_streams import STREAMS, Stream, microstrain
from imufield.acquire.decoder import Decoder
from imufield.acquire.link.serial import COLLECT_S
from imufield.acquire.protocol.checksum import make_checksum
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.recording.reader import ReadJoiner
from imufield.pipeline.intake import DECODED_EVERY_S

FRAMES = 200_000
PEER_FRAMES = 20_000
BLOCK_BYTES = 1 << 16
ROUNDS = 5


def make_stream(frames: int, seed: int = 1) -> bytes:
    """Return ``frames`` datagrams 0x93 with CR LF."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((frames, 40), dtype=np.uint8)
    rows[:, 0] = 0x93
    rows[:, 1:31] = rng.integers(0, 256, (frames, 30), dtype=np.uint8)
    rows[:, [10, 20, 30]] = 0
    rows[:, 31] = np.arange(frames) % 256
    rows[:, 32:34] = (1, 0xFA)
    crc = make_checksum("CRC-32/MPEG-2", pad_to=4).of_rows(rows[:, :34])
    rows[:, 34:38] = crc.astype(">u4").view(np.uint8).reshape(frames, 4)
    rows[:, 38:] = (13, 10)
    return rows.tobytes()


class PerFrameParser:
    """What a careful engineer writes without NumPy: CRC by a table of 256 entries, one frame at a time."""

    def __init__(self) -> None:
        crc = make_checksum("CRC-32/MPEG-2")
        spread = np.zeros((256, 1), dtype=np.uint8)
        spread[:, 0] = np.arange(256)
        zero = crc.of_rows(spread[:1])[0]
        table = crc.of_rows(spread) ^ zero
        # step(register, byte) = register << 8 ^ table[register >> 24 ^ byte]: the usual table of 256 entries
        self.table = [int(value) for value in table]
        self.words = struct.Struct(">BH")

    def crc(self, frame: bytes) -> int:
        table = self.table
        register = 0xFFFFFFFF
        for byte in frame:
            register = (register << 8 & 0xFFFFFFFF) ^ table[register >> 24 ^ byte]
        return register

    def parse(self, data: bytes) -> list[tuple[Any, ...]]:
        """Return (time, counter, status, gyroscope x3, accelerometer x3) of every good frame."""
        out = []
        at, end = 0, len(data) - 38
        integer, words, crc = int.from_bytes, self.words, self.crc
        gyroscope, accelerometer = np.pi / 180 / 2**14, 9.80665 / 2**19
        ticks = last = 0
        while at <= end:
            if data[at] != 0x93 or crc(data[at : at + 34] + b"\x00\x00") != integer(data[at + 34 : at + 38], "big"):
                at += 1
                continue
            gx = integer(data[at + 1 : at + 4], "big", signed=True) * gyroscope
            gy = integer(data[at + 4 : at + 7], "big", signed=True) * gyroscope
            gz = integer(data[at + 7 : at + 10], "big", signed=True) * gyroscope
            ax = integer(data[at + 11 : at + 14], "big", signed=True) * accelerometer
            ay = integer(data[at + 14 : at + 17], "big", signed=True) * accelerometer
            az = integer(data[at + 17 : at + 20], "big", signed=True) * accelerometer
            counter, _ = words.unpack_from(data, at + 31)
            ticks += (counter - last) % 256
            last = counter
            out.append((ticks / 2000, counter, data[at + 10] << 8 | data[at + 20], gx, gy, gz, ax, ay, az))
            at += 38
            if data[at : at + 2] == b"\r\n":
                at += 2
        return out


def _blocks(data: bytes, size: int) -> Iterator[bytes]:
    return (data[at : at + size] for at in range(0, len(data), size))


def _decode(data: bytes, size: int, protocol: Protocol | None = None) -> int:
    decoder = Decoder(protocol or load_protocol("stim300"))
    count = 0
    for number, block in enumerate(_blocks(data, size)):
        count += len(decoder.feed(block, number * size / 80_000))
    return count + len(decoder.flush())


def decode_live(data: bytes, size: int, protocol: Protocol) -> int:
    """Decode reads of a size, one every 20 ms, as a capture does: joined for a moment."""
    decoder, waiting, count = Decoder(protocol), ReadJoiner(span_s=DECODED_EVERY_S), 0
    for number, read in enumerate(_blocks(data, size)):
        if waiting.must_end_before(number * COLLECT_S, size):
            block = waiting.take()
            count += len(decoder.feed_chunks(block.data, block.end, block.monotonic_s))
        waiting.add(read, number * COLLECT_S, 0)
    block = waiting.take()
    return count + len(decoder.feed_chunks(block.data, block.end, block.monotonic_s)) + len(decoder.flush())


def _best_s(work: Callable[[], object]) -> float:
    best = float("inf")
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begin)
    return best


def _format_rows(make: Callable[[int], Stream], peer: float | None) -> Iterator[Row]:
    stream = make(FRAMES)
    protocol = load_protocol(stream.protocol, stream.settings)
    size = len(stream.data) // stream.frames
    frames = stream.frames
    large = frames / _best_s(lambda: _decode(stream.data, BLOCK_BYTES, protocol)) / 1e6
    yield row(f"{stream.name}, 64 KiB blocks", large, "million frames/s", peer)
    # All of it, as above: a decoder learns its stream once, whatever the size of the blocks.
    rate = frames / _best_s(lambda: _decode(stream.data, 80 * size, protocol)) / 1e6
    yield row(f"{stream.name}, blocks of 80 frames", rate, "million frames/s", peer)
    yield row(f"{stream.name}, blocks of 80 frames (peer: 64 KiB)", rate, "million frames/s", large)
    live = frames / _best_s(lambda: decode_live(stream.data, 80 * size, protocol)) / 1e6
    yield row(f"{stream.name}, live reads of 80 frames (peer: 64 KiB)", live, "million frames/s", large)


def _serve(data: bytes, port: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port.put(server.getsockname()[1])
        connection, _ = server.accept()
        time.sleep(0.5)
        connection.sendall(data)
        time.sleep(10)


def mscl_rate() -> float | None:
    """Return packets per second of the maker's library in millions, None where it is not installed.

    Only the time of this process counts, so that waiting for the socket costs nothing; values are not even asked for.
    """
    try:
        import mscl
    except ImportError:
        return None
    port: Any = multiprocessing.Queue()
    stream = microstrain(100_000)
    server = multiprocessing.Process(target=_serve, args=(stream.data, port), daemon=True)
    server.start()
    node = mscl.InertialNode(mscl.Connection.TcpIp("127.0.0.1", port.get()))
    packets, begin = 0, time.process_time()
    while packets < 0.9 * stream.frames and (found := len(node.getDataPackets(2000))):
        packets += found
    used_s = time.process_time() - begin
    server.terminate()
    return packets / used_s / 1e6 if packets else None


def run() -> list[Row]:
    """Return one row for each figure: name, value, unit, peer's value and ratio (None where there is no peer)."""
    return [*_stim300_rows(), *_all_format_rows()]


def _all_format_rows() -> Iterator[Row]:
    mscl_peer = mscl_rate()
    for make in STREAMS:
        yield from _format_rows(make, mscl_peer if make.__name__.startswith("microstrain") else None)


def _stim300_rows() -> list[Row]:
    clean = make_stream(FRAMES)
    short = clean[: 40 * PEER_FRAMES]
    parser = PerFrameParser()
    assert len(parser.parse(short)) == PEER_FRAMES
    peer = PEER_FRAMES / _best_s(lambda: parser.parse(short)) / 1e6
    assert _decode(clean, BLOCK_BYTES) == FRAMES
    clean_rate = FRAMES / _best_s(lambda: _decode(clean, BLOCK_BYTES)) / 1e6
    small_rate = FRAMES / _best_s(lambda: _decode(clean, 80 * 40)) / 1e6
    live_rate = FRAMES / _best_s(lambda: decode_live(clean, 80 * 40, load_protocol("stim300"))) / 1e6

    flipped = np.frombuffer(clean, dtype=np.uint8).copy()
    rng = np.random.default_rng(2)
    hits = np.flatnonzero(rng.random(len(flipped)) < 1e-4)
    flipped[hits] ^= (1 << rng.integers(0, 8, len(hits))).astype(np.uint8)
    damaged = flipped.tobytes()
    flip_rate = FRAMES / _best_s(lambda: _decode(damaged, BLOCK_BYTES)) / 1e6
    dropped = np.delete(np.frombuffer(clean, dtype=np.uint8), hits).tobytes()
    drop_rate = FRAMES / _best_s(lambda: _decode(dropped, BLOCK_BYTES)) / 1e6

    noise = np.random.default_rng(3).integers(0, 256, 1 << 22, dtype=np.uint8).tobytes()
    quarter = len(noise) // 4
    quarter_s = _best_s(lambda: _decode(noise[:quarter], BLOCK_BYTES))
    noise_s = _best_s(lambda: _decode(noise, BLOCK_BYTES))
    return [
        row("STIM300, 64 KiB blocks", clean_rate, "million frames/s", peer),
        row("STIM300, blocks of 80 frames", small_rate, "million frames/s", peer),
        row("STIM300, blocks of 80 frames (peer: 64 KiB)", small_rate, "million frames/s", clean_rate),
        row("STIM300, live reads of 80 frames (peer: 64 KiB)", live_rate, "million frames/s", clean_rate),
        row("STIM300, bit flips at 1e-4 per byte (peer: clean rate)", flip_rate, "million frames/s", clean_rate),
        row("STIM300, bytes lost at 1e-4 (peer: clean rate)", drop_rate, "million frames/s", clean_rate),
        row("noise, 1 MiB", quarter / quarter_s / 1e6, "MB/s"),
        row("noise, 4 MiB (peer: 1 MiB)", len(noise) / noise_s / 1e6, "MB/s", quarter / quarter_s / 1e6),
    ]


def main() -> None:
    """Print the figures as a table."""
    print_rows(run())


if __name__ == "__main__":
    main()
