"""A server of a page in this process, and what browsers and others send to it."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from imufield.web.access import PROTOCOL, Access
from imufield.web.board import Board
from imufield.web.server import GUIDE, PageServer, Service

WAIT_S = 60.0  # A machine under load; nothing here takes as long.


class Served:
    """A server of a page.

    Parameters
    ----------
    board, on_mark, service
        As ``PageServer`` takes them; without a board there is one for a test to write on, and marks go to a queue.
    """

    def __init__(
        self,
        board: Board | None = None,
        on_mark: Callable[[str | bytes], str | None] | None = None,
        service: Service = GUIDE,
    ) -> None:
        listening = socket.create_server(("127.0.0.1", 0))
        self.port = listening.getsockname()[1]
        self.host = f"127.0.0.1:{self.port}"
        self.access = Access(frozenset({self.host, f"localhost:{self.port}"}))
        self.url = f"http://{self.host}/#token={self.access.mark}"
        self.board = board or Board({"session": "s", "positions": []}, trace_blocks=300, log_lines=50)
        self.marks: SimpleQueue[str | bytes] = SimpleQueue()
        self.server = PageServer(listening, self.access, self.board, on_mark or self.marks.put, service=service)

    def open(self, token: str | None = None, *, origin: str | None = "", host: str | None = None) -> ClientConnection:
        """Open the socket as a browser does; an origin of None is none."""
        names = [PROTOCOL, f"token.{self.access.mark if token is None else token}"]
        return connect(
            f"ws://{host or self.host}/socket",
            sock=socket.create_connection(("127.0.0.1", self.port), timeout=WAIT_S),
            origin=None if origin is None else Origin(origin or f"http://{self.host}"),
            subprotocols=[Subprotocol(name) for name in names],
            compression=None,
            open_timeout=WAIT_S,
        )

    def status(self, **given: Any) -> int:
        """Return the status with which a socket is refused."""
        with pytest.raises(InvalidStatus) as caught:
            self.open(**given)
        return int(caught.value.response.status_code)

    def get(self, path: str, **headers: str) -> http.client.HTTPResponse:
        """Ask for a path as it is written; what a client would tidy up reaches the server."""
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WAIT_S)
        line.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            line.putheader(name, value)
        line.endheaders()
        return line.getresponse()


def next_state(page: ClientConnection) -> Any:
    """Return the next message with a state."""
    message = json.loads(page.recv(timeout=WAIT_S))
    return message if "state" in message else next_state(page)


def send_until_cut_off(page: ClientConnection, *messages: str) -> None:
    """Send messages again and again: a page that is cut off for it knows that those before were taken."""
    with suppress(ConnectionClosed):
        while True:
            for message in messages:
                page.send(message)
