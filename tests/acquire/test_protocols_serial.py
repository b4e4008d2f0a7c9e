"""Every byte-stream protocol against the vectors and recordings of real instruments."""

from __future__ import annotations

import csv
import json
import math
import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.decode.framing import Framer
from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.checksum import make_checksum
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.errors import ProtocolError, Reason
from imufield.samples import FloatArray, Samples, concatenate
from tests.acquire.plain_frames import decode_fields
from tests.refused import refused

STANDARD_GRAVITY_M_S2 = 9.80665
DEG = math.pi / 180
FILES = {
    "xsens_mtdata2": "xsens_mtdata2",
    "microstrain_mip": "microstrain_mip",
    "vectornav_binary": "vectornav",
    "vectornav_ascii": "vectornav",
    "aceinna_serial": "aceinna_openimu_serial",
    "witmotion": "witmotion",
    "novatel_oem7": "novatel_rawimu",
    "novatel_oem7_ascii": "novatel_rawimu",
    "kvh_17xx": "kvh_1750",
    "sbg_sbgecom": "sbg_sbgecom",
}
TEXT = ("vectornav_ascii", "novatel_oem7_ascii")


@cache
def vectors(shared: Path, name: str) -> list[dict[str, Any]]:
    """Return the vectors that are frames of this protocol, good or bad; not commands of the host to it."""
    found = json.loads((shared / "wire" / f"{FILES[name]}.vectors.json").read_text(encoding="utf-8"))
    is_text = name in TEXT
    return [one for one in found if one.get("kind") != "command" and (one.get("kind") == "ascii") == is_text]


def settings_of(name: str, vector: dict[str, Any]) -> dict[str, object]:
    if name == "witmotion" and vector["hex"].startswith("5561"):
        return {"form": "bluetooth" if len(vector["hex"]) == 40 else "card"}
    if name == "novatel_oem7" and vector["decoded"].get("msg_id") == 1362:
        return {"imu": "corrected"}
    return {}


def samples_of(protocol: Protocol, data: bytes, cuts: list[int] | None = None) -> tuple[Samples, Decoder]:
    decoder = Decoder(protocol)
    edges = [0, *sorted(cuts or []), len(data)]
    blocks = [decoder.feed(data[begin:end]) for begin, end in pairwise(edges)]
    return concatenate([*blocks, decoder.flush()]), decoder


@pytest.mark.parametrize("name", FILES)
def test_every_vector_is_a_frame_and_negative_ones_are_refused(name: str, shared_folder: Path) -> None:
    for vector in vectors(shared_folder, name):
        data = bytes.fromhex(vector["hex"])
        decoder = Decoder(load_protocol(name, settings_of(name, vector)))
        decoder.feed(data)
        decoder.flush()
        good = vector.get("valid", True)
        assert decoder.statistics.frames == int(good), vector
        if good and name not in TEXT:
            assert decoder.statistics.bytes_skipped == 0, vector
        twisted = Decoder(load_protocol(name, settings_of(name, vector)))
        twisted.feed(data[:-3] + bytes([data[-3] ^ 1]) + data[-2:])
        twisted.flush()
        assert twisted.statistics.frames == int(settings_of(name, vector).get("form") in ("bluetooth", "card")), vector


def fields_of(name: str, vector: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a vector by name, in the unit of the field where it is scaled."""
    protocol = load_protocol(name, settings_of(name, vector))
    ((_, found),) = list(decode_fields(protocol, bytes.fromhex(vector["hex"])))
    scaled = {key.partition(" [")[0]: value for key, value in found.items() if " [" in key}
    return {**found, **scaled}


def close(found: Any, wanted: Any) -> bool:
    return bool(np.allclose(np.ravel(found), np.ravel(wanted), rtol=1e-6, atol=1e-9))


def test_values_of_xsens_vectors(shared_folder: Path) -> None:
    compared = 0
    for vector in vectors(shared_folder, "xsens_mtdata2"):
        wanted = [field for field in vector["decoded"].get("fields", []) if not field["name"].startswith(("utc", "raw"))]
        found = fields_of("xsens_mtdata2", vector) if wanted else {}
        for field in wanted:
            assert close(found[field["name"]], field["value"]), (field, found)
            compared += 1
    assert compared > 150


def test_frames_of_one_structure_and_several_keys_are_told_apart() -> None:
    # Acknowledgements of the same length, with nothing in them, right behind each other in one read.
    decoder = Decoder(load_protocol("xsens_mtdata2"))
    decoder.feed(bytes.fromhex("FAFF3100D0FAFF1100F0FAFF3100D0FAFF8F0072"))
    decoder.flush()
    assert decoder.statistics.by_kind == {"go_to_config_done": 2, "go_to_measurement_done": 1, "0x8F": 1}
    assert (decoder.statistics.frames_bad_checksum, decoder.statistics.bytes_skipped) == (0, 0)


def test_values_of_microstrain_vectors(shared_folder: Path) -> None:
    names = {"0x04": "acceleration", "0x05": "rate", "0x06": "magnetic_field", "0x07": "delta_theta", "0x08": "delta_velocity"}
    names |= {"0x0C": "euler_rad"}
    compared = 0
    for vector in vectors(shared_folder, "microstrain_mip"):
        found = fields_of("microstrain_mip", vector)
        for field in vector["decoded"]["fields"]:
            if "uint64_ns" in field:
                name = {"0xD5": "reference_time_ns", "0xD6": "reference_delta_ns"}[field["field"]]
                assert found[name] == field["uint64_ns"]
            elif "float32" in field and None not in field["float32"]:
                assert close(found[names[field["field"]]], field["float32"])
            elif "ack_echo" in field:
                assert (found["answered_command"], found["error"]) == (int(field["ack_echo"], 16), field["ack_error"])
            else:
                continue
            compared += 1
    assert compared > 30


def test_values_of_vectornav_vectors(shared_folder: Path) -> None:
    names = {
        "1.YawPitchRoll": "yaw_pitch_roll_deg",
        "1.TimeStartup": "time_startup_ns",
        "3.UncompMag": "uncompensated_magnetic",
        "3.UncompAccel": "uncompensated_acceleration",
        "3.UncompGyro": "uncompensated_rate",
        "3.Temp": "temperature",
        "3.Pres": "pressure_kpa",
        "5.YawPitchRoll": "yaw_pitch_roll_deg",
        "5.DCM": "rotation_matrix",
        "5.MagNed": "magnetic_ned",
        "5.AccelNed": "acceleration_ned",
    }
    for vector in vectors(shared_folder, "vectornav_binary"):
        if "fields" in vector["decoded"]:
            found = fields_of("vectornav_binary", vector)
            for name, value in vector["decoded"]["fields"].items():
                assert close(found[names[name]], value), name
    wanted = [one["decoded"] for one in vectors(shared_folder, "vectornav_ascii") if "acc_x_ms2" in one["decoded"]]
    lines = b"".join(bytes.fromhex(one["hex"]) for one in vectors(shared_folder, "vectornav_ascii"))
    samples, decoder = samples_of(load_protocol("vectornav_ascii"), lines)
    assert close(samples.accelerometer, [[one[f"acc_{axis}_ms2"] for axis in "xyz"] for one in wanted])
    assert close(samples.gyroscope, [[one[f"gyro_{axis}_rads"] for axis in "xyz"] for one in wanted])
    assert {message["text"] for message in decoder.messages()} >= {"VNRRG,01,VN-300", "VNERR,12"}


def test_a_sentence_may_carry_the_long_checksum() -> None:
    body = b"VNMAR,0,0,0,1,2,-9.8,0.1,0.2,0.3"
    crc = int(make_checksum("CRC-16/XMODEM").of_rows(np.frombuffer(body, dtype=np.uint8).reshape(1, -1))[0])
    samples, _ = samples_of(load_protocol("vectornav_ascii"), b"\xfa\x01$" + body + f"*{crc:04X}\n".encode())
    assert samples.accelerometer.tolist() == [[1, 2, -9.8]]
    _, decoder = samples_of(load_protocol("vectornav_ascii"), b"$" + body + f"*{crc ^ 1:04X}\n".encode())
    assert decoder.statistics.frames_bad_checksum == 1


def test_values_of_aceinna_and_witmotion_vectors(shared_folder: Path) -> None:
    for name in ("aceinna_serial", "witmotion"):
        for vector in vectors(shared_folder, name):
            found, wanted = fields_of(name, vector), vector["decoded"]
            for key, factor, field in (
                ("acc_g", 1, "scaled_acceleration" if name == "aceinna_serial" else "acceleration"),
                ("acc_ms2", 1, "acceleration"),
                ("gyro_dps", 1, "scaled_rate" if wanted.get("type") == "S1" else "rate"),
                ("mag_g", 1, "magnetic_gauss"),
                ("angle_deg", 1, "angle"),
                ("mag_raw", 1, "magnetic"),
                ("temp_c", 1, "temperature"),
                ("temp_board_c", 1, "board_temperature"),
                ("temp_xyz_c", 1, "axis_temperature"),
                ("counter", 1, "counter"),
                ("bit", 1, "bit_status"),
                ("time_raw", 1, "time"),
                ("time_counter", 1, "time_ms"),
                ("time_s", 1, "time_s"),
            ):
                assert key not in wanted or close(found[field], np.multiply(wanted[key], factor)), (key, wanted, found)


def test_values_of_novatel_vectors(shared_folder: Path) -> None:
    def axes(one: dict[str, Any]) -> tuple[list[float], list[float]]:
        return (
            [one["acc_x"], -one["neg_acc_y"], one["acc_z"]],
            [one["gyro_x"], -one["neg_gyro_y"], one["gyro_z"]],
        )

    for name in ("novatel_oem7", "novatel_oem7_ascii"):
        seen = 0
        for vector in vectors(shared_folder, name):
            if "acc_z" in vector["decoded"]:
                samples, _ = samples_of(load_protocol(name), bytes.fromhex(vector["hex"]))
                accelerometer, gyroscope = axes(vector["decoded"])
                assert samples.accelerometer.tolist() == [accelerometer]
                assert samples.gyroscope.tolist() == [gyroscope]
                assert samples.units.accelerometer_is_increment
                seen += 1
        assert seen >= 2
    corrected = [one for one in vectors(shared_folder, "novatel_oem7") if one["decoded"].get("msg_id") == 1362]
    for vector in corrected:
        one = vector["decoded"]
        samples, _ = samples_of(load_protocol("novatel_oem7", {"imu": "corrected"}), bytes.fromhex(vector["hex"]))
        assert close(samples.gyroscope[0], [one[f"{turn}_rate_rad"] for turn in ("pitch", "roll", "yaw")])
        assert close(samples.accelerometer[0], [one[f"{along}_acc_ms"] for along in ("lat", "lon", "vert")])
        assert samples.time_s[0] == one["sec"]


def test_novatel_scales() -> None:
    protocol = load_protocol("novatel_oem7", {"imu": "hg4930", "rate_hz": 100})
    assert protocol.units.accelerometer == "m/s"
    assert protocol.factors["accelerometer"] == 2**-29
    assert protocol.factors["gyroscope"] == 2**-33
    stim = load_protocol("novatel_oem7", {"imu": "stim300", "rate_hz": 125})
    assert stim.factors["gyroscope"] == pytest.approx(2**-21 * DEG)


def test_values_of_kvh_and_sbg_vectors(shared_folder: Path) -> None:
    first, second, _ = vectors(shared_folder, "kvh_17xx")
    data = bytes.fromhex(first["hex"] + second["hex"])
    samples, _ = samples_of(load_protocol("kvh_17xx", {"gyroscope_output": "rad/s"}), data)
    for row, one in enumerate((first["decoded"], second["decoded"])):
        assert close(samples.gyroscope[row], one["rot"])
        assert close(samples.accelerometer[row], np.multiply(one["acc_g"], STANDARD_GRAVITY_M_S2))
        assert samples.temperature_degc[row] == one["temp_raw"]
        assert samples.counter[row] == one["sequence"]
    assert samples.usable.all()
    short = vectors(shared_folder, "sbg_sbgecom")[0]
    samples, _ = samples_of(load_protocol("sbg_sbgecom"), bytes.fromhex(short["hex"]))
    assert samples.accelerometer.tolist() == [short["decoded"]["acc_ms2"]]
    assert samples.gyroscope.tolist() == [short["decoded"]["gyro_rads"]]
    assert samples.temperature_degc.tolist() == [short["decoded"]["temp_c"]]


def test_the_scale_of_sbg_rates_follows_the_status(shared_folder: Path) -> None:
    data = bytearray.fromhex(vectors(shared_folder, "sbg_sbgecom")[0]["hex"])
    data[11] |= 0x04
    crc = make_checksum("CRC-16/KERMIT").of_rows(np.frombuffer(bytes(data[2:-3]), dtype=np.uint8).reshape(1, -1))
    data[-3:-1] = int(crc[0]).to_bytes(2, "little")
    samples, _ = samples_of(load_protocol("sbg_sbgecom"), bytes(data))
    assert samples.gyroscope[0, 0] == pytest.approx(2**26 / 12304174)


@pytest.mark.parametrize(("velocity", "metre"), [("m/s", 1.0), ("ft/s", 0.3048)])
@pytest.mark.parametrize(("temperature", "unit"), [("degF", 1.0), ("0.01 degF", 100.0)])
def test_kvh_as_it_can_be_configured(velocity: str, metre: float, temperature: str, unit: float, shared_folder: Path) -> None:
    first = vectors(shared_folder, "kvh_17xx")[0]
    given = {"accelerometer_output": velocity, "temperature_unit": temperature}
    samples, _ = samples_of(load_protocol("kvh_17xx", given), bytes.fromhex(first["hex"]))
    assert samples.units.accelerometer_is_increment
    assert close(samples.accelerometer[0], np.multiply(first["decoded"]["acc_g"], metre))
    assert samples.temperature_degc[0] == pytest.approx((first["decoded"]["temp_raw"] / unit - 32) / 1.8)


def capture(shared: Path, name: str) -> tuple[Protocol, bytes, int]:
    """Return protocol, bytes and number of samples of a recording."""
    folder = shared / "captures"
    if name.startswith("mti"):
        return load_protocol("xsens_mtdata2"), (folder / "xsens_mtdata2" / f"{name}.bin").read_bytes(), 96
    if name == "witmotion":
        lines = (folder / "witmotion" / "wt901ble67_5561_100hz.jsonl").read_text(encoding="utf-8").splitlines()[1:]
        data = b"".join(bytes.fromhex(json.loads(line)["hex"]) for line in lines)
        return load_protocol("witmotion", {"form": "bluetooth", "rate_hz": 100}), data, 288
    protocol, file, count = {
        "mip": ("microstrain_mip", "mip_data_first_180000_bytes.bin", 2218),
        "z1": ("aceinna_serial", "openimu_z1.raw", 2127),
        "S1": ("aceinna_serial", "imu381_S1_scale1.raw", 1002),
        "vn100": ("vectornav_binary", "vn100_F00294_mixed_log.bin", 99),
        "oem7": ("novatel_oem7", "oem7_ins1_inspvas_corrimus.bin", 0),
    }[name]
    return load_protocol(protocol), (folder / protocol / file).read_bytes(), count


def test_fields_of_one_part_may_come_in_different_units(shared_folder: Path) -> None:
    samples, _ = samples_of(*capture(shared_folder, "S1")[:2])
    # The packet has g where those of its sister models have m/s^2; the unit lies on a table.
    assert np.linalg.norm(samples.accelerometer.mean(axis=0)) == pytest.approx(STANDARD_GRAVITY_M_S2, rel=0.005)


CAPTURES = ("mti_g_710_output_1", "mti_g_710_output_2", "mti_g_710_output_3", "mip", "z1", "S1", "vn100", "oem7", "witmotion")


@pytest.mark.parametrize("name", CAPTURES)
def test_a_recording_gives_the_same_however_it_is_cut(name: str, shared_folder: Path) -> None:
    protocol, data, count = capture(shared_folder, name)
    whole, decoder = samples_of(protocol, data)
    assert len(whole) == count
    assert decoder.statistics.samples_lost == 0
    rng = np.random.default_rng(11)
    bytewise = list(range(1, min(len(data), 1500)))
    for cuts in (*(rng.integers(0, len(data), 60).tolist() for _ in range(3)), bytewise):
        again, other = samples_of(protocol, data, cuts)
        for part in ("time_s", "accelerometer", "gyroscope", "temperature_degc", "counter", "status"):
            np.testing.assert_array_equal(getattr(again, part), getattr(whole, part))
        assert (other.statistics.frames, other.statistics.bytes_skipped) == (
            decoder.statistics.frames,
            decoder.statistics.bytes_skipped,
        )


@pytest.mark.parametrize("name", [name for name in CAPTURES if name != "oem7"])
def test_the_acceleration_of_every_recording_is_of_the_size_of_gravity(name: str, shared_folder: Path) -> None:
    samples, _ = samples_of(*capture(shared_folder, name)[:2])
    finite = samples.accelerometer[np.isfinite(samples.accelerometer).all(axis=1)]
    assert samples.units.accelerometer == "m/s^2"
    assert np.median(np.linalg.norm(finite, axis=1)) == pytest.approx(STANDARD_GRAVITY_M_S2, rel=0.1)


def test_counts_of_frames_in_recordings(shared_folder: Path) -> None:
    _, decoder = samples_of(*capture(shared_folder, "mip")[:2])
    assert decoder.statistics.by_kind == {"0x80": 3549, "0x82": 354, "0xA0": 140, "base": 1}
    _, decoder = samples_of(*capture(shared_folder, "oem7")[:2])
    assert decoder.statistics.by_kind == {"0x01FC": 243, "0x0803": 29, "0x08D8": 10, "0x0799": 2}
    for number in (1, 2, 3):
        _, decoder = samples_of(*capture(shared_folder, f"mti_g_710_output_{number}")[:2])
        assert decoder.statistics.by_kind == {"0x36": 100}
        assert decoder.statistics.nominal_rate_hz == pytest.approx(100)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_published_values_of_xsens(number: int, shared_folder: Path) -> None:
    samples, _ = samples_of(*capture(shared_folder, f"mti_g_710_output_{number}")[:2])
    path = shared_folder / "captures" / "xsens_mtdata2" / f"mti_g_710_output_{number}.decoded.txt"
    text = path.read_text(encoding="utf-8")
    for what, values in (("Acceleration", samples.accelerometer), ("RateOfTurn", samples.gyroscope)):
        found = re.findall(rf"^{what}\(.*\n  X:(.*)\n  Y:(.*)\n  Z:(.*)", text, re.MULTILINE)
        np.testing.assert_allclose(values, np.array(found, dtype=np.float64), rtol=1e-6, atol=1e-9)


def test_published_values_of_vectornav(shared_folder: Path) -> None:
    samples, _ = samples_of(*capture(shared_folder, "vn100")[:2])
    with (shared_folder / "captures" / "vectornav_binary" / "vn100_F00294_decoded.csv").open(encoding="utf-8") as file:
        rows = [[float(cell) for cell in row[:10]] for row in list(csv.reader(file))[1:] if len(row) > 10]
    published = np.array(rows)
    assert len(published) == 98
    found = np.column_stack([samples.accelerometer, samples.gyroscope, samples.temperature_degc])
    for row in published:
        assert np.isclose(found, row[3:10], rtol=1e-5, atol=1e-9).all(axis=1).any()


def test_witmotion_frames_make_samples() -> None:
    def frame(kind: int, *words: int) -> bytes:
        body = bytes([0x55, kind]) + b"".join(word.to_bytes(2, "little", signed=True) for word in words)
        return body + bytes([sum(body) & 0xFF])

    def group(number: int) -> list[bytes]:
        return [
            frame(0x51, number, 0, 2048, 2500),
            frame(0x52, 0, number, 0, 0),
            frame(0x53, 0, 0, 0, 0),
            frame(0x54, 1, 2, 3, 4),
        ]

    groups = [group(number) for number in range(60)]
    groups[20][1] = groups[20][1][:5] + b"\x77" + groups[20][1][6:]
    groups[30][0] = groups[30][0][:5] + b"\x77" + groups[30][0][6:]
    data = b"".join(b"".join(one) for one in groups)
    protocol = load_protocol("witmotion", {"rate_hz": 100})
    whole, decoder = samples_of(protocol, data)
    kept = [number for number in range(60) if number not in (20, 30)]
    np.testing.assert_allclose(whole.accelerometer[:, 0], np.array(kept) / 2048 * STANDARD_GRAVITY_M_S2)
    np.testing.assert_allclose(whole.gyroscope[:, 1], np.array(kept) * 2000 / 32768 * DEG)
    assert decoder.statistics.samples_lost == 2
    assert (whole.temperature_degc == 25).all()
    for cuts in (list(range(1, len(data))), list(range(7, len(data), 7)), list(range(11, len(data), 11))):
        again, _ = samples_of(protocol, data, cuts)
        np.testing.assert_array_equal(again.accelerometer, whole.accelerometer)
        np.testing.assert_array_equal(again.time_s, whole.time_s)


FALSE_HEADERS = {
    "xsens_mtdata2": "FA FF 36 FF 08 00",
    "microstrain_mip": "75 65 80 FF",
    "vectornav_binary": "FA 3F FF 7F FF 03 FF 0F FF 3F FF 07 FF 07",
    "aceinna_serial": "55 55 7A 31 FF",
    "novatel_oem7": "AA 44 12 1C 00 00 00 00 00 3F",
    "kvh_17xx": "FE 81 FF 56",
    "sbg_sbgecom": "FF 5A 03 00 F6 0F",
}


def good_frames(shared: Path, name: str) -> list[bytes]:
    skip = {"extended BIT"}
    return [
        bytes.fromhex(one["hex"])
        for one in vectors(shared, name)
        if one.get("valid", True) and one["decoded"].get("kind") not in skip and one["decoded"].get("type") != "0x61"
    ]


@pytest.mark.parametrize("name", FALSE_HEADERS)
def test_no_good_frame_is_lost_behind_a_false_header(name: str, shared_folder: Path) -> None:
    frames = (good_frames(shared_folder, name) * 10)[:10]
    data = bytes.fromhex(FALSE_HEADERS[name].replace(" ", "")) + b"".join(frames)
    for step in (len(data), 1, 37):
        decoder = Decoder(load_protocol(name))
        for at in range(0, len(data), step):
            decoder.feed(data[at : at + step])
        decoder.flush()
        assert decoder.statistics.frames == 10


@pytest.mark.parametrize("name", [name for name in FILES if name not in TEXT])
def test_flipped_bits_cost_only_the_frames_they_hit(name: str, shared_folder: Path) -> None:
    rng = np.random.default_rng(4)
    frames = good_frames(shared_folder, name)
    order = rng.integers(0, len(frames), 4000)
    ends = np.cumsum([len(frames[number]) for number in order])
    stream = np.frombuffer(b"".join(frames[number] for number in order), dtype=np.uint8).copy()
    hits = np.flatnonzero(rng.random(len(stream)) < 1e-4)
    stream[hits] ^= (1 << rng.integers(0, 8, len(hits))).astype(np.uint8)
    intact = len(order) - len(np.unique(np.searchsorted(ends, hits, side="right")))
    rule = load_protocol(name).frame
    assert rule is not None
    framer = Framer(rule)
    found = [len(framer.feed(stream[at : at + 5000].tobytes())) for at in range(0, len(stream), 5000)]
    assert sum(found) + len(framer.feed(b"", last=True)) == intact


@pytest.mark.parametrize("name", [*FILES])
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_and_mutations_never_raise(name: str, seed: int, shared_folder: Path) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(b"".join(bytes.fromhex(one["hex"]) for one in vectors(shared_folder, name)) * 20)
    for place in rng.integers(0, len(data), len(data) // 50).tolist():
        data[place] = int(rng.integers(0, 256))
    noise = bytes(data) + rng.bytes(15_000)
    if name.startswith("novatel"):
        # Vectors of many instruments make no regular time, which increments need.
        with refused(ProtocolError, Reason.UNITS, "rate_hz"):
            samples_of(load_protocol(name), noise)
        return
    whole, decoder = samples_of(load_protocol(name), noise)
    again, other = samples_of(load_protocol(name), noise, rng.integers(0, len(noise), 100).tolist())
    assert decoder.statistics.frames == other.statistics.frames
    np.testing.assert_array_equal(whole.accelerometer, again.accelerometer)


def test_a_turned_counter_of_time_tells_losses(shared_folder: Path) -> None:
    _, data, _ = capture(shared_folder, "S1")
    size = 31
    cut = data[: 100 * size] + data[105 * size : 400 * size] + data[401 * size :]
    samples, decoder = samples_of(load_protocol("aceinna_serial"), cut)
    whole, _ = samples_of(load_protocol("aceinna_serial"), data)
    assert decoder.statistics.samples_lost == 6
    kept: FloatArray = np.delete(whole.time_s, [*range(100, 105), 400])
    np.testing.assert_allclose(samples.time_s, kept, atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", [*FILES, "stim300"])
def test_time_never_runs_backwards_whatever_comes_and_when(name: str, seed: int, shared_folder: Path) -> None:
    """Frames in any order are stamps and counters that jump to and fro; they come late, in batches, and cut anywhere."""
    rng = np.random.default_rng(seed)
    known = json.loads((shared_folder / "wire/stim300.vectors.json").read_text()) if name == "stim300" else []
    frames = [bytes.fromhex(one["hex"]) for one in known or vectors(shared_folder, name) if not settings_of(name, one)]
    # One again and again at first: a rate learned from leaps would be refused where samples are increments.
    data = b"".join(frames[which] for which in [0] * 20 + rng.integers(0, len(frames), 1200).tolist())
    ends = np.append(np.sort(rng.integers(0, len(data), 120)), len(data))
    arrival_s = 10 + ends / len(data) * 40 + rng.exponential(0.05, 121)
    # A time without anything, all of it later; a cable that is slower from then on.
    arrival_s[(arrival_s > 20) & (arrival_s < 24)] = 24.0
    arrival_s = np.maximum.accumulate(arrival_s + np.where(arrival_s > 35, 0.3, 0.0))
    decoder = Decoder(load_protocol(name))
    pieces = zip(pairwise([0, *ends.tolist()]), arrival_s.tolist(), strict=True)
    blocks = [decoder.feed(data[begin:end], at_s) for (begin, end), at_s in pieces]
    samples = concatenate([*blocks, decoder.flush()])
    assert len(samples) > 100
    assert (np.diff(samples.time_s) >= 0).all()
