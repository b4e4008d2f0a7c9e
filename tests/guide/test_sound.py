import io
import threading
import wave

import pytest

from imufield.guide.events import Accepted, Advice, Done, Event, Hold, LinkLost, Move, RefusalCode, Rejected, Topic, Turning
from imufield.guide.sound import RATE_HZ, Cue, SoundView, cue_of, spoken, tone

UP = (0.7, -0.7, 0.0)


def rejected(reason: RefusalCode, words: str = "from the wire; $(reboot)") -> Rejected:
    return Rejected(1.0, "+x", reason, words, "x", 1.0, 1.0, "deg")


def accepted() -> Accepted:
    return Accepted(1.0, "+x", UP, 1.0, 0.0, 10.0, 1e-3, 20.0, 1, 6)


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
        (Move(1.0, "z+315", UP, "words", "why", 0, 6), None, "next: plus x and minus y up"),
        (Turning(1.0, UP, "+x", 1.0, "+x", 1.0), None, None),
        (Advice(1.0, Topic.DOUBTFUL, "+x", "w", "r", 1.0, 1.0, "m/s^2"), Cue.REFUSED, None),
    ],
)
def test_what_is_heard(event: Event, cue: Cue | None, said: str | None) -> None:
    assert cue_of(event) is cue
    assert spoken(event) == said


def test_text_of_events_is_never_spoken() -> None:
    for reason in RefusalCode:
        assert "reboot" not in (spoken(rejected(reason)) or "")


def test_tones_are_told_apart_and_valid() -> None:
    assert len({cue.strokes for cue in Cue} | {cue.tones for cue in Cue}) >= len(Cue)
    for cue in Cue:
        with wave.open(io.BytesIO(tone(cue))) as file:
            assert (file.getnchannels(), file.getsampwidth(), file.getframerate()) == (1, 2, RATE_HZ)
            assert 0.1 < file.getnframes() / RATE_HZ < 1.5


def test_the_guide_never_waits_and_late_sounds_are_left_out() -> None:
    gate, played = threading.Event(), []

    def play(cue: Cue) -> None:
        gate.wait(5)
        played.append(cue)

    view = SoundView(play, None)
    for _ in range(50):
        view.show([accepted()])
    assert played == []
    gate.set()
    view.close()
    assert 1 <= len(played) <= 6


def test_a_broken_player_harms_nobody() -> None:
    said: list[str] = []

    def play(_cue: Cue) -> None:
        raise OSError("no card")

    view = SoundView(play, said.append)
    view.show([Hold(1.0, "+x", "words", 3.0, 10.0)])
    view.close()
    assert said == ["hold"]
