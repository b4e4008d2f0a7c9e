"""BSAS Tables 1, 2 and 4, IDE Tables 1 and 3: inputs of the papers, and of the simulations here.

These tables are inputs, so there is nothing to reproduce; they are here so that a reader finds every number in one place.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial

from imufield.calibrate.solvers.beetles import BsasSettings
from imufield.calibrate.solvers.triad_costs import TRIAD_NAMES
from imufield.earth import MICRO_G_M_S2
from imufield.samples import FloatArray
from imufield.study.bsas_hardware import GYROSCOPE_BIAS_DEG_PER_H, OLD_BIAS_M_S2, REPEATABILITY_M_S2
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    BSAS_NAMES,
    BSAS_TRUTH,
    GYROSCOPE_LOWER,
    GYROSCOPE_TRUTH,
    GYROSCOPE_UPPER,
    IDE_LOWER,
    IDE_TRUTH,
    IDE_UPPER,
)
from imufield.study.report import Comparison, StudyReport, make_report


def bsas_table_1(_context: StudyContext) -> StudyReport:
    """List the true values."""
    # As text, digit by digit: a number would be printed anew.
    printed = (
        "-734.949141", "-738.738914", "-714.409875", "0.00654668", "-0.04285332", "0.01471738", "0.00050230", "0.00068317",
        "-0.00048500", "-0.00035363", "0.00023193", "-0.00003365", "0.003654", "0.000644", "-0.002654",
    )  # fmt: skip
    return make_report(
        "bsas-table1",
        tuple(
            Comparison(name, paper, f"{ours:.9g}") for name, paper, ours in zip(BSAS_NAMES, printed, BSAS_TRUTH, strict=True)
        ),
        columns=("parameter", "paper", "taken"),
    )


def bsas_table_2(_context: StudyContext) -> StudyReport:
    """List the settings of the swarm."""
    printed = {"m": "10", "p_pos": "0.8", "p_st": "0.8", "n_st": "2", "s": "0.98", "c_s": "0.9", "d": "2", "c_d": "0.9"}
    printed |= {"s_0": "2.22e-16", "d_0": "2.22e-16", "k_max": "300", "tolerance": "none"}
    settings = BsasSettings()
    names = [field.name for field in fields(settings)]
    return make_report(
        "bsas-table2",
        tuple(Comparison(name, printed[name], f"{getattr(settings, name):g}") for name in names),
        columns=("setting", "paper", "taken"),
    )


def bsas_table_4(_context: StudyContext) -> StudyReport:
    """List the performance of the hardware."""
    return make_report(
        "bsas-table4",
        (
            Comparison("accelerometer constant bias (ug)", "10", f"{OLD_BIAS_M_S2 / MICRO_G_M_S2:g}"),
            Comparison("accelerometer dynamic range (g)", "60", "not simulated"),
            Comparison("gyroscope constant bias (deg/h)", "0.01", f"{GYROSCOPE_BIAS_DEG_PER_H:g}"),
            Comparison("repeatability of a position (ug)", "not given", f"{REPEATABILITY_M_S2 / MICRO_G_M_S2:g}"),
        ),
        columns=("figure", "paper", "taken"),
    )


def _triad(_context: StudyContext, *, name: str, truth: FloatArray, lower: FloatArray, upper: FloatArray) -> StudyReport:
    """List the true values and bounds of a triad."""
    rows = zip(TRIAD_NAMES, truth, lower, upper, strict=True)
    return make_report(
        name,
        tuple(Comparison(label, f"{x:.10g}", f"{x:.10g}, bounds {low:g} to {high:g}") for label, x, low, high in rows),
        columns=("parameter", "paper", "taken"),
    )


ide_table_1 = partial(_triad, name="ide-table1", truth=IDE_TRUTH, lower=IDE_LOWER, upper=IDE_UPPER)
ide_table_3 = partial(_triad, name="ide-table3", truth=GYROSCOPE_TRUTH, lower=GYROSCOPE_LOWER, upper=GYROSCOPE_UPPER)
