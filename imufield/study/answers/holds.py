"""Sessions with holds that should not count: clipped, frozen, on codes that stick, on foam; and what is made of them.

Each session is simulated twice with the same seed, sample by sample, with and without the effect: the samples that differ are
the truth about which holds the effect has spoilt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.earth import STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError
from imufield.guide.hold.checks import CLIPPED_SAMPLES, CLIPPED_SHARE
from imufield.guide.lead.unguided import StillIntervalFinder, StillIntervals
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray, Samples, concatenate
from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import Site
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.source import VirtualImu
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

RATE_HZ = 50.0
POSITIONS = "paper24"
FOAM_DEG = 3.0
FOAM_S = 5.0
_BLOCK = 5000
_SILENT_RANGE = "range of 1.02 g without a flag"
_PLACED = OperatorSettings(hold_s=8.0, initial_still_s=8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A kind of session."""

    effects: Effects = NO_EFFECTS
    habits: OperatorSettings = _PLACED
    coarse_m_s2: float | None = None
    """Step of the accelerometer, whose noise is a hundredth of it then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldsRun:
    """What came of one session.

    Attributes
    ----------
    placements, counted : int
        Times that the unit was put down or lay there at first, and observations made of them.
    spoilt : tuple of float
        Of each observation with samples that the effect changed, their share.
    inside : ndarray of bool, shape (12,)
        Gauge-free numbers within their 95 % limits; all False where nothing could be calibrated.
    good, said : bool
        The verdict; and whether something was refused or said about the outputs.
    """

    placements: int
    counted: int
    spoilt: tuple[float, ...]
    inside: FloatArray = field(default_factory=lambda: np.zeros(12))
    good: bool = False
    said: bool


CASES = {
    "no effect": Case(),
    _SILENT_RANGE: Case(effects=Effects(silent_range_m_s2=1.02 * STANDARD_GRAVITY_M_S2)),
    "all outputs frozen for 12 s": Case(effects=Effects(frozen_s=(60.0, 72.0))),
    "one output frozen for 12 s": Case(effects=Effects(frozen_s=(60.0, 72.0), frozen_outputs=(1,))),
    "every 256th code 32 wide": Case(effects=Effects(sticking_period=256, sticking_width=32)),
    "steps of 5 mg, noise of 0.05 mg": Case(coarse_m_s2=0.05),
    "foam": Case(habits=replace(_PLACED, hold_s=16.0, settling_rad=math.radians(FOAM_DEG), settling_s=FOAM_S)),
}


def run_holds(case: Case, rng: np.random.Generator) -> HoldsRun:
    """Simulate a session as an import sees it, find its still intervals and calibrate the accelerometer."""
    seed = int(rng.integers(2**31))
    source, twin = _source(case, seed), _source(replace(case, effects=NO_EFFECTS), seed)
    samples, plain = (concatenate(_samples(imu)) for imu in (source, twin))
    grade = source.imu.instrument.grade
    finder = StillIntervalFinder(samples.units, RoughScale(grade.accelerometer_scale, grade.gyroscope_scale))
    finder.feed(samples)
    found = finder.finish()
    run = HoldsRun(
        placements=len(source.operator.stills),
        counted=len(found.observations),
        spoilt=_spoilt(found, samples, plain),
        said=bool(found.refused or found.sticking),
    )
    gravity = Gravity(gravity_m_s2=source.operator.site.gravity_m_s2, sigma_m_s2=1e-5, source="typed")
    try:
        calibration = calibrate_accelerometer(found.observations, gravity)
    except CalibrationError:
        return run
    truth = source.imu.instrument.accelerometer
    true, _ = intrinsic(to_vector(replace(truth, bias_m_s2=truth.bias_m_s2 + source.imu.mean_drift[:3])))
    numbers = calibration.intrinsic
    values = np.concatenate([numbers.scale, numbers.bias_raw, numbers.angle_rad, numbers.quadratic])
    sigma = np.concatenate([numbers.scale_sigma, numbers.bias_raw_sigma, numbers.angle_sigma_rad, numbers.quadratic_sigma])
    factor, verdict = calibration.quality.student_factor_95, calibration.quality.verdict
    # A term that was left out has no sigma: nothing is stated of it.
    inside = np.where(np.isfinite(sigma), np.abs(values - true) <= factor * sigma, np.nan)
    return replace(run, inside=inside, good=verdict == "good" and not found.sticking)


def _source(case: Case, seed: int) -> VirtualImu:
    instrument = draw_truth(find_grade("mems"), np.random.default_rng([seed, 401]))
    grade = instrument.grade
    if case.coarse_m_s2 is not None:
        noise_density = 0.01 * case.coarse_m_s2 / math.sqrt(RATE_HZ)
        triad = replace(grade.accelerometer, lsb_si=case.coarse_m_s2, noise_density=noise_density)
        grade = replace(grade, accelerometer=triad)
    instrument = replace(instrument, grade=grade, effects=case.effects)
    operator = Operator(scheme(POSITIONS).directions(), seed, case.habits, Site())
    return VirtualImu(Imu(instrument, seed, ImuSettings(rate_hz=RATE_HZ)), operator)


def _samples(source: VirtualImu) -> Iterator[Samples]:
    end_s = source.operator.plan_all()
    while source.time_s < end_s + 1.0:
        yield source.next_block(_BLOCK)


def _spoilt(found: StillIntervals, samples: Samples, plain: Samples) -> tuple[float, ...]:
    """Return the share of samples that the effect changed, of each observation where it changed enough."""
    changed = (samples.accelerometer != plain.accelerometer) | (samples.gyroscope != plain.gyroscope)
    begins_s, ends_s = found.observations.start_s, found.observations.start_s + found.observations.duration_s
    rows = zip(samples.time_s.searchsorted(begins_s), samples.time_s.searchsorted(ends_s), strict=True)
    counts = [(int(changed[first:last].sum(axis=0).max()), int(last - first)) for first, last in rows]
    return tuple(count / of for count, of in counts if count >= CLIPPED_SAMPLES and count > CLIPPED_SHARE * of)


def holds_that_should_not_count(context: StudyContext) -> Findings:
    """Count what is kept and what is right of each kind of session."""
    runs = context.runs(60, 1)
    found = dict(zip(CASES, context.campaign_of_each("answers-holds", run_holds, [*CASES.values()], runs), strict=True))
    rows = {
        name: {
            "put down": float(np.mean([run.placements for run in of_case])),
            "counted": float(np.mean([run.counted for run in of_case])),
            "spoilt but counted": float(np.mean([len(run.spoilt) for run in of_case])),
            "within 95 %": float(np.nanmean([run.inside for run in of_case])),
            "good": float(np.mean([run.good for run in of_case])),
            "refused or said": float(np.mean([run.said for run in of_case])),
        }
        for name, of_case in found.items()
    }
    columns = {name: np.array([row[name] for row in rows.values()]) for name in ("within 95 %", "good", "refused or said")}
    return Findings(
        values={
            "runs": runs,
            "cases": rows,
            "clean_said": sum(run.said for run in found["no effect"]),
            "clipped": max((share for run in found[_SILENT_RANGE] for share in run.spoilt), default=0.0),
            "rate_hz": RATE_HZ,
            "foam_deg": FOAM_DEG,
            "foam_s": FOAM_S,
        },
        tables=(keyed_table("cases", "session", rows),),
        draw=figures.bars(tuple(rows), columns, "share"),
    )
