"""Histories of one instrument, solved together: how often the intervals of repeatability and of a new day hold."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.calibrate.sessions.joint import Joint, adjust
from imufield.calibrate.sessions.kinds import PPM
from imufield.dataclass import replace
from imufield.deliver.parameters.gauge_free import GaugeFree
from imufield.deliver.parameters.joined import numbers_of, prior_scales
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import AXES, FloatArray
from imufield.simulate.truth.grades import TrueInstrument, draw_truth
from imufield.study.answers.means import KNOWN, PLACED_M_S2, MeanSession, gauge_free_of, without_quadratic
from imufield.study.answers.tables import Study, Table

DAY_MG = 0.1
DAY_PPM = 60.0
"""What three public sessions of one unit leave possible."""
LENGTHS = (3, 5, 10)
GRADE = GRADES["tactical"]
"""Of the instruments."""


def with_days(sessions: int, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Draw an instrument, calibrate it on some days, and hold the joint result against mean and another day."""
    instrument = without_quadratic(draw_truth(GRADE, rng))
    found = [calibrated(on_another_day(instrument, rng), rng) for _ in range(sessions)]
    (_, reference), *_ = found
    numbers = [numbers_of(calibration, free, reference).own for calibration, free in found]
    joint = adjust(numbers, prior_scales(GRADE))
    scales = np.array([number.value for number in reference.numbers if number.name.startswith("scale")])
    mean, day = (_true(one.accelerometer, scales) for one in (instrument, on_another_day(instrument, rng)))
    return {
        **{f"{kind} interval": _holds(joint, kind, size) for kind, size in (("bias", DAY_MG), ("scale", DAY_PPM))},
        **{f"{kind} day": _inside(joint, kind, joint.daily[kind].day_sigma, day) for kind in ("bias", "scale")},
        **{f"{kind} mean": _inside(joint, kind, joint.daily[kind].mean_sigma, mean) for kind in ("bias", "scale")},
        "outlying": bool(joint.outlying),
        "differs": joint.differs,
        "estimate_mg": joint.daily["bias"].repeatability.sigma,
    }


def on_another_day(instrument: TrueInstrument, rng: np.random.Generator) -> TrueInstrument:
    """Return the instrument as it is on a day drawn at random."""
    own = instrument.accelerometer
    bias = own.bias_m_s2 + DAY_MG * MILLI_G_M_S2 * rng.standard_normal(3)
    scale = own.scale * (1 + DAY_PPM * PPM * rng.standard_normal(3))
    return replace(instrument, accelerometer=replace(own, bias_m_s2=bias, scale=scale))


def calibrated(instrument: TrueInstrument, rng: np.random.Generator) -> tuple[Calibration, GaugeFree]:
    """Return the calibration of a session of 24 positions, and its gauge-free numbers."""
    session = MeanSession(instrument=instrument, gravity_m_s2=STANDARD_GRAVITY_M_S2, scatter_m_s2=PLACED_M_S2).observe(rng)
    calibration = calibrate_accelerometer(session.observations, KNOWN, model="linear", grade=GRADE.name)
    return calibration, gauge_free_of(calibration, session.observations)


def _true(accelerometer: AccelerometerParameters, reference: FloatArray) -> dict[str, FloatArray]:
    scale, bias_raw = intrinsic(to_vector(accelerometer))[0].reshape(4, 3)[:2]
    return {"bias": bias_raw / scale / MILLI_G_M_S2, "scale": (scale / reference - 1) / PPM}


def _holds(joint: Joint, kind: str, true: float) -> bool:
    interval = joint.daily[kind].repeatability
    return interval.low <= true <= interval.high


def _inside(joint: Joint, kind: str, sigma: FloatArray, true: dict[str, FloatArray]) -> NDArray[np.bool_]:
    values = np.array([joint.values[joint.names.index(f"{kind} {axis}")] for axis in AXES])
    return np.asarray(np.abs(values - true[kind]) <= NORMAL_FACTOR_95 * sigma)


_ROWS = {f"{sessions} sessions": partial(with_days, sessions) for sessions in LENGTHS}
histories = Study(
    Table(label="history", campaign="answers-together", rows=_ROWS, runs=(1000, 1)), day_mg=DAY_MG, day_ppm=DAY_PPM
)
