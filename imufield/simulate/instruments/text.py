"""A home-made instrument that prints lines of numbers and takes no commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.samples import Samples
from imufield.simulate.instruments.device import Answer, Frames
from imufield.simulate.wire.lines import TextFormat, encode_text


class TextDevice:
    """A home-made instrument that prints lines; it takes no commands."""

    start_up_s = 0.0
    rate_hz = None
    answers_replace_samples = False

    def __init__(self, settings: TextFormat | None = None, baud: int = 921600) -> None:
        self.format = settings or TextFormat()
        self.baud = baud
        self.streaming = True
        self._offset = 0

    def encode(self, samples: Samples) -> Frames:
        """Return one line for each sample."""
        if self._offset:
            samples = replace(samples, counter=samples.counter + self._offset)
        lines = encode_text(samples, self.format)
        ends = np.cumsum([len(line) for line in lines], dtype=np.int64)
        return Frames(np.frombuffer(b"".join(lines), dtype=np.uint8), ends, ends - len(self.format.line_end) - 1)

    def power_on(self) -> bytes:
        """Return nothing."""
        return b""

    def receive(self, data: bytes) -> Answer:  # noqa: ARG002  commands are ignored
        """Return nothing."""
        return Answer()

    def jump_counter(self, by: int) -> None:
        """Let the counter column, if there is one, jump."""
        self._offset += by
