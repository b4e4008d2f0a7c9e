"""imufield: field calibration of inertial measurement units. This page is the dictionary.

Frames
    b   body frame: right-handed x, y, z of the instrument, fixed to it by the gauge of the calibration.
    s   sensing axes: the three (not quite orthogonal) axes of a triad.
    n   navigation frame: north, east, down.

Signs
    Specific force is what an accelerometer feels: a still instrument reads +g along the axis that points *up*.

Measurement equations (docs/maths.md names them after the papers; ``T`` and ``E`` have a unit diagonal, ``K`` is diagonal)
    accelerometer   s = T a,  N - raw_zero = K (s + b) + K2 s**2       element by element, "sensing" quadratic axes
                    N - raw_zero = K (T a + b) + K2 a**2               the printed form, "body" quadratic axes
                    s = T a + h(T a) in either                         with higher terms: cubic and cross terms
    gyroscope       N - raw_zero = K E w + e + G a

    N   raw output per sample, in the *raw unit*: what the instrument sends (count, pulse, or SI where it scales itself)
    a   specific force, m/s^2, body frame            w   angular rate, rad/s, body frame
    K   scale, raw unit per m/s^2 (or per rad/s)     b   bias_m_s2, m/s^2         e   bias, raw unit
    T   misalignment of the accelerometer, rad       E   misalignment of the gyroscope, rad
    K2  quadratic, raw unit per (m/s^2)^2            G   g_sensitivity, raw unit per m/s^2

Words
    link, chunk, frame, samples, still interval, position, observation, preset, session: the
    types of those names live in ``imufield.acquire``, ``imufield.samples``, ``imufield.guide``, ``imufield.calibrate``.
    A serial port has a baud rate, a CAN bus a bit rate; what serves both is called ``baud`` (``--baud``, ``Driver.bauds``).

Names carry their unit: ``rate_hz``, ``time_s``, ``bias_m_s2``, ``temperature_degc``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from imufield.version import __version__

if TYPE_CHECKING:
    from imufield.deliver.history import find
    from imufield.deliver.parameters.file import load

__all__ = ["__version__", "find", "load"]

# A wheel has drivers/ and protocols/ inside this package, a checkout has them beside it.
_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "pyproject.toml").is_file():
    __path__.append(str(_checkout))


def __getattr__(name: str) -> Any:
    """Import ``load`` and ``find`` on first use: NumPy and the rooms take longer than a prompt should wait."""
    if name == "load":
        from imufield.deliver.parameters.file import load

        return load
    if name == "find":
        from imufield.deliver.history import find

        return find
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
