"""Links on real buses of python-can: virtual, UDP multicast, and slcan on a pseudo-terminal."""

from __future__ import annotations

import itertools
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from imufield.acquire.link.can import RECEIVE_BUFFER_BYTES, CanLink, open_can_link, parse_bus
from imufield.acquire.link.host_clock import ScaledClock
from imufield.acquire.link.slcan import LINE_LIMIT_BYTES, SlcanBus
from imufield.acquire.protocol.can_frame import ADAPTER_TIME, ERROR, EXTENDED, FD, Frame, pack_frame
from imufield.acquire.protocol.can_frames import unpack_frames
from imufield.errors import LinkError, ProtocolError, Reason, UsageError
from imufield.simulate.emulator.slcan import SlcanDevice
from tests.opened_can import open_can
from tests.refused import refused

NUMBERS = itertools.count()
GROUP = "239.74.0.2"


@pytest.fixture
def channel() -> str:
    return f"test-{os.getpid()}-{next(NUMBERS)}"


@pytest.fixture
def port() -> int:
    # Linux hands a datagram to all who listen at its port, whatever their group: other tests must not use the same.
    number = 20_000 + (97 * os.getpid() + next(NUMBERS)) % 30_000
    try:
        can.Bus(GROUP, "udp_multicast", port=number).shutdown()
    except (OSError, can.CanError):
        pytest.skip("no interface of this machine routes multicast, which udp_multicast needs")
    return number


def read_all(link: CanLink, count: int, patience_s: float = 60.0) -> list[Frame]:
    frames: list[Frame] = []
    end_s = time.monotonic() + patience_s
    while len(frames) < count and time.monotonic() < end_s:
        chunk = link.read()
        if chunk is not None:
            frames += unpack_frames(chunk.data)
    return frames


def messages(count: int = 50) -> list[can.Message]:
    plain = [can.Message(arbitration_id=0x100 + n, data=bytes([n] * (n % 9)), is_extended_id=False) for n in range(count)]
    long = can.Message(arbitration_id=0x18FEDA80, data=bytes(range(64)), is_fd=True, bitrate_switch=True)
    return [*plain, long, can.Message(arbitration_id=0x7, is_remote_frame=True, is_extended_id=False, dlc=0)]


def check(frames: list[Frame], sent: list[can.Message]) -> None:
    assert [frame.data for frame in frames] == [bytes(message.data) for message in sent]
    assert [frame.can_id & 0x1FFFFFFF for frame in frames] == [message.arbitration_id for message in sent]
    assert [bool(frame.can_id & EXTENDED) for frame in frames] == [message.is_extended_id for message in sent]
    assert bool(frames[-2].flags & FD) == sent[-2].is_fd


def test_virtual(channel: str) -> None:
    link = open_can_link(f"virtual:{channel}")
    with can.Bus(channel, "virtual") as bus:
        before_s = time.monotonic()
        for message in messages():
            bus.send(message)
        frames = read_all(link, 52)
        check(frames, messages())
        # Stamps of the host are on its monotonic clock.
        assert all(before_s - 0.01 <= frame.time_s <= time.monotonic() + 0.01 for frame in frames)
        link.write(pack_frame(0x123, b"hello"))
        heard = bus.recv(60.0)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data), heard.is_extended_id) == (0x123, b"hello", False)
    link.close()


def test_udp_multicast(port: int) -> None:
    link = open_can_link(f"udp_multicast:{GROUP}:{port}")
    with can.Bus(GROUP, "udp_multicast", port=port) as bus:
        for message in messages():
            bus.send(message)
        check(read_all(link, 52), messages())
    link.close()


def test_datagrams_wait_while_the_program_is_busy(port: int) -> None:
    most_bytes = Path("/proc/sys/net/core/rmem_max")
    if not most_bytes.exists() or int(most_bytes.read_text()) < RECEIVE_BUFFER_BYTES:
        pytest.skip("this system gives no socket a larger buffer")
    burst = 2 * 270  # Twice what the usual buffer holds.
    link = open_can_link(f"udp_multicast:{GROUP}:{port}")
    with can.Bus(GROUP, "udp_multicast", port=port) as bus:
        for number in range(burst):
            bus.send(can.Message(arbitration_id=number, data=bytes(8), is_extended_id=False))
        assert [frame.can_id for frame in read_all(link, burst)] == list(range(burst))
    link.close()


@pytest.fixture
def slcan() -> Iterator[SlcanDevice]:
    if sys.platform == "win32":
        pytest.skip("Windows has no pseudo-terminals, behind which the adapter is emulated")
    device = SlcanDevice()
    yield device
    device.close()


def test_slcan_on_a_pseudo_terminal(slcan: SlcanDevice) -> None:
    link = open_can_link(f"slcan:{slcan.port.address}@115200?sleep_after_open=0", bit_rate=250_000)
    deadline_s = time.monotonic() + 60
    while not slcan.is_open and time.monotonic() < deadline_s:
        slcan.receive()
    assert slcan.bit_rate_code == "S5"
    sent = [
        Frame(0x123, b"abc"),
        Frame(0x08F02D80 | EXTENDED, bytes(range(8))),
        Frame(0x5, b""),
        Frame(0x9, bytes(12), flags=FD),
    ]
    slcan.send(sent)
    got = read_all(link, 4)
    assert [(frame.can_id, frame.data) for frame in got] == [(frame.can_id, frame.data) for frame in sent]
    link.write(pack_frame(0x18EAFF80 | EXTENDED, b"\x53\xff\x00"))
    heard: list[Frame] = []
    while not heard and time.monotonic() < deadline_s:
        heard = slcan.receive()
    assert heard[0].text == "18EAFF80#53FF00"
    link.close()


def test_a_vanished_adapter_is_a_link_error(slcan: SlcanDevice) -> None:
    link = open_can_link(f"slcan:{slcan.port.address}?sleep_after_open=0")
    slcan.close()
    with pytest.raises(LinkError) as caught:
        read_all(link, 1)
    assert caught.value.reason is Reason.DISCONNECTED
    assert not link.reopen()
    link.close()
    with refused(LinkError, Reason.DISCONNECTED, "slcan:", key="can.closed"):
        link.read()


def test_a_garbled_line_is_borne(slcan: SlcanDevice) -> None:
    link = open_can_link(f"slcan:{slcan.port.address}?sleep_after_open=0")
    slcan.receive()
    slcan.send([Frame(1, b"a")])
    slcan.port.write(b"tXYZ\r")
    slcan.send([Frame(2, b"b")])
    assert [frame.can_id for frame in read_all(link, 2)] == [1, 2]
    assert link.faults == 1
    link.close()


@pytest.mark.parametrize("at_once", [1, 64])
def test_a_stream_without_line_ends_is_neither_waited_for_nor_kept(slcan: SlcanDevice, at_once: int) -> None:
    link = open_can_link(f"slcan:{slcan.port.address}?sleep_after_open=0")
    slcan.receive()
    bus = link._bus
    assert isinstance(bus, SlcanBus)
    enough = threading.Event()

    def babble() -> None:
        end_s = time.monotonic() + 10
        while time.monotonic() < end_s and not enough.wait(2e-4):
            # What waits for a busy reader would be so many faults behind the end of the stream.
            if bus.serialPortOrig.in_waiting < LINE_LIMIT_BYTES:
                slcan.port.write(b"U" * at_once)

    stream = threading.Thread(target=babble)
    stream.start()
    try:
        assert link.read() is None
        assert stream.is_alive()
        assert len(bus._buffer) <= LINE_LIMIT_BYTES
    finally:
        enough.set()
        stream.join()
    slcan.port.write(b"\r")
    slcan.send([Frame(1, b"a"), Frame(2, b"b")])
    assert [frame.can_id for frame in read_all(link, 2)] == [1, 2]
    link.close()


@pytest.mark.parametrize("cut", range(1, 12))
def test_lines_come_in_pieces(slcan: SlcanDevice, cut: int) -> None:
    link = open_can_link(f"slcan:{slcan.port.address}?sleep_after_open=0")
    slcan.receive()
    # An answer, a refusal and a line without a meaning between frames.
    stream = b"t12320102\rz\r\aT08F02D801AA\rF00\rt0010\r"
    slcan.port.write(stream[:cut])
    first = link.read()
    slcan.port.write(stream[cut:])
    frames = [*unpack_frames(first.data if first else b""), *read_all(link, 3 if first is None else 2)]
    assert [(frame.can_id, frame.data) for frame in frames] == [
        (0x123, b"\x01\x02"),
        (0x08F02D80 | EXTENDED, b"\xaa"),
        (1, b""),
    ]
    link.close()


def test_error_frames_are_kept_and_bus_off_ends_the_link(channel: str) -> None:
    link = open_can_link(f"virtual:{channel}")
    with can.Bus(channel, "virtual") as bus:
        bus.send(can.Message(arbitration_id=0x08, is_error_frame=True, data=bytes(8), is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8), is_extended_id=False))
        frames = read_all(link, 2)
        assert [frame.can_id for frame in frames] == [ERROR | 0x08, ERROR | 0x40]
        with refused(LinkError, Reason.DISCONNECTED, channel, key="can.off"):
            link.read()
        assert link.reopen()
        bus.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert len(read_all(link, 1)) == 1
    link.close()


def test_adapter_time_stays_as_it_is(channel: str) -> None:
    link = open_can_link(f"virtual:{channel}")
    with can.Bus(channel, "virtual", preserve_timestamps=True) as bus:
        bus.send(can.Message(timestamp=12.345678, arbitration_id=1))
        bus.send(can.Message(timestamp=0.0, arbitration_id=2))
        before_s = time.monotonic()
        first, second = read_all(link, 2)
    assert (first.time_s, first.flags) == (12.345678, ADAPTER_TIME)
    assert before_s <= second.time_s <= time.monotonic()
    link.close()


def test_a_scaled_clock_scales_stamps(channel: str) -> None:
    clock = ScaledClock(8.0)
    link = open_can_link(f"virtual:{channel}", clock=clock)
    with can.Bus(channel, "virtual") as bus:
        begin_s = time.monotonic()
        bus.send(can.Message(arbitration_id=1))
        sleep_s = time.monotonic()
        time.sleep(0.1)
        woken_s = time.monotonic()
        bus.send(can.Message(arbitration_id=2))
        end_s = time.monotonic()
        chunk = link.read()
        assert chunk is not None
        first, second = unpack_frames(chunk.data)
    # Both are in one chunk, so a pause between the clocks that are read for it moves both alike.
    assert 8.0 * (woken_s - sleep_s) - 0.01 <= second.time_s - first.time_s <= 8.0 * (end_s - begin_s) + 0.01
    link.close()


def test_silence_is_none(channel: str) -> None:
    link = open_can_link(f"virtual:{channel}")
    assert link.read() is None
    link.close()
    link.close()


@pytest.mark.parametrize(
    ("text", "interface", "channel", "options"),
    [
        ("socketcan:can0", "socketcan", "can0", {}),
        ("slcan:/dev/ttyACM0@115200", "slcan", "/dev/ttyACM0@115200", {}),
        ("pcan:PCAN_USBBUS1?bitrate=250000&fd=false", "pcan", "PCAN_USBBUS1", {"bitrate": 250000, "fd": False}),
        ("udp_multicast:239.0.0.1", "udp_multicast", "239.0.0.1", {}),
        ("udp_multicast:239.0.0.1:4000", "udp_multicast", "239.0.0.1", {"port": 4000}),
        ("udp_multicast:ff15:7079::7468?port=5", "udp_multicast", "ff15:7079::7468", {"port": 5}),
        ("vector:0?app_name=imufield", "vector", "0", {"app_name": "imufield"}),
    ],
)
def test_addresses(text: str, interface: str, channel: str, options: dict[str, object]) -> None:
    address = parse_bus(text)
    assert (address.interface, address.channel, address.options) == (interface, channel, options)


@pytest.mark.parametrize(
    ("text", "wanted", "key"),
    [
        ("soketcan:can0", "'socketcan'", "can.interface"),
        ("can0", "'can0'", "can.no_colon"),
        ("socketcan", "socketcan:can0", "can.no_channel"),
        ("pcan:", "pcan:PCAN_USBBUS1", "can.no_channel"),
        ("pcan:1?bitrate", "'bitrate'", "can.option"),
    ],
)
def test_wrong_addresses(text: str, wanted: str, key: str) -> None:
    with refused(UsageError, Reason.USAGE, wanted, key=key):
        parse_bus(text)


def test_what_is_not_there() -> None:
    with refused(LinkError, Reason.PORT_NOT_FOUND, "slcan:/dev/nowhere", key="can.absent"):
        open_can_link("slcan:/dev/nowhere?sleep_after_open=0")
    with pytest.raises((LinkError, UsageError)):
        open_can_link("socketcan:nowhere0")
    with pytest.raises((LinkError, UsageError)):
        open_can_link("slcan:/dev/null?no_such_option=1")


def test_open_can(channel: str) -> None:
    opened = open_can(f"virtual:{channel}", driver="aceinna_can", settings={"axes": "sae"})
    assert (opened.driver, opened.protocol.name, opened.link.bit_rate) == ("aceinna_can", "j1939_imu", 250_000)
    assert opened.protocol.settings["axes"].origin == "given"
    opened.link.close()
    with refused(UsageError, Reason.USAGE, "--driver", "--protocol", "--dbc"):
        open_can(f"virtual:{channel}")
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "stim300", "--port", "--bus"):
        open_can(f"virtual:{channel}", driver="stim300")
