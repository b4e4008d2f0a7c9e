"""The page's turns and its projection against SciPy's, in the browser that draws them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("websockets", reason="the page needs websockets")

from imufield.guide.positions import angle_deg
from tests.web.browser import Screens
from tests.web.guide_stages import StagedSession

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PAIRS = 200
NEAR_RAD = (1e-12, 1e-7, 1e-3)
TURNS = """async (pairs) => {
    const { apply, product, rotation, smallestTurn } = await import("/vectors.js");
    return pairs.map(([from, to]) => {
        const { axis, angle } = smallestTurn(from, to);
        const [matrix, half] = [rotation(axis, angle), rotation(axis, angle / 2)];
        return { axis, angle, matrix, twice: product(half, half), turned: apply(matrix, from) };
    });
}"""
SQUARED = """async (matrices) => {
    const { orthonormal } = await import("/vectors.js");
    return matrices.map(orthonormal);
}"""
SEEN = """async (directions) => {
    const { seen } = await import("/globe.js");
    return directions.map(seen);
}"""
# One frame of a device whose owner wants no motion brings the box where it is wanted.
BOXES = """async (pairs) => {
    const [{ Box }, { apply }] = [await import("/box.js"), await import("/vectors.js")];
    const box = new Box(document.createElement("canvas"));
    return pairs.map(([up, goal]) => {
        [box.up, box.goal] = [up, goal];
        box.frame(0);
        return { up: apply(box.attitude, up), goal: apply(box.wanted(), goal), attitude: box.attitude };
    });
}"""


def directions(count: int, seed: int) -> Any:
    """Return unit vectors in random directions, shape (count, 3)."""
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def pairs() -> list[tuple[Any, Any]]:
    """Return pairs of directions: random ones, the same, opposite ones, and those nearly so."""
    found = list(zip(directions(PAIRS, 1), directions(PAIRS, 2), strict=True))
    for up in [*np.eye(3), *directions(5, 3)]:
        across = np.cross(up, directions(1, 4)[0])
        found += [(up, up), (up, -up)]
        for near_rad in NEAR_RAD:
            near = Rotation.from_rotvec(near_rad * across / np.linalg.norm(across)).apply(up)
            found += [(up, near), (up, -near)]
    return found


@pytest.fixture(scope="module")
def page(browser: Browser) -> Iterator[Page]:
    """Open the page of a session that stands still."""
    screens, staged = Screens(browser), StagedSession()
    next(staged.stages())
    with staged.served() as (_, url):
        yield screens.open(url)
    screens.close()


def test_the_smallest_turn_is_scipys(page: Page) -> None:
    given = pairs()
    for (up, to), turn in zip(given, page.evaluate(TURNS, [[up.tolist(), to.tolist()] for up, to in given]), strict=True):
        rotated = Rotation.from_rotvec(turn["angle"] * np.array(turn["axis"]))
        assert np.linalg.norm(turn["axis"]) == pytest.approx(1, abs=1e-12)
        assert np.dot(turn["axis"], up) == pytest.approx(0, abs=1e-8)
        # Within what a direction has of digits: beside the opposite one the axis is all that is left of them.
        assert rotated.apply(up) == pytest.approx(to, abs=2e-9)
        assert turn["turned"] == pytest.approx(to, abs=2e-9)
        assert turn["matrix"] == pytest.approx(rotated.as_matrix(), abs=1e-12)
        assert turn["twice"] == pytest.approx(rotated.as_matrix(), abs=1e-12)
        # The angle is the guide's own.
        assert np.degrees(turn["angle"]) == pytest.approx(angle_deg(up, to), abs=1e-6)


def test_rounding_of_many_frames_is_taken_out(page: Page) -> None:
    rotations = Rotation.random(50, rng=np.random.default_rng(5)).as_matrix()
    rounded = rotations + np.random.default_rng(6).normal(0, 1e-6, rotations.shape)
    for wanted, found in zip(rotations, np.array(page.evaluate(SQUARED, rounded.tolist())), strict=True):
        assert found @ found.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(found) == pytest.approx(1, abs=1e-12)
        assert found == pytest.approx(wanted, abs=1e-5)


def test_the_globe_is_seen_from_one_side(page: Page) -> None:
    given = directions(PAIRS, 7)
    onlooker = Rotation.from_euler("zx", [0.6, 0.4])
    assert page.evaluate(SEEN, given.tolist()) == pytest.approx(onlooker.apply(given), abs=1e-12)


def test_the_box_has_up_where_the_samples_have_it(page: Page) -> None:
    given = [[up.tolist(), goal.tolist()] for up, goal in pairs()]
    before = np.eye(3)
    for (up, _), found in zip(given, page.evaluate(BOXES, given), strict=True):
        assert found["up"] == pytest.approx([0, 0, 1], abs=1e-8)
        assert found["goal"] == pytest.approx([0, 0, 1], abs=1e-8)
        # By the shortest way: heading is kept.
        turned_deg = np.degrees(Rotation.from_matrix(np.array(found["attitude"]) @ before.T).magnitude())
        assert turned_deg == pytest.approx(angle_deg(before @ up, np.array([0.0, 0.0, 1.0])), abs=1e-5)
        before = np.array(found["attitude"])
