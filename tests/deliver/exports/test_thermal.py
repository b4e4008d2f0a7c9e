"""Exports over temperature: the formulas of PX4 and ArduPilot in single precision and the C header, against ``apply``."""

from __future__ import annotations

import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_instruments import GRAVITY, made_up

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.calibrate.model.temperature_polynomials import Polynomials, TriadTemperature
from imufield.deliver.exports import TARGETS, Exported, ExportOptions, export_parameters
from imufield.deliver.exports.conventions import diagonal_corrections
from imufield.deliver.exports.loss import directions
from imufield.deliver.parameters.file import Parameters
from imufield.errors import UsageError
from tests.refused import refused
from tests.told import keys, told

pytestmark = pytest.mark.numerical

MG, DEG_H = 9.80665e-3, np.pi / 180 / 3600
REFERENCE_DEGC, LOW_DEGC, HIGH_DEGC = 32.15, -20.0, 65.0


def over_temperature(seed: int, order: int, unit: float, ppm: float) -> TriadTemperature:
    rng = np.random.default_rng(seed)
    size = unit * 45.0 ** -np.arange(order)[:, None]
    return TriadTemperature(
        reference_degc=REFERENCE_DEGC,
        range_degc=(LOW_DEGC, HIGH_DEGC),
        bias=Polynomials(size * rng.normal(size=(order, 3)), np.zeros((3, order, order))),
        scale=Polynomials(1e-6 * ppm * rng.normal(size=(1, 3)), np.zeros((3, 1, 1))),
        hysteresis=np.full(3, np.nan),
        scale_separated=True,
    )


def made(seed: int, order: int, *, ppm: float = 60.0, angle_rad: float = 2e-3, gyroscope: bool = True) -> Parameters:
    parameters = made_up(seed, angle_rad=angle_rad, gyroscope=gyroscope)
    calibration = parameters.calibration
    rates = calibration.gyroscope
    if rates is not None:
        rates = replace(rates, temperature=over_temperature(seed + 1, order, 60 * DEG_H, ppm))
    thermal = over_temperature(seed, order, 0.15 * MG, ppm)
    return replace(parameters, calibration=replace(calibration, accelerometer_temperature=thermal, gyroscope=rates))


def values_of(exported: Exported) -> dict[str, np.float32]:
    (content,) = exported.files.values()
    rows = [line.replace(",", "\t").split("\t") for line in content.decode().splitlines() if not line.startswith("#")]
    # Vehicle and component come first in PX4's file, and the type last.
    pairs = [row[2:4] if len(row) == 5 else row for row in rows]
    return {name: np.float32(value) for name, value in pairs}


def vector(values: dict[str, np.float32], name: str, axes: str) -> np.ndarray:
    return np.array([values[name.format(axis)] for axis in axes], dtype=np.float32)


def px4(values: dict[str, np.float32], degc: float, acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Written from TemperatureCompensation and sensor_calibration."""
    thermal = []
    for letter in "AG":
        start = f"TC_{letter}0"
        assert values[f"TC_{letter}_ENABLE"] == 1
        T = np.clip(np.float32(degc), values[f"{start}_TMIN"], values[f"{start}_TMAX"])
        d = np.float32(T - values[f"{start}_TREF"])
        X = [vector(values, f"{start}_X{power}_{{}}", "012") for power in range(4)]
        thermal.append(X[0] + X[1] * d + X[2] * (d * d) + X[3] * (d * d * d))
    offset, scale, rate = (vector(values, name, "XYZ") for name in ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF"))
    return (acc - thermal[0] - offset) * scale, gyr - thermal[1] - rate


def ardupilot(values: dict[str, np.float32], degc: float, acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Written from AP_InertialSensor_tempcal.cpp and AP_InertialSensor_Backend.cpp."""
    corrected = []
    assert values["INS_TCAL1_ENABLE"] == 1
    low, high = values["INS_TCAL1_TMIN"], values["INS_TCAL1_TMAX"]
    for name, raw in (("ACC", acc), ("GYR", gyr)):
        c = [vector(values, f"INS_TCAL1_{name}{power}_{{}}", "XYZ") for power in (1, 2, 3)]
        at_degc = []
        for T in (np.float32(degc), values[f"INS_{name}1_CALTEMP"]):
            x = np.float32(np.clip(T, low, high) - np.float32(35))
            at_degc.append((c[0] + (c[1] + c[2] * x) * x) * x * np.float32(1e-6))
        corrected.append(raw - at_degc[0] + at_degc[1])
    offset, scale, rate = (vector(values, f"INS_{name}_{{}}", "XYZ") for name in ("ACCOFFS", "ACCSCAL", "GYROFFS"))
    return (corrected[0] - offset) * scale, corrected[1] - rate


FORMULAS = {"px4": px4, "ardupilot": ardupilot}


def largest_errors(parameters: Parameters, values: dict[str, np.float32], target: str) -> tuple[float, float]:
    """Return the largest error over the range at 1 g in mg, and of the gyroscope at rest in deg/h."""
    force_mg = rate_deg_h = 0.0
    # The target's frame: the body frame nearest to the sensing axes.
    R = diagonal_corrections(parameters.calibration).rotation
    force = GRAVITY * directions()
    for degc in np.linspace(LOW_DEGC, HIGH_DEGC, 81):
        there = parameters.at(float(degc)).calibration
        assert there.gyroscope is not None
        raw = predict(there.accelerometer, force).astype(np.float32)
        still = predict_gyroscope(there.gyroscope.parameters, np.zeros((1, 3))).astype(np.float32)
        their_force, their_rate = FORMULAS[target](values, float(degc), raw, still)
        assert their_force.dtype == np.float32
        force_mg = max(force_mg, np.linalg.norm(their_force - force @ R.T, axis=1).max() / MG)
        rate_deg_h = max(rate_deg_h, np.linalg.norm(their_rate, axis=1).max() / DEG_H)
    return force_mg, rate_deg_h


@pytest.mark.parametrize("order", [1, 3, 5])
@pytest.mark.parametrize("target", FORMULAS)
def test_the_loss_is_the_stated_one(target: str, order: int) -> None:
    parameters = made(3, order)
    exported = export_parameters(parameters, target, ExportOptions(accelerometer_id=1310988, gyroscope_id=1310988))
    (loss,) = told(exported.losses, "thermal.loss")
    force_mg, rate_deg_h = largest_errors(parameters, values_of(exported), target)
    assert force_mg == pytest.approx(loss.values["force_mg"], abs=1e-3)
    assert rate_deg_h == pytest.approx(loss.values["rate_deg_h"], abs=0.01)
    assert f"thermal.{target}_order" in keys(exported.notes)


@pytest.mark.parametrize("target", FORMULAS)
def test_what_the_target_can_hold_is_held(target: str) -> None:
    parameters = made(5, 3, ppm=0.0, angle_rad=0.0)
    exported = export_parameters(parameters, target)
    (loss,) = told(exported.losses, "thermal.loss")
    assert loss.values["force_mg"] < 1e-3
    assert loss.values["rate_deg_h"] < 0.01
    # Without what it takes off over temperature it would be off by milli-g.
    static = {name: value * (0 if "X1" in name or "ACC1_" in name else 1) for name, value in values_of(exported).items()}
    assert largest_errors(parameters, static, target)[0] > 1


def test_the_fourth_sensor_and_device_ids() -> None:
    options = ExportOptions(instance=3, accelerometer_id=7, gyroscope_id=8)
    values = values_of(export_parameters(made(3, 2), "px4", options))
    assert [int(values["TC_A3_ID"]), int(values["TC_G3_ID"])] == [7, 8]
    assert values["TC_A3_TREF"] == np.float32(REFERENCE_DEGC)
    values = values_of(export_parameters(made(3, 2), "ardupilot", options))
    assert "INS4_TCAL_GYR3_Z" in values
    assert values["INS4_TCAL_TMIN"] <= values["INS4_ACC_CALTEMP"] <= values["INS4_TCAL_TMAX"]


def test_no_gyroscope_no_parameters_of_it() -> None:
    values = values_of(export_parameters(made(3, 2, gyroscope=False), "px4"))
    assert "TC_A_ENABLE" in values
    assert not [name for name in values if name.startswith("TC_G")]


def test_the_ids_of_the_polynomials_are_asked_for_too() -> None:
    (note,) = told(export_parameters(made(3, 2), "px4", ExportOptions(accelerometer_id=7)).notes, "px4.no_id")
    assert note.values["names"] == ["CAL_GYRO0_ID", "TC_G0_ID"]


def test_others_get_one_temperature_and_its_cost() -> None:
    parameters = made(4, 2)
    exported = export_parameters(parameters, "vectornav", ExportOptions(temperature_degc=0.0))
    there = parameters.at(0.0)
    alone = export_parameters(there, "vectornav")
    assert exported.files == alone.files
    costs = told(exported.losses, "loss.one_temperature")
    assert [cost.values["end"] for cost in costs] == [LOW_DEGC, HIGH_DEGC]
    force = GRAVITY * directions()
    raw = predict(parameters.at(HIGH_DEGC).calibration.accelerometer, force)
    off_mg = np.linalg.norm(there.apply_accelerometer(raw) - force, axis=1).max() / MG
    assert costs[1].values["force_mg"] == pytest.approx(off_mg, rel=1e-9)
    assert costs[1].values["rate_deg_h"] > 1
    with refused(UsageError, None, "px4", key="loss.all_temperatures"):
        export_parameters(parameters, "px4", ExportOptions(temperature_degc=0.0))
    for impossible in (math.nan, math.inf, HIGH_DEGC + 1):
        with refused(UsageError, key="loss.outside"):
            export_parameters(parameters, "vectornav", ExportOptions(temperature_degc=impossible))
    with refused(UsageError, key="loss.no_temperature"):
        export_parameters(made_up(4), "vectornav", ExportOptions(temperature_degc=0.0))


@pytest.mark.parametrize("target", sorted(set(TARGETS) - {"px4", "ardupilot", "c"}))
def test_every_other_target_says_so(target: str) -> None:
    exported = export_parameters(made(4, 2), target)
    assert len(told(exported.losses, "loss.one_temperature")) == 2


PROGRAM = """
#include "imufield_calibration.h"
#include <stdio.h>
int main(void)
{
    double in[7], out[6];
    while (fread(in, sizeof in[0], 7, stdin) == 7) {
        imufield_at_reference(&imufield_calibration_accelerometer_temperature, in[6], in, in);
        imufield_at_reference(&imufield_calibration_gyroscope_temperature, in[6], in + 3, in + 3);
        if (imufield_apply(&imufield_calibration, in, in + 3, out, out + 3) != IMUFIELD_OK) return 1;
        fwrite(out, sizeof out[0], 6, stdout);
    }
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed; install it to test the C export")
def test_the_c_header_computes_the_same(tmp_path: Path) -> None:
    parameters = made(6, 5)
    exported = export_parameters(parameters, "c")
    assert not exported.losses
    for name, content in exported.files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "program.c").write_text(PROGRAM)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]
    subprocess.run(["gcc", *flags, "program.c", "-o", "program"], cwd=tmp_path, check=True)
    rng = np.random.default_rng(1)
    at_degc = np.array([-60.0, -20.0, 0.0, REFERENCE_DEGC, 65.0, 90.0, np.nan])
    raw = np.hstack([rng.uniform(-20, 20, (7, 3)), rng.uniform(-2, 2, (7, 3))])
    piped = np.column_stack([raw, at_degc]).astype("<f8").tobytes()
    out = subprocess.run([tmp_path / "program"], input=piped, capture_output=True, check=True).stdout
    np.testing.assert_allclose(
        np.frombuffer(out).reshape(7, 6), parameters.apply(raw, temperature_degc=at_degc), rtol=1e-12, atol=1e-12
    )
