"""The emulated instrument in the hands of who types its poses, or wrote them to a file."""

from __future__ import annotations

import errno
import json
import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imufield.commands.emulate import make_emulation
from imufield.commands.options.acquire_commands import EmulateOptions
from imufield.errors import Reason, UsageError
from imufield.samples import FloatArray
from imufield.simulate.emulator.emulate import make_virtual_imu
from imufield.simulate.truth.motion import up_direction
from imufield.simulate.truth.operator import Operator
from tests.refused import refused

if TYPE_CHECKING:
    from tests.commands.conftest import Program

SPEED = 16


def operator_of(path: Path) -> Operator:
    """Return the operator of a file of poses, who has heard them all."""
    emulation = make_emulation(EmulateOptions(driver="stim300", poses=path, hold_s=5.0, seed=3))
    operator = make_virtual_imu(emulation, 125.0).operator
    for visit in emulation.visits:
        operator.show(visit)
    return operator


def ups(operator: Operator, until_s: float) -> FloatArray:
    """Return the true "up" ten times a second, shape (n, 3)."""
    operator.block(0, 1, until_s)
    return up_direction(operator.attitude(np.arange(0.0, until_s, 0.1)))


def test_poses_of_a_file_are_shown_in_turn(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("x-\n\n+y\nz+135\n+x-y (2)\n")
    operator = operator_of(path)
    # He has not begun to move when the lines come.
    operator.block(0, 1, 0.01)
    for second in range(60):
        operator.block(second, 1, 1.0)
    stills = operator.stills
    edge = np.sqrt(0.5)
    expected = [[0, 0, 1], [-1, 0, 0], [0, 1, 0], [edge, -edge, 0], [edge, -edge, 0]]
    np.testing.assert_allclose([still.direction for still in stills], expected, atol=np.radians(3.1))
    assert all(still.end_s - still.start_s > 4.9 for still in stills[1:])
    assert stills[-1].end_s == np.inf
    assert all(0.9 < move.end_s - move.start_s < 4.0 for move in operator.moves)


def test_a_turn_about_an_axis_begins_where_the_unit_is(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("roll 30\npitch -90\nyaw 360\n")
    operator = operator_of(path)
    for second in range(60):
        operator.block(second, 1, 1.0)
    before, rolled, pitched, turned = (still.direction for still in operator.stills)
    assert np.degrees(np.arccos(before @ rolled)) == pytest.approx(30.0, abs=0.1)
    assert rolled[0] == pytest.approx(before[0], abs=1e-6)
    assert pitched[1] == pytest.approx(rolled[1], abs=1e-6)
    # A whole turn shows the same side again.
    np.testing.assert_allclose(turned, pitched, atol=1e-6)


def test_what_is_no_pose_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("z+\nroll thirty\n")
    with refused(UsageError, Reason.USAGE, "roll thirty", key="positions.no_name"):
        operator_of(path)
    (tmp_path / "empty").write_text("\n \n")
    with refused(UsageError, Reason.USAGE, "empty", key="emulate.empty_poses"):
        make_emulation(EmulateOptions(driver="stim300", poses=tmp_path / "empty"))
    with refused(UsageError, Reason.USAGE, "nowhere", f"({os.strerror(errno.ENOENT)})", key="emulate.no_poses"):
        operator_of(tmp_path / "nowhere")
    (tmp_path / "binary").write_bytes(b"\xff")
    with refused(UsageError, Reason.USAGE, "binary", "0xff", key="emulate.no_poses"):
        operator_of(tmp_path / "binary")


def test_a_capture_is_led_by_lines_on_standard_input(program: Program) -> None:
    """The guide is told nothing; each pose is typed when the one before is accepted, as a person would."""
    reading = ("--rate-hz", 250, "--speed", SPEED, "--json", "--wait")
    emulator = program.start("emulate", "stim300", *reading, "--poses", "-", "--hold-s", 3, stdin=subprocess.PIPE)
    assert emulator.stdout is not None
    assert emulator.stdin is not None
    port = json.loads(emulator.stdout.readline())["port"]
    capture = program.start(*program.capture(port, "--clock-speed", SPEED, "--json"))
    assert capture.stdout is not None
    left, accepted = ["upside down", "x+", "-x", "y+", "y+270", "-y"], []
    for line in capture.stdout:
        event = json.loads(line)
        if event["event"] == "accepted":
            accepted.append(event["position"])
            # What is no pose is told, and the next line is heard all the same.
            for _ in range(1 + (len(left) == 6)):
                if left:
                    emulator.stdin.write(left.pop(0) + "\n")
            emulator.stdin.flush()
    assert capture.wait() == 0, capture.communicate()[1]
    assert accepted == ["+z", "+x", "-x", "+y", "-z", "-y"]
    emulator.terminate()
    assert "'upside down' is not a position" in emulator.communicate()[1]
