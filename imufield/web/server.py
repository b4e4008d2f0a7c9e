"""The server of the page: files of this package by their names, and one socket for each page.

Everything runs in threads of its own; the guide puts what there is to see on a board and takes marks from a queue, and never
waits for either.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from http import HTTPStatus
from importlib.resources import files
from typing import Self
from urllib.parse import quote

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from imufield.dataclass import dataclass
from imufield.web.access import BEFORE_TOKEN, PROTOCOL, Access, Role
from imufield.web.board import Board, Json

SOCKET = "/socket"
# Not asked of the system: some call a script plain text, and a browser told not to guess then refuses it.
TYPES = {"html": "text/html; charset=utf-8", "css": "text/css; charset=utf-8", "js": "text/javascript; charset=utf-8"}
CLIENTS = 64
"""Pages at once; a connection beyond them is closed before it is read."""
CONNECTIONS = 128
# For a request that does not come. On a busy machine a browser may take seconds between a connection and its request, and a
# page that lacks one script of ten does nothing.
OPEN_TIMEOUT_S = 15.0
SEND_TIMEOUT_S = 5.0  # A page that takes nothing for so long is cut off; it comes back by itself.
CLOSE_TIMEOUT_S = 0.5
LARGEST_MESSAGE = 1024  # Bytes: a mark has less than a tenth of it.
MARKS_A_SECOND = 10
ACCEPT_S = 0.2
_PASSING = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM, errno.ECONNABORTED, errno.EAGAIN, errno.EINTR)
EVERY_S = 0.05  # Marks are looked for as often.
BEAT_S = 1.0
"""A page that hears nothing for three seconds takes its connection for dead: where there is nothing to say, it hears a beat."""
BEAT = "{}"

# Its messages are about pages that went away: for nobody.
_SILENT = logging.getLogger(f"{__name__}.silent")
_SILENT.addHandler(logging.NullHandler())
_SILENT.propagate = False


@cache
def static_files() -> dict[str, tuple[str, bytes]]:
    """Return the files of the page by the path they are asked for, with type and content; downloads come besides."""
    folder = files(__package__ or "").joinpath("static")
    return {
        f"/{file.name}": (TYPES[file.name.rpartition(".")[2]], file.read_bytes())
        for file in folder.iterdir()
        if file.name.rpartition(".")[2] in TYPES
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """What a server is for, beside the board; as it stands here, the page of the guide.

    Attributes
    ----------
    index : str
        The file that stands for the whole.
    download : callable
        Given a path that is no file of ours, returns the name and content of a file that is handed out there; None for none.
    largest_message : int
        Bytes.
    messages_a_second : int
        Of one page.
    """

    index: str = "index.html"
    download: Callable[[str], tuple[str, bytes] | None] = lambda _: None
    largest_message: int = LARGEST_MESSAGE
    messages_a_second: int = MARKS_A_SECOND


GUIDE = Service()


class _Door(socket.socket):
    """Listens, and closes what comes beyond the limit before anything is made for it: no thread, no descriptor is left."""

    def __init__(self, listening: socket.socket) -> None:
        super().__init__(fileno=listening.detach())
        self.settimeout(ACCEPT_S)  # Whoever closes it is not heard while it waits.
        self.inside: Callable[[], int] = lambda: 0

    def accept(self) -> tuple[socket.socket, object]:
        """Return the next connection there is room for; raises ``OSError`` once it is closed, and for nothing else."""
        while self.fileno() >= 0:
            try:
                connection, address = super().accept()
            except TimeoutError:
                continue
            except OSError as error:
                # The other side is gone again, or descriptors are short for the moment: the next one may come.
                if error.errno not in _PASSING:
                    raise
                time.sleep(ACCEPT_S)
                continue
            if self.inside() < CONNECTIONS:
                return connection, address
            connection.close()
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))


class _Connection(ServerConnection):
    """A connection that is given up where nobody takes what it sends."""

    def __init__(self, *arguments: object, **settings: object) -> None:
        super().__init__(*arguments, **settings)  # type: ignore[arg-type]
        # In blocking mode the system itself ends a send that nobody takes. Windows counts it in milliseconds.
        limit = int(1000 * SEND_TIMEOUT_S) if sys.platform == "win32" else struct.pack("ll", int(SEND_TIMEOUT_S), 0)
        # The page is gone already: the first look at the connection says so.
        with suppress(OSError):
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)


@dataclass(kw_only=True)
class _Page:
    """One page: what it has seen and how often it has spoken lately."""

    connection: ServerConnection
    role: Role
    seen: int = -1
    allowance: float = 0.0
    allowed_s: float = 0.0


def _offered(request: Request) -> list[str]:
    """Return the subprotocols that a page offers, its token among them."""
    offered = ",".join(request.headers.get_all("Sec-WebSocket-Protocol"))
    return [name.strip() for name in offered.split(",")]


def _file(kind: str, content: bytes, disposition: str = "inline") -> Response:
    head = {"Content-Type": kind, "Content-Length": str(len(content)), "Connection": "close"}
    return Response(HTTPStatus.OK, HTTPStatus.OK.phrase, Headers({**head, "Content-Disposition": disposition}), content)


class PageServer:
    """Serves the page while it is entered.

    Parameters
    ----------
    listening : socket
        Bound; ``access`` holds the names that belong to it.
    access : Access
    board : Board
    on_mark : callable
        Given each message of a page that may make marks, from the page's own thread; returns the answer to it, or None.
    service : Service
    """

    def __init__(
        self,
        listening: socket.socket,
        access: Access,
        board: Board,
        on_mark: Callable[[str | bytes], str | None],
        *,
        service: Service = GUIDE,
    ) -> None:
        self._access, self._board, self._on_mark, self._service = access, board, on_mark, service
        self._pages: set[ServerConnection] = set()
        self._lock = threading.Lock()
        self._ends = False
        self._ended: Json | None = None
        door = _Door(listening)
        self._server = serve(
            self._serve_page,
            sock=door,
            subprotocols=[Subprotocol(PROTOCOL)],
            select_subprotocol=lambda _, offered: Subprotocol(PROTOCOL) if PROTOCOL in offered else None,
            process_request=self._answer,
            process_response=self._with_headers,
            server_header=None,
            compression=None,  # A message has some hundred bytes.
            open_timeout=OPEN_TIMEOUT_S,
            close_timeout=CLOSE_TIMEOUT_S,
            max_size=service.largest_message,
            max_queue=service.messages_a_second,
            logger=_SILENT,
            create_connection=_Connection,
        )
        door.inside = lambda: len(self._server.handler_threads)
        self._thread = threading.Thread(target=self._server.serve_forever, name="page server", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        deadline_s = time.monotonic() + CLOSE_TIMEOUT_S
        while self.pages and time.monotonic() < deadline_s:
            time.sleep(EVERY_S)
        # A page that takes nothing would hold its thread, and the end of the program, until its send times out.
        with self._lock:
            for connection in self._pages:
                # It was closed by the other side in the meantime.
                with suppress(OSError):
                    connection.socket.shutdown(socket.SHUT_RDWR)
        self._server.shutdown()
        self._thread.join()

    def end(self, words: Json) -> None:
        """Keep the words that each page is told last, when all ends: what there is and what comes next."""
        self._ended = words

    @property
    def pages(self) -> int:
        """How many pages look at the moment."""
        with self._lock:
            return len(self._pages)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse, serve a file, or let the socket open."""
        path = request.path.partition("?")[0]
        is_socket = path == SOCKET
        refusal = self._access.refusal(request.headers.get_all("Host"), request.headers.get_all("Origin"), is_socket=is_socket)
        if refusal is not None:
            return connection.respond(refusal, f"{refusal.phrase}\n")
        if is_socket:
            if self._access.role(_offered(request)) is None:
                return connection.respond(HTTPStatus.FORBIDDEN, "the address lacks its token\n")
            with self._lock:
                is_full = len(self._pages) >= CLIENTS
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many pages\n") if is_full else None
        name = f"/{self._service.index}" if path == "/" else path
        if request.method != "GET":
            return connection.respond(HTTPStatus.NOT_FOUND, "not found\n")
        if name in static_files():
            return _file(*static_files()[name])
        handed_out = self._service.download(path)
        if handed_out is None:
            return connection.respond(HTTPStatus.NOT_FOUND, "not found\n")
        file, content = handed_out
        # Of pictures alone the type is needed: a page shows them.
        kind = "image/svg+xml" if file.endswith(".svg") else "application/octet-stream"
        return _file(kind, content, f"attachment; filename*=UTF-8''{quote(file, safe='')}")

    def _with_headers(self, _connection: ServerConnection, _request: Request, response: Response) -> Response:
        for name, value in self._access.headers().items():
            response.headers[name] = value
        return response

    def _serve_page(self, connection: ServerConnection) -> None:
        offered = [] if connection.request is None else _offered(connection.request)
        lasting = self._access.spend(offered)
        role = self._access.role(offered if lasting is None else [f"{BEFORE_TOKEN}{lasting}"])
        # Another page was quicker with the token that is good once.
        if role is None:
            return
        with self._lock:
            self._pages.add(connection)
        try:
            self._follow(_Page(connection=connection, role=role), lasting)
        # The page is gone, whatever it was: it comes back with a new connection.
        except (ConnectionClosed, OSError):
            pass
        # A defect, whatever it is, is shown and goes on its way: websockets would note it in a log that nobody reads.
        except Exception as error:
            sys.excepthook(type(error), error, error.__traceback__)
            raise
        finally:
            with self._lock:
                self._pages.discard(connection)

    def _follow(self, page: _Page, lasting: str | None) -> None:
        """Send what is new and take marks, until the page goes or all ends; ``lasting`` is the token to come back with."""
        page.connection.send(json.dumps({"role": page.role.value} | ({} if lasting is None else {"token": lasting})))
        ends, sent_s = False, time.monotonic()
        while not ends:
            # Asked before the board: what was put there before the end is sent.
            ends = self._ends
            page.seen, message = self._board.wait(page.seen, 0.0 if ends else EVERY_S)
            if message is not None or time.monotonic() - sent_s >= BEAT_S:
                page.connection.send(message or BEAT)
                sent_s = time.monotonic()
            # All that the page has said was taken.
            with suppress(TimeoutError):
                while self._take(page, page.connection.recv(timeout=0)):
                    pass
        if self._ended is not None:
            page.connection.send(json.dumps({"ended": self._ended}))

    def _take(self, page: _Page, message: str | bytes) -> bool:
        """Take a mark; a page that says more than a person could is cut off."""
        now_s = time.monotonic()
        most = self._service.messages_a_second
        page.allowance = min(page.allowance + (now_s - page.allowed_s) * most, most) - 1
        page.allowed_s = now_s
        if page.allowance < 0:
            page.connection.close(1008)
            return False
        if page.role is Role.MARK and (answer := self._on_mark(message)) is not None:
            page.connection.send(answer)
        return True
