"""IMU error simulator: from true specific force and angular rate to the raw samples an instrument sends.

In this order: delay between the triads, the measurement equations of ``imufield`` with temperature, white noise, drift,
saturation, quantisation, loss. White noise and losses are drawn sample by sample from streams of their own and drift on
fixed anchors, so one seed gives one session however it is cut into blocks.

Temperature: with d degrees above the reference, the bias grows by ``bias_per_degc * d`` and the whole output by the
factor ``1 + scale_per_degc * d``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.dataclass import dataclass, replace
from imufield.errors import UsageError
from imufield.samples import FloatArray, Samples, Status, no_samples
from imufield.sentences import Sentences
from imufield.simulate.truth.drift import BiasDrift
from imufield.simulate.truth.grades import REFERENCE_TEMPERATURE_DEGC, TrueInstrument
from imufield.simulate.truth.motion import TrueMotion

sentence = Sentences(__package__)

MAXIMUM_RATE_HZ = 1e5
"""No instrument sends faster: a limit against slips of the keyboard."""
MAXIMUM_TRIAD_DELAY_S = 0.01
"""Bound of the history that is kept; group delays of real instruments stay below 2 ms."""
_ROUNDING = 1e-6  # Of a sample number at another rate.


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSettings:
    """How the instrument is run."""

    rate_hz: float = 500.0
    """Nominal sample rate."""
    noise: bool = True
    drift: bool = True
    quantise: bool = True
    saturate: bool = True
    warm_up: bool = False
    """Start cold: the temperature rises to ``temperature_degc`` as the grade says."""
    temperature_degc: float = REFERENCE_TEMPERATURE_DEGC
    """Temperature of the instrument when warm."""
    temperature_slope_degc_s: float = 0.0
    temperature_end_degc: float | None = None
    """Where a slope ends; None: it does not."""
    loss_probability: float = 0.0
    """Chance of each sample to be lost on its way."""


class Imu:
    """A simulated instrument, fed with true motion, block by block.

    Parameters
    ----------
    instrument : TrueInstrument
    seed : int
    settings : ImuSettings, optional

    Raises
    ------
    UsageError
        If the rate, the loss probability or the delay between the triads makes no sense.
    """

    def __init__(self, instrument: TrueInstrument, seed: int, settings: ImuSettings | None = None) -> None:
        self.instrument = instrument
        self.samples_lost = 0
        # A stream for each effect: switching one off leaves the draws of the others as they are.
        self._noise_rng, drift_rng, self._loss_rng = (np.random.default_rng([seed, stream]) for stream in (101, 102, 103))
        a, g = instrument.grade.accelerometer, instrument.grade.gyroscope
        self._drift = BiasDrift(_six(a.bias_instability, g.bias_instability), _six(a.random_walk, g.random_walk), drift_rng)
        self._drift_sum = np.zeros(6)
        self._turn_on = instrument.effects.draw_turn_on(np.random.default_rng([seed, 104]))
        self._last_raw = np.zeros(6)
        self._next = 0
        self._gap = False
        self._use(settings or ImuSettings())

    def _use(self, settings: ImuSettings) -> None:
        """Check the settings and prepare what depends on the rate."""
        grade, rate_hz, delay_s = self.instrument.grade, settings.rate_hz, self.instrument.triad_delay_s
        if not 0 < rate_hz <= MAXIMUM_RATE_HZ:
            raise UsageError(sentence("imu.rate", rate_hz=rate_hz, limit_hz=MAXIMUM_RATE_HZ))
        if not 0 <= settings.loss_probability < 1:
            raise UsageError(sentence("imu.loss", probability=settings.loss_probability))
        if not abs(delay_s) <= MAXIMUM_TRIAD_DELAY_S:
            raise UsageError(sentence("imu.delay", delay_s=delay_s, limit_s=MAXIMUM_TRIAD_DELAY_S))
        self.settings = settings
        # A noise density N gives a standard deviation of N sqrt(rate) per sample (IEEE Std 952).
        self._sigma = np.sqrt(rate_hz) * _six(grade.accelerometer.noise_density, grade.gyroscope.noise_density)
        sends_increments = grade.units.accelerometer_is_increment or grade.units.gyroscope_is_increment
        self._units = replace(grade.units, interval_s=1 / rate_hz) if sends_increments else grade.units
        # One of the two delays is zero: samples carry the time of the triad that is ahead.
        late = delay_s / self.interval_s
        self._gyroscope_delay, self._accelerometer_delay = _Delay(max(late, 0.0)), _Delay(max(-late, 0.0))
        self._carry = np.zeros(6)

    def set_rate(self, rate_hz: float) -> int:
        """Go on at another rate; return the number of its next sample, counted from the beginning.

        Raises
        ------
        UsageError
            If the rate makes no sense.
        """
        to_new = rate_hz / self.settings.rate_hz
        self._use(replace(self.settings, rate_hz=rate_hz))
        before, self._next = self._next, int(np.ceil(self._next * to_new - _ROUNDING))
        # The mean of the drift goes on as that of the time so far.
        self._drift_sum *= self._next / max(before, 1)
        return self._next

    @property
    def interval_s(self) -> float:
        """True interval between samples: the clock error makes it differ from ``1 / rate_hz``."""
        return 1 / (self.settings.rate_hz * (1 + 1e-6 * self.instrument.clock_error_ppm))

    def to_sample_clock(self, true_time_s: float) -> float:
        """Return what the sample clock shows at a true time."""
        return true_time_s * (1 + 1e-6 * self.instrument.clock_error_ppm)

    @property
    def mean_drift(self) -> FloatArray:
        """Mean so far of the drift on top of the parameters, shape (6,): m/s^2 of three axes, then rad/s.

        What a calibration of this session sees as bias is the bias of the parameters plus this.
        """
        return self._drift_sum / max(self._next, 1)

    def feed(self, motion: TrueMotion) -> Samples:
        """Return the raw samples of the next block of motion, lost ones left out."""
        n = len(motion)
        if n == 0:
            return no_samples(self._units)
        settings, grade = self.settings, self.instrument.grade
        index = np.arange(self._next, self._next + n)
        self._next += n
        time_s = index / settings.rate_hz
        temperature = settings.temperature_degc + settings.temperature_slope_degc_s * time_s
        if settings.temperature_end_degc is not None:
            low_degc, high_degc = sorted((settings.temperature_degc, settings.temperature_end_degc))
            temperature = np.clip(temperature, low_degc, high_degc)
        if settings.warm_up:
            temperature = temperature - grade.warm_up_degc * np.exp(-time_s / grade.warm_up_s)
        warm_degc = temperature - REFERENCE_TEMPERATURE_DEGC
        output = self._respond(motion, warm_degc[:, np.newaxis])
        output += self._disturbance(time_s)
        status = np.zeros(n, dtype=np.uint32)
        raw = self._freeze(self._digitise(output, status), time_s)
        samples = Samples(
            time_s=time_s,
            accelerometer=raw[:, :3],
            gyroscope=raw[:, 3:],
            temperature_degc=warm_degc + REFERENCE_TEMPERATURE_DEGC,
            counter=index.astype(np.int64),
            status=status,
            units=self._units,
        )
        if settings.loss_probability == 0:
            return samples
        lost = self._loss_rng.random(n) < settings.loss_probability
        # The first sample after a loss tells of it; so does the first of this block after a loss at the end of the last.
        after_gap = np.concatenate([[self._gap], lost[:-1]]) & ~lost
        samples.status[after_gap] |= np.uint32(Status.AFTER_GAP)
        self._gap = bool(lost[-1])
        self.samples_lost += int(np.count_nonzero(lost))
        return samples[~lost]

    def _respond(self, motion: TrueMotion, warm_degc: FloatArray) -> FloatArray:
        """Return the noise-free outputs of both triads in raw units per second, shape (n, 6)."""
        unit = self.instrument
        # The measurement equations of imufield/__init__.py, with the true parameters.
        force = self._accelerometer_delay.feed(motion.specific_force)
        accelerometer = predict(unit.accelerometer, unit.effects.distorted(force, unit.accelerometer.misalignment_rad))
        rate = unit.effects.distorted_rate(self._gyroscope_delay.feed(motion.angular_rate))
        gyroscope = predict_gyroscope(unit.gyroscope, rate, motion.specific_force)
        zero = unit.accelerometer.raw_zero
        if np.any(warm_degc):
            # raw_zero is a constant of the converter, temperature does not move it.
            accelerometer = zero + (accelerometer - zero) * (1 + unit.accelerometer_scale_per_degc * warm_degc)
            accelerometer += unit.accelerometer.scale * unit.accelerometer_bias_per_degc * warm_degc
            gyroscope = gyroscope * (1 + unit.gyroscope_scale_per_degc * warm_degc)
            gyroscope += unit.gyroscope.scale * unit.gyroscope_bias_per_degc * warm_degc
        return np.hstack([accelerometer, gyroscope])

    def _disturbance(self, time_s: FloatArray) -> FloatArray:
        """Return turn-on, warming up, white noise and drift in raw units per second, shape (n, 6)."""
        disturbance = np.tile(self._turn_on, (len(time_s), 1))
        disturbance[:, :3] += self.instrument.effects.warming(time_s)
        if self.settings.noise:
            disturbance += self._sigma * self._noise_rng.standard_normal((len(time_s), 6))
        if self.settings.drift:
            drift = self._drift.at(time_s)
            self._drift_sum += drift.sum(axis=0)
            disturbance += drift
        # Noise and drift of a grade are in SI; the converter sees them as raw units.
        scaled: FloatArray = disturbance * np.concatenate(
            [self.instrument.accelerometer.scale, self.instrument.gyroscope.scale]
        )
        return scaled

    def _digitise(self, output: FloatArray, status: NDArray[np.uint32]) -> FloatArray:
        """Limit to the ranges (setting status flags), integrate where increments are sent, and quantise."""
        grade, units, zero = self.instrument.grade, self._units, self.instrument.accelerometer.raw_zero
        a, g = grade.accelerometer, grade.gyroscope
        raw = np.empty_like(output)
        for first, triad, scale, centre, flag, increment in (
            (0, a, grade.accelerometer_scale, zero, Status.ACCELEROMETER_SATURATED, units.accelerometer_is_increment),
            (3, g, grade.gyroscope_scale, 0.0, Status.GYROSCOPE_SATURATED, units.gyroscope_is_increment),
        ):
            columns = slice(first, first + 3)
            values = output[:, columns] - centre
            if self.settings.saturate:
                limit = triad.range_si * abs(scale)
                clipped = np.clip(values, -limit, limit)
                status[np.any(clipped != values, axis=1)] |= np.uint32(flag)
                values = clipped
            if first == 0:
                silent = self.instrument.effects.silent_range_m_s2 * abs(scale)
                values = np.clip(values, -silent, silent)
            raw[:, columns] = self._quantise(values, triad.lsb_si * abs(scale), increment, columns) + centre
        return raw

    def _quantise(self, values: FloatArray, step: float, increment: bool, columns: slice) -> FloatArray:
        """Round rates to whole steps; sum increments up and send the whole steps of the sum."""
        step = step if self.settings.quantise else 0.0
        if not increment:
            return values if step == 0 else step * self._stick(np.rint(values / step), columns)
        values = values / self.settings.rate_hz
        if step == 0:
            return values
        # A pulse counter drops nothing: what does not fill a step stays for the next sample.
        step /= self.settings.rate_hz
        total = self._carry[columns] + np.cumsum(values, axis=0)
        counted = step * np.floor(total / step)
        self._carry[columns] = total[-1] - counted[-1]
        return np.diff(counted, axis=0, prepend=np.zeros((1, 3)))

    def _stick(self, codes: FloatArray, columns: slice) -> FloatArray:
        period, width = self.instrument.effects.sticking_period, self.instrument.effects.sticking_width
        if period == 0 or columns.start != 0:
            return codes
        above = np.mod(codes, period)
        return np.where(above < width, codes - above, codes)

    def _freeze(self, raw: FloatArray, time_s: FloatArray) -> FloatArray:
        """Repeat what stood there before, while outputs are frozen."""
        effects = self.instrument.effects
        if effects.frozen_s is not None:
            frozen = (time_s >= effects.frozen_s[0]) & (time_s < effects.frozen_s[1])
            outputs = list(effects.frozen_outputs)
            if frozen.any():
                first = int(frozen.argmax())
                before = raw[first - 1] if first else self._last_raw
                repeated = raw[frozen]
                repeated[:, outputs] = before[outputs]
                raw[frozen] = repeated
            self._last_raw = raw[-1].copy()
        return raw


class _Delay:
    """Delay by a fraction of samples; before the first sample the first value holds.

    Between samples by the polynomial through six of them: a straight line would take 5 % from a tremor at 12 Hz and 100 Hz.
    """

    _POINTS = 6

    def __init__(self, samples: float) -> None:
        # The six are centred on the moment asked for, as far as the newest sample allows.
        newest = max(int(np.floor(samples)) - self._POINTS // 2 + 1, 0)
        self._past = 0 if samples == 0 else newest + self._POINTS - 1
        # Lagrange's polynomial: the share of point i is the product of (since - j) / (i - j) over the other points j.
        k, since = np.arange(self._POINTS), samples - newest
        self._shares = [(newest + i, np.prod([(since - j) / (i - j) for j in k if j != i])) for i in k]
        self._history: FloatArray | None = None

    def feed(self, values: FloatArray) -> FloatArray:
        if self._past == 0:
            return values
        if self._history is None:
            self._history = np.repeat(values[:1], self._past, axis=0)
        joined = np.concatenate([self._history, values])
        self._history = joined[-self._past :]
        n = len(values)
        delayed = np.zeros_like(values)
        for age, share in self._shares:
            delayed += share * joined[self._past - age : self._past - age + n]
        return delayed


def _six(accelerometer: float, gyroscope: float) -> FloatArray:
    return np.repeat([accelerometer, gyroscope], 3)
