"""The kinds of plot of the studies: what belongs beside the curves is beside them."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.drawing.style import figure, plot_style
from imufield.study import figures
from imufield.study.report import Draw

CURVES = {f"method {k}": np.logspace(0, -k, 50) for k in range(1, 6)}
HOURS = np.linspace(0, 5, 50)
PLOTS = {
    "convergence": figures.convergence({"all": CURVES, "some": CURVES, "few": CURVES}, "cost, m/s²"),
    "over_time": figures.over_time({name: {"old": (HOURS, HOURS), "new": (HOURS, HOURS)} for name in ("a, deg", "b, deg")}),
    "runs": figures.runs(CURVES, "error, µg", log=True),
    "bars": figures.bars([f"parameter {k}" for k in range(12)], {"": np.arange(1.0, 13)}, "RMSE", log=True),
}


@pytest.mark.parametrize("name", PLOTS)
def test_no_legend_covers_a_curve_and_nothing_is_cut(name: str) -> None:
    draw: Draw = PLOTS[name]
    with plot_style():
        drawn = figure(4.6)
        draw(drawn)
        drawn.draw_without_rendering()
        # Measured in the style, too: fonts are looked up when they are used.
        shown = [axes for axes in drawn.axes if axes.axison]
        assert shown
        for axes in shown:
            legend = axes.get_legend()
            assert (legend is None) == (name == "bars")
            assert legend is None or legend.get_window_extent().x0 >= axes.get_window_extent().x1
            assert axes.get_ylabel()
        everything = drawn.get_tightbbox()
        assert everything is not None
        assert everything.x0 >= 0
        assert everything.x1 <= drawn.get_figwidth() + 0.01
