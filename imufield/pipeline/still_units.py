"""Units of imported numbers by their stills: between two of them the gyroscope turns by as much as the accelerometer tilts.

The ratio of both is the unit of the gyroscope (1 in rad/s, 57.3 in deg/s) and shows its common scale; the length of the stills
about their centre is the unit of the accelerometer. Neither depends on how fast a hand moves, or on an offset.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imufield.acquire.formats.tables import ROWS_TO_GUESS_BY, ImportedTable
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.units import nominal_scale
from imufield.errors import CalibrationError
from imufield.guide.lead.unguided import StillIntervalFinder
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import LARGEST_OUTPUT, FloatArray, Samples, SampleUnits, make_samples
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

# The units that a scale can tell. Increments have the interval in theirs.
_UNITS = {"accelerometer": ("m/s^2", "g"), "gyroscope": ("rad/s", "deg/s")}
# Of a logarithm: a scale learned from one still has up to 0.1 of offset in it, and units differ by a factor of 10.
_SAME_FACTOR = 0.2
_ROWS_AT_ONCE = 4096


@dataclass(frozen=True, slots=True)
class StillScales:
    """What of the numbers is 1 m/s^2 and 1 rad/s, by triad, where the stills show it, and how many there were."""

    scales: dict[str, float]
    stills: int

    def choose(self, stated: Mapping[str, str], assumed: Collection[str]) -> tuple[dict[str, str], dict[str, Sentence]]:
        """Return units in place of those assumed, and by triad what is to be said, also of stated ones that are wrong."""
        units: dict[str, str] = {}
        said: dict[str, Sentence] = {}
        for triad, scale in self.scales.items():
            unit = next((unit for unit in _UNITS[triad] if abs(math.log(_ratio(scale, unit))) < _SAME_FACTOR), "count")
            if triad in assumed:
                units[triad] = unit
                key = f"still_units.{triad}" if unit in _UNITS[triad] else f"still_units.{triad}_count"
                count = {"count": 1 / scale, "count_deg": math.degrees(1 / scale)}
                said[triad] = sentence(key, unit=unit, stills=self.stills, ratio=_ratio(scale, unit), **count)
            elif stated[triad] in _UNITS[triad] and unit != stated[triad]:
                ratio = _ratio(scale, stated[triad])
                said[triad] = sentence(f"still_units.other_{triad}", stated=stated[triad], ratio=ratio)
        return units, said


def _ratio(scale: float, unit: str) -> float:
    return scale / (nominal_scale(unit) or 1.0)


def find_scales(blocks: Iterable[Samples], raw_zero: FloatArray) -> StillScales:
    """Return the scales that the stills of a recording show, whatever its units are said to be; all blocks are taken."""
    finder: StillIntervalFinder | None = None
    count = 0
    for block in blocks:
        finder = finder or StillIntervalFinder(block.units, RoughScale(raw_zero=raw_zero))
        if count < ROWS_TO_GUESS_BY:
            finder.feed(block)
        count += len(block)
    try:
        found = None if finder is None else finder.finish()
    except CalibrationError:
        found = None
    if found is None:
        return StillScales({}, 0)
    scales = {}
    if found.scale.centred and found.scale.accelerometer:
        scales["accelerometer"] = found.scale.accelerometer
    if found.axes.fits:
        scales["gyroscope"] = found.axes.gyroscope_scale
    return StillScales(scales, len(found.observations))


def with_units_of_stills(table: ImportedTable) -> ImportedTable:
    """Return a table with the units that its stills show in place of guesses, and what is to be said of them."""
    stated = {triad: str(table.settings[f"{triad}_unit"]) for triad in _UNITS}
    units, said = find_scales(_blocks(table), np.array(table.raw_zero)).choose(stated, table.guessed)
    guesses = {guess: said.pop(triad) for triad, guess in table.guessed.items() if triad in said}
    return replace(
        table,
        settings=table.settings | {f"{triad}_unit": unit for triad, unit in units.items()},
        assumptions=(*(guesses.get(assumption, assumption) for assumption in table.assumptions), *said.values()),
    )


def settings_of_stills(found: StillScales, protocol: Protocol) -> tuple[dict[str, str], tuple[Sentence, ...]]:
    """Return the settings of a protocol's units in place of those assumed, by its decoded samples, and what is to be said."""
    given = {triad: protocol.settings[f"{triad}_unit"] for triad in found.scales if f"{triad}_unit" in protocol.settings}
    stated = {triad: str(setting.value) for triad, setting in given.items()}
    # Samples are in SI where the unit is known: back to what is on the wire.
    scales = {triad: found.scales[triad] * (nominal_scale(unit) or 1.0) for triad, unit in stated.items()}
    assumed = [triad for triad, setting in given.items() if setting.origin == "assumed"]
    units, said = StillScales(scales, found.stills).choose(stated, assumed)
    return {f"{triad}_unit": unit for triad, unit in units.items()}, tuple(said.values())


def _blocks(table: ImportedTable) -> Iterator[Samples]:
    rows = table.rows[:ROWS_TO_GUESS_BY]
    # What no instrument can have sent is damage, to the decoder too.
    rows = np.where(np.abs(rows) <= LARGEST_OUTPUT, rows, np.nan)
    # Nothing is known of the units: that is what is asked.
    units = SampleUnits(accelerometer="count", gyroscope="count")
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        part = rows[start : start + _ROWS_AT_ONCE]
        yield make_samples(table.rows[start : start + len(part), 0], part[:, 1:4], part[:, 4:7], units=units)
