"""Every target's own formula, written here from its documentation, on the file it is given: it must correct as we do."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_instruments import loaded, made_up
from target_formulas import (
    DIAGONAL,
    FORMULAS,
    G0,
    RAW_UNITS_KEPT,
    TURNED,
    WITH_G,
    ardupilot,
    imucal_formula,
    imucal_package,
    kalibr_imu,
    psins,
    pyins_module,
    vectornav,
)

from imufield.calibrate.accelerometer.fit import FitData, column_basis, fit
from imufield.calibrate.model.models import predict, predict_gyroscope, to_vector
from imufield.deliver.exports import TARGETS, ExportOptions, export_parameters
from imufield.deliver.exports.loss import directions
from imufield.deliver.parameters.file import Parameters
from imufield.errors import ParameterFileError, Reason
from imufield.guide.positions import scheme
from imufield.sentences import Sentences
from tests.refused import refused
from tests.told import key_of, keys, with_key

pytestmark = pytest.mark.numerical


def samples(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-30, 30, (40, 3)), rng.uniform(-5, 5, (40, 3))


def nearest_rotation(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return the proper rotation R of theirs = R ours (Kabsch), found from the values alone."""
    left, _, right = np.linalg.svd(theirs.T @ ours)
    rotation = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    return np.asarray(rotation)


def close(theirs: np.ndarray, ours: np.ndarray, relative: float = 1e-9) -> None:
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=relative * np.abs(ours).max())


def check(target: str, parameters: Parameters, files: dict[str, bytes], unit: tuple[float, float], seed: int) -> np.ndarray:
    """Compare the target's formula with ``apply``; ``unit`` is raw per SI. Return the turn of the target's body frame."""
    acc, gyr = samples(seed)
    raw_acc, raw_gyr = acc * unit[0], gyr * unit[1]
    a = parameters.apply_accelerometer(raw_acc)
    w = parameters.apply_gyroscope(raw_gyr, a)
    formula = FORMULAS[target]
    their_a, their_w = formula(files, raw_acc, raw_gyr) if target in RAW_UNITS_KEPT else formula(files, acc, gyr)
    R = nearest_rotation(a, their_a) if target in TURNED else np.eye(3)
    close(their_a, a @ R.T)
    if their_w is not None:
        close(their_w, w @ R.T)
    return R


INSTRUMENTS = {
    "seed": st.integers(0, 2**32 - 1),
    "gauge": st.sampled_from(["lower", "upper", "symmetric", "preset"]),
    "angle_rad": st.sampled_from([0.0, 1e-4, 5e-3, 0.05]),
}


def test_every_target_is_compared_with_a_formula_of_its_own() -> None:
    # pyins itself runs below; C and its block are compiled in test_embedded.py, the plain forms are read in test_files.py.
    assert {*FORMULAS, *DIAGONAL, "pyins", "c", "binary", "json", "yaml"} == set(TARGETS)


@pytest.mark.parametrize("target", FORMULAS)
def test_formula_corrects_as_we_do(target: str) -> None:
    @settings(max_examples=25, deadline=None, derandomize=True)
    @given(**INSTRUMENTS)
    def compare(seed: int, gauge: str, angle_rad: float) -> None:
        g_sensitivity = 1e-4 if target in WITH_G else 0.0
        parameters = made_up(seed, gauge=gauge, angle_rad=angle_rad, g_sensitivity=g_sensitivity)
        exported = export_parameters(parameters, target)
        if target not in ("dlio", "imu_calib"):
            assert not [loss for loss in exported.losses if key_of(loss) != "vio.bias"]
        check(target, parameters, dict(exported.files), (1.0, 1.0), seed)

    compare()


@pytest.mark.parametrize("target", ["vectornav", "realsense", "imucal"])
@pytest.mark.parametrize("gauge", ["lower", "upper", "symmetric"])
def test_gauge_on_request_turns_both_triads(target: str, gauge: str) -> None:
    parameters = made_up(3, gauge="preset")
    exported = export_parameters(parameters, target, ExportOptions(gauge=gauge))  # type: ignore[arg-type]
    acc, gyr = samples(4)
    a = parameters.apply_accelerometer(acc)
    their_a, their_w = FORMULAS[target](dict(exported.files), acc, gyr)
    assert their_w is not None
    R = nearest_rotation(a, their_a)
    close(their_a, a @ R.T)
    close(their_w, parameters.apply_gyroscope(gyr, a) @ R.T)
    assert "job.turned" in keys(exported.notes)
    matrix = np.linalg.lstsq(acc - acc.mean(axis=0), their_a - their_a.mean(axis=0), rcond=None)[0].T
    T = np.linalg.inv(matrix)
    T /= np.diag(T)[:, None]
    zero = {"lower": np.triu(T, 1), "upper": np.tril(T, -1), "symmetric": T - T.T}[gauge]
    np.testing.assert_allclose(zero, 0, atol=1e-10)


def test_notes_tell_the_turn_in_the_direction_it_was_made() -> None:
    parameters = made_up(6, gauge="lower")
    exported = export_parameters(parameters, "imu_tk")
    R = check("imu_tk", parameters, dict(exported.files), (1.0, 1.0), 7)
    note = with_key(exported.notes, "job.turned")
    x, y, z = (float(text) * 1e-3 for text in re.findall(r"-?\d+\.\d{4}", note))
    half = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / 2
    np.testing.assert_allclose(np.linalg.solve(np.eye(3) - half, np.eye(3) + half), R, atol=2e-7)


@pytest.mark.parametrize("target", FORMULAS)
def test_two_reversed_axes_where_the_target_takes_a_full_matrix(target: str) -> None:
    parameters = made_up(8, sign=(-1.0, 1.0, -1.0))
    if target in {"dlio", "imu_calib"}:  # a full matrix for the accelerometer alone
        like = parameters.calibration
        gyroscope = replace(like.gyroscope.parameters, scale=np.abs(like.gyroscope.parameters.scale))
        parameters = loaded(like.accelerometer, gyroscope, "lower", ("m/s^2", "rad/s"))
    check(target, parameters, dict(export_parameters(parameters, target).files), (1.0, 1.0), 9)


@pytest.mark.parametrize("target", sorted(set(FORMULAS) - RAW_UNITS_KEPT))
def test_g_and_degrees_become_si(target: str) -> None:
    unit = (1 / G0, np.degrees(1))
    parameters = made_up(10, units=("g", "deg/s"), scale=unit)
    check(target, parameters, dict(export_parameters(parameters, target).files), unit, 11)


@pytest.mark.parametrize("target", sorted(set(FORMULAS) - RAW_UNITS_KEPT))
def test_counts_with_the_scale_of_the_driver(target: str) -> None:
    unit, zero = (1670.7, 7509.9), 32768.0
    parameters = made_up(12, units=("count", "count"), scale=unit, raw_zero=zero, g_sensitivity=1e-4 * (target in WITH_G))
    options = ExportOptions(accelerometer_nominal=unit[0], gyroscope_nominal=unit[1])
    files = dict(export_parameters(parameters, target, options).files)
    acc, gyr = samples(13)
    a = parameters.apply_accelerometer(acc * unit[0] + zero)
    their_a, their_w = FORMULAS[target](files, acc, gyr)
    R = nearest_rotation(a, their_a) if target in TURNED else np.eye(3)
    close(their_a, a @ R.T)
    if their_w is not None:
        close(their_w, parameters.apply_gyroscope(gyr * unit[1] + zero, a) @ R.T)


@pytest.mark.parametrize("target", sorted(RAW_UNITS_KEPT))
def test_counts_as_they_are(target: str) -> None:
    unit = (1670.7, 7509.9)
    parameters = made_up(14, units=("count", "count"), scale=unit, raw_zero=100.0)
    check(target, parameters, dict(export_parameters(parameters, target).files), unit, 15)


def test_imucal_formula_and_package_agree() -> None:
    files = dict(export_parameters(made_up(16, g_sensitivity=1e-4), "imucal").files)
    for ours, theirs in zip(imucal_formula(files, *samples(17)), imucal_package(files, *samples(17)), strict=True):
        assert ours is not None
        assert theirs is not None
        close(theirs, ours, 1e-12)


def test_imucal_without_gyroscope_passes_it_through() -> None:
    exported = export_parameters(made_up(18, gyroscope=False), "imucal")
    acc, gyr = samples(19)
    _, w = imucal_package(dict(exported.files), acc, gyr)
    assert w is not None
    close(np.degrees(w), gyr, 1e-12)
    assert "imucal.no_gyroscope" in keys(exported.notes)


def test_openvins_rpng_has_upper_triangles_in_the_frame_of_the_gyroscope() -> None:
    parameters = made_up(20, gauge="preset", g_sensitivity=1e-4)
    files = dict(export_parameters(parameters, "openvins", ExportOptions(model="rpng")).files)
    imu, _ = kalibr_imu(files)
    for name in ("Ta", "Tw"):
        assert np.all(np.tril(np.array(imu[name]), -1) == 0)
    np.testing.assert_array_equal(imu["R_IMUtoGYRO"], np.eye(3))
    check("openvins", parameters, files, (1.0, 1.0), 21)


def test_pyins_simulates_our_raw_values_and_corrects_them(tmp_path: Path) -> None:
    # Here, as it makes Numba ready for compiling, which no other test of a whole run needs.
    from pyins.inertial_sensor import EstimationModel

    parameters = made_up(22)
    module = pyins_module(dict(export_parameters(parameters, "pyins").files), tmp_path)
    acc, gyr = samples(23)
    a = parameters.apply_accelerometer(acc)
    w = parameters.apply_gyroscope(gyr, a)
    for triad, truth, raw in ((module.ACCELEROMETER, a, acc), (module.GYROSCOPE, w, gyr)):
        simulated = triad.apply(pd.DataFrame(truth, index=0.01 * np.arange(len(truth)), columns=list("xyz")), "rate")
        close(simulated.to_numpy(), raw, 1e-12)
        close(module.correct(triad, raw), truth)
        model = EstimationModel(bias_sd=1.0, scale_misal_sd=1.0)
        model.transform, model.bias = triad.transform, triad.bias
        dt = np.full(len(raw), 0.01)
        corrected = model.correct_increments(dt, pd.DataFrame(raw * 0.01, columns=list("xyz")))
        close(corrected.to_numpy() / 0.01, truth)


def test_psins_holds_the_quadratic_term_to_first_order() -> None:
    parameters = made_up(24, quadratic=5e-6, raw_zero=2.0)  # a bias whose square counts
    exported = export_parameters(parameters, "psins")
    acc, _ = samples(25)
    acc *= 9.8 / 30
    a = parameters.apply_accelerometer(acc)
    their_a, _ = psins(dict(exported.files), acc, acc)
    error = np.abs(their_a - a @ nearest_rotation(a, their_a).T).max()
    linear, _ = vectornav(dict(export_parameters(parameters, "vectornav").files), acc, acc)
    assert error < 0.02 * np.abs(linear - a).max()
    assert key_of(exported.losses[0].values["lacks"]) == "psins.lacks"  # type: ignore[attr-defined]  # a sentence keeps its values


@pytest.mark.parametrize("target", WITH_G)
def test_the_force_a_target_takes_for_its_g_sensitivity_is_in_the_loss(target: str) -> None:
    """At rest in every direction the corrected rate is all loss: nobody's straight line is the quadratic term."""
    parameters = made_up(34, quadratic=1e-4, g_sensitivity=1e-3)
    calibration = parameters.calibration
    assert calibration.gyroscope is not None
    force = 9.8071 * directions(3000)
    raw_gyr = predict_gyroscope(calibration.gyroscope.parameters, np.zeros_like(force), force)
    exported = export_parameters(parameters, target)
    _, rate = FORMULAS[target](dict(exported.files), predict(calibration.accelerometer, force), raw_gyr)
    assert rate is not None
    length_mrad_s = np.linalg.norm(rate, axis=1) * 1e3
    lacks = Sentences("imufield.deliver.exports")("loss.sensitivity_by_force")
    (loss,) = [loss for loss in exported.losses if lacks in loss]
    assert key_of(loss) == "loss.gyroscope"
    rms, largest = re.findall(r"([\d.e-]+) mrad/s", loss)
    assert float(rms) == pytest.approx(np.sqrt(np.mean(length_mrad_s**2)), rel=0.02)
    assert float(largest) == pytest.approx(length_mrad_s.max(), rel=0.02)
    # A line through the middle of all directions leaves x^2 - 1/3 of the term on each axis, not x^2.
    k, G = calibration.accelerometer.quadratic / calibration.accelerometer.scale, calibration.gyroscope.parameters.g_sensitivity
    middle = np.linalg.norm((9.8071**2 * k * (directions(3000) ** 2 - 1 / 3)) @ G.T, axis=1) * 1e3
    assert float(rms) == pytest.approx(np.sqrt(np.mean(middle**2)), rel=0.05)


@pytest.mark.parametrize("target", ["px4", "ardupilot", "microstrain"])
def test_an_instrument_without_misalignment_is_held_exactly(target: str) -> None:
    like = made_up(26, angle_rad=0.0).calibration
    gyroscope = like.gyroscope.parameters
    unit_gyroscope = type(gyroscope)(np.ones(3), np.zeros((3, 3)), gyroscope.bias, np.zeros((3, 3)))
    accelerometer = like.accelerometer
    if target == "microstrain":
        accelerometer = replace(accelerometer, scale=np.ones(3), misalignment_rad=np.zeros((3, 3)))
    parameters = loaded(accelerometer, unit_gyroscope, "lower", ("m/s^2", "rad/s"))
    exported = export_parameters(parameters, target)
    assert exported.losses == ()
    acc, gyr = samples(27)
    their_a, their_w = DIAGONAL[target](dict(exported.files), acc, gyr)
    relative = 1e-6 if target == "microstrain" else 1e-9
    close(their_a, parameters.apply_accelerometer(acc), relative)
    close(their_w, parameters.apply_gyroscope(gyr, acc), relative)


def small(bias_m_s2: float, scale_error: float) -> Parameters:
    """Return an instrument whose offsets or scales are so good already that PX4 does not take them."""
    like = made_up(28, angle_rad=3e-3).calibration
    accelerometer = replace(
        like.accelerometer, bias_m_s2=bias_m_s2 * np.array([1.0, -1.0, 0.5]), scale=1 + scale_error * np.array([1.0, 0.5, -1.0])
    )
    return loaded(accelerometer, like.gyroscope.parameters, "lower", ("m/s^2", "rad/s"))


@pytest.mark.parametrize(
    ("target", "parameters"),
    [
        *((target, made_up(28, angle_rad=3e-3, quadratic=2e-6)) for target in DIAGONAL),
        *(("px4", small(bias, error)) for bias, error in ((5e-3, 5e-3), (5e-3, 2e-2), (5e-2, 5e-3))),
    ],
)
def test_what_a_diagonal_cannot_hold_is_what_is_printed(target: str, parameters: Parameters) -> None:
    """The loss in the sentence is that of the target's formula on the written file, over other directions than ours."""
    exported = export_parameters(parameters, target)
    rng = np.random.default_rng(29)
    up = rng.normal(size=(20000, 3))
    force = 9.8071 * up / np.linalg.norm(up, axis=1, keepdims=True)
    calibration = parameters.calibration.accelerometer
    s = force @ (np.eye(3) + calibration.misalignment_rad).T
    raw = calibration.scale * (s + calibration.bias_m_s2) + calibration.quadratic * s**2
    theirs, _ = DIAGONAL[target](dict(exported.files), raw, raw)
    difference = theirs - force @ nearest_rotation(force, theirs).T
    rms_mg = np.sqrt(np.mean(np.sum(difference**2, axis=1))) / G0 * 1e3
    loss = with_key(exported.losses, "loss.accelerometer")
    printed = float(re.search(r"([\d.e-]+) mg RMS", loss)[1])  # type: ignore[index]
    assert printed == pytest.approx(rms_mg, rel=0.02)
    assert "loss.gyroscope" in keys(exported.losses)


def test_refitted_diagonal_is_better_than_a_cut_one() -> None:
    """Gravity's magnitude over all directions: the diagonal of M in the lower gauge against what ArduPilot gets."""
    up = np.random.default_rng(30).normal(size=(20000, 3))
    force = 9.8071 * up / np.linalg.norm(up, axis=1, keepdims=True)
    for seed in range(10):
        parameters = made_up(seed, angle_rad=0.02, quadratic=2e-5)
        p = parameters.calibration.accelerometer
        s = force @ (np.eye(3) + p.misalignment_rad).T
        raw = p.scale * (s + p.bias_m_s2) + p.quadratic * s**2
        M = np.linalg.inv(p.scale[:, None] * (np.eye(3) + p.misalignment_rad))
        cut = (raw - p.scale * p.bias_m_s2) * np.diag(M)
        refitted, _ = ardupilot(dict(export_parameters(parameters, "ardupilot").files), raw, raw)
        errors = [np.std(np.linalg.norm(value, axis=1) - 9.8071) + abs(np.mean(np.linalg.norm(value, axis=1)) - 9.8071)
                  for value in (refitted, cut)]  # fmt: skip
        assert errors[0] < errors[1]


def test_refit_over_all_directions_is_better_than_a_fit_to_the_positions() -> None:
    """24 positions placed within 9 degrees: what misalignment leaks into scale there is worse everywhere else."""
    everywhere = directions(2000) * 9.8071
    planned = np.array([position.direction for position in scheme("paper24").positions], dtype=float)
    losses = []
    for seed in range(10):
        parameters = made_up(seed, angle_rad=2e-3)
        p = parameters.calibration.accelerometer
        up = planned + np.random.default_rng(seed).normal(scale=0.15, size=planned.shape)
        raw = predict(p, 9.8071 * up / np.linalg.norm(up, axis=1, keepdims=True))
        origin = to_vector(p)
        origin[6:] = 0.0
        diagonal = fit(
            FitData(raw=raw, covariance_raw=None, gravity_m_s2=9.8071, quadratic_axes="sensing"),
            origin,
            column_basis(origin, tuple(range(6)), 9.8071),
        ).vector
        output = predict(p, everywhere)
        fitted = output / diagonal[:3] - diagonal[3:6]
        refitted, _ = ardupilot(dict(export_parameters(parameters, "ardupilot").files), output, output)
        losses.append(
            [np.linalg.norm(value - everywhere @ nearest_rotation(everywhere, value).T) for value in (refitted, fitted)]
        )
    assert np.all(np.array(losses)[:, 0] < np.array(losses)[:, 1])


@pytest.mark.parametrize("target", ["dlio", "imu_calib", "px4", "ardupilot", "microstrain"])
def test_a_reversed_gyroscope_is_refused_where_only_its_bias_is_held(target: str) -> None:
    like = made_up(30).calibration
    gyroscope = replace(like.gyroscope.parameters, scale=-like.gyroscope.parameters.scale)
    with refused(ParameterFileError, Reason.BOUNDS, target, "gyroscope") as caught:
        export_parameters(loaded(like.accelerometer, gyroscope, "lower", ("m/s^2", "rad/s")), target)
    assert caught.value.values["axis"] == "x"
    assert caught.value.values["scale"] < 0
