"""The sentences of the rooms: found by key, filled with their values, carried by errors."""

from __future__ import annotations

import copy
import os
import pickle
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from imufield.errors import Reason, RecordingError
from imufield.sentences import (
    Sentence,
    Sentences,
    counted,
    folded,
    printable,
    printable_lines,
    shell_word,
    shortened,
    three_digits,
)

sentence = Sentences("imufield")


def test_a_sentence_names_its_values_and_keeps_them() -> None:
    made = sentence("earth.latitude", latitude_deg=91.5)
    assert "91.5" in made
    assert (made.key, made.values) == ("earth.latitude", {"latitude_deg": 91.5})


def test_an_error_takes_the_values_of_its_sentence_and_its_own() -> None:
    error = RecordingError(sentence("files.is_input", output="a.csv"), Reason.FOREIGN, errno=17)
    assert error.values == {"output": "a.csv", "errno": 17}


@pytest.mark.parametrize("way", [copy.copy, lambda made: pickle.loads(pickle.dumps(made))])  # noqa: S301
def test_a_sentence_goes_to_another_process_as_it_is(way: Callable[[Sentence], Sentence]) -> None:
    made = sentence("files.is_input", output="a.csv")
    other = way(made)
    assert (other, other.key, other.values) == (made, made.key, made.values)


def test_a_value_in_braces_is_text() -> None:
    assert "{cause.__class__}" in sentence("files.is_input", output="{cause.__class__}")


def test_a_key_that_is_not_there_is_a_defect() -> None:
    with pytest.raises(KeyError):
        sentence("files.no_such_sentence")


def test_whether_there_is_a_sentence_can_be_asked() -> None:
    assert "earth.latitude" in sentence
    assert not [key for key in ("earth.no_such_sentence", "nowhere.latitude", "latitude", "") if key in sentence]


def test_what_a_person_is_to_type_is_quoted() -> None:
    made = Sentences("imufield.pipeline")("table_samples.device", path="/dev/my port")
    assert made.startswith("/dev/my port ")
    assert "imufield record --port '/dev/my port'" in made


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    "name",
    ["plain", "-dash", "--option", "my file's", "new\nline", "it's\\\x1b[31mred", "\x9fbe", "bad\udcff\udcfe", "\u2028ü日"],
)
def test_what_a_person_is_to_type_is_the_name_of_the_file(name: str) -> None:
    word = shell_word(name)
    assert printable(word) == word
    typed = subprocess.run(["bash", "-c", f"printf %s {word}"], capture_output=True, check=True).stdout
    assert os.path.normpath(typed) == os.fsencode(name)


def test_numbers_are_counted_and_lists_joined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sentences.toml").write_text('[a]\nb = """\n  {found:#position} of\n  {names}"""\n')
    monkeypatch.setattr("imufield.sentences.__file__", str(tmp_path / "sentences.py"))
    made = Sentences("imufield")
    from imufield import sentences

    sentences._table.cache_clear()
    try:
        assert made("a.b", found=1, names=["x", "y"]) == "1 position of x, y"
        assert made("a.b", found=2, names=("x",)) == "2 positions of x"
    finally:
        sentences._table.cache_clear()


def test_what_is_long_is_shortened_and_what_is_one_counts_as_one() -> None:
    assert shortened("x" * 41) == "x" * 40 + "..."
    assert counted(1, "hold") == "1 hold"


@pytest.mark.parametrize(
    ("value", "words"), [(1837.4, "1837"), (102.4, "102"), (99.96, "100"), (0.012345, "0.0123"), (-3.0, "-3"), (-1e-9, "0")]
)
def test_three_digits_need_no_exponent(value: float, words: str) -> None:
    assert three_digits(value) == words


def test_control_characters_of_values_are_shown() -> None:
    made = sentence("files.is_input", output="a\x1b[2J\x9b\n\t\u202e\u2066\u2028\udcff.csv")
    assert r"a\x1b[2J\x9b\n\t\u202e\u2066\u2028\udcff.csv" in made
    assert printable(made) == made
    assert sentence("files.is_input", output=Path("\x1b")) != sentence("files.is_input", output=Path("x1b"))


def test_letters_of_any_language_stay() -> None:
    words = "Zürich 東京 القاهرة\u200f नई\u200d दिल्ली 👍"
    assert printable(words) == words


def test_ends_of_lines_of_ours_stay() -> None:
    assert printable_lines("a\n\tb\r\n") == "a\n\\tb\\r\n"


MOVES = [(1.0, 0.2), (12.3, 1.1), (20.0, 0.3), (500.0, 0.15)]
OFFS = {"x+0": 0.2, "y+45": -1.1, "z+90": 0.3, "x+180": 0.15}


def lost(begin_s: float, missing_s: float) -> Sentence:
    said = {"begin_s": begin_s, "end_s": begin_s + 2, "missing_s": missing_s, "bridged_s": 0.05, "intervals": 3.5}
    return Sentences("imufield.calibrate.moves")("moves.lost_samples", **said)


def off(position: str, off_mg: float) -> Sentence:
    said = {"off_mg": off_mg, "sigmas": 4.0, "limit": 3.0, "option": f"--without {position}"}
    return Sentences("imufield.calibrate.accelerometer")("quality.outlier", position=position, **said)


@pytest.mark.parametrize(
    ("alike", "worst"),
    [
        # Neither the latest nor the one with the largest time of all.
        ([lost(*move) for move in MOVES], lost(12.3, 1.1)),
        ([off(*each) for each in OFFS.items()], off("y+45", -1.1)),
    ],
)
def test_of_many_sentences_of_a_kind_the_worst_is_read_and_how_many(alike: list[str], worst: str) -> None:
    first, told, last = folded(["before", *alike, "behind"])
    assert (first, last) == ("before", "behind")
    assert told.startswith("4 ")
    assert told.endswith(worst)


def test_few_of_a_kind_are_read_one_by_one_in_their_order() -> None:
    few = [lost(*MOVES[0]), off("x+0", 0.2), lost(*MOVES[1]), off("y+45", 1.0), lost(*MOVES[2])]
    assert folded(few) == few


def test_sentences_without_a_size_have_a_first() -> None:
    saturated = [Sentences("imufield.calibrate.moves")("moves.saturated", begin_s=k, end_s=k + 1) for k in (1, 5, 3, 2)]
    assert folded(saturated)[0].endswith(saturated[0])
    assert "worst" not in folded(saturated)[0]


def test_positions_of_which_one_sentence_is_read_are_named() -> None:
    said = {"names": ["scale x"], "leverage": 1.0}
    alike = [Sentences("imufield.calibrate.accelerometer")("quality.carries", position=name, **said) for name in OFFS]
    (told,) = folded(alike)
    assert told.startswith(alike[0])
    assert [name for name in OFFS if told.count(name) == 1] == [*OFFS]


def test_many_names_are_cut_and_sentences_that_differ_in_numbers_too_name_none() -> None:
    (told,) = folded([f"position x+{k} was moved" for k in range(40)])
    assert len(told) < 150
    shaken = [f"position {name} shook for {k} of 9 s" for k, name in enumerate(("x+45", "x+90", "y+0", "z+0", "z+0"))]
    (told,) = folded(shaken)
    assert told.endswith("position z+0 shook for 4 of 9 s")
    # A character that stands for what varies elsewhere.
    assert len(folded([*(f"file {k} is cut" for k in range(4)), "file # is cut"])) == 2
