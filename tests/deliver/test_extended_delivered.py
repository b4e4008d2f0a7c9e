"""A session with cubic and cross terms: every way out of the program carries them, or says what it loses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.models import predict
from imufield.calibrate.model.observations import Observations, leave_out
from imufield.calibrate.model.result import AccelerometerParameters
from imufield.deliver.exports import TARGETS, export_parameters
from imufield.deliver.exports.conventions import linear_corrections
from imufield.deliver.exports.loss import directions
from imufield.deliver.history import Entry
from imufield.deliver.navigation.uncertain import draw_parameters
from imufield.deliver.parameters.consistency import contradiction
from imufield.deliver.parameters.file import Context, Parameters, load, write_document
from imufield.deliver.report.rows import parameter_rows
from imufield.deliver.verification.left_out import cross_validate
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import Reason, UsageError
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.sentences import Sentences
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import TACTICAL, draw_truth
from imufield.study.answers.means import MeanSession, Observed
from tests.refused import refused
from tests.told import key_of

sentence = Sentences("imufield.deliver.exports")

pytestmark = pytest.mark.numerical

G = STANDARD_GRAVITY_M_S2
GRAVITY = Gravity(gravity_m_s2=G, sigma_m_s2=1e-5, source="measured")
NAME = "+x+y-z"
# As least squares represent them: x y z on three axes alike, a difference as +c and -c.
EFFECTS = Effects(cubic=(2e-3, -1e-3, 1e-3), cross=((1e-3, 0.0, 5e-4), (0.0, 5e-4, 0.0), (5e-4, 0.0, -1e-3)))


@pytest.fixture(scope="module")
def session() -> Observed:
    instrument = replace(draw_truth(TACTICAL, np.random.default_rng(2)), effects=EFFECTS)
    return MeanSession(instrument=instrument, gravity_m_s2=G, order="all26").observe(np.random.default_rng(4))


@pytest.fixture(scope="module")
def observations(session: Observed) -> Observations:
    return session.observations


@pytest.fixture(scope="module")
def parameters(observations: Observations) -> Parameters:
    kept, left_out = leave_out(observations, (NAME,))
    measured = SolveInput(observations=kept, left_out=left_out, gravity=GRAVITY, context=Context())
    return calibrate(measured, SolveSettings(model="extended", grade="tactical"))


def accelerometer(parameters: Parameters) -> AccelerometerParameters:
    return parameters.calibration.accelerometer


def test_the_file_carries_them(parameters: Parameters, tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    write_document(path, parameters.document)
    for ours, read in zip(
        (parameters.calibration.accelerometer, parameters.calibration.accelerometer_sigma),
        (load(path).calibration.accelerometer, load(path).calibration.accelerometer_sigma),
        strict=True,
    ):
        assert ours.higher is not None
        assert read.higher is not None
        np.testing.assert_array_equal(read.higher.to_vector(), ours.higher.to_vector())
    without = {key: value for key, value in parameters.document["accelerometer"].items() if key != "higher"}
    assert key_of(contradiction(parameters.document | {"accelerometer": without})) == "consistency.equation"
    assert not contradiction(parameters.document)


def test_applied_it_undoes_the_instrument(parameters: Parameters, session: Observed) -> None:
    up = directions(200)
    felt = EFFECTS.distorted(G * up, session.truth.misalignment_rad)
    raw = predict(session.truth, felt)
    norm = np.linalg.norm(parameters.apply_accelerometer(raw), axis=1) - G
    # Flicker of 20 ug in 26 positions, and what the scale takes of it.
    assert np.abs(norm).max() < 0.1 * MILLI_G_M_S2
    plain = replace(accelerometer(parameters), higher=None)
    assert accelerometer(parameters).higher is not None
    assert np.ptp(predict(plain, G * up) - predict(accelerometer(parameters), G * up)) > MILLI_G_M_S2


def test_what_was_left_out_is_judged_with_them(parameters: Parameters) -> None:
    positions = parameters.calibration.positions
    (off_m_s2,) = positions.leave_one_out_m_s2[~positions.used]
    # Noise and flicker of one hold are 40 ug; its terms make 1.2 mg.
    assert abs(off_m_s2) < 0.2 * MILLI_G_M_S2


def test_the_report_names_them(parameters: Parameters) -> None:
    rows = {row.name: row for row in parameter_rows(parameters.calibration, None)}
    cubic, cross = rows["cubic x"], rows["cross xy x"]
    assert (cubic.unit, cross.unit) == ("µg/g³", "µg/g²")
    assert abs(cubic.value - 2000) < 3 * cubic.sigma
    assert abs(cross.value - 1000) < 3 * cross.sigma


def test_history_compares_like_with_like(parameters: Parameters) -> None:
    assert Entry.of("parameters.toml", parameters).setup.startswith("extended ")


def test_positions_left_out_in_turn_fit(parameters: Parameters, observations: Observations) -> None:
    found = cross_validate(parameters.calibration, leave_out(observations, (NAME,))[0], 4)
    assert found.misfit < found.misfit_limit


def test_a_forecast_draws_about_them(parameters: Parameters) -> None:
    drawn = draw_parameters(parameters.calibration, 200, np.random.default_rng(1))
    errors = drawn.errors(np.array([0.0, 0.6 * G, 0.8 * G]), np.zeros(3))
    # About zero: the outputs and their inverse have the same terms.
    assert np.all(np.abs(errors[:, :3].mean(axis=0)) < 0.3 * errors[:, :3].std(axis=0))


def test_the_nearest_straight_line(parameters: Parameters) -> None:
    p = accelerometer(parameters)
    up = directions()
    raw = predict(p, G * up)
    # Least squares over all directions at 1 g, by another way.
    line = np.linalg.lstsq(np.column_stack([up * G, np.ones(len(up))]), raw, rcond=None)[0]
    found = linear_corrections(parameters.calibration).accelerometer
    np.testing.assert_allclose(found.error_matrix, line[:3].T, atol=2e-6)
    np.testing.assert_allclose(found.offset, line[3], atol=2e-5)


@pytest.mark.parametrize("target", TARGETS)
def test_exports_say_what_they_lose_or_refuse(parameters: Parameters, target: str) -> None:
    if target in ("c", "binary", "json", "yaml"):
        with refused(UsageError, Reason.USAGE, key="whole_model.higher"):
            export_parameters(parameters, target)
    else:
        assert sentence("loss.higher") in " ".join(export_parameters(parameters, target).losses)
