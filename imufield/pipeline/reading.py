"""The outcome of one replay of a recording, as plain values: all that the calibration needs (kept by ``reading_cache``)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.calibrate.model.observations import Observations, join_observations
from imufield.calibrate.moves.moves import MoveCollector, Moves, cut_moves
from imufield.calibrate.moves.slots import Slots, no_slots
from imufield.dataclass import dataclass, replace
from imufield.deliver.report.stillness_trace import TraceCells, TraceCollector
from imufield.guide.events import VERTICAL, Event, LinkLost, Rejected, Turned
from imufield.samples import FloatArray, Samples, concatenate

_AT_ONCE = 4096  # Samples that are summed at once: a live link brings them by tens, each time at the price of hundreds.


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A recording that was replayed to its end.

    Attributes
    ----------
    sha256 : str
        Of the parts, in their order.
    observations : Observations
    rests : Observations or None
        Stills between whole turns: for the gyroscope alone.
    slots : Slots
        Of the moves, and of the stills in cells.
    ends_raw : ndarray, shape (2, 3)
        Lowest and highest output of the gyroscope where it is an end of its range, else NaN.
    turned_s : ndarray, shape (k,)
        Times of the whole turns about the vertical.
    resumed_s : ndarray, shape (k,)
        Times of the last samples before an operator went on with the session.
    cells : TraceCells
    best : DecoderStatistics or None
        Of the part whose rate is known best.
    temperature_degc : ndarray, shape (2,)
        Lowest and highest; NaN where none was sent.
    sensor_offset_degc : ndarray, shape (6,)
        Temperature of each axis' sensor less that of the instrument, mean of the session; NaN where none was sent.
    raw_zero : ndarray, shape (3,) or (6,), or None
        Rates, of the accelerometer or of both triads.
    gyroscope_scale : float or None
    grade : str
        Nominal, of the protocol.
    compared, saturated : str
        Sentences about the gyroscope's axes, and about what was left out because an axis was clipped; may be empty.
    refused, sticking, notes, lost : tuple of str
        Sentences about refused holds, codes that stick, how the recording was read, and what is missing.
    """

    sha256: str
    observations: Observations
    rests: Observations | None
    slots: Slots
    ends_raw: FloatArray
    turned_s: FloatArray
    resumed_s: FloatArray
    cells: TraceCells
    best: DecoderStatistics | None
    temperature_degc: FloatArray
    sensor_offset_degc: FloatArray
    raw_zero: FloatArray | None
    gyroscope_scale: float | None
    grade: str
    compared: str
    saturated: str
    refused: tuple[str, ...]
    sticking: tuple[str, ...]
    notes: tuple[str, ...]
    lost: tuple[str, ...]

    def between(self, observations: Observations) -> Moves:
        """Return the moves between the observed stills, and those between whole turns."""
        stills = observations if self.rests is None else join_observations(observations, self.rests)
        return cut_moves(self.slots, stills.start_s, stills.duration_s, self.ends_raw, self.resumed_s, middle_s=stills.middle_s)


class ReadingCollector:
    """Keeps of a stream of samples and events what the gyroscope fit and the report need."""

    def __init__(self) -> None:
        self.refusals: list[Rejected] = []
        self.turned_s: list[float] = []
        self.resumed_s: list[float] = []
        self.trace = TraceCollector()
        self._moves: MoveCollector | None = None
        self._waiting: list[Samples] = []

    def feed(self, samples: Samples) -> None:
        """Take the next samples."""
        self._waiting.append(replace(samples, sensor_temperature_degc=None))
        if sum(map(len, self._waiting)) >= _AT_ONCE:
            self._take()

    def hear(self, events: Iterable[Event]) -> None:
        """Remember refused holds, where the operator went on, and the whole turns about the vertical that the guide saw."""
        for event in events:
            if isinstance(event, Rejected):
                self.refusals.append(event)
            elif isinstance(event, Turned) and event.about == VERTICAL:
                self.turned_s.append((event.start_s + event.end_s) / 2)
            elif isinstance(event, LinkLost) and event.resumed:
                self.resumed_s.append(event.time_s)

    def slots(self, stills: Observations) -> tuple[Slots, FloatArray]:
        """Return the slots of all samples, those inside stills joined, and the ends of the outputs' range, shape (2, 3)."""
        if self._waiting:
            self._take()
        if self._moves is None:
            return no_slots(), np.full((2, 3), np.nan)
        return self._moves.joined_slots(stills.start_s, stills.duration_s, stills.middle_s), self._moves.ends

    def _take(self) -> None:
        samples = concatenate(self._waiting)
        self._waiting.clear()
        self._moves = self._moves or MoveCollector(samples.units)
        self._moves.feed(samples)
        self.trace.feed(samples)
