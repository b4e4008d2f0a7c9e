"""Calibration <-> document: the plain dictionary that the parameter file and ``solve --json`` have in common.

Keys and shapes are docs/parameter-file.md and ``parameters.schema.json``. NaN stands for "not known" or "not estimated".
"""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.model.budget import Share
from imufield.calibrate.model.higher_terms import HigherTerms
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
from imufield.dataclass import asdict, fields
from imufield.deliver.parameters.context import (
    ClockFacts,
    Context,
    DayToDay,
    InstrumentFacts,
    JoinedSession,
    Noise,
    SessionFacts,
    Together,
)
from imufield.deliver.parameters.schema import Document
from imufield.deliver.parameters.temperature_tables import (
    VERSION_WITH_TEMPERATURE,
    add_temperature,
    temperature_of,
    temperature_sources,
)
from imufield.earth import Gravity
from imufield.samples import FloatArray

# docs/parameter-file.md; VERSION rises where an old program would misread a new file. Written is the lowest that can say what
# a file says: a program that knows no temperature reads all files without one.
FORMAT = "imufield-parameters"
VERSION = VERSION_WITH_TEMPERATURE
VERSION_WITHOUT_TEMPERATURE = 1
_GYROSCOPE_EQUATION = "N = K E w + e + G a"

_ACCELEROMETER_VECTORS = ("scale", "bias_m_s2", "misalignment_rad", "quadratic")
_SOLVER = ("method", "seed", "status", "message", "cost", "evaluations")


def _names(kind: type, *without: str) -> tuple[str, ...]:
    """Return the fields of a dataclass, which are keys of the file in the same order, less some."""
    return tuple(field.name for field in fields(kind) if field.name not in without)


_GYROSCOPE_ARRAYS = _names(GyroscopeParameters, "raw_zero")
_INTRINSIC = _names(Intrinsic)
_HIGHER = _names(HigherTerms)
_NOISE = _names(Noise, "source")
_CLOCK = _names(ClockFacts)
_TRIAD_VERDICTS = ("accelerometer_verdict", "gyroscope_verdict")
_QUALITY_LISTS = ("reasons", "warnings", "suspects")
_QUALITY_FIGURES = _names(Quality, "verdict", *_QUALITY_LISTS, *_TRIAD_VERDICTS)
_POSITION_RESULTS = _names(PositionResult, "used", "bias_drift_m_s2")


def to_document(calibration: Calibration, observations: Observations | None, context: Context) -> Document:
    """Return everything that is known about a calibration as plain Python values; ``observations`` is None of no position."""
    gravity, session = calibration.gravity, context.session
    parameters, quality, gyroscope = calibration.accelerometer, calibration.quality, calibration.gyroscope
    document: Document = {
        "format": FORMAT,
        "version": VERSION_WITHOUT_TEMPERATURE,
        "created": context.created,
        "software": context.software,
        "instrument": _plain(context.instrument, _names(InstrumentFacts)),
        "site": {
            "gravity_m_s2": float(gravity.gravity_m_s2),
            "gravity_sigma_m_s2": float(gravity.sigma_m_s2),
            "gravity_source": gravity.source,
            "latitude_deg": _or_nan(gravity.latitude_deg),
            "height_m": _or_nan(gravity.height_m),
        },
        "session": {
            "name": session.name,
            "sha256": session.sha256,
            "positions": len(calibration.positions.used),
            "sample_rate_hz": float(session.sample_rate_hz),
            "temperature_degc": [float(value) for value in session.temperature_degc],
            **({"recorded": session.recorded} if session.recorded else {}),
            **({"sensor_offset_degc": list(session.sensor_offset_degc)} if session.sensor_offset_degc else {}),
        },
        "accelerometer": {
            "equation": calibration.equation,
            "raw_unit": calibration.accelerometer_raw_unit,
            "gauge": calibration.gauge,
            **_lists(parameters, ("raw_zero", *_ACCELEROMETER_VECTORS)),
            "quadratic_axes": parameters.quadratic_axes,
            "quadratic_fitted": calibration.quadratic_fitted,
            # At rest nothing else is seen.
            "range_m_s2": float(gravity.gravity_m_s2),
            "uncertainty": _lists(calibration.accelerometer_sigma, _ACCELEROMETER_VECTORS),
            "intrinsic": _lists(calibration.intrinsic, _INTRINSIC),
        },
    }
    if parameters.higher is not None:
        document["accelerometer"]["higher"] = _lists(parameters.higher, _HIGHER) | {
            f"{key}_sigma": values for key, values in _lists(calibration.accelerometer_sigma.higher, _HIGHER).items()
        }
    if gyroscope is not None:
        document["gyroscope"] = _gyroscope_table(gyroscope, calibration.gauge, context.clock)
    document |= _context_tables(context)
    # A method that draws nothing has no seed, and TOML no null.
    document["solver"] = {key: value for key, value in _plain(calibration.solver, _SOLVER).items() if value is not None}
    document["quality"] = {
        **_plain(quality, ("verdict", *_QUALITY_FIGURES)),
        # Infinite where the positions leave a parameter open, which the file calls not known.
        "condition": float(quality.condition) if math.isfinite(quality.condition) else math.nan,
        **judgement(quality),
        "unobservable": list(calibration.unobservable),
    }
    document["position"] = [] if observations is None else _positions(calibration.positions, observations)
    document["covariance"] = {"names": list(calibration.covariance_names), "matrix": calibration.covariance.tolist()}
    if calibration.budget:
        document["budget"] = {"share": [_share_table(share) for share in calibration.budget]}
    return add_temperature(document, calibration, context.temperature_sources)


def judgement(quality: Quality) -> Document:
    """Return verdicts and sentences, keys of ``[quality]``."""
    return {
        "verdict": quality.verdict,
        **{key: value for key, value in _plain(quality, _TRIAD_VERDICTS).items() if value},
        **{key: list(getattr(quality, key)) for key in _QUALITY_LISTS if key != "suspects" or quality.suspects},
    }


def _share_table(share: Share) -> Document:
    """Return the table of a share; a key is absent where there is nothing to say."""
    freedom = {"degrees_of_freedom": float(share.degrees_of_freedom)}
    source = {"input_sigma": float(share.input_sigma), "input_unit": share.input_unit}
    return {
        "name": share.name,
        "type": share.kind,
        **({"residuals": share.residuals} if share.residuals else {}),
        **(freedom if math.isfinite(share.degrees_of_freedom) else {}),
        **(source if math.isfinite(share.input_sigma) else {}),
        "sigma": share.sigma.tolist(),
    }


def _share(table: Document) -> Share:
    return Share(
        name=table["name"],
        kind=table["type"],
        residuals=table.get("residuals", ""),
        degrees_of_freedom=float(table.get("degrees_of_freedom", math.inf)),
        input_sigma=float(table.get("input_sigma", math.nan)),
        input_unit=table.get("input_unit", ""),
        sigma=_array(table["sigma"]),
    )


def _context_tables(context: Context) -> Document:
    """Return the tables of what may not be known."""
    tables: Document = {}
    if context.clock is not None:
        tables["clock"] = _plain(context.clock, _CLOCK)
    if context.noise is not None:
        tables["noise"] = noise_table(context.noise)
    if context.together is not None:
        tables["together"] = _together_table(context.together)
    return tables


def _together_table(together: Together) -> Document:
    days = (
        {**asdict(kind), "mean_sigma": [*kind.mean_sigma], "day_sigma": [*kind.day_sigma]} for kind in together.repeatability
    )
    sessions = [asdict(session) for session in together.session]
    return {"prior_grade": together.prior_grade, "session": sessions, "repeatability": [*days]}


def _gyroscope_table(gyroscope: GyroscopeCalibration, gauge: str, clock: ClockFacts | None) -> Document:
    bias_rad_s, bias_sigma_rad_s = gyroscope_bias_rad_s(gyroscope)
    uncertainty = _lists(gyroscope.sigma, _GYROSCOPE_ARRAYS) | {"bias_rad_s": bias_sigma_rad_s.tolist()}
    if clock is not None:
        by_clock = gyroscope.parameters.scale * clock.sigma
        uncertainty["scale_absolute"] = np.hypot(gyroscope.sigma.scale, by_clock).tolist()
    return {
        "equation": gyroscope_equation(gyroscope.parameters),
        "raw_unit": gyroscope.raw_unit,
        # Without one the file stays as it was: earlier programs read it.
        **(_lists(gyroscope.parameters, ("raw_zero",)) if np.any(gyroscope.parameters.raw_zero) else {}),
        "gauge": gauge,
        "path": gyroscope.path,
        "range_rad_s": gyroscope.range_rad_s.tolist(),
        **_lists(gyroscope.parameters, _GYROSCOPE_ARRAYS),
        "bias_rad_s": bias_rad_s.tolist(),
        "uncertainty": uncertainty,
    }


def gyroscope_equation(parameters: GyroscopeParameters) -> str:
    """Return the equation of a gyroscope, with ``raw_zero`` where it has one."""
    return _GYROSCOPE_EQUATION.replace("N =", "N - raw_zero =") if np.any(parameters.raw_zero) else _GYROSCOPE_EQUATION


def noise_table(noise: Noise) -> Document:
    """Return the table ``noise`` of a document."""
    return {"source": noise.source} | _lists(noise, _NOISE)


def gyroscope_bias_rad_s(gyroscope: GyroscopeCalibration) -> tuple[FloatArray, FloatArray]:
    """Return the bias as a rate, ``K^-1 e``, and its 1 sigma, both of shape (3,); NaN where the scale is not known."""
    parameters, sigma = gyroscope.parameters, gyroscope.sigma
    bias_rad_s = parameters.bias / parameters.scale
    # A scale that was not estimated is taken as exact here: what is not known about it stands in its own sigma.
    relative = np.nan_to_num(sigma.scale / parameters.scale)
    return bias_rad_s, np.hypot(sigma.bias / parameters.scale, bias_rad_s * relative)


def _lists(source: object, names: tuple[str, ...]) -> Document:
    return {name: np.asarray(getattr(source, name), dtype=np.float64).tolist() for name in names}


def _plain(source: object, names: tuple[str, ...]) -> Document:
    values = {name: getattr(source, name) for name in names}
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in values.items()}


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


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
            # Only where one was fitted.
            **({"bias_drift_m_s2": drift.tolist()} if np.any(results.bias_drift_m_s2) else {}),
        }
        for i, drift in enumerate(results.bias_drift_m_s2)
    ]


def calibration_from_document(document: Document) -> Calibration:
    """Return the calibration a valid document was made from; the inverse of ``to_document``."""
    accelerometer, gyroscope, site = document["accelerometer"], document.get("gyroscope"), document["site"]
    quality, covariance, positions = document["quality"], document["covariance"], document["position"]
    axes = accelerometer["quadratic_axes"]
    return Calibration(
        accelerometer=AccelerometerParameters(
            **_arrays(accelerometer, ("raw_zero", *_ACCELEROMETER_VECTORS)), quadratic_axes=axes, higher=_higher(accelerometer)
        ),
        accelerometer_sigma=AccelerometerParameters(
            **_arrays(accelerometer["uncertainty"], _ACCELEROMETER_VECTORS),
            quadratic_axes=axes,
            higher=_higher(accelerometer, "_sigma"),
        ),
        accelerometer_raw_unit=accelerometer["raw_unit"],
        equation=accelerometer["equation"],
        gauge=accelerometer["gauge"],
        intrinsic=Intrinsic(**_arrays(accelerometer["intrinsic"], _INTRINSIC)),
        covariance_names=tuple(covariance["names"]),
        covariance=_array(covariance["matrix"]).reshape(len(covariance["names"]), -1),
        gravity=Gravity(
            gravity_m_s2=site["gravity_m_s2"],
            sigma_m_s2=site["gravity_sigma_m_s2"],
            source=site["gravity_source"],
            latitude_deg=_or_none(site["latitude_deg"]),
            height_m=_or_none(site["height_m"]),
        ),
        positions=PositionResult(
            **{key: _array([table[key] for table in positions]) for key in _POSITION_RESULTS},
            used=np.array([table["used"] for table in positions], dtype=np.bool_),
            bias_drift_m_s2=_array([table.get("bias_drift_m_s2", [0.0] * 3) for table in positions]).reshape(-1, 3),
        ),
        solver=SolverSummary(**document["solver"]),
        quality=Quality(
            verdict=quality["verdict"],
            **{key: quality[key] for key in _QUALITY_FIGURES},
            reasons=tuple(quality["reasons"]),
            warnings=tuple(quality.get("warnings", ())),
            suspects=tuple(quality.get("suspects", ())),
            **{key: quality.get(key, "") for key in _TRIAD_VERDICTS},
        ),
        quadratic_fitted=accelerometer["quadratic_fitted"],
        gyroscope=None
        if gyroscope is None
        else GyroscopeCalibration(
            parameters=GyroscopeParameters(
                **_arrays(gyroscope, _GYROSCOPE_ARRAYS), raw_zero=_array(gyroscope.get("raw_zero", [0.0] * 3))
            ),
            sigma=GyroscopeParameters(**_arrays(gyroscope["uncertainty"], _GYROSCOPE_ARRAYS)),
            path=gyroscope["path"],
            raw_unit=gyroscope["raw_unit"],
            range_rad_s=_array(gyroscope.get("range_rad_s", [np.nan] * 3)),
            temperature=temperature_of(document, "gyroscope"),
        ),
        unobservable=tuple(quality["unobservable"]),
        accelerometer_temperature=temperature_of(document, "accelerometer"),
        budget=tuple(_share(table) for table in document.get("budget", {}).get("share", ())),
    )


def _array(values: object) -> FloatArray:
    return np.array(values, dtype=np.float64)


def _higher(accelerometer: Document, suffix: str = "") -> HigherTerms | None:
    table = accelerometer.get("higher")
    return None if table is None else HigherTerms(**{key: _array(table[key + suffix]) for key in _HIGHER})


def _arrays(table: Document, names: tuple[str, ...]) -> dict[str, FloatArray]:
    return {name: _array(table[name]) for name in names}


def context_from_document(document: Document) -> Context:
    """Return the facts beside the numbers of a valid document."""
    session, noise = document["session"], document.get("noise")
    low, high = session["temperature_degc"]
    return Context(
        instrument=InstrumentFacts(**document["instrument"]),
        session=SessionFacts(
            name=session["name"],
            sha256=session["sha256"],
            sample_rate_hz=session["sample_rate_hz"],
            temperature_degc=(low, high),
            recorded=session.get("recorded", ""),
            sensor_offset_degc=tuple(session.get("sensor_offset_degc", ())),
        ),
        clock=None if "clock" not in document else ClockFacts(**document["clock"]),
        noise=None if noise is None else Noise(source=noise["source"], **_arrays(noise, _NOISE)),
        temperature_sources=temperature_sources(document),
        together=_together(document["together"]) if "together" in document else None,
        created=document["created"],
        software=document["software"],
    )


def _together(table: Document) -> Together:
    days = (
        {**kind, "mean_sigma": (*kind["mean_sigma"],), "day_sigma": (*kind["day_sigma"],)} for kind in table["repeatability"]
    )
    return Together(
        session=tuple(JoinedSession(**session) for session in table["session"]),
        repeatability=tuple(DayToDay(**kind) for kind in days),
        prior_grade=table["prior_grade"],
    )
