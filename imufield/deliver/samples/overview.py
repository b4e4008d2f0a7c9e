"""Hours of samples in few rows, for a picture: neighbours joined to blocks, of each the minimum, mean and maximum.

Nobody knows beforehand how many samples there are: blocks begin with one sample each, and where there are too many of them,
neighbours are joined, so that a block of an hour at 2000 Hz has some thousand samples and memory does not grow with time.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from imufield.samples import FloatArray, Samples

MOST_BLOCKS = 4096
"""Four for each dot across a wide screen, so that a part of it can be looked at closely."""
_SIGNALS = ("ax", "ay", "az", "gx", "gy", "gz")
# Of least and largest values, sums and counts; absent values (NaN) are left out of all of them.
_JOIN = (np.fmin, np.fmax, np.add, np.add)


def overview(blocks: Iterable[Samples]) -> tuple[dict[str, FloatArray], int]:
    """Return columns of at most ``MOST_BLOCKS`` rows, and how many samples they show.

    Parameters
    ----------
    blocks : iterable of Samples
        In time order.

    Returns
    -------
    columns : dict of ndarray
        ``time_s`` and ``temperature_degc`` (means); ``ax_min``, ``ax_mean``, ``ax_max`` and so on, raw units; NaN where absent.
    samples : int
    """
    width, samples = 1, 0
    parts = tuple(np.empty((0, 2 + len(_SIGNALS))) for _ in _JOIN)
    for block in blocks:
        values = np.column_stack([block.time_s, block.accelerometer, block.gyroscope, block.temperature_degc])
        known = np.isfinite(values)
        some = np.where(known, values, np.nan)
        new = _joined((some, some, np.where(known, values, 0.0), known.astype(np.float64)), width)
        parts = tuple(np.concatenate(pair) for pair in zip(parts, new, strict=True))
        samples += len(block)
        while len(parts[0]) > MOST_BLOCKS:
            parts, width = _joined(parts, 2), 2 * width
    least, largest, total, count = parts
    mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    columns = {"time_s": mean[:, 0]}
    for axis, name in enumerate(_SIGNALS, start=1):
        columns |= {f"{name}_min": least[:, axis], f"{name}_mean": mean[:, axis], f"{name}_max": largest[:, axis]}
    return columns | {"temperature_degc": mean[:, -1]}, samples


def _joined(parts: tuple[FloatArray, ...], number: int) -> tuple[FloatArray, ...]:
    """Return the parts with ``number`` neighbours joined to one; the last may have fewer."""
    starts = np.arange(0, len(parts[0]), number)
    return tuple(join.reduceat(part, starts, axis=0) for join, part in zip(_JOIN, parts, strict=True))
