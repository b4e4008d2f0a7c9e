"""``imufield solve`` over several sessions: as one by one, whoever works, and one that fails does not stop the others."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import imufield
from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.commands.options.result_commands import SolveOptions
from imufield.commands.solve import run_solve_many
from imufield.deliver.parameters.file import load
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.pipeline.solving import solve_session
from tests.commands.conftest import LONGEST_S
from tests.local_cluster import local_cluster
from tests.refused import refused

if TYPE_CHECKING:
    from tests.commands.conftest import Program

NAMES = ("a", "b", "c")


def make_sessions(whole_session: Path, parent: Path) -> list[Path]:
    """Make three sessions, the last of which takes every still interval for itself."""
    folders = [parent / name for name in NAMES]
    for folder in folders:
        shutil.copytree(whole_session, folder)
    settings = (folders[2] / "session.toml").read_text()
    (folders[2] / "session.toml").write_text(settings.replace('scheme = "paper24"\n', ""))
    return folders


@pytest.fixture
def sessions(tmp_path: Path, whole_session: Path) -> list[Path]:
    return make_sessions(whole_session, tmp_path)


@pytest.fixture(scope="module")
def solved_alone(whole_session: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return the sessions, each solved by itself."""
    folders = make_sessions(whole_session, tmp_path_factory.mktemp("alone"))
    assert [run(["solve", str(folder)]) for folder in folders] == [0, 0, 0]
    return folders


@pytest.fixture(scope="module")
def alone(solved_alone: list[Path]) -> dict[str, list[str]]:
    """Return what each of the sessions gives when it is solved by itself."""
    return {folder.name: written(folder) for folder in solved_alone}


@pytest.fixture
def read_sessions(solved_alone: list[Path], tmp_path: Path) -> list[Path]:
    """Return sessions that are as if never solved, but for what is kept of their samples."""
    results = shutil.ignore_patterns("parameters*")
    return [Path(shutil.copytree(folder, tmp_path / folder.name, ignore=results)) for folder in solved_alone]


def numbers(path: Path) -> list[str]:
    """Return the lines of a parameter file, less the time of its making and the hash over it."""
    return [line for line in path.read_text().splitlines() if not line.startswith(("created", "sha256", "integrity"))]


def written(folder: Path) -> list[str]:
    assert [path.name for path in folder.glob("parameters*.toml")] == ["parameters.toml"]
    return numbers(folder / "parameters.toml")


@pytest.mark.skipif(os.name == "nt", reason="needs links")
def test_a_link_that_leads_to_itself_fails_as_any_other_that_is_no_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("round").symlink_to("round")
    assert run(["solve", "round", "nowhere", "--workers", "1"]) == 4
    assert run(["solve", "nowhere", "elsewhere", "--preset", "round", "--workers", "1"]) == 4


def test_one_that_fails_does_not_stop_the_others(program: Program, sessions: list[Path], alone: dict[str, list[str]]) -> None:
    part = next(sessions[1].glob("part-*.mcap"))
    part.write_bytes(b"nothing")
    ended = program.run("solve", *sessions, "nowhere", "--workers", 2)
    assert ended.returncode in (4, 6), ended.stderr
    assert "Traceback" not in ended.stderr
    rows = {line.split()[0]: line.split()[1] for line in ended.stdout.splitlines()[1:5]}
    assert rows == {"a": "good", "b": "failed", "c": rows["c"], "nowhere": "failed"}
    assert rows["c"] in ("good", "usable")
    assert re.search(r"\b2\b.*\b4\b.*\b2\b", ended.stdout.splitlines()[-1])
    assert sorted(line.split(": ")[1] for line in ended.stderr.splitlines()) == [
        "a, good", "b, failed", f"c, {rows['c']}", "nowhere, failed"
    ]  # fmt: skip
    assert max(map(len, ended.stdout.splitlines()[:5])) <= 80
    assert written(sessions[0]) == alone["a"]
    assert written(sessions[2]) == alone["c"]
    assert not (sessions[1] / "parameters.toml").exists()


def test_nothing_is_computed_for_a_session_that_cannot_be_written(
    read_sessions: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (read_sessions[0] / "parameters.toml").mkdir()
    solved: list[str] = []

    def solve(session: Session, *arguments: Any) -> Any:
        solved.append(session.name)
        return solve_session(session, *arguments)

    monkeypatch.setattr("imufield.commands.solve.solve_session", solve)
    assert run(["solve", *map(str, read_sessions[:2]), "--workers", "1"]) == ParameterFileError.exit_code
    assert solved == ["b"]
    rows = [line.split()[:2] for line in capsys.readouterr().out.splitlines()[1:3]]
    assert rows == [["a", "failed"], ["b", "good"]]


def test_what_stood_there_is_kept_and_told(program: Program, sessions: list[Path]) -> None:
    sessions = sessions[:2]
    for folder in sessions:
        settings = (folder / "session.toml").read_text()
        (folder / "session.toml").write_text(settings.replace("gravity_m_s2 = 9.80665\n", ""))
    assert program.run("solve", sessions[0], "--latitude", 45, "--height", 0).returncode == 0
    before = (sessions[0] / "parameters.toml").read_bytes()
    ended = program.run("solve", *sessions, "--workers", 1)
    assert ended.returncode == 0, ended.stderr
    assert (sessions[0] / "parameters-1.toml").read_bytes() == before
    of = {name: [line for line in ended.stdout.splitlines() if line.startswith(f"{name}: ")] for name in ("a", "b")}
    assert any("parameters-1.toml" in line for line in of["a"])
    assert "--latitude 45 --height 0" in ended.stdout
    assert not any("parameters-1.toml" in line for line in of["b"])
    assert any("gravity" in line for line in of["b"])
    assert re.search(r"\b2\b.*\b2\b", ended.stdout.splitlines()[-1])
    again = program.run("solve", sessions[0], "--gravity", 9.8)
    assert "--latitude 45" not in again.stdout


def test_json_has_one_entry_a_session(program: Program, read_sessions: list[Path]) -> None:
    ended = program.run("solve", *read_sessions[:2], read_sessions[0], "--json", "--workers", 1)
    assert ended.returncode == 0, ended.stderr
    entries = json.loads(ended.stdout)
    assert [Path(entry["session"]).name for entry in entries] == ["a", "b"]
    assert {entry["verdict"] for entry in entries} == {"good"}
    scale = load(entries[0]["file"]).document["accelerometer"]["scale"]
    assert entries[0]["parameters"]["accelerometer"]["scale"] == pytest.approx(scale, rel=1e-12)


def test_options_of_one_session_are_refused(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in NAMES]
    with refused(UsageError, Reason.USAGE, "--output"):
        run_solve_many(folders, SolveOptions(output=tmp_path / "p.toml"))
    with refused(UsageError, Reason.USAGE, "--observations"):
        run_solve_many(folders, SolveOptions(observations=tmp_path / "means.csv"))
    with refused(UsageError, Reason.USAGE, "--scheduler"):
        run_solve_many([], SolveOptions(scheduler="tcp://127.0.0.1:1"))


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with local_cluster(Path(imufield.__file__).parents[1]) as cluster:
        yield cluster


def test_sessions_of_a_killed_cluster_worker_are_done_again(
    cluster: Any, sessions: list[Path], alone: dict[str, list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    nanny = next(iter(cluster.workers.values()))
    killed: list[int] = []
    killer = threading.Thread(target=kill_when_busy, args=(cluster, nanny, killed))
    killer.start()
    code = run_solve_many(sessions, SolveOptions(scheduler=cluster.scheduler_address))
    killer.join()
    assert killed
    assert code == 0, capsys.readouterr().out
    for folder in sessions:
        assert written(folder) == alone[folder.name]


def kill_when_busy(cluster: Any, nanny: Any, killed: list[int]) -> None:
    """Kill a worker as soon as it has a session to solve."""
    pid, worker = nanny.pid, cluster.scheduler.workers[nanny.worker_address]
    deadline_s = time.monotonic() + LONGEST_S
    while time.monotonic() < deadline_s:
        if worker.processing:
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)
            return
        time.sleep(0.01)
