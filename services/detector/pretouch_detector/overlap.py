"""The exact common area of rotated rectangles [x, y, w, h, theta], compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from pretouch.geometry import Array

_RIGHT, _DOWN = (-0.5, 0.5, 0.5, -0.5), (-0.5, -0.5, 0.5, 0.5)
"""The corners, in order along the outline, in units of the sides."""
_FLAT = 1e-12
"""An edge's extent is taken to be at least this, which avoids a division by zero and bounds the error that it makes."""


def compute_common_areas(rectangle: ArrayLike, others: ArrayLike) -> Array:
    """(n,): area that the rectangle (5,) and each of the others (n, 5) have in common."""
    one, many = (np.ascontiguousarray(each, dtype=np.float64).reshape(-1, 5) for each in (rectangle, others))
    areas: Array = _fill_common_areas(one[0], many)
    return areas


@njit(cache=True, nogil=True)
def _fill_common_areas(rectangle: Array, others: Array) -> Array:
    areas = np.empty(len(others))
    for i in range(len(others)):
        areas[i] = compute_common_area(others[i], rectangle)
    return areas


@njit(cache=True, nogil=True)
def compute_intersection_over_union(first: Array, second: Array) -> float:
    """Intersection over union of two rectangles (5,), in [0, 1]."""
    reach = 0.5 * (np.hypot(first[2], first[3]) + np.hypot(second[2], second[3]))
    if (first[0] - second[0]) ** 2 + (first[1] - second[1]) ** 2 >= reach * reach:
        return 0.0
    common = compute_common_area(first, second)
    return common / (first[2] * first[3] + second[2] * second[3] - common)


@njit(cache=True, nogil=True)
def compute_common_area(first: Array, second: Array) -> float:
    """Area that two rectangles (5,) have in common, at least 0 and at most the smaller one's.

    The common area is the integral of an indicator, 1 in the second rectangle, over the first. By Green's theorem that
    is the integral of clamp(x, -W/2, W/2) + W/2 over dy along those parts of the first one's edges with |y| <= H/2, in
    the axes of the second, which is W wide and H high. Along an edge the integrand is piecewise linear, so the
    trapezoids between its bends are exact. Coinciding edges are no special case, since nothing depends on which corner
    is inside the other rectangle.
    """
    x, y, w, h, theta = first
    middle_x, middle_y, width, height, axis = second
    c, s = np.cos(axis), np.sin(axis)
    u, v = c * (x - middle_x) + s * (y - middle_y), c * (y - middle_y) - s * (x - middle_x)
    c, s = np.cos(theta - axis), np.sin(theta - axis)
    area = 0.0
    for k in range(4):
        n = (k + 1) % 4
        x0, y0 = u + c * w * _RIGHT[k] - s * h * _DOWN[k], v + s * w * _RIGHT[k] + c * h * _DOWN[k]
        dx = c * w * (_RIGHT[n] - _RIGHT[k]) - s * h * (_DOWN[n] - _DOWN[k])
        dy = s * w * (_RIGHT[n] - _RIGHT[k]) + c * h * (_DOWN[n] - _DOWN[k])
        safe_dx = _FLAT if abs(dx) < _FLAT else dx
        safe_dy = _FLAT if abs(dy) < _FLAT else dy
        low, high = (-0.5 * height - y0) / safe_dy, (0.5 * height - y0) / safe_dy
        enter, leave = min(max(min(low, high), 0.0), 1.0), min(max(max(low, high), 0.0), 1.0)
        left, right = (-0.5 * width - x0) / safe_dx, (0.5 * width - x0) / safe_dx
        near, far = min(max(min(left, right), enter), leave), min(max(max(left, right), enter), leave)
        before = _clamp_to_width(x0 + enter * dx, width)
        at_near, at_far = _clamp_to_width(x0 + near * dx, width), _clamp_to_width(x0 + far * dx, width)
        after = _clamp_to_width(x0 + leave * dx, width)
        trapezoids = (near - enter) * (before + at_near) + (far - near) * (at_near + at_far)
        area += 0.5 * dy * (trapezoids + (leave - far) * (at_far + after))
    return min(max(area, 0.0), min(w * h, width * height))


@njit(cache=True, nogil=True)
def _clamp_to_width(x: float, width: float) -> float:
    """How far x lies beyond a rectangle's left side, at most its width."""
    return min(max(x + 0.5 * width, 0.0), width)
