"""The table of refusals."""

from __future__ import annotations

import string
import tomllib
from importlib.resources import files

import pytest

from imufield.guide import refusals
from imufield.guide.events import RefusalCode
from imufield.guide.refusals import Refusal, RefusalKind, quantity, what_is_left
from imufield.sentences import Sentences
from tests.guide.guided import key_of

sentence = Sentences("imufield.guide")
ROWS = {name: row for name, row in vars(refusals).items() if isinstance(row, RefusalKind)}
TEXTS = tomllib.loads((files("imufield.guide") / "sentences.toml").read_text(encoding="utf-8"))["refusals"]


def test_every_reason_has_a_row() -> None:
    assert {row.reason for row in ROWS.values()} == set(RefusalCode)


@pytest.mark.parametrize("name", ROWS)
def test_every_row_is_one_line_of_words_and_one_remedy(name: str) -> None:
    row = ROWS[name]
    texts = [TEXTS[key.partition(".")[2]] for key in (row.words, row.remedy)]
    given = {field for text in texts for _, field, _, _ in string.Formatter().parse(text) if field}
    values = dict.fromkeys(given - {"measured", "limit", "axis", "found", "allowed"}, 1.0)
    refusal = row.refusal(2.0, 1.0, axis="x", unit=row.unit or "rad/s", **values)
    assert isinstance(refusal, Refusal)
    for text in (refusal.words, refusal.remedy):
        assert text
        assert not set(text) & set("{}\n")
        assert "  " not in text
    assert refusal.unit


def test_numbers_of_a_row_are_those_of_the_event() -> None:
    event = refusals.PUSHED.refusal(0.456, 0.3, axis="y", after_s=4.0).event(9.0, "+x")
    assert key_of(event.words) == "refusals.pushed"
    assert all(number in event.words for number in ("0.46 deg", "4.0 s", "0.30 deg"))
    assert (event.measured, event.limit, event.unit, event.axis) == (0.456, 0.3, "deg", "y")
    assert (event.time_s, event.position, event.reason) == (9.0, "+x", RefusalCode.KNOCKED)


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (0.0123, "m/s^2", "12.3 mm/s^2"),
        (9.81, "m/s^2", "9.81 m/s^2"),
        (0.01, "rad/s", "0.57 deg/s"),
        (4.0, "raw unit", "4 raw unit"),
    ],
)
def test_quantities_are_in_the_unit_of_their_size(value: float, unit: str, words: str) -> None:
    assert quantity(value, unit) == words


def test_what_is_left_names_four_at_most() -> None:
    assert what_is_left([]) == sentence("refusals.none_left")
    assert what_is_left(["+x", "-x"]) == sentence("refusals.left", count=2, names="+x, -x")
    five = what_is_left(["a", "b", "c", "d", "e"])
    assert five == sentence("refusals.left_and_more", count=5, names="a, b, c, d", more=1)
