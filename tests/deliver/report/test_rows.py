"""Rows of the report: a preset is compared about the same raw zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.calibrate.model.result import Calibration
from imufield.deliver.report.rows import parameter_rows


def test_another_raw_zero_of_the_preset_is_no_change(calibration: Calibration) -> None:
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    counted = replace(calibration, gyroscope=replace(gyroscope, parameters=gyroscope.parameters.about(np.full(3, -0.5))))
    rows = [row for row in parameter_rows(calibration, counted) if row.triad == "Gyroscope" and row.name.startswith("bias")]
    assert len(rows) == 3
    np.testing.assert_allclose([row.preset for row in rows], [row.value for row in rows], rtol=1e-9)
