"""The virtual instrument on real buses: in this process, across processes, with faults."""

from __future__ import annotations

import itertools
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable

import can
import numpy as np
import pytest

from imufield.acquire.decode.assembly import Message
from imufield.acquire.protocol.can_frame import ERROR
from imufield.acquire.protocol.can_frames import unpack_frames
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.registry import load_driver
from imufield.errors import Reason, UsageError
from imufield.samples import Samples, Status, concatenate, make_samples
from imufield.simulate.emulator.can import CanEmulator
from imufield.simulate.emulator.core import EmulatorSettings
from imufield.simulate.emulator.faults import CanFaultInjector, CanFaults
from imufield.simulate.wire.can_frames import CanEncoder
from tests.opened_can import OpenedCan, open_can
from tests.refused import refused

NUMBERS = itertools.count()
RATE_HZ = 200.0
CHILD = """
import sys
from imufield.acquire.protocol.protocol import load_protocol
from imufield.simulate.emulator.can import CanEmulator
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.emulator.core import EmulatorSettings
source = make_virtual_imu(Emulation(device="text", rate_hz=200.0))
settings = EmulatorSettings(duration_s=2.0)
with CanEmulator(load_protocol("j1939_imu"), source, sys.argv[1], settings) as emulator:
    print(emulator.bus, flush=True)
    emulator.wait(60)
    print("all sent", flush=True)
    sys.stdin.read()
"""


class Ramp:
    """A source whose samples name themselves."""

    interval_s = 1 / RATE_HZ

    def __init__(self) -> None:
        self._next = 0

    def set_rate(self, rate_hz: float) -> None:
        self.interval_s = 1 / rate_hz

    def next_block(self, count: int) -> Samples:
        number = np.arange(self._next, self._next + count)
        self._next += count
        values = np.stack([0.01 * number, np.zeros(count), np.full(count, 9.81)], axis=1)
        units = load_protocol("j1939_imu").units
        return make_samples(number / RATE_HZ, values, np.zeros((count, 3)), units=units, counter=number)


@pytest.fixture
def channel() -> str:
    """Return a bus on which frames keep the stamps of their sender, as of an adapter that stamps them: no load moves them."""
    return f"virtual:emulator-{os.getpid()}-{next(NUMBERS)}?preserve_timestamps=1"


def read(opened: OpenedCan, is_over: Callable[[], bool]) -> Samples:
    blocks = []
    quiet = 0
    while quiet < 3:
        chunk = opened.link.read()
        quiet = quiet + 1 if chunk is None and is_over() else 0
        if chunk is not None:
            blocks.append(opened.decoder.feed(chunk.data, chunk.monotonic_s))
    opened.link.close()
    return concatenate([*blocks, opened.decoder.flush()])


@pytest.mark.parametrize("driver", ["aceinna_can", "xsens_can"])
def test_everything_arrives(channel: str, driver: str) -> None:
    opened = open_can(channel, driver=driver)
    protocol = load_driver(driver).load_protocol()
    with CanEmulator(protocol, Ramp(), channel, EmulatorSettings(duration_s=3.0, speed=2.0)) as emulator:
        samples = read(opened, lambda: emulator.finished)
    assert emulator.failure is None
    assert emulator.samples_sent == len(samples) == 600
    np.testing.assert_allclose(samples.accelerometer[:, 0], 0.01 * np.arange(600), atol=0.005)
    assert not (samples.status & ~np.uint32(Status.TIME_ESTIMATED)).any()
    assert opened.decoder.statistics.samples_lost == 0
    assert np.diff(samples.time_s).min() > 0


def test_slcan_on_a_pseudo_terminal() -> None:
    if sys.platform == "win32":
        pytest.skip("this system has no pseudo-terminals")
    with CanEmulator(load_protocol("j1939_imu"), Ramp(), "slcan", EmulatorSettings(duration_s=1.0)) as emulator:
        opened = open_can(f"{emulator.bus}?sleep_after_open=0", driver="aceinna_can")
        samples = read(opened, lambda: emulator.finished)
    assert len(samples) == 200
    np.testing.assert_allclose(samples.accelerometer[:, 0], 0.01 * np.arange(200), atol=1e-9)


@pytest.mark.parametrize("kind", ["udp_multicast", "slcan"])
def test_across_processes(kind: str) -> None:
    bus = kind
    if kind == "udp_multicast":
        # Linux hands a datagram to all who listen at its port, whatever their group: other tests must not use the same.
        port = 20_000 + (89 * os.getpid() + next(NUMBERS)) % 30_000
        address = f"239.75.0.2:{port}"
        try:
            can.Bus("239.75.0.2", kind, port=port).shutdown()
        except (OSError, can.CanError):
            pytest.skip("this machine has no multicast network")
        bus = f"{kind}:{address}"
        opened = open_can(bus, driver="aceinna_can")
    # Who sends keeps its port until it is read: a busy machine may leave either of the two waiting.
    line, pipe = [sys.executable, "-c", CHILD, bus], subprocess.PIPE
    with subprocess.Popen(line, stdin=pipe, stdout=pipe, text=True) as child:
        told = child.stdout
        assert told is not None
        name = told.readline().strip()
        if kind == "slcan":
            opened = open_can(f"{name}?sleep_after_open=0", driver="aceinna_can")
        samples = read(opened, lambda: bool(select.select([told], [], [], 0)[0]))
    # A busy machine may drop a datagram of UDP; an adapter drops nothing.
    fewest = 200 if kind == "udp_multicast" else 400
    whole = samples[(samples.status & np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)) == 0]
    assert fewest <= len(whole) <= len(samples) <= 400
    # Something lies on a table.
    assert np.linalg.norm(whole.accelerometer.mean(axis=0)) == pytest.approx(9.8, abs=0.1)


def test_identity_is_answered(channel: str) -> None:
    driver = load_driver("aceinna_can")
    opened = open_can(channel, driver="aceinna_can")
    with CanEmulator(load_protocol("j1939_imu"), Ramp(), channel, EmulatorSettings(duration_s=100.0)):
        opened.link.write(driver.identity_commands[0])
        messages: list[Message] = []
        end_s = time.monotonic() + 60
        while not messages and time.monotonic() < end_s:
            chunk = opened.link.read()
            if chunk is not None:
                opened.decoder.feed(chunk.data, chunk.monotonic_s)
                messages = opened.decoder.messages()
    opened.link.close()
    assert driver.identity(messages) == {"firmware": "19.1.51.0.3"}


def test_faults_are_counted_and_survived(channel: str) -> None:
    faults = CanFaults(
        lost_frame_probability=0.02,
        doubled_frame_probability=0.02,
        wrong_dlc_probability=0.01,
        not_available_probability=0.02,
        error_frames_per_s=5.0,
    )
    opened = open_can(channel, driver="aceinna_can")
    settings = EmulatorSettings(duration_s=4.0, speed=2.0)
    with CanEmulator(load_protocol("j1939_imu"), Ramp(), channel, settings, faults=faults, seed=4) as emulator:
        samples = read(opened, lambda: emulator.finished)
    counts, by_kind = emulator.injector.counts, opened.decoder.statistics.by_kind
    assert all(counts[name] for name in ("lost_frames", "doubled_frames", "wrong_dlcs", "not_available", "error_frames"))
    assert by_kind["error frame"] == counts["error_frames"]
    # A shortened frame may still hold all its signals, 7 of 8 bytes.
    short = sum(count for name, count in by_kind.items() if name.endswith("too short"))
    assert 0 < short <= 2 * counts["wrong_dlcs"]
    valid = samples.accelerometer[(samples.status & np.uint32(Status.ACCELEROMETER_INVALID)) == 0]
    number = valid[:, 0] / 0.01
    np.testing.assert_allclose(number, np.rint(number), atol=1e-6)
    assert (valid[:, 2] > 9.8).all()
    assert len(samples) > 700


def test_bus_off_is_silence_and_a_gap(channel: str) -> None:
    opened = open_can(channel, driver="aceinna_can")
    faults = CanFaults(disconnect_at_s=(2.0,), disconnect_s=1.0)
    with CanEmulator(load_protocol("j1939_imu"), Ramp(), channel, EmulatorSettings(duration_s=4.5), faults=faults) as emulator:
        samples = read(opened, lambda: emulator.finished)
    assert emulator.injector.counts["disconnects"] == 1
    assert opened.decoder.statistics.by_kind["error frame"] == 16
    number = np.rint(samples.accelerometer[:, 0] / 0.01).astype(int)
    (silence,) = np.flatnonzero(np.diff(number) > 1)
    lost = 900 - len(samples)
    assert (number[0], number[silence + 1] - number[silence] - 1, number[-1]) == (0, lost, 899)
    # All of a second, and the block in which it went; that is longer on a busy machine.
    assert 200 < lost <= 400
    assert emulator.injector.counts["frames_while_off"] % lost == 0
    assert np.flatnonzero(samples.status & Status.GAP_ESTIMATED).tolist() == [silence + 1]
    assert opened.decoder.statistics.losses_estimated == lost


def test_reordered_frames_change_places() -> None:
    encoder = CanEncoder(load_protocol("j1939_imu"))
    frames = encoder.encode(Ramp().next_block(500))
    injector = CanFaultInjector(CanFaults(reordered_frame_probability=0.1), seed=1)
    damaged = injector.damage(frames, 1.0, 1.0)
    assert sorted(damaged, key=lambda frame: frame.time_s) == frames
    assert damaged != frames
    assert injector.counts["reordered_frames"] > 50


def test_wrong_faults_are_refused() -> None:
    with refused(UsageError, Reason.USAGE, "1.5", "0 to 1", key="faults.outside") as caught:
        CanFaults(lost_frame_probability=1.5)
    assert caught.value.values["fault"] == "lost_frame_probability"
    with refused(UsageError, Reason.USAGE, "speed 0", "0 to 1000", key="core.speed"):
        CanEmulator(load_protocol("j1939_imu"), Ramp(), "virtual:none", EmulatorSettings(speed=0.0))


def test_error_frames_reach_the_recording(channel: str) -> None:
    opened = open_can(channel, driver="aceinna_can")
    faults = CanFaults(error_frames_per_s=100.0)
    with CanEmulator(load_protocol("j1939_imu"), Ramp(), channel, EmulatorSettings(duration_s=1.0), faults=faults) as emulator:
        seen = 0
        end_s = time.monotonic() + 60
        while time.monotonic() < end_s and not (emulator.finished and seen):
            chunk = opened.link.read()
            seen += 0 if chunk is None else sum(bool(frame.can_id & ERROR) for frame in unpack_frames(chunk.data))
    opened.link.close()
    assert seen
