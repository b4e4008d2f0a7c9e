"""``imufield noise`` as a user reads it."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from imufield.cli.run import run
from imufield.errors import Reason
from tests.commands.conftest import Program
from tests.commands.test_verify import rest_session, with_document
from tests.commands.told import fails, missing

UNITS = {"density": "/sqrt(Hz)", "instability": "", "walk": "/sqrt(s)"}


def test_every_figure_has_its_interval_and_unit_in_80_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = rest_session(tmp_path, 1800.0).folder
    assert run(["noise", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert run(["noise", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    heads = [k for k, line in enumerate(lines) if "95 % interval" in line]
    assert [lines[k].split("  ")[0] for k in heads] == ["density", "bias instability", "bias random walk"]
    assert len({lines[k].index("unit") for k in heads}) == 1
    at = lines[heads[0]].index("unit")
    for head, (name, per) in zip(heads, UNITS.items(), strict=True):
        for line, (axis, figures) in zip(lines[head + 1 :], found["axes"].items(), strict=False):
            assert len(line) <= 80
            assert line[2:17].rstrip() == axis
            unit = ("m/s^2" if axis.startswith("accelerometer") else "rad/s") + per
            assert line[at:] == unit == figures[name]["unit"]
            value = figures[name]["value"]
            assert line[18:30].strip() == ("not seen" if value is None else f"{value:.3g}")
    sheet = {(each["triad"], each["figure"], each["unit"]): each["axes"] for each in found["data_sheet"]}
    assert {unit for _, _, unit in sheet} == {"ug/sqrt(Hz)", "m/s/sqrt(h)", "ug", "deg/sqrt(h)", "deg/h"}
    begin = next(k for k, line in enumerate(lines) if line.startswith("as in data sheets"))
    for line, ((triad, title, unit), axes) in zip(lines[begin + 1 :], sheet.items(), strict=False):
        assert len(line) <= 80
        assert line.startswith(f"{triad[:3]} {title}")
        assert line.endswith(f"   {unit}")
        told = line[29:62].replace("< ", "<").split()
        assert told == [f"<{one['high']:.2g}" if one["value"] is None else f"{one['value']:.3g}" for one in axes]
    # One sentence for each kind of figure that was not seen.
    assert sum("too short" in line for line in lines) <= 2
    density = [found["axes"][f"gyroscope {axis}"]["density"]["value"] for axis in "xyz"]
    assert density == pytest.approx([1e-6 / 20**0.5] * 3, rel=0.1)


@pytest.mark.parametrize("rate_hz", [2.0, 1.0, 0.5, 0.2])
def test_a_slow_instrument_is_measured_or_needs_the_time_of_its_rate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rate_hz: float
) -> None:
    assert run(["noise", str(rest_session(tmp_path / "long", 3000 / rate_hz, rate_hz=rate_hz).folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["rate_hz"], found["duration_s"]) == pytest.approx((rate_hz, 3000 / rate_hz))
    assert not any("gap" in said or "moved" in said for said in found["sentences"])
    for triad, scatter in (("accelerometer", 1e-4), ("gyroscope", 1e-6)):
        density = [found["axes"][f"{triad} {axis}"]["density"]["value"] for axis in "xyz"]
        assert density == pytest.approx([scatter / rate_hz**0.5] * 3, rel=0.1)
    short = rest_session(tmp_path / "short", 900 / rate_hz, rate_hz=rate_hz).folder
    fails(["noise", str(short)], 6, Reason.TOO_FEW, f"{1000 / rate_hz:.0f} s", f"{rate_hz:g} Hz", key="noise.too_short")


def test_the_newest_session_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rest_session(tmp_path / "imufield-sessions" / "20260301T101500Z-rest", 30.0)
    monkeypatch.chdir(tmp_path)
    assert run(["noise"]) == 6
    assert "20260301T101500Z-rest" in capsys.readouterr().out


def test_every_file_that_is_written_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = rest_session(tmp_path, 600.0).folder
    files = [tmp_path / "noise.yaml", tmp_path / "allan.svg"]
    arguments = ["noise", str(folder), "--output", str(files[0]), "--plot", str(files[1])]
    assert run(arguments) == 0
    assert not missing(capsys.readouterr().out, *files)
    drawn = files[1].read_text()
    assert drawn.startswith("<?xml")
    assert run([*arguments, "--json"]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["axes"]
    assert not missing(told.err, *files)


def test_a_calibration_gives_counts_their_scale(
    solved_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    counts = rest_session(tmp_path / "counts", 600.0, unit="count").folder
    tables = {triad: {"raw_unit": unit} for triad, unit in (("accelerometer", "count"), ("gyroscope", "rad/s"))}
    parameters = with_document(solved_session / "parameters.toml", tmp_path / "p.toml", **tables)
    assert run(["noise", str(counts), "--parameters", str(parameters)]) == 0
    document = tomllib.loads(parameters.read_text())
    capsys.readouterr()
    assert run(["noise", str(counts), "--json"]) == 0
    raw = json.loads(capsys.readouterr().out)["axes"]
    for triad, unit in (("accelerometer", "m_s2"), ("gyroscope", "rad_s")):
        # The scale is some 100 ppm from one: another one would show.
        found = [raw[f"{triad} {axis}"]["density"]["value"] / document[triad]["scale"][k] for k, axis in enumerate("xyz")]
        assert document["noise"][f"{triad}_density_{unit}_per_sqrt_hz"] == pytest.approx(found, rel=1e-6)


def test_a_recording_without_gyroscope_leaves_the_gyroscope_figures(solved_session: Path, tmp_path: Path) -> None:
    parameters = with_document(solved_session / "parameters.toml", tmp_path / "p.toml")
    rest = rest_session(tmp_path / "rest", 600.0).folder
    assert run(["noise", str(rest), "--parameters", str(parameters)]) == 0
    first = tomllib.loads(parameters.read_text())["noise"]
    table = tmp_path / "rest.csv"
    assert run(["export-data", str(rest), "--output", str(table)]) == 0
    rows = [line.split(",") for line in table.read_text().splitlines()]
    table.write_text("".join(",".join(row[:4]) + "\n" for row in rows))
    alone = tmp_path / "alone"
    assert run(["import", str(table), "--output", str(alone)]) == 0
    assert run(["noise", str(alone), "--parameters", str(parameters)]) == 0
    second = tomllib.loads(parameters.read_text())["noise"]
    assert first["source"] in second["source"] != first["source"]
    for key in ("gyroscope_density_rad_s_per_sqrt_hz", "gyroscope_bias_instability_rad_s"):
        assert str(second[key]) == str(first[key])  # Text: nan is not equal to itself.


def test_parameters_of_other_units_or_of_another_instrument_are_refused(solved_session: Path, tmp_path: Path) -> None:
    counts = rest_session(tmp_path / "counts", 600.0, unit="count", instrument={"serial_number": "B2"}).folder
    parameters = solved_session / "parameters.toml"
    before = parameters.read_bytes()
    fails(["noise", str(counts), "--parameters", str(parameters)], 5, Reason.UNITS, "count", key="file.unit")
    assert parameters.read_bytes() == before
    other = with_document(parameters, tmp_path / "other.toml", instrument={"serial_number": "A1"})
    fails(["noise", str(counts), "--parameters", str(other)], 5, Reason.FOREIGN, "A1", "B2", key="file.instrument")


def test_noise_of_an_instrument_without_serial_number_is_said_not_to_be_checked(
    solved_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parameters = with_document(solved_session / "parameters.toml", tmp_path / "p.toml", instrument={"model": "mine"})
    for serial_number, is_told in (("B2", False), ("", True)):
        with_document(parameters, parameters, instrument={"serial_number": serial_number})
        instrument = {"model": "other-bench", "serial_number": "B2"}
        rest = rest_session(tmp_path / f"rest{serial_number}", 600.0, instrument=instrument).folder
        assert run(["noise", str(rest), "--parameters", str(parameters)]) == 0
        assert (not missing(capsys.readouterr().err, "mine", "other-bench")) == is_told


def test_a_date_that_is_none_ends_with_a_sentence(program: Program, tmp_path: Path) -> None:
    folder = rest_session(tmp_path / "rest", 600.0).folder
    found = program.run("noise", folder, variables={"SOURCE_DATE_EPOCH": "x"})
    assert found.returncode == 2
    assert "SOURCE_DATE_EPOCH" in found.stderr
    assert "Traceback" not in found.stderr
