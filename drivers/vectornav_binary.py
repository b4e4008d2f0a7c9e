"""VectorNav VN-100, VN-200 and VN-300, binary output.

The frame is in ``protocols/vectornav_binary.toml``. As for every protocol, ``imufield.acquire.protocol.layout`` reads its
values and ``imufield.acquire.decode.frame_source`` makes samples of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import ClassVar

from imufield.acquire.driver import Command, Message, choose_divisor

from ._vectornav_registers import BINARY_OUTPUTS, MODEL, VectorNav, read, values_of, write

# Binary outputs divide the inner rate of the sensor, which its model tells.
_IMU_HZ = 400
_IMU_HZ_VN100 = 800


class VectorNavBinary(VectorNav):
    """VectorNav binary output messages.

    Numbers are little-endian, the checksum is not.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0       0xFA
    1       groups, one bit each
    from 2  for each group a mask of 16 bits, one for each field
    then    the fields, by group, then by bit
    last 2  CRC-16 of all but the first byte, high byte first
    ======  ==============================================================

    The message carries no length, so one with an unknown field in its group mask cannot be decoded. z points down, so a
    level unit at rest shows about -9.8 m/s^2 there.
    """

    name = "vectornav_binary"
    title = "VectorNav VN-100/200/300, binary"
    protocol = "vectornav_binary"
    status = "verified on real bytes"
    manual = "VectorNav UM001, VN-100 User Manual rev. 2.22: binary output messages"
    # Registers are answered in text, whatever the samples are sent in.
    answers = "vectornav_ascii"
    variants: ClassVar[tuple[Mapping[str, object], ...]] = ({"source": "compensated"},)

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the questions for the model, which has the inner rate, and for the three binary outputs."""
        return [read(MODEL), *(read(number) for number in BINARY_OUTPUTS)]

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:
        """Return the rate of the first output that is on."""
        return next((_imu_hz(state) / int(values[1]) for _, values in _outputs(state)), None)

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:
        """Return the orders that set the divisor of every output that is on, until reset or power-off."""
        divisor = choose_divisor(cls.title, rate_hz, _imu_hz(state))
        return [write(number, values[0], divisor, *values[2:]) for number, values in _outputs(state)]

    @classmethod
    def restore_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the outputs as they were read."""
        return [write(number, *values) for number, values in _outputs(state)]


def _imu_hz(state: Sequence[Message]) -> int:
    model = values_of(state, MODEL) or [""]
    return _IMU_HZ_VN100 if model[0].startswith("VN-100") else _IMU_HZ


def _outputs(state: Sequence[Message]) -> list[tuple[int, list[str]]]:
    """Return number and values (ports, divisor, groups, masks) of the outputs that are on."""
    found = [(number, values_of(state, number)) for number in BINARY_OUTPUTS]
    return [
        (number, values)
        for number, values in found
        if len(values) > 1 and values[0] != "0" and values[1].strip("0").isdecimal()
    ]


DRIVER = VectorNavBinary
