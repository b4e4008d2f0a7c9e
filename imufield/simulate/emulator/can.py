"""A virtual instrument on a CAN bus: real frames, real rate times ``speed``, with faults on request.

::

    with CanEmulator(load_protocol("j1939_imu"), source, "udp_multicast:239.0.0.1") as emulator:
        opened = open_can(emulator.bus, driver="aceinna_can")

``virtual:NAME`` stays inside one process. Between processes take ``udp_multicast:GROUP``, or ``slcan``: the emulator then plays
an adapter on a pseudo-terminal, and ``emulator.bus`` names it.
"""

from __future__ import annotations

import contextlib
import time

import can
import numpy as np

from imufield.acquire.link.can import make_message, open_bus, parse_bus
from imufield.acquire.protocol.can_frame import EXTENDED, Frame
from imufield.acquire.protocol.protocol import Protocol
from imufield.dataclass import replace
from imufield.samples import Samples, Status
from imufield.simulate.emulator.core import LINGER_S, EmulatorCore, EmulatorSettings
from imufield.simulate.emulator.faults import CanFaultInjector, CanFaults, error_burst
from imufield.simulate.emulator.port import PseudoTerminal
from imufield.simulate.emulator.slcan import SLCAN, SlcanDevice
from imufield.simulate.truth.virtual_imu import SampleSource
from imufield.simulate.wire.can_frames import CanEncoder

_REQUEST_PF = 0xEA  # SAE J1939-21: the PGN of a request is 0xEA00, its data the PGN asked for.
# Aceinna MTLT and OpenIMU sensors tell their version so.
_VERSION = {"VersionMajor": 19, "VersionMinor": 1, "VersionPatch": 51, "VersionStage": 0, "VersionBuild": 3}


class BusPort:
    """A bus of python-can, with the methods of ``SlcanDevice``."""

    share_taken = 1.0  # A bus does not tell what its listeners take.

    def __init__(self, bus: str) -> None:
        self.address = bus
        self._bus = open_bus(parse_bus(bus))

    def send(self, frames: list[Frame]) -> None:
        """Put frames on the bus."""
        for frame in frames:
            message = make_message(frame.can_id, frame.data, frame.flags)
            message.timestamp = frame.time_s
            # Without another node nobody acknowledges a frame, which is no failure of the instrument.
            with contextlib.suppress(can.CanError):
                self._bus.send(message)

    def receive(self) -> list[Frame]:
        """Return the frames of others since the last call."""
        frames = []
        while (message := self._bus.recv(0)) is not None:
            extended = EXTENDED if message.is_extended_id else 0
            frames.append(Frame(message.arbitration_id | extended, bytes(message.data)))
        return frames

    def has_reader(self) -> bool:
        """Return True: a bus does not tell who listens."""
        return True

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


class CanEmulator(EmulatorCore):
    """An instrument on a bus, run by a thread from ``start`` (or ``with``) to ``stop``.

    Parameters
    ----------
    protocol : Protocol
        Of kind "can".
    source : SampleSource
        Gives the samples, in the units of the protocol.
    bus : str
        ``INTERFACE:CHANNEL``, or ``slcan`` for an adapter on a pseudo-terminal.
    settings : EmulatorSettings, optional
    faults : CanFaults, optional
    seed : int
        Of the faults.

    Raises
    ------
    UsageError
        If the bus makes no sense.
    LinkError
        If the bus cannot be opened.
    """

    def __init__(
        self,
        protocol: Protocol,
        source: SampleSource,
        bus: str,
        settings: EmulatorSettings | None = None,
        *,
        faults: CanFaults | None = None,
        seed: int = 0,
    ) -> None:
        settings = settings or EmulatorSettings()
        self.injector = CanFaultInjector(faults or CanFaults(), seed)
        self.encoder = CanEncoder(protocol)
        self._bus: BusPort | SlcanDevice = SlcanDevice(PseudoTerminal(settings.link)) if bus == SLCAN else BusPort(bus)
        super().__init__(source, settings, self._bus, self.injector)
        # An adapter hands out nothing before its channel is open, so it always waits for that.
        self._waits |= bus == SLCAN
        messages = protocol.can.messages if protocol.can else ()
        # By PGN: bits 8 to 25 of the 29 of an identifier.
        self._messages = {message.can_id >> 8 & 0x3FFFF: message.name for message in messages}
        self._start_wall_s = 0.0
        self._pending: list[Frame] = []  # Kept back while the instrument stalls.

    @property
    def bus(self) -> str:
        """What a host opens."""
        return self.address

    def _power_on(self) -> None:
        self._start_wall_s = time.time()

    def _listen(self) -> None:
        """Answer J1939 requests for the messages this instrument has."""
        for frame in self._bus.receive():
            if frame.can_id & EXTENDED and frame.can_id >> 16 & 0xFF == _REQUEST_PF and len(frame.data) >= 3:
                name = self._messages.get(int.from_bytes(frame.data[:3], "little"))
                if name is not None:
                    self._bus.send([self.encoder.frame(name, _VERSION if name == "SoftwareVersion" else {})])

    def _put(self, samples: Samples, duration_s: float, *, stalled: bool) -> None:
        self.encoder.counter_offset += self.injector.counter_jump(duration_s)
        unavailable = self.injector.unavailable(len(samples))
        if unavailable.any():
            invalid = np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)
            samples = replace(samples, status=np.where(unavailable, samples.status | invalid, samples.status))
        frames = self.encoder.encode(samples)
        self.samples_sent += len(samples)
        if self._is_gone:
            self.injector.counts["frames_while_off"] += len(frames)
            return
        self._pending += self.injector.damage(frames, self.time_s, duration_s)
        if not stalled:
            self._send_pending()

    def _send_pending(self) -> None:
        self._send(self._pending)
        self._pending = []

    def _send(self, frames: list[Frame]) -> None:
        """Send frames of the instrument's time with stamps of the host's clock."""
        begin_s, speed = self._start_wall_s, self.settings.speed
        self._bus.send([replace(frame, time_s=begin_s + frame.time_s / speed) for frame in frames])

    def _go_away(self) -> None:
        self._send(error_burst(self.time_s))

    def _come_back(self) -> None:
        """Do nothing: the next frames are sent."""

    def _linger(self) -> None:
        self._send_pending()
        self._stopping.wait(LINGER_S)
