"""Lines that begin with a name and end with a checksum, as NMEA 0183 has them: ``$NAME,number,...*checksum``.

What stands before the marker is passed over, since binary messages may end there. A sentence of another name is a message,
not a sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from imufield.acquire.protocol_schema import Sentence, TextRule
from imufield.acquire.statistics import DecoderStatistics

Keep = Callable[[dict[str, Any]], None]
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
        self._lost = 0

    def take_lost(self) -> int:
        """Return how many samples were lost since the last call."""
        lost, self._lost = self._lost, 0
        return lost

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
        self._statistics.by_kind[kind] = self._statistics.by_kind.get(kind, 0) + 1
        known = self._by_name.get(name)
        if known is None:
            if self._keep is not None:
                self._keep({"kind": kind, "text": body.decode("ascii", "replace")})
            return None
        row = self._numbers(body, *known)
        if row is None or not all(abs(row[place]) < LARGEST_NUMBER for place in needed):
            self._lost += 1
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
            self._lost += any(body.startswith(name) for name in self._by_name)
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


def _places(rule: TextRule, sentence: Sentence) -> tuple[int, list[tuple[int, float] | None]]:
    """Return how many columns a sentence has, and where each column of a sample stands and with what sign."""
    found: dict[str, tuple[int, float]] = {}
    for place, name in enumerate(sentence.columns):
        found[name.removeprefix("-")] = (place, -1.0 if name.startswith("-") else 1.0)
    return len(sentence.columns), [found.get(name) for name in rule.columns]


def _is_hexadecimal(text: bytes) -> bool:
    return all(character in b"0123456789abcdefABCDEF" for character in text)
