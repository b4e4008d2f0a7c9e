"""2000 hostile files, made by somebody who had not seen the first corpus: the same ones each time.

``FILES`` lists them; each makes its file in a folder and names the command that is to meet it. What is sound and gets damaged
is made once, by the programs that make such files; what an attacker puts in is in ``hostile_values.py``.

"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np

from tests.torture.hostile_values import (
    ESCAPES,
    NUMBERS,
    escaped,
    gzip_bomb,
    hostile_bytes,
    hostile_text,
    hostile_toml,
    plant_outside,
)
from tests.torture.second_can import can_log, dbc
from tests.torture.second_formats import arrays, hdf5, matlab, parquet, ros
from tests.torture.second_sessions import parameters, session_folder, session_part, session_toml
from tests.torture.second_sound import AXES, OUTSIDE, PROJECT, SESSION, HostileFile, Make, Sound, write

PROTOCOLS = (
    "text",
    "witmotion",
    "stim300",
    "novatel_oem7_ascii",
    "vectornav_binary",
    "xsens_mtdata2",
    "kvh_17xx",
    "sbg_sbgecom",
)
PROTOCOL_NUMBERS = (
    "ticks_per_s",
    "modulus",
    "steps",
    "scale",
    "rate_hz",
    "fraction_bits",
    "count",
    "size",
    "at",
    "pad_to",
    "from",
)


def protocol(sound: Sound, random: Random) -> HostileFile:
    """A hostile protocol, and a stream that it is to read."""
    from tests.torture.second_links import stream_of

    name = random.choice(PROTOCOLS)
    text = (PROJECT / "protocols" / f"{name}.toml").read_text()
    places = [*re.finditer(rf"\b({'|'.join(PROTOCOL_NUMBERS)}) = (-?[\d.]+|\[[\d, ]*\])", text)]
    way = random.random()
    if way < 0.5 and places:
        place = random.choice(places)
        new = random.choice(
            (*NUMBERS, "[0, -1]", "[]", "-0.0", "1e-320", "10000000000", "[9223372036854775807]", '"\\u001b]0;pwn\\u0007"')
        )
        data = (text[: place.start(2)] + new + text[place.end(2) :]).encode()
        what = f"{place.group(1)} = {new[:30]} ({len(new)} characters)"
    elif way < 0.6:
        door = random.choice(
            ("../outside/secret.dbc", "/dev/zero", "p.toml", "/proc/self/environ", "\x1b]0;pwn\x07.dbc", "fifo.dbc")
        )
        bosch = (PROJECT / "protocols" / "bosch_mm510.toml").read_text()
        data, what = bosch.replace('"bosch_mm510.dbc"', escaped(door)).encode(), f"dbc = {door!r}"
    else:
        what, data = hostile_toml(random, text)
    command: tuple[str, ...] = ("import", "stream.bin", "--protocol", "p.toml", "-o", "o")
    # Devices and drivers meet it, too.
    if random.random() < 0.15:
        command = random.choice(
            (
                ("record", "--port", "nowhere", "--protocol", "p.toml", "--duration-s", "1"),
                ("emulate", "p.toml", "--duration-s", "1", "--speed", "50"),
            )
        )

    def make(folder: Path) -> None:
        (folder / "p.toml").write_bytes(data)
        (folder / "stream.bin").write_bytes(stream_of(name, 300))
        os.mkfifo(folder / "fifo.dbc")

    return HostileFile(name=f"protocol {name}: {what}", command=command, make=make)


CONFIGURATION = """port = "/dev/ttyUSB9"
driver = "stim300"
baud = 921600
positions = "paper24"
hold_s = 5.0
gravity = 9.81
latitude = 48.1
height = 520.0

[settings]
accelerometer_range_g = 30

[mapping]
"accelerometer.x" = "AccLong"
"""
CONFIGURED = (
    ("solve",),
    ("devices",),
    ("record", "--duration-s", "1"),
    ("capture", "--quiet"),
    ("history",),
    ("solve", SESSION),
)


def configuration(sound: Sound, random: Random) -> HostileFile:
    """A hostile ``imufield.toml`` in the working folder."""
    what, data = hostile_toml(random, CONFIGURATION)
    put: Make = write("imufield.toml", data)
    if random.random() < 0.15:
        what, link = random.choice(
            (("a FIFO", os.mkfifo), ("a link to secret.toml", lambda path: path.symlink_to(OUTSIDE / "secret.toml")))
        )
        put = lambda folder: link(folder / "imufield.toml")  # noqa: E731

    def make(folder: Path) -> None:
        shutil.copytree(sound.session, folder / SESSION)
        put(folder)

    return HostileFile(name=f"imufield.toml: {what}", command=random.choice(CONFIGURED), make=make)


POSITIONS = "".join(
    f'[[position]]\nname = "p{number}"\nup = [0.0, {number}.0, 1.0]\nwords = "side {number}"\n\n' for number in range(8)
)


def positions(sound: Sound, random: Random) -> HostileFile:
    """A hostile list of positions."""
    what, data = hostile_toml(random, 'name = "mine"\n' + POSITIONS)
    command = random.choice(
        (
            ("capture", "--positions", "q.toml", "--port", "nowhere", "--quiet"),
            ("emulate", "text", "--positions", "q.toml", "--duration-s", "1", "--speed", "50", "--hold-s", "1"),
        )
    )
    return HostileFile(name=f"positions: {what}", command=command, make=write("q.toml", data))


OBSERVATIONS = "ax,ay,az,sigma_ax,sigma_ay,sigma_az,name\n" + "".join(
    f"{','.join(f'{9.8 * value:.4f}' for value in row)},0.0004,0.0004,0.0005,side {number}\n"
    for number, row in enumerate(np.vstack([np.eye(3), -np.eye(3), np.eye(3) * 0.7 + 0.41]).tolist())
)


def observations(sound: Sound, random: Random) -> HostileFile:
    """Hostile means of positions."""
    what, data = hostile_text(random, OBSERVATIONS)
    put: Make = write("m.csv", data)
    if random.random() < 0.06:
        what, put = "a FIFO that nobody writes to", lambda folder: os.mkfifo(folder / "m.csv")
    return HostileFile(name=f"observations: {what}", command=("solve", "--observations", "m.csv", "-o", "o.toml"), make=put)


def table(sound: Sound, random: Random) -> HostileFile:
    """A hostile table of text, packed or not, with an odd name or not."""
    separator, suffix = random.choice(((",", ".csv"), ("\t", ".tsv"), (" ", ".txt"), (";", ".csv"), (",", ".csv.gz")))
    text = (
        separator.join(("time", *AXES))
        + "\n"
        + "".join(separator.join(f"{each:.6g}" for each in row) + "\n" for row in sound.rows[:200])
    )
    what, data = hostile_text(random, text)
    name = f"t{suffix}"
    if random.random() < 0.2:
        odd = random.choice([each for each in ESCAPES if "/" not in each and "\0" not in each])
        name, what, data = (
            random.choice(
                (f"a{odd}{suffix}", f"-rf{suffix}", "n" * 240 + suffix, f"\udcff\udcfe{suffix}", "p/" * 2040 + suffix)
            ),
            "an odd name",
            text.encode(),
        )
    if suffix.endswith(".gz"):
        import gzip

        data = gzip.compress(data, mtime=0)
        what, data = random.choice(
            (
                (what, data),
                hostile_bytes(random, data),
                ("1.6 GB", gzip_bomb(text.encode(), b"0.1,1,2,3,4,5,6\n")),
                ("1.6 GB in a line", gzip_bomb(text.encode(), b"1")),
            )
        )
    command: tuple[str, ...] = ("import", f"./{name}" if name.startswith("-") else name, "-o", "o")
    make: Make = write(name, data) if len(name) < 300 else write("t", data)
    if random.random() < 0.15:
        command = ("apply", f"{SESSION}/parameters.toml", command[1], "-o", "o.csv")
        make_table = make

        def make(folder: Path) -> None:
            shutil.copytree(sound.session, folder / SESSION)
            make_table(folder)

    elif random.random() < 0.05:
        what, make = (
            random.choice(
                (
                    ("a FIFO", lambda folder: os.mkfifo(folder / name)),
                    ("a link to itself", lambda folder: (folder / name).symlink_to(name)),
                )
            )
            if len(name) < 200
            else (what, make)
        )
    return HostileFile(name=f"table {suffix}: {name[:30]!r} {what}", command=command, make=make)


FAMILIES: tuple[tuple[int, Callable[[Sound, Random], HostileFile]], ...] = (
    *((200, session_toml), (160, session_folder), (160, session_part), (200, parameters), (200, protocol), (80, configuration)),
    *((80, positions), (100, observations), (170, table), (80, arrays), (80, matlab), (90, hdf5), (50, parquet), (100, ros)),
    *((150, can_log), (100, dbc)),
)
FILES = tuple((family, number) for count, family in FAMILIES for number in range(count))
assert len(FILES) == 2000


def hostile_file(sound: Sound, number: int) -> HostileFile:
    """Return file ``number`` of the corpus."""
    family, of_family = FILES[number]
    return family(sound, Random(f"{family.__name__} {of_family}"))


def show(number: int, folder: Path) -> None:
    """Make file ``number`` in ``folder/work``, and say the command that is to be run there."""
    plant_outside(folder / "outside")
    (folder / "sound").mkdir()
    (folder / "work").mkdir()
    hostile = hostile_file(Sound(folder / "sound"), number)
    hostile.make(folder / "work")
    sys.stdout.write(f"{hostile.name}\ncd {folder / 'work'} && {shlex.join(('imufield', *hostile.command))}\n")


if __name__ == "__main__":
    # python -m tests.torture.second_corpus NUMBER FOLDER
    show(int(sys.argv[1]), Path(sys.argv[2]))
