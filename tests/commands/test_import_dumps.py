"""Byte dumps of instruments, imported as typed: their rate, their frames, what the instrument has corrected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.instrument.baud_search import serial_candidates
from imufield.acquire.instrument.recognise import Listener
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.checksum import make_checksum
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session, create_session
from imufield.acquire.registry import load_driver
from imufield.commands.import_files import import_session
from imufield.commands.options.acquire_commands import ImportOptions
from imufield.errors import Reason
from imufield.samples import SampleUnits, make_samples
from imufield.simulate.instruments.stim300 import Stim300Device
from imufield.simulate.wire.stim300 import Stim300Format, close_datagrams
from tests.commands.test_import import imported, typed
from tests.commands.told import fails, says
from tests.simulate.accounting import Wire, random_samples

PROTOCOL_OF_LINES = """
format = "imufield-protocol"
version = 1
name = "mine"
title = "mine"
manual = "none"
kind = "text"
text = {{ columns = "time,ax,ay,az" }}
samples.accelerometer = {{ fields = ["ax", "ay", "az"], unit = "m/s^2" }}
clock.time = {{ field = "time", ticks_per_s = {ticks_per_s} }}
clock.rate_hz = 100
"""


def dump_of(wire: Wire, path: Path, count: int = 400) -> Path:
    """Write what an instrument sends in samples of its usual rate."""
    choice = wire.choose()
    path.write_bytes(wire.device().encode(random_samples(choice.protocol, choice.rate_hz, 0, count)).data.tobytes())
    return path


def lines_of(path: Path, columns: int) -> Path:
    path.write_text("".join(",".join([str(number)] + ["0.5"] * (columns - 1)) + "\n" for number in range(400)))
    return path


# What is imported as bytes, and whether a rate must be told.
DUMPS = (
    (lambda path: dump_of(Wire("witmotion", "uart"), path), "witmotion", (), True),
    (lambda path: dump_of(Wire("vectornav_ascii", "VNIMU"), path), "vectornav_ascii", (), True),
    (lambda path: lines_of(path, 3), "text", ("columns=ax,ay,az",), True),
    (lambda path: lines_of(path, 4), "text", ("columns=counter,ax,ay,az",), True),
    (lambda path: lines_of(path, 4), "text", ("columns=time,ax,ay,az",), False),
    (lambda path: dump_of(Wire("stim300", ""), path), "stim300", ("accelerometer_range_g=10",), False),
    (lambda path: dump_of(Wire("kvh_17xx", "A"), path), "kvh_17xx", ("rate_hz=500",), False),
)


@pytest.mark.parametrize(("make", "protocol", "settings", "asks"), DUMPS)
def test_a_dump_has_its_own_time_or_asks_for_the_rate(
    tmp_path: Path, make: Callable[[Path], Path], protocol: str, settings: tuple[str, ...], asks: bool
) -> None:
    path = make(tmp_path / "dump.bin")
    given = [part for text in settings for part in ("--set", text)]
    command = ["import", str(path), "--protocol", protocol, *given]
    if not asks:
        assert typed(*command, "-o", tmp_path / "mine") == 0
        return
    fails(
        [*command, "-o", str(tmp_path / "mine")], 2, Reason.UNITS, str(path), "--rate-hz", key="import_files.dump_without_time"
    )
    assert not (tmp_path / "mine").exists()
    for name, rate in (("long", ("--rate-hz", 40)), ("set", ("--set", "rate_hz=40"))):
        assert typed(*command, *rate, "-o", tmp_path / name) == 0
        time_s = imported(tmp_path / name).time_s
        np.testing.assert_allclose(np.diff(time_s), 1 / 40, rtol=1e-9)
        setting = Session.open(tmp_path / name).record.settings["rate_hz"]
        assert (setting.value, setting.origin) == (40.0, "given")
    fails([*command, "--rate-hz", "40", "--set", "rate_hz=50"], 2, Reason.USAGE, "40", "50", key="import_files.two_rates")


def stim300_of_30_g(path: Path, gyroscope_output: int = 0) -> Path:
    """Write a configuration datagram with this code of the gyroscope's output, and samples of 1 g along z."""
    device = Stim300Device(Stim300Format(accelerometer_range_g=30, crlf=False))
    configuration = np.frombuffer(device.answer(b"C").data[:-4], dtype=np.uint8).copy()
    configuration[5] |= gyroscope_output
    values = np.tile([0.0, 0.0, 9.80665], (400, 1))
    samples = make_samples(np.arange(400) / device.rate_hz, values, np.zeros((400, 3)), units=SampleUnits())
    data = close_datagrams(configuration[np.newaxis], crlf=False).tobytes() + device.encode(samples).data.tobytes()
    path.write_bytes(data)
    return path


def test_a_dump_is_read_as_its_configuration_says(tmp_path: Path) -> None:
    path = stim300_of_30_g(tmp_path / "dump.bin")
    assert typed("import", path, "--driver", "stim300", "-o", tmp_path / "mine") == 0
    np.testing.assert_allclose(imported(tmp_path / "mine").accelerometer[:, 2], 9.80665, rtol=1e-6)
    setting = Session.open(tmp_path / "mine").record.settings["accelerometer_range_g"]
    assert (setting.value, setting.origin) == (30, "read")
    # Who knows better is believed.
    assert typed("import", path, "--driver", "stim300", "--set", "accelerometer_range_g=10", "-o", tmp_path / "given") == 0
    np.testing.assert_allclose(imported(tmp_path / "given").accelerometer[:, 2], 9.80665 / 2, rtol=1e-6)


def test_a_dump_of_an_output_that_is_not_read_is_refused(tmp_path: Path) -> None:
    path = stim300_of_30_g(tmp_path / "dump.bin", gyroscope_output=3)
    command = ["import", str(path), "--driver", "stim300", "-o", str(tmp_path / "mine")]
    fails(command, 4, Reason.BAD_PROTOCOL, "integrated", "gyroscope_output", key="settings.read")
    assert not (tmp_path / "mine").exists()


def test_a_real_recording_without_time_asks_for_the_rate(tmp_path: Path, shared_folder: Path) -> None:
    path = shared_folder / "captures" / "vectornav_binary" / "vn100_F00294_mixed_log.bin"
    command = ["import", str(path), "--driver", "vectornav_binary", "-o", str(tmp_path / "mine")]
    fails(command, 2, Reason.UNITS, "vn100_F00294_mixed_log.bin", key="import_files.dump_without_time")
    assert typed(*command, "--rate-hz", 10) == 0
    assert imported(tmp_path / "mine").time_s[-1] == pytest.approx(9.8)


def test_a_protocol_of_ones_own_says_its_rate(tmp_path: Path) -> None:
    path, protocol = lines_of(tmp_path / "dump.txt", 3), tmp_path / "mine.toml"
    head = 'format = "imufield-protocol"\nversion = 1\nname = "mine"\ntitle = "mine"\nmanual = "mine"\nkind = "text"\n'
    head += '[text]\ncolumns = "ax,ay,az"\n[samples]\naccelerometer = { fields = ["ax", "ay", "az"], unit = "g" }\n[clock]\n'
    protocol.write_text(head)
    command = ["import", str(path), "--protocol", str(protocol), "-o", str(tmp_path / "session")]
    fails(command, 2, Reason.UNITS, "rate_hz", "[clock]", key="import_files.protocol_without_time")
    protocol.write_text(head + "rate_hz = 50\n")
    assert typed(*command) == 0
    assert imported(tmp_path / "session").time_s[50] == 1.0


@pytest.mark.parametrize(("columns", "prefix"), [(7, "$A"), (6, "$B")])
def test_lines_of_other_numbers_or_of_another_word_are_told(tmp_path: Path, columns: int, prefix: str) -> None:
    rows = np.random.default_rng(0).normal(0, 1, (400, columns))
    rows[:, 2] += 9.8
    path = tmp_path / "lines.txt"
    path.write_text("".join("$A," + ",".join(f"{value:.4f}" for value in row) + "\n" for row in rows))
    given = f"--driver text --set prefix={prefix} --rate-hz 100 --output {tmp_path / 'session'}"
    arguments = f"import {path} --set columns=ax,ay,az,gx,gy,gz {given}"
    fails(arguments, 4, Reason.NO_FRAMES, f"{columns} numbers behind '$A'", "6 numbers", key="text_columns.other_lines")


@pytest.mark.parametrize(("ticks_per_s", "is_told"), [(1e3, False), (1e6, True)])
def test_a_rate_that_the_stamps_contradict_is_told(tmp_path: Path, ticks_per_s: float, is_told: bool) -> None:
    path, protocol = tmp_path / "lines.txt", tmp_path / "mine.toml"
    path.write_text("".join(f"{10 * k},0,0,9.8\n" for k in range(400)))
    protocol.write_text(PROTOCOL_OF_LINES.format(ticks_per_s=ticks_per_s))
    _, said = import_session(ImportOptions(files=[path], protocol=str(protocol), output=tmp_path / "session"))
    of_key = {getattr(one, "key", ""): getattr(one, "values", {}) for one in said}
    assert of_key["import_files.imported"]["duration_s"] == pytest.approx(3990 / ticks_per_s)
    assert ("import_files.other_rate" in of_key) == is_told


def of_other_kinds(path: Path) -> Path:
    """Write what a receiver sends whose corrected data are logged instead of raw ones."""
    dump_of(Wire("novatel_oem7", "IMURATECORRIMUS"), path, 766)
    # Short header of an INSPVAS: length 88, number 508.
    frame = bytes.fromhex("AA 44 13 58 FC 01") + bytes(6 + 88)
    crc = make_checksum("CRC-32/ISO-HDLC", start=0, final=0)
    path.write_bytes((frame + int(crc.of(frame)).to_bytes(4, "little")) * 62 + path.read_bytes())
    return path


def test_frames_without_samples_are_named_and_counted(tmp_path: Path) -> None:
    path = of_other_kinds(tmp_path / "dump.bin")
    command = ["import", str(path), "--driver", "novatel_oem7", "-o", str(tmp_path / "mine")]
    facts = ("828 good frames", "766 IMURATECORRIMUS, 62 INSPVAS", "log RAWIMUSX", "imu=corrected")
    fails(command, 4, Reason.NO_FRAMES, str(path), *facts, key="import_files.frames_without_samples")
    assert not (tmp_path / "mine").exists()
    # A session of the same bytes, as a recording makes it whose instrument was told otherwise meanwhile.
    protocol = load_driver("novatel_oem7").load_protocol()
    told = {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text}
    session = create_session(tmp_path / "recorded", tmp_path, "oem7", {"kind": "record", "protocol": told})
    with Recorder(session.add_part(), part_metadata(protocol, {})) as recorder:
        recorder.write_chunk(Chunk(path.read_bytes(), 1.0, 1))
    for name in ("solve", "export-data", "replay"):
        fails([name, str(session.folder)], 4, Reason.BAD_DATA, str(session.folder), *facts, key="damage.other_frames")


def of_other_sentences(count: int) -> bytes:
    """Return lines of a receiver that logs no raw data: an INSPVASA of the maker's reference, and a short one."""
    crc = make_checksum("CRC-32/ISO-HDLC", start=0, final=0)
    position = b"INSPVASA,1264,144059.000;1264,144059.002135700,51.116680071,-114.037929194,515.286704183,277.896368884,"
    position += b"84.915188605,-8.488207941,0.759619515,-2.892414901,6.179554750,INS_ALIGNMENT_COMPLETE"
    assert crc.of(position) == 0x855D6F76  # as it stands there
    bodies = [position] * count + [b"INSCONFIGA,COM1,0,66.5,UNKNOWN,1264,144059.000,02000020,b22d,16248;0"] * 2
    return b"".join(b"%%%s*%08x\r\n" % (body, crc.of(body)) for body in bodies)


def test_sentences_without_samples_are_named_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "dump.txt"
    path.write_bytes(of_other_sentences(100))
    command = ["import", str(path), "--driver", "novatel_oem7_ascii", "-o", str(tmp_path / "mine")]
    facts = ("102 good frames", "100 INSPVASA, 2 INSCONFIGA", "log RAWIMUSXA")
    fails(command, 4, Reason.NO_FRAMES, str(path), *facts, key="import_files.frames_without_samples")
    listener = Listener(next(each for each in serial_candidates() if each.name == "novatel_oem7_ascii"))
    listener.feed(Chunk(path.read_bytes(), 1.0, 1))
    found = listener.finding()
    assert found.holds_no_sample
    assert found.share == 1.0
    assert getattr(found.reason, "key", "") == "statistics.without_samples"


def test_what_an_instrument_has_corrected_is_read_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = of_other_kinds(tmp_path / "dump.bin")
    folder = tmp_path / "mine"
    assert typed("import", path, "--driver", "novatel_oem7", "--set", "imu=corrected", "-o", folder) == 0
    advice = load_driver("novatel_oem7").load_protocol({"imu": "corrected"}).samples.advice
    assert says(capsys.readouterr().err, "acquire.instrument", "connected.corrected", advice=advice)
    assert len(imported(folder)) == 766
    assert Session.open(folder).record.settings["imu"].value == "corrected"
    assert typed("export-data", folder) == 0
    for name in ("solve", "replay"):
        fails([name, str(folder)], 6, Reason.GRAVITY, "RAWIMUSX", key="chain.corrected")


def test_a_real_recording_of_other_frames(tmp_path: Path, shared_folder: Path) -> None:
    path = shared_folder / "captures" / "novatel_oem7" / "oem7_ins1_inspvas_corrimus.bin"
    command = ["import", str(path), "--driver", "novatel_oem7", "-o", str(tmp_path / "mine")]
    kinds = "243 INSPVAS, 29 INSSTDEV, 10 CORRIMUS, 2 INSCONFIG"
    fails(command, 4, Reason.NO_FRAMES, kinds, key="import_files.frames_without_samples")
