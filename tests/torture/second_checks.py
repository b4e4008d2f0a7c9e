"""What holds of a command whatever it reads: run it on a hostile file or link, and say what did not hold."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import signal
import stat
import subprocess
import time
from pathlib import Path

from tests.commands.conftest import Program
from tests.commands.pty_terminal import Terminal
from tests.torture.hostile_values import FORGED, SECRET, SECRET_AS_TEXT, plant_outside
from tests.torture.second_links import HostileLink, Peer
from tests.torture.second_sound import HostileFile

LONGEST_S = 10
"""Of processor time, for each process that a command starts."""
IDLE_S = 20.0
"""A command that takes no processor time for so long waits for something that does not come."""
WAIT_S = 0.5
MOST_BYTES = 500 << 20
CODES = (0, 2, 3, 4, 5, 6, 7)
INTERRUPTED = 130
# What rich and the live views write: colours, the cursor shown and hidden, moved and lines cleared; and what a printable
# line needs. None of them is among what an attacker puts in.
_OWN_CONTROL = re.compile(r"\x1b\[(?!5m|8m)[0-9;]*m|\x1b\[\?25[lh]|\x1b\[\d*[ABCDGK]|\x1b\[\d*;?\d*H(?!\x1b)|\x1b\[0?J|\r\n|\n")
# The marks that Arabic and Hebrew need, U+061C, U+200E and U+200F, move no letter of others, and stay.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
_READ_ON_PURPOSE = ("hard link", "imufield.toml: a link")

Entry = tuple[object, ...]


def listing(folder: Path, *, but: str) -> dict[str, Entry]:
    """Return everything in a folder, ``but`` one folder: kind, size, times, content."""
    found: dict[str, Entry] = {}
    for path in sorted(below for top in folder.iterdir() if top.name != but for below in (top, *top.rglob("*"))):
        name = str(path.relative_to(folder))
        about = path.lstat()
        # The time of reading before the content is read here.
        content = hashlib.sha256(path.read_bytes()).hexdigest() if stat.S_ISREG(about.st_mode) else ""
        found[name] = (about.st_mode, about.st_size, about.st_mtime_ns, content, about.st_atime_ns)
        if content:
            os.utime(path, ns=(about.st_atime_ns, about.st_mtime_ns))
    return found


def meet_file(hostile: HostileFile, folder: Path, *, on_terminal: bool) -> list[str]:
    """Return what did not hold when a command met a file."""
    work, before, program = _prepare(folder, hostile.make)
    ran = _run(program, folder, hostile.command, on_terminal=on_terminal)
    return _held(ran, folder, before, reads_on_purpose=any(each in hostile.name for each in _READ_ON_PURPOSE), work=work)


def meet_link(hostile: HostileLink, folder: Path, *, on_terminal: bool) -> list[str]:
    """Return what did not hold when a command met a link, or when its session was read."""
    work, before, program = _prepare(folder, lambda folder: None)
    peer = Peer(hostile)
    peer.start()
    try:
        command = tuple(peer.address if word == "PORT" else word for word in hostile.command)
        ran = _run(program, folder, command, on_terminal=on_terminal, interrupt_after_s=hostile.interrupt_after_s)
    finally:
        peer.close()
    found = _held(ran, folder, before, work=work, interrupted=bool(hostile.interrupt_after_s))
    for command in (("export-data", "s", "-o", "o.csv"), ("solve", "s")):
        if (work / "s" / "session.toml").exists():
            ran = _run(program, folder, command, on_terminal=False)
            found += [f"then {command[0]}: {each}" for each in _held(ran, folder, before, work=work)]
    return found


class _Ran:
    """How a command ended, and what it said."""

    def __init__(self, code: int | None, said: str, *, on_terminal: bool, took_s: float) -> None:
        self.code, self.said, self.on_terminal, self.took_s = code, said, on_terminal, took_s


def _prepare(folder: Path, make):  # type: ignore[no-untyped-def]
    work = folder / "work"
    (work / "home").mkdir(parents=True)
    (work / "tmp").mkdir()
    plant_outside(folder / "outside")
    make(work)
    for path in (folder / "outside").rglob("*"):
        os.utime(path, (1_500_000_000, 1_600_000_000))
    return work, listing(folder, but="work"), Program(work)


def _run(
    program: Program, folder: Path, command: tuple[str, ...], *, on_terminal: bool, interrupt_after_s: float = 0.0
) -> _Ran:
    begin_s = time.monotonic()
    limits = [("limit_and_measure", str(folder / "work" / "home" / "peak"), LONGEST_S)]
    # Lines as they are: a pipe has no width.
    variables = {"TMPDIR": str(folder / "work" / "tmp"), **({} if on_terminal else {"COLUMNS": "5000"})}
    said, code = "", None
    if on_terminal:
        terminal = Terminal(program, *command, variables=variables, at_start=limits)
        process = terminal.process
        patience = _Patience(process, interrupt_after_s)
        while process.poll() is None and not patience.is_over():
            with contextlib.suppress(OSError):
                terminal.read()
        code = _end(process)
        with contextlib.suppress(OSError):
            terminal.read(0)
        said = terminal.raw
        terminal.close()
    else:
        streams = {"stderr": subprocess.STDOUT, "errors": "replace"}
        process = program.start(*command, variables=variables, at_start=limits, start_new_session=True, **streams)
        patience = _Patience(process, interrupt_after_s)
        while code is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                said, _ = process.communicate(timeout=WAIT_S)
                code = process.returncode
            if code is None and patience.is_over():
                _end(process)
                said, _ = process.communicate()
                break
    return _Ran(code, said, on_terminal=on_terminal, took_s=time.monotonic() - begin_s)


class _Patience:
    """How long a command is waited for: on a busy machine as long as it takes, and not where it does nothing."""

    def __init__(self, process: subprocess.Popen[str], interrupt_after_s: float) -> None:
        self._process = process
        self._began_s = self._changed_s = time.monotonic()
        self._used = 0
        self._interrupt_s = self._began_s + interrupt_after_s if interrupt_after_s else float("inf")

    def is_over(self) -> bool:
        """Whether the command has done nothing for too long; a command that has no end of its own is interrupted here."""
        now_s, used = time.monotonic(), _ticks_used(self._process.pid)
        if now_s > self._interrupt_s:
            self._process.send_signal(signal.SIGINT)
            self._interrupt_s = float("inf")
        if used != self._used:
            self._used, self._changed_s = used, now_s
        return now_s > self._changed_s + IDLE_S


def _ticks_used(process: int) -> int:
    """Return the processor time that a process and its children have taken, in ticks."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    except OSError:
        return 0
    return sum(map(int, fields[11:15])) + sum(_ticks_used(int(child)) for child in children)


def _end(process: subprocess.Popen[str]) -> int | None:
    """Return how a process ended; kill it with all it started where it has not."""
    code = process.poll()
    if code is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(60)
    return code


def _held(
    ran: _Ran, folder: Path, before: dict[str, Entry], *, work: Path, reads_on_purpose: bool = False, interrupted: bool = False
) -> list[str]:
    plain = _OWN_CONTROL.sub(lambda each: "\n" if each.group().endswith("\n") else "", ran.said)
    found = [*_ended(ran, plain, (*CODES, INTERRUPTED) if interrupted else CODES), *_shown(ran, plain)]
    found += _left(folder, work, plain)
    peak = work / "home" / "peak"
    if peak.exists():
        bytes_taken = int(peak.read_text())
        peak.unlink()
        if bytes_taken > MOST_BYTES:
            found.append(f"{bytes_taken >> 20} MiB of memory")
    after = listing(folder, but="work")
    written = sorted(name for name in {*after, *before} if after.get(name, ())[:4] != before.get(name, ())[:4])
    if written:
        found.append(f"written outside: {written}")
    read = [name for name in after if after[name] != before.get(name) and (folder / name).is_file()]
    if read and not written and not reads_on_purpose:
        found.append(f"read outside: {read}")
    if any(FORGED in files for _, _, files in os.walk(work)):
        found.append("a command of the file was run")
    return found


def _ended(ran: _Ran, plain: str, codes: tuple[int, ...]) -> list[str]:
    """Return what is wrong with how it ended."""
    if "Traceback (most recent" in plain or "Error in sys.excepthook" in plain:
        return [f"a traceback that ends with {plain.strip().splitlines()[-1][:200]!r}"]
    if ran.code is None:
        return [f"hangs: not ended after {ran.took_s:.0f} s; it said {plain[-200:]!r}"]
    if ran.code in (-signal.SIGXCPU, -signal.SIGKILL):
        return [f"more than {LONGEST_S} s of processor time, or killed ({ran.code})"]
    if ran.code not in codes:
        return [f"exit code {ran.code}: {plain[-300:]!r}"]
    # Several sessions have a table, and a sentence each.
    sentences = len(re.findall(r"(?m)(?:^|\r)imufield:\s|sessions solved", plain))
    if ran.code in CODES[1:] and sentences != 1 and "Usage:" not in plain:
        return [f"{sentences} sentences with exit code {ran.code}: {plain[-300:]!r}"]
    return []


def _shown(ran: _Ran, plain: str) -> list[str]:
    """Return what should not have been shown."""
    found: list[str] = []
    if warning := re.search(r"\w*Warning:.*|Exception ignored.*", plain):
        found.append(f"a raw warning: {warning.group()[:150]!r}")
    # In a live view the cursor comes back to the left.
    if control := _CONTROL.search(plain.replace("\r", "") if ran.on_terminal else plain):
        where = "terminal" if ran.on_terminal else "pipe"
        found.append(f"a control character on the {where}: {plain[max(0, control.start() - 60) :][:120]!r}")
    if not ran.on_terminal and re.search(rf"(?m)^\s*{FORGED}", plain):
        found.append("a forged line")
    return found


def _left(folder: Path, work: Path, said: str) -> list[str]:
    """Return where the secret is, and what pages hold that no page should."""
    found = [f"the secret is told: {secret}" for secret in SECRET_AS_TEXT if secret in said]
    # What is too deep for a path is left out by ``walk``.
    for path in (Path(at) / name for at, _, names in os.walk(work) for name in names):
        about = path.lstat()
        if not stat.S_ISREG(about.st_mode) or about.st_nlink > 1 or about.st_size > 20 << 20:
            continue
        data = path.read_bytes()
        if SECRET in data or any(each.encode() in data for each in SECRET_AS_TEXT):
            found.append(f"the secret is in {path.relative_to(work)}")
        if path.suffix in (".html", ".svg") and (control := _CONTROL.search(data.decode("utf-8", "replace"))):
            found.append(f"a control character {control.group()!r} in {path.relative_to(work)}")
    return found
