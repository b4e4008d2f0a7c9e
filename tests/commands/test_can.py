"""``--bus``: the commands on real buses of python-can, with the instrument in another process than the program."""

from __future__ import annotations

import csv
import itertools
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
import numpy as np
import pytest

from imufield.acquire.instrument import connect_can
from imufield.acquire.instrument.can_map import parse_map, protocol_from_dbc
from imufield.acquire.instrument.connected import ConnectOptions
from imufield.acquire.instrument.recognise import FEWEST_SAMPLES, Listener
from imufield.acquire.link.can import open_bus, parse_bus
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.can_frame import EXTENDED, pack_frame
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.cli.run import run
from imufield.errors import Reason
from imufield.guide.positions import scheme
from imufield.pipeline.chain import session_samples
from imufield.samples import Status, concatenate
from imufield.simulate.emulator.can import CanEmulator
from imufield.simulate.emulator.core import EmulatorSettings
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.emulator.faults import CanFaults
from imufield.simulate.truth.operator import OperatorSettings
from tests.commands.told import fails, says

if TYPE_CHECKING:
    from tests.commands.conftest import Program

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals, no multicast between processes")

SPEED = 8.0
DATAGRAM_SPEED = 3.0
"""Where each message counts: a datagram that finds the buffer of a busy reader full is gone, as on no real bus."""
NUMBERS = itertools.count()
DBC = """VERSION ""
NS_ :
BS_:
BU_: Imu
BO_ 256 Force: 8 Imu
 SG_ ForceX : 0|16@1- (0.001,0) [-32|32] "m/s2" Vector__XXX
 SG_ ForceY : 16|16@1- (0.001,0) [-32|32] "m/s2" Vector__XXX
 SG_ ForceZ : 32|16@1- (0.001,0) [-32|32] "m/s2" Vector__XXX
 SG_ Count : 48|16@1+ (1,0) [0|65535] "" Vector__XXX
BO_ 257 Rate: 8 Imu
 SG_ RateX : 0|16@1- (0.02,0) [-655|655] "deg/s" Vector__XXX
 SG_ RateY : 16|16@1- (0.02,0) [-655|655] "deg/s" Vector__XXX
 SG_ RateZ : 32|16@1- (0.02,0) [-655|655] "deg/s" Vector__XXX
 SG_ Stamp : 48|16@1+ (1,0) [0|65535] "ms" Vector__XXX
VAL_ 256 ForceX -32768 "not available" ;
VAL_ 256 ForceY -32768 "not available" ;
VAL_ 256 ForceZ -32768 "not available" ;
"""
RIGHT = [
    *(f"accelerometer.{axis}=Force{axis.upper()}" for axis in "xyz"),
    *(f"gyroscope.{axis}=Rate{axis.upper()}" for axis in "xyz"),
    "counter=Count",
    "time=Stamp",
]
"""With a time stamp, so that a guided session does not depend on when a busy machine reads the bus."""
EXCHANGED = [text.replace("RateX", "Rate?").replace("RateY", "RateX").replace("Rate?", "RateY") for text in RIGHT]

Emulate = Callable[..., CanEmulator]


@pytest.fixture
def emulate() -> Iterator[Emulate]:
    """Return a function that starts an instrument: what it speaks, its bus, the positions somebody turns it to."""
    with ExitStack() as stack:

        def start(
            protocol: Protocol,
            bus: str,
            positions: str = "",
            *,
            rounds: int = 1,
            still_s: float = 6.0,
            link: Path | None = None,
            speed: float = SPEED,
            **more: Any,
        ) -> CanEmulator:
            habits = OperatorSettings(hold_s=6.0, initial_still_s=still_s)
            directions = np.tile(scheme(positions).directions(), (rounds, 1)) if positions else ()
            options = Emulation(device="text", rate_hz=100.0, grade="mems", seed=5, directions=directions, operator=habits)
            settings = EmulatorSettings(speed=speed, link=link, **more.pop("run", {}))
            return stack.enter_context(CanEmulator(protocol, make_virtual_imu(options), bus, settings, **more))

        yield start


@pytest.fixture
def multicast() -> str:
    # Linux hands a datagram to all who listen at its port, whatever their group: other tests must not use the same.
    port = 20_000 + (83 * os.getpid() + next(NUMBERS)) % 30_000
    try:
        can.Bus("239.76.0.2", "udp_multicast", port=port).shutdown()
    except (OSError, can.CanError):
        pytest.skip("this machine has no multicast network")
    return f"udp_multicast:239.76.0.2:{port}"


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "my_imu.dbc"
    path.write_text(DBC, encoding="ascii")
    return path


def maps(texts: list[str]) -> list[str]:
    return [part for text in texts for part in ("--map", text)]


def on_slcan(emulator: CanEmulator) -> str:
    return f"{emulator.bus}?sleep_after_open=0"


def guided(bus: str, *options: object) -> list[object]:
    common = ("--positions", "faces6", "--hold-s", 2, "--clock-speed", SPEED, "--latitude", 48, "--json")
    return ["capture", "--bus", bus, *common, *options]


def events(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]


def test_a_guided_session_on_slcan_then_solve(program: Program, emulate: Emulate, dbc: Path) -> None:
    protocol = protocol_from_dbc(dbc, parse_map(RIGHT))
    emulator = emulate(protocol, "slcan", "faces6")
    ended = program.run(*guided(on_slcan(emulator), "--baud", 500000, "--dbc", dbc, *maps(RIGHT)))
    assert ended.returncode == 0, ended.stderr
    told = events(ended.stdout)
    assert [event["event"] for event in told].count("accepted") == 6
    assert not [event for event in told if event.get("reason") == "axes"]
    metadata = Session.newest(program.folder / "imufield-sessions").metadata
    assert metadata["link"] == {"bus": on_slcan(emulator), "bit_rate": 500000, "is_virtual": True}
    assert metadata["instrument"]["driver"] == "my_imu"
    # Everything that decodes it is in the session.
    dbc.unlink()
    solved = program.run("solve", "--json", "--gauge", "symmetric")
    assert solved.returncode == 0, solved.stderr
    document = json.loads(solved.stdout)
    found, truth = document["accelerometer"], emulator.source.imu.instrument.accelerometer  # type: ignore[attr-defined]
    np.testing.assert_allclose(found["bias_m_s2"], truth.bias_m_s2, atol=0.05)
    np.testing.assert_allclose(found["scale"], truth.scale, rtol=0.01)


def test_exchanged_axes_are_refused_by_guide_and_solver(program: Program, emulate: Emulate, dbc: Path) -> None:
    emulator = emulate(protocol_from_dbc(dbc, parse_map(RIGHT)), "slcan", "faces6")
    ended = program.run(*guided(on_slcan(emulator), "--baud", 500000, "--dbc", dbc, *maps(EXCHANGED)))
    assert ended.returncode == 0, ended.stderr
    (refused,) = [event for event in events(ended.stdout) if event.get("reason") == "axes"]
    assert refused["event"] == "rejected"
    assert "x = +y" in json.dumps(refused) or "x = -y" in json.dumps(refused)
    solved = program.run("solve")
    assert solved.returncode == 6
    assert "axes x = " in solved.stderr


def is_listening(multicast: str) -> bool:
    port = int(multicast.rpartition(":")[2])
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


def test_record_from_multicast_then_solve(program: Program, emulate: Emulate, multicast: str) -> None:
    # With the rate, time is that of the counter, and not that at which a busy machine hands datagrams on.
    options = ("--clock-speed", DATAGRAM_SPEED, "--set", "rate_hz=100", "--json")
    process = program.start("record", "--bus", multicast, *options)
    # The positions are shown to a program that listens, however late it starts, and until the last one.
    while sys.platform == "linux" and not is_listening(multicast):
        assert process.poll() is None
        time.sleep(0.05)
    protocol = load_driver("xsens_can").load_protocol()
    # Twice each: of datagrams that a starved program does not fetch in time the system drops some, and with them a position.
    run = {"duration_s": 130.0}
    emulator = emulate(protocol, multicast, "faces6", rounds=2, still_s=10.0, speed=DATAGRAM_SPEED, run=run)
    assert emulator.wait(900)
    process.send_signal(signal.SIGINT)
    output, error = process.communicate(timeout=900)
    assert process.returncode == 130, error
    assert "driver xsens_can, " in error
    told = events(output)[-1]
    assert told["event"] == "recorded"
    assert told["samples"] > 6000
    solved = program.run("solve", "--json", "--latitude", 48)
    assert solved.returncode == 0, solved.stderr
    assert json.loads(solved.stdout)["quality"]["residual_rms_m_s2"] < 0.05


def test_what_is_not_available_is_a_gap(program: Program, emulate: Emulate, multicast: str, dbc: Path) -> None:
    faults = CanFaults(not_available_probability=0.1)
    emulate(protocol_from_dbc(dbc, parse_map(RIGHT)), multicast, faults=faults, speed=DATAGRAM_SPEED)
    options = ("--duration-s", 16, "--clock-speed", DATAGRAM_SPEED)
    arguments = ["record", "--bus", multicast, "--dbc", dbc, *maps(RIGHT), *options]
    ended = program.run(*arguments, "--session", "gaps")
    assert ended.returncode == 0, ended.stderr
    samples = concatenate(session_samples(Session.open(program.folder / "gaps"), []))
    gaps = (samples.status & np.uint32(Status.ACCELEROMETER_INVALID)) != 0
    assert 0.03 < gaps.mean() < 0.2
    lacking = gaps | ((samples.status & np.uint32(Status.GYROSCOPE_INVALID)) != 0)
    assert f"{np.count_nonzero(lacking)} of {len(samples)} samples" in ended.stdout
    assert np.isnan(samples.accelerometer[gaps]).all()
    assert np.linalg.norm(samples.accelerometer[~gaps], axis=1).min() > 9
    assert program.run("export-data", "gaps", "-o", "gaps.csv").returncode == 0
    with (program.folder / "gaps.csv").open(newline="") as file:
        empty = [row["ax"] == "" for row in csv.DictReader(file)]
    assert empty == gaps.tolist()


def test_a_bus_that_goes_and_comes_back_and_a_resume(program: Program, emulate: Emulate, dbc: Path, tmp_path: Path) -> None:
    protocol = protocol_from_dbc(dbc, parse_map(RIGHT))
    bus = f"slcan:{tmp_path / 'imu'}?sleep_after_open=0"
    emulator = emulate(protocol, "slcan", "faces6", link=tmp_path / "imu")
    process = program.start(*guided(bus, "--baud", 500000, "--dbc", dbc, *maps(RIGHT), "--session", "mine"))
    until(process, '"accepted": 1')
    emulator.stop()
    until(process, '"link_lost"')
    emulator = emulate(protocol, "slcan", "faces6", link=tmp_path / "imu")
    until(process, '"link_back"')
    process.terminate()
    assert process.wait(120) == 130
    process.communicate()
    emulator.stop()
    emulate(protocol, "slcan", "faces6", link=tmp_path / "imu")
    # Bus, bit rate, DBC and mapping are those of the session.
    dbc.unlink()
    ended = program.run("capture", "--resume", "--session", "mine", "--clock-speed", SPEED, "--json")
    assert ended.returncode == 0, ended.stderr
    assert events(ended.stdout)[-1]["event"] == "done"
    session = Session.open(program.folder / "mine")
    assert session.finished
    assert len(session.parts) == 2


def until(process: Any, words: str) -> None:
    while words not in process.stdout.readline():
        assert process.poll() is None, process.stderr.read()


def test_ctrl_c_ends_a_recording_whole(program: Program, emulate: Emulate, multicast: str) -> None:
    emulate(load_driver("aceinna_can").load_protocol(), multicast)
    process = program.start("record", "--bus", multicast, "--driver", "aceinna_can", "--session", "mine", "--json")
    until(process, '"recording"')
    process.send_signal(signal.SIGINT)
    output, error = process.communicate(timeout=900)
    assert process.returncode == 130, error
    told = json.loads(output.splitlines()[-1])
    assert told["samples"] == len(concatenate(session_samples(Session.open(program.folder / "mine"), []))) > 0


def test_replay_to_a_bus_and_to_an_adapter(program: Program, emulate: Emulate, multicast: str) -> None:
    emulator = emulate(load_driver("aceinna_can").load_protocol(), "slcan", run={"duration_s": 12.0})
    recorded = program.run(
        *("record", "--bus", on_slcan(emulator), "--driver", "aceinna_can", "--session", "mine"),
        *("--duration-s", 9, "--clock-speed", SPEED),
    )
    assert recorded.returncode == 0, recorded.stderr
    before = concatenate(session_samples(Session.open(program.folder / "mine"), []))
    # As imufield opens it, with room for what arrives while a busy machine lets nobody read.
    with open_bus(parse_bus(multicast)) as bus:
        heard: list[can.Message] = []
        notifier = can.Notifier(bus, [heard.append])
        replayed = program.run("replay", "mine", "--bus", multicast, "--speed", 4)
        # The last ones may still be on their way.
        deadline_s = time.monotonic() + 60
        while f"{len(heard)} frames sent" not in replayed.stdout and time.monotonic() < deadline_s:
            time.sleep(0.05)
        notifier.stop()
    assert replayed.returncode == 0, replayed.stderr
    assert f"{len(heard)} frames sent" in replayed.stdout
    assert len(heard) == pytest.approx(2 * len(before), abs=2)

    # As long as it took, so that even where nobody reads for seconds the instrument is known before the adapter goes away.
    process = program.start("replay", "mine", "--to-pty", "--speed", 1)
    assert process.stdout is not None
    address = process.stdout.readline().split()[5]
    assert address.startswith("slcan:/dev/")
    again = program.run(
        *("record", "--bus", f"{address}?sleep_after_open=0", "--driver", "aceinna_can", "--session", "again"),
        *("--duration-s", 25),
    )
    # The adapter goes away at the end, as when it is unplugged, and is waited for until the time is over.
    assert again.returncode == 3, again.stderr
    assert "disconnected" in again.stderr
    after = concatenate(session_samples(Session.open(program.folder / "again"), []))
    np.testing.assert_array_equal(after.accelerometer, before.accelerometer[: len(after)])
    assert len(after) >= len(before) - 1


def in_this_process(*arguments: object) -> int:
    return run([str(argument) for argument in arguments])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


RECORD = ("record", "--clock-speed", 16, "--duration-s", 1)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--bus", "virtual:nobody", "--driver", "aceinna_can"), 3, "is silent: no frame in 5 s"),
        (("--bus", "slcan:/dev/nowhere", "--driver", "aceinna_can"), 3, "does not exist"),
        (("--bus", "slcan:/dev/nowhere"), 2, "bit rate of"),
        (("--bus", "soketcan:can0"), 2, "did you mean 'socketcan'"),
        (("--bus", "virtual:nobody", "--driver", "stim300"), 4, "give its --port instead of a --bus"),
        (("--bus", "virtual:nobody", "--port", "/dev/ttyUSB0"), 2, "exclude each other"),
        (("--bus", "virtual:nobody", "--protocol", "x.toml", "--dbc", "x.dbc"), 2, "exclude each other"),
        (("--bus", "virtual:nobody", "--map", "accelerometer.x=A"), 2, "with --dbc"),
        (("--bus", "virtual:nobody", "--dbc", "nowhere.dbc", "--map", "gyroscope.x=A"), 4, "cannot be read"),
        (("--bus", "virtual:nobody", "--dbc", "x", "--map", "gyro.x=A"), 2, "did you mean 'gyroscope.x'"),
        (("--port", "/dev/ttyUSB0", "--driver", "aceinna_can"), 2, "is on a CAN bus; name it with --bus"),
        (("--port", "/dev/ttyUSB0", "--dbc", "x.dbc"), 2, "are for a CAN bus"),
    ],
)
def test_what_cannot_be(
    options: tuple[str, ...], code: int, words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert in_this_process(*RECORD, *options) == code
    assert words in capsys.readouterr().err
    assert not (folder / "imufield-sessions").exists()


class Talker:
    """Sends the same messages over and over to a virtual bus."""

    def __init__(self, channel: str, messages: list[can.Message]) -> None:
        self._channel, self._messages = channel, messages
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._talk)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *exc: object) -> None:
        self._stopping.set()
        self._thread.join()

    def _talk(self) -> None:
        with can.Bus(self._channel, "virtual") as bus:
            while not self._stopping.wait(0.002):
                for message in self._messages:
                    bus.send(message)


@pytest.mark.usefixtures("dbc")
@pytest.mark.parametrize(
    ("messages", "options", "code", "words"),
    [
        ([can.Message(is_error_frame=True, arbitration_id=8, data=bytes(8))], (), 3, "only error frames"),
        ([can.Message(arbitration_id=0x123, is_extended_id=False)], (), 3, "identifiers 123 x"),
        (
            [can.Message(arbitration_id=0x123 + one, is_extended_id=False) for one in range(11)],
            ("--driver", "xsens_can"),
            3,
            ", 3 others) gave only 0 samples with xsens_can (5 needed)",
        ),
        # What a file of J1939 looks like that does not say so, from another source address.
        (
            [can.Message(arbitration_id=0x08F02D81, data=bytes(8))],
            ("--dbc", "my_imu.dbc", *maps(RIGHT)),
            3,
            "identifiers=j1939",
        ),
        (
            [can.Message(arbitration_id=one, data=bytes(8)) for one in (0x08F02D80, 0x0CF02A80)],
            (),
            2,
            "choose --driver from aceinna_can, Aceinna MTLT305",
        ),
    ],
)
def test_what_is_heard_is_not_understood(
    messages: list[can.Message],
    options: tuple[str, ...],
    code: int,
    words: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    channel = f"talker-{os.getpid()}-{next(NUMBERS)}"
    with Talker(channel, messages):
        assert in_this_process(*RECORD, "--bus", f"virtual:{channel}", *options) == code
    assert words in capsys.readouterr().err
    assert not (folder / "imufield-sessions").exists()


class Uneven:
    """A link whose host reads seldom: 30 frames of each kind at once, now and then."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic_s(self) -> float:
        return self.now_s

    def read(self) -> Chunk:
        self.now_s += 1.4
        frames = [
            pack_frame(identifier | EXTENDED, bytes(8), self.now_s + 1e-5 * number)
            for number in range(30)
            for identifier in (0x08F02D80, 0x0CF02A80)
        ]
        return Chunk(b"".join(frames), self.now_s, 0)


def test_frames_that_come_in_bursts_are_understood_however_uneven() -> None:
    host = Uneven()
    (candidate,) = connect_can.bus_candidates(ConnectOptions(driver="aceinna_can"))
    listener = Listener(candidate)
    connect_can._listen(host, [listener], host)  # type: ignore[arg-type]
    assert listener.decoder.statistics.samples >= FEWEST_SAMPLES


def test_a_typed_bus_goes_before_a_port_by_default(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "imufield.toml").write_text('port = "/dev/ttyUSB0"\n[mapping]\n"accelerometer.x" = "A"\n', encoding="utf-8")
    fails([*map(str, RECORD), "--bus", "virtual:nobody", "--driver", "aceinna_can"], 2, Reason.USAGE, "--map")
    (folder / "imufield.toml").write_text('port = "/dev/ttyUSB0"\n', encoding="utf-8")
    fails([*map(str, RECORD), "--bus", "virtual:nobody", "--driver", "aceinna_can"], 3, Reason.SILENCE, "virtual:nobody")
    monkeypatch.setenv("IMUFIELD_BUS", "virtual:other")
    gone = [*map(str, RECORD), "--port", "/dev/nowhere", "--driver", "stim300"]
    fails(gone, 3, Reason.PORT_NOT_FOUND, "/dev/nowhere")


def test_probe_of_a_bus_says_who_is_there_and_how_to_read_it(capsys: pytest.CaptureFixture[str]) -> None:
    sbg = [can.Message(arbitration_id=one, is_extended_id=False, data=bytes(8)) for one in (0x121, 0x122)]
    with Talker("probed", sbg):
        assert in_this_process("probe", "--bus", "virtual:probed", "--json") == 0
        (told,) = json.loads(capsys.readouterr().out)["buses"]
        assert in_this_process("probe", "--bus", "virtual:probed") == 0
    command = "imufield capture --bus virtual:probed --driver sbg_can"
    assert (told["bus"], told["found"]["name"], told["command"]) == ("virtual:probed", "sbg_can", command)
    assert told["found"]["samples"] >= 20
    said = capsys.readouterr()
    assert command in said.out
    assert says(said.err, "commands", "probe.listening", places=["virtual:probed"], limit_s=5)
    assert in_this_process("probe", "--bus", "virtual:nobody-probed") == 3
    assert in_this_process("probe", "--bus", "virtual:probed", "--port", "/dev/ttyUSB0") == 2
