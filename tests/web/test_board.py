"""What pages are told, each at its own pace, adds up to what happened."""

from __future__ import annotations

import json
import random
import threading
from types import SimpleNamespace
from typing import Any

import pytest

import imufield.web.board
from imufield.web.board import Board

TRACE, LINES = 30, 12


class Reader:
    """What a page knows from the messages that it was sent, as its script keeps it."""

    def __init__(self) -> None:
        self.seen = -1
        self.state: Any = None
        self.map: Any = None
        self.trace: list[Any] = []
        self.log: list[Any] = []

    def look(self, board: Board) -> None:
        self.seen, text = board.wait(self.seen, 0)
        if text is None:
            return
        message = json.loads(text)
        if "head" in message:
            self.trace, self.log = [], []
        self.state = message["state"]
        self.map = message.get("map", self.map)
        self.trace = (self.trace + message.get("trace", []))[-TRACE:]
        self.log = (self.log + message.get("log", []))[-LINES:]


@pytest.mark.parametrize("seed", range(5))
def test_pages_of_any_pace_know_the_same_in_the_end(seed: int) -> None:
    rng = random.Random(seed)
    board = Board({"session": "s"}, trace_blocks=TRACE, log_lines=LINES)
    readers = [(Reader(), chance) for chance in (1.0, 0.5, 0.1, 0.02)]
    trace: list[int] = []
    log: list[str] = []
    measured: list[str] = []
    for number in range(400):
        blocks = [*range(len(trace), len(trace) + rng.randrange(4))]
        lines = [f"line {number}"] * (rng.random() < 0.2)
        trace, log = trace + blocks, log + lines
        if rng.random() < 0.05:
            measured.append(f"p{number}")
        board.put({"n": number}, positions={"accepted": [*measured]}, trace=[*blocks], log=[*lines])
        for reader, chance in readers:
            if rng.random() < chance:
                reader.look(board)
            # A reload, or a phone that was asleep for longer than its connection lived.
            if rng.random() < 0.02:
                reader.__init__()  # type: ignore[misc]
    late = Reader()
    for reader in (late, *(reader for reader, _ in readers)):
        reader.look(board)
        assert reader.state == {"n": 399}
        assert reader.map == {"accepted": measured}
        assert reader.trace == trace[-TRACE:]
        assert reader.log == log[-LINES:]


def test_a_page_that_comes_before_the_first_state_waits_for_it() -> None:
    board = Board({"session": "s"}, trace_blocks=TRACE, log_lines=LINES)
    assert board.wait(-1, 0) == (-1, None)
    found: list[str | None] = []
    waiting = threading.Thread(target=lambda: found.append(board.wait(-1, 60)[1]))
    waiting.start()
    board.put({"n": 0})
    waiting.join()
    assert found[0] is not None
    assert json.loads(found[0])["state"] == {"n": 0}


def test_what_is_no_number_is_a_defect_and_not_sent() -> None:
    board = Board({}, trace_blocks=TRACE, log_lines=LINES)
    board.put({"angle_deg": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        board.wait(-1, 0)


def test_who_writes_waits_for_no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    encoding, written = threading.Event(), threading.Event()

    def slow(*_: object, **__: object) -> str:
        encoding.set()
        written.wait(60)
        return "{}"

    shown = Board({}, trace_blocks=TRACE, log_lines=LINES)
    shown.put({"n": 0})
    monkeypatch.setattr(imufield.web.board, "json", SimpleNamespace(dumps=slow))
    reading = threading.Thread(target=shown.wait, args=(-1, 0))
    reading.start()
    assert encoding.wait(60)
    shown.put({"n": 1})
    assert reading.is_alive()
    written.set()
    reading.join()
