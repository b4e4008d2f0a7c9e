"""Opening an instrument from the command line: its options, the clock to read it with, and what a person is told meanwhile."""

from __future__ import annotations

from imufield.acquire.link.host_clock import HostClock, ScaledClock, SystemClock
from imufield.commands.terminal.output import say
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def say_assumed(assumption: str) -> None:
    """Tell what was found or assumed while connecting, beside the result of the command."""
    say(assumption, err=True, indent=2)


def host_clock(speed: float) -> HostClock:
    """Return the clock to read an instrument with that runs ``speed`` times faster than real time, as emulated ones may."""
    if speed == 1.0:
        return SystemClock()
    # Said each time: with a real instrument every rate would come out wrong by this factor.
    say(sentence("connection.fast_clock", speed=speed), err=True)
    return ScaledClock(speed)
