"""Command lines that are read without typer: they mean what typer makes of them, or are left to it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from imufield.cli.app import make_app
from imufield.cli.command import Command, find_command, parameters
from imufield.cli.plain import read
from imufield.cli.table import NAMES
from imufield.commands.options.shared import TypedNumber

PLAIN = [
    "devices",
    "devices stim300 --json",
    "import acc.txt gyro.txt --zero 32768 -o folder",
    "import -o folder acc.txt --set accelerometer_unit=g --set gyroscope_unit=rad/s --rate-hz 100 --columns=time,ax",
    "import a.log --dbc my.dbc --map accelerometer.x=AccLong --gravity 9.810 --replace",
    "solve",
    "solve one two --together",
    "solve real --gravity 9.81744+-0.0001 --gauge lower --model linear --seed 7 --no-polish",
    "solve real --latitude 48.1 --height 520 --without z+135 --without x+0 --temperature cold",
    "emulate stim300 --wait --speed 8",
    "emulate stim300 --no-wait --day 3 --fault bit_flip_probability=1e-4",
    "capture --port /dev/ttyUSB0 --latitude 48.1 --retake x+0 --big --web --web-port 9000",
    "record --bus socketcan:can0 --driver aceinna_can --duration-s 1.5e3",
    "replay folder --baud 500000 --speed 0",
    "verify parameters.toml folder --require residual-ug=50 --align-s 60",
    "export-data folder --to csv -o samples.csv",
    "apply parameters.toml table.csv -o out.csv",
    "history folder --serial N255 --stale-days 30.5",
    "plan --target-bias-ug 150 --grade tactical",
    "study bsas-table1 --quick --workers 2",
    "sessions",
    "noise folder --to kalibr",
    "report folder",
    "certificate folder --laboratory Lab --due-months 12",
    "export parameters.toml --to c -o calibration.h",
    "demo --temperature",
    "init --driver stim300",
    "probe --port COM3",
    "web folder",
]
LEFT = [
    "devices --help",
    "devices -h",
    "devices --jso",
    "devices --json=yes",
    "devices -",
    "devices one two",
    "devices --",
    "import",
    "import a.txt -ofolder",
    "import a.txt -o=folder",
    "import a.txt -o",
    "import a.txt --rate-hz abc",
    "import a.txt --rate-hz 0",
    "import a.txt --rate-hz nan",
    "import a.txt --zero -5",
    "import a.txt --zero 1 --zero 2",
    "solve --seed 1.0",
    "solve --seed 1_000",
    "solve --gravity nine",
    "solve --model=",
    "capture --cable up",
]


@pytest.fixture(autouse=True)
def no_defaults(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)


def by_typer(line: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Mapping[str, object], frozenset[str]]:
    found: list[Any] = []

    def note(command: Command, values: Mapping[str, object], typed: frozenset[str]) -> int:
        assert command.name == line.split(maxsplit=1)[0]
        found.append((values, typed))
        return 0

    monkeypatch.setattr(Command, "run", note)
    with pytest.raises(SystemExit) as left:
        make_app(line.split()[:1])(line.split(), prog_name="imufield")
    assert left.value.code == 0
    (values_and_typed,) = found
    return values_and_typed


@pytest.mark.parametrize("line", PLAIN)
def test_a_line_means_what_it_means_to_typer(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, *words = line.split()
    plain = read(find_command(name), words, ())
    assert plain == by_typer(line, monkeypatch)
    assert plain is not None
    for value, of_typer in zip(plain[0].values(), by_typer(line, monkeypatch)[0].values(), strict=True):
        assert type(value) is type(of_typer)
        if isinstance(value, TypedNumber):
            assert isinstance(of_typer, TypedNumber)
            assert (value.text, value.sigma_text) == (of_typer.text, of_typer.sigma_text)


def test_each_command_has_a_line_here() -> None:
    assert {line.split()[0] for line in PLAIN} == NAMES


@pytest.mark.parametrize("line", LEFT)
def test_what_is_unclear_is_left_to_typer(line: str) -> None:
    name, *words = line.split()
    assert read(find_command(name), words, ()) is None


def test_defaults_of_others_are_left_to_typer(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = find_command("solve")
    assert read(solve, [], ()) is not None
    assert read(solve, [], {"hold_s"}) is not None
    assert read(solve, [], {"latitude"}) is None
    monkeypatch.setenv("IMUFIELD_LATITUDE_DEG", "48.1")
    assert read(solve, [], ()) is None
    assert read(find_command("devices"), [], ()) is not None
    monkeypatch.setenv("IMUFIELD_LATITUDE_DEG", "")
    assert read(solve, [], ()) is not None


@pytest.mark.parametrize("name", sorted(NAMES))
def test_each_option_is_known_by_the_names_that_typer_has(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every option of every command, alone, with a value that fits it."""
    command = find_command(name)
    needed = {
        "import": "a.txt",
        "emulate": "stim300",
        "verify": "p.toml",
        "apply": "p.toml t.csv -o out",
        "study": "bsas-table1",
    }
    for parameter in parameters(command.options):
        if parameter.option.is_argument or "--output" in parameter.option.names:
            continue
        names = parameter.option.names or (f"--{parameter.name.replace('_', '-')}",)
        switch = names[0].partition("/")[0]
        for value in (f"{switch}", f"{switch}=5", f"{switch}=9600", f"{switch}=a=5", f"{switch}=+x"):
            line = f"{name} {needed.get(name, '')} {value}".replace("  ", " ")
            plain = read(command, line.split()[1:], ())
            if plain is not None:
                assert plain == by_typer(line, monkeypatch)
                break
        else:
            pytest.fail(f"no value fits {switch}")
