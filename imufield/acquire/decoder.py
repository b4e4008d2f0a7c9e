"""Bytes to samples: the one way from an instrument's stream, live or recorded, into imufield.

A *source* turns bytes into samples without a time: ``decode/frame_source`` frames of a serial line, ``decode/text_lines``
lines of text, ``decode/can_source`` frames of a CAN bus. A *clock* gives them their time: ``clock/sample_clock`` by what
the bytes themselves tell and by the host's clock, ``clock/can_clock`` by the time stamps of a bus, ``clock/stamp_clock`` by
those that a message of the bus has. ``Decoder`` joins one of each as the protocol asks.

Pure: no input or output, no clock, no logging. What comes out depends on the bytes alone and not on how they are cut into
feeds, except where host arrival time is used because the stream cannot tell (``Status.TIME_ESTIMATED`` and
``Status.GAP_ESTIMATED``).
"""

from __future__ import annotations

import math

import numpy as np

from imufield.acquire.clock.clock import Arrival, Arrivals, Clock
from imufield.acquire.clock.sample_clock import SampleClock
from imufield.acquire.decode.assembly import Keep, Message, Source
from imufield.acquire.decode.frame_source import FrameSource
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decode.text_lines import LineReader, SentenceReader
from imufield.acquire.protocol.protocol import Protocol
from imufield.samples import FloatArray, IntArray, Samples, Status, concatenate, no_samples

_INCOMPLETE = np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)
# Larger feeds are worked off in pieces of this size: memory stays bounded, and the pieces stay in cache.
_PIECE_BYTES = 1 << 18
# Messages kept until somebody fetches them: identity comes first, a stream of the same kind must not fill memory.
_MESSAGES_KEPT = 1000


class Decoder:
    """Turns the stream of one instrument into samples.

    Parameters
    ----------
    protocol : Protocol

    Examples
    --------
    >>> from imufield.acquire.protocol.protocol import load_protocol
    >>> decoder = Decoder(load_protocol("stim300", {"accelerometer_range_g": 30}))
    >>> len(decoder.feed(b"noise", arrival_s=0.0))
    0
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.statistics = DecoderStatistics()
        self._messages: list[Message] = []
        self._source, self._clock = _parts(protocol, self.statistics, self._keep)

    def feed(self, data: bytes, arrival_s: float = math.nan) -> Samples:
        """Take the bytes of one read; return the samples that are settled now, in order.

        Parameters
        ----------
        data : bytes
        arrival_s : float
            Host time when the last of them arrived, s; leave it out where it is not known.
        """
        self.statistics.bytes_total += len(data)
        return self._feed(data, Arrival(arrival_s))

    def feed_chunks(self, data: bytes, ends: IntArray, arrival_s: FloatArray) -> Samples:
        """Take the bytes of k reads at once; the same as k calls of ``feed``, many times faster for small reads.

        Parameters
        ----------
        data : bytes
            The reads, joined.
        ends : ndarray of int64, shape (k,)
            Where each ends in ``data``; the last is ``len(data)``.
        arrival_s : ndarray, shape (k,)
            Host time when the last byte of each arrived, s; NaN where not known.
        """
        arrivals = Arrivals(ends + self.statistics.bytes_total, np.asarray(arrival_s, dtype=np.float64))
        self.statistics.bytes_total += len(data)
        return self._feed(data, arrivals)

    def _feed(self, data: bytes, arrivals: Arrival | Arrivals) -> Samples:
        done: list[Samples] = []
        for at in range(0, len(data), _PIECE_BYTES):
            block = self._source.feed(data[at : at + _PIECE_BYTES])
            timed = None if block is None else self._clock.push(block, arrivals)
            if timed is not None:
                done.append(timed)
        return self._joined(done)

    def flush(self) -> Samples:
        """Return what was kept back; nothing will follow."""
        block = self._source.finish()
        never = Arrival(math.nan)
        timed = [] if block is None else [self._clock.push(block, never)]
        return self._joined([samples for samples in (*timed, self._clock.flush()) if samples is not None])

    def messages(self) -> list[Message]:
        """Return the messages that are no samples (identity, configuration, errors) since the last call.

        Each has its "kind" and the fields of the message by name.
        """
        messages, self._messages = self._messages, []
        return messages

    @property
    def time_is_counted(self) -> bool:
        """Whether samples are timed at the stated rate: neither the stream nor its arrival tells it."""
        return self._clock.by_rate

    @property
    def time_is_assumed(self) -> bool:
        """Whether that rate is one that nobody told: that of a setting left at its default, or none."""
        rate = self.protocol.settings.get("rate_hz")
        is_told = self.protocol.clock.rate_hz > 0 and (rate is None or rate.origin != "assumed")
        return self.time_is_counted and not is_told

    def _keep(self, message: Message) -> None:
        if len(self._messages) < _MESSAGES_KEPT:
            self._messages.append(message)

    def _joined(self, blocks: list[Samples]) -> Samples:
        for block in blocks:
            self.statistics.samples_incomplete += int(np.count_nonzero(block.status & _INCOMPLETE))
        if len(blocks) == 1:
            return blocks[0]
        return concatenate(blocks) if blocks else no_samples(self.protocol.units)


def _parts(protocol: Protocol, statistics: DecoderStatistics, keep: Keep) -> tuple[Source, Clock]:
    """Return the source that reads this protocol, and the clock that takes its blocks."""
    if protocol.can is not None:
        # Imported where a bus is used: cantools is slow to import.
        from imufield.acquire.clock.can_clock import CanClock
        from imufield.acquire.clock.can_sent_time import CanSentTime
        from imufield.acquire.decode.can_source import CanSource

        has_time = any(kind.time for kind in protocol.can.kinds)
        bus_clock = (CanSentTime if has_time else CanClock)(protocol.clock, protocol.units, statistics)
        return CanSource(protocol.can, statistics, keep), bus_clock
    clock = SampleClock(protocol.clock, protocol.units, statistics)
    if protocol.frame is not None:
        return FrameSource(protocol, protocol.frame, statistics, keep), clock
    reader = SentenceReader if protocol.lines and protocol.lines.sentences else LineReader
    return reader(protocol, statistics, keep), clock
