"""The verdict on what holds on another day, or at another temperature: no better than its uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from imufield.calibrate.accelerometer.quality import sigma_sentences
from imufield.calibrate.gyroscope.result import coarse_sentences
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import Calibration, Quality
from imufield.sentences import Sentence


def judged_by_sigma(quality: Quality, calibration: Calibration, remedy: Sentence) -> Quality:
    """Return a verdict, lowered where a session with the uncertainty of this calibration would be, and what makes it surer."""
    for triad, why in sigma_doubts(calibration, remedy):
        quality = quality.triad_doubted(triad, why)
    return quality


def sigma_doubts(calibration: Calibration, remedy: Sentence) -> Iterator[tuple[str, Sequence[Sentence]]]:
    """Yield each triad with what is too uncertain of it for a good verdict, and what makes it surer."""
    vector, sigma = to_vector(calibration.accelerometer), to_vector(calibration.accelerometer_sigma)
    yield "accelerometer", sigma_sentences(vector, sigma, calibration.gravity, remedy)
    if calibration.gyroscope is not None:
        yield "gyroscope", coarse_sentences(calibration.gyroscope, remedy)
