"""What instruments answer: commands in, answers out, settings that are lost at power-off.

What a family answers is written from the facts of its wire and independently of its driver, so that each can test the other;
what would be written to memory that outlives the power is counted, not done. What it sends by itself is made elsewhere, from
its protocol.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

_LONGEST_COMMAND = 4096


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

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.streaming = True
        self.memory_writes: list[bytes] = []
        self._heard = b""

    def hear(self, data: bytes) -> bytes:
        """Take what the host sent; return what is answered."""
        self._heard = (self._heard + data)[-_LONGEST_COMMAND:]
        answers = b""
        while True:
            command, self._heard = self._cut(self._heard)
            if command is None:
                return answers
            answers += self._answer(command)

    @abstractmethod
    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:
        """Return the first whole command, None where there is none, and what follows."""

    @abstractmethod
    def _answer(self, command: bytes) -> bytes:
        """Carry out one command and return the answer."""


class NoCommands(ScriptedInstrument):
    """An instrument that cannot be told anything."""

    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:  # noqa: ARG002  nothing is heard
        return None, b""

    def _answer(self, command: bytes) -> bytes:  # noqa: ARG002  nothing is heard
        return b""


def nearest(rates_hz: Iterable[float], rate_hz: float) -> float:
    """Return the rate that an instrument tells while it is emulated at one it does not have."""
    return min(rates_hz, key=lambda one: abs(one - rate_hz))
