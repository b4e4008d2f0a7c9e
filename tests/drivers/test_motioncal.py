"""Lines as the sketches for MotionCal print them, by hand, and what probing makes of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.baud_search import listener_of, serial_candidates
from imufield.acquire.instrument.recognise import Listener, best
from imufield.acquire.link.serial import Chunk
from imufield.acquire.registry import load_driver
from imufield.samples import concatenate
from imufield.simulate.emulator.emulate import Emulation, choose_wire, make_device, make_virtual_imu

G = 9.80665
# 1 g is 8192, 1 deg/s is 16, 0.1 uT is 1 (MotionCal, imuread.h); the second line is what Adafruit's sketch prints of the same.
SAMPLE = b"Raw:36,-72,8412,-8,0,-3,-415,-310,687\r\nUni:0.04,-0.09,10.06,-0.0087,0.0000,-0.0033,-41.50,-31.00,68.70\r\n"


def test_numbers_by_hand() -> None:
    decoder = Decoder(load_driver("motioncal").load_protocol())
    data = SAMPLE + b"Raw:8192,0,0,16,-16,32,0,0,0\r\nCal1:0.000,0.000\r\n"
    samples = concatenate([decoder.feed(data, 0.0), decoder.flush()])
    np.testing.assert_allclose(
        samples.accelerometer, np.array([[36.0, -72.0, 8412.0], [8192.0, 0.0, 0.0]]) * G / 8192, rtol=1e-12
    )
    np.testing.assert_allclose(samples.gyroscope, np.array([[-0.5, 0.0, -0.1875], [1.0, -1.0, 2.0]]) * np.pi / 180, rtol=1e-12)
    assert (decoder.statistics.samples_lost, decoder.statistics.gaps, decoder.statistics.bytes_skipped) == (0, 0, 0)


@pytest.mark.parametrize("g_m_s2", [9.80665, 9.8])
def test_one_g_is_what_the_sketch_takes_for_it(g_m_s2: float) -> None:
    # Adafruit's sketch divides by 9.8, MotionCal counts in standard gravity.
    decoder = Decoder(load_driver("motioncal").load_protocol({"g_m_s2": g_m_s2}))
    samples = concatenate([decoder.feed(b"Raw:8192,-4096,0,0,0,0,0,0,0\r\n", 0.0), decoder.flush()])
    np.testing.assert_allclose(samples.accelerometer, [[g_m_s2, -g_m_s2 / 2, 0.0]], rtol=1e-12)


@pytest.mark.parametrize("bad", [b"Raw:36,-72,8412,-8,0,-3,-415,-310\r\n", b"Raw:36,-72,x,-8,0,-3,-415,-310,687\r\n"])
def test_a_line_that_is_not_whole_is_no_sample(bad: bytes) -> None:
    decoder = Decoder(load_driver("motioncal").load_protocol())
    assert len(concatenate([decoder.feed(SAMPLE + bad + SAMPLE, 0.0), decoder.flush()])) == 2
    assert decoder.statistics.gaps == 1


def test_the_emulator_prints_such_lines() -> None:
    options = Emulation(device="motioncal", grade="mems")
    wire = choose_wire(options)
    frames = make_device(options, wire).encode(make_virtual_imu(options, wire.rate_hz).next_block(1))
    line = frames.data.tobytes()
    assert line.startswith(b"Raw:")
    assert line.endswith(b",0,0,0\r\n")
    assert [int(cell) for cell in line[4:].split(b",")]


@pytest.mark.parametrize("repeat", [SAMPLE, SAMPLE.split(b"Uni")[0]])
def test_it_is_recognised_among_all_others(repeat: bytes) -> None:
    listeners: list[Listener] = [listener_of(candidate, is_given=False) for candidate in serial_candidates()]
    for number in range(100):
        for listener in listeners:
            listener.feed(Chunk(repeat, 0.01 * number, 0))
    for listener in listeners:
        listener.close()
    found = best(listeners)
    assert found is not None
    assert found.candidate.name == "motioncal"
    assert found.finding().share == pytest.approx(1.0)
    norm = found.finding().norm_m_s2
    assert norm is not None
    assert math.isclose(norm, G * 8412 / 8192, rel_tol=1e-3)
