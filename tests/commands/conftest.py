"""The real program in processes of its own, emulated instruments for it, and recorded sessions made without a port."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import RecordedEvent, read_session
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.cli.run import run
from imufield.guide.positions import scheme
from imufield.pipeline.chain import ROTATIONS
from imufield.pipeline.solving import read_recording
from imufield.samples import Samples
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.instruments.stim300 import Stim300Device
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu
from imufield.simulate.wire.stim300 import Stim300Format
from tests.commands import at_start
from tests.commands.pty_terminal import Terminal
from tests.conftest import write_secret

IMUFIELD = [sys.executable, "-m", "imufield"]
# Libraries leave variables behind in this process (Dask: PYTHONHASHSEED), which are nothing to the programs.
AT_START = {name: value for name, value in os.environ.items() if not name.startswith("IMUFIELD_")}
SPEED = 16.0
RATE_HZ = 125.0
FACES = tuple(position.name for position in scheme("faces6").positions)
LONGEST_S = 900.0  # Only a program that hangs takes so long, however busy the machine.
CHUNK_SAMPLES = 5
BLOCK_CHUNKS = 200  # made at once; what is recorded is the same whatever it is


@dataclass
class Program:
    """Runs imufield in a folder of its own, with a home of its own and nobody's defaults."""

    folder: Path
    started: list[subprocess.Popen[str]] = field(default_factory=list)
    variables: dict[str, str] = field(default_factory=dict)

    def environment(self, more: dict[str, str] | None = None) -> dict[str, str]:
        home = str(self.folder / "home")
        return {
            **AT_START,
            "HOME": home,
            "XDG_CONFIG_HOME": f"{home}/.config",
            "XDG_CACHE_HOME": f"{home}/.cache",
            "XDG_STATE_HOME": f"{home}/.local/state",
            "COLUMNS": "80",
            **self.variables,
            **(more or {}),
        }

    def run(
        self, *arguments: object, variables: dict[str, str] | None = None, timeout_s: float = LONGEST_S, **options: Any
    ) -> subprocess.CompletedProcess[str]:
        streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = self._open(map(str, arguments), self.environment(variables), {**streams, **options})
        with process:
            try:
                output, error = process.communicate(timeout=timeout_s)
            except BaseException:
                process.kill()
                raise
        return subprocess.CompletedProcess(process.args, process.returncode, output, error)

    def start(self, *arguments: object, variables: dict[str, str] | None = None, **options: Any) -> subprocess.Popen[str]:
        """Start the program; ``at_start`` as in forks."""
        streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = self._open(map(str, arguments), self.environment(variables), {**streams, **options})
        self.started.append(process)
        return process

    def _open(self, arguments: Iterable[str], variables: dict[str, str], options: dict[str, Any]) -> subprocess.Popen[str]:
        from tests.commands.forks import Forked, can_fork

        if can_fork({name: value for name, value in variables.items() if AT_START.get(name) != value}, options):
            return Forked([*arguments], cwd=self.folder, env=variables, text=True, **options)
        calls = options.pop("at_start", ())
        if calls:
            options["preexec_fn"] = lambda: at_start.do(calls)
        return subprocess.Popen([*IMUFIELD, *arguments], cwd=self.folder, env=variables, text=True, **options)

    def emulate(
        self, *options: object, driver: str = "stim300", speed: float = SPEED, rate_hz: float = RATE_HZ, **streams: Any
    ) -> str:
        """Start an emulator and return its port."""
        rate = ("--rate-hz", rate_hz, "--speed", speed)
        process = self.start("emulate", driver, "--json", *rate, *options, **{"stderr": subprocess.DEVNULL, **streams})
        assert process.stdout is not None
        return str(json.loads(process.stdout.readline())["port"])

    def show(self, *names: str, options: tuple[object, ...] = (), hold_s: float = 6, rate_hz: float = RATE_HZ) -> str:
        """Start an emulator whose operator shows these faces again and again and never another; return its port.

        However late a key or a signal comes, a capture of six faces is then not at its end.
        """
        lines = []
        for number in range(20):
            for name in names:
                up = next(position.direction for position in scheme("faces6").positions if position.name == name)
                lines += ["[[position]]", f'name = "{name} round {number}"', f"up = {up.tolist()}"]
        path = self.folder / "shown.toml"
        path.write_text("\n".join(lines))
        return self.emulate("--positions", path, "--hold-s", hold_s, "--wait", *options, rate_hz=rate_hz)

    def capture(self, port: str, *options: object) -> tuple[str, ...]:
        """Return the arguments that capture six faces in short holds from a fast emulator."""
        common = ("--driver", "stim300", "--positions", "faces6", "--hold-s", 2, "--clock-speed", SPEED)
        return tuple(map(str, ("capture", "--port", port, *common, *options)))

    def stop(self) -> None:
        # What reads an instrument before the instrument: it would look for it again.
        for process in reversed(self.started):
            if process.poll() is None:
                process.kill()
            process.communicate()


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    write_secret(tmp_path / "home" / ".local" / "state")
    program = Program(tmp_path)
    yield program
    program.stop()


@pytest.fixture
def terminals() -> Iterator[list[Terminal]]:
    """Return a list for terminals, which are closed in the end."""
    opened: list[Terminal] = []
    yield opened
    for terminal in opened:
        terminal.close()


def newest(program: Program) -> Session:
    """Return the session that was begun last."""
    return Session.newest(program.folder / "imufield-sessions")


def recorded_events(session: Session) -> list[dict[str, Any]]:
    """Return what the guide said, as it is on disk."""
    return [item.event for item in read_session(session) if isinstance(item, RecordedEvent)]


Change = Callable[[Samples], Samples]


def simulated_session(
    folder: Path,
    positions: str = "paper24",
    *,
    change: Change | None = None,
    hold_s: float = 7.0,
    finished: bool = True,
    visits: int | None = None,
    style: str = "placed",
    day: int = 0,
    rotations: str | None = None,
    serial_number: str = "",
    range_g: int | None = None,
) -> Session:
    """Record a simulated session as ``capture`` would, without a port; ``change`` spoils the samples on purpose.

    ``visits`` lets the operator go home early; on another ``day`` the same instrument has other noise and is in other hands.
    ``range_g`` is said to be the accelerometer's range, and changes nothing else.
    """
    directions = scheme(positions).directions()[:visits]
    habits = OperatorSettings(
        hold_s=hold_s,
        initial_still_s=8.0,
        style=style,  # type: ignore[arg-type]
        rotations=rotations,  # type: ignore[arg-type]
    )
    source = make_virtual_imu(Emulation(rate_hz=RATE_HZ, seed=3, directions=directions, operator=habits))
    if day:
        other = make_virtual_imu(Emulation(rate_hz=RATE_HZ, seed=3 + day, directions=directions, operator=habits))
        source = VirtualImu(Imu(source.imu.instrument, 3 + day, source.imu.settings), other.operator)
    duration_s = source.operator.plan_all() - 0.5
    said = {} if range_g is None else {"accelerometer_range_g": range_g}
    protocol = load_driver("stim300").load_protocol({"rate_hz": RATE_HZ, **said})
    device = Stim300Device(Stim300Format(rate_hz=RATE_HZ))
    metadata = {
        "kind": "capture",
        "scheme": positions,
        "guide": {"hold_s": 4.0, **({"rotations": ROTATIONS[rotations]} if rotations else {})},
        "site": {"gravity_m_s2": 9.80665, "gravity_sigma_m_s2": 1.1e-5},
        "instrument": {"driver": "stim300", "model": "stim300", "serial_number": serial_number},
        "link": {"port": "/dev/ttyUSB0", "baud": 921600},
        "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
        "settings": {name: {"value": one.value, "origin": one.origin} for name, one in protocol.settings.items()},
        "finished": finished,
    }
    session = Session.create_in(folder, "stim300", metadata)
    with Recorder(session.add_part(), part_metadata(protocol, {})) as recorder:
        chunks = int(duration_s * RATE_HZ / CHUNK_SAMPLES)
        for first in range(0, chunks, BLOCK_CHUNKS):
            samples = source.next_block(min(BLOCK_CHUNKS, chunks - first) * CHUNK_SAMPLES)
            frames = device.encode(change(samples) if change else samples)
            parts = np.split(frames.data, frames.ends[CHUNK_SAMPLES - 1 :: CHUNK_SAMPLES])[:-1]
            for number, data in enumerate(parts, first + 1):
                time_s = number * CHUNK_SAMPLES / RATE_HZ
                recorder.write_chunk(Chunk(data.tobytes(), time_s, 1_700_000_000_000_000_000 + round(1e9 * time_s)))
    return session


@pytest.fixture
def make_session(tmp_path: Path) -> Callable[..., Session]:
    return lambda *arguments, **options: simulated_session(tmp_path / "session", *arguments, **options)


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that the first process of a run to ask for it has made; the others wait until it is there."""
    base = factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / name).exists():
            make(shared / f"{name}.unfinished")
            (shared / f"{name}.unfinished").rename(shared / name)
    return shared / name


def recorded(folder: Path, **options: Any) -> None:
    """Record a simulated session, and keep what its replay finds, as ``capture`` does when it has seen all of it."""
    with read_recording(simulated_session(folder / "session", **options), []):
        pass


@pytest.fixture(scope="session")
def whole_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of one finished session of 24 positions; copy it before changing anything."""
    return made_once(tmp_path_factory, "whole", recorded) / "session"


@pytest.fixture(scope="session")
def short_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a finished session as short as every command takes it; copy it before changing anything.

    Its 13 positions are enough for the linear model, and for verifying without some of them.
    """

    return made_once(tmp_path_factory, "short", partial(recorded, visits=13, hold_s=5.0)) / "session"


def solved(session: Path, name: str, factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a copy of a session, with its parameters."""

    def solve(folder: Path) -> None:
        shutil.copytree(session, folder / "session")
        assert run(["solve", str(folder / "session"), "--latitude", "48"]) == 0

    return made_once(factory, name, solve) / "session"


@pytest.fixture(scope="session")
def solved_session(whole_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the whole session with its parameters; copy it before changing anything."""
    return solved(whole_session, "solved", tmp_path_factory)


@pytest.fixture(scope="session")
def short_solved(short_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the short session with its parameters; copy it before changing anything."""
    return solved(short_session, "short_solved", tmp_path_factory)
