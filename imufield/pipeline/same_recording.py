"""Whether two sessions hold the same recording, by what was sent: also where one is a copy that is damaged or cut short.

The hash of a file finds whole copies only, and names and times are edited or missing. So marks are left at places that the
content itself chooses: a run of rows of output whose hash ends in a few zeros is a mark. A copy has the same marks wherever it
begins and whatever it lacks; outputs of another day have noise of their own, and share none.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Protocol, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imufield.samples import Samples, UIntArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_RUN = 16  # Rows: six outputs of at least one bit of noise make 96 bits.
_ONE_IN = np.uint64(128)  # A minute at 100 Hz has some 50 marks.
_SHARED = 3  # Fewer are 2 s of 100 Hz, and no day.


@cache  # Made when they are needed: numpy.random is slow to import, and most sessions are solved alone.
def _factors() -> UIntArray:
    return np.random.default_rng(0).integers(1, 2**63, size=(2, _RUN), dtype=np.uint64) * np.uint64(2) + np.uint64(1)


class RecordingMarks:
    """Collects the marks of a stream of samples."""

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=np.uint64)
        self._marks: set[int] = set()

    def feed(self, samples: Samples) -> None:
        """Take the next samples."""
        outputs = np.ascontiguousarray(np.hstack([samples.accelerometer, samples.gyroscope]))
        rows = _mixed(outputs.view(np.uint64) @ _factors()[0, : outputs.shape[1]])
        rows = np.concatenate([self._rows, rows])
        # An output that stands still would be the same on every day.
        rows = rows[np.diff(rows, prepend=~rows[:1]) != 0]
        if len(rows) >= _RUN:
            runs = _mixed(sliding_window_view(rows, _RUN) @ _factors()[1])
            self._marks.update(runs[runs % _ONE_IN == 0].tolist())
        self._rows = rows[-(_RUN - 1) :]

    def same_as(self, other: RecordingMarks) -> bool:
        """Whether both streams hold the same recording, or parts of it."""
        return len(self._marks & other._marks) >= _SHARED


class Marked(Protocol):
    """A recording that was read."""

    @property
    def name(self) -> str:
        """What people call it."""
        ...

    @property
    def marks(self) -> RecordingMarks:
        """Of its samples."""
        ...


AnyMarked = TypeVar("AnyMarked", bound=Marked)


def without_copies(given: Sequence[AnyMarked]) -> tuple[list[AnyMarked], list[str]]:
    """Return the recordings of their own, and a sentence for each copy of one that comes before it."""
    kept: list[AnyMarked] = []
    said: list[str] = []
    for each in given:
        whole = next((other for other in kept if each.marks.same_as(other.marks)), None)
        if whole is None:
            kept.append(each)
        else:
            said.append(sentence("same_recording.copy", copy=each.name, whole=whole.name))
    return kept, said


def _mixed(values: UIntArray) -> UIntArray:
    """Return hashes every bit of which hangs on every bit of the values (the finaliser of splitmix64)."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
