"""A clock of the samples that is wrong: what of the gyroscope is right all the same, and what is said of the rest."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.models import to_vector
from imufield.cli.run import run
from imufield.guide.positions import scheme
from imufield.samples import FloatArray
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import OperatorSettings
from tests.commands.told import missing

ERROR = 5e-3
RATE_HZ = 100.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray]:
    """A table of an instrument whose oscillator is 0.5 % fast, timed by its nominal rate, and its true gyroscope scale."""
    habits = OperatorSettings(hold_s=5.0, initial_still_s=8.0)
    drawn = make_virtual_imu(
        Emulation(rate_hz=RATE_HZ, seed=5, grade="mems", directions=scheme("paper24").directions(), operator=habits)
    )
    instrument = replace(drawn.imu.instrument, clock_error_ppm=1e6 * ERROR)
    imu, operator = Imu(instrument, 5, drawn.imu.settings), drawn.operator
    count = int(operator.plan_all() / imu.interval_s)
    samples = imu.feed(operator.block(0, count, imu.interval_s))
    rows = np.column_stack([np.arange(count) / RATE_HZ, samples.accelerometer_rate(), samples.gyroscope_rate()])
    folder = tmp_path_factory.mktemp("clock")
    names = "time,ax_counts,ay_counts,az_counts,gx_counts,gy_counts,gz_counts"
    np.savetxt(folder / "table.csv", rows, delimiter=",", header=names, comments="", fmt="%.9g")
    units = ("--set", "accelerometer_unit=count", "--set", "gyroscope_unit=count")
    columns = ("--columns", "time,ax,ay,az,gx,gy,gz")
    assert run(["import", str(folder / "table.csv"), "-o", str(folder / "session"), *columns, *units]) == 0
    rotation = change_gauge(to_vector(instrument.accelerometer), "lower").rotation
    return folder / "session", turn_gyroscope(instrument.gyroscope, rotation).scale


def solved(session: Path, *options: str) -> dict[str, Any]:
    path = session.parent / "found.toml"
    path.unlink(missing_ok=True)
    assert run(["solve", str(session), "--latitude", "45", "--height", "0", "-o", str(path), *options]) == 0
    return tomllib.loads(path.read_text(encoding="utf-8"))


@pytest.mark.numerical
def test_scale_is_right_by_its_own_clock_and_its_sigma_in_true_seconds(recorded: tuple[Path, FloatArray]) -> None:
    session, truth = recorded
    found = solved(session)
    scale, sigma = np.array(found["gyroscope"]["scale"]), np.array(found["gyroscope"]["uncertainty"]["scale"])
    absolute = np.array(found["gyroscope"]["uncertainty"]["scale_absolute"])
    # Only K over the period is found: an instrument that is fast has a shorter one than it states.
    assert np.all(np.abs(scale / (1 + ERROR) - truth) < 4 * sigma)
    assert np.all(np.abs(scale - truth) > 15 * sigma)
    assert np.all(np.abs(scale - truth) < 2 * absolute)
    assert found["clock"] == {"source": "unchecked", "sample_period_s": pytest.approx(0.01), "sigma": 0.03}
    assert any(not missing(reason, "10 ms", "30000 ppm", "--clock-sigma-ppm") for reason in found["quality"]["reasons"])
    stated = solved(session, "--clock-sigma-ppm", "100")
    # Judged apart: what is said of the clock changes neither the verdict nor any other number.
    assert stated["quality"]["verdict"] == found["quality"]["verdict"]
    assert stated["gyroscope"]["uncertainty"]["scale"] == found["gyroscope"]["uncertainty"]["scale"]
    assert np.allclose(stated["gyroscope"]["uncertainty"]["scale_absolute"], np.hypot(sigma, 1e-4 * scale), rtol=1e-9)
