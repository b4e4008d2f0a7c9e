"""Sessions at three temperatures and a ramp, simulated, become one parameter file that holds over temperature."""

from __future__ import annotations

import json
import shutil
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
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeCalibration, GyroscopeParameters
from imufield.calibrate.model.temperature_polynomials import Polynomials, TriadTemperature
from imufield.cli.run import run
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
from imufield.pipeline.solving import lost_by_replacing, solve_session
from imufield.pipeline.temperature import MarkedSession, RampMeans, read_ramp, with_temperature
from imufield.samples import SampleUnits
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.imu import ImuSettings
from imufield.simulate.truth.operator import OperatorSettings
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
        direction=up,
        start_s=20 * np.arange(m, dtype=np.float64),
        duration_s=np.full(m, 10.0),
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
    np.testing.assert_allclose(curves.bias.half_95[row], student_factor(model.new_day.bias_freedom) * sigma_mg)
    found = np.abs(there.accelerometer.bias_m_s2 - TRUTH.bias_m_s2 - OVER_TEMPERATURE.bias.at(np.array([35.0]))[0])
    assert np.all(found < 5 * there.accelerometer_sigma.bias_m_s2)
    assert np.all(np.linalg.eigvalsh(there.covariance) > -1e-15)
    page = render_report(ReportData(parameters=joint))
    assert "temperature-accelerometer-" in page
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


@pytest.mark.parametrize(("day_change", "verdict"), [(0.0, "good"), (7e-4, "usable")])
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


def test_each_triad_answers_for_its_own_polynomials(sessions: tuple[Parameters, ...]) -> None:
    none, sigma = np.zeros((3, 3)), GyroscopeParameters(np.full(3, 1e-5), np.zeros((3, 3)), np.full(3, 1e-6), np.zeros((3, 3)))
    with_gyroscope = []
    for degc, session, bias in zip((-18.0, 20.0, 55.0), sessions, (3e-3, 0.0, 3e-3), strict=True):
        rates = GyroscopeParameters(np.ones(3), none, np.full(3, bias), none)
        quality = replace(session.calibration.quality, gyroscope_verdict="good")
        gyroscope = GyroscopeCalibration(parameters=rates, sigma=sigma, path="made up")
        calibration = replace(session.calibration, gyroscope=gyroscope, quality=quality)
        with_gyroscope.append(from_document(to_document(calibration, observed(degc), session.context)))
    quality = with_temperature(with_gyroscope[1], with_gyroscope, [ramp()]).calibration.quality
    assert [words.values["triad"] for words in told(quality.warnings, "fit.scatter")] == ["gyroscope"]
    assert (quality.verdict, quality.accelerometer_verdict, quality.gyroscope_verdict) == ("usable", "good", "usable")


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


def import_table(folder: Path, name: str, table: np.ndarray, head: str = "time_s,ax,ay,az,gx,gy,gz,temperature_degc") -> Path:
    np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=head, comments="", fmt="%.9g")
    assert run(["import", str(folder / f"{name}.csv"), "-o", str(folder / name), "--latitude", "48", "--height", "500"]) == 0
    return folder / name


def recorded(folder: Path, temperature_degc: float) -> Path:
    """Return an imported session of one simulated instrument, 24 positions at a temperature."""
    options = Emulation(
        device="text",
        rate_hz=50.0,
        grade="industrial",
        directions=scheme("paper24").directions(),
        operator=OperatorSettings(hold_s=5.5, initial_still_s=6.0, begins_in_first_position=True),
        imu=ImuSettings(temperature_degc=temperature_degc),
    )
    source = make_virtual_imu(options)
    samples = source.next_block(int((source.operator.plan_all() + 2) / source.interval_s))
    columns = (samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc)
    return import_table(folder, f"at{temperature_degc:g}", np.column_stack(columns))


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Return a session at 25 degC, one at 0 degC, and a ramp; copy what is solved."""
    folder = tmp_path_factory.mktemp("recorded")
    return recorded(folder, 25.0), recorded(folder, 0.0), warming_up(folder)


def warming_up(folder: Path) -> Path:
    """Return an imported recording of one pose over 30 degC and back."""
    time_s = np.arange(0.0, 4000.0, 2.0)
    at_degc = 10 + 30 * (1 - np.abs(time_s / 2000 - 1))
    outputs = np.array([0.1, 0.2, 9.8, 0, 0, 0]) + np.outer(at_degc, [1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])
    noise = 1e-4 * np.random.default_rng(3).normal(size=(len(time_s), 6))
    return import_table(folder, "warm-up", np.column_stack([time_s, outputs + noise, at_degc]))


def test_a_ramp_alone_is_refused_as_what_it_is(folders: tuple[Path, Path, Path]) -> None:
    with refused(CalibrationError, Reason.TOO_FEW, "--temperature warm-up", key="solving.one_pose"):
        solve_session(Session.open(folders[2]), SolveSettings())


def test_a_rest_alone_is_refused_with_what_it_is_good_for(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 400.0, 0.01)
    outputs = np.array([0.1, 0.2, 9.8, 0, 0, 0]) + 1e-3 * np.random.default_rng(4).normal(size=(len(time_s), 6))
    rest = import_table(tmp_path, "rest", np.column_stack([time_s, outputs, np.full(len(time_s), 20.0)]))
    with refused(CalibrationError, Reason.TOO_FEW, "imufield noise rest", "imufield verify", key="solving.one_rest"):
        solve_session(Session.open(rest), SolveSettings())


def test_a_file_over_temperature_is_not_replaced_without_a_word(
    sessions: tuple[Parameters, ...], folders: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = shutil.copytree(folders[0], tmp_path / "at25")
    path, joint = session / "parameters.toml", with_temperature(sessions[1], sessions, [])
    write_document(path, joint.document)
    (lost,) = told(lost_by_replacing(path, sessions[1]), "solving.lost_temperature")
    assert (lost.values["low"], lost.values["high"]) == (-18.0, 55.0)
    assert not lost_by_replacing(path, joint)
    capsys.readouterr()
    # One session, as the workbench solves it, and several.
    assert run(["solve", "--json", str(session)]) == 0
    assert "--temperature 'at -18'" in json.loads(capsys.readouterr().out)["notes"][-1]
    assert not load(path).temperature_models
    write_document(path, joint.document)
    capsys.readouterr()
    assert run(["solve", "--json", "--workers", "1", str(session), str(shutil.copytree(folders[1], tmp_path / "at0"))]) == 0
    solved = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "--temperature 'at -18'" in solved[0]["notes"][-1]
    assert not solved[1]["notes"]


def test_solve_takes_sessions_and_ramps_as_they_come(
    folders: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (base, cold, warm_up), output = folders, tmp_path / "parameters.toml"
    # Each of them twice, under another name.
    copies = [shutil.copytree(session, tmp_path / f"{session.name}-copy") for session in (base, cold, warm_up)]
    given = [word for session in (cold, warm_up, *copies) for word in ("--temperature", str(session))]
    capsys.readouterr()
    assert run(["solve", str(base), *given, "-o", str(output)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    joint = load(output)
    # Said once, though it is no word of the first session.
    assert all(shown.count(reason) == 1 for reason in joint.calibration.quality.reasons if "polynomial" in reason)
    reasons = joint.calibration.quality.reasons
    assert all(
        any(f"{copy.name} " in reason and session.name in reason for reason in reasons)
        for session, copy in zip((base, cold, warm_up), copies, strict=True)
    )
    assert [source.kind for source in joint.context.temperature_sources] == ["session", "session", "ramp"]
    accelerometer, gyroscope = joint.temperature_models
    assert accelerometer.scale_separated
    # At rest the ramp shows the gyroscope's bias alone, and it is most of what is known of it.
    assert gyroscope.bias.order >= 1
    change = gyroscope.bias.at(np.array([10.0])) - gyroscope.bias.at(np.array([0.0]))
    np.testing.assert_allclose(change, 1e-4, atol=5e-5)
    means = read_ramp(Session.open(warm_up), joint)
    assert 399 <= len(means.time_s) <= 401
    np.testing.assert_allclose(means.accelerometer[:, 0], 0.1 + 1e-3 * means.temperature_degc, atol=3e-4)
    assert run(["solve", str(base), str(cold), "--temperature", str(warm_up)]) == 2


def test_a_ramp_without_accelerometer_shows_the_gyroscope(
    sessions: tuple[Parameters, ...], folders: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    base, _, warm_up = folders
    table = np.loadtxt(warm_up.parent / "warm-up.csv", delimiter=",", skiprows=1)[:, [0, 4, 5, 6, 7]]
    # Of another day: its noise is its own. It only rises.
    table[:, 1:4] += 1e-4 * np.random.default_rng(9).normal(size=(len(table), 3))
    folder = import_table(tmp_path, "rates", table[: len(table) // 2], "time_s,gx,gy,gz,temperature_degc")
    output = tmp_path / "parameters.toml"
    assert run(["solve", str(base), "--temperature", str(warm_up), "--temperature", str(folder), "-o", str(output)]) == 0
    joint = load(output)
    assert [source.name for source in joint.context.temperature_sources] == ["warm-up", "rates"]
    change = joint.temperature_models[1].bias.at(np.array([10.0])) - joint.temperature_models[1].bias.at(np.array([0.0]))
    np.testing.assert_allclose(change, 1e-4, atol=5e-5)
    rates = replace(read_ramp(Session.open(folder), joint), remarks=("cut short",))
    assert np.isnan(rates.accelerometer).all()
    reasons = with_temperature(joint, [], [read_ramp(Session.open(warm_up), joint), rates]).calibration.quality.reasons
    assert "cut short" in reasons
    assert [words.values["name"] for words in told(reasons, "ramp.one_way")] == ["rates"]
    counts = replace(joint, document=joint.document | {"gyroscope": joint.document["gyroscope"] | {"raw_unit": "count"}})
    with refused(ParameterFileError, Reason.UNITS, "gyroscope", key="file.unit"):
        read_ramp(Session.open(warm_up), counts)
    assert joint.calibration.gyroscope is not None
    of_counts = replace(joint.calibration.gyroscope, raw_unit="count")
    other = replace(joint, calibration=replace(joint.calibration, gyroscope=of_counts))
    with refused(CalibrationError, Reason.UNITS, "gyroscope", key="temperature.differs"):
        with_temperature(joint, [joint, other], [])
    # Alone it does not show the accelerometer, and an instrument without gyroscope has no use for it.
    with refused(CalibrationError, Reason.TOO_FEW, key="fit.too_few"):
        with_temperature(joint, [], [rates])
    with refused(CalibrationError, Reason.NOT_FINITE, "rates", key="temperature.no_output"):
        with_temperature(sessions[1], sessions, [rates])
