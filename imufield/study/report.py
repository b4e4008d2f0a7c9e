"""The report of a study: the paper's figure and ours side by side, why they differ, tables for CSV, and a plot.

The words of all reports are in ``texts.toml``; a study gives the figures.
"""

from __future__ import annotations

import csv
import io
import re
import string
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import tomli
from numpy.typing import ArrayLike

from imufield.dataclass import dataclass, field
from imufield.deliver.parameters.printed_numbers import WIDTH, hanging
from imufield.drawing.style import figure, plot_style, title, to_png
from imufield.files import typed_write_errors, write_atomically
from imufield.samples import FloatArray
from imufield.study import instruments

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GAP = "  "  # Between the columns of a terminal.
Draw = Callable[["Figure"], None]
"""Draws into a matplotlib figure."""


class Comparison(NamedTuple):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What a study computes; ``make_report`` puts it into words."""

    values: Mapping[str, object] = field(default_factory=dict)
    """What the words of ``texts.toml`` name."""
    tables: tuple[CsvTable, ...] = ()
    draw: Draw | None = None


@cache
def texts() -> dict[str, dict[str, Any]]:
    """Return the words of ``texts.toml`` by study, and those of the ``instruments``."""
    return tomli.loads((files("imufield.study") / "texts.toml").read_text(encoding="utf-8"))


def make_report(name: str, findings: Findings) -> StudyReport:
    """Return the report of a study: its words, with what was found filled in."""
    text = texts()[name]
    told = {key: _fill(words, vars(instruments)) for key, words in texts()["instruments"].items()}
    values = {**told, **findings.values}
    comparisons: list[Comparison] = []
    for row in text["comparisons"]:
        if len(row) == 3:
            comparisons.append(Comparison(*(_fill(cell, values) for cell in row)))
            continue
        # Once for each entry of a value: what is compared beside it has the same place in the paper.
        entries = findings.values[row[0]]
        assert isinstance(entries, Mapping)  # noqa: S101  texts.toml and the studies belong together
        papers = text.get("paper", {}).get(row[0], [""] * len(entries))
        for (label, value), paper in zip(entries.items(), papers, strict=True):
            of_entry = {**values, "name": label, "value": value, "paper": paper}
            comparisons.append(Comparison(*(_fill(cell, of_entry) for cell in row[1:])))
    return StudyReport(
        name=name,
        title=_fill(text["title"], values),
        setting=_fill(text["setting"], values),
        comparisons=tuple(comparisons),
        differences=tuple(_notes(text["differences"], values)),
        tables=findings.tables,
        draw=findings.draw,
        columns=tuple(text.get("columns", ("", "paper", "ours"))),
    )


# Figures of an array that a text can name, and the words between them where there are several.
_STATISTICS: dict[str, tuple[str, Callable[[FloatArray], ArrayLike]]] = {
    "mean": ("{}", np.mean),
    "median": ("{}", np.median),
    "sd": ("{}", lambda values: np.std(values, ddof=1)),
    "rms": ("{}", lambda values: np.sqrt(np.mean(values**2))),
    "largest": ("{}", np.max),
    "range": ("{} to {}", lambda values: (np.min(values), np.max(values))),
    "spread": ("{} (5 to 95 %: {} to {})", lambda values: (np.median(values), *np.quantile(values, [0.05, 0.95]))),
}


class _Format(string.Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        name, _, of_number = format_spec.partition(" ")
        if name not in _STATISTICS:
            return format(value, format_spec)
        words, statistic = _STATISTICS[name]
        return words.format(*(format(number, of_number) for number in np.atleast_1d(statistic(value))))


def _fill(text: str, values: Mapping[str, object]) -> str:
    return " ".join(_Format().vformat(text, (), values).split())


def _notes(notes: Iterable[str | list[str]], values: Mapping[str, object]) -> Iterator[str]:
    """Yield the notes that hold: one of two texts stands only where the value that its first text names is true."""
    for note in notes:
        *conditions, words = [note] if isinstance(note, str) else note
        if all(values[condition] for condition in conditions):
            yield _fill(words, values)


def keyed_table(name: str, label: str, rows: Mapping[str, Mapping[str, object]]) -> CsvTable:
    """Return a table whose first column has the keys, the others are named as the values of each row."""
    columns = next(iter(rows.values()))
    return CsvTable(name, (label, *columns), tuple((key, *row.values()) for key, row in rows.items()))


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
    cells = [report.columns, *report.comparisons]
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
    lines += ["", *(hanging("* ", difference) for difference in report.differences)]
    return "\n".join(lines) + "\n"


def as_markdown(report: StudyReport) -> str:
    """Return a report as a section of a document."""
    lines = [f"## {report.name}: {report.title}", "", report.setting, ""]
    lines += [_markdown_row(report.columns), "|---|---|---|"]
    lines += [_markdown_row(comparison) for comparison in report.comparisons]
    lines += ["", *(f"* {difference}" for difference in report.differences)]
    return "\n".join(lines).rstrip() + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    # A bar within a cell would end it.
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def save(report: StudyReport, folder: Path) -> tuple[Path, ...]:
    """Write the CSV files and the plot of a report; return their paths.

    Raises
    ------
    UsageError
        If matplotlib, which draws the plot, is not installed.
    """
    with typed_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    written = [folder / f"{report.name}.csv"]
    _write_csv(written[0], CsvTable("", report.columns, report.comparisons))
    for table in report.tables:
        written.append(folder / f"{report.name}-{re.sub(r'[^a-z0-9]+', '-', table.name.lower())}.csv")
        _write_csv(written[-1], table)
    if report.draw is not None:
        written.append(folder / f"{report.name}.png")
        _write_plot(report, report.draw, written[-1])
    return tuple(written)


def _write_csv(path: Path, table: CsvTable) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(table.rows)
    with typed_write_errors(path):
        write_atomically(path, text.getvalue().encode())


def _write_plot(report: StudyReport, draw: Draw, path: Path) -> None:
    with plot_style("study"):
        drawn = figure(4.6)
        draw(drawn)
        title(drawn, f"{report.name}: {report.title}")
        image = to_png(drawn)
    with typed_write_errors(path):
        write_atomically(path, image)
