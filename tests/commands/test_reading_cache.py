"""What is kept of a replay: it saves the replay and changes no result, whatever becomes of it."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.cli.run import run
from imufield.commands.options.result_commands import ReportOptions
from imufield.commands.report import gather
from imufield.guide.positions import SCHEME_FILE
from imufield.pipeline import reading_cache, solving
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.solving import solve_session
from tests.commands.conftest import simulated_session

if TYPE_CHECKING:
    from tests.commands.conftest import Program

WITHOUT = SolveSettings(without=("x+90",))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recorded session of six faces: its result, good or not, is to stay the same."""
    return simulated_session(tmp_path_factory.mktemp("recorded") / "session", "faces6", hold_s=5.0).folder


@pytest.fixture(scope="module")
def replayed(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return the same with what a replay keeps, and what was found; copy it before changing anything."""
    copy = Path(shutil.copytree(recorded, tmp_path_factory.mktemp("replayed") / "session"))
    return copy, solved(copy)


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    """Return a recorded session of which nothing is kept."""
    return Path(shutil.copytree(recorded, tmp_path / "session"))


@pytest.fixture
def longer(short_session: Path, tmp_path: Path) -> Path:
    """Return one with positions enough to leave some out."""
    copy = Path(shutil.copytree(short_session, tmp_path / "session"))
    (copy / reading_cache.CACHE_FILE).unlink(missing_ok=True)
    return copy


def solved(folder: Path, settings: SolveSettings | None = None) -> dict[str, Any]:
    document = dict(solve_session(Session.open(folder), settings or SolveSettings()).document)
    return {key: value for key, value in document.items() if key not in ("created", "integrity")}


def refuse_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    def replay(*_: object, **__: object) -> None:
        raise AssertionError("the recording was read again")

    monkeypatch.setattr(solving, "replay_into", replay)


def test_results_are_those_of_the_replay(longer: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (longer / reading_cache.CACHE_FILE).mkdir()  # Nothing can be kept.
    cold, cold_without = solved(longer), solved(longer, WITHOUT)
    (longer / reading_cache.CACHE_FILE).rmdir()
    assert repr(solved(longer)) == repr(cold)
    refuse_replay(monkeypatch)
    assert repr(solved(longer)) == repr(cold)
    assert repr(solved(longer, WITHOUT)) == repr(cold_without)
    assert repr(cold) != repr(cold_without)


def test_the_first_replay_of_a_user_is_kept(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Other tests find a secret there.
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "nothing" / "yet"))
    first = solved(folder)
    refuse_replay(monkeypatch)
    assert repr(solved(folder)) == repr(first)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def edit(path: Path) -> None:
    settings = path.with_name(SETTINGS_FILE)
    settings.write_text(settings.read_text(encoding="utf-8") + "\n# another day\n", encoding="utf-8")


def forge(path: Path) -> None:
    """Write as somebody else who has the program: all is right but the secret."""
    session = Session.open(path.parent)
    reading = reading_cache.cached_reading(session, session.sha256())
    assert reading is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading_cache, "_secret", lambda: bytes(32))
        reading_cache.write_cache(session, reading)


def move_on(path: Path) -> None:
    """Take a file away that was hashed, and let what is kept begin with its hash."""
    scheme, content = path.with_name(SCHEME_FILE), path.read_bytes()
    scheme.write_text("# none of the session's\n", encoding="utf-8")
    session = Session.open(path.parent)
    body = content[32:]
    signed = reading_cache._digest(session, session.sha256(), body)
    scheme_hash = hashlib.sha256(scheme.read_bytes()).digest()
    scheme.unlink()
    path.write_bytes(signed + scheme_hash + body)


@pytest.mark.parametrize("spoil", [flip, edit, forge, move_on, lambda path: path.write_bytes(path.read_bytes()[:-9])])
def test_what_does_not_fit_is_read_anew(
    replayed: tuple[Path, dict[str, Any]], tmp_path: Path, spoil: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, cold = Path(shutil.copytree(replayed[0], tmp_path / "session")), replayed[1]
    path = folder / reading_cache.CACHE_FILE
    before = path.read_bytes()
    spoil(path)
    with monkeypatch.context() as patch:
        refuse_replay(patch)
        with pytest.raises(AssertionError):
            solved(folder)
    assert repr(solved(folder)) == repr(cold)
    assert path.read_bytes()[32:] == before[32:]


@pytest.mark.parametrize("content", [None, b"", bytes(31)])
def test_a_secret_that_is_missing_or_damaged_is_made_anew(
    folder: Path, tmp_path: Path, content: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platformdirs.user_state_path", lambda *_, **__: tmp_path)
    if content is not None:
        (tmp_path / "secret").write_bytes(content)
    cold = solved(folder)
    assert len((tmp_path / "secret").read_bytes()) == 32
    if os.name == "posix":
        assert (tmp_path / "secret").stat().st_mode & 0o777 == 0o600
    refuse_replay(monkeypatch)
    assert repr(solved(folder)) == repr(cold)


def test_without_a_place_for_the_secret_nothing_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(*_: object, **__: object) -> Path:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("platformdirs.user_state_path", nowhere)
    solved(folder)
    assert not (folder / reading_cache.CACHE_FILE).exists()


def test_other_code_reads_anew(replayed: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Path(shutil.copytree(replayed[0], tmp_path / "session"))
    monkeypatch.setattr(reading_cache, "_code_sha256", lambda: "of another version")
    refuse_replay(monkeypatch)
    with pytest.raises(AssertionError):
        solved(folder)


def test_a_damaged_recording_is_read_every_time(whole_session: Path, tmp_path: Path) -> None:
    # Of several blocks, so that something is left.
    folder = Path(shutil.copytree(whole_session, tmp_path / "session", ignore=shutil.ignore_patterns(reading_cache.CACHE_FILE)))
    flip(folder / "part-001.mcap")
    reasons = [solve_session(Session.open(folder), SolveSettings()).calibration.quality.reasons for _ in range(2)]
    assert reasons[0] == reasons[1]
    assert not (folder / reading_cache.CACHE_FILE).exists()


def test_report_and_verify_need_no_replay(longer: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(["solve", str(longer), "--latitude", "45"]) == 0
    first, _ = gather(ReportOptions(session=longer))
    refuse_replay(monkeypatch)
    monkeypatch.setattr("imufield.commands.verify.replay_into", None)
    again, _ = gather(ReportOptions(session=longer))
    assert first.trace is not None
    assert again.trace is not None
    np.testing.assert_array_equal(first.trace.scatter_m_s2, again.trace.scatter_m_s2)
    assert run(["verify", str(longer)]) == 0


def test_what_capture_keeps_is_what_a_replay_finds(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    port = program.emulate("--positions", "faces6", "--hold-s", 6, "--wait")
    ended = program.run(*program.capture(port))
    assert ended.returncode == 0, ended.stderr
    folder = Session.newest(program.folder / "imufield-sessions").folder
    path = folder / reading_cache.CACHE_FILE
    live = path.read_bytes()
    # As that user: what another one kept is not believed.
    for name in ("HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, program.environment()[name])
    with monkeypatch.context() as patch:
        refuse_replay(patch)
        found = solved(folder)
    path.unlink()
    assert repr(solved(folder)) == repr(found)
    assert path.read_bytes() == live
