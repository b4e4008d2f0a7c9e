"""Bias and scale over temperature: what order is chosen, and what is left in poses and at temperatures never measured."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.grades import GRADES, Grade
from imufield.calibrate.model.models import at_temperature, predict, recover
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.calibrate.model.rotation import unit_vectors
from imufield.calibrate.model.temperature_polynomials import HIGHEST_ORDER, Polynomials, TriadTemperature, powers
from imufield.calibrate.model.uncertainty import rms
from imufield.calibrate.temperature.fit import RampBlocks, TemperatureData, fit_orders, fit_temperature
from imufield.calibrate.temperature.points import accelerometer_points
from imufield.calibrate.temperature.ramp import RampWindows, cut_ramp
from imufield.dataclass import replace
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray
from imufield.simulate.truth.grades import draw_truth, perfect_instrument
from imufield.study.answers.means import KNOWN, MeanSession
from imufield.study.answers.tables import Rows, Study, Table

REFERENCE_DEGC = 20.0
AWAY_DEGC = 40.0
LAST_SIGMAS = 5.0
"""How well the last coefficient is seen."""
BIAS_PER_DEGC = 0.15 * MILLI_G_M_S2
SCALE_PER_DEGC = 60e-6
_BENT = 0.2  # Share of the quadratic term at 40 degC in the straight line's.
_INDUSTRIAL = GRADES["industrial"]
# Of an ICM-42688: milli-g to tens of them over the range, and a wave that no cubic follows (ArduPilot#27295).
_WAVE_MG = (5.0, 2.0, 1.0, 0.7, 0.5)
_RAMP_S = 7200.0
_WINDOW_S = 10.0
_POSES = 200


def order_of_blocks(order: int, blocks: int, axes: int, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Choose the order of a ramp in blocks; the last coefficient is that of ``axes`` axes alone."""
    unit = np.linspace(-1.0, 1.0, blocks)
    V = np.column_stack([np.ones(blocks), powers(unit, order)])
    last = LAST_SIGMAS * float(np.sqrt(np.linalg.inv(V.T @ V)[-1, -1])) * rng.choice([-1.0, 1.0], 3)
    last[axes:] = 0.0
    truth = V @ np.vstack([LAST_SIGMAS * rng.standard_normal((order, 3)), last])
    ramp = RampBlocks(
        temperature_degc=REFERENCE_DEGC + AWAY_DEGC * unit,
        output=truth + rng.standard_normal(truth.shape),
        sigma=np.ones_like(truth),
        direction=np.ones(blocks),
        specific_force_m_s2=np.zeros(3),
    )
    return _order_found(TemperatureData(reference_degc=REFERENCE_DEGC, ramps=[ramp]), truth, order)


def order_of_wave(rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Choose the order of a recorded ramp whose bias waves as that of an ICM-42688, noise and flicker of a MEMS."""
    time_s = np.arange(0.0, _RAMP_S, _WINDOW_S)
    at_degc = REFERENCE_DEGC + AWAY_DEGC * (1 - 2 * np.abs(2 * time_s / _RAMP_S - 1))
    wave = MILLI_G_M_S2 * np.vstack([np.zeros(3), np.array(_WAVE_MG)[:, None] * rng.choice([-1.0, 1.0], (HIGHEST_ORDER, 3))])
    wave[1:] *= rng.uniform(0.5, 1.5, (HIGHEST_ORDER, 3))
    noise = GRADES["mems"].accelerometer.noise_density / np.sqrt(_WINDOW_S)
    force = np.full((len(time_s), 3), STANDARD_GRAVITY_M_S2 / np.sqrt(3))
    truth = chebyshev.chebval((at_degc - REFERENCE_DEGC) / AWAY_DEGC, wave).T
    output = force + truth + noise * rng.standard_normal(force.shape)
    windows = RampWindows(time_s=time_s, temperature_degc=at_degc, output=output, specific_force_m_s2=force)
    blocks = cut_ramp(windows).blocks
    truth = chebyshev.chebval((blocks.temperature_degc - REFERENCE_DEGC) / AWAY_DEGC, wave).T
    return _order_found(TemperatureData(reference_degc=REFERENCE_DEGC, ramps=[blocks]), truth, HIGHEST_ORDER)


def _order_found(data: TemperatureData, truth: NDArray[np.floating], order: int) -> dict[str, ArrayLike]:
    """Return whether the order is right, and the error over that of the best order."""

    def error(temperature: TriadTemperature) -> float:
        off = temperature.bias.at(data.temperature_degc - data.reference_degc) - truth
        # A constant is the business of the session at the reference.
        return float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)))

    found = fit_temperature(data).temperature
    best = min(error(fit_orders(data, bias, 0).temperature) for bias in range(HIGHEST_ORDER + 1))
    ratio = error(found) / best
    return {"right": found.bias.order == order, "near": ratio <= 1.1, "ratio_95": ratio}


def left_after(repeatability_mg: float, repeatability_ppm: float, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Return the residual specific force, mg, 40 degC from the reference on a new day: one session, one pose, all joined."""
    truth = linear_truth(_INDUSTRIAL, rng)
    range_degc = (REFERENCE_DEGC - AWAY_DEGC, REFERENCE_DEGC + AWAY_DEGC)
    over = cheap_chip(range_degc, np.array([[1.0], [_BENT / AWAY_DEGC]]), np.ones((1, 1)), rng)
    repeated = repeatability_mg * MILLI_G_M_S2, repeatability_ppm

    def day(temperature_degc: float) -> AccelerometerParameters:
        return of_day(at_temperature(truth, over, temperature_degc), *repeated, rng)

    at_degc = [REFERENCE_DEGC - AWAY_DEGC, REFERENCE_DEGC, REFERENCE_DEGC + AWAY_DEGC]
    sessions = [solved(day(temperature_degc), _INDUSTRIAL, rng) for temperature_degc in at_degc]
    base = sessions[1].accelerometer
    ramp = _ramp(truth, over, base, rng)
    points = accelerometer_points(base, sessions, at_degc)
    ways = {
        "one session": None,
        "one pose": fit_temperature(TemperatureData(reference_degc=REFERENCE_DEGC, ramps=[ramp])).temperature,
        "joint": fit_temperature(TemperatureData(reference_degc=REFERENCE_DEGC, points=points, ramps=[ramp])).temperature,
    }
    end_degc = float(rng.choice([at_degc[0], at_degc[2]]))
    up = rng.standard_normal((_POSES, 3))
    force = KNOWN.gravity_m_s2 * unit_vectors(up)
    raw = predict(day(end_degc), force)
    return {name: _rms_mg(base, temperature, raw, end_degc, force=force) for name, temperature in ways.items()}


def linear_truth(grade: Grade, rng: np.random.Generator) -> AccelerometerParameters:
    """Draw an accelerometer as the linear model has it, in its gauge."""
    drawn = draw_truth(grade, rng).accelerometer
    return AccelerometerParameters(
        scale=drawn.scale, bias_m_s2=drawn.bias_m_s2, misalignment_rad=np.tril(drawn.misalignment_rad)
    )


def cheap_chip(
    range_degc: tuple[float, float], bias: FloatArray, scale: FloatArray, rng: np.random.Generator
) -> TriadTemperature:
    """Draw the coefficients of a cheap chip; ``bias`` and ``scale`` say how large those of each order are, shape (order, 1)."""

    def drawn(per_degc: float, sizes: FloatArray) -> Polynomials:
        order = len(sizes)
        return Polynomials(per_degc * sizes * rng.standard_normal((order, 3)), np.zeros((3, order, order)))

    return TriadTemperature(
        reference_degc=REFERENCE_DEGC,
        range_degc=range_degc,
        bias=drawn(BIAS_PER_DEGC, bias),
        scale=drawn(SCALE_PER_DEGC, scale),
        hysteresis=np.full(3, np.nan),
        scale_separated=True,
    )


def of_day(
    there: AccelerometerParameters, bias_m_s2: float, scale_ppm: float, rng: np.random.Generator
) -> AccelerometerParameters:
    """Return the true parameters of one day; days differ by that much, 1 sigma."""
    factor = 1 + 1e-6 * scale_ppm * rng.standard_normal(3)
    return replace(there, scale=there.scale * factor, bias_m_s2=there.bias_m_s2 + bias_m_s2 * rng.standard_normal(3))


def solved(truth: AccelerometerParameters, grade: Grade, rng: np.random.Generator) -> Calibration:
    """Return the calibration of a session of an instrument that is so on its day."""
    instrument = replace(perfect_instrument(grade), accelerometer=truth)
    session = MeanSession(instrument=instrument, gravity_m_s2=KNOWN.gravity_m_s2).observe(rng)
    return calibrate_accelerometer(session.observations, KNOWN, model="linear", grade=grade.name)


def _ramp(
    truth: AccelerometerParameters, over: TriadTemperature, base: AccelerometerParameters, rng: np.random.Generator
) -> RampBlocks:
    """Return a ramp in one pose over the whole range."""
    at_degc = REFERENCE_DEGC + np.linspace(-AWAY_DEGC, AWAY_DEGC, 41)
    up = rng.standard_normal(3)
    pose = KNOWN.gravity_m_s2 * unit_vectors(up)
    raw = np.vstack([predict(at_temperature(truth, over, float(degc)), pose) for degc in at_degc])
    sigma = _INDUSTRIAL.accelerometer.bias_instability
    output = raw / base.scale + sigma * rng.standard_normal(raw.shape)
    return RampBlocks(
        temperature_degc=at_degc,
        output=output,
        sigma=np.full(raw.shape, sigma),
        direction=np.ones(len(at_degc)),
        specific_force_m_s2=output.mean(axis=0) - base.bias_m_s2,
    )


def _rms_mg(
    base: AccelerometerParameters,
    temperature: TriadTemperature | None,
    raw: FloatArray,
    temperature_degc: float,
    *,
    force: FloatArray,
) -> float:
    """Return the RMS of an axis of the corrected specific force less the true one, mg."""
    if temperature is not None:
        raw = temperature.to_reference(raw, np.full(len(raw), temperature_degc), scale=base.scale, raw_zero=base.raw_zero)
    return float(np.sqrt(np.mean((recover(base, raw) - force) ** 2))) / MILLI_G_M_S2


_ORDERS: Rows = {f"order {order}, 20 blocks": partial(order_of_blocks, order, 20, 3) for order in (1, 2, 3)} | {
    "order 3, 40 blocks": partial(order_of_blocks, 3, 40, 3),
    "order 2, 20 blocks, seen in one axis only": partial(order_of_blocks, 2, 20, 1),
    "order 5, a recorded ramp as of an ICM-42688": order_of_wave,
}
_DAYS: Rows = {
    "the same each day": partial(left_after, 0.0, 0.0),
    "repeatability 0.1 mg, 40 ppm": partial(left_after, 0.1, 40.0),
    "repeatability 1 mg, 200 ppm": partial(left_after, 1.0, 200.0),
}
chosen_order = Study(
    Table(
        label="truth",
        campaign="answers-orders",
        rows=_ORDERS,
        runs=(1000, 2),
        statistics={"ratio_95": partial(np.percentile, q=95)},
    )
)
other_poses = Study(
    Table(
        label="instrument",
        campaign="answers-poses",
        rows=_DAYS,
        runs=(300, 1),
        statistics=dict.fromkeys(("one session", "one pose", "joint"), rms),
    )
)
