"""The server of the page, attacked as a foreign page, a stranger in the network and a broken phone would."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections import deque
from contextlib import ExitStack, suppress
from http import HTTPStatus
from queue import Empty

import pytest

websockets = pytest.importorskip("websockets", reason="the page needs websockets")

from websockets.exceptions import ConnectionClosed, WebSocketException  # noqa: E402

from imufield.web import server  # noqa: E402
from imufield.web.access import BEFORE_TOKEN, PROTOCOL, Access, Role  # noqa: E402
from imufield.web.board import Board  # noqa: E402
from imufield.web.server import CLIENTS, CONNECTIONS, LARGEST_MESSAGE, SEND_TIMEOUT_S, static_files  # noqa: E402
from tests.web.served import WAIT_S, Served, next_state, send_until_cut_off  # noqa: E402


@pytest.mark.parametrize("role", Role)
def test_a_token_that_is_good_once_is_exchanged_for_a_lasting_one(served: Served, role: Role) -> None:
    token = served.access.once(role)
    lasting = {Role.MARK: served.access.mark, Role.WATCH: served.access.watch}[role]
    with served.open(token) as page:
        assert json.loads(page.recv(timeout=WAIT_S)) == {"role": role.value, "token": lasting}
    assert served.status(token=token) == HTTPStatus.FORBIDDEN
    with served.open(lasting) as page:
        assert json.loads(page.recv(timeout=WAIT_S)) == {"role": role.value}


def test_a_page_is_told_everything_and_then_what_is_new(served: Served) -> None:
    served.board.put({"n": 1}, positions={"accepted": {}}, trace=[[0.0, 1]], log=[{"text": "first"}])
    with served.open() as page:
        assert page.subprotocol == PROTOCOL
        assert json.loads(page.recv(timeout=WAIT_S)) == {"role": "mark"}
        first = next_state(page)
        assert (first["state"], first["head"]["session"], first["map"]) == ({"n": 1}, "s", {"accepted": {}})
        assert (first["trace"], first["log"]) == ([[0.0, 1]], [{"text": "first"}])
        served.board.put({"n": 2}, positions={"accepted": {}}, trace=[[0.1, 2]])
        second = next_state(page)
        assert {name: second[name] for name in second if name != "version"} == {"state": {"n": 2}, "trace": [[0.1, 2]]}
        # One that comes later has all of it.
        with served.open() as late:
            assert next_state(late)["trace"] == [[0.0, 1], [0.1, 2]]


def test_a_page_hears_a_beat_where_there_is_nothing_to_say(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "BEAT_S", 0.0)
    # Before the first state, and behind one that does not change, as in a replay that waits for its next block.
    with served.open() as page:
        assert json.loads(page.recv(timeout=WAIT_S)) == {"role": "mark"}
        assert json.loads(page.recv(timeout=WAIT_S)) == {}
        served.board.put({"n": 1})
        assert next_state(page)["state"] == {"n": 1}
        assert json.loads(page.recv(timeout=WAIT_S)) == {}


def test_one_that_was_away_too_long_begins_anew() -> None:
    board = Board({"session": "s"}, trace_blocks=3, log_lines=50)
    board.put({}, trace=[[0]])
    seen, _ = board.wait(-1, 0)
    for number in range(1, 6):
        board.put({}, trace=[[number]])
    _, message = board.wait(seen, 0)
    assert message is not None
    found = json.loads(message)
    assert found["head"] == {"session": "s"}
    assert found["trace"] == [[3], [4], [5]]


def test_marks_come_from_those_who_may(served: Served) -> None:
    served.board.put({})
    with served.open(served.access.watch) as watching, served.open() as marking:
        assert json.loads(watching.recv(timeout=WAIT_S)) == {"role": "watch"}
        send_until_cut_off(watching, "s")
        marking.send("r")
        assert served.marks.get(timeout=WAIT_S) == "r"
        with pytest.raises(Empty):
            served.marks.get_nowait()


@pytest.mark.parametrize("token", ["", "x", "A" * 22, "A" * 5000, "é".encode().hex()])
def test_without_the_token_nobody_gets_in(served: Served, token: str) -> None:
    assert served.status(token=token) in (403, 431, 400)
    assert served.server.pages == 0


def test_a_token_is_as_long_as_it_must_be_and_the_roles_differ(served: Served) -> None:
    assert len({served.access.watch, served.access.mark, Access(frozenset()).watch}) == 3
    # 22 characters of six bits: 128 bits and more.
    assert len(served.access.watch) == len(served.access.mark) == 22


def test_half_a_surrogate_pair_is_no_token() -> None:
    access = Access(frozenset())
    assert access.role(["token.\udcff", "token.\ud800" + access.mark]) is None
    assert access.role(["token.\udcff", BEFORE_TOKEN + access.watch]) is Role.WATCH


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1", "http://localhost:1", "file://"]
)
def test_a_foreign_page_gets_no_socket(served: Served, origin: str | None) -> None:
    assert served.status(origin=origin) == 403


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8777", "127.0.0.1:1", "127.0.0.2", "", "127.0.0.1.evil.example"]
)
def test_a_name_that_was_made_to_point_here_is_not_answered(served: Served, host: str) -> None:
    assert served.get("/", Host=host).status in (400, 421)
    assert served.status(host=host or "x", origin=f"http://{host}") in (400, 421)


def test_two_names_are_none(served: Served) -> None:
    with socket.create_connection(("127.0.0.1", served.port), timeout=WAIT_S) as line:
        line.sendall(f"GET / HTTP/1.1\r\nHost: {served.host}\r\nHost: evil.example\r\n\r\n".encode())
        assert b" 421 " in line.recv(4096).split(b"\r\n")[0]


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py", "/..%2fserver.py", "/static/../server.py", "//etc/passwd", "/etc/passwd", "/%2e%2e/server.py", "/.",
        "/..", "/static", "/index.html/", "/index.html%00", "/server.py", "/\\..\\server.py", "/style.css/../../server.py",
        "/socket", "/favicon.ico", "/guide.js~", "/__init__.py", "http://evil.example/", "/" + "a" * 4000,
    ],
)  # fmt: skip
def test_nothing_but_the_files_of_the_page_is_served(served: Served, path: str) -> None:
    answer = served.get(path)
    assert answer.status in (400, 403, 404, 414, 421, 431)
    assert len(answer.read()) < 300


@pytest.mark.parametrize("path", sorted(static_files()))
def test_files_come_with_headers_that_keep_them_to_themselves(served: Served, path: str) -> None:
    answer = served.get(path)
    assert answer.status == 200
    assert answer.getheader("Content-Type", "").startswith("text/")
    policy = answer.getheader("Content-Security-Policy", "")
    assert "default-src 'none'" in policy
    assert "require-trusted-types-for 'script'" in policy
    assert f"ws://{served.host}" in policy
    assert "unsafe" not in policy
    assert answer.getheader("X-Content-Type-Options") == "nosniff"
    assert answer.getheader("Referrer-Policy") == "no-referrer"
    assert answer.getheader("Server") is None
    text = answer.read().decode()
    # Nothing of elsewhere, nothing inline, and no way to make markup of a text.
    assert "http://" not in text.replace("http://www.w3.org", "")
    assert "https://" not in text
    assert not any(
        word in text for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", " style=")
    )


def test_a_giant_message_closes_its_page_only(served: Served) -> None:
    served.board.put({})
    with served.open() as giant, served.open() as other:
        giant.send("x" * (LARGEST_MESSAGE + 1))
        with pytest.raises(ConnectionClosed):
            next(None for _ in range(1000) if giant.recv(timeout=WAIT_S) is None)
        other.send("r")
        assert served.marks.get(timeout=WAIT_S) == "r"


def test_a_flood_of_marks_is_cut_off(served: Served) -> None:
    served.board.put({})
    with served.open() as flood, pytest.raises(ConnectionClosed):
        deque(map(flood.send, "s" * 100_000), maxlen=0)
    taken = 0
    while not served.marks.empty():
        served.marks.get()
        taken += 1
    assert taken < 100


def test_a_page_that_reads_nothing_holds_nobody_up(served: Served, pages: ExitStack) -> None:
    served.board.put({"text": "x" * 100_000})
    slow = pages.enter_context(served.open())
    slow.recv(timeout=WAIT_S)
    began_s = time.monotonic()
    for number in range(200):
        served.board.put({"n": number, "text": "x" * 100_000})
        time.sleep(0.002)
    with served.open() as quick:
        assert next_state(quick)["state"]["n"] == 199
    assert time.monotonic() - began_s < WAIT_S


def test_pages_beyond_the_limit_are_refused_and_the_others_stay(served: Served, pages: ExitStack) -> None:
    served.board.put({})
    opened = [pages.enter_context(served.open()) for _ in range(CLIENTS)]
    # A page counts once it is being served, which may be later than its side of the opening.
    assert all(next_state(page) for page in opened)
    assert served.status() == 503
    served.board.put({"n": 1})
    assert all(next_state(page) for page in (opened[0], opened[-1]))
    opened[0].close()
    deadline_s = time.monotonic() + WAIT_S
    while served.server.pages >= CLIENTS and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert next_state(pages.enter_context(served.open()))


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imufield.web.server.OPEN_TIMEOUT_S", 3.0)


def test_a_request_that_comes_late_is_answered(served: Served) -> None:
    with socket.create_connection(("127.0.0.1", served.port), timeout=WAIT_S) as line:
        # A browser on a machine with many programs does so.
        time.sleep(6.0)
        line.sendall(f"GET /texts.js HTTP/1.1\r\nHost: {served.host}\r\n\r\n".encode())
        assert line.recv(15).startswith(b"HTTP/1.1 200")


@pytest.mark.usefixtures("impatient")  # Made before the server, which reads the limit then.
def test_connections_that_say_nothing_keep_nobody_out_for_long(served: Served) -> None:
    served.board.put({"n": 1})
    threads = threading.active_count()
    idle = [socket.create_connection(("127.0.0.1", served.port), timeout=WAIT_S) for _ in range(200)]
    try:
        deadline_s = time.monotonic() + WAIT_S
        while time.monotonic() < deadline_s:
            # Each that is let in has two threads.
            assert threading.active_count() <= threads + 2 * (CONNECTIONS + 1)
            # Closed at once while the silent ones hold all places; they lose them after a few seconds.
            with suppress(OSError, EOFError, WebSocketException), served.open() as page:
                assert next_state(page)["state"] == {"n": 1}
                break
            time.sleep(0.2)
        else:
            pytest.fail("nobody gets in any more")
    finally:
        for line in idle:
            line.close()


def test_garbage_in_place_of_a_request_ends_its_connection_only(served: Served) -> None:
    for garbage in (
        b"\x00" * 100,
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"POST /socket HTTP/1.1\r\nHost: x\r\n\r\n",
        b"\x16\x03\x01\x02\x00",
    ):
        with socket.create_connection(("127.0.0.1", served.port), timeout=WAIT_S) as line:
            line.sendall(garbage)
            line.shutdown(socket.SHUT_WR)
            while line.recv(4096):
                pass
    assert served.get("/").status == 200


def test_it_ends_at_once_whatever_a_page_does(pages: ExitStack) -> None:
    served = Served()
    with served.server:
        served.board.put({"text": "x" * 10_000_000})
        pages.enter_context(served.open())
        time.sleep(0.3)
        began_s = time.monotonic()
    # The time to send to a page that takes nothing is five seconds; the end does not wait for it.
    assert time.monotonic() - began_s < SEND_TIMEOUT_S
