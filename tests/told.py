"""Which sentences were told, by the keys of their room's ``sentences.toml``."""

from __future__ import annotations

from collections.abc import Iterable

from imufield.sentences import Sentence


def key_of(text: object) -> str:
    """Return the key of a sentence; empty for a text that has none."""
    return str(getattr(text, "key", ""))


def keys(texts: Iterable[str]) -> list[str]:
    """Return the key of each sentence."""
    return [key_of(text) for text in texts]


def with_key(texts: Iterable[str], key: str) -> str:
    """Return the only sentence of a key."""
    (found,) = [text for text in texts if key_of(text) == key]
    return found


def told(texts: Iterable[str], key: str) -> list[Sentence]:
    """Return the sentences of a key, with their values."""
    return [text for text in texts if isinstance(text, Sentence) and text.key == key]
