"""Running mean and covariance of points, and the covariance's axes, in single precision.

The interest of a pixel depends on the direction of an axis, and that axis, for a nearly flat patch, on the last bits.
To give the results of PCL, the running update and the closed form (characteristic polynomial; an eigenvector as the
longest cross product of two rows) use PCL's order of operations and precision.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch_detector.proposals.narf.range_image import Floats

MOMENTS = 11
"""Numbers in a moments array: mean (3), covariance xx, xy, xz, yy, yz, zz, sum of the weights, number of points."""
COUNT = 10
_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_THIRD, _SQRT3 = np.float32(1 / 3), np.sqrt(np.float32(3))
_EPSILON = np.finfo(np.float32).eps
_TINY = np.finfo(np.float32).tiny
_SMALL = np.float32(1e-5)


@njit(cache=True, nogil=True, error_model="numpy")
def add_point(moments: Floats, point: Floats, weight: np.float32) -> None:
    """Adds `point` (3,) to `moments` (MOMENTS,)."""
    if weight == _ZERO:
        return
    moments[9] += weight
    moments[COUNT] += _ONE
    share = weight / moments[9]
    rest = _ONE - share
    dx, dy, dz = point[0] - moments[0], point[1] - moments[1], point[2] - moments[2]
    moments[3] = (moments[3] + dx * dx * share) * rest
    moments[4] = (moments[4] + dx * dy * share) * rest
    moments[5] = (moments[5] + dx * dz * share) * rest
    moments[6] = (moments[6] + dy * dy * share) * rest
    moments[7] = (moments[7] + dy * dz * share) * rest
    moments[8] = (moments[8] + dz * dz * share) * rest
    moments[0] += dx * share
    moments[1] += dy * share
    moments[2] += dz * share


@njit(cache=True, nogil=True, error_model="numpy")
def compute_axes(moments: Floats, values: Floats, vectors: Floats) -> None:
    """Writes the covariance's eigenvalues, rising, to `values` (3,) and its eigenvectors to the rows of `vectors`."""
    scale = _ZERO
    for k in range(3, 9):
        scale = max(scale, abs(moments[k]))
    if scale <= _TINY:
        scale = _ONE
    xx, xy, xz = moments[3] / scale, moments[4] / scale, moments[5] / scale
    yy, yz, zz = moments[6] / scale, moments[7] / scale, moments[8] / scale
    _solve_cubic(xx, xy, xz, yy, yz, zz, values)
    if values[2] - values[0] <= _EPSILON:
        vectors[:] = _ZERO
        vectors[0, 0] = vectors[1, 1] = vectors[2, 2] = _ONE
    elif values[1] - values[0] <= _EPSILON:
        _find_null_vector(xx - values[2], xy, xz, yy - values[2], yz, zz - values[2], vectors[2])
        _find_perpendicular(vectors[2], vectors[1])
        cross(vectors[1], vectors[2], vectors[0])
    elif values[2] - values[1] <= _EPSILON:
        _find_null_vector(xx - values[0], xy, xz, yy - values[0], yz, zz - values[0], vectors[0])
        _find_perpendicular(vectors[0], vectors[1])
        cross(vectors[0], vectors[1], vectors[2])
    else:
        l0 = _find_null_vector(xx - values[0], xy, xz, yy - values[0], yz, zz - values[0], vectors[0])
        l1 = _find_null_vector(xx - values[1], xy, xz, yy - values[1], yz, zz - values[1], vectors[1])
        l2 = _find_null_vector(xx - values[2], xy, xz, yy - values[2], yz, zz - values[2], vectors[2])
        surest, least = 0, 0
        if l1 < l0:
            least = 1
        if l2 < min(l0, l1):
            least = 2
        if l1 >= l0:
            surest = 1
        if l2 >= max(l0, l1):
            surest = 2
        for k in (least, 3 - least - surest):
            cross(vectors[(k + 1) % 3], vectors[(k + 2) % 3], vectors[k])
            normalise(vectors[k])
    for k in range(3):
        values[k] *= scale


@njit(cache=True, nogil=True, error_model="numpy")
def cross(a: Floats, b: Floats, out: Floats) -> None:
    """Writes a x b, (3,) each, to `out`."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    out[0], out[1], out[2] = x, y, z


@njit(cache=True, nogil=True, error_model="numpy")
def dot(a: Floats, b: Floats) -> np.float32:
    """a . b of (3,)."""
    return a[0] * b[0] + (a[1] * b[1] + a[2] * b[2])


@njit(cache=True, nogil=True, error_model="numpy")
def normalise(a: Floats) -> None:
    """Gives a (3,) length 1, unless it is zero."""
    square = dot(a, a)
    if square > _ZERO:
        length = np.sqrt(square)
        a[0] /= length
        a[1] /= length
        a[2] /= length


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_cubic(
    xx: np.float32, xy: np.float32, xz: np.float32, yy: np.float32, yz: np.float32, zz: np.float32, values: Floats
) -> None:
    """The eigenvalues of a positive semi-definite matrix, rising, after Cardano."""
    determinant = xx * yy * zz + _TWO * xy * xz * yz - xx * yz * yz - yy * xz * xz - zz * xy * xy
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    trace = xx + yy + zz
    if abs(determinant) < _EPSILON:
        _solve_quadratic(trace, minors, values)
        return
    mean = trace * _THIRD
    a = min((minors - trace * mean) * _THIRD, _ZERO)
    b = _HALF * (determinant + mean * (_TWO * mean * mean - minors))
    q = min(b * b + a * a * a, _ZERO)
    rho = np.sqrt(-a)
    angle = np.arctan2(np.sqrt(-q), b) * _THIRD
    cosine, sine = np.cos(angle), np.sin(angle)
    r0 = mean + _TWO * rho * cosine
    r1 = mean - rho * (cosine + _SQRT3 * sine)
    r2 = mean - rho * (cosine - _SQRT3 * sine)
    if r0 >= r1:
        r0, r1 = r1, r0
    if r1 >= r2:
        r1, r2 = r2, r1
        if r0 >= r1:
            r0, r1 = r1, r0
    values[0], values[1], values[2] = r0, r1, r2
    if r0 <= _ZERO:
        _solve_quadratic(trace, minors, values)


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_quadratic(trace: np.float32, minors: np.float32, values: Floats) -> None:
    """The eigenvalues when the smallest is zero."""
    square = np.float32(np.float64(trace * trace) - 4.0 * np.float64(minors))
    root = np.sqrt(max(square, _ZERO))
    values[0], values[1], values[2] = _ZERO, _HALF * (trace - root), _HALF * (trace + root)


@njit(cache=True, nogil=True, error_model="numpy")
def _find_null_vector(
    xx: np.float32, xy: np.float32, xz: np.float32, yy: np.float32, yz: np.float32, zz: np.float32, out: Floats
) -> np.float32:
    """Writes the unit vector that a singular symmetric matrix maps to zero; returns the cross product's length."""
    ax, ay, az = xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy
    bx, by, bz = xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz
    cx, cy, cz = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    la = np.sqrt(ax * ax + (ay * ay + az * az))
    lb = np.sqrt(bx * bx + (by * by + bz * bz))
    lc = np.sqrt(cx * cx + (cy * cy + cz * cz))
    length = la
    if lb > length:
        ax, ay, az, length = bx, by, bz, lb
    if lc > length:
        ax, ay, az, length = cx, cy, cz, lc
    out[0], out[1], out[2] = ax / length, ay / length, az / length
    return length


@njit(cache=True, nogil=True, error_model="numpy")
def _find_perpendicular(a: Floats, out: Floats) -> None:
    """Writes a unit vector at a right angle to `a` (3,)."""
    if max(abs(a[0]), abs(a[1])) > _SMALL * abs(a[2]):
        inverse = _ONE / np.sqrt(a[0] * a[0] + a[1] * a[1])
        out[0], out[1], out[2] = -a[1] * inverse, a[0] * inverse, _ZERO
    else:
        inverse = _ONE / np.sqrt(a[1] * a[1] + a[2] * a[2])
        out[0], out[1], out[2] = _ZERO, -a[2] * inverse, a[1] * inverse
