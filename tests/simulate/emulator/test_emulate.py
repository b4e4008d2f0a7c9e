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

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.toml import spell
from imufield.acquire.registry import load_driver
from imufield.calibrate.model.grades import GRADES
from imufield.commands.options.shared import LARGEST_SEED
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import Samples, concatenate
from imufield.simulate.emulator.core import EmulatorSettings
from imufield.simulate.emulator.emulate import (
    Emulation,
    choose_wire,
    emulate,
    make_device,
    make_emulator,
    make_virtual_imu,
    truth_document,
)
from imufield.simulate.emulator.faults import CanFaults, Faults
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.stim300 import Stim300Device, Stim300Identity
from imufield.simulate.truth.operator import OperatorSettings
from tests.refused import refused
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
    with refused(UsageError, Reason.USAGE, "333 Hz", "125, 250, 500, 1000", key="emulate.rate") as caught:
        make_emulator(replace(OPTIONS, rate_hz=333.0))
    assert caught.value.values["rate_hz"] == 333


@pytest.mark.parametrize("device", ["stim300", "text"])
def test_the_rate_is_also_a_setting(device: str) -> None:
    """As of other instruments: who copies the settings of a capture gets the stream that they describe."""
    options = replace(OPTIONS, device=device, rate_hz=None, settings={"rate_hz": "250"})
    emulator = make_emulator(options)
    emulator.stop()
    assert choose_wire(options).rate_hz == 250
    assert choose_wire(replace(options, rate_hz=125.0)).rate_hz == 125


@pytest.mark.parametrize(
    "names", [["accelerometer_output"], ["gyroscope_output"], ["accelerometer_output", "gyroscope_output"]]
)
def test_a_stim300_of_increments_is_read_with_the_settings_that_are_told(names: list[str]) -> None:
    options = replace(OPTIONS, settings=dict.fromkeys(names, "increment"))
    wire = choose_wire(options)
    sent = make_virtual_imu(options).next_block(500)
    decoder = Decoder(load_driver("stim300").load_protocol({name: spell(value) for name, value in wire.settings.items()}))
    read = concatenate([decoder.feed(make_device(options, wire).encode(sent).data.tobytes(), 1.0), decoder.flush()])
    # A step of the wire: 2^-22 m/s of each sample at 10 g, 2^-21 deg, or 2^-19 g and 2^-14 deg/s.
    np.testing.assert_allclose(read.accelerometer_rate(), sent.accelerometer, atol=2e-5)
    np.testing.assert_allclose(read.gyroscope_rate(), sent.gyroscope, atol=2e-6)


def test_failure_of_the_thread_reaches_the_caller(tmp_path: Path) -> None:
    with refused(ParameterFileError, Reason.FOREIGN, "truth.toml"):
        emulate(replace(OPTIONS, truth=tmp_path / "missing" / "truth.toml"))


def test_the_page_lists_every_form() -> None:
    text = (Path(__file__).resolve().parents[3] / "docs" / "emulate.md").read_text(encoding="utf-8")
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


def first_samples(options: Emulation) -> Samples:
    virtual = make_virtual_imu(options)
    return concatenate([virtual.next_block(100) for _ in range(10)])


def test_another_day_is_another_session_of_the_same_instrument() -> None:
    first, again, other = OPTIONS, replace(OPTIONS, day=0), replace(OPTIONS, day=1)
    np.testing.assert_array_equal(first_samples(first).accelerometer, first_samples(again).accelerometer)
    assert not np.any(first_samples(first).accelerometer == first_samples(other).accelerometer)
    assert not np.any(first_samples(replace(OPTIONS, day=2)).accelerometer == first_samples(other).accelerometer)
    truths = [json.loads(json.dumps(truth_document(options, make_virtual_imu(options)))) for options in (first, other)]
    for name in ("scale", "bias_m_s2", "misalignment_rad", "quadratic"):
        assert truths[0]["accelerometer"][name] == truths[1]["accelerometer"][name]
    assert [truth["day"] for truth in truths] == [0, 1]
    tilts = [truth["still"][0]["direction"] for truth in truths]
    assert tilts[0] != tilts[1]


def test_faults_of_another_day_are_others() -> None:
    def damaged(day: int) -> bytes:
        emulator = make_emulator(replace(OPTIONS, day=day, faults=Faults(bit_flip_probability=0.1)))
        assert isinstance(emulator, Emulator)
        emulator.stop()
        return emulator.injector.damage(np.zeros(1000, dtype=np.uint8), np.array([999]), 1.0)

    assert damaged(0) == damaged(0) != damaged(1)


def test_the_serial_number_follows_seed_and_grade_and_not_the_day() -> None:
    def serial_number(seed: int, day: int = 0, grade: str = "tactical") -> str:
        device = make_device(options := Emulation(seed=seed, day=day, grade=grade), choose_wire(options))
        assert isinstance(device, Stim300Device)
        return device.identity.serial_number

    assert serial_number(1) == Stim300Identity().serial_number
    assert serial_number(2) == serial_number(2, day=5) != serial_number(1)
    assert len({serial_number(seed) for seed in (0, 1, 2, 3, LARGEST_SEED)}) == 5
    assert {len(serial_number(seed)) for seed in (0, 1, LARGEST_SEED)} == {14}
    # Another grade of the same seed has other parameters, so it is another unit.
    assert len({serial_number(seed, grade=grade) for seed in (1, 2) for grade in GRADES}) == 2 * len(GRADES)
