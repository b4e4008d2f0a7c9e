"""The emulator on a real pseudo-terminal, read with plain ``os.read`` and a parser of this file's own."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imufield.errors import Reason, UsageError
from imufield.simulate.emulator.core import EmulatorSettings
from imufield.simulate.emulator.emulate import Emulation, choose_wire, make_device
from imufield.simulate.emulator.faults import Faults
from imufield.simulate.emulator.port import PseudoTerminal
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.stim300 import Stim300Device, utility_message
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator
from imufield.simulate.truth.virtual_imu import VirtualImu
from imufield.simulate.wire.stim300 import Stim300Format
from tests.refused import refused

pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs pseudo-terminals: Linux or macOS")

LIMIT_S = 60.0
FRAME = 40


def source(rate_hz: float = 500.0) -> VirtualImu:
    return VirtualImu(Imu(perfect_instrument(TACTICAL), 1, ImuSettings(rate_hz=rate_hz)), Operator([], 1))


def stim300(rate_hz: float = 500.0) -> Stim300Device:
    return Stim300Device(Stim300Format(rate_hz=rate_hz))


def open_port(port: str) -> int:
    return os.open(port, os.O_RDWR | os.O_NOCTTY)


def read_until(descriptor: int, enough: Callable[[bytes], bool]) -> bytes:
    """Read until there is enough; fail when it never comes."""
    data, end_s = b"", time.monotonic() + LIMIT_S
    while not enough(data):
        assert time.monotonic() < end_s, f"only {len(data)} bytes came"
        if select.select([descriptor], [], [], 0.1)[0]:
            part = os.read(descriptor, 65536)
            if not part:
                raise ConnectionResetError("the port is gone")
            data += part
    return data


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def normal_frames(data: bytes) -> list[bytes]:
    """Frames of 38 bytes and CR LF that follow each other; whatever else is passed over."""
    frames, at = [], 0
    while at + FRAME <= len(data):
        if data[at] == 0x93 and data[at + 38 : at + FRAME] == b"\r\n":
            frames.append(data[at : at + FRAME])
            at += FRAME
        else:
            at += 1
    return frames


def test_stream_begins_with_identity_and_start_up_then_runs_without_a_gap() -> None:
    # At its own pace: a pseudo-terminal holds 4096 bytes, and a busy reader must not lose one.
    with Emulator(stim300(), source(), EmulatorSettings(wait_for_reader=True)) as emulator:
        descriptor = open_port(emulator.port)
        data = read_until(descriptor, lambda got: len(got) > 40000)
        os.close(descriptor)
    assert data.startswith(stim300().power_on())
    frames = normal_frames(data)
    assert FRAME * len(frames) > len(data) - len(stim300().power_on()) - FRAME
    counter = np.array([frame[31] for frame in frames])
    assert set(np.diff(counter) % 256) == {4}
    starting = np.array([frame[10] == 0x40 for frame in frames])
    # 281 ms at 500 Hz
    assert np.array_equal(np.flatnonzero(starting), np.arange(141))
    z = np.array([int.from_bytes(frame[17:20], "big", signed=True) for frame in frames]) / 2**19
    assert abs(z).max() < 1.1
    assert emulator.failure is None
    assert emulator.bytes_dropped == 0


@pytest.mark.parametrize("held", [False, True], ids=["closed", "open but not read"])
def test_nobody_reading_blocks_nothing_and_drops_are_counted(held: bool) -> None:
    with Emulator(stim300(), source(), EmulatorSettings(speed=50.0)) as emulator:
        descriptor = open_port(emulator.port) if held else -1
        until(lambda: emulator.bytes_dropped > 100000)
        before_s = emulator.time_s
        until(lambda: emulator.time_s > before_s + 1.0)
        if held:
            os.close(descriptor)
    assert emulator.failure is None


def test_what_a_host_takes_too_late_is_known() -> None:
    terminal = PseudoTerminal()
    try:
        # Nobody is there: nothing is taken too late.
        terminal.write(bytes(200000))
        assert terminal.share_taken == 1.0
        descriptor = open_port(terminal.address)
        terminal.write(bytes(1000))
        assert terminal.share_taken == 1.0
        terminal.write(bytes(999000))
        lost = terminal.bytes_dropped - 200000
        assert lost > 500000
        assert terminal.share_taken == pytest.approx(1 - lost / 1e6)
        os.close(descriptor)
    finally:
        terminal.close()


def test_late_opener_finds_no_old_bytes() -> None:
    with Emulator(stim300(), source(), EmulatorSettings(speed=4.0)) as emulator:
        until(lambda: emulator.time_s > 1.0)
        descriptor = open_port(emulator.port)
        frames = normal_frames(read_until(descriptor, lambda got: len(got) > 1000))
        os.close(descriptor)
    # Start-up, with which the stream began, is long over.
    assert frames[0][10] == 0


def test_commands_are_answered_within_the_stream() -> None:
    with Emulator(stim300(), source(), EmulatorSettings(wait_for_reader=True)) as emulator:
        descriptor = open_port(emulator.port)
        before = read_until(descriptor, lambda got: len(got) > 1000)
        os.write(descriptor, b"C\r")
        answer = stim300().answer(b"C").data
        data = read_until(descriptor, lambda got: answer in got and len(normal_frames(got)) > 20)
        # Its place was taken from one datagram.
        steps = {int(step) for step in np.diff([frame[31] for frame in normal_frames(before + data)]) % 256}
        assert steps == {4, 8}
        os.write(descriptor, b"R\r")
        read_until(descriptor, lambda got: stim300().power_on() in got and any(f[10] == 0x40 for f in normal_frames(got)))
        os.write(descriptor, b"SERVICEMODE\r")
        read_until(descriptor, lambda got: got.endswith(b"\r>"))
        os.write(descriptor, b"x n\r")
        read_until(descriptor, lambda got: got.startswith(b"x n\r") and len(normal_frames(got)) > 3)
        os.close(descriptor)


def test_an_answer_takes_the_place_of_the_only_datagram_that_is_due() -> None:
    with Emulator(stim300(50.0), source(50.0), EmulatorSettings(wait_for_reader=True)) as emulator:
        descriptor = open_port(emulator.port)
        read_until(descriptor, lambda got: len(normal_frames(got)) > 2)
        answer = stim300(50.0).answer(b"C").data
        for _ in range(3):
            os.write(descriptor, b"C\r")
            read_until(descriptor, lambda got: answer in got)
        read_until(descriptor, lambda got: len(normal_frames(got)) > 0)
        os.close(descriptor)
    assert emulator.failure is None


def test_port_goes_away_and_comes_back_under_its_name(tmp_path: Path) -> None:
    link = tmp_path / "imu"
    settings = EmulatorSettings(speed=2.0, wait_for_reader=True, link=link)
    with Emulator(stim300(), source(), settings, faults=Faults(disconnect_at_s=(0.5,), disconnect_s=0.5)) as emulator:
        assert emulator.port == str(link)
        descriptor = open_port(emulator.port)
        # Linux ends the file, other systems raise an error of their own.
        with pytest.raises(OSError):  # noqa: PT011
            read_until(descriptor, lambda got: len(got) > 10**6)
        os.close(descriptor)
        # The old link may be there for a moment longer, and lead nowhere.
        until(link.exists)
        descriptor = open_port(emulator.port)
        assert normal_frames(read_until(descriptor, lambda got: len(got) > 1000))
        os.close(descriptor)
        assert emulator.injector.counts["disconnects"] == 1
    assert not link.is_symlink()


def test_stalled_data_comes_later_whole() -> None:
    faults = Faults(stalls_per_s=2.0, stall_s=0.1)
    with Emulator(stim300(), source(), EmulatorSettings(speed=4.0, wait_for_reader=True), faults=faults, seed=3) as emulator:
        descriptor = open_port(emulator.port)
        data = read_until(descriptor, lambda got: len(got) > 60000)
        os.close(descriptor)
    assert emulator.injector.counts["stalls"] > 0
    assert set(np.diff([frame[31] for frame in normal_frames(data)]) % 256) == {4}


def test_counter_jumps_where_faults_say_so() -> None:
    faults = Faults(counter_jumps_per_s=2.0)
    with Emulator(stim300(), source(), EmulatorSettings(speed=4.0, wait_for_reader=True), faults=faults) as emulator:
        descriptor = open_port(emulator.port)
        data = read_until(descriptor, lambda got: len(got) > 60000)
        os.close(descriptor)
    steps = np.diff([frame[31] for frame in normal_frames(data)]) % 256
    assert 1 <= np.count_nonzero(steps != 4) <= emulator.injector.counts["counter_jumps"]


def test_duration_ends_it() -> None:
    options = Emulation(device="text")
    device = make_device(options, choose_wire(options))
    with Emulator(device, source(100.0), EmulatorSettings(speed=20.0, duration_s=2.0, wait_for_reader=True)) as emulator:
        descriptor = open_port(emulator.port)
        lines = read_until(descriptor, lambda got: got.count(b"\n") >= 200).decode().splitlines()
        assert emulator.wait(LIMIT_S)
        os.close(descriptor)
    assert emulator.samples_sent == 200
    assert [len(line.split(",")) for line in lines] == [7] * 200
    assert lines[199].startswith("1.990000,")


def test_failure_of_the_source_is_kept() -> None:
    broken = source()
    broken.imu.settings = None  # type: ignore[assignment]
    with Emulator(stim300(), broken, EmulatorSettings()) as emulator:
        assert emulator.wait(LIMIT_S)
    assert isinstance(emulator.failure, AttributeError)


def test_stop_before_a_reader_came() -> None:
    emulator = Emulator(stim300(), source(), EmulatorSettings(wait_for_reader=True)).start()
    emulator.stop()
    emulator.stop()
    assert emulator.time_s == 0.0


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e6])
def test_senseless_speed_is_refused(speed: float) -> None:
    with refused(UsageError, Reason.USAGE, f"speed {speed:g}", "0 to 1000", key="core.speed"):
        Emulator(stim300(), source(), EmulatorSettings(speed=speed))


def test_link_never_replaces_a_file(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("precious")
    with refused(UsageError, Reason.USAGE, "notes", key="port.no_link") as caught:
        PseudoTerminal(tmp_path / "notes")
    assert caught.value.values["path"].endswith("notes")
    assert (tmp_path / "notes").read_text() == "precious"


def test_every_byte_value_passes_both_ways() -> None:
    pty = PseudoTerminal()
    descriptor = open_port(pty.address)
    try:
        everything = bytes(range(256))
        pty.write(everything)
        assert read_until(descriptor, lambda got: len(got) >= 256) == everything
        os.write(descriptor, everything)
        heard = b""
        while len(heard) < 256:
            heard += pty.read()
        assert heard == everything
    finally:
        os.close(descriptor)
        pty.close()


@pytest.mark.parametrize("to_hz", [125.0, 200.0, 2000.0])
def test_at_another_rate_the_same_motion_goes_on(to_hz: float) -> None:
    virtual = source(500.0)
    before = virtual.next_block(501)
    virtual.set_rate(to_hz)
    after = virtual.next_block(100)
    # The first sample is the next whole one of the new rate, counted from power-on.
    assert before.time_s[-1] < after.time_s[0] <= before.time_s[-1] + 1 / 500 + 1 / to_hz + 1e-9
    np.testing.assert_allclose(np.diff(after.time_s), 1 / to_hz, rtol=1e-9)
    assert after.counter.tolist() == list(range(round(after.time_s[0] * to_hz), round(after.time_s[0] * to_hz) + 100))
    sigma = before.accelerometer.std(axis=0), after.accelerometer.std(axis=0)
    # White noise of a constant density: its standard deviation grows with the root of the rate.
    np.testing.assert_allclose(sigma[1] / sigma[0], np.sqrt(to_hz / 500), rtol=0.5)
    allowed = 5 * np.max(sigma[1] / np.sqrt(100) + sigma[0] / np.sqrt(501))
    np.testing.assert_allclose(after.accelerometer.mean(axis=0), before.accelerometer.mean(axis=0), atol=allowed)


def test_rates_go_up_and_down_while_it_runs() -> None:
    device = stim300()
    emulator = Emulator(device, source(), EmulatorSettings(speed=4.0))
    # Told by the emulator's own thread: between two of its steps time has gone on and samples have not.
    moments: list[tuple[float | None, int, float]] = []
    emulator.on_progress = lambda: moments.append((device.rate_hz, emulator.samples_sent, emulator.time_s))
    with emulator:
        port = open_port(emulator.port)
        for code, rate_hz in ((0, 125), (4, 2000), (2, 500)):
            os.write(port, b"UTILITYMODE\r" + utility_message(f"$sm,{code}") + utility_message("$xn"))
            until(lambda wanted=rate_hz: bool(moments) and moments[-1][0] == wanted)  # type: ignore[misc]
            _, before, since_s = moments[-1]
            until(lambda since_s=since_s: moments[-1][2] > since_s + 2.0)  # type: ignore[misc]
            _, after, until_s = moments[-1]
            assert after - before == pytest.approx(rate_hz * (until_s - since_s))
            os.read(port, 65536)
        os.write(port, b"R\r")
        os.close(port)
    assert emulator.failure is None
