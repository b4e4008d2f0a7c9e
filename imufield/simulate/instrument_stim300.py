"""A STIM300 whose sample rate can be set in utility mode (TS1524 rev. 31, section 10); written from the datasheet alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.samples import Samples, SampleUnits
from imufield.simulate.devices import COMMAND_END, Stim300Device, utility_message
from imufield.simulate.encode import Stim300Format
from imufield.simulate.instruments import FORCE_M_S2, RATE_RAD_S, TEMPERATURE_DEGC, ScriptedInstrument

_RATES_HZ = (125, 250, 500, 1000, 2000)


class Stim300Instrument(ScriptedInstrument):
    """Normal mode with its questions, and utility mode with the sample rate."""

    def __init__(self, rate_hz: float = 250) -> None:
        super().__init__(rate_hz)
        self._device = Stim300Device(Stim300Format(rate_hz=rate_hz, accelerometer_range_g=30))

    def sample(self, number: int, time_s: float) -> bytes:
        """Return one datagram; its counter follows from the number and the rate."""
        one = Samples(
            np.array([time_s]),
            np.array([FORCE_M_S2]),
            np.array([RATE_RAD_S]),
            np.array([TEMPERATURE_DEGC]),
            np.array([number]),
            np.zeros(1, dtype=np.uint32),
            SampleUnits(),
        )
        return self._device.encode(one).data.tobytes()

    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:
        command, end, rest = heard.partition(COMMAND_END)
        return (command.strip(b"\n"), rest) if end else (None, heard)

    def _answer(self, command: bytes) -> bytes:
        text = command.decode("ascii", "replace")
        if not self._device.streaming and text == utility_message("$save").decode().strip():
            self.memory_writes.append(command)
        if not self._device.streaming and text.startswith("$sm,"):
            return self._set_rate(text)
        answer = self._device.answer(command).data
        self.streaming = self._device.streaming
        return answer

    def _set_rate(self, text: str) -> bytes:
        code = text.split(",")[1]
        if utility_message(f"$sm,{code}") != text.encode() + COMMAND_END or code not in tuple("01234"):
            return utility_message("#sm,5")
        self.rate_hz = _RATES_HZ[int(code)]
        self._device = Stim300Device(replace(self._device.format, rate_hz=self.rate_hz))
        self._device.answer(b"UTILITYMODE")
        return utility_message("#sm,0")
