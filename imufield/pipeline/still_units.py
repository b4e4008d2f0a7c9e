"""Units of what is imported, by its stills: in place of those that nobody stated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imufield.acquire.formats.tables import ImportedTable
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.units import nominal_scale
from imufield.guide.lead.still_scales import StillScales, find_scales
from imufield.samples import LARGEST_OUTPUT, Samples, SampleUnits, make_samples
from imufield.sentences import Sentence

_TRIADS = ("accelerometer", "gyroscope")
_ROWS_AT_ONCE = 4096


def with_units_of_stills(table: ImportedTable) -> ImportedTable:
    """Return a table with the units that its stills show in place of guesses, and what is to be said of them."""
    stated = {triad: str(table.settings[f"{triad}_unit"]) for triad in _TRIADS}
    units, said = find_scales(_blocks(table), np.array(table.raw_zero)).choose(stated, table.guessed)
    guesses = {guess: said.pop(triad) for triad, guess in table.guessed.items() if triad in said}
    return replace(
        table,
        settings=table.settings | {f"{triad}_unit": unit for triad, unit in units.items()},
        assumptions=(*(guesses.get(assumption, assumption) for assumption in table.assumptions), *said.values()),
    )


def _blocks(table: ImportedTable) -> Iterator[Samples]:
    units = SampleUnits(accelerometer="count", gyroscope="count")
    for start in range(0, len(table.rows), _ROWS_AT_ONCE):
        part = table.rows[start : start + _ROWS_AT_ONCE]
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
