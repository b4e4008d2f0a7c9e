"""``imufield init``: questions at a terminal, options without one, and what a capture makes of the file."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.commands.options.configuration import default_map
from imufield.errors import Reason
from imufield.files import DEFAULT_ROOT
from tests.commands.conftest import Program
from tests.commands.pty_terminal import Terminal
from tests.commands.told import fails, missing

QUESTIONS = ("Latitude in degrees", "Height above", "Instrument", "Port", "Target for biases", "Target for scale")


@pytest.fixture
def terminal(program: Program) -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def open_one(*arguments: str) -> Terminal:
        opened.append(Terminal(program, *arguments))
        return opened[-1]

    yield open_one
    for one in opened:
        one.close()


def written(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "imufield.toml").read_text(encoding="utf-8"))


def answer(screen: Terminal, *answers: str) -> None:
    for question, typed in zip(QUESTIONS, answers, strict=True):
        screen.wait_for(question)
        screen.type(f"{typed}\n")


def earlier_session(folder: Path, **site: float) -> None:
    """Put a session where captures go."""
    Session.create(folder / DEFAULT_ROOT, "stim300", {"kind": "capture", "site": site})


def test_all_questions(program: Program, terminal: Callable[..., Terminal]) -> None:
    screen = terminal("init")
    answer(screen, "48.1", "520", "stim300", "/dev/ttyUSB7", "100", "50")
    screen.wait_for("written to imufield.toml")
    assert screen.wait() == 0
    place = {"latitude": 48.1, "height": 520.0}
    targets = {"target_bias_ug": 100.0, "target_scale_ppm": 50.0}
    assert written(program.folder) == {"port": "/dev/ttyUSB7", "driver": "stim300", **place, **targets}


def test_an_answer_that_makes_no_sense_is_asked_again(program: Program, terminal: Callable[..., Terminal]) -> None:
    screen = terminal("init", "--port", "/dev/ttyUSB7", "--target-scale-ppm", "50")
    for question, typed in (
        ("Latitude", "north"),
        ("Latitude", "100"),
        ("Latitude", "-33.9"),
        ("Height", "1e9"),
        ("Height", "nan"),
        ("Height", ""),
        ("Instrument", "stim30"),
        ("Instrument, e.g.", "stim300"),
        ("Target for biases", "-5"),
        ("Target for biases", ""),
    ):
        screen.wait_for(question)
        screen.type(f"{typed}\n")
    assert screen.wait() == 0
    assert written(program.folder) == {
        "port": "/dev/ttyUSB7",
        "driver": "stim300",
        "latitude": -33.9,
        "target_scale_ppm": 50.0,
    }


def test_an_instrument_on_a_bus_is_asked_for_no_port(program: Program, terminal: Callable[..., Terminal]) -> None:
    place, target = ("--latitude", "48", "--height", "9"), ("--target-bias-ug", "10", "--target-scale-ppm", "10")
    screen = terminal("init", *place, "--driver", "mv5_can", *target)
    assert screen.wait() == 0
    assert "Port" not in screen.text
    assert "port" not in written(program.folder)


def test_what_is_there_is_kept_where_it_is_replaced(program: Program, terminal: Callable[..., Terminal]) -> None:
    path = program.folder / "imufield.toml"
    path.write_text('driver = "text"\n')
    screen = terminal("init")
    screen.wait_for("Replace it")
    screen.type("n\n")
    assert screen.wait() == 2
    assert path.read_text() == 'driver = "text"\n'
    screen = terminal("init")
    screen.wait_for("Replace it")
    screen.type("y\n")
    answer(screen, "48.1", "", "", "-", "", "")
    screen.wait_for("imufield-1.toml")
    assert screen.wait() == 0
    assert written(program.folder) == {"latitude": 48.1}
    assert (program.folder / "imufield-1.toml").read_text() == 'driver = "text"\n'


@pytest.mark.parametrize(
    ("recorded", "options", "written_site"),
    [
        ({"latitude_deg": 45.0}, (), {"latitude": 45.0, "height": 300.0}),
        ({"latitude_deg": 45.0, "height_m": 100.0}, ("--height", "520"), {"latitude": 45.0, "height": 520.0}),
        # An older session kept the digits of a textbook's value, which measure nothing.
        ({"gravity_m_s2": 9.81, "gravity_sigma_m_s2": 0.01 / 12**0.5}, (), {"gravity": "9.81"}),
    ],
)
def test_what_is_missing_of_the_last_site_is_asked(
    recorded: dict[str, float],
    options: tuple[str, ...],
    written_site: dict[str, object],
    program: Program,
    terminal: Callable[..., Terminal],
) -> None:
    earlier_session(program.folder, **recorded)
    screen = terminal("init", "--driver", "mv5_can", "--target-bias-ug", "10", "--target-scale-ppm", "10", *options)
    screen.wait_for("Latitude in degrees")
    screen.type("\n")
    if recorded == {"latitude_deg": 45.0}:
        screen.wait_for("Height above")
        screen.type("300\n")
    assert screen.wait() == 0
    site = {name: value for name, value in written(program.folder).items() if name in ("gravity", "latitude", "height")}
    assert site == written_site


def test_of_a_latitude_alone_the_height_is_asked(program: Program, terminal: Callable[..., Terminal]) -> None:
    screen = terminal("init", "--latitude", "48", "--driver", "mv5_can", "--target-bias-ug", "10", "--target-scale-ppm", "10")
    screen.wait_for("Height above")
    screen.type("520\n")
    assert screen.wait() == 0
    assert (written(program.folder)["latitude"], written(program.folder)["height"]) == (48.0, 520.0)


@pytest.mark.parametrize("keys", ["\x03", "\x04"])
def test_broken_off_nothing_is_written(keys: str, program: Program, terminal: Callable[..., Terminal]) -> None:
    screen = terminal("init")
    screen.wait_for("Latitude in degrees")
    screen.type("48.1\n")
    screen.wait_for("Height")
    screen.type(keys)
    assert screen.wait() == 130
    assert not (program.folder / "imufield.toml").exists()


def test_the_last_site_is_offered_again(program: Program, terminal: Callable[..., Terminal]) -> None:
    earlier_session(program.folder, latitude_deg=47.5, height_m=610.0)
    # Newer ones that have no place, or cannot be read; that of the demonstration is nobody's.
    earlier_session(program.folder)
    of_demo = {"site": {"latitude_deg": 45.0}, "link": {"port": "instrument", "is_virtual": True}}
    Session.create(program.folder / DEFAULT_ROOT, "stim300", of_demo)
    broken = Session.create(program.folder / DEFAULT_ROOT, "stim300", {})
    (broken.folder / "session.toml").write_text("format = ")
    screen = terminal("init")
    assert not missing(screen.wait_for("unknown)"), "latitude 47.5", "height 610 m")
    screen.type("\n")
    for question in QUESTIONS[2:]:
        screen.wait_for(question)
        screen.type("\n" if question != "Port" else "-\n")
    assert screen.wait() == 0
    assert written(program.folder) == {"latitude": 47.5, "height": 610.0}


def test_a_capture_offers_it_too(program: Program, terminal: Callable[..., Terminal]) -> None:
    earlier_session(program.folder, gravity_m_s2=9.80813, gravity_sigma_m_s2=1e-4)
    port = program.emulate("--positions", "faces6", "--wait")
    line = program.capture(port)
    screen = terminal(*line, "--session", "mine")
    assert not missing(screen.wait_for("unknown)"), "gravity 9.80813 m/s^2")
    screen.type("\n")
    screen.wait_for("0 of 6 done")
    screen.type("q")
    assert screen.wait() == 0
    site = Session.open(program.folder / "mine").metadata["site"]
    assert site == {"gravity_m_s2": 9.80813, "gravity_sigma_m_s2": 1e-4}


def test_without_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    fails("init", 2, Reason.USAGE, "--latitude", "--driver", key="init.no_terminal")
    fails("init --driver stim30", 2, Reason.UNKNOWN_DRIVER, "stim300", key="registry.unknown")
    assert not (tmp_path / "imufield.toml").exists()
    assert run(["init", "--gravity", "9.8081+-0.0002", "--driver", "text", "--target-bias-ug", "80"]) == 0
    assert written(tmp_path) == {"gravity": "9.8081+-0.0002", "driver": "text", "target_bias_ug": 80.0}
    assert default_map()["capture"]["target_bias_ug"] == 80.0
    assert default_map()["solve"] == {"gravity": "9.8081+-0.0002"}
    fails("init --latitude 48", 2, Reason.USAGE, "imufield.toml", key="init.exists")
    assert written(tmp_path)["driver"] == "text"


def test_what_a_shell_or_another_file_says_is_no_part_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "home" / "imufield"
    config.mkdir(parents=True)
    (config / "imufield.toml").write_text(tomli_w.dumps({"driver": "stim300", "latitude": 10.0}))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(config.parent))
    assert run(["init", "--port", "/dev/ttyUSB7"]) == 0
    assert written(tmp_path) == {"port": "/dev/ttyUSB7"}
