"""The box and the big letters."""

from pathlib import Path

import numpy as np
import pytest

from imufield.drawing.box import turn_shortest
from imufield.guide.positions import cube_directions
from imufield.guide.view.pictures import LETTER_WIDTH, ROWS, big_lines, draw_box
from imufield.samples import FloatArray

DIRECTIONS = cube_directions()


@pytest.mark.parametrize("ascii_only", [False, True])
@pytest.mark.parametrize("name", DIRECTIONS)
def test_the_picture_fits_and_names_the_side_that_is_up(name: str, ascii_only: bool) -> None:
    lines = draw_box(turn_shortest(np.eye(3), DIRECTIONS[name]), 20, 8, cable="-x", ascii_only=ascii_only)
    assert [len(line) for line in lines] == [20] * 8
    assert not ascii_only or all(line.isascii() for line in lines)
    text = "\n".join(lines)
    if len(name) == 2:
        assert name in text or (name == "-x" and "cable" in text)
    assert sum(not character.isspace() for character in text) > 20


def seen(up: FloatArray) -> str:
    return "\n".join(draw_box(turn_shortest(np.eye(3), up), 20, 8))


def test_different_sides_look_different() -> None:
    assert len({seen(up) for up in DIRECTIONS.values()}) == len(DIRECTIONS)


def test_big_letters() -> None:
    lines = big_lines("HOLD 7?", 80)
    assert len(lines) == ROWS
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("##      ##")
    assert big_lines("TOO LONG A WORD", 80) == big_lines("TOO LO", 80)
    assert LETTER_WIDTH * 6 <= 80
    assert all(not line for line in big_lines("~", 80))


def test_the_readme_shows_the_screen_that_was_drawn() -> None:
    """``make screens`` writes both; what is typed in between is a lie."""
    root = Path(__file__).parents[3]
    drawn = (root / "docs" / "screens" / "turn.txt").read_text(encoding="utf-8").rstrip()
    assert drawn in (root / "README.md").read_text(encoding="utf-8")
    lines = drawn.splitlines()
    assert len(lines) == 24
    assert max(map(len, lines)) <= 80
