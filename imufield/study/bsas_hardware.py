"""BSAS Figs. 9 to 11, Tables 5 and 6: the experiments on hardware, with a simulated instrument in its place.

The paper's instrument has 10 ug of accelerometer bias and 0.01 deg/h of gyroscope bias (Table 4). How far its old calibration
was off, and how well a position repeats, is not printed; the figures chosen here are stated in the setting and were not tuned.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 5.
"""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.model.models import SCALE, from_vector, predict, recover
from imufield.calibrate.solvers.beetles import solve_bsas
from imufield.dataclass import dataclass
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
    PresetError,
    bsas_directions,
    bsas_outputs,
)
from imufield.study.known_attitudes import fit_known_attitudes
from imufield.study.navigation import minute_curves, navigate_at_rest, rest_inputs
from imufield.study.report import Findings, numbered_table

REPEATABILITY_M_S2 = 5 * MICRO_G_M_S2
"""1 sigma of the norm of a position: noise of the mean, flicker and turn-on of a 10 ug class instrument."""
OLD = PresetError(scale=10e-6, bias_m_s2=10 * MICRO_G_M_S2, misalignment_rad=10e-6, quadratic=0.5)
"""1 sigma of what the old calibration is off by."""
GYROSCOPE_BIAS_DEG_PER_H = 0.01
TURNTABLE_RAD = 5 * math.pi / (180 * 3600)
"""1 sigma, about each axis, of what a position of the turntable is off: 5 arcseconds, a laboratory's with its mounting."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recalibration:
    """One instrument, old parameters and new ones, and what each shows at 36 other positions."""

    old: FloatArray
    new: FloatArray
    old_error_ug: FloatArray
    """Eq. 22 at 36 positions."""
    new_error_ug: FloatArray
    turntable: FloatArray
    """Parameters from the same 24 positions by their attitudes on a turntable, the papers' traditional method."""
    turntable_error_ug: FloatArray


def run_recalibration(_number: int, rng: np.random.Generator) -> Recalibration:
    """Recalibrate one instrument and check it at 36 positions."""
    # The old calibration, off the truth by a normal error of each kind of parameter.
    old = BSAS_TRUTH + OLD.of_each() * rng.standard_normal(len(BSAS_TRUTH))
    # 24 positions to calibrate, 36 others to check, each with an error of its own.
    raw = bsas_outputs(rng, REPEATABILITY_M_S2)
    problem = whitened_problem(old, raw, BSAS_GRAVITY_M_S2, quadratic_axes=BSAS_AXES)
    new = problem.vector(solve_bsas(problem, rng=rng).x)
    check = bsas_outputs(rng, REPEATABILITY_M_S2, "paper36")
    told = bsas_directions() * BSAS_GRAVITY_M_S2
    turntable = fit_known_attitudes(_on_turntable(rng), told, quadratic_axes=BSAS_AXES)
    # Eq. 22: the norm of a(x) at rest is g, whatever the position.
    errors = [
        np.abs(np.linalg.norm(recover(from_vector(vector, None, BSAS_AXES), check), axis=1) - BSAS_GRAVITY_M_S2) / MICRO_G_M_S2
        for vector in (old, new, turntable)
    ]
    return Recalibration(
        old=old, new=new, turntable=turntable, old_error_ug=errors[0], new_error_ug=errors[1], turntable_error_ug=errors[2]
    )


def _on_turntable(rng: np.random.Generator) -> FloatArray:
    """Return the outputs at 24 positions of a turntable that is a little off in each."""
    up = bsas_directions()
    # A small turn by d adds d x up.
    up = up + np.cross(TURNTABLE_RAD * rng.standard_normal(up.shape), up)
    force = BSAS_GRAVITY_M_S2 * up / np.linalg.norm(up, axis=1)[:, None]
    noise = BSAS_TRUTH[SCALE] * REPEATABILITY_M_S2 * rng.standard_normal(up.shape)
    return np.asarray(predict(from_vector(BSAS_TRUTH, None, BSAS_AXES), force) + noise)


@cache
def _recalibrations(context: StudyContext) -> list[Recalibration]:
    return context.campaign("bsas-table5", run_recalibration, range(context.runs(200, 3)))


def table_5(context: StudyContext) -> Findings:
    """Compare the norm error at 36 positions before and after."""
    runs = _recalibrations(context)
    # Mean and standard deviation over the 36 positions, one column per instrument.
    old = np.transpose([[run.old_error_ug.mean(), run.old_error_ug.std(ddof=1)] for run in runs])
    new = np.transpose([[run.new_error_ug.mean(), run.new_error_ug.std(ddof=1)] for run in runs])
    turntable = np.transpose([[run.turntable_error_ug.mean(), run.turntable_error_ug.std(ddof=1)] for run in runs])
    # Unit vectors: their product is 1 where a check direction is one of the calibration.
    near = bsas_directions("paper36") @ bsas_directions("paper24").T > 1 - 1e-9
    shared = int(near.any(axis=1).sum())
    columns = ("instrument", "old mean", "old SD", "new mean", "new SD", "turntable mean", "turntable SD")
    return Findings(
        values={
            "old": old,
            "new": new,
            "turntable": turntable,
            "falls": (new[0] < old[0]).sum(),
            "below": (new[0] < turntable[0]).sum(),
            "mostly": np.mean(new[0] < old[0]) > 0.5,
            "runs": len(runs),
            "shared": shared,
        },
        tables=(numbered_table("errors", columns, np.vstack([old, new, turntable]).T),),
        draw=figures.runs({"old": old[0], "turntable": turntable[0], "recalibrated": new[0]}, "mean error, µg"),
    )


def figure_9(context: StudyContext) -> Findings:
    """Show the norm error at each of 36 positions for one instrument."""
    run = _recalibrations(context)[0]
    rows = zip(run.old_error_ug, run.new_error_ug, strict=True)
    return Findings(
        values={"old": run.old_error_ug, "new": run.new_error_ug},
        tables=(numbered_table("errors", ("position", "old (ug)", "recalibrated (ug)"), rows),),
        draw=figures.runs({"old": run.old_error_ug, "recalibrated": run.new_error_ug}, "error, µg", xlabel="position"),
    )


# Five hours with old parameters, new ones and those of a turntable: aligned with each, and told the attitude.
_FLIGHTS = ("old", "new", "turntable", "old_told", "new_told", "turntable_told")


def run_navigation(number: int, rng: np.random.Generator) -> dict[str, Drift]:
    """Recalibrate one instrument and let it navigate at rest, same recording for all three parameter sets."""
    recalibrated = run_recalibration(number, rng)
    heading = 30.0
    force, rate = rest_inputs(HARBIN_LATITUDE_DEG, heading)
    raw = predict(from_vector(BSAS_TRUTH, None, BSAS_AXES), force[None])
    # The static output has the turn-on error of any position.
    raw = raw + BSAS_TRUTH[SCALE] * REPEATABILITY_M_S2 * rng.standard_normal(3)
    rate = rate + np.radians(GYROSCOPE_BIAS_DEG_PER_H / 3600) * rng.choice([-1.0, 1.0], 3)
    seed = int(rng.integers(2**32))
    flown = []
    navigate = partial(navigate_at_rest, rate_rad_s=rate, latitude_deg=HARBIN_LATITUDE_DEG)
    for told in (None, np.array([0.0, 0.0, heading])):
        for vector in (recalibrated.old, recalibrated.new, recalibrated.turntable):
            shown = recover(from_vector(vector, None, BSAS_AXES), raw)[0]
            # The same noise: one recording, three parameter sets.
            flown.append(navigate(shown, rng=np.random.default_rng(seed), attitude_rph_deg=told))
    return dict(zip(_FLIGHTS, flown, strict=True))


@cache
def _navigations(context: StudyContext) -> list[dict[str, Drift]]:
    return context.campaign("bsas-table6", run_navigation, range(context.runs(40, 1)))


def table_6(context: StudyContext) -> Findings:
    """Compare the position error of five hours at rest before and after."""
    runs = _navigations(context)
    # Maximum and mean over the five hours, one column per instrument.
    found = {
        name: np.transpose([[run[name].position_nmi.max(), run[name].position_nmi.mean()] for run in runs]) for name in _FLIGHTS
    }
    old, new = found["old"], found["new"]
    columns = ("instrument", "old maximum", "old mean", "new maximum", "new mean")
    return Findings(
        values={
            **found,
            "change": new[0] / old[0] - 1,
            "against_turntable": new[0] / found["turntable"][0] - 1,
            "rises": (new[0] > old[0]).sum(),
            "either_sign": 0 < (new[0] > old[0]).sum() < len(runs),
            "runs": len(runs),
        },
        tables=(numbered_table("errors", columns, np.vstack([old, new]).T),),
        draw=figures.bars(
            ("maximum", "mean"), {name: np.median(found[name], axis=1) for name in ("old", "new")}, "position error, nmi"
        ),
    )


def _first(context: StudyContext) -> dict[str, Drift]:
    run = _navigations(context)[0]
    return {"old": run["old"], "recalibrated": run["new"]}


def figure_10(context: StudyContext) -> Findings:
    """Show latitude and longitude error over five hours."""
    runs = _first(context)
    curves = {
        f"{angle} error": {name: (run.hours, getattr(run, f"{angle}_deg")) for name, run in runs.items()}
        for angle in ("latitude", "longitude")
    }
    errors = {
        f"{angle} after 5 h, {name}": degrees[-1] for angle, of_run in curves.items() for name, (_, degrees) in of_run.items()
    }
    apart = max(np.abs(of_run["old"][1] - of_run["recalibrated"][1]).max() for of_run in curves.values())
    largest = max(np.abs(of_run["old"][1]).max() for of_run in curves.values())
    return Findings(
        values={"errors": errors, "apart": apart, "largest": largest, "together": apart < largest / 10},
        tables=(minute_curves(runs, ("latitude_deg", "longitude_deg")),),
        draw=figures.over_time({f"{angle}, deg": of_run for angle, of_run in curves.items()}),
    )


def figure_11(context: StudyContext) -> Findings:
    """Show the position error over five hours."""
    runs = _first(context)
    curves = {name: (run.hours, run.position_nmi) for name, run in runs.items()}
    return Findings(
        values={"errors": {name: run.position_nmi for name, run in runs.items()}},
        tables=(minute_curves(runs, ("position_nmi",)),),
        draw=figures.over_time({"position error, nmi": curves}),
    )
