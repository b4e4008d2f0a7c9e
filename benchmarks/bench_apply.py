"""Use parameters: million samples/s of ``Parameters.apply``, accelerometer and gyroscope together, on one core.

The peer is the plain NumPy expression of the same linear correction, `(raw - offset) @ matrix.T` for each triad, and for the
stream to CSV the bare conversion of the same numbers to text.
"""

from __future__ import annotations

import os

# One core: the figure is for a program that does other things besides.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, print_rows, row
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    Intrinsic,
    PositionResult,
    Quality,
    SolverSummary,
)
from imufield.deliver.exports.conventions import linear_corrections
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.document import to_document
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.samples.apply_session import apply_session
from imufield.earth import Gravity
from imufield.samples import FloatArray, Samples, SampleUnits, make_samples

SAMPLES = 2_000_000
STREAMED = 200_000
ROUNDS = 7


def make_parameters(quadratic: FloatArray, g_sensitivity: FloatArray) -> Parameters:
    """Return parameters of a plausible instrument."""
    rng = np.random.default_rng(1)
    off_diagonal = rng.normal(scale=1e-3, size=(3, 3)) * (1 - np.eye(3))
    accelerometer = AccelerometerParameters(
        scale=1 + rng.normal(scale=1e-3, size=3),
        bias_m_s2=rng.normal(scale=0.02, size=3),
        misalignment_rad=off_diagonal,
        quadratic=quadratic,
    )
    gyroscope = GyroscopeParameters(np.ones(3), off_diagonal.T, np.full(3, 1e-4), g_sensitivity)
    nothing = np.zeros(3)
    calibration = Calibration(
        accelerometer=accelerometer,
        accelerometer_sigma=accelerometer,
        accelerometer_raw_unit="m/s^2",
        equation="N - raw_zero = K (T a + b) + K2 (T a)^2",
        gauge="preset",
        intrinsic=Intrinsic(**{field.name: nothing for field in fields(Intrinsic)}),
        covariance_names=(),
        covariance=np.zeros((0, 0)),
        gravity=Gravity(gravity_m_s2=9.81, sigma_m_s2=1e-4, source="typed"),
        positions=PositionResult.none(),
        solver=SolverSummary(method="least squares", status=1, message="", cost=0.0, evaluations=1),
        quality=Quality(
            residual_rms_m_s2=0.0,
            residual_max_m_s2=0.0,
            leave_one_out_rms_m_s2=0.0,
            between_position_sigma_m_s2=0.0,
            degrees_of_freedom=1,
            student_factor_95=2.0,
            rank=12,
            parameters_fitted=12,
            condition=1.0,
            verdict="good",
            reasons=(),
        ),
        quadratic_fitted=bool(np.any(quadratic)),
        gyroscope=GyroscopeCalibration(parameters=gyroscope, sigma=gyroscope, path="made up"),
    )
    empty, times = np.zeros((0, 3)), np.zeros(0)
    none = Observations(
        name=(),
        mean_raw=empty,
        covariance_raw=np.zeros((0, 3, 3)),
        gyroscope_mean_raw=empty,
        gyroscope_covariance_raw=np.zeros((0, 3, 3)),
        gyroscope_rounding_raw=np.zeros((0, 3)),
        gyroscope_noise_raw=np.full((0, 3), np.nan),
        direction=empty,
        start_s=times,
        duration_s=times,
        middle_s=np.full(0, np.nan),
        middle_rad=np.zeros((0, 3)),
        temperature_degc=times,
        units=SampleUnits(),
    )
    document = to_document(calibration, none, Context())
    return Parameters(calibration=calibration, context=Context(), document=document, version=document["version"])


def make_block(count: int) -> Samples:
    """Return random samples in SI."""
    rng = np.random.default_rng(2)
    return make_samples(np.arange(count) / 2000, rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), units=SampleUnits())


def _million_per_s(work: Callable[[], object], count: int, rounds: int = ROUNDS) -> float:
    best = float("inf")
    for _ in range(rounds):
        begin = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begin)
    return count / best / 1e6


def _plain(parameters: Parameters, samples: Samples) -> tuple[FloatArray, FloatArray]:
    corrections = linear_corrections(parameters.calibration)
    assert corrections.gyroscope is not None
    return corrections.accelerometer.apply(samples.accelerometer), corrections.gyroscope.apply(samples.gyroscope)


def _stream(parameters: Parameters, folder: str) -> None:
    block = make_block(8192)

    def blocks() -> Iterator[Samples]:
        for start in range(0, STREAMED, len(block)):
            yield replace(block, time_s=block.time_s + start / 2000)

    apply_session(parameters, blocks(), Path(folder) / "corrected.csv")


def _streamed(parameters: Parameters) -> list[Row]:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory() as folder:
        rate = _million_per_s(lambda: _stream(parameters, folder), STREAMED, 1)
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return [row("stream to CSV", rate, "million samples/s"), row("stream to CSV, peak memory more than before", more, "MiB")]


def run() -> list[Row]:
    """Return one row for each figure: name, value, unit, peer's value and ratio (None where there is no peer)."""
    linear = make_parameters(np.zeros(3), np.zeros((3, 3)))
    sensitive = make_parameters(np.zeros(3), np.full((3, 3), 1e-5))
    quadratic = make_parameters(np.full(3, 1e-6), np.zeros((3, 3)))
    streamed = _streamed(linear)  # first: memory that later figures take would hide what this one takes
    samples, small = make_block(SAMPLES), make_block(4096)
    columns = np.hstack([samples.accelerometer, samples.gyroscope])
    unit = "million samples/s"
    peer = _million_per_s(lambda: _plain(linear, samples), SAMPLES)
    rows = [
        row("linear, block of 2 million", _million_per_s(lambda: linear.apply(samples), SAMPLES), unit, peer),
        row("linear, array of six columns", _million_per_s(lambda: linear.apply(columns), SAMPLES), unit, peer),
        row("linear, blocks of 4096", _million_per_s(lambda: linear.apply(small), len(small), 200), unit),
        row("with g-sensitivity", _million_per_s(lambda: sensitive.apply(samples), SAMPLES), unit, peer),
        row("with quadratic term", _million_per_s(lambda: quadratic.apply(samples), SAMPLES), unit),
    ]
    return [*rows, *streamed]


def main() -> None:
    """Print the figures as a table."""
    print_rows(run())


if __name__ == "__main__":
    main()
