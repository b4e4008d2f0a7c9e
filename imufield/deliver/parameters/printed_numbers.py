"""Numbers for people: a value with its uncertainty in digits that mean something, and units of the trade.

In the parameter file itself every number has all its digits: ``write``.
"""

from __future__ import annotations

import math
import re
import shutil
import textwrap
from typing import TextIO

from imufield.drawing.printed_lines import columns
from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2
from imufield.sentences import printable

ARC_MINUTE_RAD = math.pi / (180 * 60)
DEG_PER_HOUR_RAD_S = math.pi / 180 / 3600
MOST_DECIMALS = 9  # Beyond, a number does not fit its column; with_sigma_within takes a power of ten out.
WIDTH = 80
"""Columns where the width is not known: a pipe, a log file."""


def decimals(sigma: float, digits: int = 2) -> int:
    """Return how many decimals show ``digits`` significant digits of ``sigma``; negative for tens and hundreds."""
    if not sigma > 0 or not math.isfinite(sigma):
        return 0
    # The exponent of the rounded number: 0.0996 to two digits is 0.10.
    exponent = int(f"{sigma:.{digits - 1}e}".partition("e")[2])
    return min(digits - 1 - exponent, MOST_DECIMALS)


def rounded(value: float, sigma: float, *, sign: bool = False, digits: int = 2) -> str:
    """Return a value to as many decimals as show ``digits`` significant digits of ``sigma``."""
    places = decimals(sigma, digits)
    # Adding zero takes the sign off a value that rounds to nothing.
    return f"{round(value, places) + 0.0:{'+' if sign else ''}.{max(places, 0)}f}"


def with_sigma(value: float, sigma: float, *, sign: bool = False, digits: int = 2) -> str:
    """Return "1.234 ± 0.056"; "fixed" where the gauge leaves no uncertainty, "± ?" where none is known."""
    plus = "+" if sign else ""
    if math.isnan(sigma):
        return f"{value:{plus}.5g} ± ?" if value else "not estimated"
    if sigma == 0:
        return f"{value:{plus}.5g} fixed" if value else "0 fixed"
    return f"{rounded(value, sigma, sign=sign, digits=digits)} ± {rounded(sigma, sigma, digits=digits)}"


def with_sigma_within(width: int, value: float, sigma: float, *, sign: bool = False) -> str:
    """Return ``with_sigma`` in at most ``width`` characters where there is a way: fewer digits, a power of ten taken out."""
    texts = [with_sigma(value, sigma, sign=sign, digits=digits) for digits in (2, 1)]
    largest = max(abs(value), sigma)
    if 0 < largest < math.inf:
        exponent = 3 * math.floor(math.log10(largest) / 3)
        size = 10.0**exponent
        texts += [f"({with_sigma(value / size, sigma / size, sign=sign, digits=digits)})e{exponent}" for digits in (2, 1)]
    return next((text for text in texts if len(text) <= width), min(texts, key=len))


def line_width() -> int:
    """Return the columns of the terminal, 80 at most; 80 where there is none."""
    return min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)


def hanging(start: str, sentence: str) -> str:
    """Return a sentence in lines of ``line_width`` behind ``start``, words whole, the lines below it indented as far."""
    return textwrap.fill(
        start + sentence, line_width(), subsequent_indent=" " * len(start), break_long_words=False, break_on_hyphens=False
    )


def beside(words: str, path: object, indent: int = 0) -> str:
    """Return words and a path, the path on a line of its own where both are too long for one: broken it cannot be copied."""
    shown = printable(str(path))
    line = f"{words} {shown}"
    return line if columns(line) <= line_width() else f"{words.rstrip()}\n{' ' * indent}{shown}"


def bar(share: float, width: int) -> str:
    """Return a bar of ``share`` of ``width`` characters, in eighths."""
    eighths = round(min(max(share, 0.0), 1.0) * width * 8)
    part = " ▏▎▍▌▋▊▉"[eighths % 8].strip()
    return ("█" * (eighths // 8) + part).ljust(width)


def acceleration_unit(largest_m_s2: float) -> tuple[str, float]:
    """Return the unit in which ``largest_m_s2`` has few digits, and its size in m/s^2."""
    return ("µg", MICRO_G_M_S2) if not largest_m_s2 >= 9999.5 * MICRO_G_M_S2 else ("mg", MILLI_G_M_S2)


_ASCII = str.maketrans(
    {"±": "+-", "µ": "u", "²": "^2", "°": "deg", "·": "-", "◄": "<"} | dict.fromkeys("█▉▊▋▌", "#") | dict.fromkeys("▍▎▏", ".")
)


def to_ascii(text: str) -> str:
    """Return the text for terminals and files that know ASCII only; columns of numbers stay in line."""
    return re.sub(r"(?<=\d) ± ", " +-", text).translate(_ASCII)


def knows_unicode(stream: TextIO) -> bool:
    """Whether a stream takes every character."""
    return (stream.encoding or "utf-8").lower().startswith("utf")


def shown_on(stream: TextIO, text: str) -> str:
    """Return a text as a stream can show it: where it knows no Unicode our signs in ASCII, and other characters as codes."""
    return text if knows_unicode(stream) else to_ascii(text).encode(stream.encoding, "backslashreplace").decode(stream.encoding)
