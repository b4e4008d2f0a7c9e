"""Sessions at three temperatures and a ramp, simulated, become one parameter file that holds over temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.calibrate.accelerometer.quality import USABLE_SCALE_SIGMA
from imufield.calibrate.model.budget import combined_sigma
from imufield.calibrate.model.coverage_factors import student_factor
from imufield.calibrate.model.models import at_temperature, predict, predict_gyroscope
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, Calibration, GyroscopeCalibration, GyroscopeParameters
from imufield.calibrate.model.temperature_polynomials import Polynomials, TriadTemperature
from imufield.calibrate.temperature.at_temperature import calibration_at
from imufield.deliver.parameters.context import Context, InstrumentFacts, SessionFacts
from imufield.deliver.parameters.file import Parameters, from_document, load, to_document, write_document
from imufield.deliver.report.budget import not_in_budget
from imufield.deliver.report.data import ReportData
from imufield.deliver.report.over_temperature import temperature_curves
from imufield.deliver.report.page import render_report
from imufield.earth import MILLI_G_M_S2, Gravity
from imufield.errors import CalibrationError, ParameterFileError, Reason, RecordingError, UsageError
from imufield.guide.positions import scheme
from imufield.pipeline import temperature
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.pipeline.temperature import MarkedSession, RampMeans, with_temperature
from imufield.samples import SampleUnits
from tests.refused import refused
from tests.told import key_of, keys, told

pytestmark = pytest.mark.numerical

GRAVITY = Gravity(gravity_m_s2=9.81, sigma_m_s2=1e-5, source="measured")
NOISE_M_S2 = 2e-4
TRUTH = AccelerometerParameters(
    scale=np.array([1.01, 0.99, 1.005]),
    bias_m_s2=np.array([0.05, -0.08, 0.1]),
    misalignment_rad=np.array([[0, 0, 0], [2e-3, 0, 0], [-1e-3, 3e-3, 0]]),
)
BIAS = np.array([[0.15, -0.12, 0.2], [1e-3, -1.5e-3, 1e-3]]) * MILLI_G_M_S2
SCALE = np.array([[60e-6, -50e-6, 70e-6]])
OVER_TEMPERATURE = TriadTemperature(
    reference_degc=20.0,
    range_degc=(-40.0, 80.0),
    bias=Polynomials(BIAS, np.zeros((3, 2, 2))),
    scale=Polynomials(SCALE, np.zeros((3, 1, 1))),
    hysteresis=np.full(3, np.nan),
    scale_separated=True,
)
UP = np.array([[0.55, -0.6, 0.58]])


def outputs(force: np.ndarray, of_axes_degc: np.ndarray) -> np.ndarray:
    """Return what the instrument gives whose axes have these temperatures."""
    of_axes = (predict(at_temperature(TRUTH, OVER_TEMPERATURE, degc), force)[:, axis] for axis, degc in enumerate(of_axes_degc))
    return np.column_stack([*of_axes])


def observed(
    temperature_degc: float, sensor_offset_degc: tuple[float, ...] = (), *, noise_m_s2: float = NOISE_M_S2, day: float = 1.0
) -> Observations:
    """Return what positions show, of a day whose scale is ``day`` times the usual one."""
    rng, up = np.random.default_rng(int(temperature_degc) + 50), scheme("paper24").directions()
    m = len(up)
    output = outputs(GRAVITY.gravity_m_s2 * up, temperature_degc + np.array((*sensor_offset_degc, 0, 0, 0)[:3]))
    return Observations(
        name=tuple(position.name for position in scheme("paper24").positions),
        mean_raw=day * output + noise_m_s2 * rng.normal(size=output.shape),
        covariance_raw=np.broadcast_to(noise_m_s2**2 * np.eye(3), (m, 3, 3)),
        gyroscope_mean_raw=np.full((m, 3), np.nan),
        gyroscope_covariance_raw=np.full((m, 3, 3), np.nan),
        gyroscope_rounding_raw=np.zeros((m, 3)),
        gyroscope_noise_raw=np.full((m, 3), np.nan),
        direction=up,
        start_s=20 * np.arange(m, dtype=np.float64),
        duration_s=np.full(m, 10.0),
        middle_s=np.full(m, np.nan),
        middle_rad=np.zeros((m, 3)),
        temperature_degc=np.full(m, temperature_degc),
        units=SampleUnits(),
    )


def solved(
    temperature_degc: float,
    *,
    gauge: str = "lower",
    serial_number: str = "A1",
    gravity: Gravity = GRAVITY,
    sensor_offset_degc: tuple[float, ...] = (),
    noise_m_s2: float = NOISE_M_S2,
    day: float = 1.0,
) -> Parameters:
    observations = observed(temperature_degc, sensor_offset_degc, noise_m_s2=noise_m_s2, day=day)
    context = Context(
        instrument=InstrumentFacts(serial_number=serial_number),
        session=SessionFacts(
            name=f"at {temperature_degc:g}",
            sha256=64 * "b",
            sample_rate_hz=100.0,
            temperature_degc=(temperature_degc, temperature_degc),
            sensor_offset_degc=sensor_offset_degc,
        ),
    )
    settings = SolveSettings(model="linear", gauge=gauge, grade="industrial")  # type: ignore[arg-type]
    return calibrate(SolveInput(observations=observations, gravity=gravity, context=context), settings)


@pytest.fixture(scope="module")
def sessions() -> tuple[Parameters, ...]:
    return solved(-18.0), solved(20.0), solved(55.0)


def ramp() -> RampMeans:
    """Return a ramp of two hours from -20 to 60 degC and back, one pose."""
    time_s = np.arange(0.0, 14400.0, 10.0)
    at_degc = -20 + 80 * (1 - np.abs(time_s / 7200 - 1))
    truths = (at_temperature(TRUTH, OVER_TEMPERATURE, degc) for degc in at_degc)
    output = np.vstack([predict(truth, GRAVITY.gravity_m_s2 * UP / np.linalg.norm(UP)) for truth in truths])
    noise = NOISE_M_S2 * np.random.default_rng(2).normal(size=output.shape)
    return RampMeans(
        name="ramp",
        sha256=64 * "c",
        time_s=time_s,
        temperature_degc=at_degc,
        accelerometer=output + noise,
        gyroscope=np.full_like(output, np.nan),
    )


def residual_m_s2(parameters: Parameters, temperature_degc: float) -> float:
    """Return the RMS of norm less gravity in poses never measured."""
    up = np.random.default_rng(8).normal(size=(200, 3))
    force = GRAVITY.gravity_m_s2 * up / np.linalg.norm(up, axis=1)[:, None]
    raw = predict(at_temperature(TRUTH, OVER_TEMPERATURE, temperature_degc), force)
    corrected = parameters.apply_accelerometer(raw, temperature_degc=temperature_degc)
    return float(np.sqrt(np.mean((np.linalg.norm(corrected, axis=1) - GRAVITY.gravity_m_s2) ** 2)))


def test_joint_parameters_hold_where_one_session_and_one_pose_do_not(sessions: tuple[Parameters, ...], tmp_path: Path) -> None:
    base = sessions[1]
    joint, one_pose = with_temperature(base, sessions, [ramp()]), with_temperature(base, [], [ramp()])
    write_document(tmp_path / "parameters.toml", joint.document)
    joint = load(tmp_path)
    for at_degc in (-20.0, 60.0):
        left = residual_m_s2(joint, at_degc)
        assert left < residual_m_s2(base, at_degc) / 10
        assert left < residual_m_s2(one_pose, at_degc) / 4
    np.testing.assert_array_equal(joint.calibration.accelerometer.scale, base.calibration.accelerometer.scale)
    assert "temperature.found" not in keys(base.calibration.quality.reasons)
    assert [source.kind for source in joint.context.temperature_sources] == ["session"] * 3 + ["ramp"]


def test_the_file_keeps_sessions_and_new_day_and_the_report_draws_them(
    sessions: tuple[Parameters, ...], tmp_path: Path
) -> None:
    joint = with_temperature(sessions[1], sessions, [ramp()])
    write_document(tmp_path / "parameters.toml", joint.document)
    model, again = joint.temperature_models[0], load(tmp_path).temperature_models[0]
    assert model.sessions is not None
    assert model.new_day is not None
    assert again.sessions is not None
    assert again.new_day is not None
    np.testing.assert_array_equal(again.sessions.bias, model.sessions.bias)
    np.testing.assert_array_equal(again.new_day.bias_covariance, model.new_day.bias_covariance)
    # What the sessions themselves found is what the truth says, and the curves go by there.
    d_degc = model.sessions.temperature_degc - 20.0
    np.testing.assert_allclose(model.sessions.bias, OVER_TEMPERATURE.bias.at(d_degc), atol=5 * NOISE_M_S2)
    (curves,) = temperature_curves(joint)
    row = int(np.argmin(np.abs(curves.temperature_degc - 55.0)))
    there = joint.at(float(curves.temperature_degc[row])).calibration
    sigma_mg = there.accelerometer_sigma.bias_m_s2 / MILLI_G_M_S2
    np.testing.assert_allclose(curves.bias.sigma[row], sigma_mg)
    assert curves.bias.factor == student_factor(model.new_day.bias_freedom)
    found = np.abs(there.accelerometer.bias_m_s2 - TRUTH.bias_m_s2 - OVER_TEMPERATURE.bias.at(np.array([35.0]))[0])
    assert np.all(found < 5 * there.accelerometer_sigma.bias_m_s2)
    assert np.all(np.linalg.eigvalsh(there.covariance) > -1e-15)
    page = render_report(ReportData(parameters=joint))
    assert "Accelerometer over temperature" in page
    # The three axes about one another, twice: of bias and of scale.
    assert page.count('fill-opacity="0.12"') == 6
    assert not [*temperature_curves(sessions[1])]


def test_neither_gauge_nor_an_assumed_gravity_changes_what_is_found(sessions: tuple[Parameters, ...]) -> None:
    in_lower = with_temperature(sessions[1], sessions, []).temperature_models[0]
    uppers = [solved(degc, gauge="upper") for degc in (-18.0, 20.0, 55.0)]
    in_upper = with_temperature(uppers[1], uppers, []).temperature_models[0]
    for quantity in ("bias", "scale"):
        lower, upper = getattr(in_lower, quantity).coefficients, getattr(in_upper, quantity).coefficients
        np.testing.assert_allclose(upper, lower, rtol=1e-3, atol=1e-3 * np.abs(lower).max())
    # 1800 ppm of scale that no one knows are those of the place: they are the same at all temperatures.
    unknown = Gravity(gravity_m_s2=9.81, sigma_m_s2=0.018, source="assumed")
    assumed = [solved(degc, gravity=unknown) for degc in (-18.0, 20.0, 55.0)]
    assert np.all(assumed[1].calibration.accelerometer_sigma.scale > 1e-3)
    found = with_temperature(assumed[1], assumed, [])
    np.testing.assert_allclose(found.temperature_models[0].scale.covariance, in_lower.scale.covariance, rtol=0.05)
    # But of the scale itself they are the uncertainty, there as well.
    there = found.at(55.0).calibration
    assert np.all(there.accelerometer_sigma.scale > 1e-3)


@pytest.mark.parametrize(("day_change", "verdict"), [(0.0, "good"), (6e-4, "usable")])
def test_a_scale_that_days_leave_unsure_is_not_good(day_change: float, verdict: str) -> None:
    """Each session is good, and none contradicts the others: they are as noisy as their days differ."""
    at_degc, signs = (0.0, 10.0, 20.0, 30.0, 40.0), (1, -1, 1, 1, -1)
    days = [solved(degc, noise_m_s2=5e-3, day=1 + sign * day_change) for degc, sign in zip(at_degc, signs, strict=True)]
    assert {session.calibration.quality.verdict for session in days} == {"good"}
    joint = with_temperature(days[2], days, [])
    sigma = max(float(joint.at(degc).calibration.accelerometer_sigma.scale.max()) for degc in (at_degc[0], at_degc[-1]))
    assert (sigma > USABLE_SCALE_SIGMA) is (verdict == "usable")
    quality = joint.calibration.quality
    assert (quality.verdict, quality.accelerometer_verdict) == (verdict, verdict)
    assert len(quality.warnings) == (verdict == "usable")


def test_the_budget_stays_that_of_the_reference(sessions: tuple[Parameters, ...]) -> None:
    joined = with_temperature(sessions[1], (sessions[0], sessions[2]), [ramp()])
    variances = np.diag(joined.calibration.covariance)
    assert combined_sigma(joined.calibration.budget) ** 2 == pytest.approx(variances, rel=1e-9, abs=1e-24)
    assert keys(not_in_budget(joined)) == [
        "budget.no_repeatability",
        "budget.over_temperature_days",
        "budget.over_temperature",
    ]
    assert keys(not_in_budget(sessions[1])) == ["budget.no_repeatability", "budget.no_temperature"]


def test_the_budget_states_what_parameters_at_the_worst_temperature_do(sessions: tuple[Parameters, ...]) -> None:
    joint = with_temperature(sessions[1], sessions, [ramp()])
    bias, scale = told(not_in_budget(joint), "budget.over_temperature_days")
    assert (bias.values["unit"], scale.values["unit"]) == ("mg", "ppm")
    for degc in np.linspace(*joint.temperature_range_degc, 9):
        there = joint.at(degc).calibration
        relative = there.accelerometer_sigma.scale / there.accelerometer.scale
        assert float(bias.values["sigma"]) >= there.accelerometer_sigma.bias_m_s2.max() / MILLI_G_M_S2 * (1 - 1e-3)
        assert float(scale.values["sigma"]) >= 1e6 * relative.max() * (1 - 1e-3)


def test_a_scale_whose_days_are_not_shown_has_the_sigma_of_its_change(sessions: tuple[Parameters, ...]) -> None:
    joined = with_temperature(sessions[1], (sessions[0], sessions[2]), [ramp()])
    (model,) = joined.temperature_models
    assert model.new_day is not None
    assert np.isnan(model.new_day.scale).all()
    own, there = joined.calibration, joined.at(55.0).calibration
    changed = model.scale.sigma_at(np.array([35.0]))[0]
    relative = there.accelerometer_sigma.scale / there.accelerometer.scale
    np.testing.assert_allclose(relative, np.hypot(own.accelerometer_sigma.scale / own.accelerometer.scale, changed))


def test_one_pose_alone_is_never_good_and_sessions_keep_their_verdict(sessions: tuple[Parameters, ...]) -> None:
    base = sessions[1]
    assert base.calibration.quality.verdict == "good"
    one_pose = with_temperature(base, [], [ramp()]).calibration.quality
    assert one_pose.verdict == one_pose.accelerometer_verdict == "usable"
    assert "one_pose.pose" in keys(one_pose.warnings)
    # Three sessions show a straight line, which the bias is not, and what they differ from it by is sigma, too.
    bent = with_temperature(base, sessions, []).calibration.quality
    assert bent.verdict == "usable"
    assert keys(bent.warnings) == ["fit.scatter", "quality.bias_sigma"]
    assert with_temperature(base, sessions, [ramp()]).calibration.quality.verdict == "good"


def judged(session: Parameters, verdict: str, *warnings: str, suspects: tuple[str, ...] = ()) -> Parameters:
    """Return a session as it would be with this verdict on its accelerometer."""
    quality = replace(session.calibration.quality, accelerometer_verdict=verdict, suspects=suspects).lowered(verdict, *warnings)
    return replace(session, calibration=replace(session.calibration, quality=quality), of_recording=("cut short",))


def test_a_position_of_any_session_may_be_left_out(
    sessions: tuple[Parameters, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its file is not read: what it is solved with is looked at, and refused where no session has the name."""
    cold, base, _ = sessions
    given: list[SolveSettings] = []

    def solve(_session: Session, settings: SolveSettings, *_: object) -> Parameters:
        given.append(settings)
        return cold

    monkeypatch.setattr(temperature, "solve_session", solve)
    recorded = Session.create(tmp_path, "imu", {"kind": "capture"})
    settings = SolveSettings(without=("nowhere",))
    with refused(UsageError, Reason.USAGE, key="observations.not_there"):
        temperature.over_temperature(MarkedSession(base), [recorded], settings)
    assert [(each.without, each.is_of_several) for each in given] == [(("nowhere",), True)]


def test_no_session_is_worse_than_the_verdict_and_each_is_heard(sessions: tuple[Parameters, ...]) -> None:
    cold, base, warm = sessions
    usable, poor = judged(cold, "usable", "it warmed up"), judged(warm, "poor", "two", "three", suspects=("+x",))
    found = with_temperature(base, [usable, base, poor], [ramp()])
    quality = from_document(found.document).calibration.quality
    assert quality.verdict == quality.accelerometer_verdict == "poor"
    assert quality.main_reason == "at 55: two"
    assert [warning for warning in quality.warnings if key_of(warning) == "result.of_session"] == [
        "at 55: two",
        "at -18: it warmed up",
        "at 55: three",
    ]
    # Positions of the file itself: the workbench offers to repeat them.
    assert quality.suspects == ()
    assert {"at -18: cut short", "at 55: cut short"} <= set(quality.details)
    quality = with_temperature(base, [usable, base, warm], [ramp()]).calibration.quality
    assert (quality.verdict, quality.accelerometer_verdict) == ("usable", "usable")
    assert quality.warnings == ("at -18: it warmed up",)
    # The reference says it by itself.
    own = judged(base, "usable", "it warmed up")
    assert with_temperature(own, [cold, own, warm], [ramp()]).calibration.quality.warnings == ("it warmed up",)


def with_rates(sessions: tuple[Parameters, ...], biases: tuple[float, ...]) -> list[Parameters]:
    """Return the sessions with a gyroscope of these biases, good by itself."""
    none, sigma = np.zeros((3, 3)), GyroscopeParameters(np.full(3, 1e-5), np.zeros((3, 3)), np.full(3, 1e-6), np.zeros((3, 3)))
    with_gyroscope = []
    for degc, session, bias in zip((-18.0, 20.0, 55.0), sessions, biases, strict=True):
        rates = GyroscopeParameters(np.ones(3), none, np.full(3, bias), none)
        quality = replace(session.calibration.quality, gyroscope_verdict="good")
        gyroscope = GyroscopeCalibration(parameters=rates, sigma=sigma, path="made up")
        calibration = replace(session.calibration, gyroscope=gyroscope, quality=quality)
        with_gyroscope.append(from_document(to_document(calibration, observed(degc), session.context)))
    return with_gyroscope


def test_each_triad_answers_for_its_own_polynomials(sessions: tuple[Parameters, ...]) -> None:
    with_gyroscope = with_rates(sessions, (3e-3, 0.0, 3e-3))
    quality = with_temperature(with_gyroscope[1], with_gyroscope, [ramp()]).calibration.quality
    assert [words.values["triad"] for words in told(quality.warnings, "fit.scatter")] == ["gyroscope"]
    assert (quality.verdict, quality.accelerometer_verdict, quality.gyroscope_verdict) == ("usable", "good", "usable")


def test_each_end_of_the_range_lowers_what_is_unsure_there(
    sessions: tuple[Parameters, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    with_gyroscope = with_rates(sessions, (0.0, 0.0, 0.0))

    def at_end(calibration: Calibration, end_degc: float) -> Calibration:
        there, gyroscope = calibration_at(calibration, end_degc), calibration.gyroscope
        assert gyroscope is not None
        scale = np.full(3, 0.1)
        if end_degc < 20:
            return replace(there, accelerometer_sigma=replace(there.accelerometer_sigma, scale=scale))
        return replace(there, gyroscope=replace(gyroscope, sigma=replace(gyroscope.sigma, scale=scale)))

    monkeypatch.setattr(temperature, "calibration_at", at_end)
    quality = with_temperature(with_gyroscope[1], with_gyroscope, [ramp()]).calibration.quality
    assert {"quality.scale_sigma", "result.coarse"} <= set(keys(quality.warnings))
    assert (quality.accelerometer_verdict, quality.gyroscope_verdict) == ("usable", "usable")
    # As unsure at both ends: said once.
    monkeypatch.setattr(temperature, "calibration_at", lambda calibration, _: at_end(calibration, 60.0))
    quality = with_temperature(with_gyroscope[1], with_gyroscope, [ramp()]).calibration.quality
    assert keys(quality.warnings).count("result.coarse") == 1


def test_ramps_without_gyroscope_leave_it_at_one_temperature(sessions: tuple[Parameters, ...]) -> None:
    calibration = sessions[1].calibration
    rates = GyroscopeParameters(np.ones(3), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)))
    base = replace(
        sessions[1],
        calibration=replace(calibration, gyroscope=GyroscopeCalibration(parameters=rates, sigma=rates, path="made up")),
    )
    reasons = with_temperature(base, [], [ramp()]).calibration.quality.reasons
    assert "temperature.gyroscope_unknown" in keys(reasons)


def test_the_raw_zero_of_a_gyroscope_has_no_temperature(sessions: tuple[Parameters, ...]) -> None:
    none = np.zeros((3, 3))
    truth = GyroscopeParameters(np.full(3, 4000.0), none, np.array([10.0, -5.0, 3.0]), none, raw_zero=np.full(3, 32768.0))
    bias = Polynomials(np.array([[1e-5, -2e-5, 1.5e-5]]), np.zeros((3, 1, 1)))
    model = replace(OVER_TEMPERATURE, bias=bias, scale=Polynomials(np.full((1, 3), 1e-5), np.zeros((3, 1, 1))))
    sigma = GyroscopeParameters(np.full(3, 0.04), none, np.full(3, 0.02), none)
    own = [
        GyroscopeCalibration(parameters=at_temperature(truth, model, degc), sigma=sigma, path="made up", raw_unit="count")
        for degc in (-18.0, 20.0, 55.0)
    ]
    # A session that was solved before the raw zero was known says the same.
    own[0] = replace(own[0], parameters=own[0].parameters.about(np.zeros(3)))
    known = [
        from_document(to_document(replace(each.calibration, gyroscope=of_it), observed(degc), each.context))
        for degc, each, of_it in zip((-18.0, 20.0, 55.0), sessions, own, strict=True)
    ]
    means, rng = ramp(), np.random.default_rng(6)
    rates = [predict_gyroscope(at_temperature(truth, model, degc), np.zeros((1, 3)))[0] for degc in means.temperature_degc]
    means = replace(means, gyroscope=np.array(rates) + 0.01 * rng.normal(size=(len(rates), 3)))
    found = with_temperature(known[1], known, [means]).temperature_models[1]
    d_degc = np.array([-38.0, 35.0])
    np.testing.assert_allclose(found.bias.at(d_degc), bias.at(d_degc), atol=2e-5)
    np.testing.assert_allclose(found.scale.at(d_degc), model.scale.at(d_degc), atol=3e-5)


def test_sessions_that_mean_something_else_are_refused(sessions: tuple[Parameters, ...]) -> None:
    with refused(CalibrationError, Reason.UNITS, "gauge", key="temperature.differs"):
        with_temperature(sessions[1], [*sessions[:2], solved(55.0, gauge="upper")], [])
    with refused(ParameterFileError, Reason.FOREIGN):
        with_temperature(sessions[1], [*sessions[:2], solved(55.0, serial_number="B2")], [])
    positions = [row | {"temperature_degc": float("nan")} for row in sessions[0].document["position"]]
    session = SessionFacts(name="cold", sha256=64 * "d", sample_rate_hz=100.0)
    nowhere = replace(sessions[0].context, session=session)
    cold = replace(sessions[0], document=sessions[0].document | {"position": positions}, context=nowhere)
    with refused(CalibrationError, Reason.NOT_FINITE, key="temperature.none"):
        with_temperature(sessions[1], [*sessions[1:], cold], [])
    heated = [row | {"temperature_degc": 1000.0} for row in positions]
    hot = replace(sessions[0], document=sessions[0].document | {"position": heated})
    with refused(RecordingError, Reason.BAD_DATA, key="samples.impossible"):
        with_temperature(sessions[1], [*sessions[1:], hot], [])
