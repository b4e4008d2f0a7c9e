"""What every emulated instrument on a serial line does: it encodes samples and answers commands."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from imufield.dataclass import dataclass
from imufield.samples import Samples
from imufield.simulate.wire.frames import Bytes
from imufield.simulate.wire.lines import LINE_END


@dataclass(frozen=True, slots=True)
class Frames:
    """Encoded frames of a block."""

    data: Bytes
    """Shape (n,)."""
    ends: np.ndarray[tuple[int], np.dtype[np.int64]]
    """Where each frame ends in it, ascending. Shape (m,)."""
    checksum_at: np.ndarray[tuple[int], np.dtype[np.int64]]
    """Place of one byte of the checksum of each frame; of any byte where the form has no checksum."""

    @classmethod
    def of_lines(cls, lines: Sequence[bytes]) -> Frames:
        """Return lines of text; a checksum, where they have one, stands before the end of the line."""
        ends = np.cumsum([len(line) for line in lines], dtype=np.int64)
        return cls(np.frombuffer(b"".join(lines), dtype=np.uint8), ends, ends - len(LINE_END) - 1)


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to a command."""

    data: bytes = b""
    resets: bool = False
    """The instrument starts anew."""


class Device(ABC):
    """An instrument on the other end of the wire; unless it says otherwise it always sends, and takes no commands."""

    start_up_s = 0.0
    """Samples of this time after power-on are flagged ``Status.START_UP``."""
    answers_replace_samples = False
    """Whether an answer takes the place of a sample; otherwise it comes between two."""

    @property
    def streaming(self) -> bool:
        """Whether samples are sent in the present mode."""
        return True

    @property
    def rate_hz(self) -> float | None:
        """Output rate that commands have set; None: that of its samples."""
        return None

    @abstractmethod
    def encode(self, samples: Samples) -> Frames:
        """Return the frames of a block of samples."""

    @abstractmethod
    def jump_counter(self, by: int) -> None:
        """Let the counter jump; without one, the time stamp by as many samples."""

    def power_on(self) -> bytes:
        """Return what is sent at power-on before the first sample."""
        return b""

    def receive(self, data: bytes) -> Answer:  # noqa: ARG002  commands are ignored
        """Return the answer to bytes of the host, whole commands or parts of them."""
        return Answer()
