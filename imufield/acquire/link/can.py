"""Open a CAN bus through python-can by an address such as ``socketcan:can0``, and read frames from it in chunks.

``INTERFACE:CHANNEL``, with options of the interface behind a question mark::

    socketcan:can0                         pcan:PCAN_USBBUS1?bitrate=250000
    slcan:/dev/ttyACM0@115200              vector:0?app_name=imufield&bitrate=500000
    virtual:bench                          udp_multicast:239.0.0.1       (or 239.0.0.1:43113)

A read waits for the first frame, lets the driver collect for 20 ms, and returns what is there. A chunk holds packed frames
(``can_frames``), so that the recorder and everything behind it see bytes, as of a serial port. Time stamps of the host's clock
are put on its monotonic clock; those of an adapter stay as they are.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import re
import socket
import time
from typing import Any

import can

from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, SystemClock
from imufield.acquire.link.link_errors import system_errno
from imufield.acquire.link.serial import COLLECT_S, WAIT_S, WRITE_TIMEOUT_S, not_taken
from imufield.acquire.protocol.can_frame import (
    ADAPTER_TIME,
    BIT_RATE_SWITCH,
    BUS_OFF,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    ID_MASK,
    REMOTE,
    SENT,
    pack_frame,
)
from imufield.acquire.protocol.can_frames import unpack_frames
from imufield.acquire.protocol.toml import near
from imufield.dataclass import dataclass, field
from imufield.errors import LinkError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)
# python-can logs lines of a file as they are, and every driver that is not installed; what it means is said in a sentence.
logging.getLogger("can").setLevel(logging.CRITICAL)

MOST_FRAMES = 4096
"""Most frames of one chunk: 0.2 s of the busiest bus of 1 Mbit/s; what remains is the next chunk."""
RECEIVE_BUFFER_BYTES = 1 << 20
"""Asked of the system for sockets: its usual 208 KiB hold some 270 frames, 35 ms of a busy bus."""
_HOST_CLOCK_S = 60.0  # A time stamp nearer than this to the host's clock was made by it.
# Reads in a row that may fail before the bus counts as gone: one alone may be a garbled line or a stranger's datagram.
_FAULTS_BORNE = 3
# Interfaces whose bit rate is set elsewhere, or that have none.
_NO_BIT_RATE = ("socketcan", "virtual", "udp_multicast", "socketcand")
_EXTRAS = {"udp_multicast": "multicast", "slcan": "serial"}  # Of python-can, where they have another name than the interface.
# What python-can's drivers raise where a bus cannot be opened. Besides its own errors: OSError of the system, ValueError and
# TypeError for options that the interface does not know, and ImportError, AttributeError or NameError (kvaser) where the
# vendor's library is missing or older than the driver expects.
_OPEN_FAILURES = (can.CanError, OSError, ValueError, TypeError, ImportError, AttributeError, NameError)
# What ``recv`` and ``send`` raise: python-can's own, OSError of the system, and ValueError or IndexError of drivers that parse
# text or datagrams (slcan, udp_multicast) and meet a garbled one.
_READ_FAILURES = (can.CanError, OSError, ValueError, IndexError)
_GROUP_AND_PORT = re.compile(r"((?:\d+\.){3}\d+):(\d+)")
# What a number of the system means where a bus cannot be opened.
_OPEN_FAULTS = (
    ((errno.ENODEV, errno.ENOENT, errno.ENXIO), Reason.PORT_NOT_FOUND, "can.absent"),
    ((errno.EACCES, errno.EPERM), Reason.NO_PERMISSION, "can.no_permission"),
    ((errno.EBUSY,), Reason.PORT_BUSY, "can.busy"),
    ((errno.EAFNOSUPPORT,), Reason.PORT_NOT_FOUND, "can.no_socketcan"),
    ((errno.ENETDOWN,), Reason.DISCONNECTED, "can.down"),
)
_EXAMPLES = {"socketcan": "can0", "slcan": "/dev/ttyACM0", "pcan": "PCAN_USBBUS1"}  # Of channels, by interface.


# Handed to python-can, whose drivers know what they take.
BusOptions = dict[str, Any]


@dataclass(frozen=True, slots=True)
class BusAddress:
    """A bus, as typed.

    Attributes
    ----------
    interface, channel : str
    options : dict
        Of the interface, as python-can names them.
    """

    interface: str
    channel: str
    options: BusOptions = field(default_factory=dict)

    @property
    def bit_rate(self) -> int | None:
        """The bit rate that the address gives, None without."""
        rate = self.options.get("bitrate")
        return int(rate) if isinstance(rate, int | float) else None

    @property
    def takes_bit_rate(self) -> bool:
        """Whether the bit rate is set on opening, and the address does not give it."""
        return self.interface not in _NO_BIT_RATE and "bitrate" not in self.options


def parse_bus(text: str) -> BusAddress:
    """Read ``INTERFACE:CHANNEL?option=value&option=value``.

    Raises
    ------
    UsageError
        If it is not of this form, or python-can has no such interface.
    """
    place, _, tail = text.partition("?")
    interface, _, channel = place.partition(":")
    known = sorted(can.interfaces.VALID_INTERFACES)
    if interface not in known:
        if ":" not in place:
            raise UsageError(sentence("can.no_colon", bus=text, known=known))
        hint = near(interface, known)
        raise UsageError(sentence("can.interface", bus=text, interface=interface, near=hint, known=known))
    if not channel:
        example = _EXAMPLES.get(interface, "0")
        raise UsageError(sentence("can.no_channel", bus=text, interface=interface, example=example))
    options: BusOptions = {}
    for part in filter(None, tail.split("&")):
        name, equals, value = part.partition("=")
        if not (name.isidentifier() and equals):
            raise UsageError(sentence("can.option", bus=text, option=part))
        options[name] = _typed(value)
    if interface == "udp_multicast" and (found := _GROUP_AND_PORT.fullmatch(channel)):
        channel, options["port"] = found.group(1), int(found.group(2))
    return BusAddress(interface, channel, options)


def _typed(value: str) -> float | str:
    """Return a number or a truth value where a text is one."""
    for convert in (int, float):
        with contextlib.suppress(ValueError):
            return convert(value)
    return {"true": True, "false": False}.get(value.lower(), value)


def open_bus(address: BusAddress, bit_rate: int | None = None) -> can.BusABC:
    """Open a bus through python-can.

    Parameters
    ----------
    address : BusAddress
    bit_rate : int, optional
        Where the address does not give it and the interface sets one.

    Raises
    ------
    LinkError
        Not there, busy, no permission.
    UsageError
        The interface needs a package or a library that is not installed, or an option makes no sense to it.
    """
    options = dict(address.options)
    if bit_rate and address.takes_bit_rate:
        options["bitrate"] = bit_rate
    try:
        bus = _make_bus(address.interface, address.channel, options)
    except can.CanInterfaceNotImplementedError as error:
        # The driver of the interface, or the package that holds it, is not installed.
        extra = _EXTRAS.get(address.interface, address.interface)
        missing = sentence("can.no_driver", interface=address.interface, cause=error, extra=extra)
        raise UsageError(missing, Reason.MISSING_PACKAGE) from error
    except _OPEN_FAILURES as error:
        name, number = f"{address.interface}:{address.channel}", system_errno(error)
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        faults = ((reason, key) for numbers, reason, key in _OPEN_FAULTS if number in numbers)
        reason, key = next(faults, (Reason.DISCONNECTED, "can.cannot_open"))
        if key == "can.absent" and address.interface == "socketcan":
            key = "can.absent_link"
        raise LinkError(sentence(key, bus=name, channel=address.channel, cause=cause), reason) from error
    # NotImplementedError: serial and virtual buses have no socket.
    # OSError: a system that refuses the larger buffer still has its usual one.
    with contextlib.suppress(OSError, NotImplementedError):
        channel = socket.socket(fileno=bus.fileno())
        try:
            channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        finally:
            channel.detach()  # The bus closes it.
    return bus


def _make_bus(interface: str, channel: str, options: BusOptions) -> can.BusABC:
    if interface == "slcan":
        from imufield.acquire.link.slcan import SlcanBus

        return SlcanBus(channel, **options)
    return can.Bus(channel, interface, ignore_config=True, **options)


class CanLink:
    """A CAN bus; made by ``open_can_link``.

    Parameters
    ----------
    name : str
        As typed.
    address : BusAddress
    bit_rate : int or None
    clock : HostClock

    Raises
    ------
    LinkError, UsageError
        As ``open_bus``.
    """

    def __init__(self, name: str, address: BusAddress, bit_rate: int | None, clock: HostClock) -> None:
        self.name = name
        self.address = address
        self.bit_rate = bit_rate
        self.faults = 0  # Reads that failed and were borne.
        self._clock = clock
        self._speed = float(getattr(clock, "speed", 1.0))
        self._bus: can.BusABC | None = open_bus(address, bit_rate)
        self._in_a_row = 0
        self._is_off = False

    def read(self) -> Chunk | None:
        """Return up to 20 ms of the bus as packed frames, or None if nothing came within 50 ms.

        Raises
        ------
        LinkError
            The bus is closed, gone, or its controller has left it ("bus off").
        """
        bus = self._opened()
        if self._is_off:
            raise LinkError(sentence("can.off", bus=self.name), Reason.DISCONNECTED)
        messages: list[can.Message] = []
        try:
            first = bus.recv(WAIT_S)
            if first is not None:
                messages.append(first)
                self._clock.sleep(COLLECT_S)
                while len(messages) < MOST_FRAMES and (message := bus.recv(0)) is not None:
                    messages.append(message)
        except _READ_FAILURES as error:
            self.faults += 1
            # What came before still counts; the next read meets the error again.
            if not messages:
                self._in_a_row += 1
                if self._in_a_row > _FAULTS_BORNE:
                    raise self._gone(error) from error
                return None
        self._in_a_row = 0
        return self._chunk(messages) if messages else None

    def _chunk(self, messages: list[can.Message]) -> Chunk:
        # In this order: what stops us between the two makes stamps late, as everything does, and none early.
        wall_s, arrival_s = time.time(), self._clock.monotonic_s()
        utc_ns = self._clock.utc_ns()
        pieces = []
        for message in messages:
            time_s, flags = message.timestamp, 0
            if abs(wall_s - time_s) < _HOST_CLOCK_S:
                time_s = arrival_s - (wall_s - time_s) * self._speed
            elif time_s == 0.0:
                # The driver gives no stamp.
                time_s = arrival_s
            else:
                flags = ADAPTER_TIME
            pieces.append(pack_message(message, time_s, flags))
            if message.is_error_frame and message.arbitration_id & BUS_OFF:
                self._is_off = True
        return Chunk(b"".join(pieces), arrival_s, utc_ns)

    def write(self, data: bytes) -> None:
        """Send packed frames.

        Raises
        ------
        LinkTimeoutError
            The bus did not take them within 1 s.
        LinkError
            The bus is closed or gone.
        """
        bus = self._opened()
        try:
            for frame in unpack_frames(data):
                bus.send(make_message(frame.can_id, frame.data, frame.flags), timeout=WRITE_TIMEOUT_S)
        except can.CanTimeoutError as error:
            raise not_taken(self.name, "a frame", sentence("can.check_nodes")) from error
        except _READ_FAILURES as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Give the bus back; may be called again."""
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(*_READ_FAILURES):
                bus.shutdown()

    def reopen(self) -> bool:
        """Try to open the same bus again after it was lost; return False while that makes no sense yet.

        Raises
        ------
        LinkError
            The bus is there and may not be used: waiting would not help.
        """
        self.close()
        try:
            self._bus = open_bus(self.address, self.bit_rate)
        except LinkError as error:
            if error.reason is Reason.NO_PERMISSION:
                raise
            return False
        self._is_off, self._in_a_row = False, 0
        return True

    def _opened(self) -> can.BusABC:
        if self._bus is None:
            raise self._gone(None)
        return self._bus

    def _gone(self, cause: BaseException | None) -> LinkError:
        key = "can.closed" if cause is None else "can.gone"
        return LinkError(sentence(key, bus=self.name, cause=str(cause)), Reason.DISCONNECTED)


def pack_message(message: can.Message, time_s: float, flags: int = 0) -> bytes:
    """Return a message of python-can as a packed frame."""
    can_id = message.arbitration_id & ID_MASK
    if message.is_extended_id:
        can_id |= EXTENDED
    if message.is_error_frame:
        can_id |= ERROR
    elif message.is_remote_frame:
        return pack_frame(can_id | REMOTE, b"", time_s, flags)
    if message.is_fd:
        flags |= FD | (BIT_RATE_SWITCH if message.bitrate_switch else 0) | (ERROR_STATE if message.error_state_indicator else 0)
    if not message.is_rx:
        flags |= SENT
    return pack_frame(can_id, bytes(message.data), time_s, flags)


def make_message(can_id: int, data: bytes, flags: int = 0) -> can.Message:
    """Return a packed frame's content as a message of python-can."""
    return can.Message(
        arbitration_id=can_id & ID_MASK,
        data=data,
        is_extended_id=bool(can_id & EXTENDED),
        is_remote_frame=bool(can_id & REMOTE),
        is_error_frame=bool(can_id & ERROR),
        is_fd=bool(flags & FD),
        bitrate_switch=bool(flags & BIT_RATE_SWITCH),
        error_state_indicator=bool(flags & ERROR_STATE),
        is_rx=False,
    )


def open_can_link(bus: str, *, bit_rate: int | None = None, clock: HostClock | None = None) -> CanLink:
    """Open a bus by its text.

    Parameters
    ----------
    bus : str
        ``INTERFACE:CHANNEL``, see the module.
    bit_rate : int, optional
        For interfaces that set it, unless the text gives one.
    clock : HostClock, optional
        Stamps the chunks; the system's clock by default.

    Raises
    ------
    LinkError, UsageError
        As ``open_bus``.
    """
    return CanLink(bus, parse_bus(bus), bit_rate, clock or SystemClock())
