"""Run every benchmark beside this file, one after the other, each in a process of its own: ``make bench``."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path


def main() -> int:
    """Return 0 if every benchmark ran; what they measure is printed and never judged here."""
    print(f"Python {platform.python_version()}, {platform.machine()}, {platform.system()}")
    failed = []
    for script in sorted(Path(__file__).parent.glob("bench_*.py")):
        print(f"\n== {script.stem}", flush=True)
        command = [sys.executable, "-m", f"{script.parent.name}.{script.stem}"]
        if subprocess.run(command, cwd=script.parent.parent, check=False).returncode:
            failed.append(script.stem)
    if failed:
        print(f"\nfailed: {', '.join(failed)}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
