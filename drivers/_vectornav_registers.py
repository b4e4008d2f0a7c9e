"""Registers of VectorNav sensors, read and written by lines of text whatever the sensor sends otherwise.

``$VNRRG,number*XX`` reads, ``$VNWRG,number,values*XX`` writes, and both answer with the line that holds the values; ``$VNERR``
refuses. XX is the XOR of what stands between dollar and star. What is written lasts until reset or power-off unless
``$VNWNV`` is sent, which imufield never does (UM001, system module).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from imufield.acquire.checksum import make_checksum
from imufield.acquire.exchange import Command, Message

BINARY_OUTPUTS = (75, 76, 77)
_MODEL, _SERIAL, _FIRMWARE = 1, 3, 4
_XOR = make_checksum("XOR-8")


def read(number: int) -> Command:
    """Return the question for a register."""
    return _command(f"register {number}", f"VNRRG,{number:02d}", "VNRRG", number)


def write(number: int, *values: object) -> Command:
    """Return the order to set a register."""
    return _command(f"set register {number}", ",".join(["VNWRG", f"{number:02d}", *map(str, values)]), "VNWRG", number)


def pause(name: str, *, paused: bool) -> Command:
    """Return the order to stop asynchronous output or to go on with it; the registers stay as they are."""
    return _command(name, f"VNASY,{int(not paused)}", "VNASY", int(not paused), is_last=not paused)


def who_are_you() -> Sequence[Command]:
    """Return the questions for model, serial number and firmware."""
    return [read(_MODEL), read(_SERIAL), read(_FIRMWARE)]


def identity(messages: Iterable[Message]) -> dict[str, str]:
    """Return what answers tell of model, serial number and firmware."""
    held = list(messages)
    names = {"model": _MODEL, "serial_number": _SERIAL, "firmware": _FIRMWARE}
    return {name: values[0] for name, number in names.items() if (values := values_of(held, number))}


def values_of(messages: Iterable[Message], number: int) -> list[str]:
    """Return the values of a register by the newest answer that has it."""
    found: list[str] = []
    for message in messages:
        if message["kind"] in ("VNRRG", "VNWRG") and _is_about(message, number):
            found = message["text"].split(",")[2:]
    return found


def _command(name: str, text: str, answer: str, number: int, *, is_last: bool = False) -> Command:
    def answers(message: Message) -> bool:
        return message["kind"] == "VNERR" or (message["kind"] == answer and _is_about(message, number))

    return Command(name, sentence(text), answers, _refusal, is_last)


def sentence(text: str) -> bytes:
    """Return a line with its checksum."""
    return f"${text}*{_XOR.of(text.encode()):02X}\r\n".encode()


def _is_about(message: Message, number: int) -> bool:
    register = [*message["text"].split(","), ""][1]
    return register.isdecimal() and int(register) == number


def _refusal(answer: Message) -> str:
    return answer["text"] if answer["kind"] == "VNERR" else ""
