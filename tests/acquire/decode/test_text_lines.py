"""Lines of numbers."""

from __future__ import annotations

import gzip
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.decode.text_lines import LONGEST_LINE
from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol, parse_protocol
from imufield.errors import ProtocolError, Reason
from imufield.samples import Samples, Status, concatenate
from tests.acquire.own_protocols import LINES, changed
from tests.refused import refused

GAP = np.uint32(Status.AFTER_GAP)


def decode(data: bytes, **settings: object) -> tuple[Samples, Decoder]:
    """Decode whole, byte by byte and in pieces of 7; all must agree."""
    found = []
    for size in (len(data) + 1, 1, 7):
        decoder = Decoder(load_protocol("text", settings))
        blocks = [decoder.feed(data[at : at + size], 0.0) for at in range(0, len(data), size)]
        found.append((concatenate([*blocks, decoder.flush()]), decoder))
    for samples, decoder in found[1:]:
        np.testing.assert_array_equal(samples.accelerometer, found[0][0].accelerometer)
        np.testing.assert_array_equal(samples.status, found[0][0].status)
        assert decoder.statistics == found[0][1].statistics
    return found[0]


def lines(rows: np.ndarray, delimiter: str = ",", end: str = "\n") -> bytes:
    return "".join(delimiter.join(f"{value:.9g}" for value in row) + end for row in rows).encode()


def table(n: int = 30) -> np.ndarray:
    rows = np.random.default_rng(2).normal(size=(n, 7)).round(6)
    rows[:, 0] = np.arange(n) * 0.01
    return rows


@pytest.mark.parametrize("delimiter", [",", ";", " ", "\t", " , ", "  "])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_delimiters_and_line_ends(delimiter: str, end: str) -> None:
    rows = table()
    samples, decoder = decode(lines(rows, delimiter, end))
    np.testing.assert_allclose(samples.time_s, rows[:, 0], atol=1e-12)
    np.testing.assert_array_equal(samples.accelerometer, rows[:, 1:4])
    np.testing.assert_array_equal(samples.gyroscope, rows[:, 4:7])
    assert not samples.status.any()
    assert decoder.statistics.bytes_skipped == 0


def test_header_comments_and_empty_lines_are_no_loss() -> None:
    rows = table()
    data = b"time,ax,ay,az,gx,gy,gz\n# logger 3\n\n" + lines(rows[:10]) + b"% more\r\n\n" + lines(rows[10:])
    samples, decoder = decode(data)
    assert len(samples) == 30
    assert decoder.statistics.samples_lost == decoder.statistics.gaps == 0
    # A heading and empty lines; comments are understood.
    assert decoder.statistics.bytes_skipped == len(b"time,ax,ay,az,gx,gy,gz\n\n\n")


@pytest.mark.parametrize(
    "bad",
    [
        b"0.1,1,2,3,4,5",
        b"0.1,1,2,3,4,5,6,7",
        b"0.1,1,nan,3,4,5,6",
        b"0.1,1,,3,4,5,6",
        b"0.1,1,2,x,4,5,6",
        b"1_0,1,2,3,4,5,6",
        b"0.1,1,inf,3,4,5,6",
        b"\xff\x00\x93",
        b"0.1,1,1e999,3,4,5,6",
    ],
)
def test_a_bad_line_is_a_gap(bad: bytes) -> None:
    rows = table()
    samples, decoder = decode(lines(rows[:10]) + bad + b"\n" + lines(rows[11:]))
    assert len(samples) == 29
    assert np.flatnonzero(samples.status & GAP).tolist() == [10]
    assert decoder.statistics.samples_lost == 1
    assert decoder.statistics.bytes_skipped == len(bad) + 1


def test_a_bad_line_is_a_gap_without_a_clock_too() -> None:
    rows = table()[:, 1:4]
    samples, decoder = decode(lines(rows[:10]) + b"?\n?\n" + lines(rows[10:]), columns="ax,ay,az")
    assert decoder.statistics.samples_lost == 2
    assert np.flatnonzero(samples.status & GAP).tolist() == [10]
    assert (samples.status & np.uint32(Status.TIME_ESTIMATED)).all()
    assert samples.time_s[10] - samples.time_s[9] == pytest.approx(0.03)
    assert np.isnan(samples.gyroscope).all()


def test_prefix_and_checksum() -> None:
    body = [f"$IMU,{i},1,2,{i}.5".encode() for i in range(20)]
    sums = [b"*%02X\r\n" % reduce(xor, text[1:]) for text in body]
    sums[7] = b"*00\r\n"
    data = b"$GPGGA,1,2,3,4*00\r\n" + b"".join(a + b for a, b in zip(body, sums, strict=True)) + b"$OTHER,1,2,3,4\r\n"
    samples, decoder = decode(data, prefix="$IMU", columns="counter,ax,ay,az")
    assert samples.accelerometer[:, 2].tolist() == [i + 0.5 for i in range(20) if i != 7]
    assert samples.counter.tolist() == [i for i in range(20) if i != 7]
    assert decoder.statistics.samples_lost == 1
    assert decoder.statistics.frames_bad_checksum == 2


def test_units_scientific_notation_and_columns_to_pass_over() -> None:
    data = b"".join(b"%d 7 1e0 -2E+0 +3. 9e1 0 -18e1 21.5\n" % (1000 + 5 * i) for i in range(20))
    columns = "time,-,ax,ay,az,gx,gy,gz,temperature"
    samples, decoder = decode(data, columns=columns, time_unit="ms", accelerometer_unit="g", gyroscope_unit="deg/s")
    np.testing.assert_allclose(samples.accelerometer[3], np.array([1, -2, 3]) * 9.80665)
    np.testing.assert_allclose(samples.gyroscope[3], [np.pi / 2, 0, -np.pi])
    assert samples.temperature_degc[3] == 21.5
    assert samples.time_s[0] == 1.0
    assert decoder.statistics.nominal_rate_hz == pytest.approx(200)


def test_pulse_counts_as_increments() -> None:
    data = b"".join(b"%d;%d;%d;%d\n" % (i % 1000, 10000 + i, 2, 3) for i in range(990, 1020))
    samples, decoder = decode(
        data,
        columns="counter,ax,ay,az",
        counter_modulus="1000",
        accelerometer_unit="pulse",
        gyroscope_unit="pulse",
        increments="true",
        rate_hz="50",
        raw_zero=10000,
    )
    assert samples.units.accelerometer == "pulse"
    assert samples.units.accelerometer_is_increment
    assert samples.accelerometer_rate()[0].tolist() == [10990 * 50, 100, 150]
    np.testing.assert_allclose(np.diff(samples.time_s), 0.02)
    assert decoder.statistics.samples_lost == 0
    assert decoder.protocol.nominal.raw_zero.tolist() == [10000] * 3


def test_decimal_commas_between_semicolons() -> None:
    samples, _ = decode(b"".join(b"%d,5;1,25;-2,5;3\n" % i for i in range(12)), columns="time,ax,ay,az")
    assert samples.accelerometer[0].tolist() == [1.25, -2.5, 3]
    assert samples.time_s[1] == 1.5


def test_an_endless_line_is_passed_over_in_bounded_memory() -> None:
    rows = table()
    noise = b"\x00" * (3 * LONGEST_LINE)
    data = lines(rows[:15]) + noise + b"\n" + lines(rows[16:])
    decoder = Decoder(load_protocol("text"))
    counts = [len(decoder.feed(data[at : at + 1000])) for at in range(0, len(data), 1000)]
    assert sum(counts) == 29
    assert decoder.statistics.samples_lost == 1
    assert decoder.statistics.bytes_skipped == len(noise) + 1


def test_missing_temperature_is_not_a_gap() -> None:
    samples, decoder = decode(b"".join(b"%d,1,2,3,\n" % i for i in range(10)), columns="time,ax,ay,az,temperature")
    assert len(samples) == 10
    assert np.isnan(samples.temperature_degc).all()
    assert decoder.statistics.gaps == 0


def test_the_last_line_needs_no_end() -> None:
    samples, _ = decode(lines(table())[:-1])
    assert len(samples) == 30


@pytest.mark.parametrize(
    ("settings", "reason", "facts"),
    [
        ({"columns": "time,ax,ay"}, Reason.USAGE, ("columns", "az")),
        ({"columns": "time,ax,ay,az,ax"}, Reason.USAGE, ("columns", "'ax'")),
        ({"columns": "time,ax,ay,az,wx"}, Reason.USAGE, ("columns", "'wx'")),
        ({"delimiter": "dot"}, Reason.USAGE, ("delimiter", "'dot'", "auto, comma")),
        ({"increments": True}, Reason.BAD_PROTOCOL, ("samples.accelerometer", "m/s^2")),
        ({"rate_hz": -1}, Reason.USAGE, ("rate_hz", "-1", "0.001")),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, object], reason: Reason, facts: tuple[str, ...]) -> None:
    with refused(ProtocolError, reason, *facts):
        load_protocol("text", settings)


def own(data: str, *changes: tuple[str, str]) -> tuple[Samples, Decoder]:
    """Decode lines by a protocol file of a user's own."""
    decoder = Decoder(parse_protocol(changed(LINES, *changes)))
    return concatenate([decoder.feed(data.encode()), decoder.flush()]), decoder


def test_values_stand_in_the_order_that_fields_tell() -> None:
    samples, _ = own(
        "0,1,2,3,4,5,6,20\n", ('["ax", "ay", "az"]', '["ay", "az", "ax"]'), ('["gx", "gy", "gz"]', '["gz", "gx", "gy"]')
    )
    np.testing.assert_allclose(samples.accelerometer, np.array([[2, 3, 1]]) * 9.80665)
    np.testing.assert_allclose(samples.gyroscope, np.radians([[6, 4, 5]]))


def test_a_scale_of_the_temperature_counts() -> None:
    samples, _ = own("0,1,2,3,4,5,6,255\n", ('unit = "degC"', 'unit = "degC", scale = 0.1'))
    assert samples.temperature_degc.tolist() == [25.5]


@pytest.mark.parametrize(("modulus", "first"), [(", modulus = 65536", 32700), (", modulus = 1000", 700), ("", 65500)])
def test_counters_of_lines_have_a_sign_or_never_wrap(modulus: str, first: int) -> None:
    numbers = [first + n for n in range(200) if n != 100]
    if modulus == ", modulus = 65536":
        # An int of an Arduino.
        numbers = [(number + 32768) % 65536 - 32768 for number in numbers]
    if modulus == ", modulus = 1000":
        numbers = [number % 1000 for number in numbers]
    data = "".join(f"{number},0,0,1,0,0,0,20\n" for number in numbers)
    samples, decoder = own(data, (", modulus = 65536", modulus))
    assert (len(samples), decoder.statistics.samples_lost) == (199, 1)
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx(1.99)


def test_a_real_logger(shared_folder: Path) -> None:
    data = gzip.decompress((shared_folder / "data/mikoff/imu0.log.gz").read_bytes())
    decoder = Decoder(load_protocol("text", {"columns": "ax,ay,az,gx,gy,gz", "rate_hz": 100}))
    samples = concatenate([decoder.feed(data), decoder.flush()])
    reference = np.array(data.split(), dtype=np.float64).reshape(-1, 6)
    np.testing.assert_array_equal(np.hstack([samples.accelerometer, samples.gyroscope]), reference)
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx((len(reference) - 1) / 100)


@pytest.mark.parametrize("garbage", [b"3\n", b"7;\xff\x00;1\n", b"a;b 5\n", bytes(range(256)) + b"\n", b"1;2;3;4;5;6\n" * 3])
def test_foreign_bytes_teach_no_delimiter(garbage: bytes) -> None:
    line = b"0.01,0.1,0.2,9.8,0.0,0.0,0.0\n"
    decoder = Decoder(load_protocol("text"))
    decoder.feed(garbage + 50 * line + garbage + 50 * line, 0.0)
    decoder.flush()
    assert decoder.statistics.samples == 100


@pytest.mark.parametrize("size", [LONGEST_LINE, LONGEST_LINE + 1, 2 * LONGEST_LINE])
def test_a_long_line_is_the_same_in_pieces(size: int) -> None:
    data = b"0.01,0.1,0.2,9.8,0.0,0.0,0.0\n" * 20
    data += b"x" * size + b"\n" + data
    lost = []
    for step in (len(data), 7):
        decoder = Decoder(load_protocol("text", {"columns": "-,ax,ay,az,gx,gy,gz"}))
        for at in range(0, len(data), step):
            decoder.feed(data[at : at + step], 0.0)
        decoder.flush()
        lost.append((decoder.statistics.samples, decoder.statistics.samples_lost))
    assert lost[0] == lost[1]


def test_times_in_nanoseconds_since_1970_are_times() -> None:
    decoder = Decoder(load_protocol("text", {"columns": "time,ax,ay,az", "time_unit": "ns"}))
    begin_ns = 1_800_000_000_000_000_000
    lines = "".join(f"{begin_ns + 10_000_000 * number},0.1,0.2,9.8\n" for number in range(50))
    samples = concatenate([decoder.feed(lines.encode(), 0.0), decoder.flush()])
    assert len(samples) == 50
    # A double knows such a time to 256 ns.
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01, atol=6e-7)
