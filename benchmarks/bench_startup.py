"""What a person waits for before anything happens: ``--help`` of every command, and the commands that only list."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

from typer.main import get_command

from imufield.cli.app import make_app

ROUNDS = 3
SCIENTIFIC = "import scipy.optimize"
"""What a user of Python's scientific packages waits for anyway."""


def best_s(*arguments: str) -> float:
    """Return the shortest of some starts."""
    found = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
        found.append(time.perf_counter() - begin)
    return min(found)


def run() -> list[dict[str, Any]]:
    """Return one row for each command; the peer is the import of ``scipy.optimize``."""
    peer = best_s("-c", SCIENTIFIC)
    group: Any = get_command(make_app())
    lines = [("imufield --version", ["--version"]), ("imufield --help", ["--help"]), ("devices", ["devices"])]
    lines += [(f"{name} --help", [name, "--help"]) for name in sorted(group.commands)]
    values = [(what, best_s("-m", "imufield", *words)) for what, words in lines]
    return [{"name": what, "value": value, "unit": "s", "peer": peer, "ratio": value / peer} for what, value in values]


if __name__ == "__main__":
    for line in run():
        print(f"{line['name']:<30} {line['value']:6.2f} s   {line['ratio']:.2f} times {SCIENTIFIC}")
