"""Refusals: reason, sentences and unit of each. Texts are in ``guide/sentences.toml``, the places of use give the numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imufield.dataclass import dataclass, fields, replace
from imufield.guide.events import RefusalCode, Rejected
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

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
    taken_back: bool = False

    def event(self, now_s: float, position: str | None) -> Rejected:
        """Return the event of this refusal."""
        return Rejected(time_s=now_s, position=position, **{field.name: getattr(self, field.name) for field in fields(self)})


@dataclass(frozen=True, slots=True)
class RefusalKind:
    """One row of the table: the keys of what was found and of what to do, and the unit of the measured value and its limit."""

    reason: RefusalCode
    words: str
    remedy: str
    unit: str = ""

    def refusal(
        self, measured: float, limit: float, *, axis: str | None = None, unit: str | None = None, **values: float | str
    ) -> Refusal:
        """Return the refusal with these numbers; ``unit`` where the table has none."""
        unit = self.unit if unit is None else unit
        values |= {"measured": measured, "limit": limit, "axis": axis or ""}
        values["found"], values["allowed"] = quantities(measured, limit, unit)
        return Refusal(
            reason=self.reason,
            words=sentence(self.words, **values),
            remedy=sentence(self.remedy, **values),
            measured=measured,
            limit=limit,
            unit=unit,
            axis=axis,
        )

    def beyond(self, measured: float, limit: float, *, axis: str | None = None, **values: float | str) -> Refusal | None:
        """Return the refusal where the value passes its limit."""
        return self.refusal(measured, limit, axis=axis, unit=None, **values) if measured > limit else None


def quantity(value: float, unit: str, beside: float = 0.0) -> str:
    """Return a value in the unit people use for its size, mm/s^2 or deg/s; in that of a larger one it stands beside."""
    if unit == "m/s^2":
        return f"{1e3 * value:.3g} mm/s^2" if max(abs(value), abs(beside)) < 1 else f"{value:.3g} m/s^2"
    if unit == "rad/s":
        return f"{math.degrees(value):.2g} deg/s"
    return f"{value:.3g} {unit}"


def quantities(measured: float, limit: float, unit: str) -> tuple[str, str]:
    """Return a value and its limit in one unit."""
    return quantity(measured, unit, limit), quantity(limit, unit, measured)


def taken_back(refusal: Refusal, position: str) -> Refusal:
    """Return the refusal of a position that was accepted before later holds showed what is wrong with it."""
    words = sentence("refusals.taken_back", position=position, words=refusal.words)
    return replace(refusal, words=words, taken_back=True)


def what_is_left(names: Sequence[str]) -> Sentence:
    """Return the remedy at a side that is measured already: the names of the others."""
    if not names:
        return sentence("refusals.none_left")
    more = len(names) - _NAMED_AT_ONCE
    key = "refusals.left" if more <= 0 else "refusals.left_and_more"
    return sentence(key, count=len(names), names=list(names[:_NAMED_AT_ONCE]), more=more)


# A hold that ends by motion; the unit is that of the triad that moved.
MOVED = RefusalKind(RefusalCode.MOVED, "refusals.moved", "refusals.moved_remedy")
MOVED_AGAIN = RefusalKind(RefusalCode.MOVED, "refusals.moved", "refusals.moved_again_remedy")
TOO_SHORT_IN_HAND = RefusalKind(RefusalCode.MOVED, "refusals.short_in_hand", "refusals.short_in_hand_remedy", "s")
NOT_STILL = RefusalKind(RefusalCode.NOT_STILL, "refusals.not_still", "refusals.not_still_remedy")

# Where the unit is.
NOT_NEAR = RefusalKind(RefusalCode.NOT_NEAR, "refusals.not_near", "refusals.not_near_remedy", "deg")
NOT_NEAR_BY_OFFSET = RefusalKind(RefusalCode.NOT_NEAR, "refusals.not_near", "refusals.not_near_by_offset_remedy", "deg")
ALREADY_DONE = RefusalKind(RefusalCode.ALREADY_DONE, "refusals.already_done", "refusals.already_done_remedy", "deg")
OTHER_SIDE = RefusalKind(RefusalCode.OTHER_SIDE, "refusals.other_side", "refusals.other_side_remedy", "deg")

# What happened during the hold.
KNOCKED = RefusalKind(RefusalCode.KNOCKED, "refusals.knocked", "refusals.knocked_remedy", "%")
PUSHED = RefusalKind(RefusalCode.KNOCKED, "refusals.pushed", "refusals.pushed_remedy", "deg")
BUMPED = RefusalKind(RefusalCode.KNOCKED, "refusals.bumped", "refusals.bumped_remedy", "m/s^2")
TREMBLING = RefusalKind(RefusalCode.TREMBLING, "refusals.trembling", "refusals.trembling_remedy", "deg")
SWAYING = RefusalKind(RefusalCode.SWAYING, "refusals.swaying", "refusals.swaying_remedy", "deg")
DRIFTS = RefusalKind(RefusalCode.DRIFTING, "refusals.drifts", "refusals.drifting_remedy", "m/s^2")
TILTS = RefusalKind(RefusalCode.DRIFTING, "refusals.tilts", "refusals.drifting_remedy", "deg")
WARMING_UP = RefusalKind(RefusalCode.WARMING_UP, "refusals.warming_up", "refusals.warming_up_remedy", "degC/min")

# What the samples are worth.
SATURATED = RefusalKind(RefusalCode.SATURATED, "refusals.saturated", "refusals.saturated_remedy", "%")
SATURATED_ON_AXIS = RefusalKind(RefusalCode.SATURATED, "refusals.saturated_on_axis", "refusals.saturated_remedy", "%")
START_UP = RefusalKind(RefusalCode.START_UP, "refusals.start_up", "refusals.start_up_remedy", "%")
FAULT = RefusalKind(RefusalCode.INVALID, "refusals.fault", "refusals.fault_remedy", "%")
ACCELEROMETER_INVALID = RefusalKind(RefusalCode.INVALID, "refusals.accelerometer_invalid", "refusals.invalid_remedy", "%")
GYROSCOPE_INVALID = RefusalKind(RefusalCode.INVALID, "refusals.gyroscope_invalid", "refusals.invalid_remedy", "%")
SAMPLE_LOSS = RefusalKind(RefusalCode.SAMPLE_LOSS, "refusals.sample_loss", "refusals.sample_loss_remedy", "%")
STUCK = RefusalKind(RefusalCode.STUCK, "refusals.stuck", "refusals.stuck_remedy", "raw unit")
FROZEN = RefusalKind(RefusalCode.FROZEN, "refusals.frozen", "refusals.frozen_remedy", "s")
DEAD_AXIS = RefusalKind(RefusalCode.INVALID, "refusals.dead_axis", "refusals.dead_axis_remedy", "raw unit")
GRAVITY = RefusalKind(RefusalCode.GRAVITY, "refusals.gravity", "refusals.gravity_remedy", "m/s^2")
CLOCK_FORWARD = RefusalKind(RefusalCode.CLOCK_JUMP, "refusals.clock_forward", "refusals.clock_remedy", "s")
CLOCK_SET = RefusalKind(RefusalCode.CLOCK_JUMP, "refusals.clock_set", "refusals.clock_remedy", "%")
CLOCK_BACK = RefusalKind(RefusalCode.CLOCK_JUMP, "refusals.clock_back", "refusals.clock_remedy", "s")
RATE = RefusalKind(RefusalCode.RATE, "refusals.rate", "refusals.rate_remedy", "Hz")

# While there is no noise floor; the unit is that of the triad that moves.
NOT_QUIET_MISSING = RefusalKind(RefusalCode.NOT_QUIET, "refusals.not_quiet_missing", "refusals.not_quiet_missing_remedy", "s")
NOT_QUIET_SHAKES = RefusalKind(RefusalCode.NOT_QUIET, "refusals.not_quiet_shakes", "refusals.not_quiet_remedy")
NOT_QUIET_EVEN = RefusalKind(RefusalCode.NOT_QUIET, "refusals.not_quiet_shakes", "refusals.not_quiet_even_remedy")
NOT_QUIET_GYROSCOPE = RefusalKind(RefusalCode.NOT_QUIET, "refusals.not_quiet_shakes", "refusals.not_quiet_gyroscope_remedy")
NOT_QUIET_STRAYS = RefusalKind(RefusalCode.NOT_QUIET, "refusals.not_quiet_strays", "refusals.not_quiet_remedy")

# What the positions and the moves between them contradict.
AXES_LEFT_HANDED = RefusalKind(RefusalCode.AXES, "refusals.axes_left_handed", "refusals.gyroscope_lost_remedy", "deg")
AXES_DIFFER = RefusalKind(RefusalCode.AXES, "refusals.axes_differ", "refusals.gyroscope_lost_remedy", "deg")
AXES_OPEN = RefusalKind(RefusalCode.AXES, "refusals.axes_open", "refusals.gyroscope_lost_remedy", "deg")
MOTIONLESS = RefusalKind(RefusalCode.AXES, "refusals.motionless", "refusals.gyroscope_lost_remedy", "deg")
SCALE_DIFFERS = RefusalKind(RefusalCode.SCALE, "refusals.scale_differs", "refusals.gyroscope_lost_remedy", "deg")
SCALE_AND_AXES = RefusalKind(RefusalCode.SCALE, "refusals.scale_and_axes", "refusals.gyroscope_lost_remedy", "deg")
SAME_SIDE_AGAIN = RefusalKind(RefusalCode.AXES, "refusals.same_side_again", "refusals.own_way_remedy", "sides")
SIDES_EXPLAINED = RefusalKind(RefusalCode.AXES, "refusals.sides_explained", "refusals.own_way_remedy", "sides")

# Whole turns.
TURN_TILTED = RefusalKind(RefusalCode.NOT_WHOLE, "refusals.turn_tilted", "refusals.turn_remedy", "deg")
TURN_ASIDE = RefusalKind(RefusalCode.NOT_WHOLE, "refusals.turn_aside", "refusals.turn_remedy", "deg")
TURN_SHORT = RefusalKind(RefusalCode.NOT_WHOLE, "refusals.turn_short", "refusals.turn_remedy", "deg")
OTHER_TURN = RefusalKind(RefusalCode.OTHER_TURN, "refusals.other_turn", "refusals.other_turn_remedy", "deg")
