"""Which sentences a calibration tells, by their keys: never by their wording."""

from __future__ import annotations

from collections.abc import Iterable

from imufield.sentences import Sentence


def told(sentences: Iterable[str], key: str) -> list[Sentence]:
    """Return the sentences of one key."""
    return [sentence for sentence in sentences if isinstance(sentence, Sentence) and sentence.key == key]
