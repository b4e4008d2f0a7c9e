"""BSAS Tables 1, 2 and 4, IDE Tables 1 and 3: inputs of the papers, and of the simulations here.

These tables are inputs, so there is nothing to reproduce; they are here so that a reader finds every number in one place.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.calibrate.solvers.beetles import BsasSettings
from imufield.calibrate.solvers.triad_costs import TRIAD_NAMES
from imufield.dataclass import asdict
from imufield.earth import MICRO_G_M_S2
from imufield.study import instruments
from imufield.study.bsas_hardware import GYROSCOPE_BIAS_DEG_PER_H, OLD, REPEATABILITY_M_S2
from imufield.study.context import StudyContext
from imufield.study.instruments import BSAS_NAMES, BSAS_TRUTH
from imufield.study.report import Findings


def bsas_table_1(_context: StudyContext) -> Findings:
    """List the true values."""
    return Findings(values={"parameters": dict(zip(BSAS_NAMES, BSAS_TRUTH, strict=True))})


def bsas_table_2(_context: StudyContext) -> Findings:
    """List the settings of the swarm."""
    return Findings(values={"settings": asdict(BsasSettings())})


def bsas_table_4(_context: StudyContext) -> Findings:
    """List the performance of the hardware."""
    return Findings(
        values={
            "bias_ug": OLD.bias_m_s2 / MICRO_G_M_S2,
            "gyroscope_bias_deg_h": GYROSCOPE_BIAS_DEG_PER_H,
            "repeatability_ug": REPEATABILITY_M_S2 / MICRO_G_M_S2,
        }
    )


def ide_table(_context: StudyContext, *, triad: Literal["IDE", "GYROSCOPE"]) -> Findings:
    """List the true values and bounds of a triad."""
    columns = np.transpose([getattr(instruments, f"{triad}_{name}") for name in ("TRUTH", "LOWER", "UPPER")])
    return Findings(values={"parameters": dict(zip(TRIAD_NAMES, columns, strict=True))})
