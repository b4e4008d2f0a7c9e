"""The commanded side of an instrument: commands in, answers out, settings that are lost at power-off.

What a family answers is written from the facts of its wire and independently of its driver, so that each can test the other.
Writes to memory that outlives the power are counted, not carried out. The samples are made elsewhere, from the protocol.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

_LONGEST_COMMAND = 4096  # Bytes kept while waiting for the end of a command: many times the longest of any family.


class ScriptedInstrument(ABC):
    """The commanded side of one instrument.

    Attributes
    ----------
    rate_hz : float
        Output rate now.
    streaming : bool
        Whether it sends samples by itself.
    memory_writes : list of bytes
        Commands that would have changed memory that outlives the power.
    """

    sync = b""
    """First bytes of a command."""
    length_at = 0
    """Place of the byte that counts the data of a command."""
    overhead = 0
    """Bytes of a command besides its data."""

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.streaming = True
        self.memory_writes: list[bytes] = []
        self._received = b""

    def receive(self, data: bytes) -> bytes:
        """Carry out the commands in the bytes of the host; return the answers."""
        self._received = (self._received + data)[-_LONGEST_COMMAND:]
        answers = b""
        while True:
            command, self._received = self._cut(self._received)
            if command is None:
                return answers
            if command:
                answers += self._answer(command)

    def _cut(self, received: bytes) -> tuple[bytes | None, bytes]:
        """Return the first whole command, None where there is none, empty in place of a damaged one; and what follows."""
        begin = received.find(self.sync)
        if begin < 0 or len(received) < begin + self.overhead:
            return None, received
        end = begin + self.overhead + received[begin + self.length_at]
        if len(received) < end:
            return None, received
        # The search goes on one byte behind the start of a damaged command: a good one may begin within it.
        whole = self._is_whole(received[begin:end])
        return (received[begin:end], received[end:]) if whole else (b"", received[begin + 1 :])

    def _is_whole(self, command: bytes) -> bool:  # noqa: ARG002  for families without a checksum
        """Return whether the checksum is right."""
        return True

    @abstractmethod
    def _answer(self, command: bytes) -> bytes:
        """Carry out one command and return the answer."""


class NoCommands(ScriptedInstrument):
    """An instrument that takes no commands."""

    def receive(self, data: bytes) -> bytes:  # noqa: ARG002  commands are ignored
        """Return nothing."""
        return b""

    def _answer(self, command: bytes) -> bytes:  # noqa: ARG002  commands are ignored
        return b""


def nearest(rates_hz: Iterable[float], rate_hz: float) -> float:
    """Return the rate that an instrument tells while it is emulated at one it does not have."""
    return min(rates_hz, key=lambda listed_hz: abs(listed_hz - rate_hz))
