"""``imufield history``: parameters of instruments over time, from a folder of parameter files."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from imufield.calibrate.sessions.changes import LargestChange
from imufield.commands.options.result_commands import HistoryOptions
from imufield.commands.terminal.output import echo, echo_path, say, say_each, write_output
from imufield.deliver.control_chart import plot_history
from imufield.deliver.history import History, InstrumentHistory, as_utc, one_instrument, read_history
from imufield.deliver.history_words import sentences, shown_as, to_csv
from imufield.deliver.judged_history import JudgedHistory, judge_histories
from imufield.deliver.pair_test import Change
from imufield.deliver.parameters.gauge_free import Number, unit_of
from imufield.deliver.parameters.printed_numbers import beside, hanging, shown_on, with_sigma
from imufield.drawing.printed_lines import aligned
from imufield.errors import UsageError
from imufield.files import refuse_overwriting, utf8_text
from imufield.sentences import Sentence, Sentences, counted, folded

sentence = Sentences(__package__)


def run_history(options: HistoryOptions, now: datetime | None = None) -> History:
    """Print the history of every instrument, and write the table and the plot where asked.

    Raises
    ------
    ParameterFileError
        If the folder holds no parameter file, or a file cannot be written.
    UsageError
        If the time is none, or there are several instruments to choose the closest file from.
    """
    now = now or datetime.now(UTC)
    history = read_history(options.folder, options.serial_number, _cores())
    if options.at is not None:
        _print_nearest(history, options)
        return history
    plots = {} if options.plot is None else _plot_paths(history, options.plot)
    for path in filter(None, (options.csv, *plots)):
        refuse_overwriting(
            path, (options.folder / entry.path for instrument in history.instruments for entry in instrument.entries)
        )
    if options.csv is not None:
        write_output(options.csv, utf8_text(to_csv(history)).encode(), as_json=options.as_json)
    judged = dict(zip(history.instruments, judge_histories(history, _cores()), strict=True))
    for path, instrument in plots.items():
        write_output(path, plot_history(judged[instrument]), as_json=options.as_json)
    if options.as_json:
        instruments = [_instrument(each, options, now) for each in judged.values()]
        echo(json.dumps({"folder": str(history.folder), "instruments": instruments, "faults": list(history.faults)}))
    else:
        _print([*judged.values()], options, now)
    say_each(history.faults, err=True, indent=2, begin="left out: ")
    return history


def _cores() -> int:
    return os.cpu_count() or 1


def _plot_paths(history: History, path: Path) -> dict[Path, InstrumentHistory]:
    """Return where each instrument is drawn: several get a file each, with the serial number in its name."""
    if len(history.instruments) == 1:
        return {path: history.instruments[0]}
    found: dict[Path, InstrumentHistory] = {}
    for instrument in history.instruments:
        who = re.sub(r"[^\w.-]+", "_", instrument.serial_number or instrument.title)
        place = path.with_name(f"{path.stem}-{who}{path.suffix}")
        # Two serial numbers may differ in signs alone that no file name can have.
        while place in found:
            place = place.with_name(f"{place.stem}-{len(found)}{place.suffix}")
        found[place] = instrument
    return found


def _print_nearest(history: History, options: HistoryOptions) -> None:
    """Print the path alone, for scripts, and on the other stream how far it is in time."""
    try:
        at = as_utc(datetime.fromisoformat(str(options.at)))
    except ValueError as error:
        raise UsageError(sentence("history.no_date", at=options.at)) from error
    instrument = one_instrument(history)
    entry = instrument.nearest(at)
    echo_path(options.folder / entry.path)
    days = abs((entry.time - at).total_seconds()) / 86400
    old = sentence("history.old", stale_days=options.stale_days) if days > options.stale_days else ""
    # In whole days between the dates, as a person counts them: from evening to morning is a day.
    apart = (entry.time.astimezone(at.tzinfo).date() - at.date()).days
    when = f"{counted(abs(apart), 'day')} {'after' if apart > 0 else 'before'} {options.at}"
    when = when if apart else f"on the day of {options.at}"
    say(f"{instrument.title}, {entry.verdict}, calibrated {when}{old}", err=True, indent=2)


def _print(histories: Sequence[JudgedHistory], options: HistoryOptions, now: datetime) -> None:
    for history in histories:
        entries = history.instrument.entries
        echo(f"{history.instrument.title}: {counted(len(entries), 'calibration')}")
        for entry in entries:
            echo(beside(f"  {entry.created[:10]}  {entry.verdict:<7}", entry.path, indent=4))
        changes = {change.name: change for change in history.changes()}
        # One calibration has nothing to compare, and its numbers are in its file.
        numbers = history.entries[-1].numbers if changes else ()
        if numbers:
            rows = [("parameter", "value ± sigma", "unit", "change")]
            rows += [_cells(number, changes.get(number.name)) for number in numbers]
            for printed in aligned([[(cell, "") for cell in row] for row in rows], "<><>"):
                echo(shown_on(sys.stdout, "".join(words for words, _ in printed).rstrip()))
            echo(hanging("  - ", sentence("history.change")))
        if any(number.name.startswith("angle") for number in numbers):
            echo(hanging("  - ", sentence("history.angles")))
        for line in folded(_said(history, options, now)):
            echo(hanging("  - ", line))
    alone = sum(len(history.instrument.entries) == 1 for history in histories)
    if alone:
        what = "It has" if len(histories) == 1 else f"{counted(alone, 'instrument')} {'has' if alone == 1 else 'have'}"
        echo(hanging("", sentence("history.nothing_to_compare", what=what)))


def _said(history: JudgedHistory, options: HistoryOptions, now: datetime) -> list[Sentence]:
    wanted = {"bias": options.target_bias_ug and options.target_bias_ug / 1000, "scale": options.target_scale_ppm}
    accuracies = {kind: accuracy for kind, accuracy in wanted.items() if accuracy is not None}
    return list(sentences(history, now, options.stale_days, accuracies))


def _cells(number: Number, change: Change | None) -> tuple[str, str, str, str]:
    # Adding zero takes the sign off a change that rounds to nothing.
    moved = "" if change is None or math.isnan(change.in_sigma) else f"{round(change.in_sigma, 1) + 0.0:+.1f} sigma"
    name, unit, size = shown_as(number.name, number.unit)
    value = number.value if unit == number.unit else number.value - 1
    return name, with_sigma(value / size, number.sigma / size, sign=True), unit, moved


def _instrument(history: JudgedHistory, options: HistoryOptions, now: datetime) -> dict[str, object]:
    instrument = history.instrument
    return {
        "instrument": instrument.instrument,
        "serial_number": instrument.serial_number,
        "age_days": instrument.age_days(now),
        "stale": instrument.age_days(now) > options.stale_days,
        "sentences": _said(history, options, now),
        "repeatability": {
            kind: {"sigma": found.sigma, "low": found.low, "high": found.high, "unit": unit_of(f"{kind} x")}
            for kind, found in history.repeatability.items()
        },
        "news": [
            {"parameter": change.name, "since": _first_after(history, change), "in_sigma": change.in_sigma}
            for change in history.judged.news
        ],
        "calibrations": [
            {
                "created": entry.created,
                "verdict": entry.verdict,
                "file": entry.path,
                "edited": entry.edited,
                "parameters": {
                    number.name: {"value": number.value, "sigma": number.sigma, "unit": number.unit} for number in entry.numbers
                },
            }
            for entry in instrument.entries
        ],
    }


def _first_after(history: JudgedHistory, change: LargestChange) -> str | None:
    """Return when the first calibration after a step was; None of a drift."""
    return None if change.first_after is None else history.entries[change.first_after].created
