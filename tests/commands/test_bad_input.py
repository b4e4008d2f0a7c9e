"""Everything that goes wrong, through the real program: one sentence, the right exit code, no traceback, nothing lost."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import read_session
from imufield.acquire.recording.session import Session
from imufield.cli.run import _interrupted_words
from imufield.errors import Reason
from imufield.pipeline.reading_cache import CACHE_FILE
from imufield.samples import Samples, Status
from imufield.sentences import Sentences
from tests.commands.conftest import FACES
from tests.commands.told import failure, missing, one_sentence

if TYPE_CHECKING:
    from tests.commands.conftest import Program

USAGE, LINK, RECORDING, PARAMETER_FILE, CALIBRATION, INTERRUPTED = 2, 3, 4, 5, 6, 130


@dataclass(frozen=True)
class Case:
    """One line of the table: what is typed, the exit code, and facts (what, where, limit or value, an option)."""

    name: str
    arguments: str
    code: int
    facts: tuple[str, ...]


TYPED = [
    Case("no such port", "capture --port /dev/ttyUSB77", LINK, ("/dev/ttyUSB77", "imufield devices")),
    Case("not a port", "capture --port /dev/null", LINK, ("/dev/null", "imufield devices")),
    Case("unknown address", "record --port gopher://imu", USAGE, ("gopher://imu", "socket://host:port")),
    Case("nobody listens", "record --port socket://127.0.0.1:{free}", LINK, ("127.0.0.1",)),
    Case("unknown driver", "capture --port x --driver stim3000", USAGE, ("stim3000", "stim300", "text")),
    Case("unknown scheme", "capture --port x --positions paper42", USAGE, ("paper42", "paper24")),
    Case("setting without value", "capture --port x --set range", USAGE, ("'range'", "NAME=VALUE")),
    Case("hold too short", "capture --port x --hold-s 0.1", USAGE, ()),
    Case("gravity of the Moon", "capture --port x --gravity 1.62", CALIBRATION, ("1.62 m/s^2", "9.76", "9.84", "--latitude")),
    Case("no latitude", "capture --port x --latitude 91", USAGE, ("91 deg", "90")),
    Case("no height", "capture --port x --height 99999", USAGE, ("99999 m", "9000")),
    Case("height alone", "plan --height 300", USAGE, ("300 m", "--latitude")),
    Case("gravity in g", "solve whole --gravity 1", CALIBRATION, (" 1 m/s^2", "9.76", "9.84", "--latitude")),
    Case("gravity NaN", "solve whole --gravity nan", CALIBRATION, ("nan m/s^2", "9.76", "9.84")),
    Case("nothing to resume", "capture --port x --resume", USAGE, ("--resume",)),
    Case("resume what is not there", "capture --port x --session new --resume", USAGE, ("new", "--resume")),
    Case("resume what is finished", "capture --port x --session whole --resume", USAGE, ("imufield solve whole",)),
    Case("no session at all", "solve", RECORDING, ("imufield capture",)),
    Case("no such session", "solve nowhere", RECORDING, ("nowhere", "session.toml")),
    Case("foreign file", "solve notes.txt", RECORDING, ("notes.txt", "session.toml")),
    Case("unknown model", "solve whole --model cubic", USAGE, ("cubic", "linear, quadratic")),
    Case("preset gauge without preset", "solve whole --gauge preset", USAGE, ("--preset",)),
    Case("foreign preset", "solve whole --preset notes.txt", PARAMETER_FILE, ("notes.txt",)),
    Case("output nowhere", "solve whole -o none/p.toml", PARAMETER_FILE, ("none/p.toml", "--output")),
    Case("output is a folder", "solve whole -o folder", PARAMETER_FILE, ("folder",)),
    Case("zero of two numbers", "solve whole --zero 1,2", USAGE, ("1,2",)),
    Case("session and means", "solve whole --observations means.csv", USAGE, ("--observations",)),
    Case("NaN in the means", "solve --observations nan.csv", RECORDING, ("nan.csv", "line 4", "ay")),
    Case("too few means", "solve --observations few.csv", CALIBRATION, ("5", "6")),
    Case("means without columns", "solve --observations notes.txt", RECORDING, ("notes.txt",)),
    Case("no such table", "import none.csv", RECORDING, ("none.csv",)),
    Case("bytes as a table", "import noise.bin", RECORDING, ("noise.bin", "--protocol")),
    Case("noise as a dump", "import noise.bin --protocol stim300", RECORDING, ("noise.bin", "100000 bytes", "--protocol")),
    Case("unknown protocol", "import noise.bin --protocol stim301", USAGE, ("stim301", "stim300")),
    Case("rate for a dump", "import noise.bin --protocol stim300 --rate-hz 5", USAGE, ("rate_hz", "2000")),
    Case("unknown format", "export-data whole --to xls", USAGE, ("xls", "csv")),
    Case("export nowhere", "export-data whole -o none/s.csv", RECORDING, ("none/s.csv",)),
    Case("export over a folder", "export-data whole -o folder", RECORDING, ("folder",)),
    Case("unknown instrument", "emulate stim301", USAGE, ("stim301", "stim300")),
    Case("rate it has not", "emulate stim300 --rate-hz 333", USAGE, ("333 Hz", "125, 250")),
    Case("unknown form", "emulate witmotion --form usart", USAGE, ("usart", "uart, bluetooth, card")),
    Case("form of one format", "emulate stim300 --form usart", USAGE, ("usart", "stim300", "--form")),
    Case("form on a bus", "emulate aceinna_can --form usart", USAGE, ("usart", "aceinna_can", "--form")),
    Case("unknown fault", "emulate stim300 --fault fire=1", USAGE, ("fire", "stalls_per_s")),
    Case("replay nowhere", "replay nowhere", RECORDING, ("nowhere",)),
    Case("unknown key of imufield.toml", "-C bad/imufield.toml devices", USAGE, ("colour", "latitude")),
]


@pytest.fixture
def furnished(program: Program, whole_session: Path) -> Program:
    """A folder with one good session and files that are not what they should be."""
    folder = program.folder
    # As at a first use: nothing kept of the session, and no secret to keep it by, so that whatever is written is seen.
    shutil.rmtree(folder / "home")
    (folder / "home").mkdir()
    shutil.copytree(whole_session, folder / "whole", ignore=shutil.ignore_patterns(CACHE_FILE))
    (folder / "folder").mkdir()
    (folder / "notes.txt").write_text("Dear diary,\n")
    (folder / "noise.bin").write_bytes(np.random.default_rng(5).bytes(100_000))
    (folder / "few.csv").write_text("ax,ay,az\n" + "".join(f"0,0.{k},9.8\n" for k in range(5)))
    (folder / "nan.csv").write_text("ax,ay,az\n0,0,9.8\n0,0,-9.8\n0,nan,0\n" + "9.8,0,0\n" * 9)
    return program


@pytest.fixture(scope="module")
def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return int(server.getsockname()[1])


@pytest.mark.parametrize("case", TYPED, ids=lambda case: case.name)
def test_what_is_typed(case: Case, furnished: Program, free_port: int) -> None:
    arguments = case.arguments.format(free=free_port).split()
    if arguments[0] == "-C":
        (furnished.folder / "imufield.toml").write_text('colour = "red"\n')
        arguments = arguments[2:]
    before = sorted(furnished.folder.rglob("*"))
    ended = furnished.run(*arguments)
    assert ended.returncode == case.code, ended.stderr
    assert ended.stdout == ""
    if case.facts:
        assert not missing(one_sentence(ended.stderr), *case.facts)
    assert sorted(furnished.folder.rglob("*")) == before


@pytest.fixture
def wire() -> Iterator[tuple[int, str]]:
    """The far end and the name of a port on which nothing happens by itself."""
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.set_blocking(master, False)
    yield master, name
    os.close(slave)
    os.close(master)


def test_silence(program: Program, wire: tuple[int, str]) -> None:
    ended = program.run("capture", "--port", wire[1], "--driver", "stim300", "--clock-speed", 16)
    assert ended.returncode == LINK
    assert not missing(one_sentence(ended.stderr), wire[1], "5 s", "921600 bit/s")
    assert not list(program.folder.rglob("session.toml"))


@pytest.mark.parametrize("driver", [("--driver", "stim300"), ()], ids=["stim300", "any driver"])
def test_noise_as_of_a_wrong_bit_rate(program: Program, wire: tuple[int, str], driver: tuple[str, ...]) -> None:
    process = program.start("capture", "--port", wire[1], *driver, "--clock-speed", 4)
    noise = np.random.default_rng(7).bytes(1 << 16)
    while process.poll() is None:
        try:
            os.write(wire[0], noise)
        except BlockingIOError:
            signal.sigtimedwait([], 0.01)
    output, error = process.communicate()
    assert (process.returncode, output) == (LINK, "")
    assert not missing(one_sentence(error), wire[1], "stim300", "--baud", "--protocol")
    assert not list(program.folder.rglob("session.toml"))


def test_wrong_protocol(program: Program) -> None:
    port = program.emulate("--positions", "none", driver="text", rate_hz=100)
    ended = program.run("record", "--port", port, "--driver", "stim300", "--duration-s", 5, "--clock-speed", 16)
    assert ended.returncode == LINK
    assert not missing(one_sentence(ended.stderr), port, "stim300", "--driver", "--protocol")


def test_a_port_that_another_program_holds(program: Program) -> None:
    port = program.emulate("--positions", "none")
    first = program.start("record", "--port", port, "--driver", "stim300", "--clock-speed", 16, "--json")
    assert first.stdout is not None
    assert '"recording"' in first.stdout.readline()
    second = program.run("capture", "--port", port)
    assert second.returncode == LINK
    assert not missing(one_sentence(second.stderr), port, first.pid)
    first.send_signal(signal.SIGINT)
    assert first.wait(120) == INTERRUPTED


def test_no_permission(program: Program, wire: tuple[int, str]) -> None:
    Path(wire[1]).chmod(0)
    ended = program.run("capture", "--port", wire[1], at_start=[("give_up_privileges",)])
    assert ended.returncode == LINK
    assert not missing(one_sentence(ended.stderr), wire[1], "usermod")


def bytes_on_disk(session: Session) -> int:
    return sum(len(item.data) for item in read_session(session) if isinstance(item, Chunk))


def only_session(folder: Path) -> Session:
    (session,) = Session.newest_first(folder / "imufield-sessions")
    return Session.open(session)


def test_unplugged_while_recording(program: Program) -> None:
    link = program.folder / "imu"
    faults = ("--fault", "disconnect_at_s=12", "--fault", "disconnect_s=5")
    port = program.emulate("--positions", "none", "--wait", "--link", link, *faults)
    ended = program.run("record", "--port", port, "--driver", "stim300", "--clock-speed", 16, "--duration-s", 40)
    assert ended.returncode == 0, ended.stderr
    said = ended.stderr.splitlines()
    (lost,) = [number for number, line in enumerate(said) if port in line and "back" in line]
    assert any("back" in line for line in said[lost + 1 :]), said
    session = only_session(program.folder)
    assert session.finished
    assert str(session.name) in ended.stdout
    # Far more than what came before the fault; a busy computer opens the port later.
    assert bytes_on_disk(session) > 20 * 125 * 25


def test_unplugged_while_capturing(program: Program) -> None:
    link = program.folder / "imu"
    faults = ("--fault", "disconnect_at_s=30", "--fault", "disconnect_s=5")
    port = program.show(*FACES, options=("--link", link, *faults))
    ended = program.run(*program.capture(port, "--json"))
    assert ended.returncode == 0, ended.stderr
    kinds = [json.loads(line).get("event") for line in ended.stdout.splitlines()]
    assert kinds.count("link_lost") == kinds.count("link_back") == 1
    assert "accepted" in kinds[: kinds.index("link_lost")]
    assert "link_back" in kinds[kinds.index("link_lost") :]
    assert kinds.count("accepted") == 6
    assert program.run("solve").returncode == 0


def test_disk_full_while_recording(program: Program) -> None:
    port = program.emulate("--positions", "none", rate_hz=2000)
    arguments = ("record", "--port", port, "--driver", "stim300", "--clock-speed", 16)
    ended = program.run(*arguments, at_start=[("limit_file_size", 1_000_000)])
    assert ended.returncode == RECORDING
    said = one_sentence(ended.stderr)
    assert not missing(said, "part-001.mcap", "space", Sentences("imufield.commands")("record.remedy"))
    assert "resume" not in said
    assert bytes_on_disk(only_session(program.folder)) > 300_000
    # What it advises is possible beside what is there.
    assert program.run(*arguments, "--duration-s", 32).returncode == 0


def test_disk_full_while_capturing(program: Program) -> None:
    port = program.emulate("--positions", "none", rate_hz=2000)
    ended = program.run(*program.capture(port), at_start=[("limit_file_size", 1_000_000)])
    assert ended.returncode == RECORDING
    assert not missing(one_sentence(ended.stderr), "space", Sentences("imufield.commands.terminal")("guided.remedy"))
    session = only_session(program.folder)
    assert not session.finished
    assert f"--resume --session {session.folder.relative_to(program.folder)}" in ended.stdout
    assert bytes_on_disk(session) > 300_000


@pytest.mark.parametrize(
    ("arguments", "code"), [("import rows.csv --rate-hz 100", 4), ("export-data whole", 4), ("solve whole", 5)]
)
def test_disk_full_at_a_desk(furnished: Program, arguments: str, code: int) -> None:
    rows = np.random.default_rng(0).normal(0, 1, (4_000, 6)).round(4)
    np.savetxt(furnished.folder / "rows.csv", rows, fmt="%.4f", delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")
    before = sorted((furnished.folder / "whole").iterdir())
    ended = furnished.run(*arguments.split(), at_start=[("limit_file_size", 10_000)])
    assert ended.returncode == code, ended.stderr
    assert "space" in one_sentence(ended.stderr)
    assert sorted((furnished.folder / "whole").iterdir()) == before


@pytest.mark.parametrize("command", ["capture", "record"])
def test_a_folder_deleted_while_it_is_written(program: Program, command: str) -> None:
    port = program.emulate("--positions", "none")
    arguments = program.capture(port, "--json") if command == "capture" else ("record", "--port", port, "--json")
    process = program.start(*arguments, variables={"IMUFIELD_CLOCK_SPEED": "16"})
    assert process.stdout is not None
    while '"noise_floor"' not in (line := process.stdout.readline()) and '"recording"' not in line:
        assert line
    shutil.rmtree(only_session(program.folder).folder)
    _, error = process.communicate(timeout=900)
    assert process.returncode == RECORDING
    assert not missing(one_sentence(error), "part-001.mcap", "deleted")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that nobody may write to, root included")
@pytest.mark.parametrize("command", ["capture", "record"])
def test_a_folder_that_cannot_be_written(program: Program, command: str) -> None:
    port = program.emulate("--positions", "none")
    ended = program.run(command, "--port", port, "--driver", "stim300", "--clock-speed", 16, "--session", "/proc/self/session")
    assert ended.returncode == RECORDING
    assert "/proc/self/session" in one_sentence(ended.stderr)


def test_standard_output_that_is_closed(program: Program) -> None:
    port = program.emulate("--positions", "none")
    arguments = ("record", "--port", port, "--driver", "stim300", "--clock-speed", 16, "--duration-s", 2)
    ended = program.run(*arguments, preexec_fn=lambda: os.close(1))
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    session = only_session(program.folder)
    assert session.finished
    assert bytes_on_disk(session) > 125 * 38


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
@pytest.mark.parametrize("command", ["capture", "record"])
def test_interrupted(program: Program, command: str, number: signal.Signals) -> None:
    port = program.emulate("--positions", "none")
    arguments = program.capture(port, "--json") if command == "capture" else ("record", "--port", port, "--json")
    process = program.start(*arguments, variables={"IMUFIELD_CLOCK_SPEED": "16"})
    assert process.stdout is not None
    # Until a second of samples has come: on a busy machine the first that is told of a recording may have few.
    while (event := json.loads(process.stdout.readline())).get("event") != "noise_floor":
        if event.get("samples", 0) > 125:
            break
    process.send_signal(number)
    output, error = process.communicate(timeout=900)
    assert process.returncode == INTERRUPTED, error
    assert one_sentence(error) == f"{_interrupted_words([command], KeyboardInterrupt())}."
    session = only_session(program.folder)
    assert bytes_on_disk(session) > 125 * 38
    assert session.finished == (command == "record")
    assert ('"recorded"' in output) == (command == "record")


def test_nohup_lets_a_recording_go_on_when_the_terminal_is_closed(program: Program) -> None:
    port = program.emulate("--positions", "none")
    arguments = ("record", "--port", port, "--json", "--clock-speed", 16)
    process = program.start(*arguments, at_start=[("ignore_hangup",)])
    assert process.stdout is not None
    assert '"recording"' in process.stdout.readline()
    process.send_signal(signal.SIGHUP)
    for _ in range(3):
        assert '"recording"' in process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    process.communicate()
    assert process.returncode == INTERRUPTED


def test_interrupted_while_replaying_to_a_port(furnished: Program) -> None:
    process = furnished.start("replay", "whole", "--to-pty")
    assert process.stdout is not None
    assert "/dev/" in process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=900)
    assert process.returncode == INTERRUPTED
    assert "Traceback" not in error


DAMAGES: dict[str, tuple[Callable[[Path], object], int, Reason, tuple[str, ...]]] = {
    "part is foreign": (
        lambda folder: part(folder).write_bytes(b"hello" * 1000),
        RECORDING,
        Reason.NOT_A_RECORDING,
        ("part-001.mcap",),
    ),
    "part is gone": (lambda folder: part(folder).unlink(), RECORDING, Reason.DAMAGED, ("part-001.mcap",)),
    "part is empty": (lambda folder: part(folder).write_bytes(b""), RECORDING, Reason.DAMAGED, ("part-001.mcap",)),
    "part is cut to its head": (
        lambda folder: cut(part(folder), 300),
        RECORDING,
        Reason.DAMAGED,
        ("part-001.mcap", " byte"),
    ),
    "part is cut to some seconds": (
        lambda folder: cut(part(folder), 150_000),
        RECORDING,
        # How much a block holds depends on the speed of the disk: a few positions are left, or nothing.
        Reason.DAMAGED,
        ("part-001.mcap", " byte"),
    ),
    "session.toml is cut": (
        lambda folder: cut(folder / "session.toml", 40),
        RECORDING,
        Reason.DAMAGED,
        ("session.toml", "`created`"),
    ),
    "session.toml is newer": (
        lambda folder: edit(folder, "version = 1", "version = 9"),
        RECORDING,
        Reason.NEWER,
        ("version 9",),
    ),
    "unknown key": (
        lambda folder: edit(folder, 'kind = "', 'colour = "red"\nkind = "'),
        RECORDING,
        Reason.UNKNOWN_KEY,
        ("`colour`",),
    ),
    "unknown scheme": (
        lambda folder: edit(folder, '"paper24"', '"paper42"'),
        RECORDING,
        Reason.DAMAGED,
        ("paper42", "paper24"),
    ),
}


def part(folder: Path) -> Path:
    return folder / "part-001.mcap"


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def edit(folder: Path, old: str, new: str) -> None:
    path = folder / "session.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_session(furnished: Program, capsys: pytest.CaptureFixture[str], damage: str) -> None:
    spoil, code, reason, facts = DAMAGES[damage]
    spoil(furnished.folder / "whole")
    error = failure("solve", furnished.folder / "whole")
    assert (error.exit_code, error.reason) == (code, reason)
    assert not missing(one_sentence(capsys.readouterr().err), *facts)


def test_a_damaged_part_is_used_as_far_as_it_can_be_read(furnished: Program) -> None:
    path = part(furnished.folder / "whole")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    ended = furnished.run("solve", "whole")
    assert ended.returncode in (0, CALIBRATION), ended.stderr
    told = ended.stdout + ended.stderr
    assert "part-001.mcap" in told.replace("\n   ", " ")
    assert "Traceback" not in told


def swap(samples: Samples) -> Samples:
    return replace(samples, gyroscope=samples.gyroscope[:, [1, 0, 2]])


def swap_force(samples: Samples) -> Samples:
    return replace(samples, accelerometer=samples.accelerometer[:, [0, 2, 1]])


def mirror(samples: Samples) -> Samples:
    return replace(samples, accelerometer=samples.accelerometer * [1, -1, 1])


def turn_round(samples: Samples) -> Samples:
    return replace(samples, gyroscope=-samples.gyroscope)


def saturate(samples: Samples) -> Samples:
    """Clip the y axis at 0.7 g, as an instrument does that says so in its status."""
    clipped = np.clip(samples.accelerometer, [-99, -7, -99], [99, 7, 99])
    hit = (clipped != samples.accelerometer).any(axis=1)
    status = np.where(hit, samples.status | np.uint32(Status.ACCELEROMETER_SATURATED), samples.status)
    return replace(samples, accelerometer=clipped, status=status)


def stick(samples: Samples) -> Samples:
    return replace(samples, accelerometer=np.clip(samples.accelerometer, [-99, -7, -99], [99, 7, 99]))


MEASURED: dict[str, tuple[dict[str, Any], Reason, tuple[str, ...]]] = {
    "gyroscope axes swapped": ({"change": swap}, Reason.HANDEDNESS, ("x = +y, y = +x, z = +z", "20 deg")),
    "accelerometer axes swapped": ({"change": swap_force}, Reason.HANDEDNESS, ("x = -x, y = -z, z = -y", "20 deg")),
    "left-handed accelerometer": ({"change": mirror}, Reason.HANDEDNESS, ("x = -x, y = +y, z = -z", "20 deg")),
    "gyroscope signs turned round": ({"change": turn_round}, Reason.HANDEDNESS, ("x = -x, y = -y, z = -z", "20 deg")),
    "too few positions": ({"visits": 4}, Reason.TOO_FEW, ("5 positions", "6", "19 left")),
    "saturated axis": ({"positions": "faces6", "change": saturate}, Reason.SATURATED, ("4 positions", "6", "axis y")),
    "saturated axis, unsaid": (
        {"positions": "faces6", "change": stick},
        Reason.SATURATED,
        ("4 positions", "6", "axis y", "range"),
    ),
}


@pytest.mark.parametrize("name", MEASURED)
def test_what_was_measured(make_session: Callable[..., Session], capsys: pytest.CaptureFixture[str], name: str) -> None:
    options, reason, facts = MEASURED[name]
    session = make_session(**{"positions": "corners24", **options})
    before = {path.name: path.stat().st_size for path in session.folder.iterdir()}
    error = failure("solve", session.folder)
    assert (error.exit_code, error.reason) == (CALIBRATION, reason)
    assert not missing(one_sentence(capsys.readouterr().err), *facts)
    assert {path.name: path.stat().st_size for path in session.folder.iterdir()} == before


def test_six_faces_give_scale_and_bias_and_refuse_the_rest(program: Program, make_session: Callable[..., Session]) -> None:
    session = make_session("faces6")
    ended = program.run("solve", session.folder)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("not estimated") == 3
    text = " ".join(ended.stdout.split())
    assert "not observable, so set to zero: misalignment" in text
    assert "Verdict: POOR" in text or "Verdict: USABLE" in text
    assert "nan" not in text
