"""The console as wide as its window, whatever the environment says."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

fcntl = pytest.importorskip("fcntl", reason="needs pseudo-terminals: Linux or macOS")
termios = pytest.importorskip("termios", reason="needs pseudo-terminals: Linux or macOS")

ASKING = """
from imufield.console import PlainTextConsole

console = PlainTextConsole()
for _ in range(3):
    input()
    print(*console.size, flush=True)
"""


@pytest.mark.parametrize("sizes", [{}, {"COLUMNS": "0", "LINES": "0"}])
def test_it_follows_its_window(tmp_path: Path, sizes: dict[str, str]) -> None:
    master, slave = os.openpty()
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")} | sizes
    process = subprocess.Popen(
        [sys.executable, "-c", ASKING],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=slave,
        env=environment,
        cwd=tmp_path,
        text=True,
    )
    found = []
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        for columns, lines in [(100, 30), (60, 20), (130, 40)]:
            fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
            process.stdin.write("\n")
            process.stdin.flush()
            found.append(tuple(map(int, process.stdout.readline().split())))
    os.close(slave)
    os.close(master)
    assert found == [(100, 30), (60, 20), (130, 40)]
