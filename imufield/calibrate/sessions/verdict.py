"""The verdict on what holds on another day, or at another temperature: no better than its uncertainty."""

from __future__ import annotations

from imufield.calibrate.accelerometer.quality import sigma_sentences
from imufield.calibrate.gyroscope.result import coarse_scale
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import Calibration, Quality
from imufield.sentences import Sentence


def judged_by_sigma(quality: Quality, calibration: Calibration, remedy: Sentence) -> Quality:
    """Return a verdict, lowered where a session with the uncertainty of this calibration would be, and what makes it surer."""
    vector, sigma = to_vector(calibration.accelerometer), to_vector(calibration.accelerometer_sigma)
    gyroscope = calibration.gyroscope
    quality = quality.triad_doubted("accelerometer", sigma_sentences(vector, sigma, calibration.gravity, remedy))
    return quality if gyroscope is None else quality.triad_doubted("gyroscope", coarse_scale(gyroscope, remedy))
