"""``imufield capture`` as a person and as a program use it."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.pipeline.chain import session_samples
from imufield.sentences import Sentences
from tests.commands.conftest import FACES, IMUFIELD, SPEED, newest, recorded_events
from tests.commands.pty_terminal import Terminal
from tests.commands.told import missing, says

if TYPE_CHECKING:
    from tests.commands.conftest import Program


@pytest.fixture
def faces(program: Program) -> str:
    return program.emulate("--positions", "faces6", "--hold-s", 6, "--wait")


def test_port_alone_is_enough_and_what_is_assumed_is_said(program: Program) -> None:
    port = program.emulate("--positions", "none")
    process = program.start("capture", "--port", port, variables={"IMUFIELD_CLOCK_SPEED": "16"})
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(3)]
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=900)
    assert "driver stim300, " in error
    assert "baud rate 921600 (assumed)" in error
    unknown = Sentences("imufield.commands")("capture.gravity_unknown")
    assert " ".join(error.split()).count(unknown) == 1
    assert "--latitude DEGREES" in unknown
    assert lines[0].startswith("session imufield-sessions/")
    metadata = newest(program).metadata
    assert metadata["scheme"] == "paper24"
    assert metadata["instrument"]["serial_number"].startswith("N")
    assert metadata["settings"]["accelerometer_range_g"]["origin"] == "read"
    assert metadata["site"] == {}


def test_a_whole_session_in_plain_lines_then_solve(program: Program, faces: str) -> None:
    ended = program.run(*program.capture(faces))
    assert ended.returncode == 0, ended.stderr
    session = newest(program)
    assert session.finished
    folder = session.folder.relative_to(program.folder)
    # The path and the command, too long to stand beside the words, have lines of their own.
    assert ended.stdout.splitlines()[-4:] == [
        "6 of 6 positions measured, session",
        f"{folder}",
        "next:",
        f"imufield solve {folder}",
    ]
    assert "\x1b" not in ended.stdout
    assert "?" not in ended.stdout
    solved = program.run("solve", "--json")
    assert solved.returncode == 0, solved.stderr
    document = json.loads(solved.stdout)
    assert document["site"]["gravity_source"] == "assumed"
    assert document["site"]["gravity_sigma_m_s2"] == pytest.approx(0.018)
    assert any("gravity" in reason and "assumed" in reason for reason in document["quality"]["reasons"])
    assert document["instrument"]["serial_number"] == session.metadata["instrument"]["serial_number"]
    assert sorted(position["name"] for position in document["position"]) == sorted(FACES)
    assert (session.folder / "parameters.toml").is_file()


def test_an_earlier_calibration_goes_into_the_session(program: Program, faces: str, solved_session: Path) -> None:
    process = program.start(*program.capture(faces, "--preset", solved_session))
    assert process.stdout is not None
    assert process.stdout.readline().startswith("session ")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=900)
    guide = newest(program).metadata["guide"]
    # The simulated instrument is right to a tenth of a percent, the calibration to a thousandth.
    assert guide["earlier_scale_raw"] == pytest.approx(1.0, abs=2e-3)
    assert 0 < guide["earlier_scale_sigma"] < 1e-3


def test_an_earlier_calibration_of_another_instrument_is_refused(program: Program, faces: str) -> None:
    example = Path(__file__).parents[2] / "docs" / "exports" / "example.toml"
    ended = program.run(*program.capture(faces, "--preset", example))
    assert ended.returncode == 5
    assert "serial number 0001" in ended.stderr
    assert not list((program.folder / "imufield-sessions").glob("*"))


def test_json_lines_and_nothing_else(program: Program, faces: str) -> None:
    ended = program.run(*program.capture(faces, "--json"))
    assert ended.returncode == 0, ended.stderr
    told = [json.loads(line) for line in ended.stdout.splitlines()]
    assert told[0] == {"version": 1, "event": "session", "session": str(newest(program).folder.relative_to(program.folder))}
    assert told[-1]["event"] == "done"
    assert [event["position"] for event in told if event["event"] == "accepted"][-1] in FACES
    assert told[1:] == recorded_events(newest(program))


def test_replay_tells_the_same(program: Program, faces: str) -> None:
    captured = program.run(*program.capture(faces, "--json"))
    replayed = program.run("replay", "--json")
    assert replayed.returncode == 0, replayed.stderr
    assert replayed.stdout.splitlines() == captured.stdout.splitlines()[1:]


def test_resume(program: Program) -> None:
    port = program.emulate("--positions", "corners24", "--hold-s", 6)
    process = program.start(*program.capture(port, "--json", "--gravity", 9.81))
    assert process.stdout is not None
    while '"accepted": 2' not in process.stdout.readline():
        assert process.poll() is None
    process.terminate()
    assert process.wait(120) == 130
    process.communicate()
    session = newest(program)
    folder = session.folder.relative_to(program.folder)
    solved = program.run("solve", folder)
    assert solved.returncode == 6
    # Broken off in a hold that a busy machine had delayed, there is a refusal to name as well.
    assert not missing(solved.stderr, "2 positions", "scale and bias need 6", f"imufield capture --session {folder} --resume")

    for options, code, words in (
        ((), 4, "--resume"),
        (("--resume", "--positions", "paper24"), 2, "faces6"),
        (("--resume", "--hold-s", "9"), 2, "2 s"),
        (("--resume", "--target-bias-ug", "5"), 2, "--target-bias-ug"),
        (("--resume", "--rotations", "rolled"), 2, "--rotations"),
        (("--resume", "--rotations", "bogus"), 2, "unknown"),
        (("--resume", "--preset", "nonexistent.toml"), 5, "nonexistent.toml"),
    ):
        refused = program.run("capture", "--port", port, "--session", folder, *options)
        assert (refused.returncode, refused.stdout) == (code, "")
        assert words in " ".join(refused.stderr.split())

    # The list of sessions decodes nothing.
    accepted = [event for event in recorded_events(newest(program)) if event["event"] == "accepted"]
    assert newest(program).record.accepted == len(accepted) >= 2
    # Port, driver, baud rate, positions and site are those of the session.
    resumed = program.run("capture", "--resume", variables={"IMUFIELD_CLOCK_SPEED": "16"})
    assert resumed.returncode == 0, resumed.stderr
    assert "6 of 6 positions measured" in resumed.stdout
    assert "assumed" not in resumed.stderr
    session = newest(program)
    assert (session.finished, session.record.accepted) == (True, 6)
    assert session.metadata["site"]["gravity_m_s2"] == 9.81
    assert [path.name for path in session.parts] == ["part-001.mcap", "part-002.mcap"]
    taken = [event["position"] for event in recorded_events(session) if event["event"] == "accepted"]
    assert sorted(map(str, taken)) == sorted(FACES)


def test_what_is_proposed_can_be_pasted(program: Program) -> None:
    def paste(command: str) -> subprocess.CompletedProcess[str]:
        text = f" {command}".replace(" imufield ", f" {shlex.join(IMUFIELD)} ", 1)
        run = ["sh", "-c", text]
        return subprocess.run(run, cwd=program.folder, env=program.environment(), capture_output=True, text=True, check=False)

    port = program.emulate("--positions", "faces6", "--hold-s", 6)
    process = program.start(*program.capture(port, "--plain", "--gravity", 9.81, "--session", "my imu, No 1"))
    assert process.stdout is not None
    while "accepted" not in process.stdout.readline():
        assert process.poll() is None
    process.terminate()
    output, _ = process.communicate(timeout=900)
    resumed = paste(output.rsplit("go on:", 1)[1].strip())
    assert resumed.returncode == 0, resumed.stderr
    assert "6 of 6 positions measured" in resumed.stdout
    solved = paste(resumed.stdout.rsplit("next:", 1)[1].strip())
    assert solved.returncode == 0, solved.stderr


@pytest.mark.parametrize(("option", "value", "code"), [("--rotations", "x", 2), ("--preset", "nonexistent.toml", 5)])
def test_options_are_checked_before_the_port_is_opened(program: Program, option: str, value: str, code: int) -> None:
    refused = program.run("capture", "--port", "nowhere", "--driver", "stim300", option, value)
    assert (refused.returncode, refused.stdout) == (code, "")
    assert value in refused.stderr


def test_resume_refuses_another_instrument(program: Program) -> None:
    port = program.emulate("--positions", "none")
    process = program.start(*program.capture(port, "--json"))
    assert process.stdout is not None
    process.stdout.readline()
    process.terminate()
    process.communicate()
    session = newest(program)
    session.update(instrument={**session.metadata["instrument"], "serial_number": "N1"})
    refused = program.run("capture", "--resume", variables={"IMUFIELD_CLOCK_SPEED": "16"})
    assert refused.returncode == 4
    assert "serial number N1" in refused.stderr
    assert len(newest(program).parts) == 1


def test_two_captures_into_one_folder(program: Program) -> None:
    ports = [program.emulate("--positions", "none") for _ in range(2)]
    first = program.start(*program.capture(ports[0], "--json", "--session", "here"))
    assert first.stdout is not None
    first.stdout.readline()
    second = program.run(*program.capture(ports[1], "--json", "--session", "here", "--resume"))
    assert second.returncode == 4
    assert f"process {first.pid}" in second.stderr
    assert first.poll() is None


def test_positions_of_the_users_own_are_kept_in_the_session(program: Program, faces: str) -> None:
    mine = program.folder / "mine.toml"
    mine.write_text('name = "two"\n[[position]]\nup = [0, 0, 1]\n[[position]]\nup = [0, 0, -1]\n')
    ended = program.run(*program.capture(faces), "--positions", mine)
    assert ended.returncode == 0, ended.stderr
    assert "2 of 2 positions measured" in ended.stdout
    mine.unlink()
    replayed = program.run("replay")
    assert replayed.returncode == 0, replayed.stderr
    assert "2 of 2 done" in replayed.stdout


def test_defaults_from_file_and_variables(program: Program) -> None:
    port = program.emulate("--positions", "none")
    (program.folder / "imufield.toml").write_text(
        'port = "/dev/nowhere"\ndriver = "stim300"\npositions = "faces6"\nhold_s = 3\nlatitude = 48.1\n'
        "[settings]\naccelerometer_range_g = 30\n"
    )
    variables = {"IMUFIELD_PORT": port, "IMUFIELD_CLOCK_SPEED": "16", "IMUFIELD_LATITUDE_DEG": "50"}
    process = program.start("capture", "--json", "--hold-s", 4, variables=variables)
    assert process.stdout is not None
    process.stdout.readline()
    process.terminate()
    process.communicate()
    metadata = newest(program).metadata
    assert metadata["link"]["port"] == port
    assert (metadata["scheme"], metadata["guide"]) == ("faces6", {"hold_s": 4.0})
    assert metadata["site"] == {"latitude_deg": 50.0}
    assert metadata["settings"]["accelerometer_range_g"] == {"value": 30, "origin": "given"}


@pytest.fixture
def open_terminal(program: Program) -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def open_one(*arguments: str, speed: int = 16) -> Terminal:
        opened.append(Terminal(program, *arguments, variables={"IMUFIELD_CLOCK_SPEED": str(speed)}))
        return opened[-1]

    yield open_one
    for one in opened:
        one.close()


@pytest.fixture
def screen(program: Program, open_terminal: Callable[..., Terminal]) -> Terminal:
    port = program.emulate("--positions", "faces6", "--hold-s", 12, "--wait")
    return open_terminal("capture", "--port", port, "--driver", "stim300", "--positions", "faces6", "--hold-s", "2")


def test_keys_on_a_terminal(program: Program, screen: Terminal) -> None:
    screen.wait_for("Latitude in degrees")
    screen.type("48.1\n")
    screen.wait_for("Height above")
    screen.type("520\n")
    screen.wait_for("1 of 6 done")
    for key, words in (
        ("p", "press p to continue"),
        ("p", "continuing"),
        ("s", "skipped ("),
        ("u", "undone;"),
        ("r", "will be measured again"),
        ("S", "skipped ("),
    ):
        screen.type(key)
        screen.wait_for(words)
    screen.wait_for("accepted -")
    screen.type("f")
    screen.wait_for("f again within 10 s to finish with")
    assert screen.process.poll() is None
    screen.type("f")
    screen.wait_for("finished with")
    assert screen.wait() == 0
    session = newest(program)
    assert session.finished
    assert session.metadata["site"] == {"latitude_deg": 48.1, "height_m": 520.0}
    marks = [event["action"] for event in recorded_events(session) if event["event"] == "mark"]
    assert marks == ["pause", "pause", "skip", "undo", "retake", "skip", "finish"]
    told = program.run("replay", "--json").stdout.splitlines()
    live = [event for event in recorded_events(session) if event["event"] != "mark"]
    assert [json.loads(line) for line in told] == live


def test_what_was_finished_early_goes_on_when_it_is_named(
    program: Program, screen: Terminal, open_terminal: Callable[..., Terminal]
) -> None:
    screen.wait_for("Latitude in degrees")
    screen.type("48\n")
    screen.wait_for("Height above")
    screen.type("\n")
    screen.wait_for("1 of 6 done")
    screen.type("ff")
    assert screen.wait() == 0
    assert says(screen.text, "commands.terminal", "guided.too_few", missing=5)
    session = newest(program)
    assert session.finished
    refused = program.run("capture", "--session", session.folder)
    assert refused.returncode == 2
    folder = session.folder
    assert says(refused.stderr, "commands.terminal", "resume.finished_early", folder=folder)
    again = open_terminal("capture", "--resume", "--session", str(session.folder))
    again.wait_for("2 of 6 done")
    again.type("q")
    assert again.wait() == 0
    session = newest(program)
    assert not session.finished
    recorded = recorded_events(session)
    assert [event["action"] for event in recorded if event["event"] == "mark"] == ["finish", "reopen"]
    told = program.run("replay", "--json").stdout.splitlines()
    assert [json.loads(line) for line in told] == [event for event in recorded if event["event"] != "mark"]


def test_a_finished_session_measures_a_position_again(program: Program) -> None:
    port = program.emulate("--positions", "faces6", "--hold-s", 6, "--wait")
    whole = program.run(*program.capture(port, "--json", "--session", "s", "--latitude", 48))
    assert whole.returncode == 0, whole.stderr
    go_on = ("capture", "--resume", "--session", "s", "--port", program.show("+x"), "--clock-speed", SPEED, "--json")
    refused = program.run(*go_on)
    assert refused.returncode == 2
    assert says(refused.stderr, "commands.terminal", "resume.finished", folder="s")
    unknown = program.run(*go_on, "--retake", "z+45")
    assert unknown.returncode == 2
    assert not missing(unknown.stderr, "z+45", "+x")
    # Not named, it is the newest one, finished or not.
    shutil.copytree(program.folder / "s", program.folder / "imufield-sessions" / "20260801T100000Z-STIM300")
    newest_one = program.run("capture", "--resume", "--port", "nowhere", "--retake", "z+45")
    assert newest_one.returncode == 2
    assert not missing(newest_one.stderr, "z+45", "+x", "imufield-sessions/20260801T100000Z-STIM300")
    # Which one that is, is said before its instrument is asked for.
    no_port = program.run("capture", "--resume", "--port", "nowhere", "--retake", "+x", "--latitude", 75)
    # Nor is another place than that it was begun at taken without a word.
    assert not missing(no_port.stderr, "9.82870 m/s^2", "ppm", "--latitude")
    assert says(no_port.stderr, "commands", "capture.goes_on", session="imufield-sessions/20260801T100000Z-STIM300")
    again = program.run(*go_on, "--retake", "+x")
    assert again.returncode == 0, again.stderr
    session = Session.open(program.folder / "s")
    assert session.finished
    recorded = recorded_events(session)
    marks = [(event["action"], event.get("position")) for event in recorded if event["event"] == "mark"]
    assert marks == [("reopen", None), ("retake", "+x")]
    # It was finished, and no link was lost.
    assert [event["resumed"] for event in recorded if event["event"] == "link_lost"] == [True]
    assert [event["position"] for event in recorded if event["event"] == "accepted" and event["replaces"]] == ["+x"]
    told = program.run("replay", "s", "--json").stdout.splitlines()
    assert [json.loads(line) for line in told] == [event for event in recorded if event["event"] != "mark"]


def test_quit_and_go_on(program: Program, open_terminal: Callable[..., Terminal]) -> None:
    port = program.show("+x", "+y", hold_s=12)
    screen = open_terminal("capture", "--port", port, "--driver", "stim300", "--positions", "faces6", "--hold-s", "2")
    screen.wait_for("Latitude in degrees")
    screen.type("\n")
    screen.wait_for("1 of 6 done")
    screen.type("q")
    shown = screen.wait_for("imufield capture --resume")
    assert re.search("[12] of 6 positions measured so far", shown)
    assert screen.wait() == 0
    session = newest(program)
    assert not session.finished
    unknown = program.run("capture", "--resume", "--port", "nowhere", "--retake", "q+4")
    assert unknown.returncode == 2
    assert not missing(unknown.stderr, "q+4", "+x", "-z", session.folder.name)
    again = open_terminal("capture", "--session", str(session.folder))
    again.wait_for("Go on with the unfinished session")
    again.type("y\n")
    again.wait_for("Latitude in degrees")
    again.type("51\n")
    again.wait_for("Height above")
    again.type("-\n")
    again.wait_for("2 of 6 done")
    again.type("\x03")
    assert again.wait() == 130
    assert newest(program).metadata["site"] == {"latitude_deg": 51.0}


def test_a_terminal_that_is_closed(program: Program, screen: Terminal) -> None:
    screen.wait_for("Latitude in degrees")
    screen.type("48\n")
    screen.wait_for("Height above")
    screen.type("\n")
    screen.wait_for("1 of 6 done")
    screen.close()
    assert screen.process.wait(120) == 130
    session = newest(program)
    assert not session.finished
    assert "accepted" in {event["event"] for event in recorded_events(session)}
    assert program.run("replay").returncode == 0


def test_a_terminal_that_stands_still_loses_nothing_of_the_wire(
    program: Program, open_terminal: Callable[..., Terminal]
) -> None:
    port = program.emulate("--positions", "none", "--wait", rate_hz=2000, speed=1)
    screen = open_terminal("capture", "--port", port, "--driver", "stim300", "--latitude", "48", speed=1)
    screen.wait_for("link ok")
    time.sleep(5)  # a terminal takes a few kilobytes; this is 400 kB of wire
    screen.type("q")
    screen.wait_for("imufield capture --resume")
    assert screen.wait() == 0
    counter = np.concatenate([block.counter for block in session_samples(newest(program), [])])
    assert len(counter) > 5 * 2000
    assert set(np.diff(counter) % 256) == {1}


def test_a_latitude_that_is_none(program: Program, screen: Terminal) -> None:
    screen.wait_for("Latitude in degrees")
    screen.type("here\n")
    screen.wait_for("is not a number")
    # It is asked again.
    screen.type("\x03")
    assert screen.wait() == 130
    assert not (program.folder / "imufield-sessions").exists()


def test_an_interrupt_at_the_question_recorded_nothing(program: Program, screen: Terminal) -> None:
    screen.wait_for("Latitude in degrees")
    screen.type("\x03")
    assert screen.wait() == 130
    assert "interrupted; nothing was recorded." in screen.text
    assert "Aborted" not in screen.text
    assert "on disk" not in screen.text
    assert not (program.folder / "imufield-sessions").exists()
