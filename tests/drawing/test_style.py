"""One style for the plots of report, noise, history and studies."""

from __future__ import annotations

import re
import sys
from itertools import pairwise

import numpy as np
import pytest

from imufield.drawing.style import figure, legend_beside, plain_ticks, plot_style, title, to_svg
from imufield.errors import Reason, UsageError
from tests.refused import refused

PALETTE = re.compile("#(111111|0b5394|b45f06|009e73|cc79a7|56b4e9|e69f00|8a8a8a|882255|dddddd|ffffff|000000)", re.IGNORECASE)


def test_curves_differ_in_line_as_well_as_in_colour() -> None:
    with plot_style():
        axes = figure(2.0).subplots()
        lines = [axes.plot([0, 1])[0] for _ in range(9)]
    assert len({line.get_color() for line in lines}) == 9
    for line, other in pairwise(lines):
        assert line.get_linestyle() != other.get_linestyle()


def test_a_long_title_goes_on_in_a_second_line() -> None:
    with plot_style():
        drawn = figure(2.0)
        drawn.subplots()
        title(drawn, "nine words of ten letters " * 5)
        text = to_svg(drawn, "drawn")
    lines = re.findall(r">\s*([^<>]*ten letters[^<>]*?)\s*<", text)
    assert [len(line) <= 90 for line in lines] == [True, True]
    assert " ".join(lines) == ("nine words of ten letters " * 5).strip()


def test_only_colours_of_the_palette_are_drawn() -> None:
    with plot_style():
        drawn = figure(2.0)
        axes = drawn.subplots()
        for k in range(3):
            axes.plot([0, 1], [0, k], label=str(k))
        legend_beside(axes)
        title(drawn, "a title")
        text = to_svg(drawn, "drawn")
    assert ">a title<" in text
    assert not [colour for colour in re.findall("#[0-9a-fA-F]{6}", text) if not PALETTE.fullmatch(colour)]


def test_the_style_is_gone_afterwards() -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    with plot_style():
        assert not mpl.rcParams["axes.spines.top"]
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(("high", "wanted"), [(60.0, {"1", "2", "5", "10", "20", "50"}), (1e8, {"1", "10000", "1e+08"})])
def test_numbers_of_a_logarithmic_axis_are_plain_and_neither_few_nor_many(high: float, wanted: set[str]) -> None:
    with plot_style():
        drawn = figure(2.0)
        axes = drawn.subplots()
        axes.loglog([1.0, high], [1.0, high])
        plain_ticks(axes.xaxis, axes.yaxis)
        drawn.draw_without_rendering()
        low, top = axes.get_ylim()
        ticks = [tick for tick in axes.yaxis.get_major_ticks() if low <= tick.get_loc() <= top]
    assert {tick.label1.get_text() for tick in ticks} >= wanted
    assert len(ticks) <= 12
    boxes = sorted((tick.label1.get_window_extent().y0, tick.label1.get_window_extent().y1) for tick in ticks)
    assert np.all(np.diff(np.ravel(boxes)) > 0)


def test_a_package_that_is_missing_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for extra in ("report", "study"):
        with refused(UsageError, Reason.MISSING_PACKAGE, f"pip install '.[{extra}]'", key="errors.missing_package"):
            plot_style(extra)
