"""The guide: leads one person through the positions. Samples in, events out; no I/O, no clock but the samples' own.

``state_table`` says what happens when; here are the actions. Everything is decided between two cells of the sample clock,
so the same recording with the same marks gives the same events, however it is cut: a mark takes effect when the cell in
which it was made is complete.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.guide.cross_checks.axes import ENOUGH_MOVES, AxesCheck, MoveLog, check_axes
from imufield.guide.cross_checks.sides import DeadAxis
from imufield.guide.events import Event, Marked, RefusalCode, Vector
from imufield.guide.hold.checks import explain_flags
from imufield.guide.hold.observe import gather
from imufield.guide.lead.actions import GuideActions
from imufield.guide.lead.plan import Plan
from imufield.guide.lead.refusals import axes_refusal, clock_refusal, not_quiet_refusal, rate_refusal, vector
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import TABLE, Input, State
from imufield.guide.positions import Scheme
from imufield.guide.stillness.cells import CellBuilder, Cells, join_cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.limits import Activity
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Judgement, Phase
from imufield.samples import Samples, SampleUnits

_BAD_IN_A_ROW = 3  # Cells without usable samples before anybody is told.
_IN_VAIN = 5  # Lengths of a noise floor waited for before settings are doubted.
ACTIONS = ("retake", "skip", "undo", "pause", "finish", "go_on", "reopen")
# What the operator says that is an input of the table and nothing else.
_INPUTS = {"pause": Input.PAUSE, "finish": Input.FINISH, "reopen": Input.RESUMED}
RATE_CELLS = 50
RATE_SHARE = 0.05
"""Change of the sample rate over five seconds that is told: oscillators differ by 0.01 %."""
JUMP_S = 2.0
"""A gap in the sample clock that is told: a suspended computer, an instrument that began anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """What a live view shows beside the events."""

    state: State
    time_s: float
    target: str | None
    """Proposed position."""
    position: str | None
    """The one under way."""
    fraction: float
    activity: Activity | None
    """Stillness of the latest cell against its limit."""
    rate_hz: float
    """Over the last second; NaN before."""
    lost_cells: int
    """Cells with missing or unusable samples so far."""
    temperature_degc: float
    accepted: tuple[str, ...]
    skipped: tuple[str, ...]
    planned: int
    direction: Vector | None = None
    """Where up is in the body now, unit vector; None before the first sample, or in free fall."""
    target_direction: Vector | None = None
    in_hand: bool = False
    doubtful: tuple[str, ...] = ()
    forecast: dict[str, float] | None = None
    """1 sigma of the parameters now, see ``Accepted``; None until there are four positions."""


class Guide:
    """A guided session.

    Parameters
    ----------
    scheme : Scheme
    units : SampleUnits
    scale : RoughScale, optional
        What is known of the raw units; by default what their names say.
    settings : GuideSettings, optional
    """

    def __init__(
        self, scheme: Scheme, units: SampleUnits, *, scale: RoughScale | None = None, settings: GuideSettings | None = None
    ) -> None:
        self.settings = settings or GuideSettings()
        self.plan = Plan(scheme, self.settings.tolerance_deg)
        self.units = units
        self.state = State.LEARNING
        self.time_s = math.nan  # Sample clock of the latest sample.
        longest_s = max(self.settings.stillness.longest_s, self.settings.wish.longest_s + 10)
        stillness = replace(self.settings.stillness, longest_s=longest_s, hand=True)
        self.detector = StillnessDetector(scale or RoughScale.of_units(units), stillness)
        self._do = GuideActions(self.plan, self.detector, self.settings)
        self._builder = CellBuilder(stillness.cell_s)
        self._marks: list[tuple[int, str, str | None]] = []
        self._moves = MoveLog(stillness.cell_s)
        self._dead_axis = DeadAxis()
        self._axes_asked = 0  # Positions at the last look at the axes; all, once the moves have told.
        self._axes_told: set[tuple[RefusalCode, bool]] = set()
        self._slot: int | None = None
        self._counts: deque[int] = deque(maxlen=RATE_CELLS)
        self._recent: Cells | None = None
        self._bad_cells = 0
        self._bad_in_a_row = 0
        self._waited = 0

    @property
    def done(self) -> bool:
        """Whether nothing is left to do."""
        return self.state is State.DONE

    @property
    def finished_early(self) -> bool:
        """Whether the operator ended it with something left that was asked for."""
        return self.done and (self.plan.proposed() is not None or self._do.turns.was_given_up)

    def asked_to_finish(self) -> Marked:
        """Return what to say when somebody wants to finish: what there would be, and how to mean it."""
        turns = self._do.turns
        rolled = f" and {turns.planned - len(turns.left)} of {turns.planned} turns" if turns.planned else ""
        words = f"f again to finish with {len(self.plan.accepted)} of {len(self.plan.scheme)} positions{rolled}"
        return Marked(self.time_s, "finish", None, words)

    def feed(self, samples: Samples) -> list[Event]:
        """Take the next samples and return what there is to say."""
        if not len(samples):
            return []
        if self.state is State.LOST:
            self._handle(Input.LINK_BACK)
        self.time_s = float(samples.time_s[-1])
        self._do.weighing.history.add(samples)
        cells = self._builder.feed(samples)
        if cells is not None:
            self._take(cells)
        self._do.weighing.history.prune()
        return self._said_now()

    def mark(self, action: str, time_s: float, position: str | None = None) -> list[Event]:
        """Take what the operator says, one of ``ACTIONS``; ``retake`` may name a position, otherwise the last is meant.

        It takes effect when the cell of ``time_s`` is complete; so on replay all marks may be given beforehand. Without
        a link it takes effect at once.
        """
        if action not in ACTIONS:
            raise ValueError(f"`action` is {action!r}, not one of {', '.join(ACTIONS)}")
        if self.state in (State.LOST, State.DONE) or math.isnan(time_s):
            self._apply_mark(action, position)
        else:
            self._marks.append((int(self._builder.slots(np.array([time_s]))[0]), action, position))
            self._marks.sort(key=lambda mark: mark[0])
        return self._said_now()

    def link_lost(self) -> list[Event]:
        """Say that no samples arrive any more; nothing measured is lost."""
        while self._marks:
            self._apply_mark(*self._marks.pop(0)[1:])
        self._builder = CellBuilder(self.detector.settings.cell_s)
        # What comes next may be of another clock and another rate: a pause is no jump.
        self._slot = None
        self._counts.clear()
        self._handle(Input.LINK_LOST)
        return self._said_now()

    def link_back(self) -> list[Event]:
        """Say that samples arrive again; the sample clock may have started anew."""
        self._handle(Input.LINK_BACK)
        return self._said_now()

    def flush(self) -> list[Event]:
        """Judge the unfinished cell: the recording ends here."""
        cells = self._builder.flush()
        if cells is not None:
            self._take(cells)
        while self._marks:
            self._apply_mark(*self._marks.pop(0)[1:])
        return self._said_now()

    def observations(self) -> Observations:
        """Return what was accepted, in order of acceptance."""
        return gather(list(self.plan.accepted.values()), self.units)

    def turn_rests(self) -> Observations:
        """Return the stills between the whole turns: they tell the gyroscope where a turn began and ended."""
        return gather(self._do.turns.rests, self.units)

    def check_axes(self) -> AxesCheck:
        """Compare the turns that accelerometer and gyroscope saw between the stills so far."""
        return check_axes(self._moves.moves(self.detector.scale), self.detector.scale.gyroscope)

    def snapshot(self) -> Snapshot:
        """Return what a live view shows."""
        target = self.plan.proposed() if self._do.announced else None
        recent = self._recent
        span = float(recent.slot[-1] - recent.slot[0] + 1) * self._builder.cell_s if recent is not None else math.nan
        return Snapshot(
            state=self.state,
            time_s=self.time_s,
            target=None if target is None else self.plan.position(target).name,
            position=None if self._do.position is None else self.plan.position(self._do.position).name,
            fraction=self._do.weighing.fraction,
            activity=None if self._do.judgement is None else self.detector.explain(self._do.judgement),
            rate_hz=float(recent.count.sum()) / span if recent is not None else math.nan,
            lost_cells=self._bad_cells,
            temperature_degc=float(recent.temperature_degc[-1]) if recent is not None else math.nan,
            accepted=tuple(self.plan.position(i).name for i in self.plan.accepted),
            skipped=tuple(self.plan.position(i).name for i in sorted(self.plan.skipped)),
            planned=len(self.plan.scheme),
            direction=self._do.direction_now(),
            target_direction=None if target is None else vector(self.plan.position(target).direction),
            in_hand=self.detector.in_hand,
            doubtful=tuple(one.name for one in self._do.doubts.now),
            forecast=None if self._do.fit is None else self._do.fit.forecast(),
        )

    def _said_now(self) -> list[Event]:
        events, self._do.events = self._do.events, []
        return events

    def _take(self, cells: Cells) -> None:
        """Take finished cells in order, each mark right after the cell in which it was made."""
        while self._marks and len(cells) and bool((cells.slot >= self._marks[0][0]).any()):
            upto = int(np.argmax(cells.slot >= self._marks[0][0])) + 1
            self._judge_cells(cells[:upto])
            cells = cells[upto:]
            self._apply_mark(*self._marks.pop(0)[1:])
        if len(cells):
            self._judge_cells(cells)

    def _judge_cells(self, cells: Cells) -> None:
        self._recent = cells[-10:] if self._recent is None else join_cells([self._recent, cells[-10:]])[-10:]
        # One by one while the noise floor is not known: what is said must not depend on where a block was cut.
        while len(cells) and self.detector.floor is None:
            self._wait_for_floor(cells[:1])
            cells = cells[1:]
        for judgement in self.detector.judge(cells):
            self._watch_data(judgement.cells, judgement.row)
            self._follow(judgement)

    def _wait_for_floor(self, cell: Cells) -> None:
        self._watch_data(cell, 0)
        for judgement in self.detector.judge(cell):
            self._follow(judgement)
        if self.detector.floor is None:
            self._explain_waiting(cell)

    def _follow(self, judgement: Judgement) -> None:
        """Tell the state table what a cell meant."""
        self._do.judgement = judgement
        self._set_time(judgement.cells, judgement.row)
        if not self._do.announced and Input.FLOOR in TABLE[self.state]:
            self._handle(Input.FLOOR)
        if judgement.ended is not None:
            self._handle(Input.ENDED)
            dead = self._dead_axis.leave_side(self.detector.floor, self.detector.scale)
            if dead is not None:
                self._do.reject(dead)
        if judgement.phase is Phase.STILL:
            self._handle(Input.STILL)
        else:
            self._do.note_motion(judgement)
            self._handle(Input.MOVING)
        self._moves.follow(judgement, self.detector.stretch.mean)
        if len(self.plan.accepted) > max(self._axes_asked, ENOUGH_MOVES):
            self._ask_axes()

    def _ask_axes(self) -> None:
        """See with each new position whether axes and scale agree, until the moves tell; say once that they do not."""
        axes = self.check_axes()
        found = axes_refusal(axes)
        self._axes_asked = len(self.plan.accepted) if axes.agrees is None else len(self.plan.scheme)
        # That nothing fits, a scale, wrong axes: each is said once, as soon as the moves tell.
        kind = (found.reason, axes.agrees is False)
        if axes.is_contradicted and kind not in self._axes_told:
            self._axes_told.add(kind)
            self._do.reject(found)

    def _set_time(self, cells: Cells, row: int) -> None:
        """Advance the time of what is said; cells kept until the noise floor was known do not turn it back."""
        now_s = float(cells.end_s[row])
        if math.isnan(self._do.now_s) or now_s > self._do.now_s:
            self._do.now_s = now_s

    def _handle(self, happened: Input) -> None:
        """Look up what to do, do it, and follow the answer."""
        answer: Input | None = happened
        while answer is not None:
            transition = TABLE[self.state].get(answer)
            if transition is None:
                return
            self.state = transition.to
            answer = self._do.by_name[transition.action]()

    def _watch_data(self, cells: Cells, row: int) -> None:
        """Count cells with missing or unusable samples; say so when several follow each other."""
        self._do.warmth.follow(cells, row)
        self._dead_axis.follow(cells, row)
        self._watch_clock(cells, row)
        floor, share = self.detector.floor, self.detector.settings.usable_fraction
        usual = cells.count[row] if floor is None else floor.samples_per_cell
        if cells.usable[row] >= share * usual:
            self._bad_in_a_row = 0
            return
        self._bad_in_a_row += 1
        self._bad_cells += 1
        if self._bad_in_a_row >= _BAD_IN_A_ROW and self.state is not State.DONE:
            self._set_time(cells, row)
            refusal = explain_flags(cells[row : row + 1], 0.0, share)
            if self._do.due(f"data {refusal.reason.value}", self.settings.remind_s):
                self._do.reject(refusal)

    def _watch_clock(self, cells: Cells, row: int) -> None:
        """Say when the sample clock jumps or the sample rate changes."""
        before, self._slot = self._slot, int(cells.slot[row])
        gap_s = 0.0 if before is None else (self._slot - before) * self.detector.settings.cell_s
        if not -JUMP_S < gap_s < JUMP_S:
            self._counts.clear()
            self._do.warmth.clear()
            self._do.reject(clock_refusal(gap_s, JUMP_S))
            return
        self._counts.append(int(cells.count[row]))
        floor = self.detector.floor
        if floor is None or len(self._counts) < RATE_CELLS:
            return
        # The median does not mind cells with lost samples; those are told elsewhere.
        share = float(np.median(self._counts)) / floor.samples_per_cell - 1
        if (
            abs(share) > RATE_SHARE
            and abs(share) * floor.samples_per_cell > 1
            and self._do.due("rate", 6 * self.settings.remind_s)
        ):
            self._do.reject(rate_refusal(share, RATE_SHARE, floor.samples_per_cell / self.detector.settings.cell_s))

    def _explain_waiting(self, cells: Cells) -> None:
        """Say what is waited for while there is no noise floor."""
        self._waited += len(cells)
        self._set_time(cells, -1)
        waited_s = self._waited * self.detector.settings.cell_s
        floor_s = self.detector.settings.floor_s
        if waited_s > 2 * floor_s and cells.usable.any() and self._do.due("not quiet", self.settings.remind_s):
            in_vain = waited_s > _IN_VAIN * floor_s
            self._do.reject(not_quiet_refusal(self.detector.waited(), self.detector.scale, floor_s, in_vain=in_vain))

    def _apply_mark(self, action: str, name: str | None) -> None:
        before = self.plan.proposed()
        if action in _INPUTS:
            self._handle(_INPUTS[action])
            return
        if action == "go_on":
            self._do.go_cold = True
            self._do.events.append(Marked(self._do.now_s, action, None, "going on although the temperature changes"))
            return
        index, words = {"retake": self._retake, "skip": self._skip, "undo": self._undo}[action](name)
        said = None if index is None else self.plan.position(index).name
        self._do.events.append(Marked(self._do.now_s, action, said, words))
        if action == "skip" and self.state is State.ROLLING and index is None:
            self._skip_turn()
        elif self.plan.proposed() is None:
            answer = self._do.go_on()
            if answer is not None:
                self._handle(answer)
        elif self.plan.proposed() != before or action == "retake":
            if Input.REOPENED in TABLE[self.state]:
                self.detector.restart()
                self._handle(Input.REOPENED)
            elif self._do.announced:
                self._do.propose()

    def _skip_turn(self) -> None:
        """Leave out the next whole turn."""
        self._do.turns.skip()
        self._do.propose_turn()
        if not self._do.turns.left:
            self._handle(Input.COMPLETE)

    def _retake(self, name: str | None) -> tuple[int | None, str]:
        doubtful = [one.name for one in self._do.doubts.now if self.plan.find(one.name) not in self.plan.wanted_again]
        named = name or next(iter(doubtful), None)
        index = self.plan.last_accepted if named is None else self.plan.find(named)
        if index is None or index not in self.plan.accepted:
            return None, f"nothing to retake: {name or 'no position'} is not measured yet"
        self.plan.want_again(index)
        self._do.rested = None
        return index, f"{self.plan.position(index).name} is measured again; the older measurement counts until then"

    def _skip(self, name: str | None) -> tuple[int | None, str]:
        index = self.plan.proposed() if name is None else self.plan.find(name)
        if index is None or not self.plan.is_pending(index):
            return None, "nothing to skip"
        self.plan.skip(index)
        return index, f"{self.plan.position(index).name} is not asked for any more; shown all the same, it is taken"

    def _undo(self, _name: str | None) -> tuple[int | None, str]:
        undone = self.plan.undo()
        if undone is None:
            return None, "nothing to undo"
        action, index = undone
        # What was known with it is known no longer.
        self._do.fit_again()
        return index, f"{action} of {self.plan.position(index).name} is undone; its samples stay in the recording"
