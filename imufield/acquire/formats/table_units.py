"""Choose the units of time, acceleration and rate of a table where its header does not state them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from imufield.errors import UsageError
from imufield.samples import LARGEST_OUTPUT, FloatArray

TIME_SCALE = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
TIME_UNIT = "time_unit"
"""Setting of an import; rows themselves are in seconds."""
SHORTEST_STEP_S = 2.5e-4
LONGEST_STEP_S = 0.2
"""Instruments send 5 to 4000 samples a second. The two limits are less than a factor of 1000 apart, so a median step fits one
unit of time at most."""
# A typed rate within 20 % of the time column's decides the unit of time; outside, one of the two is wrong.
_RATE_TOLERANCE = 0.2

_CONVERTED = {"mg": ("g", 1e-3)}  # Units that protocol ``rows_f64`` does not know: what they become, and the factor.
_FAST = 0.999  # Of all outputs; larger ones may be damage.
_STANDS_FOR_G = (0.8, 1.25)
_STANDS_FOR_M_S2 = (8.0, 12.0)  # Median norm of an accelerometer that is at rest most of the time.


def given_time_unit(settings: Mapping[str, object]) -> str | None:
    """Return the unit of time the user gives, None without.

    Raises
    ------
    UsageError
        If it is no unit of time.
    """
    unit = settings.get(TIME_UNIT)
    if unit is not None and unit not in TIME_SCALE:
        raise UsageError(f"--set {TIME_UNIT}={unit} is no unit of time; choose one of {', '.join(TIME_SCALE)}.")
    return None if unit is None else str(unit)


def choose_time_scale(path: Path, time: FloatArray, unit: str | None, rate_hz: float | None) -> tuple[float, str]:
    """Return seconds per unit of a time column, and a sentence where it was assumed.

    Raises
    ------
    UsageError
        No unit gives a plausible rate, or the typed rate contradicts the column.
    """
    steps = np.diff(time)
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    if unit is not None:
        _check_rate(path, step * TIME_SCALE[unit], rate_hz)
        return TIME_SCALE[unit], ""
    low, high = (
        (SHORTEST_STEP_S, LONGEST_STEP_S)
        if rate_hz is None
        else ((1.0 - _RATE_TOLERANCE) / rate_hz, (1.0 + _RATE_TOLERANCE) / rate_hz)
    )
    fitting = [name for name, scale in TIME_SCALE.items() if low <= step * scale <= high]
    if not fitting:
        # In seconds it would be plausible: then it is the rate that is wrong.
        if rate_hz is not None and SHORTEST_STEP_S <= step <= LONGEST_STEP_S:
            _check_rate(path, step, rate_hz)
        named = "give it with --set time_unit=..., or the rate with --rate-hz, or other --columns"
        hint = named if rate_hz is None else "give the right --rate-hz"
        raise UsageError(
            f"the time column of {path} has a median step of {step:g}, which is no plausible rate in s, ms, us or ns: {hint}.",
            path=str(path),
            step=step,
            rate_hz=rate_hz,
        )
    name = fitting[0]
    rate = 1.0 / (step * TIME_SCALE[name])
    why = f"a median step of {step:g} is then {rate:.6g} Hz; --set {TIME_UNIT}=... says otherwise"
    return TIME_SCALE[name], f"{path.name}: time is taken as {name}, because {why}."


def _check_rate(path: Path, step_s: float, rate_hz: float | None) -> None:
    if rate_hz is not None and abs(step_s * rate_hz - 1.0) > _RATE_TOLERANCE:
        actual = f"{1.0 / step_s:.6g} Hz" if step_s > 0.0 else "no rate at all"
        raise UsageError(
            f"--rate-hz {rate_hz:g} contradicts the time column of {path}, {actual}: leave it out.", path=str(path)
        )


def choose_unit(
    quantity: str, values: FloatArray, stated: Mapping[str, str], given: Mapping[str, object], *, has_zero: bool
) -> tuple[str, float, str]:
    """Choose the unit of a triad.

    Parameters
    ----------
    quantity : str
        ``accelerometer`` or ``gyroscope``.
    values : ndarray, shape (n, 3)
    stated : mapping
        Units the headers name.
    given : mapping
        Settings of the user.
    has_zero : bool
        A mid-scale was given: the accelerometer sends counts.

    Returns
    -------
    unit : str
    factor : float
        By which the values are to be multiplied.
    sentence : str
        What was assumed or converted; empty if nothing.
    """
    setting = given.get(f"{quantity}_unit")
    if setting is not None:
        return str(setting), 1.0, ""
    if quantity in stated:
        unit, factor = _CONVERTED.get(stated[quantity], (stated[quantity], 1.0))
        return unit, factor, f"{quantity} is converted from {stated[quantity]} to {unit}." if factor != 1.0 else ""
    is_whole = ~np.isnan(values).any(axis=1)
    # A triad without values has any unit.
    if not is_whole.any():
        return ("m/s^2" if quantity == "accelerometer" else "rad/s"), 1.0, ""
    # Neither one damaged number nor a gap decides for all the others.
    possible = (np.abs(values) <= LARGEST_OUTPUT).all(axis=1)
    values = values[possible if possible.any() else is_whole]
    unit, why = _guess_accelerometer(values, has_zero) if quantity == "accelerometer" else _guess_gyroscope(values, stated)
    return unit, 1.0, f"{quantity} is taken as {unit}, because {why}; --set {quantity}_unit=... says otherwise."


def _guess_accelerometer(values: FloatArray, has_zero: bool) -> tuple[str, str]:
    if has_zero:
        return "count", "a mid-scale was given"
    if _is_whole(values):
        return "count", "all values are whole numbers"
    with np.errstate(over="ignore", invalid="ignore"):  # in damaged files; infinite is no plausible norm either
        norm = float(np.median(np.linalg.norm(values, axis=1)))
    for unit, (low, high) in (("m/s^2", _STANDS_FOR_M_S2), ("g", _STANDS_FOR_G)):
        if low <= norm <= high:
            return unit, f"the median norm is {norm:.4g}"
    return "count", f"a median norm of {norm:.4g} is neither m/s^2 nor g"


def _guess_gyroscope(values: FloatArray, stated: Mapping[str, str]) -> tuple[str, str]:
    if _is_whole(values):
        return "count", "all values are whole numbers"
    # Hands turn a unit faster than this in deg/s at once, and never in rad/s (4000 deg/s).
    fastest = float(np.quantile(np.abs(values), _FAST, method="lower"))
    if fastest > 70.0:
        return "deg/s", f"values reach {fastest:.4g}"
    if stated.get("accelerometer") in ("g", "mg"):
        return "deg/s", "the accelerometer is in g"
    return "rad/s", f"values reach no more than {fastest:.4g}"


def _is_whole(values: FloatArray) -> bool:
    return bool(np.array_equal(values, np.rint(values)))
