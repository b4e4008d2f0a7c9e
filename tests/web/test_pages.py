"""Many pages that come, go, sleep and come back, on real sockets."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the page needs websockets")

from websockets.exceptions import ConnectionClosed, ConnectionClosedOK, InvalidStatus
from websockets.sync.client import ClientConnection

from imufield.web.server import CLIENTS
from tests.web.guide_stages import ENDED
from tests.web.served import WAIT_S, Served, next_state

RELOADS = 50


def newest(page: ClientConnection, number: int) -> Any:
    """Read until a state is there; each is newer than the one before."""
    last = -1
    while (message := next_state(page))["state"]["n"] != number:
        assert message["state"]["n"] > last
        last = message["state"]["n"]
    return message


def wait_until_gone(served: Served) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while served.server.pages:
        assert time.monotonic() < deadline_s
        # Who has gone without a word is found out when something is to be told.
        served.board.put({"n": -1})
        time.sleep(0.02)


def test_a_page_that_is_reloaded_again_and_again_sees_at_once_what_is_true(served: Served) -> None:
    threads = threading.active_count()
    for number in range(RELOADS):
        served.board.put({"n": number}, positions={"accepted": {"x+0": {}}}, log=[{"text": f"line {number}"}])
        with served.open() as page:
            message = next_state(page)
            assert message["state"] == {"n": number}
            assert message["map"] == {"accepted": {"x+0": {}}}
            assert [line["text"] for line in message["log"]][-1] == f"line {number}"
            # Without a word, as a page that is reloaded or loses its network.
            page.socket.shutdown(socket.SHUT_RDWR)
    wait_until_gone(served)
    # Nothing is left of any of them: each thread ends by itself.
    deadline_s = time.monotonic() + WAIT_S
    while threading.active_count() > threads:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_a_page_that_was_away_is_told_everything_anew(served: Served) -> None:
    served.board.put({"n": 0}, trace=[[0]])
    with served.open() as page:
        next_state(page)
    for number in range(1, 1001):
        served.board.put({"n": number}, trace=[[number]], log=[{"text": str(number)}])
    with served.open() as page:
        message = next_state(page)
    assert message["state"] == {"n": 1000}
    assert message["trace"] == [[number] for number in range(701, 1001)]
    assert [line["text"] for line in message["log"]] == [str(number) for number in range(951, 1001)]


def test_pages_that_sleep_hold_up_neither_the_guide_nor_each_other(served: Served, pages: ExitStack) -> None:
    served.board.put({"n": 0})
    asleep = [pages.enter_context(served.open()) for _ in range(5)]
    with served.open() as awake:
        for number in range(1, 101):
            # More than the system keeps for a page that does not read.
            served.board.put({"n": number, "text": "x" * 200_000})
            assert newest(awake, number)["state"]["n"] == number
        # Those that wake up in time see fewer states, the last one among them; the others come back with a new connection.
        for page in asleep:
            try:
                assert newest(page, 100)
            except ConnectionClosed:
                with served.open() as again:
                    assert next_state(again)["state"]["n"] == 100


def test_of_two_hundred_pages_those_that_find_room_agree(served: Served, pages: ExitStack) -> None:
    served.board.put({"n": 0}, trace=[[0]])
    inside, refused = [], 0
    for number in range(200):
        try:
            page = pages.enter_context(served.open(served.access.watch if number % 2 else None))
        except InvalidStatus as error:
            refused += error.response.status_code == 503
        else:
            # It is counted once it is told something.
            assert next_state(page)["trace"] == [[0]]
            inside.append(page)
    assert (len(inside), refused) == (CLIENTS, 200 - CLIENTS)
    for number in range(1, 11):
        served.board.put({"n": number}, trace=[[number]])
    for page in inside:
        trace: list[Any] = []
        while len(trace) < 10:
            trace += next_state(page)["trace"]
        assert trace == [[number] for number in range(1, 11)]
    inside[0].send("r")
    assert served.marks.get(timeout=WAIT_S) == "r"


def test_who_watches_is_never_told_how_to_mark(served: Served) -> None:
    served.board.put({"n": 0})
    with served.open(served.access.watch) as page:
        assert page.response is not None
        told = [str(page.response.headers), page.recv(timeout=WAIT_S), page.recv(timeout=WAIT_S)]
        served.board.put({"n": 1}, log=[{"text": "line"}])
        told.append(page.recv(timeout=WAIT_S))
    files = served.get("/")
    told += [str(files.headers), files.read().decode()]
    assert not any(served.access.mark in str(each) or served.access.watch in str(each) for each in told)


def test_the_last_message_says_how_it_ended_behind_the_last_state() -> None:
    served = Served()
    with ExitStack() as stack:
        with served.server:
            served.board.put({"n": 0})
            opened = [stack.enter_context(served.open()) for _ in range(3)]
            for page in opened:
                next_state(page)
            served.board.put({"n": 1}, log=[{"text": "done"}])
            served.server.end(ENDED)
        for page in opened:
            told = [json.loads(text) for text in page]
            assert [(message["state"], message["log"]) for message in told[:-1]] == [({"n": 1}, [{"text": "done"}])]
            assert told[-1] == {"ended": ENDED}
            with pytest.raises(ConnectionClosedOK):
                page.recv(timeout=WAIT_S)
