"""Sessions and folders of somebody else: links, pipes, names that are no UTF-8. Nothing hangs, nothing outside is touched."""

from __future__ import annotations

import codecs
import os
import shutil
import signal
import subprocess
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import pytest
import tomli_w

from imufield import files
from imufield.acquire.instrument.connected import ConnectOptions
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import LOCK_FILE, Session
from imufield.acquire.registry import load_driver
from imufield.cli import _bytes_or_codes
from imufield.cli.run import run
from imufield.commands.terminal.resume import connect_as_before
from imufield.errors import ProtocolError, Reason, RecordingError, UsageError
from imufield.guide.positions import SCHEME_FILE
from tests.commands.conftest import IMUFIELD
from tests.commands.told import fails, failure
from tests.refused import refused

if TYPE_CHECKING:
    from tests.commands.conftest import Program

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with a name and links")

RESULTS = "parameters.verification.json"
LONGEST_S = 20
NOT_UTF8 = os.fsdecode(b"caf\xe9")
READERS = (
    "solve S -o out.toml",
    "export-data S -o out.csv",
    "replay S",
    "noise S -o out.csv",
    "report S --output out.html --record record.html",
    "verify S S -o out.json",
    "export S --to c -o out.h",
)


@pytest.fixture
def session(short_solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(short_solved, tmp_path / "S")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "S"


@pytest.fixture(autouse=True)
def _in_time() -> Iterator[None]:
    def too_late(number: int, frame: FrameType | None) -> None:
        raise AssertionError("it hangs")

    before = signal.signal(signal.SIGALRM, too_late)
    # Several commands a test, on a busy machine.
    signal.alarm(10 * LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def refuses(line: str) -> None:
    """Run a command that must end with the code of an error, or be content without the file; never with a traceback."""
    assert run(line.split()) in (0, 2, 4, 5, 6, 7), line


# Neither a lock nor results keep a reader from the other of them.
@pytest.mark.parametrize(
    "names", [("session.toml",), ("part-001.mcap",), ("parameters.toml",), (LOCK_FILE, RESULTS)], ids=" ".join
)
def test_a_pipe_in_a_session_hangs_nothing(session: Path, names: tuple[str, ...]) -> None:
    for name in names:
        (session / name).unlink(missing_ok=True)
        os.mkfifo(session / name)
    for line in READERS:
        refuses(line)
    if (name := names[0]) in ("session.toml", "part-001.mcap"):
        fails("solve S -o out.toml", 4, Reason.DAMAGED if name == "session.toml" else Reason.NOT_A_RECORDING, "pipe")
        fails("export-data S -o out.csv", 4, Reason.DAMAGED if name == "session.toml" else Reason.NOT_A_RECORDING, "pipe")


@pytest.mark.parametrize("name", ["session.toml", "part-001.mcap", "parameters.toml"])
def test_a_link_in_a_session_is_not_followed(session: Path, name: str) -> None:
    (session / name).rename(session.parent / "outside")
    (session / name).symlink_to("../outside")
    line = "export S --to c -o out.h" if name == "parameters.toml" else "solve S -o out.toml"
    error = failure(*line.split())
    assert "link" in error.message


def test_a_lock_that_is_a_link_destroys_nothing(session: Path) -> None:
    victim = session.parent / "victim"
    for content in (b"precious", None):
        if content is None:
            victim.unlink()
        else:
            victim.write_bytes(content)
        (session / LOCK_FILE).unlink(missing_ok=True)
        (session / LOCK_FILE).symlink_to("../victim")
        opened = Session.open(session)
        assert not opened.is_being_recorded
        with refused(RecordingError, Reason.FOREIGN, LOCK_FILE, "link", key="files.no_file"), opened.lock():
            pass
        assert (victim.read_bytes() if victim.exists() else None) == content


def test_no_file_of_a_session_is_written_through_a_link(session: Path) -> None:
    victim = session.parent / "victim"
    made = ["samples.csv", "report.html", "calibration-record.html", "parameters.toml", RESULTS]
    for name in made:
        (session / name).unlink(missing_ok=True)
        (session / name).symlink_to("../victim")
    victim.write_bytes(b"precious")
    for line in ("solve S", "export-data S", "report S", "verify S S"):
        run(line.split())
        assert victim.read_bytes() == b"precious", line
    for name in ("session.toml", "part-002.mcap"):
        (session / name).unlink(missing_ok=True)
        (session / name).symlink_to("../victim")
    run(["capture", "--resume", "--session", "S"])
    assert victim.read_bytes() == b"precious"


def edit(session: Path, **changes: object) -> None:
    content = tomllib.loads((session / "session.toml").read_text())
    (session / "session.toml").write_text(tomli_w.dumps(content | changes))


def test_a_session_names_no_file_elsewhere(session: Path) -> None:
    (session.parent / "mine.toml").write_text("[[position]]\nup = [0, 0, 1]\n")
    edit(session, scheme=str(session.parent / "mine.toml"))
    fails("solve S -o out.toml", 4, Reason.DAMAGED, "session.toml", "scheme", key="chain.scheme")
    edit(session, scheme=SCHEME_FILE)
    (session / SCHEME_FILE).symlink_to("../mine.toml")
    fails("solve S -o out.toml", 2, Reason.USAGE, SCHEME_FILE, "link", key="positions.cannot_read")


@pytest.mark.parametrize(
    ("settings", "now"),
    [
        ({"gyroscope_output": "increment"}, "accelerometer in m/s^2, gyroscope in rad per 0.008 s"),
        ({"accelerometer_output": "increment"}, "accelerometer in m/s per 0.008 s, gyroscope in rad/s"),
    ],
)
def test_parts_with_other_units_are_told_by_both_triads(session: Path, settings: dict[str, str], now: str) -> None:
    protocol = load_driver("stim300").load_protocol({"rate_hz": 125.0, **settings})
    with Recorder(Session.open(session).add_part(), part_metadata(protocol, {})):
        pass
    before = "accelerometer in m/s^2, gyroscope in rad/s"
    fails("solve S -o out.toml", 4, Reason.UNITS, before, now, key="session_decoder.units")


def test_a_session_opens_no_address_that_writes_files(session: Path) -> None:
    victim = session.parent / "victim"
    edit(session, link={"port": f"spy:///dev/null?file={victim}"})
    with refused(UsageError, Reason.USAGE, "--port", key="resume.port"):
        connect_as_before(ConnectOptions(), Session.open(session))
    assert not victim.exists()
    for port in ("/dev/ttyUSB0", "COM3", "socket://192.168.1.5:4001"):
        edit(session, link={"port": port})
        assert connect_as_before(ConnectOptions(), Session.open(session)).port == port


@pytest.mark.parametrize("name", ["/etc/hosts", "../outside.dbc", "beside.dbc"])
def test_a_protocol_reads_no_dbc_elsewhere(tmp_path: Path, name: str) -> None:
    from imufield.acquire.protocol.protocol import load_protocol

    (tmp_path / "outside.dbc").write_text("")
    (tmp_path / "P").mkdir()
    (tmp_path / "P" / "beside.dbc").symlink_to("../outside.dbc")
    path = tmp_path / "P" / "p.toml"
    path.write_text(f'format = "imufield-protocol"\nversion = 1\nkind = "can"\n[can]\ndbc = "{name}"\n')
    key = "protocol.no_dbc" if name == "beside.dbc" else "protocol.dbc_elsewhere"
    with refused(ProtocolError, Reason.BAD_PROTOCOL, name, key=key):
        load_protocol(path)


def test_history_writes_nothing_into_the_folder(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(session / "pipe.toml")
    before = sorted(session.iterdir())
    assert run(["history", "S"]) == 0
    assert sorted(session.iterdir()) == before
    assert "STIM" in capsys.readouterr().out.upper()


def test_means_come_through_a_pipe(session: Path) -> None:
    rows = tomllib.loads((session / "parameters.toml").read_text())["position"]
    means = "ax,ay,az\n" + "".join(",".join(map(str, row["mean_raw"])) + "\n" for row in rows)
    Path("means.csv").write_text(means)
    os.mkfifo("means")
    writer = threading.Thread(target=lambda: Path("means").write_text(means), daemon=True)
    writer.start()
    assert run(["solve", "--observations", "means", "-o", "piped.toml", "--latitude", "48"]) == 0
    writer.join()
    assert run(["solve", "--observations", "means.csv", "-o", "file.toml", "--latitude", "48"]) == 0
    piped, file = (tomllib.loads(Path(name).read_text()) for name in ("piped.toml", "file.toml"))
    assert piped["session"]["sha256"] == file["session"]["sha256"]
    assert str(piped["accelerometer"]) == str(file["accelerometer"])


@pytest.mark.parametrize("line", ["solve --observations pipe -o out.toml", "report S --parameters pipe"])
def test_a_pipe_that_nobody_writes_to_is_no_reason_to_wait(session: Path, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "PIPE_OPEN_LIMIT_S", 0.1)
    os.mkfifo(session.parent / "pipe")
    assert "pipe" in failure(*line.split()).message


def test_defaults_in_a_pipe_are_refused(session: Path) -> None:
    # Passed over, the place that somebody wrote there would be missing without a word.
    os.mkfifo(session.parent / "imufield.toml")
    fails("devices", 2, Reason.USAGE, "pipe")


def test_names_that_are_no_utf8(session: Path, program: Program) -> None:
    folder = session.parent / NOT_UTF8
    try:
        session.rename(folder)
    except OSError:
        pytest.skip("this file system has names of UTF-8 alone")
    for arguments in (
        ("solve", folder),
        ("export-data", folder, "-o", f"{NOT_UTF8}.csv"),
        ("import", f"{NOT_UTF8}.csv", "-o", "again"),
        ("report", folder),
        ("certificate", folder, "--operator", NOT_UTF8),
        ("history", session.parent, "--csv", "table.csv"),
    ):
        done = program.run(*arguments)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
    assert tomllib.loads((folder / "parameters.toml").read_text("utf-8"))["session"]["name"] == "caf\ufffd"
    assert "caf\ufffd/parameters.toml" in Path("table.csv").read_text("utf-8")
    # What is printed for a script is the name that can be opened.
    found = program.run("history", session.parent, "--at", "2026-01-01", errors="surrogateescape").stdout
    assert Path(found.strip()).is_file()
    # The second time from the index.
    assert program.run("history", session.parent).returncode == 0


def test_letters_that_an_encoding_lacks_end_nothing(session: Path, program: Program) -> None:
    document = tomllib.loads((session / "parameters.toml").read_text("utf-8"))
    document["instrument"]["serial_number"] = "Łódź-7"
    document["integrity"]["sha256"] = "edited"
    (session / "parameters.toml").write_text(tomli_w.dumps(document), "utf-8")
    # No fork of another: the interpreter opens its streams.
    line, variables = [*IMUFIELD, "history", "."], program.environment({"PYTHONIOENCODING": "gbk"})
    done = subprocess.run(line, check=True, capture_output=True, encoding="gbk", env=variables, cwd=session.parent)
    # Each letter of the two that it has none of, as its code; what it has stays.
    assert r"\u0141" in done.stdout
    assert "ó" in done.stdout


def test_a_byte_beside_a_letter_that_an_encoding_lacks_stays_a_byte() -> None:
    codecs.register_error("tests.pipe", _bytes_or_codes)
    assert "a\udce4\u0141b".encode("latin-1", "tests.pipe") == rb"a" + b"\xe4" + rb"\u0141b"
    assert "\u0141\udce4".encode("ascii", "tests.pipe") == rb"\u0141" + b"\xe4"


def test_a_path_beyond_the_limit_is_refused_before_the_work(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deep = session.parent
    # One level at a time: no longer path is taken at once.
    for _ in range(25):
        os.chdir(deep)
        deep = Path("d" * 200)
        deep.mkdir()
    shutil.copy(session / "parameters.toml", deep)
    os.chdir(session.parent)
    assert run(["history", "."]) == 0
    assert "left out" in capsys.readouterr().err
    error = fails(["solve", "S", "-o", "/".join(["d" * 200] * 25) + "/p.toml"], 5, Reason.USAGE, key="files.long_name")
    assert "position" not in error.message


@pytest.mark.parametrize("line", ["solve S -o out.toml", "export-data S -o out.csv", "replay S"])
def test_one_answer_where_the_copy_of_the_protocol_is_damaged(session: Path, line: str) -> None:
    content = tomllib.loads((session / "session.toml").read_text())
    edit(session, protocol=content["protocol"] | {"text": "no = [protocol"})
    assert run(line.split()) == 0
