"""Hostile sessions, their parts and parameter files."""

from __future__ import annotations

import os
import re
import shutil
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random

from tests.torture.hostile_values import (
    DEEP,
    ESCAPES,
    MEBIBYTE,
    NUMBERS,
    escaped,
    hostile_bytes,
    hostile_toml,
)
from tests.torture.second_sound import OUTSIDE, PROJECT, SESSION, HostileFile, Make, Sound, in_session, write

SESSION_COMMANDS = (
    *(("export-data", SESSION, "-o", "o.csv"), ("replay", SESSION), ("solve", SESSION), ("solve", SESSION, "--json")),
    *(("report", SESSION), ("verify", f"{SESSION}/parameters.toml", SESSION), ("history", SESSION), ("noise", SESSION)),
    *(("apply", f"{SESSION}/parameters.toml", SESSION, "-o", "o.csv"), ("solve", SESSION, SESSION), ("history", ".")),
    *(("replay", SESSION, "--json"), ("export-data", SESSION, "--to", "hdf5", "-o", "o.h5"), ("export-data", SESSION)),
)
PARAMETER_COMMANDS = (
    *(("export", "p.toml", "--to", target, "-o", "o") for target in ("c", "px4", "vectornav", "kalibr", "matlab")),
    *(("apply", "p.toml", SESSION, "-o", "o.csv"), ("history", "."), ("history", ".", "--json"), ("verify", "p.toml", SESSION)),
    *(("report", SESSION, "--parameters", "p.toml"), ("solve", SESSION, "--preset", "p.toml"), ("export", "p.toml")),
    *(("history", ".", "--csv", "o.csv"), ("history", ".", "--plot", "o.svg"), ("report", SESSION, "--preset", "p.toml")),
)


def session_toml(sound: Sound, random: Random) -> HostileFile:
    """A session whose ``session.toml``, or the protocol in it, is hostile."""
    text = sound.session_text
    inner = re.search(r'(?m)^text = ("(?:[^"\\]|\\.)*")$', text)
    if inner is not None and random.random() < 0.2:
        import tomllib

        what, protocol = hostile_toml(random, tomllib.loads(f"x = {inner.group(1)}")["x"])
        data = text.replace(inner.group(1), escaped(protocol.decode("utf-8", "replace"))).encode()
        what = f"protocol, {what}"
    elif random.random() < 0.3:
        # What stands there for a live instrument to have said.
        told = "".join(f"{key} = {escaped(random.choice(ESCAPES))}\n" for key in ("serial_number", "firmware"))
        name = escaped(f"VN-100{random.choice(ESCAPES)}")
        data = text.replace('model = "stim300"\n', f"model = {name}\n").replace("\n[link]", f"{told}\n[link]").encode()
        what = f"model {name}"
    else:
        what, data = hostile_toml(random, text)
    return HostileFile(
        name=f"session.toml: {what}",
        command=random.choice(SESSION_COMMANDS),
        make=in_session(sound, write("session.toml", data)),
    )


def _replaced(name: str, put: Callable[[Path], object]) -> Make:
    def change(folder: Path) -> None:
        path = folder / name
        if path.is_file():
            path.rename(folder / "was")
        put(path)

    return change


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        here = os.open(path.parent, os.O_RDONLY)
        try:
            server.bind(f"/proc/self/fd/{here}/{path.name}")
        finally:
            os.close(here)


def session_folder(sound: Sound, random: Random) -> HostileFile:
    """A session in whose folder something is not what it should be: links, FIFOs, devices, odd names."""
    name = random.choice(
        (
            "session.toml",
            "part-001.mcap",
            "session.lock",
            "parameters.toml",
            "report.html",
            "calibration-record.html",
            "samples.csv",
            "part-002.mcap",
            "verification.toml",
            "verify.toml",
            "samples.csv.tmp",
            "parameters-1.toml",
        )
    )
    target = random.choice(("secret.txt", "secret.toml", "secret.mcap", "victim.txt"))
    puts: tuple[tuple[str, Callable[[Path], object]], ...] = (
        (f"a link to {target} outside", lambda path: path.symlink_to(Path("..") / OUTSIDE / target)),
        (f"a link to {target} outside", lambda path: path.symlink_to((path.parents[2] / "outside" / target).resolve())),
        ("a hard link to victim.txt outside", lambda path: path.hardlink_to(path.parents[2] / "outside" / "victim.txt")),
        ("a link to itself", lambda path: path.symlink_to(path.name)),
        ("a link to a folder outside", lambda path: path.symlink_to((path.parents[2] / "outside" / "folder").resolve())),
        ("a link to nowhere outside", lambda path: path.symlink_to(path.parents[2] / "outside" / "new.txt")),
        ("a link to /dev/zero", lambda path: path.symlink_to("/dev/zero")),
        ("a link to /proc/self/environ", lambda path: path.symlink_to("/proc/self/environ")),
        ("a FIFO", os.mkfifo),
        ("a FIFO", os.mkfifo),
        ("a socket", _socket),
        ("a folder", lambda path: path.mkdir()),
        ("empty", lambda path: path.write_bytes(b"")),
        ("as large as a disk", _sparse),
    )
    odd: tuple[tuple[str, Callable[[Path], object]], ...] = (
        ("beside it a folder that links to its parent", lambda folder: (folder / "loop").symlink_to("..")),
        ("beside it a file whose name is an escape", lambda folder: (folder / random_name).write_text("x")),
        (
            "beside it a part whose name is no UTF-8",
            lambda folder: Path(os.fsdecode(os.fsencode(folder) + b"/part-\xff.mcap")).touch(),
        ),
        ("beside it parameters whose name is no UTF-8", not_utf8),
        ("parameters below an escape", lambda folder: _below(folder, random_name)),
        ("200 folders deep", _deep),
    )
    random_name = random.choice([each for each in ESCAPES if "/" not in each and "\0" not in each]) + ".toml"
    if random.random() < 0.25:
        what, change = random.choice(odd)
        commands: tuple[tuple[str, ...], ...] = SESSION_COMMANDS
    else:
        what, put = random.choice(puts)
        what, change = f"{name} is {what}", _replaced(name, put)
        commands = SESSION_COMMANDS
        # Whatever writes a file of that name is more likely to be the one.
        writers = {
            "report.html": "report",
            "calibration-record.html": "report",
            "samples.csv": "export-data",
            "verification.toml": "verify",
        }
        writers |= {"parameters.toml": "solve", "parameters-1.toml": "solve", "session.lock": "solve"}
        commands += tuple(each for each in SESSION_COMMANDS if each[0] == writers.get(name)) * 6
    return HostileFile(name=f"session folder: {what}", command=random.choice(commands), make=in_session(sound, change))


def not_utf8(folder: Path) -> None:
    shutil.copy(folder / "parameters.toml", os.fsdecode(os.fsencode(folder) + b"/\xffparameters.toml"))


def _below(folder: Path, name: str) -> None:
    (folder / name).mkdir()
    shutil.copy(folder / "parameters.toml", folder / name / "parameters.toml")


def _deep(folder: Path) -> None:
    here = os.open(folder, os.O_RDONLY)
    for _ in range(200):
        os.mkdir("d" * 100, dir_fd=here)
        below = os.open("d" * 100, os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = below
    with os.fdopen(os.open("parameters.toml", os.O_CREAT | os.O_WRONLY, dir_fd=here), "wb") as file:
        file.write(b"x")
    os.close(here)


def session_part(sound: Sound, random: Random) -> HostileFile:
    """A session whose part is damaged, a bomb, or from a host whose clock is wrong."""
    data = (PROJECT / "fixtures" / "stim300-six-faces" / "part-001.mcap").read_bytes()
    way = random.choice(("bytes",) * 4 + ("told",) * 3 + ("clock", "clock", "bomb", "foreign"))
    if way == "bytes":
        what, damaged = hostile_bytes(random, data)
        change: Make = write("part-001.mcap", damaged)
    elif way == "told":
        what, damaged = _told(random, data)
        change = write("part-001.mcap", damaged)
    elif way == "bomb":
        what, change = (
            "a chunk that unpacks to 1.6 GB",
            write("part-001.mcap", _zstd_bomb(data, random.choice((1 << 20, 64 << 20, 1 << 31, 1 << 62)))),
        )
    else:
        clock = random.choice(("backwards", "frozen", "beyond", "not a number", "before 1970", "random"))
        what = f"clock {clock}" if way == "clock" else "foreign bytes between"
        seed = random.random()
        change = lambda folder: _rewrite(folder, clock if way == "clock" else "sound", Random(seed), way == "foreign")  # noqa: E731
    return HostileFile(name=f"part: {what}", command=random.choice(SESSION_COMMANDS), make=in_session(sound, change))


def _zstd_bomb(part: bytes, told: int) -> bytes:
    """Return a part with one more chunk: 64 MiB of zeros again and again, which says of itself that it holds ``told``."""
    import zstandard

    packed = zstandard.ZstdCompressor(level=1).compress(bytes(64 * MEBIBYTE)) * 25
    content = struct.pack("<QQQII4sQ", 0, 0, told, 0, 4, b"zstd", len(packed)) + packed
    chunk = struct.pack("<BQ", 6, len(content)) + content
    first = part.index(b"\x04\0\0\0zstd") - 28 - 9
    return part[:first] + chunk + part[first:]


def _told(random: Random, part: bytes) -> tuple[str, bytes]:
    """Return a part whose metadata or events say something hostile; its checksums are right."""
    import zlib

    from mcap.data_stream import RecordBuilder
    from mcap.records import Metadata

    from imufield.acquire.recording.mcap_format import MESSAGE, chunk_record

    first = part.index(b"\x04\0\0\0zstd") - 28 - 9
    # The metadata record is the last one before the chunks, and its text the longest in it.
    begin = part.rindex(b"\x0c", 0, part.index(b"imufield-recording") - 20)
    value = random.choice(
        (
            *NUMBERS,
            "NaN",
            "Infinity",
            "[" * 100_000 + "]" * 100_000,
            '{"a":' * DEEP + "1" + "}" * DEEP,
            "null",
            *map(escaped, ESCAPES),
        )
    )
    if random.random() < 0.5:
        text = part[part.index(b"{", begin) : part.rindex(b"}", begin, first) + 1].decode("utf-8", "replace")
        values = [*re.finditer(r'(?<=":)\s*("[^"\\]*"|-?[\d.]+|\{|\[)', text)]
        place = random.choice(values)
        text = text[: place.start()] + value + text[place.end() :]
        builder = RecordBuilder()
        told = {"format": "imufield-recording", "version": "1", "json": text, "crc32": str(zlib.crc32(text.encode()))}
        Metadata(name="imufield", metadata=told).write(builder)
        made: bytes = builder.end()  # type: ignore[no-untyped-call]  # the mcap package leaves it out here alone
        what = f"metadata: {value[:30]} ({len(value)} characters) as byte {place.start()}"
        return what, part[:begin] + made + part[first:]
    kind, name = random.choice(("accepted", "mark", "fault", "position")), escaped(random.choice(ESCAPES))
    event = f'{{"event": "{kind}", "time_s": {value}, "name": {name}}}'.encode()
    message = MESSAGE.pack(5, MESSAGE.size - 9 + len(event), 2, 0, 0, 0) + event
    return f"event {event[:60]!r}", part[:first] + chunk_record([message] * 50) + part[first:]


def _rewrite(folder: Path, clock: str, random: Random, foreign: bool) -> None:
    """Record the session again, with other times or with foreign bytes between."""
    from imufield.acquire.link.serial import Chunk
    from imufield.acquire.recording.recorder import Recorder, part_metadata
    from imufield.acquire.registry import load_driver
    from tests.torture.second_links import stream_of

    (folder / "part-001.mcap").unlink()
    data, pieces = stream_of("stim300", 1500), 300
    protocol = load_driver("stim300").load_protocol({"rate_hz": 125.0})
    times: dict[str, Callable[[int], tuple[float, int]]] = {
        "sound": lambda number: (number * 0.04, 10**18 + number * 40_000_000),
        "backwards": lambda number: (-number * 0.04, 10**18 - number * 40_000_000),
        "frozen": lambda number: (5.0, 10**18),
        "beyond": lambda number: (1e300 * number, 2**64 - 1),
        "not a number": lambda number: (random.choice((float("nan"), float("inf"), -float("inf"))), 0),
        "before 1970": lambda number: (number * 0.04, -(10**18)),
        "random": lambda number: (random.uniform(-1e9, 1e9), random.randrange(2**64)),
    }
    size = len(data) // pieces
    path = folder / "part-001.mcap"
    with Recorder(path, part_metadata(protocol, {})) as recorder:
        for number in range(pieces):
            piece = data[number * size : (number + 1) * size]
            if foreign and number % 7 == 3:
                piece = random.choice(
                    (random.randbytes(size), ESCAPES[number % len(ESCAPES)].encode() * 20, stream_of("witmotion", 20))
                )
            recorder.write_chunk(Chunk(piece, *times[clock](number)))


def parameters(sound: Sound, random: Random) -> HostileFile:
    """A hostile parameter file."""
    what, data = hostile_toml(random, sound.parameters_text)
    if random.random() < 0.1:
        what, put = random.choice(
            (
                ("a FIFO", os.mkfifo),
                ("a link to /dev/zero", lambda path: path.symlink_to("/dev/zero")),
                ("a link to itself", lambda path: path.symlink_to("p.toml")),
                ("a folder", lambda path: path.mkdir()),
            )
        )
    else:
        put = lambda path: path.write_bytes(data)  # noqa: E731

    def make(folder: Path) -> None:
        shutil.copytree(sound.session, folder / SESSION)
        put(folder / "p.toml")

    return HostileFile(name=f"parameters: {what}", command=random.choice(PARAMETER_COMMANDS), make=make)
