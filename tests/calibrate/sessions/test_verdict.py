"""What lowers the verdict of one session by its uncertainty lowers that of several, or of another temperature."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.accelerometer.quality import USABLE_BIAS_SIGMA_M_S2, USABLE_SCALE_SIGMA
from imufield.calibrate.model.result import GyroscopeCalibration, GyroscopeParameters
from imufield.calibrate.sessions.verdict import judged_by_sigma
from imufield.dataclass import replace
from imufield.sentences import Sentence
from tests.pipeline.test_over_temperature import solved
from tests.told import keys, told

REMEDY = Sentence("calibrate before each use")


@pytest.mark.parametrize(
    ("of", "limit", "key"),
    [
        ("scale", USABLE_SCALE_SIGMA, "quality.scale_sigma"),
        ("bias", USABLE_BIAS_SIGMA_M_S2, "quality.bias_sigma"),
        ("gyroscope scale", 0.005, "result.coarse"),
        ("gyroscope misalignment", 0.005, "result.skewed"),
    ],
)
@pytest.mark.parametrize(("share", "verdict"), [(0.9, "good"), (1.1, "usable")])
def test_each_triad_has_the_limits_of_one_session(of: str, limit: float, key: str, share: float, verdict: str) -> None:
    calibration = solved(20.0).calibration
    sigma, none, one = calibration.accelerometer_sigma, np.zeros((3, 3)), np.ones(3)
    rates = GyroscopeParameters(one, none, 0 * one, none)
    axis = np.array([0.0, 1.0, 0.0]) * share * limit
    if of == "scale":
        sigma = replace(sigma, scale=axis * calibration.accelerometer.scale)
    elif of == "bias":
        sigma = replace(sigma, bias_m_s2=axis)
    skew = np.outer(axis, [1.0, 0.0, 0.0]) if of == "gyroscope misalignment" else none
    unsure = GyroscopeParameters(axis if of == "gyroscope scale" else 0 * one, skew, 0 * one, none)
    gyroscope = GyroscopeCalibration(parameters=rates, sigma=unsure, path="")
    quality = replace(calibration.quality, accelerometer_verdict="good", gyroscope_verdict="good")
    judged = judged_by_sigma(quality, replace(calibration, accelerometer_sigma=sigma, gyroscope=gyroscope), REMEDY)
    verdicts = {"accelerometer": judged.accelerometer_verdict, "gyroscope": judged.gyroscope_verdict}
    triad = "gyroscope" if of.startswith("gyroscope") else "accelerometer"
    assert (judged.verdict, verdicts.pop(triad)) == (verdict, verdict)
    assert [*verdicts.values()] == ["good"]
    assert keys(judged.warnings) == [key] * (verdict == "usable")
    assert all(REMEDY in warning for warning in judged.warnings)
    assert all(found.values["axis"] == "y" for found in told(judged.warnings, key) if triad == "gyroscope")
