"""Simple plots: scales against what their numbers say, and the elements that a picture consists of."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from imufield.drawing.svg import Axes, Picture, Scale


@pytest.mark.parametrize(
    ("scale", "wanted"),
    [
        (Scale(-3.2, 1.2), ["\u22123", "\u22122", "\u22121", "0", "1"]),
        (Scale(0.0, 0.19), ["0.00", "0.05", "0.10", "0.15"]),
        (Scale(0.0, 1e5), ["0", "20000", "40000", "60000", "80000", "100000"]),
        (Scale(0.0, 5e9), ["0", "1e+09", "2e+09", "3e+09", "4e+09", "5e+09"]),
        (Scale(-2e-9, 0.0), ["\u22122e\u221209", "\u22121.5e\u221209", "\u22121e\u221209", "\u22125e\u221210", "0"]),
        (Scale(1.5, 60.0, is_logarithmic=True), ["2", "5", "10", "20", "50"]),
        (Scale(2.2, 4.0, is_logarithmic=True), ["2.5", "3.0", "3.5", "4.0"]),
        (Scale(0.001, 200.0, is_logarithmic=True), ["0.001", "0.01", "0.1", "1", "10", "100"]),
        (Scale(1e-10, 1e10, is_logarithmic=True), ["1e-10", "1e-07", "0.0001", "0.1", "100", "100000", "1e+08"]),
    ],
)
def test_numbers_of_an_axis_are_round_and_few(scale: Scale, wanted: list[str]) -> None:
    ticks = list(scale.ticks(6))
    assert [words for _, words in ticks] == wanted
    for number, words in ticks:
        assert float(words.replace("\u2212", "-")) == pytest.approx(number)
        assert 0 <= scale.share(number) <= 1


def test_a_scale_holds_what_is_known() -> None:
    values = np.array([2.0, np.nan, 10.0])
    shares = Scale.over(values).share(values)
    assert 0 < shares[0] < shares[2] < 1
    assert Scale.over(values, low=0.0).low == 0.0
    logarithmic = Scale.over(values, is_logarithmic=True)
    # Equal factors are equal lengths.
    lengths = np.diff(logarithmic.share(np.array([2.0, 4.0, 8.0])))
    assert lengths[0] == pytest.approx(lengths[1])
    # A single value, and none, are places too.
    for few in (np.array([5.0]), np.array([np.nan])):
        alone = Scale.over(few)
        assert alone.low < alone.high


def elements(picture: Picture, tag: str) -> list[dict[str, str]]:
    return [part.attrib for part in ET.fromstring(picture.svg()).iter(f"{{http://www.w3.org/2000/svg}}{tag}")]  # noqa: S314 - our own


def test_marks_and_lines_stand_where_the_numbers_say() -> None:
    picture = Picture(2.0)
    axes = Axes(picture=picture, x=Scale(0.0, 10.0), y=Scale(0.0, 4.0))
    axes.frame("x", "y")
    labels = {attributes["transform"] for attributes in elements(picture, "text")}
    axes.marks(np.array([0.0, 5.0, 6.0]), np.array([2.0, 4.0, np.nan]), "o", "#111111", is_filled=True)
    left, right = elements(picture, "circle")
    # The number 2 of the vertical axis is as high as the mark there, the number 5 of the other below the second.
    heights = [float(found[1]) for label in labels if (found := re.search(r"translate\(41.00 (.*?)\)", label))]
    assert float(left["cy"]) in heights
    # Half of a page of 504 points, less the margins of 46 and 6.
    assert float(right["cx"]) == pytest.approx(46 + (504 - 46 - 6) / 2)
    assert float(right["cy"]) == pytest.approx(axes.top)
    before = len(elements(picture, "path"))
    axes.curve(np.arange(4.0), np.array([1.0, np.nan, 1.0, 2.0]), color="#111111")
    assert elements(picture, "path")[before]["d"].count("M") == 2


def test_words_cannot_break_out_of_a_picture() -> None:
    picture = Picture(1.0)
    picture.text(1.0, 1.0, '<script>&"')
    assert "<script" not in picture.svg()
    assert "".join(ET.fromstring(picture.svg()).itertext()).strip() == '<script>&"'  # noqa: S314 - our own
