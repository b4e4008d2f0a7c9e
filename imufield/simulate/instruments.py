"""Instruments that can be told what to do: commands in, answers and samples out, settings that are lost at power-off.

They lie still on a table. What a family answers is written from the facts of its wire and independently of its driver, so
that each can test the other; what would be written to memory that outlives the power is counted, not done.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from imufield.simulate.port import PseudoTerminal

SLICE_S = 0.004
"""Between two looks at the port."""
FORCE_M_S2 = (0.12, -0.23, 9.79)
RATE_RAD_S = (0.001, -0.002, 0.0005)
TEMPERATURE_DEGC = 25.5
_LONGEST_COMMAND = 4096
_LATEST_S = 0.25
"""Samples that are later than this are left out, as by an instrument whose host sleeps."""


class ScriptedInstrument(ABC):
    """One instrument without its port.

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
    def sample(self, number: int, time_s: float) -> bytes:
        """Return the bytes of one sample.

        Parameters
        ----------
        number : int
            Of the sample.
        time_s : float
            Since power-on.
        """

    @abstractmethod
    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:
        """Return the first whole command, None where there is none, and what follows."""

    @abstractmethod
    def _answer(self, command: bytes) -> bytes:
        """Carry out one command and return the answer."""


class InstrumentOnPort:
    """Runs an instrument on a pseudo-terminal in real time, inside ``with``.

    Parameters
    ----------
    instrument : ScriptedInstrument
    deaf : bool
        The wire to the instrument is not connected.
    """

    def __init__(self, instrument: ScriptedInstrument, *, deaf: bool = False) -> None:
        self.instrument = instrument
        self._deaf = deaf
        self._terminal = PseudoTerminal()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="instrument", daemon=True)

    @property
    def port(self) -> str:
        """What a host opens."""
        return self._terminal.port

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._stopping.set()
        self._thread.join()
        self._terminal.close()

    def _run(self) -> None:
        start_s = time.monotonic()
        due_s, number = 0.0, 0
        while not self._stopping.wait(SLICE_S):
            now_s = time.monotonic() - start_s
            heard = self._terminal.read()
            data = b"" if self._deaf else self.instrument.hear(heard)
            due_s = max(due_s, now_s - _LATEST_S) if self.instrument.streaming else now_s
            while self.instrument.streaming and due_s <= now_s:
                data += self.instrument.sample(number, due_s)
                due_s += 1 / self.instrument.rate_hz
                number += 1
            if data:
                self._terminal.write(data)
