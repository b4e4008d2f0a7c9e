"""The commands as a person runs them, each in a process of its own: demo, help, import and solve, CSV, record and capture.

The peer is a start with ``import scipy.optimize`` in the same run, but for the C++ program and where there is none.

``python -m benchmarks.bench_commands 60`` listens for 60 s to the emulated instrument of 2000 Hz, which is what the figures
are stated for. The real recording of a calibrated unit is looked for in ``shared/data`` beside the project.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, print_rows, row
from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.guide.positions import scheme
from imufield.pipeline.chain import session_samples
from imufield.pipeline.reading_cache import CACHE_FILE
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.instruments.stim300 import Stim300Device
from imufield.simulate.truth.operator import OperatorSettings
from imufield.simulate.wire.stim300 import Stim300Format

IMUFIELD = [sys.executable, "-m", "imufield"]
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "imu_tk"
COMPILED = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
"""Where the program is compiled once, as pip does when it installs it; the peer of a start is compiled, too."""
PEER_SOLVE_S = 0.47
"""C++ program on the same files, middle of 0.4 s to 0.55 s measured on a machine like this; not run here."""
COMMANDS = ("demo", "devices", "capture", "record", "import", "replay", "solve", "export-data", "emulate")
RATE_HZ = 2000.0
DURATION_S = 10.0
LONG_SESSION_S = 2400.0
CHUNK_S = 0.02
ROUNDS = 3


@dataclass(frozen=True)
class Ended:
    """A process that ended: wall and processor time, largest resident memory, standard output."""

    wall_s: float
    cpu_s: float
    memory_mib: float
    output: str


def run_program(folder: Path, *arguments: object, until_s: float | None = None, code: int = 0) -> Ended:
    """Run imufield to its end, or interrupt it after a time."""
    begin_s = time.perf_counter()
    with (folder / "output").open("w+") as output:
        command = [*IMUFIELD, *map(str, arguments)]
        process = subprocess.Popen(
            command, cwd=folder, env=COMPILED, stdout=output, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL
        )
        if until_s is not None:
            time.sleep(until_s)
            process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        errors = process.stderr.read().decode()
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - begin_s
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == code, errors
        output.seek(0)
        kilo = 1 if sys.platform == "darwin" else 1024
        return Ended(wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * kilo / 2**20, output.read())


@contextmanager
def emulator(*options: object) -> Iterator[str]:
    """Run ``imufield emulate`` beside; yield its port."""
    command = [*IMUFIELD, "emulate", "stim300", "--json", "--wait", *map(str, options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            yield str(json.loads(process.stdout.readline())["port"])
        finally:
            process.terminate()


def unit_s() -> float:
    """Return the time of a start with ``import scipy.optimize``, in which the times of commands are told."""
    found = []
    for _ in range(ROUNDS):
        begin_s = time.perf_counter()
        subprocess.run([sys.executable, "-c", "import scipy.optimize"], check=True)
        found.append(time.perf_counter() - begin_s)
    return min(found)


def help_rows(folder: Path) -> list[Row]:
    best = {
        command: min(run_program(folder, *command.split(), "--help").wall_s for _ in range(ROUNDS))
        for command in ("", *COMMANDS)
    }
    slowest = max(best, key=lambda command: best[command])
    unit = unit_s()
    return [row("--help", best[""], "s", unit), row(f"--help of the slowest command ({slowest})", best[slowest], "s", unit)]


def demo_rows(folder: Path) -> list[Row]:
    ended = run_program(folder, "demo", "--plain")
    passed = "Passed:" in ended.output
    text = ended.output.partition("in units of the stated sigma:")[2]
    errors = [abs(float(word)) for word in text.split() if word[0] in "+-" and word[1:2].isdigit()]
    return [
        row("demo, 24 positions over a pseudo-terminal", ended.wall_s, "s"),
        row("demo: all as it should be", float(passed), "1 is yes"),
        row("demo: largest error", max(errors), "sigma"),
    ]


def real_rows(folder: Path) -> list[Row]:
    files = [REAL_DATA / "xsens_acc.mat.gz", REAL_DATA / "xsens_gyro.mat.gz"]
    if not all(path.is_file() for path in files):
        return []
    site = ("--gravity", 9.81744, "--gauge", "lower", "--model", "linear")
    imports, solves, unit = [], [], unit_s()
    for number in range(ROUNDS):
        imports.append(run_program(folder, "import", *files, "--zero", 32768, "-o", f"real-{number}").wall_s)
        solves.append(run_program(folder, "solve", f"real-{number}", *site).wall_s)
    both = min(one + other for one, other in zip(imports, solves, strict=True))
    return [
        row("real recording: import", min(imports), "s", unit),
        row("real recording: solve", min(solves), "s", unit),
        row("real recording: both, best of three", both, "s", PEER_SOLVE_S),
    ]


def live_rows(folder: Path, duration_s: float) -> list[Row]:
    """Read the emulator with the real commands; their start is counted in."""
    rows = []
    for command in ("record", "capture"):
        with emulator("--rate-hz", RATE_HZ) as port:
            common = ("--port", port, "--driver", "stim300", "--session", folder / command, "--json")
            if command == "record":
                ended = run_program(folder, command, *common, "--duration-s", duration_s)
            else:
                ended = run_program(folder, command, *common, until_s=duration_s, code=130)
        counter = np.concatenate([block.counter for block in session_samples(Session.open(folder / command), [])])
        step = np.mod(np.diff(counter.astype(np.int64)), 256)
        lost = float((step - 1).sum())
        rows += [
            row(f"{command}, 2000 Hz for {duration_s:g} s: processor", 100 * ended.cpu_s / ended.wall_s, "% of a core"),
            row(f"{command}, 2000 Hz for {duration_s:g} s: frames lost", lost, f"of {len(counter) + lost:.0f}"),
        ]
    return rows


def write_long_session(folder: Path) -> Session:
    """Simulate 40 minutes at 2000 Hz of an operator who goes through 24 positions."""
    directions = scheme("paper24").directions()
    hold_s = (LONG_SESSION_S - 30) / len(directions) - 3
    operator = OperatorSettings(hold_s=hold_s)
    source = make_virtual_imu(Emulation(rate_hz=RATE_HZ, seed=1, directions=directions, operator=operator))
    protocol = load_driver("stim300").load_protocol({"rate_hz": RATE_HZ})
    device = Stim300Device(Stim300Format(rate_hz=RATE_HZ))
    metadata = {
        "kind": "capture",
        "scheme": "paper24",
        "site": {"latitude_deg": 48.1},
        "instrument": {"driver": "stim300", "model": "stim300"},
        "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
    }
    session = Session.create_in(folder, "stim300", metadata)
    size, per_block = round(CHUNK_S * RATE_HZ), 100
    with Recorder(session.add_part(), part_metadata(protocol, {})) as recorder:
        for number in range(round(LONG_SESSION_S / CHUNK_S / per_block)):
            data = device.encode(source.next_block(size * per_block)).data.tobytes()
            length = len(data) // per_block
            for part in range(per_block):
                time_s = (number * per_block + part + 1) * CHUNK_S
                chunk = Chunk(
                    data[part * length : (part + 1) * length], time_s, 1_700_000_000_000_000_000 + round(1e9 * time_s)
                )
                recorder.write_chunk(chunk)
    return session


def long_rows(folder: Path) -> list[Row]:
    session = write_long_session(folder / "long")
    size_mb = sum(path.stat().st_size for path in session.parts) / 1e6
    unit = unit_s()
    ended = []
    for _ in range(ROUNDS):
        # Cold: without what is kept of an earlier replay.
        (session.folder / CACHE_FILE).unlink(missing_ok=True)
        ended.append(run_program(folder, "solve", session.folder, "--json"))
    kept = {
        "solve, as right after a capture": ("solve", session.folder, "--json"),
        "verify": ("verify", session.folder),
        "report": ("report", session.folder),
        "replay": ("replay", session.folder, "--json"),
    }
    again = {what: min(run_program(folder, *line).wall_s for _ in range(ROUNDS)) for what, line in kept.items()}
    text = run_program(folder, "export-data", session.folder, "--to", "csv", "-o", "samples.csv")
    corrected = run_program(folder, "apply", session.folder / "parameters.toml", session.folder, "-o", "corrected.csv")
    positions = len(json.loads(ended[0].output)["position"])
    return [
        row(
            f"solve, 40 min at 2000 Hz ({size_mb:.0f} MB, {positions} positions)",
            min(program.wall_s for program in ended),
            "s",
            unit,
        ),
        *(row(f"{what}, 40 min at 2000 Hz", value, "s", unit) for what, value in again.items()),
        row("export-data --to csv, 40 min at 2000 Hz", text.wall_s, "s", unit),
        row("apply to CSV, 40 min at 2000 Hz", corrected.wall_s, "s", unit),
        row("solve, 40 min at 2000 Hz: largest resident memory", max(program.memory_mib for program in ended), "MiB"),
    ]


def run(duration_s: float = DURATION_S) -> list[Row]:
    """Return one row for each figure: name, value, unit, peer's value and ratio (None where there is no peer)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [
            *help_rows(folder),
            *real_rows(folder),
            *long_rows(folder),
            *live_rows(folder, duration_s),
            *demo_rows(folder),
        ]


def main() -> None:
    """Print the figures as a table."""
    print_rows(run(float(sys.argv[1]) if len(sys.argv) > 1 else DURATION_S))


if __name__ == "__main__":
    main()
