"""Xsens / Movella MTi on a serial port, MTData2."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from typing import ClassVar

from imufield.acquire.driver import Ability, Command, Driver, Evidence, Message, checksum_of

_SUM = partial(checksum_of, "SUM-8/NEGATED")
# Message identifiers; each answer has the next one.
REQUEST_DEVICE_ID = 0x00
GO_TO_MEASUREMENT = 0x10
REQUEST_FIRMWARE = 0x12
REQUEST_PRODUCT_CODE = 0x1C
GO_TO_CONFIG = 0x30


class XsensMtData2(Driver):
    """Xsens MTi 1, 10, 100, 300, 600 and 700 series, in measurement mode.

    Every number is big-endian.

    ==========  ==============================================================
    bytes       content
    ==========  ==============================================================
    0           0xFA
    1           bus id, 0xFF of a single unit
    2           message id, 0x36 for data
    3           length of the data; 255: the two bytes behind have it
    from 4      packets: id (2 bytes), size (1), values
    last        makes the sum of all bytes but the first zero
    ==========  ==============================================================

    The two lowest bits of a packet's id tell the number format: float32, fixed 12.20, fixed 16.32 (fraction first), float64.
    Messages with GNSS data alone come in between, with an older time; they are no samples. Nor are messages with HR outputs
    alone, which have rates of their own, unless these are chosen (``--set accelerometer_output=high_rate --set
    gyroscope_output=high_rate``).
    """

    name = "xsens_mtdata2"
    title = "Xsens MTi"
    protocol = "xsens_mtdata2"
    bauds = (115200, 921600, 460800, 230400, 2000000, 57600)
    wiring = "by model: USB, RS-232, RS-422, RS-485 or UART (3.3 V logic)"
    status = "verified on real bytes"
    manual = "Xsens MT0101P, MT Low Level Communication Protocol Documentation: Xbus messages, MTData2"
    abilities: ClassVar[Mapping[Ability, Evidence]] = {
        "identify": "verified on real bytes",
        "start and stop": "verified on real bytes",
    }
    no_rate = "an MTi keeps its rate in memory that outlives the power, which imufield never writes"

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the requests, which are valid in configuration state alone, with the way there and back."""
        return [
            *cls.stop_orders(),
            request("device_id", REQUEST_DEVICE_ID, "device_id"),
            request("product_code", REQUEST_PRODUCT_CODE, "product_code"),
            request("firmware", REQUEST_FIRMWARE, "firmware_revision"),
            *cls.start_orders(()),
        ]

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return GoToMeasurement."""
        return [request("GoToMeasurement", GO_TO_MEASUREMENT, "go_to_measurement_done", is_last=True)]

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:
        """Return GoToConfig."""
        return [request("GoToConfig", GO_TO_CONFIG, "go_to_config_done")]

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return product code, device id and firmware."""
        found: dict[str, str] = {}
        for message in messages:
            if message["kind"] == "device_id":
                found["serial_number"] = message["device_id"].upper()
            elif message["kind"] == "product_code":
                found["model"] = message["product_code"].strip()
            elif message["kind"] == "firmware_revision":
                found["firmware"] = ".".join(str(message[part]) for part in ("major", "minor", "revision"))
        return found


def request(name: str, message_id: int, answer: str, data: bytes = b"", *, is_last: bool = False) -> Command:
    """Return a message to the instrument, answered by a message called ``answer`` or by an error."""
    body = bytes([0xFF, message_id, len(data)]) + data
    return Command(
        name=name,
        data=b"\xfa" + body + bytes([_SUM(body)]),
        answer=lambda message: message["kind"] in (answer, "error"),
        refusal=_refusal,
        is_last=is_last,
    )


def _refusal(answer: Message) -> str:
    return f"error {answer['code']}" if answer["kind"] == "error" else ""


DRIVER = XsensMtData2
