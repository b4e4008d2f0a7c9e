"""The operator's marks: their keys in a terminal, and how the guide's sentences name them.

Where a sentence of the guide asks for a mark, it names it in brackets: "[retake] to measure it again". Each view says how that
is done there: the terminal by a key, the page by a button, another program by what it has.
"""

from __future__ import annotations

import re

from imufield.sentences import Sentences

sentence = Sentences(__package__)

KEYS = {"r": "retake", "s": "skip", "u": "undo", "p": "pause", "f": "finish", "g": "go_on"}
NAMES = {"retake": "r", "go on": "p", "measure anyway": "g", "finish": "f"}
"""Names that stand in sentences, and the key of each."""
AGAIN_WITHIN_S = 10.0
"""Finishing with something left ends the session only with the same mark again within this time; a person's time is real,
however fast an emulated instrument runs."""

_NAMED = re.compile(rf"\[({'|'.join(NAMES)})\]")


def with_keys(words: str) -> str:
    """Return a sentence of the guide as a terminal says it: "press r to measure it again"."""
    return _NAMED.sub(lambda found: sentence("marks.press", key=NAMES[found[1]]), words)
