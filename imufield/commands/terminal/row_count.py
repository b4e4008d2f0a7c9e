"""What the rows of a file of samples hold, to be said below it: units, and how many are marked as not usable."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from imufield.samples import Samples, SampleUnits, Status
from imufield.sentences import Sentences

sentence = Sentences(__package__)


class RowCount:
    """Counts flagged rows of blocks that pass."""

    def __init__(self) -> None:
        self._units: SampleUnits | None = None
        self._starting = 0
        self._unusable = 0

    def through(self, blocks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the blocks as they are."""
        for block in blocks:
            self._units = self._units or block.units  # All blocks of a session have the same.
            self._starting += int(np.count_nonzero(block.status & np.uint32(Status.START_UP)))
            self._unusable += int(np.count_nonzero(~block.usable))
            yield block

    def units(self) -> str:
        """Return the units of the columns as they came, in words."""
        return (self._units or SampleUnits()).words

    def flags(self, *, has_status: bool = True) -> str:
        """Return a sentence on the rows that are flagged, in a file that has a column for it or not; empty where none is."""
        if not self._unusable:
            return ""
        flagged, lacking = ("row_count.flagged", "row_count.flagged_starting"), ("row_count.lacking", "row_count.starting")
        key, key_of_start = flagged if has_status else lacking
        starting = sentence(key_of_start, starting=self._starting, flag=Status.START_UP.value) if self._starting else ""
        return sentence(key, unusable=self._unusable, starting=starting)
