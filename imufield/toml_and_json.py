"""TOML and JSON that people and other programs wrote: the reader of sessions, parameter files, protocols, positions, defaults.

It refuses in one sentence, with file and line, what is no UTF-8, no TOML, nested too deeply, or a whole number beyond 64 bits.
What comes out of it can be walked through recursively, and each of its whole numbers is a float, too. Of JSON
only syntax and nesting are checked.
"""

from __future__ import annotations

import json
import re

import tomli

from imufield.errors import ImufieldError, ParameterFileError, ProtocolError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

DEEPEST = 32
"""Levels of tables and arrays in each other; shipped protocols have eight."""
INTEGER_BITS = 64
"""TOML asks for as many with a sign; masks and checksums of instruments have as many without one."""

# Any file can be named where one of these kinds is expected: which kind that is, is said.
_NO_TOML: dict[type[ImufieldError], str] = {
    ParameterFileError: "toml_and_json.no_parameter_file",
    ProtocolError: "toml_and_json.no_protocol_file",
}

Place = tuple[str | int, ...]
"""Keys and indices of arrays, from the outermost."""

# What opens, closes and joins; strings and comments are found as a whole, so that nothing inside them counts.
_TOKEN = re.compile(
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"{3,5})?'
    r"|'''(?:[^']++|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]++|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[][{}.,=\n]"
    # Runs of decimal numbers, for speed; no parts of a key, whose dots are counted one by one.
    r"|(?<![0-9])(?:[0-9]++\.[0-9e+-]++(?=[],\s]),?[ \n]*+-?)++",
    re.DOTALL,
)
_BRACE = re.compile("[{}]")
_HEADER = re.compile(r"^[^\S\n]{0,100}\[[\w.\"' \[\]-]{1,200}\][^\S\n]{0,100}(?:#|$)", re.MULTILINE)
# More digits than Python makes a number of.
_ENDLESS_NUMBER = re.compile("(?<![0-9_])[0-9_]{4300}")


def decode_toml(content: bytes, label: str, kind: type[ImufieldError]) -> str:
    """Return the text of a file, whose first bytes may be the mark that editors on Windows write; errors as ``parse_toml``."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = 1 + content.count(b"\n", 0, error.start)
        raise kind(sentence("toml_and_json.no_text", label=label, line=line, byte=error.start)) from error


def parse_toml(text: str, label: str, kind: type[ImufieldError]) -> dict[str, object]:
    """Return the content of a TOML file.

    Parameters
    ----------
    text : str
        Of a size that was limited where it was read.
    label : str
        What to call the file in sentences.
    kind : type of ImufieldError
        What is raised for this file.

    Raises
    ------
    ImufieldError
        Of that kind.
    """
    _check_brackets(text, label, kind)
    try:
        content: dict[str, object] = tomli.loads(text)
    except tomli.TOMLDecodeError as error:
        raise kind(sentence(_NO_TOML.get(kind, "toml_and_json.no_toml"), label=label, cause=error)) from error
    except ValueError as error:
        # Python's own limit on digits. Nothing else of a document can be the cause.
        digits = _ENDLESS_NUMBER.search(text)
        line = 1 + text.count("\n", 0, digits.start() if digits else 0)
        raise kind(sentence("toml_and_json.integer", label=label, line=line)) from error
    _check_values(content, text, label, kind)
    return content


def _check_brackets(text: str, label: str, kind: type[ImufieldError]) -> None:
    """Refuse brackets in each other and parts of one key beyond the limit: they would exhaust the parser's stack and time."""
    open_brackets = parts = 0
    for token in _TOKEN.finditer(text):
        mark = token[0][0]
        open_brackets += (mark in "[{") - (mark in "]}")
        # A quoted part of a key ends no key.
        parts = parts + 1 if mark == "." else parts if mark in "\"'0123456789" else 0
        if open_brackets > DEEPEST or parts >= DEEPEST:
            line = 1 + text.count("\n", 0, token.start())
            raise kind(sentence("toml_and_json.nested", label=label, line=line, deepest=DEEPEST))


def _check_values(content: dict[str, object], text: str, label: str, kind: type[ImufieldError]) -> None:
    """Refuse what is too deep, as keys of several parts nest without brackets, and whole numbers that are too large."""
    waiting: list[tuple[Place, dict[str, object] | list[object]]] = [((), content)]
    while waiting:
        place, outer = waiting.pop()
        for key, value in outer.items() if isinstance(outer, dict) else enumerate(outer):
            if isinstance(value, float):
                continue  # Most are: asked first, for speed.
            if isinstance(value, dict | list):
                if len(place) >= DEEPEST:
                    raise kind(sentence("toml_and_json.nested", label=label, line=line_of(text, place), deepest=DEEPEST))
                waiting.append(((*place, key), value))
            elif isinstance(value, int) and not -(1 << INTEGER_BITS - 1) <= value < 1 << INTEGER_BITS:
                raise kind(sentence("toml_and_json.integer", label=label, line=line_of(text, (*place, key))))


def line_of(text: str, place: Place) -> int:
    """Return the number of the line, from 1, where a value of a TOML text is written, as near as it can be found."""
    at = 0
    for part in place:
        behind = _behind_element(text, at, part) if isinstance(part, int) else _behind_key(text, at, part)
        if behind is None:
            break
        at = behind
    return 1 + text.count("\n", 0, at)


def _behind_key(text: str, at: int, name: str) -> int | None:
    # Few blanks, and a comment passed over as a whole: a text that is made to be slow is looked at once all the same.
    key = re.compile(rf"(?<![\w-])[\"']?{re.escape(name)}[\"']?[^\S\n]{{0,100}}[=.\]]")
    header = _HEADER.search(text, at)
    own = header.start() if header else len(text)  # Behind it, a value is another table's.
    while found := key.search(text, at):
        line = text[text.rfind("\n", 0, found.start()) + 1 : found.start()]
        if not line.lstrip().startswith("#") and (found.start() < own or not found[0].endswith("=")):
            return found.end()
        at = text.find("\n", found.end())
        if at < 0:
            break
    return None


def _behind_element(text: str, at: int, index: int) -> int | None:
    """Find the element ``index`` of an array: by its opening brace, nested ones passed over."""
    depth, seen = 0, -1
    for brace in _BRACE.finditer(text, at):
        depth += 1 if brace[0] == "{" else -1
        seen += brace[0] == "{" and depth == 1
        if seen == index:
            return brace.end()
    return None


def parse_json(data: bytes | str) -> object:
    """Return the decoded document.

    Raises
    ------
    ValueError
        It is no JSON, or nested deeper than ``DEEPEST``: what takes it apart afterwards would end in a RecursionError.
    """
    try:
        value = json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    layer = [value]
    for _ in range(DEEPEST):
        tables = [each.values() if isinstance(each, dict) else each for each in layer if isinstance(each, dict | list)]
        layer = [each for table in tables for each in table]
        if not layer:
            return value
    raise ValueError("nested too deep")
