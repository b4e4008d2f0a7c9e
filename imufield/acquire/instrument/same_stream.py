"""Check that a stream runs in real time, and that after a reconnect it still comes from the same instrument.

In real time by its own clock, and still the same instrument where a link was lost and opened again and nobody can be asked.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.acquire.link.chunk import Chunk
from imufield.errors import LinkError, Reason, UsageError
from imufield.samples import FloatArray, Samples, Status, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# Samples from which a rate is told: by the clock of the host it is known within some percent then, and a position takes longer.
_RATE_S = 2.0
_RATE_SHARE = 0.2  # Part by which it may differ; the rates that an instrument can be set to are further apart.
_NO_SAMPLE_S = 10.0  # Of bytes alone: what an instrument says when it is switched on is shorter.
_PAUSE_S = 0.25  # Silence counts no longer than this.
_FAST = 1.5  # Seconds of samples in one of the host, where no crystal is off by a thousandth.
_WHOLE = 0.9  # Part of a second's samples that is there on a link that keeps up.
_FAST_WINDOWS = 10  # In a row from the beginning: what had waited to be read comes in the first.


class SameStream:
    """Compares the samples behind a reconnect with those before.

    Parameters
    ----------
    port : str
        For sentences.
    window_s : float
        A real second by the clock that the reads are stamped with.
    """

    def __init__(self, port: str, window_s: float = 1.0) -> None:
        self._port = port
        self._window_s = window_s
        self._window: list[FloatArray] | None = None  # Times of its samples; None once some came no faster than real.
        self._window_begin_s = math.nan
        self._fast_windows = 0
        self._is_lossy = False
        self._rate_hz: float | None = None  # Of the first stretch that was long enough.
        self._times: list[FloatArray] | None = None  # Of the samples since the link was opened; None once they have told.
        self.unread_s = 0.0  # Of bytes since the newest sample, or since the link was opened.
        self._last_s = math.nan

    def begin(self) -> None:
        """Expect what comes behind a reconnection, or the very first samples, which all others are compared with."""
        self._times, self.unread_s, self._last_s = [], 0.0, math.nan
        self._window, self._window_begin_s, self._fast_windows = [], math.nan, 0
        self._is_lossy = False

    @property
    def is_unread(self) -> bool:
        """Whether bytes alone have come for long, without a sample: other nodes of a bus, or noise."""
        return self.unread_s > _NO_SAMPLE_S

    def hear(self, samples: Samples) -> None:
        """Take the samples that the chain has made."""
        self.unread_s = 0.0
        if self._times is not None:
            self._times.append(samples.time_s)
        # The clock of the host tells nothing of itself.
        if self._window is not None and not (samples.status & np.uint32(Status.TIME_ESTIMATED)).any():
            self._window.append(samples.time_s)

    def check(self, chunk: Chunk) -> None:
        """Judge the samples heard so far, of which this was the newest read.

        Raises
        ------
        LinkError
            They are of another kind or rate than before (``FOREIGN``).
        UsageError
            They come faster than their own clock runs, and not all of them.
        """
        self._check_pace(chunk.monotonic_s)
        pause_s, self._last_s = chunk.monotonic_s - self._last_s, chunk.monotonic_s
        self.unread_s += min(pause_s, _PAUSE_S) if math.isfinite(pause_s) else 0.0
        if self._times is None:
            return
        if not self._times:
            if self.is_unread:
                other = sentence("same_stream.kind", port=self._port, heard_s=self.unread_s)
                raise LinkError(other, Reason.FOREIGN)
        elif self._times[-1][-1] - self._times[0][0] >= _RATE_S:
            step_s = float(median(np.diff(np.concatenate(self._times))))
            self._times = None
            # A clock that jumps about tells no rate.
            if step_s <= 0:
                return
            rate_hz = 1 / step_s
            self._rate_hz = self._rate_hz or rate_hz
            if abs(rate_hz / self._rate_hz - 1) > _RATE_SHARE:
                other = sentence("same_stream.rate", port=self._port, rate_hz=rate_hz, before_hz=self._rate_hz)
                raise LinkError(other, Reason.FOREIGN)

    def _check_pace(self, now_s: float) -> None:
        """Compare how many samples came in a second of the host with the step of their own times; as ``check``."""
        span_s = now_s - self._window_begin_s
        if self._window is None or span_s < self._window_s:
            return
        times = np.concatenate(self._window) if self._window else np.empty(0)
        self._window, self._window_begin_s = [], now_s
        if len(times) < 2 or not math.isfinite(span_s):
            return
        heard_s = len(times) * float(median(np.diff(times)))
        self._fast_windows += 1
        self._is_lossy |= heard_s < _WHOLE * float(times[-1] - times[0])
        if heard_s <= _FAST * span_s:
            self._window = None
        elif self._fast_windows == _FAST_WINDOWS:
            # Of a stream that is whole, its own clock tells all there is to know.
            self._window = None
            if self._is_lossy:
                raise UsageError(sentence("same_stream.fast", port=self._port, pace=heard_s / span_s, limit=_FAST))
