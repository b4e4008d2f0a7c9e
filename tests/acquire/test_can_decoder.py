"""Packed frames through the whole decoder: cuts, faults, strangers on the bus, floats, multiplexers, noise."""

from __future__ import annotations

import itertools
import random
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imufield.acquire.decode.statistics import LEFT_OUT, DecoderStatistics, remarks
from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.can_map import protocol_from_dbc
from imufield.acquire.protocol.can_frame import ERROR, EXTENDED, FD, REMOTE, Frame, pack_frame
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.samples import Samples, Status, concatenate
from tests.acquire.plain_frames import pack_frames, parse_candump

ACCELERATION, RATE = 0x08F02D80 | EXTENDED, 0x0CF02A80 | EXTENDED
J1939, XSENS, SBG = (load_protocol(name) for name in ("j1939_imu", "xsens_can", "sbg_can"))
MUX = """VERSION ""
BS_:
BU_: A
BO_ 256 Motion: 8 A
 SG_ Page M : 0|2@1+ (1,0) [0|0] "" A
 SG_ Group : 2|6@1+ (1,0) [0|0] "" A
 SG_ AccX m0 : 8|16@1- (0.01,0) [0|0] "m/s^2" A
 SG_ AccY m0 : 24|16@1- (0.01,0) [0|0] "m/s^2" A
 SG_ AccZ m0 : 40|16@1- (0.01,0) [0|0] "m/s^2" A
 SG_ GyroX m1 : 8|13@1- (0.01,0) [0|0] "rad/s" A
 SG_ GyroY m1 : 21|13@1- (0.01,0) [0|0] "rad/s" A
 SG_ GyroZ m1 : 34|13@1- (0.01,0) [0|0] "rad/s" A
"""
WIDE = """VERSION ""
BS_:
BU_: A
BO_ 256 All: 48 A
 SG_ T : 0|64@1+ (1,0) [0|0] "us" A
 SG_ AccX : 64|32@1- (1,0) [0|0] "g" A
 SG_ AccY : 96|32@1- (1,0) [0|0] "g" A
 SG_ AccZ : 128|32@1- (1,0) [0|0] "g" A
 SG_ GyroX : 263|64@0- (1,0) [0|0] "rad/s" A
 SG_ GyroY : 199|32@0- (1,0) [0|0] "rad/s" A
 SG_ GyroZ : 231|32@0- (1,0) [0|0] "rad/s" A

SIG_VALTYPE_ 256 AccX : 1;
SIG_VALTYPE_ 256 AccY : 1;
SIG_VALTYPE_ 256 AccZ : 1;
SIG_VALTYPE_ 256 GyroX : 2;
SIG_VALTYPE_ 256 GyroY : 1;
SIG_VALTYPE_ 256 GyroZ : 1;
"""
MAP = {
    f"{triad}.{axis}": f"{name}{axis.upper()}"
    for triad, name in (("accelerometer", "Acc"), ("gyroscope", "Gyro"))
    for axis in "xyz"
}


def decode(protocol: Protocol, data: bytes, cuts: list[int] | None = None) -> tuple[Samples, DecoderStatistics]:
    decoder = Decoder(protocol)
    edges = [0, *(cuts or []), len(data)]
    blocks = [decoder.feed(data[begin:end], 0.0) for begin, end in itertools.pairwise(edges)]
    return concatenate([*blocks, decoder.flush()]), decoder.statistics


def words(a: int, b: int, c: int, last: int = 0) -> bytes:
    return struct.pack("<HHHBB", a, b, c, last, 0)


def stream(samples: int, address: int = 0x80, seed: int = 0) -> list[Frame]:
    rng = random.Random(seed)
    frames = []
    for number in range(samples):
        for can_id, delay_s in ((ACCELERATION, 0.0), (RATE, 0.00027)):
            data = words(*(rng.randrange(20000, 44000) for _ in range(3)))
            frames.append(Frame(can_id & ~0xFF | address, data, number * 0.01 + delay_s))
    return frames


@pytest.mark.parametrize("seed", range(5))
def test_cuts_do_not_matter(seed: int) -> None:
    rng = random.Random(seed)
    frames = [frame for frame in stream(300) if rng.random() > 0.03]
    frames += [Frame(ERROR | 8, bytes(8), 1.0), Frame(0x123, b"other", 1.0)]
    data = pack_frames(frames)
    whole, first = decode(J1939, data)
    cut, second = decode(J1939, data, sorted(rng.sample(range(len(data)), 60)))
    np.testing.assert_array_equal(whole.accelerometer, cut.accelerometer)
    np.testing.assert_array_equal(whole.gyroscope, cut.gyroscope)
    np.testing.assert_array_equal(whole.status, cut.status)
    np.testing.assert_allclose(whole.time_s, cut.time_s, atol=2e-3)
    assert first.by_kind == second.by_kind
    assert (first.frames, first.bytes_skipped) == (second.frames, second.bytes_skipped)


def unequal(samples: int, each: int, slower: int = RATE, *, offset: int = 0) -> list[Frame]:
    """Return the frames of a bus with one message of ``slower`` to ``each`` of the other kind; values count samples."""
    frames = []
    for number in range(samples):
        for can_id, delay_s in ((ACCELERATION, 0.0), (RATE, 0.00027)):
            if can_id != slower or number % each == offset:
                frames.append(Frame(can_id, words(20000 + number, 32000, 32000), number * 0.005 + delay_s))
    return frames


@pytest.mark.parametrize("each", [2, 3, 5, 10])
def test_a_slower_message_stands_until_the_next(each: int) -> None:
    data = pack_frames(unequal(400, each))
    for cuts in ([], list(range(24, len(data), 24)), list(range(77, len(data), 77))):
        samples, statistics = decode(J1939, data, cuts)
        assert len(samples) == 400
        assert samples.usable.all()
        assert (np.diff(samples.accelerometer[:, 0]) != 0).all(), "the faster one is measured in each sample"
        sent = samples.gyroscope[::each, 0]
        assert (np.diff(sent) != 0).all()
        np.testing.assert_array_equal(samples.gyroscope[:, 0], np.repeat(sent, each)[:400])
        standing = (samples.status & np.uint32(Status.STANDING)) != 0
        assert standing.tolist() == (np.arange(400) % each != 0).tolist()
        assert (statistics.samples_incomplete, statistics.lost) == (0, 0)
        assert statistics.samples_standing == np.count_nonzero(standing)
        assert statistics.nominal_rate_hz == pytest.approx(200.0, rel=1e-3)
        (said,) = [sentence for sentence in remarks([statistics]) if "512" in sentence]
        assert f"{statistics.samples_standing} of 400" in said


def test_the_acceleration_may_be_the_slower_one() -> None:
    samples, statistics = decode(J1939, pack_frames(unequal(400, 2, ACCELERATION)))
    assert len(samples) == 400
    # What comes before the first rate belongs to no sample.
    assert samples.usable[1:-1].all()
    assert statistics.samples_standing == pytest.approx(200, abs=2)
    assert len(set(samples.accelerometer[1:-1, 0].tolist())) == pytest.approx(200, abs=2)


@pytest.mark.parametrize("slower", [RATE, ACCELERATION])
def test_of_two_messages_at_three_to_two_the_faster_one_begins(slower: int) -> None:
    frames = []
    for number in range(1200):
        if number % 2 == 0:
            frames.append(Frame(ACCELERATION + RATE - slower, words(20000 + number, 32000, 32000), number * 0.005 + 0.0003))
        if number % 3 == 0:
            frames.append(Frame(slower, words(20000 + number, 32000, 32000), number * 0.005))
    samples, statistics = decode(J1939, pack_frames(frames))
    assert len(samples) == 600
    assert samples.usable.mean() > 0.98
    assert statistics.by_kind.get(LEFT_OUT, 0) <= 1
    assert statistics.nominal_rate_hz == pytest.approx(100.0, rel=1e-3)


def test_frames_left_out_are_said() -> None:
    assert J1939.can is not None
    begin = next(number for number, kind in enumerate(J1939.can.kinds) if kind.message.can_id & 0xFFFF00 == RATE & 0xFFFF00)
    rule = replace(J1939.can, assembly=replace(J1939.can.assembly, starts_with=begin))
    samples, statistics = decode(replace(J1939, can=rule), pack_frames(unequal(400, 2)))
    assert statistics.by_kind[LEFT_OUT] == pytest.approx(400 - len(samples), abs=2)
    (said,) = remarks([statistics])
    assert f"{statistics.by_kind[LEFT_OUT]} frames" in said
    assert f"{len(samples)} samples" in said
    assert "starts_with" in said


def test_a_message_too_rare_to_stand_is_said_with_the_remedy() -> None:
    _, statistics = decode(J1939, pack_frames(unequal(2000, 40)))
    (said,) = remarks([statistics])
    assert re.search(r"1950\b.*\b2000\b.*98 %", said)
    assert "starts_with" in said


def test_a_slower_message_that_is_lost_stands_no_longer_than_its_turn() -> None:
    frames = unequal(400, 2)
    lost = next(place for place, frame in enumerate(frames) if frame.can_id == RATE and frame.time_s > 1.0)
    number = round(frames[lost].time_s / 0.005)
    samples, statistics = decode(J1939, pack_frames(frames[:lost] + frames[lost + 1 :]))
    assert np.flatnonzero(~samples.usable).tolist() == [number, number + 1]
    assert statistics.samples_incomplete == 2


def test_messages_lost_at_random_do_not_stand() -> None:
    rng = random.Random(5)
    frames = [frame for frame in stream(600) if frame.can_id == ACCELERATION or rng.random() > 0.4]
    samples, statistics = decode(J1939, pack_frames(frames))
    assert statistics.samples_standing == 0
    assert np.count_nonzero(~samples.usable) == 600 - sum(frame.can_id == RATE for frame in frames)


@pytest.mark.parametrize("seed", range(4))
def test_cuts_do_not_matter_where_frames_are_stamped_as_they_are_read(seed: int) -> None:
    rng = random.Random(seed)
    frames, now_s = [], 0.0
    for frame in stream(600, seed=seed):
        # A host that looks now and then, whose looks part the messages of one sample; some are lost.
        now_s = max(now_s, frame.time_s + (rng.uniform(0.01, 0.08) if rng.random() < 0.2 else 0.0))
        if rng.random() > 0.02:
            frames.append(Frame(frame.can_id, frame.data, now_s))
    data = pack_frames(frames)
    whole, statistics = decode(J1939, data)
    for size in (24, 77, 480, 4800):
        parts, counts = decode(J1939, data, list(range(size, len(data), size)))
        assert counts.samples == statistics.samples
        assert counts.lost == statistics.lost
        np.testing.assert_array_equal(parts.accelerometer, whole.accelerometer)
        np.testing.assert_array_equal(parts.gyroscope, whole.gyroscope)
        np.testing.assert_allclose(parts.time_s, whole.time_s, atol=2e-3)
        np.testing.assert_array_equal(parts.status, whole.status)


def test_byte_by_byte() -> None:
    data = pack_frames(stream(40))
    whole, _ = decode(J1939, data)
    bytewise, _ = decode(J1939, data, list(range(1, len(data))))
    np.testing.assert_array_equal(whole.accelerometer, bytewise.accelerometer)
    np.testing.assert_array_equal(whole.gyroscope, bytewise.gyroscope)


def test_codes_become_gaps() -> None:
    frames = stream(200)
    frames[20] = Frame(ACCELERATION, words(0x8000, 0xFFFF, 0x8000), frames[20].time_s)
    frames[41] = Frame(RATE, words(0xFE01, 0x8000, 0x8000), frames[41].time_s)
    frames[60] = Frame(ACCELERATION, words(0x8000, 0x8000, 0x8000, last=0b100000), frames[60].time_s)
    samples, _ = decode(J1939, pack_frames(frames))
    assert len(samples) == 200
    assert np.isnan(samples.accelerometer[10]).tolist() == [False, True, False]
    assert np.isnan(samples.gyroscope[20]).tolist() == [True, False, False]
    usual = Status.TIME_ESTIMATED
    assert samples.status[10] == usual | Status.ACCELEROMETER_INVALID
    assert samples.status[20] == usual | Status.GYROSCOPE_INVALID | Status.INSTRUMENT_FAULT
    assert samples.status[30] == usual | Status.ACCELEROMETER_INVALID, "figure of merit says error"
    assert samples.usable.sum() == 197


def test_short_frames_are_refused_and_counted() -> None:
    frames = stream(100)
    frames[50] = Frame(ACCELERATION, frames[50].data[:5], frames[50].time_s)
    samples, statistics = decode(J1939, pack_frames(frames))
    assert len(samples) == 99
    assert statistics.by_kind["AccelerationSensor, too short"] == 1
    assert statistics.by_kind["without a sample"] == 1
    assert statistics.frames_bad_checksum == 1
    assert statistics.losses_estimated == 1
    assert np.flatnonzero(samples.status & Status.GAP_ESTIMATED).tolist() == [25]


def test_strangers_on_the_bus() -> None:
    rng = random.Random(3)
    own = stream(200)
    strangers = [
        Frame(
            rng.choice((0x123, 0x18FEF100 | EXTENDED, RATE ^ 0x100, RATE & ~EXTENDED & 0x7FF)),
            rng.randbytes(8),
            rng.random() * 2,
        )
        for _ in range(500)
    ]
    remote = Frame(ACCELERATION | REMOTE, b"", 0.5)
    mixed = sorted([*own, *strangers, remote], key=lambda frame: frame.time_s)
    samples, statistics = decode(J1939, pack_frames(mixed))
    alone, _ = decode(J1939, pack_frames(own))
    np.testing.assert_array_equal(samples.accelerometer, alone.accelerometer)
    np.testing.assert_array_equal(samples.gyroscope, alone.gyroscope)
    assert statistics.by_kind["other"] == 501


def test_two_instruments_are_not_mixed() -> None:
    first, second = stream(100, 0x80, 1), stream(100, 0xE2, 2)
    mixed = sorted([*first, *second], key=lambda frame: frame.time_s)
    alone, _ = decode(J1939, pack_frames(first))
    samples, _ = decode(J1939, pack_frames(mixed))
    np.testing.assert_array_equal(samples.accelerometer, alone.accelerometer)
    chosen, _ = decode(load_protocol("j1939_imu", {"source_address": 0xE2}), pack_frames(mixed))
    other, _ = decode(J1939, pack_frames(second))
    np.testing.assert_array_equal(chosen.gyroscope, other.gyroscope)


def test_messages_of_identity() -> None:
    decoder = Decoder(J1939)
    version = parse_candump("18FEDA80#1301330002")
    decoder.feed(pack_frames([*stream(5), version]))
    (message,) = decoder.messages()
    assert message["kind"] == "SoftwareVersion"
    assert (message["VersionMajor"], message["VersionMinor"], message["VersionPatch"]) == (19, 1, 51)
    assert message["source_address"] == 0x80
    assert decoder.messages() == []


def test_multiplexed_messages_are_joined_by_their_counter(tmp_path: Path) -> None:
    (tmp_path / "mux.dbc").write_text(MUX)
    protocol = protocol_from_dbc(
        tmp_path / "mux.dbc", {**MAP, "counters": "Group", "starts_with": "Motion[0]", "limit_s": "0.02"}
    )
    frames = []
    for number in range(100):
        count = number % 64 << 2
        acceleration = struct.pack("<Bhhhx", count, number, -number, 981)
        bits = (number & 0x1FFF) | (-number & 0x1FFF) << 13 | 500 << 26
        rate = struct.pack("<B", count | 1) + bits.to_bytes(7, "little")
        page2 = struct.pack("<Bhhhx", count | 2, 1, 2, 3)
        pair = [
            Frame(256, acceleration, number * 0.01),
            Frame(256, page2, number * 0.01),
            Frame(256, rate, number * 0.01 + 0.001),
        ]
        frames += pair[::-1] if number % 3 == 0 else pair
    samples, statistics = decode(protocol, pack_frames(frames))
    np.testing.assert_allclose(samples.accelerometer, [[0.01 * n, -0.01 * n, 9.81] for n in range(100)])
    np.testing.assert_allclose(samples.gyroscope, [[0.01 * n, -0.01 * n, 5.0] for n in range(100)])
    assert statistics.by_kind["Motion[0]"] == statistics.by_kind["Motion[1]"] == statistics.by_kind["other"] == 100


def test_all_forms_of_a_message_that_is_needed_are_needed(tmp_path: Path) -> None:
    (tmp_path / "mux.dbc").write_text(MUX)
    protocol = protocol_from_dbc(tmp_path / "mux.dbc", {**MAP, "counters": "Group", "needs": "Motion"})
    frames = []
    for number in range(100):
        count = number % 64 << 2
        frames.append(Frame(256, struct.pack("<Bhhhx", count, 1, 2, 3), number * 0.01))
        if number != 50:
            frames.append(Frame(256, struct.pack("<Bq", count | 1, 0)[:8], number * 0.01 + 0.001))
    samples, _ = decode(protocol, pack_frames(frames))
    assert len(samples) == 99
    assert np.isfinite(samples.gyroscope).all()


def test_wide_frames_of_can_fd(tmp_path: Path) -> None:
    (tmp_path / "wide.dbc").write_text(WIDE)
    protocol = protocol_from_dbc(tmp_path / "wide.dbc", {**MAP, "time": "T"})
    frames = []
    for number in range(100):
        data = struct.pack("<Qfff", 1_000_000 + number * 2500, 0.5, number, -1.0)
        data = data.ljust(24, b"\0") + struct.pack(">ffd", number + 0.25, 0.125, -number)
        frames.append(Frame(256, data.ljust(48, b"\0"), 0.0, FD))
    samples, statistics = decode(protocol, pack_frames(frames), [100, 1000, 1001])
    np.testing.assert_allclose(samples.accelerometer / 9.80665, [[0.5, n, -1.0] for n in range(100)])
    np.testing.assert_allclose(samples.gyroscope, [[-n, n + 0.25, 0.125] for n in range(100)])
    np.testing.assert_allclose(samples.time_s, 1.0 + np.arange(100) * 0.0025)
    assert statistics.samples_lost == 0
    assert statistics.nominal_rate_hz == pytest.approx(400)
    assert not samples.status.any()


def test_floats_that_are_no_numbers(tmp_path: Path) -> None:
    protocol = load_protocol("racelogic_can")
    frames = []
    for number in range(50):
        bad = b"\x7f\xa0\x00\x01" if number == 20 else struct.pack(">f", 1.0)
        for can_id, data in (
            (0x600, struct.pack(">ff", 10.0, 0.5)),
            (0x601, struct.pack(">ff", 0.25, 25.0)),
            (0x602, struct.pack(">ff", 1.0, 2.0)),
            (0x603, bad),
        ):
            frames.append(Frame(can_id, data, number * 0.01 + (can_id & 3) * 2e-4))
    samples, _ = decode(protocol, pack_frames(frames))
    assert len(samples) == 50
    assert np.isnan(samples.accelerometer[20]).tolist() == [False, False, True]
    assert samples.status[20] & Status.ACCELEROMETER_INVALID
    # Racelogic's axes are x forward, y to the left, z up; its pitch is positive with the nose up, its yaw clockwise from above.
    np.testing.assert_allclose(np.degrees(samples.gyroscope[0]), [2.0, -1.0, -10.0])
    assert samples.temperature_degc[0] == 25.0


@given(st.binary(max_size=1200), st.integers(1, 300))
@settings(max_examples=150, deadline=None)
def test_noise_is_no_samples(data: bytes, step: int) -> None:
    decoder = Decoder(J1939)
    for at in range(0, len(data), step):
        decoder.feed(data[at : at + step])
    decoder.flush()
    assert decoder.statistics.samples == 0
    assert decoder.statistics.bytes_total == len(data)


@given(
    st.lists(
        st.tuples(
            st.sampled_from([ACCELERATION, RATE, 0x18FEDA80 | EXTENDED, ERROR, 5, 6, 0x11, 0x32, 0x34, 0x120, 0x121, 0x122]),
            st.binary(max_size=8),
            st.floats(),
        ),
        max_size=80,
    )
)
@settings(max_examples=200, deadline=None)
def test_any_frames_at_any_time(frames: list[tuple[int, bytes, float]]) -> None:
    for protocol in (J1939, XSENS, SBG):
        decoder = Decoder(protocol)
        samples = decoder.feed(b"".join(pack_frame(*frame) for frame in frames))
        last = decoder.flush()
        times = np.concatenate([samples.time_s, last.time_s])
        assert np.isfinite(times).all()
        assert (np.diff(times) >= 0).all()
