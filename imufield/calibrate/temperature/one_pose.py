"""The warning about ramps in one pose, which cannot tell bias from scale over temperature: how large the error may be."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.calibrate.temperature.fit import SessionPoints
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)


def pose_sentence(temperature: TriadTemperature, typical: Grade) -> Sentence:
    """Say what is left in other poses where the drift of the accelerometer's scale is in its bias."""
    worst, span = _worst(temperature)
    ppm = typical.accelerometer.scale_ppm_per_degc
    size = {"ppm": ppm, "size_mg": 1e-6 * ppm * span * STANDARD_GRAVITY_M_S2 / MILLI_G_M_S2}
    return sentence("one_pose.pose", grade=typical.name, temperature_degc=worst, **size)


def gyroscope_sentence(temperature: TriadTemperature, typical: Grade, points: SessionPoints | None) -> Sentence:
    """Say that the gyroscope's scale has no curve over temperature: by how much sessions differ, or typical ones do."""
    if points is not None and points.temperatures_of_scale > 1:
        at_degc, scale = points.temperature_degc[points.shows_scale], points.scale[points.shows_scale]
        size_ppm = 1e6 * float(np.ptp(scale, axis=0).max())
        return sentence("one_pose.gyroscope_sessions", low=at_degc.min(), high=at_degc.max(), size_ppm=size_ppm)
    worst, span = _worst(temperature)
    ppm = typical.gyroscope.scale_ppm_per_degc
    return sentence("one_pose.gyroscope", grade=typical.name, temperature_degc=worst, ppm=ppm, size_ppm=ppm * span)


def _worst(temperature: TriadTemperature) -> tuple[float, float]:
    """Return the end of the range that is farthest from the reference, and how far it is, degC."""
    ends = np.array(temperature.range_degc)
    span = np.abs(ends - temperature.reference_degc)
    return float(ends[np.argmax(span)]), float(span.max())
