"""A folder of parameter files: changes in sigma, what is left out, staleness."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.control_chart import charts, date_locator, plot_history
from imufield.deliver.history import Entry, InstrumentHistory, find, one_instrument, read_history
from imufield.deliver.history_words import sentences, to_csv
from imufield.deliver.judged_history import judge_history
from imufield.deliver.pair_test import Shared
from imufield.deliver.parameters.context import Context, InstrumentFacts, SessionFacts
from imufield.deliver.parameters.gauge_free import gauge_free
from imufield.errors import ParameterFileError, Reason
from imufield.guide.positions import nearest_cube_direction
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.sentences import Sentence
from tests.parameter_files import on_purpose
from tests.pipeline.test_over_temperature import GRAVITY, observed, solved
from tests.refused import refused
from tests.told import key_of, keys, with_key

NOW = datetime(2026, 9, 1, tzinfo=UTC)


def test_a_move_is_told_in_sigma_of_the_difference(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", moved=-4.1 * np.sqrt(2), session="b" * 64)
    (instrument,) = read_history(tmp_path).instruments
    assert [entry.created[:10] for entry in instrument.entries] == ["2026-03-04", "2026-08-01"]
    change = {one.name: one for one in judge_history(instrument).changes()}["bias y"]
    assert change.in_sigma == pytest.approx(-4.1, rel=1e-6)
    (told,) = sentences(judge_history(instrument), NOW)
    assert "bias y" in told
    assert "4.1 sigma" in told
    assert "4 March 2026 (" in told


def test_two_sessions_cannot_tell_a_change_from_a_turn_on(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    # 1 sigma is 0.011 mg; the noise of the gyroscope is that of a tactical instrument, which turns on to 0.75 mg.
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", moved=50.0, session="b" * 64)
    (told,) = sentences(judge_history(read_history(tmp_path).instruments[0]), NOW)
    assert key_of(told) == "history_words.differs_as_turn_on"
    assert told.values["turn_on"] == 0.75
    write("b", "2026-08-01", moved=900.0, session="b" * 64)
    # The file that stood there before is kept beside it.
    not_listed, told = sentences(judge_history(read_history(tmp_path).instruments[0]), NOW)
    assert (key_of(not_listed), not_listed.values["files"]) == ("history_words.not_listed", 1)
    assert key_of(told) == "history_words.moved"


def test_many_differences_of_one_kind_are_one_sentence_of_the_worst(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", session="b" * 64)
    old, new = read_history(tmp_path).instruments[0].entries
    # Scales x, y, z by 500, 600, 700 ppm and one angle: days change them, and no turn-on bias.
    moved = {"scale x": 5e-4, "scale y": 6e-4, "scale z": 7e-4, "angle xy": 0.1, "bias y": 0.5}

    def told(*names: str) -> list[Sentence]:
        numbers = tuple(
            replace(number, value=number.value + (moved[number.name] if number.name in names else 0.0))
            for number in new.numbers
        )
        history = InstrumentHistory("stim300", "N1", (old, replace(new, numbers=numbers)))
        return list(sentences(judge_history(history), NOW))

    scales = told("scale x", "scale y", "scale z")
    assert keys(scales) == ["history_words.differs"] * 3
    assert [each.values["name"] for each in scales] == [f"scale error {axis}" for axis in "xyz"]
    assert [each.values["difference"] for each in scales] == pytest.approx([500.0, 600.0, 700.0])
    assert {each.values["unit"] for each in scales} == {"ppm"}
    bias, many = told(*moved)
    assert (many.key, many.values["numbers"]) == ("history_words.differs_many", 4)
    assert (bias.key, bias.values["name"]) == ("history_words.differs_as_turn_on", "bias y")
    one_by_one = [each for name in moved for each in told(name)]
    worst = max(
        (each for each in one_by_one if each.key == "history_words.differs"),
        key=lambda each: float(str(each.values["in_sigma"])),
    )
    assert many.values["name"] == worst.values["name"]


def test_the_grade_of_the_file_goes_before_its_noise(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    # 9 mg: more than tactical instruments turn on to, which this one is by its noise; not more than industrial ones do.
    write("b", "2026-08-01", moved=900.0, session="b" * 64, grade="industrial")
    (told,) = sentences(judge_history(read_history(tmp_path).instruments[0]), NOW)
    assert key_of(told) == "history_words.differs_as_turn_on"
    assert told.values["turn_on"] == pytest.approx(3.0)
    # One that nobody stated tells nothing of the instrument.
    write("b", "2026-08-01", moved=900.0, session="b" * 64, grade="mems", grade_source="assumed")
    _, told = sentences(judge_history(read_history(tmp_path).instruments[0]), NOW)
    assert key_of(told) == "history_words.moved"


def test_a_step_is_told_with_the_days_it_lies_between(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for name, date, moved in (("a", "2026-03-04", 0.0), ("b", "2026-05-01", 50.0), ("c", "2026-08-01", 50.0)):
        write(name, date, moved=moved, session=name * 64)
    history = judge_history(read_history(tmp_path).instruments[0])
    step, *daily = sentences(history, NOW)
    assert key_of(step) == "history_words.step"
    assert (step.values["before"], step.values["after"]) == ("4 March 2026", "1 May 2026")
    # Nothing in a file tells apart what of a gyroscope's sigma all sessions have in common.
    closer = {each.values["kind"]: key_of(each) for each in daily}
    assert closer["scale"] == "history_words.daily_closer"
    assert closer["gyroscope bias"] == "history_words.daily_closer_in_part"
    # The step is news, and nothing that days do.
    assert history.repeatability["bias"].sigma == 0.0
    # The sigma of the difference has what days do in it, which is nothing here.
    assert {change.name: change for change in history.changes()}["bias y"].in_sigma == pytest.approx(0.0, abs=1e-6)


def test_where_nothing_differs_the_largest_is_told_with_its_limit(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    # Beyond the 3 sigma of one number, not beyond those of all.
    write("b", "2026-08-01", moved=3.1 * np.sqrt(2), session="b" * 64)
    (told,) = sentences(judge_history(read_history(tmp_path).instruments[0]), NOW)
    assert key_of(told) == "history_words.same"
    assert told.values["name"] == "bias y"
    assert told.values["in_sigma"] == pytest.approx(3.1, rel=1e-5)
    assert told.values["limit_sigma"] > 3.1


def test_an_assumed_gravity_is_not_that_of_the_same_place(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", session="b" * 64)
    old, new = read_history(tmp_path).instruments[0].entries
    assert new.shared_with(old) == Shared(gravity=True, setup=True)
    assert not replace(new, gravity_source="assumed").shared_with(replace(old, gravity_source="assumed")).gravity
    assert not replace(new, gravity_m_s2=9.79).shared_with(old).gravity
    assert not replace(new, setup="quadratic 1-1").shared_with(old).setup


@pytest.mark.parametrize("step", [0.0, 4e-4])
def test_the_same_sides_in_any_order_share_what_the_model_leaves_out(step: float) -> None:
    rng, planned = np.random.default_rng(5), observed(20.0)
    entries = []
    for day in range(5):
        order = rng.permutation(len(planned))
        # As of an import: nothing was planned, and names count what was found.
        seen = replace(
            planned,
            name=tuple(f"free {k + 1}: near {nearest_cube_direction(planned.direction[row])}" for k, row in enumerate(order)),
            mean_raw=planned.mean_raw[order] * (1 + step * (day == 4)) + 2e-4 * rng.normal(size=(len(planned), 3)),
            direction=np.full((len(planned), 3), np.nan),
        )
        context = Context(
            instrument=InstrumentFacts(serial_number="A1"),
            session=SessionFacts(name=f"{day}", sha256=f"{day}" * 64, sample_rate_hz=100.0, temperature_degc=(20.0, 20.0)),
            created=f"2026-08-0{day + 1}T10:00:00Z",
        )
        settings = SolveSettings(model="linear", grade="mems")
        entries.append(Entry.of("", calibrate(SolveInput(observations=seen, gravity=GRAVITY, context=context), settings)))
    assert entries[0].shared_with(entries[1]).setup
    assert entries[0].setup == Entry.of("", solved(20.0)).setup
    history = judge_history(InstrumentHistory("", "A1", tuple(entries)))
    assert [(change.name, change.first_after) for change in history.judged.news] == [
        (f"scale {axis}", 4) for axis in "xyz" if step
    ]
    assert "history_words.daily_closer" not in keys(sentences(history, NOW))


def test_of_two_on_one_day_the_time_is_told(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-08-01", session="a" * 64)
    write("b", "2026-08-01T15:30:00Z", moved=9.0, session="b" * 64)
    (instrument,) = read_history(tmp_path).instruments
    (told,) = sentences(judge_history(instrument), NOW)
    assert "1 August 2026, 10:00 UTC (" in told
    first, second = instrument.entries
    again = replace(second, created="2026-08-01T10:00:07Z")
    (told,) = sentences(judge_history(replace(instrument, entries=(first, again))), NOW)
    assert "1 August 2026, 10:00:00 UTC (" in told


def test_scatter_of_one_day_is_not_that_of_days(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for k, moved in enumerate((0.0, 30.0, -30.0)):
        write(f"s{k}", f"2026-08-01T1{k}:00:00Z", moved=moved, session=f"{k}" * 64)
    (instrument,) = read_history(tmp_path).instruments
    told = with_key(sentences(judge_history(instrument), NOW), "history_words.daily")
    assert "from session to session" in told
    days = tuple(replace(entry, created=f"2026-08-0{k + 1}T10:00:00Z") for k, entry in enumerate(instrument.entries))
    told = with_key(sentences(judge_history(replace(instrument, entries=days)), NOW), "history_words.daily")
    assert "from day to day" in told


def test_scatter_below_its_own_sigma_has_no_limit(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for k, moved in enumerate((0.0, 1e-3, -1e-3)):
        write(f"s{k}", f"2026-08-0{k + 1}T10:00:00Z", moved=moved, session=f"{k}" * 64)
    (instrument,) = read_history(tmp_path).instruments
    told = keys(sentences(judge_history(instrument), NOW))
    assert "history_words.daily_closer" in told
    assert "history_words.daily_unseen" not in told
    # From other sides, the sigma holds what the model leaves out, which may be the same in all of them.
    apart = tuple(replace(entry, setup=f"quadratic 12 {k}") for k, entry in enumerate(instrument.entries))
    told = keys(sentences(judge_history(replace(instrument, entries=apart)), NOW))
    assert "history_words.daily_closer" not in told
    assert "history_words.daily_closer_in_part" in told


def test_other_temperatures_are_told(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for name, date in (("a", "2026-03-04"), ("b", "2026-08-01")):
        write(name, date, session=name * 64)
    (instrument,) = read_history(tmp_path).instruments
    first, second = instrument.entries
    assert first.temperature_degc == second.temperature_degc == pytest.approx(32.15, abs=0.5)
    assert "history_words.temperatures" not in keys(sentences(judge_history(instrument), NOW))
    cold = replace(instrument, entries=(replace(first, temperature_degc=-10.0), second))
    told = next(one for one in sentences(judge_history(cold), NOW) if key_of(one) == "history_words.temperatures")
    assert (told.values["low"], told.values["high"]) == (-10.0, second.temperature_degc)
    assert Entry.from_text(first.text) == first
    unknown = replace(first, temperature_degc=None)
    assert Entry.from_text(unknown.text) == unknown


def test_slow_drift_is_told_by_the_year(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for k in range(6):
        write(f"s{k}", f"2026-0{k + 1}-01", moved=4.0 * k, session=f"{k}" * 64)
    history = judge_history(read_history(tmp_path).instruments[0])
    drift, *_ = sentences(history, NOW)
    assert key_of(drift) == "history_words.drift"
    first, last = (next(number for number in entry.numbers if number.name == "bias y") for entry in history.entries[::5])
    assert drift.values["size"] == pytest.approx((last.value - first.value) * 365.25 / 151, rel=0.02)


def test_what_days_do_is_no_news(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    # The last day is off by 20 sigma of its difference, and the days before by as much.
    moves = np.random.default_rng(2).normal(0.0, 30.0, 6)
    for k, moved in enumerate(moves):
        write(f"s{k}", f"2026-0{k + 1}-01", moved=float(moved), session=f"{k}" * 64)
    history = judge_history(read_history(tmp_path).instruments[0])
    told = list(sentences(history, NOW))
    assert keys(told)[:2] == ["history_words.none", "history_words.daily"]
    # The test of the whole history says what it found and where: it is not what the table compares.
    largest = max(history.judged.changes, key=lambda change: abs(change.in_sigma) / change.limit_sigma)
    assert key_of(told[0].values["change"]) == (
        "history_words.a_drift" if largest.first_after is None else "history_words.a_step"
    )
    assert told[0].values["in_sigma"] == pytest.approx(abs(largest.in_sigma))
    number = next(number for number in history.entries[0].numbers if number.name == "bias y")
    # One axis of three changes.
    assert history.repeatability["bias"].sigma == pytest.approx(moves.std(ddof=1) * number.sigma / np.sqrt(3), rel=0.05)
    change = {one.name: one for one in history.changes()}["bias y"]
    assert change.sigma == pytest.approx(np.sqrt(2) * np.hypot(number.sigma, history.repeatability["bias"].sigma), rel=0.01)


def test_a_chart_marks_what_is_news(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for k, moved in enumerate((0.0, 1.0, -1.0, 60.0, 61.0)):
        write(f"s{k}", f"2026-0{k + 1}-01", moved=moved, session=f"{k}" * 64)
    drawn = {chart.name: chart for chart in charts(judge_history(read_history(tmp_path).instruments[0]))}
    assert drawn["bias y"].is_news == (False, False, False, True, True)
    assert not any(drawn["bias x"].is_news)
    inside = np.abs(drawn["bias y"].values) < drawn["bias y"].half_width
    assert inside.tolist() == [True, True, True, False, False]


def test_when_to_calibrate_again(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    for k in range(4):
        write(f"s{k}", f"2026-0{k + 1}-01", moved=0.0, session=f"{k}" * 64)
    instrument = read_history(tmp_path).instruments[0]
    assert keys(sentences(judge_history(instrument), NOW, wanted={"bias": 1.0}))[-1] == "history_words.forecast_short"
    for k in range(4, 8):
        write(f"s{k}", f"2026-0{k + 1}-01", moved=5.0 * (k % 2), session=f"{k}" * 64)
    history = judge_history(read_history(tmp_path).instruments[0])
    sigma = max(number.sigma for number in history.entries[-1].numbers if number.name.startswith("bias"))
    late, now = (list(sentences(history, NOW, wanted={"bias": size * sigma}))[-1] for size in (1e3, 1.1))
    assert key_of(late) == "history_words.forecast_unseen"
    assert late.values["span"] == pytest.approx(212, abs=1)
    assert key_of(now) == "history_words.forecast_now"
    assert now.values["now"] > 1.1 * sigma


def test_of_two_at_one_moment_one_counts_everywhere_and_it_is_said(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-08-01", session="a" * 64)
    write("b", "2026-08-01", moved=9.0, session="b" * 64)
    (instrument,) = read_history(tmp_path).instruments
    assert instrument.entries[-1].path.startswith("b")
    assert instrument.nearest(NOW) is instrument.entries[-1]
    first = next(iter(sentences(judge_history(instrument), NOW)))
    assert key_of(first) == "history_words.same_time"
    assert first.startswith("a/parameters.toml and b/parameters.toml")


def test_another_variant_of_the_model_is_the_same_instrument(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64, model="STIM300 K")
    write("b", "2026-05-04", session="b" * 64, model="STIM300 L")
    (instrument,) = read_history(tmp_path, "N1").instruments
    assert len(instrument.entries) == 2
    assert one_instrument(read_history(tmp_path)).title == "STIM300 L N1"


def test_gravity_is_common_to_both_scales(calibration: Calibration, observations: Observations) -> None:
    numbers = gauge_free(calibration, observations.mean_raw, np.full_like(observations.mean_raw, np.nan)).numbers
    scale = {one.name: one for one in numbers}["scale x"]
    assert scale.common == pytest.approx(5e-4 / 9.8071, rel=1e-3)
    assert scale.common < scale.sigma


def test_an_old_calibration_is_called_old(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2025-08-01")
    (instrument,) = read_history(tmp_path).instruments
    said = next(iter(sentences(judge_history(instrument), NOW)))
    assert key_of(said) == "history_words.stale"
    assert "396 days" in said
    assert "365" in said
    assert not list(sentences(judge_history(instrument), NOW, stale_days=400))


def test_only_the_newest_solution_of_a_recording_counts(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("a", "2026-03-05", session="a" * 64)
    (instrument,) = read_history(tmp_path).instruments
    assert [entry.path for entry in instrument.entries] == ["a/parameters.toml"]


def test_a_session_that_was_taken_up_again_is_one_calibration(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    """A retake changes the recording and its hash; beside it stands what was solved before."""
    began = "2026-03-04T09:00:00Z"
    write("a", "2026-03-04", session="a" * 64, recorded=began)
    write("a", "2026-03-05", session="b" * 64, recorded=began, moved=2.0)
    write("b", "2026-03-04", session="c" * 64, recorded=began)
    write("b", "2026-03-06", session="d" * 64, recorded="2026-03-06T09:00:00Z")
    found = read_history(tmp_path)
    (instrument,) = found.instruments
    assert [entry.path for entry in instrument.entries] == ["b/parameters-1.toml", "a/parameters.toml", "b/parameters.toml"]
    assert [entry.session[0] for entry in instrument.entries] == ["c", "b", "d"]
    assert instrument.not_listed == 1
    # Whatever the files are called.
    (tmp_path / "a" / "parameters.toml").rename(tmp_path / "a" / "again.toml")
    (instrument,) = read_history(tmp_path).instruments
    assert instrument.entries[1].path == "a/again.toml"


def test_two_that_began_at_once_by_a_clock_that_nobody_has_set_are_two(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    began = "2000-01-01T00:00:00Z"
    write("a", "2026-03-04", session="a" * 64, recorded=began, called="march")
    write("a", "2026-08-04", session="b" * 64, recorded=began, called="august", moved=2.0)
    (instrument,) = read_history(tmp_path).instruments
    assert [entry.session[0] for entry in instrument.entries] == ["a", "b"]
    assert instrument.not_listed == 0


def test_instruments_are_kept_apart_and_one_can_be_chosen(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", serial_number="N1")
    write("b", "2026-03-05", serial_number="N2")
    assert [one.serial_number for one in read_history(tmp_path).instruments] == ["N1", "N2"]
    assert [one.serial_number for one in read_history(tmp_path, "N2").instruments] == ["N2"]
    with refused(ParameterFileError, Reason.FOREIGN, "N3", key="history.none_of_serial"):
        read_history(tmp_path, "N3")


def test_unknown_serial_numbers_are_not_trusted(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", serial_number="", session="a" * 64)
    write("b", "2026-03-05", serial_number="", session="b" * 64)
    (instrument,) = read_history(tmp_path).instruments
    assert key_of(next(iter(sentences(judge_history(instrument), NOW)))) == "history_words.no_serial"


def test_empty_and_missing_folders_are_refused(tmp_path: Path) -> None:
    with refused(ParameterFileError, Reason.FOREIGN, key="history.none"):
        read_history(tmp_path)
    with refused(ParameterFileError, Reason.FOREIGN, "nowhere", key="history.no_folder"):
        read_history(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    with refused(ParameterFileError, Reason.FOREIGN, "file", key="history.not_a_folder"):
        read_history(tmp_path / "file")


def test_table_has_a_row_for_every_number(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", moved=5.0, session="b" * 64)
    rows = list(csv.DictReader(io.StringIO(to_csv(read_history(tmp_path)))))
    numbers = len(read_history(tmp_path).instruments[0].entries[0].numbers)
    assert len(rows) == 2 * numbers
    moved = [row for row in rows if row["parameter"] == "bias y"]
    assert [row["change_sigma"] for row in moved] == ["", "3.54"]
    assert float(moved[0]["value"]) == read_history(tmp_path).instruments[0].entries[0].numbers[1].value


def test_table_says_which_file_was_edited_and_which_refused(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    edited = write("b", "2026-08-01", session="b" * 64)
    refused = write("c", "2026-08-02", session="c" * 64)
    edited.write_text(on_purpose(edited.read_text(encoding="utf-8")), encoding="utf-8")
    refused.write_text(refused.read_text(encoding="utf-8").replace("used = true", "used = false", 1), encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(to_csv(read_history(tmp_path)))))
    remarks = {row["file"]: row["remark"] for row in rows}
    assert remarks["a/parameters.toml"] == ""
    assert remarks["b/parameters.toml"] == "edited by hand"
    (last,) = [row for row in rows if not row["file"]]
    assert last["remark"].startswith("refused: ")
    assert "c/parameters.toml" in last["remark"]
    assert last["value"] == ""


def test_an_axis_of_any_length_has_its_dates() -> None:
    """Also that of a first try, with calibrations minutes apart; matplotlib warns where it finds none that fit."""
    pytest.importorskip("matplotlib")
    begin = datetime(2026, 3, 4, 10, 7, 13, tzinfo=UTC)
    for length_s in np.geomspace(5.0, 20 * 365.25 * 86400, 200):
        dates = date_locator().tick_values(begin, begin + timedelta(seconds=length_s))  # type: ignore[no-untyped-call]
        assert 1 <= len(dates) <= 8


def test_plot_is_a_drawing_of_every_kind(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", session="b" * 64)
    drawn = plot_history(judge_history(read_history(tmp_path).instruments[0])).decode()
    assert drawn.startswith("<svg")
    assert all(f">{name}<" in drawn for name in ("bias x, mg", "scale z, ppm", "angle yz, mrad"))
    # Limits of two calibrations alone are not known: none are drawn, and none explained.
    assert "Shaded" not in drawn
    write("c", "2026-10-01", session="c" * 64)
    assert "Shaded" in plot_history(judge_history(read_history(tmp_path).instruments[0])).decode()


def test_a_number_of_one_calibration_alone_is_not_drawn(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04", session="a" * 64)
    write("b", "2026-08-01", session="b" * 64)
    (instrument,) = read_history(tmp_path).instruments
    first, second = instrument.entries
    kept = [k for k, number in enumerate(first.numbers) if not number.name.startswith("angle")]
    parts = (getattr(first.gauge_free, part)[np.ix_(kept, kept)] for part in ("error", "scatter"))
    error, scatter = (tuple(part[np.triu_indices(len(kept))].tolist()) for part in parts)
    without = replace(first, numbers=tuple(first.numbers[k] for k in kept), error=error, scatter=scatter, linear=())
    drawn = plot_history(judge_history(replace(instrument, entries=(without, second)))).decode()
    assert ">bias x, mg<" in drawn
    assert ">angle" not in drawn
    assert "STIM300" in drawn
    nothing = tuple(replace(entry, numbers=(), error=(), scatter=(), linear=()) for entry in instrument.entries)
    assert plot_history(judge_history(replace(instrument, entries=nothing))).decode().startswith("<svg")


def test_the_calibration_closest_in_time_is_found(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    dates = ["2026-01-10T00:00:00Z", "2026-03-10T00:00:00Z", "2026-08-10T00:00:00Z"]
    paths = [write(f"{k}.toml", date, session=str(k) * 64) for k, date in enumerate(dates)]
    write("other.toml", "2026-05-01T00:00:00Z", serial_number="N2", session="f" * 64)
    for day, expected in ((datetime(2025, 1, 1), 0), (datetime(2026, 3, 20, tzinfo=UTC), 1), (datetime(2026, 6, 1), 2)):  # noqa: DTZ001
        assert find(tmp_path, "N1", day).path == paths[expected]
    assert find(str(tmp_path), "N1").path == paths[2]
    with refused(ParameterFileError, Reason.FOREIGN, "N3", key="history.none_of_serial"):
        find(tmp_path, "N3")


@pytest.mark.filterwarnings("error")
def test_a_position_left_out_is_no_side_of_the_setup() -> None:
    whole = solved(20.0)
    rows = whole.document["position"]

    def setup(changed: dict[str, object]) -> str:
        return Entry.of(
            "", replace(whole, document=whole.document | {"position": [*rows[:4], rows[4] | changed, *rows[5:]]})
        ).setup

    assert setup({"used": False}) != setup({})
    # What was not measured has no side.
    assert setup({"direction": [0.0, 0.0, 0.0]})
