"""How long a placed session takes against holds and turns alone, and what the terminal view costs."""

from __future__ import annotations

import io
import time

from rich.console import Console

from imufield.guide.events import Accepted, Done, Event, Move
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.view.terminal import TerminalView
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings

RATE_HZ = 200.0
HOLD_S = 10.0
BLOCK = 20


def session() -> tuple[list[Event], Operator]:
    """Play a placed session at 10 s hold with an operator who waits for "accepted"."""
    plan = scheme("paper24")
    operator = Operator(plan.directions(), 7, OperatorSettings(hold_s=HOLD_S, initial_still_s=4.0, waits=True))
    imu = Imu(perfect_instrument(TACTICAL), 7, ImuSettings(rate_hz=RATE_HZ))
    guide = Guide(plan, imu.instrument.grade.units, settings=GuideSettings(hold_s=HOLD_S))
    names = [position.name for position in plan.positions]
    events: list[Event] = []
    target = None
    for first in range(0, round(3600 * RATE_HZ), BLOCK):
        said = guide.feed(imu.feed(operator.block(first, BLOCK, imu.interval_s)))
        events += said
        target = next((names.index(event.position) for event in said if isinstance(event, Move)), target)
        if any(isinstance(event, Accepted) for event in said):
            operator.accepted(target)
        if guide.done:
            break
    return events, operator


def length_factor() -> float:
    events, operator = session()
    end_s = next(event.time_s for event in events if isinstance(event, Done))
    turns = sum(move.end_s - move.start_s for move in operator.moves if move.end_s <= end_s)
    return end_s / (24 * HOLD_S + turns)


def frame_ms(frames: int = 200) -> float:
    """Processor time of a frame of the terminal view."""
    plan = scheme("paper24")
    imu = Imu(perfect_instrument(TACTICAL), 1, ImuSettings(rate_hz=RATE_HZ))
    operator = Operator(plan.directions(), 1, OperatorSettings())
    guide = Guide(plan, imu.instrument.grade.units)
    console = Console(file=io.StringIO(), force_terminal=True, width=80, height=24)
    spent = 0.0
    with TerminalView(plan, console) as view:
        for frame in range(frames):
            events = guide.feed(imu.feed(operator.block(frame * BLOCK, BLOCK, imu.interval_s)))
            begin = time.process_time()
            view.show(events, guide.snapshot(), 0)
            spent += time.process_time() - begin
    return 1e3 * spent / frames


def run() -> list[dict[str, object]]:
    """Return rows of name, value, unit."""
    frame = frame_ms()
    return [
        {"name": "placed session at 10 s hold, over holds and turns", "value": round(length_factor(), 3), "unit": "times"},
        {"name": "terminal view: a frame", "value": round(frame, 2), "unit": "ms of processor time"},
        {"name": "terminal view at 10 frames/s", "value": round(frame, 2), "unit": "% of a core"},
    ]


if __name__ == "__main__":
    for row in run():
        print(f"{row['name']:55} {row['value']:>8} {row['unit']}")
