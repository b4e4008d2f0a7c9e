"""Processor time and memory against the length of a session, 1, 10 and 100 times: each must grow no faster than the data.

A session of six faces at 500 Hz, one minute long, then ten and a hundred; bytes of a STIM300, made as in ``bench_commands``.
Processor time is taken less the start of the program; its exponent over the length is 1 where growth is linear.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.bench_commands import CHUNK_S, Ended, run_program
from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.guide.positions import scheme
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.instruments.stim300 import Stim300Device
from imufield.simulate.truth.operator import OperatorSettings
from imufield.simulate.wire.stim300 import Stim300Format

RATE_HZ = 500.0
SHORTEST_S = 60.0
LENGTHS = (1, 10, 100)
BLOCK = 100
COMMANDS = {
    "replay": "replay {session} --json",
    "solve": "solve {session} --latitude 48 -o {folder}/parameters.toml",
    "apply": "apply {folder}/parameters.toml {session} -o {folder}/corrected.csv",
    "export-data": "export-data {session} -o {folder}/samples.csv",
    "report": "report {session} --parameters {folder}/parameters.toml -o {folder}/report.html --record {folder}/record.html",
}


def write_session(folder: Path, duration_s: float) -> Session:
    """Simulate an operator who holds six faces for as long as it takes."""
    directions = scheme("faces6").directions()
    operator = OperatorSettings(hold_s=(duration_s - 12) / len(directions) - 3, initial_still_s=8.0)
    source = make_virtual_imu(Emulation(rate_hz=RATE_HZ, seed=1, directions=directions, operator=operator))
    protocol = load_driver("stim300").load_protocol({"rate_hz": RATE_HZ})
    device = Stim300Device(Stim300Format(rate_hz=RATE_HZ))
    metadata = {
        "kind": "capture",
        "scheme": "faces6",
        "guide": {"hold_s": 3.0},
        "instrument": {"driver": "stim300", "model": "stim300"},
        "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
    }
    session = Session.create_in(folder, "stim300", metadata)
    size = round(CHUNK_S * RATE_HZ)
    with Recorder(session.add_part(), part_metadata(protocol, {})) as recorder:
        for number in range(round(duration_s / CHUNK_S / BLOCK)):
            data = device.encode(source.next_block(size * BLOCK)).data.tobytes()
            length = len(data) // BLOCK
            for part in range(BLOCK):
                time_s = (number * BLOCK + part + 1) * CHUNK_S
                utc_ns = 1_700_000_000_000_000_000 + round(1e9 * time_s)
                recorder.write_chunk(Chunk(data[part * length : (part + 1) * length], time_s, utc_ns))
    return session


def measured(folder: Path, length: int) -> dict[str, Ended]:
    """Run every command on a session of this length."""
    place = folder / f"{length}"
    session = write_session(place / "session", length * SHORTEST_S)
    return {
        name: run_program(folder, *line.format(session=session.folder, folder=place).split()) for name, line in COMMANDS.items()
    }


def run() -> list[dict[str, Any]]:
    """Return rows of time, memory and exponent for each command."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        start_s = {command: run_program(folder, command, "--help").cpu_s for command in COMMANDS}
        ended = {length: measured(folder, length) for length in LENGTHS}
    for command in COMMANDS:
        times = [ended[length][command].cpu_s for length in LENGTHS]
        minutes = [f"{length * SHORTEST_S / 60:g} min" for length in LENGTHS]
        rows += [{"name": f"{command}, {m}: processor", "value": t, "unit": "s"} for m, t in zip(minutes, times, strict=True)]
        memory = [ended[length][command].memory_mib for length in LENGTHS]
        rows += [{"name": f"{command}, {m}: memory", "value": v, "unit": "MiB"} for m, v in zip(minutes, memory, strict=True)]
        above = [max(time - start_s[command], 1e-3) for time in times]
        rows.append({"name": f"{command}: growth of time", "value": math.log10(above[2] / above[1]), "unit": "exponent"})
        grown = math.log10(memory[2] / memory[1])
        rows.append({"name": f"{command}: growth of memory", "value": grown, "unit": "exponent"})
    return rows


if __name__ == "__main__":
    for line in run():
        print(f"{line['name']:<45} {line['value']:9.3f} {line['unit']}")
