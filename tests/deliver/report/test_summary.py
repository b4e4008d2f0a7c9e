from __future__ import annotations

import io
import os
import re
import shlex
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from io import FileIO
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration, GyroscopeCalibration, Quality
from imufield.deliver.parameters.clock import clock_words
from imufield.deliver.parameters.context import ClockFacts, Context
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.report.summary import Outcome, print_summary, summary_text
from imufield.drawing.printed_lines import columns
from imufield.earth import choose_gravity
from imufield.sentences import Sentences

sentence = Sentences("imufield.deliver.report")


@pytest.fixture
def full(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    return from_document(to_document(calibration, observations, context))


def made(calibration: Calibration, observations: Observations, context: Context) -> str:
    return summary_text(from_document(to_document(calibration, observations, context)))


def test_says_every_parameter_with_its_uncertainty(full: Parameters) -> None:
    text = summary_text(full)
    assert "+3.182 ± 0.011" in text  # 0.0312 m/s² are 3.1815 mg
    assert "+0.03120 ± 0.00011" in text
    assert "+123 ± 52" in text  # 1.000123 against 1 m/s² per m/s²
    assert "yx +1.310 ± 0.026" in text
    assert "+4.5" in text  # 1.31 mrad in arc-minutes
    assert "+10.8 ± 2.9" in text  # 1.1e-6 (m/s²)/(m/s²)² times 9.80665
    assert "+20.63 ± 0.43" in text  # 1e-4 rad/s in °/h
    assert "static bias" in text


def test_fits_80_columns_and_ends_lines_without_blanks(full: Parameters) -> None:
    lines = summary_text(full, Outcome(Path("a" * 30, "b" * 30, "parameters.toml"), Path("parameters-3.toml"))).splitlines()
    path = "/".join(["a" * 30, "b" * 30, "parameters.toml"])
    assert lines[lines.index("Written to") + 1] == path
    assert max(len(line) for line in lines if line != path) <= 80
    assert all(line == line.rstrip() for line in lines)
    assert not any("…" in line for line in lines)


AGAIN = "imufield capture --resume --session {} --retake NAME"
ON = "imufield capture --resume --session {}"
WITHOUT = "imufield solve {} --without NAME"
MORE = "imufield capture"


@pytest.mark.parametrize(
    ("kind", "finished", "to_spare", "none_to_spare"),
    [
        ("capture", True, AGAIN, MORE),
        ("capture", False, ON, ON),
        ("record", True, WITHOUT, MORE),
        ("record", False, WITHOUT, MORE),
        ("import", True, WITHOUT, MORE),
        (None, True, "imufield solve --observations FILE --without NAME", MORE),
    ],
)
def test_the_remedy_is_one_that_the_session_takes(
    full: Parameters, tmp_path: Path, *, kind: str | None, finished: bool, to_spare: str, none_to_spare: str
) -> None:
    session, folder = None, tmp_path / f"a session of {'x' * 60}"
    if kind is not None:
        session = Session.create_in(folder, "IMU", {"kind": kind})
        session.update(finished=finished)

    def commands(verdict: str, accelerometer: str, freedom: int, alone: Quality | None = None) -> list[str]:
        quality = replace(full.calibration.quality, verdict=verdict, accelerometer_verdict=accelerometer)
        quality = replace(quality, degrees_of_freedom=freedom, student_factor_95=2.0 if freedom else float("nan"))
        judged = replace(full, calibration=replace(full.calibration, quality=quality))
        lines = summary_text(judged, Outcome(tmp_path / "parameters.toml", session=session, quality=alone)).splitlines()
        # Each on a line of its own: in two pieces it cannot be copied.
        return [line.strip() for line in lines if line.startswith("   imufield")]

    quoted = shlex.quote(str(folder))
    assert commands("poor", "poor", 3) == [to_spare.format(quoted)]
    assert commands("poor", "poor", 0) == [none_to_spare.format(quoted)]
    # Of a gyroscope that is poor alone its own reason says what to do.
    assert commands("poor", "good", 3) == []
    assert commands("good", "good", 3) == []
    # Nor does it help where another session is poor.
    assert commands("poor", "poor", 3, replace(full.calibration.quality, verdict="good")) == []


def test_the_end_fits_a_terminal_of_24_lines(full: Parameters) -> None:
    lines = summary_text(full, Outcome(Path("parameters.toml"))).splitlines()
    assert any("Residual by position" in line for line in lines[-23:])
    # A table in g and deg/s is converted when it is imported: the units of apply are said where it is named.
    assert lines[-1] == f" · {sentence('summary.use', units=['m/s^2', 'rad/s'])}"


def test_marks_the_worst_position_and_the_unused(
    calibration: Calibration, observations: Observations, context: Context
) -> None:
    used = np.arange(24) != 4
    left_out = replace(calibration, positions=replace(calibration.positions, used=used))
    text = made(left_out, observations, context)
    assert "3-2 █████████    -93 ◄" in text
    assert text.count("◄") == 1
    assert text.count("not used") == 1


def test_scale_of_an_instrument_that_counts(calibration: Calibration, observations: Observations, context: Context) -> None:
    counts = replace(calibration, accelerometer_raw_unit="count/s", gauge="symmetric")
    text = made(counts, observations, context)
    assert "count/s per m/s²         1.00012 ± 0.00005" in text  # a second digit of sigma would not fit
    assert max(len(line) for line in text.splitlines()) <= 80


def test_six_faces_say_what_was_not_estimated(six_faces: Calibration, observations: Observations, context: Context) -> None:
    text = made(six_faces, observations, context)
    line = next(line for line in text.splitlines() if line.startswith("misalignment"))
    assert line.count("not estimated") == 3
    assert "Gyroscope" not in text


def test_where_no_position_is_left_there_are_no_residuals(
    six_faces: Calibration, observations: Observations, context: Context
) -> None:
    """Six zeros would look like a perfect fit."""
    exact = replace(six_faces, quality=replace(six_faces.quality, degrees_of_freedom=0))
    _, _, shown = made(exact, observations, context).partition("Residual by position: ")
    assert shown.splitlines()[0] == sentence("summary.no_residual")
    assert observations.name[0] not in shown


def test_assumed_gravity_is_said_aloud_and_answered(
    calibration: Calibration, observations: Observations, context: Context
) -> None:
    text = made(replace(calibration, gravity=choose_gravity()), observations, context)
    assert f"9.807 ± 0.018 m/s², {sentence('summary.assumed')}" in " ".join(text.split())
    # Who has typed one is told why it counts for so little.
    typed = made(replace(calibration, gravity=choose_gravity(gravity_m_s2=9.81)), observations, context)
    assert f"9.810 ± 0.018 m/s², {sentence('summary.assumed')}" in " ".join(typed.split())
    assert "imufield solve --latitude DEGREES" in text


def test_poor_of_few_positions_says_what_to_do(calibration: Calibration, observations: Observations, context: Context) -> None:
    quality = replace(calibration.quality, verdict="poor", degrees_of_freedom=0, student_factor_95=float("nan"))
    text = made(replace(calibration, quality=quality), observations, context)
    assert "POOR" in text
    assert sentence("summary.take_24") in " ".join(text.split())


def test_below_the_verdict_warnings_come_first(calibration: Calibration, observations: Observations, context: Context) -> None:
    quality = calibration.quality.lowered("usable", "look at this first")
    text = " ".join(made(replace(calibration, quality=quality), observations, context).split())
    verdict = text.partition("Verdict:")[2]
    assert 0 < verdict.index("look at this first") < verdict.index(quality.reasons[0])


def test_the_reason_of_the_verdict_is_quoted_and_not_that_of_a_milder_one(calibration: Calibration) -> None:
    poor, usable = (calibration.quality.lowered(verdict, f"it is {verdict}") for verdict in ("poor", "usable"))
    for quality in (poor.lowered("usable", "it is usable"), usable.lowered("poor", "it is poor")):
        assert (quality.verdict, quality.main_reason) == ("poor", "it is poor")
        assert set(quality.warnings) >= {"it is poor", "it is usable"}


def test_gyroscope_of_unknown_scale_and_of_full_calibration(
    calibration: Calibration, observations: Observations, context: Context, gyroscope: GyroscopeCalibration
) -> None:
    unknown = replace(gyroscope, parameters=replace(gyroscope.parameters, scale=np.full(3, np.nan)), raw_unit="count")
    text = made(replace(calibration, gyroscope=unknown), observations, context)
    assert "(+100.0 ± 2.1)e-6" in text
    sigma = replace(gyroscope.sigma, scale=np.full(3, 1e-4), misalignment_rad=np.full((3, 3), 1e-4))
    fast = replace(gyroscope.parameters, scale=np.array([1.001, 0.999, 1.0]), bias=np.array([0.1, 0.2, -0.3]))
    text = made(replace(calibration, gyroscope=replace(gyroscope, parameters=fast, sigma=sigma)), observations, context)
    assert "+5.72385 ± 0.00058" in text  # °/s; the scale's sigma counts in: 0.1 * 1e-4 rad/s
    assert "+1000 ± 100" in text


def test_the_nine_g_sensitivities_are_shown_where_fitted(
    calibration: Calibration, observations: Observations, context: Context, gyroscope: GyroscopeCalibration
) -> None:
    g_sensitivity = 1e-6 * np.arange(1.0, 10.0).reshape(3, 3)
    sigma = replace(
        gyroscope.sigma, scale=np.full(3, 1e-4), misalignment_rad=np.full((3, 3), 1e-4), g_sensitivity=np.full((3, 3), 1e-7)
    )
    fitted = replace(gyroscope.parameters, scale=np.ones(3), g_sensitivity=g_sensitivity)
    text = made(replace(calibration, gyroscope=replace(gyroscope, parameters=fitted, sigma=sigma)), observations, context)
    # 1e-6 rad/s per m/s^2 are 9.80665e-6 * 648000 / pi = 2.02 deg/h per g; y of the gyroscope has four times that of a_x.
    (row,) = [line for line in text.splitlines() if line.startswith("g-sens. of ax")]
    assert row.split()[3:] == ["°/h/g", "+2.02", "±", "0.20", "+8.09", "±", "0.20", "+14.16", "±", "0.20"]


def test_residuals_of_rounding_have_no_worst(calibration: Calibration, observations: Observations, context: Context) -> None:
    exact = replace(calibration, positions=replace(calibration.positions, residual_m_s2=np.full(24, 1e-15)))
    assert "◄" not in made(exact, observations, context)


@pytest.mark.parametrize(("source", "is_beside"), [("unchecked", True), ("compared", False)])
def test_a_clock_that_nothing_checks_is_said_beside_the_verdict(
    calibration: Calibration, observations: Observations, context: Context, source: str, is_beside: bool
) -> None:
    """It was 30000 ppm among the details, below a scale of 49 ppm."""
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    clock = ClockFacts(source=source, sample_period_s=0.01, sigma=0.03)
    known = replace(gyroscope, sigma=replace(gyroscope.sigma, scale=np.full(3, 5e-5)))
    judged = replace(calibration, gyroscope=known, quality=calibration.quality.with_reasons(clock_words(clock)))
    text = made(judged, observations, replace(context, clock=clock))
    assert text.count("30000 ppm") == 1
    assert ("30000 ppm" in text.partition("Verdict: ")[2]) is is_beside


def test_edited_file_is_said(full: Parameters) -> None:
    assert sentence("summary.edited") in summary_text(replace(full, edited=True))
    assert sentence("summary.edited") not in summary_text(full)


def on_a_terminal(full: Parameters, monkeypatch: pytest.MonkeyPatch, width: int) -> str:
    """Return what is written to a terminal of that width."""
    if not hasattr(os, "openpty"):
        pytest.skip("needs pseudo-terminals: Linux or macOS")
    master, slave = os.openpty()
    # rich asks the program's own terminal for its width, and of a test there is none.
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "xterm-256color")
    with os.fdopen(master, "rb", buffering=0) as screen, ThreadPoolExecutor(1) as threads:
        with os.fdopen(slave, "w", encoding="utf-8") as terminal:
            # A terminal takes some kilobytes before it waits for a reader.
            read = threads.submit(read_all, screen)
            print_summary(full, file=terminal)
        return read.result().decode().replace("\r\n", "\n")


def read_all(screen: FileIO) -> bytes:
    found = b""
    with suppress(OSError):  # The other side has hung up.
        while data := screen.read(1 << 16):
            found += data
    return found


def test_colours_on_a_terminal_only(full: Parameters, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = on_a_terminal(full, monkeypatch, 80)
    assert "\x1b[" in seen
    pipe = io.StringIO()
    print_summary(full, file=pipe)
    assert pipe.getvalue() == summary_text(full) == without_colours(seen)


def without_colours(seen: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", seen)


def test_ascii_files_get_ascii(full: Parameters, tmp_path: Path) -> None:
    with (tmp_path / "log.txt").open("w", encoding="ascii") as file:
        print_summary(full, file=file)
    assert "+3.182 +-0.011" in (tmp_path / "log.txt").read_text(encoding="ascii")


@pytest.mark.parametrize("width", [45, 60])
def test_a_narrow_window_has_every_number_in_a_line_of_its_own(
    full: Parameters, monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    lines = without_colours(on_a_terminal(full, monkeypatch, width)).splitlines()
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines)
    numbers = [line.split() for line in summary_text(full).splitlines() if "±" in line and line.split()[0] in ("bias", "scale")]
    assert numbers
    for words in numbers:
        for place in (place for place, word in enumerate(words) if word == "±"):
            assert sum(" ".join(words[place - 1 : place + 2]) in line for line in lines) >= 1


def test_a_width_of_nothing_hides_nothing(full: Parameters, monkeypatch: pytest.MonkeyPatch) -> None:
    assert without_colours(on_a_terminal(full, monkeypatch, 0)) == summary_text(full)


def test_the_ends_of_long_names_tell_them_apart(calibration: Calibration, observations: Observations, context: Context) -> None:
    names = tuple(f"{'a position ' * 12}{k}" for k in range(24))
    _, _, shown = made(calibration, replace(observations, name=names), context).partition("Residual by position")
    rows = shown.splitlines()[1:25]
    assert max(map(len, rows)) <= 80
    assert len({row[:61] for row in rows}) == 24


@pytest.mark.parametrize(("encoding", "name"), [("ascii", "传感器"), ("latin-1", "Košice"), ("cp1252", "传感器")])
def test_names_that_an_output_does_not_know_are_spelt_out(
    full: Parameters, tmp_path: Path, *, encoding: str, name: str
) -> None:
    with (tmp_path / "log.txt").open("w", encoding=encoding) as file:
        print_summary(full, Outcome(Path(name, "parameters.toml")), file)
    shown = (tmp_path / "log.txt").read_text(encoding=encoding)
    assert name.encode(encoding, "backslashreplace").decode(encoding) in shown
    assert "Verdict" in shown


@pytest.mark.parametrize("name", ["上", "e\u0301te\u0301"])
def test_names_of_other_than_one_column_a_character_stand_in_line(
    calibration: Calibration, observations: Observations, context: Context, name: str
) -> None:
    """A Chinese character takes two columns of a terminal, a mark above a letter none."""
    named = replace(observations, name=(name, *observations.name[1:]))
    rows = made(calibration, named, context).partition("Residual by position")[2].splitlines()[1:9]
    bars = [columns(row[: re.search("[█▏▎▍▌▋▊▉]", row).start()]) for row in rows]
    assert len({*bars}) == 1
