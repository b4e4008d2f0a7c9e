"""The examples of docs/replay-in-pytest.md run as they stand, on a capture as a user would bring it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imufield.cli.run import run as imufield
from imufield.guide.positions import scheme

PAGE = Path(__file__).resolve().parent.parent / "docs" / "replay-in-pytest.md"
RATE_HZ = 200
TURN_S, HOLD_S = 1, 5


def write_capture(path: Path) -> None:
    """Write a table without a time column: still, then 24 holds with turns between them; constant rates while turning."""
    rng = np.random.default_rng(7)
    up = scheme("paper24").directions()
    force, rate = [np.tile(up[0], (5 * RATE_HZ, 1))], [np.zeros((5 * RATE_HZ, 3))]
    for before, after in zip(up, np.roll(up, -1, axis=0), strict=True):
        force += [np.tile(before, (HOLD_S * RATE_HZ, 1))]
        rate += [np.zeros((HOLD_S * RATE_HZ, 3))]
        share = np.linspace(0, 1, TURN_S * RATE_HZ)[:, None]
        way = (1 - share) * before + share * after + 0.3 * np.sin(np.pi * share) * np.roll(before, 1)
        force += [way / np.linalg.norm(way, axis=1, keepdims=True)]
        # In the body frame d(up)/dt = -w x up; the turn about "up" itself is left out.
        rate += [np.cross(np.gradient(force[-1], 1 / RATE_HZ, axis=0), force[-1])]
    table = np.hstack([9.80665 * np.concatenate(force) + [0.02, -0.03, 0.01], np.concatenate(rate)])
    table[:, :3] += rng.normal(scale=0.01, size=(len(table), 3))
    table[:, 3:] += rng.normal(scale=0.001, size=(len(table), 3))
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")


def run(*arguments: str, folder: Path) -> str:
    answer = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return answer.stdout


def test_the_page_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = PAGE.read_text(encoding="utf-8")
    write_capture(tmp_path / "bench-17.csv")
    (command,) = re.findall(r"^    imufield (import .*)$", text, flags=re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    assert imufield(command.split()) == 0
    blocks = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "test_my_imu.py").write_text("\n\n".join(blocks), encoding="utf-8")
    # Both runs in one process, which need not import everything twice.
    update = ["-q", "-k", "stays_what", "--imufield-update"]
    code = f"import pytest, sys; sys.exit(pytest.main({update}) or pytest.main(['-q']))"
    assert "4 passed" in run("-c", code, folder=tmp_path)
