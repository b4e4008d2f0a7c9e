"""Rotations, many at once: of a simulated instrument, and of the intervals of a gyroscope.

Which body frame the parameters are written in: ``gauge``.

Quaternions are ``[w, x, y, z]``, unit. The turn of an interval with rotation vector ``p`` takes vectors of the body frame at
its end to the body frame at its start, so the turn of a chain of intervals is the product ``q_1 q_2 ... q_n``: the gyroscope
gives body rates, and each turn is made in the frame that the one before has reached.

A small change ``d`` of one rotation vector changes the turn by a rotation of ``Jr(p) d`` at its end [1]_::

    exp(p + d) = exp(p) exp(Jr(p) d),    Jr(p) = I - (1 - cos t)/t^2 [p] + (t - sin t)/t^3 [p]^2,    t = norm(p)

References
----------
.. [1] J. Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508, 2017: equation 184.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from imufield.samples import FloatArray, IntArray

# Element by element below, not as products of small matrices: NumPy's loops over three numbers cost more than the numbers.
_CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
_MANY = 4096  # Turns from which they are multiplied in blocks: below, few long passes are faster.
_BLOCK = 16
_SMALL_RAD = 1e-3  # Below this the series of ``Jr`` is exact to the last bit that matters (1e-13).


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of vectors, shape (..., 3); several times faster than ``numpy.cross`` on long arrays."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in _CYCLES:
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


def skew(vector: FloatArray) -> FloatArray:
    """Return the matrices [v] with [v] x = v cross x, shape (..., 3) -> (..., 3, 3)."""
    matrix = np.zeros((*vector.shape[:-1], 3, 3))
    matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0] = vector[..., 0], vector[..., 1], vector[..., 2]
    return matrix - np.swapaxes(matrix, -1, -2)


def multiply(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the quaternion product, shape (..., 4)."""
    (lw, *lv), (rw, *rv) = ([factor[..., k] for k in range(4)] for factor in (left, right))
    result = _components(np.broadcast_shapes(left.shape, right.shape), 1)
    result[..., 0] = lw * rw - (lv[0] * rv[0] + lv[1] * rv[1] + lv[2] * rv[2])
    for i, j, k in _CYCLES:
        result[..., 1 + i] = lw * rv[i] + rw * lv[i] + (lv[j] * rv[k] - lv[k] * rv[j])
    return result


def product(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the products of matrices, shape (..., 3, 3): as ``left @ right``, several times faster on long arrays."""
    result = _components(np.broadcast_shapes(left.shape, right.shape), 2)
    for i in range(3):
        for j in range(3):
            first, second, third = (left[..., i, k] * right[..., k, j] for k in range(3))
            result[..., i, j] = first + second + third
    return result


def _components(shape: tuple[int, ...], axes: int) -> FloatArray:
    """Return an array to be filled, the numbers of each component (its last axes) beside each other in memory."""
    order = (*range(axes, len(shape)), *range(axes))
    return np.empty((*shape[-axes:], *shape[:-axes])).transpose(order)


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths of vectors, shape (..., n) to (...)."""
    return np.asarray(np.sqrt(sum(vectors[..., k] ** 2 for k in range(vectors.shape[-1]))))


def exponential(rotation_rad: FloatArray) -> FloatArray:
    """Return quaternions of rotation vectors, shape (..., 3) -> (..., 4)."""
    angle = _lengths(rotation_rad)[..., None]
    result = _components((*rotation_rad.shape[:-1], 4), 1)
    # np.sinc(x) is sin(pi x) / (pi x) and exact at zero.
    result[..., :1], result[..., 1:] = np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * rotation_rad
    return result


def logarithm(quaternion: FloatArray) -> FloatArray:
    """Return rotation vectors of at most pi, shape (..., 4) -> (..., 3)."""
    # q and -q are one turn: take the one of at most pi.
    short = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = np.linalg.norm(short[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, short[..., :1])
    return np.asarray(np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 2.0) * short[..., 1:])


def conjugate(quaternion: FloatArray) -> FloatArray:
    """Return the inverse of unit quaternions, shape (..., 4)."""
    return np.asarray(quaternion * np.array([1.0, -1.0, -1.0, -1.0]))


def rotate(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Return vectors turned by quaternions, shape (..., 4) and (..., 3) to (..., 3)."""
    w, v = quaternion[..., :1], quaternion[..., 1:]
    # q v q* without the two quaternion products
    twice = 2 * cross(v, vector)
    return vector + w * twice + cross(v, twice)


def matrix(quaternion: FloatArray) -> FloatArray:
    """Return rotation matrices, shape (..., 4) -> (..., 3, 3)."""
    w, *v = (quaternion[..., k] for k in range(4))
    result = _components((*quaternion.shape[:-1], 3, 3), 2)
    common = w**2 - (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    for i, j, k in _CYCLES:
        product, turn = 2 * v[i] * v[j], 2 * w * v[k]
        result[..., i, i] = 2 * v[i] ** 2 + common
        result[..., i, j] = product - turn
        result[..., j, i] = product + turn
    return result


def from_matrix(rotation: FloatArray) -> FloatArray:
    """Return quaternions of rotation matrices, shape (..., 3, 3) -> (..., 4)."""
    d = np.diagonal(rotation, axis1=-2, axis2=-1)
    trace = d.sum(axis=-1)
    # The four squares add up to 1, so the largest is at least 1/4: its row is divided by nothing small.
    squares = np.concatenate([1 + trace[..., None], 1 + 2 * d - trace[..., None]], axis=-1)
    R = rotation
    x, y, z = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    xy, xz, yz = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    w2, x2, y2, z2 = (squares[..., k] for k in range(4))
    table = np.stack([w2, x, y, z, x, x2, xy, xz, y, xy, y2, yz, z, xz, yz, z2], axis=-1).reshape(*trace.shape, 4, 4)
    best = np.argmax(squares, axis=-1)[..., None, None]
    row = np.take_along_axis(table, np.broadcast_to(best, (*trace.shape, 1, 4)), axis=-2)[..., 0, :]
    return unit_vectors(row)


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return the directions of vectors, shape (..., n)."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def one_rotation_matrix(rotation_rad: FloatArray) -> FloatArray:
    """Return the matrix of one rotation vector, by Rodrigues: where each turn waits for the one before, arrays cost more."""
    x, y, z = rotation_rad.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    half = math.sin(angle / 2) / angle if angle > 0 else 0.5
    # I + s [r] + 2 h^2 [r]^2 with h = sin(t/2) / t and s = sin(t) / t
    s, c = 2 * half * math.cos(angle / 2), 2 * half * half
    return np.array(
        [
            [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)],
        ]
    )


def right_jacobian(rotation_rad: FloatArray) -> FloatArray:
    """Return Jr of rotation vectors, shape (..., 3) -> (..., 3, 3)."""
    p = [rotation_rad[..., k] for k in range(3)]
    angle = _lengths(rotation_rad)
    small = angle < _SMALL_RAD
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    result = _components((*rotation_rad.shape, 3), 2)
    for i, j, k in _CYCLES:
        product, turn = second * p[i] * p[j], first * p[k]
        result[..., i, i] = 1 - second * (p[j] ** 2 + p[k] ** 2)
        result[..., i, j] = product + turn
        result[..., j, i] = product - turn
    return result


def total_turn(quaternion: FloatArray) -> FloatArray:
    """Return the turn of each whole chain of intervals, shape (..., k, 4) to (..., 4)."""
    # Neighbours in pairs: a few passes, each over half as many as the one before.
    while (count := quaternion.shape[-2]) > 1:
        pairs = multiply(quaternion[..., : count - 1 : 2, :], quaternion[..., 1::2, :])
        quaternion = np.concatenate([pairs, quaternion[..., count - count % 2 :, :]], axis=-2)
    return np.asarray(quaternion[..., 0, :] / np.linalg.norm(quaternion[..., 0, :], axis=-1, keepdims=True))


def running_turns(quaternion: FloatArray, first: IntArray) -> FloatArray:
    """Return the turn from the start of each chain to the end of each of its intervals.

    Parameters
    ----------
    quaternion : ndarray, shape (k, 4)
        Turns of single intervals, chain after chain.
    first : ndarray of int, shape (m,)
        Where each chain begins.

    Returns
    -------
    ndarray, shape (k, 4)
        Running products, in vectorised passes instead of one step an interval.
    """
    length = np.diff(np.append(first, len(quaternion)))
    running = _running(quaternion.copy(), length)
    running /= _lengths(running)[..., None]
    return running


def _running(running: FloatArray, length: IntArray) -> FloatArray:
    """Return running products of chains of these lengths, shape (k, 4); what is given is changed."""
    first = np.cumsum(length) - length
    place = np.arange(len(running)) - np.repeat(first, length)
    if len(running) < _MANY:
        step = 1
        while step < length.max(initial=0):
            later = np.flatnonzero(place >= step)
            running[later] = multiply(running[later - step], running[later])
            step *= 2  # each pass doubles how far every product reaches
        return running
    # Many passes over much cost more than memory gives: blocks of a chain, all at once, and then the chains of their products.
    blocks = -(-length // _BLOCK)
    first_block = np.cumsum(blocks) - blocks
    at = np.repeat(first_block, length) + place // _BLOCK
    # Filled up with turns about nothing. Numbers of one component stand together, which makes long loops of it.
    filled = np.zeros((4, _BLOCK * blocks.sum()))
    filled[0] = 1.0
    filled[:, (places := place % _BLOCK * blocks.sum() + at)] = running.T
    products = np.moveaxis(filled.reshape(4, _BLOCK, -1), 0, -1)
    for step in range(1, _BLOCK):
        products[step] = multiply(products[step - 1], products[step])
    before = np.roll(_running(products[-1].copy(), blocks), 1, axis=0)
    before[first_block[length > 0]] = (1.0, 0.0, 0.0, 0.0)
    return multiply(before.T.take(at, axis=1).T, filled.take(places, axis=1).T)


def signed_permutations() -> FloatArray:
    """Return the 48 signed permutation matrices, shape (48, 3, 3)."""
    orders, signs = itertools.permutations(range(3)), list(itertools.product((1.0, -1.0), repeat=3))
    return np.array([np.eye(3)[list(order)] * np.array(sign)[:, None] for order in orders for sign in signs])


def misfits_rad(
    turns_raw: FloatArray, before: FloatArray, after: FloatArray, *, permutations: FloatArray, scales: FloatArray
) -> FloatArray:
    """Return the angles between directions fixed in the room and where turns carry them, in each of the m moves.

    Parameters
    ----------
    turns_raw : ndarray, shape (m, k, 3)
        Rotation vectors of the intervals, raw; zeros fill up shorter moves.
    before, after : ndarray, shape (m, 3)
        The direction in the body frame, unit vectors.
    permutations : ndarray, shape (p, 3, 3)
        Signed ones; right turns = permutation @ given turns.
    scales : ndarray, shape (n,)
        Raw per rad.

    Returns
    -------
    ndarray, shape (n, m, p)
    """
    turned = exponential(turns_raw / scales[:, None, None, None])
    # A permutation P of determinant d gives exp(P w) = P exp(d w) P^T, so all 48 need two chains of turns: of w and of -w.
    mirrored, misfits = np.linalg.det(permutations) < 0, np.empty((len(scales), len(before), len(permutations)))
    for is_mirrored in {*mirrored.tolist()}:
        alike = mirrored == is_mirrored
        back = matrix(conjugate(total_turn(conjugate(turned) if is_mirrored else turned)))
        start, end = (np.einsum("pji,mj->mip", permutations[alike], each) for each in (before, after))
        chord = np.linalg.norm(back @ start - end, axis=-2)
        misfits[..., alike] = 2 * np.arcsin(np.minimum(chord / 2, 1.0))
    return misfits
