"""Begin or end of a turn that fades into the sway of the hand: a smooth turn fitted to the rate, with the sway as noise.

A threshold detects a slow turn only where it is faster than the swings of the arm, and mistakes the wobble of a turn for calm.
Here the rate of the cells at one edge of a stretch is explained by a turn that begins (or ends) at any moment, as people turn:
from rest, without a jerk [1]_, about any axis, for any of a range of lengths. The sway is coloured noise whose autocovariance
the hold itself shows, which tells a slow continued push from swings to and fro that are as fast. For every moment and length
the best turn follows by generalised least squares, and its gain in log-likelihood tells how well it explains the cells
(generalised likelihood ratio, [2]_). The answer is the mean over all of them, weighted with their likelihoods. No real turn
keeps to the profile: where cells are clearly faster than the sway, a share of that rate counts as noise.

References
----------
.. [1] T. Flash, N. Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985): minimum jerk.
.. [2] S. M. Kay, "Fundamentals of statistical signal processing II: detection theory", 1998: sections 6.4 and 12.5.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from imufield.samples import FloatArray

REACH = 40  # Cells from the edge inwards in which a turn is searched; the slowest fades into the sway over half of these.
_LENGTHS = (5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 56.0)  # Of whole turns, in cells; half a second to more than five.
_STEP = 0.5  # Cells between the moments tried.
_LEAST_GAIN = 10.0  # Log-likelihood below which no turn stands out: sway alone makes 5 now and then.
# Of the sway's variance: white noise beside it, since a few seconds do not show a covariance to the last digit. Where three
# seconds show it, the moments found scatter by a twentieth less for it; to longer holds it makes no difference.
_WHITE = 0.03
_FASTER = 2.2  # Times the sway's rms: from here on a cell is clearly of the turn.
_UNLIKE = 0.25  # Share of the rate of such cells that no smooth turn explains: the wobble of real ones.
_HIDDEN = 0.3  # Times the rms angle of the sway: a turn that has made no more than this has not begun.
_SHARES = np.linspace(0, 1, 201)  # Steps of the profile that is inverted by interpolation.
_TINY = np.finfo(np.float64).tiny  # Instead of a zero that would be divided by.


class Sway(NamedTuple):
    """Motion of a hand in a hold."""

    covariance: FloatArray
    """Autocovariance of the rates at lags of 0, 1, ... cells, shape (REACH, 3)."""
    angle: float
    """Rms length of the angle, in rate times cells."""


class _Turns(NamedTuple):
    """Turns that may be at the end of k cells, n of them, each by an angle of 1."""

    begin: FloatArray  # Cells from the first, shape (n,).
    length: FloatArray
    rate: FloatArray  # In each cell, shape (k, n).


def minimum_jerk(share: FloatArray) -> FloatArray:
    """Return the share of a turn, from rest to rest, that is made after a share of its time, 0 to 1 ([1]_)."""
    made: FloatArray = share**3 * (10 + share * (6 * share - 15))
    return made


def sway_of(rate: FloatArray) -> Sway:
    """Return the sway in the rates of a hold, shape (m, 3)."""
    m = len(rate)
    rate = rate - rate.mean(axis=0)
    # Padded to twice the length, so that the ends do not wrap around.
    power = np.abs(np.fft.rfft(rate, 2 * m, axis=0)) ** 2
    covariance = np.zeros((REACH, 3))
    lags = min(m, REACH)
    covariance[:lags] = np.fft.irfft(power, axis=0)[:lags] / m
    time = np.linspace(-1, 1, m)[:, np.newaxis]
    angle = np.cumsum(rate, axis=0)
    angle -= angle.mean(axis=0)
    # A straight line is the error of the mean rate and no sway.
    angle -= time * (time * angle).sum(axis=0) / (time * time).sum()
    return Sway(covariance, math.sqrt(float((angle**2).mean(axis=0).sum())))


def cells_of_turn(rate: FloatArray, sway: Sway, least: float) -> float | None:
    """Return the number of cells at the end that are of a turn, None where no turn stands out from the sway.

    Parameters
    ----------
    rate : ndarray, shape (k, 3)
        Rates of the last cells of a stretch, without the mean of the hold; k at most ``REACH``.
    sway : Sway
    least : float
        Rate, rms per axis, below which nothing counts.
    """
    k = len(rate)
    turns = _turns(k)
    swing = max(math.sqrt(float(sway.covariance[0].sum())), least)
    size = np.linalg.norm(rate, axis=1)
    # Once the turn is visible it continues, although its wobble makes single cells slow.
    fast = np.maximum.accumulate(np.where(size > _FASTER * swing, size, 0.0))
    lag = np.abs(np.subtract.outer(np.arange(k), np.arange(k)))
    white = _WHITE * sway.covariance[0][:, np.newaxis] + least**2 + (_UNLIKE * fast) ** 2
    # Of the rate that no turn explains, one matrix for each axis, shape (3, k, k).
    covariance = sway.covariance.T[:, lag] + white[:, :, np.newaxis] * np.eye(k)
    # Whitened, the sway and the rest of the noise weigh every cell alike: least squares of each moment and length at once.
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    expected = whitening @ turns.rate
    energy = np.maximum((expected**2).sum(axis=1), _TINY)
    match = np.einsum("akn,ak->an", expected, np.einsum("akl,la->ak", whitening, rate))
    gain = (match**2 / energy).sum(axis=0) / 2
    if gain.max() < _LEAST_GAIN:
        return None
    angle = np.linalg.norm(match / energy, axis=0)
    share = np.minimum(_HIDDEN * sway.angle / np.maximum(angle, _TINY), 1.0)
    begin = np.minimum(turns.begin + turns.length * np.interp(share, minimum_jerk(_SHARES), _SHARES), k)
    weight = np.exp(gain - gain.max())
    return k - float(weight @ begin) / float(weight.sum())


@lru_cache(maxsize=8)
def _turns(count: int) -> _Turns:
    """Return the turns that are tried on a number of cells."""
    begin, length = (grid.ravel() for grid in np.meshgrid(np.arange(0.0, count, _STEP), _LENGTHS, indexing="ij"))
    made = minimum_jerk(np.clip((np.arange(count + 1.0)[:, np.newaxis] - begin) / length, 0.0, 1.0))
    return _Turns(begin, length, np.diff(made, axis=0))
