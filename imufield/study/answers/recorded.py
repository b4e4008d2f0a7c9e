"""Sessions simulated sample by sample: holds that should not count, offsets and units of imports, a clock that is wrong.

Each session of holds is simulated twice with the same seed, with and without the effect: the samples that differ are the truth
about which holds the effect has spoilt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from imufield.acquire.clock.host_lag import HostBaseline
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.formats.table_columns import choose_unit
from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95
from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.grades import find_grade
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.uncertainty import rms
from imufield.calibrate.moves.moves import MoveCollector
from imufield.dataclass import replace
from imufield.deliver.parameters.clock import HOST_SIGMA, clock_facts
from imufield.earth import STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError
from imufield.guide.hold.checks import CLIPPED_SAMPLES, CLIPPED_SHARE
from imufield.guide.lead.still_scales import find_scales
from imufield.guide.lead.unguided import StillIntervalFinder, StillIntervals
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import TRIADS, FloatArray, Samples, concatenate
from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import TrueInstrument, draw_truth
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu
from imufield.study.answers.means import answer_of
from imufield.study.answers.tables import Rows, Statistics, Study, Table

HOLDS = 40
OFFSETS_G = (0.0, 0.25, 0.5)
UNITS = {"rad/s": 1.0, "deg/s": math.degrees(1.0)}
"""Raw per rad/s."""
PEAK_DEG_S = (15.0, 400.0)
"""Fastest turn of a person: a careful one, and one in a hurry."""
RATE_HZ = 50.0
MOVES_RATE_HZ = 100.0
LATE_S = 2e-3
"""Mean delay of a read beyond the least: a USB adapter of a computer at work."""
WAITED_S = 0.3
"""What lay at the port when it was opened."""
FOAM_DEG = 3.0
FOAM_S = 5.0
_READ = 4  # Samples.
_BLOCK = 2000
_PLACED = OperatorSettings(hold_s=8.0, initial_still_s=8.0)
_PAPER24 = scheme("paper24").directions()


def _instrument(seed: int) -> TrueInstrument:
    """Return the chip that ``imufield emulate`` draws from this seed."""
    return draw_truth(find_grade("mems"), np.random.default_rng([seed, 401]))


def _blocks(source: VirtualImu, more_s: float = 0.0) -> Iterator[Samples]:
    """Yield the samples of all that is planned, and some seconds more."""
    left = int((source.operator.plan_all() + more_s) / source.interval_s)
    for count in [*[_BLOCK] * (left // _BLOCK), left % _BLOCK]:
        yield source.next_block(count)


def with_effects(
    rng: np.random.Generator, *, effects: Effects = NO_EFFECTS, habits: OperatorSettings = _PLACED, coarse_m_s2: float = 0.0
) -> dict[str, ArrayLike]:
    """Import a session, find its still intervals and calibrate the accelerometer.

    With ``coarse_m_s2`` for a step of the accelerometer its noise is a hundredth of that.
    """
    seed = int(rng.integers(2**31))
    instrument = _instrument(seed)
    grade = instrument.grade
    if coarse_m_s2:
        triad = replace(grade.accelerometer, lsb_si=coarse_m_s2, noise_density=0.01 * coarse_m_s2 / math.sqrt(RATE_HZ))
        grade = replace(grade, accelerometer=triad)
    imus = (
        Imu(replace(instrument, grade=grade, effects=each), seed, ImuSettings(rate_hz=RATE_HZ))
        for each in (NO_EFFECTS, effects)
    )
    plain, source = (VirtualImu(imu, Operator(_PAPER24, seed, habits)) for imu in imus)
    expected, samples = (concatenate(_blocks(each, more_s=1.0)) for each in (plain, source))
    finder = StillIntervalFinder(
        samples.units, RoughScale(accelerometer=grade.accelerometer_scale, gyroscope=grade.gyroscope_scale)
    )
    finder.feed(samples)
    found = finder.finish()
    inside: ArrayLike = np.zeros(12)
    is_good = is_beyond = False
    gravity = Gravity(gravity_m_s2=source.operator.site.gravity_m_s2, sigma_m_s2=1e-5, source="typed")
    with suppress(CalibrationError):
        truth = replace(instrument.accelerometer, bias_m_s2=instrument.accelerometer.bias_m_s2 + source.imu.mean_drift[:3])
        answer = answer_of(calibrate_accelerometer(found.observations, gravity), truth)
        # A term that was left out has no sigma: nothing is stated of it.
        inside = np.where(np.isfinite(answer.over_limit), np.abs(answer.over_limit) <= 1, np.nan)
        is_good = answer.is_good and not found.sticking
        is_beyond = answer.is_good_and_beyond and not found.sticking
    spoilt = _spoilt(found, samples, expected)
    return {
        "put down": len(source.operator.stills),
        "counted": len(found.observations),
        "spoilt but counted": len(spoilt),
        "within 95 %": inside,
        "good": is_good,
        "refused or said": bool(found.refused or found.sticking),
        "most of it spoilt": max(spoilt, default=0.0),
        "good and beyond": is_beyond,
    }


def _spoilt(found: StillIntervals, samples: Samples, expected: Samples) -> list[float]:
    """Return the share of samples that the effect changed, of each observation where it changed enough."""
    changed = (samples.accelerometer != expected.accelerometer) | (samples.gyroscope != expected.gyroscope)
    begins_s, ends_s = found.observations.start_s, found.observations.start_s + found.observations.duration_s
    rows = zip(samples.time_s.searchsorted(begins_s), samples.time_s.searchsorted(ends_s), strict=True)
    counts = [(int(changed[first:last].sum(axis=0).max()), int(last - first)) for first, last in rows]
    return [count / of for count, of in counts if count >= CLIPPED_SAMPLES and count > CLIPPED_SHARE * of]


def with_offset(offset_g: float, unit: str, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Import a table of a chip with this offset on each axis, of any sign; that its gyroscope is in ``unit`` nobody says."""
    drawn = draw_truth(find_grade("mems"), rng)
    offset = STANDARD_GRAVITY_M_S2 * offset_g * rng.choice([-1.0, 1.0], 3)
    truth = replace(drawn, accelerometer=replace(drawn.accelerometer, bias_m_s2=drawn.accelerometer.bias_m_s2 + offset))
    seed, peak = int(rng.integers(1 << 31)), math.radians(math.exp(rng.uniform(*np.log(PEAK_DEG_S))))
    habits = OperatorSettings(hold_s=4.0, initial_still_s=4.0, turn_s=(1.5, 2.5), peak_rate_rad_s=peak)
    operator = Operator(rng.standard_normal((HOLDS, 3)), seed, habits)
    in_si = [*_blocks(VirtualImu(Imu(truth, seed, ImuSettings(rate_hz=RATE_HZ)), operator))]
    table = [replace(block, gyroscope=block.gyroscope * UNITS[unit]) for block in in_si]
    scales = find_scales(table, np.zeros(3))
    chosen, _ = scales.choose({}, TRIADS)
    by_size, _, _ = choose_unit("gyroscope", concatenate(table).gyroscope, {}, {}, has_zero=False)
    # As the session is read once the unit is known.
    finder = StillIntervalFinder(truth.grade.units)
    finder.feed(concatenate(in_si))
    found = finder.finish()
    middles: FloatArray = found.observations.start_s + found.observations.duration_s / 2
    # Share of the true stills, the stay before the first move among them, in which the middle of an observation lies: it may
    # begin before the still, as the end of a slow turn counts as still already.
    kept = float(np.mean([np.any((still.start_s <= middles) & (middles < still.end_s)) for still in operator.stills]))
    true_scale = float(np.mean(truth.gyroscope.scale)) * UNITS[unit]
    return {
        "holds kept": kept,
        "sessions that lose a hold": kept < 1,
        "axes decided": found.axes.agrees is True,
        "unit right": chosen.get("gyroscope") == unit,
        "unit right by size": by_size == unit,
        # NaN where the stills show none.
        "common scale off": abs(scales.scales.get("gyroscope", math.nan) / true_scale - 1),
    }


def moves_of(observations: Observations, collector: MoveCollector, gravity: Gravity, latitude_deg: float) -> GyroscopeInput:
    """Return what the gyroscope is calibrated from, the accelerometer calibrated."""
    calibration = calibrate_accelerometer(observations, gravity)
    moves = collector.finish(observations.start_s, observations.duration_s, observations.middle_s)
    return GyroscopeInput(observations=observations, moves=moves, calibration=calibration, latitude_deg=latitude_deg)


def imported_moves(imu: Imu, operator: Operator) -> GyroscopeInput:
    """Return what an import makes of a whole session: stills, moves between them, and the accelerometer calibrated."""
    units = imu.instrument.grade.units
    finder, collector = StillIntervalFinder(units), MoveCollector(units)
    for block in _blocks(VirtualImu(imu, operator)):
        finder.feed(block)
        collector.feed(block)
    observations, site = finder.finish().observations, operator.site
    gravity = Gravity(gravity_m_s2=site.gravity_m_s2, sigma_m_s2=1e-5, source="measured", latitude_deg=site.latitude_deg)
    return moves_of(observations, collector, gravity, site.latitude_deg)


def with_clock(
    rng: np.random.Generator, *, within: float = 0.0, exactly: float = 0.0, has_host: bool = False
) -> dict[str, ArrayLike]:
    """Calibrate the gyroscope of one session by moves between 24 positions.

    The oscillator is ``exactly`` off, or uniform ``within`` a share; a host stood beside it or not.
    """
    error = exactly or float(rng.uniform(-within, within))
    seed = int(rng.integers(2**31))
    truth = replace(_instrument(seed), clock_error_ppm=1e6 * error)
    operator = Operator(_PAPER24, seed, OperatorSettings(hold_s=5.0, initial_still_s=8.0))
    imu = Imu(truth, seed, ImuSettings(rate_hz=MOVES_RATE_HZ))
    count = int(operator.plan_all() / imu.interval_s)
    found = calibrate_gyroscope(imported_moves(imu, operator)).calibration
    scale, sigma = found.parameters.scale, found.sigma.scale
    true_scale = turn_gyroscope(truth.gyroscope, change_gauge(to_vector(truth.accelerometer), "lower").rotation).scale
    statistics = DecoderStatistics(samples=count, nominal_rate_hz=MOVES_RATE_HZ)
    rate_error = math.nan
    if has_host:
        host_error = HOST_SIGMA * float(rng.standard_normal())
        baseline = _arrivals(count, imu.interval_s * (1 + host_error), rng)
        statistics.rate_hz, statistics.rate_sigma = (1 - (baseline.slope or 0.0)) * MOVES_RATE_HZ, baseline.slope_sigma
        rate_error = statistics.rate_hz * imu.interval_s - 1
    off, limit, by_clock = scale - true_scale, NORMAL_FACTOR_95 * sigma, scale * clock_facts(statistics).sigma
    return {
        "alone": np.abs(off) <= limit,
        "sigmas": off / sigma,
        "absolute": np.abs(off) <= NORMAL_FACTOR_95 * np.hypot(sigma, by_clock),
        # Only K over the period is found.
        "own_clock": np.abs(scale / (1 + error) - true_scale) <= limit,
        "rate_ppm": 1e6 * rate_error,
    }


def _arrivals(count: int, interval_s: float, rng: np.random.Generator) -> HostBaseline:
    """Return what the host knows of samples that it stamps late, the first of which had waited."""
    baseline = HostBaseline()
    taken = np.arange(_READ, count, _READ)
    true_s = taken * interval_s
    late_s = np.maximum(rng.exponential(LATE_S, len(taken)), WAITED_S - true_s)
    for number, arrival_s in zip(taken, true_s + late_s, strict=True):
        baseline.add(float(arrival_s), float(number) / MOVES_RATE_HZ)
    return baseline


_FOAM = replace(_PLACED, hold_s=16.0, settling_rad=math.radians(FOAM_DEG), settling_s=FOAM_S)
_HELD: Rows = {
    "no effect": with_effects,
    "range of 1.02 g without a flag": partial(with_effects, effects=Effects(silent_range_m_s2=1.02 * STANDARD_GRAVITY_M_S2)),
    "all outputs frozen for 12 s": partial(with_effects, effects=Effects(frozen_s=(60.0, 72.0))),
    "one output frozen for 12 s": partial(with_effects, effects=Effects(frozen_s=(60.0, 72.0), frozen_outputs=(1,))),
    "every 256th code 32 wide": partial(with_effects, effects=Effects(sticking_period=256, sticking_width=32)),
    "steps of 5 mg, noise of 0.05 mg": partial(with_effects, coarse_m_s2=0.05),
    "foam": partial(with_effects, habits=_FOAM),
}
_IMPORTED = {f"{offset_g:g} g, {unit}": partial(with_offset, offset_g, unit) for offset_g in OFFSETS_G for unit in UNITS}
_TIMED = {
    "typed rate, exactly 0.5 % off": partial(with_clock, exactly=0.005),
    "typed rate, exactly 3 % off": partial(with_clock, exactly=0.03),
    "typed rate, within 1 %": partial(with_clock, within=0.01),
    "typed rate, within 5 %": partial(with_clock, within=0.05),
    "instrument's time beside the host's, within 1 %": partial(with_clock, within=0.01, has_host=True),
}
_LARGEST = dict.fromkeys(("most of it spoilt", "common scale off"), np.max)
_COUNTED: Statistics = {"within 95 %": np.nanmean, "sigmas": rms, "rate_ppm": rms, **_LARGEST}
holds_that_should_not_count = Study(
    Table(name="cases", label="session", campaign="answers-holds", rows=_HELD, runs=(500, 1), statistics=_COUNTED),
    bars=("within 95 %", "good", "refused or said"),
    rate_hz=RATE_HZ,
    foam_deg=FOAM_DEG,
    foam_s=FOAM_S,
)
_LABEL = "offset on each axis, unit"
offsets = Study(
    Table(name="sessions", label=_LABEL, campaign="answers-offsets", rows=_IMPORTED, runs=(100, 1), statistics=_COUNTED),
    holds=HOLDS + 1,
    peak=PEAK_DEG_S,
)
wrong_clock = Study(Table(label="clock", campaign="answers-clock", rows=_TIMED, runs=(100, 1), statistics=_COUNTED))
