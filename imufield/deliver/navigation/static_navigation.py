"""Static navigation over one recording with several parameter sets at once, in bounded memory.

What it can show. Alignment takes every constant accelerometer error for a tilt, and the tilt it finds takes the error off
again. At 45 deg of latitude 100 ug make 0.7 nmi in five hours with a true attitude, and half of it or nothing after alignment;
a gyroscope bias of 0.01 deg/h makes up to 2.9 nmi. So a recording that is not touched says much of the gyroscope, little of
the accelerometer. Turned over after the alignment, the tilt that was found has the wrong sign and the same error counts four
times. The proof of the accelerometer remains left-out positions (``imufield.deliver.verification.left_out``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.result import Calibration
from imufield.dataclass import dataclass, field
from imufield.deliver.navigation.alignment import Alignment, Heading, RestMeans, align
from imufield.deliver.navigation.drift import Drift
from imufield.deliver.navigation.drift_forecast import RUNS, DriftForecast, RandomErrors, Scene, forecast
from imufield.deliver.navigation.mechanise import Mechanisation, load_pyins
from imufield.deliver.navigation.rest import SECOND_S, IntervalMeans, RestNoise, fill_gaps, measure_noise, moving_seconds
from imufield.deliver.parameters.file import Corrected
from imufield.errors import ImufieldError, Reason, RecordingError, UsageError
from imufield.samples import FloatArray, Samples, TemperatureHold
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Apply = Callable[[Samples], Corrected]

ALIGN_S = 600.0
SHORTEST_ALIGN_S = 20.0  # Fewer than 20 means of a second tell no noise from movement.
SHORTEST_S = 60.0
"""Of navigation: a drift of less says nothing."""
LONGEST_GAP_S = 5.0  # At rest a straight line over so long misses nothing but a hand.
LARGEST_LOSS = 0.01  # More is no accident of the wire but a wrong protocol.
TOUCHED_S = 3.0
"""Moving seconds that are forgiven: a door, a bump against the table."""
TURNED_DEG = 20.0  # Less is the table giving way, not somebody turning the instrument over.
_GRAVITY_TOLERANCE = 0.05  # Of gravity: calibrated force is within a percent, that of another instrument within a few.
LARGEST_HEADING_SIGMA_RAD = 0.5
"""Beyond, the forecast's equations are not linear any more and the heading is a guess."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSettings:
    """How to navigate."""

    latitude_deg: float
    height_m: float = 0.0
    gravity_m_s2: float = 9.80665
    align_s: float = ALIGN_S
    turned: bool = False
    """Somebody turned the instrument over after the alignment."""
    heading: Heading | None = None
    """During the alignment, where it is known; None: found from the Earth's rate."""
    turn_on: FloatArray = field(default_factory=lambda: np.full(6, np.nan))
    """1 sigma of a bias that is new at each power-on, shape (6,), m/s^2 and rad/s; NaN: the bias instability."""
    instability: FloatArray | None = None
    """Bias instability, shape (6,); None: measured on the recording."""
    runs: int = RUNS
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class NavigationResult:
    """What a recording showed."""

    drifts: dict[str, Drift]
    """By name of parameter set, the one under test last."""
    forecast: DriftForecast | None
    """Of the parameter set under test; None where there is none, see ``notes``."""
    settings: CheckSettings
    navigated_s: float
    samples: int
    lost: int
    """Samples left out: flagged, or not a number."""
    noise: RestNoise
    notes: tuple[str, ...] = ()

    @property
    def tested(self) -> Drift:
        """The drift of the parameter set under test."""
        return list(self.drifts.values())[-1]


class StaticNavigation:
    """Takes a recording block by block.

    Parameters
    ----------
    sets : mapping of str to callable
        Names and ways to correct; the last one is under test.
    settings : CheckSettings

    Raises
    ------
    UsageError
        If python-ins is not installed, or the alignment is too short.
    """

    def __init__(self, sets: Mapping[str, Apply], settings: CheckSettings) -> None:
        if not settings.align_s >= SHORTEST_ALIGN_S:
            raise UsageError(sentence("check.align_s", align_s=settings.align_s, limit_s=SHORTEST_ALIGN_S))
        load_pyins()
        self.settings = settings
        self.stopped: ImufieldError | None = None  # Why this recording cannot be navigated; set at once, raised by ``finish``.
        *_, tested = sets
        # What it is compared with may be a nominal scale, with offsets that nobody knows.
        self._sets = {name: ParameterSet(apply, settings, checks_gravity=name == tested) for name, apply in sets.items()}
        self._temperature = TemperatureHold()
        self._counts = np.zeros(2, dtype=np.int64)
        self._has_gyroscope = False
        self._gap_s = 0.0
        self._start_s: float | None = None
        self._last_s = 0.0

    def feed(self, samples: Samples) -> None:
        """Take the next block."""
        # What one block refuses, the next would refuse again; the caller reads on for the positions.
        if self.stopped is not None:
            return
        samples = self._temperature.fill(samples)
        has_rates = np.isfinite(samples.gyroscope).all(axis=1)
        self._has_gyroscope |= bool(has_rates.any())
        usable = samples.usable & np.isfinite(samples.accelerometer).all(axis=1) & has_rates
        self._counts += (len(samples), len(samples) - int(usable.sum()))
        kept = samples if usable.all() else samples[usable]
        if not len(kept):
            return
        if self._start_s is None:
            self._start_s = self._last_s = float(kept.time_s[0])
        self._gap_s = max(self._gap_s, float(np.diff(kept.time_s, prepend=self._last_s).max()))
        self._last_s = float(kept.time_s[-1])
        try:
            # Integrated across a gap, the attitude can become invalid.
            if self._gap_s > LONGEST_GAP_S:
                raise RecordingError(sentence("check.gap", gap_s=self._gap_s, limit_s=LONGEST_GAP_S))
            for parameter_set in self._sets.values():
                parameter_set.feed(kept)
        except RecordingError as error:
            self.stopped = error

    def finish(self, calibration: Calibration | None = None) -> NavigationResult:
        """Return the drift of every set, with the forecast for the last one where its calibration is given.

        Raises
        ------
        RecordingError
            If the recording is too short, was moved, does not show gravity, diverges, or has holes or too many values that are
            no numbers.
        """
        self._check_whole()
        drifts = {name: parameter_set.finish() for name, parameter_set in self._sets.items()}
        tested = list(self._sets.values())[-1]
        means = tested.means()
        moving = moving_seconds(means)
        self._check_moves(means, moving)
        # The noise is that of rest: of the longest run of still seconds, and what moved too much was refused above.
        edges = np.flatnonzero(np.diff(np.concatenate([[True], moving, [True]])))
        starts, ends = edges[::2], edges[1::2]
        longest = int(np.argmax(ends - starts))
        noise = measure_noise(means[starts[longest] : ends[longest]])
        expected, notes = self._forecast(tested, calibration, noise)
        return NavigationResult(
            drifts=drifts,
            forecast=expected,
            settings=self.settings,
            navigated_s=float(drifts[next(iter(drifts))].time_s[-1]),
            samples=int(self._counts[0]),
            lost=int(self._counts[1]),
            noise=noise,
            notes=notes,
        )

    def _check_whole(self) -> None:
        total, lost = (int(count) for count in self._counts)
        if total and not self._has_gyroscope:
            raise RecordingError(sentence("check.no_gyroscope"), Reason.BAD_DATA)
        if total and lost > LARGEST_LOSS * total:
            raise RecordingError(sentence("check.lost", lost=lost, total=total, limit=LARGEST_LOSS), Reason.NOT_FINITE)
        if self.stopped is not None:
            raise self.stopped
        needed_s, there_s = self.settings.align_s + SHORTEST_S, self._last_s - (self._start_s or 0.0)
        if there_s < needed_s:
            align_s = self.settings.align_s
            refused = sentence("check.too_short", duration_s=there_s, needed_s=needed_s, align_s=align_s)
            raise RecordingError(refused, Reason.TOO_FEW)

    def _check_moves(self, means: FloatArray, moving: NDArray[np.bool_]) -> None:
        at_s, turned_deg = int(np.argmax(moving)) * SECOND_S, 0.0
        still = fill_gaps(means)[~moving][:, :3]
        if len(still) > 1:
            # Between the first and the last still seconds.
            first, last = (part.mean(axis=0) / np.linalg.norm(part.mean(axis=0)) for part in (still[:10], still[-10:]))
            turned_deg = float(np.degrees(np.arccos(np.clip(first @ last, -1, 1))))
        if self.settings.turned and turned_deg < TURNED_DEG:
            refused = sentence("check.not_turned", turned_deg=turned_deg, limit_deg=TURNED_DEG)
            raise RecordingError(refused, Reason.BAD_DATA)
        moving_s = int(moving.sum())
        if not self.settings.turned and (moving_s > TOUCHED_S or turned_deg > TURNED_DEG):
            refused = sentence("check.moved", at_s=at_s, moving_s=moving_s, limit_s=TOUCHED_S)
            raise RecordingError(refused, Reason.BAD_DATA)

    def _forecast(
        self, tested: ParameterSet, calibration: Calibration | None, noise: RestNoise
    ) -> tuple[DriftForecast | None, tuple[str, ...]]:
        settings, alignment, flown = self.settings, tested.alignment, tested.mechanisation
        if calibration is None or alignment is None or flown is None:
            return None, ()
        if not np.isfinite(calibration.covariance).all():
            return None, (sentence("check.no_uncertainty"),)
        instability = noise.instability if settings.instability is None else settings.instability
        # A bias that is new at each start is as large as what it wanders, where nobody knows better.
        turn_on = np.nan_to_num(np.where(np.isnan(settings.turn_on), instability, settings.turn_on))
        random = RandomErrors(noise.density, instability, turn_on)
        scene = Scene(
            latitude_deg=settings.latitude_deg,
            height_m=settings.height_m,
            gravity_m_s2=settings.gravity_m_s2,
            alignment=alignment,
            time_s=flown.drift.time_s,
            attitudes=flown.attitudes,
        )
        expected = forecast(calibration, scene, random, np.random.default_rng(settings.seed), runs=settings.runs)
        if expected.heading_sigma_rad > LARGEST_HEADING_SIGMA_RAD:
            return None, (sentence("check.no_heading", sigma_deg=min(np.degrees(expected.heading_sigma_rad), 180)),)
        return expected, ()


class ParameterSet:
    """Correct, align, mechanise with one parameter set."""

    def __init__(self, apply: Apply, settings: CheckSettings, *, checks_gravity: bool) -> None:
        self._apply = apply
        self._settings = settings
        self._checks_gravity = checks_gravity
        self._seconds: IntervalMeans | None = None
        self._waiting: list[Corrected] = []
        self.alignment: Alignment | None = None
        self.mechanisation: Mechanisation | None = None

    def feed(self, samples: Samples) -> None:
        """Take the next block of usable samples."""
        corrected = self._apply(samples)
        if self._seconds is None:
            self._seconds = IntervalMeans(float(samples.time_s[0]))
        self._seconds.feed(corrected.time_s, np.hstack([corrected.specific_force_m_s2, corrected.angular_rate_rad_s]))
        if self.mechanisation is not None:
            self.mechanisation.feed(*corrected)
            return
        self._waiting.append(corrected)
        end_s = self._seconds.start_s + int(self._settings.align_s / SECOND_S) * SECOND_S
        # A second more, so that the last mean of the alignment is complete.
        if corrected.time_s[-1] > end_s + SECOND_S:
            self._align(end_s)

    def finish(self) -> Drift:
        """Return the drift of the whole recording."""
        assert self.mechanisation is not None  # noqa: S101  (the length of the recording was checked)
        self.mechanisation.finish()
        return self.mechanisation.drift

    def means(self) -> FloatArray:
        """Return the means of every second, shape (n, 6)."""
        return np.empty((0, 6)) if self._seconds is None else self._seconds.finish()

    def _align(self, end_s: float) -> None:
        settings = self._settings
        seconds = int(settings.align_s / SECOND_S)
        means = fill_gaps(self.means()[:seconds])
        moving = moving_seconds(means)
        if moving.sum() > TOUCHED_S:
            refused = sentence("check.moves_in_alignment", at_s=int(np.argmax(moving)), align_s=settings.align_s)
            raise RecordingError(refused, Reason.BAD_DATA)
        force_m_s2, gravity_m_s2 = float(np.linalg.norm(means[:, :3].mean(axis=0))), settings.gravity_m_s2
        if self._checks_gravity and abs(force_m_s2 / gravity_m_s2 - 1) > _GRAVITY_TOLERANCE:
            refused = sentence("check.no_gravity", force_m_s2=force_m_s2, gravity_m_s2=gravity_m_s2, limit=_GRAVITY_TOLERANCE)
            raise RecordingError(refused, Reason.GRAVITY)
        rest = RestMeans(SECOND_S, means[:, :3], means[:, 3:])
        self.alignment = align(rest, settings.latitude_deg, measure_noise(means).triads(), settings.heading)
        self.mechanisation = Mechanisation(self.alignment.attitude, end_s, settings.latitude_deg, settings.height_m)
        for corrected in self._waiting:
            after = corrected.time_s >= end_s
            self.mechanisation.feed(*(values[after] for values in corrected))
        self._waiting = []
