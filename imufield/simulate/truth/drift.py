"""Slow bias drift: flicker noise (bias instability) and random walk, as a stream.

Flicker is approximated by first-order Gauss-Markov processes whose time constants ``tau`` are a factor ``r`` apart, all of
the same variance v. In the limit of close spacing the one-sided density of the sum is v / (f ln r) between the corner
frequencies; a bias instability of B means B**2 / (pi f) [1]_, hence v = B**2 ln(r) / pi.

The processes are drawn exactly on *anchors* 0.1 s apart, in fixed blocks of anchors, and interpolated in between: the
result does not depend on how a session is cut into calls.

References
----------
.. [1] IEEE Std 952-2020, annex C: bias instability, Allan deviation floor sqrt(2 ln 2 / pi) B.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.samples import FloatArray

ANCHOR_S = 0.1
ANCHORS_PER_BLOCK = 64
_SPACING = math.sqrt(10.0)  # r of the derivation above: two time constants a decade.
TIME_CONSTANTS_S = 0.5 * _SPACING ** np.arange(9)
"""0.5 s to 5000 s: faster flicker drowns in white noise, slower looks constant over one session."""


class BiasDrift:
    """Drift of the biases of several channels, read at rising times.

    Parameters
    ----------
    bias_instability, random_walk : ndarray, shape (c,)
        B, in the unit of the channel, and the walk in 1 s, unit per sqrt(s).
    rng : numpy.random.Generator
        Used by nothing else, or the result depends on the order of calls.
    """

    def __init__(self, bias_instability: FloatArray, random_walk: FloatArray, rng: np.random.Generator) -> None:
        self._rng = rng
        decay = np.exp(-ANCHOR_S / TIME_CONSTANTS_S)
        self._carry_over = decay[:, np.newaxis] ** np.arange(1, ANCHORS_PER_BLOCK + 1)
        # Lower triangular matrices that filter a block of shocks, shape (processes, k, k): decay^lag for two anchors.
        steps = np.arange(ANCHORS_PER_BLOCK)
        lag = steps[:, np.newaxis] - steps
        self._response = np.where(lag >= 0, decay[:, np.newaxis, np.newaxis] ** np.maximum(lag, 0), 0.0)
        # v = B^2 ln(r) / pi, see above.
        stationary = np.asarray(bias_instability) * math.sqrt(math.log(_SPACING) / math.pi)
        # A shock of this size keeps the variance of x[k+1] = exp(-dt / tau) x[k] + shock at v.
        self._innovation = np.sqrt(1 - decay**2)[:, np.newaxis] * stationary
        self._walk_step = np.asarray(random_walk) * math.sqrt(ANCHOR_S)
        self._state = stationary * rng.standard_normal((len(decay), len(stationary)))
        self._walk = np.zeros(len(stationary))
        self._first = 0
        self._anchors: FloatArray = self._state.sum(axis=0)[np.newaxis]

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the drift at rising times, shape (n,) to (n, c); anchors before ``time_s[0]`` are dropped."""
        position = time_s / ANCHOR_S
        lower = np.floor(position).astype(np.int64)
        missing = int(lower[-1]) + 2 - self._first - len(self._anchors)
        # Whole blocks only: the draws do not depend on the times asked for.
        blocks = [self._next_block() for _ in range(math.ceil(missing / ANCHORS_PER_BLOCK))]
        self._anchors = np.concatenate([self._anchors, *blocks])
        forget = max(0, int(lower[0]) - self._first)
        self._anchors, self._first = self._anchors[forget:], self._first + forget
        row = lower - self._first
        weight = (position - lower)[:, np.newaxis]
        below = self._anchors[row]
        return below + weight * (self._anchors[row + 1] - below)

    def _next_block(self) -> FloatArray:
        """Return the next anchors, shape (ANCHORS_PER_BLOCK, c), and carry the state on."""
        processes, channels = self._state.shape
        shocks = self._innovation[:, np.newaxis] * self._rng.standard_normal((processes, ANCHORS_PER_BLOCK, channels))
        flicker = self._carry_over[:, :, np.newaxis] * self._state[:, np.newaxis] + self._response @ shocks
        steps = self._walk_step * self._rng.standard_normal((ANCHORS_PER_BLOCK, channels))
        walk = self._walk + np.cumsum(steps, axis=0)
        self._state, self._walk = flicker[:, -1], walk[-1]
        block: FloatArray = flicker.sum(axis=0) + walk
        return block
