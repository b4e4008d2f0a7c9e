"""What the guide says and when it says it again: the events of a session in their order."""

from __future__ import annotations

import math

import numpy as np

from imufield.dataclass import replace
from imufield.guide.cross_checks.running_fit import Disagreement, RunningFit
from imufield.guide.events import Accepted, Event, Move, NoiseFloorMeasured, vector
from imufield.guide.hold.observe import Observation
from imufield.guide.lead.plan import Plan
from imufield.guide.positions import angle_deg
from imufield.guide.refusals import Refusal, quantity
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import CELL_S
from imufield.sentences import Sentences

sentence = Sentences(__package__)

REPEAT_S = 0.2  # Least time between two ``turning`` or ``holding`` events: a screen shows no more.
REMIND_S = 10.0  # Least time between two complaints about the same thing.
_ROUNDING_S = 1e-6  # Of times that are a whole number of cells apart.


class Speaker:
    """Collects events until they are taken, and remembers when each repeated one was due last."""

    def __init__(self) -> None:
        self.now_s = math.nan  # Sample clock at the end of the latest cell.
        self._events: list[Event] = []
        self._due_s: dict[str, float] = {}

    def say(self, *events: Event) -> None:
        """Append events."""
        self._events += events

    def reject(self, refusal: Refusal | None, position: str | None = None) -> None:
        """Append a refusal, if there is one."""
        if refusal is not None:
            self._events.append(refusal.event(self.now_s, position))

    def take(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def advance(self, cells: Cells, row: int) -> None:
        """Advance the time of the events; cells kept until the noise floor was known do not turn it back."""
        now_s = float(cells.end_s[row])
        if math.isnan(self.now_s) or now_s > self.now_s:
            self.now_s = now_s

    def due(self, what: str, every_s: float) -> bool:
        """Whether a repeated event is due; a time before the last one means a new clock, so it is."""
        last_s = self._due_s.get(what, -math.inf)
        if 0 <= self.now_s - last_s < every_s - _ROUNDING_S:
            return False
        self._due_s[what] = self.now_s
        return True


def move_event(now_s: float, plan: Plan, index: int) -> Move:
    """Return the event that proposes a position."""
    position = plan.position(index)
    # The first that applies.
    reasons = {
        "speaker.revisited": index == plan.revisiting,
        "speaker.wanted_again": index in plan.wanted_again,
        "speaker.lies_there": index == plan.first and not plan.accepted,
        "speaker.first_of_list": not plan.accepted,
        "speaker.helps_most": index == plan.preferred,
        "speaker.next_in_order": True,
    }
    return Move(
        time_s=now_s,
        position=position.name,
        direction=vector(position.direction),
        words=position.words,
        why=sentence(next(key for key, applies in reasons.items() if applies)),
        accepted=len(plan.accepted),
        planned=len(plan.scheme),
    )


def floor_event(now_s: float, floor: NoiseFloor, detector: StillnessDetector) -> NoiseFloorMeasured:
    """Return the event of a noise floor just measured."""
    scale = detector.scale
    (_, force_unit, force_factor), (_, rate_unit, rate_factor) = scale.triads
    force, rate, limit = (
        float(np.sqrt(np.mean(sigma**2))) / factor
        for sigma, factor in (
            (floor.sigma[:3], force_factor),
            (floor.sigma[3:], rate_factor),
            (detector.limits.vibration[:3], force_factor),
        )
    )
    words = sentence(
        "speaker.floor" if floor.has_gyroscope else "speaker.floor_without_gyroscope",
        force=quantity(force, force_unit),
        rate=quantity(rate, rate_unit),
        limit=quantity(limit, force_unit),
    )
    return NoiseFloorMeasured(
        time_s=now_s,
        accelerometer_sigma=force,
        accelerometer_unit=force_unit,
        gyroscope_sigma=rate,
        gyroscope_unit=rate_unit,
        vibration_limit=limit,
        rate_hz=floor.samples_per_cell / CELL_S,
        scale_learned=scale.learned,
        words=f"{words}; {sentence('speaker.scale_learned')}" if scale.learned else words,
    )


def accepted_event(
    now_s: float,
    observation: Observation,
    scale: RoughScale,
    plan: Plan,
    *,
    replaces: bool,
    fit: RunningFit | None,
    forecast: dict[str, float] | None,
    others: Disagreement | None,
) -> Accepted:
    """Return the event of an observation just taken; running fit and comparison with the others are None before the first."""
    direction = scale.up(observation.mean_raw)
    sigma = math.sqrt(float(np.diag(observation.covariance_raw).max())) / (scale.accelerometer or math.nan)
    hand = observation.hand_mean
    event = Accepted(
        time_s=now_s,
        position=observation.name,
        direction=vector(direction),
        angle_deg=angle_deg(observation.direction, direction),
        start_s=observation.start_s,
        duration_s=observation.duration_s,
        sigma_m_s2=sigma,
        temperature_degc=observation.temperature_degc,
        accepted=len(plan.accepted),
        planned=len(plan.scheme),
        replaces=replaces,
    )
    if hand is not None:
        event = replace(event, held=True, tremor_deg=hand.tremor_deg, sway_deg=hand.sway_deg)
    if fit is not None and others is not None:
        # A revisit replaces nothing: the row is that of the measurement before, which has the same name.
        row = fit.names.index(observation.name)
        event = replace(
            event,
            residual_m_s2=float(fit.residual_m_s2[row]),
            forecast=forecast,
            leave_one_out_m_s2=others.leave_one_out_m_s2,
            suspect=others.is_suspect,
            rank=fit.rank,
            condition=fit.condition,
        )
    return event
