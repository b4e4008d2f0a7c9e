"""Guided sessions over simulated paths, for the tests of the guide."""

import re
import string
from typing import Any

import numpy as np

from imufield.guide.events import Rejected
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.refusals import Refusal, Sentence
from imufield.samples import Samples

FACES = {"+x": [1, 0, 0], "-x": [-1, 0, 0], "+y": [0, 1, 0], "-y": [0, -1, 0], "+z": [0, 0, 1], "-z": [0, 0, -1]}
SHORT = GuideSettings(hold_s=3.0)


def faces_session(
    make_path: Any, order: Any = ("+z", "+x", "-z", "+y", "-x", "-y"), hold_s: Any = 5.0, rate_hz: float = 100.0
) -> Any:
    path = make_path(rate_hz, lever_m=np.array([0.05, 0.02, -0.03])).hold(FACES[order[0]], hold_s + 1)
    for name in order[1:]:
        path.turn(FACES[name], 1.5).hold(FACES[name], hold_s)
    return path


def run(
    samples: Samples, name: str = "faces6", settings: Any = SHORT, marks: Any = (), blocks: Any = None, **options: Any
) -> Any:
    guide = Guide(scheme(name), samples.units, settings=settings, **options)
    events = []
    for action, time_s in marks:
        events += guide.mark(action, time_s)
    for block in blocks or [samples]:
        events += guide.feed(block)
    return guide, events + guide.flush()


def of(events: Any, kind: Any) -> Any:
    return [event for event in events if isinstance(event, kind)]


def is_said_by(row: Sentence, told: Refusal | Rejected) -> bool:
    """Whether a refusal is of this row of the table, which alone knows the wording."""
    return told.reason is row.reason and fits(row.words, told.words) and fits(row.remedy, told.remedy)


def fits(text: str, told: str) -> bool:
    """Whether what was told is this text with anything in its fields."""
    return re.fullmatch(_pattern(text), told) is not None


def fields_of(text: str, told: str) -> dict[str, str]:
    """Return what the fields of a text hold in what was told."""
    found = re.fullmatch(_pattern(text), told)
    assert found is not None, told
    return found.groupdict()


def _pattern(text: str) -> str:
    pattern, named = "", set()
    for words, name, _, _ in string.Formatter().parse(text):
        pattern += re.escape(words)
        if name is not None:
            pattern += ".*?" if name in named else f"(?P<{name}>.*?)"
            named.add(name)
    return pattern
