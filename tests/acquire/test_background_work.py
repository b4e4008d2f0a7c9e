"""What is done beside is told to who waits for it, whatever comes of it."""

from __future__ import annotations

import threading

import pytest

from imufield.acquire.background_work import BackgroundWork


def test_the_result_is_waited_for() -> None:
    may_end = threading.Event()
    waiting, other = BackgroundWork(lambda: may_end.wait(60)), BackgroundWork(threading.get_ident)
    assert other.result() != threading.get_ident()
    threading.Timer(0.1, may_end.set).start()
    assert waiting.result()


def test_an_error_is_raised_where_the_result_is_asked_for() -> None:
    beside = BackgroundWork(lambda: 1 // 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            beside.result()
