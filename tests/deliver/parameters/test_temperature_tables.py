"""Bias and scale over temperature in the parameter file: version 2, round trip, what is refused, and what apply makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from imufield.calibrate.model.models import at_temperature, predict
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.calibrate.model.temperature_polynomials import NewDay, Polynomials, TriadTemperature
from imufield.deliver.parameters.context import Context, TemperatureSource
from imufield.deliver.parameters.file import (
    Parameters,
    json_ready,
    load,
    parameter_schema,
    to_document,
    to_toml,
    write_parameters,
)
from imufield.errors import ParameterFileError, Reason
from imufield.pipeline.solving import lost_by_replacing
from imufield.samples import SampleUnits, Status, TemperatureHold, make_samples
from tests.parameter_files import edit
from tests.refused import refused
from tests.told import told

SOURCES = (
    TemperatureSource("cold", "session", 64 * "a", (-19.0, -17.5)),
    TemperatureSource("warm-up", "ramp", "", (-20.0, 55.0)),
)


def over_temperature(order: int, unit: float) -> TriadTemperature:
    rng = np.random.default_rng(order)
    size = unit * 50.0 ** -np.arange(1, order + 1)[:, None]
    roots = rng.normal(size=(3, order, order)) * size.ravel()[:, None]
    roots_of_scale = 1e-6 * rng.normal(size=(3, 1, 1))
    return TriadTemperature(
        reference_degc=32.15,
        range_degc=(-20.0, 55.0),
        bias=Polynomials(size * rng.normal(size=(order, 3)), roots @ roots.transpose(0, 2, 1)),
        scale=Polynomials(1e-5 * rng.normal(size=(1, 3)), roots_of_scale**2),
        hysteresis=np.array([1e-3, 2e-3, np.nan]) * unit,
        scale_separated=True,
        new_day=NewDay(
            bias=np.full(3, 0.1 * unit),
            scale=np.array([1e-5, 2e-5, np.nan]),
            bias_covariance=np.array([np.diag([1.0, *size.ravel()]) ** 2 * unit**2] * 3),
            scale_covariance=np.array([np.diag([1e-5, 1e-6]) ** 2] * 3),
            bias_scale_covariance=np.array([0.5 * unit * 1e-5 * np.eye(order + 1, 2) * [1.0, 0.0]] * 3),
            bias_freedom=6.0,
            scale_freedom=3.0,
        ),
        bias_scale_covariance=1e-3 * roots[:, :, :1] * roots_of_scale,
    )


@pytest.fixture
def with_temperature(calibration: Calibration, observations: Observations, context: Context) -> tuple[Calibration, Context]:
    assert calibration.gyroscope is not None
    gyroscope = replace(calibration.gyroscope, temperature=over_temperature(2, 1e-3))
    both = replace(calibration, accelerometer_temperature=over_temperature(5, 0.1), gyroscope=gyroscope)
    return both, replace(context, temperature_sources=SOURCES)


@pytest.fixture
def loaded(with_temperature: tuple[Calibration, Context], observations: Observations, tmp_path: Path) -> Parameters:
    write_parameters(tmp_path / "parameters.toml", with_temperature[0], observations, with_temperature[1])
    return load(tmp_path)


def test_a_file_with_temperature_is_version_2_and_comes_back_digit_by_digit(
    loaded: Parameters, with_temperature: tuple[Calibration, Context], observations: Observations
) -> None:
    assert loaded.version == loaded.document["version"] == 2
    jsonschema.validate(json_ready(loaded.document), parameter_schema())
    again = to_document(loaded.calibration, observations, loaded.context)
    assert json_ready(again) == json_ready(to_document(*with_temperature[:1], observations, with_temperature[1]))
    assert loaded.context.temperature_sources == SOURCES


def test_the_range_is_that_of_both_triads(
    with_temperature: tuple[Calibration, Context], observations: Observations, tmp_path: Path
) -> None:
    calibration, context = with_temperature
    gyroscope, path = calibration.gyroscope, tmp_path / "parameters.toml"
    assert gyroscope is not None
    assert gyroscope.temperature is not None
    narrow = replace(gyroscope, temperature=replace(gyroscope.temperature, range_degc=(-5.0, 70.0)))
    write_parameters(path, replace(calibration, gyroscope=narrow), observations, context)
    both = load(path)
    assert both.temperature_range_degc == (-5.0, 55.0)
    assert np.isnan(both.at(30.0).temperature_range_degc).all()
    # What solving again loses is the same range, and not that of the first triad.
    (lost,) = told(lost_by_replacing(path, both.at(30.0)), "solving.lost_temperature")
    assert (lost.values["low"], lost.values["high"]) == (-5.0, 55.0)


def test_without_temperature_it_is_version_1_as_before(
    calibration: Calibration, observations: Observations, context: Context, tmp_path: Path
) -> None:
    path = tmp_path / "parameters.toml"
    write_parameters(path, calibration, observations, context)
    text = path.read_text(encoding="utf-8")
    assert "version = 1" in text
    assert "temperature_source" not in text
    parameters = load(path)
    assert parameters.version == 1
    assert parameters.at(70.0) is parameters
    assert not parameters.temperature_status(np.array([np.nan])).any()


@pytest.mark.parametrize(
    ("old", "new", "fact"),
    [
        ("version = 2", "version = 1", "accelerometer.temperature"),
        ("reference_degc = 32.15", "reference_degc = 60.0", "accelerometer.temperature.reference_degc"),
        ("range_degc = [-20.0, 55.0]", "range_degc = [40.0, 55.0]", "accelerometer.temperature.reference_degc"),
        ("range_degc = [-20.0, 55.0]", "range_degc = [55.0, -20.0]", "accelerometer.temperature.range_degc"),
        ("range_degc = [-20.0, 55.0]", "range_degc = [32.1, 32.2]", "accelerometer.temperature.range_degc"),
        ("scale_separated = true", "scale_separated = true\nhidden = 1", "accelerometer.temperature.hidden"),
        (
            "scale_separated = true",
            "scale_separated = true\nsessions = {temperature_degc = [], bias_m_s2 = [], scale = []}",
            "accelerometer.temperature.sessions.temperature_degc",
        ),
    ],
)
@pytest.mark.usefixtures("loaded")
def test_what_contradicts_itself_is_refused(tmp_path: Path, old: str, new: str, fact: str) -> None:
    with refused(ParameterFileError, None, "parameters.toml", fact):
        load(edit(tmp_path / "parameters.toml", old, new))


@pytest.mark.parametrize(
    ("values", "fact"),
    [
        ({"scale_covariance": [[[-1.0]], [[0.0]], [[0.0]]]}, "scale_covariance"),
        ({"scale_covariance": [[[1.0]], [[1.0, 0.0]], [[1.0]]]}, "scale_covariance"),
        ({"scale": [[0.02, 0.0, 0.0]]}, "scale"),
        ({"bias_scale_covariance": [[[0.0]], [[0.0]], [[0.0]]]}, "bias_scale_covariance"),
        ({"bias_scale_covariance": [[[1.0]] * 5] * 3}, "bias_scale_covariance"),
    ],
)
def test_numbers_that_cannot_be_are_refused(loaded: Parameters, tmp_path: Path, values: dict[str, object], fact: str) -> None:
    table = loaded.document["accelerometer"]
    document = loaded.document | {"accelerometer": table | {"temperature": table["temperature"] | values}}
    path = tmp_path / "p.toml"
    path.write_text(to_toml({key: value for key, value in document.items() if key != "integrity"}), encoding="utf-8")
    with refused(ParameterFileError, Reason.DAMAGED, "accelerometer.temperature", fact):
        load(path)


def test_an_older_file_has_no_covariance_between_bias_and_scale(loaded: Parameters, tmp_path: Path) -> None:
    document = {key: value for key, value in loaded.document.items() if key != "integrity"}
    for triad in ("accelerometer", "gyroscope"):
        table = dict(document[triad]["temperature"])
        table["new_day"] = {key: value for key, value in table["new_day"].items() if key != "bias_scale_covariance"}
        del table["bias_scale_covariance"]
        document[triad] = document[triad] | {"temperature": table}
    path = tmp_path / "older.toml"
    path.write_text(to_toml(document), encoding="utf-8")
    for model in load(path).temperature_models:
        assert model.bias_scale_covariance is None
        assert model.new_day is not None
        assert not model.new_day.bias_scale_covariance.any()


def test_apply_undoes_what_the_temperature_did(loaded: Parameters) -> None:
    calibration, force = loaded.calibration, np.random.default_rng(1).normal(scale=8, size=(5, 3))
    assert calibration.accelerometer_temperature is not None
    at_degc = np.array([-30.0, -20.0, 10.0, 32.15, 70.0])
    raw = np.vstack(
        [
            predict(at_temperature(calibration.accelerometer, calibration.accelerometer_temperature, degc), row)
            for degc, row in zip(at_degc, force, strict=True)
        ]
    )
    np.testing.assert_allclose(loaded.apply_accelerometer(raw, temperature_degc=at_degc), force, atol=1e-9)
    assert np.abs(loaded.apply_accelerometer(raw) - force).max() > 1e-3
    both = np.hstack([raw, 0.1 * force])
    corrected = loaded.apply(both, temperature_degc=at_degc)
    np.testing.assert_allclose(corrected[:, :3], force, atol=1e-9)
    np.testing.assert_allclose(loaded.apply(both[None], temperature_degc=at_degc[None])[0], corrected, rtol=1e-12)
    for row, degc in enumerate(at_degc):
        np.testing.assert_allclose(loaded.at(degc).apply(both[row]), corrected[row], atol=1e-9)
    assert loaded.at(10.0).context.session.temperature_degc == (10.0, 10.0)


def test_samples_hold_the_last_temperature_and_the_unknown_use_the_reference(loaded: Parameters) -> None:
    raw = np.random.default_rng(2).normal(scale=5, size=(4, 6))
    samples = make_samples(
        np.arange(4.0), raw[:, :3], raw[:, 3:], units=SampleUnits(), temperature_degc=np.array([np.nan, -10.0, np.nan, 60.0])
    )
    corrected = loaded.apply(samples)
    expected = loaded.apply(raw, temperature_degc=np.array([32.15, -10.0, -10.0, 60.0]))
    np.testing.assert_allclose(np.hstack(corrected[1:]), expected, rtol=1e-12)
    hold = TemperatureHold()
    blocks = [loaded.apply(hold.fill(samples[part])) for part in (slice(2), slice(2, 2), slice(2, 3), slice(3, 4))]
    np.testing.assert_allclose(np.vstack([np.hstack(block[1:]) for block in blocks]), expected, rtol=1e-12)
    flagged = loaded.temperature_status(samples)
    assert flagged.tolist() == [Status.TEMPERATURE_UNKNOWN, 0, 0, Status.TEMPERATURE_OUTSIDE]
    status = loaded.temperature_status(np.array([np.nan, 0.0, 60.0]))
    assert status.tolist() == [Status.TEMPERATURE_UNKNOWN, 0, Status.TEMPERATURE_OUTSIDE]


def test_observations_become_those_of_the_reference(loaded: Parameters, observations: Observations) -> None:
    there = loaded.observed_at_reference(observations)
    expected = loaded.apply_accelerometer(observations.mean_raw, temperature_degc=observations.temperature_degc)
    np.testing.assert_allclose(loaded.apply_accelerometer(there.mean_raw), expected, rtol=1e-12)
