"""A network between a browser and the program that can be cut: what is sent to it at one address it passes on to another."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from typing import Self

HERE = "127.0.0.2"
"""Loopback as well, so that the port may be that of the program, and names and origins are those it expects."""
ARGUMENT = f"--host-resolver-rules=MAP localhost {HERE}"
"""For the browser: "localhost" leads through the network."""


class Network:
    """Passes on what comes to a port, until it is cut.

    Parameters
    ----------
    port : int
        Of the program, at 127.0.0.1.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self._listening: socket.socket | None = None
        self._lines: list[socket.socket] = []
        self._lock = threading.Lock()
        self.connections = 0  # That were made.

    def __enter__(self) -> Self:
        self.join()
        return self

    def __exit__(self, *_: object) -> None:
        self.cut()

    def join(self) -> None:
        """Let connections be made."""
        self._listening = socket.create_server((HERE, self._port))
        threading.Thread(target=self._accept, args=(self._listening,), daemon=True).start()

    def cut(self) -> None:
        """End all connections without a word, and let none be made."""
        listening, self._listening = self._listening, None
        with self._lock:
            for line in (*self._lines, *filter(None, [listening])):
                with suppress(OSError):
                    line.shutdown(socket.SHUT_RDWR)
                line.close()
            self._lines.clear()

    def _accept(self, listening: socket.socket) -> None:
        with suppress(OSError):
            while True:
                near, _ = listening.accept()
                try:
                    far = socket.create_connection(("127.0.0.1", self._port))
                except OSError:
                    # The program does not answer: whoever asks hears that at once.
                    near.close()
                    continue
                with self._lock:
                    self._lines += [near, far]
                    self.connections += 1
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    @staticmethod
    def _pass_on(source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)
