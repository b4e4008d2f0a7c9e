"""The workbench without a browser: what a page may ask for, what it gets, and what it never gets."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the workbench needs websockets")

from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from imufield.acquire.recording.reader import Damage, read_session
from imufield.acquire.recording.session import Session
from imufield.errors import EXIT_INTERRUPTED, UsageError
from imufield.progress import ERASE
from imufield.sentences import Sentence
from imufield.web import jobs
from imufield.web.access import PROTOCOL
from imufield.web.page_commands import ACTIONS, LONGEST_TEXT, UPLOADS, VIRTUAL, Sessions, command_line
from imufield.web.workbench import Workbench
from tests.web.served import WAIT_S, Served, next_state, send_until_cut_off
from tests.web.workbench_page import Page, page, root, served

__all__ = ["page", "root", "served"]

# What a page may ask for


@pytest.mark.parametrize(
    ("action", "values", "words"),
    [
        ("devices", {}, "devices --json"),
        ("devices", {"driver": "stim300"}, "devices --json stim300"),
        ("probe", {"port": "socket://host:4001"}, "probe --json --port=socket://host:4001"),
        ("sessions", {}, "sessions --json sessions"),
        ("emulate", {"speed": 4}, "emulate stim300 --json --wait --rate-hz=500 --link=sessions/virtual-stim300 --speed=4"),
        ("solve", {"session": "one", "latitude": -48.1, "without": ["x+0", "-o /etc/x"]},
         "solve --json sessions/one --latitude=-48.1 --without=x+0 '--without=-o /etc/x'"),
        ("capture", {"new": "two", "gravity": "9.8089+-0.0001", "settings": ["accelerometer_range_g=30"]},
         "capture --json --web --gravity=9.8089+-0.0001 --set=accelerometer_range_g=30 --session=sessions/two"),
        ("resume", {"session": "one", "retake": ["-z"]}, "capture --json --web --resume --session=sessions/one --retake=-z"),
        ("export", {"session": "one", "to": "c"}, "export --json sessions/one/parameters.toml --output=sessions/one --to=c"),
        ("import", {"files": ["one/parameters.toml"], "new": "two", "columns": "time,ax,ay,az", "zero": "32768"},
         "import --json sessions/one/parameters.toml --output=sessions/two --columns=time,ax,ay,az --zero=32768"),
        ("history", {"plot": True}, "history --json sessions --plot=sessions/history.svg"),
        ("report", {"session": "one", "operator": "--pdf", "pdf": False}, "report sessions/one --operator=--pdf"),
    ],
)  # fmt: skip
def test_what_is_asked_becomes_a_command_that_a_person_could_type(
    root: Path, action: str, values: dict[str, Any], words: str
) -> None:
    assert shlex.join(command_line(action, values, Sessions(root))) == words


def test_no_folder_is_an_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("--help", "-x"):
        Path(name).mkdir()
        (Path(name) / "parameters.toml").touch()
    sessions = Sessions(Path())
    assert command_line("solve", {"session": "--help"}, sessions)[:3] == ["solve", "--json", "./--help"]
    assert command_line("sessions", {}, Sessions(Path("-x"))) == ["sessions", "--json", "./-x"]
    assert "./-x/parameters.toml" in command_line("export", {"session": "-x", "to": "c"}, sessions)
    assert "./--help/parameters.toml" in command_line("import", {"new": "y", "files": ["--help/parameters.toml"]}, sessions)


@pytest.mark.parametrize(
    ("action", "values"),
    [
        ("shell", {}), ("", {}), (None, {}), (["solve"], {}), ("solve --output=/etc/x", {"session": "one"}), ("web", {}),
        ("record", {}), ("demo", {}), ("study", {}), ("apply", {}), ("verify", {}),
        # An option, or a word that is none of the table.
        ("devices", {"driver": "--help"}), ("devices", {"driver": "../x.toml"}), ("devices", {"driver": "x.toml"}),
        ("devices", {"output": "x"}), ("devices", ["driver"]), ("devices", "driver"), ("emulate", {"driver": "stim300"}),
        ("solve", {"session": "one", "output": "/etc/x"}), ("solve", {"session": "one", "preset": "/etc/passwd"}),
        ("solve", {"session": "one", "model": "--output=/etc/x"}), ("solve", {"session": "one", "without": "x+0"}),
        ("solve", {"session": "one", "without": ["x"] * 101}), ("solve", {"session": "one", "without": [["x"]]}),
        ("solve", {"session": "one", "latitude": "48 --output=/etc/x"}), ("solve", {"session": "one", "latitude": True}),
        ("solve", {"session": "one", "latitude": 1e999}), ("solve", {"session": "one", "gravity": "9.8 -o x"}),
        ("solve", {"session": "one", "gravity": 9.8}), ("report", {"session": "one", "operator": "x" * (LONGEST_TEXT + 1)}),
        ("report", {"session": "one", "operator": "a\nb"}), ("report", {"session": "one", "operator": "\x1b[2J"}),
        ("report", {"session": "one", "operator": "a\u202eb"}), ("report", {"session": "one", "operator": "a\x00b"}),
        ("export", {"session": "one", "to": "c", "settings": ["--output=/etc/x"]}), ("export", {"session": "one"}),
        ("export", {"session": "one", "to": "../c"}), ("export", {"to": "c"}),
        # A folder or a file of elsewhere.
        ("solve", {}), ("solve", {"session": ".."}), ("solve", {"session": "."}), ("solve", {"session": ""}),
        ("solve", {"session": "../sessions/one"}), ("solve", {"session": "/etc"}), ("solve", {"session": "one/.."}),
        ("solve", {"session": "one/"}), ("solve", {"session": "led-out"}), ("solve", {"session": "two"}),
        ("solve", {"session": ["one"]}), ("solve", {"session": {"name": "one"}}), ("solve", {"session": None}),
        ("solve", {"session": "-one"}), ("solve", {"session": "--json"}), ("solve", {"session": "one\x00"}),
        ("capture", {}), ("capture", {"new": "../two"}), ("capture", {"new": "/tmp/two"}), ("capture", {"new": ".two"}),
        ("capture", {"new": "-two"}), ("capture", {"new": "two/three"}), ("capture", {"new": "one"}),
        ("capture", {"new": UPLOADS}), ("capture", {"new": "two\n"}), ("capture", {"new": "x" * 101}),
        ("capture", {"new": "two", "positions": "/etc/passwd"}), ("capture", {"new": "two", "positions": "x.toml"}),
        ("import", {"new": "two", "files": ["../secret"]}), ("import", {"new": "two", "files": ["/etc/passwd"]}),
        ("import", {"new": "two", "files": ["one/led-out"]}), ("import", {"new": "two", "files": ["led-out/secret"]}),
        ("import", {"new": "two", "files": ["one"]}), ("import", {"new": "two", "files": "one/parameters.toml"}),
        # Longer than a name on the disk may be, in bytes.
        ("solve", {"session": "é" * 150}), ("import", {"new": "two", "files": ["é" * 150]}),
        ("import", {"new": "two"}), ("import", {"new": "two", "files": ["one/parameters.toml"], "protocol": "x.toml"}),
        # Addresses of pyserial that write files or load code, and what is no port.
        ("probe", {"port": "spy:///dev/ttyUSB0?file=/etc/x"}), ("probe", {"port": "alt:///dev/ttyUSB0?class=x"}),
        ("probe", {"port": "loop://?logging=debug"}), ("probe", {"port": "one/parameters.toml"}),
        ("probe", {"port": "/etc/passwd"}),
        ("probe", {"port": "/dev/null"}), ("probe", {"port": "/dev/watchdog"}), ("probe", {"port": "/dev/pts/../null"}),
        ("probe", {"port": "round"}), ("solve", {"session": "round"}), ("import", {"new": "two", "files": ["round"]}),
        ("solve", {"session": "one", "latitude": 10**400}), ("solve", {"session": "one", "latitude": float("nan")}),
        ("probe", {"port": "socket://host:1?logging=debug"}), ("probe", {"port": "--ask"}), ("probe", {"bus": "--ask"}),
        ("probe", {"bus": "socketcan:can0,../x"}), ("probe", {"port": 1}),
        ("probe", {"bus": "slcan:/dev/watchdog"}), ("probe", {"bus": "slcan:spy:///dev/ttyUSB0"}),
        ("history", {"plot": "x" * 500_000}), ("report", {"session": "one", "pdf": 1}),
    ],
)  # fmt: skip
def test_anything_else_is_refused(root: Path, action: Any, values: Any) -> None:
    with pytest.raises(UsageError) as caught:
        command_line(action, values, Sessions(root))
    assert isinstance(caught.value.message, Sentence)
    assert caught.value.message.key.startswith("page_commands.")


def test_the_words_of_the_table_are_commands_of_the_program() -> None:
    from imufield.cli.app import make_app

    known = {command.name for command in make_app().registered_commands}
    assert {action.words.split()[0] for action in ACTIONS.values()} <= known
    assert all(set(action.needs) <= action.fields.keys() for action in ACTIONS.values())


# What becomes of it


def test_a_command_runs_and_every_page_sees_what_it_says(served: Served, page: Page) -> None:
    job = page.run("sessions")
    assert page.heard(job, "code") == 0
    assert page.heard(job, "value")["folder"] == "sessions"
    assert page.heard(job, "command") == "imufield sessions --json sessions"
    # One that comes later has all of it.
    with served.open() as line:
        late = Page(line)
        assert late.heard(job, "code") == 0
        assert late.events == page.events


def test_what_is_no_number_is_none_on_its_way_to_the_pages() -> None:
    assert jobs._value('{"a": NaN, "b": [-Infinity], "c": 1}') == {"a": None, "b": [None], "c": 1}
    assert jobs._value("words") is jobs._value("{words}") is None


def test_how_far_a_command_is_is_shown_and_not_kept() -> None:
    told: list[dict[str, object]] = []
    under_way = jobs.Jobs(lambda *events: told.extend(events))
    under_way._heads[1] = jobs._Head(job=1, action="solve", values={}, command="imufield solve")
    under_way._read(1, io.StringIO(f"{ERASE}reading: 9%\nwords\n"), "said")
    (head,) = under_way.unfinished()
    assert head["told"] == {"progress": {"event": "progress", "words": "reading: 9%"}}
    under_way._read(1, io.StringIO(f"{ERASE}\n"), "said")
    assert under_way.unfinished()[0]["told"] == {}
    assert told == [{"job": 1, "said": "words"}]


def test_a_command_that_fails_says_why(page: Page) -> None:
    job = page.run("solve", session="one")
    assert page.heard(job, "code") == 4
    assert "sessions/one" in page.heard(job, "said")


@pytest.fixture
def deaf() -> Iterator[None]:
    """Ignore Ctrl-C, as shells let programs do that they start in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGINT, before)


# Two programs, each of which takes half a second to start.
@pytest.mark.usefixtures("deaf")
def test_a_command_waits_for_its_turn_and_is_ended_as_by_ctrl_c(
    served: Served, page: Page, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "MOST_AT_ONCE", 1)
    monkeypatch.setattr(jobs, "MOST_WAITING", 2)
    # Nobody has this number yet: it ends nothing, now or later.
    page.ask({"cancel": 1})
    running = page.run("emulate")
    assert running == 1
    assert Path(page.heard(running, "value")["port"]).exists()
    # There is one, and whoever comes later knows where.
    assert page.run("emulate") == running
    with served.open() as line:
        (head,) = next_state(line)["state"]["running"]
        assert head["told"]["started"]["port"] == str(root / VIRTUAL)
    dropped, waiting = page.run("devices"), page.run("sessions")
    assert "refused" in page.ask({"run": "devices"})
    page.ask({"cancel": dropped})
    assert page.heard(dropped, "code") == EXIT_INTERRUPTED
    assert not any(event["job"] == waiting and "code" in event for event in page.events)
    page.ask({"cancel": running})
    assert page.heard(running, "code") == EXIT_INTERRUPTED
    assert page.heard(waiting, "code") == 0
    # What has ended, and what never was.
    assert page.ask({"cancel": running})["answer"] == page.ask({"cancel": 99})["answer"] == {}
    assert page.ask({"cancel": [1]})["answer"] == {}


# Three programs, one after the other.
def test_an_instrument_that_ends_is_given_to_nobody_and_one_that_is_given_does_not_end(page: Page) -> None:
    first = page.run("emulate")
    port = page.heard(first, "value")["port"]
    page.ask({"cancel": first})
    second = page.run("emulate")
    assert second != first
    # It is at the port of the one before it, which is gone by then.
    assert page.heard(second, "value")["port"] == port
    assert page.heard(first, "code") == EXIT_INTERRUPTED
    assert Path(port).exists()
    # While one that reads it ends, it is given to another: for that one it stays.
    reader = page.run("probe", port=port)
    assert page.run("emulate") == second
    page.heard(reader, "code")
    # What comes behind it is answered behind it.
    assert page.ask({"cancel": 99})["answer"] == {}
    assert not any(event["job"] == second and "code" in event for event in page.events)
    # What it was given for is refused.
    assert "refused" in page.ask({"run": "capture", "values": {"new": "one", "port": port}})
    assert page.heard(second, "code") == EXIT_INTERRUPTED
    assert not Path(port).exists()


# Two programs, at two terminals that send nothing.
def test_a_port_that_is_probed_is_not_probed_by_a_second_page(served: Served, page: Page) -> None:
    pairs = [os.openpty() for _ in range(2)]
    ports = [os.ttyname(slave) for _, slave in pairs]
    first = page.run("probe", port=ports[0])
    # A page that is loaded anew asks for the same, by another socket.
    with served.open() as line:
        again = Page(line)
        assert again.run("probe", port=ports[0]) == first
        other = again.run("probe", port=ports[1])
        assert other != first
        for job in (first, other):
            assert again.heard(job, "value")["ports"][0]["error"]["reason"] == "silence"
    for descriptor in (descriptor for pair in pairs for descriptor in pair):
        os.close(descriptor)


# Two programs.
def test_a_virtual_instrument_ends_with_the_session_that_reads_it(page: Page) -> None:
    virtual = page.run("emulate")
    port = page.heard(virtual, "value")["port"]
    # Such a place is nowhere: it ends before it has begun.
    reader = page.run("capture", new="two", port=port, latitude=95)
    assert page.heard(reader, "code") != 0
    assert page.heard(virtual, "code") == EXIT_INTERRUPTED
    assert not Path(port).exists()


def test_what_a_session_holds_is_told_from_its_folder(page: Page, root: Path, solved_session: Path) -> None:
    shutil.copytree(solved_session, root / "two")
    (root / "two" / "report.html").touch()
    found = page.ask({"session": "two"})["answer"]
    assert found["files"] == ["parameters.toml", "report.html"]
    assert len(found["parameters"]["position"]) == 24
    assert found["parameters"]["error_at_rest"]["after_mg"] < found["parameters"]["error_at_rest"]["before_mg"]
    (root / "two" / "parameters.toml").unlink()
    assert page.ask({"session": "two"})["answer"] == found | {"files": ["report.html"], "parameters": None}
    # Its parameters are none: the sentence of whoever reads them, and all else.
    damaged = page.ask({"session": "one"})["answer"]
    assert "sessions/one" in damaged["fault"]
    assert (damaged["files"], damaged["parameters"]) == (["parameters.toml"], None)
    assert "refused" in page.ask({"session": ".."})


def test_what_a_session_holds_is_told_while_programs_write_there(root: Path) -> None:
    workbench, done = Workbench(root), threading.Event()

    def write() -> None:
        while not done.is_set():
            for number in range(100):
                (root / "one" / f".{number}.tmp").touch()
            for number in range(100):
                (root / "one" / f".{number}.tmp").unlink()

    writer = threading.Thread(target=write)
    writer.start()
    try:
        answers = [json.loads(workbench.take('{"session": "one"}')) for _ in range(100)]
    finally:
        done.set()
        writer.join()
        workbench.close()
    assert not [answer for answer in answers if "refused" in answer]
    assert all(answer["answer"]["files"] == ["parameters.toml"] for answer in answers)


def test_what_is_older_than_the_parameters_or_replaced_is_told_apart(page: Page, root: Path, solved_session: Path) -> None:
    shutil.copytree(solved_session, root / "two")
    parameters = root / "two" / "parameters.toml"
    for name in (
        "c.h",
        "c-1.h",
        "px4-1.params",
        "report.html",
        "report-2.html",
        "samples.overview.csv",
        "samples.overview-1.csv",
    ):
        (root / "two" / name).touch()
    solved_ns = parameters.stat().st_mtime_ns
    for name, made_ns in (("report.html", solved_ns - 1), ("samples.overview.csv", solved_ns - 1), ("c.h", solved_ns)):
        os.utime(root / "two" / name, ns=(made_ns, made_ns))
    found = page.ask({"session": "two"})["answer"]
    # Replaced, or older; a number alone says nothing, and of reports and samples none is kept.
    assert (sorted(found["earlier"]), found["is_outdated"]) == (["c-1.h", "report.html"], False)
    # A copy of the recording has a time of its own; it is another one where something came to it.
    part = next((root / "two").glob("part-*.mcap"))
    os.utime(part, ns=(solved_ns + 1, solved_ns + 1))
    assert not page.ask({"session": "two"})["answer"]["is_outdated"]
    shutil.copy(part, part.with_name("part-999.mcap"))
    assert page.ask({"session": "two"})["answer"]["is_outdated"]


def test_signals_that_were_read_are_not_read_again_until_the_recording_grows(
    page: Page, root: Path, solved_session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(solved_session, root / "two")
    part = next((root / "two").glob("part-*.mcap"))
    made_ns = part.stat().st_mtime_ns

    def needed() -> list[str]:
        return list(page.ask({"session": "two"})["answer"]["signals"])

    assert needed() == ["overview"]
    (root / "two" / "samples.overview.csv").touch()
    os.utime(root / "two" / "samples.overview.csv", ns=(made_ns + 1, made_ns + 1))
    # Samples exported for ROS 2 have the suffix of a part, and are none.
    (root / "two" / "samples.mcap").touch()
    assert needed() == []
    os.utime(part, ns=(made_ns + 2, made_ns + 2))
    monkeypatch.setattr("imufield.pipeline.chain.OUTLINE_BYTES", part.stat().st_size - 1)
    assert needed() == ["outline", "overview"]
    # A first picture is nobody's file.
    (root / "two" / "samples.outline.csv").touch()
    assert "samples.outline.csv" not in page.ask({"session": "two"})["answer"]["files"]


@pytest.mark.parametrize(
    "message",
    ["", "x", "{", "[]", "null", "7", '{"run": {}}', '{"values": {}}', "{}", "[" * 100_000, b"", b"x", b"\xff" * 99,
     '{"upload": "x"}', '{"upload": "x", "size": true}', '{"upload": 1, "size": 1}', '{"upload": "x", "size": -1}',
     '{"upload": "x", "size": 1, "folder": "../.."}', '{"upload": "x", "size": 1e300}', '{"file": ["x"]}', '{"file": ".."}',
     '{"file": "../secret"}', '{"file": "/etc/passwd"}', '{"file": "one"}', '{"file": "one/led-out"}',
     '{"file": "led-out/secret"}',
     '{"run": "solve", "values": {"session": "one", "latitude": 1e999}}', '{"id": 1e999, "session": "one"}',
     '{"file": "one/../../secret"}', '{"file": "one/parameters.toml\\u0000"}', '{"file": ""}'],
)  # fmt: skip
def test_a_message_that_makes_no_sense_is_answered_by_a_sentence(page: Page, message: str | bytes) -> None:
    assert len(page.ask(message)["refused"]) > 10
    assert "address" in page.ask({"file": "one/parameters.toml"})["answer"]


def test_who_only_watches_starts_nothing(served: Served, root: Path) -> None:
    with served.open(served.access.watch) as line, served.open() as other:
        send_until_cut_off(line, json.dumps({"run": "sessions", "values": {}}), json.dumps({"upload": "x.csv", "size": 3}))
        page = Page(other)
        assert page.run("sessions") == 1
        assert not (root / UPLOADS).exists()


@pytest.mark.parametrize("token", ["", "x", "A" * 22])
def test_a_foreign_token_gets_no_socket(served: Served, token: str) -> None:
    with pytest.raises(InvalidStatus) as caught:
        served.open(token)
    assert caught.value.response.status_code == 403


def test_a_value_out_of_range_is_told_in_a_sentence_and_no_box(page: Page) -> None:
    job = page.run("plan", noise_ug=-5)
    assert page.heard(job, "code") == 2
    said = [event["said"] for event in page.events if event["job"] == job and "said" in event]
    assert "--noise-ug" in said[-1]
    assert not re.search(r"[\u2500-\u257f]", "".join(said))


# The command


@pytest.fixture
def program(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start the command as a person does, in a folder of its own."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("IMUFIELD_")}
    program = subprocess.Popen(
        [sys.executable, "-m", "imufield", "web", "kept"],
        cwd=tmp_path,
        env={**variables, "HOME": str(tmp_path), "DISPLAY": "", "BROWSER": "true"},
        stderr=subprocess.PIPE,
        text=True,
    )
    yield program
    program.kill()
    program.communicate()


@contextmanager
def page_of(program: subprocess.Popen[str]) -> Iterator[Page]:
    assert program.stderr is not None
    found = re.search(r"(http://127\.0\.0\.1:\d+)/#token=(\S+)", program.stderr.readline())
    assert found is not None
    names = [Subprotocol(PROTOCOL), Subprotocol(f"token.{found[2]}")]
    address = f"{found[1].replace('http', 'ws')}/socket"
    with connect(address, origin=Origin(found[1]), subprotocols=names, compression=None) as line:
        yield Page(line)


# The program and two that it starts.
def test_the_command_tells_its_address_and_ends_with_what_it_has_started(
    program: subprocess.Popen[str], tmp_path: Path
) -> None:
    with page_of(program) as page:
        port = tmp_path / page.heard(page.run("emulate"), "value")["port"]
        assert port.exists()
        assert page.heard(page.run("sessions"), "value") == {"folder": "kept", "sessions": []}
        program.send_signal(signal.SIGINT)
        assert program.wait(WAIT_S) == EXIT_INTERRUPTED
    assert not port.exists()


# The same with a capture.
def test_what_it_has_started_ends_with_it_however_it_ends_and_loses_nothing(
    program: subprocess.Popen[str], tmp_path: Path
) -> None:
    with page_of(program) as page:
        port = page.heard(page.run("emulate", speed=16), "value")["port"]
        page.run("capture", new="two", port=port, driver="stim300", clock_speed=16, gravity="9.80665")
        # Said of samples.
        while not any("time_s" in event.get("value", {}) for event in page.events):
            page.next()
        program.kill()
    session, deadline_s = Session.open(tmp_path / "kept" / "two"), time.monotonic() + WAIT_S
    while session.is_being_recorded or (tmp_path / port).is_symlink():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    damage: list[Damage] = []
    assert len([*read_session(session, damage)]) > 2
    assert damage == []
