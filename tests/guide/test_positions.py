from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.calibrate.accelerometer.drift import MOST_CONFUSION, order_confusion
from imufield.errors import Reason, UsageError
from imufield.guide.positions import (
    SCHEMES,
    angle_deg,
    cube_directions,
    describe,
    nearest_cube_direction,
    scheme,
)
from imufield.sentences import Sentences
from tests.guide.proposed_order import IN_TURN, interleave
from tests.refused import refused

sentence = Sentences("imufield.guide")

# Seen how often: positions of a direction, directions.
COUNTS = {"paper24": {1: 12, 2: 6}, "paper36": {1: 24, 2: 6}, "corners24": {1: 4, 2: 10}, "all26": {1: 26}, "faces6": {1: 6}}


@pytest.mark.parametrize("name", SCHEMES)
def test_names_are_unique_and_directions_are_as_described(name: str) -> None:
    found = scheme(name)
    assert len({position.name for position in found.positions}) == len(found)
    np.testing.assert_allclose(np.linalg.norm(found.directions(), axis=1), 1)
    _, times = np.unique(np.round(found.directions(), 6) + 0.0, axis=0, return_counts=True)
    assert dict(zip(*np.unique(times, return_counts=True), strict=True)) == COUNTS[name]


@pytest.mark.parametrize("name", ["paper24", "paper36", "corners24"])
def test_repeats_are_far_apart(name: str) -> None:
    directions = scheme(name).directions()
    for i, first in enumerate(directions):
        for j in range(i):
            if angle_deg(first, directions[j]) < 1:
                assert i - j >= len(directions) // 5


@pytest.mark.parametrize("name", ["paper24", "corners24", "all26"])
def test_no_order_confuses_drift_with_the_quadratic_term(name: str) -> None:
    assert order_confusion(scheme(name).directions()) < MOST_CONFUSION


@pytest.mark.parametrize("name", ["paper24", "paper36", "corners24", "all26"])
def test_a_linear_drift_looks_like_no_bias(name: str) -> None:
    directions = scheme(name).directions()
    time = np.linspace(-1, 1, len(directions))
    correlation = directions.T @ time / np.linalg.norm(directions, axis=0) / np.linalg.norm(time)
    assert np.abs(correlation).max() < 0.06


@pytest.mark.parametrize("name", SCHEMES)
def test_the_shipped_order_is_the_best_that_the_search_finds(name: str) -> None:
    shipped = [position.name.partition(" ")[0] for position in scheme(name).positions]
    direction = dict(zip(shipped, scheme(name).directions(), strict=True))
    found = interleave(np.array([direction[side] for side in IN_TURN[name]]))
    assert [IN_TURN[name][i] for i in found] == shipped


def test_a_direction_as_the_papers_give_it() -> None:
    by_name = {position.name: position for position in scheme("paper24").positions}
    np.testing.assert_allclose(by_name["x+0"].direction, [0, 0, 1])
    np.testing.assert_allclose(by_name["x+45"].direction, [0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_allclose(by_name["z+90"].direction, [1, 0, 0])
    assert by_name["x+45"].words == sentence("positions.edge", first="+y", second="+z")


def test_words() -> None:
    said = {
        (0.0, 0.0, -1.0): sentence("positions.face", up="-z", down="+z"),
        (1.0, -1.0, 1.0): sentence("positions.corner", sides="+x -y +z"),
        (0.0, 0.5, np.sqrt(0.75)): sentence("positions.leaning", up="+z", lean_deg=30, towards="+y"),
        (0.9, 0.1, 0.3): sentence("positions.leaning_between", up="+x", lean_deg=26, towards="+z", aside="+y"),
    }
    for up, words in said.items():
        assert describe(np.array(up)) == words


def test_nearest_of_26() -> None:
    assert len(cube_directions()) == 26
    assert nearest_cube_direction(np.array([5.0, 4.5, -0.3])) == "+x+y"
    assert nearest_cube_direction(np.array([0.1, -9.8, 0.3])) == "-y"


GOOD = """name = "mine"
[[position]]
name = "top"
up = [0, 0, 2]
[[position]]
up = [1, 1, 0]
words = "on the long edge"
"""


def test_own_positions(tmp_path: Any) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    found = scheme(path)
    assert found.name == "mine"
    assert [position.name for position in found.positions] == ["top", "+x+y"]
    assert found.positions[1].words == "on the long edge"
    np.testing.assert_allclose(found.positions[0].direction, [0, 0, 1])


@pytest.mark.parametrize(
    ("text", "key", "facts"),
    [
        ("", "no_position", ("[[position]]",)),
        ("position = 3", "no_position", ("[[position]]",)),
        ("[[position]]\nup = [0, 0, 1]\n" * 301, "too_many", ("301", "300")),
        ("colour = 1\n" + GOOD, "unknown_key_of_file", ("'colour'",)),
        (GOOD + "[[position]]\nup = [0, 0, 0]\n", "no_direction", ("line 8", "up = [0, 0, 0]")),
        (GOOD + "[[position]]\nup = [0, 0]\n", "no_direction", ("line 8", "up = [0, 0]")),
        (GOOD + "[[position]]\nup = 'z'\n", "no_direction", ("line 8", "up = 'z'")),
        (GOOD + "[[position]]\nup = [0, nan, 1]\n", "no_direction", ("line 8", "up = [0, nan, 1]")),
        (GOOD + "[[position]]\nup = [0, 0, 1]\nname = 'top'\n", "name_twice", ("line 8", "'top'")),
        (GOOD + "[[position]]\nup = [0, 0, 1]\nheading = 3\n", "unknown_key", ("line 8", "'heading'")),
        (GOOD + "[[position]]\nup = [0, 0, 1]\nname = 3\n", "no_text", ("line 8", "name", " 3 ")),
        ("position = [3]", "no_table", ("[[position]]", " 3")),
        ("name = \n[[position]]\n", "toml_and_json.no_toml", ("line 1",)),
    ],
)
def test_own_positions_that_make_no_sense(tmp_path: Any, text: str, key: str, facts: tuple[str, ...]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with refused(UsageError, Reason.USAGE, "mine.toml", *facts, key=key if "." in key else f"positions.{key}"):
        scheme(path)


def test_no_such_scheme() -> None:
    schemes = "paper24, paper36, corners24, all26, faces6"
    with refused(UsageError, Reason.USAGE, "'paper25'", schemes, key="positions.no_scheme"):
        scheme("paper25")


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null", "/", "."])
def test_a_folder_or_device_is_no_file_of_positions(path: str, tmp_path: Path) -> None:
    with refused(UsageError, Reason.USAGE, key="positions.no_scheme" if path == "." else "positions.no_file"):
        scheme(path)
    with refused(UsageError, Reason.USAGE, str(tmp_path), key="positions.no_file"):
        scheme(tmp_path)


def test_an_empty_name_is_no_scheme() -> None:
    with refused(UsageError, Reason.USAGE, "''", key="positions.no_scheme"):
        scheme("")
