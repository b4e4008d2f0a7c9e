"""The formulas of the targets, written from their documentation: what each makes of the file it is given."""

from __future__ import annotations

import importlib.util
import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imucal
import numpy as np
import yaml

Formula = Callable[[dict[str, bytes], np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray | None]]
"""Files, raw acceleration and rate in the unit the target works in -> corrected acceleration and rate in SI."""
G0 = 9.80665


def square(values: list[float]) -> np.ndarray:
    return np.array(values, dtype=float).reshape(3, 3)


def vectornav(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    registers = {}
    for line in files["vectornav.txt"].decode().split("\r\n"):
        if match := re.fullmatch(r"\$VNWRG,(\d\d),([^*]*)\*[0-9A-F]{2}", line):
            registers[int(match[1])] = [float(value) for value in match[2].split(",")]
    out = [(raw - registers[number][9:]) @ square(registers[number][:9]).T for number, raw in ((25, acc), (84, gyr))]
    return out[0], out[1]


def kalibr_imu(files: dict[str, bytes]) -> tuple[dict[str, Any], list[list[float]]]:
    (content,) = files.values()
    text = content.decode().replace("%YAML:1.0\n", "")
    biases = [yaml.safe_load(match) for match in re.findall(r"bias, \S+: (\[.*\])", text)]
    return yaml.safe_load(text)["imu0"], biases


def kalibr(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    imu, biases = kalibr_imu(files)
    M, Mg = np.array(imu["accelerometers"]["M"]), np.array(imu["gyroscopes"]["M"])
    C, A = np.array(imu["gyroscopes"]["C_gyro_i"]), np.array(imu["gyroscopes"]["A"])
    assert np.all(np.triu(M, 1) == 0)
    assert np.all(np.triu(Mg, 1) == 0)
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(C) > 0
    a = np.linalg.solve(M, (acc - biases[0]).T).T
    return a, np.linalg.solve(Mg @ C, (gyr - biases[1] - a @ (A @ C).T).T).T


def openvins(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    imu, biases = kalibr_imu(files)
    Ta, Tw, Tg, Ra, Rw = (np.array(imu[name]) for name in ("Ta", "Tw", "Tg", "R_IMUtoACC", "R_IMUtoGYRO"))
    a = (acc - biases[0]) @ (Ra.T @ np.linalg.inv(Ta)).T
    return a, (gyr - biases[1] - a @ Tg.T) @ (Rw.T @ np.linalg.inv(Tw)).T


def basalt(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    values = json.loads(files["calibration.json"])["value0"]
    bx, by, bz, s1, s2, s3, s4, s5, s6 = values["calib_accel_bias"]
    a = acc @ np.array([[1 + s1, 0, 0], [s2, 1 + s4, 0], [s3, s5, 1 + s6]]).T - [bx, by, bz]
    full = np.array(values["calib_gyro_bias"])
    S = np.column_stack([full[3:6], full[6:9], full[9:12]])
    return a, gyr + gyr @ S.T - full[:3]


def realsense(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    imu = json.loads(files["calibration.json"])["imus"][0]
    # rs-imu-calibration.py fits X of [raw, -1] X = true, and writes its twelve numbers one after the other.
    X = {name: np.reshape([*triad["scale_and_alignment"], *triad["bias"]], (4, 3)) for name, triad in imu.items()}
    ones = -np.ones((len(acc), 1))
    return np.hstack([acc, ones]) @ X["accelerometer"], np.hstack([gyr, ones]) @ X["gyroscope"]


def dlio(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    intrinsics = yaml.safe_load(files["dlio.yaml"])["dlio"]["imu"]["intrinsics"]
    return acc @ square(intrinsics["accel"]["sm"]).T - intrinsics["accel"]["bias"], None


def imu_calib(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    values = yaml.safe_load(files["imu_calib.yaml"])
    return acc @ square(values["SM"]).T - values["bias"], None


def imu_tk(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    out = []
    for name, raw in (("imu_tk_acc.calib", acc), ("imu_tk_gyro.calib", gyr)):
        T, K, bias = (np.array([[float(x) for x in row.split()] for row in block.splitlines()])
                      for block in files[name].decode().split("\n\n"))  # fmt: skip
        assert np.all(np.diag(T) == 1)
        assert np.all(np.diag(np.diag(K)) == K)
        assert "gyro" in name or np.all(np.tril(T, -1) == 0)
        out.append((raw - bias.ravel()) @ (T @ K).T)
    return out[0], out[1]


def imucal_package(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    text = files["imucal.json"].decode()
    info = imucal.ferraris_calibration_info.FerrarisCalibrationInfo.from_json(text)
    units = json.loads(text)
    a, w = info.calibrate(acc, gyr, units["from_acc_unit"], units["from_gyr_unit"])
    return a, np.radians(w)


def imucal_formula(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    v = {key: np.array(value) for key, value in json.loads(files["imucal.json"]).items() if key[1] == "_" and key[0] in "KRb"}
    np.testing.assert_allclose(np.linalg.norm(v["R_a"], axis=1), 1)
    a = np.linalg.solve(v["K_a"] @ v["R_a"], (acc - v["b_a"]).T).T
    return a, np.radians(np.linalg.solve(v["K_g"] @ v["R_g"], (gyr - a @ v["K_ga"].T - v["b_g"]).T).T)


def psins(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    text = files["imufield_clbt.m"].decode()
    clbt = {name: np.array([[float(x) for x in row.split(",")] for row in body.split(";")])
            for name, body in re.findall(r"clbt\.(\w+) = \[([^\]]*)\]", text)}  # fmt: skip
    ts = 0.01
    wm, vm = gyr * ts, acc * ts
    ka2 = clbt["Ka2"].ravel()
    out_v = vm @ clbt["Ka"].T - clbt["db"].ravel() * ts - ka2 * vm**2 / ts
    out_w = wm @ clbt["Kg"].T - clbt["eb"].ravel() * ts - vm @ clbt.get("gSens", np.zeros((3, 3))).T
    return out_v / ts, out_w / ts


def pyins_module(files: dict[str, bytes], folder: Path) -> object:
    path = folder / "imufield_pyins.py"
    path.write_bytes(files["imufield_pyins.py"])
    spec = importlib.util.spec_from_file_location("imufield_pyins", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


WITH_G: dict[str, Formula] = {"kalibr": kalibr, "openvins": openvins, "imucal": imucal_package, "psins": psins}
FORMULAS: dict[str, Formula] = WITH_G | {
    "vectornav": vectornav,
    "basalt": basalt,
    "realsense": realsense,
    "dlio": dlio,
    "imu_calib": imu_calib,
    "imu_tk": imu_tk,
}
TURNED = {"kalibr", "openvins", "basalt", "imu_tk", "psins"}
RAW_UNITS_KEPT = {"imu_tk", "imucal"}


def px4(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows = [line.split("\t") for line in files["px4.params"].decode().splitlines() if not line.startswith("#")]
    p = {name: float(value) for _, _, name, value, _ in rows}
    offset, scale, gyroscope = (np.array([p[name.format(axis)] for axis in "XYZ"])
                                for name in ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF"))  # fmt: skip
    # What Accelerometer::set_offset and set_scale do of a new start: nothing where the vector hardly changes.
    taken, factor = np.zeros(3), np.ones(3)
    if np.linalg.norm(taken - offset) > 0.01:
        taken = offset
    if np.linalg.norm(factor - scale) > 0.01:
        factor = scale
    return (acc - taken) * factor, gyr - gyroscope


def ardupilot(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows = [line.split(",") for line in files["ardupilot.param"].decode().splitlines() if not line.startswith("#")]
    p = {name: float(value) for name, value in rows}
    offset, scale, gyroscope = (np.array([p[f"INS_{name}_{axis}"] for axis in "XYZ"])
                                for name in ("ACCOFFS", "ACCSCAL", "GYROFFS"))  # fmt: skip
    return (acc - offset) * scale, gyr - gyroscope


def microstrain(files: dict[str, bytes], acc: np.ndarray, gyr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    stream, bias = files["microstrain.bin"], {}
    while stream:
        length = stream[3]
        payload, stream = stream[4 : 4 + length], stream[6 + length :]
        if payload[2] == 1:
            bias[payload[1]] = np.array(struct.unpack(">3f", payload[3:]))
    return (acc / G0 - bias[0x37]) * G0, gyr - bias[0x38]


DIAGONAL = {"px4": px4, "ardupilot": ardupilot, "microstrain": microstrain}
