"""One line on standard error that says how far a long task is; nothing where that is no terminal."""

from __future__ import annotations

import sys
import time

from imufield.samples import Samples

FIRST_S = 0.5
"""A task shorter than this needs no line."""
EVERY_S = 0.2  # Fast enough to be seen to move, slow enough to be read.


class ProgressLine:
    """Counts what is read; closed, the line is gone.

    Parameters
    ----------
    task : str
        What is done, e.g. "reading".
    """

    def __init__(self, task: str) -> None:
        self._task = task
        self._on = sys.stderr.isatty()
        self._due_s = time.monotonic() + FIRST_S
        self._shown = False
        self._samples = 0

    def close(self) -> None:
        """Take the line away."""
        if self._shown:
            self._write("")

    def feed(self, samples: Samples) -> None:
        """Count samples; a listener of a chain."""
        self._samples += len(samples)
        if self._on and len(samples) and time.monotonic() >= self._due_s:
            minutes, seconds = divmod(int(samples.time_s[-1]), 60)
            self._write(f"{self._task}: {self._samples / 1e6:.2f} million samples, to {minutes} min {seconds:02d} s")

    def say(self, task: str) -> None:
        """Say what comes now."""
        self._task = task
        if self._shown:
            self._write(task)

    def _write(self, text: str) -> None:
        # Back to the start of the line, and what stood there away.
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()
        self._shown = True
        self._due_s = time.monotonic() + EVERY_S
