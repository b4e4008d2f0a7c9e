"""The C header compiled by the strictest compiler flags, and the binary block read by C and by Python."""

from __future__ import annotations

import shutil
import struct
import subprocess
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_instruments import made_up

from imufield.deliver.exports import ExportOptions, export_parameters
from imufield.deliver.exports.binary import SIZE, unpack
from imufield.deliver.parameters.file import Parameters
from imufield.errors import ParameterFileError, Reason, UsageError
from tests.refused import refused
from tests.told import keys

pytestmark = pytest.mark.numerical

GCC, GXX = shutil.which("gcc"), shutil.which("g++")
FLAGS = ["-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic", "-O1"]
needs_gcc = pytest.mark.skipif(GCC is None, reason="gcc is not installed; install it to test the C export")

PROGRAM = """
#include "imufield_calibration.h"
#include <stdio.h>
int main(void)
{
    imufield_real raw[6], force[3], rate[3];
    double in[6];
    while (fread(in, sizeof in[0], 6, stdin) == 6) {
        double out[7];
        int i;
        for (i = 0; i < 6; i++) raw[i] = (imufield_real)in[i];
        force[0] = force[1] = force[2] = rate[0] = rate[1] = rate[2] = 7;
        out[6] = imufield_apply(&imufield_calibration, raw, raw + 3, force, rate);
        for (i = 0; i < 3; i++) { out[i] = force[i]; out[3 + i] = rate[i]; }
        fwrite(out, sizeof out[0], 7, stdout);
    }
    return 0;
}
"""
READER = """
#include "imufield_apply.h"
#include <stdio.h>
int main(void)
{
    static unsigned char block[4096];
    const double in[6] = {1.0, -2.0, 9.5, 0.1, -0.2, 0.3};
    double force[3] = {0, 0, 0}, rate[3] = {0, 0, 0};
    imufield_parameters p;
    const size_t size = fread(block, 1, sizeof block, stdin);
    int status = imufield_read(block, size, &p);
    if (status == IMUFIELD_OK) status = imufield_apply(&p, in, in + 3, force, rate);
    printf("%d %.17g %.17g %.17g %.17g %.17g %.17g\\n", status, force[0], force[1], force[2], rate[0], rate[1], rate[2]);
    return 0;
}
"""
TWO_FILES = """
#include "imufield_calibration.h"
#include "imufield_calibration.h"
#include "second.h"
int main(void)
{
    return imufield_calibration.has_gyroscope + second.has_gyroscope - 2;
}
"""


def build(folder: Path, source: str, files: dict[str, bytes], compiler: list[str]) -> Path:
    for name, content in files.items():
        (folder / name).write_bytes(content)
    path = folder / "program.c"
    path.write_text(source)
    program = folder / "program"
    done = subprocess.run([*compiler, *FLAGS, str(path), "-o", str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


def run(program: Path, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    done = subprocess.run([program], input=rows.astype("<f8").tobytes(), capture_output=True, check=True)
    out = np.frombuffer(done.stdout, dtype="<f8").reshape(-1, 7)
    return out[:, :3], out[:, 3:6], out[:, 6]


def compiled(folder: Path, parameters: Parameters, options: ExportOptions | None = None) -> Path:
    """Return the program that applies the exported header, built by gcc."""
    return build(folder, PROGRAM, dict(export_parameters(parameters, "c", options).files), [str(GCC), "-std=c99"])


def expected(parameters: Parameters, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    force = parameters.apply_accelerometer(rows[:, :3])
    return force, parameters.apply_gyroscope(rows[:, 3:], force)


def close(theirs: np.ndarray, ours: np.ndarray, relative: float) -> None:
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=relative * np.abs(ours).max())


def raw_rows(scale: tuple[float, float] = (1.0, 1.0), zero: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.hstack([rng.uniform(-30, 30, (300, 3)) * scale[0] + zero, rng.uniform(-5, 5, (300, 3)) * scale[1] + zero])


MODELS: dict[str, dict[str, Any]] = {
    "linear": {},
    "quadratic": {"quadratic": 2e-4},
    "body axes": {"quadratic": 2e-4, "axes": "body", "angle_rad": 0.02},
    "counts": {
        "units": ("count", "count"), "scale": (1670.7, -7509.9), "raw_zero": 32768.0, "quadratic": 1e-5, "g_sensitivity": 1e-4
    },
    "reversed": {"sign": (-1.0, -1.0, 1.0), "quadratic": 1e-4},
}  # fmt: skip


@needs_gcc
@pytest.mark.parametrize("model", MODELS)
def test_c_equals_python(model: str, tmp_path: Path) -> None:
    parameters = made_up(2, **MODELS[model])
    exported = export_parameters(parameters, "c")
    assert exported.losses == ()
    rows = raw_rows((1670.7, 7509.9), 32768.0) if model == "counts" else raw_rows()
    force, rate, status = run(build(tmp_path, PROGRAM, dict(exported.files), [str(GCC), "-std=c99"]), rows)
    assert not status.any()
    ours = expected(parameters, rows)
    close(force, ours[0], 1e-12)
    close(rate, ours[1], 1e-12)


@needs_gcc
@pytest.mark.parametrize(("model", "relative"), [("quadratic", 3e-6), ("body axes", 3e-6)])
def test_single_precision(model: str, relative: float, tmp_path: Path) -> None:
    parameters = made_up(3, **MODELS[model])
    compiler = [str(GCC), "-std=c99", "-DIMUFIELD_REAL=float"]
    program = build(tmp_path, PROGRAM, dict(export_parameters(parameters, "c").files), compiler)
    force, rate, status = run(program, raw_rows())
    assert not status.any()
    ours = expected(parameters, raw_rows())
    close(force, ours[0], relative)
    close(rate, ours[1], relative)


@pytest.mark.skipif(GXX is None, reason="g++ is not installed; install it to test the C export from C++")
def test_header_is_also_cpp(tmp_path: Path) -> None:
    parameters = made_up(4)
    program = build(tmp_path, PROGRAM, dict(export_parameters(parameters, "c").files), [str(GXX), "-x", "c++", "-std=c++11"])
    close(run(program, raw_rows())[0], expected(parameters, raw_rows())[0], 1e-12)


@needs_gcc
def test_two_instruments_in_one_program(tmp_path: Path) -> None:
    first = export_parameters(made_up(5), "c").files
    second = export_parameters(made_up(6), "c", ExportOptions(name="second")).files
    program = build(tmp_path, TWO_FILES, {**first, **second}, [str(GCC), "-std=c99"])
    assert subprocess.run([program], check=False).returncode == 0


@needs_gcc
def test_output_without_a_solution_is_told_and_changes_nothing(tmp_path: Path) -> None:
    parameters = made_up(7, quadratic=0.02)
    quadratic = parameters.calibration.accelerometer.quadratic
    rows = np.hstack([-np.sign(quadratic) * 1e4, np.zeros(3)])[None]
    force, rate, status = run(compiled(tmp_path, parameters), rows)
    np.testing.assert_array_equal(status, -1)
    np.testing.assert_array_equal(force, 7)
    np.testing.assert_array_equal(rate, 7)


@needs_gcc
def test_without_gyroscope(tmp_path: Path) -> None:
    parameters = made_up(8, gyroscope=False)
    force, rate, status = run(compiled(tmp_path, parameters), raw_rows())
    close(force, parameters.apply_accelerometer(raw_rows()[:, :3]), 1e-12)
    np.testing.assert_array_equal(status, -2)
    np.testing.assert_array_equal(rate, 7)


@needs_gcc
def test_nan_stays_nan(tmp_path: Path) -> None:
    parameters = made_up(9, quadratic=1e-4)
    rows = raw_rows()[:1]
    rows[0, 1] = np.nan
    force, _, _ = run(compiled(tmp_path, parameters), rows)
    np.testing.assert_array_equal(np.isnan(force), np.isnan(expected(parameters, rows)[0]))


@needs_gcc
@pytest.mark.parametrize("gauge", ["lower", "upper", "symmetric"])
def test_gauge_on_request(gauge: str, tmp_path: Path) -> None:
    parameters = made_up(10, gauge="preset", quadratic=1e-4, g_sensitivity=1e-4)
    exported = export_parameters(parameters, "c", ExportOptions(gauge=gauge))  # type: ignore[arg-type]
    force, rate, _ = run(build(tmp_path, PROGRAM, dict(exported.files), [str(GCC), "-std=c99"]), raw_rows())
    ours = expected(parameters, raw_rows())
    left, _, right = np.linalg.svd(force.T @ ours[0])
    R = left @ right
    close(force, ours[0] @ R.T, 1e-12)
    close(rate, ours[1] @ R.T, 1e-12)
    assert "job.turned" in keys(exported.notes)


def test_gauge_cannot_be_had_with_the_quadratic_term_on_body_axes() -> None:
    parameters = made_up(11, quadratic=1e-4, axes="body")
    with refused(UsageError, Reason.USAGE, "gauge = upper", key="whole_model.gauge"):
        export_parameters(parameters, "c", ExportOptions(gauge="upper"))


@pytest.mark.parametrize("name", ["my-imu", "9", "", "a\nb", "imufield_parameters", "int"])
def test_a_name_that_is_none_in_c(name: str) -> None:
    with refused(UsageError, Reason.USAGE) as caught:
        export_parameters(made_up(12), "c", ExportOptions(name=name))
    assert caught.value.values["name"] == name


def read_by_c(program: Path, block: bytes) -> tuple[int, list[float]]:
    out = subprocess.run([program], input=block, capture_output=True, check=True).stdout.split()
    return int(out[0]), [float(value) for value in out[1:]]


@needs_gcc
@pytest.mark.parametrize("model", MODELS)
def test_block_read_by_c_corrects_as_python(model: str, tmp_path: Path) -> None:
    parameters = made_up(13, **MODELS[model])
    files = dict(export_parameters(parameters, "binary").files)
    program = build(tmp_path, READER, files, [str(GCC), "-std=c99"])
    status, values = read_by_c(program, files["imufield_parameters.bin"])
    ours = expected(parameters, np.array([[1.0, -2.0, 9.5, 0.1, -0.2, 0.3]]))
    assert status == 0
    # Counts near zero lie 2^15 counts off the middle: there the corrected value is large.
    np.testing.assert_allclose(values, np.hstack(ours)[0], rtol=1e-12, atol=1e-12)


def with_new_crc(block: bytes) -> bytes:
    return block[:-4] + struct.pack("<I", zlib.crc32(block[:-4]))


@needs_gcc
def test_every_damage_is_told(tmp_path: Path) -> None:
    files = dict(export_parameters(made_up(14), "binary").files)
    block = files["imufield_parameters.bin"]
    program = build(tmp_path, READER, files, [str(GCC), "-std=c99"])
    assert len(block) == SIZE == 472
    flipped = bytearray(block)
    flipped[200] ^= 1
    damages = {
        b"": (-3, Reason.DAMAGED, "foreign"),
        block[:100]: (-3, Reason.DAMAGED, "cut"),
        b"X" + block[1:]: (-4, Reason.DAMAGED, "foreign"),
        with_new_crc(block[:8] + b"\x02\x00" + block[10:]): (-5, Reason.NEWER, "newer"),
        with_new_crc(block[:10] + b"\xd0\x01" + block[12:]): (-6, Reason.DAMAGED, "damaged"),
        bytes(flipped): (-6, Reason.DAMAGED, "damaged"),
    }
    for damaged, (status, reason, key) in damages.items():
        assert read_by_c(program, damaged)[0] == status
        with refused(ParameterFileError, reason, key=f"binary.{key}"):
            unpack(damaged)
    assert read_by_c(program, block + b"more")[0] == 0


def test_block_says_where_it_comes_from() -> None:
    parameters = made_up(15, quadratic=1e-5)
    block = export_parameters(parameters, "binary").files["imufield_parameters.bin"]
    content = unpack(block)
    assert content["serial_number"] == "N25581"
    assert content["accelerometer_raw_unit"] == "m/s^2"
    assert content["created"] == "2025-03-01T10:55:00Z"
    np.testing.assert_array_equal(content["site"], [9.8071, 30.9, 33.4])
    np.testing.assert_array_equal(content["quadratic"], parameters.calibration.accelerometer.quadratic)
    # The layout as documented, by hand: the first scale is the float64 at byte 104.
    assert struct.unpack_from("<d", block, 104)[0] == parameters.calibration.accelerometer.scale[0]
    assert struct.unpack_from("<I", block, 468)[0] == zlib.crc32(block[:468])


def test_serial_number_longer_than_the_block_holds() -> None:
    from dataclasses import replace

    parameters = made_up(16)
    context = replace(parameters.context, instrument=replace(parameters.context.instrument, serial_number=33 * "9"))
    with refused(ParameterFileError, Reason.BOUNDS, "33 bytes", "32", key="binary.text_size"):
        export_parameters(replace(parameters, context=context), "binary")
