"""Scales and units of both triads by the stills of a recording, whatever its units are said to be.

Between two stills the gyroscope turns by as much as the accelerometer tilts. The ratio of both is the unit of the gyroscope (1
in rad/s, 57.3 in deg/s) and shows its common scale; the length of the stills about their centre is the unit of the
accelerometer. Neither depends on how fast a hand moves, or on an offset.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from copy import deepcopy

import numpy as np

from imufield.acquire.protocol.units import TO_SI, nominal_scale
from imufield.dataclass import dataclass
from imufield.errors import CalibrationError
from imufield.guide.lead.unguided import StillIntervalFinder
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import LARGEST_OFFSET_M_S2, FloatArray, Samples
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

# Of a logarithm: a scale learned from one still has up to 0.1 of offset in it, and units differ by a factor of 10.
_SAME_FACTOR = 0.2
_ENOUGH_STILLS = 12  # Twice what a sphere and the axes need; units differ by so much that these tell them apart.
_MOST_SAMPLES = 1 << 18  # Two minutes at 2000 Hz: the stills of more would tell the same.


@dataclass(frozen=True, slots=True)
class _Kind:
    """Units of a triad that a scale can tell (those of increments have the interval in them), and the keys of sentences."""

    units: tuple[str, str]
    taken: str
    taken_as_count: str
    contradicted: str
    fits_none: str


_KINDS = {
    "accelerometer": _Kind(
        ("m/s^2", "g"),
        "still_scales.accelerometer",
        "still_scales.accelerometer_count",
        "still_scales.other_accelerometer",
        "still_scales.no_accelerometer_unit",
    ),
    "gyroscope": _Kind(
        ("rad/s", "deg/s"),
        "still_scales.gyroscope",
        "still_scales.gyroscope_count",
        "still_scales.other_gyroscope",
        "still_scales.no_gyroscope_unit",
    ),
}
CONTRADICTIONS = frozenset(key for kind in _KINDS.values() for key in (kind.contradicted, kind.fits_none))
"""Keys of the sentences about a stated unit that is wrong."""


@dataclass(frozen=True, slots=True)
class StillScales:
    """What of the numbers is 1 m/s^2 and 1 rad/s, by triad, where the stills show it, and how many there were."""

    scales: dict[str, float]
    stills: int
    centre_raw: FloatArray | None = None
    """Of the accelerometer's outputs, shape (3,), where it is many g from the raw zero: that of a converter, left out."""

    @property
    def are_sure(self) -> bool:
        """Whether both triads are among them, by stills enough."""
        return len(self.scales) == len(_KINDS) and self.stills >= _ENOUGH_STILLS

    def choose(self, stated: Mapping[str, str], assumed: Collection[str]) -> tuple[dict[str, str], dict[str, Sentence]]:
        """Return units in place of those assumed, and by triad what is to be said, also of stated ones that are wrong."""
        units: dict[str, str] = {}
        said: dict[str, Sentence] = {}
        for triad, scale in self.scales.items():
            kind = _KINDS[triad]
            unit = next((unit for unit in kind.units if abs(math.log(_ratio(scale, unit))) < _SAME_FACTOR), "count")
            if triad in assumed:
                units[triad] = unit
                key = kind.taken if unit in kind.units else kind.taken_as_count
                count = {"count": 1 / scale, "count_deg": math.degrees(1 / scale)}
                said[triad] = sentence(key, unit=unit, stills=self.stills, ratio=_ratio(scale, unit), **count)
            elif _is_other(scale, stated[triad], kind.units[0]):
                right = fitting_unit(scale, kind.units[0])
                key = kind.contradicted if right else kind.fits_none
                said[triad] = sentence(key, stated=stated[triad], ratio=_ratio(scale, stated[triad]), right=right)
        return units, said


def fitting_unit(scale: float, si_unit: str) -> str:
    """Return the unit of which so many are one of the SI unit; empty where no usual unit has about that scale."""
    units = [unit for unit, (si, _) in TO_SI.items() if si == si_unit and scale > 0]
    return next((unit for unit in units if abs(math.log(_ratio(scale, unit))) < _SAME_FACTOR), "")


def _is_other(scale: float, unit: str, si_unit: str) -> bool:
    """Whether a stated unit is one that a scale can tell, and another."""
    return TO_SI.get(unit, ("",))[0] == si_unit and abs(math.log(_ratio(scale, unit))) >= _SAME_FACTOR


def _ratio(scale: float, unit: str) -> float:
    return scale / (nominal_scale(unit) or 1.0)


def find_scales(blocks: Iterable[Samples], raw_zero: FloatArray) -> StillScales:
    """Return the scales that the stills of a recording show, by only as many of them as show both.

    Parameters
    ----------
    blocks : iterable of Samples
    raw_zero : ndarray, shape (3,), or (6,)
        Of the accelerometer, or of both triads.
    """
    finder: StillIntervalFinder | None = None
    found, count, enough = StillScales({}, 0), 0, _ENOUGH_STILLS
    # To the end, whatever is used: the decoder behind them counts its frames.
    for block in blocks:
        # Nothing is known of the scales: that is what is asked.
        finder = finder or StillIntervalFinder(block.units, RoughScale(raw_zero=block.units.raw_zero_rate(raw_zero[:3])))
        if found.are_sure or count >= _MOST_SAMPLES:
            continue
        finder.feed(block)
        count += len(block)
        if finder.placed >= enough:
            # Of a copy: what is finished cannot go on. Asked after twice as many again, which costs less than the stills.
            found, enough = _scales_of(deepcopy(finder)), 2 * finder.placed
    return found if finder is None or found.are_sure else _scales_of(finder)


def _scales_of(finder: StillIntervalFinder) -> StillScales:
    try:
        found = finder.finish()
    except CalibrationError:
        return StillScales({}, 0)
    scales = {}
    if found.scale.centred and found.scale.accelerometer:
        scales["accelerometer"] = found.scale.accelerometer
    if found.axes.fits:
        scales["gyroscope"] = found.axes.gyroscope_scale
    offset = found.scale.raw_zero - finder.detector.scale.raw_zero
    is_far = found.scale.centred and np.linalg.norm(offset) > LARGEST_OFFSET_M_S2 * (found.scale.accelerometer or math.inf)
    return StillScales(scales, len(found.observations), found.scale.raw_zero if is_far else None)
