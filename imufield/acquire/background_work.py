"""Work in a background thread; it gains time only where the work releases the interpreter (reading, hashing, packing).

``concurrent.futures`` does the same; to import it takes as long as what is done here in a short command.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")


class BackgroundWork(Generic[Result]):
    """What ``work`` returns; it begins at once, and a program that ends does not wait for it."""

    def __init__(self, work: Callable[[], Result]) -> None:
        self._found: list[Result] = []
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(work,), daemon=True)
        self._thread.start()

    def result(self) -> Result:
        """Wait for it and return it; raises what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._found[0]

    def _run(self, work: Callable[[], Result]) -> None:
        try:
            self._found.append(work())
        # Whatever it is, ``result`` raises it: an error that ended only this thread would be lost.
        except Exception as error:  # noqa: BLE001
            self._error = error
