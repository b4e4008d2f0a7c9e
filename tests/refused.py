"""How tests expect an error: its kind, its reason and the facts it names, never its wording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from imufield.errors import ImufieldError, Reason


@contextmanager
def refused(
    kind: type[ImufieldError], reason: Reason | None = None, *facts: str, key: str | None = None
) -> Iterator[pytest.ExceptionInfo[ImufieldError]]:
    """Expect an error of a kind.

    Parameters
    ----------
    kind : type
    reason : Reason, optional
    *facts : str
        What the sentence must name: a file, an option, a key, a number with its unit.
    key : str, optional
        Which sentence of its room's ``sentences.toml`` it is.
    """
    with pytest.raises(kind) as caught:
        yield caught
    assert reason is None or caught.value.reason is reason, caught.value
    assert key is None or getattr(caught.value.message, "key", None) == key, caught.value
    for fact in facts:
        assert fact in caught.value.message
    # Every sentence says what to do: more than the fact that something is wrong.
    assert len(caught.value.message.split()) > 3, caught.value
