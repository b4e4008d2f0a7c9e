"""Whatever a link does, every reading of a session finds what the screen said: live, resumed, replayed and solved.

A sequence is drawn from good samples, bytes of another instrument, garbage, silence and a link that is lost and opened again.
It goes through the loop of a capture, a small chunk at a time, and what that measured is compared with what is read back from
the recording, in blocks: every sample and every accepted position, bit for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.instrument.connected import Connected
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.can_frame import ERROR, EXTENDED, pack_frame
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session
from imufield.calibrate.model.observations import Observations
from imufield.commands.terminal.guided import QUIT, CaptureLoop
from imufield.errors import LinkError, Reason
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from imufield.pipeline.intake import Intake
from imufield.samples import Samples, concatenate, no_samples
from imufield.simulate.emulator.emulate import Emulation, choose_wire, make_device
from imufield.simulate.wire.can_frames import CanEncoder
from tests.guide.conftest import Path as Motion
from tests.guide.guided import faces_session
from tests.torture.conftest import FULL, Campaign

SEQUENCES = 1000 if FULL else 9
PARTS = 20 if FULL else 1
"""Of the sequences of a kind: a test of its own each, so that none takes minutes."""
CHUNK_S = 0.02 if FULL else 0.05
FACES = ("+z", "+x", "-z", "+y", "-x", "-y")
SHOWN = FACES * 2 if FULL else FACES + FACES[:3]
POLL_S = 0.02
UTC_NS = 1_790_000_000_000_000_000
LOST = None
"""In the script of a link: it is gone, and opened again with the next chunk."""
Script = list[Chunk | None]


class ScriptedClock:
    """Shows the time of the newest chunk; waiting costs nothing."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def utc_ns(self) -> int:
        return UTC_NS + round(self.now_s * 1e9)

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


class ScriptedLink:
    """Plays a script; its end shows in ``is_over``."""

    name = "scripted"

    def __init__(self, script: Script, clock: ScriptedClock) -> None:
        self._items = iter(script)
        self._clock = clock
        self.is_over = False

    def read(self) -> Chunk | None:
        try:
            item = next(self._items)
        except StopIteration:
            self.is_over = True
            time.sleep(POLL_S)  # As a port waits for bytes: a thread that never waits takes all time from the others.
            return None
        if item is LOST:
            raise LinkError("pulled", Reason.DISCONNECTED)
        self._clock.now_s = max(self._clock.now_s, item.monotonic_s)
        return item

    def write(self, data: bytes) -> None:
        """Take what nobody answers."""

    def reopen(self) -> bool:
        return True

    def close(self) -> None:
        """Leave it."""


class NoView:
    page = None

    def show(self, events: Any) -> None:
        """Show nothing."""

    def refresh(self, *_: Any, **__: Any) -> None:
        """Draw nothing."""

    def tell(self, text: str) -> None:
        """Answer nothing."""


@dataclass
class Keys:
    """Quits at the end of the script."""

    link: ScriptedLink

    def read(self) -> str:
        return QUIT if self.link.is_over else ""


@dataclass(frozen=True)
class Kind:
    """An instrument: how its samples become bytes, and whose bytes are foreign to it."""

    name: str
    protocol: Protocol
    encoder: Callable[[], Callable[[Samples], list[bytes]]]
    """Makes an instrument that was switched on now; it gives the bytes of each sample."""
    foreign: str
    rate_hz: float = 100.0

    @property
    def on_bus(self) -> bool:
        return self.protocol.can is not None


def serial_kind(name: str, device: str, foreign: str, rate_hz: float = 100.0, **settings: object) -> Kind:
    options = Emulation(device=device, rate_hz=rate_hz, settings=settings)
    wire = choose_wire(options)

    def switched_on() -> Callable[[Samples], list[bytes]]:
        instrument = make_device(options, wire)

        def encode(samples: Samples) -> list[bytes]:
            frames = instrument.encode(samples)
            each = len(frames.ends) // len(samples)
            ends = [0, *frames.ends[each - 1 :: each].tolist()]
            return [frames.data[begin:end].tobytes() for begin, end in pairwise(ends)]

        return encode

    return Kind(name, wire.protocol, switched_on, foreign, rate_hz)


def can_kind(name: str, protocol_name: str, foreign: str) -> Kind:
    protocol = load_protocol(protocol_name)

    def switched_on() -> Callable[[Samples], list[bytes]]:
        encoder = CanEncoder(protocol)

        def encode(samples: Samples) -> list[bytes]:
            frames = encoder.encode(samples)
            each = len(frames) // len(samples)
            packed = [pack_frame(frame.can_id, frame.data, frame.time_s, frame.flags) for frame in frames]
            return [b"".join(packed[at : at + each]) for at in range(0, len(packed), each)]

        return encode

    return Kind(name, protocol, switched_on, foreign)


KINDS = {
    kind.name: kind
    for kind in (
        serial_kind("text", "text", "xsens", columns="ax,ay,az,gx,gy,gz"),
        serial_kind("text with time", "text", "stim300"),
        serial_kind("sentences", "vectornav_ascii", "text"),
        serial_kind("stim300", "stim300", "text", 125.0),
        serial_kind("xsens", "xsens_mtdata2", "witmotion"),
        serial_kind("witmotion", "witmotion", "stim300"),
        can_kind("j1939", "j1939_imu", "xsens can"),
        can_kind("xsens can", "xsens_can", "j1939"),
        can_kind("sbg can", "sbg_can", "j1939"),
    )
}
LONGEST_S = {"foreign": 3.0, "garbage": 3.0, "silence": 3.0, "reopen": 3.0}
"""Of the stretches in which nothing good comes; 3 s of garbage are a power-up at another baud rate."""


def samples_of(kind: Kind, seed: int) -> Samples:
    """Return the samples of somebody who turns the instrument to its six faces, and again where what came was not good."""
    motion: Any = faces_session(Motion, SHOWN, hold_s=4.0, rate_hz=kind.rate_hz)
    samples: Samples = motion.samples(sigma_m_s2=0.003, seed=seed)
    return replace(samples, counter=np.arange(len(samples)), temperature_degc=np.full(len(samples), 25.0))


def sequence(kind: Kind, seed: int) -> Iterator[Script]:
    """Yield what comes over the link in each of two runs."""
    rng = np.random.default_rng([seed, 14])
    samples, foreign = samples_of(kind, seed), KINDS[kind.foreign]
    others = samples_of(foreign, seed)
    end_s, middle_s = float(samples.time_s[-1]), rng.uniform(0.3, 0.7) * float(samples.time_s[-1])
    now_s, script, encode = 0.0, [], kind.encoder()
    pieces: list[tuple[float, bytes]] = []
    what = "good"
    while now_s < end_s:
        until_s = min(now_s + (rng.uniform(2.0, 14.0) if what == "good" else rng.uniform(0.05, LONGEST_S[what])), end_s)
        if what == "good":
            pieces += sent(encode, samples, now_s, until_s)
        elif what == "foreign":
            pieces += sent(foreign.encoder(), others, now_s, until_s)
        elif what == "garbage":
            pieces += noise(kind, rng, now_s, until_s)
        elif what == "reopen":
            script += [*reads(kind, rng, pieces), LOST]
            pieces.clear()
            if rng.random() < 0.5:
                encode = kind.encoder()
        now_s = until_s
        what = str(rng.choice(list(LONGEST_S))) if what == "good" or rng.random() < 0.3 else "good"
        if now_s > middle_s:
            yield script + reads(kind, rng, pieces)
            middle_s, script, encode = end_s, [], kind.encoder()
            pieces.clear()
    yield script + reads(kind, rng, pieces)


def sent(encode: Callable[[Samples], list[bytes]], samples: Samples, begin_s: float, end_s: float) -> list[tuple[float, bytes]]:
    """Return when the bytes of each sample of a stretch of time are on the wire."""
    first, last = np.searchsorted(samples.time_s, [begin_s, end_s])
    if last <= first:
        return []
    return list(zip(samples.time_s[first:last].tolist(), encode(samples[first:last]), strict=True))


def noise(kind: Kind, rng: np.random.Generator, begin_s: float, end_s: float) -> list[tuple[float, bytes]]:
    """Return what comes of a wrong baud rate, or on a bus that is disturbed."""
    at = np.arange(begin_s, end_s, 1 / kind.rate_hz).tolist()
    if not kind.on_bus:
        return [(time_s, rng.bytes(int(rng.integers(1, 60)))) for time_s in at]
    known = [form.message.can_id for form in kind.protocol.can.kinds] if kind.protocol.can is not None else []
    pieces = []
    for time_s in at:
        can_id = int(rng.choice([ERROR | 8, 0x123, 0x18F00000 | EXTENDED, *known]))
        pieces.append((time_s, pack_frame(can_id, rng.bytes(int(rng.integers(0, 9))), time_s, 0)))
    return pieces


def reads(kind: Kind, rng: np.random.Generator, pieces: list[tuple[float, bytes]]) -> Script:
    """Return the wire as it is read: every 20 ms or later, and cut anywhere but on a bus."""
    script: Script = []
    waiting, next_s = b"", 0.0
    for time_s, data in pieces:
        if waiting and time_s > next_s:
            cut = len(waiting) if kind.on_bus else int(rng.integers(1, len(waiting) + 1))
            script.append(chunk(waiting[:cut], next_s + rng.exponential(0.002)))
            waiting = waiting[cut:]
        if time_s > next_s:
            next_s = time_s + (CHUNK_S if rng.random() < 0.98 else rng.uniform(0.1, 1.0))
        waiting += data
    return [*script, chunk(waiting, next_s + 0.005)] if waiting else script


def chunk(data: bytes, arrival_s: float) -> Chunk:
    return Chunk(data, arrival_s, UTC_NS + round(arrival_s * 1e9))


@dataclass
class Reading:
    """What a way of reading a session has found."""

    samples: Samples
    positions: Observations


def live(session: Session, kind: Kind, script: Script) -> Reading:
    """Capture, or go on with, a session."""
    clock = ScriptedClock()
    link = ScriptedLink(script, clock)
    background = BackgroundLink(link)
    blocks: list[Samples] = []
    stream = SameStream(link.name)
    chain = Chain(ReadingPlan.of(session), listeners=(blocks.append, stream.hear))
    replay_into(chain, session, [], ended=False)
    stream.begin()
    connected = Connected(
        link=background, protocol=kind.protocol, driver=kind.name, model="m", baud=None, chunks=[], identity={}
    )
    try:
        with Recorder(session.add_part(), part_metadata(kind.protocol, {}), clock=clock) as recorder:
            intake = Intake(recorder=recorder, chain=chain, stream=stream)
            loop = CaptureLoop(
                session=session,
                connected=connected,
                intake=intake,
                view=NoView(),  # type: ignore[arg-type]
                keyboard=Keys(link),  # type: ignore[arg-type]
                clock=clock,
                check=lambda: None,
            )
            try:
                loop.run()
            except LinkError as error:
                # Only where nothing but foreign bytes came for long; what came before is kept all the same.
                assert error.reason is Reason.FOREIGN  # noqa: PT017
                intake.finish()
    finally:
        background.close()
    return Reading(joined(blocks, kind), chain.observations())


def read_back(session: Session, kind: Kind) -> Reading:
    """Read a session as replay and solve do."""
    blocks: list[Samples] = []
    chain = Chain(ReadingPlan.of(session), listeners=(blocks.append,))
    replay_into(chain, session, [])
    return Reading(joined(blocks, kind), chain.observations())


def joined(blocks: list[Samples], kind: Kind) -> Samples:
    return concatenate(blocks) if blocks else no_samples(kind.protocol.units)


def assert_same(one: Reading, other: Reading) -> None:
    """Compare bit for bit, the samples first: where they differ shows why positions do."""
    for name in ("time_s", "accelerometer", "gyroscope", "temperature_degc", "counter", "status"):
        np.testing.assert_array_equal(getattr(one.samples, name), getattr(other.samples, name), err_msg=name)
    for field in fields(one.positions):
        np.testing.assert_array_equal(getattr(one.positions, field.name), getattr(other.positions, field.name))


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("name", KINDS)
def test_every_reading_finds_the_same(name: str, part: int, tmp_path: Path, campaign: Campaign) -> None:
    kind = KINDS[name]
    others = list(KINDS).index(name)
    accepted = sequences = 0
    for seed in range(others, SEQUENCES, len(KINDS))[part::PARTS]:
        metadata = {"kind": "capture", "scheme": "faces6", "guide": {"hold_s": 2.5}}
        session = Session.create_in(tmp_path / f"{seed}", "m", metadata)
        for script in sequence(kind, seed):
            captured = live(session, kind, script)
            assert_same(captured, read_back(session, kind))
        accepted += len(captured.positions)
        sequences += 1
    assert accepted
    campaign.tell(
        "capture over a link with foreign bytes, garbage, silence and unplugged cables, resumed in the middle",
        sequences,
        "sequences",
        "live, resumed, replayed and solved: the same {accepted} positions and all samples, bit for bit",
        accepted=accepted,
    )
