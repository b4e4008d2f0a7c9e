"""An slcan adapter through python-can, read in blocks: a call to the system for each byte takes a third of a core."""

from __future__ import annotations

import time

from can.exceptions import error_check
from can.interfaces.slcan import slcanBus


class SlcanBus(slcanBus):
    """The bus of python-can, but for how it gets its lines."""

    def _read(self, timeout: float | None) -> str | None:
        """Return the next line with its end, None if there is none within the time."""
        end_s = None if timeout is None else time.monotonic() + timeout
        while (line := self._next_line()) is None:
            with error_check("Could not read from serial device"):
                # Waits for the first byte only, for a thousandth of a second by default.
                data = self.serialPortOrig.read(max(1, self.serialPortOrig.in_waiting))
            self._buffer.extend(data)
            if not data and end_s is not None and time.monotonic() >= end_s:
                return None
        return line

    def _next_line(self) -> str | None:
        ends = [at for mark in (self._OK, self._ERROR) if (at := self._buffer.find(mark)) >= 0]
        if not ends:
            return None
        line = bytes(self._buffer[: min(ends) + 1])
        del self._buffer[: min(ends) + 1]
        return line.decode()
