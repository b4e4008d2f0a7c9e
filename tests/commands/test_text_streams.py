"""Boards that print lines, on pseudo-terminals: ``probe`` and ``record`` find out what the numbers are, or show them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest

from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.recording.reader import PartStart, read_session
from imufield.acquire.recording.session import Session
from imufield.commands.probe import Probed, probe_port
from imufield.errors import Reason
from imufield.pipeline.chain import session_samples
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, Samples, concatenate
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.device import Device, Frames
from imufield.simulate.truth.grades import draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu
from tests.commands.told import missing
from tests.told import key_of

if TYPE_CHECKING:
    from tests.commands.conftest import Program

G = 9.80665
SIZES = {"m/s^2": 1.0, "g": 1 / G, "mg": 1000 / G, "rad/s": 1.0, "deg/s": np.degrees(1.0)}
RATE_HZ = 100.0
RESTLESS = OperatorSettings(style="held", hold_s=0.5, initial_still_s=0.2, turn_s=(1.0, 1.5))


class Board(Device):
    """Prints ``columns`` in its own units and with its own marks; what has no name of ours is printed as it stands there."""

    def __init__(self, columns: str, units: str = "m/s^2 rad/s", delimiter: str = ",", heading: str = "") -> None:
        self._columns, self._delimiter = columns.split(","), delimiter
        self._sizes = [SIZES[unit] for unit in units.split()]
        self._heading = heading

    def jump_counter(self, by: int) -> None:
        """Not used."""

    def power_on(self) -> bytes:
        return f"{self._heading}\r\n".encode() if self._heading else b""

    def encode(self, samples: Samples) -> Frames:
        values = {"counter": samples.counter, "time": samples.time_s, "ms": samples.time_s * 1000}
        triads = (samples.accelerometer * self._sizes[0], samples.gyroscope * self._sizes[1])
        values |= dict(zip(ACCELEROMETER_COLUMNS + GYROSCOPE_COLUMNS, np.hstack(triads).T, strict=True))
        lines = [
            self._delimiter.join(f"{values[name][row]:.6g}" if name in values else name for name in self._columns) + "\r\n"
            for row in range(len(samples))
        ]
        ends = np.cumsum([len(line) for line in lines], dtype=np.int64)
        return Frames(np.frombuffer("".join(lines).encode("latin-1"), dtype=np.uint8), ends, ends - 1)


@contextmanager
def printing(board: Board, *, moves: bool = True) -> Iterator[str]:
    directions = np.random.default_rng(3).standard_normal((200, 3)) if moves else ()
    imu = Imu(draw_truth(find_grade("mems"), np.random.default_rng(3)), 3, ImuSettings(rate_hz=RATE_HZ))
    with Emulator(board, VirtualImu(imu, Operator(directions, 3, RESTLESS))) as emulator:
        yield emulator.port


def settings_of(found: Probed) -> dict[str, object]:
    assert found.found is not None, found.error
    # The rate is measured, and that of a machine that sends in bursts is another one.
    return {name: value for name, value in found.found.variant.items() if name != "rate_hz"}


SIX = "ax,ay,az,gx,gy,gz"
GYROSCOPE_FIRST = "gx,gy,gz,ax,ay,az"


@pytest.mark.parametrize(
    ("board", "expected"),
    [
        pytest.param(
            Board(SIX, "g deg/s", " "),
            {"columns": SIX, "accelerometer_unit": "g", "gyroscope_unit": "deg/s"},
            id="g and deg/s, blanks",
        ),
        pytest.param(
            Board(f"counter,{GYROSCOPE_FIRST}", "mg rad/s", ";"),
            {"columns": f"counter,{GYROSCOPE_FIRST}", "accelerometer_unit": "mg"},
            id="counter, gyroscope first, mg, semicolons",
        ),
        pytest.param(
            Board(f"ms,{SIX}", "m/s^2 deg/s", "\t"),
            {"time_unit": "ms", "gyroscope_unit": "deg/s"},
            id="milliseconds, tabs",
        ),
        pytest.param(
            Board(f"time,{GYROSCOPE_FIRST},25.0", "g deg/s"),
            {"columns": f"time,{GYROSCOPE_FIRST},temperature", "accelerometer_unit": "g", "gyroscope_unit": "deg/s"},
            id="temperature",
        ),
    ],
)
def test_a_board_that_moves_tells_its_columns_and_units(board: Board, expected: dict[str, object]) -> None:
    with printing(board) as port:
        found = probe_port(port, None, SystemClock())
    assert settings_of(found) == expected
    options = "".join(f" --set {name}={value}" for name, value in expected.items())
    assert found.command == f"imufield capture --port {port} --driver text{options}"
    assert {"columns", "accelerometer_unit", "gyroscope_unit"} <= {taken.split(" = ")[0] for taken in found.taken}
    assert all("--set" in taken for taken in found.taken)


def test_a_heading_is_read_and_what_lies_still_is_assumed_aloud() -> None:
    heading = "t,wx,wy,wz,accX,accY,accZ"
    with printing(Board(f"time,{GYROSCOPE_FIRST}", "g rad/s", heading=heading), moves=False) as port:
        found = probe_port(port, None, SystemClock())
    units = {"accelerometer_unit": "g", "gyroscope_unit": "deg/s"}
    assert settings_of(found) == {"columns": f"time,{GYROSCOPE_FIRST}", **units}
    (guess,) = (taken for taken in found.taken if taken.startswith("gyroscope_unit"))
    assert "assumed" in guess
    assert "of capture" in guess  # A probe itself has no such option.


def test_record_takes_them_and_says_so(program: Program) -> None:
    with printing(Board(GYROSCOPE_FIRST, "g deg/s", " ")) as port:
        ended = program.run("record", "--port", port, "--duration-s", 1, "--session", "mine")
    assert ended.returncode == 0, ended.stderr
    assert f"columns = {GYROSCOPE_FIRST} (" in ended.stderr
    assert "change with --set gyroscope_unit=..." in ended.stderr
    session = Session.open(program.folder / "mine")
    assert {name: session.metadata["settings"][name]["origin"] for name in ("columns", "gyroscope_unit")} == {
        "columns": "read",
        "gyroscope_unit": "read",
    }
    norm = np.linalg.norm(concatenate(list(session_samples(session, []))).accelerometer, axis=1)
    assert np.median(norm) == pytest.approx(G, rel=0.05)


@pytest.mark.parametrize("driver", [(), ("--driver", "text")])
def test_what_was_recognised_holds_when_the_session_goes_on(program: Program, driver: tuple[str, ...]) -> None:
    with printing(Board(f"ms,{SIX}", "g deg/s")) as port:
        for how in (("--port", port, *driver), ("--resume",)):
            process = program.start("capture", *how, "--session", "mine", "--json")
            assert process.stdout is not None
            assert '"session"' in process.stdout.readline()
            assert json.loads(process.stdout.readline())["event"]  # It is under way.
            process.terminate()
            assert process.wait(60) == 130
            process.communicate()
    parts = [item for item in read_session(Session.open(program.folder / "mine")) if isinstance(item, PartStart)]
    first, second = (dict(cast("Mapping[str, object]", part.metadata["settings"])) for part in parts)
    assert first == second
    assert {"time_unit": "ms", "accelerometer_unit": "g", "gyroscope_unit": "deg/s"}.items() <= first.items()


def test_a_driver_that_is_named_needs_no_columns_either(program: Program) -> None:
    with printing(Board(SIX, "m/s^2 deg/s"), moves=False) as port:
        given = ("--driver", "text", "--set", "gyroscope_unit=deg/s")
        ended = program.run("record", "--port", port, *given, "--duration-s", 0.5, "--session", "mine")
    assert ended.returncode == 0, ended.stderr
    settings = Session.open(program.folder / "mine").metadata["settings"]
    assert settings["columns"] == {"value": SIX, "origin": "read"}
    assert settings["gyroscope_unit"] == {"value": "deg/s", "origin": "given"}


def test_lines_that_nobody_understands_are_shown_with_the_option(program: Program) -> None:
    with printing(Board("1,2,ax,ay,\x1b[2J", "m/s^2 rad/s", " "), moves=False) as port:
        ended = program.run("record", "--port", port, "--session", "mine")
    assert ended.returncode == 3
    assert ended.stderr.count("first lines: 1 2 ") == 3
    assert "\x1b" not in ended.stderr
    assert "\\x1b[2J" in ended.stderr
    with printing(Board("gx,gx,gx,ax,gx"), moves=False) as port:
        probed = program.run("probe", "--port", port, "--json")
    assert probed.returncode == 3
    (told,) = json.loads(probed.stdout)["ports"]
    assert told["error"]["reason"] == Reason.NO_FRAMES.value
    assert [line.count(",") for line in told["lines"]] == [4, 4, 4]
    assert not missing(told["error"]["message"], "5 numbers in a line, 7 expected", "--driver text --set columns=ax,ay,az,-,-")


def frames_of(printed: Iterable[str]) -> Frames:
    """Return lines as a board sends them."""
    lines = [*printed]
    ends = np.cumsum([len(line) for line in lines], dtype=np.int64)
    return Frames(np.frombuffer("".join(lines).encode(), dtype=np.uint8), ends, ends - 1)


def test_numbers_with_labels_are_told_how_to_be_printed() -> None:
    class Labelled(Board):
        def encode(self, samples: Samples) -> Frames:
            return frames_of("ax={:.3f} ay={:.3f} az={:.3f}\n".format(*row) for row in samples.accelerometer.tolist())

    with printing(Labelled(SIX), moves=False) as port:
        found = probe_port(port, None, SystemClock())
    assert found.error is not None
    assert key_of(found.error.message) == "baud_search.labelled"
    assert found.lines[0].startswith("ax=")


@pytest.mark.parametrize(("word", "prefix"), [("", ""), ("$IMU,", "--set 'prefix=$IMU' ")])
def test_counts_are_offered_and_not_taken(word: str, prefix: str) -> None:
    """The command is one that a shell leaves as it is."""

    class Counts(Board):
        def encode(self, samples: Samples) -> Frames:
            values = np.rint(np.hstack([samples.accelerometer * 1671, samples.gyroscope * 7506])).astype(int)
            return frames_of(word + ",".join(map(str, row)) + "\n" for row in values.tolist())

    with printing(Counts(SIX), moves=False) as port:
        found = probe_port(port, None, SystemClock())
    assert found.error is not None
    assert key_of(found.error.message) == "baud_search.columns"
    assert (
        f"--driver text {prefix}--set columns={SIX} --set accelerometer_unit=count --set gyroscope_unit=count"
        in found.error.message
    )
