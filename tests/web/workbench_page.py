"""A page of the workbench without a browser, and the workbench that serves it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the workbench needs websockets")

from websockets.sync.client import ClientConnection

from imufield.web.workbench import Workbench
from tests.web.served import WAIT_S, Served


class Page:
    """A page of the workbench: asks, and follows what becomes of it."""

    def __init__(self, line: ClientConnection) -> None:
        self.line = line
        self.events: list[dict[str, Any]] = []

    def next(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self.line.recv(timeout=WAIT_S))
        self.events += message.get("log", [])
        return message

    def ask(self, message: dict[str, Any] | str | bytes) -> dict[str, Any]:
        self.line.send(json.dumps({"id": 7, **message}) if isinstance(message, dict) else message)
        while True:
            answer = self.next()
            if "answer" in answer or "refused" in answer:
                return answer

    def run(self, action: str, **values: Any) -> int:
        return int(self.ask({"run": action, "values": values})["answer"]["job"])

    def heard(self, job: int, name: str) -> Any:
        """Return what a command says of a kind, first of all what is known already."""
        while True:
            for event in self.events:
                if event["job"] == job and name in event:
                    return event[name]
            self.next()


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of sessions with one that holds a file, below the present folder."""
    monkeypatch.chdir(tmp_path)
    root = Path("sessions")
    (root / "one").mkdir(parents=True)
    (root / "one" / "parameters.toml").write_text("of one")
    (tmp_path / "secret").write_text("not yours")
    (root / "led-out").symlink_to(tmp_path)
    (root / "round").symlink_to("round")
    (root / "one" / "led-out").symlink_to(tmp_path / "secret")
    return root


@pytest.fixture
def served(root: Path) -> Iterator[Served]:
    bench = Workbench(root)
    served = Served(bench.board, bench.take, bench.service)
    with served.server:
        bench.refresh()
        yield served
        bench.close()


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with served.open() as line:
        yield Page(line)
