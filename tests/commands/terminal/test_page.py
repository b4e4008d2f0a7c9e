"""The page of a capture and of a replay, as a program meets it: the address, the marks, the end; the session is the same."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast
from urllib.parse import urlsplit

import jsonschema
import pytest

pytest.importorskip("websockets", reason="the page needs websockets")

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from imufield.acquire.instrument.connected import Connected
from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import PartStart, RecordedBlock, RecordedEvent, read_blocks, read_session
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.commands import replay
from imufield.commands.options.acquire_commands import CaptureOptions
from imufield.commands.terminal import guided, page
from imufield.commands.terminal.guided import guided_session
from imufield.commands.terminal.page import bind_page
from imufield.errors import Reason
from imufield.guide.events import EVENT_VERSION
from imufield.web.address import lan_addresses
from imufield.web.guide_page import GuidePage
from tests.commands.conftest import RATE_HZ, recorded_events
from tests.commands.pty_terminal import Terminal
from tests.commands.told import fails
from tests.guide.test_event_schema import read_schema

if TYPE_CHECKING:
    from imufield.commands.terminal.page import ServedPage
    from imufield.web.address import PageAddress
    from tests.commands.conftest import Program

WAIT_S = 300.0  # Only a program that hangs takes so long, however busy the machine.
MARKS = {300: "p", 320: "p", 400: "r", 600: "s", 601: "u"}
"""Behind these chunks of a stream."""


@contextmanager
def opened(url: str) -> Iterator[ClientConnection]:
    """Open an address as its page does."""
    parts = urlsplit(url)
    protocols = [Subprotocol("imufield"), Subprotocol(f"token.{parts.fragment.removeprefix('token=')}")]
    origin = Origin(f"http://{parts.netloc}")
    # A browser keeps whatever comes, whether its script looks at it or not.
    with connect(f"ws://{parts.netloc}/socket", origin=origin, subprotocols=protocols, max_queue=None) as connection:
        yield connection


def read_until(connection: ClientConnection, is_meant: Callable[[Any], bool]) -> Any:
    while not is_meant(message := json.loads(connection.recv(timeout=WAIT_S))):
        pass
    return message


def log_of(message: Any) -> list[str]:
    return [line["text"] for line in message.get("log", [])]


def marks_of(folder: Path) -> list[object]:
    """Return what was marked, as it stands in the recording."""
    return [event["action"] for event in recorded_events(Session.open(folder)) if event["event"] == "mark"]


@contextmanager
def printing(program: Program, *arguments: object) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """Start the program; what it prints goes to a file: nobody empties a pipe meanwhile."""
    path = program.folder / "printed.jsonl"
    with path.open("w") as output:
        yield program.start(*arguments, stdout=output), path


def address(process: subprocess.Popen[str], printed: Path) -> Any:
    """Return the first line that is printed."""
    while "\n" not in printed.read_text():
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    first = json.loads(printed.read_text().splitlines()[0])
    jsonschema.Draft202012Validator(read_schema()).validate(first)
    assert (first["version"], first["event"]) == (EVENT_VERSION, "page")
    return first


def test_a_program_is_told_the_address_and_pages_the_end(program: Program) -> None:
    port = program.show("+x")
    capture = program.capture(port, "--json", "--web", "--session", "one session")
    with (
        printing(program, *capture) as (process, printed),
        opened((told := address(process, printed))["url"]) as marking,
        opened(told["watch_url"]) as watching,
    ):
        assert told["url"] != told["watch_url"]
        assert json.loads(marking.recv(timeout=WAIT_S)) == {"role": "mark"}
        assert json.loads(watching.recv(timeout=WAIT_S)) == {"role": "watch"}
        read_until(marking, lambda message: message["state"]["done"] == 1)
        watching.send("f")
        watching.send("f")
        marking.send("q")
        marking.send("f")
        asked = read_until(marking, lambda message: any("[finish] again" in line for line in log_of(message)))
        assert asked["state"]["state"] != "done"
        marking.send("f")
        for each in (marking, watching):
            ended = read_until(each, lambda message: "ended" in message)["ended"]
            # What the terminal says at the end, as it can be pasted; too few for a result.
            command = "imufield capture --resume --session 'one session' --clock-speed 16"
            counts = {"accepted": 1, "planned": 6}
            # Five more for a result at all: nothing would check six positions.
            assert "to solve" in (lacking := ended.pop("lacking"))
            assert "5 more" in lacking
            assert ended == {"outcome": "stopped", "reason": "", "command": command, **counts}
        assert process.wait(WAIT_S) == 0
    lines = [json.loads(line) for line in printed.read_text().splitlines()]
    assert lines[1]["event"] == "session"
    assert marks_of(program.folder / "one session") == ["finish"]


def test_a_person_reads_the_address_beside_the_lines(program: Program) -> None:
    process = program.start(*program.capture(program.show("+x"), "--web"))
    assert process.stderr is not None
    line = next(line for line in process.stderr if "http://127.0.0.1:" in line)
    with opened(line.split()[-1]) as marking:
        read_until(marking, lambda message: "state" in message)
        process.send_signal(2)
        ended = read_until(marking, lambda message: "ended" in message)["ended"]
    assert (ended["outcome"], "--resume" in ended["command"]) == ("stopped", True)
    process.communicate(timeout=WAIT_S)
    assert process.returncode == 130


def test_pages_are_told_why_a_session_was_broken_off(program: Program) -> None:
    link = program.folder / "imu"
    program.show("+x", options=("--link", link))
    instrument = program.started[-1]
    with (
        printing(program, *program.capture(str(link), "--json", "--web")) as (process, printed),
        opened(address(process, printed)["url"]) as page,
    ):
        json.loads(page.recv(timeout=WAIT_S))
        read_until(page, lambda message: message["state"]["done"] == 1)
        # The link first: what it leads to may be another test's terminal once it is free.
        link.unlink()
        instrument.kill()
        instrument.wait()
        read_until(page, lambda message: message["state"]["link"] == "lost")
        # Another one at the same port.
        program.show("+x", options=("--link", link, "--seed", 5))
        ended = read_until(page, lambda message: "ended" in message)["ended"]
        assert process.wait(WAIT_S) == 3
    assert process.stderr is not None
    error = process.stderr.read()
    assert ended["reason"]
    assert ended["reason"] in " ".join(error.split())
    assert "--resume" in ended["command"]


def test_the_picture_for_a_phone_stands_in_place_of_the_guide_until_one_looks(program: Program) -> None:
    if not lan_addresses():
        pytest.skip("this machine is in no network")
    capture = program.capture(program.show("+x"), "--web-lan", "auto", "--latitude", 48, "--quiet")
    terminal = Terminal(program, *capture, size=(100, 50))

    def is_paused(message: dict[str, Any]) -> bool:
        # A terminal that nobody reads is soon full, and holds up the guide.
        terminal.read(0.0)
        return bool(message.get("state", {}).get("state") == "paused")

    try:
        place = terminal.expect("scan the code")
        url = re.findall(r"http://\S+#token=\S+", terminal.text)[0]
        with opened(url) as page:
            json.loads(page.recv(timeout=WAIT_S))
            terminal.expect("stillness", after=place)
            # A mark is no key that leads from the picture to the guide.
            page.send("p")
            read_until(page, is_paused)
        terminal.type("q")
        assert terminal.wait() == 0
    finally:
        terminal.close()


@pytest.mark.parametrize("size", [(60, 20), (80, 24), (120, 40)])
def test_the_address_and_one_answer_to_a_key_stay_on_the_screen(program: Program, size: tuple[int, int]) -> None:
    """As on a machine without a desktop, where nothing opens the page; the guide covers what was printed."""
    capture = program.capture(program.show("+x"), "--web", "--latitude", 48, "--quiet")
    terminal = Terminal(program, *capture, size=size)

    def frame() -> str:
        """Return a whole picture that is shown from now on, from its one line of the link to the next."""
        begin = terminal.expect("link ok", after=len(terminal.text))
        end = terminal.expect("link ok", after=begin)
        return terminal.text[begin:end]

    try:
        terminal.expect("accepted")
        (url,) = re.findall(r"^ page (http://127\.0\.0\.1:\S+#token=\S+) *\r?$", frame(), re.MULTILINE)
        with opened(url) as page:
            assert json.loads(page.recv(timeout=WAIT_S)) == {"role": "mark"}
        # In a pause nothing else is said.
        terminal.type("p")
        terminal.expect("paused: ")
        terminal.type("?x")
        terminal.expect("does nothing")
        terminal.type("?")
        # It is the newest again, and stands there once.
        while "does nothing" in (shown := frame()).partition("retake (suspect")[2] or "retake (suspect" not in shown:
            pass
        assert shown.count("retake (suspect") == 1
        assert f" page {url}" in shown
        terminal.type("q")
        assert terminal.wait() == 0
    finally:
        terminal.close()


@pytest.mark.parametrize("speed", [0, 40])
def test_a_recorded_session_is_shown_at_any_speed(program: Program, make_session: Callable[..., Session], speed: float) -> None:
    folder = make_session("faces6", hold_s=6.0).folder
    replay = ("replay", folder, "--web", "--json", "--speed", speed)
    with printing(program, *replay) as (process, printed), ExitStack() as stack:
        told = address(process, printed)
        # However short it is, it is not over before its page looks.
        assert process.stderr is not None
        assert process.stderr.readline()
        assert len(printed.read_text().splitlines()) == 1
        watching = stack.enter_context(opened(told["url"]))
        # There is nothing to mark any more.
        assert told["url"] == told["watch_url"]
        assert json.loads(watching.recv(timeout=WAIT_S)) == {"role": "watch"}
        states, heads = [], []
        while "ended" not in (message := json.loads(watching.recv(timeout=WAIT_S))):
            states.append(message["state"])
            heads += [message["head"]] if "head" in message else []
        assert {head["replay_speed"] for head in heads} == {speed}
        assert states[-1]["done"] == states[-1]["planned"] == 6
        assert states[-1]["state"] == "done"
        assert (message["ended"]["outcome"], message["ended"]["command"]) == ("replayed", f"imufield replay --web {folder}")
        assert process.wait(WAIT_S) == 0
    lines = printed.read_text().splitlines(keepends=True)
    assert "".join(lines[1:]) == program.run("replay", folder, "--json").stdout


def test_the_first_block_waits_for_a_page(whole_session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = iter([False, False, True])

    class Page:
        @property
        def is_looked_at(self) -> bool:
            return next(looks)

    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    items = replay._once_seen(cast("ServedPage", Page()), read_blocks(Session.open(whole_session), [], span_s=1.0))
    assert isinstance(next(items), PartStart)
    assert not slept
    blocks = [item for item in items if isinstance(item, RecordedBlock)]
    assert (len(slept), len(blocks) > 1, next(looks, None)) == (2, True, None)


def test_a_recording_without_data_waits_for_no_page(program: Program, whole_session: Path, tmp_path: Path) -> None:
    damaged = shutil.copytree(whole_session, tmp_path / "damaged")
    (damaged / "part-001.mcap").write_bytes(bytes(1000))
    ended = program.run("replay", damaged, "--web", "--json")
    assert (ended.returncode, json.loads(ended.stdout)["event"]) == (4, "page")


def test_one_target_at_a_time_and_only_guided_sessions(program: Program, whole_session: Path, tmp_path: Path) -> None:
    ended = program.run("replay", whole_session, "--web", "--to-pty")
    assert (ended.returncode, "--web" in ended.stderr, "--to-pty" in ended.stderr) == (2, True, True)
    plain = shutil.copytree(whole_session, tmp_path / "plain")
    settings = plain / "session.toml"
    settings.write_text(settings.read_text().replace('scheme = "paper24"\n', ""))
    assert "scheme" not in Session.open(plain).metadata
    ended = program.run("replay", plain, "--web")
    assert ended.returncode == 2
    assert "--web" in ended.stderr


def test_a_port_without_a_page_is_a_mistake() -> None:
    fails("capture --port /dev/null --web-port 9000", 2, Reason.USAGE, "--web-port", key="page.port_alone")


class Stream:
    """The chunks of a recording as a link gives them; at some of them it waits until a mark was made and heard."""

    name = "recorded"

    def __init__(self, chunks: list[Chunk], make: Callable[[str], None], is_heard: Callable[[], bool]) -> None:
        self._chunks, self._marks, self._next = chunks, dict(MARKS), 0
        self._make, self._is_heard, self._waits = make, is_heard, False

    def read(self) -> Chunk | None:
        self._waits = self._waits and not self._is_heard()
        if self._waits:
            time.sleep(0.001)
            return None
        if (key := self._marks.pop(self._next, None)) is not None:
            self._make(key)
            self._waits = True
            return None
        self._next += 1
        return self._chunks[self._next - 1]

    def drain(self) -> list[Chunk]:
        return []


class Keys:
    """A keyboard that types what it is told."""

    typed = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def read(self) -> str:
        keys, Keys.typed = Keys.typed, ""
        return keys


def capture_again(
    source: Session, folder: Path, place: PageAddress | None, make: Callable[[str], None], is_heard: Any
) -> list[object]:
    """Capture the stream of a recording anew, with marks at certain places; return what is recorded."""
    metadata = {name: value for name, value in source.metadata.items() if name not in ("created", "software")}
    session = Session.create_in(folder, "stim300", metadata)
    connected = Connected(
        link=Stream([item for item in read_session(source) if isinstance(item, Chunk)], make, is_heard),  # type: ignore[arg-type]
        protocol=load_driver("stim300").load_protocol({"rate_hz": RATE_HZ}),
        driver="stim300",
        model="stim300",
        baud=921600,
        chunks=[],
        identity={},
    )
    options = CaptureOptions(connect=None, plain=True, quiet=True)  # type: ignore[arg-type]
    assert guided_session(session, connected, SystemClock(), options, place=place).finished
    recorded = read_session(session)
    kept = {PartStart: "metadata", RecordedEvent: "event"}
    return [getattr(item, kept[type(item)]) if type(item) in kept else item for item in recorded]


def test_the_recording_is_the_same_with_a_page_and_without(
    make_session: Callable[..., Session], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = make_session("faces6", hold_s=5.5)
    monkeypatch.setattr(guided, "Keyboard", Keys)
    without = capture_again(source, tmp_path / "without", None, lambda key: setattr(Keys, "typed", key), lambda: not Keys.typed)
    said: list[str] = []
    sent: list[str] = []
    heard: list[str] = []
    read = GuidePage.read

    def keep(keys: str) -> str:
        heard.append(keys)
        return keys

    monkeypatch.setattr(page, "say", lambda line, **_: said.append(line))
    # A mark is answered with the next samples only, so that the stream must know when it was read.
    monkeypatch.setattr(GuidePage, "read", lambda of: keep(read(of)))
    with ExitStack() as stack:

        def make(key: str) -> None:
            connection = stack.enter_context(opened(said[0].split()[-1]))
            connection.send(key)
            sent.append(key)

        def is_heard() -> bool:
            return len("".join(heard)) == len(sent)

        shown = capture_again(source, tmp_path / "with", bind_page(stack), make, is_heard)
    assert marks_of(tmp_path / "with") == ["pause", "pause", "retake", "skip", "undo"]
    assert shown == without
