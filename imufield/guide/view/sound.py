"""Sound: what a person needs to hear who looks at the unit and not at the screen.

Tones go to the sound card where there is a program that plays them (``pw-play``, ``paplay``, ``aplay``, ``afplay``), else
the terminal's bell rings, in a number of strokes that tells the events apart. Speech goes to a program of the system. What is
said are fixed words and names of positions made from the scheme; text from the wire never reaches a program.

A thread of its own plays: the guide never waits for a sound, and what is not played yet when more arrives is left out.
"""

from __future__ import annotations

import io
import math
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import wave
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path

from imufield.guide.events import (
    Accepted,
    Advice,
    Done,
    Event,
    Hold,
    LinkBack,
    LinkLost,
    Move,
    NoiseFloorMeasured,
    RefusalCode,
    Rejected,
    Topic,
    Turn,
    Turned,
)
from imufield.samples import AXES

RATE_HZ = 22050
PLAYERS = ("pw-play", "paplay", "aplay", "afplay")
SPEAKERS = ("spd-say", "espeak-ng", "espeak", "say")
_LONGEST_S = 10.0  # A program that takes longer is ended: a sound that hangs must not keep a process.


class Cue(Enum):
    """What a sound means; the value holds strokes of the bell, and frequency and length of each tone."""

    READY = (1, ((660.0, 0.12),))
    HOLD = (1, ((880.0, 0.12),))
    ACCEPTED = (2, ((880.0, 0.10), (1320.0, 0.16)))
    REFUSED = (3, ((330.0, 0.18), (262.0, 0.28)))
    LOST = (4, ((262.0, 0.2), (262.0, 0.2), (262.0, 0.2)))
    DONE = (5, ((660.0, 0.12), (880.0, 0.12), (1100.0, 0.12), (1320.0, 0.3)))

    @property
    def strokes(self) -> int:
        """Strokes of the terminal's bell."""
        return int(self.value[0])

    @property
    def tones(self) -> tuple[tuple[float, float], ...]:
        """Frequency (Hz) and length (s) of each tone."""
        tones: tuple[tuple[float, float], ...] = self.value[1]
        return tones


_SILENT = (RefusalCode.NOT_QUIET, RefusalCode.RATE)
_SPOKEN_REFUSALS = {
    RefusalCode.MOVED: "moved, again",
    RefusalCode.KNOCKED: "knocked, again",
    RefusalCode.NOT_STILL: "not still",
    RefusalCode.NOT_NEAR: "not a planned side",
    RefusalCode.ALREADY_DONE: "this side is done",
    RefusalCode.OTHER_SIDE: "another side than asked",
    RefusalCode.TREMBLING: "trembling, again",
    RefusalCode.SWAYING: "swaying, again",
    RefusalCode.DRIFTING: "drifting, again",
    RefusalCode.WARMING_UP: "warming up, wait",
    RefusalCode.NOT_WHOLE: "not a whole turn, again",
}


def cue_of(event: Event) -> Cue | None:
    """Return what to play for an event, None for most."""
    if isinstance(event, Rejected):
        return None if event.reason in _SILENT else Cue.REFUSED
    if isinstance(event, Advice):
        return Cue.REFUSED if event.topic is Topic.DOUBTFUL else None
    cues: dict[type[Event], Cue] = {
        NoiseFloorMeasured: Cue.READY,
        Hold: Cue.HOLD,
        Accepted: Cue.ACCEPTED,
        Turned: Cue.ACCEPTED,
        LinkLost: Cue.LOST,
        LinkBack: Cue.READY,
        Done: Cue.DONE,
    }
    return cues.get(type(event))


def spoken(event: Event) -> str | None:
    """Return the words for an event, None for most; only words known here and directions."""
    if isinstance(event, Move):
        return f"next: {_spoken_side(event.direction)}"
    if isinstance(event, Rejected):
        return None if event.reason in _SILENT else _SPOKEN_REFUSALS.get(event.reason, "refused, see the screen")
    if isinstance(event, Turn):
        return f"roll about {event.axis}, {'plus' if event.sense > 0 else 'minus'}"
    words: dict[type[Event], str] = {
        NoiseFloorMeasured: "ready",
        Hold: "hold",
        Accepted: "accepted",
        Turned: "turn accepted",
        LinkLost: "no link",
        LinkBack: "link is back",
        Done: "done",
    }
    return words.get(type(event))


def _spoken_side(direction: tuple[float, float, float]) -> str:
    """Return the axes that point up, the largest first: "plus x and minus y up"."""
    order = sorted(range(3), key=lambda i: -abs(direction[i]))
    largest = abs(direction[order[0]])
    names = [f"{'plus' if direction[i] > 0 else 'minus'} {AXES[i]}" for i in order if abs(direction[i]) > 0.3 * largest]
    return " and ".join(names) + " up"


class SoundView:
    """Plays and speaks events.

    Parameters
    ----------
    play : callable
        Plays a cue; may take its time.
    speak : callable or None
        Says words; may take its time.
    """

    def __init__(self, play: Callable[[Cue], None], speak: Callable[[str], None] | None = None) -> None:
        self._play, self._speak = play, speak
        self._waiting: queue.Queue[list[Callable[[], None]] | None] = queue.Queue(maxsize=4)
        self._thread = threading.Thread(target=self._run, name="sound", daemon=True)
        self._thread.start()

    def show(self, events: list[Event]) -> None:
        """Take events; returns at once."""
        work: list[Callable[[], None]] = []
        for event in events:
            cue = cue_of(event)
            words = None if self._speak is None else spoken(event)
            if cue is not None:
                work.append(lambda cue=cue: self._play(cue))  # type: ignore[misc]
            if words is not None and self._speak is not None:
                work.append(lambda words=words, speak=self._speak: speak(words))  # type: ignore[misc]
        if work:
            # Late sounds mislead: what does not fit is left out.
            with suppress(queue.Full):
                self._waiting.put_nowait(work)

    def close(self) -> None:
        """Play what is waiting, for a moment at most."""
        with suppress(queue.Full):
            self._waiting.put_nowait(None)
        self._thread.join(timeout=3.0)

    def _run(self) -> None:
        while (work := self._waiting.get()) is not None:
            for one in work:
                with suppress(OSError, ValueError, subprocess.SubprocessError):
                    one()


@contextmanager
def open_sound(*, speak: bool = False) -> Iterator[SoundView]:
    """Yield a view with what this system has: sound card or bell, and speech where asked for and installed."""
    with tempfile.TemporaryDirectory(prefix="imufield-sound-") as folder:
        player = _find(PLAYERS) if _has_sound_card() else None
        play = _ring if player is None else _card_player(player, Path(folder))
        speaker = _find(SPEAKERS) if speak else None
        view = SoundView(play, None if speaker is None else _speaker(speaker))
        try:
            yield view
        finally:
            view.close()


def tone(cue: Cue) -> bytes:
    """Return a cue as a WAV file, mono, 16 bit; edges are rounded so that nothing clicks."""
    samples = array("h")
    for frequency_hz, length_s in cue.tones:
        count = int(length_s * RATE_HZ)
        edge = max(count // 10, 1)
        for i in range(count):
            loudness = min(1.0, i / edge, (count - i) / edge)
            samples.append(int(12000 * loudness * math.sin(2 * math.pi * frequency_hz * i / RATE_HZ)))
        samples.extend([0] * (RATE_HZ // 25))
    if sys.byteorder == "big":
        samples.byteswap()
    content = io.BytesIO()
    with wave.open(content, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        file.writeframes(samples.tobytes())
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
            threading.Event().wait(0.18)
        os.write(screen.fileno(), b"\a")


def _card_player(program: str, folder: Path) -> Callable[[Cue], None]:
    files = {cue: folder / f"{cue.name.lower()}.wav" for cue in Cue}
    for cue, path in files.items():
        path.write_bytes(tone(cue))

    def play(cue: Cue) -> None:
        _run_program([program, str(files[cue])])

    return play


def _speaker(program: str) -> Callable[[str], None]:
    waits = ["--wait"] if Path(program).name == "spd-say" else []

    def speak(words: str) -> None:
        _run_program([program, *waits, words])

    return speak


def _run_program(arguments: list[str]) -> None:
    quiet = subprocess.DEVNULL
    # A list without a shell, a program found on the path, words from this module: nothing of the wire is in it.
    subprocess.run(arguments, stdin=quiet, stdout=quiet, stderr=quiet, timeout=_LONGEST_S, check=False)  # noqa: S603
