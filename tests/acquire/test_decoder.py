"""The decoder on real and made STIM300 streams."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.errors import ProtocolError, Reason
from imufield.samples import Samples, Status, concatenate
from tests.acquire.plain_frames import decode_fields
from tests.refused import refused

MakeDatagram = Callable[..., bytes]
CAPTURE = "captures/stim300/stim300_0x93_crlf_125hz_30g_motion_corrupt_tail_ubc3.bin"


def decode(protocol: Protocol, data: bytes, cuts: list[int] | range = range(0)) -> tuple[Samples, Decoder]:
    decoder = Decoder(protocol)
    edges = [0, *sorted(cuts), len(data)]
    blocks = [decoder.feed(data[a:b]) for a, b in pairwise(edges)]
    return concatenate([*blocks, decoder.flush()]), decoder


def assert_same(one: Samples, other: Samples) -> None:
    for name in ("time_s", "accelerometer", "gyroscope", "temperature_degc", "counter", "status"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.fixture(scope="module")
def vectors(shared_folder: Path) -> list[dict[str, Any]]:
    found = json.loads((shared_folder / "wire/stim300.vectors.json").read_text())
    return [vector for vector in found if vector.get("kind") != "utility-mode ASCII"]


def test_every_vector_field_by_field(vectors: list[dict[str, Any]]) -> None:
    names = {"gyro": "gyroscope", "acc": "accelerometer", "incl": "inclinometer"}
    checked = 0
    for vector in vectors:
        wanted, data = vector["decoded"], bytes.fromhex(vector["hex"])
        protocol = load_protocol("stim300", {"accelerometer_range_g": vector.get("acc_range_g", 10)})
        found = list(decode_fields(protocol, data))
        if not vector.get("valid", True):
            assert found == []
            continue
        ((kind, fields),) = found
        assert kind.upper() == wanted["id"].upper()
        assert fields["counter"] == wanted["counter"]
        assert fields["latency"] == wanted["latency_us"]
        for short, name in names.items():
            if f"{short}_raw" in wanted:
                assert fields[name] == wanted[f"{short}_raw"]
                assert fields[f"{name}_status"] == wanted[f"{short}_status"]
                unit, scaled = ("deg/s", wanted["gyro_dps"]) if short == "gyro" else ("g", wanted[f"{short}_g"])
                if short != "acc" or "acc_range_g" in vector:
                    assert fields[f"{name} [{unit}]"] == scaled
            if f"{short}_temp_c" in wanted:
                assert fields[f"{name}_temperature [degC]"] == wanted[f"{short}_temp_c"]
        if "aux_raw" in wanted:
            assert (fields["auxiliary"], fields["auxiliary_status"]) == (wanted["aux_raw"], wanted["aux_status"])
        checked += 1
    assert checked == 9


def test_vectors_as_samples_are_si(vectors: list[dict[str, Any]]) -> None:
    for vector in vectors:
        wanted = vector["decoded"]
        protocol = load_protocol("stim300", {"accelerometer_range_g": vector.get("acc_range_g", 10)})
        samples, _ = decode(protocol, bytes.fromhex(vector["hex"]))
        assert len(samples) == (1 if vector.get("valid", True) else 0)
        if len(samples) == 0:
            continue
        np.testing.assert_allclose(samples.gyroscope[0], np.radians(wanted["gyro_dps"]), rtol=1e-14)
        if "acc_range_g" in vector:
            np.testing.assert_allclose(samples.accelerometer[0], np.array(wanted["acc_g"]) * 9.80665, rtol=1e-14)
        assert samples.counter[0] == wanted["counter"]
        if "acc_temp_c" in wanted:
            assert samples.temperature_degc[0] == pytest.approx(np.mean(wanted["acc_temp_c"]), abs=1e-12)
        assert samples.status[0] >> 16 == wanted["gyro_status"] | wanted["acc_status"] << 8


def test_first_datagram_after_power_up_is_flagged(vectors: list[dict[str, Any]]) -> None:
    start = next(v for v in vectors if v["decoded"].get("gyro_status") == 255)
    samples, _ = decode(load_protocol("stim300"), bytes.fromhex(start["hex"]))
    flags = Status(int(samples.status[0]) & 0xFFFF)
    # The accelerometer's byte is 0xEF: all but the overload bit.
    assert flags == (
        Status.START_UP
        | Status.INSTRUMENT_FAULT
        | Status.GYROSCOPE_SATURATED
        | Status.GYROSCOPE_INVALID
        | Status.ACCELEROMETER_INVALID
    )
    assert not samples.usable[0]


def test_capture_gives_525_frames_however_it_is_cut(shared_folder: Path) -> None:
    data = (shared_folder / CAPTURE).read_bytes()
    protocol = load_protocol("stim300", {"accelerometer_range_g": 30})
    whole, decoder = decode(protocol, data)
    assert len(whole) == 525
    assert decoder.statistics.by_kind == {"0x93": 525}
    assert decoder.statistics.nominal_rate_hz == 125
    np.testing.assert_allclose(np.diff(whole.time_s), 1 / 125, atol=1e-12)
    still = np.linalg.norm(whole.accelerometer[:20].mean(axis=0)) / 9.80665
    assert still == pytest.approx(1, abs=0.02)
    rng = np.random.default_rng(0)
    for cuts in (range(4000), *(rng.integers(0, len(data), 60).tolist() for _ in range(5))):
        again, other = decode(protocol, data, cuts)
        assert_same(whole, again)
        assert other.statistics == decoder.statistics


def test_status_bits_one_by_one(datagram: MakeDatagram) -> None:
    meaning = {
        (0x80, 0): Status.INSTRUMENT_FAULT,
        (0x40, 0): Status.START_UP,
        (0x10, 0): Status.GYROSCOPE_SATURATED,
        (0x08, 0): Status.GYROSCOPE_INVALID,
        (0x27, 0): Status.GOOD,
        (0, 0x80): Status.INSTRUMENT_FAULT,
        (0, 0x40): Status.START_UP,
        (0, 0x10): Status.ACCELEROMETER_SATURATED,
        (0, 0x08): Status.ACCELEROMETER_INVALID,
    }
    data = b"".join(datagram(i, gyroscope_status=g, accelerometer_status=a) for i, (g, a) in enumerate(meaning))
    samples, _ = decode(load_protocol("stim300"), data)
    for status, ((gyroscope, accelerometer), flag) in zip(samples.status.tolist(), meaning.items(), strict=True):
        assert status & 0xFFFF == flag
        assert status >> 16 == gyroscope | accelerometer << 8


@pytest.mark.parametrize("step", [1, 2, 4, 8, 16])
def test_losses_below_one_wrap_are_exact_at_every_rate(datagram: MakeDatagram, step: int) -> None:
    per_wrap = 256 // step
    kept = [i for i in range(4 * per_wrap + 40) if not (20 <= i < 22 or 30 <= i < 30 + per_wrap - 1)]
    samples, decoder = decode(load_protocol("stim300"), b"".join(datagram(i * step) for i in kept))
    np.testing.assert_allclose(samples.time_s, np.array(kept) * step / 2000, atol=1e-9)
    assert decoder.statistics.samples_lost == 2 + per_wrap - 1
    assert decoder.statistics.gaps == 2
    assert decoder.statistics.nominal_rate_hz == 2000 / step
    gaps = np.flatnonzero(samples.status & np.uint32(Status.AFTER_GAP))
    assert [kept[i] for i in gaps] == [22, 30 + per_wrap - 1]


@pytest.mark.parametrize("range_g", [2, 5, 10, 30, 80])
def test_ranges_and_increments_agree_with_rates(datagram: MakeDatagram, range_g: int) -> None:
    bits = {2: 21, 5: 20, 10: 19, 30: 18, 80: 16}[range_g]
    data = datagram(0, accelerometer=(1 << 16, -(1 << 17), 3), gyroscope=(1 << 14, -(1 << 15), 7))
    rates, _ = decode(load_protocol("stim300", {"accelerometer_range_g": range_g}), data)
    np.testing.assert_allclose(rates.accelerometer[0], np.array([1 << 16, -(1 << 17), 3]) / 2**bits * 9.80665, rtol=1e-15)
    np.testing.assert_allclose(rates.gyroscope[0], np.radians([1.0, -2.0, 7 / 2**14]), rtol=1e-15)
    chosen = {"accelerometer_output": "increment", "gyroscope_output": "increment", "rate_hz": 500}
    protocol = load_protocol("stim300", {"accelerometer_range_g": range_g, **chosen})
    increments, _ = decode(protocol, data)
    assert increments.units.accelerometer == "m/s"
    assert increments.units.gyroscope == "rad"
    assert increments.units.interval_s == 0.002
    np.testing.assert_allclose(
        increments.accelerometer_rate()[0], np.array([1 << 16, -(1 << 17), 3]) / 2 ** (bits + 3) * 500, rtol=1e-15
    )
    np.testing.assert_allclose(
        increments.gyroscope_rate()[0], np.radians(np.array([1 << 14, -(1 << 15), 7]) / 2**21) * 500, rtol=1e-15
    )


def test_increments_without_a_rate_are_refused() -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "clock.rate_hz"):
        load_protocol("stim300", {"accelerometer_output": "increment"})


def test_increments_at_another_rate_than_said_are_refused(datagram: MakeDatagram) -> None:
    protocol = load_protocol("stim300", {"accelerometer_output": "increment", "rate_hz": 2000})
    with refused(ProtocolError, Reason.UNITS, "125", "2000") as caught:
        decode(protocol, b"".join(datagram(16 * i) for i in range(20)))
    assert caught.value.values["rate_hz"] == pytest.approx(125)


def test_special_datagrams_come_as_messages(datagram: MakeDatagram, finish: Callable[[bytes], bytes]) -> None:
    configuration = bytes([0xBD, ord("F"), 12, 0x83, 0x14, 0x70, 0, 0, 0x72, 0, 0, 0x70, 0, 0, 8, 0, 0, 0x44, 0x40, 0, 0, 0])
    serial = b"\xb7N\x25\x58\x18\x46\x02\x00\x20" + bytes(7)
    trim = b"\xd1" + bytes(range(35))
    error = b"\xbe" + bytes(range(16))
    specials = finish(configuration) + b"\r\n" + finish(serial) + b"\r\n" + finish(trim) + finish(error)
    data = b"".join(datagram(i) for i in range(12)) + specials + b"".join(datagram(i) for i in range(13, 25))
    samples, decoder = decode(load_protocol("stim300"), data)
    assert len(samples) == 24
    assert decoder.statistics.bytes_skipped == 0
    assert decoder.statistics.samples_lost == 1
    messages = {message["kind"]: message for message in decoder.messages()}
    assert list(messages) == ["configuration", "serial_number", "bias_trim", "extended_error"]
    assert decoder.messages() == []
    assert messages["serial_number"]["digits"] == "25581846020020"
    assert messages["configuration"]["rate_hz"] == 2000
    assert messages["configuration"]["baud"] == 460800
    assert messages["configuration"]["accelerometer_range_g"] == 30
    assert messages["configuration"]["accelerometer_output"] == "average"
    assert messages["configuration"]["parity"] == "even" if configuration[4] & 2 else "none"


def test_block_sizes_do_not_matter_with_losses_and_damage(datagram: MakeDatagram) -> None:
    rng = np.random.default_rng(11)
    data = bytearray(b"".join(datagram(2 * i) for i in range(900) if rng.random() > 0.02))
    for at in np.flatnonzero(rng.random(len(data)) < 1e-3):
        data[at] ^= 0x10
    protocol = load_protocol("stim300")
    whole, decoder = decode(protocol, bytes(data))
    for _ in range(4):
        again, other = decode(protocol, bytes(data), rng.integers(0, len(data), 200).tolist())
        assert_same(whole, again)
        assert other.statistics == decoder.statistics
    assert (np.diff(whole.time_s) > 0).all()


@pytest.mark.parametrize("name", ["stim300", "text", "rows_f64"])
@settings(max_examples=40, deadline=None)
@given(pieces=st.lists(st.binary(max_size=200), max_size=8))
def test_any_bytes_never_raise(name: str, pieces: list[bytes]) -> None:
    decoder = Decoder(load_protocol(name))
    blocks = [decoder.feed(piece, 0.1 * i) for i, piece in enumerate(pieces)] + [decoder.flush()]
    samples = concatenate(blocks)
    assert len(samples) == decoder.statistics.samples
    assert decoder.statistics.bytes_total == sum(map(len, pieces))


def test_large_feeds_equal_small_ones(datagram: MakeDatagram) -> None:
    data = b"".join(datagram(i) for i in range(256)) * 80
    protocol = load_protocol("stim300")
    whole, _ = decode(protocol, data)
    parts, _ = decode(protocol, data, range(0, len(data), 65536))
    assert_same(whole, parts)
    assert len(whole) == 256 * 80


@pytest.mark.parametrize("joined", [1, 7, 50, 10_000])
@pytest.mark.parametrize("name", ["stim300", "text"])
def test_reads_fed_together_give_what_they_give_one_by_one(datagram: MakeDatagram, name: str, joined: int) -> None:
    rng = np.random.default_rng(3)
    # 2000 Hz with a host that stops for 0.4 s, and 1000 samples lost in the middle.
    numbers = np.concatenate([np.arange(3000), np.arange(4000, 8000)])
    made = [datagram(i) if name == "stim300" else b"%d,%d,2,3\n" % (i % 256, i) for i in numbers.tolist()]
    reads = [(b"".join(made[at : at + 40])[: int(rng.integers(1, 3000))], at) for at in range(0, len(made), 40)]
    arrival_s = np.array([10 + numbers[min(at + 39, len(numbers) - 1)] / 2000 for _, at in reads])
    arrival_s[40:48] = arrival_s[48]
    chosen = {"columns": "counter,ax,ay,az", "counter_modulus": 256, "rate_hz": 2000} if name == "text" else {}
    protocol = load_protocol(name, chosen)
    one, other = Decoder(protocol), Decoder(protocol)
    apart = [one.feed(data, float(at_s)) for (data, _), at_s in zip(reads, arrival_s, strict=True)]
    together = []
    for at in range(0, len(reads), joined):
        pieces = [data for data, _ in reads[at : at + joined]]
        together.append(other.feed_chunks(b"".join(pieces), np.cumsum([len(p) for p in pieces]), arrival_s[at : at + joined]))
    singly, jointly = concatenate([*apart, one.flush()]), concatenate([*together, other.flush()])
    # Behind a loss estimated from the host clock the last bit may differ.
    np.testing.assert_allclose(jointly.time_s, singly.time_s, rtol=1e-14)
    assert_same(singly, replace(jointly, time_s=singly.time_s))
    assert one.statistics == other.statistics
    assert one.statistics.losses_estimated > 0


def test_rows_of_float64_are_taken_as_they_are() -> None:
    rows = np.arange(80.0).reshape(10, 8)
    rows[:, 0] = 5 + np.arange(10) * 0.25
    protocol = load_protocol("rows_f64", {"accelerometer_unit": "count", "gyroscope_unit": "deg/s", "raw_zero": 32768})
    samples, decoder = decode(protocol, rows.astype("<f8").tobytes(), [3 * 64, 7 * 64])
    np.testing.assert_array_equal(samples.time_s, rows[:, 0])
    np.testing.assert_array_equal(samples.accelerometer, rows[:, 1:4])
    np.testing.assert_allclose(samples.gyroscope, np.radians(rows[:, 4:7]), rtol=1e-15)
    np.testing.assert_array_equal(samples.temperature_degc, rows[:, 7])
    assert samples.units.accelerometer == "count"
    assert protocol.nominal.raw_zero.tolist() == [32768.0] * 3
    assert decoder.statistics.nominal_rate_hz == 4
    assert not samples.status.any()


def test_rows_with_garbage_are_flagged_and_time_stays_finite() -> None:
    rows = np.ones((40, 8))
    rows[:, 0] = np.arange(40) * 0.01
    rows[5, 0], rows[6, 0], rows[20, 0] = np.nan, 1e308, -np.inf
    rows[10, 2], rows[11, 1], rows[12, 4:7], rows[13, 5] = np.nan, 1.7e308, np.nan, np.nan
    protocol = load_protocol("rows_f64", {"accelerometer_unit": "g"})
    samples, _ = decode(protocol, rows.astype("<f8").tobytes(), [64 * 6, 64 * 7, 64 * 20])
    assert np.isfinite(samples.time_s).all()
    assert (np.diff(samples.time_s) >= 0).all()
    assert samples.time_s[-1] == pytest.approx(0.39)
    invalid = samples.status & np.uint32(Status.ACCELEROMETER_INVALID)
    assert np.flatnonzero(invalid).tolist() == [10, 11]
    assert np.flatnonzero(samples.status & np.uint32(Status.GYROSCOPE_INVALID)).tolist() == [13]


def test_statistics_as_plain_values() -> None:
    found = json.loads(json.dumps(Decoder(load_protocol("text")).statistics.to_dict()))
    assert found["samples"] == 0
    assert not math.isnan(found["bytes_total"])
