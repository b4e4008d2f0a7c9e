"""Watches the stream of cells for what is wrong with the data: loss, clock, rate, warm-up, axes and scales that contradict."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import median

import numpy as np

from imufield.guide import refusals
from imufield.guide.cross_checks.axes import ENOUGH_FOR_UNITS, AxesCheck, MoveLog, check_axes, check_while_waiting
from imufield.guide.cross_checks.centre import centred
from imufield.guide.cross_checks.outputs import Outputs
from imufield.guide.cross_checks.sides import DeadAxis
from imufield.guide.events import RefusalCode
from imufield.guide.hold.checks import explain_flags
from imufield.guide.lead.advice import gyroscope_scale_advice
from imufield.guide.lead.plan import Plan
from imufield.guide.lead.speaker import REMIND_S, Speaker
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.detector import USABLE_SHARE, StillnessDetector
from imufield.guide.stillness.noise_floor import FLOOR_S, is_even, measure_floor, why_not_quiet
from imufield.guide.stillness.stretch import Judgement, Stretch
from imufield.samples import AXES, CELL_S

_BAD_IN_A_ROW = 3  # Cells without usable samples before anybody is told: a second of a computer's delay is harmless.
_RATE_CELLS = 50  # The rate is that of five seconds: USB delivers in bursts.
_RATE_SHARE = 0.05  # Change of the sample rate that is told: oscillators differ by 0.01 %.
_RATE_REMIND_S = 6 * REMIND_S  # A rate that changed stays so.
_JUMP_S = 2.0  # A gap in the sample clock that is told: a suspended computer, an instrument that began anew.
_WAIT = 2  # Lengths of a noise floor waited for before anybody is told why.
_IN_VAIN = 5  # The same before the settings come under suspicion.
_LARGEST_DEGC_MIN = 0.5  # The bias of a chip follows its temperature.
_WARMTH_CELLS = 300  # Half a minute: a longer one still sees a warm-up that is over.
_FEWEST_OF_WARMTH = 35  # The shortest hold. They tell a slope of 1 degC/min from a step of 0.01 degC.
_FEWEST_READINGS = 5  # An instrument that sends it once a second has as many by then.
_STILLS_KEPT = 200  # Far more than tell an offset; memory does not grow with the session.


class Warmth:
    """Is the instrument warm? The slope of the temperature that it reports, over the last half minute."""

    def __init__(self) -> None:
        self._degc: deque[float] = deque(maxlen=_WARMTH_CELLS)
        self.goes_on_cold = False  # The operator does not wait for the temperature.

    def follow(self, cells: Cells, row: int) -> None:
        """Add one cell; its temperature may be NaN."""
        self._degc.append(float(cells.temperature_degc[row]))

    def clear(self) -> None:
        """Forget the temperatures: time has passed that was not observed."""
        self._degc.clear()

    @property
    def slope_degc_min(self) -> float:
        """Slope of a straight line less twice its sigma towards zero, degC per minute; 0 while not known."""
        window = np.array(self._degc)
        known = np.flatnonzero(np.isfinite(window))
        if len(window) < _FEWEST_OF_WARMTH or len(known) < _FEWEST_READINGS:
            return 0.0
        window, time_min = window[known], (known - known.mean()) * CELL_S / 60
        spread = float(time_min @ time_min)
        slope = float(time_min @ window) / spread
        residual = window - window.mean() - slope * time_min
        # Readings come in steps and repeat from cell to cell: a tenth of them counts.
        sigma = math.sqrt(float(residual @ residual) / max(len(window) / 10 - 2, 1) / spread)
        return math.copysign(max(abs(slope) - 2 * sigma, 0.0), slope)

    def refusal(self, plan: Plan) -> Refusal | None:
        """Return why a session does not begin at this temperature; None where it has begun, or the operator does not wait."""
        # What changes outdoors would end it later.
        slope = 0.0 if plan.accepted or self.goes_on_cold else self.slope_degc_min
        return refusals.WARMING_UP.beyond(abs(slope), _LARGEST_DEGC_MIN, slope=slope)


class StreamWatch:
    """Watches the cells of a session and tells what is wrong with them.

    Parameters
    ----------
    detector : StillnessDetector
    speaker : Speaker
    """

    def __init__(self, detector: StillnessDetector, speaker: Speaker) -> None:
        self._detector = detector
        self._speaker = speaker
        self.warmth = Warmth()
        self.outputs = Outputs()
        self.bad_cells = 0  # With missing or unusable samples so far.
        self._bad_in_a_row = 0
        self._moves = MoveLog()
        self._stills: deque[list[float]] = deque(maxlen=_STILLS_KEPT)
        self._dead_axis = DeadAxis()
        self._positions_checked = 0  # Accepted positions at the last check of the axes; all, once the moves have told.
        self._told: set[tuple[RefusalCode, bool]] = set()
        self._slot: int | None = None
        self._counts: deque[int] = deque(maxlen=_RATE_CELLS)
        self._waited = 0

    def forget_clock(self) -> None:
        """Expect another clock and another rate: the link is gone, and a pause is no jump."""
        self._slot = None
        self._counts.clear()

    def follow(self, cells: Cells, row: int, *, silent: bool) -> None:
        """Count cells with missing or unusable samples; unless ``silent``, tell when several follow each other."""
        self.warmth.follow(cells, row)
        self.outputs.follow(cells, slice(row, row + 1))
        self._watch_clock(cells, row)
        floor = self._detector.floor
        usual = cells.count[row] if floor is None else floor.samples_per_cell
        # An integer of NumPy takes ten times as long to be compared with a float.
        if int(cells.usable[row]) >= USABLE_SHARE * usual:
            self._bad_in_a_row = 0
            return
        self._bad_in_a_row += 1
        self.bad_cells += 1
        if self._bad_in_a_row >= _BAD_IN_A_ROW and not silent:
            self._speaker.advance(cells, row)
            refusal = explain_flags(cells[row : row + 1], 1.0, 1 - USABLE_SHARE)
            if self._speaker.due(f"data {refusal.reason.value}", REMIND_S):
                self._speaker.reject(refusal)

    def _watch_clock(self, cells: Cells, row: int) -> None:
        """Tell when the sample clock jumps or the sample rate changes."""
        before, self._slot = self._slot, int(cells.slot[row])
        gap_s = 0.0 if before is None else (self._slot - before) * CELL_S
        if not -_JUMP_S < gap_s < _JUMP_S:
            self._counts.clear()
            self.warmth.clear()
            way = refusals.CLOCK_FORWARD if gap_s > 0 else refusals.CLOCK_BACK
            self._speaker.reject(way.refusal(abs(gap_s), _JUMP_S))
            return
        self._counts.append(int(cells.count[row]))
        floor = self._detector.floor
        if floor is None or len(self._counts) < _RATE_CELLS:
            return
        usual = floor.samples_per_cell
        # The median does not mind cells with lost samples; those are told elsewhere.
        share = median(self._counts) / usual - 1
        # A cell of a few samples holds one more or less by chance.
        if abs(share) > _RATE_SHARE and abs(share) * usual > 1 and self._speaker.due("rate", _RATE_REMIND_S):
            usual_hz = usual / CELL_S
            refusal = refusals.RATE.refusal(
                abs(share) * usual_hz,
                _RATE_SHARE * usual_hz,
                percent=100 * share,
                usual_hz=usual_hz,
                limit_percent=100 * _RATE_SHARE,
            )
            self._speaker.reject(refusal)

    def leave_side(self, still: Stretch) -> None:
        """Add a still stretch that has ended, and tell that an axis is dead, once."""
        self._stills.append(still.mean[:3])
        dead = self._dead_axis.leave_side(self.outputs.extremes, self._detector.floor, self._detector.scale)
        self._speaker.reject(dead)

    def centre(self, more: Sequence[float] = ()) -> None:
        """Count from the centre of the still stretches so far, and of one more that has not ended, where they show it."""
        stills = [*self._stills, *([list(more)] if more else [])]
        self._detector.scale = centred(self._detector.scale, np.array(stills).reshape(-1, 3))

    def follow_move(self, judgement: Judgement, accepted: int, planned: int) -> None:
        """Follow the moves; check axes and scale with each new position until the moves decide, and tell a contradiction."""
        self._moves.follow(judgement, self._detector.stretch.mean)
        if accepted <= max(self._positions_checked, ENOUGH_FOR_UNITS):
            return
        axes = self.check_axes()
        self._positions_checked = accepted if axes.agrees is None else planned
        if axes.agrees and self._detector.scale.gyroscope is None:
            self._speaker.say(gyroscope_scale_advice(self._speaker.now_s, axes))
        if axes.refusal is None or not axes.is_contradicted:
            return
        # That nothing fits, a scale, wrong axes: each is told once, as soon as the moves show it.
        kind = (axes.refusal.reason, axes.agrees is False)
        if kind not in self._told:
            self._told.add(kind)
            self._speaker.reject(axes.refusal)

    def check_axes(self) -> AxesCheck:
        """Compare the turns by accelerometer and gyroscope between the stills so far."""
        if self._detector.has_waited:
            return check_while_waiting(self._detector)
        scale = self._detector.scale
        return check_axes(self._moves.moves(scale), scale.gyroscope)

    def explain_waiting(self, cells: Cells) -> None:
        """Tell what the guide waits for while there is no noise floor."""
        self._waited += len(cells)
        self._speaker.advance(cells, -1)
        waited_s = self._waited * CELL_S
        if waited_s <= _WAIT * FLOOR_S or not cells.usable.any() or not self._speaker.due("not quiet", REMIND_S):
            return
        if self._detector.frozen:
            self._speaker.reject(refusals.FROZEN.refusal(waited_s, 0.0))
            return
        axes = self.check_axes()
        if axes.turns_ratio != 1.0:
            self._speaker.reject(axes.refusal)
            return
        window, scale = self._detector.waited(), self._detector.scale
        window = window[np.flatnonzero(window.usable)]
        cause = why_not_quiet(window, scale) if len(window) > 1 else None
        if cause is None:
            whole_s = float((window.end_s - window.start_s).sum())
            self._speaker.reject(refusals.NOT_QUIET_MISSING.refusal(whole_s, FLOOR_S, floor_s=FLOOR_S))
            return
        kind = refusals.NOT_QUIET_SHAKES if cause.shakes else refusals.NOT_QUIET_STRAYS
        # After a long wait the settings are suspected, too, where the motion looks like noise.
        if waited_s > _IN_VAIN * FLOOR_S and cause.shakes and is_even(window, measure_floor(window), scale):
            kind = refusals.NOT_QUIET_EVEN if cause.column < 3 else refusals.NOT_QUIET_GYROSCOPE
        triad, unit, factor = scale.triads[cause.column // 3]
        refusal = kind.refusal(
            cause.measured / factor,
            cause.limit / factor,
            axis=AXES[cause.column % 3],
            unit=unit,
            triad=triad,
            floor_s=FLOOR_S,
            sides=ENOUGH_FOR_UNITS + 1,
        )
        self._speaker.reject(refusal)
