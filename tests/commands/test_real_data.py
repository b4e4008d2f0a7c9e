"""Real recordings through the real commands, against the reference results that lie beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from tests.commands.conftest import Program

MG = 9.80665e-3
MIKOFF = {
    "imu0": ([1.003668, 1.002879, 1.006557], [0.43e-3, 5.49e-3, 2.00e-3], [0.1022, 0.0977, 0.3433]),
    "imu2": ([1.003965, 1.003496, 1.007804], [0.09e-3, 5.07e-3, 4.04e-3], [0.0946, 0.0071, -0.0456]),
}
"""Scale, T21 T31 T32 in rad, bias in m/s^2: README.md of the recordings."""


def solved(program: Program, *options: object) -> dict[str, Any]:
    ended = program.run("solve", "session", "--gauge", "lower", "--model", "linear", "--json", *options)
    assert ended.returncode == 0, ended.stderr
    content: dict[str, Any] = json.loads(ended.stdout)
    return content


def lower(matrix: list[list[float]]) -> list[float]:
    return [matrix[1][0], matrix[2][0], matrix[2][1]]


def test_xsens(program: Program, shared_folder: Path) -> None:
    files = [shared_folder / "data" / "imu_tk" / f"xsens_{triad}.mat.gz" for triad in ("acc", "gyro")]
    imported = program.run("import", *files, "--zero", 32768, "-o", "session")
    assert imported.returncode == 0, imported.stderr
    content = solved(program, "--gravity", 9.81744)
    found = content["accelerometer"]
    assert np.abs(np.array(found["scale"]) / [414.4455, 412.1213, 414.5082] - 1).max() < 50e-6
    assert np.abs(np.array(lower(found["misalignment_rad"])) - [0.003579, 0.009249, 0.021334]).max() < 0.2e-3
    assert np.abs(np.array(found["bias_m_s2"]) - [0.858606, 1.230565, -0.973426]).max() < 0.05 * MG
    assert 36 <= len(content["position"]) <= 46
    assert 0.09 < content["quality"]["residual_rms_m_s2"] / MG < 0.12
    # One position alone shows +x: without it the scale moves by 122 ppm.
    assert any("scale x" in reason and "near +x" in reason for reason in content["quality"]["reasons"])


@pytest.mark.parametrize("name", MIKOFF)
def test_mikoff(program: Program, shared_folder: Path, name: str) -> None:
    file = shared_folder / "data" / "mikoff" / f"{name}.log.gz"
    columns = ("--columns", "ax,ay,az,gx,gy,gz", "--rate-hz", 100)
    imported = program.run("import", file, *columns, "--set", "accelerometer_unit=m/s^2", "-o", "session")
    assert imported.returncode == 0, imported.stderr
    found = solved(program, "--gravity", 9.81)["accelerometer"]
    scale, misalignment, bias = MIKOFF[name]
    assert np.abs(np.array(found["scale"]) - scale).max() < 6e-4
    assert np.abs(np.array(lower(found["misalignment_rad"])) - misalignment).max() < 7e-4
    assert np.abs(np.array(found["bias_m_s2"]) - bias).max() < 3e-3
