"""MicroStrain (HBK, formerly LORD) inertial sensors, MIP."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from typing import ClassVar

from imufield.acquire.driver import BY_DOCUMENT, Ability, Command, Driver, Evidence, Message, checksum_of, choose_divisor

_SUMS = partial(checksum_of, "FLETCHER-16/MOD-256")
# Descriptor sets of commands, and the kinds of messages that answer them.
BASE = 0x01
SETTINGS = 0x0C
_KINDS = {BASE: "base", SETTINGS: "settings"}
# What a command of settings does with them; saving them (3) is not here on purpose.
_APPLY = 1
_READ = 2
_IMU_SET = 0x80  # Descriptor set of inertial data, which newer commands name.
# Commands by their descriptors: base, settings of the GX5 generation, settings of newer ones.
_IDLE = 0x02
_DEVICE_INFORMATION = 0x03
_RESUME = 0x06
_IMU_BASE_RATE = 0x06
_IMU_FORMAT = 0x08
_SET_BASE_RATE = 0x0E
_SET_FORMAT = 0x0F
_INERTIAL = (0x04, 0x05, 0x07, 0x08)  # Descriptors of acceleration, rate, delta theta and delta velocity.


class MicroStrainMip(Driver):
    """MicroStrain 3DM-GX4, GX5, CV5, CV7, GQ7 and others that speak MIP.

    Every number is big-endian.

    ==========  ==============================================================
    bytes       content
    ==========  ==============================================================
    0, 1        0x75 0x65
    2           descriptor set, 0x80 for inertial data
    3           length of the payload
    from 4      fields: length (1 byte, it counts itself), descriptor (1), values
    last 2      two running sums modulo 256 over all bytes before
    ==========  ==============================================================

    Acceleration is in g, delta velocity in g s. A packet of set 0x80 without acceleration and rate is no sample; one that an
    event sent (field 0xD0) is flagged and enters no mean. The temperatures of field 0x14 are statistics since power-on, so
    samples have none.
    """

    name = "microstrain_mip"
    title = "MicroStrain 3DM series (MIP)"
    protocol = "microstrain_mip"
    bauds = (115200, 921600, 460800, 230400, 57600, 19200, 9600)
    wiring = "by model: USB, RS-232 or UART (3 V logic)"
    status = "verified on real bytes"
    manual = "LORD MicroStrain, 3DM-GX5-25 Data Communications Protocol manual: MIP packets, IMU data set"
    abilities: ClassVar[Mapping[Ability, Evidence]] = {**BY_DOCUMENT, "start and stop": "verified on real bytes"}

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the question for the device information."""
        return [command("device information", BASE, _DEVICE_INFORMATION)]

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the questions for base rate and message format, of the newer and of the GX5 generation, in idle."""
        return [
            *cls.stop_orders(),
            command("base rate", SETTINGS, _SET_BASE_RATE, bytes([_IMU_SET])),
            command("format", SETTINGS, _SET_FORMAT, bytes([_READ, _IMU_SET])),
            command("base rate", SETTINGS, _IMU_BASE_RATE),
            command("format", SETTINGS, _IMU_FORMAT, bytes([_READ])),
            *cls.start_orders(()),
        ]

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:
        """Return base rate by decimation of the first inertial field."""
        base_hz, _, fields = _format(state)
        return next((base_hz / decimation for number, decimation in fields if number in _INERTIAL and decimation), None)

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:
        """Return the format with another decimation for every field that goes with the acceleration."""
        base_hz, _, fields = _format(state)
        wanted = choose_divisor(cls.title, rate_hz, base_hz)
        # Fields with another decimation, as of a magnetometer, are no part of the samples.
        old = next((decimation for number, decimation in fields if number in _INERTIAL), 0)
        return _set_format(state, [(number, wanted if decimation == old else decimation) for number, decimation in fields])

    @classmethod
    def restore_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the format as it was."""
        return _set_format(state, _format(state)[2])

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return resume."""
        return [command("resume", BASE, _RESUME, is_last=True)]

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:
        """Return idle."""
        return [command("idle", BASE, _IDLE)]

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return model name and number, serial number and firmware of the device information."""
        for message in messages:
            if "model_name" in message:
                model = f"{message['model_name'].strip()} {message['model_number'].strip()}".strip()
                firmware = f"{message['firmware'] // 1000}.{message['firmware'] // 100 % 10}.{message['firmware'] % 100:02d}"
                return {"model": model, "serial_number": message["serial_number"].strip(), "firmware": firmware}
        return {}


def command(name: str, descriptor_set: int, number: int, data: bytes = b"", *, is_last: bool = False) -> Command:
    """Return a packet with one command, answered by the acknowledgement of it."""
    # Payload and field have the same length: there is one field, and it counts its own two bytes.
    body = bytes([0x75, 0x65, descriptor_set, len(data) + 2, len(data) + 2, number]) + data
    return Command(
        name=name,
        data=body + _SUMS(body).to_bytes(2, "big"),
        answer=lambda message: message["kind"] == _KINDS[descriptor_set] and message.get("answered_command") == number,
        refusal=lambda answer: f"error {answer['error']}" if answer["error"] else "",
        is_last=is_last,
    )


def _format(state: Sequence[Message]) -> tuple[int, int, list[tuple[int, int]]]:
    """Return base rate, the command that holds the format, and its fields as (descriptor, decimation)."""
    base_hz, holder, fields = 0, 0, b""
    for answer in state:
        # A unit answers the commands of its generation and refuses the others.
        if not answer.get("error") and not fields:
            base_hz = answer.get("base_rate_hz", answer.get("imu_base_rate_hz", base_hz))
            holder = answer["answered_command"]
            fields = bytes.fromhex(answer.get("fields", answer.get("imu_fields", "")))
    return base_hz, holder, [(fields[at], fields[at + 1] << 8 | fields[at + 2]) for at in range(0, len(fields) - 2, 3)]


def _set_format(state: Sequence[Message], fields: list[tuple[int, int]]) -> Sequence[Command]:
    holder = _format(state)[1]
    data = bytes([_APPLY, *([_IMU_SET] if holder == _SET_FORMAT else []), len(fields)])
    data += b"".join(bytes([number, decimation >> 8, decimation & 0xFF]) for number, decimation in fields)
    return [*MicroStrainMip.stop_orders(), command("set format", SETTINGS, holder, data), *MicroStrainMip.start_orders(())]


DRIVER = MicroStrainMip
