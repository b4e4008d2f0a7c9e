"""A gyroscope whose scale depends on sense and size of the rate: how often it is named, and what the stated sigma is worth."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.model_choice import typical_rate_terms
from imufield.calibrate.gyroscope.result import JointSolution, joint_result
from imufield.calibrate.gyroscope.turntable import TurntableRun
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95
from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.models import predict_gyroscope, to_vector
from imufield.calibrate.model.result import GyroscopeParameters
from imufield.dataclass import replace
from imufield.guide.positions import scheme
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import TrueInstrument
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import OperatorSettings
from imufield.study.answers.recorded import MOVES_RATE_HZ as RATE_HZ
from imufield.study.answers.recorded import imported_moves
from imufield.study.answers.tables import Rows, Study, Table

ASYMMETRY_PPM = 500.0
"""Between positive and negative rates."""
NONLINEARITY_PPM = 1000.0
AT_DEG_S = 200.0
TABLE_DEG_S = (25.0, 50.0, 100.0, 200.0)
_TABLE_S = 20.0


def with_rates(
    rng: np.random.Generator,
    *,
    grade: str,
    asymmetry_ppm: float = 0.0,
    nonlinearity_ppm: float = 0.0,
    has_turntable: bool = False,
    is_typical: bool = False,
) -> dict[str, ArrayLike]:
    """Calibrate the gyroscope of one session by moves between 24 positions.

    Both effects are as large as told, of any sign, or drawn from what is typical of the grade.
    """
    habits = OperatorSettings(hold_s=5.0, initial_still_s=8.0)
    seed = int(rng.integers(2**31))
    drawn = make_virtual_imu(
        Emulation(rate_hz=RATE_HZ, seed=seed, grade=grade, directions=scheme("paper24").directions(), operator=habits)
    )
    asymmetry, cubic = (
        (float(x), float(y), float(z))
        for x, y, z in rng.choice([-1e-6, 1e-6], (2, 3)) * [[asymmetry_ppm / 2], [nonlinearity_ppm / np.radians(AT_DEG_S) ** 2]]
    )
    effects = _typical(grade, rng) if is_typical else Effects(gyroscope_asymmetry=asymmetry, gyroscope_cubic=cubic)
    truth = replace(drawn.imu.instrument, clock_error_ppm=0.0, effects=effects)
    given = replace(imported_moves(Imu(truth, seed, drawn.imu.settings), drawn.operator), grade=grade)
    gyroscope = turn_gyroscope(truth.gyroscope, change_gauge(to_vector(truth.accelerometer), "lower").rotation)
    if has_turntable:
        given = replace(given, turntable=_turntable(truth, gyroscope, rng))
    found = calibrate_gyroscope(given)
    solution = found.basis
    assert isinstance(solution, JointSolution)  # noqa: S101  (there are moves)
    linearity = solution.linearity
    nothing = replace(linearity, moved=np.zeros_like(linearity.moved), hidden_root=np.zeros_like(linearity.hidden_root))
    untested = joint_result(replace(solution, linearity=nothing))
    # The scales as they would be without the test, and with it.
    before, after = (
        np.abs(each.calibration.parameters.scale - gyroscope.scale) <= NORMAL_FACTOR_95 * each.calibration.sigma.scale
        for each in (untested, found)
    )
    named = {told.key for told in linearity.sentences}
    return {
        "asymmetry": "model_choice.asymmetry" in named,
        "nonlinearity": "model_choice.nonlinearity" in named,
        "lowers": linearity.matters,
        "before": before,
        "after": after,
        "right": linearity.matters | after,
    }


def _typical(grade: str, rng: np.random.Generator) -> Effects:
    """Draw terms up to the full range, as ``check_linearity`` takes them to be."""
    range_rad_s = GRADES[grade].gyroscope.range_si
    drawn = typical_rate_terms(np.full(3, range_rad_s), GRADES[grade]) * rng.standard_normal(6)
    x, y, z, *cubic = (float(size) for size in drawn * np.repeat([1.0, range_rad_s**-2], 3))
    return Effects(gyroscope_asymmetry=(x, y, z), gyroscope_cubic=(cubic[0], cubic[1], cubic[2]))


def _turntable(truth: TrueInstrument, gyroscope: GyroscopeParameters, rng: np.random.Generator) -> list[TurntableRun]:
    """Return the means of runs about each axis at several rates, both ways, in the frame of the calibration."""
    sigma = truth.gyroscope.scale * truth.grade.gyroscope.noise_density / np.sqrt(_TABLE_S)
    runs = []
    for axis in np.eye(3):
        for rate_rad_s in np.radians([way * rate for rate in TABLE_DEG_S for way in (1.0, -1.0)]):
            rate = truth.effects.distorted_rate(rate_rad_s * axis[np.newaxis])
            mean_raw = predict_gyroscope(gyroscope, rate, 9.8 * axis[np.newaxis])[0] + sigma * rng.standard_normal(3)
            runs.append(
                TurntableRun(
                    axis=axis, rate_rad_s=float(rate_rad_s), mean_raw=mean_raw, covariance_raw=np.diag(sigma**2),
                    rate_sigma_rad_s=1e-5 * abs(rate_rad_s), axis_sigma_rad=1e-4,
                )
            )  # fmt: skip
    return runs


def _typical_sigmas(grade: str) -> float:
    """Return the nonlinearity in sigmas of what is typical of a grade."""
    typical = typical_rate_terms(np.full(3, np.radians(AT_DEG_S)), GRADES[grade])
    return 1e-6 * NONLINEARITY_PPM / float(typical[3])


_SIZES = {
    "no effect": (0.0, 0.0),
    "asymmetry": (ASYMMETRY_PPM, 0.0),
    "nonlinearity": (0.0, NONLINEARITY_PPM),
}
_ROWS: Rows = {
    f"{what}, {grade}{', turntable' if has_turntable else ''}": partial(
        with_rates, grade=grade, asymmetry_ppm=asymmetry_ppm, nonlinearity_ppm=nonlinearity_ppm, has_turntable=has_turntable
    )
    for grade, has_turntable in (("industrial", False), ("mems", False), ("industrial", True))
    for what, (asymmetry_ppm, nonlinearity_ppm) in _SIZES.items()
} | {f"typical, {grade}": partial(with_rates, grade=grade, is_typical=True) for grade in GRADES}
slow_and_fast = Study(
    Table(label="session", campaign="answers-rates", rows=_ROWS, runs=(400, 1)),
    asymmetry_ppm=ASYMMETRY_PPM,
    nonlinearity_ppm=NONLINEARITY_PPM,
    at_deg_s=AT_DEG_S,
    industrial_sigmas=_typical_sigmas("industrial"),
    mems_sigmas=_typical_sigmas("mems"),
)
