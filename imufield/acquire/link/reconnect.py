"""Open a lost link again, so that a loose plug does not end a session."""

from __future__ import annotations

from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.host_clock import HostClock
from imufield.acquire.link.serial import Chunk
from imufield.errors import LinkError

RECONNECT_EVERY_S = 0.5  # A plug is back within seconds; opening a port takes some milliseconds.
_WAIT_S = 0.1  # Between two tries the caller still sees Ctrl-C and draws its screen.


class PatientLink:
    """Reads a link, and while it is lost tries to open it again.

    Parameters
    ----------
    link : BackgroundLink
    clock : HostClock
    """

    def __init__(self, link: BackgroundLink, clock: HostClock) -> None:
        self._link = link
        self._clock = clock
        self._next_try_s = 0.0
        self.lost: LinkError | None = None  # Why nothing arrives; None while the link is there.

    def read(self) -> Chunk | None:
        """Return the next chunk, None if nothing came for a moment.

        Raises
        ------
        LinkError
            The port is there again and cannot be used: waiting would not help.
        """
        if self.lost is None:
            try:
                return self._link.read()
            except LinkError as error:
                self.lost, self._next_try_s = error, self._clock.monotonic_s()
                return None
        now_s = self._clock.monotonic_s()
        if now_s < self._next_try_s:
            self._clock.sleep(_WAIT_S)
        elif self._link.reopen():
            self.lost = None
        else:
            self._next_try_s = now_s + RECONNECT_EVERY_S
        return None
