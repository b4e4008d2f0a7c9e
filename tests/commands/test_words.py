"""What commands say of what they wrote, took and left: units, flagged rows, places, interrupts."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imufield
from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.recording.session import Session
from imufield.cli.run import _interrupted_words, run
from imufield.commands.terminal.guided import Captured, farewell
from imufield.commands.terminal.output import NothingRecorded
from imufield.deliver.exports import export_parameters
from imufield.deliver.parameters.file import load
from imufield.earth import normal_gravity
from imufield.errors import CalibrationError, ParameterFileError, Reason
from imufield.guide import refusals
from imufield.guide.events import Event, LinkLost, Rejected
from imufield.guide.view.sound import heard
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from imufield.pipeline.solving import _check_count
from imufield.samples import Samples, Status
from imufield.sentences import Sentences
from tests.commands.told import fails, missing, says
from tests.refused import refused
from tests.told import key_of

ROOT = Path(__file__).parents[2]


def starting_up(samples: Samples) -> Samples:
    """Mark the first two seconds as the instrument's start-up."""
    early = samples.time_s < samples.time_s.dtype.type(2.0)
    return replace(samples, status=np.where(early, samples.status | np.uint32(Status.START_UP), samples.status))


def test_tables_say_their_units_and_what_to_leave_out(
    make_session: Callable[..., Session], capsys: pytest.CaptureFixture[str], solved_session: Path, tmp_path: Path
) -> None:
    session = make_session("faces6", change=starting_up)
    table = tmp_path / "samples.csv"
    assert run(["export-data", str(session.folder), "-o", str(table)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "time in s, accelerometer in m/s^2, gyroscope in rad/s, temperature in degC" in told
    marked = sum(int(line.rsplit(",", 1)[1]) & Status.START_UP != 0 for line in table.read_text().splitlines()[1:])
    assert marked > 100
    assert f"{marked} rows marked unusable in the column status, {marked} of them during start-up (flag 16)" in told
    assert run(["apply", str(solved_session), str(session.folder), "-o", str(tmp_path / "corrected.csv")]) == 0
    told = capsys.readouterr().out
    assert not missing(" ".join(told.split()), "specific force in m/s^2, angular rate in rad/s")
    model = session.record.model
    unknown = {"who": "recording and the parameter file name", "own": model, "recorded": model}
    assert says(told, "deliver.parameters", "file.no_serial_number", **unknown)
    # Of the session that was solved nobody need be told.
    assert run(["apply", str(solved_session), str(solved_session), "-o", str(tmp_path / "corrected.csv")]) == 0
    assert not says(capsys.readouterr().out, "deliver.parameters", "file.no_serial_number", **unknown)


def test_parameters_are_printed_in_a_line(solved_session: Path) -> None:
    parameters = imufield.load(solved_session)
    assert not missing(repr(parameters), parameters.context.instrument.model, parameters.context.measured, "GOOD")
    assert len(repr(parameters)) < 150


def test_the_folder_of_a_session_stands_for_its_parameters(
    solved_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["export", str(solved_session), "--to", "c", "-o", str(tmp_path / "out.h")]) == 0
    assert (tmp_path / "out.h").read_bytes()
    assert imufield.load(solved_session).path == solved_session / "parameters.toml"
    folder = tmp_path / "unsolved"
    shutil.copytree(solved_session, folder)
    (folder / "parameters.toml").unlink()
    capsys.readouterr()
    assert run(["export", str(folder), "--to", "c"]) == 5
    assert "imufield solve" in capsys.readouterr().err


def test_an_export_asks_for_all_that_is_missing_at_once(solved_session: Path) -> None:
    parameters = imufield.load(solved_session)
    calibration = parameters.calibration
    assert calibration.gyroscope is not None
    counts = replace(calibration, accelerometer_raw_unit="count", gyroscope=replace(calibration.gyroscope, raw_unit="count"))
    unknown = replace(parameters, calibration=counts)
    with pytest.raises(ParameterFileError) as caught:
        export_parameters(unknown, "px4")
    assert "--set accelerometer_nominal=NUMBER (count per m/s^2)" in caught.value.message
    assert "--set gyroscope_nominal=NUMBER (count per rad/s)" in caught.value.message


def test_the_one_hold_that_was_refused_is_named() -> None:
    refusal = refusals.FAULT.refusal(10.0, 5.0).event(1.0, "x+90")
    with refused(CalibrationError, Reason.TOO_FEW, "2 positions", "x+90", key="solving.too_few_one"):
        _check_count(2, [refusal])


def test_an_example_of_gravity_is_that_of_the_place_beside_it() -> None:
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    form = (ROOT / "imufield" / "web" / "static" / "workbench.html").read_text(encoding="utf-8")
    examples = [
        re.search(r"--latitude ([\d.]+) --height (\d+)`, `--gravity ([\d.]+)", page),
        re.search(r'(?s)name="latitude".*?holder="([\d.]+)".*?holder="(\d+)".*?holder="([\d.]+)\+-', form),
    ]
    for example in examples:
        assert example is not None
        latitude_deg, height_m, gravity_m_s2 = map(float, example.groups())
        assert gravity_m_s2 == pytest.approx(normal_gravity(latitude_deg, height_m), abs=1e-4)


def test_an_import_onto_a_session_names_what_it_can_do(solved_session: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("ax,ay,az,gx,gy,gz\n" + "0.1,0.2,9.8,0,0,0\n" * 50)
    line = ["import", str(tmp_path / "rows.csv"), "--rate-hz", "100", "-o", str(solved_session)]
    error = fails(line, 4, Reason.UNFINISHED, str(solved_session), key="import_files.exists_and_stays")
    assert "--resume" not in error.message


@pytest.mark.parametrize(
    ("command", "key"),
    [("capture", "run.recorded"), ("solve", None), ("emulate", None), ("import", "run.nothing_imported")],
)
def test_an_interrupt_says_what_is_true(command: str, key: str | None) -> None:
    assert getattr(_interrupted_words([command, "x"], KeyboardInterrupt()), "key", None) == key
    nothing = NothingRecorded()
    assert getattr(_interrupted_words([command, "x"], nothing), "key", None) == "run.nothing_recorded"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("factor", [1e300, -1e30, 1e13])
def test_samples_of_no_instrument_are_invalid(factor: float, tmp_path: Path) -> None:
    rows = np.random.default_rng(1).normal([0.1, 0.2, 9.8, 0, 0, 0], 0.01, (2000, 6))
    rows[1000:] *= factor
    np.savetxt(tmp_path / "rows.csv", rows, delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")
    units = ("--set", "accelerometer_unit=m/s^2", "--set", "gyroscope_unit=rad/s")
    assert run(["import", str(tmp_path / "rows.csv"), "--rate-hz", "100", *units, "-o", str(tmp_path / "session")]) == 0
    fails(["solve", str(tmp_path / "session")], 6, Reason.TOO_FEW, key="solving.one_rest")


def test_one_rest_without_a_gyroscope_says_how_to_hold_the_unit(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).normal([0.1, 0.2, 9.8], 0.01, (2000, 3))
    np.savetxt(tmp_path / "rows.csv", rows, delimiter=",", header="ax_m_s2,ay_m_s2,az_m_s2", comments="")
    assert run(["import", str(tmp_path / "rows.csv"), "--rate-hz", "100", "-o", str(tmp_path / "session")]) == 0
    fails(["solve", str(tmp_path / "session")], 6, Reason.TOO_FEW, key="solving.one_rest_in_hand")


def test_a_table_without_time_is_corrected_at_the_rate_that_is_told(
    solved_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, output = tmp_path / "table.csv", tmp_path / "corrected.csv"
    table.write_text("ax,ay,az,gx,gy,gz\n" + "0.1,0.2,9.8,0.01,0.02,0.03\n" * 20)
    parameters = str(solved_session / "parameters.toml")
    assert run(["apply", parameters, str(table), "-o", str(output)]) != 0
    assert "--rate-hz" in capsys.readouterr().err
    table.write_text("Uhr [ms]," + table.read_text().replace("\n0", "\n7,0"))
    assert run(["apply", parameters, str(table), "-o", str(output), "--rate-hz", "50"]) == 0, capsys.readouterr().err
    # A time that nobody recognised is told, and how it is read.
    assert not missing(capsys.readouterr().err, "Uhr [ms]", "--columns", "50 Hz")
    time_s = np.genfromtxt(output, delimiter=",", skip_header=1)[:, 0]
    assert np.diff(time_s) == pytest.approx(np.full(19, 0.02))
    assert run(["apply", parameters, str(solved_session), "-o", str(output), "--rate-hz", "50"]) == 2


def test_a_table_that_only_an_import_can_be_told_of_is_corrected_by_way_of_it(solved_session: Path, tmp_path: Path) -> None:
    table, output = tmp_path / "table.csv", str(tmp_path / "corrected.csv")
    table.write_text("p,q,r,s\n" + "0.1,0.2,9.8,0.01\n" * 20)
    fails(["apply", str(solved_session), str(table), "-o", output], 2, Reason.USAGE, "imufield import", key="apply.by_import")
    # A rate is an option of this command, too.
    table.write_text("time_s,ax,ay,az\n" + "".join(f"{0.01 * row:.2f},0.1,0.2,9.8\n" for row in range(20)))
    line = ["apply", str(solved_session), str(table), "-o", output, "--rate-hz", "50"]
    fails(line, 2, Reason.USAGE, "--rate-hz", key="table_columns.other_rate")


def test_parameters_without_a_gyroscope_say_so_where_they_are_used(
    short_solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, session = tmp_path / "table.csv", tmp_path / "alone"
    assert run(["export-data", str(short_solved), "-o", str(table)]) == 0
    np.savetxt(
        table,
        np.loadtxt(table, delimiter=",", skiprows=1, usecols=range(4)),
        delimiter=",",
        header="time,ax,ay,az",
        comments="",
    )
    assert run(["import", str(table), "-o", str(session)]) == run(["solve", str(session), "--gravity", "9.8"]) == 0
    alone = load(session).gyroscope_note
    assert key_of(alone) == "file.not_calibrated"
    for command, *output in (("export", "--to", "json"), ("apply", str(table))):
        capsys.readouterr()
        assert run([command, str(session / "parameters.toml"), *output, "-o", str(tmp_path / command)]) == 0
        assert not missing(capsys.readouterr().out, *alone.split())


def test_rows_missing_in_an_imported_table_were_not_lost_on_a_wire(
    solved_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, gap = tmp_path / "samples.csv", tmp_path / "gap.csv"
    assert run(["export-data", str(solved_session), "-o", str(table)]) == 0
    head, *rows = [",".join(line.split(",")[:7]) for line in table.read_text().splitlines()]
    gap.write_text("\n".join([head, *rows[:1000], *rows[1040:]]) + "\n")
    assert run(["import", str(gap), "-o", str(tmp_path / "mine")]) == 0
    capsys.readouterr()
    assert run(["solve", str(tmp_path / "mine"), "--latitude", "48"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert f"40 of {len(rows)} samples are missing in the file" in told
    assert "wire" not in told
    assert "axes verified" in told


def test_a_session_that_goes_on_does_not_speak_of_a_link_that_is_gone(make_session: Callable[..., Session]) -> None:
    session = make_session("faces6", visits=3)
    chain = Chain(ReadingPlan.of(session))
    replay_into(chain, session, [], ended=False)
    assert chain.protocol is not None
    said = [event for event in chain.start_part(chain.protocol) if isinstance(event, LinkLost)]
    assert [event.words for event in said] == [Sentences("imufield.pipeline")("chain.part_begins")]
    # Nothing is wrong: no alarm sounds.
    assert [heard(event) for event in said] == [(None, None)]
    assert said[0].accepted == 3


# With nine positions nothing would be left to check them.
@pytest.mark.parametrize(("accepted", "command"), [(9, "imufield capture --resume --session"), (10, "imufield solve")])
def test_what_comes_next_can_be_done(
    accepted: int, command: str, whole_session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    farewell(
        Captured(session=Session.open(whole_session), accepted=accepted, planned=24, finished=True), "plain", SystemClock()
    )
    assert command in capsys.readouterr().out


@pytest.mark.parametrize(("accepted", "is_enough"), [(9, False), (10, True), (24, True)])
def test_what_is_not_finished_can_be_solved_where_it_is_enough(
    accepted: int, is_enough: bool, whole_session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = Session.open(whole_session)
    farewell(Captured(session=session, accepted=accepted, planned=24, finished=False), "plain", SystemClock())
    shown = capsys.readouterr().out
    assert "imufield capture --resume --session" in shown
    assert ("imufield solve" in shown) is is_enough


def test_what_was_refused_and_measured_then_is_not_what_is_missing(make_session: Callable[..., Session]) -> None:
    """The second side is knocked, and measured right after; the last is never shown."""

    def knock(samples: Samples) -> Samples:
        hit = (samples.time_s > 29) & (samples.time_s < 29.2)
        samples.accelerometer[hit] += np.random.default_rng(0).normal(0, 3, (hit.sum(), 3))
        return samples

    session = make_session("faces6", visits=5, hold_s=14.0, finished=False, change=knock)
    refused: list[Event] = []
    chain = Chain(ReadingPlan.of(session))
    replay_into(chain, session, [], refused.extend)
    assert chain.guide is not None
    (missed,) = chain.guide.plan.missing()
    assert [event.position for event in refused if isinstance(event, Rejected) and event.position] == ["-y"]
    fails(f"solve {session.folder}", 6, Reason.TOO_FEW, "5 positions", "1 left", missed, "--resume", key="solving.unfinished")


def test_a_hold_that_moved_is_not_what_is_missing_where_it_would_not_be_enough(make_session: Callable[..., Session]) -> None:
    """The second side is knocked until the recording ends; four others are never shown."""

    def knock(samples: Samples) -> Samples:
        hit = samples.time_s > 29
        samples.accelerometer[hit] += np.random.default_rng(0).normal(0, 3, (hit.sum(), 3))
        return samples

    session = make_session("faces6", visits=2, hold_s=14.0, finished=False, change=knock)
    error = fails(f"solve {session.folder}", 6, Reason.TOO_FEW, "--resume", key="solving.unfinished")
    assert (error.values["positions"], error.values["more"]) == (1, 5)


def test_turns_that_are_missing_are_counted(whole_session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ended = Captured(session=Session.open(whole_session), accepted=24, planned=24, turns=(1, 6), finished=False)
    farewell(ended, "plain", SystemClock())
    assert "24 of 24 positions and 1 of 6 whole turns" in capsys.readouterr().out


def test_a_session_that_lost_samples_in_many_moves_says_so_once(
    make_session: Callable[..., Session], capsys: pytest.CaptureFixture[str]
) -> None:
    """The file, JSON and with them other programs have every move."""

    def lose(samples: Samples) -> Samples:
        return samples[np.flatnonzero(np.linalg.norm(samples.gyroscope, axis=1) < 1.2)]

    folder = str(make_session(change=lose).folder)
    assert run(["solve", folder, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    moves = [reason for reason in document["quality"]["reasons"] if "lost samples for" in reason]
    assert len(moves) > 10
    assert run(["solve", folder]) == 0
    told = " ".join(capsys.readouterr().out.split())
    worst = max(moves, key=lambda move: float(move.split(" lost samples for ")[1].split()[0]))
    assert told.count("lost samples for") == 1
    assert f"{len(moves)} sentences like this, the largest: {worst}" in told
