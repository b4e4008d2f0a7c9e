"""What is read of a link while it is recorded: to the disk first, then through the chain."""

from __future__ import annotations

from dataclasses import dataclass

from imufield.acquire.decoded_session import UNPLUGGED
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.recording.recorder import Recorder
from imufield.guide.events import Event
from imufield.pipeline.chain import Chain


@dataclass(frozen=True, slots=True, kw_only=True)
class Intake:
    """The way of every chunk of a capture and of a plain recording."""

    recorder: Recorder
    chain: Chain
    stream: SameStream
    """Hears the samples of the chain."""

    def take(self, chunk: Chunk) -> list[Event]:
        """Record a chunk and return what the guide says of it.

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
        return self.chain.feed(chunk.data, chunk.monotonic_s, chunk.utc_ns)

    def link_lost(self) -> list[Event]:
        """Read anew what comes, and record that: the guide says it only where that is new to it."""
        self.recorder.write_event({"event": UNPLUGGED})
        events = self.chain.link_lost()
        self.stream.begin()
        return events
