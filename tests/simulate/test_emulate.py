"""The virtual instrument as the command runs it."""

from __future__ import annotations

import json
import math
import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from imufield.errors import UsageError
from imufield.samples import concatenate
from imufield.simulate.devices import Stim300Device
from imufield.simulate.emulate import Emulation, emulate, make_emulator, make_virtual_imu
from imufield.simulate.emulator import Emulator, EmulatorSettings
from imufield.simulate.faults import CanFaults, Faults
from imufield.simulate.operator import OperatorSettings
from tests.simulate.accounting import serial_wires

OPTIONS = Emulation(
    rate_hz=125.0,
    directions=((0, 0, 1), (0, 1, 0)),
    operator=OperatorSettings(hold_s=2.0, initial_still_s=1.0, turn_s=(0.5, 1.0)),
    seed=3,
    run=EmulatorSettings(speed=50.0, duration_s=12.0),
)


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_truth_is_written_and_true(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"truth{suffix}"
    started: list[str] = []
    emulator = emulate(replace(OPTIONS, truth=path), lambda running: started.append(running.address))
    assert started
    assert emulator.samples_sent == 1500
    truth = tomllib.loads(path.read_text()) if suffix == ".toml" else json.loads(path.read_text())
    assert truth["format"] == "imufield-truth"
    assert [still["position"] for still in truth["still"]] == [-1, 0, 1]
    assert "end_s" not in truth["still"][-1]

    # The same options make the same instrument: its means in the stills follow from the parameters in the file.
    virtual = make_virtual_imu(OPTIONS)
    samples = concatenate([virtual.next_block(100) for _ in range(15)])
    still = truth["still"][1]
    rows = (samples.time_s > still["start_s"] + 0.05) & (samples.time_s < still["end_s"] - 0.05)
    force = truth["site"]["gravity_m_s2"] * np.array(still["direction"])
    triad = {
        name: np.array(value) for name, value in truth["accelerometer"].items() if name not in ("raw_unit", "quadratic_axes")
    }
    sensed = (np.eye(3) + triad["misalignment_rad"]) @ force
    expected = triad["scale"] * (sensed + triad["bias_m_s2"]) + triad["quadratic"] * sensed**2
    np.testing.assert_allclose(samples.accelerometer[rows].mean(axis=0), expected, atol=5e-3)


def test_true_rate_is_that_of_the_drawn_clock() -> None:
    virtual = make_virtual_imu(OPTIONS)
    assert virtual.interval_s == pytest.approx(1 / (125 * (1 + 1e-6 * virtual.imu.instrument.clock_error_ppm)), rel=1e-12)
    assert virtual.next_block(10).time_s[-1] == 9 / 125


def test_without_directions_it_lies_on_the_table() -> None:
    virtual = make_virtual_imu(replace(OPTIONS, directions=()))
    assert virtual.operator.stills[0].end_s == math.inf


@pytest.mark.parametrize(("grade", "range_g"), [("navigation", 30), ("tactical", 10), ("industrial", 10), ("mems", 5)])
def test_range_of_the_datagrams_holds_the_grade(grade: str, range_g: int) -> None:
    emulator = make_emulator(replace(OPTIONS, grade=grade))
    try:
        assert isinstance(emulator, Emulator)
        assert isinstance(emulator.device, Stim300Device)
        assert emulator.device.format.accelerometer_range_g == range_g
    finally:
        emulator.stop()


def test_text_at_any_rate_and_stim300_at_its_own() -> None:
    emulator = make_emulator(replace(OPTIONS, device="text", rate_hz=33.0))
    emulator.stop()
    with pytest.raises(UsageError, match="333 Hz"):
        make_emulator(replace(OPTIONS, rate_hz=333.0))


def test_failure_of_the_thread_reaches_the_caller(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        emulate(replace(OPTIONS, truth=tmp_path / "missing" / "truth.toml"))


def test_the_page_lists_every_form() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "emulate.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", text, flags=re.MULTILINE))
    by_driver: dict[str, list[str]] = {}
    for wire in serial_wires():
        if wire.form:
            by_driver.setdefault(wire.driver, []).append(wire.form)
    for name, forms in by_driver.items():
        assert re.findall(r"`([^`]+)`", listed[name]) == forms
    for kind in (Faults, CanFaults):
        for field in fields(kind):
            assert f"`{field.name}`" in text
