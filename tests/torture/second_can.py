"""Hostile logs of CAN buses and DBC files."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from random import Random

from tests.torture.hostile_values import (
    ESCAPES,
    NUMBERS,
    deflate_bomb,
    gzip_bomb,
    hostile_bytes,
    hostile_text,
)
from tests.torture.second_sound import HostileFile, Sound, write

CAN_VALUES = (
    *(
        b"(1e300) can0 174#0000",
        b"(nan) can0 174#00",
        b"(-5.0) can0 174#00",
        b"(1600000000.0) can0 174#" + b"00" * 65,
        b"(1.0) can0 174##1" + b"00" * 65,
    ),
    *(
        b"(1.0) \x1b]0;pwn\x07 174#00",
        b"(1.0) can0 FFFFFFFFFF#00",
        b"(1.0) can0 174#R999999999",
        b"(" + b"9" * 5000 + b".0) can0 174#00",
        b"(1.0) can0 -1#00",
    ),
    *(
        b";$STARTTIME=1e400",
        b";$STARTTIME=nan",
        b";$FILEVERSION=9" + b"9" * 5000,
        b";$COLUMNS=",
        b"date \x1b]0;pwn\x07",
        b"date Thu Jan 99 99:99:99 9999",
    ),
    *(
        b"base hex  timestamps \x1b[2J",
        b"1e300 1 174 Rx d 8 00 00 00 00 00 00 00 00",
        b"1.0 1 174 Rx d 99 00",
        b"1.0 CANFD 1 Rx 174 0 0 f 64" + b" 00" * 65,
    ),
    *(b"nan,0x174,0,0,0,8,AAAA", b"1.0,0x174,0,0,0,999999999999,AAAA", b"1.0,0xFFFFFFFFFFFF,1,0,0,8,!!!!"),
)


def can_log(sound: Sound, random: Random) -> HostileFile:
    """A hostile log of a CAN bus."""
    suffix = random.choice((".log", ".asc", ".blf", ".trc", ".csv") * 3 + (".mf4",))
    data = sound.can_log(suffix)
    if suffix == ".blf" and random.random() < 0.4:
        what, data = _hostile_blf(random, data)
    elif suffix in (".blf", ".mf4"):
        what, data = hostile_bytes(random, data)
    elif random.random() < 0.5:
        lines = data.splitlines(keepends=True)
        value = random.choice(CAN_VALUES)
        at = random.randrange(min(len(lines), 30))
        lines.insert(at, value + b"\n")
        what, data = f"{value[:60]!r} as line {at + 1}", b"".join(lines)
    else:
        what, data = hostile_text(random, data.decode())
    name = f"t{suffix}"
    if suffix == ".log" and random.random() < 0.1:
        what, name, data = "a bomb", "t.log.gz", gzip_bomb(data, b"(1600000000.000000) can0 174#0080000030750000\n")
    return HostileFile(
        name=f"CAN {name}: {what}", command=("import", name, "--driver", "bosch_mm510", "-o", "o"), make=write(name, data)
    )


def _hostile_blf(random: Random, data: bytes) -> tuple[str, bytes]:
    """Unpack the container of a BLF file and pack it again with other sizes of the objects in it."""
    import zlib

    head = int.from_bytes(data[4:8], "little")
    size = struct.unpack_from("<I", data, head + 8)[0]
    packed_at = head + 16 + 16
    inner = bytearray(zlib.decompress(data[packed_at : head + size]))
    places = [each.start() for each in re.finditer(b"LOBJ", bytes(inner))]
    at = random.choice(places[:20])
    offset, value = random.choice(
        (
            (4, 0),
            (4, 0xFFFF),
            (8, 0),
            (8, 1),
            (8, 16),
            (8, 2**32 - 1),
            (8, 33),
            (12, 0xFFFFFFFF),
            (12, 10),
            (24, 2**64 - 1),
            (24, 2**63),
            (16, 0),
        )
    )
    width = {4: "<H", 8: "<I", 12: "<I", 16: "<I", 24: "<Q"}[offset]
    struct.pack_into(width, inner, at + offset, value)
    packed = zlib.compress(bytes(inner))
    told = random.choice((len(inner), len(inner), 2**32 - 1, 0))
    body = struct.pack("<H6xI4x", 2, told) + packed
    if random.random() < 0.15:
        bomb = b"\x78\x01" + deflate_bomb()
        body, what = struct.pack("<H6xI4x", 2, 100) + bomb, "a bomb"
    else:
        what = f"object at {at}: {value} at {offset}, size {told}"
    made = data[:head] + struct.pack("<4sHHII", b"LOBJ", 16, 1, 16 + len(body), 10) + body
    return what, made + bytes(-len(made) % 4)


DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 372 One: 8 A
 SG_ Mode M : 0|8@1+ (1,0) [0|255] "" A
 SG_ AccX : 8|16@1- (0.001,0) [-30|30] "m/s2" A
 SG_ AccY : 24|16@1- (0.001,0) [-30|30] "m/s2" A
BO_ 376 Two: 8 A
 SG_ AccZ : 32|16@1- (0.001,0) [-30|30] "m/s2" A
CM_ "a bus";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
VAL_ 372 Mode 0 "off" 1 "on" ;
"""


def dbc_cycle(length: int) -> str:
    names = [f"M{number}" for number in range(length)]
    signals = "".join(f' SG_ {name} m0M : {8 * (number % 8)}|8@1+ (1,0) [0|255] "" A\n' for number, name in enumerate(names))
    chosen = "".join(f"SG_MUL_VAL_ 372 {name} {names[number - 1]} 0-0;\n" for number, name in enumerate(names))
    head = 'VERSION ""\nBU_: A\nBO_ 372 One: 8 A\n'
    return f'{head}{signals} SG_ AccX m0 : 8|16@1- (1,0) [0|0] "" A\nSG_MUL_VAL_ 372 AccX M0 0-0;\n{chosen}'


def dbc(sound: Sound, random: Random) -> HostileFile:
    """A hostile DBC file, and a log that it is to read."""
    escape = random.choice(ESCAPES)
    number = random.choice(NUMBERS)
    made = (
        ("multiplexed in a circle", dbc_cycle(random.choice((1, 2, 3, 8)))),
        ("multiplexed in a circle", dbc_cycle(random.choice((1, 2, 3, 8)))),
        (
            "40,000 messages",
            DBC + "".join(f'BO_ {1000 + each} N{each}: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n' for each in range(40_000)),
        ),
        (
            "20,000 signals",
            DBC.replace(
                " SG_ AccY",
                "".join(f' SG_ S{each} m{each} : 8|8@1+ (1,0) [0|0] "" A\n' for each in range(20_000)) + " SG_ AccY",
            ),
        ),
        (f"a factor of {number[:20]}", DBC.replace("(0.001,0)", f"({number},0)")),
        (f"an offset of {number[:20]}", DBC.replace("(0.001,0)", f"(1,{number})")),
        ("a signal of 2^31 bits", DBC.replace("8|16@1-", "8|2147483648@1-")),
        (f"a message of {number[:20]} bytes", DBC.replace("One: 8", f"One: {number}")),
        (f"an identifier of {number[:20]}", DBC.replace("BO_ 376", f"BO_ {number}")),
        (f"unit {escape!r}", DBC.replace('"m/s2"', f'"{escape}"')),
        (f"comment {escape!r}", DBC.replace("a bus", escape)),
        (f"name {escape!r}", DBC.replace("AccY", f"Acc{escape}")),
        (f"value {escape!r}", DBC.replace('"off"', f'"{escape}"')),
        ("floating values", DBC + "SIG_VALTYPE_ 372 AccX : 1;\nSIG_VALTYPE_ 376 AccZ : 2;\n"),
    )
    what, data = random.choice(made) if random.random() < 0.6 else hostile_text(random, DBC)
    content = data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass")
    chosen = ("accelerometer.x=AccX", "accelerometer.y=AccY", "accelerometer.z=AccZ")
    command = ("import", "t.log", "--dbc", "t.dbc", "-o", "o", *(word for each in chosen for word in ("--map", each)))

    def make(folder: Path) -> None:
        (folder / "t.log").write_bytes(sound.can_log(".log"))
        (folder / "t.dbc").write_bytes(content)

    return HostileFile(name=f"DBC: {what}", command=command[: random.choice((6, 12, 12))], make=make)
