"""The command line itself: help with examples, versions, defects, and nothing heavy before it is needed."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.main import get_command

from imufield import __version__
from imufield.cli.app import make_app
from imufield.cli.root_help import OF_TYPER
from imufield.cli.run import run
from imufield.commands.terminal.output import NoAnswer
from imufield.errors import EXIT_INTERRUPTED, ImufieldError
from imufield.sentences import Sentences

COMMANDS = sorted(get_command(make_app()).commands)  # type: ignore[attr-defined]  # the app is a group


def imufield(*arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "imufield", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=900, **options)  # type: ignore[call-overload]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"Example: imufield {command}" in " ".join(shown.split())
    assert max(map(len, shown.splitlines())) <= 80
    # Neither cut names nor limits that take the room of the words.
    assert "…" not in shown
    assert "<=x" not in shown
    # A type stands beside what has a value.
    assert "<bool>" not in shown
    assert run([command, "-h"]) == 0
    assert capsys.readouterr().out == shown


class Dropping:
    """Python drops what is raised when it is deleted."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


class Wrapping:
    """Python 3.11 makes a RuntimeError of what is raised when a class is made with it."""

    def __set_name__(self, owner: type, name: str) -> None:
        signal.raise_signal(signal.SIGTERM)


def drop(_: list[str]) -> int:
    for _number in range(2):
        Dropping()
    time.sleep(60)
    return 0


def wrap(_: list[str]) -> int:
    type("Owner", (), {"field": Wrapping()})
    return 0


@pytest.mark.parametrize("command", [drop, wrap])
def test_a_signal_ends_the_program_wherever_it_comes(
    command: Callable[[list[str]], int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    handlers = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGALRM)]
    monkeypatch.setattr("imufield.cli.run.run_line", command)
    assert run(["sessions"]) == EXIT_INTERRUPTED
    assert capsys.readouterr().err == "imufield: interrupted.\n"
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGALRM)] == handlers


@pytest.mark.parametrize(
    ("command", "setting"), [("export", "instance="), ("solve", "m="), ("capture", "accelerometer_range_g=")]
)
def test_help_of_set_names_a_setting_of_the_command(command: str, setting: str) -> None:
    options = get_command(make_app()).commands[command].params  # type: ignore[attr-defined]  # the app is a group
    (told,) = [option.help for option in options if "--set" in option.opts]
    assert f"e.g. {setting}" in told


@pytest.mark.parametrize(
    ("line", "text", "key"),
    [
        ("plan --latitude 48,1", "48,1", "shared.no_number"),
        ("replay x --speed 48,1", "48,1", "shared.no_number"),
        ("solve x --gravity 48,1+-0.1", "48,1", "shared.no_number"),
        ("solve x --seed 1.5", "1.5", "shared.no_whole_number"),
        ("capture --baud 9600x", "9600x", "shared.no_whole_number"),
    ],
)
def test_a_number_that_is_none_is_quoted(line: str, text: str, key: str) -> None:
    ended = imufield(*line.split())
    told = re.sub(r"[│\s]+", " ", ended.stderr)
    assert (ended.returncode, Sentences("imufield.commands.options")(key, text=text) in told) == (2, True)


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(command in shown for command in COMMANDS)
    assert "<bool>" not in shown
    assert run(["-h"]) == 0
    assert capsys.readouterr().out == shown


@pytest.mark.parametrize("columns", [60, 80, 132])
def test_help_without_typer_is_that_of_typer(columns: int) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in OF_TYPER} | {"COLUMNS": str(columns)}
    ours = imufield("--help", env=environment)
    of_typer = imufield("--help", env=environment | {"_TYPER_FORCE_DISABLE_TERMINAL": "1"})
    assert ours.stdout == of_typer.stdout
    assert (ours.returncode, of_typer.returncode) == (0, 0)


@pytest.mark.parametrize(
    ("command", "unused"),
    [
        ("--version", {"typer", "rich", "imufield.errors"}),
        ("--help", {"typer", "imufield.commands", "numpy"}),
        ("devices --json", {"numpy", "pydantic", "rich.table", "imufield.commands.options.result_commands"}),
    ],
)
def test_a_start_loads_what_it_uses(command: str, unused: set[str]) -> None:
    code = f"""
import sys
sys.argv[1:] = {command.split()}
from imufield.cli import main
try:
    main()
finally:
    print(sorted({unused} & set(sys.modules)), file=sys.stderr)
"""
    environment = {name: value for name, value in os.environ.items() if name not in OF_TYPER}
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert ended.stderr == "[]\n"


@pytest.mark.parametrize(("option", "value"), [("--seed", "-1"), ("--seed", str(2**63)), ("--workers", "0")])
def test_values_out_of_range_are_refused(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["study", "bsas-table1", option, value]) == 2
    assert option in capsys.readouterr().err


@pytest.mark.parametrize("comes", ["before", "later"])
def test_what_others_want_at_the_end_is_done(comes: str) -> None:
    code = f"""
import atexit, sys
from imufield.cli import program, run

def register():
    atexit.register(print, "done")

def registering(arguments, run=run.run):
    register()
    return run(arguments)

if {comes == "later"}:
    run.run = registering
else:
    register()
sys.argv[1:] = ["devices", "--nonsense"]
program()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=900)
    assert (ended.returncode, ended.stdout) == (2, "done\n"), ended.stderr


@pytest.mark.parametrize(("entry", "written"), [("main", "freed"), ("program", "")])
def test_the_program_leaves_without_freeing_what_there_is(tmp_path: Path, entry: str, written: str) -> None:
    code = f"""
import sys
from imufield.cli import {entry}

never_closed = open("written", "w")
never_closed.write("freed")
sys.argv[1:] = ["devices", "--nonsense"]
{entry}()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=900, cwd=tmp_path)
    assert (ended.returncode, (tmp_path / "written").read_text()) == (2, written)


@pytest.mark.parametrize(
    "call",
    [
        "imufield.cli.main()",
        "runpy.run_module('imufield', run_name='__main__')",
        "runpy.run_module('imufield', run_name='__main__', alter_sys=True)",
    ],
)
def test_a_script_that_goes_on_ends_as_it_says(tmp_path: Path, call: str) -> None:
    code = f"""
import contextlib, runpy, sys
import imufield.cli

sys.argv[1:] = ["devices", "--nonsense"]
with contextlib.suppress(SystemExit):
    {call}
never_closed = open("written", "w")
never_closed.write("all of it")
sys.exit(5)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=900, cwd=tmp_path)
    assert (ended.returncode, (tmp_path / "written").read_text()) == (5, "all of it")


def test_version() -> None:
    ended = imufield("--version")
    assert (ended.returncode, ended.stdout) == (0, f"imufield {__version__}\n")


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    code = """
import sys
from imufield.cli.run import run
for command in sys.argv[1:]:
    run([command, "--help"])
print(sorted({"numpy", "scipy", "serial", "can", "cantools", "mcap", "matplotlib", "rich.live"} & set(sys.modules)))
"""
    command = [sys.executable, "-c", code, *COMMANDS]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert ended.stdout.splitlines()[-1] == "[]"


def test_a_defect_keeps_its_traceback_and_is_code_1(tmp_path: Path) -> None:
    code = """
from imufield import cli
import imufield.commands.devices as devices

def defect(options):
    raise RuntimeError("a defect of ours")

devices.list_devices = defect
cli.sys.argv = ["imufield", "devices"]
cli.main()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert ended.returncode == 1
    assert "Traceback" in ended.stderr
    assert "defect" in ended.stderr


@pytest.mark.parametrize("error", ImufieldError.__subclasses__(), ids=lambda error: error.__name__)
def test_every_error_has_its_exit_code(
    error: type[ImufieldError], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*arguments: object, **options: object) -> None:
        raise error("this is wrong: do that instead")

    monkeypatch.setattr("imufield.commands.devices.list_devices", fail)
    assert run(["devices"]) == error.exit_code
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == "imufield: this is wrong: do that instead.\n"


def test_interrupted_at_a_prompt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(*arguments: object, **options: object) -> None:
        raise NoAnswer

    monkeypatch.setattr("imufield.commands.devices.list_devices", interrupt)
    assert run(["devices"]) == EXIT_INTERRUPTED
    assert capsys.readouterr().err == "Aborted.\nimufield: interrupted.\n"


def test_a_reader_that_goes_away(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        ended = subprocess.run(
            [sys.executable, "-m", "imufield", "devices"],
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=tmp_path,
        )
    finally:
        os.close(write)
    assert ended.returncode == EXIT_INTERRUPTED
    assert ended.stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, which Linux has")
def test_standard_output_on_a_full_disk(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "imufield", "devices", "--json"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=tmp_path,
        )
    assert ended.returncode == 4
    assert ended.stderr.startswith("imufield: ")
    assert "No space left on device" in ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, which Linux has")
@pytest.mark.parametrize(
    ("command", "code"),
    [("export nowhere --to c", 5), ("bogus", 2), ("export nowhere --to", 2), ("devices --json", 0), ("--version", 0)],
)
@pytest.mark.parametrize("number", [1, 2, 3], ids=["output", "error", "both"])
def test_a_stream_that_takes_nothing_changes_no_code(command: str, code: int, number: int, tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "imufield", *command.split()],
            stdout=full if number & 1 else subprocess.DEVNULL,
            stderr=full if number & 2 else subprocess.DEVNULL,
            check=False,
            cwd=tmp_path,
        )
    # What happened, whoever could be told of it; 4 where the output itself was what was asked for.
    assert ended.returncode == (4 if number & 1 and not code else code)


@pytest.mark.parametrize(
    "command",
    [("export", "{}", "--to", "c"), ("solve", "--observations", "{}"), ("report", "{}"), ("import", "a", "--dbc", "{}")],
)
def test_names_longer_than_a_file_can_have(command: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run([one.format("x" * 300) for one in command]) in (2, 4, 5)
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert said.strip()


@pytest.mark.skipif(os.name != "posix", reason="needs groups of processes")
@pytest.mark.parametrize("is_leader", [True, False])
def test_what_is_watched_ends_its_own_group_and_no_other(tmp_path: Path, *, is_leader: bool) -> None:
    # A program with a group of its own, which is not to hear how the one that it has started ends.
    code = f"""
import subprocess, sys
command = [sys.executable, "-m", "imufield.cli.watched", "emulate", "stim300", "--json", "--wait", "--link", "port"]
held = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session={is_leader})
held.stdout.readline()
held.stdin.close()
print(held.wait())
"""
    script = [sys.executable, "-c", code]
    ended = subprocess.run(
        script, capture_output=True, text=True, check=False, cwd=tmp_path, start_new_session=True, timeout=900
    )
    assert (ended.returncode, ended.stdout) == (0, f"{EXIT_INTERRUPTED}\n")
    assert not (tmp_path / "port").is_symlink()


@pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None) if os.name == "posix" else None, "mallopt"), reason="needs the memory of glibc"
)
def test_memory_that_arrays_leave_serves_the_next_ones() -> None:
    """Handed back each time, the system clears it page by page for the next: a tenth of a ``replay``."""
    counting = """
import resource, sys
import numpy as np

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        [np.ones(1 << 18) for _ in range(8)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
"""
    beside = f"{counting}\nfaults(); print(faults())"
    script = f"""{counting}
import contextlib, subprocess
from imufield.cli import main

sys.argv[1:] = ["devices", "--json"]
with contextlib.suppress(SystemExit):
    main()
faults()
print()
print(faults(), flush=True)
subprocess.run([sys.executable, "-c", {beside!r}], check=True)
"""
    # What is set stays, and a Dask worker that was started here leaves a threshold behind.
    unset = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=900, env=unset)
    own, of_child = map(int, done.stdout.split()[-2:])
    # Of 40,960 pages that are written.
    assert max(own, of_child) < 4096
