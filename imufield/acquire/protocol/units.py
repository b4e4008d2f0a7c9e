"""Units of what instruments send, and what each is in SI."""

from __future__ import annotations

import math

from imufield.earth import STANDARD_GRAVITY_M_S2

TO_SI = {
    "m/s^2": ("m/s^2", 1.0),
    "g": ("m/s^2", STANDARD_GRAVITY_M_S2),
    "mg": ("m/s^2", STANDARD_GRAVITY_M_S2 / 1e3),
    "ft/s^2": ("m/s^2", 0.3048),
    "m/s": ("m/s", 1.0),
    "g*s": ("m/s", STANDARD_GRAVITY_M_S2),
    "ft/s": ("m/s", 0.3048),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "arcsec": ("rad", math.pi / 648000),
    "count": ("count", 1.0),
    "pulse": ("pulse", 1.0),
    "degC": ("degC", 1.0),
}
"""Units a protocol may name: what a sample holds, and by what the number is multiplied."""
UNITS_OF = {
    "accelerometer": ("m/s^2", "m/s", "count", "pulse"),
    "gyroscope": ("rad/s", "rad", "count", "pulse"),
    "temperature": ("degC",),
}
"""What each part of a sample may be in; the first where nothing else is known."""
SI_UNITS = ("m/s^2", "m/s", "rad/s", "rad")


def nominal_scale(unit: str) -> float | None:
    """Return the scale of an instrument that sends this unit and is perfect; None where only the maker knows it."""
    si, factor = TO_SI.get(unit, ("", 1.0))
    return 1 / factor if si in SI_UNITS else None
