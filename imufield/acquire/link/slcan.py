"""An slcan adapter through python-can, read in blocks: a call to the system for each byte takes a third of a core."""

from __future__ import annotations

import math
import time

from can.exceptions import CanOperationError, error_check
from can.interfaces.slcan import slcanBus

LINE_LIMIT_BYTES = 147
"""The longest line of an adapter: letter, 8 digits of an identifier, size, 64 bytes in hex, 8 digits of a time stamp, CR."""


class SlcanBus(slcanBus):
    """The bus of python-can, but for how it gets its lines."""

    def _read(self, timeout: float | None) -> str | None:
        """Return the next line with its end, None if there is none within the time."""
        end_s = math.inf if timeout is None else time.monotonic() + timeout
        is_over = False
        while (line := self._next_line()) is None and not is_over:
            with error_check("Could not read from serial device"):
                # Waits for the first byte only, for a thousandth of a second by default.
                self._buffer.extend(self.serialPortOrig.read(max(1, self.serialPortOrig.in_waiting)))
            # Whether or not bytes came: those of a wrong baud rate come for ever, and end no line.
            is_over = time.monotonic() >= end_s
        return line

    def _next_line(self) -> str | None:
        ends = [at for mark in (self._OK, self._ERROR) if (at := self._buffer.find(mark)) >= 0]
        if not ends:
            if len(self._buffer) > LINE_LIMIT_BYTES:
                self._buffer.clear()
                raise CanOperationError(f"no end of line within {LINE_LIMIT_BYTES} bytes")
            return None
        line = bytes(self._buffer[: min(ends) + 1])
        del self._buffer[: min(ends) + 1]
        return line.decode()
