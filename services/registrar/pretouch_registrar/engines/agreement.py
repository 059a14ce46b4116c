"""How badly a set of beams disagrees with what the camera saw, for one pose correction: the cost of one sample.

A correction is x = (w, d): p -> exp(w) (p - c) + c + d, c the object's centroid, base axes. A returned beam's point is
carried back to where the camera would have put it and explained in the cheaper of two ways:

- by what the camera sees there: distance along that surface's normal; off the silhouette, of the nearest object
  pixel's surface, plus the distance to that pixel within the surface; where layers lie behind each other, as at a cup's
  rim, the front one beside it will do as well;
- by the table: its height above it.

A point below a seen part of the object has no business there, since its beam came from above: it also pays for how far
inside the object's footprint it lies. Behind a seen surface, but not below it, may be a hidden side: that disagreement
is capped low. In front of it the camera would have seen it: capped high. A miss pays like a point below a seen part.

Costs saturate smoothly, cost = cap s / (cap + s) with s = half the squared normalised residual (Geman-McClure).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.estimate import Prior
from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch_registrar.engines.camera_model import (
    CELL,
    FRONT_PLANE,
    FRONT_POINT,
    INSIDE,
    KIND,
    NOWHERE,
    OBJECT,
    OTHER,
    OUTWARD,
    PLANE,
    POINT,
    TO_SURFACE,
    TOP,
    UNSEEN,
    CameraModel,
)  # fmt: skip

CAP_FRONT = 4.5
CAP_BEHIND = 1.4
SURFACE_STD = 0.0020
"""m: how well a smoothed surface point of the camera is known, as one local patch."""
EDGE_STD = 0.0025
"""m: how well the silhouette is known, laterally."""
EDGE_SLACK_PX = 0.7
"""A silhouette is known to about this many pixels: lateral distances below it cost nothing."""
FOOTPRINT_SLACK = 0.0015
"""m: likewise for the footprint's outline, half a cell."""
BELOW = 0.006
"""m: a point this far below a seen part of the object is below it, whatever the noise."""
EFFECTIVE_SAMPLES = 30.0
"""Independent samples that one scan is worth: neighbours share the model's error."""
_PATCH = 0.009
"""m along a scan over which the camera's error stays the same."""


@dataclass(frozen=True, eq=False)
class Problem:
    """One scene's model and the scans, packed for the compiled kernels.

    Attributes:
        beams: (n, 8): point of the return or start of the beam (3), direction (3), 1 for a return else 0, weight.
        optics: (17,): camera rotation (9), position (3), fx, fy, cx, cy, range_max.
        table: (4,): normal (3), offset.
        noise: (3,): standard deviations of surface, table and edge residuals, m.
        prior: (6,) inverse variances, order (w, d).
    """

    model: CameraModel
    beams: Array
    optics: Array
    table: Array
    noise: Array
    prior: Array
    centroid: Array

    def arguments(self) -> tuple[Any, ...]:
        """What every kernel takes after the pose."""
        m = self.model
        return self.beams, self.centroid, self.optics, self.table, self.noise, m.pixels, m.footprint, m.frame


def beam_rows(scans: Sequence[Scan], sensor: Sensor) -> Array:
    """The scans as `Problem.beams`; each is worth EFFECTIVE_SAMPLES independent samples at most, however long.

    A wide beam's spots overlap, so that its samples are worth less still.
    """
    worth = EFFECTIVE_SAMPLES * _PATCH / (_PATCH + 2 * _spot_radius(sensor))
    rows = [np.zeros((0, 8))]
    for scan in scans:
        hit = scan.returned
        ends = scan.origins + np.where(hit, scan.ranges, 0.0)[:, None] * scan.directions
        weight = min(1.0, worth / max(len(scan), 1))
        rows.append(np.column_stack([ends, scan.directions, hit, np.full(len(scan), weight)]))
    return np.ascontiguousarray(np.concatenate(rows))


def _spot_radius(sensor: Sensor) -> float:
    """m: radius of the beam's spot in the middle of the sensor's range."""
    return float(0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle))


def pose_problem(model: CameraModel, scans: Sequence[Scan], prior: Prior, sensor: Sensor) -> Problem:
    """Packs a scene's model and its scans for the kernels."""
    scene = model.scene
    pose, camera = scene.base_T_camera, scene.camera
    optics = np.concatenate(
        [pose.rotation.ravel(), pose.translation, [camera.fx, camera.fy, camera.cx, camera.cy, sensor.range_max]]
    )
    spot = _spot_radius(sensor)
    noise = np.array(
        [
            np.hypot(np.hypot(sensor.range_std, SURFACE_STD), spot / 5),
            np.hypot(np.hypot(sensor.range_std, 0.001), spot / 5),
            np.hypot(EDGE_STD, spot / 2),
        ]
    )
    table = np.array([*scene.table.normal, scene.table.offset])
    inverse = np.array([prior.rotation_std**-2.0] * 3 + [prior.translation_std**-2.0] * 3)
    return Problem(model, beam_rows(scans, sensor), optics, table, noise, inverse, np.array(scene.centroid))


@njit(cache=True, nogil=True, fastmath=True)
def rotation_of(w: Array) -> Array:
    """exp of a rotation vector (3,), by Rodrigues' formula."""
    angle = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a, b = 1.0, 0.5
    if angle > 1e-8:
        a = np.sin(angle) / angle
        b = (1.0 - np.cos(angle)) / (angle * angle)
    x, y, z = w[0], w[1], w[2]
    r = np.empty((3, 3))
    r[0, 0] = 1 - b * (y * y + z * z)
    r[1, 1] = 1 - b * (x * x + z * z)
    r[2, 2] = 1 - b * (x * x + y * y)
    r[0, 1] = b * x * y - a * z
    r[1, 0] = b * x * y + a * z
    r[0, 2] = b * x * z + a * y
    r[2, 0] = b * x * z - a * y
    r[1, 2] = b * y * z - a * x
    r[2, 1] = b * y * z + a * x
    return r


@njit(cache=True, nogil=True)
def vector_of(r: Array) -> Array:
    """log of a rotation matrix (3, 3) by less than half a turn: its rotation vector (3,)."""
    v = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if sine < 1e-9:
        return v
    return v * (np.arctan2(sine, 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)) / sine)


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def project(x: float, y: float, z: float, o: Array) -> tuple[float, float, float]:
    """(u, v, depth) of a point in base; depth at most 1 mm where it is not in front of the camera."""
    x, y, z = x - o[9], y - o[10], z - o[11]
    depth = o[2] * x + o[5] * y + o[8] * z
    if depth < 1e-3:
        return 0.0, 0.0, 0.0
    u = o[12] * (o[0] * x + o[3] * y + o[6] * z) / depth + o[14]
    v = o[13] * (o[1] * x + o[4] * y + o[7] * z) / depth + o[15]
    return u, v, depth


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def cell_of(x: float, y: float, z: float, footprint: NDArray[np.float32], frame: Array) -> tuple[int, int]:
    """The footprint's cell that a point in base stands over; -1, -1 outside."""
    a = int(np.floor((frame[0] * x + frame[1] * y + frame[2] * z - frame[6]) / CELL))
    b = int(np.floor((frame[3] * x + frame[4] * y + frame[5] * z - frame[7]) / CELL))
    if a < 0 or b < 0 or a >= footprint.shape[0] or b >= footprint.shape[1]:
        return -1, -1
    return a, b


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _off_surface(
    x: float, y: float, z: float, pixel: NDArray[np.float32], plane: int, point: int
) -> tuple[float, float, float, float, float]:
    """Signed distance of a point from a pixel's plane; distance within the plane from its point, and its direction."""
    surface = pixel[plane] * x + pixel[plane + 1] * y + pixel[plane + 2] * z - pixel[plane + 3]
    e0 = x - pixel[point] - surface * pixel[plane]
    e1 = y - pixel[point + 1] - surface * pixel[plane + 1]
    e2 = z - pixel[point + 2] - surface * pixel[plane + 2]
    length = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2) + 1e-12
    return surface, length, e0 / length, e1 / length, e2 / length


@njit(cache=True, nogil=True, fastmath=True)
def point_residual(
    x: float, y: float, z: float, optics: Array, table: Array, noise: Array, pixels: NDArray[np.float32],
    footprint: NDArray[np.float32], frame: Array, out: Array,
) -> float:  # fmt: skip
    """The cheapest explanation of a returned point (x, y, z), where the camera would have put it.

    Fills `out` (12,): normalised residual and its gradient by the point, three times (surface or table; within the
    surface; inside the footprint). Returns the cap.
    """
    out[4] = 0.0
    out[8] = 0.0
    above = table[0] * x + table[1] * y + table[2] * z - table[3]
    height = above / noise[1]
    below = 0.0
    a, b = cell_of(x, y, z, footprint, frame)
    if a >= 0 and footprint[a, b, TOP] > above + BELOW:
        cell = footprint[a, b]
        below = max(cell[INSIDE] - FOOTPRINT_SLACK, 0.0) / noise[2]
        if below > 0:
            out[8] = below
            for k in range(3):
                out[9 + k] = -(cell[OUTWARD] * frame[k] + cell[OUTWARD + 1] * frame[3 + k]) / noise[2]
    u, v, depth = project(x, y, z, optics)
    i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
    if depth <= 0 or i < 0 or j < 0 or i >= pixels.shape[0] or j >= pixels.shape[1]:
        out[0] = height
        for k in range(3):
            out[1 + k] = table[k] / noise[1]
        return CAP_BEHIND
    pixel = pixels[i, j]
    slack = EDGE_SLACK_PX * depth / optics[12]
    plane = PLANE
    distance, length, e0, e1, e2 = _off_surface(x, y, z, pixel, PLANE, POINT)
    surface = distance / noise[0]
    edge = 0.0
    if pixel[TO_SURFACE] > 0:
        edge = max(length - slack, 0.0) / noise[2]
    kind = pixel[KIND]
    cap = CAP_FRONT
    if kind == OTHER or (below == 0 and (kind == UNSEEN or (kind == OBJECT and distance < 0))):
        cap = CAP_BEHIND
    cost = surface * surface + edge * edge
    if cost > 4.0 and pixel[FRONT_PLANE + 3] < NOWHERE:
        front, front_length, f0, f1, f2 = _off_surface(x, y, z, pixel, FRONT_PLANE, FRONT_POINT)
        front /= noise[0]
        front_edge = max(front_length - slack, 0.0) / noise[2]
        if front * front + front_edge * front_edge < cost:
            plane, surface, edge, e0, e1, e2 = FRONT_PLANE, front, front_edge, f0, f1, f2
            cost = surface * surface + edge * edge
    if height * height < cost:
        out[0] = height
        for k in range(3):
            out[1 + k] = table[k] / noise[1]
        return cap
    out[0] = surface
    for k in range(3):
        out[1 + k] = pixel[plane + k] / noise[0]
    if edge > 0:
        out[4] = edge
        out[5], out[6], out[7] = e0 / noise[2], e1 / noise[2], e2 / noise[2]
    return cap


@njit(cache=True, nogil=True, fastmath=True)
def _miss_cost(
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
    optics: Array, table: Array, noise: Array, footprint: NDArray[np.float32], frame: Array,
) -> float:  # fmt: skip
    """What a beam without a return, given where the camera puts it, pays for piercing the seen object from above."""
    pace = 0.01
    for _ in range(int(optics[16] / pace + 0.5)):
        x, y, z = x + pace * dx, y + pace * dy, z + pace * dz
        a, b = cell_of(x, y, z, footprint, frame)
        if a >= 0 and footprint[a, b, TOP] > table[0] * x + table[1] * y + table[2] * z - table[3] + BELOW:
            below = max(footprint[a, b, INSIDE] - FOOTPRINT_SLACK, 0.0) / noise[2]
            s = 0.5 * below * below
            return CAP_FRONT * s / (CAP_FRONT + s)
    return 0.0


@njit(cache=True, nogil=True, fastmath=True)
def total_cost(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> float:  # fmt: skip
    """Cost of the correction x (6,): weighted samples plus the prior; `factor` widens all noise (annealing)."""
    r = rotation_of(x[:3])
    wide = noise * factor
    out = np.zeros(12)
    cost = 0.0
    for k in range(6):
        cost += 0.5 * x[k] * x[k] * prior[k]
    for n in range(beams.shape[0]):
        b = beams[n]
        y0, y1, y2 = b[0] - centroid[0] - x[3], b[1] - centroid[1] - x[4], b[2] - centroid[2] - x[5]
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        if b[6] > 0:
            cap = point_residual(q0, q1, q2, optics, table, wide, pixels, footprint, frame, out)
            s = 0.5 * (out[0] * out[0] + out[4] * out[4] + out[8] * out[8])
            cost += b[7] * cap * s / (cap + s)
        else:
            d0 = r[0, 0] * b[3] + r[1, 0] * b[4] + r[2, 0] * b[5]
            d1 = r[0, 1] * b[3] + r[1, 1] * b[4] + r[2, 1] * b[5]
            d2 = r[0, 2] * b[3] + r[1, 2] * b[4] + r[2, 2] * b[5]
            cost += b[7] * _miss_cost(q0, q1, q2, d0, d1, d2, optics, table, wide, footprint, frame)
    return cost


@njit(cache=True, nogil=True, fastmath=True)
def costs(
    xs: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> Array:  # fmt: skip
    """`total_cost` of each row of xs (m, 6)."""
    result = np.empty(xs.shape[0])
    for m in range(xs.shape[0]):
        result[m] = total_cost(xs[m], factor, prior, beams, centroid, optics, table, noise, pixels, footprint, frame)
    return result


@njit(cache=True, nogil=True, fastmath=True)
def normal_equations(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Information (6, 6), gradient (6,) and cost at x for a Gauss-Newton step, robust weights frozen (IRLS)."""
    r = rotation_of(x[:3])
    wide = noise * factor
    out, row = np.zeros(12), np.empty(6)
    information = np.zeros((6, 6))
    gradient = np.zeros(6)
    cost = 0.0
    for k in range(6):
        information[k, k] = prior[k]
        gradient[k] = prior[k] * x[k]
        cost += 0.5 * x[k] * x[k] * prior[k]
    for n in range(beams.shape[0]):
        b = beams[n]
        y0, y1, y2 = b[0] - centroid[0] - x[3], b[1] - centroid[1] - x[4], b[2] - centroid[2] - x[5]
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        if b[6] == 0:
            d0 = r[0, 0] * b[3] + r[1, 0] * b[4] + r[2, 0] * b[5]
            d1 = r[0, 1] * b[3] + r[1, 1] * b[4] + r[2, 1] * b[5]
            d2 = r[0, 2] * b[3] + r[1, 2] * b[4] + r[2, 2] * b[5]
            cost += b[7] * _miss_cost(q0, q1, q2, d0, d1, d2, optics, table, wide, footprint, frame)
            continue
        cap = point_residual(q0, q1, q2, optics, table, wide, pixels, footprint, frame, out)
        s = 0.5 * (out[0] * out[0] + out[4] * out[4] + out[8] * out[8])
        cost += b[7] * cap * s / (cap + s)
        weight = b[7] * (cap / (cap + s)) ** 2
        for part in range(0, 12, 4):
            if out[part] == 0.0:
                continue
            g0 = r[0, 0] * out[part + 1] + r[0, 1] * out[part + 2] + r[0, 2] * out[part + 3]
            g1 = r[1, 0] * out[part + 1] + r[1, 1] * out[part + 2] + r[1, 2] * out[part + 3]
            g2 = r[2, 0] * out[part + 1] + r[2, 1] * out[part + 2] + r[2, 2] * out[part + 3]
            row[0], row[1], row[2] = g1 * y2 - g2 * y1, g2 * y0 - g0 * y2, g0 * y1 - g1 * y0
            row[3], row[4], row[5] = -g0, -g1, -g2
            for k in range(6):
                gradient[k] += weight * row[k] * out[part]
                for m in range(6):
                    information[k, m] += weight * row[k] * row[m]
    return information, gradient, cost


@njit(cache=True, nogil=True, fastmath=True)
def sample_residuals(
    x: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """For each beam (n,): its residual along the surface's normal, m, and whether it agrees within 3 sigma.

    Misses do not agree with anything.
    """
    r = rotation_of(x[:3])
    out = np.zeros(12)
    residual = np.zeros(beams.shape[0])
    agrees = np.zeros(beams.shape[0], dtype=np.bool_)
    for n in range(beams.shape[0]):
        b = beams[n]
        if b[6] == 0:
            continue
        y0, y1, y2 = b[0] - centroid[0] - x[3], b[1] - centroid[1] - x[4], b[2] - centroid[2] - x[5]
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        point_residual(q0, q1, q2, optics, table, noise, pixels, footprint, frame, out)
        residual[n] = out[0] / np.sqrt(out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
        agrees[n] = out[0] * out[0] + out[4] * out[4] + out[8] * out[8] < 9.0
    return residual, agrees
