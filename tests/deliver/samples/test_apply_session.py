from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.samples.apply_session import TemperatureFlags, apply_session
from imufield.errors import ParameterFileError, Reason, RecordingError
from imufield.samples import Samples, SampleUnits, Status, make_samples
from tests.parameter_files import over_temperature
from tests.refused import refused

ROWS = 1000


def block(start: int = 0, units: SampleUnits | None = None) -> Samples:
    rng = np.random.default_rng(start)
    acc, gyr = rng.uniform(-20, 20, (ROWS, 3)), rng.uniform(-3, 3, (ROWS, 3))
    acc[7], gyr[7] = np.nan, np.nan
    time_s = start + np.arange(ROWS) / ROWS
    counter = np.arange(ROWS, dtype=np.int64)
    return make_samples(time_s, acc, gyr, units=units or SampleUnits(), counter=counter)


@pytest.fixture
def loaded(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    return from_document(to_document(calibration, observations, context))


def test_writes_what_apply_gives(loaded: Parameters, tmp_path: Path) -> None:
    blocks = [block(0), block(1)]
    path = tmp_path / "corrected.csv"
    assert apply_session(loaded, blocks, path, serial_number="N25581234567890") == 2 * ROWS
    table = np.genfromtxt(path, delimiter=",", names=True)
    columns = np.array(table.tolist())[:, 1:7]
    expected = [np.hstack([c.specific_force_m_s2, c.angular_rate_rad_s]) for c in map(loaded.apply, blocks)]
    np.testing.assert_array_equal(columns, np.vstack(expected))
    assert np.isnan(columns[7]).all()
    np.testing.assert_array_equal(table["counter"][:ROWS], np.arange(ROWS))


def test_increments_become_rates(loaded: Parameters, tmp_path: Path) -> None:
    units = SampleUnits(
        accelerometer="m/s", gyroscope="rad", accelerometer_is_increment=True, gyroscope_is_increment=True, interval_s=0.01
    )
    rates = block()
    increments = replace(rates, accelerometer=rates.accelerometer * 0.01, gyroscope=rates.gyroscope * 0.01, units=units)
    for name, samples in (("a", rates), ("b", increments)):
        apply_session(loaded, [samples], tmp_path / name)
    tables = [np.genfromtxt(tmp_path / name, delimiter=",", skip_header=1)[:, :7] for name in "ab"]
    np.testing.assert_allclose(tables[1], tables[0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("serial_number", "units", "reason", "key"),
    [
        ("N1", SampleUnits(), Reason.FOREIGN, "file.instrument"),
        ("", SampleUnits(accelerometer="g"), Reason.UNITS, "file.unit"),
        ("", SampleUnits(accelerometer="count", gyroscope="count"), Reason.UNITS, "file.unit"),
    ],
)
def test_another_instrument_or_unit_is_refused_and_the_old_file_stays(
    serial_number: str, units: SampleUnits, reason: Reason, key: str, loaded: Parameters, tmp_path: Path
) -> None:
    path = tmp_path / "corrected.csv"
    path.write_text("old")
    with refused(ParameterFileError, reason, key=key) as caught:
        apply_session(loaded, [block(0), block(1, units)], path, serial_number=serial_number)
    assert caught.value.exit_code == 5
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_serial_number_not_known_is_no_reason_to_refuse(loaded: Parameters, tmp_path: Path) -> None:
    assert apply_session(loaded, [block()], tmp_path / "a.csv") == ROWS


def test_memory_does_not_grow_with_the_recording(loaded: Parameters, tmp_path: Path) -> None:
    def stream(count: int) -> Iterator[Samples]:
        return (block(number) for number in range(count))

    peaks = []
    # Pieces of what is written at once follow each other in both; 60 blocks more, kept, would be twice the memory.
    for count in (20, 80):
        tracemalloc.start()
        apply_session(loaded, stream(count), tmp_path / "corrected.csv")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_rates_that_need_an_acceleration_which_is_not_there_are_refused(loaded: Parameters, tmp_path: Path) -> None:
    found = loaded.calibration.gyroscope
    assert found is not None
    path = tmp_path / "corrected.csv"
    sensitive, insensitive = (
        replace(loaded, calibration=replace(loaded.calibration, gyroscope=replace(found, parameters=gyroscope)))
        for gyroscope in (replace(found.parameters, g_sensitivity=np.eye(3) * size) for size in (1e-4, 0.0))
    )
    lacking = replace(block(), accelerometer=np.full((ROWS, 3), np.nan))
    with refused(RecordingError, Reason.BAD_DATA, key="apply_session.nothing"):
        apply_session(sensitive, [lacking, lacking], path)
    assert not path.exists()
    # A part of it may lack the acceleration, and a gyroscope alone is corrected where it needs none.
    assert apply_session(sensitive, [lacking, block(1)], path) == 2 * ROWS
    assert apply_session(insensitive, [lacking], path) == ROWS


@pytest.fixture
def warm(loaded: Parameters) -> Parameters:
    return replace(loaded, calibration=over_temperature(loaded.calibration, 1e-3))


@pytest.mark.parametrize("found", [-400.0, -100.1, 300.1, 5000.0, np.inf])
def test_a_temperature_that_no_instrument_has_is_refused(
    found: float, loaded: Parameters, warm: Parameters, tmp_path: Path
) -> None:
    at_degc = np.full(ROWS, 20.0)
    at_degc[3] = found
    blocks = [replace(block(0), temperature_degc=at_degc)]
    with refused(RecordingError, Reason.BAD_DATA, f"{found:g} degC", key="samples.impossible"):
        apply_session(warm, blocks, tmp_path / "corrected.csv")
    assert not list(tmp_path.iterdir())
    # Parameters of one temperature take none of it.
    apply_session(loaded, blocks, tmp_path / "corrected.csv")


def test_samples_beyond_the_calibrated_temperatures_are_flagged_and_counted(
    loaded: Parameters, warm: Parameters, tmp_path: Path
) -> None:
    at_degc = np.full(ROWS, np.nan)
    at_degc[10], at_degc[500] = 30.0, 50.0
    blocks = [replace(block(0), temperature_degc=at_degc), block(1)]
    flags = TemperatureFlags(warm)
    apply_session(warm, blocks, tmp_path / "corrected.csv", flags=flags)
    table = np.genfromtxt(tmp_path / "corrected.csv", delimiter=",", names=True)
    # What the second block lacks is held from the first.
    expected = np.repeat([Status.TEMPERATURE_UNKNOWN, 0, Status.TEMPERATURE_OUTSIDE], [10, 490, 500 + ROWS])
    np.testing.assert_array_equal(table["status"], expected)
    np.testing.assert_array_equal(table["temperature_degc"], np.concatenate([at_degc, block(1).temperature_degc]))
    reference = loaded.apply(block(0)).specific_force_m_s2[:, 0]
    np.testing.assert_allclose(table["ax"][:10], reference[:10], rtol=1e-12)
    assert np.all(np.abs(table["ax"][11:500] - reference[11:500] + 0.01) < 1e-4)
    assert {sentence.key: sentence.values["samples"] for sentence in flags.notes()} == {  # type: ignore[attr-defined]
        "apply_session.outside": 500 + ROWS,
        "apply_session.unknown": 10,
    }
