"""Refusals: the sentence, remedy and unit of each, by reason. The places of use give the numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from imufield.guide.events import RefusalCode, Rejected

_NAMED_AT_ONCE = 4  # Positions named in one sentence: the screen has room for these.


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """Why a hold does not count, or why the guide cannot go on."""

    reason: RefusalCode
    words: str
    remedy: str
    measured: float
    limit: float
    unit: str
    axis: str | None = None

    def event(self, now_s: float, position: str | None) -> Rejected:
        """Return the event of this refusal."""
        return Rejected(time_s=now_s, position=position, **{field.name: getattr(self, field.name) for field in fields(self)})


@dataclass(frozen=True, slots=True)
class Sentence:
    """One row of the table: what was found, what to do, and the unit of the measured value and its limit.

    Both texts are formats. Beside the values of the place of use they may name ``measured``, ``limit``, ``axis``, and ``found``
    and ``allowed``: value and limit in the unit that people use for their size.
    """

    reason: RefusalCode
    words: str
    remedy: str
    unit: str = ""

    def refusal(
        self, measured: float, limit: float, *, axis: str | None = None, unit: str | None = None, **values: float | str
    ) -> Refusal:
        """Return the refusal with these numbers; ``unit`` where the table has none."""
        unit = self.unit if unit is None else unit
        found, allowed = quantity(measured, unit), quantity(limit, unit)
        values = {**values, "measured": measured, "limit": limit, "found": found, "allowed": allowed, "axis": axis or ""}
        return Refusal(
            reason=self.reason,
            words=self.words.format(**values),
            remedy=self.remedy.format(**values),
            measured=measured,
            limit=limit,
            unit=unit,
            axis=axis,
        )


def quantity(value: float, unit: str) -> str:
    """Return a value in the unit people use for its size: mm/s^2, deg/s."""
    if unit == "m/s^2":
        return f"{1e3 * value:.3g} mm/s^2" if abs(value) < 1 else f"{value:.2f} m/s^2"
    if unit == "rad/s":
        return f"{math.degrees(value):.2g} deg/s"
    return f"{value:.3g} {unit}"


def what_is_left(names: Sequence[str]) -> str:
    """Return the remedy at a side that is measured already: the names of the others."""
    if not names:
        return "bring another side up"
    more = f" and {len(names) - _NAMED_AT_ONCE} more" if len(names) > _NAMED_AT_ONCE else ""
    return f"{len(names)} left: {', '.join(names[:_NAMED_AT_ONCE])}{more}"


# A hold that ends by motion; the unit is that of the triad that moved.
_MOVED = "it {what} after {lasted_s:.1f} of {hold_s:g} s: {triad} {axis} {found} (limit {allowed})"
MOVED = Sentence(RefusalCode.MOVED, _MOVED, "hold again; only this hold is repeated")
MOVED_AGAIN = Sentence(
    RefusalCode.MOVED,
    _MOVED,
    "{times} times in a row it was let go or lifted too early: keep it as it is until the two tones, or until the "
    "screen says accepted",
)
NOT_STILL = Sentence(
    RefusalCode.NOT_STILL,
    "not still yet: it {verb}, {triad} {axis} {found} (limit {allowed})",
    "put it on a firm support or lean it on one, hands off",
)

# Where the unit is.
NOT_NEAR = Sentence(
    RefusalCode.NOT_NEAR,
    "not near any pending position: nearest is {nearest} at {measured:.0f} deg (limit {limit:.0f} deg)",
    "bring it to {wanted}: {wanted_words}",
    "deg",
)
ALREADY_DONE = Sentence(RefusalCode.ALREADY_DONE, "{position} is already done", "{left}", "deg")
OTHER_SIDE = Sentence(
    RefusalCode.OTHER_SIDE,
    "the unit is on another side than asked: {shown} is up, {asked} up is asked for",
    "bring it to {asked} up, or to any other pending position",
    "deg",
)

# What happened during the hold.
KNOCKED = Sentence(
    RefusalCode.KNOCKED,
    "knocks or vibration in {measured:.0f} % of the hold (limit {limit:.0f} %)",
    "keep hands and machines off the table, and hold again",
    "%",
)
PUSHED = Sentence(
    RefusalCode.KNOCKED,
    "it was pushed by {measured:.2f} deg after {after_s:.1f} s of the hold (limit {limit:.2f} deg, axis {axis})",
    "leave it: it is measured again",
    "deg",
)
BUMPED = Sentence(
    RefusalCode.KNOCKED,
    "it was bumped after {after_s:.1f} s: a jolt of {measured:.2f} m/s^2 (limit {limit:.2f} m/s^2)",
    "go on holding: it is measured again",
    "m/s^2",
)
TREMBLING = Sentence(
    RefusalCode.TREMBLING,
    "the hand trembles by {measured:.2f} deg rms (limit {limit:g} deg)",
    "rest the arm on something, or lean the unit against a support; it is measured again",
    "deg",
)
SWAYING = Sentence(
    RefusalCode.SWAYING,
    "the hand sways by {measured:.1f} deg rms (limit {limit:g} deg)",
    "rest the elbows on the table, or lean the unit against a support; it is measured again",
    "deg",
)
_DRIFT_REMEDY = "leave it: it is measured again; if this repeats, use a firmer support or let the unit warm up"
DRIFTS = Sentence(
    RefusalCode.DRIFTING,
    "the reading drifts by {drift_mm_s2:.1f} mm/s^2 over the hold (limit {limit_mm_s2:.1f} mm/s^2, axis {axis})",
    _DRIFT_REMEDY,
    "m/s^2",
)
TILTS = Sentence(
    RefusalCode.DRIFTING,
    "the unit tilts by {measured:.2f} deg over the hold (limit {limit:.2f} deg, axis {axis})",
    _DRIFT_REMEDY,
    "deg",
)
WARMING_UP = Sentence(
    RefusalCode.WARMING_UP,
    "the temperature changes by {slope:+.1f} degC per minute (limit {limit:g})",
    "leave it on and wait: it is measured as soon as it is warm; press g to go on cold",
    "degC/min",
)

# What the samples are worth.
_SHARE = "{measured:.1f} % of the samples (limit {limit:.0f} %)"
SATURATED = Sentence(
    RefusalCode.SATURATED,
    "the {triad} is at the end of its range{on_axis} in " + _SHARE,
    "choose a larger range, or check the range setting of the driver, then hold again",
    "%",
)
START_UP = Sentence(
    RefusalCode.START_UP, "the instrument is still starting up in " + _SHARE, "leave it alone until it is ready", "%"
)
FAULT = Sentence(
    RefusalCode.INVALID,
    "the instrument reports a fault in " + _SHARE,
    "read its status in the manual, then hold again",
    "%",
)
_CHECK_INSTRUMENT = "check the instrument, then hold again"
ACCELEROMETER_INVALID = Sentence(
    RefusalCode.INVALID, "the accelerometer is reported invalid in " + _SHARE, _CHECK_INSTRUMENT, "%"
)
GYROSCOPE_INVALID = Sentence(RefusalCode.INVALID, "the gyroscope is reported invalid in " + _SHARE, _CHECK_INSTRUMENT, "%")
SAMPLE_LOSS = Sentence(
    RefusalCode.SAMPLE_LOSS,
    "lost or not finite: " + _SHARE,
    "check cable, baud rate and load of the computer, then hold again",
    "%",
)
STUCK = Sentence(
    RefusalCode.STUCK,
    "accelerometer axis {axis} stays at {reading:g} (raw) although its noise is {limit:.3g}: "
    "at the end of its range, or broken",
    "choose a larger range, or check the instrument, then hold again",
    "raw unit",
)
DEAD_AXIS = Sentence(
    RefusalCode.INVALID,
    "accelerometer axis {axis} is dead: it stayed at {reading:g} (raw) on {sides} sides and in the turns between",
    "check the instrument, its range, and which column or field the driver or protocol takes for this axis; "
    "nothing can be calibrated without it",
    "raw unit",
)
GRAVITY = Sentence(
    RefusalCode.GRAVITY,
    "at rest the accelerometer shows {measured:.2f} m/s^2, further than {limit:.2f} m/s^2 from gravity",
    "check the unit, range and scale settings of the driver",
    "m/s^2",
)
CLOCK_FORWARD, CLOCK_BACK = (
    Sentence(
        RefusalCode.CLOCK_JUMP,
        f"the sample clock jumped {way} by {{measured:.1f}} s (limit {{limit:g}} s): the computer was suspended, "
        "or the instrument began anew",
        "nothing measured is lost; a hold that was under way begins anew",
        "s",
    )
    for way in ("forward", "back")
)
RATE = Sentence(
    RefusalCode.RATE,
    "the sample rate has changed by {percent:+.0f} % from {usual_hz:.0f} Hz (limit {limit_percent:g} %)",
    "check the load of the computer, the baud rate and the instrument's settings",
    "Hz",
)

# While there is no noise floor; the unit is that of the triad that moves.
_WAITING = "waiting for {floor_s:g} s without motion to measure the noise floor: "
_SHAKES = _WAITING + "it shakes, {triad} {axis} {found} (limit {allowed})"
_HANDS_OFF = "lay the unit on a firm surface and take the hands off"
NOT_QUIET_MISSING = Sentence(
    RefusalCode.NOT_QUIET, _WAITING + "samples are missing", "check cable, baud rate and load of the computer", "s"
)
NOT_QUIET_SHAKES = Sentence(RefusalCode.NOT_QUIET, _SHAKES, _HANDS_OFF)
NOT_QUIET_EVEN = Sentence(
    RefusalCode.NOT_QUIET,
    _SHAKES,
    "noise this even is no motion of a hand: if the unit lies still, the {triad}'s unit or range is set wrong "
    "(--set or the protocol)",
)
NOT_QUIET_STRAYS = Sentence(
    RefusalCode.NOT_QUIET,
    _WAITING + "it does not keep still, {triad} {axis} strays by {found} (limit {allowed})",
    _HANDS_OFF,
)

# What the positions and the moves between them contradict. The check of the moves has these words wherever it is told.
_GYROSCOPE_LOST = "the accelerometer positions stay valid; nothing of the gyroscope will be until this is corrected"
AXES_DIFFER = Sentence(
    RefusalCode.AXES,
    "gyroscope and accelerometer do not belong together: {handed}; as given the moves misfit by {measured:.0f} deg, "
    "with gyroscope {axes} by {best:.1f} deg (limit {limit:g} deg); correct driver or protocol",
    _GYROSCOPE_LOST,
    "deg",
)
AXES_OPEN = Sentence(
    RefusalCode.AXES,
    "axes not decided: as given the moves misfit by {measured:.0f} deg, the best arrangement by {best:.0f} deg "
    "(limit {limit:g} deg), the next by {second:.0f} deg; turn the unit slowly about different axes",
    _GYROSCOPE_LOST,
    "deg",
)
SCALE_DIFFERS = Sentence(
    RefusalCode.SCALE,
    "the unit turns {ratio:.3g} times as fast as the gyroscope says{cause}: as given the moves misfit by "
    "{measured:.0f} deg, with that factor{axes} by {best:.1f} deg (limit {limit:g} deg); "
    "correct unit or range of the gyroscope (--set or the protocol)",
    _GYROSCOPE_LOST,
    "deg",
)
_OWN_WAY = (
    "if you showed what was asked for, axes or signs in the driver or protocol are wrong: quit and correct them; "
    "if you go your own way, go on"
)
SAME_SIDE_AGAIN = Sentence(
    RefusalCode.AXES,
    "{limit:.0f} times {asked} up was asked for and the accelerometer saw {shown} up",
    _OWN_WAY,
    "sides",
)
SIDES_EXPLAINED = Sentence(
    RefusalCode.AXES,
    "the last {count} sides were none of those asked for, but all would be with the accelerometer's {axes}",
    _OWN_WAY,
    "sides",
)

# Whole turns.
_WHOLE_TURN = "begin on a side, turn by a whole turn about one axis, and end on the same side"
TURN_TILTED, TURN_ASIDE, TURN_SHORT = (
    Sentence(RefusalCode.NOT_WHOLE, f"no whole turn about {{axis}}: {what} (limit {{limit:g}} deg)", _WHOLE_TURN, "deg")
    for what in (
        "it came to rest {measured:.0f} deg from where it began",
        "it turned by {measured:.0f} deg about the other axes",
        "it turned by {angle:.0f} deg, {measured:.0f} deg from whole turns",
    )
)
