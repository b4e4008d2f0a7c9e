"""Where a calibration comes from: the facts a parameter file holds beside the numbers themselves."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from imufield.dataclass import dataclass, field
from imufield.samples import FloatArray
from imufield.version import __version__

SOFTWARE = f"imufield {__version__}"


def now_text() -> str:
    """Return the time without fractions and with Z: files sort by it as text."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _unknown() -> FloatArray:
    return np.full(3, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentFacts:
    """Which instrument; an empty string where not known."""

    driver: str = ""
    model: str = ""
    serial_number: str = ""
    firmware: str = ""
    grade: str = ""
    """Whose typical errors stand in the uncertainty for what the session does not show."""
    grade_source: str = ""
    """"stated", or "assumed" where nobody says which."""

    @property
    def stated_grade(self) -> str:
        """Empty where nobody says which: an assumed one tells nothing of the instrument."""
        return "" if self.grade_source == "assumed" else self.grade


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionFacts:
    """Which recording.

    ``sha256`` is the hash of what was solved (the session's parts in order, or the observation file); ``sample_rate_hz``
    is the true rate, device counter against host time; NaN where not known. ``recorded`` is when the recording began, UTC,
    ISO 8601; empty where nobody knows.
    """

    name: str = ""
    sha256: str = ""
    sample_rate_hz: float = float("nan")
    temperature_degc: tuple[float, float] = (float("nan"), float("nan"))
    """Lowest and highest."""
    recorded: str = ""
    sensor_offset_degc: tuple[float, ...] = ()
    """Temperature of each axis' sensor, ax ay az gx gy gz, less that of the instrument, means; NaN where an axis has none."""


@dataclass(frozen=True, slots=True)
class TemperatureSource:
    """One recording that the parameters over temperature rest on."""

    name: str
    kind: str
    """"session" or "ramp"."""
    sha256: str
    temperature_degc: tuple[float, float]
    """Lowest and highest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockFacts:
    """The clock that gave the samples their time.

    ``source`` is "host", "compared" (the instrument's own, held against the host's) or "unchecked" (a stated rate, or the times
    of a file). The gyroscope's scale belongs to ``sample_period_s``, whose relative error in true seconds has ``sigma``.
    """

    source: str
    sample_period_s: float
    sigma: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Noise:
    """Noise figures per axis, shape (3,), NaN where not known.

    A density is the white noise of a rate output: the standard deviation of one sample times the square root of the
    sample interval.
    """

    source: str
    accelerometer_density_m_s2_per_sqrt_hz: FloatArray = field(default_factory=_unknown)
    gyroscope_density_rad_s_per_sqrt_hz: FloatArray = field(default_factory=_unknown)
    accelerometer_bias_instability_m_s2: FloatArray = field(default_factory=_unknown)
    gyroscope_bias_instability_rad_s: FloatArray = field(default_factory=_unknown)


@dataclass(frozen=True, slots=True, kw_only=True)
class JoinedSession:
    """One of the sessions of a file that was solved from several."""

    name: str
    sha256: str
    recorded: str
    """UTC, ISO 8601; empty where nobody knows."""
    positions: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DayToDay:
    """How a kind of parameter changes from session to session, 1 sigma, and how well it is known, for x, y, z; SI."""

    kind: str
    """"accelerometer.bias_m_s2", "accelerometer.scale", "gyroscope.bias_rad_s" or "gyroscope.scale"; scales are relative."""
    sigma: float
    low: float
    """Of the 95 % interval of sigma."""
    high: float
    degrees_of_freedom: int
    mean_sigma: tuple[float, ...]
    """Of the mean over all days."""
    day_sigma: tuple[float, ...]
    """Of a new day."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """What sessions that were solved together tell beside the parameters."""

    session: tuple[JoinedSession, ...]
    repeatability: tuple[DayToDay, ...]
    prior_grade: str = ""
    """Whose typical figures bound the change from day to day where the sessions are few; empty where none did."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Everything in a parameter file that the solver does not know."""

    instrument: InstrumentFacts = field(default_factory=InstrumentFacts)
    session: SessionFacts = field(default_factory=SessionFacts)
    clock: ClockFacts | None = None
    """None where no samples were timed."""
    noise: Noise | None = None
    temperature_sources: tuple[TemperatureSource, ...] = ()
    together: Together | None = None
    """None for the file of one session."""
    created: str = field(default_factory=now_text)
    """UTC, ISO 8601."""
    software: str = SOFTWARE

    @property
    def measured(self) -> str:
        """When the session was recorded; when it was solved where nobody knows. A session may be solved again years later."""
        return self.session.recorded or self.created
