"""Whether it is still the same instrument that sends, where a link was lost and opened again and nobody can be asked."""

from __future__ import annotations

import math

import numpy as np

from imufield.acquire.link.serial import Chunk
from imufield.errors import LinkError, Reason
from imufield.samples import FloatArray, Samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# Samples from which a rate is told: by the clock of the host it is known within some percent then, and a position takes longer.
_RATE_S = 2.0
_RATE_SHARE = 0.2  # Part by which it may differ; the rates that an instrument can be set to are further apart.
_NO_SAMPLE_S = 10.0  # Of bytes alone: what an instrument says when it is switched on is shorter.
_PAUSE_S = 0.25  # Silence counts no longer than this.


class SameStream:
    """Compares the samples behind a reconnect with those before.

    Parameters
    ----------
    port : str
        For sentences.
    """

    def __init__(self, port: str) -> None:
        self._port = port
        self._rate_hz: float | None = None  # Of the first stretch that was long enough.
        self._times: list[FloatArray] | None = None  # Of the samples since the link was opened; None once they have told.
        self._unread_s = 0.0
        self._last_s = math.nan

    def begin(self) -> None:
        """Expect what comes behind a reconnection, or the very first samples, which all others are compared with."""
        self._times, self._unread_s, self._last_s = [], 0.0, math.nan

    def hear(self, samples: Samples) -> None:
        """Take the samples that the chain has made."""
        if self._times is not None:
            self._times.append(samples.time_s)

    def check(self, chunk: Chunk) -> None:
        """Judge the samples heard so far, of which this was the newest read.

        Raises
        ------
        LinkError
            They are of another kind or rate than before (``FOREIGN``).
        """
        if self._times is None:
            return
        pause_s, self._last_s = chunk.monotonic_s - self._last_s, chunk.monotonic_s
        if not self._times:
            self._unread_s += min(pause_s, _PAUSE_S) if math.isfinite(pause_s) else 0.0
            if self._unread_s > _NO_SAMPLE_S:
                other = sentence("same_stream.kind", port=self._port, heard_s=self._unread_s)
                raise LinkError(other, Reason.FOREIGN)
        elif self._times[-1][-1] - self._times[0][0] >= _RATE_S:
            rate_hz = 1 / float(np.median(np.diff(np.concatenate(self._times))))
            self._times, self._rate_hz = None, self._rate_hz or rate_hz
            if abs(rate_hz / self._rate_hz - 1) > _RATE_SHARE:
                other = sentence("same_stream.rate", port=self._port, rate_hz=rate_hz, before_hz=self._rate_hz)
                raise LinkError(other, Reason.FOREIGN)
