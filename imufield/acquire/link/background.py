"""Read a link in a background thread, so that no byte is lost while the program is busy, and open a lost one again.

The system keeps about 68 KiB of a serial port: at 80 kB/s that is less than a second, and a terminal that is stopped
(Ctrl-S, a slow remote connection) or a long computation may take longer. Chunks keep the arrival time they had.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

from imufield.acquire.link.host_clock import HostClock
from imufield.acquire.link.serial import WAIT_S, Chunk, Link
from imufield.errors import LinkError, Reason

LONGEST_BACKLOG = 50 * 600
"""Chunks: ten minutes of 50 a second; beyond it the thread waits, and the system's buffer overflows as it would without."""

RECONNECT_EVERY_S = 0.5  # A plug is back within seconds; opening a port takes some milliseconds.
_BETWEEN_TRIES_S = 0.1  # The caller still sees Ctrl-C and draws its screen.


class ReopenableLink(Link, Protocol):
    """A link that can be opened again after it was lost."""

    def reopen(self) -> bool:
        """Try to open it again; False while it is not there."""
        ...


class BackgroundLink:
    """Reads another link ahead.

    Parameters
    ----------
    link : ReopenableLink
        Open; nobody else may read it from now on.
    """

    def __init__(self, link: ReopenableLink) -> None:
        self.name = link.name
        self._link = link
        self._arrived: queue.Queue[Chunk | Exception] = queue.Queue(LONGEST_BACKLOG)
        self._put_back: list[Chunk | Exception] = []
        self._stopping = threading.Event()
        self._thread = self._started()

    def read(self) -> Chunk | None:
        """Return the next chunk, or None if nothing came within 50 ms.

        Raises
        ------
        LinkError
            The link is gone; everything that arrived before was returned.
        """
        try:
            item = self._put_back.pop(0) if self._put_back else self._arrived.get(timeout=WAIT_S)
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def drain(self) -> list[Chunk]:
        """Return at once what has arrived and was not read yet; an error among it is left out."""
        items, self._put_back = self._put_back, []
        with suppress(queue.Empty):
            while True:
                items.append(self._arrived.get_nowait())
        return [item for item in items if isinstance(item, Chunk)]

    def put_back(self, items: Sequence[Chunk | Exception]) -> None:
        """Return these again, in front of what follows; an error among them is raised in its turn."""
        self._put_back = [*items, *self._put_back]

    def write(self, data: bytes) -> None:
        """Send a command; raises as the link does."""
        self._link.write(data)

    def reopen(self) -> bool:
        """Try to open the link again after it was lost; raises as the link does."""
        self._stop()
        if not self._link.reopen():
            return False
        self._thread = self._started()
        return True

    def close(self) -> None:
        """Give the link back; may be called again."""
        # The thread first: a link that is closed while it reads fails in ways of its own.
        self._stop()
        self._link.close()

    def _started(self) -> threading.Thread:
        self._stopping.clear()
        thread = threading.Thread(target=self._run, name=f"reader of {self.name}", daemon=True)
        thread.start()
        return thread

    def _stop(self) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                chunk = self._link.read()
                if chunk is not None:
                    self._put(chunk)
        # Whatever it is, ``read`` raises it: an error that ended only this thread would leave the reader waiting for ever.
        except Exception as error:  # noqa: BLE001
            self._put(error)

    def _put(self, item: Chunk | Exception) -> None:
        while True:
            with suppress(queue.Full):
                self._arrived.put(item, timeout=WAIT_S)
                return
            # Nobody takes chunks any more when the thread is to end; what there is room for, ``drain`` finds.
            if self._stopping.is_set():
                return


class PatientLink:
    """Reads a link, and while it is lost tries to open it again, so that a loose plug does not end a session.

    Parameters
    ----------
    link : BackgroundLink
    clock : HostClock
    ask : callable
        Called with the first chunk behind a reconnection, in a list where it puts what is to be read instead; refuses another
        instrument.
    """

    def __init__(self, link: BackgroundLink, clock: HostClock, ask: Callable[[list[Chunk]], None]) -> None:
        self._link = link
        self._clock = clock
        self._ask = ask
        self._is_new = False  # Nothing was read since it was opened again.
        self._next_try_s = 0.0
        self.lost: LinkError | None = None  # Why nothing arrives; None while the link is there.

    def read(self) -> Chunk | None:
        """Return the next chunk, None if nothing came for a moment.

        Raises
        ------
        LinkError
            The port is there again and cannot be used, or another instrument is on it: waiting would not help.
        """
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
