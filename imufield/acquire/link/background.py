"""Read a link in a background thread, so that no byte is lost while the program is busy.

The system keeps about 68 KiB of a serial port: at 80 kB/s that is less than a second, and a terminal that is stopped
(Ctrl-S, a slow remote connection) or a long computation may take longer. Chunks keep the arrival time they had.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.serial import WAIT_S, Link

LONGEST_BACKLOG = 50 * 600
"""Chunks: ten minutes of 50 a second; beyond it the thread waits, and the system's buffer overflows as it would without."""


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
        # Not written in Python, as a Queue is: an interrupt inside that could leave its lock held for ever.
        self._arrived: queue.SimpleQueue[Chunk | Exception] = queue.SimpleQueue()
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
        # Nobody takes chunks any more when the thread is to end; what there is room for, ``drain`` finds.
        while self._arrived.qsize() >= LONGEST_BACKLOG:
            if self._stopping.wait(WAIT_S):
                return
        self._arrived.put(item)
