import numpy as np
import pytest

from imufield.guide.stillness.scale import RoughScale
from imufield.samples import SampleUnits


def test_units_alone() -> None:
    assert RoughScale.of_units(SampleUnits(accelerometer="g", gyroscope="deg/s")).accelerometer == pytest.approx(1 / 9.80665)
    assert RoughScale.of_units(SampleUnits(accelerometer="g", gyroscope="deg/s")).gyroscope == pytest.approx(57.29578)
    assert RoughScale.of_units(SampleUnits(accelerometer="count", gyroscope="pulse")).accelerometer is None


def test_what_is_not_known_is_learned_from_gravity() -> None:
    scale = RoughScale(raw_zero=np.full(3, 100.0)).learn(np.array([100.0, 100.0, 100.0 + 9806.65]))
    assert scale.learned
    assert scale.accelerometer == pytest.approx(1000)
    assert RoughScale(accelerometer=2.0).learn(np.ones(3)).accelerometer == 2.0
    assert not RoughScale().learn(np.zeros(3)).learned
    with pytest.raises(ValueError, match="accelerometer"):
        RoughScale().specific_force(np.ones(3))
