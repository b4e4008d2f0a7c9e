"""Sounds of the guide, for a person who looks at the unit and not at the screen.

Tones go to the sound card where there is a program that plays them (``pw-play``, ``paplay``, ``aplay``, ``afplay``), else
the terminal's bell rings, in a number of strokes that tells the events apart. Speech goes to a program of the system. It
consists of fixed words and names of positions made from the scheme; text from the wire never reaches a program.
Programs play files; where the disk takes none, the bell rings too.

A thread of its own plays: the guide never waits for a sound, and sounds that come too late are left out.
"""

from __future__ import annotations

import io
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import wave
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from enum import Enum
from pathlib import Path

import numpy as np

from imufield.guide import events
from imufield.guide.events import Event, RefusalCode, Topic
from imufield.guide.view.plain import said_once
from imufield.samples import AXES

RATE_HZ = 22050  # Every sound card plays it.
_LOUDNESS = 12000  # Of 32767: louder tones distort in small loudspeakers.
_PLAYERS = ("pw-play", "paplay", "aplay", "afplay")
_SPEAKERS = ("spd-say", "espeak-ng", "espeak", "say")
_LONGEST_S = 10.0  # A program that takes longer is ended: a sound that hangs must not keep a process.
_CLOSE_S = 3.0  # The longest sound, with its program's start.
_STROKE_S = 0.18  # Between two strokes of the bell, so that they are counted.
_WAITING = 4  # Blocks of events that wait for their sounds: more would come too late.
_POINTS_UP = 0.3  # Of the largest axis: an axis that points up by less is not named.


class Cue(Enum):
    """The sounds: strokes of the terminal's bell, and frequency (Hz) and length (s) of each tone."""

    READY = (1, ((660.0, 0.12),))
    HOLD = (1, ((880.0, 0.12),))
    ACCEPTED = (2, ((880.0, 0.10), (1320.0, 0.16)))
    REFUSED = (3, ((330.0, 0.18), (262.0, 0.28)))
    LOST = (4, ((262.0, 0.2), (262.0, 0.2), (262.0, 0.2)))
    DONE = (5, ((660.0, 0.12), (880.0, 0.12), (1100.0, 0.12), (1320.0, 0.3)))

    def __init__(self, strokes: int, tones: tuple[tuple[float, float], ...]) -> None:
        self.strokes = strokes
        self.tones = tones


_SILENT = (RefusalCode.NOT_QUIET, RefusalCode.RATE)
_SPOKEN_REFUSALS = {
    RefusalCode.MOVED: "moved, again",
    RefusalCode.KNOCKED: "knocked, again",
    RefusalCode.NOT_STILL: "not still",
    RefusalCode.NOT_NEAR: "not a planned side",
    RefusalCode.ALREADY_DONE: "this side is done",
    RefusalCode.OTHER_SIDE: "another side than asked",
    RefusalCode.OTHER_TURN: "another turn than asked",
    RefusalCode.TREMBLING: "trembling, again",
    RefusalCode.SWAYING: "swaying, again",
    RefusalCode.DRIFTING: "drifting, again",
    RefusalCode.WARMING_UP: "warming up, wait",
    RefusalCode.NOT_WHOLE: "not a whole turn, again",
}


# Sound and words of events that always have the same.
_HEARD: dict[type[Event], tuple[Cue, str]] = {
    events.NoiseFloorMeasured: (Cue.READY, "ready"),
    events.Hold: (Cue.HOLD, "hold"),
    events.Accepted: (Cue.ACCEPTED, "accepted"),
    events.Turned: (Cue.ACCEPTED, "turn accepted"),
    events.LinkLost: (Cue.LOST, "no link"),
    events.LinkBack: (Cue.READY, "link is back"),
    events.Done: (Cue.DONE, "done"),
}


def heard(event: Event) -> tuple[Cue | None, str | None]:
    """Return the sound and the words of an event, None for most; only words known here and directions."""
    if isinstance(event, events.Move):
        up = event.direction
        order = sorted(range(3), key=lambda i: -abs(up[i]))
        # An axis that hardly points up would only make the side longer to say: "plus x and minus y up".
        named = [i for i in order if abs(up[i]) > _POINTS_UP * abs(up[order[0]])]
        return None, f"next: {' and '.join(f'{_sign(up[i])} {AXES[i]}' for i in named)} up"
    if isinstance(event, events.Turn):
        return None, f"roll about {event.axis}, {_sign(event.sense)}"
    if isinstance(event, events.Rejected) and event.reason not in _SILENT:
        return Cue.REFUSED, _SPOKEN_REFUSALS.get(event.reason, "refused, see the screen")
    if isinstance(event, events.Advice) and event.topic is Topic.DOUBTFUL:
        return Cue.REFUSED, None
    if isinstance(event, events.Accepted) and event.suspect:
        return Cue.REFUSED, "suspect, again"
    if isinstance(event, events.LinkLost) and event.resumed:
        return None, None
    return _HEARD.get(type(event), (None, None))


def _sign(value: float) -> str:
    return "plus" if value > 0 else "minus"


class SoundView:
    """Plays and speaks events.

    Parameters
    ----------
    play : callable
        Plays a cue; may be slow.
    speak : callable or None
        Speaks words; may be slow.
    """

    def __init__(self, play: Callable[[Cue], None], speak: Callable[[str], None] | None = None) -> None:
        self._play, self._speak = play, speak
        self._waiting: queue.SimpleQueue[list[tuple[Cue | None, str | None]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="sound", daemon=True)
        self._thread.start()

    def show(self, events: list[Event]) -> None:
        """Play and speak events; returns at once."""
        sounds = [(cue, None if self._speak is None else words) for cue, words in map(heard, said_once(events))]
        sounds = [(cue, words) for cue, words in sounds if cue is not None or words is not None]
        # Late sounds mislead: what does not fit is left out.
        if sounds and self._waiting.qsize() < _WAITING:
            self._waiting.put(sounds)

    def close(self) -> None:
        """Play the waiting sounds, for a moment at most."""
        self._waiting.put(None)
        self._thread.join(timeout=_CLOSE_S)

    def _run(self) -> None:
        # A sound that fails harms nobody, and the words after it are spoken all the same.
        harmless = (OSError, ValueError, subprocess.SubprocessError)
        while (sounds := self._waiting.get()) is not None:
            for cue, words in sounds:
                if cue is not None:
                    with suppress(*harmless):
                        self._play(cue)
                if words is not None and self._speak is not None:
                    with suppress(*harmless):
                        self._speak(words)


@contextmanager
def open_sound(*, speak: bool = False) -> Iterator[SoundView]:
    """Yield a view with the means of this system: sound card or bell, and speech where asked for and installed."""
    with ExitStack() as stack:
        play: Callable[[Cue], None] = _ring
        speaker = _find(_SPEAKERS) if speak else None
        if player := _find(_PLAYERS) if _has_sound_card() else None:
            # A full disk ends no session: the bell rings.
            with suppress(OSError):
                folder = tempfile.TemporaryDirectory(prefix="imufield-sound-", ignore_cleanup_errors=True)
                play = _card_player(player, Path(stack.enter_context(folder)))
        view = SoundView(play, _speaker(speaker) if speaker else None)
        try:
            yield view
        finally:
            view.close()


def tone(cue: Cue) -> bytes:
    """Return a cue as a WAV file, mono, 16 bit; edges are rounded so that nothing clicks."""
    parts = []
    for frequency_hz, length_s in cue.tones:
        count = int(length_s * RATE_HZ)
        edge, i = max(count // 10, 1), np.arange(count)
        loudness = np.minimum(1.0, np.minimum(i, count - i) / edge)
        parts += [_LOUDNESS * loudness * np.sin(2 * np.pi * frequency_hz * i / RATE_HZ), np.zeros(RATE_HZ // 25)]
    content = io.BytesIO()
    with wave.open(content, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        file.writeframes(np.concatenate(parts).astype("<i2").tobytes())
    return content.getvalue()


def _find(names: tuple[str, ...]) -> str | None:
    return next((found for name in names if (found := shutil.which(name))), None)


def _has_sound_card() -> bool:
    """Whether sound may come out: a card of this computer; over SSH the bell reaches the person, the card does not."""
    if os.environ.get("SSH_CONNECTION"):
        return False
    return sys.platform == "darwin" or any(Path("/dev/snd").glob("pcm*p"))


def _ring(cue: Cue) -> None:
    """Ring the terminal's bell; it moves no cursor and prints nothing."""
    # The live view keeps what is written to ``sys.stdout`` until a line ends; the bell goes to the terminal itself.
    screen = sys.__stdout__
    if screen is None or not screen.isatty():
        return
    for stroke in range(cue.strokes):
        if stroke:
            threading.Event().wait(_STROKE_S)
        os.write(screen.fileno(), b"\a")


def _card_player(program: str, folder: Path) -> Callable[[Cue], None]:
    files = {cue: folder / f"{cue.name.lower()}.wav" for cue in Cue}
    for cue, path in files.items():
        path.write_bytes(tone(cue))
    return lambda cue: _run_program(program, str(files[cue]))


def _speaker(program: str) -> Callable[[str], None]:
    # Of the speakers only this one returns before it has spoken, and two sentences at once are none.
    waits = ["--wait"] if Path(program).name == "spd-say" else []
    return lambda words: _run_program(program, *waits, words)


def _run_program(*arguments: str) -> None:
    quiet = subprocess.DEVNULL
    # A list without a shell, a program found on the path, words from this module: nothing of the wire is in it.
    subprocess.run(arguments, stdin=quiet, stdout=quiet, stderr=quiet, timeout=_LONGEST_S, check=False)  # noqa: S603
