"""What the decoder makes of every vector, capture and wire format, compared with what it made of them before.

Raw values, counters, flags, statistics and messages are compared by a hash of all of them; times within one unit in the last
place, since BLAS takes part where a bus has no clock of its own. ``--imufield-update`` writes the golden files anew.
"""

from __future__ import annotations

import gzip
import hashlib
import itertools
import json
import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.can_map import protocol_from_dbc
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.can_frame import ERROR, EXTENDED, Frame
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.recording.reader import read_part
from imufield.errors import ProtocolError
from imufield.samples import Samples, concatenate
from tests.acquire.plain_frames import pack_frames, parse_candump
from tests.acquire.streams import INSTRUMENTS, RECORDED, flipped, recording
from tests.acquire.test_can_decoder import ACCELERATION, MAP, MUX, RATE, WIDE, unequal, words
from tests.acquire.test_protocols_serial import CAPTURES, FILES, capture, settings_of, vectors
from tests.conftest import PROJECT

Golden = Callable[..., None]
# Of the times in a golden file: a wrong clock moves nearly all of them, so that a few show it.
TIMES_KEPT = 10
ONE_UNIT = 2.0**-52
RATES = ("nominal_rate_hz", "rate_hz", "rate_sigma", "follows_host", "least_loss_s")
SECONDS = 10
MOST_HZ = 500
OPTIONS: dict[str, dict[str, object]] = {
    "witmotion bluetooth": {"form": "bluetooth"},
    "novatel ascii": {"rate_hz": 100},
}
WRAP = 256  # Of the counter of a STIM300.
STIM300 = "captures/stim300/stim300_0x93_crlf_125hz_30g_motion_corrupt_tail_ubc3.bin"
CAN_PROTOCOLS = ("j1939_imu", "xsens_can", "sbg_can", "racelogic_can", "bosch_mm510")


@dataclass
class Run:
    """One stream through one decoder."""

    blocks: list[Samples]
    decoder: Decoder
    error: str = ""


def play(protocol: Protocol, reads: Iterable[tuple[bytes, float]]) -> Run:
    run = Run([], Decoder(protocol))
    try:
        for data, arrival_s in reads:
            run.blocks.append(run.decoder.feed(data, arrival_s))
        run.blocks.append(run.decoder.flush())
    except ProtocolError as error:
        run.error = error.message
    return run


def at_once(data: bytes) -> list[tuple[bytes, float]]:
    return [(data, math.nan)]


def cut(data: bytes, seed: int, reads: int = 80) -> list[tuple[bytes, float]]:
    """Return the bytes in random pieces, whose arrival is not known."""
    edges = [0, *sorted(np.random.default_rng(seed).integers(0, len(data) + 1, reads).tolist()), len(data)]
    return [(data[begin:end], math.nan) for begin, end in itertools.pairwise(edges)]


def arriving(data: bytes, bytes_per_s: float, seed: int) -> list[tuple[bytes, float]]:
    """Return the bytes as a busy host reads them: every 40 ms, late by some ms, once by half a second."""
    rng = np.random.default_rng(seed)
    size = max(round(bytes_per_s * 0.04), 1)
    at_s, reads = 0.0, []
    for number, begin in enumerate(range(0, len(data), size)):
        late_s = float(rng.exponential(0.003)) + (0.5 if number == 100 else 0.0)
        at_s = max(at_s, 50.0 + 0.04 * (number + 1) + late_s)
        reads.append((data[begin : begin + size], at_s))
    return reads


def damaged(data: bytes, seed: int) -> bytes:
    """Return the bytes with bits turned and pieces missing, one of them long."""
    rng = np.random.default_rng(seed)
    pieces, begin = [], 0
    for end in sorted(rng.integers(0, len(data), 12).tolist()):
        pieces.append(data[begin:end])
        begin = end + int(rng.integers(1, 200))
    pieces.append(data[max(begin, len(data) * 3 // 4) :])
    return flipped(b"".join(pieces), 2e-4, seed)


def values_of(samples: Samples) -> bytes:
    """Return all that is no time; the sign of a NaN tells nothing."""
    parts = [samples.accelerometer, samples.gyroscope, samples.temperature_degc]
    numbers = b"".join(np.where(np.isnan(part), np.nan, part).astype("<f8").tobytes() for part in parts)
    return numbers + samples.counter.astype("<i8").tobytes() + samples.status.astype("<u4").tobytes()


def summary(runs: Iterable[Run]) -> list[object]:
    """Return the hash of what must be equal, and what may differ by a unit in the last place."""
    exact = hashlib.sha256()
    times: list[float] = []
    rates: list[float | None] = []
    count = 0
    for run in runs:
        samples = concatenate(run.blocks) if run.blocks else None
        exact.update(b"" if samples is None else values_of(samples))
        statistics = run.decoder.statistics.to_dict()
        found = run.decoder.statistics
        rates += [found.nominal_rate_hz, found.rate_hz, found.least_loss_s]
        statistics = {name: value for name, value in statistics.items() if name not in RATES}
        sizes = [len(block) for block in run.blocks]
        count += sum(sizes)
        rest = [sizes, statistics, run.decoder.messages(), run.error]
        exact.update(json.dumps(rest, sort_keys=True, default=str).encode())
        if samples is not None and len(samples):
            places = np.unique(np.linspace(0, len(samples) - 1, TIMES_KEPT).round().astype(np.int64))
            times += samples.time_s[places].tolist()
            times.append(math.fsum(samples.time_s.tolist()))
    if len(times) > 4 * TIMES_KEPT:
        times = [*times[:: len(times) // (4 * TIMES_KEPT)], math.fsum(times)]
    if len(rates) > 12:
        rates = [math.fsum(rate or 0.0 for rate in rates)]
    return [exact.hexdigest()[:24], count, times, rates]


def check(golden: Golden, name: str, values: dict[str, list[object]]) -> None:
    golden(f"samples_{name}", values, relative=ONE_UNIT, absolute=1e-15)


def test_vectors(shared_folder: Path, imufield_golden: Golden) -> None:
    found = {}
    for name in FILES:
        runs = []
        for vector in vectors(shared_folder, name):
            data = bytes.fromhex(vector["hex"])
            protocol = load_protocol(name, settings_of(name, vector))
            runs += [play(protocol, at_once(data)), play(protocol, cut(b"\x55" + 20 * data, 1))]
        joined = b"".join(bytes.fromhex(vector["hex"]) for vector in vectors(shared_folder, name))
        runs += [play(load_protocol(name), cut(joined, seed)) for seed in range(3)]
        found[name] = summary(runs)
    runs = []
    for vector in json.loads((shared_folder / "wire/stim300.vectors.json").read_text()):
        data = bytes.fromhex(vector["hex"])
        protocol = load_protocol("stim300", {"accelerometer_range_g": vector.get("acc_range_g", 10)})
        runs += [play(protocol, at_once(data)), play(protocol, cut(12 * data, 2))]
    found["stim300"] = summary(runs)
    for file in ("aceinna_mtlt_can", "can_imus"):
        texts = [vector["hex"] for vector in json.loads((shared_folder / f"wire/{file}.vectors.json").read_text())]
        frames = [parse_candump(text) for text in 30 * texts]
        data = pack_frames(Frame(frame.can_id, frame.data, 0.001 * number) for number, frame in enumerate(frames))
        for name in CAN_PROTOCOLS:
            protocol = load_protocol(name)
            found[f"{file} {name}"] = summary([play(protocol, at_once(data)), play(protocol, cut(data, 3))])
    check(imufield_golden, "vectors", found)


def test_captures(shared_folder: Path, imufield_golden: Golden) -> None:
    sources = {name: capture(shared_folder, name)[:2] for name in CAPTURES}
    sources["stim300"] = (
        load_protocol("stim300", {"accelerometer_range_g": 30}),
        (shared_folder / STIM300).read_bytes(),
    )
    sources["logger"] = (
        load_protocol("text", {"columns": "ax,ay,az,gx,gy,gz", "rate_hz": 100}),
        gzip.decompress((shared_folder / "data/mikoff/imu0.log.gz").read_bytes())[:60_000],
    )
    for name, driver in RECORDED.items():
        sources[f"other settings {name}"] = (
            load_protocol(driver, {} if name != "stim300" else {"accelerometer_output": "increment", "rate_hz": 125}),
            recording(shared_folder, name),
        )
    found = {}
    for name, (protocol, data) in sources.items():
        runs = [play(protocol, at_once(data)), play(protocol, cut(data, 4))]
        runs += [play(protocol, arriving(data, 8000.0, 5)), play(protocol, arriving(damaged(data, 7), 8000.0, 7))]
        found[name] = summary(runs)
    check(imufield_golden, "captures", found)


def test_made_streams(imufield_golden: Golden) -> None:
    found = {}
    for name, (driver, rate_hz, sample) in INSTRUMENTS.items():
        if rate_hz > MOST_HZ:
            continue
        protocol = load_protocol(driver, OPTIONS.get(name, {}))
        pieces = [sample(number, number / rate_hz) for number in range(round(SECONDS * rate_hz))]
        whole, begin = b"".join(pieces), round(4 * rate_hz)
        lacking = b"".join(pieces[:begin] + pieces[begin + WRAP :])
        per_s = len(whole) / SECONDS
        runs = [play(protocol, at_once(whole)), play(protocol, arriving(damaged(whole, 9), per_s, 9))]
        runs.append(play(protocol, arriving(lacking, per_s, 10)))
        # A loss that only the host clock shows: the bytes stop for as long as it is.
        gap_s = WRAP / rate_hz
        runs.append(play(protocol, [(data, at + (gap_s if at > 54.0 else 0.0)) for data, at in arriving(lacking, per_s, 11)]))
        found[name] = summary(runs)
    check(imufield_golden, "made", found)


def test_fixture(imufield_golden: Golden) -> None:
    protocol = load_protocol("stim300", {"accelerometer_range_g": 10})
    paths = sorted((PROJECT / "fixtures" / "stim300-six-faces").glob("part-*.mcap"))
    reads = [(item.data, item.monotonic_s) for path in paths for item in read_part(path) if isinstance(item, Chunk)]
    data, ends = b"".join(data for data, _ in reads), np.cumsum([len(data) for data, _ in reads])
    joined = Run([], Decoder(protocol))
    joined.blocks = [joined.decoder.feed_chunks(data, ends, np.array([at_s for _, at_s in reads])), joined.decoder.flush()]
    check(imufield_golden, "fixture", {"reads": summary([play(protocol, reads)]), "joined": summary([joined])})


def bus(each: int, seed: int, *, burst_s: float = 0.0, lost: float = 0.0) -> bytes:
    """Return frames of a J1939 unit: ``each`` accelerations to a rate, delays of a bus, bursts of a host, losses, strangers."""
    rng = np.random.default_rng(seed)
    frames = []
    for frame in unequal(1500, each):
        stamp_s = frame.time_s + float(rng.exponential(0.0002))
        if burst_s:
            stamp_s = math.ceil(stamp_s / burst_s) * burst_s
        if rng.random() >= lost:
            frames.append(Frame(frame.can_id, frame.data, stamp_s))
        if rng.random() < 0.02:
            frames.append(Frame(0x123 if rng.random() < 0.7 else ERROR | 8, bytes(8), stamp_s))
        if rng.random() < 0.005:
            frames.append(frames[-1])
    return pack_frames(frames)


def made(protocol: Protocol, seed: int, lost: float) -> bytes:
    """Return frames of every kind of a CAN protocol, each with a counter and a time stamp where one may stand."""
    assert protocol.can is not None
    rng = np.random.default_rng(seed)
    frames = []
    for number in range(1200):
        at_s = number * 0.01 + float(rng.exponential(0.0005))
        for place, kind in enumerate(protocol.can.kinds):
            data = struct.pack("<4H", *rng.integers(0, 60000, 3).tolist(), number % 256)
            if kind.counter is not None:
                data = struct.pack(">H", number % 65536) + bytes(6)
            elif kind.time is not None:
                data = struct.pack("<IHh", (number * 10_000 + 2**32 - 3_000_000) % 2**32, number % 7, 2500)
            frames.append(Frame(kind.message.can_id, data, at_s + 0.0002 * place))
    return pack_frames(frame for frame in frames if rng.random() >= lost)


def protocol_of(dbc: str, folder: Path, **mapping: str) -> Protocol:
    path = folder / "bus.dbc"
    path.write_text(dbc)
    return protocol_from_dbc(path, MAP | mapping)


def test_buses(tmp_path: Path, imufield_golden: Golden) -> None:
    j1939 = load_protocol("j1939_imu")
    found = {}
    for each in (1, 2, 5):
        for burst_s, lost in ((0.0, 0.0), (0.0, 0.02), (0.05, 0.0), (0.1, 0.01)):
            data = bus(each, 12, burst_s=burst_s, lost=lost)
            runs = [play(j1939, at_once(data)), play(j1939, cut(data, 13)), play(j1939, cut(flipped(data, 1e-4, 14), 14))]
            found[f"j1939 {each} {burst_s} {lost}"] = summary(runs)
    outage = [Frame(one.can_id, one.data, one.time_s + (2.0 if one.time_s > 3.0 else 0.0)) for one in unequal(1500, 1)]
    restart = [Frame(one.can_id, one.data, one.time_s % 4.0) for one in unequal(1500, 1)]
    faster = [Frame(one.can_id, one.data, min(one.time_s, 3.0) + max(one.time_s - 3.0, 0) / 2) for one in unequal(1500, 1)]
    still = [Frame(one.can_id, one.data, 1.0) for one in unequal(1500, 1)]
    for name, frames in (("outage", outage), ("restart", restart), ("faster", faster), ("still", still)):
        data = pack_frames(frames)
        found[name] = summary([play(j1939, at_once(data)), play(j1939, cut(data, 15))])
    for name in CAN_PROTOCOLS:
        protocol = load_protocol(name)
        whole, lacking = made(protocol, 16, 0.0), made(protocol, 16, 0.02)
        reads = [at_once(whole), cut(whole, 17), at_once(lacking), cut(lacking, 17), cut(flipped(lacking, 1e-4, 18), 18)]
        found[name] = summary(play(protocol, each) for each in reads)
    rng = np.random.default_rng(18)
    pages = [
        Frame(
            0x100,
            bytes([page | number % 64 << 2]) + rng.integers(0, 255, 7, dtype=np.uint8).tobytes(),
            number * 0.01 + page * 0.001,
        )
        for number in range(600)
        for page in (0, 1)
        if rng.random() > 0.01
    ]
    wide = [
        Frame(0x100, struct.pack("<Q3f", number * 10_000, 0.1, -0.2, 1.0) + bytes(28), number * 0.01, 1)
        for number in range(600)
        if rng.random() > 0.01
    ]
    protocols = {
        "pages": protocol_of(MUX, tmp_path),
        "shared counter": protocol_of(MUX, tmp_path, counters="Group", starts_with="Motion[0]", limit_s="0.02"),
        "wide": protocol_of(WIDE, tmp_path, time="T"),
        "wide by stamps": protocol_of(WIDE, tmp_path),
    }
    for name, protocol in protocols.items():
        data = pack_frames(wide if "wide" in name else pages)
        found[name] = summary([play(protocol, at_once(data)), play(protocol, cut(data, 19)), play(protocol, cut(data, 20))])
    check(imufield_golden, "buses", found)


COUNTED = """VERSION ""
BS_:
BU_: A
BO_ 256 Acc: 8 A
 SG_ Count : 48|4@1+ (1,0) [0|0] "" A
 SG_ AccX : 0|16@1- (0.001,0) [0|0] "g" A
 SG_ AccY : 16|16@1- (0.001,0) [0|0] "g" A
 SG_ AccZ : 32|16@1- (0.001,0) [0|0] "g" A
BO_ 257 Gyro: 8 A
 SG_ GyroX : 7|16@0- (0.01,0) [0|0] "deg/s" A
 SG_ GyroY : 23|16@0- (0.01,0) [0|0] "deg/s" A
 SG_ GyroZ : 39|16@0- (0.01,0) [0|0] "deg/s" A
"""


@pytest.mark.parametrize("lost", [0, 5, 16, 40])
def test_a_counter_on_a_bus(lost: int, tmp_path: Path, imufield_golden: Golden) -> None:
    protocol = protocol_of(COUNTED, tmp_path, counter="Count")
    rng = np.random.default_rng(21)
    frames = []
    for number in range(1500):
        late_s = float(rng.exponential(0.0003))
        if not 700 <= number < 700 + lost and rng.random() > 0.01:
            data = words(20000, number, 32000)[:6] + bytes([number % 16, 0])
            frames += [Frame(0x100, data, number * 0.005 + late_s), Frame(0x101, data, number * 0.005 + late_s + 0.0002)]
    data = pack_frames(frames)
    check(
        imufield_golden, f"counter_{lost}", {"counter": summary([play(protocol, at_once(data)), play(protocol, cut(data, 22))])}
    )


def test_frames_in_other_order(imufield_golden: Golden) -> None:
    rng = np.random.default_rng(23)
    frames = [
        Frame(can_id | EXTENDED, words(20000 + number, 32000, 32000), number * 0.01 + 0.0003 * place)
        for number in range(500)
        for place, can_id in enumerate((RATE, ACCELERATION) if rng.random() < 0.05 else (ACCELERATION, RATE))
    ]
    data = pack_frames(frames)
    protocol = load_protocol("j1939_imu")
    check(imufield_golden, "order", {"order": summary([play(protocol, at_once(data)), play(protocol, cut(data, 24))])})
