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

from imufield.acquire.decode.assembly import Keep, RawBlock
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import SentenceRule, TextRule
from imufield.errors import ProtocolError
from imufield.samples import NO_COUNTER, FloatArray, IntArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

LARGEST_NUMBER = 1e17
"""Above any counter (2**53) and any time stamp in ns of a century ago; larger numbers, infinity and NaN are garbage."""


class SentenceReader:
    """Reads one line at a time.

    Parameters
    ----------
    rule : TextRule
        With sentences.
    statistics : DecoderStatistics
    keep : callable or None
        Takes sentences that are no samples.
    """

    def __init__(self, rule: TextRule, statistics: DecoderStatistics, keep: Keep | None) -> None:
        self._rule = rule
        self._statistics = statistics
        self._keep = keep
        self._by_name = {sentence.name.encode(): _places(rule, sentence) for sentence in rule.sentences}
        self._checksums = {2 * checksum.size: checksum for checksum in rule.checksums}
        self._markers = rule.markers.encode()
        self.lost = 0  # Samples lost since the reader of lines last set it back.

    def read(self, text: bytes, needed: list[int]) -> list[float] | None:
        """Return the numbers of a sample in the order of the columns, None where the line is none.

        Parameters
        ----------
        text : bytes
            The line.
        needed : list of int
            Places of the columns that must be finite.
        """
        body = self._checked(text)
        if body is None:
            return None
        name = body.split(b",", 1)[0].split(self._rule.header_end.encode() or b",", 1)[0]
        self._statistics.frames += 1
        kind = name.decode("ascii", "replace")
        self._statistics.count(kind)
        known = self._by_name.get(name)
        if known is None:
            if self._keep is not None:
                self._keep({"kind": kind, "text": body.decode("ascii", "replace")})
            return None
        row = self._numbers(body, *known)
        if row is None or not all(abs(row[place]) < LARGEST_NUMBER for place in needed):
            self.lost += 1
            return None
        return row

    def _checked(self, text: bytes) -> bytes | None:
        """Return what stands between marker and star if the checksum fits."""
        begin = max(text.rfind(marker) for marker in self._markers)
        body, star, sent = text[begin + 1 :].rpartition(b"*")
        if begin < 0 or not star:
            return None
        checksum = self._checksums.get(len(sent))
        good = checksum is not None and len(body) > 0 and _is_hexadecimal(sent)
        if checksum is not None and good:
            row = np.frombuffer(body, dtype=np.uint8).reshape(1, -1)
            good = int(checksum.of_rows(row)[0]) == int(sent, 16)
        if not good:
            self._statistics.frames_bad_checksum += 1
            self.lost += any(body.startswith(name) for name in self._by_name)
            return None
        return body

    def _numbers(self, body: bytes, count: int, places: list[tuple[int, float] | None]) -> list[float] | None:
        end = self._rule.header_end.encode()
        parts = body.partition(end)[2].split(b",") if end else body.split(b",")[1:]
        if len(parts) != count:
            return None
        try:
            return [math.nan if place is None else float(parts[place[0]]) * place[1] for place in places]
        except ValueError:
            return None


def _places(rule: TextRule, sentence: SentenceRule) -> tuple[int, list[tuple[int, float] | None]]:
    """Return how many columns a sentence has, and where each column of a sample stands and with what sign."""
    found: dict[str, tuple[int, float]] = {}
    for place, name in enumerate(sentence.columns):
        found[name.removeprefix("-")] = (place, -1.0 if name.startswith("-") else 1.0)
    return len(sentence.columns), [found.get(name) for name in rule.columns]


def _is_hexadecimal(text: bytes) -> bool:
    return all(character in b"0123456789abcdefABCDEF" for character in text)


LONGEST_LINE = 4096
"""Forty columns of 100 characters; a longer line is no line but noise and is passed over up to its end."""

_DELIMITERS = {"comma": b",", "semicolon": b";", "whitespace": None}


class LineReader:
    """Reads samples out of a stream of text.

    Parameters
    ----------
    protocol : Protocol
        With ``lines``.
    statistics : DecoderStatistics
    keep : callable, optional
        Takes sentences that are no samples, as dicts.
    """

    def __init__(self, protocol: Protocol, statistics: DecoderStatistics, keep: Keep | None = None) -> None:
        if protocol.lines is None:
            raise ProtocolError(sentence("text_lines.no_lines", name=protocol.name))
        rule = protocol.lines
        self._rule = rule
        self._prefix = rule.prefix.encode()
        self._comments = tuple(comment.encode() for comment in rule.comments)
        self._statistics = statistics
        self._sentences = SentenceReader(rule, statistics, keep) if rule.sentences else None
        self._factors = protocol.factors
        # What is needed for a sample: an instrument may leave its temperature out now and then.
        self._column = {name: index for index, name in enumerate(rule.columns) if name != "-"}
        self._needed = [index for name, index in self._column.items() if name != "temperature"]
        self._delimiter = _DELIMITERS.get(rule.delimiter)
        self._delimiter_known = rule.delimiter != "auto"
        self._rest = b""
        self._too_long = False
        self._offset = 0  # Of the bytes that are done with, in the stream.
        self._lost = 0  # Bad lines since the last good one.
        self._seen_line = False  # Numbers were seen, so a line of words is no header any more.

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
            text = line.strip()
            self._offset += len(line) + 1
            row = None
            if text and not text.startswith(self._comments):
                row = self._sentences.read(text, self._needed) if self._sentences else self._numbers(text)
            if row is None:
                self._statistics.bytes_skipped += len(line) + 1
                continue
            rows.append(row)
            lost.append(self._lost + (self._sentences.lost if self._sentences else 0))
            ends.append(self._offset)
            self._lost = 0
            if self._sentences:
                self._sentences.lost = 0
        if not rows:
            return None
        if self._sentences is None:
            self._statistics.frames += len(rows)
            self._statistics.count("line", len(rows))
        return self._block(np.array(rows), np.array(lost, dtype=np.int64), np.array(ends, dtype=np.int64))

    def _numbers(self, text: bytes) -> list[float] | None:
        """Return the numbers of one line, None for a line to pass over, which is counted as lost unless it is a header."""
        body = self._body(text)
        parts = [] if body is None else self._split(body)
        try:
            row = [float(part) if part.strip() else math.nan for part in parts]
        except ValueError:
            is_header = not self._seen_line and not _has_number(parts)
            self._lost += not is_header
            return None
        self._seen_line = True
        # Python would read 1_000 as a number; no instrument writes that.
        if len(row) == len(self._rule.columns) and all(abs(row[i]) < LARGEST_NUMBER for i in self._needed) and b"_" not in text:
            return row
        self._lost += 1
        return None

    def _body(self, text: bytes) -> bytes | None:
        """Return the line without prefix and checksum; None if either is wrong."""
        body, star, sent = text.rpartition(b"*")
        if star:
            # As in NMEA 0183, the mark that begins the line is not covered.
            covered = body.removeprefix(b"$")
            try:
                good = int(sent, 16) == reduce(xor, covered, 0) and len(sent) == 2
            except ValueError:
                good = False
            if not good:
                self._statistics.frames_bad_checksum += 1
                return None
        else:
            body = text
        if not self._prefix:
            return body
        if not body.startswith(self._prefix):
            return None
        return body[len(self._prefix) :].lstrip(b" \t,;")

    def _split(self, body: bytes) -> list[bytes]:
        if not self._delimiter_known:
            self._delimiter = next((mark for mark in (b";", b",") if mark in body), None)
            self._delimiter_known = _has_number(body.split(self._delimiter))
        parts = body.split(self._delimiter)
        # Where semicolons separate, a comma can only be the decimal sign.
        return [part.replace(b",", b".") for part in parts] if self._delimiter == b";" else parts

    def _block(self, rows: FloatArray, lost: IntArray, ends: IntArray) -> RawBlock:
        column = self._column
        counter = column.get("counter")
        time = column.get("time")
        return RawBlock(
            accelerometer=self._triad(rows, "accelerometer", ("ax", "ay", "az")),
            gyroscope=self._triad(rows, "gyroscope", ("gx", "gy", "gz")),
            temperature_degc=rows[:, column["temperature"]].copy() if "temperature" in column else np.full(len(rows), np.nan),
            counter=np.full(len(rows), NO_COUNTER) if counter is None else rows[:, counter].astype(np.int64),
            ticks=np.empty(0) if time is None else rows[:, time].copy(),
            status=np.zeros(len(rows), dtype=np.uint32),
            lost_before=lost,
            skipped_before=lost.astype(np.float64),
            stream_end=ends,
        )

    def _triad(self, rows: FloatArray, part: str, names: tuple[str, ...]) -> FloatArray:
        if not all(name in self._column for name in names):
            return np.full((len(rows), 3), np.nan)
        return rows[:, [self._column[name] for name in names]] * self._factors[part]


def _has_number(parts: list[bytes]) -> bool:
    for part in parts:
        try:
            float(part)
        except ValueError:
            continue
        return True
    return False
