"""Imported sessions of cheap parts: offsets of up to 0.5 g on each axis, and units that nobody stated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from imufield.acquire.formats.table_columns import choose_unit
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.lead.still_scales import find_scales
from imufield.guide.lead.unguided import StillIntervalFinder, StillIntervals
from imufield.samples import FloatArray
from imufield.simulate.truth.grades import draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.source import VirtualImu
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

HOLDS = 40
OFFSETS_G = (0.0, 0.25, 0.5)
UNITS = {"rad/s": 1.0, "deg/s": math.degrees(1.0)}
"""Raw per rad/s."""
PEAK_DEG_S = (15.0, 400.0)
"""Fastest turn of a person: a careful one, and one in a hurry."""
_RATE_HZ = 50.0
_BLOCK = 4096


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of session."""

    offset_g: float
    unit: str
    """Of the gyroscope in the table."""


@dataclass(frozen=True, slots=True)
class ImportRun:
    """What one session shows."""

    kept: float
    """Share of the holds made that are observations, the stay before the first move among them."""
    decided: bool
    """Whether the moves say that the axes are right."""
    by_stills: bool
    """Whether the unit of the gyroscope is taken as it is."""
    by_size: bool
    """The same by the size of its numbers alone."""
    ratio: float
    """Common scale of the gyroscope by the stills over the true one, NaN where they show none."""


def run_import(case: Case, rng: np.random.Generator) -> ImportRun:
    """Draw a chip with this offset on each axis, of any sign, and a person who shows 40 sides of it."""
    drawn = draw_truth(find_grade("mems"), rng)
    offset = STANDARD_GRAVITY_M_S2 * case.offset_g * rng.choice([-1.0, 1.0], 3)
    truth = replace(drawn, accelerometer=replace(drawn.accelerometer, bias_m_s2=drawn.accelerometer.bias_m_s2 + offset))
    seed, peak = int(rng.integers(1 << 31)), math.radians(math.exp(rng.uniform(*np.log(PEAK_DEG_S))))
    habits = OperatorSettings(hold_s=4.0, initial_still_s=4.0, turn_s=(1.5, 2.5), peak_rate_rad_s=peak)
    operator = Operator(rng.standard_normal((HOLDS, 3)), seed, habits)
    unit = VirtualImu(Imu(truth, seed, ImuSettings(rate_hz=_RATE_HZ)), operator)
    samples = unit.next_block(int(operator.plan_all() * _RATE_HZ))
    samples = replace(samples, gyroscope=samples.gyroscope * UNITS[case.unit])
    blocks = [samples[start : start + _BLOCK] for start in range(0, len(samples), _BLOCK)]
    scales = find_scales(blocks, np.zeros(3))
    chosen, _ = scales.choose({}, ("accelerometer", "gyroscope"))
    by_size, _, _ = choose_unit("gyroscope", samples.gyroscope, {}, {}, has_zero=False)
    true_scale = float(np.mean(truth.gyroscope.scale)) * UNITS[case.unit]
    # As the session is read once the unit is known.
    finder = StillIntervalFinder(samples.units)
    finder.feed(replace(samples, gyroscope=samples.gyroscope / UNITS[case.unit]))
    found = finder.finish()
    return ImportRun(
        kept=_kept(operator, found),
        decided=found.axes.agrees is True,
        by_stills=chosen.get("gyroscope") == case.unit,
        by_size=by_size == case.unit,
        ratio=scales.scales.get("gyroscope", math.nan) / true_scale,
    )


def _kept(operator: Operator, found: StillIntervals) -> float:
    """Return the share of the true stills in which an observation begins."""
    starts: FloatArray = found.observations.start_s
    inside = [bool(((still.start_s <= starts) & (starts < still.end_s)).any()) for still in operator.stills]
    return float(np.mean(inside))


def offsets(context: StudyContext) -> Findings:
    """Measure how many holds are kept, how often axes are decided and the unit is right, by offset and unit."""
    cases = [Case(offset_g, unit) for offset_g, unit in product(OFFSETS_G, UNITS)]
    runs = context.runs(200, 1)
    found = context.campaign_of_each("answers-offsets", run_import, cases, runs)
    rows = {f"{case.offset_g:g} g, {case.unit}": _row(results) for case, results in zip(cases, found, strict=True)}
    return Findings(
        values={"rows": rows, "runs": runs, "holds": HOLDS + 1, "peak": PEAK_DEG_S, "size_wrong": _wrong_by_size(found)},
        tables=(keyed_table("sessions", "offset on each axis, unit", rows),),
    )


def _row(results: list[ImportRun]) -> dict[str, float]:
    ratios = np.array([result.ratio for result in results])
    return {
        "holds kept": float(np.mean([result.kept for result in results])),
        "sessions that lose a hold": float(np.mean([result.kept < 1 for result in results])),
        "axes decided": float(np.mean([result.decided for result in results])),
        "unit right": float(np.mean([result.by_stills for result in results])),
        "unit right by size": float(np.mean([result.by_size for result in results])),
        # NaN where no session shows a scale.
        "common scale off": float(np.max(np.abs(ratios - 1))),
    }


def _wrong_by_size(found: list[list[ImportRun]]) -> float:
    return float(np.mean([not result.by_size for results in found for result in results]))
