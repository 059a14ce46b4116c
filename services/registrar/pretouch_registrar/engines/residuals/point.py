"""The residuals of a thin beam's return, carried back to where the camera would have put it.

The cheaper of two explanations counts:

- the surface that the camera sees there, by the distance along its normal. Off the silhouette it is the surface of the
  nearest object pixel, and the distance to that pixel within the surface is a second residual. Where one layer lies
  behind another, as at a cup's rim, the front layer beside the pixel is an alternative;
- the table, by the height above it. Within the object's hull, where the camera did not see the table, this has a cost.

If the beam entered the object through a seen surface, the distance inside the footprint at that place is a residual
too. A point behind a seen surface, but not below it, may lie on a hidden side, and its cost has a low cap; in front of
it the camera would have seen the surface, and the cap is high. A surface that the beam meets at grazing incidence
explains little, since the beam could have ended anywhere along it; that costs up to `MAX_GRAZING_COST`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import NOWHERE, OBJECT, OTHER, TABLE, UNSEEN, Footprint, Surface
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.projection import compute_height, find_cell, find_pixel, project
from pretouch_registrar.engines.registration_problem import Noise, Table, Target
from pretouch_registrar.engines.residuals.inside import depth_inside, find_pierced_cell
from pretouch_registrar.engines.robust_kernel import CAP_BEHIND, CAP_FRONT, HIDDEN_TABLE

NORMAL, EDGE, INSIDE = 0, 1, 2
"""The three residuals of a point: along the normal of surface or table; within the surface, off the silhouette; inside
the footprint."""
MAX_GRAZING_COST = 1.7
"""Upper bound of the cost of grazing incidence: a beam along a wall may end anywhere on it."""
EDGE_SLACK_PX = 0.7
"""A silhouette is known to about this many pixels; smaller lateral distances cost nothing."""
ON_SURFACE = 0.5
"""Squared normalised residual up to which a point lies on a seen surface, and cannot be below it."""


class PointResiduals(NamedTuple):
    """Buffers for the residuals of one point.

    Attributes:
        values: (3,), normalised residuals NORMAL, EDGE and INSIDE; 0 where one does not apply.
        gradients: (3, 3), 1/m, the gradient of each by the point, base axes; undefined where the residual is 0.
    """

    values: Array
    gradients: Array


@njit(cache=True, nogil=True, inline="always")
def compute_half_square(residuals: PointResiduals) -> float:
    """Half the sum of the squared residuals: the robust kernel's argument."""
    values = residuals.values
    return 0.5 * (values[0] * values[0] + values[1] * values[1] + values[2] * values[2])


@njit(cache=True, nogil=True, inline="always")
def _compute_plane_distance(point: Vector, surface: Surface, i: int, j: int) -> float:
    """m: signed distance of a point from a pixel's plane."""
    n = surface.normals
    return n[i, j, 0] * point[0] + n[i, j, 1] * point[1] + n[i, j, 2] * point[2] - surface.offsets[i, j]


@njit(cache=True, nogil=True, inline="always")
def _compute_in_plane_offset(
    point: Vector, distance: float, surface: Surface, i: int, j: int
) -> tuple[float, float, float, float]:
    """Distance, m, and direction within a pixel's plane from its point; `distance` is that from the plane."""
    e0 = point[0] - surface.points[i, j, 0] - distance * surface.normals[i, j, 0]
    e1 = point[1] - surface.points[i, j, 1] - distance * surface.normals[i, j, 1]
    e2 = point[2] - surface.points[i, j, 2] - distance * surface.normals[i, j, 2]
    length = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2) + 1e-12
    return length, e0 / length, e1 / length, e2 / length


@njit(cache=True, nogil=True, inline="always")
def _explain_inside(footprint: Footprint, a: int, b: int, std: float, out: PointResiduals) -> float:
    """Fills the residual INSIDE of a beam that entered through a cell, and returns it."""
    below = depth_inside(footprint, a, b, std)
    out.values[INSIDE] = below
    for k in range(3):
        outward = footprint.outward_x[a, b] * footprint.x_axis[k] + footprint.outward_y[a, b] * footprint.y_axis[k]
        out.gradients[INSIDE, k] = -outward / std
    return below


@njit(cache=True, nogil=True, inline="always")
def _bound_inside(out: PointResiduals, limit: float) -> None:
    """Bounds the residual INSIDE: a point near a seen surface need not be below it."""
    if out.values[INSIDE] > limit:
        for k in range(3):
            out.gradients[INSIDE, k] *= limit / out.values[INSIDE]
        out.values[INSIDE] = limit


@njit(cache=True, nogil=True, inline="always")
def _explain_by_table(height: float, table: Table, std: float, out: PointResiduals) -> None:
    """Fills the residual NORMAL with the normalised height above the table."""
    out.values[NORMAL] = height
    for k in range(3):
        out.gradients[NORMAL, k] = table.normal[k] / std


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def point_residual(
    point: Vector, direction: Vector, target: Target, noise: Noise, out: PointResiduals
) -> tuple[float, float]:
    """Fills `out` with the residuals of the cheapest explanation of a return at `point`, as carried back.

    Returns the cap of the robust kernel and the explanation's additional cost.
    """
    out.values[EDGE] = 0.0
    out.values[INSIDE] = 0.0
    pixels, table, footprint = target.pixels, target.table, target.footprint
    above = compute_height(point, table)
    height = above / noise.table
    u, v, depth = project(point, target.optics)
    i, j = find_pixel(u, v)
    if depth <= 0 or i < 0 or j < 0 or i >= pixels.kinds.shape[0] or j >= pixels.kinds.shape[1]:
        _explain_by_table(height, table, noise.table, out)
        return CAP_BEHIND, 0.0
    slack = EDGE_SLACK_PX * depth / target.optics.fx
    seen = pixels.surface
    distance = _compute_plane_distance(point, seen, i, j)
    n0, n1, n2 = seen.normals[i, j, 0], seen.normals[i, j, 1], seen.normals[i, j, 2]
    rim = pixels.rims[i, j] * noise.rim
    std = np.sqrt(noise.surface * noise.surface + rim * rim)
    surface = distance / std
    edge = e0 = e1 = e2 = 0.0
    if pixels.distances[i, j] > 0:
        length, e0, e1, e2 = _compute_in_plane_offset(point, distance, seen, i, j)
        edge = max(length - slack, 0.0) / noise.edge
    cost = surface * surface + edge * edge
    if cost > 4.0 and pixels.front.offsets[i, j] < NOWHERE:
        layer = pixels.front
        before = _compute_plane_distance(point, layer, i, j)
        length, f0, f1, f2 = _compute_in_plane_offset(point, before, layer, i, j)
        front, front_edge = before / std, max(length - slack, 0.0) / noise.edge
        if front * front + front_edge * front_edge < cost:
            n0, n1, n2 = layer.normals[i, j, 0], layer.normals[i, j, 1], layer.normals[i, j, 2]
            surface, edge, e0, e1, e2 = front, front_edge, f0, f1, f2
            cost = surface * surface + edge * edge
    below = 0.0
    if min(cost, height * height) > ON_SURFACE:
        a, b = find_pierced_cell(point, direction, above, table, footprint)
        if a >= 0:
            below = _explain_inside(footprint, a, b, noise.edge, out)
    kind = pixels.kinds[i, j]
    cap = CAP_FRONT
    if kind == OTHER or (below == 0 and (kind == UNSEEN or (kind == OBJECT and distance < 0))):
        cap = CAP_BEHIND
    if height * height < cost:
        _explain_by_table(height, table, noise.table, out)
        _bound_inside(out, abs(height))
        a, b = find_cell(point, footprint)
        if kind == TABLE or a < 0 or footprint.hull[a, b] == 0:
            return cap, 0.0
        return cap - HIDDEN_TABLE, HIDDEN_TABLE
    _bound_inside(out, np.sqrt(cost))
    out.values[NORMAL] = surface
    normal = (n0, n1, n2)
    for k in range(3):
        out.gradients[NORMAL, k] = normal[k] / std
    facing = abs(n0 * direction[0] + n1 * direction[1] + n2 * direction[2])
    steep = min(-np.log(max(facing, 0.02)), MAX_GRAZING_COST) / (noise.widening * noise.widening)
    if edge > 0:
        out.values[EDGE] = edge
        out.gradients[EDGE, 0], out.gradients[EDGE, 1], out.gradients[EDGE, 2] = (
            e0 / noise.edge, e1 / noise.edge, e2 / noise.edge,
        )  # fmt: skip
    return cap - steep, steep + np.log(std / noise.surface)
