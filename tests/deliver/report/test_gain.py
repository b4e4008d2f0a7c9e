"""The error at rest before and after, by a second route: what each position shows of gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.report.gain import gain
from imufield.earth import MILLI_G_M_S2
from tests.told import key_of


@pytest.fixture
def solved(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    return from_document(to_document(calibration, observations, context))


def test_before_is_by_the_nominal_scale(solved: Parameters, observations: Observations) -> None:
    found = gain(solved)
    assert found is not None
    left_out = solved.calibration.positions.leave_one_out_m_s2
    # A position that the others cannot check tells nothing.
    checked = np.isfinite(left_out)
    assert 0 < checked.sum() < len(checked)
    before = np.linalg.norm(observations.mean_raw, axis=1) - 9.8071
    np.testing.assert_allclose(found.before_m_s2, before[checked], atol=1e-12)
    np.testing.assert_allclose(found.after_m_s2, left_out[checked])
    before_mg = np.sqrt(np.mean(found.before_m_s2**2)) / MILLI_G_M_S2
    assert found.words.key == "gain.better"
    assert found.words.values["before_mg"] == pytest.approx(before_mg)
    assert key_of(found.words.values["by"]) == "gain.by_nominal"


def test_before_is_by_the_preset(solved: Parameters, residual: np.ndarray) -> None:
    found = gain(solved, preset=solved)
    assert found is not None
    np.testing.assert_allclose(
        found.before_m_s2, residual[np.isfinite(solved.calibration.positions.leave_one_out_m_s2)], atol=1e-9
    )
    assert found.words.key == "gain.not_better"
    assert key_of(found.words.values["by"]) == "gain.by_preset"


def test_nothing_is_said_where_no_position_is_left_to_tell_it(solved: Parameters) -> None:
    """Six parameters go through six positions: the residuals are zero, whatever the error is."""
    quality = replace(solved.calibration.quality, degrees_of_freedom=0)
    assert gain(replace(solved, calibration=replace(solved.calibration, quality=quality))) is None


def test_counts_without_a_nominal_scale_get_the_one_that_fits(
    calibration: Calibration, observations: Observations, context: Context
) -> None:
    parameters = replace(calibration.accelerometer, scale=1000 * calibration.accelerometer.scale)
    counts = replace(calibration, accelerometer=parameters, accelerometer_raw_unit="count")
    found = gain(from_document(to_document(counts, replace(observations, mean_raw=1000 * observations.mean_raw), context)))
    assert found is not None
    assert key_of(found.words.values["by"]) == "gain.by_fitted"
    checked = np.isfinite(calibration.positions.leave_one_out_m_s2)
    norms = np.linalg.norm(observations.mean_raw, axis=1)[checked]
    np.testing.assert_allclose(found.before_m_s2, norms / norms.mean() * 9.8071 - 9.8071, atol=1e-9)
