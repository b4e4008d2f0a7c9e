"""The tables of sentences, read together: short, with the limit named, without the private words of earlier days."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import imufield
from imufield.guide.view.marks import AGAIN_WITHIN_S, NAMES
from tests.sources import house

MOST_WORDS = 25
LIMIT_WORDS = re.compile(
    r"limit|at (least|most)|up to|needed?\b|outside|beyond|above|below|reads|from|between|more than|within|range"
)
"""One of them stands where a sentence names a limit."""
PRIVATE = re.compile(
    r"so many|is said|\bwish|as asked|is asked for|asked for|held out|lies there|nothing is overwritten|"
    r"put back|to spare|strays?\b",
    re.IGNORECASE,
)
"""What read as if translated, and was replaced."""
WORD = re.compile(r"[\w./'^-]*[^\W_][\w./'^-]*")


def sentences() -> Iterator[tuple[str, str]]:
    """Yield key and text of every sentence of every room."""
    root = Path(imufield.__file__).parent
    for path in sorted(root.rglob("sentences.toml")):
        for section, texts in tomllib.loads(path.read_text(encoding="utf-8")).items():
            for key, text in texts.items():
                yield f"{path.parent.relative_to(root)}: {section}.{key}", " ".join(text.split())


def test_no_sentence_is_long() -> None:
    parts = (
        (key, part) for key, text in sentences() for part in re.split(r"(?<=\.)\s+(?=[A-Z])", re.sub(r"\{[^}]*\}", "N", text))
    )
    long = [f"{key}: {part}" for key, part in parts if len(WORD.findall(part)) > MOST_WORDS]
    assert not long, "\n".join(long)


def test_a_limit_is_called_one() -> None:
    bare = [
        f"{key}: {text}" for key, text in sentences() if re.search(r"\{\w*limit\w*[:}!]", text) and not LIMIT_WORDS.search(text)
    ]
    assert not bare, "\n".join(bare)


def test_sentences_of_the_guide_name_marks_and_no_keys() -> None:
    """Each view says how a mark is made there: see ``imufield.guide.view.marks``."""
    of_guide = {key: text for key, text in sentences() if key.startswith("guide") and key != "guide/view: marks.press"}
    assert {name for text in of_guide.values() for name in re.findall(r"(?<!\[)\[([a-z ]+)\]", text)} == {*NAMES}
    assert not [key for key, text in of_guide.items() if re.search(r"\bpress\b|\btap\b", text)]


def test_degrees_of_freedom_are_counted() -> None:
    """As "1 degree" where it is one."""
    assert not [key for key, text in sentences() if re.search(r"\} degrees of freedom", text)]


def test_of_a_move_nothing_is_asked_that_nobody_can_do() -> None:
    """It is found in a recording and has no name: positions and sessions can be repeated, a move cannot."""
    of_moves = {
        key: text
        for key, text in sentences()
        if key.startswith(("calibrate/gyroscope", "calibrate/moves")) and re.search(r"\bmove\b", text)
    }
    assert of_moves
    assert not [key for key, text in of_moves.items() if re.search(r"repeat it\b", text)]


def test_a_torn_end_may_be_that_of_a_recording_under_way() -> None:
    of_parts = {key: text for key, text in sentences() if key.startswith("acquire/recording: part_file.")}
    torn = [text for text in of_parts.values() if "cut off" in text]
    assert len(torn) == 2
    assert all("or is still" in text for text in torn)


def test_options_of_import_are_named_with_their_command() -> None:
    """``apply`` reads the same tables and has none of them."""
    first = re.compile(r"(imufield import (?:with )?)?--(?:set|columns|zero)\b(?! was given)")
    of_tables = [
        (key, named)
        for key, text in sentences()
        # One that begins with an option is of what was given.
        if re.match(r"acquire/formats: table|pipeline: still_units|guide/lead: still_scales", key) and not text.startswith("--")
        if (named := first.search(text))
    ]
    assert len(of_tables) > 20
    assert [key for key, named in of_tables if named[1] is None] == []


def test_no_private_words() -> None:
    found = [f"{key}: {text}" for key, text in sentences() if PRIVATE.search(text)]
    assert not found, "\n".join(found)


def test_the_second_finish_is_asked_for_within_its_time() -> None:
    asked = [text for _, text in sentences() if re.search(r"\[finish\] (again|twice)", text)]
    assert asked
    assert not [text for text in asked if f"within {AGAIN_WITHIN_S:g} s" not in text]


def test_sentences_that_no_code_names_and_names_without_a_sentence_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = '[parts]\nread = "{size} bytes"\nunread = "none"\n[shares]\ndrift = "Drift"\nwarm = "Warm"\n'
    (tmp_path / "sentences.toml").write_text(table)
    source = 'sentence("parts.read")\nsentence("parts.reed", size=1)\nsentence(f"shares.{name}")\nname = "drift"\n'
    monkeypatch.setattr(house(), "PROJECT", tmp_path)
    module = house().Module(tmp_path / "part.py", "part", source, ast.parse(source))
    assert house().sentences_astray([module]) == [
        "part.py:1 parts.read: {size} is not given",
        "part.py:2 parts.reed: no such sentence",
        "sentences.toml parts.unread: no code names it",
        "sentences.toml shares.warm: no code names it",
    ]
