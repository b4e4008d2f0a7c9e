"""Disks that are full, folders and clocks that change under a recording, and two captures that want the same."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import read_session
from imufield.acquire.recording.session import Session
from imufield.sentences import Sentences
from tests.commands.conftest import recorded_events
from tests.commands.pty_terminal import Terminal
from tests.commands.told import says
from tests.torture.captures import (
    SCHEME,
    accepted_on_disk,
    bytes_on_disk,
    capture_into,
    end_and_solve,
    show_rounds,
)
from tests.torture.conftest import FULL, Campaign

if TYPE_CHECKING:
    from tests.commands.conftest import Program

sentence = Sentences("imufield")

POSITIONS = "corners24" if FULL else "faces6"
SMALL_KB = 400 if FULL else 120
LINK, RECORDING, PARAMETERS, TOO_FEW = 3, 4, 5, 6
ANSWERS = 3
FLOW = 125 * 38
"""Bytes of a second of the instrument."""


def sentence_of(error: str) -> str:
    """Return what was said, which is one sentence and no traceback."""
    lines = [line for line in error.splitlines() if line.strip()]
    assert lines, "nothing was said"
    assert "Traceback" not in error
    return " ".join(lines)


def test_disk_full_again_and_again(program: Program, campaign: Campaign) -> None:
    rng = random.Random(31)
    folder, port = program.folder / "session", show_rounds(program, POSITIONS)
    times, kept = campaign.times(2, 40), set[str]()
    for number in range(times):
        limit = rng.randrange(20_000, 250_000) if campaign.full else 80_000
        ended = program.run(*capture_into(program, port, folder, POSITIONS), at_start=[("limit_file_size", limit)])
        if ended.returncode == 0:
            times = number
            break
        assert ended.returncode == RECORDING, ended.stderr
        part = Session.open(folder).parts[-1]
        full = {"path": part, "cause": os.strerror(errno.EFBIG), "advice": ""}
        assert says(sentence_of(ended.stderr), "", "files.size_limit", **full)
        assert part.stat().st_size == limit, "what fits on the disk is written"
        accepted = accepted_on_disk(folder)
        assert kept <= set(accepted), f"full disk {number}: a position is gone"
        kept = set(accepted)
        if Session.open(folder).finished:
            # Full with the very last block: all positions are there, and nothing is left to resume.
            times = number + 1
            break
    assert kept
    end_and_solve(program, port, folder, POSITIONS)
    campaign.tell(
        "disk full while `capture` writes (limit on the size of the file), resumed; then the session ended and solved",
        times,
        "full disks",
        "the disk is filled to its last byte, all {positions} positions accepted before are there, exit code 4",
        positions=len(kept),
    )


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own that is soon full."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={SMALL_KB}k", "tmpfs", str(place)]
    can_mount = sys.platform == "linux" and shutil.which("mount") is not None
    if not can_mount or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount a tmpfs")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


def test_a_small_file_system(program: Program, small_disk: Path, campaign: Campaign) -> None:
    folder, port = small_disk / "session", show_rounds(program, POSITIONS)
    ended = program.run(*capture_into(program, port, folder, POSITIONS))
    assert ended.returncode == RECORDING, ended.stderr
    cause = os.strerror(errno.ENOSPC)
    # What grows: the recording, or what is accepted.
    full = [Session.open(folder).parts[-1], folder / "session.toml"]
    assert any(says(sentence_of(ended.stderr), "", "files.disk_full", path=path, cause=cause, advice="") for path in full)
    kept = accepted_on_disk(folder)
    assert kept
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    samples, parameters = small_disk / "samples.csv", folder / "parameters.toml"
    for path, command in ((parameters, ("solve", folder, "--latitude", 48)), (samples, ("export-data", folder, "-o", samples))):
        ended = program.run(*command)
        # On a fast machine the disk is full before there are positions enough.
        assert ended.returncode in (RECORDING, PARAMETERS, TOO_FEW), ended.stderr
        said = sentence_of(ended.stderr)
        assert ended.returncode == TOO_FEW or says(said, "", "files.disk_full", path=path, cause=cause, advice="")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in small_disk.iterdir()] == ["session"]
    subprocess.run(["mount", "-o", "remount,size=64m", str(small_disk)], check=True)
    end_and_solve(program, port, folder, POSITIONS)
    assert set(kept) <= set(accepted_on_disk(folder))
    campaign.tell(
        f"`capture`, `solve` and `export-data` on a file system of {SMALL_KB} kB (tmpfs), resumed when there was space",
        1,
        "session",
        "{positions} positions accepted before it was full are there; nothing half written beside them",
        positions=len(kept),
    )


@pytest.mark.skipif(sys.platform != "linux", reason="takes root's privileges as Linux does")
def test_read_only_folders(program: Program, solved_session: Path, campaign: Campaign) -> None:
    port, closed = program.emulate("--positions", "none"), program.folder / "closed"
    shutil.copytree(solved_session, closed / "session")
    for folder in (closed / "session", closed):
        folder.chmod(0o555)
    before = {path: path.read_bytes() for path in closed.rglob("*") if path.is_file()}
    record = ("--port", port, "--driver", "stim300", "--clock-speed", 16)
    commands = (
        (RECORDING, ("capture", *record, "--session", closed / "new")),
        (RECORDING, ("record", *record, "--session", closed / "new")),
        (PARAMETERS, ("solve", closed / "session")),
        (PARAMETERS, ("report", closed / "session")),
        (RECORDING, ("export-data", closed / "session", "-o", closed / "samples.csv")),
        (PARAMETERS, ("export", closed / "session" / "parameters.toml", "--to", "c", "-o", closed / "out.h")),
    )
    for code, command in commands:
        ended = program.run(*command, at_start=[("give_up_privileges",)])
        assert ended.returncode == code, (command[0], ended.stderr)
        assert "ermission" in sentence_of(ended.stderr) or "cannot be written" in sentence_of(ended.stderr)
    assert {path: path.read_bytes() for path in closed.rglob("*") if path.is_file()} == before
    campaign.tell(
        "commands that write, in a folder that may only be read", len(commands), "commands", "a sentence each; nothing changed"
    )


def test_a_folder_deleted_under_a_capture(program: Program, campaign: Campaign) -> None:
    times, port = campaign.times(1, 10), show_rounds(program, POSITIONS)
    for number in range(times):
        folder = program.folder / f"session-{number}"
        process = program.start(*capture_into(program, port, folder, POSITIONS))
        assert process.stdout is not None
        while '"event": "accepted"' not in (line := process.stdout.readline()):
            assert line
        # What it writes meanwhile is deleted, too.
        while folder.exists():
            shutil.rmtree(folder, ignore_errors=True)
        _, error = process.communicate(timeout=900)
        assert process.returncode == RECORDING
        told = " ".join(sentence_of(error).split())
        # The part or the session's own file, whichever is written first.
        gone = {"cause": os.strerror(errno.ENOENT), "advice": ""}
        files = (folder / "part-001.mcap", folder / "session.toml")
        assert any(sentence("files.no_folder", path=file, **gone) in told for file in files), told
        assert not folder.exists(), "it must not come back half"
    campaign.tell("folder of the session deleted under `capture`", times, "sessions", "noticed and said, exit code 4")


SET_BACK = """
import itertools, runpy, time
after, by_s = 40, 7200
asked, clock, clock_ns = itertools.count(), time.time, time.time_ns
def back(): return by_s if next(asked) > after else 0
time.time = lambda: clock() - back()
time.time_ns = lambda: clock_ns() - back() * 10**9
runpy.run_module("imufield", run_name="__main__")
"""
"""imufield on a machine whose clock is set back by two hours while it records: when the time was asked for 40 times."""


def test_clock_set_back(program: Program, campaign: Campaign) -> None:
    port = program.emulate("--positions", "none", "--wait", speed=1)
    folder, duration_s = program.folder / "session", campaign.times(5, 60)
    typed = ["record", "--port", port, "--driver", "stim300", "--session", folder, "--duration-s", duration_s]
    command = [sys.executable, "-c", SET_BACK, *map(str, typed)]
    ended = subprocess.run(command, cwd=program.folder, env=program.environment(), capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    chunks = [item for item in read_session(Session.open(folder)) if isinstance(item, Chunk)]
    steps_s = np.diff([chunk.utc_ns for chunk in chunks]) / 1e9
    assert np.sum(steps_s < -7000) == 1, "the clock was not set back"
    assert np.all(np.diff([chunk.monotonic_s for chunk in chunks]) >= 0)
    exported = program.run("export-data", folder, "-o", "samples.csv")
    assert exported.returncode == 0, exported.stderr
    time_s = np.genfromtxt(program.folder / "samples.csv", delimiter=",", names=True)["time_s"]
    steps = np.diff(time_s) * 125
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    # The answers to the questions who it is take the place of a datagram each.
    assert 0 <= np.sum(np.round(steps) - 1) <= ANSWERS
    assert len(time_s) > 0.5 * duration_s * 125
    campaign.tell(
        "clock of the machine set back by two hours while `record` writes",
        len(time_s),
        f"samples in {duration_s} s",
        "none lost, none out of its time",
    )


def test_two_captures_want_the_same(program: Program, campaign: Campaign) -> None:
    # Only some of the positions are shown: the first is not at its end before a person says so, however long the others take.
    port, other = show_rounds(program, "faces6"), program.emulate("--positions", "none")
    folder, times = program.folder / "session", campaign.times(1, 10)
    screen = Terminal(program, *program.capture(port, "--session", folder, "--latitude", 48), "--positions", SCHEME)
    first = screen.process
    # All that are shown; where the machine is busy, a count on the way there may never be drawn.
    screen.expect("12 of 24 done")
    for number in range(times):
        ended = program.run(*capture_into(program, port, program.folder / f"other-{number}"))
        assert (ended.returncode, ended.stdout) == (LINK, ""), ended.stderr
        assert f"(process {first.pid})" in sentence_of(ended.stderr)
        ended = program.run(*capture_into(program, other, folder))
        assert (ended.returncode, ended.stdout) == (RECORDING, ""), ended.stderr
        assert f"being recorded by process {first.pid}" in sentence_of(ended.stderr)
        assert not (program.folder / f"other-{number}").exists()
    screen.type("ff")
    assert screen.wait() == 0, screen.text[-1000:]
    screen.close()
    assert not any(event["event"] in ("link_lost", "gap") for event in recorded_events(Session.open(folder)))
    assert len(Session.open(folder).parts) == 1
    assert bytes_on_disk(folder) > 20 * FLOW
    solved = program.run("solve", folder, "--json")
    assert solved.returncode == 0, solved.stderr
    assert {one["name"] for one in json.loads(solved.stdout)["position"]} == set(accepted_on_disk(folder))
    campaign.tell(
        "`capture` on a port, and `capture --resume` on a folder, that another capture holds",
        2 * times,
        "attempts",
        "refused with the number of the other's process; the first one ends whole and is solved",
    )
