"""What reaches a terminal: no control character that imufield did not write, whatever wires and files of others hold."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import tomli_w

from imufield.acquire.recording.session import Session
from imufield.deliver.parameters.write import to_toml
from imufield.sentences import printable
from imufield.simulate.emulator.core import EmulatorSettings
from imufield.simulate.emulator.emulate import Emulation, make_emulator
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.protocol_device import ProtocolDevice
from imufield.simulate.instruments.vectornav import VectorNavInstrument
from tests.commands.conftest import SPEED
from tests.commands.pty_terminal import Terminal

if TYPE_CHECKING:
    from tests.commands.conftest import Program

OF_WIRE = "VN-100\x1b]0;pwn\x07\x1b[2J\x7f"
HOSTILE = OF_WIRE + "\x9b31m\x85\u202e\u2066\u2028\r\nforged: Zürich\x1b[5;5H"
FILE_NAME = HOSTILE.replace("/", "")[:60]
# What the views and rich send: colours, the cursor shown or hidden, the other screen, its corner, a line cleared.
_OURS = re.compile(r"\x1b\[(?:[0-9;]*m|\?25[hl]|\?1049[hl]|H|2?K|1?A)|\r|\n")
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")

Show = Callable[..., str]


@pytest.fixture
def show(program: Program) -> Show:
    """Return a function that runs a command on a terminal, and returns what was shown once it was found to be clean."""

    def run(*arguments: object, keys: str = "", after: str = "", code: int = 0) -> str:
        terminal = Terminal(program, *arguments)
        try:
            if after:
                terminal.expect(after)
            terminal.type(keys)
            assert terminal.wait() == code, terminal.raw
        finally:
            terminal.close()
        assert not _CONTROL.findall(_OURS.sub("", terminal.raw)), repr(terminal.raw)
        assert not re.search(r"^ *forged", terminal.text, re.MULTILINE), repr(terminal.raw)
        return terminal.text

    return run


@pytest.fixture
def port() -> Iterator[str]:
    """Yield the port of an instrument that says hostile things of itself."""
    emulator = make_emulator(Emulation(device="vectornav_ascii", rate_hz=100, run=EmulatorSettings(speed=SPEED)))
    assert isinstance(emulator, Emulator)
    assert isinstance(emulator.device, ProtocolDevice)
    script = emulator.device.script
    assert isinstance(script, VectorNavInstrument)
    script.registers |= {1: OF_WIRE, 3: "0100\x1b[31m", 4: "2.1\x1b(0"}
    with emulator as there:
        yield str(there.port)


def edit(path: Path, **tables: object) -> None:
    path.write_text(tomli_w.dumps({**tomllib.loads(path.read_text()), **tables}))


INSTRUMENT = {"driver": "stim300", "model": HOSTILE, "serial_number": HOSTILE, "firmware": HOSTILE}


@pytest.fixture
def hostile_session(program: Program, short_session: Path) -> Path:
    """Return a session whose folder and whose instrument have hostile names."""
    folder = program.folder / FILE_NAME
    shutil.copytree(short_session, folder)
    edit(folder / "session.toml", instrument=INSTRUMENT, model=HOSTILE)
    return folder


@pytest.fixture
def hostile_parameters(program: Program, solved_session: Path) -> Path:
    """Return a parameter file as a program wrote it that lets every text through."""
    document = tomllib.loads((solved_session / "parameters.toml").read_text())
    document["instrument"] |= INSTRUMENT
    document["session"]["name"] = HOSTILE
    document["position"][0]["name"] = HOSTILE
    del document["integrity"]
    folder = program.folder / "files"
    folder.mkdir()
    path = folder / f"{FILE_NAME}.toml"
    path.write_text(to_toml(document))
    return path


def test_an_instrument_that_is_probed(show: Show, port: str) -> None:
    assert printable(OF_WIRE) in "".join(show("probe", "--port", port, "--ask", "--clock-speed", SPEED).split())


def test_json_is_valid_and_has_no_control_characters(program: Program, port: str) -> None:
    result = program.run("probe", "--port", port, "--ask", "--json", "--clock-speed", SPEED)
    assert json.loads(result.stdout)["ports"][0]["identity"]["model"] == printable(OF_WIRE)


def test_an_instrument_that_is_recorded(show: Show, port: str, program: Program) -> None:
    show(
        "record",
        "--port",
        port,
        "--driver",
        "vectornav_ascii",
        "--duration-s",
        2,
        "--clock-speed",
        SPEED,
        "--session",
        "recorded",
    )
    content = tomllib.loads((program.folder / "recorded" / "session.toml").read_text())
    emulated = f"{printable(OF_WIRE)} (emulated)"
    assert (content["model"], content["instrument"]["model"]) == (printable(OF_WIRE), emulated)
    assert content["instrument"]["serial_number"] == printable("0100\x1b[31m")


@pytest.mark.parametrize(
    ("view", "key", "code"),
    [((), "q", 0), (("--plain",), "\x03", 130), (("--json",), "\x03", 130)],
)
def test_an_instrument_that_is_captured(view: tuple[str, ...], key: str, code: int, show: Show, port: str) -> None:
    options = ("--port", port, "--driver", "vectornav_ascii", "--latitude", 48, "--quiet", "--hold-s", 2, *view)
    show("capture", *options, "--clock-speed", SPEED, keys=key, after="accepted", code=code)


def test_a_session_of_hostile_names(show: Show, hostile_session: Path) -> None:
    show("solve", FILE_NAME, "--latitude", 48)
    stored = (hostile_session / "parameters.toml").read_text()
    assert not _CONTROL.findall(stored.replace("\n", ""))
    show("report", FILE_NAME)
    show("certificate", FILE_NAME)
    for page in hostile_session.glob("*.html"):
        assert not _CONTROL.findall(page.read_text().replace("\n", ""))
    show("history", FILE_NAME)
    show("verify", f"{FILE_NAME}/parameters.toml", FILE_NAME)
    show("export-data", FILE_NAME, "--output", f"{FILE_NAME}.csv")
    show("replay", FILE_NAME)
    show("solve", f"{FILE_NAME}1", f"{FILE_NAME}2", code=4)
    assert Session.open(hostile_session).record.instrument.serial_number == printable(HOSTILE)


def test_parameters_of_hostile_names(show: Show, hostile_parameters: Path) -> None:
    name = f"files/{hostile_parameters.name}"
    show("history", "files")
    show("history", "files", "--at", "2001-01-01")
    show("export", name, "--to", "c", "--output", "files/x.h")
    show("export", name, "--to", "c", "--output", f"{name}.h")
    hostile_parameters.write_text(hostile_parameters.read_text().replace("version =", '"\\u001b[2J" = 1\nversion =', 1))
    show("export", name, "--to", "c", "--output", "files/y.h", code=5)


ROWS = "".join(f"{k / 100},0.1,0.2,9.8,0.01,0.02,0.03,{k % 7}\n" for k in range(2000))


def test_tables_of_hostile_names(show: Show, program: Program) -> None:
    path = program.folder / f"{FILE_NAME}.csv"
    path.write_text(f"time,ax,ay,az,gx,gy,gz,evil\x1b[2J\x9b\u202e\n{ROWS}")
    show("import", path.name, "--output", "imported")
    content = tomllib.loads((program.folder / "imported" / "session.toml").read_text())
    assert not [text for text in (*content["notes"], content["model"]) if _CONTROL.search(text)]
    path.write_text(f"{HOSTILE}\n{HOSTILE}\n{HOSTILE}\n{ROWS}")
    show("import", path.name, "--output", "refused", code=4)


HOSTILE_FILES = {
    "a list of positions": ("emulate", "--positions", 2, '[[position]]\nname = "\\u001b[2J"\n"\\u001b[2J" = 1\n'),
    "a protocol": ("import", "--protocol", 4, '"\\u001b[2J" = "\\u009b"\n'),
    "no TOML": ("import", "--protocol", 4, "\x1b[2J\x9b\n"),
}


@pytest.mark.parametrize("case", HOSTILE_FILES)
def test_files_of_hostile_keys(case: str, show: Show, program: Program) -> None:
    command, option, code, content = HOSTILE_FILES[case]
    (program.folder / f"{FILE_NAME}.toml").write_text(content)
    show(command, option, f"{FILE_NAME}.toml", "stim300" if command == "emulate" else f"{FILE_NAME}.toml", code=code)


def test_defaults_of_hostile_keys(show: Show, program: Program) -> None:
    (program.folder / "imufield.toml").write_text('"\\u001b[2J" = "\\u009b"\n')
    show("devices", code=2)


@pytest.mark.parametrize(
    "arguments", [(HOSTILE,), ("solve", "--gauge", HOSTILE), ("solve", HOSTILE), ("solve", "--" + HOSTILE)]
)
def test_what_was_typed(arguments: tuple[str, ...], show: Show) -> None:
    code = 4 if arguments == ("solve", HOSTILE) else 2
    show(*arguments, code=code)


def test_ports_and_instruments(show: Show) -> None:
    show("devices")


def test_letters_of_any_language_stay(show: Show, program: Program, solved_session: Path) -> None:
    words = "Zürich 東京 القاهرة Αθήνα"
    shutil.copytree(solved_session, program.folder / words)
    assert words in " ".join(show("history", words, "--at", "2001-01-01").split())
