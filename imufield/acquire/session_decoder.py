"""The reads of a session in, samples on one clock out: a decoder for each part, and a new one where the link was lost."""

from __future__ import annotations

import numpy as np

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.reader import RecordedBlock
from imufield.dataclass import replace
from imufield.errors import ProtocolError, Reason, RecordingError
from imufield.samples import Samples, Status
from imufield.sentences import Sentences

sentence = Sentences(__package__)

PART_GAP_S = 1.0
"""Least time between the samples of two parts, whatever the clocks of the host say of them."""


class SessionDecoder:
    """Decodes the parts of a session one after the other. Where nothing comes of what is fed, None is returned.

    Attributes
    ----------
    protocol : Protocol or None
        Of the part under way.
    statistics : list of DecoderStatistics
        One for each decoder.
    """

    def __init__(self) -> None:
        self.protocol: Protocol | None = None
        self.statistics: list[DecoderStatistics] = []
        self._decoder: Decoder | None = None
        self._offset_s: float | None = 0.0  # None from the start of a later decoder to its first samples, which tell it.
        self._last_s: float | None = None
        self._last_utc_ns, self._last_arrival_s = 0, 0.0  # Of the newest read.
        self._is_same_part = False  # As the decoder before: one program recorded both.
        self._pause_s: float | None = None  # From the last read of a decoder to the first of the next one.

    @property
    def has_read(self) -> bool:
        """Whether the decoder under way has got a byte."""
        return self._decoder is not None and self._decoder.statistics.bytes_total > 0

    def start_part(self, protocol: Protocol) -> Samples | None:
        """Begin a part: clocks, counters and half frames do not carry over. Return what the decoder before held back.

        Raises
        ------
        ProtocolError
            If its samples have other units than those of the parts before.
        """
        if self.protocol is not None and protocol.units != self.protocol.units:
            units = [self.protocol.units.words, protocol.units.words]
            raise ProtocolError(sentence("session_decoder.units", units=units), Reason.UNITS)
        self.protocol = protocol
        return self._start(protocol, is_same_part=False)

    def start_anew(self) -> Samples | None:
        """Begin anew inside a part, where the link was lost; as ``start_part``."""
        return None if self.protocol is None else self._start(self.protocol, is_same_part=True)

    def _start(self, protocol: Protocol, *, is_same_part: bool) -> Samples | None:
        held_back = self.flush()
        self._is_same_part = is_same_part
        self._decoder = Decoder(protocol)
        self.statistics.append(self._decoder.statistics)
        # At the very first there is nothing to be behind of.
        if self._last_s is not None:
            self._offset_s = self._pause_s = None
        return held_back

    def feed(self, block: RecordedBlock) -> Samples | None:
        """Take reads, joined, as if they came one by one."""
        self._note_arrival(block)
        return self._on_session_clock(self._started().feed_chunks(block.data, block.end, block.monotonic_s))

    def flush(self) -> Samples | None:
        """Return what the decoder held back; nothing will follow it."""
        return None if self._decoder is None else self._on_session_clock(self._decoder.flush())

    def _note_arrival(self, block: RecordedBlock) -> None:
        """Measure the pause behind which a new decoder begins: by reads, which are the same however they are joined."""
        if self._offset_s is None and self._pause_s is None:
            # UTC steps when somebody sets it; the monotonic clock is another one after a restart of the computer.
            by_utc_s = (block.first_utc_ns - self._last_utc_ns) / 1e9
            pause_s = float(block.monotonic_s[0]) - self._last_arrival_s if self._is_same_part else by_utc_s
            self._pause_s = max(pause_s, PART_GAP_S)
        self._last_utc_ns, self._last_arrival_s = block.utc_ns, float(block.monotonic_s[-1])

    def _started(self) -> Decoder:
        if self._decoder is None:
            raise RecordingError(sentence("session_decoder.no_part"), Reason.DAMAGED)
        return self._decoder

    def _on_session_clock(self, samples: Samples) -> Samples | None:
        """Shift the samples of a later decoder behind those of the ones before, as far as the host's clock says."""
        if not len(samples):
            return None
        if self._offset_s is None and self._last_s is not None and self._pause_s is not None:
            self._offset_s = self._last_s + self._pause_s - float(samples.time_s[0])
            # How many are missing meanwhile, nobody has counted.
            samples = replace(samples, status=samples.status.copy())
            samples.status[0] |= np.uint32(Status.GAP_ESTIMATED)
        if self._offset_s:
            samples = replace(samples, time_s=samples.time_s + self._offset_s)
        self._last_s = float(samples.time_s[-1])
        return samples
