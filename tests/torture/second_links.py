"""200 hostile links: what sits at the other end of a pseudo-terminal, a TCP port, an slcan adapter or a CAN bus on UDP.

The streams are sound ones of the emulated instruments, and then something is wrong with them; the same ones each time.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from random import Random

from imufield.acquire.protocol.can_frame import Frame
from imufield.simulate.emulator.emulate import (
    OWN_RATE_HZ,
    SCRIPTS,
    Emulation,
    WireChoice,
    choose_wire,
    make_device,
    make_virtual_imu,
)
from imufield.simulate.emulator.slcan import format_frame
from imufield.simulate.instruments.protocol_device import InProtocolUnits
from imufield.simulate.instruments.vectornav import sentence
from imufield.simulate.truth.virtual_imu import SampleSource
from imufield.simulate.wire.can_frames import CanEncoder
from tests.torture.hostile_values import ESCAPES, MEBIBYTE, NUMBERS, hostile_bytes

Script = Sequence[bytes | None]
PIECE_S = 0.02
PIECES = 100
CAN = ("bosch_mm510", "aceinna_can", "racelogic_can", "xsens_can")
FRAMED = (
    "stim300",
    "witmotion",
    "xsens_mtdata2",
    "microstrain_mip",
    "vectornav_binary",
    "novatel_oem7",
    "aceinna_serial",
    "kvh_17xx",
    "sbg_sbgecom",
)
LINES = ("text", "vectornav_ascii", "novatel_oem7_ascii")
DURATION_S = 2
GROUP = "239.74.45.83"


def _source(driver: str, rate_hz: float | None) -> tuple[Emulation, WireChoice, SampleSource]:
    options = Emulation(device=driver, rate_hz=rate_hz)
    wire = choose_wire(options)
    virtual = make_virtual_imu(options, wire.rate_hz)
    if driver in OWN_RATE_HZ:
        return options, wire, virtual
    grade = virtual.imu.instrument.grade
    return (
        options,
        wire,
        InProtocolUnits(virtual, (grade.accelerometer_scale, grade.gyroscope_scale), wire.protocol, wire.rate_hz),
    )


@cache
def stream_of(driver: str, samples: int) -> bytes:
    """Return what an instrument sends; a STIM300 does so at 125 Hz."""
    options, wire, source = _source(driver, 125.0 if driver == "stim300" else None)
    return make_device(options, wire).encode(source.next_block(samples)).data.tobytes()


@cache
def frames_of(driver: str, samples: int) -> tuple[Frame, ...]:
    """Return what an instrument sends on a CAN bus."""
    _, wire, source = _source(driver, None)
    return tuple(CanEncoder(wire.protocol).encode(source.next_block(samples)))


def _pieces(data: bytes) -> list[bytes]:
    size = max(1, len(data) // PIECES)
    return [data[at : at + size] for at in range(0, len(data), size)]


Answer = Callable[[bytes], bytes]
HANG_UP = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HostileLink:
    """What is at the other end, and the command that meets it; ``PORT`` in it is the address of the link."""

    name: str
    wire: str
    """``pty``, ``tcp`` or ``udp``."""
    command: tuple[str, ...]
    script: tuple[bytes | None, ...]
    """A piece each 20 ms; None hangs up, as an unplugged cable does."""
    answer: Answer
    interrupt_after_s: float = 0.0
    """For commands that have no end of their own."""


def _nothing(data: bytes) -> bytes:
    return b""


def hostile_link(number: int) -> HostileLink:
    """Return link ``number`` of the corpus."""
    random = Random(f"link {number}")
    kind = ("lines", "framed", "can", "framed", "lines", "slcan")[number % 6]
    driver = random.choice({"lines": LINES, "framed": FRAMED}.get(kind, CAN))
    if kind in ("can", "slcan"):
        return _can_link(random, kind, driver)
    # Two seconds of it, at most as much as a port of a megabit a second brings.
    data = stream_of(driver, 200)
    ways: dict[str, Callable[[Random, bytes], tuple[Script, str]]] = {
        "escapes": _escapes,
        "foreign": _foreign,
        "frozen": _frozen,
        "flood": _flood,
        "cut": _cut,
        "numbers": _numbers,
        "endless": _endless,
        "clock": _clock,
        "unplugged": _unplugged,
        "answers": lambda random, data: (_pieces(data), "answers"),
    }
    way = random.choice([*ways])
    script, what = ways[way](random, data)
    answer, answered = _answer(random, driver) if way == "answers" or random.random() < 0.3 else (_nothing, "no answer")
    wire = "tcp" if random.random() < 0.25 else "pty"
    command, interrupt_s = _command(random, driver, asked=answered != "no answer")
    return HostileLink(
        name=f"{driver} on {wire}: {what}, {answered}",
        wire=wire,
        command=command,
        script=tuple(script),
        answer=answer,
        interrupt_after_s=interrupt_s,
    )


def _command(random: Random, driver: str, *, asked: bool, address: str = "--port") -> tuple[tuple[str, ...], float]:
    port = (address, "PORT")
    settings = ("--set", "imu=hg4930") if driver.startswith("novatel") else ()
    live = (*port, "--driver", driver, *settings, "--session", "s")
    options: list[tuple[tuple[str, ...], float]] = [
        (("record", *live, "--duration-s", str(DURATION_S)), 0.0),
        (("record", *live, "--duration-s", str(DURATION_S)), 0.0),
        (("record", *port, *settings, "--session", "s", "--duration-s", str(DURATION_S)), 0.0),
        (("capture", *live, "--quiet", "--positions", "faces6", "--hold-s", "2"), 4.0),
        (("capture", *live, "--json", "--positions", "faces6", "--hold-s", "2"), 4.0),
        (("probe", *port), 0.0),
        (("probe", *port, "--ask"), 0.0),
    ]
    if asked and address == "--port":
        options += [(("probe", *port, "--ask"), 0.0), (("record", *live, "--duration-s", "1", "--rate-hz", "100"), 0.0)] * 3
    return random.choice(options)


def _escapes(random: Random, data: bytes) -> tuple[Script, str]:
    escape = random.choice(ESCAPES)
    pieces: list[bytes | None] = []
    for piece in _pieces(data):
        line_end = piece.find(b"\n") + 1
        pieces += [piece[:line_end] + escape.encode() + (b"\r\n" if random.random() < 0.5 else b"") + piece[line_end:]]
    return pieces, f"{escape!r} in between"


def _foreign(random: Random, data: bytes) -> tuple[Script, str]:
    others = [
        stream_of(random.choice((*FRAMED, *LINES)), 100),
        random.randbytes(4000),
        bytes(4000),
        b"\xff" * 4000,
        b"\x55" * 4000,
    ]
    pieces: list[bytes | None] = [*_pieces(data)]
    other = _pieces(random.choice(others))
    at = random.choice((0, 30, 60))
    return [*pieces[:at], *other[:40], *pieces[at:]], f"another instrument or garbage from piece {at}"


def _frozen(random: Random, data: bytes) -> tuple[Script, str]:
    pieces = _pieces(data)
    at = random.choice((0, 1, 20, 50))
    if random.random() < 0.5:
        return [*pieces[:at], *[b""] * 200], f"silent from piece {at}"
    return [*pieces[:at], *[pieces[at]] * 200], f"the same again and again from piece {at}"


def _flood(random: Random, data: bytes) -> tuple[Script, str]:
    times = random.choice((50, 400))
    return [data * times] * 20, f"{times} times at once"


def _cut(random: Random, data: bytes) -> tuple[Script, str]:
    if random.random() < 0.5:
        what, damaged = "", data
        for _ in range(20):
            what, damaged = hostile_bytes(random, damaged) if len(damaged) > 1000 else (what, data)
        return [*_pieces(damaged)] if damaged else [b""], f"damaged, {what}"
    return [piece[: random.randrange(len(piece) + 1)] for piece in _pieces(data)], "cut in each piece"


def _numbers(random: Random, data: bytes) -> tuple[Script, str]:
    value = random.choice((*NUMBERS, "1" * 100_000, "-" * 100, "0x10", "1_0")).encode()
    lines = data.split(b"\n")
    if len(lines) < 50 or b"," not in lines[1]:
        # A frame of bytes: its head, and the largest numbers behind it.
        return [data[:8] + random.choice((b"\xff", b"\x7f", b"\x80")) * 60] * 100 + _pieces(
            data
        ), "frames of the largest numbers"
    field = random.randrange(len(lines[1].split(b",")))
    changed = []
    for line in lines:
        fields = line.split(b",")
        if len(fields) > field and random.random() < 0.5:
            fields[field] = value
        changed.append(b",".join(fields))
    return [*_pieces(b"\n".join(changed))], f"{value[:20]!r} as field {field + 1}"


def _endless(random: Random, data: bytes) -> tuple[Script, str]:
    piece = random.choice((b"1", b"1,", b"$", b"\xfa\xff", data[:4] + b"\xff\xff", b"$VNIMU,"))
    return [piece * (MEBIBYTE // len(piece) // 4)] * 16 + [*_pieces(data)], f"4 MiB of {piece!r}"


def _clock(random: Random, data: bytes) -> tuple[Script, str]:
    pieces = _pieces(data)
    ways = {
        "backwards": pieces[::-1],
        "from the start again and again": pieces[:10] * 10,
        "shuffled": random.sample(pieces, len(pieces)),
        "every tenth piece": pieces[::10] * 3,
    }
    way = random.choice([*ways])
    return [*ways[way]], f"its clock goes {way}"


def _unplugged(random: Random, data: bytes) -> tuple[Script, str]:
    at = random.choice((0, 1, 10, 40))
    return [*_pieces(data)[:at], HANG_UP], f"hangs up at piece {at}"


def _answer(random: Random, driver: str) -> tuple[Answer, str]:
    escape = random.choice(ESCAPES)
    way = random.choice(("identity", "identity", "echo", "escape", "long", "damaged"))
    if way == "echo":
        return lambda data: data, "echoes"
    if way == "escape":
        return lambda data: escape.encode() + b"\r\n", f"answers {escape!r}"
    if way == "long":
        return lambda data: b"$VNRRG,01," + b"9" * 300_000 + b"\r\n", "answers without an end"
    if driver.startswith("vectornav") and way == "identity":
        texts = {
            b"01": f"VN-100{escape}",
            b"03": f"01{escape}",
            b"04": f"2.1{escape}",
            b"05": random.choice(NUMBERS),
            b"07": random.choice(NUMBERS),
        }

        def tell(data: bytes) -> bytes:
            return b"".join(
                sentence(f"VNRRG,{each[:2].decode()},{texts[each[:2]]}")
                for each in data.split(b"VNRRG,")[1:]
                if each[:2] in texts
            )

        return tell, f"a model and number with {escape!r}"
    script, wire = SCRIPTS.get(driver), choose_wire(Emulation(device=driver))
    if script is None or wire.form is None:
        return lambda data: escape.encode() * 10, f"answers {escape!r}"
    instrument = script(wire.rate_hz, wire.form)

    def damage(data: bytes) -> bytes:
        answer = instrument.receive(data)
        return hostile_bytes(random, answer)[1] if answer else b""

    return damage, "damaged answers"


SLCAN_LINES = (
    *(
        b"t174",
        b"t1749",
        b"tZZZ80000000000000000",
        b"T1FFFFFFFF8" + b"00" * 8,
        b"t174F" + b"00" * 64,
        b"d174F" + b"00" * 64,
        b"r1748",
        b"\a" * 50,
    ),
    *(
        b"t1748" + b"0" * 100_000,
        b"V\x1b]0;pwn\x07",
        b"z" * 1000,
        b"t-748" + b"00" * 8,
        b"t1748GGGGGGGGGGGGGGGG",
        b"\xff\xfe\x80",
        b"t 1748",
        b"T" + b"9" * 5000,
    ),
)


def _can_link(random: Random, kind: str, driver: str) -> HostileLink:
    frames = list(frames_of(driver, 200))
    way = random.choice(("bytes", "bytes", "foreign", "frozen", "flood", "clock", "random", "unplugged"))
    if way == "foreign":
        frames[50:] = frames_of(random.choice(CAN), 200)
    elif way == "frozen":
        frames = frames[:3] * 100
    elif way == "clock":
        random.shuffle(frames)
    elif way == "random":
        frames = [
            Frame(
                random.randrange(1 << 11) if random.random() < 0.5 else random.randrange(1 << 29) | 1 << 31,
                random.randbytes(random.randrange(9)),
            )
            for _ in range(600)
        ]
    pack = _slcan if kind == "slcan" else _datagram
    pieces: list[bytes | None] = [pack(frame) for frame in frames]
    if way == "flood":
        pieces = pieces * 40
    if kind == "slcan":
        lines = [b"".join(pieces[at : at + 5]) for at in range(0, len(pieces), 5)]  # type: ignore[arg-type]
        script: list[bytes | None] = [
            line + (random.choice(SLCAN_LINES) + b"\r" if way == "bytes" else b"") for line in lines[:300]
        ]
    else:
        script = pieces[:20_000]
        if way == "bytes":
            for at in range(0, len(script), 3):
                script[at] = _hostile_datagram(random, script[at] or b"")
    if way == "unplugged":
        script = [*script[:20], HANG_UP]
    command, interrupt_s = _command(random, driver, asked=False, address="--bus")
    return HostileLink(
        name=f"{driver} on {kind}: {way}",
        wire="pty-slcan" if kind == "slcan" else "udp",
        command=command,
        script=tuple(script),
        answer=(lambda data: b"\r" * data.count(b"\r")) if kind == "slcan" else _nothing,
        interrupt_after_s=interrupt_s,
    )


def _slcan(frame: Frame) -> bytes:
    return format_frame(frame).encode()


def _datagram(frame: Frame) -> bytes:
    import can
    from can.interfaces.udp_multicast.utils import pack_message

    extended = bool(frame.can_id & 1 << 31)
    message = can.Message(0.0, frame.can_id & 0x1FFFFFFF, is_extended_id=extended, data=frame.data)
    return bytes(pack_message(message))


def _hostile_datagram(random: Random, sound: bytes) -> bytes:
    import msgpack  # type: ignore[import-untyped]

    table: dict[str, object] = {
        "timestamp": 0.0,
        "arbitration_id": 372,
        "is_extended_id": False,
        "is_remote_frame": False,
        "is_error_frame": False,
    }
    table |= {
        "channel": None,
        "dlc": 8,
        "data": b"\0" * 8,
        "is_fd": False,
        "bitrate_switch": False,
        "error_state_indicator": False,
    }
    key = random.choice([*table])
    value: object = random.choice(
        (None, -1, 1 << 62, 1e300, float("nan"), float("inf"), "\x1b]0;pwn\x07", b"\0" * 5000, [], {}, True, [1] * 999)
    )
    ways = (
        lambda: msgpack.packb({**table, key: value}),
        lambda: msgpack.packb({**table, key: value}),
        lambda: msgpack.packb({name: each for name, each in table.items() if name != key}),
        lambda: msgpack.packb({**table, "\x1b[2J": 1}),
        lambda: b"\xdd\xff\xff\xff\xff" + sound,
        lambda: b"\x91" * 3000,
        lambda: random.randbytes(60),
        lambda: sound[: random.randrange(len(sound))],
        lambda: b"",
        lambda: msgpack.packb(random.choice((1, "x", [], None, 1e300))),
    )
    return random.choice(ways)()


class Peer(threading.Thread):
    """The other end of a link: sends its script a piece each 20 ms, answers, and stays until it is closed."""

    def __init__(self, link: HostileLink) -> None:
        super().__init__(daemon=True)
        self._link = link
        self._closed = threading.Event()
        self._files: list[int] = []
        self._udp: socket.socket | None = None
        self._server: socket.socket | None = None
        if link.wire == "udp":
            self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._udp.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
                free.bind(("", 0))
                self._port = free.getsockname()[1]
            self.address = f"udp_multicast:{GROUP}:{self._port}"
        elif link.wire == "tcp":
            self._server = socket.create_server(("127.0.0.1", 0))
            self._server.settimeout(0.1)
            self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        else:
            self._files = [*pty.openpty()]
            tty.setraw(self._files[1])
            os.set_blocking(self._files[0], False)
            self.address = ("slcan:" if link.wire == "pty-slcan" else "") + os.ttyname(self._files[1])

    def run(self) -> None:
        with contextlib.suppress(OSError):
            if self._udp is not None:
                self._play(partial(self._tell, self._udp), lambda: b"")
            elif self._server is not None:
                while not self._closed.is_set():
                    with contextlib.suppress(TimeoutError):
                        connection, _ = self._server.accept()
                        with connection, contextlib.suppress(ConnectionError):
                            connection.setblocking(False)
                            self._play(partial(self._send, connection.fileno()), partial(self._receive, connection.fileno()))
            else:
                self._play(partial(self._send, self._files[0]), partial(self._receive, self._files[0]))

    def _play(self, send: Callable[[bytes], object], receive: Callable[[], bytes]) -> None:
        while not self._closed.is_set():
            for piece in self._link.script:
                asked = receive()
                answer = self._link.answer(asked) if asked else b""
                if piece is HANG_UP:
                    # The number of a port that is gone is given to the next one: the command's own terminal, before it starts.
                    self._closed.wait(1.0)
                    self._hang_up()
                    return
                if answer:
                    send(answer)
                # Nothing is sent as nothing, but for a datagram.
                if piece or self._udp is not None:
                    send(piece)
                if self._closed.wait(PIECE_S):
                    return

    def _tell(self, group: socket.socket, data: bytes) -> None:
        group.sendto(data[:60_000], (GROUP, self._port))

    def _send(self, file: int, data: bytes) -> None:
        """Write what is taken within a second; what nobody reads is lost, as on a serial line."""
        until = time.monotonic() + 1.0
        while data and time.monotonic() < until and not self._closed.is_set():
            if select.select([], [file], [], 0.05)[1]:
                with contextlib.suppress(BlockingIOError):
                    data = data[os.write(file, data[:65536]) :]

    def _receive(self, file: int) -> bytes:
        if not select.select([file], [], [], 0)[0]:
            return b""
        with contextlib.suppress(BlockingIOError):
            return os.read(file, 4096)
        return b""

    def _hang_up(self) -> None:
        while self._files:
            os.close(self._files.pop())

    def close(self) -> None:
        self._closed.set()
        if self.is_alive():
            self.join(5)
        self._hang_up()
        for each in (self._udp, self._server):
            if each is not None:
                each.close()
