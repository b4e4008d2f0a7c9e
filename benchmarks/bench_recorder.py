"""The recorder beside the decoder on a pseudo-terminal at 2000 Hz, and reading back forty minutes of it.

A second process sends valid STIM300 datagrams 0x93 (40 bytes with CR LF) at the real rate; what is measured is the processor
time of reading, recording and decoding in this one. ``python benchmarks/bench_recorder.py 60`` takes 60 s.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np

from imufield.acquire.decoder import Decoder
from imufield.acquire.link.serial import Chunk, open_link
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.reader import RecordedBlock, read_blocks, read_part
from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import Session
from imufield.simulate.wire.stim300 import close_datagrams

RATE_HZ = 2000
FRAME_BYTES = 40
DURATION_S = 60.0
BURST_S = 0.004
LONG_SESSION_S = 2400.0
CHUNK_S = 0.02


def make_stream(frames: int) -> bytes:
    """Return datagrams 0x93 with CR LF, noise of a few bits as a still instrument sends it."""
    rng = np.random.default_rng(1)
    body = np.zeros((frames, 34), dtype=np.uint8)
    body[:, 0] = 0x93
    for start in (1, 4, 7, 11, 14, 17, 21, 24, 27):
        body[:, start + 1] = rng.integers(0, 4, frames)
        body[:, start + 2] = rng.integers(0, 256, frames)
    body[:, 31] = np.arange(frames) % 256
    return bytes(close_datagrams(body, crlf=True).tobytes())


def send(duration_s: float) -> None:
    """Send on a new pseudo-terminal at the real rate; its name goes to stdout, frames sent at the end."""
    stream = memoryview(make_stream(256 * 40))
    master, slave = os.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    sys.stdin.readline()
    start_s, sent, total = time.monotonic(), 0, round(duration_s * RATE_HZ)
    while sent < total:
        due = min(int((time.monotonic() - start_s) * RATE_HZ), total)
        while sent < due:
            at = sent * FRAME_BYTES % len(stream)
            piece = stream[at : at + (due - sent) * FRAME_BYTES]
            os.write(master, piece)
            sent += len(piece) // FRAME_BYTES
        time.sleep(BURST_S)
    print(sent, flush=True)
    sys.stdin.readline()


def record_live(folder: Path, duration_s: float) -> dict[str, float]:
    """Read, record and decode what the second process sends; return frames, samples, chunks and processor share."""
    command = [sys.executable, __file__, "--send", str(duration_s)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as sender:
        assert sender.stdin is not None
        assert sender.stdout is not None
        link = open_link(sender.stdout.readline().strip(), baud=921600)
        decoder = Decoder(load_protocol("stim300"))
        sender.stdin.write("go\n")
        sender.stdin.flush()
        chunks, samples, silent = 0, 0, 0
        begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
        with Recorder(folder / "part-001.mcap", {}) as recorder:
            while silent < 5:
                chunk = link.read()
                if chunk is None:
                    silent += 1 if chunks else 0
                    continue
                silent = 0
                recorder.write_chunk(chunk)
                samples += len(decoder.feed(chunk.data, chunk.monotonic_s))
                chunks += 1
        used_s, took_s = time.process_time() - begin_cpu_s, time.perf_counter() - begin_s
        samples += len(decoder.flush())
        sent = int(sender.stdout.readline())
        link.close()
        sender.stdin.write("end\n")
    return {"sent": sent, "samples": samples, "lost": sent - samples, "chunks": chunks, "cpu": used_s / took_s}


def write_long(folder: Path) -> Session:
    """Record forty minutes as fast as the disk takes them."""
    session = Session.create(folder, "stim300")
    stream = make_stream(256 * 40)
    size = round(CHUNK_S * RATE_HZ) * FRAME_BYTES
    with Recorder(session.add_part(), {}) as recorder:
        for number in range(round(LONG_SESSION_S / CHUNK_S)):
            at = number * size % len(stream)
            recorder.write_chunk(Chunk(stream[at : at + size], number * CHUNK_S, 1_700_000_000_000_000_000 + number))
    return session


def _row(name: str, value: float, unit: str) -> dict[str, Any]:
    return {"name": name, "value": value, "unit": unit, "peer": None, "ratio": None}


def run(duration_s: float = DURATION_S) -> list[dict[str, Any]]:
    """Return one row for each figure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        live = record_live(folder, duration_s)
        begin_s = time.perf_counter()
        session = write_long(folder)
        write_s = time.perf_counter() - begin_s
        begin_s = time.perf_counter()
        items = sum(1 for _ in read_part(session.parts[0]))
        items_s = time.perf_counter() - begin_s
        begin_s = time.perf_counter()
        blocks = [len(item.data) for item in read_blocks(session) if isinstance(item, RecordedBlock)]
        blocks_s = time.perf_counter() - begin_s
        assert sum(blocks) == LONG_SESSION_S * RATE_HZ * FRAME_BYTES
        size = session.parts[0].stat().st_size
    return [
        _row(f"2000 Hz for {duration_s:g} s: link, recorder, decoder", 100.0 * live["cpu"], "% of a core"),
        _row("2000 Hz: frames lost", live["lost"], f"of {live['sent']:.0f}"),
        _row("2000 Hz: chunks a second", live["chunks"] / duration_s, "1/s"),
        _row("40 min at 2000 Hz: recording", write_s, "s"),
        _row("40 min at 2000 Hz: size of the part", size / 1e6, f"MB of {sum(blocks) / 1e6:.0f}"),
        _row(f"40 min at 2000 Hz: reading {items} chunks", items_s, "s"),
        _row(f"40 min at 2000 Hz: reading {len(blocks)} joined blocks", blocks_s, "s"),
    ]


def main() -> None:
    """Print the figures as a table."""
    if sys.argv[1:2] == ["--send"]:
        send(float(sys.argv[2]))
        return
    for row in run(float(sys.argv[1]) if len(sys.argv) > 1 else DURATION_S):
        print(f"{row['name']:58} {row['value']:10.3f}  {row['unit']}")


if __name__ == "__main__":
    main()
