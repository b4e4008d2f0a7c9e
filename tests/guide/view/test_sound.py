import errno
import io
import os
import pty
import threading
import wave
from collections.abc import Callable
from pathlib import Path

import pytest

from imufield.guide.events import (
    Accepted,
    Advice,
    Done,
    Event,
    Hold,
    LinkLost,
    Move,
    RefusalCode,
    Rejected,
    Topic,
    Turn,
    Turning,
)
from imufield.guide.view.sound import RATE_HZ, Cue, SoundView, heard, open_sound, tone

UP = (0.7, -0.7, 0.0)


def rejected(reason: RefusalCode, words: str = "from the wire; $(reboot)") -> Rejected:
    return Rejected(time_s=1.0, position="+x", reason=reason, words=words, remedy="x", measured=1.0, limit=1.0, unit="deg")


def accepted() -> Accepted:
    return Accepted(
        time_s=1.0,
        position="+x",
        direction=UP,
        angle_deg=1.0,
        start_s=0.0,
        duration_s=10.0,
        sigma_m_s2=1e-3,
        temperature_degc=20.0,
        accepted=1,
        planned=6,
    )


@pytest.mark.parametrize(
    ("event", "cue", "said"),
    [
        (Hold(1.0, "+x", "words", 3.0, 10.0), Cue.HOLD, "hold"),
        (accepted(), Cue.ACCEPTED, "accepted"),
        (rejected(RefusalCode.MOVED), Cue.REFUSED, "moved, again"),
        (rejected(RefusalCode.STUCK), Cue.REFUSED, "refused, see the screen"),
        (rejected(RefusalCode.NOT_QUIET), None, None),
        (LinkLost(1.0, 1, 6), Cue.LOST, "no link"),
        (Done(1.0, 6, 6, (), "words"), Cue.DONE, "done"),
        (
            Move(time_s=1.0, position="z+315", direction=UP, words="words", why="why", accepted=0, planned=6),
            None,
            "next: plus x and minus y up",
        ),
        (Turning(time_s=1.0, direction=UP, position="+x", angle_deg=1.0, target="+x", target_angle_deg=1.0), None, None),
        (
            Advice(
                time_s=1.0, topic=Topic.DOUBTFUL, position="+x", words="w", remedy="r", measured=1.0, limit=1.0, unit="m/s^2"
            ),
            Cue.REFUSED,
            None,
        ),
    ],
)
def test_what_is_heard(event: Event, cue: Cue | None, said: str | None) -> None:
    assert heard(event) == (cue, said)


def test_text_of_events_is_never_spoken() -> None:
    for reason in RefusalCode:
        assert "reboot" not in (heard(rejected(reason))[1] or "")


def test_tones_are_told_apart_and_valid() -> None:
    assert len({cue.strokes for cue in Cue} | {cue.tones for cue in Cue}) >= len(Cue)
    for cue in Cue:
        with wave.open(io.BytesIO(tone(cue))) as file:
            assert (file.getnchannels(), file.getsampwidth(), file.getframerate()) == (1, 2, RATE_HZ)
            assert 0.1 < file.getnframes() / RATE_HZ < 1.5


def play_to_the_end(view: SoundView) -> None:
    """Close a view, however long its sounds take: closing alone waits for a moment."""
    view.close()
    view._thread.join(60.0)


def test_the_guide_never_waits_and_late_sounds_are_left_out() -> None:
    gate, heard, played = threading.Event(), threading.Event(), []

    def play(cue: Cue) -> None:
        gate.wait(60.0)
        played.append(cue)
        heard.set()

    view = SoundView(play, None)
    for _ in range(50):
        view.show([accepted()])
    assert played == []
    gate.set()
    assert heard.wait(60.0)
    view.close()
    assert 1 <= len(played) <= 6


def test_a_broken_player_harms_nobody() -> None:
    said: list[str] = []

    def play(_cue: Cue) -> None:
        raise OSError("no card")

    view = SoundView(play, said.append)
    view.show([Hold(1.0, "+x", "words", 3.0, 10.0)])
    play_to_the_end(view)
    assert said == ["hold"]


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Return what puts programs of these names on the path; each writes its arguments into a file of its name."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    monkeypatch.delenv("SSH_CONNECTION", raising=False)

    def make(*names: str) -> Path:
        for name in names:
            (folder / name).write_text(f'#!/bin/sh\nfor one in "$@"; do echo "$one" >> {tmp_path}/{name}; done\n')
            (folder / name).chmod(0o755)
        return tmp_path

    return make


def test_programs_get_our_file_and_our_words_and_nothing_else(
    programs: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = programs("pw-play", "spd-say")
    monkeypatch.setattr("imufield.guide.view.sound._has_sound_card", lambda: True)
    with open_sound(speak=True) as view:
        view.show([Hold(1.0, "+x; $(reboot)", "`reboot`", 3.0, 10.0)])
        play_to_the_end(view)
    (played,) = (heard / "pw-play").read_text().split()
    assert played.endswith("/hold.wav")
    assert not Path(played).exists(), "the folder of sounds stays behind"
    assert (heard / "spd-say").read_text().split() == ["--wait", "hold"]


def full_disk(_cue: Cue) -> bytes:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("missing", ["card", "folder", "space"])
def test_without_a_card_or_room_for_sounds_the_bell_rings_and_without_a_program_nobody_speaks(
    programs: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    programs("pw-play")
    room = tmp_path / "room"
    if missing == "card":
        monkeypatch.setenv("SSH_CONNECTION", "here there")
    else:
        monkeypatch.setattr("imufield.guide.view.sound._has_sound_card", lambda: True)
        monkeypatch.setattr("tempfile.tempdir", str(room))
    if missing == "space":
        room.mkdir()
        monkeypatch.setattr("imufield.guide.view.sound.tone", full_disk)
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as screen, open_sound() as view:
        monkeypatch.setattr("sys.__stdout__", screen)
        view.show([accepted()])
        play_to_the_end(view)
    rung = b""
    while len(rung) < Cue.ACCEPTED.strokes:
        rung += os.read(ours, 100)
    assert rung == b"\a" * Cue.ACCEPTED.strokes
    os.close(ours)
    assert not room.exists() or not [*room.iterdir()], "the folder of sounds stays behind"


def test_a_bell_that_goes_nowhere_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.__stdout__", None)
    with open_sound() as view:
        view.show([accepted()])


@pytest.mark.parametrize(("sense", "way"), [(1, "plus"), (-1, "minus")])
def test_turns_are_spoken(sense: int, way: str) -> None:
    turn = Turn(time_s=1.0, axis="y", sense=sense, about="horizontal", words="words", done=0, planned=6)
    assert heard(turn) == (None, f"roll about y, {way}")
