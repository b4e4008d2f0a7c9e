"""What is done beside is told to who waits for it, whatever comes of it."""

from __future__ import annotations

import threading

import pytest

from imufield.acquire.beside import Beside


def test_the_result_is_waited_for() -> None:
    may_end = threading.Event()
    both = Beside(lambda: may_end.wait(60)), Beside(threading.get_ident)
    may_end.set()
    assert both[0].result()
    assert both[1].result() != threading.get_ident()


def test_an_error_is_raised_where_the_result_is_asked_for() -> None:
    beside = Beside(lambda: 1 // 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            beside.result()
