"""Find what the columns of a table mean, and their units: by their header, by what the user gives, or by number and values.

Every assumption that the header does not state is returned as a sentence.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from imufield.acquire.formats.table_names import (
    SAMPLE_TIME_FINE,
    TEMPERATURE,
    TIME,
    TableColumn,
    columns_that_repeat,
    named_column,
    one_of_each,
    quantity_of_file,
    stamp_of_measurement,
    time_in_parts,
)
from imufield.acquire.protocol.units import SECONDS, TO_DEGC, TO_SI, known_units, unit_name
from imufield.dataclass import dataclass, replace
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import (
    ACCELEROMETER_COLUMNS,
    GYROSCOPE_COLUMNS,
    LARGEST_OUTPUT,
    SAMPLE_COLUMNS,
    FloatArray,
    median,
    sound_rows,
)
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

FIELDS = (TIME, *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS, TEMPERATURE)
"""The columns of a row of protocol ``rows_f64``, in its order."""
STATUS = "status"
"""Flags of imufield itself, beside the other columns; known in exports of its own only, since others' mean other things."""
COUNTER = "counter"
"""What the instrument numbered its samples by; known in exports of our own only, whose flags tell of every gap."""
FRACTION = "fraction"
"""What has passed of the second in the column of the time, in a unit of its own."""
OF_COLUMNS = frozenset(
    {
        "table_columns.doubled",
        "table_columns.missing",
        "table_columns.narrow_header",
        "table_columns.no_header",
        "table_columns.no_triad",
        "table_columns.two_units",
        "table_columns.unknown_unit",
    }
)
"""Refusals whose remedy is an option for columns or units."""
SKIPPED = ("-", "_", "skip")
_NAMED_AT_ONCE = 12  # Columns that a sentence lists: as many as a person looks through.
_EXAMPLE = "time_ms,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps"  # A unit goes into a name.


HEADERLESS = {
    3: ACCELEROMETER_COLUMNS,
    6: (*ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS),
    7: (TIME, *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS),
    8: FIELDS,
}

TIME_UNIT = "time_unit"
"""Setting of an import; rows themselves are in seconds."""
SHORTEST_STEP_S = 2.5e-4
LONGEST_STEP_S = 0.2
"""Instruments send 5 to 4000 samples a second. The two limits are less than a factor of 1000 apart, so a step fits one unit of
time at most."""
_DATES_S = (946_684_800.0, 4_102_444_800.0)  # 2000 and 2100, from 1970: also less than a factor of 1000 apart.
# Of all steps: longer ones are pauses. Rows that are handed over in bursts, up to a hundred at once, have more long ones.
_NO_PAUSE = 0.99
_BURST = 4.0  # The mean step over the median one: in a burst of two it is more, where one sample of two is lost two.
# A typed rate within 20 % of the time column's decides the unit of time; outside, one of the two is wrong.
_RATE_TOLERANCE = 0.2

_MOST_EQUAL = 0.8  # Share of rows with the time of the row before: of more than five rows nobody knows when the others were.
_THOUSANDTHS = {"mg": "g", "mdeg/s": "deg/s"}
_KEPT = ("g", "deg/s", "deg")  # Beside SI: protocol ``rows_f64`` knows them.
_FAST = 0.999  # Of all outputs; larger ones may be damage.
_LEAST_TICKED = 0.03  # Share of rows with the time of the row before that makes a clock coarse.
_SAME_TICK = 0.07  # Of a tick: those of 15.6 ms are 15 and 16 ms in a file of whole ones.
_MOST_REGULAR = 0.9  # Share of the ticks that are so: the others are pauses and losses.
_STANDS_FOR_G = (0.8, 1.25)
_STANDS_FOR_M_S2 = (8.0, 12.0)  # Median norm of an accelerometer that is at rest most of the time.
# Hands turn a unit faster than this in deg/s at once, and hardly ever in rad/s: 1150 deg/s, half the range of a chip.
FASTEST_RAD_S = 20.0
_LEAST_CODE = 512  # Of a converter's largest outputs: smaller numbers are in a unit.
_END = 1 / 16  # Of the range of all codes, at either end and to either side of its middle.
_MOST_DAMAGED = 1e-3  # Share of the outputs.
_LEAST_AT_ENDS = 0.05  # Share of the outputs of an axis, at each end.
_LEAST_LEAPS = 3  # Of an axis, from one end to the other.


@dataclass(frozen=True, slots=True)
class Meaning:
    """The used columns of one file, and what was assumed about them, in sentences.

    Attributes
    ----------
    columns : tuple of TableColumn
    units : dict
        The stated unit of each quantity, where there is one.
    assumptions : tuple of str
    is_guess : bool
        Nothing but the number of columns tells what they are.
    """

    columns: tuple[TableColumn, ...]
    units: dict[str, str]
    assumptions: tuple[str, ...] = ()
    is_guess: bool = False

    @property
    def places(self) -> list[int]:
        """Where the columns stand in the file."""
        return [column.index for column in self.columns]


def columns_by_user(path: Path, columns: str, width: int) -> Meaning:
    """Take the user's word, e.g. ``time,ax,ay,az,gx,gy,gz,temperature``; ``-`` skips a column.

    Raises
    ------
    UsageError
        A name is unknown or used twice, or there are not as many names as columns.
    """
    names = [name.strip() for name in columns.split(",")]
    if len(names) != width:
        raise UsageError(sentence("table_columns.other_number", found=len(names), path=str(path), width=width))
    found = []
    for index, name in enumerate(names):
        if name in SKIPPED:
            continue
        # A sign would be dropped without a word.
        column = None if name.startswith(("-", "+")) else named_column(name, index)
        if column is None:
            raise UsageError(sentence("table_columns.unknown_name", name=name, known=FIELDS))
        found.append(column)
    return _checked(path, found, (), names)


def columns_by_header(
    path: Path,
    header: Sequence[str],
    units: Sequence[str] | None,
    *,
    width: int,
    text_columns: Collection[int],
    rows: Sequence[Sequence[str]],
) -> Meaning:
    """Understand a header above rows of ``width`` cells, the first of which are given; ``text_columns`` have no numbers.

    Raises
    ------
    UsageError
        No accelerometer or gyroscope triad is found, two columns mean the same, or some have no name.
    """
    # Which of them have none, nobody can tell: rows may begin with a number of their own.
    if len(header) < width:
        known = {"found": len(header), "width": width, "example": ",".join(FIELDS)}
        raise UsageError(sentence("table_columns.narrow_header", path=str(path), **known))
    below = units if units is not None and len(units) == len(header) else [None] * len(header)
    of_axes = quantity_of_file(path)
    found = [named_column(name, index, unit, of_axes) for index, (name, unit) in enumerate(zip(header, below, strict=True))]
    whole, part = time_in_parts(found, rows) or (None, None)
    named, no_clocks = [column for column in found if column not in (None, part)], columns_that_repeat(rows, width, whole)
    chosen = one_of_each(named, header, text_columns, no_clocks)
    if part is not None and whole in chosen:
        chosen.insert(chosen.index(whole) + 1, replace(part, field=FRACTION))
    # Only an export of our own has all of these; columns of these names mean other things elsewhere.
    if set(SAMPLE_COLUMNS) <= set(header):
        chosen += [TableColumn(index=header.index(name), field=name) for name in (STATUS, COUNTER)]
    used = {column.index for column in chosen}
    ignored = [shortened(name) for index, name in enumerate(header) if index not in used and name]
    said = [sentence("table_columns.ignored", name=path.name, ignored=ignored)] if ignored else []
    stamp = stamp_of_measurement(named, no_clocks)
    others = [shortened(header[column.index]) for column in named if column.field == TIME and column.index not in used]
    if stamp is not None and stamp.index in used and others:
        of = shortened(header[stamp.index])
        said.append(sentence("table_columns.stamp", name=path.name, stamp=of, others=others))
    return _checked(path, chosen, tuple(said), header)


def columns_by_count(path: Path, width: int, number: int, files: int) -> Meaning:
    """Assume the usual order of a file without header; ``number`` is its place among ``files``, from 0.

    Raises
    ------
    UsageError
        That many columns have no usual order.
    """
    # Programs that write a file for each sensor write the accelerometer first.
    triad = (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS)[min(number, 1)]
    if number > 1:
        raise UsageError(sentence("table_columns.third_file", path=str(path), number=number + 1))
    if width == 4:
        fields: Sequence[str] | None = (TIME, *triad)
    elif width == 3 and files > 1:
        fields = triad
    else:
        fields = HEADERLESS.get(width) if number == 0 else None
    if fields is None:
        raise UsageError(sentence("table_columns.no_header", path=str(path), width=width, example=",".join(FIELDS)))
    said = sentence("table_columns.taken_as", name=path.name, width=width, fields=[*fields])
    return Meaning(
        tuple(TableColumn(index=index, field=field) for index, field in enumerate(fields)), {}, (said,), is_guess=True
    )


def _checked(path: Path, found: Sequence[TableColumn], assumptions: tuple[str, ...], names: Sequence[str]) -> Meaning:
    """Refuse doubled columns and incomplete triads; ``names`` are those of all columns."""
    fields = [column.field for column in found]
    doubled = next((field for field in fields if fields.count(field) > 1), None)
    if doubled is not None:
        raise UsageError(sentence("table_columns.doubled", path=str(path), field=doubled))
    for triad in (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS):
        missing = [field for field in triad if field not in fields]
        if 0 < len(missing) < 3:
            raise UsageError(sentence("table_columns.missing", path=str(path), missing=missing))
    if not set(fields) - {TIME, FRACTION, TEMPERATURE, STATUS, COUNTER}:
        told = {"names": [shortened(name) for name in names[:_NAMED_AT_ONCE]], "example": _EXAMPLE}
        raise UsageError(sentence("table_columns.no_triad", path=str(path), **told))
    units: dict[str, str] = {}
    for column in found:
        before = units.setdefault(column.quantity, column.unit) if column.unit is not None else None
        if before != column.unit:
            both = [before, column.unit]
            raise UsageError(sentence("table_columns.two_units", path=str(path), quantity=column.quantity, units=both))
    if words := [*dict.fromkeys(column.word for column in found if column.word.strip("-"))]:
        assumptions += (sentence("table_columns.no_units", name=path.name, words=words),)
    return Meaning(tuple(found), units, assumptions)


def given_time_unit(settings: Mapping[str, object]) -> str | None:
    """Return the unit of time the user gives, None without.

    Raises
    ------
    UsageError
        If it is no unit of time.
    """
    unit = settings.get(TIME_UNIT)
    if unit is not None and unit not in SECONDS:
        raise UsageError(sentence("table_columns.time_unit", unit=unit, known=[*SECONDS]))
    return None if unit is None else str(unit)


def median_step(time: FloatArray) -> float:
    """Return the median of the steps that are not 0, 0 where there is none."""
    steps = np.diff(time)
    return float(median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0


def _mean_step(time: FloatArray) -> float:
    """Return the mean step without pauses: also that of rows in bursts, whose median is what a program takes between two."""
    steps = np.diff(time)
    return float(np.mean(steps[steps <= np.quantile(steps, _NO_PAUSE, method="lower")]))


def _unit_of_dates(time: FloatArray, step: float) -> str | None:
    """Return the unit in which times are dates of this century, None without.

    What counts microseconds since the instrument was switched on may be a date in seconds, but then with steps of minutes.
    """
    begin, end = _DATES_S
    units = [(name, scale) for name, scale in SECONDS.items() if scale <= 1.0 and 0.0 < step * scale <= LONGEST_STEP_S]
    return next((name for name, scale in units if begin <= time[0] * scale and time[-1] * scale < end), None)


def choose_time_scale(path: Path, time: FloatArray, unit: str | None, rate_hz: float | None) -> tuple[float, str]:
    """Return seconds per unit of a time column, and a sentence where it was assumed.

    Raises
    ------
    UsageError
        No unit gives a plausible rate, or the typed rate contradicts the column.
    """
    # Pauses make the one longer, and bursts the other shorter.
    steps = (_mean_step(time), median_step(time))
    step = steps[0]
    if unit == SAMPLE_TIME_FINE:
        # Their rates are so far apart that a step fits one of them.
        tick_s = 1e-4 if step * 1e-4 <= LONGEST_STEP_S else 1e-6
        _check_rate(path, steps, tick_s, rate_hz)
        return tick_s, ""
    dates = _unit_of_dates(time, steps[1]) if unit is None else None
    if unit is not None or dates is not None:
        scale = SECONDS[unit or str(dates)]
        _check_rate(path, steps, scale, rate_hz)
        if dates is not None:
            day = datetime.fromtimestamp(time[0] * scale, UTC).date()
            return scale, sentence("table_columns.dates", name=path.name, unit=dates, day=day, rate_hz=1.0 / (step * scale))
        if rate_hz is not None or not step or any(SHORTEST_STEP_S <= each * scale <= LONGEST_STEP_S for each in steps):
            return scale, ""
        told = {"name": path.name, "unit": unit, "step": step, "rate_hz": 1.0 / (step * scale)}
        scales = ((name, each) for name, each in SECONDS.items() if each <= 1.0)
        likely = next((name for name, each in scales if SHORTEST_STEP_S <= step * each <= LONGEST_STEP_S), "")
        key = "table_columns.implausible" if likely else "table_columns.implausible_in_all"
        return scale, sentence(key, likely=likely, **told)
    low, high = SHORTEST_STEP_S, LONGEST_STEP_S
    if rate_hz is not None:
        low, high = (1.0 - _RATE_TOLERANCE) / rate_hz, (1.0 + _RATE_TOLERANCE) / rate_hz
    # A step tells units apart that differ by 1000: minutes and hours are not among them.
    units = [name for name, scale in SECONDS.items() if scale <= 1.0]
    fitting = ((each, name) for each in steps for name in units if low <= each * SECONDS[name] <= high)
    step, name = next(fitting, (step, ""))
    if not name:
        # In seconds it would be plausible: then it is the rate that is wrong.
        if rate_hz is not None and SHORTEST_STEP_S <= step <= LONGEST_STEP_S:
            _check_rate(path, steps, 1.0, rate_hz)
        key = "table_columns.no_rate_fits" if rate_hz is None else "table_columns.wrong_rate"
        raise UsageError(sentence(key, path=str(path), step=step, rate_hz=rate_hz))
    fitting_hz = 1.0 / (step * SECONDS[name])
    return SECONDS[name], sentence("table_columns.time_taken_as", name=path.name, unit=name, step=step, rate_hz=fitting_hz)


def in_degc(path: Path, values: FloatArray, unit: str) -> FloatArray:
    """Return temperatures in degC.

    Raises
    ------
    UsageError
        If the header names a unit that is none.
    """
    if unit not in TO_DEGC:
        raise UsageError(
            sentence("table_columns.unknown_temperature_unit", path=str(path), unit=unit, known=[*TO_DEGC]), Reason.UNITS
        )
    factor, offset = TO_DEGC[unit]
    return values * factor + offset


def refuse_coarse_times(path: Path, time: FloatArray) -> None:
    """Raise ``UsageError`` if most rows have the time of the row before."""
    share = np.count_nonzero(np.diff(time) == 0.0) / max(len(time) - 1, 1)
    if share > _MOST_EQUAL:
        raise UsageError(sentence("table_columns.same_times", path=str(path), share=share, limit=_MOST_EQUAL))


def refuse_bursts(path: Path, time_s: FloatArray) -> None:
    """Raise ``UsageError`` if most rows follow the one before at once and the others much later: they have times of arrival."""
    step_s, mean_s = median_step(time_s), _mean_step(time_s)
    if step_s < SHORTEST_STEP_S and mean_s >= _BURST * step_s:
        told = {"limit_s": SHORTEST_STEP_S, "step_s": step_s, "rate_hz": (len(time_s) - 1) / (time_s[-1] - time_s[0])}
        raise UsageError(sentence("table_columns.bursts", path=str(path), **told))


def spread_times(time: FloatArray) -> FloatArray | None:
    """Return rising times, shape (n,), for times that never fall, of a clock with coarse but regular ticks; None for others.

    Rows of one time are spread about the middle of their tick, a mean step apart. No step between two ticks is then longer
    than 1.5 mean steps, which would count as a loss.
    """
    first = np.flatnonzero(np.diff(time, prepend=-np.inf))
    rows, between = np.diff(first, append=len(time)), np.diff(time[first])
    usual = median(between)
    regular = np.abs(between / usual - 1) < _SAME_TICK
    # What was read in bursts and stamped by its arrival is left to the decoder, which follows arrivals. A few rows of one time
    # are of a clock that stood, and the time is missing.
    if np.mean(regular) <= _MOST_REGULAR or len(first) > (1 - _LEAST_TICKED) * len(time):
        return None
    mean_step = between[regular].sum() / rows[:-1][regular].sum()
    # The last tick has no end. A pause is longer than a tick, and one whose time came late as long as its rows take.
    tick = np.minimum(np.append(between, np.inf), np.maximum(usual, rows * mean_step))
    step = np.minimum(mean_step, tick / rows)
    # More rows than a tick has room for were sent while the clock stood: they keep their time.
    step[(rows - 1.5) * mean_step > tick] = 0.0
    first_time = time[first] + (tick - (rows - 1) * step) / 2
    rising: FloatArray = np.repeat(first_time, rows) + (np.arange(len(time)) - np.repeat(first, rows)) * np.repeat(step, rows)
    return rising


def _check_rate(path: Path, steps: Sequence[float], scale: float, rate_hz: float | None) -> None:
    """Refuse a typed rate that neither of the steps has."""
    if rate_hz is not None and all(abs(step * scale * rate_hz - 1.0) > _RATE_TOLERANCE for step in steps):
        found_hz = 1.0 / (steps[0] * scale) if steps[0] > 0.0 else 0.0
        key = "table_columns.other_rate" if found_hz else "table_columns.no_rate"
        raise UsageError(sentence(key, path=str(path), rate_hz=rate_hz, found_hz=found_hz))


def choose_unit(
    quantity: str, values: FloatArray, stated: Mapping[str, str], given: Mapping[str, object], *, has_zero: bool
) -> tuple[str, float, str]:
    """Choose the unit of a triad.

    Parameters
    ----------
    quantity : str
        ``accelerometer`` or ``gyroscope``.
    values : ndarray, shape (n, 3)
    stated : mapping
        Units the headers name.
    given : mapping
        Settings of the user.
    has_zero : bool
        A mid-scale was given: the accelerometer sends counts.

    Returns
    -------
    unit : str
    factor : float
        By which the values are to be multiplied.
    sentence : str
        What was assumed or converted; empty if nothing.

    Raises
    ------
    UsageError
        If the user names a unit that is none, or a header and the user none.
    """
    setting = given.get(f"{quantity}_unit")
    whole = sound_rows(values, ~np.isnan(values))
    # A triad without values has any unit.
    if setting is None and not len(whole):
        return ("m/s^2" if quantity == "accelerometer" else "rad/s"), 1.0, ""
    written = stated.get(quantity) if setting is None else str(setting)
    if written is not None:
        name = unit_name(written, quantity)
        if name is None:
            known = known_units(quantity)
            raise UsageError(sentence("table_columns.unknown_unit", quantity=quantity, unit=written, known=known), Reason.UNITS)
        unit, factor = (_THOUSANDTHS[name], 1e-3) if name in _THOUSANDTHS else TO_SI[name]
        if factor == 1.0 or name in _KEPT:
            return name, 1.0, ""
        return unit, factor, sentence("table_columns.converted", quantity=quantity, stated=name, unit=unit)
    # Neither one damaged number nor a gap decides for all the others.
    possible = sound_rows(whole, np.abs(whole) <= LARGEST_OUTPUT)
    guess, key, found = _guess(quantity, possible if len(possible) else whole, stated, has_zero=has_zero)
    return guess, 1.0, sentence(key, quantity=quantity, unit=guess, found=found, found_deg=np.degrees(found))


def refuse_unsigned(path: str, quantity: str, values: FloatArray) -> None:
    """Refuse two's complement that was read without its sign: counts that leap between both ends of their bits, none between.

    Raises
    ------
    RecordingError
        With the bits, and what to subtract.
    """
    known = sound_rows(values, np.isfinite(values))
    if not (len(known) and (known >= 0).all() and np.array_equal(known, np.rint(known)) and known.max() >= _LEAST_CODE):
        return
    bits = int(known.max()).bit_length()
    share = known.T.copy() / (1 << bits)  # Axis by axis, each of them counted in one pass.
    # An axis at rest is at one end, and goes to the other through the middle; single outputs may be damaged.
    low, high = (np.count_nonzero(end, axis=1) for end in (share < _END, share > 1 - _END))
    at_both = np.minimum(low, high) > _LEAST_AT_ENDS * len(known)
    leaps = np.count_nonzero(np.abs(np.diff(share[at_both], axis=1)) > 1 - 2 * _END, axis=1)
    if (leaps >= _LEAST_LEAPS).any() and np.mean(np.abs(share - 0.5) < _END) < _MOST_DAMAGED:
        sizes = {"bits": bits, "half": 1 << bits - 1, "codes": 1 << bits}
        raise RecordingError(sentence("table_columns.unsigned", path=path, quantity=quantity, **sizes), Reason.BAD_DATA)


def _guess(quantity: str, values: FloatArray, stated: Mapping[str, str], *, has_zero: bool) -> tuple[str, str, float]:
    """Return the unit, the key of the sentence that says why, and the number that decides."""
    if has_zero and quantity == "accelerometer":
        return "count", "table_columns.count_by_zero", 0.0
    if np.array_equal(values, np.rint(values)):
        return "count", "table_columns.count_by_whole_numbers", 0.0
    if quantity == "accelerometer":
        with np.errstate(over="ignore", invalid="ignore"):  # in damaged files; infinite is no plausible norm either
            norm = float(median(np.linalg.norm(values, axis=1)))
        for unit, (low, high) in (("m/s^2", _STANDS_FOR_M_S2), ("g", _STANDS_FOR_G)):
            if low <= norm <= high:
                return unit, "table_columns.unit_by_norm", norm
        return "count", "table_columns.count_by_norm", norm
    fastest = float(np.quantile(np.abs(values), _FAST, method="lower"))
    if fastest > FASTEST_RAD_S:
        return "deg/s", "table_columns.deg_by_fastest", fastest
    if stated.get("accelerometer") in ("g", "mg"):
        return "deg/s", "table_columns.deg_by_g", fastest
    return "rad/s", "table_columns.rad_by_fastest", fastest
