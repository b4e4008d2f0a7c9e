"""Bias and scale over temperature in the parameter file: tables of version 2, and what their numbers must agree on.

They are evaluated by ``calibrate.model.temperature_polynomials``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from imufield.calibrate.model.result import Calibration
from imufield.calibrate.model.temperature_polynomials import NewDay, Polynomials, SessionChanges, TriadTemperature
from imufield.dataclass import asdict
from imufield.deliver.parameters.context import TemperatureSource
from imufield.deliver.parameters.schema import Document
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

VERSION_WITH_TEMPERATURE = 2
BIAS_UNITS = {"accelerometer": "m_s2", "gyroscope": "rad_s"}
# Over the range measured: no sensor loses half of its scale, and beyond the output of 1 + k = 0 nothing can be corrected.
_MOST_SCALE = 0.5
_LEAST_RANGE_DEGC = 1.0  # A tenth of the shortest ramp: polynomials over less mean nothing.
_ARRAYS = ("sensor_offset_degc", "bias_scale_covariance")  # That not every triad has.
_SESSIONS = ("temperature_degc", "bias", "scale")
_NEW_DAY = ("bias", "scale", "bias_covariance", "scale_covariance")
_ROUNDING = 1e-9  # Relative: covariances are printed with all digits.


def add_temperature(document: Document, calibration: Calibration, sources: tuple[TemperatureSource, ...]) -> Document:
    """Return a document with what is known over temperature, and of the version that has it; as it is where nothing is."""
    gyroscope = calibration.gyroscope
    models = {
        "accelerometer": calibration.accelerometer_temperature,
        "gyroscope": None if gyroscope is None else gyroscope.temperature,
    }
    known = {triad: model for triad, model in models.items() if model is not None}
    if not known:
        return document
    tables = {triad: document[triad] | {"temperature": _table(model, BIAS_UNITS[triad])} for triad, model in known.items()}
    listed = [
        {
            "name": source.name,
            "kind": source.kind,
            "sha256": source.sha256,
            "temperature_degc": [float(value) for value in source.temperature_degc],
        }
        for source in sources
    ]
    return document | tables | {"version": VERSION_WITH_TEMPERATURE, "temperature_source": listed}


def _table(model: TriadTemperature, unit: str) -> Document:
    return {
        "reference_degc": float(model.reference_degc),
        "range_degc": [float(value) for value in model.range_degc],
        f"bias_{unit}": model.bias.coefficients.tolist(),
        "scale": model.scale.coefficients.tolist(),
        f"hysteresis_{unit}": model.hysteresis.tolist(),
        "scale_separated": model.scale_separated,
        "bias_covariance": model.bias.covariance.tolist(),
        "scale_covariance": model.scale.covariance.tolist(),
        **_as_table({name: getattr(model, name) for name in ("new_day", "sessions", *_ARRAYS)}, unit),
    }


def _as_table(values: Mapping[str, object], unit: str) -> Document:
    """Return what is not None under the keys of the file, arrays as lists, and records as tables."""
    document: Document = {}
    for name, value in values.items():
        key = {"bias": f"bias_{unit}"}.get(name, name).replace("_freedom", "_degrees_of_freedom")
        if isinstance(value, NewDay | SessionChanges):
            document[key] = _as_table(asdict(value), unit)
        elif value is not None:
            document[key] = value.tolist() if isinstance(value, np.ndarray) else value
    return document


def temperature_of(document: Document, triad: str) -> TriadTemperature | None:
    """Return what a valid document says of a triad over temperature; None where it says nothing."""
    table = document[triad].get("temperature")
    if table is None:
        return None
    unit = BIAS_UNITS[triad]
    low, high = table["range_degc"]
    return TriadTemperature(
        reference_degc=float(table["reference_degc"]),
        range_degc=(float(low), float(high)),
        bias=_polynomials(table[f"bias_{unit}"], table["bias_covariance"]),
        scale=_polynomials(table["scale"], table["scale_covariance"]),
        hysteresis=np.array(table[f"hysteresis_{unit}"], dtype=np.float64),
        scale_separated=table["scale_separated"],
        new_day=_new_day(table["new_day"], unit) if "new_day" in table else None,
        sessions=SessionChanges(**_arrays(table["sessions"], unit, _SESSIONS)) if "sessions" in table else None,
        sensor_offset_degc=np.array(table["sensor_offset_degc"]) if "sensor_offset_degc" in table else None,
        bias_scale_covariance=_between(table) if "bias_scale_covariance" in table else None,
    )


def _between(table: Document) -> FloatArray:
    """Return the covariances between bias and scale; files of earlier programs have none, and count as without."""
    orders = [len(table[f"{quantity}_covariance"][0]) for quantity in ("bias", "scale")]
    return np.array(table.get("bias_scale_covariance", np.zeros((3, *orders))), dtype=np.float64).reshape(3, *orders)


def _arrays(table: Document, unit: str, names: tuple[str, ...]) -> dict[str, FloatArray]:
    return {name: np.array(table[f"bias_{unit}" if name == "bias" else name], dtype=np.float64) for name in names}


def _new_day(table: Document, unit: str) -> NewDay:
    return NewDay(
        **_arrays(table, unit, _NEW_DAY),
        bias_scale_covariance=_between(table),
        bias_freedom=float(table["bias_degrees_of_freedom"]),
        scale_freedom=float(table["scale_degrees_of_freedom"]),
    )


def _polynomials(coefficients: list[list[float]], covariance: list[list[list[float]]]) -> Polynomials:
    order = len(coefficients)
    return Polynomials(
        np.array(coefficients, dtype=np.float64).reshape(order, 3),
        np.array(covariance, dtype=np.float64).reshape(3, order, order),
    )


def temperature_sources(document: Document) -> tuple[TemperatureSource, ...]:
    """Return what recordings the tables of a valid document rest on."""
    return tuple(
        TemperatureSource(row["name"], row["kind"], row["sha256"], (row["temperature_degc"][0], row["temperature_degc"][1]))
        for row in document.get("temperature_source", [])
    )


def temperature_contradictions(document: Document) -> Iterator[str]:
    """Yield what in the tables over temperature contradicts itself, or a version that has none; the key first."""
    tables = {triad: document[triad]["temperature"] for triad in BIAS_UNITS if "temperature" in document.get(triad, {})}
    new = [f"{triad}.temperature" for triad in tables] + ["temperature_source"] * ("temperature_source" in document)
    if new and document["version"] < VERSION_WITH_TEMPERATURE:
        yield sentence("temperature_tables.version", key=new[0], version=document["version"])
    for triad, table in tables.items():
        where = f"{triad}.temperature"
        low, high = table["range_degc"]
        if high - low < _LEAST_RANGE_DEGC:
            yield sentence("temperature_tables.range", where=where, low=low, high=high, limit=_LEAST_RANGE_DEGC)
            return
        if not low <= table["reference_degc"] <= high:
            yield sentence("temperature_tables.reference", where=where, reference=table["reference_degc"], low=low, high=high)
        for quantity, key in (("bias", f"bias_{BIAS_UNITS[triad]}"), ("scale", "scale")):
            order = len(table[key])
            # Of a new day the first row is that of the session at the reference.
            for part, size in ((table, order), *((table[name], order + 1) for name in ("new_day",) if name in table)):
                blocks = part[f"{quantity}_covariance"]
                if any(len(row) != size for block in blocks for row in (block, *block)):
                    yield sentence("temperature_tables.size", where=where, quantity=quantity, order=order)
                    return
                if not all(map(_is_covariance, blocks)):
                    yield sentence("temperature_tables.covariance", where=where, quantity=quantity)
        yield from _wrong_between(table, where)
        yield from _wrong_between(table.get("new_day", {}), where)
        sessions = table.get("sessions", {})
        if len({len(values) for values in sessions.values()}) > 1:
            yield sentence("temperature_tables.sessions", where=where)
        yield from _too_steep(document, triad)


def _wrong_between(part: Document, where: str) -> Iterator[str]:
    """Yield what the covariances between bias and scale contradict: their size, or sigmas that are too small for them."""
    if "bias_scale_covariance" not in part:
        return
    blocks = zip(part["bias_covariance"], part["scale_covariance"], part["bias_scale_covariance"], strict=True)
    for of_bias, of_scale, between in blocks:
        if len(between) != len(of_bias) or any(len(row) != len(of_scale) for row in between):
            yield sentence("temperature_tables.size", where=where, quantity="bias_scale", order=len(of_bias))
            return
        turned = [[row[k] for row in between] for k in range(len(of_scale))]
        rows = [[*own, *other] for own, other in zip((*of_bias, *turned), (*between, *of_scale), strict=True)]
        if not _is_covariance(rows):
            yield sentence("temperature_tables.covariance", where=where, quantity="bias_scale")
            return


def _is_covariance(block: list[list[float]]) -> bool:
    matrix = np.array(block, dtype=np.float64).reshape(len(block), len(block))
    sigma = np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(np.float64).tiny))
    correlation: FloatArray = matrix / np.outer(sigma, sigma)
    if not len(matrix) or not np.any(matrix):
        return True
    return bool(np.allclose(correlation, correlation.T, atol=_ROUNDING) and np.linalg.eigvalsh(correlation)[0] > -1e-6)


def _too_steep(document: Document, triad: str) -> Iterator[str]:
    model = temperature_of(document, triad)
    if model is None:
        return
    most = float(np.abs(model.scale.at(model.degrees_above(np.linspace(*model.range_degc, 50)))).max())
    if most > _MOST_SCALE:
        yield sentence("temperature_tables.steep", where=f"{triad}.temperature", most=most, limit=_MOST_SCALE)
