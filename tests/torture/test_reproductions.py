"""What was once tried by hand and did harm, again: one sentence, at most 10 s of processor time and 500 MiB each."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from tests.torture.conftest import FULL, Campaign
from tests.torture.hostile_values import gzip_bomb, zip_bomb
from tests.torture.second_can import DBC, dbc_cycle
from tests.torture.second_checks import meet_file
from tests.torture.second_formats import h5_external, h5_virtual, npy_head
from tests.torture.second_links import stream_of
from tests.torture.second_sessions import not_utf8
from tests.torture.second_sound import AXES, OUTSIDE, PROJECT, SESSION, HostileFile, Make, Sound, in_session, write

EVERY = 1 if FULL else 5
SOLVE = ("solve", SESSION)
IMPORT_CAN = ("import", "t.log", "--dbc", "t.dbc", "-o", "o", "--map", "accelerometer.x=AccX")
HEADLINE = ",".join(("time", *AXES)).encode() + b"\n"


def reproductions(sound: Sound) -> Iterator[HostileFile]:
    """Yield what the first attack on the program found, in its order."""
    yield from doors(sound)
    yield from endless(sound)
    yield from bombs()
    yield from numbers(sound)
    yield from names(sound)


def doors(sound: Sound) -> Iterator[HostileFile]:
    """Escapes for the terminal, and files that lead to other files."""
    escape = 'model = "VN-100\\u001b]0;pwn\\u0007\\u001b[2J\\nimufield: forged"'
    escaped = re.sub(r'(?m)^model = ".*"', lambda _: escape, sound.session_text)
    for command in (SOLVE, ("sessions",), ("history", "."), ("report", SESSION)):
        yield hostile("a model with escapes", command, in_session(sound, write("session.toml", escaped.encode())))
    yield hostile("HDF5, external storage", ("import", "t.h5", "-o", "o"), h5_external)
    yield hostile("HDF5, a virtual dataset", ("import", "t.h5", "-o", "o"), h5_virtual)
    victim = Path("..") / OUTSIDE / "victim.txt"
    for command in (SOLVE, ("report", SESSION)):
        yield hostile(
            "a lock that is a link", command, in_session(sound, lambda folder: relinked(folder / "session.lock", victim))
        )


def endless(sound: Sound) -> Iterator[HostileFile]:
    """What once never ended: circles, and pipes that nobody writes to."""
    many = DBC + "".join(f'BO_ {1000 + each} N{each}: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n' for each in range(40_000))
    for what, text in (("in a circle", dbc_cycle(2)), ("of 40,000 messages", many)):
        yield hostile(f"DBC {what}", IMPORT_CAN, both(write("t.dbc", text.encode()), write("t.log", sound.can_log(".log"))))
    blf = sound.can_log(".blf")
    at = blf.index(b"LOBJ", 144)
    yield hostile(
        "BLF, an object of size 0", ("import", "t.blf", "-o", "o"), write("t.blf", blf[: at + 8] + bytes(4) + blf[at + 12 :])
    )
    for name in ("session.toml", "parameters.toml"):
        for command in (SOLVE, ("export", f"{SESSION}/parameters.toml", "--to", "c", "-o", "x.h"), ("history", ".")):
            yield hostile(f"{name} is a pipe", command, in_session(sound, partial(pipe_in, name)))


def bombs() -> Iterator[HostileFile]:
    """A small file of which 1.6 GB come."""
    packed = (("t.csv.gz", gzip_bomb(HEADLINE, b"0.1,1,2,3,4,5,6\n")), ("t.npz", zip_bomb(npy_head("(200000000,)"))))
    for name, data in packed:
        yield hostile(f"{name} of 1.6 GB", ("import", name, "-o", "o"), write(name, data))


def numbers(sound: Sound) -> Iterator[HostileFile]:
    """Numbers that no arithmetic survives."""
    text = sound.session_text
    for what, value in (
        ("an integer of 330 digits", "9" * 330),
        ("an integer of 5000 digits", "9" * 5000),
        ("1e308", "1e308"),
        ("5e-324", "5e-324"),
        ("3000 nested arrays", "[" * 3000 + "]" * 3000),
    ):
        changed = re.sub(r"(?m)^hold_s = .*", f"hold_s = {value}", text)
        yield hostile(f"hold_s: {what}", SOLVE, in_session(sound, write("session.toml", changed.encode())))
    rated = re.sub(r"(?m)^format = ", f"rate_hz = {'9' * 400}\nformat = ", text, count=1)
    yield hostile("rate_hz of 400 digits", SOLVE, in_session(sound, write("session.toml", rated.encode())))
    log = sound.can_log(".log")
    stamped = re.sub(rb"\(\d+\.\d+\)", b"(1e300)", log, count=3)
    long = log.replace(b"#", b"#" + b"00" * 60, 1)
    for what, data in (("a stamp of 1e300", stamped), ("65 data bytes", long)):
        yield hostile(f"candump, {what}", IMPORT_CAN, both(write("t.dbc", DBC.encode()), write("t.log", data)))
    traced = re.sub(rb"(?m)^;\$STARTTIME=.*", b";$STARTTIME=1e400", sound.can_log(".trc"))
    yield hostile("TRC that begins at 1e400", ("import", "t.trc", "-o", "o", "--driver", "aceinna_can"), write("t.trc", traced))
    protocol = (PROJECT / "protocols" / "stim300.toml").read_text()
    for old, new in (
        ("ticks_per_s = 2000", "ticks_per_s = 0"),
        ("steps = [1, 2, 4, 8, 16]", "steps = [0, -1]"),
        ("fraction_bits = 22", f"fraction_bits = {'9' * 5000}"),
        ("scale = { setting", "scale = 0\nwas = { setting"),
        ("gyroscope_range = 400", "gyroscope_range = 5e-324"),
    ):
        assert old in protocol, old
        make = both(write("p.toml", protocol.replace(old, new, 1).encode()), write("stream.bin", stream_of("stim300", 300)))
        yield hostile(f"protocol with {new[:40]}", ("import", "stream.bin", "--protocol", "p.toml", "-o", "o"), make)


def names(sound: Sound) -> Iterator[HostileFile]:
    """Names that are not UTF-8."""
    for command in (SOLVE, ("history", "."), ("history", SESSION)):
        yield hostile("a name that is not UTF-8", command, in_session(sound, not_utf8))


def hostile(name: str, command: tuple[str, ...], make: Make) -> HostileFile:
    return HostileFile(name=name, command=command, make=make)


def both(one: Make, other: Make) -> Make:
    return lambda folder: (one(folder), other(folder))


def relinked(path: Path, target: Path) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to(target)


def pipe_in(name: str, folder: Path) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    return Sound(tmp_path_factory.mktemp("sound"))


def test_reproductions(sound: Sound, tmp_path: Path, campaign: Campaign) -> None:
    findings: list[str] = []
    tried = list(reproductions(sound))[::EVERY]
    for number, each in enumerate(tried):
        found = meet_file(each, tmp_path / str(number), on_terminal=number % 2 == 0)
        findings += [f"{each.name} ({' '.join(each.command)}): {what}" for what in found]
    assert not findings, "\n".join(findings)
    campaign.tell(
        "what the first attack did harm with: escapes, links, circles, pipes, bombs, numbers, names",
        len(tried),
        "commands",
        "one sentence each, at most 10 s of processor time and 500 MiB, nothing read or written outside",
    )
