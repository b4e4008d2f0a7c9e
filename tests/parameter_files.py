"""Parameter files as tests need them: changed by hand on purpose, or valid over temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from imufield.calibrate.model.result import Calibration
from imufield.calibrate.model.temperature_polynomials import Polynomials, TriadTemperature


def on_purpose(text: str) -> str:
    """Return the text of a parameter file that says of itself that it was edited."""
    head, _, _ = text.rpartition("sha256 = ")
    return f'{head}sha256 = "edited"\n'


def edit(path: Path, old: str, new: str) -> Path:
    """Change a parameter file on purpose."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(on_purpose(text.replace(old, new, 1)), encoding="utf-8")
    return path


def over_temperature(calibration: Calibration, drift_m_s2_per_degc: float) -> Calibration:
    """Return a calibration that holds from 0 to 40 degC, with a drift of the accelerometer's bias."""
    model = TriadTemperature(
        reference_degc=20.0,
        range_degc=(0.0, 40.0),
        bias=Polynomials(np.full((1, 3), drift_m_s2_per_degc), np.zeros((3, 1, 1))),
        scale=Polynomials(np.zeros((0, 3)), np.zeros((3, 0, 0))),  # No polynomial: it stays as it is.
        hysteresis=np.full(3, np.nan),
        scale_separated=True,
    )
    return replace(calibration, accelerometer_temperature=model)
