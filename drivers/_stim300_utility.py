"""Utility mode of the STIM300: lines of text with a checksum, in which it sends nothing by itself.

The host sends ``$name,value,...,crc`` CR and gets ``#name,status,value,...,crc`` CR; the checksum is a decimal CRC-8 over all
characters up to and including the last comma (TS1524 rev. 31, section 10). Settings last until reset or power-off unless
``$save`` is sent, which imufield never does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from imufield.acquire.driver import Command, Message, checksum_of

_CRC = partial(checksum_of, "CRC-8/SMBUS", start=0xFF)


def enter_utility_mode() -> Command:
    """Return the way from normal mode to utility mode."""
    return Command(name="UTILITYMODE", data=b"UTILITYMODE\r", read=_answer("UTILITYMODE"))


def utility(name: str, *values: object, is_last: bool = False) -> Command:
    """Return a command of utility mode."""
    body = ",".join([f"${name}", *map(str, values)]) + ","
    data = f"{body}{_CRC(body.encode())}\r".encode()
    return Command(name=name, data=data, refusal=_refusal, is_last=is_last, read=_answer(name))


def _refusal(answer: Message) -> str:
    return "" if answer["values"][0] == "0" else f"status {answer['values'][0]}"


def _answer(name: str) -> Callable[[bytes], Message | None]:
    def read(heard: bytes) -> Message | None:
        # What stands behind the last CR is a line that has not ended.
        for line in heard.split(b"\r")[:-1]:
            body, comma, crc = line[line.rfind(b"#") :].rpartition(b",")
            if body.startswith(f"#{name}".encode()) and crc == str(_CRC(body + comma)).encode():
                return {"kind": "utility", "values": body.decode("ascii", "replace").split(",")[1:]}
        return None

    return read
