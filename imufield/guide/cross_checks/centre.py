"""The centre of the stills: the accelerometer's offset as far as sides and norms need it, before anything is calibrated.

Whatever side is up, a still output x lies at gravity's length from the output at no input c: |x - c| = r. Squared, that is
linear in c and k = r^2 - |c|^2:

    2 x . c + k = |x|^2

This is the sphere in place of the ellipsoid of ``calibrate/accelerometer/start.py``: four unknowns in place of nine, so that
five stills tell it with one to spare. Scales that differ by 3 % from axis to axis move the centre by 0.06 g at most where it is
taken. An offset of 0.5 g, common in cheap parts, turns the apparent up by 30 degrees and makes norms of 0.5 to 1.5 g.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray

_FEWEST = 5  # Stills: one more than there are unknowns.
# Smallest singular value of the stills (unit length, beside a column of ones) with which the centre is taken: squares that are
# 6 % wrong, of scales that differ by 3 %, move it by half of that over this value.
_LEAST_SIGHT = 0.5
# An offset of less stays in: it turns the apparent up by 6 degrees, which a side's tolerance allows for, and the running fit
# finds it better.
LEAST_OFFSET_M_S2 = 1.0


def centred(scale: RoughScale, stills_raw: FloatArray) -> RoughScale:
    """Return a scale that counts from the centre of the stills (m, 3), unchanged where they do not show it.

    A scale that was learned from the first still, with the offset in it, is learned anew from the distance to the centre.
    """
    if scale.accelerometer is None or len(stills_raw) < _FEWEST:
        return scale
    x = stills_raw - scale.raw_zero
    length = float(np.sqrt(np.mean(np.sum(x**2, axis=1))))
    if not length > 0:
        return scale
    x = x / length
    design = np.column_stack([2 * x, np.ones(len(x))])
    if np.linalg.svd(design * [0.5, 0.5, 0.5, 1.0], compute_uv=False)[-1] < _LEAST_SIGHT:
        return scale
    *centre, k = np.linalg.lstsq(design, np.sum(x**2, axis=1), rcond=None)[0]
    offset, radius = length * np.array(centre), length * float(np.sqrt(k + np.dot(centre, centre)))
    if np.linalg.norm(offset) <= LEAST_OFFSET_M_S2 * scale.accelerometer:
        return replace(scale, centred=True)
    accelerometer = radius / STANDARD_GRAVITY_M_S2 if scale.learned else scale.accelerometer
    return replace(scale, accelerometer=accelerometer, raw_zero=scale.raw_zero + offset, centred=True)
