"""Each axis has its own thermometer, as in a STIM300: from the wire to parameters over temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol, parse_protocol
from imufield.deliver.parameters.file import Parameters, from_document, load, write_document
from imufield.errors import ProtocolError
from imufield.pipeline.chain import Chain, ReadingPlan
from imufield.pipeline.temperature import with_temperature
from imufield.samples import Samples, SampleUnits, concatenate, make_samples
from imufield.simulate.wire.stim300 import Stim300Encoder, Stim300Format
from tests.pipeline.test_over_temperature import GRAVITY, outputs, ramp, solved
from tests.refused import refused
from tests.told import keys

pytestmark = pytest.mark.numerical

# Of each session: the sensors of ax ay az gx gy gz less the instrument. Days differ in how the instrument is heated.
OFFSETS = {
    -18.0: (1.5, -1.0, -0.5, 2.0, 2.0, 2.0),
    0.0: (0.8, 1.0, -1.8, 1.0, 1.0, 1.0),
    20.0: (0.3, 0.2, -0.5, 1.0, 1.0, 1.0),
    38.0: (-0.5, -1.0, 1.5, 1.0, 1.0, 1.0),
    55.0: (-1.2, 1.8, -0.6, 0.0, 0.0, 0.0),
}


def sent(n: int = 200, settings: Stim300Format | None = None) -> Samples:
    """Return what is decoded of a STIM300 whose axes are 1 to 6 degC above 20."""
    own = np.tile(20.0 + np.arange(1, 7), (n, 1))
    zeros = np.zeros((n, 3))
    units = load_protocol("stim300").units
    samples = make_samples(
        np.arange(n) / 100, zeros, zeros, units=units, temperature_degc=np.full(n, 22.0), counter=np.arange(n)
    )
    frames = Stim300Encoder(settings or Stim300Format(temperature=True)).encode(replace(samples, sensor_temperature_degc=own))
    decoder = Decoder(load_protocol("stim300"))
    return decoder.feed(frames.tobytes(), 0.0)


def test_each_axis_comes_with_its_own() -> None:
    samples = sent()
    assert samples.sensor_temperature_degc is not None
    np.testing.assert_array_equal(samples.sensor_temperature_degc, np.tile(20.0 + np.arange(1, 7), (len(samples), 1)))
    np.testing.assert_array_equal(samples.temperature_degc, 22.0)  # The mean of the accelerometer's, as ever.
    assert samples[:3].sensor_temperature_degc.shape == (3, 6)


def test_a_triad_that_is_not_there_has_none() -> None:
    own = sent(settings=Stim300Format(accelerometer=False, inclinometer=False, temperature=True)).sensor_temperature_degc
    assert own is not None
    assert np.isnan(own[:, :3]).all()
    np.testing.assert_array_equal(own[0, 3:], [24.0, 25.0, 26.0])


def test_blocks_without_join_those_with() -> None:
    samples = sent()
    joined = concatenate([replace(samples, sensor_temperature_degc=None), samples])
    assert joined.sensor_temperature_degc is not None
    assert np.isnan(joined.sensor_temperature_degc[: len(samples)]).all()


def test_the_chain_takes_the_mean_offset() -> None:
    chain = Chain(ReadingPlan(scheme=None), judging=False)
    chain._take(sent())
    np.testing.assert_allclose(chain.sensor_offset_degc(), np.arange(-1.0, 5.0))


def test_a_field_of_two_values_is_refused() -> None:
    text = (Path(__file__).parents[2] / "protocols" / "stim300.toml").read_text()
    known = 'name = "gyroscope_temperature", type = "i16", count = '
    wrong = text.replace(f"{known}3", f"{known}2")
    assert wrong != text
    with refused(ProtocolError, None, "gyroscope_temperature", "2", key="references.count"):
        parse_protocol(wrong)


@pytest.fixture(scope="module")
def sessions() -> tuple[Parameters, ...]:
    return tuple(solved(at_degc, sensor_offset_degc=offset) for at_degc, offset in OFFSETS.items())


def left_m_s2(parameters: Parameters, at_degc: float, of_axes_degc: np.ndarray, *, with_sensors: bool) -> float:
    """Return the RMS of norm less gravity, of samples in poses never measured."""
    up = np.random.default_rng(8).normal(size=(200, 3))
    force = GRAVITY.gravity_m_s2 * up / np.linalg.norm(up, axis=1)[:, None]
    own = np.tile([*of_axes_degc, np.nan, np.nan, np.nan], (len(up), 1))
    raw = make_samples(
        np.arange(200.0), outputs(force, of_axes_degc), units=SampleUnits(), temperature_degc=np.full(len(up), at_degc)
    )
    _, corrected, _ = parameters.apply(replace(raw, sensor_temperature_degc=own if with_sensors else None))
    return float(np.sqrt(np.mean((np.linalg.norm(corrected, axis=1) - GRAVITY.gravity_m_s2) ** 2)))


def test_curves_over_the_own_sensor_hold_however_the_instrument_is_heated(
    sessions: tuple[Parameters, ...], tmp_path: Path
) -> None:
    found = with_temperature(sessions[2], sessions, [])
    assert "temperature.by_sensors" in keys(found.calibration.quality.reasons)
    write_document(tmp_path / "parameters.toml", found.document)
    found = load(tmp_path)
    bare = [from_document(without_offsets(each)) for each in sessions]
    plain = with_temperature(bare[2], bare, [])
    # Another day, heated in another way.
    of_axes_degc = 45.0 + np.array([2.0, -2.0, 1.0])
    by_sensors = left_m_s2(found, 45.0, of_axes_degc, with_sensors=True)
    by_one = left_m_s2(plain, 45.0, of_axes_degc, with_sensors=True)
    assert by_sensors < by_one / 3, (by_sensors, by_one)
    assert by_sensors < left_m_s2(found, 45.0, of_axes_degc, with_sensors=False) / 3
    assert "temperature.by_sensors" not in keys(plain.calibration.quality.reasons)
    np.testing.assert_array_equal(found.temperature_models[0].sensor_offset_degc, OFFSETS[20.0][:3])
    assert found.context.session.sensor_offset_degc == OFFSETS[20.0]


def without_offsets(parameters: Parameters) -> dict[str, object]:
    session = {key: value for key, value in parameters.document["session"].items() if key != "sensor_offset_degc"}
    return parameters.document | {"session": session}


def test_with_a_ramp_all_belongs_to_the_temperature_of_the_instrument(sessions: tuple[Parameters, ...]) -> None:
    found = with_temperature(sessions[2], sessions, [ramp()])
    assert found.temperature_models[0].sensor_offset_degc is None
