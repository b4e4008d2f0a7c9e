"""Outputs about the middle of a converter: the same parameters for rates, for increments, and without a middle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imufield.dataclass import replace
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.document import gyroscope_bias_rad_s
from imufield.deliver.parameters.file import Parameters
from imufield.earth import choose_gravity
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.samples import FloatArray, Samples, SampleUnits
from imufield.testing import Replayed
from tests.guide.conftest import Path as BodyPath
from tests.guide.guided import find_still_intervals
from tests.told import keys

Solved = Callable[..., Parameters]

RATE_HZ = 100.0
BIAS_RAD_S = np.array([0.01, -0.02, 0.015])
COUNTS_PER_M_S2, COUNTS_PER_RAD_S, MIDDLE = 400.0, 4000.0, 32768.0
"""Of a rate; of an increment a hundredth, about a middle of its own."""


@pytest.fixture(scope="module")
def samples() -> Samples:
    first, *others = scheme("faces6").directions()
    path = BodyPath(RATE_HZ).hold(first, 8)
    for direction in others:
        path.turn(direction, 1.5).hold(direction, 6)
    moved: Samples = path.samples(2e-3, 5e-4, gyroscope_bias=0.0)
    moved.accelerometer[:] *= [1.01, 0.99, 1.02]
    moved.accelerometer[:] += [0.3, -0.2, 0.1]
    moved.gyroscope[:] += BIAS_RAD_S
    return moved


@pytest.fixture
def solved(samples: Samples, tmp_path: Path, imufield_replay: Callable[..., Replayed]) -> Solved:
    """Solve lines of counts about a middle of each triad, of rates (``per_s`` is 1) or of increments."""

    def solve(
        middles: tuple[float, float | FloatArray], stated: float, per_s: float = 1.0, zero: str | None = None
    ) -> Parameters:
        accelerometer = samples.accelerometer * COUNTS_PER_M_S2 / per_s + middles[0]
        gyroscope = samples.gyroscope * COUNTS_PER_RAD_S / per_s + middles[1]
        lines = np.column_stack([samples.time_s, accelerometer, gyroscope])
        np.savetxt(tmp_path / "lines.txt", lines, delimiter=",", fmt="%.9f")
        settings = {
            "accelerometer_unit": "count",
            "gyroscope_unit": "count",
            "raw_zero": str(stated),
            "rate_hz": str(RATE_HZ),
            "increments": str(per_s > 1).lower(),
        }
        session = imufield_replay(tmp_path / "lines.txt", protocol="text", settings=settings)
        return session.solve(gravity_m_s2=9.8, zero=zero)

    return solve


@pytest.mark.parametrize("of_gyroscope", [0.0, MIDDLE])
@pytest.mark.parametrize(
    ("per_s", "zero"), [(1.0, None), (RATE_HZ, None), (RATE_HZ, str(MIDDLE))], ids=["rates", "increments", "typed"]
)
def test_a_raw_zero_is_that_of_one_sample(per_s: float, zero: str | None, of_gyroscope: float, solved: Solved) -> None:
    found = solved((MIDDLE, of_gyroscope), MIDDLE, per_s, zero).calibration
    # Raw rates: counts a second of increments, whose middle is that of a sample over its time.
    np.testing.assert_allclose(found.accelerometer.raw_zero, MIDDLE * per_s)
    np.testing.assert_allclose(found.accelerometer.scale, COUNTS_PER_M_S2 * np.array([1.01, 0.99, 1.02]), rtol=1e-3)
    np.testing.assert_allclose(found.accelerometer.bias_m_s2, np.array([0.3, -0.2, 0.1]) / [1.01, 0.99, 1.02], atol=5e-3)
    assert found.gyroscope is not None
    np.testing.assert_allclose(found.gyroscope.parameters.raw_zero, of_gyroscope * per_s)
    np.testing.assert_allclose(gyroscope_bias_rad_s(found.gyroscope)[0], BIAS_RAD_S, atol=1e-3)
    assert "calibration.raw_zero" not in keys(found.quality.reasons)


@pytest.mark.parametrize(("stated", "zero"), [(0.0, None), (MIDDLE, "32768,32768,32769")])
def test_a_raw_zero_that_is_not_of_both_triads_stays_in_the_gyroscopes_bias(
    stated: float, zero: str | None, solved: Solved, samples: Samples
) -> None:
    found = solved((stated, MIDDLE), stated, zero=zero)
    gyroscope = found.calibration.gyroscope
    assert gyroscope is not None
    assert not gyroscope.parameters.raw_zero.any()
    np.testing.assert_allclose(gyroscope.parameters.bias, MIDDLE + BIAS_RAD_S * COUNTS_PER_RAD_S, atol=5)
    assert "calibration.raw_zero" in keys(found.calibration.quality.reasons)
    raw = np.column_stack([samples.accelerometer * COUNTS_PER_M_S2 + stated, samples.gyroscope * COUNTS_PER_RAD_S + MIDDLE])
    about = gyroscope.parameters.about(np.full(3, MIDDLE))
    same = replace(found, calibration=replace(found.calibration, gyroscope=replace(gyroscope, parameters=about)))
    np.testing.assert_allclose(same.apply(raw), found.apply(raw), atol=1e-9)


@pytest.mark.parametrize("per_s", [1.0, RATE_HZ], ids=["rates", "increments"])
def test_six_numbers_are_of_both_triads(per_s: float, solved: Solved) -> None:
    found = solved((100.0, MIDDLE), 0.0, per_s, f"100,100,100,{MIDDLE},{MIDDLE},{MIDDLE}").calibration
    assert found.gyroscope is not None
    np.testing.assert_allclose(found.accelerometer.raw_zero, 100.0 * per_s)
    np.testing.assert_allclose(found.gyroscope.parameters.raw_zero, MIDDLE * per_s)
    np.testing.assert_allclose(gyroscope_bias_rad_s(found.gyroscope)[0], BIAS_RAD_S, atol=1e-3)


def test_an_axis_that_is_signed_has_no_raw_zero(solved: Solved) -> None:
    found = solved((MIDDLE, np.array([MIDDLE, 0.0, MIDDLE])), MIDDLE).calibration.gyroscope
    assert found is not None
    np.testing.assert_array_equal(found.parameters.raw_zero, [MIDDLE, 0.0, MIDDLE])
    np.testing.assert_allclose(gyroscope_bias_rad_s(found)[0], BIAS_RAD_S, atol=1e-3)


@pytest.mark.parametrize(("raw_zero", "bias"), [(0.0, MIDDLE), (MIDDLE, 0.0)])
def test_a_bias_alone_is_told_in_counts(raw_zero: float, bias: float, samples: Samples) -> None:
    """Without moves nothing says the scale of counts."""
    units = SampleUnits(accelerometer="count", gyroscope="count")
    raw = replace(
        samples,
        accelerometer=samples.accelerometer * COUNTS_PER_M_S2 + raw_zero,
        gyroscope=samples.gyroscope * COUNTS_PER_RAD_S + MIDDLE,
        units=units,
    )
    stills = find_still_intervals([raw], scale=RoughScale(raw_zero=np.full(3, raw_zero))).observations
    measured = SolveInput(observations=stills, gravity=choose_gravity(9.8), context=Context(), raw_zero=np.full(3, raw_zero))
    found = calibrate(measured, SolveSettings()).calibration
    assert found.gyroscope is not None
    assert np.isnan(found.gyroscope.parameters.scale).all()
    np.testing.assert_allclose(found.gyroscope.parameters.bias, bias + BIAS_RAD_S * COUNTS_PER_RAD_S, atol=5)
    assert "calibration.raw_zero" not in keys(found.quality.reasons)
