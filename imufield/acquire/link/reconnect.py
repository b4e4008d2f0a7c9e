"""Open a lost link again, so that a loose plug does not end a session, and watch for silence of one that is there.

That a link is lost, ``serial`` and ``can`` tell; of one that is silent they tell nothing.
"""

from __future__ import annotations

from collections.abc import Callable

from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.errors import LinkError, Reason

RECONNECT_EVERY_S = 0.5  # A plug is back within seconds; opening a port takes some milliseconds.
_BETWEEN_TRIES_S = 0.1  # The caller still sees Ctrl-C and draws its screen.
SILENCE_S = 2.0
"""Real time without a byte after which a person is told: instruments that measure positions send ten times a second or more."""


class ReconnectingLink:
    """Reads a link, and while it is lost tries to open it again.

    Parameters
    ----------
    link : BackgroundLink
    clock : HostClock
    ask : callable
        Called with the first chunk behind a reconnection, in a list where it puts what is to be read instead; refuses another
        instrument.
    """

    def __init__(self, link: BackgroundLink, clock: HostClock, ask: Callable[[list[Chunk]], None]) -> None:
        self.name = link.name
        self._link = link
        self._clock = clock
        self._ask = ask
        self._is_new = False  # Nothing was read since it was opened again.
        self._next_try_s = 0.0
        self._now_s = self._heard_s = clock.monotonic_s()  # Of the newest read, and of the newest with data.
        self._there_s = self._now_s  # The time without a link is no silence of the instrument.
        self._pauses_s = 0.0  # Those that have ended, together.
        self.lost: LinkError | None = None  # Why nothing arrives; None while the link is there.

    @property
    def is_silent(self) -> bool:
        """Whether the link is there and nothing arrives."""
        return self._now_s - max(self._heard_s, self._there_s) > patience_s(self._clock, SILENCE_S)

    @property
    def pause_s(self) -> float:
        """Time for which nothing has arrived, whether the link is there or not; 0 while it is too short to count."""
        pause_s = self._now_s - self._heard_s
        return pause_s if pause_s > patience_s(self._clock, SILENCE_S) else 0.0

    @property
    def pauses_s(self) -> float:
        """All pauses together, that under way among them."""
        return self._pauses_s + self.pause_s

    def read(self) -> Chunk | None:
        """Return the next chunk, None if nothing came for a moment.

        Raises
        ------
        LinkError
            The port is there again and cannot be used, or another instrument is on it: waiting would not help.
        """
        chunk, now_s = self._read(), self._clock.monotonic_s()
        if chunk is not None:
            self._pauses_s, self._heard_s = self.pauses_s, now_s
        self._now_s = now_s
        if self.lost is not None:
            self._there_s = self._now_s
        return chunk

    def _read(self) -> Chunk | None:
        if self.lost is None:
            try:
                chunk = self._link.read()
                if chunk is None or not self._is_new:
                    return chunk
                self._ask_behind(chunk)
            except LinkError as error:
                if error.reason is Reason.FOREIGN:
                    raise
                self.lost, self._next_try_s = error, self._clock.monotonic_s()
            return None
        now_s = self._clock.monotonic_s()
        if now_s < self._next_try_s:
            self._clock.sleep(_BETWEEN_TRIES_S)
        elif self._link.reopen():
            self.lost, self._is_new = None, True
        else:
            self._next_try_s = now_s + RECONNECT_EVERY_S
        return None

    def _ask_behind(self, first: Chunk) -> None:
        """Ask who is there when it sends, and not before: an instrument that starts hears nothing yet."""
        chunks, self._is_new = [first], False
        try:
            self._ask(chunks)
        except LinkError as error:
            if error.reason is Reason.FOREIGN:
                raise
            # The link is lost behind what was read.
            self._link.put_back([error])
        except KeyboardInterrupt:
            self._link.put_back(chunks)
            raise
        self._link.put_back(chunks)
