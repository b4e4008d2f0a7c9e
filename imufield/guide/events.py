"""Events of the guide, the same for every front end (docs/events.md).

An event is a value; ``to_dict`` returns it for JSON lines, with ``version`` and ``event``. Within one version keys are only
added. Times are of the sample clock. Terminal, plain lines, JSON lines and sound render these and nothing else.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import ClassVar

import numpy as np

from imufield.dataclass import dataclass, field, fields
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

EVENT_VERSION = 1

HORIZONTAL = "horizontal"
VERTICAL = "vertical"
"""What an axis of whole turns is."""
ACTIONS = ("retake", "skip", "undo", "pause", "finish", "go_on", "reopen")
"""What an operator's mark asks for."""

Vector = tuple[float, float, float]


def vector(values: FloatArray) -> Vector:
    """Return an array (3,) as plain numbers."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


class RefusalCode(Enum):
    """Why a hold was refused."""

    MOVED = "moved"
    NOT_STILL = "not_still"
    KNOCKED = "knocked"
    DRIFTING = "drifting"
    NOT_NEAR = "not_near"
    ALREADY_DONE = "already_done"
    GRAVITY = "gravity"
    SATURATED = "saturated"
    STUCK = "stuck"
    FROZEN = "frozen"
    START_UP = "start_up"
    INVALID = "invalid"
    SAMPLE_LOSS = "sample_loss"
    NOT_QUIET = "not_quiet"
    AXES = "axes"
    TREMBLING = "trembling"
    SWAYING = "swaying"
    WARMING_UP = "warming_up"
    CLOCK_JUMP = "clock_jump"
    RATE = "rate"
    SCALE = "scale"
    NOT_WHOLE = "not_whole"
    OTHER_SIDE = "other_side"
    OTHER_TURN = "other_turn"


EVENTS: dict[str, type[Event]] = {}
"""All events by their name on the wire."""


@dataclass(frozen=True, slots=True)
class Event:
    """Base of all events."""

    kind: ClassVar[str] = ""

    time_s: float
    """Sample clock."""

    def __init_subclass__(cls, kind: str = "") -> None:
        # A dataclass with slots is made twice; the second class, which is used, has the name from the first.
        cls.kind = kind or cls.kind
        EVENTS[cls.kind] = cls

    def to_dict(self) -> dict[str, object]:
        """Return the event as plain values for JSON; a value that is not finite becomes None."""
        values = {field.name: _plain(getattr(self, field.name)) for field in fields(self)}
        return {"version": EVENT_VERSION, "event": self.kind, **values}


def _plain(value: object) -> object:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFloorMeasured(Event, kind="noise_floor"):
    """The noise floor is known; stillness is judged from here on."""

    accelerometer_sigma: float
    """Rms of single samples over the axes, in ``accelerometer_unit``."""
    accelerometer_unit: str
    gyroscope_sigma: float
    """NaN without a gyroscope."""
    gyroscope_unit: str
    vibration_limit: float
    """Rms vibration of the accelerometer at which a stretch cannot begin, ``accelerometer_unit``."""
    rate_hz: float
    scale_learned: bool
    """The rough scale comes from this still: its norm was taken as g."""
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Move(Event, kind="move"):
    """Bring the unit to the next position."""

    position: str
    direction: Vector
    """Of up, in the body frame."""
    words: str
    why: str
    accepted: int
    planned: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Turning(Event, kind="turning"):
    """The unit moves; where it points now. At most a few a second."""

    direction: Vector
    """Of the specific force, in the body frame: up, as long as the motion is slow."""
    position: str
    """Nearest pending position."""
    angle_deg: float
    """From there."""
    target: str
    """Proposed position."""
    target_angle_deg: float


@dataclass(frozen=True, slots=True)
class Hold(Event, kind="hold"):
    """The unit is still at a pending position: leave it."""

    position: str
    words: str
    angle_deg: float
    """Off the planned direction."""
    hold_s: float
    """Expected: it ends when its mean is good enough, which noise that is not white puts off."""


@dataclass(frozen=True, slots=True)
class Holding(Event, kind="holding"):
    """Part of the hold is done. At most a few a second."""

    position: str
    fraction: float
    remaining_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Accepted(Event, kind="accepted"):
    """The position is measured."""

    position: str
    direction: Vector
    """As measured."""
    angle_deg: float
    start_s: float
    duration_s: float
    sigma_m_s2: float
    """1 sigma of the mean, largest axis; NaN where the scale is not known."""
    temperature_degc: float
    accepted: int
    planned: int
    replaces: bool = False
    """An older observation of this position was replaced (it stays in the recording)."""
    residual_m_s2: float | None = None
    """Of a fit to all positions so far; None until there are four."""
    forecast: dict[str, float] | None = None
    """1 sigma of the parameters now, with that of gravity and what is typical of the grade, as in the result: bias_ug,
    scale_ppm, misalignment_urad, quadratic_ug_per_g2; a group that the positions do not show yet is left out."""
    leave_one_out_m_s2: float | None = None
    """Against a fit to all others; None likewise."""
    rank: int | None = None
    """Number of parameters that the positions so far show, of 12."""
    condition: float | None = None
    held: bool = False
    """The unit was in the hand: every sample was turned into one frame with the gyroscope."""
    tremor_deg: float | None = None
    sway_deg: float | None = None
    """Rms of each axis above and below 4 Hz, of a unit in the hand."""
    suspect: bool = False
    """The others contradict it already: it was probably moved or bumped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejected(Event, kind="rejected"):
    """A hold was refused, or cannot begin: why, by how much, and what to do."""

    position: str | None
    reason: RefusalCode
    words: str
    """The finding, one sentence."""
    remedy: str
    """What to do, one sentence."""
    measured: float
    limit: float
    unit: str
    axis: str | None = None
    taken_back: bool = False
    """Whether it takes back an earlier ``Accepted`` of the position."""


class Topic(Enum):
    """What an advice is about."""

    DOUBTFUL = "doubtful"
    SETTLED = "settled"
    """The position is no suspect any more."""
    TARGET_MET = "target_met"
    SCHEME = "scheme"
    DRIFT = "drift"
    SCALE = "scale"
    ORDER = "order"
    """A drift would look like a quadratic term in the order of positions so far."""
    OFFSET = "offset"
    TIME = "time"
    """How long the session takes to the accuracy that is wanted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice(Event, kind="advice"):
    """Something the operator may act on, or not; nothing is refused."""

    topic: Topic
    position: str | None
    words: str
    remedy: str
    measured: float
    limit: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn(Event, kind="turn"):
    """Make a whole turn for the gyroscope."""

    axis: str
    """Body axis to turn about."""
    sense: int
    """+1 or -1, right-handed about that axis."""
    about: str
    """"horizontal" (rolled edge over edge) or "vertical" (on a turntable or flat surface)."""
    words: str
    done: int
    planned: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Turned(Event, kind="turned"):
    """A whole turn is done; ``start_s`` and ``end_s`` are the ends of the motion on the sample clock."""

    axis: str
    turns: int
    """Signed whole turns."""
    about: str
    start_s: float
    end_s: float
    angle_deg: float
    """By the uncalibrated gyroscope."""
    tilt_deg: float
    """Between up before and up after."""
    done: int
    planned: int


@dataclass(frozen=True, slots=True)
class Marked(Event, kind="marked"):
    """An operator's mark was applied, or could not be."""

    action: str
    position: str | None
    words: str


@dataclass(frozen=True, slots=True)
class LinkLost(Event, kind="link_lost"):
    """No more samples arrive."""

    accepted: int
    planned: int
    words: str = field(default_factory=lambda: sentence("events.link_lost"))
    resumed: bool = False
    """No link was lost: the operator had stopped the session, and goes on with it."""


@dataclass(frozen=True, slots=True)
class LinkBack(Event, kind="link_back"):
    """Samples arrive again."""

    words: str


@dataclass(frozen=True, slots=True)
class Done(Event, kind="done"):
    """Nothing is left to do."""

    accepted: int
    planned: int
    skipped: tuple[str, ...]
    """Positions without an observation."""
    words: str
