"""The Earth as a calibration reference: normal gravity (WGS-84) and rotation.

References
----------
.. [1] NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd edition, 2000: equations 4-1 (Somigliana)
   and 4-3 (height), tables 3.1, 3.3 and 3.4 (constants).
"""

from __future__ import annotations

import math

from imufield.dataclass import dataclass
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

EARTH_RATE_RAD_S = 7.292115e-5
"""WGS 84."""
STANDARD_GRAVITY_M_S2 = 9.80665
"""By definition (CGPM 1901)."""
MILLI_G_M_S2 = 9.80665e-3
MICRO_G_M_S2 = 9.80665e-6
SAME_GRAVITY_M_S2 = 1e-7
"""Rounding of the figures in a file: a larger difference is another value."""
SEMI_MAJOR_AXIS_M = 6378137.0
"""Of the ellipsoid, as the eccentricity."""
ECCENTRICITY_SQUARED = 0.00669437999014

_GRAVITY_EQUATOR_M_S2 = 9.7803253359
_SOMIGLIANA_K = 0.00193185265241
_FLATTENING = 1 / 298.257223563
_M = 0.00344978650684  # centrifugal over gravitational acceleration at the equator

NORMAL_GRAVITY_SIGMA_M_S2 = 5e-4
"""1 sigma of true minus normal gravity: anomalies are below 1e-3 m/s^2 (100 ppm of scale) but on high peaks, Huascaran 3e-3."""
UNKNOWN_HEIGHT_GRAVITY_SIGMA_M_S2 = 1.6e-3
"""The same with a height of 0 ± 500 m where none is given: half of all people live above 194 m (Cohen and Small 1998)."""
MEASURED_GRAVITY_SIGMA_M_S2 = 1e-5
"""Least 1 sigma of a value the user typed: a gravimeter or a geodetic survey, 1 mGal."""
GRAVITIES_DIFFER_SIGMA = 3.0
"""A typed value this far from that of its latitude is reported, and a typed place from the recorded one."""
ASSUMED_GRAVITY_SIGMA_M_S2 = 0.018
"""1 sigma where nothing is known: gravity runs from 9.764 to 9.834 m/s^2 over the Earth's surface."""
_TEXTBOOK_GRAVITIES_M_S2 = (STANDARD_GRAVITY_M_S2, 9.81, 9.807, 9.8)

GRAVITY_RANGE_M_S2 = (9.76, 9.84)
"""Surface gravity from Huascaran (9.7639) to the Arctic Ocean (9.8337), with a margin."""
HEIGHT_RANGE_M = (-500.0, 9000.0)
"""From the shore of the Dead Sea to the top of Mount Everest, with a margin."""

_SOURCE_WORDS = {
    "typed": "stated for the site",
    "normal": "WGS-84 normal gravity",
    "measured": "measured",
    "assumed": "ASSUMED: textbook value or unknown place",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Gravity:
    """Local gravity and how it is known.

    ``source`` is "typed", "normal" (WGS-84 at latitude and height), "measured" or "assumed" (nothing, or a textbook's value).
    """

    gravity_m_s2: float
    sigma_m_s2: float
    source: str
    latitude_deg: float | None = None
    height_m: float | None = None

    @property
    def lacks_height(self) -> bool:
        """Whether it is that of a latitude at an unknown height."""
        return self.source == "normal" and self.height_m is None

    @property
    def has_few_digits(self) -> bool:
        """Whether its digits, and nothing given beside them, make its sigma more than that of a measurement."""
        if self.source != "typed" or self.sigma_m_s2 <= MEASURED_GRAVITY_SIGMA_M_S2:
            return False
        width = math.log10(self.sigma_m_s2 * math.sqrt(12))  # Of the last digit: see ``sigma_of_digits``.
        return math.isclose(width, round(width), abs_tol=1e-6)

    @property
    def source_words(self) -> str:
        """How it is known, as people read it."""
        return _SOURCE_WORDS[self.source]


def normal_gravity(latitude_deg: float, height_m: float = 0.0) -> float:
    """Return WGS-84 normal gravity in m/s^2 ([1]_ eq. 4-1 and 4-3)."""
    sin2 = math.sin(math.radians(latitude_deg)) ** 2
    surface = _GRAVITY_EQUATOR_M_S2 * (1 + _SOMIGLIANA_K * sin2) / math.sqrt(1 - ECCENTRICITY_SQUARED * sin2)  # eq. 4-1
    ratio = height_m / SEMI_MAJOR_AXIS_M  # eq. 4-3
    return surface * (1 - 2 * ratio * (1 + _FLATTENING + _M - 2 * _FLATTENING * sin2) + 3 * ratio**2)


def sigma_of_digits(text: str) -> float:
    """Return 1 sigma in m/s^2 of gravity typed as ``text``: anything that rounds to it is as likely, but 1e-5 at least."""
    # A value is as likely anywhere in its last digit: width over the root of 12.
    decimals = len(text.partition(".")[2].rstrip()) if "e" not in text.lower() else 0
    return max(10.0**-decimals / math.sqrt(12), MEASURED_GRAVITY_SIGMA_M_S2)


def sigma_as_typed(text: str, given: str) -> float | None:
    """Return 1 sigma in m/s^2 of gravity typed as ``text``: as given beside it, or by its digits; None for a textbook's value.

    Raises
    ------
    UsageError
        If what was given is no standard deviation of gravity.
    """
    if not given:
        return None if float(text) in _TEXTBOOK_GRAVITIES_M_S2 else sigma_of_digits(text)
    low, high = MEASURED_GRAVITY_SIGMA_M_S2, GRAVITY_RANGE_M_S2[1] - GRAVITY_RANGE_M_S2[0]
    try:
        sigma_m_s2 = float(given)
    except ValueError:
        sigma_m_s2 = math.nan
    # Written so that NaN is outside.
    if not low <= sigma_m_s2 <= high:
        raise UsageError(sentence("earth.gravity_sigma", given=given, low=low, high=high))
    return sigma_m_s2


def recorded_sigma(gravity_m_s2: float | None, sigma_m_s2: float | None) -> float | None:
    """Return 1 sigma in m/s^2 that a session recorded; None where an older one kept the digits of a textbook's value."""
    if gravity_m_s2 is None or sigma_m_s2 is None or gravity_m_s2 not in _TEXTBOOK_GRAVITIES_M_S2:
        return sigma_m_s2
    return None if math.isclose(sigma_m_s2, sigma_of_digits(repr(gravity_m_s2)), rel_tol=1e-6) else sigma_m_s2


def height_words(gravity: Gravity) -> str:
    """Return the height of a place, in words where it is not given."""
    if gravity.height_m is not None:
        return f"height {gravity.height_m:g} m"
    return "height not given, taken as 0 ± 500 m" if gravity.lacks_height else "height not given"


def _normal_sigma(height_m: float | None) -> float:
    return UNKNOWN_HEIGHT_GRAVITY_SIGMA_M_S2 if height_m is None else NORMAL_GRAVITY_SIGMA_M_S2


def contradiction(gravity: Gravity) -> str:
    """Return a sentence where a typed value is not that of the latitude it was given with; else an empty one."""
    if gravity.source != "typed" or gravity.latitude_deg is None:
        return ""
    normal = normal_gravity(gravity.latitude_deg, gravity.height_m or 0.0)
    off, limit = gravity.gravity_m_s2 - normal, math.hypot(gravity.sigma_m_s2, _normal_sigma(gravity.height_m))
    if abs(off) <= GRAVITIES_DIFFER_SIGMA * limit:
        return ""
    return sentence(
        "earth.contradiction" if gravity.height_m is not None else "earth.contradiction_at_0_m",
        given=gravity,
        normal_m_s2=normal,
        apart_ppm=abs(off) / normal * 1e6,
        limit_ppm=GRAVITIES_DIFFER_SIGMA * limit / normal * 1e6,
    )


def choose_gravity(
    gravity_m_s2: float | None = None,
    latitude_deg: float | None = None,
    height_m: float | None = None,
    sigma_m_s2: float | None = None,
) -> Gravity:
    """Return gravity from the best of what the user gave: a value, a latitude, or nothing.

    A value that textbooks print says nothing about the place: without latitude and ``sigma_m_s2`` it is an assumed one.

    Raises
    ------
    CalibrationError
        If a value is outside what the Earth's surface has.
    UsageError
        If the latitude or height is outside its range.
    """
    if latitude_deg is not None and not -90 <= latitude_deg <= 90:
        raise UsageError(sentence("earth.latitude", latitude_deg=latitude_deg))
    if height_m is not None and not HEIGHT_RANGE_M[0] <= height_m <= HEIGHT_RANGE_M[1]:
        raise UsageError(sentence("earth.height", height_m=height_m, low_m=HEIGHT_RANGE_M[0], high_m=HEIGHT_RANGE_M[1]))
    if gravity_m_s2 is not None:
        low, high = GRAVITY_RANGE_M_S2
        if not low <= gravity_m_s2 <= high:
            refused = sentence("earth.gravity", gravity_m_s2=gravity_m_s2, low=low, high=high)
            raise CalibrationError(refused, Reason.GRAVITY)
        value, sigma, source = gravity_m_s2, sigma_of_digits(repr(float(gravity_m_s2))), "typed"
        if value in _TEXTBOOK_GRAVITIES_M_S2 and latitude_deg is None and sigma_m_s2 is None:
            sigma, source = ASSUMED_GRAVITY_SIGMA_M_S2, "assumed"
        elif value in _TEXTBOOK_GRAVITIES_M_S2:
            # Its digits are no measurement: where the place does not contradict it, it is as good as what the place says.
            sigma = max(sigma, _normal_sigma(height_m))
    elif latitude_deg is not None:
        value, sigma, source = normal_gravity(latitude_deg, height_m or 0.0), _normal_sigma(height_m), "normal"
    else:
        value, sigma, source, height_m = STANDARD_GRAVITY_M_S2, ASSUMED_GRAVITY_SIGMA_M_S2, "assumed", None
    return Gravity(
        gravity_m_s2=value,
        sigma_m_s2=sigma if sigma_m_s2 is None else sigma_m_s2,
        source=source,
        latitude_deg=latitude_deg,
        height_m=height_m,
    )
