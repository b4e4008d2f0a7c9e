import numpy as np
import pytest

from imufield.acquire.protocol.protocol import Nominal
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import SampleUnits

NOTHING = Nominal(
    accelerometer_scale=None,
    gyroscope_scale=None,
    raw_zero=np.zeros(3),
    accelerometer_range_m_s2=None,
    gyroscope_range_rad_s=None,
    rate_hz=None,
    grade="",
)


def test_units_alone() -> None:
    assert RoughScale.of_units(SampleUnits(accelerometer="g", gyroscope="deg/s")).accelerometer == pytest.approx(1 / 9.80665)
    assert RoughScale.of_units(SampleUnits(accelerometer="g", gyroscope="deg/s")).gyroscope == pytest.approx(57.29578)
    assert RoughScale.of_units(SampleUnits(accelerometer="count", gyroscope="pulse")).accelerometer is None


def test_the_protocol_knows_more_than_the_units() -> None:
    nominal = Nominal(
        accelerometer_scale=414.0,
        gyroscope_scale=4780.0,
        raw_zero=np.full(3, 32768.0),
        accelerometer_range_m_s2=None,
        gyroscope_range_rad_s=None,
        rate_hz=100.0,
        grade="",
    )
    scale = RoughScale.of(SampleUnits(accelerometer="count", gyroscope="count"), nominal)
    assert (scale.accelerometer, scale.gyroscope) == (414.0, 4780.0)
    np.testing.assert_allclose(scale.specific_force(np.array([32768.0, 32768.0, 32768.0 + 414.0])), [0, 0, 1])
    assert RoughScale.of(SampleUnits(), NOTHING).accelerometer == 1.0


def test_mid_scale_of_increments_is_a_rate_too() -> None:
    units = SampleUnits(
        accelerometer="count", gyroscope="count", accelerometer_is_increment=True, gyroscope_is_increment=True, interval_s=0.01
    )
    nominal = Nominal(
        accelerometer_scale=1e4,
        gyroscope_scale=1e6,
        raw_zero=np.full(3, 500.0),
        accelerometer_range_m_s2=None,
        gyroscope_range_rad_s=None,
        rate_hz=100.0,
        grade="",
    )
    scale = RoughScale.of(units, nominal)
    # 9.8 m/s^2 over 10 ms: 0.098 m/s, 980 counts above the mid-scale.
    np.testing.assert_allclose(scale.specific_force(np.full(3, 1480.0) / 0.01), 9.8)


def test_what_is_not_known_is_learned_from_gravity() -> None:
    scale = RoughScale(raw_zero=np.full(3, 100.0)).learn(np.array([100.0, 100.0, 100.0 + 9806.65]))
    assert scale.learned
    assert scale.accelerometer == pytest.approx(1000)
    assert RoughScale(2.0).learn(np.ones(3)).accelerometer == 2.0
    assert not RoughScale().learn(np.zeros(3)).learned
    with pytest.raises(ValueError, match="accelerometer"):
        RoughScale().specific_force(np.ones(3))
