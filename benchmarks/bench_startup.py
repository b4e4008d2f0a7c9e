"""What a person waits for before anything happens: ``--help`` of every command, and the commands that only list."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

from typer.main import get_command

from imufield.cli.app import make_app

ROUNDS = 3
BARE = "import numpy"
"""What no command that computes can do without."""


def best_s(*arguments: str) -> float:
    """Return the shortest of some starts."""
    found = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
        found.append(time.perf_counter() - begin)
    return min(found)


def run() -> list[dict[str, Any]]:
    """Return one row for each command; the peer is a bare Python."""
    bare = best_s("-c", "pass")
    numpy = best_s("-c", BARE)
    group: Any = get_command(make_app())
    lines = [("imufield --help", ["--help"]), *((f"{name} --help", [name, "--help"]) for name in sorted(group.commands))]
    rows = [{"name": what, "value": best_s("-m", "imufield", *words), "unit": "s", "peer": bare} for what, words in lines]
    rows.append({"name": "devices", "value": best_s("-m", "imufield", "devices"), "unit": "s", "peer": numpy})
    return rows


if __name__ == "__main__":
    for line in run():
        print(f"{line['name']:<30} {line['value']:6.2f} s   bare Python {line['peer']:.2f} s")
