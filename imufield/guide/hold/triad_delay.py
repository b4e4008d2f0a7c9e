"""Delay of the gyroscope behind the accelerometer, from the tremor of one hold.

A hand trembles at 8 to 12 Hz, about a pivot at the distance ``r`` from the sensor. As the unit turns, gravity moves in its
frame and the arm adds its tangential acceleration. With Q and W' the Fourier lines of turn and angular acceleration as the
gyroscope shows them, the accelerometer shows in the band of tremor, at the angular frequency w,

    A = exp(i w d) (f x Q + W' x r),    f the mean force, d the delay of the gyroscope.

The part of the arm depends on ``r`` alone and is in phase with gravity's part or against it; only a delay turns the phase. The
four unknowns are found by Gauss-Newton. The gain of either triad goes into ``r`` and does not affect the delay, nor does a
filter that both share. The delay is pulled towards zero by the usual size of such delays (``USUAL_S``) with the weight that the
noise of the hold gives it: a hold that shows no delay changes nothing, and where the arm is long enough for the delay to
matter (docs/maths.md, stillness) the result is right within some 20 us.

References
----------
.. [1] F. J. Harris, "On the use of windows for harmonic analysis with the discrete Fourier transform", Proc. IEEE 66 (1978),
   table 1: Hanning, 1.50 bins.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass
from imufield.samples import FloatArray, median

USUAL_S = 0.002  # 1 sigma of the delays that instruments have: group delays of their filters differ by up to 2 ms.
_LARGEST_S = 0.01  # A larger one is no delay between triads.
_BAND_HZ = (5.0, 20.0)  # Of tremor, 8 to 12 Hz, and its sidebands; below, sway is larger, above there is noise only.
_NYQUIST_SHARE = 0.8  # Of half the rate: next to it tremor and its mirror image mix.
# Lines under a Hann taper are not independent: there are this many times fewer, its equivalent noise bandwidth [1]_.
_HANN_NEIGHBOURS = 1.5
_FEWEST_LINES = 6  # Four independent ones, as many as there are unknowns.
_ITERATIONS = 6  # A delay of 2 ms stands to 0.3 us after three.

_Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class TriadDelay:
    """Delay of the gyroscope behind the accelerometer, and its 1 sigma; negative where the accelerometer is late."""

    delay_s: float
    sigma_s: float


@dataclass(frozen=True, slots=True)
class _Lines:
    """Fourier lines in the band of tremor, one row each."""

    omega: FloatArray  # Angular frequency, rad/s, shape (m, 1).
    force: _Complex  # Shape (m, 3).
    gravity: _Complex  # Motion of gravity in the frame, were there no delay, shape (m, 3).
    arm: _Complex  # The same for an arm of one unit of length along each axis, shape (3, m, 3).


def triad_delay(time_s: FloatArray, force: FloatArray, rate: FloatArray, weight: FloatArray) -> TriadDelay:
    """Return the delay between the triads in a trembling hold; zero and the usual size where the hold shows none.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Rising; small holes are bridged.
    force : ndarray, shape (n, 3)
        Body frame, any unit.
    rate : ndarray, shape (n, 3)
        Body frame, rad/s.
    weight : ndarray, shape (n,)
        0 to 1: share by which a row counts, smooth.
    """
    unknown = TriadDelay(0.0, USUAL_S)
    lines = _lines(time_s, force, rate, weight)
    if lines is None:
        return unknown
    delay_s, sigma_s = 0.0, USUAL_S
    for _ in range(_ITERATIONS):
        step_s, sigma_s = _step(lines, delay_s)
        delay_s += step_s
        if not abs(delay_s) <= _LARGEST_S:
            return unknown
    return TriadDelay(delay_s, sigma_s)


def _lines(time_s: FloatArray, force: FloatArray, rate: FloatArray, weight: FloatArray) -> _Lines | None:
    """Return the lines of a hold, None where its rate or its length gives too few."""
    step_s = float(median(np.diff(time_s)))
    grid_s = np.arange(time_s[0], time_s[-1], step_s)
    taper = np.sin(np.pi * (grid_s - grid_s[0]) / (len(grid_s) * step_s)) ** 2 * np.interp(grid_s, time_s, weight)
    hz = np.fft.rfftfreq(len(grid_s), step_s)
    band = (hz >= _BAND_HZ[0]) & (hz <= min(_BAND_HZ[1], _NYQUIST_SHARE / 2 / step_s))
    if np.count_nonzero(band) < _FEWEST_LINES or not taper.any():
        return None

    def spectrum(values: FloatArray, under: FloatArray) -> _Complex:
        lines: _Complex = np.fft.rfft(under[:, None] * values, axis=0)[band]
        return lines

    shown, turning = (np.stack([np.interp(grid_s, time_s, column) for column in values.T], axis=1) for values in (force, rate))
    mean: FloatArray = taper @ shown / taper.sum()
    turning = turning - taper @ turning / taper.sum()
    angle = step_s * (np.cumsum(turning, axis=0) - turning / 2)
    omega = np.asarray(2 * np.pi * hz[band, None], dtype=np.float64)
    # A line next to that of the tremor is not another frequency but the taper: (h w)' = h w' + h' w.
    speeding = 1j * omega * spectrum(turning, taper) - spectrum(turning, np.gradient(taper, step_s))
    arm: _Complex = np.stack([np.cross(speeding, axis) for axis in np.eye(3)])
    gravity: _Complex = -np.cross(spectrum(angle - taper @ angle / taper.sum(), taper), mean)
    return _Lines(omega, spectrum(shown - mean, taper), gravity, arm)


def _step(lines: _Lines, delay_s: float) -> tuple[float, float]:
    """Return the next Gauss-Newton step of the delay, and the 1 sigma of the delay."""
    late = np.exp(1j * lines.omega * delay_s)
    arms = _real(late * lines.arm)
    radius, *_ = np.linalg.lstsq(arms.T, _real(lines.force - late * lines.gravity), rcond=None)
    shown = late * (lines.gravity + np.tensordot(radius, lines.arm, 1))
    residual = _real(lines.force - shown)
    by_delay = _real(1j * lines.omega * shown)
    # The part that an arm would show as well tells nothing of the delay.
    by_delay = by_delay - arms.T @ np.linalg.lstsq(arms.T, by_delay, rcond=None)[0]
    power = float(by_delay @ by_delay)
    freedom = max(len(residual) / _HANN_NEIGHBOURS - 4, 1.0)
    variance = float(residual @ residual) / freedom
    if power > 0:
        # Sway puts sidebands beside the lines of tremor: the residual counts where the delay shows.
        near = _HANN_NEIGHBOURS * float(residual**2 @ by_delay**2) / power
        variance = max(variance, near)
    information = power + variance / USUAL_S**2
    if information == 0:
        return 0.0, USUAL_S
    step_s = (float(by_delay @ residual) - variance / USUAL_S**2 * delay_s) / information
    return step_s, math.sqrt(variance / information)


def _real(lines: _Complex) -> FloatArray:
    """Return real and imaginary parts side by side, shape (..., m, 3) -> (..., 6 m)."""
    return np.concatenate([lines.real, lines.imag], axis=-2).reshape(*lines.shape[:-2], -1)
