"""Units of what is imported, by its stills: in place of those that nobody stated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from imufield.acquire.formats.tables import ImportedTable
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.units import nominal_scale
from imufield.dataclass import replace
from imufield.errors import UsageError
from imufield.guide.lead.still_scales import StillScales, find_scales
from imufield.samples import LARGEST_OUTPUT, TRIADS, FloatArray, Samples, SampleUnits, make_samples
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_ROWS_AT_ONCE = 4096
_SWAPPED = [0, 4, 5, 6, 1, 2, 3, 7]  # Columns of a row with either triad in the place of the other.


def with_units_of_stills(table: ImportedTable) -> ImportedTable:
    """Return a table with the units that its stills show in place of guesses, and what is to be said of them."""
    kept = {triad: str(table.settings[f"{triad}_unit"]) for triad in TRIADS}
    found = find_scales(_blocks(table.rows), np.array(table.raw_zero))
    if not found.scales and find_scales(_blocks(table.rows, _SWAPPED), np.array(table.raw_zero)).are_sure:
        raise UsageError(sentence("still_units.swapped"))
    stated = {triad: table.stated.get(triad, unit) for triad, unit in kept.items()}
    # Of the numbers as they stand in the file: a unit may have been converted.
    factors = {triad: (nominal_scale(stated[triad]) or 1.0) / (nominal_scale(unit) or 1.0) for triad, unit in kept.items()}
    as_written = replace(found, scales={triad: scale * factors[triad] for triad, scale in found.scales.items()})
    units, said = as_written.choose(stated, table.guessed)
    if units.get("gyroscope") == "count" and "rate_hz" in table.settings:
        said |= _other_rate(found.scales["gyroscope"], float(table.settings["rate_hz"]), table.rows[:, 4:7])
    if found.centre_raw is not None:
        said |= {"raw_zero": sentence("still_units.raw_zero", centre=[round(each) for each in found.centre_raw.tolist()])}
    assumptions = table.assumptions
    # Gravity looks small in a wrong unit, and in none; there it turns with the gyroscope nonetheless.
    if "accelerometer" in said or found.are_sure:
        assumptions = tuple(each for each in assumptions if getattr(each, "key", "") != "tables.no_gravity")
    guesses = {guess: said.pop(triad) for triad, guess in table.guessed.items() if triad in said}
    return replace(
        table,
        settings=table.settings | {f"{triad}_unit": unit for triad, unit in units.items()},
        assumptions=(*(guesses.get(assumption, assumption) for assumption in assumptions), *said.values()),
    )


def _other_rate(scale: float, rate_hz: float, rate_raw: FloatArray) -> dict[str, Sentence]:
    """Return what is to be said where outputs are no counts, and would be in a usual unit at another sample rate."""
    known = rate_raw[np.isfinite(rate_raw)]
    if np.array_equal(known, np.rint(known)):
        return {}
    # Turns are rate times step: a step that is wrong by a factor looks like a unit that is.
    rates_hz = {unit: rate_hz * scale / (nominal_scale(unit) or 1.0) for unit in ("rad/s", "deg/s")}
    unit = min(rates_hz, key=lambda name: abs(np.log(rates_hz[name] / rate_hz)))
    return {"gyroscope": sentence("still_units.other_rate", unit=unit, right_hz=rates_hz[unit], rate_hz=rate_hz)}


def _blocks(rows: FloatArray, columns: Sequence[int] | slice = slice(None)) -> Iterator[Samples]:
    units = SampleUnits(accelerometer="count", gyroscope="count")
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        part = rows[start : start + _ROWS_AT_ONCE, columns]
        # What no instrument can have sent is damage, to the decoder too.
        values = np.where(np.abs(part) <= LARGEST_OUTPUT, part, np.nan)
        yield make_samples(part[:, 0], values[:, 1:4], values[:, 4:7], units=units)


def settings_of_stills(found: StillScales, protocol: Protocol) -> tuple[dict[str, str], tuple[Sentence, ...]]:
    """Return the settings of a protocol's units in place of those assumed, by its decoded samples, and what is to be said."""
    given = {triad: protocol.settings[f"{triad}_unit"] for triad in found.scales if f"{triad}_unit" in protocol.settings}
    stated = {triad: str(setting.value) for triad, setting in given.items()}
    # Samples are in SI where the unit is known: back to what is on the wire.
    scales = {triad: found.scales[triad] * (nominal_scale(unit) or 1.0) for triad, unit in stated.items()}
    assumed = [triad for triad, setting in given.items() if setting.origin == "assumed"]
    units, said = StillScales(scales, found.stills).choose(stated, assumed)
    return {f"{triad}_unit": unit for triad, unit in units.items()}, tuple(said.values())
