"""Fail where less than 90 % of the branches of a room are tested; reads what ``coverage run`` left.

Lines are not asked for: a branch that was never taken is where a defect hides, and a tested branch has tested lines.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOMS = ("acquire", "calibrate", "guide")
FLOOR = 0.90
REPORT = Path("build/coverage.json")


def main() -> int:
    """Return 1 if a room is below the floor."""
    REPORT.parent.mkdir(exist_ok=True)
    subprocess.run([sys.executable, "-m", "coverage", "json", "--quiet", "-o", str(REPORT)], check=True)
    files = json.loads(REPORT.read_text(encoding="utf-8"))["files"]
    branches: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    worst: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for name, file in files.items():
        room = next((room for room in ROOMS if name.startswith(f"imufield/{room}/")), None)
        if room is not None:
            there, taken = file["summary"]["num_branches"], file["summary"]["covered_branches"]
            branches[room][0] += taken
            branches[room][1] += there
            worst[room].append((there - taken, name))
    low = False
    for room in ROOMS:
        share = branches[room][0] / max(branches[room][1], 1)
        low |= share < FLOOR
        print(f"{room:<10} {share:6.1%} of {branches[room][1]} branches (at least {FLOOR:.0%})")
        for missing, name in sorted(worst[room], reverse=True)[:3]:
            print(f"  {missing:4d} not taken in {name}")
    return int(low)


if __name__ == "__main__":
    sys.exit(main())
