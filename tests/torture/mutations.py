"""Damage to files: strategies of hypothesis that give lists of small edits, which shrink to the few that matter."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import strategies as st

Edit = Callable[[bytes], bytes]

TOKENS = (
    *(
        "nan",
        "-nan",
        "inf",
        "1e999",
        "-1",
        "0",
        "1e-320",
        "9" * 40,
        "0x7fffffffffffffff",
        "true",
        '""',
        '"\\u0000"',
        "[]",
        "[[]]",
    ),
    *(
        "{}",
        "[1, 2]",
        "'''",
        '"../../outside"',
        '"/etc/passwd"',
        "!!python/object:os.system",
        "__import__('os')",
        "\ufeff",
        "=",
        "\t",
    ),
    *("1970-01-01T00:00:00Z", "10000000000000", "x = 1", "[settings]", "[a.b.c]", "#", ";", ",", "\r", "\x00", "é", "-0.0"),
)
"""What a hand, or a bad program, may put into a text file."""


def _place(length: int, at: float) -> int:
    return min(int(at * length), max(length - 1, 0))


def _flip(at: float, mask: int) -> Edit:
    def edit(data: bytes) -> bytes:
        place = _place(len(data), at)
        return data[:place] + bytes(byte ^ mask for byte in data[place : place + 1]) + data[place + 1 :]

    return edit


def _cut(at: float, length: int) -> Edit:
    return lambda data: data[: _place(len(data), at)] + data[_place(len(data), at) + length :]


def _end(at: float) -> Edit:
    return lambda data: data[: _place(len(data), at)]


def _insert(at: float, what: bytes) -> Edit:
    return lambda data: data[: _place(len(data), at)] + what + data[_place(len(data), at) :]


def _repeat(at: float, length: int) -> Edit:
    def edit(data: bytes) -> bytes:
        place = _place(len(data), at)
        return data[: place + length] + data[place:]

    return edit


def _token(at: float, token: str) -> Edit:
    """Replace the word at a place by a token."""

    def edit(data: bytes) -> bytes:
        words = data.split(b" ")
        words[_place(len(words), at)] = token.encode("utf-8", "surrogatepass")
        return b" ".join(words)

    return edit


def _line(at: float, to: float | None) -> Edit:
    """Move a line to another place, or take it away."""

    def edit(data: bytes) -> bytes:
        lines = data.split(b"\n")
        taken = lines.pop(_place(len(lines), at))
        if to is not None:
            lines.insert(_place(len(lines), to), taken)
        return b"\n".join(lines)

    return edit


_at = st.floats(0, 1, allow_nan=False)
_binary = st.one_of(
    st.builds(_flip, _at, st.integers(1, 255)),
    st.builds(_cut, _at, st.integers(1, 5000)),
    st.builds(_end, _at),
    st.builds(_insert, _at, st.binary(min_size=1, max_size=64)),
    st.builds(_repeat, _at, st.integers(1, 3000)),
)
_text = st.one_of(
    st.builds(_token, _at, st.sampled_from(TOKENS)),
    st.builds(_line, _at, st.one_of(st.none(), _at)),
    st.builds(_insert, _at, st.sampled_from(TOKENS).map(str.encode)),
    _binary,
)
binary_edits = st.lists(_binary, min_size=1, max_size=4)
text_edits = st.lists(_text, min_size=1, max_size=4)


def damaged(data: bytes, edits: list[Edit]) -> bytes:
    """Return the file after all edits."""
    for edit in edits:
        data = edit(data)
    return data
