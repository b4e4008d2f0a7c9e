"""Part a line of text into cells, and tell what a cell is: a number, or a date."""

from __future__ import annotations

import re
from datetime import UTC, datetime

_DAY_FIRST = re.compile(r"^(\d\d?)\.(\d\d?)\.(\d{4})(?!\d)")  # Between dots, as in most of Europe.
_YEAR_FIRST = re.compile(r"^(\d{4})[./](\d\d?)[./](\d\d?)(?!\d)")
_ONE_DIGIT = re.compile(r"(?<![\d.,])\d(?!\d)")
_QUOTED = re.compile(r'"([^"\n]*)"')
# Three digits behind it may be thousands, but for those of 0,123.
_DECIMAL_COMMA = re.compile(r"(?<!\d)0,\d|\d,(?!\d{3}(?!\d))\d")


def delimiter_of(line: str) -> tuple[str | None, bool]:
    """Return what separates cells, and whether commas are decimal ones."""
    # What stands in quotes separates nothing.
    outside, bare = _QUOTED.sub("", line), line.replace('"', "")
    if ";" in outside:
        return ";", "," in bare
    # A bar may stand in a text: it parts cells where nothing else makes more numbers.
    if "|" in outside and _numbers(bare, "|") >= max(1, *(_numbers(bare, other) for other in (",", None))):
        return "|", "," in bare
    # Between tabs a comma is a decimal one where it cannot be another.
    is_one_each = max(cell.count(",") for cell in bare.split("\t")) == 1
    if "\t" in outside and is_one_each and "." not in bare and _DECIMAL_COMMA.search(bare):
        return None, True
    if "," in outside:
        return ",", False
    # A tab separates even where cells are empty, but files padded with blanks and tabs are common: take both as blanks.
    return None, False


def _numbers(line: str, delimiter: str | None) -> int:
    return sum(is_number(cell.replace(",", ".")) for cell in split_cells(line, delimiter) if cell)


def without_quotes(text: str, delimiter: str | None, mark: str = "_") -> str:
    """Leave out quotes; a delimiter inside them becomes what no number has: it may be a decimal comma, or one of thousands."""
    inside = re.compile(r"\s" if delimiter is None else re.escape(delimiter))
    return _QUOTED.sub(lambda quoted: inside.sub(mark, quoted[1]), text).replace('"', "") if '"' in text else text


def split_cells(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line without the blanks around them."""
    return [cell.strip() for cell in line.split(delimiter)]


def is_number(text: str) -> bool:
    """Tell whether NumPy reads a cell as a number; an empty cell counts as one."""
    # Python reads 1_000 as a number, NumPy does not.
    if "_" in text:
        return False
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True


def seconds_of_date(text: str) -> float:
    """Return the seconds since 1970, or since midnight, of a date or time of day; without a time zone it is taken as UTC.

    Raises
    ------
    ValueError
        If it is none.
    """
    text = _YEAR_FIRST.sub(r"\1-\2-\3", _DAY_FIRST.sub(r"\3-\2-\1", text.strip()))
    # But for days of a week of ISO 8601.
    text = text if "W" in text else _ONE_DIGIT.sub(r"0\g<0>", text.replace("/", "-"))
    # A time of day counts from midnight; two numbers are minutes and seconds, as Excel shows them.
    if ":" in text[:3]:
        text = f"1970-01-01T{'00:' if text.count(':') == 1 else ''}{text}"
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        # As MATLAB writes it.
        whole = text if "." in text else f"{text}.0"
        moment = datetime.strptime(whole, "%d-%b-%Y %H:%M:%S.%f")  # noqa: DTZ007  (the time zone follows)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
