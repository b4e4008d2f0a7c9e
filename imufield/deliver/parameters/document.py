"""Calibration <-> document: the plain dictionary that the parameter file and ``solve --json`` have in common.

Keys and shapes are docs/parameter-file.md and ``parameters.schema.json``. NaN stands for "not known" or "not estimated".
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    Intrinsic,
    PositionResult,
    Quality,
    SolverSummary,
)
from imufield.deliver.parameters.context import Context, InstrumentFacts, Noise, SessionFacts
from imufield.earth import Gravity
from imufield.samples import FloatArray

Document = dict[str, Any]

FORMAT = "imufield-parameters"
VERSION = 1
GYROSCOPE_EQUATION = "N = K E w + e + G a"

_ACCELEROMETER_VECTORS = ("scale", "bias_m_s2", "misalignment_rad", "quadratic")
_GYROSCOPE_ARRAYS = ("scale", "misalignment_rad", "bias", "g_sensitivity")
_INTRINSIC = (
    "scale",
    "bias_raw",
    "angle_rad",
    "quadratic",
    "scale_sigma",
    "bias_raw_sigma",
    "angle_sigma_rad",
    "quadratic_sigma",
)
_NOISE = (
    "accelerometer_density_m_s2_per_sqrt_hz",
    "gyroscope_density_rad_s_per_sqrt_hz",
    "accelerometer_bias_instability_m_s2",
    "gyroscope_bias_instability_rad_s",
)
_INSTRUMENT = ("driver", "model", "serial_number", "firmware")
_SOLVER = ("method", "seed", "status", "message", "cost", "evaluations")
_QUALITY = (
    "verdict",
    "residual_rms_m_s2",
    "residual_max_m_s2",
    "leave_one_out_rms_m_s2",
    "between_position_sigma_m_s2",
    "degrees_of_freedom",
    "student_factor_95",
    "rank",
    "parameters_fitted",
)
_POSITION_RESULTS = ("residual_m_s2", "leave_one_out_m_s2", "leverage")


def to_document(calibration: Calibration, observations: Observations, context: Context) -> Document:
    """Return everything that is known about a calibration as plain Python values."""
    document: Document = {
        "format": FORMAT,
        "version": VERSION,
        "created": context.created,
        "software": context.software,
        "instrument": _plain(context.instrument, _INSTRUMENT),
        "site": _site(calibration.gravity),
        "session": _session(context.session, len(observations)),
        "accelerometer": _accelerometer(calibration),
    }
    if calibration.gyroscope is not None:
        document["gyroscope"] = _gyroscope(calibration.gyroscope, calibration.gauge)
    if context.noise is not None:
        document["noise"] = noise_table(context.noise)
    document["solver"] = {key: value for key, value in _plain(calibration.solver, _SOLVER).items() if value is not None}
    document["quality"] = _quality(calibration)
    document["position"] = _positions(calibration.positions, observations)
    document["covariance"] = {"names": list(calibration.covariance_names), "matrix": calibration.covariance.tolist()}
    return document


def noise_table(noise: Noise) -> Document:
    """Return the table ``noise`` of a document."""
    return {"source": noise.source} | _lists(noise, _NOISE)


def _lists(source: object, names: tuple[str, ...]) -> Document:
    return {name: np.asarray(getattr(source, name), dtype=np.float64).tolist() for name in names}


def _plain(source: object, names: tuple[str, ...]) -> Document:
    values = {name: getattr(source, name) for name in names}
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in values.items()}


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _site(gravity: Gravity) -> Document:
    return {
        "gravity_m_s2": float(gravity.gravity_m_s2),
        "gravity_sigma_m_s2": float(gravity.sigma_m_s2),
        "gravity_source": gravity.source,
        "latitude_deg": _or_nan(gravity.latitude_deg),
        "height_m": _or_nan(gravity.height_m),
    }


def _session(facts: SessionFacts, positions: int) -> Document:
    return {
        "name": facts.name,
        "sha256": facts.sha256,
        "positions": positions,
        "sample_rate_hz": float(facts.sample_rate_hz),
        "temperature_degc": [float(value) for value in facts.temperature_degc],
    }


def _accelerometer(calibration: Calibration) -> Document:
    parameters = calibration.accelerometer
    return {
        "equation": calibration.equation,
        "raw_unit": calibration.accelerometer_raw_unit,
        "gauge": calibration.gauge,
        **_lists(parameters, ("raw_zero", *_ACCELEROMETER_VECTORS)),
        "quadratic_axes": parameters.quadratic_axes,
        "quadratic_fitted": calibration.quadratic_fitted,
        "uncertainty": _lists(calibration.accelerometer_sigma, _ACCELEROMETER_VECTORS),
        "intrinsic": _lists(calibration.intrinsic, _INTRINSIC),
    }


def gyroscope_bias_rad_s(gyroscope: GyroscopeCalibration) -> tuple[FloatArray, FloatArray]:
    """Return the bias as a rate, ``K^-1 e``, and its 1 sigma, both of shape (3,); NaN where the scale is not known."""
    parameters, sigma = gyroscope.parameters, gyroscope.sigma
    bias_rad_s = parameters.bias / parameters.scale
    # A scale that was not estimated is taken as exact here: what is not known about it stands in its own sigma.
    relative = np.nan_to_num(sigma.scale / parameters.scale)
    return bias_rad_s, np.hypot(sigma.bias / parameters.scale, bias_rad_s * relative)


def _gyroscope(gyroscope: GyroscopeCalibration, gauge: str) -> Document:
    parameters, sigma = gyroscope.parameters, gyroscope.sigma
    bias_rad_s, bias_sigma_rad_s = gyroscope_bias_rad_s(gyroscope)
    return {
        "equation": GYROSCOPE_EQUATION,
        "raw_unit": gyroscope.raw_unit,
        "gauge": gauge,
        "path": gyroscope.path,
        **_lists(parameters, _GYROSCOPE_ARRAYS),
        "bias_rad_s": bias_rad_s.tolist(),
        "uncertainty": _lists(sigma, _GYROSCOPE_ARRAYS) | {"bias_rad_s": bias_sigma_rad_s.tolist()},
    }


def _quality(calibration: Calibration) -> Document:
    quality = calibration.quality
    condition = float(quality.condition)
    return {
        **_plain(quality, _QUALITY),
        "condition": condition if math.isfinite(condition) else math.nan,
        "reasons": list(quality.reasons),
        "unobservable": list(calibration.unobservable),
    }


def _positions(results: PositionResult, observations: Observations) -> list[Document]:
    sigma_raw = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    return [
        {
            "name": observations.name[i],
            "used": bool(results.used[i]),
            "direction": observations.direction[i].tolist(),
            "mean_raw": observations.mean_raw[i].tolist(),
            "sigma_raw": sigma_raw[i].tolist(),
            **{key: float(getattr(observations, key)[i]) for key in ("start_s", "duration_s", "temperature_degc")},
            **{key: float(getattr(results, key)[i]) for key in _POSITION_RESULTS},
        }
        for i in range(len(observations))
    ]


def calibration_from_document(document: Document) -> Calibration:
    """Return the calibration a valid document was made from; the inverse of ``to_document``."""
    accelerometer, site = document["accelerometer"], document["site"]
    quality = document["quality"]
    return Calibration(
        accelerometer=_accelerometer_parameters(accelerometer, accelerometer),
        accelerometer_sigma=_accelerometer_parameters(accelerometer["uncertainty"], accelerometer),
        accelerometer_raw_unit=accelerometer["raw_unit"],
        equation=accelerometer["equation"],
        gauge=accelerometer["gauge"],
        intrinsic=Intrinsic(**_arrays(accelerometer["intrinsic"], _INTRINSIC)),
        covariance_names=tuple(document["covariance"]["names"]),
        covariance=_array(document["covariance"]["matrix"]).reshape(len(document["covariance"]["names"]), -1),
        gravity=Gravity(
            gravity_m_s2=site["gravity_m_s2"],
            sigma_m_s2=site["gravity_sigma_m_s2"],
            source=site["gravity_source"],
            latitude_deg=_or_none(site["latitude_deg"]),
            height_m=_or_none(site["height_m"]),
        ),
        positions=_position_result(document["position"]),
        solver=SolverSummary(**({"seed": None} | document["solver"])),
        quality=Quality(
            **{key: quality[key] for key in _QUALITY}, condition=quality["condition"], reasons=tuple(quality["reasons"])
        ),
        quadratic_fitted=accelerometer["quadratic_fitted"],
        gyroscope=_gyroscope_calibration(document.get("gyroscope")),
        unobservable=tuple(quality["unobservable"]),
    )


def _array(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64)


def _arrays(table: Document, names: tuple[str, ...]) -> dict[str, FloatArray]:
    return {name: _array(table[name]) for name in names}


def _accelerometer_parameters(values: Document, table: Document) -> AccelerometerParameters:
    is_uncertainty = values is not table
    return AccelerometerParameters(
        **_arrays(values, _ACCELEROMETER_VECTORS),
        raw_zero=np.zeros(3) if is_uncertainty else _array(table["raw_zero"]),
        quadratic_axes=table["quadratic_axes"],
    )


def _gyroscope_calibration(table: Document | None) -> GyroscopeCalibration | None:
    if table is None:
        return None
    return GyroscopeCalibration(
        parameters=GyroscopeParameters(**_arrays(table, _GYROSCOPE_ARRAYS)),
        sigma=GyroscopeParameters(**_arrays(table["uncertainty"], _GYROSCOPE_ARRAYS)),
        path=table["path"],
        raw_unit=table["raw_unit"],
    )


def _position_result(tables: list[Document]) -> PositionResult:
    columns = {key: _array([table[key] for table in tables]) for key in _POSITION_RESULTS}
    return PositionResult(**columns, used=np.array([table["used"] for table in tables], dtype=np.bool_))


def context_from_document(document: Document) -> Context:
    """Return the facts beside the numbers of a valid document."""
    session, noise = document["session"], document.get("noise")
    low, high = session["temperature_degc"]
    return Context(
        instrument=InstrumentFacts(**document["instrument"]),
        session=SessionFacts(session["name"], session["sha256"], session["sample_rate_hz"], (low, high)),
        noise=None if noise is None else Noise(source=noise["source"], **_arrays(noise, _NOISE)),
        created=document["created"],
        software=document["software"],
    )
