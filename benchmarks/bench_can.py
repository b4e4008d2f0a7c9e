"""CAN frames to samples against cantools message by message; a live bus against python-can's own ``recv()``. All in this run.

The stream is that of a J1939 unit: acceleration and angular rate, 1000 samples a second. Live, a process emulates it on
UDP multicast, another reads and records it through imufield, and a third calls ``recv()`` and does nothing else; their
processor times are compared. Then the same on slcan over a pseudo-terminal, as a cheap USB adapter speaks it, with a unit of
three messages a sample and one reader at a time. ``--live-s`` shortens the 60 s, ``--slcan-s`` the 20 s.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cantools
import numpy as np

from benchmarks.bench_decode import decode_live
from benchmarks.rows import Row, print_rows, row
from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.can_frame import EXTENDED, MARK, UNIT_BYTES
from imufield.acquire.protocol.protocol import load_protocol

SAMPLES = 200_000
PEER_FRAMES = 40_000
BLOCK_BYTES = 1 << 16
ROUNDS = 7
RATE_HZ = 1000.0
GROUP = "239.74.163.77"
_EMULATE = """
import sys
from imufield.acquire.protocol.protocol import load_protocol
from imufield.simulate.emulator.can import CanEmulator
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.emulator.core import EmulatorSettings
source = make_virtual_imu(Emulation(device="text", rate_hz=float(sys.argv[2])))
with CanEmulator(load_protocol(sys.argv[4]), source, sys.argv[1], EmulatorSettings(duration_s=float(sys.argv[3]))) as emulator:
    print(emulator.bus, flush=True)
    emulator.wait()
    print(emulator.samples_sent, flush=True)
"""
_READ = """
import json, resource, sys, time
from pathlib import Path
from imufield.acquire.decoder import Decoder
from imufield.acquire.link.can import open_can_link
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.recorder import Recorder
from imufield.errors import LinkError
link, decoder = open_can_link(sys.argv[1]), Decoder(load_protocol(sys.argv[3]))
recorder = Recorder(Path(sys.argv[2]) / "part-001.mcap", {})
print("ready", flush=True)
samples, last, began = 0, time.monotonic(), None
while time.monotonic() - last < 2.0 or began is None:
    try:
        chunk = link.read()
    except LinkError:
        break
    if chunk is None:
        continue
    if began is None:
        before, began = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
    last = time.monotonic()
    recorder.write_chunk(chunk)
    samples += len(decoder.feed(chunk.data, chunk.monotonic_s))
    after = resource.getrusage(resource.RUSAGE_SELF)
samples += len(decoder.flush())
recorder.close()
link.close()
cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
lost = decoder.statistics.losses_estimated
print(json.dumps({"samples": samples, "lost": lost, "cpu": cpu / (last - began)}), flush=True)
"""
_RECEIVE = """
import can, contextlib, json, resource, sys, time
from imufield.acquire.link.can import parse_bus
address = parse_bus(sys.argv[1])
bus = can.Bus(address.channel, address.interface, ignore_config=True, **address.options)
print("ready", flush=True)
frames, last, began = 0, time.monotonic(), None
while time.monotonic() - last < 2.0 or began is None:
    try:
        message = bus.recv(0.05)
    except (ValueError, IndexError):
        continue
    except can.CanError:
        break
    if message is None:
        continue
    if began is None:
        before, began = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
        last = began
    frames += 1
    if not frames % 64:
        last = time.monotonic()
        after = resource.getrusage(resource.RUSAGE_SELF)
cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
with contextlib.suppress(can.CanError):
    bus.shutdown()
print(json.dumps({"frames": frames, "cpu": cpu / (last - began)}), flush=True)
"""


def make_stream(samples: int, seed: int = 1) -> bytes:
    """Return packed frames of acceleration and rate, as a bus of 1000 samples a second gives them."""
    rng = np.random.default_rng(seed)
    units = np.zeros((2 * samples, UNIT_BYTES), dtype=np.uint8)
    identifiers = np.tile(np.array([0x08F02D80, 0x0CF02A80], dtype="<u4") | np.uint32(EXTENDED), samples)
    units[:, :4] = identifiers.view(np.uint8).reshape(-1, 4)
    units[:, 4] = 8
    units[:, 6:8] = (MARK & 0xFF, MARK >> 8)
    time_s = np.repeat(np.arange(samples) / RATE_HZ, 2) + np.tile([0.0, 0.00025], samples)
    units[:, 8:16] = time_s.astype("<f8").view(np.uint8).reshape(-1, 8)
    units[:, 16:22] = rng.integers(20_000, 44_000, (2 * samples, 3)).astype("<u2").view(np.uint8).reshape(-1, 6)
    return units.tobytes()


def peer_decode(database: Any, frames: list[tuple[int, bytes, float]]) -> list[list[float]]:
    """Return time, acceleration and rate of each sample: what one writes with cantools."""
    samples = []
    acceleration: dict[str, Any] = {}
    for identifier, data, time_s in frames:
        # Priority and source address are not those of the file.
        group = identifier & 0x03FFFF00
        if group == 0x00F02D00:
            acceleration = database.decode_message("AccelerationSensor", data)
        elif group == 0x00F02A00:
            rate = database.decode_message("AngularRate", data)
            samples.append(
                [
                    time_s,
                    acceleration["LateralAcceleration"],
                    acceleration["LongitudinalAcceleration"],
                    acceleration["VerticalAcceleration"],
                    rate["PitchRate"],
                    rate["RollRate"],
                    rate["YawRate"],
                ]
            )
    return samples


def peer_decode_bare(messages: list[Any], frames: list[tuple[int, bytes, float]]) -> int:
    """Decode and throw away: cantools alone, the message known beforehand, value tables left out."""
    for place, (_, data, _) in enumerate(frames):
        messages[place & 1].decode(data, decode_choices=False)
    return len(frames)


def _decode(data: bytes, size: int) -> int:
    decoder = Decoder(load_protocol("j1939_imu"))
    count = sum(len(decoder.feed(data[at : at + size], 0.0)) for at in range(0, len(data), size))
    return count + len(decoder.flush())


def _best_in_turns(works: list[Callable[[], object]]) -> list[float]:
    """Return the shortest time of each, s; in turns, so that a busy moment of the machine hits all of them."""
    best = [float("inf")] * len(works)
    for _ in range(ROUNDS):
        for place, work in enumerate(works):
            begin = time.perf_counter()
            work()
            best[place] = min(best[place], time.perf_counter() - begin)
    return best


def decode_rows() -> list[Row]:
    """Return the decode rates."""
    protocol = load_protocol("j1939_imu")
    database = cantools.database.load_string(protocol.text.split("text = '''\n")[1].rsplit("'''", 1)[0], "dbc")
    data = make_stream(SAMPLES)
    units = np.frombuffer(data, dtype=np.uint8).reshape(-1, UNIT_BYTES)[:PEER_FRAMES]
    times = units.view("<f8")[:, 1].tolist()
    frames = [(int(unit.view("<u4")[0]), unit[16:].tobytes(), at) for unit, at in zip(units, times, strict=True)]
    messages = [database.get_message_by_name(name) for name in ("AccelerationSensor", "AngularRate")]
    assert _decode(data, BLOCK_BYTES) == SAMPLES
    assert len(peer_decode(database, frames)) == PEER_FRAMES // 2
    small_data = data[: len(data) // 4]
    peer_s, blocks_s, bare_s, small_s, live_s = _best_in_turns(
        [
            lambda: peer_decode(database, frames),
            lambda: _decode(data, BLOCK_BYTES),
            lambda: peer_decode_bare(messages, frames),
            lambda: _decode(small_data, 80 * UNIT_BYTES),
            lambda: decode_live(small_data, 80 * UNIT_BYTES, protocol),
        ]
    )
    peer, bare = PEER_FRAMES / peer_s / 1e6, PEER_FRAMES / bare_s / 1e6
    blocks, small, live = 2 * SAMPLES / blocks_s / 1e6, SAMPLES / 2 / small_s / 1e6, SAMPLES / 2 / live_s / 1e6
    return [
        row("J1939, 64 KiB blocks, to samples (peer: cantools, to samples)", blocks, "million frames/s", peer),
        row("J1939, 64 KiB blocks, to samples (peer: cantools' decode alone)", blocks, "million frames/s", bare),
        row("J1939, blocks of 80 frames (peer: cantools, to samples)", small, "million frames/s", peer),
        row("J1939, blocks of 80 frames (peer: 64 KiB)", small, "million frames/s", blocks),
        row("J1939, live reads of 80 frames (peer: 64 KiB)", live, "million frames/s", blocks),
    ]


def _start(code: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True)


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def live_rows(live_s: float) -> list[Row]:
    """Return what a live bus of 1000 Hz x 2 messages costs, and what it loses."""
    bus = f"udp_multicast:{GROUP}"
    with tempfile.TemporaryDirectory() as folder:
        readers = [_start(_READ, bus, folder, "j1939_imu"), _start(_RECEIVE, bus)]
        assert [_line(reader) for reader in readers] == ["ready", "ready"]
        emulator = _start(_EMULATE, bus, str(RATE_HZ), str(live_s), "j1939_imu")
        _line(emulator)
        sent = int(_line(emulator))
        ours, plain = (json.loads(_line(reader)) for reader in readers)
        recorded = Path(folder, "part-001.mcap").stat().st_size
    for process in (emulator, *readers):
        process.wait()
    name = f"live {RATE_HZ:g} Hz x 2 messages, {live_s:g} s, UDP multicast"
    return [
        row(f"{name}: samples (peer: sent)", ours["samples"], "samples", sent),
        row(f"{name}: said to be lost", ours["lost"], "samples"),
        row(f"{name}: processor, recording (peer: recv())", 100 * ours["cpu"], "% of a core", 100 * plain["cpu"]),
        row(f"{name}: above recv()", 100 * (ours["cpu"] - plain["cpu"]), "% of a core"),
        row(f"{name}: recording", recorded / 1e6, "MB"),
    ]


def slcan_rows(live_s: float) -> list[Row]:
    """Return the same on slcan over a pseudo-terminal, which takes one reader at a time, with three messages a sample."""
    found = []
    for code in (_READ, _RECEIVE):
        with tempfile.TemporaryDirectory() as folder:
            emulator = _start(_EMULATE, "slcan", str(RATE_HZ), str(live_s), "bosch_mm510")
            reader = _start(code, f"{_line(emulator)}?sleep_after_open=0", folder, "bosch_mm510")
            _line(reader)
            sent = int(_line(emulator))
            found.append(json.loads(_line(reader)))
            emulator.wait()
            reader.wait()
    ours, plain = found
    name = f"live {RATE_HZ:g} Hz x 3 messages, {live_s:g} s, slcan"
    return [
        row(f"{name}: samples (peer: sent)", ours["samples"], "samples", sent),
        row(f"{name}: said to be lost", ours["lost"], "samples"),
        row(f"{name}: processor, recording (peer: recv())", 100 * ours["cpu"], "% of a core", 100 * plain["cpu"]),
        row(f"{name}: above recv()", 100 * (ours["cpu"] - plain["cpu"]), "% of a core"),
    ]


def run(live_s: float = 60.0, slcan_s: float = 20.0) -> list[Row]:
    """Return one row for each figure: name, value, unit, peer's value and ratio (None where there is no peer)."""
    return [*decode_rows(), *live_rows(live_s), *slcan_rows(slcan_s)]


def main() -> None:
    """Print the figures as a table."""
    parser = argparse.ArgumentParser(description="CAN: decode rates and a live bus")
    parser.add_argument("--live-s", type=float, default=60.0, help="seconds of the live bus")
    parser.add_argument("--slcan-s", type=float, default=20.0, help="seconds of the slcan adapter")
    options = parser.parse_args()
    print_rows(run(options.live_s, options.slcan_s), width=76)


if __name__ == "__main__":
    main()
