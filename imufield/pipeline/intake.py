"""What is read of a link while it is recorded: to the disk first, then through the chain.

The order of recorded events does not depend on when the link is silent: events of earlier bytes precede a mark or a loss.
"""

from __future__ import annotations

from imufield.acquire.decoded_session import UNPLUGGED
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.reader import ReadJoiner
from imufield.acquire.recording.recorder import Recorder
from imufield.dataclass import dataclass, field
from imufield.guide.events import Event
from imufield.pipeline.chain import MARK, Chain

DECODED_EVERY_S = 0.1
"""Of the wire, decoded at once: a small block costs nearly as much as a large one, and cells of the guide are as long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Intake:
    """The way of every chunk of a capture and of a plain recording.

    The events that a method returns are recorded already; each may raise RecordingError.
    """

    recorder: Recorder
    chain: Chain
    stream: SameStream
    """Hears the samples of the chain."""
    waiting: ReadJoiner = field(default_factory=lambda: ReadJoiner(span_s=DECODED_EVERY_S))
    """Recorded and not yet decoded."""

    def start_part(self, protocol: Protocol) -> list[Event]:
        """Begin the part that is recorded; raises as ``Chain.start_part``."""
        return self._record(self.chain.start_part(protocol))

    def take(self, chunk: Chunk) -> list[Event]:
        """Record a chunk and return what the guide says of those before it.

        Raises
        ------
        LinkError
            Those before it are of another instrument than the session.
        RecordingError
            It cannot be written.
        """
        self.stream.check(chunk)
        return self._keep(chunk)

    def take_rest(self, chunks: list[Chunk]) -> None:
        """Record what still waits at the end, when nobody asks any more whose it is; RecordingError as ``take``."""
        for chunk in chunks:
            self._keep(chunk)

    def _keep(self, chunk: Chunk) -> list[Event]:
        # To the disk first: what fails behind it can be done again from there.
        self.recorder.write_chunk(chunk)
        events = self.catch_up() if self.waiting.must_end_before(chunk.monotonic_s, len(chunk.data)) else []
        self.waiting.add(chunk.data, chunk.monotonic_s, chunk.utc_ns)
        return events

    def catch_up(self) -> list[Event]:
        """Decode what was taken so far: the link is silent, or a mark or a loss refers to the samples up to here."""
        return self._record(self.chain.feed(self.waiting.take())) if self.waiting.pieces else []

    def mark(self, action: str, position: str | None = None) -> list[Event]:
        """Record what the operator says, and tell the guide; without one nothing is recorded."""
        events = self.catch_up()
        if self.chain.guide is None:
            return events
        # The time is that of the sample clock: a replay marks the same sample, however fast it runs.
        time_s = self.chain.guide.time_s
        named = {} if position is None else {"position": position}
        self.recorder.write_event({"event": MARK, "action": action, "time_s": time_s, **named})
        return events + self._record(self.chain.mark(action, time_s, position))

    def link_lost(self) -> list[Event]:
        """Record the loss, and decode anew what comes behind it; the guide tells one loss once."""
        # What the decoder held back is of before the loss. A replay begins anew at ``link_lost`` as at ``unplugged``.
        events = self.catch_up() + self._record(self.chain.link_lost())
        self.recorder.write_event({"event": UNPLUGGED})
        self.stream.begin()
        return events

    def finish(self) -> list[Event]:
        """Decode what was taken, and take what the decoder held back; nothing will follow."""
        return self.catch_up() + self._record(self.chain.finish())

    def _record(self, events: list[Event]) -> list[Event]:
        for event in events:
            self.recorder.write_event(event.to_dict())
        return events
