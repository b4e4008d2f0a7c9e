"""What an attacker puts in place of a value, a line, a byte, a file: the same for the same random numbers."""

from __future__ import annotations

import gzip
import io
import os
import re
import zipfile
import zlib
from functools import cache
from pathlib import Path
from random import Random

SECRET = b"SECRETs@"
"""What stands, again and again, in files that no command was told of: text, and as a float64 a sound output (309.27)."""
SECRET_AS_TEXT = ("SECRETs@", "309.26692")
FORGED = "FORGED"
"""Begins a line of its own where a newline of an attacker got through."""
ESCAPES = (
    *("\x1b]0;pwn\x07", "\x1b[2J\x1b[H", "\x1bP$q\x1b\\", "\x1bc", "\x9b5n", "\x9d0;pwn\x9c", "\u202egnp.exe", "\u2066x"),
    *("a\x08\x08b", "\x07", f"\n{FORGED}", f"\r{FORGED}", "\x7f", "\x0eq", "\x1b[5mblink", f"\x85{FORGED}", f"\u2028{FORGED}"),
    *("\x1b]8;;http://evil.example\x1b\\click\x1b]8;;\x1b\\", "\x1b]52;c;cHduCg==\x07", "\x1b[?1049h", "\x00", "\u200f\u061c"),
)
NUMBERS = (
    *("1e308", "-1e308", "1e400", "5e-324", "nan", "inf", "-inf", "9" * 330, "9" * 400, "9" * 5000, "1e-300", "-1", "0", "0.0"),
    *("99999999999999999999", "2147483648", "9223372036854775807", "-9223372036854775808", "18446744073709551616", "1e16"),
)
FOREIGN_TEXT = (
    "ÄÖü漢字",
    "١٢٣",
    "0x7f",
    "1,5",
    "TRUE",
    "NULL",
    "${HOME}",
    "$(id)",
    "../outside/secret.txt",
    "/dev/zero",
    "{0}",
    "%s%n",
)
FIRST_BYTES = (
    b"\x89HDF\r\n\x1a\n",
    b"PK\x03\x04",
    b"\x1f\x8b\x08",
    b"PAR1",
    b"#ROSBAG V2.0\n",
    b"SQLite format 3\0",
    b"MDF     4.10",
    b"LOGG",
)
DEEP = 3000
MEBIBYTE = 1 << 20
BOMB_BYTES = 1600 * MEBIBYTE


def escaped(text: str) -> str:
    """Return a basic string of TOML that means this text."""
    return '"' + "".join(f"\\u{ord(each):04x}" if each < " " or each in '"\\\x7f\x85' else each for each in text) + '"'


def toml_values() -> tuple[str, ...]:
    """Return what is put in place of a value in TOML."""
    return (
        *NUMBERS,
        *map(escaped, (*ESCAPES, *FOREIGN_TEXT, "", "x" * 100_000)),
        *('""', "[]", "{}", "true", "[[[]]]", "[0]", "[0, -1]", "[nan, inf, 1e400]", "1979-05-27T07:32:00Z", "07:32:00"),
        *(
            "[" * DEEP + "]" * DEEP,
            "{a=" * DEEP + "1" + "}" * DEEP,
            "[" + "1," * 200_000 + "]",
            "0x" + "f" * 5000,
            "-" + "9" * 4400,
        ),
    )


def hostile_toml(random: Random, text: str) -> tuple[str, bytes]:
    """Return a TOML file with one thing wrong, and what it is."""
    lines = text.splitlines(keepends=True)
    keys = [
        number for number, line in enumerate(lines) if re.match(r"[\w\"']+ *= *[^\[\n]*$|[\w\"']+ *= *\[.*\]$", line.rstrip())
    ]
    way = random.choice(("value",) * 12 + ("key", "table", "twice", "gone") + ("whole",) * 4)
    if way == "whole":
        return hostile_text(random, text)
    if way == "table":
        made = random.choice(toml_structures())
        return f"more: {made[:30]!r}", (text + "\n" + made).encode("utf-8", "surrogatepass")
    at = random.choice(keys) if keys else 0
    name, _, value = lines[at].partition("=")
    if way == "value":
        new = random.choice(toml_values())
        lines[at] = f"{name}= {new}\n"
        what = f"{name.strip()} = {new[:40]!r} ({len(new)} characters)"
    elif way == "key":
        new = escaped(random.choice((*ESCAPES, *FOREIGN_TEXT)))
        lines[at] = f"{new} ={value}"
        what = f"key {new} in place of {name.strip()}"
    elif way == "twice":
        lines.insert(at, lines[at])
        what = f"{name.strip()} twice"
    else:
        del lines[at]
        what = f"without {name.strip()}"
    return what, "".join(lines).encode()


@cache
def toml_structures() -> tuple[str, ...]:
    """Return tables that nobody expects."""
    return (
        ".".join("a" * DEEP) + " = 1\n",
        "[" + ".".join("a" * DEEP) + "]\nb = 1\n",
        "".join(f"k{number} = 1\n" for number in range(50_000)),
        "".join(f"[[position]]\nname = 'p{number}'\n" for number in range(20_000)),
        "# " + "x" * (8 * MEBIBYTE) + "\n",
        'x = """' + "y" * (8 * MEBIBYTE) + '"""\n',
        "[[session]]\n[[link]]\n",
        *(f"[{escaped(escape)}]\nx = 1\n" for escape in ESCAPES),
        "x = 1e999999999\n",
        "x = " + "1" * 4301 + "\n",
        "x = 9999-99-99\n",
    )


def hostile_text(random: Random, text: str) -> tuple[str, bytes]:
    """Return a text file with one thing wrong, and what it is."""
    data = text.encode()
    at = random.randrange(len(data) + 1)
    escape, number = random.choice(ESCAPES), random.choice(NUMBERS)
    lines = text.splitlines(keepends=True)
    line = random.randrange(len(lines))
    fields = [*re.finditer(r"[^\s,;]+", lines[line])] or [*re.finditer(r".", "x")]
    field = random.choice(fields)

    def put(new: str) -> bytes:
        changed = lines[line][: field.start()] + new + lines[line][field.end() :]
        return "".join([*lines[:line], changed, *lines[line + 1 :]]).encode()

    ways = (
        lambda: ("empty", b""),
        lambda: (f"cut at byte {at}", data[:at]),
        lambda: (f"{escape!r} at byte {at}", data[:at] + escape.encode() + data[at:]),
        lambda: (f"{escape!r} in line {line + 1}", put(escape)),
        lambda: (f"{escape!r} in the first line", (lines[0].rstrip("\n") + escape + "\n" + "".join(lines[1:])).encode()),
        lambda: (f"{number[:20]} ({len(number)}) in line {line + 1}", put(number)),
        lambda: (f"{number[:20]} ({len(number)}) in line {line + 1}", put(number)),
        lambda: (f"foreign text in line {line + 1}", put(random.choice(FOREIGN_TEXT))),
        lambda: (f"200 random bytes at {at}", data[:at] + random.randbytes(200) + data[at:]),
        lambda: ("in UTF-16", text.encode("utf-16")),
        lambda: ("begins with a byte order mark and a NUL", b"\xef\xbb\xbf\0" + data),
        lambda: (f"{at} NULs in front", b"\0" * at + data),
        lambda: ("a line of 4 MiB", data + b"1" * (4 * MEBIBYTE) + b"\n" + data),
        lambda: ("a line of a million fields", data + b"1," * 1_000_000 + b"\n"),
        lambda: ("300,000 empty lines", data + b"\n" * 300_000),
        lambda: ("lines backwards", "".join(reversed(lines)).encode()),
        lambda: (f"line {line + 1} 2000 times", "".join([*lines[:line], lines[line] * 2000, *lines[line:]]).encode()),
        lambda: ("begins as something else", random.choice(FIRST_BYTES) + data),
        lambda: ("carriage returns only", data.replace(b"\n", b"\r")),
        lambda: ("an open quote", data[:at] + b'"' + data[at:]),
        lambda: (f"{DEEP} brackets", data[:at] + b"[" * DEEP + data[at:]),
    )
    return random.choice(ways)()


def hostile_bytes(random: Random, data: bytes) -> tuple[str, bytes]:
    """Return a binary file with one thing wrong, and what it is; the heads of files are hit more often than the rest."""
    size = len(data)
    at = random.choice((random.randrange(size), random.randrange(min(size, 400)), size - 1 - random.randrange(min(size, 300))))
    width = random.choice((1, 2, 4, 8))
    value = random.choice((b"\xff", b"\0", b"\x7f", b"\x80")) * width
    escape = random.choice(ESCAPES).encode()
    texts = [*re.finditer(rb"[A-Za-z_/]{4,}", data)]
    text = random.choice(texts) if texts else None

    def over(begin: int, new: bytes) -> bytes:
        return data[:begin] + new + data[begin + len(new) :]

    ways = (
        lambda: ("empty", b""),
        lambda: (f"cut at byte {at}", data[:at]),
        lambda: (f"{value!r} at byte {at}", over(at, value)),
        lambda: (f"{value!r} at byte {at}", over(at, value)),
        lambda: (f"{value!r} at byte {at}", over(at, value)),
        lambda: (f"bit {at % 8} of byte {at} turned", over(at, bytes([data[at] ^ 1 << at % 8]))),
        lambda: (f"64 random bytes at {at}", over(at, random.randbytes(64))),
        lambda: (f"a byte more at {at}", data[:at] + b"\x55" + data[at:]),
        lambda: (f"{width} bytes less at {at}", data[:at] + data[at + width :]),
        lambda: ("begins as something else", random.choice(FIRST_BYTES) + data),
        lambda: ("twice", data + data),
        lambda: (f"zeros from byte {at}", data[:at] + bytes(size - at)),
        lambda: (f"{escape!r} over a text", over(text.start(), escape[: len(text.group())]) if text else data),
        lambda: (f"{escape!r} over a text", over(text.start(), escape[: len(text.group())]) if text else data),
    )
    return random.choice(ways)()


@cache
def gzip_bomb(begin: bytes, line: bytes) -> bytes:
    """Return a packed text of 1.6 GB, of members that are alike."""
    member = gzip.compress(line * (10 * MEBIBYTE // len(line)), mtime=0)
    return gzip.compress(begin, mtime=0) + member * (BOMB_BYTES // (10 * MEBIBYTE))


@cache
def deflate_bomb() -> bytes:
    """Return 1.6 GB of zeros as a raw deflate stream, of pieces that are alike."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    piece = packer.compress(bytes(10 * MEBIBYTE)) + packer.flush(zlib.Z_FULL_FLUSH)
    return piece * (BOMB_BYTES // (10 * MEBIBYTE)) + zlib.compressobj(9, zlib.DEFLATED, -15).flush()


@cache
def zip_bomb(head: bytes) -> bytes:
    """Return an archive of one file that unpacks to 1.6 GB behind its head."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH) + deflate_bomb()
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(zipfile.ZipInfo("data.npy"), packed)
    size = len(packed)
    data = bytearray(content.getvalue())
    # As if the archive itself had packed it: method 8, and the size of what comes out.
    for signature, method_at in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        at = data.index(signature)
        data[at + method_at : at + method_at + 2] = b"\x08\0"
        data[at + method_at + 14 : at + method_at + 18] = (len(head) + BOMB_BYTES).to_bytes(4, "little")
    assert size < len(data)
    return bytes(data)


def plant_outside(outside: Path) -> None:
    """Make the folder that no command was told of: files with a secret in many formats, and one that must stay as it is."""
    outside.mkdir(parents=True)
    for name in ("secret.txt", "secret.csv", "secret.toml", "secret.dbc", "secret.mcap", "secret.db3", "secret.bin"):
        (outside / name).write_bytes(SECRET * 512)
    (outside / "victim.txt").write_bytes(b"as it was\n" * 100)
    (outside / "folder").mkdir()
    for path in (*outside.rglob("*"), outside):
        # Where the file system notes reading at all, it notes the first one behind the last change.
        os.utime(path, (1_500_000_000, 1_600_000_000))
