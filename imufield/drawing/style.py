"""One style of all plots: report, noise, history and studies.

They must be readable on grey paper and by whoever cannot tell colours apart: shape, fill and line style carry the meaning,
colour only helps. In SVG letters stay letters (``svg.fonttype`` none): small files, sharp print, text that can be searched.
"""

from __future__ import annotations

import io
import re
import textwrap
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from imufield.errors import load_package

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

INK = "#111111"
BLUE = "#0b5394"
ORANGE = "#b45f06"
GREY = "#8a8a8a"
"""Dark enough on paper; blue and orange differ in lightness too. Curves take the first three for x, y, z."""
WIDTH_IN = 7.0
_TITLE_LETTERS = 90  # Bold letters of a page's width, in a browser's font too, which may be wider than ours.
FEW_DECADES = 2
"""Up to here there is room for the numbers 1, 2 and 5 of each."""


def figure(height_in: float) -> Figure:
    """Return an empty figure of the page's width, to be drawn in ``plot_style``."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def title(drawn: Figure, text: str) -> None:
    """Write what a picture shows above it; a page has its own headings."""
    drawn.suptitle(textwrap.fill(text, _TITLE_LETTERS), x=0.01, horizontalalignment="left", fontsize=9, fontweight="bold")


def legend_beside(axes: Axes) -> None:
    """Put the legend beside the curves, not over them."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def plain_ticks(*logarithmic: Axis) -> None:
    """Write 0.01 where matplotlib would write a power of ten in a font of its own."""
    from matplotlib.ticker import LogLocator

    for axis in logarithmic:
        low, high = axis.get_view_interval()
        if high < low * 10.0**FEW_DECADES:
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")


def to_svg(drawn: Figure, name: str) -> str:
    """Return a figure as an ``<svg>`` element whose ids are its own."""
    buffer = io.StringIO()
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    # savefig draws everything twice, once for a layout that drawing makes by itself.
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    FigureCanvasSVG(drawn).print_svg(buffer, metadata=nothing)  # type: ignore[no-untyped-call]  # not in its stubs
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Pages hold several drawings, and an id must be unique in the page.
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', "", text, count=1)


def to_png(drawn: Figure) -> bytes:
    """Return a figure as a PNG file, drawn once as in ``to_svg``; called in ``plot_style``."""
    from matplotlib import rcParams
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawn.set_dpi(rcParams["savefig.dpi"])
    buffer = io.BytesIO()
    FigureCanvasAgg(drawn).print_png(buffer)  # type: ignore[no-untyped-call]  # not in its stubs
    return buffer.getvalue()


def plot_style(extra: str = "report") -> AbstractContextManager[None]:
    """Return a context in which figures are drawn and written in the common style; raises as ``load_package``."""
    matplotlib = load_package("matplotlib", "a plot", extra)
    # On top of what is set: without the defaults of matplotlib, which the file would bring along.
    settings = matplotlib.rc_params_from_file(Path(__file__).with_name("plots.mplstyle"), use_default_template=False)
    context: AbstractContextManager[None] = matplotlib.rc_context(settings)
    return context
