"""Registers of VectorNav sensors, read and written by lines of text whatever the sensor sends otherwise.

``$VNRRG,number*XX`` reads, ``$VNWRG,number,values*XX`` writes, and both answer with the line that holds the values; ``$VNERR``
refuses. XX is the XOR of what stands between dollar and star. What is written lasts until reset or power-off unless
``$VNWNV`` is sent, which imufield never does (UM001, system module). Which of them set the
output rate is in ``vectornav_binary`` and ``vectornav_ascii``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import partial

from imufield.acquire.driver import BY_DOCUMENT, Command, Driver, Message, checksum_of

BINARY_OUTPUTS = (75, 76, 77)  # Each configures one of the three messages that can be sent at once.
MODEL = 1
_SERIAL = 3
_FIRMWARE = 4
_XOR = partial(checksum_of, "XOR-8")


class VectorNav(Driver):
    """What the forms of VectorNav's output have in common."""

    bauds = (115200, 921600, 460800, 230400, 128000, 57600, 38400, 19200, 9600)
    wiring = "by model: RS-232 (rugged) or UART (3 V logic)"
    abilities = BY_DOCUMENT

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the questions for model, serial number and firmware."""
        return [read(MODEL), read(_SERIAL), read(_FIRMWARE)]

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return model, serial number and firmware as far as the registers were read."""
        answers = list(messages)
        names = {"model": MODEL, "serial_number": _SERIAL, "firmware": _FIRMWARE}
        return {name: values[0] for name, number in names.items() if (values := values_of(answers, number))}

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the end of the pause."""
        return [pause("resume", paused=False)]

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:
        """Return the pause of all asynchronous output."""
        return [pause("pause", paused=True)]


def read(number: int) -> Command:
    """Return the question for a register."""
    return _command(f"register {number}", f"VNRRG,{number:02d}", "VNRRG", number)


def write(number: int, *values: object) -> Command:
    """Return the order to set a register."""
    return _command(f"set register {number}", ",".join(["VNWRG", f"{number:02d}", *map(str, values)]), "VNWRG", number)


def pause(name: str, *, paused: bool) -> Command:
    """Return the order to stop asynchronous output or to go on with it; the registers stay as they are."""
    # The way back is sent even where something before it failed: a unit must not stay paused.
    return _command(name, f"VNASY,{int(not paused)}", "VNASY", int(not paused), is_last=not paused)


def values_of(messages: Iterable[Message], number: int) -> list[str]:
    """Return the values of a register by the newest answer that has it."""
    # The answer to an order repeats what was set, so it is newer than that to the question before.
    found: list[str] = []
    for message in messages:
        if message["kind"] in ("VNRRG", "VNWRG") and _is_about(message, number):
            found = message["text"].split(",")[2:]  # Behind name and number.
    return found


def _command(name: str, text: str, answer: str, number: int, *, is_last: bool = False) -> Command:
    def answers(message: Message) -> bool:
        return message["kind"] == "VNERR" or (message["kind"] == answer and _is_about(message, number))

    return Command(name=name, data=with_checksum(text), answer=answers, refusal=_refusal, is_last=is_last)


def with_checksum(text: str) -> bytes:
    """Return a line with its checksum."""
    return f"${text}*{_XOR(text.encode()):02X}\r\n".encode()


def _is_about(message: Message, number: int) -> bool:
    register = [*message["text"].split(","), ""][1]
    return register.isdecimal() and int(register) == number


def _refusal(answer: Message) -> str:
    return answer["text"] if answer["kind"] == "VNERR" else ""
