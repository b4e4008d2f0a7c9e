"""Parameter files that must not be used, through every command that takes one: one sentence, code 5, old files intact."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import tomli_w

from imufield.calibrate.model.gauge import intrinsic, make_intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.cli.run import run
from imufield.deliver.parameters.document import calibration_from_document
from imufield.deliver.parameters.write import to_toml
from imufield.errors import Reason
from imufield.samples import SAMPLE_COLUMNS
from tests.commands.told import fails, missing
from tests.parameter_files import on_purpose

OLD = f"{','.join(SAMPLE_COLUMNS)}\nwhat stood there before\n".encode()


@pytest.fixture(scope="module")
def told(short_solved: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a solved session whose instrument told its serial number, with what is kept of reading it so."""
    folder = Path(shutil.copytree(short_solved, tmp_path_factory.mktemp("told") / "solved"))
    metadata = tomllib.loads((folder / "session.toml").read_text(encoding="utf-8"))
    metadata["instrument"]["serial_number"] = "B2"
    (folder / "session.toml").write_text(tomli_w.dumps(metadata), encoding="utf-8")
    assert run(["solve", str(folder), "-o", str(folder.parent / "again.toml")]) == 0
    return folder


@pytest.fixture
def solved(told: Path, tmp_path: Path) -> Path:
    """Return the same of one's own."""
    return Path(shutil.copytree(told, tmp_path / "solved"))


def cut(text: str) -> str:
    return text[: len(text) // 2]


def edited(text: str) -> str:
    return text.replace("used = true", "used = false", 1)


def newer(text: str) -> str:
    return on_purpose(text.replace("version = 1", "version = 3", 1))


def not_a_number(text: str) -> str:
    head, name, tail = text.partition("scale = [")
    return on_purpose(f"{head}{name}nan{tail[tail.index(',') :]}")


def changed(table: str, key: str, value: object) -> Callable[[str], str]:
    """Return what writes a whole file again with another value, hash and all."""

    def write(text: str) -> str:
        document = tomllib.loads(text)
        del document["integrity"]
        document[table][key] = value
        return to_toml(document)

    return write


def impossible(text: str) -> str:
    terms = "cubic = [1e300, 0.0, 0.0]\ncross = [{0}]\ncubic_sigma = [0.0, 0.0, 0.0]\ncross_sigma = [{0}]\n"
    zeros = ", ".join(["[0.0, 0.0, 0.0]"] * 3)
    return on_purpose(f"{text}\n").replace("[covariance]", f"[accelerometer.higher]\n{terms.format(zeros)}\n[covariance]", 1)


def reversed_axis(text: str) -> str:
    """Return the file of an instrument whose output y is the other way round, with all that follows from it."""
    document = tomllib.loads(text)
    del document["integrity"]
    accelerometer = document["accelerometer"]
    for table in (accelerometer, *document["position"]):
        key = "mean_raw" if "mean_raw" in table else "scale"
        table[key][1] = -table[key][1]
    vector = to_vector(calibration_from_document(document).accelerometer)
    values = intrinsic(vector, accelerometer["quadratic_axes"])[0]
    follows = make_intrinsic(values, values)
    for key in ("scale", "bias_raw", "angle_rad", "quadratic"):
        accelerometer["intrinsic"][key] = getattr(follows, key).tolist()
    return to_toml(document)


other_unit = changed("accelerometer", "raw_unit", "count")
other_instrument = changed("instrument", "serial_number", "A1")
BAD: dict[str, tuple[Callable[[str], str], Reason, tuple[str, ...]]] = {
    "cut": (cut, Reason.DAMAGED, ("bad.toml",)),
    "edited by hand": (edited, Reason.DAMAGED, ("bad.toml",)),
    "newer": (newer, Reason.NEWER, ("bad.toml", "version 3", "version 2")),
    "not a number": (not_a_number, Reason.NOT_FINITE, ("bad.toml", "scale[0]", "nan")),
    "other units": (other_unit, Reason.UNITS, ("count",)),
    "another instrument": (other_instrument, Reason.FOREIGN, ("A1",)),
    "impossible": (impossible, Reason.DAMAGED, ("accelerometer.higher.cubic[0]", "1e+15")),
    "reversed axis": (reversed_axis, Reason.BOUNDS, ("y",)),
}
COMMANDS = {
    "apply": "apply {bad} {session} -o {old}",
    "verify": "verify {bad} {session} -o {old}",
    "verify against a preset": "verify {good} {session} --preset {bad} -o {old}",
    "report": "report {session} --parameters {bad} -o {old}",
    "report with a preset": "report {session} --preset {bad} -o {old}",
    "solve with a preset": "solve {session} --preset {bad} -o {old}",
    "certificate": "certificate {bad}",
    "export px4": "export {bad} --to px4 -o {old}",
    "export c": "export {bad} --to c -o {old}",
}
NEEDS_SESSION = ("apply", "verify", "verify against a preset", "report", "report with a preset", "solve with a preset")
UNREADABLE = ("cut", "edited by hand", "newer", "not a number")
CASES = [
    *((fault, command) for fault in UNREADABLE for command in COMMANDS),
    *(("other units", command) for command in (*NEEDS_SESSION, "export px4")),
    *(("another instrument", command) for command in NEEDS_SESSION),
    ("reversed axis", "export px4"),
    ("impossible", "export c"),
]


@pytest.mark.parametrize(("fault", "command"), CASES)
def test_one_sentence_code_5_and_the_old_file(
    solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str, command: str
) -> None:
    make, reason, facts = BAD[fault]
    good, bad, old = solved / "parameters.toml", tmp_path / "bad.toml", tmp_path / "old"
    bad.write_text(make(good.read_text(encoding="utf-8")), encoding="utf-8")
    old.write_bytes(OLD)
    before = {path.name: path.read_bytes() for path in solved.iterdir()}
    line = COMMANDS[command].format(good=good, bad=bad, session=solved, old=old)
    fails(line, 5, reason, *facts)
    errors = capsys.readouterr().err
    assert errors.count("imufield: ") == 1
    assert old.read_bytes() == OLD
    assert {path.name: path.read_bytes() for path in solved.iterdir()} == before


def test_apply_with_its_arguments_the_other_way_round(solved: Path, tmp_path: Path) -> None:
    fails(
        f"apply {solved} {solved / 'parameters.toml'} -o {tmp_path / 'old'}",
        2,
        Reason.USAGE,
        "parameters.toml",
        key="apply.swapped",
    )
    assert not (tmp_path / "old").exists()


@pytest.mark.parametrize(
    "command",
    [
        "apply {edited} {session} -o {old}",
        "verify {edited} {session} -o {old}",
        "verify {edited} {session} -o {old} --json",
        "export {edited} --to c -o {old}",
        "export {edited} --to c -o {old} --json",
        "history {folder}",
        "history {folder} --json",
    ],
)
def test_every_command_says_that_a_file_was_edited(
    solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    path = folder / "parameters.toml"
    text = (solved / "parameters.toml").read_text(encoding="utf-8")
    for content, wanted in ((text, False), (on_purpose(text), True)):
        path.write_text(content, encoding="utf-8")
        line = command.format(edited=path, session=solved, old=tmp_path / "old", folder=folder)
        capsys.readouterr()
        assert run(line.split()) == 0
        said = capsys.readouterr().out
        if command == "history {folder} --json":
            (instrument,) = json.loads(said)["instruments"]
            assert instrument["calibrations"][0]["edited"] is wanted
        else:
            assert ("edited" in said) is wanted


def test_a_file_with_an_impossible_number_has_no_history(
    solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, _, facts = BAD["impossible"]
    whole = (solved / "parameters.toml").read_text(encoding="utf-8")
    for name, text in (("good.toml", whole), ("bad.toml", make(whole))):
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert run(["history", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "bad.toml" not in said.out
    assert not missing(said.err, "bad.toml", *facts)
