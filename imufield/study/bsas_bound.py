"""How near least squares comes to the Cramér-Rao bound in the setting of BSAS Table 3, and what the body frame does to it.

With the quadratic term on body axes, as [1]_ prints it, a turn of the body frame is not quite invisible: it moves bias and
quadratic term. Numbers found in two frames can therefore be compared only after one of them is brought to the other's frame,
and on body axes that needs a refit. Three comparisons:

* as solved, in the frame of the preset, against the bound for a frame that is known;
* the same against the bound for a frame known as well as the preset says, which is all that the solver is told;
* refitted in the frame of the truth, against the bound for a known frame.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 4.2.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.model.gauge import change_gauge, intrinsic
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.dataclass import dataclass
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    BSAS_AXES,
    BSAS_GRAVITY_M_S2,
    BSAS_NOISE_M_S2,
    BSAS_TRUTH,
    FIELD_PRESET,
    bsas_outputs,
    bsas_preset,
)
from imufield.study.optimum import INTRINSIC_NAMES, cramer_rao_bound
from imufield.study.report import Findings, keyed_table

TURN_SIGMA_RAD = FIELD_PRESET.misalignment_rad / np.sqrt(6)
"""1 sigma of the turn in a preset whose misalignments are uniform within their limit: a turn is half a difference of two."""


@dataclass(frozen=True, slots=True)
class BoundRun:
    """Gauge-free errors of one data set, shape (12,) each."""

    as_solved: FloatArray
    """In the frame of the preset."""
    in_true_frame: FloatArray
    """Refitted in the frame of the truth."""
    converged: bool


def run_bound(_number: int, rng: np.random.Generator) -> BoundRun:
    """Solve one data set by least squares, then once more in the frame of the truth."""
    raw, preset = bsas_outputs(rng), bsas_preset(rng)
    truth = intrinsic(BSAS_TRUTH, BSAS_AXES)[0]
    # First in the frame of the preset, as a user gets it; then started from the same instrument in the frame of the truth.
    found = _solve(preset, raw)
    again = _solve(change_gauge(found[0], "preset", BSAS_TRUTH).vector, raw)
    return BoundRun(intrinsic(found[0], BSAS_AXES)[0] - truth, intrinsic(again[0], BSAS_AXES)[0] - truth, found[1] and again[1])


def _solve(start: FloatArray, raw: FloatArray) -> tuple[FloatArray, bool]:
    problem = whitened_problem(start, raw, BSAS_GRAVITY_M_S2, quadratic_axes=BSAS_AXES)
    found = solve_least_squares(problem)
    return problem.vector(found.x), found.converged


def bound(turn_sigma_rad: float = 0.0) -> FloatArray:
    """Return the Cramér-Rao bound of the 12 gauge-free numbers for a frame known to this, per axis, shape (12,)."""
    # Noise of zero: the Jacobian is taken at the true outputs, and the generator is not used.
    clean = bsas_outputs(np.random.default_rng(0), 0.0)
    return cramer_rao_bound(
        BSAS_TRUTH, clean, BSAS_GRAVITY_M_S2, BSAS_NOISE_M_S2, quadratic_axes=BSAS_AXES, turn_sigma_rad=turn_sigma_rad
    )


def least_squares_bound(context: StudyContext) -> Findings:
    """Hold least squares against the bounds, over enough data sets that the ratio is known to 2 %."""
    runs = context.campaign("bsas-bound", run_bound, range(context.runs(2000, 20)))
    known, as_preset = bound(), bound(TURN_SIGMA_RAD)
    rmse = {
        name: np.sqrt(np.mean([getattr(run, name) ** 2 for run in runs], axis=0)) for name in ("as_solved", "in_true_frame")
    }
    # The ratio of an RMSE over n runs has a standard deviation of 1 / sqrt(2 n).
    ratios = {
        "as solved, bound of a known frame": rmse["as_solved"] / known,
        "as solved, bound of a frame known as the preset": rmse["as_solved"] / as_preset,
        "in the true frame, bound of a known frame": rmse["in_true_frame"] / known,
    }
    columns = {"bound": known, "bound with frame as the preset": as_preset, **ratios}
    rows = {name: {label: column[k] for label, column in columns.items()} for k, name in enumerate(INTRINSIC_NAMES)}
    return Findings(
        values={
            "converged": sum(run.converged for run in runs),
            "largest": {name: _largest(ratio) for name, ratio in ratios.items()},
            "frame": _largest(as_preset / known),
            "as_solved": _largest(ratios["as solved, bound of a known frame"]),
            # The largest of twelve ratios is within four of their sigmas of one.
            "efficient": ratios["in the true frame, bound of a known frame"].max() < 1 + 4 / np.sqrt(2 * len(runs)),
            "runs": len(runs),
            "known": 1 / np.sqrt(2 * len(runs)),
        },
        tables=(keyed_table("ratios", "number", rows),),
        draw=figures.bars(INTRINSIC_NAMES, ratios, "RMSE over Cramér-Rao bound"),
    )


def _largest(ratio: FloatArray) -> tuple[float, str]:
    worst = int(np.argmax(ratio))
    return ratio[worst], INTRINSIC_NAMES[worst]
