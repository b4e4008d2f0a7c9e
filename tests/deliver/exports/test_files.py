"""What stands in the files beside the numbers, and every refusal."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from made_up_instruments import loaded, made_up

from imufield.deliver.exports import TARGETS, ExportOptions, export_options, export_parameters, write_exported
from imufield.deliver.exports.microstrain import packet
from imufield.deliver.exports.text import number, yaml_lines
from imufield.deliver.exports.vectornav import with_checksum
from imufield.errors import ImufieldError, ParameterFileError, Reason, UsageError
from tests.refused import refused
from tests.told import keys, told, with_key

SI_ONLY = sorted(set(TARGETS) - {"c", "binary", "json", "yaml", "imu_tk", "imucal"})
ONE_FRAME = ("kalibr", "openvins", "basalt", "imu_tk", "psins")
POSITIVE_ONLY = ("px4", "ardupilot", "microstrain")


def test_listing_the_targets_imports_nothing_heavy() -> None:
    code = "import sys, imufield.deliver.exports as e; assert 'px4' in e.TARGETS; print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "imufield.deliver.parameters.file"} & set(out)


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_exports_and_says_what_it_lost(target: str) -> None:
    exported = export_parameters(made_up(1, quadratic=1e-5, g_sensitivity=1e-4), target)
    assert exported.files
    assert all(exported.files.values())
    assert bool(exported.losses) == (target not in ("c", "binary", "json", "yaml"))
    for sentence_ in (*exported.losses, *exported.notes):
        assert "\n" not in sentence_
        assert not sentence_.endswith(".")
    assert all("mg" in loss or "mrad/s" in loss for loss in exported.losses)


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_goes_without_gyroscope(target: str) -> None:
    exported = export_parameters(made_up(2, gyroscope=False), target)
    assert "loss.gyroscope" not in keys(exported.losses)


@pytest.mark.parametrize("target", TARGETS)
def test_what_was_not_determined_is_said_with_the_verdict(target: str) -> None:
    made = made_up(2)
    hidden = tuple(f"accelerometer.misalignment_rad.{place}" for place in ("yx", "zx", "zy"))
    quality = replace(made.calibration.quality, verdict="usable")
    unsure = replace(made, calibration=replace(made.calibration, unobservable=hidden, quality=quality))
    exported = export_parameters(unsure, target)
    (note,) = told(exported.notes, "job.not_determined")
    assert note.values["names"] == ["accelerometer.misalignment_rad"]
    assert told(exported.notes, "job.usable")
    assert not {"job.not_determined", "job.usable"} & set(keys(export_parameters(made, target).notes))


@pytest.mark.parametrize("target", TARGETS)
def test_gyroscope_without_scale_is_left_out_and_said(target: str) -> None:
    made = made_up(3).calibration
    gyroscope = replace(made.gyroscope.parameters, scale=np.full(3, np.nan))
    exported = export_parameters(loaded(made.accelerometer, gyroscope, "lower", ("m/s^2", "count")), target)
    assert "job.no_gyroscope" in keys(exported.notes)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["scale", "bias_m_s2", "misalignment_rad", "quadratic", "raw_zero"])
def test_nan_is_refused(target: str, name: str) -> None:
    made = made_up(4).calibration
    spoilt = getattr(made.accelerometer, name).copy()
    spoilt.flat[1] = np.nan
    accelerometer = replace(made.accelerometer, **{name: spoilt})
    with refused(ParameterFileError, Reason.NOT_FINITE, name, key="conventions.not_usable") as caught:
        export_parameters(loaded(accelerometer, None, "lower", ("m/s^2", "rad/s")), target)
    assert caught.value.exit_code == 5
    assert caught.value.reason is Reason.NOT_FINITE


def test_nan_of_a_gyroscope_is_refused() -> None:
    made = made_up(4).calibration
    assert made.gyroscope is not None
    gyroscope = replace(made.gyroscope.parameters, raw_zero=np.array([0.0, np.nan, 0.0]))
    with refused(ParameterFileError, Reason.NOT_FINITE, "gyroscope.raw_zero", key="conventions.not_usable"):
        export_parameters(loaded(made.accelerometer, gyroscope, "lower", ("m/s^2", "rad/s")), "px4")


@pytest.mark.parametrize("target", SI_ONLY)
def test_counts_are_refused_where_only_si_is_known(target: str) -> None:
    parameters = made_up(5, units=("count", "count"), scale=(1670.7, 7509.9))
    with refused(ParameterFileError, Reason.UNITS, "accelerometer", key="job.unit") as caught:
        export_parameters(parameters, target)
    assert caught.value.values["unit"] == "count"
    assert caught.value.values["target"] == target
    assert caught.value.exit_code == 5
    assert caught.value.reason is Reason.UNITS


@pytest.mark.parametrize("target", POSITIVE_ONLY)
@pytest.mark.parametrize("sign", [(-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, -1.0, -1.0)])
def test_sign_that_cannot_be_expressed_is_refused(target: str, sign: tuple[float, float, float]) -> None:
    with refused(ParameterFileError, Reason.BOUNDS, target, "accelerometer", key="job.sign") as caught:
        export_parameters(made_up(6, sign=sign), target)
    assert caught.value.values["scale"] < 0
    assert caught.value.exit_code == 5


@pytest.mark.parametrize("target", ONE_FRAME)
def test_another_gauge_is_refused_where_the_target_fixes_it(target: str) -> None:
    with refused(UsageError, Reason.USAGE, target, "gauge = symmetric", key="job.gauge"):
        export_parameters(made_up(7), target, ExportOptions(gauge="symmetric"))


def test_ardupilot_refuses_what_is_out_of_its_range() -> None:
    made = made_up(8).calibration.accelerometer
    for accelerometer in (replace(made, scale=made.scale * 1.4), replace(made, bias_m_s2=np.array([0.0, 4.0, 0.0]))):
        with refused(ParameterFileError, Reason.BOUNDS, "ArduPilot", "axis", key="flight_stack.range"):
            export_parameters(loaded(accelerometer, None, "lower", ("m/s^2", "rad/s")), "ardupilot")


def test_px4_refuses_a_scale_of_another_unit() -> None:
    with refused(ParameterFileError, Reason.BOUNDS, "PX4", key="flight_stack.range"):
        export_parameters(made_up(8), "px4", ExportOptions(accelerometer_nominal=100.0))


@pytest.mark.parametrize(
    ("target", "names"), [("px4", ["CAL_ACC0_ID", "CAL_GYRO0_ID"]), ("ardupilot", ["INS_ACC_ID", "INS_GYR_ID"])]
)
def test_every_id_that_is_missing_is_named(target: str, names: list[str]) -> None:
    one, both = ExportOptions(accelerometer_id=7), ["--set accelerometer_id=N", "--set gyroscope_id=N"]
    for options, first in ((ExportOptions(), 0), (one, 1), (replace(one, gyroscope_id=8), 2)):
        said = told(export_parameters(made_up(8), target, options).notes, f"{target}.no_id")
        found = [(note.values["names"], note.values["options"]) for note in said]
        assert found == ([] if first == 2 else [(names[first:], " ".join(both[first:]))])
    (alone,) = told(export_parameters(made_up(8, gyroscope=False), target).notes, f"{target}.no_id")
    assert (alone.values["names"], alone.values["options"]) == (names[:1], both[0])


@pytest.mark.parametrize("key", ["vectornav.factory", *(f"{name}.replaces" for name in ("px4", "ardupilot", "microstrain"))])
def test_what_corrects_its_own_output_says_from_what_to_calibrate(key: str) -> None:
    assert key in keys(export_parameters(made_up(8), key.partition(".")[0]).notes)


def test_imu_calib_says_which_of_its_topics_to_calibrate_from() -> None:
    assert "ros_yaml.imu_calib_raw" in keys(export_parameters(made_up(8), "imu_calib").notes)


@pytest.mark.parametrize(
    ("target", "name", "text"),
    [
        ("px4", "accelerometer_id", "0"),
        ("px4", "gyroscope_id", "99999999999"),
        ("ardupilot", "accelerometer_id", "-5"),
        ("kalibr", "accelerometer_random_walk", "-1"),
        ("kalibr", "gyroscope_random_walk", "0"),
        ("kalibr", "gyroscope_random_walk", "nan"),
    ],
)
def test_numbers_that_are_of_no_sensor_are_refused(target: str, name: str, text: str) -> None:
    with refused(UsageError, Reason.USAGE, name, text, key="registry.limits"):
        export_options({name: text}, target)


@pytest.mark.parametrize(("target", "instance"), [("px4", 4), ("px4", -1), ("ardupilot", 5)])
def test_instance_that_does_not_exist(target: str, instance: int) -> None:
    with refused(UsageError, Reason.USAGE, f"{instance}", "instance", key="flight_stack.instance"):
        export_parameters(made_up(9), target, ExportOptions(instance=instance))


@pytest.mark.parametrize(
    ("instance", "names"),
    [
        (
            0,
            (
                "INS_ACC_ID",
                "INS_ACC1_CALTEMP",
                "INS_GYR1_CALTEMP",
                "INS_ACCOFFS_X",
                "INS_ACCSCAL_Z",
                "INS_GYR_ID",
                "INS_GYROFFS_Y",
            ),
        ),
        (1, ("INS_ACC2_ID", "INS_ACC2_CALTEMP", "INS_ACC2OFFS_X", "INS_ACC2SCAL_Z", "INS_GYR2_ID", "INS_GYR2OFFS_Y")),
        (3, ("INS4_ACC_ID", "INS4_ACC_CALTEMP", "INS4_ACCOFFS_X", "INS4_ACCSCAL_Z", "INS4_GYR_ID", "INS4_GYROFFS_Y")),
    ],
)
def test_ardupilot_names(instance: int, names: tuple[str, ...]) -> None:
    options = ExportOptions(instance=instance, accelerometer_id=2753028, gyroscope_id=2753036)
    text = export_parameters(made_up(10), "ardupilot", options).files["ardupilot.param"].decode()
    lines = [line.partition(",")[0] for line in text.splitlines() if not line.startswith("#")]
    assert set(names) <= set(lines)
    assert "2753028" in text


def test_px4_lines_are_those_of_qgroundcontrol() -> None:
    options = ExportOptions(instance=2, accelerometer_id=1310988)
    exported = export_parameters(made_up(11), "px4", options)
    lines = exported.files["px4.params"].decode().splitlines()
    assert "# Vehicle-Id Component-Id Name Value Type" in lines
    assert "1\t1\tCAL_ACC2_ID\t1310988\t6" in lines
    assert not [line for line in lines if "_TEMP" in line]  # PX4 has no such parameters any more (PX4#19320)
    rows = [line.split("\t") for line in lines if not line.startswith("#")]
    assert all(len(row) == 5 for row in rows)
    assert {row[4] for row in rows} == {"6", "9"}


def test_vectornav_checksums(shared_folder: Path) -> None:
    vectors = json.loads((shared_folder / "wire" / "vectornav.vectors.json").read_text())
    known = [v["ascii"] for v in (vector.get("decoded", {}) for vector in vectors) if "VNWRG" in v.get("ascii", "")]
    assert len(known) >= 3
    for line in (text.removesuffix("<CR><LF>") for text in known):
        assert with_checksum(line[1:].partition("*")[0]) == line
    text = export_parameters(made_up(12), "vectornav").files["vectornav.txt"].decode()
    assert text.endswith("$VNWNV*57\r\n")
    for line in text.split("\r\n")[:-1]:
        assert with_checksum(line[1:].partition("*")[0]) == line
        assert len(line) < 256


def test_microstrain_packets(shared_folder: Path) -> None:
    vectors = json.loads((shared_folder / "wire" / "microstrain_mip.vectors.json").read_text())
    known = {vector["hex"] for vector in vectors}
    assert packet(0x30, 3).hex() in known  # save all startup settings
    assert packet(0x37, 1, np.array([1.0, -2.0, 0.5])).hex().startswith("75650c0f0f37013f800000c00000003f000000")


@pytest.mark.parametrize("target", ["json", "yaml"])
def test_plain_documents_are_enough_to_correct(target: str) -> None:
    parameters = made_up(13, quadratic=1e-5, g_sensitivity=1e-4)
    (content,) = export_parameters(parameters, target).files.values()
    document = json.loads(content) if target == "json" else yaml.safe_load(content)
    acc = {key: np.array(value) if isinstance(value, list) else value for key, value in document["accelerometer"].items()}
    gyr = {key: np.array(value) if isinstance(value, list) else value for key, value in document["gyroscope"].items()}
    raw = np.random.default_rng(14).uniform(-20, 20, (20, 3))
    output = raw - acc["raw_zero"] - acc["scale"] * acc["bias"]
    s = (-acc["scale"] + np.sqrt(acc["scale"] ** 2 + 4 * acc["quadratic"] * output)) / (2 * acc["quadratic"])
    force = s @ acc["inverse_alignment"].T
    np.testing.assert_allclose(force, parameters.apply_accelerometer(raw), rtol=0, atol=1e-8)
    rate = (raw - gyr["offset"] - force @ gyr["g_sensitivity"].T) @ gyr["matrix"].T
    np.testing.assert_allclose(rate, parameters.apply_gyroscope(raw, force), rtol=0, atol=1e-12)
    linear = (raw - acc["offset"]) @ acc["matrix"].T
    assert 1e-6 < np.abs(linear - force).max() < 0.1
    assert acc["linear_is_exact"] is False


def test_yaml_and_json_hold_the_same() -> None:
    parameters = made_up(15)
    exported = [export_parameters(parameters, target).files for target in ("json", "yaml")]
    assert json.loads(*exported[0].values()) == yaml.safe_load(next(iter(exported[1].values())))


def test_yaml_quotes_what_yaml_would_read_otherwise() -> None:
    document: dict[str, Any] = {
        "a": "no",
        "b": 'say "1.0": # x',
        "c": "1e5",
        "d": None,
        "e": True,
        "f": [1e-5, 1e22, 3.0],
        "g": "\u00b5\n",
    }
    document["h"] = {"i": [[1.0, 2.0], [3.0, 4.0]]}
    assert yaml.safe_load("\n".join(yaml_lines(document))) == document


@pytest.mark.parametrize("value", [1e-5, 1.5e-300, 1e22, -3.0, 0.1, 123456789.123])
def test_numbers_read_back_exactly(value: float) -> None:
    assert float(number(value)) == value
    assert yaml.safe_load(number(value)) == value


def test_a_name_cannot_break_out_of_its_comment() -> None:
    made = made_up(16)
    session = replace(made.context.session, name="a\nINS_ACC_ID,1\n*/ int x; /*")
    parameters = replace(made, context=replace(made.context, session=session))
    text = export_parameters(parameters, "ardupilot").files["ardupilot.param"].decode()
    assert not [line for line in text.splitlines() if line.startswith("INS_ACC_ID")]
    header = export_parameters(parameters, "c").files["imufield_calibration.h"].decode()
    assert "*/ int x" not in header


def test_noise_that_is_not_known_is_asked_for() -> None:
    parameters = made_up(17)
    exported = export_parameters(parameters, "kalibr")
    assert "accelerometer_random_walk, gyroscope_random_walk" in with_key(exported.notes, "vio.unknown")
    options = ExportOptions(accelerometer_random_walk=1e-4, gyroscope_random_walk=2e-6)
    exported = export_parameters(parameters, "kalibr", options)
    imu = yaml.safe_load(exported.files["imu.yaml"])["imu0"]
    assert (imu["accelerometer_noise_density"], imu["gyroscope_random_walk"]) == (pytest.approx(7e-4), 2e-6)
    assert imu["update_rate"] == 1999.987
    assert "vio.unknown" not in keys(exported.notes)


def test_options_from_text() -> None:
    options = export_options({"instance": "1", "accelerometer_id": "0x1F", "gyroscope_nominal": "16.4"}, "px4")
    assert options == ExportOptions(instance=1, accelerometer_id=31, gyroscope_nominal=16.4)
    assert export_options({"gauge": "upper", "name": "a"}, "c") == ExportOptions(gauge="upper", name="a")
    assert export_options({"temperature_degc": "20"}, "imu_tk") == ExportOptions(temperature_degc=20.0)


class _Read:
    """Options that note which of them were read."""

    def __init__(self, options: ExportOptions) -> None:
        self._options = options
        self.names: set[str] = set()

    def __getattr__(self, name: str) -> object:
        self.names.add(name)
        return getattr(self._options, name)


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_has_the_options_that_it_reads(target: str) -> None:
    read = _Read(ExportOptions())
    export_parameters(made_up(21), target, read)  # type: ignore[arg-type]
    # Where the frame or the temperatures are those of the target, another is refused.
    fixed = {"gauge"} if target in ONE_FRAME else set[str]()
    fixed |= {"temperature_degc"} if TARGETS[target].over_temperature else set()
    assert set(TARGETS[target].option_names) == read.names - fixed


@pytest.mark.parametrize(
    ("target", "settings", "key"),
    [
        ("c", {"colour": "red"}, "option"),
        ("c", {"instance": "1"}, "option"),
        ("px4", {"gauge": "upper"}, "option"),
        ("px4", {"instance": "one"}, "whole"),
        ("c", {"gauge": "left"}, "choice"),
        ("openvins", {"model": "vins"}, "choice"),
    ],
)
def test_options_that_make_no_sense(target: str, settings: dict[str, str], key: str) -> None:
    with refused(UsageError, Reason.USAGE, *settings, key=f"registry.{key}"):
        export_options(settings, target)


def test_unknown_target() -> None:
    with refused(UsageError, Reason.USAGE, "px4", key="registry.target") as caught:
        export_parameters(made_up(18), "px5")
    assert caught.value.values["name"] == "px5"


@pytest.mark.parametrize("nominal", [0.0, float("nan"), float("inf")])
def test_nominal_scale_that_is_none(nominal: float) -> None:
    with refused(UsageError, Reason.USAGE, f"accelerometer_nominal = {nominal}", key="job.nominal"):
        export_parameters(made_up(19), "vectornav", ExportOptions(accelerometer_nominal=nominal))


def test_openvins_rpng_needs_a_gyroscope() -> None:
    with refused(ParameterFileError, Reason.UNITS, "rpng", "kalibr", key="openvins.no_gyroscope"):
        export_parameters(made_up(20, gyroscope=False), "openvins", ExportOptions(model="rpng"))


def test_files_go_into_a_folder_or_under_one_name(tmp_path: Path) -> None:
    two = export_parameters(made_up(21), "imu_tk")
    assert [one.path.name for one in write_exported(two, tmp_path)] == ["imu_tk_acc.calib", "imu_tk_gyro.calib"]
    one = export_parameters(made_up(21), "px4")
    assert write_exported(one, tmp_path / "drone.params") == [(tmp_path / "drone.params", None)]
    assert (tmp_path / "drone.params").read_bytes() == one.files["px4.params"]
    with refused(UsageError, Reason.USAGE, "2 files", "imu_tk_acc.calib", "one.calib", key="registry.folder"):
        write_exported(two, tmp_path / "one.calib")


def test_old_file_stays_where_the_new_one_cannot_be_written(tmp_path: Path) -> None:
    old = tmp_path / "px4.params"
    old.write_text("old")
    with pytest.raises(ImufieldError):
        write_exported(export_parameters(made_up(22), "px4"), old / "px4.params")
    assert old.read_text() == "old"


def test_an_earlier_file_of_other_content_is_kept_under_a_number(tmp_path: Path) -> None:
    first, second = (export_parameters(made_up(seed), "px4") for seed in (21, 22))
    path = tmp_path / "px4.params"
    assert write_exported(first, tmp_path) == [(path, None)]
    assert write_exported(first, tmp_path) == [(path, None)]
    assert write_exported(second, tmp_path) == [(path, tmp_path / "px4-1.params")]
    assert path.read_bytes() == second.files["px4.params"]
    assert (tmp_path / "px4-1.params").read_bytes() == first.files["px4.params"]
