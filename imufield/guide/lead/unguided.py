"""Still intervals of a recording without a guide: each is an observation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.errors import CalibrationError, Reason
from imufield.guide.cross_checks.axes import AxesCheck, MoveLog, check_axes
from imufield.guide.cross_checks.centre import centred
from imufield.guide.hold.checks import HoldUnderTest, check_gravity, examine
from imufield.guide.hold.observe import Observation, gather, observe, trim_stretch
from imufield.guide.positions import nearest_cube_direction
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import CellBuilder, Cells, cells_in
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.noise_floor import FLOOR_S, MAX_FLOOR_M_S2, NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Phase, Stretch
from imufield.samples import Samples, SampleUnits
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_SHORTEST_S = 1.0  # A still interval shorter than this, guard bands off, is a pause in a motion.


@dataclass(frozen=True, slots=True, kw_only=True)
class StillIntervals:
    """Observations of a recording, and start time and reason of the still intervals that were refused."""

    observations: Observations
    refused: tuple[tuple[float, Refusal], ...]
    noise_floor: NoiseFloor
    scale: RoughScale
    axes: AxesCheck
    """Whether the gyroscope's axes belong to the accelerometer's."""


class StillIntervalFinder:
    """Collects an observation from each still interval of a stream; memory does not grow with its length.

    An observation is named after the nearest face, edge or corner of a cube, "free 7: near +x+y", and has no planned direction.

    Parameters
    ----------
    units : SampleUnits
    scale : RoughScale, optional
        What is known of the raw units; by default that of their names.
    """

    def __init__(self, units: SampleUnits, scale: RoughScale | None = None) -> None:
        self.units = units
        self.detector = StillnessDetector(scale or RoughScale.of_units(units))
        self._found: list[Observation] = []
        self._refused: list[tuple[float, Refusal]] = []
        self._moves = MoveLog()
        self._builder = CellBuilder()

    def feed(self, samples: Samples) -> None:
        """Process the next samples."""
        self._process(self._builder.feed(samples))

    def finish(self) -> StillIntervals:
        """Return the still intervals; the last one ends here.

        Raises
        ------
        CalibrationError
            If no stretch was quiet enough to be a noise floor.
        """
        self._process(self._builder.flush())
        if self.detector.phase is Phase.STILL:
            self._add(self.detector.stretch)
            self.detector.restart()
        if self.detector.floor is None:
            never_quiet = sentence("unguided.never_quiet", floor_s=FLOOR_S, limit_m_s2=MAX_FLOOR_M_S2)
            raise CalibrationError(never_quiet, Reason.TOO_FEW)
        scale = centred(self.detector.scale, np.array([observation.mean_raw for observation in self._found]))
        kept: list[Observation] = []
        for observation in self._found:
            # Only now all stills tell together which offset there is.
            refusal = check_gravity(observation.mean_raw, scale)
            if refusal is None:
                nearest = nearest_cube_direction(scale.specific_force(observation.mean_raw))
                kept.append(replace(observation, name=f"free {len(kept) + 1}: near {nearest}"))
            else:
                self._refused.append((observation.start_s, refusal))
        return StillIntervals(
            observations=gather(kept, self.units),
            refused=tuple(sorted(self._refused, key=lambda refused: refused[0])),
            noise_floor=self.detector.floor,
            scale=scale,
            axes=check_axes(self._moves.moves(scale), scale.gyroscope),
        )

    def _process(self, cells: Cells | None) -> None:
        for judgement in () if cells is None else self.detector.judge(cells):
            self._moves.follow(judgement, self.detector.stretch.mean)
            if judgement.ended is not None:
                self._add(judgement.ended)

    def _add(self, stretch: Stretch) -> None:
        """Add the observation of a stretch, or its refusal."""
        detector, floor = self.detector, self.detector.floor
        cells = stretch.cells()
        cells = cells[trim_stretch(cells, detector.limits)]
        if floor is None or len(cells) < cells_in(_SHORTEST_S):
            return
        refusal = examine(HoldUnderTest(cells=cells, floor=floor, limits=detector.limits, scale=detector.scale))
        if refusal is not None:
            self._refused.append((float(cells.start_s[0]), refusal))
            return
        self._found.append(observe(cells, detector.limits, ""))
