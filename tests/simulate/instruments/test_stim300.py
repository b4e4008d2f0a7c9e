"""What the emulated instruments answer, as (sent, answered) pairs and by the byte maps of the datasheet."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imufield.samples import SampleUnits, Status, make_samples
from imufield.simulate.instruments.device import Answer
from imufield.simulate.instruments.stim300 import Stim300Device, Stim300Identity, utility_message
from imufield.simulate.wire.stim300 import Stim300Format

LENGTHS = {b"N": 20, b"I": 20, b"C": 26, b"T": 40, b"E": 21}
PLAIN_IDS = {b"N": 0xB1, b"I": 0xB5, b"C": 0xBC, b"T": 0xD1, b"E": 0xBE}
CRLF_IDS = {b"N": 0xB3, b"I": 0xB7, b"C": 0xBD, b"T": 0xD2, b"E": 0xBF}


@pytest.mark.parametrize("command", LENGTHS)
def test_special_datagrams_have_the_lengths_and_ids_of_the_datasheet(command: bytes) -> None:
    plain = Stim300Device(Stim300Format(crlf=False)).answer(command).data
    ended = Stim300Device(Stim300Format(crlf=True)).answer(command).data
    assert (plain[0], len(plain)) == (PLAIN_IDS[command], LENGTHS[command])
    assert (ended[0], len(ended), ended[-2:]) == (CRLF_IDS[command], LENGTHS[command] + 2, b"\r\n")


def test_power_on_tells_part_number_serial_number_and_configuration() -> None:
    device = Stim300Device()
    assert device.power_on() == b"".join(device.answer(command).data for command in (b"N", b"I", b"C"))


def test_serial_number_is_packed_decimal() -> None:
    data = Stim300Device(identity=Stim300Identity(serial_number="25581846020021")).answer(b"I").data
    assert data[1:9] == b"N" + bytes.fromhex("25581846020021")


def test_part_number_digits_lie_where_the_datasheet_has_them() -> None:
    data = Stim300Device(identity=Stim300Identity(part_number="12345-6789AB-CDEF", revision="K")).answer(b"N").data
    nibbles = [nibble for byte in data[1:12] for nibble in (byte >> 4, byte & 15)]
    assert nibbles[1:6] == [1, 2, 3, 4, 5]
    assert data[4:5] == data[8:9] == b"-"
    assert nibbles[8:14] == [6, 7, 8, 9, 10, 11]
    p12, p13, p14, p15, p16, p17 = nibbles[16:22]
    assert [p17, p12 + 16 * p16, p13, p14 + 16 * p15] == [0xC, 0xD, 0xE, 0xF]
    assert data[15:16] == b"K"


def test_configuration_says_how_the_unit_is_set_up() -> None:
    settings = Stim300Format(
        rate_hz=500.0, temperature=True, auxiliary="pps", accelerometer_range_g=30, gyroscope_output="increment"
    )
    data = Stim300Device(settings, baud=1843200).answer(b"C").data
    assert data[3] == 2 << 5 | 0b11111
    assert data[4] >> 4 == 3
    assert data[5] == 0x71
    assert data[14] & 0x08
    assert data[17:19] == bytes([0x44, 0x40])


def test_utility_messages_carry_the_crc_of_the_datasheet(shared_folder: Path) -> None:
    vectors = json.loads((shared_folder / "wire" / "stim300.vectors.json").read_text())
    messages = [bytes.fromhex(vector["hex"]) for vector in vectors if vector.get("kind") == "utility-mode ASCII"]
    assert len(messages) == 13
    for message in messages:
        assert utility_message(message[: message.rfind(b",")].decode()) == message


def test_utility_mode_exchange() -> None:
    device = Stim300Device()
    exchange = [
        (b"UTILITYMODE", b"#UTILITYMODE,234\r"),
        (b"$isn,28", utility_message("#isn,0,N25581846020020")),
        (b"$irng,74", b"#irng,0,400,400,400,10,10,10,1.7,1.7,1.7,NA,61\r"),
        (b"$isn,29", utility_message("#isn,1")),
        (utility_message("$nonsense")[:-1], utility_message("#nonsense,1")),
        (b"N", utility_message("#,1")),
    ]
    for sent, answered in exchange:
        assert device.answer(sent).data == answered
        assert not device.streaming
    assert device.answer(utility_message("$xn")[:-1]).data == b"#xn,0,125\r"
    assert device.streaming


def test_service_mode_exchange() -> None:
    device = Stim300Device()
    exchange = [
        (b"SERVICEMODE", b"\r>", False),
        (b"i s", b"i s\rSERIAL NUMBER = N25581846020020\r>", False),
        (b"m 3", b"m 3\r>", False),
        (b"x n", b"x n\r", True),
    ]
    for sent, answered, streaming in exchange:
        assert device.answer(sent).data == answered
        assert device.streaming is streaming


def test_reset_and_the_unknown() -> None:
    device = Stim300Device()
    assert device.answer(b"R") == Answer(resets=True)
    assert device.answer(b"Q") == device.answer(b"") == Answer()


def test_start_up_shows_full_rate_and_the_bit() -> None:
    status = np.array([Status.START_UP, 0], dtype=np.uint32)
    samples = make_samples(
        np.arange(2.0), np.zeros((2, 3)), np.zeros((2, 3)), units=SampleUnits(), counter=np.arange(2), status=status
    )
    frames = Stim300Device().encode(samples)
    first, second = frames.data.reshape(2, 40)
    # 480 deg/s, as recorded at a real start-up
    assert first[1:4].tobytes() == bytes.fromhex("780000")
    assert first[10] == 0x40
    assert second[1:4].tobytes() == bytes(3)
    assert frames.checksum_at.tolist() == [37, 77]
