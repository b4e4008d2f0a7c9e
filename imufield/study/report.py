"""The report of a study: the paper's figure and ours side by side, why they differ, tables for CSV, and a plot.

The words of all reports are in ``texts.toml``; a study gives the figures.
"""

from __future__ import annotations

import csv
import importlib
import io
import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from imufield.deliver.parameters.numbers import WIDTH, hanging
from imufield.errors import Reason, UsageError
from imufield.files import typed_write_errors, write_atomically
from imufield.samples import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GAP = "  "  # Between the columns of a terminal.
Draw = Callable[["Figure"], None]
"""Draws into a matplotlib figure."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One figure of the paper beside ours, as text."""

    what: str
    paper: str
    ours: str


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A table of numbers or words for a CSV file."""

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyReport:
    """The outcome of one study."""

    name: str
    """As typed: "bsas-table3"."""
    title: str
    setting: str
    """What was simulated, and with which settings; a simulation in place of hardware is named as one."""
    comparisons: tuple[Comparison, ...]
    differences: tuple[str, ...]
    """Sentences: where and why ours differ."""
    tables: tuple[CsvTable, ...] = ()
    draw: Draw | None = field(default=None, compare=False)
    columns: tuple[str, str, str] = ("", "paper", "ours")


@cache
def _texts() -> dict[str, dict[str, object]]:
    return tomllib.loads((files("imufield.study") / "texts.toml").read_text(encoding="utf-8"))


def make_report(
    name: str,
    comparisons: Iterable[Comparison],
    *,
    tables: tuple[CsvTable, ...] = (),
    draw: Draw | None = None,
    columns: tuple[str, str, str] = ("", "paper", "ours"),
    **values: object,
) -> StudyReport:
    """Return the report of a study: its words of ``texts.toml``, with ``values`` filled in."""

    def fill(text: object) -> str:
        # Line breaks of the file mean nothing.
        return " ".join(str(text).format(**values).split())

    text = _texts()[name]
    differences = text["differences"]
    return StudyReport(
        name=name,
        title=fill(text["title"]),
        setting=fill(text["setting"]),
        comparisons=tuple(comparisons),
        differences=tuple(map(fill, differences)) if isinstance(differences, list) else (),
        tables=tables,
        draw=draw,
        columns=columns,
    )


def numbered_table(name: str, columns: tuple[str, ...], rows: Iterable[Iterable[object]]) -> CsvTable:
    """Return a table whose rows are numbered from 1 in its first column."""
    return CsvTable(name, columns, tuple((number, *row) for number, row in enumerate(rows, 1)))


def curves_table(name: str, label: str, curves: dict[str, FloatArray]) -> CsvTable:
    """Return curves of any length side by side, one column each."""
    # Runs end at different lengths; what a curve lacks stays empty.
    length = max(len(curve) for curve in curves.values())
    rows = tuple((i + 1, *(f"{curve[i]:.9g}" if i < len(curve) else "" for curve in curves.values())) for i in range(length))
    return CsvTable(name, (label, *curves), rows)


def as_text(report: StudyReport) -> str:
    """Return a report for a terminal."""
    heading = f"{report.name}: {report.title}"
    lines = [heading, "-" * len(heading), hanging("", report.setting), ""]
    cells = [report.columns, *((c.what, c.paper, c.ours) for c in report.comparisons)]
    # A table where it fits into a terminal, else one comparison below the other.
    widths = [max(len(row[k]) for row in cells) for k in range(3)]
    if sum(widths) + 2 * len(_GAP) <= WIDTH:
        lines += [_GAP.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    else:
        width = max(map(len, report.columns[1:]))
        for comparison in report.comparisons:
            lines.append(comparison.what)
            for name, words in zip(report.columns[1:], (comparison.paper, comparison.ours), strict=True):
                lines += [hanging(f"  {name:<{width}}  ", words)] if words else []
    lines += ["", *(hanging("* ", sentence) for sentence in report.differences)]
    return "\n".join(lines) + "\n"


def as_markdown(report: StudyReport) -> str:
    """Return a report as a section of a document."""
    lines = [f"## {report.name}: {report.title}", "", report.setting, ""]
    lines += [_markdown_row(report.columns), "|---|---|---|"]
    lines += [_markdown_row((c.what, c.paper, c.ours)) for c in report.comparisons]
    lines += ["", *(f"* {sentence}" for sentence in report.differences)]
    return "\n".join(lines).rstrip() + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    # A bar within a cell would end it.
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def save(report: StudyReport, folder: Path, *, plot: bool = True) -> tuple[Path, ...]:
    """Write the CSV files and the plot of a report; return their paths.

    Raises
    ------
    UsageError
        If a plot is wanted and matplotlib is not installed.
    """
    with typed_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    written = [folder / f"{report.name}.csv"]
    comparisons = tuple((c.what, c.paper, c.ours) for c in report.comparisons)
    _write_csv(written[0], CsvTable("", report.columns, comparisons))
    for table in report.tables:
        written.append(folder / f"{report.name}-{re.sub(r'[^a-z0-9]+', '-', table.name.lower())}.csv")
        _write_csv(written[-1], table)
    if plot and report.draw is not None:
        written.append(folder / f"{report.name}.png")
        _write_plot(report, written[-1])
    return tuple(written)


def _write_csv(path: Path, table: CsvTable) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(table.rows)
    with typed_write_errors(path):
        write_atomically(path, text.getvalue().encode())


def _write_plot(report: StudyReport, path: Path) -> None:
    try:
        figures = importlib.import_module("matplotlib.figure")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"plots need the package matplotlib, which is not installed ({error}); install imufield[study], or ask for no plot",
            Reason.MISSING_PACKAGE,
            package="matplotlib",
        ) from error
    figure = figures.Figure(figsize=(8, 5), layout="constrained")
    if report.draw is not None:
        report.draw(figure)
    figure.suptitle(f"{report.name}: {report.title}", fontsize=10)
    image = io.BytesIO()
    figure.savefig(image, format="png")
    with typed_write_errors(path):
        write_atomically(path, image.getvalue())
