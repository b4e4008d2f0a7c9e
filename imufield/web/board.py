"""What the pages show: written by the guide, read by any number of pages, each at its own pace.

A writer never waits for a page. A page that was away, or is too slow, is given everything anew; the others what has changed
since their last message, which is encoded once for all of them.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from itertools import dropwhile

Json = dict[str, object]


class Board:
    """The newest state and what led to it.

    Parameters
    ----------
    head : dict
        What does not change: session, instrument, positions.
    trace_blocks, log_lines : int
        How many are kept for a page that comes.
    """

    def __init__(self, head: Json, *, trace_blocks: int, log_lines: int) -> None:
        self._head = head
        # Entered itself: a condition is entered by Python code, where an interrupt could leave the lock held for ever.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._version = -1  # Nothing to show yet: a page that comes waits for the first state.
        self._state: Json = {}
        self._map: tuple[int, Json] = (-1, {})
        self._trace: deque[tuple[int, object]] = deque(maxlen=trace_blocks)
        self._log: deque[tuple[int, object]] = deque(maxlen=log_lines)
        self._encoding = threading.Lock()
        self._encoded: tuple[tuple[int, int], str] = ((-1, -1), "")

    def put(
        self,
        state: Json,
        *,
        positions: Json | None = None,
        trace: list[object] | None = None,
        log: list[object] | None = None,
    ) -> None:
        """Show a new state, and add what has happened; ``positions`` only where they have changed."""
        with self._lock:
            self._version += 1
            self._state = state
            if positions is not None and positions != self._map[1]:
                self._map = (self._version, positions)
            self._trace.extend((self._version, block) for block in trace or ())
            self._log.extend((self._version, line) for line in log or ())
            self._changed.notify_all()

    def wait(self, seen: int, timeout_s: float) -> tuple[int, str | None]:
        """Return the newest version and the message to a page that has seen another; None where nothing is new.

        Parameters
        ----------
        seen : int
            Version of the last message; -1 for a page that comes.
        timeout_s : float
        """
        with self._lock:
            if seen == self._version:
                self._changed.wait(timeout_s)
            if seen == self._version:
                return seen, None
            asked, message = (seen, self._version), self._message(seen)
        # Behind the lock of those who write, who wait for no page.
        with self._encoding:
            if self._encoded[0] != asked:
                self._encoded = asked, json.dumps(message, allow_nan=False, separators=(",", ":"))
            return asked[1], self._encoded[1]

    def _message(self, seen: int) -> Json:
        """Return what is new since ``seen``; everything where that is no longer known."""
        # A block that was pushed out since then is missing in the middle of a page's trace.
        is_whole = seen < 0 or any(
            len(kept) == kept.maxlen and kept[0][0] > seen + 1 for kept in (self._trace, self._log) if kept
        )
        seen = -1 if is_whole else seen
        message: Json = {"state": self._state, "version": self._version}
        if is_whole:
            message["head"] = self._head
        if self._map[0] > seen:
            message["map"] = self._map[1]
        for name, kept in (("trace", self._trace), ("log", self._log)):
            new = [value for _, value in dropwhile(lambda entry: entry[0] <= seen, kept)]
            if new:
                message[name] = new
        return message
