"""Lines of numbers to samples without a time.

A line is taken when it has the right number of columns, every number that a sample cannot do without is finite, and its
checksum fits where it has one (``*XX``, the XOR of the characters before it, as in NMEA 0183). Empty lines, comments and
headers are passed over; every other line is counted as bad and becomes a gap.

Lines that begin with a name and end with a checksum, as NMEA 0183 has them: ``$NAME,number,...*checksum``.

What stands before the marker is passed over, since binary messages may end there. A sentence of another name is a message,
not a sample.
"""

from __future__ import annotations

import math
from functools import reduce
from operator import xor

import numpy as np

from imufield.acquire.decode.assembly import ABSENT, Keep, RawBlock
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import PARTS, SentenceRule, TextRule
from imufield.samples import FloatArray, IntArray, no_counters, unknown

LARGEST_NUMBER = 1e19
"""Above any counter (2**53) and any time stamp in ns since 1970 (1.8e18); larger numbers, infinity and NaN are garbage."""
LONGEST_LINE = 4096
"""Forty columns of 100 characters; a longer line is no line but noise and is passed over up to its end."""

_DELIMITERS = {"comma": b",", "semicolon": b";", "whitespace": None}
_MARKS = (b";", b",")  # Where semicolons separate, a comma can only be the decimal sign.
_HEXADECIMAL = frozenset(b"0123456789abcdefABCDEF")


class LineReader:
    """Reads samples out of a stream of text whose lines are all of one kind.

    Parameters
    ----------
    protocol : Protocol
        With ``lines``.
    statistics : DecoderStatistics
    keep : callable
        Takes sentences that are no samples, as dicts.
    """

    def __init__(self, protocol: Protocol, statistics: DecoderStatistics, keep: Keep) -> None:
        rule = protocol.lines
        assert rule is not None  # noqa: S101  the decoder looked
        self._rule = rule
        self._statistics = statistics
        self._keep = keep
        self._prefix = rule.prefix.encode()
        self._comments = tuple(comment.encode() for comment in rule.comments)
        # What is needed for a sample: an instrument may leave its temperature out now and then.
        self._column = {name: index for index, name in enumerate(rule.columns) if name != "-"}
        self._needed = [index for name, index in self._column.items() if name != "temperature"]
        fields = {part: protocol.samples.quantity(part).fields for part in PARTS}
        self._places = {part: [self._column[name] for name in names if name in self._column] for part, names in fields.items()}
        self._factors = protocol.factors
        # A counter is kept with the samples, whatever the clock goes by.
        self._counter = self._column.get(protocol.clock.counter_field or "counter")
        self._time = self._column.get(protocol.clock.time_field)
        self._finds_delimiter = rule.delimiter == "auto"
        self._delimiter = _DELIMITERS.get(rule.delimiter)
        self._rest = b""
        self._too_long = False
        self._offset = 0  # Of the bytes that are done with, in the stream.
        self._lost = 0  # Bad lines since the last good one.
        self._seen_row = False  # A line of words behind the first row is no header any more.

    def feed(self, data: bytes) -> RawBlock | None:
        """Return the samples of the lines that are complete now."""
        if self._too_long:
            # The line goes on to its end, wherever that is; only what follows may be numbers again.
            end = data.find(b"\n")
            self._too_long = end < 0
            self._pass_over(len(data) if end < 0 else end + 1)
            data = b"" if end < 0 else data[end + 1 :]
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            self._too_long = True
            self._lost += 1
            self._pass_over(len(self._rest))
            self._rest = b""
        return self._read(lines)

    def finish(self) -> RawBlock | None:
        """Take what stands there without an end of line; nothing will follow."""
        rest, self._rest = self._rest, b""
        return self._read([rest] if rest else [])

    def _pass_over(self, count: int) -> None:
        self._offset += count
        self._statistics.bytes_skipped += count

    def _read(self, lines: list[bytes]) -> RawBlock | None:
        rows: list[list[float]] = []
        lost: list[int] = []
        ends: list[int] = []
        for line in lines:
            # However it comes: of one that is not whole yet, the beginning is passed over before its end is there.
            is_too_long = len(line) > LONGEST_LINE
            self._lost += is_too_long
            text, frames = b"" if is_too_long else line.strip(), self._statistics.frames
            is_comment = text.startswith(self._comments)
            row = self._numbers(text) if text and not is_comment else None
            self._offset += len(line) + 1
            if row is None:
                # A sentence without a sample is a good frame all the same, and a comment is understood.
                self._statistics.bytes_skipped += (len(line) + 1) * (self._statistics.frames == frames and not is_comment)
                continue
            rows.append(row)
            lost.append(self._lost)
            ends.append(self._offset)
            self._lost = 0
        return self._block(np.array(rows), np.array(lost, dtype=np.int64), np.array(ends, dtype=np.int64)) if rows else None

    def _numbers(self, text: bytes) -> list[float] | None:
        """Return the numbers of one line, None for a line to pass over, which is counted as lost unless it is a header."""
        body = self._body(text)
        parts = [] if body is None else self._split(body)
        try:
            row = [float(part) if part.strip() else math.nan for part in parts]
        except ValueError:
            is_header = not self._seen_row and not _has_number(parts)
            self._lost += not is_header
            return None
        # Python would read 1_000 as a number; no instrument writes that.
        if len(row) == len(self._rule.columns) and self._is_sample(row) and b"_" not in text:
            self._seen_row = True
            return row
        self._lost += 1
        return None

    def _is_sample(self, row: list[float]) -> bool:
        return all(abs(row[place]) < LARGEST_NUMBER for place in self._needed)

    def _body(self, text: bytes) -> bytes | None:
        """Return the line without prefix and checksum; None if either is wrong."""
        body, star, sent = text.rpartition(b"*")
        if not star:
            body = text
        # As in NMEA 0183, the mark that begins the line is not covered.
        elif len(sent) != 2 or not _HEXADECIMAL.issuperset(sent) or int(sent, 16) != reduce(xor, body.removeprefix(b"$"), 0):
            self._statistics.frames_bad_checksum += 1
            return None
        if not self._prefix:
            return body
        return body.removeprefix(self._prefix).lstrip(b" \t,;") if body.startswith(self._prefix) else None

    def _split(self, body: bytes) -> list[bytes]:
        # Of each line by itself: what was learned of one line would be wrong for all others if that one is garbage.
        delimiter = next((mark for mark in _MARKS if mark in body), None) if self._finds_delimiter else self._delimiter
        parts = body.split(delimiter)
        return [part.replace(b",", b".") for part in parts] if delimiter == b";" else parts

    def _block(self, rows: FloatArray, lost: IntArray, ends: IntArray) -> RawBlock:
        if not self._rule.sentences:
            self._statistics.frames += len(rows)
            self._statistics.count("line", len(rows))
        return RawBlock(
            accelerometer=self._values(rows, "accelerometer", 3),
            gyroscope=self._values(rows, "gyroscope", 3),
            temperature_degc=self._values(rows, "temperature", 1)[:, 0],
            counter=no_counters(len(rows)) if self._counter is None else rows[:, self._counter].astype(np.int64),
            ticks=ABSENT if self._time is None else rows[:, self._time].copy(),
            status=np.zeros(len(rows), dtype=np.uint32),
            lost_before=lost,
            skipped_before=lost.astype(np.float64),
            stream_end=ends,
        )

    def _values(self, rows: FloatArray, part: str, count: int) -> FloatArray:
        """Return the values of a part of the sample, NaN where a line does not have all of them. Shape (n, count)."""
        places = self._places[part][:count]
        return rows[:, places] * self._factors[part] if len(places) == count else unknown((len(rows), count))


class SentenceReader(LineReader):
    """Reads samples out of lines that begin with a name; parameters as for ``LineReader``."""

    def __init__(self, protocol: Protocol, statistics: DecoderStatistics, keep: Keep) -> None:
        super().__init__(protocol, statistics, keep)
        rule = self._rule
        self._by_name = {kind.name.encode(): _places(rule, kind) for kind in rule.sentences}
        self._checksums = {2 * checksum.size: checksum for checksum in rule.checksums}
        self._markers = rule.markers.encode()
        self._header_end = rule.header_end.encode()

    def _numbers(self, text: bytes) -> list[float] | None:
        """Return the numbers of a sample in the order of the columns, None where the line is none."""
        body = self._checked(text)
        if body is None:
            return None
        name = body.split(b",", 1)[0].split(self._header_end or b",", 1)[0]
        self._statistics.frames += 1
        kind = name.decode("ascii", "replace")
        self._statistics.count(kind)
        if name not in self._by_name:
            self._keep({"kind": kind, "text": body.decode("ascii", "replace")})
            return None
        count, places = self._by_name[name]
        parts = body.partition(self._header_end)[2].split(b",") if self._header_end else body.split(b",")[1:]
        try:
            row = [math.nan if place is None else float(parts[place[0]]) * place[1] for place in places]
        except (ValueError, IndexError):
            row = []
        if len(parts) == count and row and self._is_sample(row):
            return row
        self._lost += 1
        return None

    def _checked(self, text: bytes) -> bytes | None:
        """Return what stands between marker and star if the checksum fits."""
        begin = max(text.rfind(marker) for marker in self._markers)
        body, star, sent = text[begin + 1 :].rpartition(b"*")
        if begin < 0 or not star:
            return None
        checksum = self._checksums.get(len(sent))
        if checksum is not None and body and _HEXADECIMAL.issuperset(sent) and checksum.of(body) == int(sent, 16):
            return body
        self._statistics.frames_bad_checksum += 1
        self._lost += any(body.startswith(name) for name in self._by_name)
        return None


def _places(rule: TextRule, sentence: SentenceRule) -> tuple[int, list[tuple[int, float] | None]]:
    """Return how many columns a sentence has, and where each column of a sample stands and with what sign."""
    found: dict[str, tuple[int, float]] = {}
    for place, name in enumerate(sentence.columns):
        found[name.removeprefix("-")] = (place, -1.0 if name.startswith("-") else 1.0)
    return len(sentence.columns), [found.get(name) for name in rule.columns]


def _has_number(parts: list[bytes]) -> bool:
    for part in parts:
        try:
            float(part)
        except ValueError:
            continue
        return True
    return False
