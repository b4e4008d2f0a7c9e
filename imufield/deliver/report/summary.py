"""A calibration for a person at a terminal: parameters with uncertainty, residual by position, verdict, what to do next.

The verdict comes last, because the end is what a terminal of 24 lines shows.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from imufield.calibrate.model.coverage_factors import degrees_of_freedom
from imufield.calibrate.model.result import Calibration, Quality
from imufield.console import PlainTextConsole
from imufield.dataclass import dataclass
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import (
    ARC_MINUTE_RAD,
    WIDTH,
    acceleration_unit,
    bar,
    to_ascii,
    with_sigma,
    with_sigma_within,
)
from imufield.deliver.report.gain import gain
from imufield.deliver.report.rows import GAUGE_WORDS, VERDICT_WORDS, Quantity, quantities
from imufield.earth import MICRO_G_M_S2, height_words
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentence, Sentences, folded, printable, shell_word, three_digits

if TYPE_CHECKING:
    from imufield.acquire.recording.session import Session

sentence = Sentences(__package__)

_VERDICT_STYLES = {"good": "bold green", "usable": "bold yellow", "poor": "bold red"}
# Three columns of each fit 80 characters.
_BAR_WIDTH = 9
_NUMBER_WIDTH = 18


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a summary says beside the parameters: where they went."""

    path: Path | None = None
    """The file written."""
    kept: Path | None = None
    """Where the file that stood there before is kept."""
    session: Session | None = None
    """The session they come from."""
    quality: Quality | None = None
    """Of that session alone, where others were joined to it."""


def print_summary(parameters: Parameters, outcome: Outcome | None = None, console: Console | None = None) -> None:
    """Print the summary; without a terminal as plain text of 80 columns, without Unicode in ASCII."""
    console = console or PlainTextConsole()
    if console.is_terminal and not console.options.ascii_only:
        # Not cropped: a path longer than the line is still to be copied.
        console.print(summary(parameters, outcome, console.width), crop=False)
        return
    text = summary_text(parameters, outcome)
    console.out(to_ascii(text) if console.options.ascii_only else text, end="", highlight=False)


def summary_text(parameters: Parameters, outcome: Outcome | None = None) -> str:
    """Return the summary as plain text of 80 columns."""
    console = PlainTextConsole(width=WIDTH, file=io.StringIO())
    with console.capture() as capture:
        console.print(summary(parameters, outcome), crop=False)
    # rich fills columns with blanks; in a file or a mail they are only noise.
    return "".join(f"{line.rstrip()}\n" for line in capture.get().splitlines())


def summary(parameters: Parameters, outcome: Outcome | None = None, width: int = WIDTH) -> RenderableType:
    """Return the summary as something rich can draw in that width; below 80 columns each axis has a line of its own."""
    calibration = parameters.calibration
    parts: list[RenderableType] = [_heading(parameters), "", _table("Accelerometer", calibration, width)]
    if calibration.gyroscope is not None:
        parts += ["", _table("Gyroscope", calibration, width), Text(calibration.gyroscope.path, style="dim")]
    parts += ["", _facts(calibration), "", *_residuals(parameters, width)]
    # It may be far more than the sigma of scale above: beside the verdict.
    if details := [reason for reason in calibration.quality.details if reason != parameters.clock_note]:
        parts += ["", Text("Details", style="bold"), *_bullets(details)]
    parts += ["", _verdict(parameters)]
    parts += _next_steps(parameters, outcome or Outcome())
    return Group(*parts)


def _heading(parameters: Parameters) -> RenderableType:
    instrument, session = parameters.context.instrument, parameters.context.session
    who = " ".join(word for word in (instrument.model or instrument.driver or "IMU", instrument.serial_number) if word)
    low, high = session.temperature_degc
    facts = [f"{parameters.calibration.positions.count} positions"]
    if math.isfinite(low) and math.isfinite(high):
        facts.append(f"{low:.0f} °C" if round(low) == round(high) else f"{low:.0f} to {high:.0f} °C")
    facts.append(parameters.context.measured.replace("T", " ").replace("Z", " UTC"))
    return Group(Text(f"Calibration of {who}", style="bold"), Text(" · ".join(facts), style="dim"))


class _TriadTable:
    """Rows of three numbers, each in a line or, in a narrow window, in a line for each axis."""

    def __init__(self, title: str, width: int) -> None:
        self._is_narrow = width < WIDTH
        self.table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
        self.table.add_column(Text(title, style="bold"), no_wrap=True, min_width=13)
        self.table.add_column("", no_wrap=True, style="dim", min_width=6)
        if self._is_narrow:
            self.table.add_column("", no_wrap=True, style="bold")
        for axis in AXES[:1] if self._is_narrow else AXES:
            name = "" if self._is_narrow else axis
            self.table.add_column(name, justify="right", no_wrap=True, min_width=_NUMBER_WIDTH, header_style="bold")

    def add(self, name: str, unit: str, cells: Sequence[str], *, places: Sequence[str] = AXES, style: str = "") -> None:
        """Add a row; ``places`` are what lines of a narrow window call the cells."""
        if not self._is_narrow:
            self.table.add_row(name, unit, *cells, style=style)
            return
        for place, cell in zip(places, cells, strict=False):
            self.table.add_row(name, unit, place, cell, style=style)
            name = unit = ""

    def add_numbers(self, name: str, unit: str, values: FloatArray, sigma: FloatArray, *, sign: bool = True) -> None:
        """Add a row of numbers with their uncertainty."""
        numbers = zip(values.tolist(), sigma.tolist(), strict=True)
        self.add(name, unit, [with_sigma_within(_NUMBER_WIDTH, value, spread, sign=sign) for value, spread in numbers])


def _table(title: str, calibration: Calibration, width: int) -> Table:
    """Return the table of one triad."""
    table = _TriadTable(title, width)
    for quantity in quantities(calibration):
        value, sigma = quantity.value, quantity.sigma
        if quantity.triad != title:
            continue
        if quantity.name == "misalignment":
            _add_misalignment(table, quantity)
        elif quantity.name == "g-sensitivity":
            # A row for each axis of the specific force: what the gyroscopes x, y, z show of it.
            for j, axis in enumerate(AXES):
                table.add_numbers(f"g-sens. of a{axis}", quantity.unit, value.reshape(3, 3)[:, j], sigma.reshape(3, 3)[:, j])
        elif quantity.name == "scale":
            table.add_numbers(quantity.unit, "", value, sigma, sign=False)
        else:
            table.add_numbers(quantity.name, quantity.unit, value, sigma)
        if quantity.name == "bias" and title == "Accelerometer":
            table.add_numbers("", "m/s²", calibration.accelerometer.bias_m_s2, calibration.accelerometer_sigma.bias_m_s2)
    return table.table


def _add_misalignment(table: _TriadTable, quantity: Quantity) -> None:
    every = list(zip(quantity.places, quantity.value.tolist(), quantity.sigma.tolist(), strict=True))
    shown = [(pair, value, sigma) for pair, value, sigma in every if value != 0 or sigma != 0]
    if not any(math.isfinite(sigma) and value for _, value, sigma in shown):
        table.add("misalignment", "", ["not estimated"] * 3)
        return
    for start in range(0, len(shown), 3):
        part = shown[start : start + 3]
        pairs = [pair for pair, *_ in part]
        cells = [f"{pair} {with_sigma(value, sigma, sign=True)}" for pair, value, sigma in part]
        table.add("misalignment" if start == 0 else "", "mrad", cells, places=[""] * 3)
        minutes = [f"{value * 1e-3 / ARC_MINUTE_RAD:+.1f}" if math.isfinite(sigma) else "" for _, value, sigma in part]
        table.add("", "arcmin", minutes, places=pairs, style="dim")


def _facts(calibration: Calibration) -> Table:
    quality, gravity = calibration.quality, calibration.gravity
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    source: str = gravity.source_words
    if gravity.source == "assumed":
        source = sentence("summary.assumed")
    elif gravity.source == "normal" and gravity.latitude_deg is not None:
        source = sentence("summary.normal", latitude_deg=gravity.latitude_deg, height=height_words(gravity))
    table.add_row("Gravity", f"{with_sigma(gravity.gravity_m_s2, gravity.sigma_m_s2)} m/s², {source}")
    table.add_row("Frame", f"{GAUGE_WORDS[calibration.gauge]} (gauge {calibration.gauge})")
    table.add_row("Sigma", sigma_words(quality))
    return table


def sigma_words(quality: Quality) -> Sentence:
    """Say what ± is, and what makes a 95 % limit of it: what is known beforehand adds to the degrees of freedom."""
    factor = quality.student_factor_95
    if not math.isfinite(factor):
        return sentence("summary.sigma_of_holds")
    freedom = degrees_of_freedom(factor)
    return sentence("summary.sigma" if math.isfinite(freedom) else "summary.sigma_normal", factor=factor, freedom=freedom)


def _residuals(parameters: Parameters, width: int) -> Iterator[RenderableType]:
    tables = parameters.document["position"]
    residual = np.array([table["residual_m_s2"] for table in tables], dtype=np.float64)
    used = np.array([table["used"] for table in tables], dtype=np.bool_)
    largest = float(np.nanmax(np.abs(residual), initial=0.0))
    quality = parameters.calibration.quality
    unit, size = acceleration_unit(largest)
    title = Text("Residual by position", style="bold")
    if quality.degrees_of_freedom < 1:
        # Zeros would look like a perfect fit.
        yield title.append(f": {sentence('summary.no_residual')}", style="not bold")
        return
    figures = f", {unit}: RMS {three_digits(quality.residual_rms_m_s2 / size)}, largest {three_digits(largest / size)}"
    if math.isfinite(quality.leave_one_out_rms_m_s2):
        figures += f", leave-one-out RMS {three_digits(quality.leave_one_out_rms_m_s2 / size)}"
    title.append(figures, style="not bold")
    yield title
    # Residuals of nothing but rounding have no worst.
    worst = int(np.nanargmax(np.abs(residual))) if largest > 1e-3 * MICRO_G_M_S2 else -1
    cells = []
    for k, (table, value, is_used) in enumerate(zip(tables, (residual / size).tolist(), used.tolist(), strict=True)):
        if not is_used or not math.isfinite(value):
            cells.append((table["name"], Text("not used", style="dim"), Text("")))
            continue
        style = "bold yellow" if k == worst else ""
        bar_of = Text(bar(abs(value) / (largest / size) if worst >= 0 else 0, _BAR_WIDTH), style=style or "cyan")
        number = f"{value:+.0f}" if worst >= 0 and largest / size >= 10 else f"{value:+.2f}"
        cells.append((table["name"], bar_of, Text(number + (" ◄" if k == worst else "  "), style=style)))
    yield _in_columns(cells, max(len(table["name"]) for table in tables), width)


def _in_columns(cells: list[tuple[str, Text, Text]], name_width: int, width: int) -> Table:
    # Name, bar, number and their gaps; three columns at most, so that 24 positions take eight lines.
    columns = max(1, min(3, width // (name_width + _BAR_WIDTH + 10)))
    rows = -(-len(cells) // columns)
    table = Table.grid(padding=(0, 1, 0, 0))
    for _ in range(columns):
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(justify="right", no_wrap=True, min_width=8)
    for row in range(rows):
        # Down the first column, then the second: the order in which they were taken.
        table.add_row(*(part for cell in cells[row::rows] for part in cell))
    return table


def _verdict(parameters: Parameters) -> RenderableType:
    quality, gained = parameters.calibration.quality, gain(parameters)
    line = Text() if gained is None else Text(f"{gained.words}\n", style="bold")
    line.append("Verdict: ", style="bold")
    line.append(quality.verdict.upper(), style=_VERDICT_STYLES[quality.verdict])
    line.append(f", {VERDICT_WORDS[quality.verdict]}", style="not bold")
    if parameters.edited:
        line.append(f" {sentence('summary.edited')}", style="bold yellow")
    if parameters.is_converted:
        line.append(f" {sentence('summary.converted', version=parameters.version)}", style="bold yellow")
    if quality.gyroscope_verdict:
        words = {"accelerometer": quality.accelerometer_verdict, "gyroscope": quality.gyroscope_verdict}
        line.append(f" ({', '.join(f'{triad} {_loud(verdict)}' for triad, verdict in words.items())})", style="not bold")
    return Group(line, *_bullets(filter(None, (*quality.warnings, parameters.clock_note, *quality.reasons[:1]))))


def _loud(verdict: str) -> str:
    return verdict.upper() if verdict in VERDICT_WORDS else verdict


def _bullets(texts: Iterable[str]) -> Iterator[RenderableType]:
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column()
    for text in folded(texts):
        table.add_row(" ·", Text(text))
    if table.row_count:
        yield table


def _next_steps(parameters: Parameters, outcome: Outcome) -> Iterator[RenderableType]:
    calibration = parameters.calibration
    if calibration.gravity.source == "assumed":
        again = "imufield solve" if outcome.session is None else f"imufield solve {shell_word(outcome.session.folder)}"
        yield from _bullets([sentence("summary.tell_place")])
        yield _unbroken(f"   {again} --latitude DEGREES --height METRES")
    yield from _remedy(outcome.quality or calibration.quality, outcome.session)
    if outcome.path is not None:
        yield Text("")
        yield Text("Written to", style="bold")
        yield _unbroken(str(outcome.path))
        if outcome.kept is not None:
            yield from _bullets([sentence("summary.kept", name=outcome.kept.name)])
        if calibration.quality.verdict != "poor":
            units = [calibration.accelerometer_raw_unit, *([calibration.gyroscope.raw_unit] if calibration.gyroscope else [])]
            yield from _bullets([sentence("summary.use", units=units)])


def _remedy(quality: Quality, session: Session | None) -> Iterator[RenderableType]:
    """Yield what to do about positions that disagree or are too few, and the command that this session takes for it."""
    is_poor = (quality.accelerometer_verdict or quality.verdict) == "poor"
    guided = session if session is not None and session.record.kind == "capture" else None
    folder = "" if session is None else shell_word(session.folder)
    if guided is not None and not guided.finished and is_poor:
        key, command = "summary.go_on", f"imufield capture --resume --session {folder}"
    elif quality.degrees_of_freedom < 1:
        key, command = "summary.take_24", "imufield capture"
    elif not is_poor:
        return
    elif guided is not None:
        key, command = "summary.take_again", f"imufield capture --resume --session {folder} --retake NAME"
    else:
        key, command = "summary.leave_out", f"imufield solve {folder or '--observations FILE'} --without NAME"
    yield from _bullets([sentence(key)])
    yield _unbroken(f"   {command}")


def _unbroken(text: str) -> Text:
    """Return a path or a command on a line of its own: in two pieces it cannot be copied."""
    return Text(printable(text), overflow="ignore", no_wrap=True)
