"""A calibration for a person at a terminal: parameters with uncertainty, residual by position, verdict, what to do next.

The verdict comes last, because the end is what a terminal of 24 lines shows.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np

from imufield.calibrate.model.coverage_factors import degrees_of_freedom
from imufield.calibrate.model.result import Calibration, Quality
from imufield.dataclass import dataclass
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import (
    ARC_MINUTE_RAD,
    WIDTH,
    acceleration_unit,
    bar,
    knows_unicode,
    shown_on,
    with_sigma,
    with_sigma_within,
)
from imufield.deliver.report.gain import gain
from imufield.deliver.report.rows import GAUGE_WORDS, VERDICT_WORDS, Quantity, quantities
from imufield.drawing.printed_lines import Line, aligned, columns, wrapped
from imufield.earth import MICRO_G_M_S2, height_words
from imufield.progress import hidden
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


def print_summary(parameters: Parameters, outcome: Outcome | None = None, file: TextIO | None = None) -> None:
    """Print the summary: in colour and as wide as the window on a terminal with Unicode, else as plain text of 80 columns.

    Where Unicode is not known, in ASCII.
    """
    stream: TextIO = sys.stdout if file is None else file
    if stream.isatty() and knows_unicode(stream):
        # Late: only a terminal needs rich, and importing it takes a twentieth of a short ``solve``.
        from rich.text import Text

        from imufield.console import PlainTextConsole

        console = PlainTextConsole(file=stream)
        lines = [Text.assemble(*line) for line in summary(parameters, outcome, console.width)]
        for line in lines:
            line.rstrip()
        # Not cropped: a path longer than the line is still to be copied.
        console.print(Text("\n").join(lines), no_wrap=True, overflow="ignore", crop=False)
        return
    text = summary_text(parameters, outcome)
    with hidden():
        stream.write(shown_on(stream, text))
        stream.flush()


def summary_text(parameters: Parameters, outcome: Outcome | None = None) -> str:
    """Return the summary as plain text of 80 columns."""
    lines = ("".join(words for words, _ in line) for line in summary(parameters, outcome))
    return "".join(f"{line.rstrip()}\n" for line in lines)


def summary(parameters: Parameters, outcome: Outcome | None = None, width: int = WIDTH) -> list[Line]:
    """Return the lines of the summary in that width; below 80 columns each axis has a line of its own."""
    calibration = parameters.calibration
    lines = [*_heading(parameters, width), [], *_triad("Accelerometer", calibration, width)]
    if calibration.gyroscope is not None:
        lines += [[], *_triad("Gyroscope", calibration, width), *wrapped([(calibration.gyroscope.path, "dim")], width)]
    lines += [[], *_facts(calibration, width), [], *_residuals(parameters, width)]
    # It may be far more than the sigma of scale above: beside the verdict.
    if details := [reason for reason in calibration.quality.details if reason != parameters.clock_note]:
        lines += [[], [("Details", "bold")], *_bullets(details, width)]
    return [*lines, [], *_verdict(parameters, width), *_next_steps(parameters, outcome or Outcome(), width)]


def _heading(parameters: Parameters, width: int) -> Iterator[Line]:
    instrument, session = parameters.context.instrument, parameters.context.session
    who = " ".join(word for word in (instrument.model or instrument.driver or "IMU", instrument.serial_number) if word)
    low, high = session.temperature_degc
    facts = [f"{parameters.calibration.positions.count} positions"]
    if math.isfinite(low) and math.isfinite(high):
        facts.append(f"{low:.0f} °C" if round(low) == round(high) else f"{low:.0f} to {high:.0f} °C")
    facts.append(parameters.context.measured.replace("T", " ").replace("Z", " UTC"))
    yield from wrapped([(f"Calibration of {who}", "bold")], width)
    yield from wrapped([(" · ".join(facts), "dim")], width)


class _TriadRows:
    """Rows of three numbers, each in a line or, in a narrow window, in a line for each axis."""

    def __init__(self, title: str, width: int) -> None:
        self._is_narrow = width < WIDTH
        axes = ["", ""] if self._is_narrow else AXES
        self._rows: list[Line] = [[(title, "bold"), ("", ""), *((axis, "bold") for axis in axes)]]

    def add(self, name: str, unit: str, cells: Sequence[str], *, places: Sequence[str] = AXES, style: str = "") -> None:
        """Add a row; ``places`` are what lines of a narrow window call the cells."""
        if not self._is_narrow:
            self._rows.append([(name, style), (unit, "dim"), *((cell, style) for cell in cells)])
            return
        for place, cell in zip(places, cells, strict=False):
            self._rows.append([(name, style), (unit, "dim"), (place, "bold"), (cell, style)])
            name = unit = ""

    def add_numbers(self, name: str, unit: str, values: FloatArray, sigma: FloatArray, *, sign: bool = True) -> None:
        """Add a row of numbers with their uncertainty."""
        numbers = zip(values.tolist(), sigma.tolist(), strict=True)
        self.add(name, unit, [with_sigma_within(_NUMBER_WIDTH, value, spread, sign=sign) for value, spread in numbers])

    def lines(self) -> Iterator[Line]:
        """Yield them below each other."""
        cells = [0, 0] if self._is_narrow else [_NUMBER_WIDTH] * 3
        return aligned(self._rows, "<<<>" if self._is_narrow else "<<>>>", [13, 6, *cells])


def _triad(title: str, calibration: Calibration, width: int) -> Iterator[Line]:
    """Return the lines of the table of one triad."""
    table = _TriadRows(title, width)
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
    return table.lines()


def _add_misalignment(table: _TriadRows, quantity: Quantity) -> None:
    every = list(zip(quantity.places, quantity.value.tolist(), quantity.sigma.tolist(), strict=True))
    shown = [(pair, value, sigma) for pair, value, sigma in every if value != 0 or sigma != 0]
    if not any(math.isfinite(sigma) and value for _, value, sigma in shown):
        table.add("misalignment", "", ["not estimated"] * 3)
        return
    for start in range(0, len(shown), 3):
        part = shown[start : start + 3]
        pairs = [pair for pair, *_ in part]
        room = _NUMBER_WIDTH - 3  # Beside "yx ".
        cells = [f"{pair} {with_sigma_within(room, value, sigma, sign=True)}" for pair, value, sigma in part]
        table.add("misalignment" if start == 0 else "", "mrad", cells, places=[""] * 3)
        minutes = [f"{value * 1e-3 / ARC_MINUTE_RAD:+.1f}" if math.isfinite(sigma) else "" for _, value, sigma in part]
        table.add("", "arcmin", minutes, places=pairs, style="dim")


def _facts(calibration: Calibration, width: int) -> Iterator[Line]:
    quality, gravity = calibration.quality, calibration.gravity
    source: str = gravity.source_words
    if gravity.source == "assumed":
        source = sentence("summary.assumed")
    elif gravity.source == "normal" and gravity.latitude_deg is not None:
        source = sentence("summary.normal", latitude_deg=gravity.latitude_deg, height=height_words(gravity))
    facts = {
        "Gravity": f"{with_sigma(gravity.gravity_m_s2, gravity.sigma_m_s2)} m/s², {source}",
        "Frame": f"{GAUGE_WORDS[calibration.gauge]} (gauge {calibration.gauge})",
        "Sigma": sigma_words(quality),
    }
    for name, words in facts.items():
        yield from wrapped([(f"{name:8}", "bold"), (words, "")], width, indent=9)


def sigma_words(quality: Quality) -> Sentence:
    """Say what ± is, and what makes a 95 % limit of it: what is known beforehand adds to the degrees of freedom."""
    factor = quality.student_factor_95
    if not math.isfinite(factor):
        return sentence("summary.sigma_of_holds")
    freedom = degrees_of_freedom(factor)
    return sentence("summary.sigma" if math.isfinite(freedom) else "summary.sigma_normal", factor=factor, freedom=freedom)


def _residuals(parameters: Parameters, width: int) -> Iterator[Line]:
    tables = parameters.document["position"]
    residual = np.array([table["residual_m_s2"] for table in tables], dtype=np.float64)
    used = np.array([table["used"] for table in tables], dtype=np.bool_)
    largest = float(np.nanmax(np.abs(residual), initial=0.0))
    quality = parameters.calibration.quality
    unit, size = acceleration_unit(largest)
    if quality.degrees_of_freedom < 1:
        # Zeros would look like a perfect fit.
        yield from wrapped([("Residual by position:", "bold"), (sentence("summary.no_residual"), "")], width)
        return
    figures = f"{unit}: RMS {three_digits(quality.residual_rms_m_s2 / size)}, largest {three_digits(largest / size)}"
    if math.isfinite(quality.leave_one_out_rms_m_s2):
        figures += f", leave-one-out RMS {three_digits(quality.leave_one_out_rms_m_s2 / size)}"
    yield from wrapped([("Residual by position,", "bold"), (figures, "")], width)
    # Residuals of nothing but rounding have no worst.
    worst = int(np.nanargmax(np.abs(residual))) if largest > 1e-3 * MICRO_G_M_S2 else -1
    cells = []
    for k, (table, value, is_used) in enumerate(zip(tables, (residual / size).tolist(), used.tolist(), strict=True)):
        if not is_used or not math.isfinite(value):
            cells.append([(table["name"], ""), ("not used", "dim"), ("", "")])
            continue
        style = "bold yellow" if k == worst else ""
        bar_of = bar(abs(value) / (largest / size) if worst >= 0 else 0, _BAR_WIDTH)
        number = f"{value:+.0f}" if worst >= 0 and largest / size >= 10 else f"{value:+.2f}"
        cells.append([(table["name"], ""), (bar_of, style or "cyan"), (number + (" ◄" if k == worst else "  "), style)])
    yield from _in_columns(cells, width)


def _in_columns(cells: list[Line], width: int) -> Iterator[Line]:
    # Name, bar, number and their gaps; three columns at most, so that 24 positions take eight lines.
    # A longer name would part all the others from their numbers.
    most = width - _BAR_WIDTH - 10
    cells = [[(_shortened(printable(name), most), style), *others] for (name, style), *others in cells]
    name_width = max(columns(name) for (name, _), *_ in cells)
    beside = max(1, min(3, width // (name_width + _BAR_WIDTH + 10)))
    rows = -(-len(cells) // beside)
    # Down the first column, then the second: the order in which they were taken.
    lines = [[part for cell in cells[row::rows] for part in cell] for row in range(rows)]
    return aligned(lines, "<<>" * beside, [name_width, _BAR_WIDTH, 8] * beside)


def _shortened(name: str, most: int) -> str:
    """Return a name, or its end where it is too long: there numbers stand."""
    shown = name
    while name and columns(shown) > most:
        name = name[1:]
        shown = f"…{name}"
    return shown


def _verdict(parameters: Parameters, width: int) -> Iterator[Line]:
    quality, gained = parameters.calibration.quality, gain(parameters)
    if gained is not None:
        yield from wrapped([(gained.words, "bold")], width)
    line = [("Verdict:", "bold"), (f"{quality.verdict.upper()},", _VERDICT_STYLES[quality.verdict])]
    line.append((VERDICT_WORDS[quality.verdict], ""))
    if parameters.edited:
        line.append((sentence("summary.edited"), "bold yellow"))
    if parameters.is_converted:
        line.append((sentence("summary.converted", version=parameters.version), "bold yellow"))
    if quality.gyroscope_verdict:
        words = {"accelerometer": quality.accelerometer_verdict, "gyroscope": quality.gyroscope_verdict}
        line.append((f"({', '.join(f'{triad} {_loud(verdict)}' for triad, verdict in words.items())})", ""))
    yield from wrapped(line, width)
    yield from _bullets(filter(None, (*quality.warnings, parameters.clock_note, *quality.reasons[:1])), width)


def _loud(verdict: str) -> str:
    return verdict.upper() if verdict in VERDICT_WORDS else verdict


def _bullets(texts: Iterable[str], width: int) -> Iterator[Line]:
    for text in folded(texts):
        yield from wrapped([(" ·", ""), (text, "")], width, indent=3)


def _next_steps(parameters: Parameters, outcome: Outcome, width: int) -> Iterator[Line]:
    calibration = parameters.calibration
    if calibration.gravity.source == "assumed":
        again = "imufield solve" if outcome.session is None else f"imufield solve {shell_word(outcome.session.folder)}"
        yield from _bullets([sentence("summary.tell_place")], width)
        yield _unbroken(f"   {again} --latitude DEGREES --height METRES")
    yield from _remedy(outcome.quality or calibration.quality, outcome.session, width)
    if outcome.path is not None:
        yield from ([], [("Written to", "bold")])
        yield _unbroken(str(outcome.path))
        if outcome.kept is not None:
            yield from _bullets([sentence("summary.kept", name=outcome.kept.name)], width)
        if calibration.quality.verdict != "poor":
            units = [calibration.accelerometer_raw_unit, *([calibration.gyroscope.raw_unit] if calibration.gyroscope else [])]
            yield from _bullets([sentence("summary.use", units=units)], width)


def _remedy(quality: Quality, session: Session | None, width: int) -> Iterator[Line]:
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
    yield from _bullets([sentence(key)], width)
    yield _unbroken(f"   {command}")


def _unbroken(text: str) -> Line:
    """Return a path or a command on a line of its own: in two pieces it cannot be copied."""
    return [(printable(text), "")]
