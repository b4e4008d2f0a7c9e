from __future__ import annotations

import json
import math
import subprocess
import sys
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import imufield
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.deliver.parameters.consistency import contradiction
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import (
    as_written,
    from_document,
    json_ready,
    load,
    parameter_schema,
    to_document,
    to_toml,
    write_parameters,
)
from imufield.deliver.parameters.read import parse_document, read_document
from imufield.deliver.parameters.write import write_document
from imufield.errors import ImufieldError, ParameterFileError, Reason
from imufield.sentences import printable
from tests.parameter_files import edit
from tests.refused import refused
from tests.told import key_of


@pytest.fixture
def file(tmp_path: Path, calibration: Calibration, observations: Observations, context: Context) -> Path:
    path = tmp_path / "parameters.toml"
    assert write_parameters(path, calibration, observations, context) is None
    return path


def refusal(path: Path) -> ParameterFileError:
    with pytest.raises(ParameterFileError) as caught:
        load(path)
    assert caught.value.exit_code == 5
    assert "\n" not in caught.value.message
    assert ";" in caught.value.message, "no remedy"
    return caught.value


def assert_same(one: Any, other: Any) -> None:
    """Compare two values to the last bit, NaN equal to NaN."""
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, (np.ndarray, float)):
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


def test_what_is_loaded_is_what_was_written(file: Path, calibration: Calibration, context: Context) -> None:
    loaded = imufield.load(file)
    assert_same(loaded.calibration, calibration)
    assert_same(loaded.context, context)
    assert not loaded.edited


def test_six_faces_without_gyroscope_and_noise_pass_too(
    tmp_path: Path, six_faces: Calibration, observations: Observations, context: Context
) -> None:
    path = tmp_path / "p.toml"
    write_parameters(path, six_faces, observations, replace(context, noise=None))
    loaded = load(str(path))
    assert_same(loaded.calibration, six_faces)
    assert loaded.context.noise is None
    jsonschema.validate(json_ready(loaded.document), parameter_schema())


def test_a_gyroscope_that_was_not_calibrated_is_said_to_be_none(
    file: Path, six_faces: Calibration, observations: Observations, context: Context
) -> None:
    loaded = load(file)
    assert key_of(loaded.gyroscope_note) == "file.bias_with_scale"
    write_parameters(file, six_faces, observations, context)
    assert "parameters.toml" in load(file).gyroscope_note
    assert key_of(load(file).gyroscope_note) == "file.not_calibrated"
    gyroscope = loaded.calibration.gyroscope
    assert gyroscope is not None
    known = replace(gyroscope, sigma=replace(gyroscope.sigma, scale=np.full(3, 1e-4)))
    assert replace(loaded, calibration=replace(loaded.calibration, gyroscope=known)).gyroscope_note == ""


def test_the_file_is_toml_that_meets_the_schema(file: Path) -> None:
    document = tomllib.loads(file.read_text(encoding="utf-8"))
    jsonschema.validate(json_ready(document), parameter_schema())
    assert len(document["position"]) == document["session"]["positions"] == 24
    assert list(document)[-1] == "integrity"


def test_json_and_file_have_one_content(
    file: Path, calibration: Calibration, observations: Observations, context: Context
) -> None:
    printed = json.loads(json.dumps(json_ready(to_document(calibration, observations, context)), allow_nan=False))
    stored = json_ready(read_document(file).document)
    del stored["integrity"]
    assert printed == stored


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)
@given(start=st.lists(st.floats(-1e15, 1e15), min_size=24, max_size=24), name=st.text())
def test_any_float_and_any_text_survive(
    calibration: Calibration, observations: Observations, context: Context, start: list[float], name: str
) -> None:
    name = name.encode("utf-8", "replace").decode("utf-8")
    with_start = replace(observations, start_s=np.array(start))
    with_name = replace(context, session=replace(context.session, name=name))
    document = parse_document(to_toml(to_document(calibration, with_start, with_name))).document
    found = [table["start_s"] for table in document["position"]]
    assert found == start
    assert np.signbit(found).tolist() == np.signbit(start).tolist()
    # What would control a terminal is made visible where a file is read.
    assert document["session"]["name"] == printable(name)


def test_an_existing_file_is_kept(file: Path, calibration: Calibration, observations: Observations, context: Context) -> None:
    first = file.read_bytes()
    other = replace(context, created="2025-03-02T10:55:00Z", session=replace(context.session, name="another"))
    kept = write_parameters(file, calibration, observations, other)
    assert kept == file.with_name("parameters-1.toml")
    assert kept.read_bytes() == first
    assert load(file).context.created == "2025-03-02T10:55:00Z"


def test_the_same_at_another_time_is_the_file_that_is_there(
    file: Path, calibration: Calibration, observations: Observations, context: Context
) -> None:
    def made(created: str) -> dict[str, Any]:
        return to_document(calibration, observations, replace(context, created=created))

    first, later = file.read_bytes(), made("2099-03-02T10:55:00Z")
    document = as_written(file, later)
    assert document == later | {"created": context.created}
    assert write_document(file, document) is None
    assert file.read_bytes() == first
    # What was written by a clock that was ahead is put right, and a changed file is another one, whatever its hash says.
    earlier = made("1999-03-02T10:55:00Z")
    assert as_written(file, earlier) == earlier
    name = context.session.name.encode()
    for edited in (
        first.replace(name, b"x"),
        first + b"# x\n",
        b"x = " + b"[" * 100_000,
        b"\xff",
        first.replace(b"\n", b"\r\n"),
    ):
        file.write_bytes(edited)
        assert as_written(file, later) == later
    file.unlink()
    assert as_written(file, later) == later


def test_a_full_disk_leaves_the_old_file(
    file: Path, calibration: Calibration, observations: Observations, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_space(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    before = file.read_bytes()
    monkeypatch.setattr("os.fsync", no_space)
    # What stands there already would not be written.
    other = replace(calibration, accelerometer=replace(calibration.accelerometer, scale=calibration.accelerometer.scale * 1.1))
    with refused(ParameterFileError, Reason.DISK_FULL, "parameters.toml") as caught:
        write_parameters(file, other, observations, context)
    assert caught.value.values["errno"] == 28
    assert caught.value.reason is Reason.DISK_FULL
    assert {path.name: path.read_bytes() for path in file.parent.iterdir()} == {"parameters.toml": before}


def test_a_parameter_that_is_nan_is_not_written(
    file: Path, calibration: Calibration, observations: Observations, context: Context
) -> None:
    before = file.read_bytes()
    broken = replace(calibration, accelerometer=replace(calibration.accelerometer, scale=np.array([1.0, np.nan, 1.0])))
    with refused(ParameterFileError, Reason.NOT_FINITE, "nan", key="write.fault") as caught:
        write_parameters(file, broken, observations, context)
    assert caught.value.values["key"] == "accelerometer.scale[1]"
    assert caught.value.reason is Reason.NOT_FINITE
    assert file.read_bytes() == before


def test_every_cut_is_refused(file: Path) -> None:
    whole = file.read_bytes()
    # The last newline is no content.
    for length in [*range(0, len(whole) - 1, 97), *range(len(whole) - 90, len(whole) - 1)]:
        file.write_bytes(whole[:length])
        refusal(file)


def test_every_changed_value_is_refused_and_a_changed_comment_is_not(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("# Gravity is a common", "# Our gravimeter. Gravity is a common"), encoding="utf-8")
    assert not load(file).edited
    for old, new in [("height_m = 520.0", "height_m = 521.0"), ("0.0312", "0.0313"), ("used = true", "used = false")]:
        assert old in text
        file.write_text(text.replace(old, new, 1), encoding="utf-8")
        error = refusal(file)
        assert error.reason is Reason.DAMAGED
        assert key_of(error.message) == "read.changed"


def test_a_change_on_purpose_is_taken_and_remembered(file: Path) -> None:
    loaded = load(edit(file, "height_m = 520.0", "height_m = 521.0"))
    assert loaded.edited
    assert loaded.calibration.gravity.height_m == 521.0


def test_a_gyroscope_about_the_middle_of_a_converter(
    calibration: Calibration, observations: Observations, context: Context, tmp_path: Path
) -> None:
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    counted = replace(calibration, gyroscope=replace(gyroscope, parameters=gyroscope.parameters.about(np.full(3, -0.5))))
    path = tmp_path / "counted.toml"
    write_parameters(path, counted, observations, context)
    assert_same(load(path).calibration, counted)
    raw = np.random.default_rng(1).normal(size=(9, 6))
    plain = from_document(to_document(calibration, observations, context))
    assert "raw_zero" not in plain.document["gyroscope"]
    np.testing.assert_allclose(load(path).apply(raw), plain.apply(raw), atol=1e-14)
    edit(path, 'equation = "N - raw_zero = K E w', 'equation = "N = K E w')
    assert refusal(path).values["key"].startswith("gyroscope.equation")


def test_a_byte_order_mark_of_an_editor_is_no_damage(file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert not load(file).edited


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("scale = [1.000123456789,", "scale = [2.0,", "accelerometer.intrinsic.scale"),
        ("bias_m_s2 = [0.0312,", "bias_m_s2 = [1.0,", "accelerometer.intrinsic.bias_raw"),
        ("[0.00131, 0.0, 0.0]", "[0.01, 0.0, 0.0]", "accelerometer.intrinsic"),
        ('gauge = "lower"', 'gauge = "upper"', "accelerometer.gauge"),
        ('gauge = "lower"', 'gauge = "symmetric"', "accelerometer.gauge"),
        ('equation = "N - raw_zero', 'equation = "N + raw_zero', "accelerometer.equation"),
        ('quadratic_axes = "sensing"', 'quadratic_axes = "body"', "accelerometer.equation"),
        ('raw_unit = "m/s^2"', 'raw_unit = "furlong"', "accelerometer.raw_unit"),
        ('raw_unit = "m/s^2"', 'raw_unit = "g"', "accelerometer.raw_unit"),
        ('raw_unit = "rad/s"', 'raw_unit = "deg/s"', "gyroscope.raw_unit"),
        ('equation = "N = K E w', 'equation = "N = K E v', "gyroscope.equation"),
        ("bias_rad_s = [0.0001,", "bias_rad_s = [0.0002,", "gyroscope.bias_rad_s"),
    ],
)
def test_an_edited_file_that_contradicts_itself_is_refused_by_its_key(file: Path, old: str, new: str, key: str) -> None:
    edit(file, old, new)
    error = refusal(file)
    assert error.values["key"].startswith(key)
    assert f": {key}" in error.message
    assert error.exit_code == 5


def test_an_edited_file_whose_numbers_follow_from_one_another_is_taken(file: Path) -> None:
    edit(file, "bias_m_s2 = [0.0312,", "bias_m_s2 = [0.04,")
    edit(file, f"bias_raw = [{1.000123456789 * 0.0312!r},", "bias_raw = [0.04000494,")
    assert load(file).edited


def indefinite(document: dict[str, Any]) -> None:
    matrix = document["covariance"]["matrix"]
    for i, j, correlation in ((0, 1, 0.9), (1, 2, 0.9), (0, 2, -0.9)):
        matrix[i][j] = matrix[j][i] = correlation * math.sqrt(matrix[i][i] * matrix[j][j])


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda it: it["accelerometer"].update(scale=[-1.000123456789, 0.99987654321, 1.00031]), "accelerometer.intrinsic"),
        (lambda it: it["accelerometer"].update(gauge="symmetric"), "accelerometer.gauge"),
        (lambda it: it["accelerometer"].update(raw_unit="furlong"), "accelerometer.raw_unit"),
        (lambda it: it["site"].update(gravity_m_s2=9.8), "position[0].residual_m_s2"),
        (lambda it: it["position"][3].update(mean_raw=[1.0, 2.0, 9.0]), "position[3].residual_m_s2"),
        (lambda it: it["position"][5].update(residual_m_s2=0.0), "position[5].residual_m_s2"),
        (lambda it: it["quality"].update(residual_rms_m_s2=1e-7), "quality.residual_rms_m_s2"),
        (lambda it: it["quality"].update(residual_max_m_s2=1e-7), "quality.residual_max_m_s2"),
        (lambda it: it["quality"].update(leave_one_out_rms_m_s2=0.06), "quality.verdict"),
        (lambda it: it["quality"].update(degrees_of_freedom=0), "quality.verdict"),
        (lambda it: it["solver"].update(status=0), "quality.verdict"),
        (lambda it: it["accelerometer"]["uncertainty"].update(scale=[1e-9, 5.3e-5, 5.4e-5]), "covariance.matrix"),
        (lambda it: it["site"].update(gravity_sigma_m_s2=0.0), "covariance.matrix"),
        (lambda it: it["covariance"]["names"].__setitem__(0, "accelerometer.charm.x"), "covariance.names"),
        (indefinite, "covariance.matrix"),
    ],
)
def test_a_file_with_a_right_hash_that_contradicts_itself_is_refused(file: Path, change: Any, key: str) -> None:
    """Whoever makes the hash anew vouches for nothing."""
    document = tomllib.loads(file.read_text(encoding="utf-8"))
    del document["integrity"]
    file.write_text(to_toml(document), encoding="utf-8")
    assert not load(file).edited
    change(document)
    file.write_text(to_toml(document), encoding="utf-8")
    error = refusal(file)
    assert f": {key}" in error.message
    assert error.values["key"] == key or error.values["key"].startswith("accelerometer.intrinsic")


def test_a_calibration_that_calls_itself_poor_may_have_any_scale(file: Path) -> None:
    document = tomllib.loads(file.read_text(encoding="utf-8"))
    document["accelerometer"]["scale"] = [6.5, 0.99987654321, 1.00031]
    assert contradiction(document).startswith("accelerometer.raw_unit")
    document["quality"]["verdict"] = "poor"
    # What else follows from the scale is still looked at.
    assert contradiction(document).startswith("accelerometer.intrinsic")


@pytest.mark.parametrize(
    ("old", "new", "reason", "key", "facts"),
    [
        ("version = 1", "version = 3", Reason.NEWER, "read.newer", ["version 3"]),
        ("version = 1", "version = true", Reason.DAMAGED, "read.version", ["True"]),
        ("version = 1", "version = -1", Reason.DAMAGED, "read.version", ["-1"]),
        ("version = 1", "version = 0", Reason.UNKNOWN_KEY, "versions.unknown", ["accelerometer.raw_zero", "version 0"]),
        ('"imufield-parameters"', '"imufield-recording"', Reason.FOREIGN, "read.format", ['format = "imufield-parameters"']),
        ("gauge = ", 'colour = "red"\ngauge = ', Reason.UNKNOWN_KEY, "schema.unknown", ["accelerometer.colour"]),
        ("positions = 24", "positions = 23", Reason.DAMAGED, "consistency.position_count", ["23", "24 [[position]]"]),
        ("used = true", 'used = "yes"', Reason.DAMAGED, "schema.type", ["position[0].used", "'yes'", "true or false"]),
        ("scale = [1.000123456789", "scale = [0.0", Reason.DAMAGED, "consistency.zero_scale", ["accelerometer.scale"]),
        ("scale = [1.000123456789", "scale = [nan", Reason.NOT_FINITE, "schema.nan", ["accelerometer.scale[0]"]),
        ("[0.0, 0.0, 0.0],\n", "[0.1, 0.0, 0.0],\n", Reason.DAMAGED, "consistency.diagonal", ["misalignment_rad"]),
        ('names = ["', 'names = ["extra", "', Reason.DAMAGED, "consistency.covariance_size", ["20 by 20"]),
        ("created = ", "created = 2025-01-01 #", Reason.DAMAGED, "schema.type", ["created"]),
        ("version = 1", "version = 1" + 5000 * "0", Reason.DAMAGED, "toml_and_json.integer", ["line "]),
        ("gravity_m_s2 = 9.8", "gravity_m_s2 = 98.", Reason.DAMAGED, "schema.maximum", ["site.gravity_m_s2", "98", "9.84"]),
        ("rank = 12", "rank = 0x" + 9000 * "f", Reason.DAMAGED, "toml_and_json.integer", []),
        ("rank = 12", "rank = " + 5000 * "[", Reason.DAMAGED, "toml_and_json.nested", []),
        ("rank = 12", "rank" + 5000 * ".a" + " = 1", Reason.DAMAGED, "toml_and_json.nested", []),
    ],
)
def test_refused_in_one_sentence(file: Path, old: str, new: str, reason: Reason, key: str, facts: list[str]) -> None:
    if 'names = ["' in old:
        old, new = "names = [\n", 'names = [\n    "extra",\n'
    edit(file, old, new)
    error = refusal(file)
    # What is wrong with a key stands inside the sentence that names the file.
    what = error.message if key.startswith(("read.", "toml_and_json.")) else error.values["what"]
    assert key_of(what) == key, error
    assert "parameters.toml" in error.message
    assert all(fact in what for fact in facts), error
    assert error.reason is reason


@pytest.mark.parametrize(
    ("row", "column", "factor", "key"),
    [(0, 0, -1.0, "variance"), (0, 1, 1.1, "not_symmetric"), (1, 1, 1e-6, "correlation")],
)
def test_a_covariance_that_is_none_is_refused(file: Path, row: int, column: int, factor: float, key: str) -> None:
    document = dict(load(file).document)
    matrix = np.array(document["covariance"]["matrix"], dtype=np.float64)
    assert matrix[0, 1] != 0
    matrix[row, column] *= factor
    document["covariance"] = document["covariance"] | {"matrix": matrix.tolist()}
    del document["integrity"]
    file.write_text(to_toml(document), encoding="utf-8")
    error = refusal(file)
    assert key_of(error.values["what"]) == f"consistency.{key}"
    assert error.values["key"] == "covariance.matrix"


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_any_flipped_byte_gives_the_same_parameters_or_the_error(file: Path, data: st.DataObject) -> None:
    whole = file.read_bytes()
    position = data.draw(st.integers(0, len(whole) - 1))
    broken = bytearray(whole)
    broken[position] ^= data.draw(st.integers(1, 255))
    path = file.with_name("broken.toml")
    path.write_bytes(broken)
    try:
        loaded = load(path)
    except ParameterFileError:
        return
    # Only a comment, a blank or the last newline can have been hit.
    assert loaded.document == load(file).document or json_ready(loaded.document) == json_ready(load(file).document)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    typed = refusal(tmp_path / "none.toml")
    assert (typed.reason, key_of(typed.message)) == (Reason.FOREIGN, "read.not_there")
    # A folder stands for the file that solving makes.
    no_session = refusal(tmp_path)
    assert (no_session.reason, key_of(no_session.message)) == (Reason.FOREIGN, "read.no_session")
    (tmp_path / "session.toml").touch()
    not_solved = refusal(tmp_path)
    assert (not_solved.reason, key_of(not_solved.message)) == (Reason.FOREIGN, "read.not_solved")
    assert f"imufield solve {tmp_path}" in not_solved.message
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    assert "b.toml" in refusal(tmp_path / "b.toml").message
    assert key_of(refusal(tmp_path / "b.toml").message) == "toml_and_json.no_text"
    with (tmp_path / "large.toml").open("wb") as large:
        large.truncate(2**30)
    assert "large.toml" in refusal(tmp_path / "large.toml").message
    assert key_of(refusal(tmp_path / "large.toml").message) == "read.not_there"


def test_importing_the_package_imports_nothing_heavy() -> None:
    program = "import sys, imufield; print(sorted({'numpy', 'scipy', 'rich', 'mcap'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_an_unknown_name_of_the_package_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="unload"):
        imufield.unload  # noqa: B018  # reading it is the test


def test_document_to_parameters_without_a_file(
    calibration: Calibration, observations: Observations, context: Context, parameters: AccelerometerParameters
) -> None:
    made = from_document(to_document(calibration, observations, context))
    assert made.path is None
    assert_same(made.calibration.accelerometer, parameters)
    with refused(ImufieldError, Reason.UNITS, key="file.unit") as caught:
        made.check_unit("accelerometer", "g")
    assert caught.value.values["wanted"] == "m/s^2"
    assert caught.value.values["unit"] == "g"
