"""``import`` and ``export-data`` of other programs' formats, as typed."""

from __future__ import annotations

import errno
import gzip
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import can
import numpy as np
import pytest
from scipy.io import savemat

from imufield.acquire.instrument.can_map import parse_map, protocol_from_dbc
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.cli.run import run
from imufield.commands import import_files
from imufield.commands.options.acquire_commands import ImportOptions
from imufield.deliver.samples.export_data import export_samples
from imufield.errors import Reason, RecordingError, UsageError
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into, session_samples
from imufield.pipeline.table_samples import table_samples
from imufield.samples import NO_COUNTER, Samples, Status, concatenate, make_samples
from imufield.simulate.wire.can_frames import CanEncoder
from tests.acquire.formats.conftest import fork_readers
from tests.commands.conftest import Program
from tests.commands.told import fails, missing
from tests.refused import refused

N = 500
DBC = """VERSION ""
BU_: Imu
BO_ 256 Force: 8 Imu
 SG_ Front : 0|16@1- (0.001,0) [-32|32] "m/s2" Vector__XXX
 SG_ Left : 16|16@1- (0.001,0) [-32|32] "m/s2" Vector__XXX
 SG_ Up : 32|16@1- (0.001,0) [-32|32] "m/s2" Vector__XXX
 SG_ Count : 48|16@1+ (1,0) [0|65535] "" Vector__XXX
"""
FORMATS = (("csv", "csv", "numpy"), ("parquet", "parquet", "pyarrow"), ("hdf5", "h5", "h5py"), ("ros2", "mcap", "rosbags"))
HEADS = {
    "mat": b"MATLAB 5.0 MAT-file",
    "h5": b"\x89HDF\r\n\x1a\n",
    "parquet": b"PAR1",
    "npz": b"PK\x03\x04",
    "bag": b"#ROSBAG V2.0\n",
    "mcap": b"\x89MCAP0\r\n",
    "blf": b"LOGG",
    "asc": b"date ",
    "log": b"(1.0) can0 12",
    "csv": b"",
}
MAP = ("accelerometer.x=Front", "accelerometer.y=Left", "accelerometer.z=Up", "counter=Count")


@pytest.fixture(autouse=True)
def forked_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    fork_readers(monkeypatch)


def samples_of(protocol: Protocol) -> Samples:
    time_s = np.linspace(0.0, (N - 1) * 0.01, N)
    force = np.column_stack([np.sin(time_s), np.cos(time_s), np.full(N, 9.8)])
    status = np.where(np.arange(N) == 77, np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID), np.uint32(0))
    return make_samples(time_s, force, force / 10, units=protocol.units, counter=np.arange(N), status=status)


def write_log(path: Path, protocol: Protocol) -> None:
    with can.Logger(path) as logger:
        for frame in CanEncoder(protocol).encode(samples_of(protocol)):
            is_extended = bool(frame.can_id >> 31)
            identifier = frame.can_id & 0x1FFFFFFF
            logger(
                can.Message(
                    timestamp=1.7e9 + frame.time_s,
                    arbitration_id=identifier,
                    is_extended_id=is_extended,
                    data=frame.data,
                    channel="can0" if path.suffix == ".log" else 0,
                )
            )


def pack(path: Path) -> Path:
    packed = path.with_name(f"{path.name}.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    return packed


def typed(*arguments: object) -> int:
    return run([str(argument) for argument in arguments])


def imported(folder: Path) -> Samples:
    session = Session.open(folder)
    assert session.finished
    return concatenate(session_samples(session, []))


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "trc"])
@pytest.mark.parametrize("packed", [False, True])
def test_a_log_of_a_can_bus(tmp_path: Path, suffix: str, packed: bool, capsys: pytest.CaptureFixture[str]) -> None:
    protocol = load_driver("aceinna_can").load_protocol()
    path = tmp_path / f"drive.{suffix}"
    write_log(path, protocol)
    if packed:
        path = pack(path)
    assert typed("import", path, "--driver", "aceinna_can", "-o", tmp_path / "mine") == 0
    assert f"{N} samples of {2 * N} frames, 0 lost" in capsys.readouterr().err
    found, wanted = imported(tmp_path / "mine"), samples_of(protocol)
    good = (wanted.status & np.uint32(Status.ACCELEROMETER_INVALID)) == 0
    np.testing.assert_allclose(found.accelerometer[good], wanted.accelerometer[good], atol=0.0051)
    np.testing.assert_allclose(found.gyroscope[good], wanted.gyroscope[good], atol=0.0001)
    assert np.isnan(found.accelerometer[77]).all()
    assert np.flatnonzero(found.status & np.uint32(Status.ACCELEROMETER_INVALID)).tolist() == [77]
    assert Session.open(tmp_path / "mine").metadata["instrument"]["driver"] == "aceinna_can"
    assert Session.open(tmp_path / "mine").record.recorded == "2023-11-14T22:13:20Z"


def test_a_log_with_a_dbc_and_a_mapping(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dbc = tmp_path / "my.dbc"
    dbc.write_text(DBC, encoding="ascii")
    protocol = protocol_from_dbc(dbc, parse_map(MAP))
    path = tmp_path / "drive.blf"
    write_log(path, protocol)
    maps = [part for text in MAP for part in ("--map", text)]
    assert typed("import", path, "--dbc", dbc, *maps, "-o", tmp_path / "mine") == 0
    np.testing.assert_allclose(imported(tmp_path / "mine").accelerometer, samples_of(protocol).accelerometer, atol=0.0005)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - 30])
    capsys.readouterr()
    assert typed("import", path, "--dbc", dbc, *maps, "-o", tmp_path / "cut") == 0
    assert f"{len(content) - 30} of {len(content)} bytes" in capsys.readouterr().err
    assert typed("import", path, "--driver", "aceinna_can", "-o", tmp_path / "other") == 4
    assert re.search(r"drive.blf: 4\d\d frames contain no whole sample of j1939_imu \(other: 4\d\d\)", capsys.readouterr().err)
    unknown = ["import", str(path), "-o", str(tmp_path / "other")]
    fails(unknown, 2, Reason.USAGE, str(path), key="import_files.unknown_can_log")
    fails([*unknown, "--map", MAP[0]], 2, Reason.USAGE, "--dbc", key="import_files.map_without_dbc")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("name", ["", "part-001.mcap", "session.toml"])
def test_our_own_recording_needs_no_import(tmp_path: Path, name: str) -> None:
    folder = Path(__file__).parents[2] / "fixtures" / "stim300-six-faces"
    with refused(UsageError, Reason.USAGE, f"{folder.name}`", key="import_files.own"):
        import_files.import_session(ImportOptions(files=[folder / name], output=tmp_path / "session"))
    assert not (tmp_path / "session").exists()


def test_a_log_of_two_buses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.log"
    write_log(path, load_driver("aceinna_can").load_protocol())
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line.replace("can0", f"can{number // 2 % 2}") for number, line in enumerate(lines)))
    assert typed("import", path, "--driver", "aceinna_can", "-o", tmp_path / "mine") == 2
    assert "choose with --channel" in capsys.readouterr().err
    assert typed("import", path, "--driver", "aceinna_can", "--channel", "can1", "-o", tmp_path / "mine") == 0


def test_a_log_in_which_one_of_two_messages_never_comes_is_no_import(tmp_path: Path) -> None:
    path = tmp_path / "half.log"
    write_log(path, load_driver("aceinna_can").load_protocol())
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[::2]))
    options = ImportOptions(files=[path], driver="aceinna_can", output=tmp_path / "mine")
    with refused(RecordingError, Reason.NO_FRAMES, "AccelerationSensor: 500", key="import_files.log_without_samples"):
        import_files.import_session(options)
    assert not (tmp_path / "mine").exists()


def test_matlab_and_every_export_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(2)
    force, rate = rng.normal(size=(N, 3)) + np.array([0, 0, 9.8]), rng.normal(scale=0.1, size=(N, 3))
    savemat(tmp_path / "bench.mat", {"t": np.arange(N) * 0.01, "acc": force, "gyro": rate})
    assert typed("import", tmp_path / "bench.mat", "-o", tmp_path / "mine", "--json") == 0
    assert json.loads(capsys.readouterr().out)["event"] == "imported"
    for to, suffix, package in FORMATS:
        pytest.importorskip(package)
        assert typed("export-data", tmp_path / "mine", "--to", to) == 0
        assert f"{N} samples in {tmp_path / 'mine' / f'samples.{suffix}'}" in " ".join(capsys.readouterr().out.split())
        again = tmp_path / f"again-{to}"
        assert typed("import", tmp_path / "mine" / f"samples.{suffix}", "-o", again) == 0
        np.testing.assert_array_equal(imported(again).accelerometer, force)
        np.testing.assert_array_equal(imported(again).gyroscope, rate)
        capsys.readouterr()
    wrong = ["export-data", str(tmp_path / "mine"), "--to", "ros1"]
    fails(wrong, 2, Reason.USAGE, "'ros1'", "csv: text", key="export_data.unknown_format")
    wrong = ["export-data", str(tmp_path / "mine"), "-o", "samples.xlsx"]
    fails(wrong, 2, Reason.USAGE, "'xlsx'", key="export_data.unknown_format")


@pytest.mark.parametrize("suffix", HEADS)
def test_garbage_is_a_typed_error(tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(HEADS[suffix] + bytes(range(256)) * 3)
    options = ("--driver", "aceinna_can") if suffix in ("blf", "asc", "log") else ()
    assert typed("import", path, *options, "-o", tmp_path / "mine") in (2, 4)
    assert str(path) in capsys.readouterr().err
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_an_import_that_ends_early_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def fail(*_: object, **__: object) -> None:
        if isinstance(error, OSError):
            raise RecordingError("the disk is full", Reason.DISK_FULL) from error
        raise error

    path = tmp_path / "rows.csv"
    path.write_text("time,ax,ay,az\n" + "".join(f"{k / 100},0,0,9.8\n" for k in range(50)))
    monkeypatch.setattr(import_files, "Recorder", fail)
    with pytest.raises((RecordingError, KeyboardInterrupt)) as caught:
        import_files.import_session(ImportOptions(files=[path], output=tmp_path / "new"))
    assert not (tmp_path / "new").exists()
    assert "resume" not in str(caught.value)


def test_a_protocol_that_does_not_exist_is_a_typing_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert typed("import", tmp_path / "x.bin", "--protocol", "nix", "-o", tmp_path / "mine") == 2
    assert "there is no protocol 'nix'" in capsys.readouterr().err
    assert typed("import", tmp_path / "x.bin", "--driver", "nix", "-o", tmp_path / "mine") == 2


def test_sentences_about_cells_are_short_and_have_a_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "table.csv"
    rows = "".join(f"{number / 100},0,0,9.8\n" for number in range(50))
    for cell in ("2026-01-01T00:00:00", "x" * 5000):
        path.write_text(f"t,ax,ay,az\n{rows}{cell},0,0,9.8\n")
        assert typed("import", path, "-o", tmp_path / "mine") == 4
        error = capsys.readouterr().err
        assert "correct or remove it" in error
        assert len(error) < 300
    path.write_text(f"t,ax,ay,az,{'h' * 4000}\n" + rows.replace("\n", ",1\n"))
    assert typed("import", path, "-o", tmp_path / "mine") == 0
    assert len(max(capsys.readouterr().err.splitlines(), key=len)) < 300


def test_a_cell_with_a_colon_has_a_remedy_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "table.csv"
    path.write_text("t,ax,ay,az\n" + "0.01,0,0,9.8\n" * 50 + "a:b,0,0\n")
    assert typed("import", path, "-o", tmp_path / "mine") == 4
    assert "correct or remove it" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["/dev/zero", "x" * 300, "empty.csv"])
def test_what_has_no_end_no_name_or_no_number(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty.csv").write_text("ax,ay,az\n" + "nan,nan,nan\n" * 50)
    for more in ([], ["--protocol", "stim300"]) if name != "empty.csv" else ([],):
        assert run(["import", name, "-o", "new", *more]) in (2, 4)
        said = capsys.readouterr().err
        assert any(words in said for words in ("no end", "check its name", "no numbers in any", "is a device"))
        assert not Path("new").exists()


@pytest.mark.parametrize(
    "command",
    [
        "solve --observations {} -o out.toml",
        "report {}",
        "export {} --to c -o out.h",
        "solve {}",
        "emulate stim300 --positions {}",
    ],
)
def test_small_files_without_end(
    tmp_path: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(command.format("/dev/zero").split()) in (2, 4, 5)
    assert "Traceback" not in capsys.readouterr().err


def write_lines(path: Path, factor: float = 1.0) -> None:
    rng = np.random.default_rng(1)
    force = np.array([0.0, 0.0, 9.8 * factor]) + 0.01 * rng.standard_normal((N, 3))
    np.savetxt(path, np.column_stack([1000 * np.arange(N) / 100, force]), delimiter=",")


def test_the_unit_of_time_and_the_site_are_kept(tmp_path: Path) -> None:
    write_lines(tmp_path / "a.csv")
    typed = ["--set", "time_unit=ms", "--latitude", "45", "--height", "300"]
    assert run(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "here"), *typed]) == 0
    session = Session.open(tmp_path / "here")
    assert session.metadata["site"] == {"latitude_deg": 45.0, "height_m": 300.0}
    samples = concatenate(list(session_samples(session, [])))
    assert np.diff(samples.time_s).mean() == pytest.approx(0.01)
    assert run(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "there"), "--latitude", "95"]) == 2
    assert not (tmp_path / "there").exists()


@pytest.mark.parametrize(
    ("begin_s", "unit", "recorded"),
    [
        (1_767_225_600.5, "s", "2026-01-01T00:00:00Z"),
        (1_767_225_600_500.0, "ms", "2026-01-01T00:00:00Z"),
        (0.0, "s", ""),
        # A clock that is set to the future, and one that has run for three years.
        (4.1e9, "s", ""),
        (9e7, "s", ""),
    ],
)
def test_a_recording_began_when_its_times_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], begin_s: float, unit: str, recorded: str
) -> None:
    steps = np.arange(N) * {"s": 0.01, "ms": 10.0}[unit]
    np.savetxt(tmp_path / "a.csv", np.column_stack([begin_s + steps, np.full((N, 3), 5.7)]), delimiter=",", fmt="%.3f")
    assert run(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "here")]) == 0
    session = Session.open(tmp_path / "here")
    assert session.record.recorded == recorded
    assert (not missing(capsys.readouterr().err, "2026-01-01T00:00:00Z", "UTC")) is bool(recorded)


def test_what_is_told_of_the_instrument_is_kept(tmp_path: Path) -> None:
    instruments = []
    for name in ("january", "february"):
        write_lines(tmp_path / f"{name}.csv")
        who = ["--model", "STIM300 rev D", "--serial", "A17"]
        assert run(["import", str(tmp_path / f"{name}.csv"), "-o", str(tmp_path / name), *who]) == 0
        instruments.append(Session.open(tmp_path / name).record.instrument)
    assert instruments[0] == instruments[1]
    assert (instruments[0].model, instruments[0].serial_number) == ("STIM300 rev D", "A17")


def test_a_name_with_dots_is_the_whole_model(tmp_path: Path) -> None:
    write_lines(tmp_path / "run.3_0.001.csv")
    (tmp_path / "run.4_0.001.csv.gz").write_bytes(gzip.compress((tmp_path / "run.3_0.001.csv").read_bytes()))
    for number, name in ((3, "run.3_0.001.csv"), (4, "run.4_0.001.csv.gz")):
        assert run(["import", str(tmp_path / name), "-o", str(tmp_path / str(number))]) == 0
        assert Session.open(tmp_path / str(number)).record.instrument.model == f"run.{number}_0.001"


def test_a_default_site_is_not_that_of_another_programs_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMUFIELD_LATITUDE_DEG", "45")
    write_lines(tmp_path / "a.csv")
    assert run(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "here")]) == 0
    assert not Session.open(tmp_path / "here").metadata.get("site")


def test_an_import_is_replaced_when_asked_and_nothing_else_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_lines(tmp_path / "a.csv")
    write_lines(tmp_path / "b.csv", 2.0)
    here = tmp_path / "here"

    def imported(name: str, *options: str) -> int:
        return run(["import", str(tmp_path / name), "-o", str(here), *options])

    def level() -> float:
        return float(concatenate(list(session_samples(Session.open(here), []))).accelerometer[:, 2].mean())

    assert imported("a.csv", "--replace") == 0
    once_more = ["import", str(tmp_path / "b.csv"), "-o", str(here)]
    fails(once_more, 4, Reason.UNFINISHED, "--replace", key="import_files.exists")
    go_on = ["capture", "--resume", "--session", str(here), "--retake", "x+0"]
    fails(go_on, 2, Reason.USAGE, f"imufield solve {here}", key="resume.unguided")
    assert imported("nowhere.csv", "--replace") == 4
    assert level() == pytest.approx(9.8, rel=1e-3)
    assert imported("b.csv", "--replace") == 0
    assert level() == pytest.approx(19.6, rel=1e-3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "b.csv", "here"]
    # Solved: what the program keeps for itself is nobody's file.
    (here / ".imufield-reading").touch()
    assert imported("b.csv", "--replace") == 0
    (here / "parameters.toml").touch()
    again = ["import", str(tmp_path / "a.csv"), "-o", str(here), "--replace"]
    fails(again, 2, Reason.USAGE, "parameters.toml", key="import_files.holds_more")
    # Only what works is offered.
    assert "--replace" not in fails(once_more, 4, Reason.UNFINISHED, str(here), key="import_files.exists_and_stays").message
    (here / "parameters.toml").unlink()
    Session.open(here).update(kind="capture")
    fails(again, 2, Reason.USAGE, "capture", key="import_files.no_import")
    fails(["import", str(tmp_path / "a.csv"), "--replace"], 2, Reason.USAGE, "--output", key="import_files.replace_what")


def gappy(n: int = 3000) -> Samples:
    """Return samples with gaps counted and estimated, a night between two of them, flags, and a counter with holes."""
    rng = np.random.default_rng(4)
    step_s = np.full(n, 0.01)
    step_s[[100, 900]], step_s[200], step_s[1500] = 0.04, 0.137, 20_000.0
    status = np.full(n, np.uint32(Status.TIME_ESTIMATED), dtype=np.uint32)
    status[[100, 900]] |= np.uint32(Status.AFTER_GAP)
    status[[200, 1500]] |= np.uint32(Status.GAP_ESTIMATED)
    status[::2] |= np.uint32(Status.STANDING)
    status[:50] |= np.uint32(Status.START_UP)
    status[300] |= np.uint32(Status.ACCELEROMETER_INVALID | 5 << 16)
    counter = (7 + np.arange(n)) % 256
    counter[400:410] = NO_COUNTER
    force = rng.normal(size=(n, 3))
    force[300] = np.nan
    protocol = load_driver("aceinna_can").load_protocol()
    return make_samples(
        5.5 + np.cumsum(step_s),
        force,
        rng.normal(size=(n, 3)),
        units=protocol.units,
        counter=counter,
        status=status,
        temperature_degc=np.where(np.arange(n) % 9 == 0, 21.5, np.nan),
    )


@pytest.mark.parametrize(("to", "suffix"), [("csv", "csv"), ("parquet", "parquet"), ("hdf5", "h5")])
@pytest.mark.parametrize("has_counter", [True, False])
def test_exported_samples_come_back_as_they_were(tmp_path: Path, to: str, suffix: str, has_counter: bool) -> None:
    sent = gappy()
    if not has_counter:
        sent.counter[:] = NO_COUNTER
    path = tmp_path / f"samples.{suffix}"
    export_samples([sent], path, to)
    assert typed("import", path, "-o", tmp_path / "again") == 0
    found = imported(tmp_path / "again")
    for name in ("time_s", "accelerometer", "gyroscope", "temperature_degc", "counter", "status"):
        np.testing.assert_array_equal(getattr(found, name), getattr(sent, name), err_msg=name)
    chain = Chain(ReadingPlan(None), judging=False)
    replay_into(chain, Session.open(tmp_path / "again"), [])
    (counts,) = chain.statistics
    assert (counts.gaps, counts.samples_lost) == (4, 6)
    assert counts.losses_estimated >= 13


def test_a_table_piece_by_piece_keeps_the_counter(tmp_path: Path) -> None:
    sent = gappy()
    export_samples([sent], tmp_path / "samples.csv")
    found = concatenate(table_samples(tmp_path / "samples.csv", None, []))
    np.testing.assert_array_equal(found.counter, sent.counter)
    np.testing.assert_array_equal(found.status, sent.status)
    np.testing.assert_array_equal(found.time_s, sent.time_s)


@pytest.mark.parametrize("name", ["pipe.csv", "pipe.h5"])
def test_a_pipe_is_refused(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for arguments in ((), ("--protocol", "rows_f64")):
        assert typed("import", tmp_path / name, *arguments, "-o", tmp_path / "s") == 2
    assert not (tmp_path / "s").exists()
    with refused(UsageError, Reason.USAGE, name, key="table_samples.pipe"):
        next(table_samples(tmp_path / name, None, []))


@pytest.mark.parametrize(("to", "suffix", "package"), FORMATS)
def test_what_lacks_its_first_values_comes_back(tmp_path: Path, to: str, suffix: str, package: str) -> None:
    pytest.importorskip(package)
    sent = samples_of(load_driver("aceinna_can").load_protocol())
    sent.accelerometer[:141], sent.gyroscope[:141] = np.nan, np.nan
    sent.status[:141] |= np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)
    path = tmp_path / f"start.{suffix}"
    export_samples([sent], path, to)
    assert typed("import", path, "-o", tmp_path / "again") == 0
    found = imported(tmp_path / "again")
    assert np.flatnonzero(np.isnan(found.accelerometer).all(axis=1)).tolist() == list(range(141))
    assert (found.units.accelerometer, found.units.gyroscope) == ("m/s^2", "rad/s")
    np.testing.assert_array_equal(found.accelerometer[141:], sent.accelerometer[141:])
    np.testing.assert_array_equal(found.gyroscope[141:], sent.gyroscope[141:])


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize("name", ["-dash", "new\nline", "it's"])
def test_the_next_command_can_be_pasted_whatever_the_session_is_called(name: str, program: Program) -> None:
    (program.folder / "mine.csv").write_text("time,ax,ay,az\n" + "".join(f"{row / 100},0,0,9.8\n" for row in range(500)))
    imported = program.run("import", "mine.csv", f"--output={name}")
    assert imported.returncode == 0, imported.stderr
    (command,) = re.findall(r"^next: +imufield (.*)$", imported.stdout, re.MULTILINE)
    words = subprocess.run(["bash", "-c", f"printf '%s\\0' {command}"], capture_output=True, check=True, text=True).stdout
    solved = program.run(*words.split("\0")[:-1])
    assert solved.returncode == 6, solved.stderr
