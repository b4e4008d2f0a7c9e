"""Clocks of the host computer, which stamp the arrival of bytes. Only links, the recorder and commands read them.

Monotonic time orders and measures, UTC names the moment. A ``ScaledClock`` lets an emulated instrument that runs 8 times
faster than real be read as if an hour had passed in seven and a half minutes.
"""

from __future__ import annotations

import time
from typing import Protocol

NANOSECONDS = 1_000_000_000
COUNTS_FROM_1970_S = 1e8
"""A time beyond this, in 1973, counts from 1970; one below from a start of its own, of a clock or of a recording."""


class HostClock(Protocol):
    """What links and commands need to know of time."""

    def monotonic_s(self) -> float:
        """Return seconds since some fixed moment; never steps back."""
        ...

    def utc_ns(self) -> int:
        """Return nanoseconds since 1970-01-01 UTC; steps when the operator or NTP sets the clock."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Wait ``duration_s`` seconds of this clock."""


def patience_s(clock: HostClock, duration_s: float) -> float:
    """Convert real seconds to seconds of a clock: an emulated instrument may be fast, the machine it runs on is not."""
    return duration_s * max(float(getattr(clock, "speed", 1.0)), 1.0)


# An instrument goes on while the computer is suspended. Linux has a clock for it, that of macOS goes on by itself.
_CLOCK = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))


class SystemClock:
    """The machine's own clocks."""

    def monotonic_s(self) -> float:
        """Return the monotonic clock of the system in seconds, those included that it was suspended where it can tell."""
        return time.monotonic() if _CLOCK is None else time.clock_gettime(_CLOCK)

    def utc_ns(self) -> int:
        """Return nanoseconds since 1970-01-01 UTC."""
        return time.time_ns()

    def sleep(self, duration_s: float) -> None:
        """Wait."""
        time.sleep(duration_s)


class ScaledClock:
    """A clock that runs ``speed`` times faster than the system's, from the moment it is made.

    Parameters
    ----------
    speed : float
        Larger than 0.
    """

    def __init__(self, speed: float) -> None:
        if not speed > 0.0:
            raise ValueError("`speed` must be larger than 0")
        self.speed = speed
        self._start_s = time.monotonic()
        self._start_utc_ns = time.time_ns()

    def monotonic_s(self) -> float:
        """Return seconds that pass ``speed`` times faster."""
        return self._start_s + (time.monotonic() - self._start_s) * self.speed

    def utc_ns(self) -> int:
        """Return UTC at the start plus the time that passed on this clock."""
        return self._start_utc_ns + round((self.monotonic_s() - self._start_s) * NANOSECONDS)

    def sleep(self, duration_s: float) -> None:
        """Wait ``duration_s`` seconds of this clock, which is less in reality."""
        time.sleep(duration_s / self.speed)
