"""An emulated slcan adapter: Lawicel's ASCII protocol on a pseudo-terminal.

What programs of this family send: ``S0`` to ``S8`` bit rate, ``O`` open, ``L`` open to listen only, ``C`` close, ``V`` version,
``N`` serial number, ``F`` status flags, ``tIIILDD..`` and ``TIIIIIIIILDD..`` a frame. An answer ends with CR, an error is BEL.
Frames come the other way in the same form. Error frames have no form at all.
"""

from __future__ import annotations

from can.util import CAN_FD_DLC

from imufield.acquire.protocol.can_frame import BIT_RATE_SWITCH, ERROR, EXTENDED, FD, ID_MASK, REMOTE, Frame
from imufield.simulate.emulator.port import BUFFER_BYTES, PseudoTerminal

SLCAN = "slcan"
"""Name of the interface, as in python-can."""
_END = b"\r"
_BELL = b"\a"
_LONGEST_LINE = 200  # A CAN FD frame of 64 bytes has 138 characters.
_FLAGS = {"t": 0, "r": 0, "d": FD, "b": FD | BIT_RATE_SWITCH}  # By the letter a frame begins with, a capital if extended.


class SlcanDevice:
    """An adapter that a host opens as ``slcan:PORT``."""

    def __init__(self, port: PseudoTerminal | None = None) -> None:
        self.port = port or PseudoTerminal()
        self.is_open = False  # Whether the host has opened the channel.
        self.bit_rate_code = ""
        self.frames_dropped = 0  # Frames that came while the channel was closed, or the host did not read.
        self._frames_for_host = 0
        self._frames_too_late = 0
        self._line = b""

    @property
    def share_taken(self) -> float:
        """Of the frames for a host that has opened the channel, the part that it took in time."""
        return 1.0 - self._frames_too_late / max(self._frames_for_host, 1)

    @property
    def address(self) -> str:
        """What a host opens."""
        return f"{SLCAN}:{self.port.address}"

    def has_reader(self) -> bool:
        """Answer what the host asks; return whether it has opened the channel."""
        self.receive()
        return self.is_open

    def send(self, frames: list[Frame]) -> None:
        """Hand frames of the bus to the host."""
        if not self.is_open:
            self.frames_dropped += len(frames)
            return
        room = BUFFER_BYTES - self.port.bytes_waiting
        lines = []
        for frame in frames:
            # The protocol has no form for an error frame.
            if frame.can_id & ERROR:
                continue
            line = format_frame(frame).encode("ascii")
            # An adapter whose host is late drops frames, never parts of one.
            room -= len(line)
            self._frames_for_host += 1
            if room < 0:
                self.frames_dropped += 1
                self._frames_too_late += 1
            else:
                lines.append(line)
        self.port.write(b"".join(lines))

    def receive(self) -> list[Frame]:
        """Answer what the host asks; return the frames it sends."""
        *lines, rest = (self._line + self.port.read()).split(_END)
        # Whatever a host writes, no more of it is kept than a line can have.
        self._line = rest[-_LONGEST_LINE:]
        frames = []
        answers = b""
        for line in lines:
            frame = parse_frame(line)
            if frame is not None:
                frames.append(frame)
                answers += (b"Z" if frame.can_id & EXTENDED else b"z") + _END
            else:
                answers += self._answer(line)
        if answers:
            self.port.write(answers)
        return frames

    def close(self) -> None:
        """Take the port away."""
        self.port.close()

    def _answer(self, line: bytes) -> bytes:
        command = line[:1]
        if command in (b"O", b"L"):
            self.is_open = True
            return _END
        if command == b"C":
            self.is_open = False
            return _END
        if command in (b"S", b"s", b"Y", b"Z", b"M", b"m"):
            self.bit_rate_code = line.decode("ascii", "replace")
            return _END
        fixed = {b"V": b"V1013", b"N": b"NA123", b"F": b"F00"}
        if command in fixed:
            return fixed[command] + _END
        return _BELL if line.strip() else _END


def format_frame(frame: Frame) -> str:
    """Return a frame as an adapter writes it, CR included."""
    extended, remote = bool(frame.can_id & EXTENDED), bool(frame.can_id & REMOTE)
    letter = "b" if frame.flags & BIT_RATE_SWITCH else "d" if frame.flags & FD else "r" if remote else "t"
    identifier = f"{frame.can_id & ID_MASK:0{8 if extended else 3}X}"
    size = CAN_FD_DLC.index(len(frame.data)) if frame.flags & FD else len(frame.data)
    data = "" if remote else frame.data.hex().upper()
    return f"{letter.upper() if extended else letter}{identifier}{size:X}{data}\r"


def parse_frame(line: bytes) -> Frame | None:
    """Return the frame a host wrote; None for anything else."""
    letter = line[:1].decode("latin-1")
    kind = letter.lower()
    if kind not in _FLAGS or len(line) > _LONGEST_LINE:
        return None
    digits = 8 if letter.isupper() else 3
    try:
        can_id = int(line[1 : 1 + digits], 16) | (EXTENDED if letter.isupper() else 0)
        size = CAN_FD_DLC[int(line[1 + digits : 2 + digits], 16)]
        data = bytes.fromhex(line[2 + digits :].decode("ascii"))
    except ValueError:
        return None
    if kind == "r":
        return Frame(can_id | REMOTE, b"")
    return Frame(can_id, data, flags=_FLAGS[kind]) if len(data) == size else None
