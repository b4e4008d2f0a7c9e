"""Damaged streams of every serial form, counted to the last frame; forms without a checksum are excepted and say so."""

from __future__ import annotations

import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.registry import load_driver
from imufield.samples import concatenate
from tests.simulate.accounting import Wire, account_for, has_checksum, random_samples, serial_wires

WIRES = serial_wires()
WITHOUT_CHECKSUM = {
    "text-default": "lines of numbers",
    "motioncal-default": "lines of numbers",
    "witmotion-bluetooth": "no checksum",
    "witmotion-card": "no checksum",
}
CHECKED = [wire for wire in WIRES if str(wire) not in WITHOUT_CHECKSUM]
BY_HOST_TIME = ("vectornav_ascii", "witmotion", "aceinna_serial-S0")
"""Wires with neither time nor counter."""
BY_COUNTER = ("stim300", "kvh_17xx-A", "kvh_17xx-C", "aceinna_serial-S1")
"""Wires whose counter wraps within a second and that have no time."""
DURATION_S = 4.0
"""The slowest wires lose samples in it, the counters of the fast ones wrap several times."""
OUTAGES_S = 12.0
"""With pauses longer than a wrap, of which some must come."""


def test_every_form_is_there() -> None:
    assert len(WIRES) == 39
    assert {str(wire) for wire in WIRES if not has_checksum(wire.choose().protocol)} == set(WITHOUT_CHECKSUM)


def test_forms_without_checksum_say_so() -> None:
    assert "no checksum" in str(load_protocol("witmotion").text)
    assert "checksum" in str(load_driver("text").__doc__)


@pytest.mark.parametrize("wire", CHECKED, ids=str)
def test_every_intact_frame_is_decoded_and_nothing_else(wire: Wire) -> None:
    account = account_for(wire, DURATION_S, seed=3)
    assert account.bits_flipped + account.bytes_lost > 0
    assert account.samples_missed == account.samples_false == 0
    assert account.frames_intact <= account.frames_decoded
    # What stands behind a checksum (an end of line) may be hit and the frame be good all the same.
    assert account.frames_decoded - account.frames_intact <= 0.01 * account.frames_sent
    assert account.frames_intact < account.frames_sent
    if str(wire).startswith(BY_HOST_TIME):
        assert account.flagged_estimated == account.samples_decoded
        assert account.counted_lost <= account.missing
    else:
        assert account.counted_lost == account.missing
        assert account.estimated_lost == account.flagged_estimated == 0


@pytest.mark.parametrize("wire", [wire for wire in CHECKED if str(wire).startswith(BY_COUNTER)], ids=str)
def test_losses_beyond_a_wrap_come_from_host_time_and_are_said_to_be_estimated(wire: Wire) -> None:
    account = account_for(wire, OUTAGES_S, seed=4, outages=True)
    assert account.samples_missed == account.samples_false == 0
    assert account.estimated_lost > 0
    assert account.flagged_estimated > 0
    assert account.counted_lost + account.estimated_lost == account.missing


def test_a_time_stamp_beside_a_counter_shows_whole_wraps() -> None:
    account = account_for(Wire("kvh_17xx", "B"), OUTAGES_S, seed=4, outages=True)
    assert account.counted_lost == account.missing > 300
    assert account.estimated_lost == 0


@pytest.mark.parametrize("wire", [wire for wire in CHECKED if str(wire).startswith(BY_HOST_TIME)], ids=str)
def test_streams_without_time_and_counter_say_that_all_is_estimated(wire: Wire) -> None:
    account = account_for(wire, 3 * OUTAGES_S, seed=4, outages=True)
    assert account.samples_missed == account.samples_false == 0
    assert account.flagged_estimated == account.samples_decoded
    # A pause below a second may be a slow cable, so it is no loss; none is ever invented.
    assert account.counted_lost + account.estimated_lost <= 1.02 * account.missing


FALSE_HEADERS = {
    "aceinna_serial": b"\x55\x55z1\xff",
    "kvh_17xx": b"\xfe\x81\xff\x56",
    "microstrain_mip": b"\x75\x65\x80\xff",
    "novatel_oem7": b"\xaa\x44\x12\x1c\x0c\x01\x00\x00\x00\x3f",
    "novatel_oem7-RAWIMUS": b"\xaa\x44\x13\xff\x45\x01",
    "novatel_oem7_ascii": b"#RAWIMUA,COM1,0,66.5,FINESTEERING,2300,0.000,",
    "sbg_sbgecom": b"\xff\x5a\x03\x00\xf6\x0f",
    "stim300": b"\xf7",
    "vectornav_ascii": b"$VNIMU,+00.1000,",
    "vectornav_binary": b"\xfa\x3f\xff\x7f\xff\x03\xff\x0f\xff\x3f\xff\x07\xff\x07",
    "witmotion-uart": b"\x55\x51",
    "xsens_mtdata2": b"\xfa\xff\x36\xff\x08\x00",
}
"""By the beginning of a wire's name: what announces the longest frame there is."""


@pytest.mark.parametrize("wire", CHECKED, ids=str)
@pytest.mark.parametrize("step", [0, 1, 29], ids=["whole", "byte by byte", "in parts"])
def test_a_false_header_of_a_long_frame_hides_no_good_one(wire: Wire, step: int) -> None:
    choice = wire.choose()
    samples = random_samples(choice.protocol, choice.rate_hz, 0, 10)
    frames = wire.device().encode(samples)
    header = FALSE_HEADERS[max((name for name in FALSE_HEADERS if str(wire).startswith(name)), key=len)]
    data = header + frames.data.tobytes()
    decoder = Decoder(choice.protocol)
    step = step or len(data)
    blocks = [decoder.feed(data[at : at + step]) for at in range(0, len(data), step)]
    got = concatenate([*blocks, decoder.flush()])
    assert decoder.statistics.frames == len(frames.ends)
    assert len(got) == 10
