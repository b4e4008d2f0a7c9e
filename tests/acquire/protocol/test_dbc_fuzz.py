"""Any text as a DBC file: signals that can be read from frames, or one sentence."""

from __future__ import annotations

import os
import random
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.protocol.can_dbc import DbcFile
from imufield.acquire.protocol.can_protocol import dbc_table
from imufield.acquire.protocol.protocol import parse_protocol
from imufield.errors import ImufieldError, ProtocolError, Reason
from tests.refused import refused

FUZZ_S = float(os.environ.get("IMUFIELD_FUZZ_S", "1"))
"""Of processor time."""

PROTOCOLS = Path(__file__).parents[3] / "protocols"
WHOLE = [(PROTOCOLS / f"{path.stem}.toml", path) for path in sorted(PROTOCOLS.glob("*.dbc"))]
NUMBERS = (
    "0",
    "1",
    "-1",
    "7",
    "63",
    "64",
    "65",
    "255",
    "1e400",
    "-1e400",
    "5e-324",
    "1e308",
    "nan",
    "9" * 25,
    "9" * 400,
    "9" * 5000,
)
PIECES = (
    *NUMBERS,
    *(
        "BO_ ",
        "SG_ ",
        "VAL_ ",
        "SG_MUL_VAL_ ",
        "SIG_VALTYPE_ ",
        "BA_ ",
        "CM_ ",
        "BU_: A\n",
        "m0 ",
        "M ",
        "m0M ",
        ": ",
        "|",
        "@1+ ",
        "@0- ",
    ),
    *(
        "(1,0) ",
        "(0,0) ",
        "[0|0] ",
        '"',
        '"g" ',
        "//",
        "/*",
        "*/",
        ";\n",
        "\n",
        "\x00",
        "\x1b[2J",
        "\u00e9",
        "\r\n",
        "VECTOR__INDEPENDENT_SIG_MSG",
    ),
)


def damaged(generator: random.Random, text: str) -> str:
    """Return a DBC file with some numbers replaced and some places cut, doubled or written over."""
    for _ in range(generator.randint(1, 5)):
        at = generator.randrange(len(text) + 1)
        if generator.random() < 0.5:
            # A number in the place of another is what a parser lets through.
            while at < len(text) and not text[at].isdigit():
                at += 1
            end = at
            while end < len(text) and text[end] in "0123456789.":
                end += 1
            text = text[:at] + generator.choice(NUMBERS) + text[end:]
        else:
            piece = generator.choice(PIECES) * generator.choice((1, 1, 1, 30))
            text = text[:at] + piece + text[at + generator.choice((0, 0, 1, 20)) :]
    return text


def read_everything(dbc: DbcFile) -> None:
    """Read each signal of a file from frames of ones, zeros and random bits."""
    for message, signal in dbc.signals():
        rows = np.frombuffer(b"\x00" * 64 + b"\xff" * 64 + random.Random(1).randbytes(64), dtype=np.uint8).reshape(3, 64)
        for each in (signal, *(selector for selector, _ in message.selectors)):
            raw = each.raw(rows)
            each.gaps(raw)
        with np.errstate(over="ignore", invalid="ignore"):  # As where samples are decoded.
            assert len(raw * signal.factor + signal.offset) == 3
        dbc.describe(message.name, b"\xff" * 8)


def test_any_dbc_gives_signals_or_a_sentence() -> None:
    generator, begin = random.Random(14), time.process_time()
    while time.process_time() - begin < FUZZ_S:
        protocol, path = generator.choice(WHOLE)
        text = damaged(generator, path.read_text(encoding="utf-8"))
        # Anything else that comes up is a defect.
        with suppress(ProtocolError):
            read_everything(DbcFile(text, "a.dbc"))
        with suppress(ImufieldError):
            parse_protocol(protocol.read_text(encoding="utf-8") + dbc_table(text))


@pytest.mark.parametrize(
    ("signal", "key"),
    [
        ("8|65@1+ (1,0)", "bits"),
        ("0|16@0+ (0,0)", "factor"),
        ("8|16@1+ (5e-324,0)", "factor"),
        (f"8|16@1+ ({'9' * 400},0)", "factor"),
        ("8|16@1+ (1,1e308)", "factor"),
        ("9999|8@1+ (1,0)", "too_long"),
    ],
)
def test_a_signal_that_gives_no_number_is_refused(signal: str, key: str) -> None:
    dbc = DbcFile(f'VERSION ""\nBS_:\nBU_: A\nBO_ 100 Motion: 99999 A\n SG_ Rate : {signal} [0|0] "" A\n', "mine.dbc")
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "mine.dbc", "Motion.Rate", key=f"can_dbc.{key}"):
        dbc.find("Rate")
