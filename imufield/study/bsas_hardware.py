"""BSAS Figs. 9 to 11, Tables 5 and 6: the experiments on hardware, with a simulated instrument in its place.

The paper's instrument has 10 ug of accelerometer bias and 0.01 deg/h of gyroscope bias (Table 4). How far its old calibration
was off, and how well a position repeats, is not printed; the figures chosen here are stated in the setting and were not tuned.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from imufield.calibrate.accelerometer.whitening import whitened_problem
from imufield.calibrate.model.models import BIAS, MISALIGNMENT, QUADRATIC, SCALE, from_vector, predict, recover
from imufield.calibrate.solvers.beetles import solve_bsas
from imufield.deliver.navigation.drift import Drift
from imufield.earth import MICRO_G_M_S2
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    BSAS_AXES,
    BSAS_GRAVITY_M_S2,
    BSAS_TRUTH,
    HARBIN_LATITUDE_DEG,
    bsas_directions,
    bsas_outputs,
)
from imufield.study.navigation import WhiteNoise, minute_curves, navigate_at_rest, rest_inputs
from imufield.study.report import Comparison, StudyReport, make_report, numbered_table

REPEATABILITY_M_S2 = 5 * MICRO_G_M_S2
"""1 sigma of the norm of a position: noise of the mean, flicker and turn-on of a 10 ug class instrument."""
OLD_BIAS_M_S2 = 10 * MICRO_G_M_S2
OLD_SCALE = 10e-6
OLD_MISALIGNMENT_RAD = 10e-6
OLD_QUADRATIC = 0.5
"""1 sigma of what the old calibration is off by, quadratic term as a share of itself."""
GYROSCOPE_BIAS_DEG_PER_H = 0.01
HOURS = 5.0
"""As in the paper's Table 6."""
_SETTING = (
    "Instrument of BSAS Tables 1 and 4, simulated in place of the hardware. The old calibration is off by 10 ug, "
    "10 ppm, 10 urad (1 sigma) and half of K2; a position repeats to 5 ug. Recalibrated from 24 positions by bsas."
)


@dataclass(frozen=True, slots=True)
class Recalibration:
    """One instrument, old parameters and new ones, and what each shows at 36 other positions."""

    old: FloatArray
    new: FloatArray
    old_error_ug: FloatArray
    """Eq. 22 at 36 positions."""
    new_error_ug: FloatArray


def run_recalibration(_number: int, rng: np.random.Generator) -> Recalibration:
    """Recalibrate one instrument and check it at 36 positions."""
    # The old calibration, off the truth by a normal error of each kind of parameter.
    size = np.zeros(len(BSAS_TRUTH))
    size[SCALE] = OLD_SCALE * np.abs(BSAS_TRUTH[SCALE])
    size[BIAS] = OLD_BIAS_M_S2
    size[MISALIGNMENT] = OLD_MISALIGNMENT_RAD
    size[QUADRATIC] = OLD_QUADRATIC * np.abs(BSAS_TRUTH[QUADRATIC])
    old = BSAS_TRUTH + size * rng.standard_normal(len(size))
    # 24 positions to calibrate, 36 others to check, each with an error of its own.
    raw = bsas_outputs(rng, REPEATABILITY_M_S2)
    problem = whitened_problem(old, raw, BSAS_GRAVITY_M_S2, quadratic_axes=BSAS_AXES)
    new = problem.vector(solve_bsas(problem, rng=rng).x)
    check = bsas_outputs(rng, REPEATABILITY_M_S2, "paper36")
    # Eq. 22: the norm of a(x) at rest is g, whatever the position.
    norms = (np.linalg.norm(recover(from_vector(vector, None, BSAS_AXES), check), axis=1) for vector in (old, new))
    return Recalibration(old, new, *(np.abs(norm - BSAS_GRAVITY_M_S2) / MICRO_G_M_S2 for norm in norms))


@cache
def _recalibrations(context: StudyContext) -> list[Recalibration]:
    return context.campaign("bsas-table5", run_recalibration, range(context.runs(200, 5)))


def table_5(context: StudyContext) -> StudyReport:
    """Compare the norm error at 36 positions before and after."""
    runs = _recalibrations(context)
    # Mean and standard deviation over the 36 positions, one row per instrument.
    old = np.array([[run.old_error_ug.mean(), run.old_error_ug.std(ddof=1)] for run in runs])
    new = np.array([[run.new_error_ug.mean(), run.new_error_ug.std(ddof=1)] for run in runs])
    comparisons = (
        Comparison("mean error, old parameters (ug)", "12.025", _spread(old[:, 0])),
        Comparison("mean error, recalibrated (ug)", "7.253", _spread(new[:, 0])),
        Comparison("SD of the error, old parameters (ug)", "8.296", _spread(old[:, 1])),
        Comparison("SD of the error, recalibrated (ug)", "4.786", _spread(new[:, 1])),
        Comparison("instruments whose mean error falls", "1 of 1", f"{(new[:, 0] < old[:, 0]).sum()} of {len(runs)}"),
    )
    columns = ("instrument", "old mean", "old SD", "new mean", "new SD")
    return make_report(
        "bsas-table5",
        comparisons,
        tables=(numbered_table("errors", columns, np.hstack([old, new])),),
        draw=figures.runs({"old": old[:, 0], "recalibrated": new[:, 0]}, "mean error (µg)"),
        instrument=_SETTING,
        runs=len(runs),
        shared=directions_shared(),
    )


def _spread(values: FloatArray) -> str:
    low, high = np.quantile(values, [0.05, 0.95])
    return f"{np.median(values):.2f} (5 to 95 %: {low:.2f} to {high:.2f})"


def figure_9(context: StudyContext) -> StudyReport:
    """Show the norm error at each of 36 positions for one instrument."""
    run = _recalibrations(context)[0]
    comparisons = (
        Comparison("range, old parameters (ug)", "1 to 35", f"{run.old_error_ug.min():.1f} to {run.old_error_ug.max():.1f}"),
        Comparison("range, recalibrated (ug)", "1 to 25", f"{run.new_error_ug.min():.1f} to {run.new_error_ug.max():.1f}"),
    )
    rows = zip(run.old_error_ug, run.new_error_ug, strict=True)
    return make_report(
        "bsas-fig9",
        comparisons,
        tables=(numbered_table("errors", ("position", "old (ug)", "recalibrated (ug)"), rows),),
        draw=figures.runs({"old": run.old_error_ug, "recalibrated": run.new_error_ug}, "error (µg)", xlabel="position"),
        instrument=_SETTING,
    )


@dataclass(frozen=True, slots=True)
class Navigation:
    """Five hours with old and new parameters: aligned with each, and told the attitude."""

    old: Drift
    new: Drift
    old_told: Drift
    new_told: Drift


def run_navigation(number: int, rng: np.random.Generator) -> Navigation:
    """Recalibrate one instrument and let it navigate at rest, same recording for both parameter sets."""
    recalibrated = run_recalibration(number, rng)
    heading = 30.0
    force, rate = rest_inputs(HARBIN_LATITUDE_DEG, heading)
    raw = predict(from_vector(BSAS_TRUTH, None, BSAS_AXES), force[None])
    # The static output has the turn-on error of any position.
    raw = raw + BSAS_TRUTH[SCALE] * REPEATABILITY_M_S2 * rng.standard_normal(3)
    rate = rate + np.radians(GYROSCOPE_BIAS_DEG_PER_H / 3600) * rng.choice([-1.0, 1.0], 3)
    seed = int(rng.integers(2**32))
    flown = []
    navigate = partial(navigate_at_rest, rate_rad_s=rate, latitude_deg=HARBIN_LATITUDE_DEG, hours=HOURS, noise=WhiteNoise())
    for told in (None, np.array([0.0, 0.0, heading])):
        for vector in (recalibrated.old, recalibrated.new):
            shown = recover(from_vector(vector, None, BSAS_AXES), raw)[0]
            # The same noise: one recording, two parameter sets.
            flown.append(navigate(shown, rng=np.random.default_rng(seed), attitude_rph_deg=told))
    return Navigation(*flown)


@cache
def _navigations(context: StudyContext) -> list[Navigation]:
    return context.campaign("bsas-table6", run_navigation, range(context.runs(40, 2)))


def table_6(context: StudyContext) -> StudyReport:
    """Compare the position error of five hours at rest before and after."""
    runs = _navigations(context)
    figures_of = {
        name: np.array([[getattr(r, name).position_nmi.max(), getattr(r, name).position_nmi.mean()] for r in runs])
        for name in ("old", "new", "old_told", "new_told")
    }
    change = figures_of["new"][:, 0] / figures_of["old"][:, 0] - 1
    median = np.median(change)
    low, high = np.quantile(change, [0.05, 0.95])
    comparisons = (
        Comparison("maximum error, old parameters (nmi)", "3.1229", _spread(figures_of["old"][:, 0])),
        Comparison("maximum error, recalibrated (nmi)", "3.0273", _spread(figures_of["new"][:, 0])),
        Comparison("mean error, old parameters (nmi)", "1.8165", _spread(figures_of["old"][:, 1])),
        Comparison("mean error, recalibrated (nmi)", "1.7583", _spread(figures_of["new"][:, 1])),
        Comparison("change of the maximum by recalibration", "-3.1 %", f"{median:+.1%} (5 to 95 %: {low:+.1%} to {high:+.1%})"),
        Comparison("maximum error told the attitude, old (nmi)", "not done", _spread(figures_of["old_told"][:, 0])),
        Comparison("maximum error told the attitude, recalibrated (nmi)", "not done", _spread(figures_of["new_told"][:, 0])),
    )
    columns = ("instrument", "old maximum", "old mean", "new maximum", "new mean")
    return make_report(
        "bsas-table6",
        comparisons,
        tables=(numbered_table("errors", columns, np.hstack([figures_of["old"], figures_of["new"]])),),
        draw=figures.bars(("maximum", "mean"), {name: np.median(figures_of[name], axis=0) for name in ("old", "new")}, "nmi"),
        instrument=_SETTING,
        runs=len(runs),
    )


def _first(context: StudyContext) -> dict[str, Drift]:
    run = _navigations(context)[0]
    return {"old": run.old, "recalibrated": run.new}


def figure_10(context: StudyContext) -> StudyReport:
    """Show latitude and longitude error over five hours."""
    runs = _first(context)
    comparisons, panels = [], {}
    for angle, old, recalibrated in (("latitude", "-0.0416", "-0.0402"), ("longitude", "0.0445", "0.0434")):
        curves = {name: (run.hours, getattr(run, f"{angle}_deg")) for name, run in runs.items()}
        panels[f"{angle} error (deg)"] = curves
        comparisons += [
            Comparison(f"{angle} error after 5 h, {name} (deg)", paper, f"{curves[name][1][-1]:.4f}")
            for name, paper in (("old", old), ("recalibrated", recalibrated))
        ]
    return make_report(
        "bsas-fig10",
        comparisons,
        tables=(minute_curves(runs, ("latitude_deg", "longitude_deg")),),
        draw=figures.over_time(panels),
        instrument=_SETTING,
    )


def figure_11(context: StudyContext) -> StudyReport:
    """Show the position error over five hours."""
    runs = _first(context)
    comparisons = tuple(
        Comparison(f"position error, {name} (nmi)", f"maximum {paper}", f"maximum {runs[name].position_nmi.max():.3f}")
        for name, paper in (("old", "3.1229"), ("recalibrated", "3.0273"))
    )
    curves = {name: (run.hours, run.position_nmi) for name, run in runs.items()}
    return make_report(
        "bsas-fig11",
        comparisons,
        tables=(minute_curves(runs, ("position_nmi",)),),
        draw=figures.over_time({"position error (nmi)": curves}),
        instrument=_SETTING,
    )


def directions_shared() -> int:
    """Return how many of the 36 check directions are among the 24 of the calibration."""
    # Unit vectors: their product is 1 where they are the same.
    near = bsas_directions("paper36") @ bsas_directions("paper24").T > 1 - 1e-9
    return int(near.any(axis=1).sum())
