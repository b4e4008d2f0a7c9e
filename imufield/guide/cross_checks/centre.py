"""The centre of the stills: the accelerometer's offset as far as sides and norms need it, before anything is calibrated.

Whatever side is up, a still output x lies at gravity's length from the output at no input c: norm(x - c) = r. This is the
sphere in place of the ellipsoid of ``calibrate/accelerometer/ellipsoid_start.py``: four unknowns in place of nine, so that six
faces tell it with two to spare. Scales that differ by 3 % from axis to axis move the centre by 0.06 g at most where it is
taken. An offset of 0.5 g, common in cheap parts, turns the apparent up by 30 degrees and makes norms of 0.5 to 1.5 g.

Stills that are none (an elevator, a range that was changed) must not move the centre for the others, so the residuals have
Cauchy's weights 1 / (1 + (residual / s)^2) [1]_, with s going from half of r, where the sum is nearly convex, to what unequal
scales leave [2]_.

References
----------
.. [1] P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted least-squares", Commun. Stat. A6(9), 1977.
.. [2] A. Blake, A. Zisserman, "Visual Reconstruction", 1987: graduated non-convexity.
"""

from __future__ import annotations

import numpy as np

from imufield.dataclass import replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray, median

_UNKNOWNS = 4
FEWEST_STILLS = 6
"""The six faces, of which none tells a direction alone."""
# s in each step, of gravity.
_WIDTHS = np.maximum(0.05, 0.5 * 0.7 ** np.arange(20))
_ON_SPHERE = 0.15  # Three times the last s.
# Smallest singular value of the directions (unit length, beside a column of ones) with which the centre is taken: lengths
# that are 3 % wrong move it by that over this value.
_LEAST_SINGULAR_VALUE = 0.5
# Who nearly alone tells a direction is believed, whatever it shows; each of six faces has a leverage of 0.67.
_LARGEST_LEVERAGE = 0.8
_SAME_SIDE = 0.25  # Of gravity: stills nearer than this are of one side, and say twice what it says.
_UNSEEN = 0.05  # Singular value, as a share of the largest, below which a direction of the centre keeps its start.
_LEAST_OF_OFFSET = 0.005  # Gravity beside a mid-scale: 0.04 for 16 g in 16 bits. Noise of stills is a tenth of this.
_UNEQUAL = 0.5  # From a nominal scale a real one differs by less.
# An offset of less stays in: it turns the apparent up by 6 degrees, which a side's tolerance allows for, and the running fit
# finds it better.
LEAST_OFFSET_M_S2 = 1.0


def centred(scale: RoughScale, stills_raw: FloatArray) -> RoughScale:
    """Return a scale that counts from the centre of the stills (m, 3), unchanged where they do not show it.

    Where enough of them show that no centre explains them, the present one counts. A scale that was learned from the first
    still, with the offset in it, is learned anew from the distance to the centre.
    """
    if scale.accelerometer is None or len(stills_raw) < FEWEST_STILLS:
        return scale
    # From the middle of all where they look like one side: beside a converter's mid-scale gravity is small.
    middle = (stills_raw.min(axis=0) + stills_raw.max(axis=0)) / 2
    for start in (scale.raw_zero, middle):
        x = stills_raw - start
        length = float(median(np.linalg.norm(x, axis=1)))
        if length > 0 and len(x := _sides(x / length)) >= FEWEST_STILLS:
            break
    else:
        return scale
    centre, radius = _fit_sphere(x)
    offset = start + length * centre - scale.raw_zero
    if start is not scale.raw_zero and not _is_gravity(length * radius, scale, offset):
        return scale
    arm = x - centre
    on_sphere = np.abs(np.linalg.norm(arm, axis=1) / radius - 1) < _ON_SPHERE
    spare, off = int(on_sphere.sum()) - _UNKNOWNS, int((~on_sphere).sum())
    # Four stills always lie on a sphere: those to spare must outnumber those that are not on it.
    if spare <= off or not _is_seen(arm[on_sphere]):
        return replace(scale, centred=True) if _is_seen(x) and start is scale.raw_zero else scale
    if np.linalg.norm(offset) <= LEAST_OFFSET_M_S2 * scale.accelerometer:
        return replace(scale, centred=True)
    accelerometer = length * radius / STANDARD_GRAVITY_M_S2 if scale.learned else scale.accelerometer
    return replace(scale, accelerometer=accelerometer, raw_zero=scale.raw_zero + offset, centred=True)


def _is_gravity(radius_raw: float, scale: RoughScale, offset: FloatArray) -> bool:
    """Whether a sphere about a far centre is as large as gravity: stills of one pose lie on one as large as their noise."""
    if scale.learned or scale.accelerometer is None:
        return radius_raw > _LEAST_OF_OFFSET * float(np.linalg.norm(offset))
    return abs(radius_raw / (STANDARD_GRAVITY_M_S2 * scale.accelerometer) - 1) < _UNEQUAL


def may_hide_offset(mean_raw: FloatArray, scale: RoughScale) -> bool:
    """Whether a still mean (3,) may point elsewhere because of an offset: its length is not gravity's, or tells nothing."""
    if scale.centred:
        return False
    return (
        scale.learned or abs(float(np.linalg.norm(scale.specific_force(mean_raw))) - STANDARD_GRAVITY_M_S2) > LEAST_OFFSET_M_S2
    )


def _sides(x: FloatArray) -> FloatArray:
    """Return the first point of each side."""
    kept: list[FloatArray] = []
    for point in x:
        if all(np.linalg.norm(point - other) >= _SAME_SIDE for other in kept):
            kept.append(point)
    return np.array(kept)


def _fit_sphere(x: FloatArray) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius of points (m, 3) of typical length 1: Gauss-Newton from the origin."""
    found, rows = np.array([0.0, 0.0, 0.0, 1.0]), np.ones((len(x), 4))
    for width in _WIDTHS:
        arm = x - found[:3]
        # A point at the centre itself has no direction, and no say.
        distance = np.maximum(np.linalg.norm(arm, axis=1), 1e-9)
        residual = distance - found[3]
        weight = 1 / np.sqrt(1 + (residual / width) ** 2)
        rows[:, :3] = arm / distance[:, None]
        found = found + np.linalg.lstsq(rows * weight[:, None], residual * weight, rcond=_UNSEEN)[0]
    return found[:3], float(found[3])


def _is_seen(arm: FloatArray) -> bool:
    """Whether points (m, 3) about the centre show it, and none of them a direction nearly alone."""
    if len(arm) < FEWEST_STILLS:
        return False
    rows = np.column_stack([arm / np.linalg.norm(arm, axis=1)[:, None], np.ones(len(arm))])
    left, values, _ = np.linalg.svd(rows, full_matrices=False)
    # The rows of the left factor have the leverages as their squared lengths.
    return bool(values[-1] >= _LEAST_SINGULAR_VALUE and np.sum(left**2, axis=1).max() <= _LARGEST_LEVERAGE)
