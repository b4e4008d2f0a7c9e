"""Sessions together: the verdict on what one file says of a day that was not measured."""

from __future__ import annotations

import pytest

from imufield.calibrate.accelerometer.quality import USABLE_SCALE_SIGMA
from imufield.calibrate.model.grades import find_grade
from imufield.calibrate.sessions.joint import adjust
from imufield.deliver.parameters.joined import JoinedFrom, joined_parameters, numbers_of, prior_scales
from tests.pipeline.test_over_temperature import solved
from tests.told import told


@pytest.mark.parametrize(("day_change", "verdict"), [(0.0, "good"), (6e-3, "usable")])
def test_a_scale_that_changes_from_day_to_day_is_not_good(day_change: float, verdict: str) -> None:
    days = [solved(20.0 + day, day=1 + sign * day_change) for day, sign in enumerate((1, -1, 0))]
    assert {session.calibration.quality.verdict for session in days} == {"good"}
    reference = days[0].gauge_free()
    positions = days[0].calibration.positions
    positions.used[3], positions.residual_m_s2[3] = False, 1.0
    gathered = [numbers_of(session.calibration, session.gauge_free(), reference) for session in days]
    joint = joined_parameters(
        JoinedFrom(parameters=days, base=0, shared=[each.shared for each in gathered], prior_grade="industrial", sha256=""),
        adjust([each.own for each in gathered], prior_scales(find_grade("industrial"))),
        reference,
        warnings=(),
        notes=(),
    ).calibration
    relative = joint.accelerometer_sigma.scale / joint.accelerometer.scale
    assert bool(relative.max() > USABLE_SCALE_SIGMA) is (verdict == "usable")
    assert (joint.quality.verdict, joint.quality.accelerometer_verdict) == (verdict, verdict)
    assert len(joint.quality.warnings) == (verdict == "usable")
    assert told(joint.quality.reasons, "joined.summary")[0].values["positions"] == 3 * len(positions.used) - 1
    assert joint.quality.residual_max_m_s2 < 0.1
