"""How badly a set of beams disagrees with what the camera saw, for one pose correction: the cost of one sample.

A correction is x = (w, d): p -> exp(w) (p - c) + c + d, c the object's centroid, base axes. A returned beam's point is
carried back to where the camera would have put it and looked up in the depth image:

- on an object pixel: distance along the surface's normal; behind the surface may be a hidden side, so that disagreement
  is capped low; in front of it the camera would have seen it, capped high;
- off the object's silhouette: the nearest object pixel's surface plus the lateral distance to it, or the table;
- on the object but in truth on the table: the table plus the lateral distance to the nearest table pixel;
- a miss that would have pierced the seen surface pays for how far inside the silhouette it did so.

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
    KIND,
    OBJECT,
    OBJECT_WAY,
    PLANE,
    TABLE,
    TABLE_WAY,
    TO_OBJECT,
    TO_TABLE,
    UNSEEN,
    CameraModel,
)  # fmt: skip

CAP_FRONT = 4.5
CAP_BEHIND = 1.4
SURFACE_STD = 0.0020
"""m: how well a smoothed surface point of the camera is known, as one local patch."""
EDGE_STD = 0.0025
"""m: how well the silhouette is known, laterally."""
NEAR_TABLE_PX = 40.0
"""Further inside a silhouette a point is not taken to be the table's."""
REACH = 0.012
"""m: a beam that is seen this far behind a surface has not pierced it there; it has gone past its edge."""
EFFECTIVE_SAMPLES = 30.0
"""Independent samples that one scan is worth: neighbours share the model's error."""


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
        return self.beams, self.centroid, self.optics, self.table, self.noise, self.model.pixels


def beam_rows(scans: Sequence[Scan]) -> Array:
    """The scans as `Problem.beams`; each is worth EFFECTIVE_SAMPLES independent samples at most, however long."""
    rows = [np.zeros((0, 8))]
    for scan in scans:
        hit = scan.returned
        ends = scan.origins + np.where(hit, scan.ranges, 0.0)[:, None] * scan.directions
        weight = min(1.0, EFFECTIVE_SAMPLES / max(len(scan), 1))
        rows.append(np.column_stack([ends, scan.directions, hit, np.full(len(scan), weight)]))
    return np.ascontiguousarray(np.concatenate(rows))


def pose_problem(model: CameraModel, scans: Sequence[Scan], prior: Prior, sensor: Sensor) -> Problem:
    """Packs a scene's model and its scans for the kernels."""
    scene = model.scene
    pose, camera = scene.base_T_camera, scene.camera
    optics = np.concatenate(
        [pose.rotation.ravel(), pose.translation, [camera.fx, camera.fy, camera.cx, camera.cy, sensor.range_max]]
    )
    spot = 0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle) / 2
    noise = np.array(
        [
            np.hypot(sensor.range_std, SURFACE_STD),
            np.hypot(sensor.range_std, 0.001),
            np.hypot(EDGE_STD, spot),
        ]
    )
    table = np.array([*scene.table.normal, scene.table.offset])
    inverse = np.array([prior.rotation_std**-2.0] * 3 + [prior.translation_std**-2.0] * 3)
    return Problem(model, beam_rows(scans), optics, table, noise, inverse, np.array(scene.centroid))


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


@njit(cache=True, nogil=True, fastmath=True)
def point_residual(
    x: float, y: float, z: float, optics: Array, table: Array, noise: Array, pixels: NDArray[np.float32], out: Array
) -> float:
    """The cheapest explanation of a returned point (x, y, z), where the camera would have put it.

    Fills `out` (8,): normalised residual and its gradient by the point, twice (surface or table; lateral).
    Returns the cap.
    """
    out[4] = 0.0
    height = (table[0] * x + table[1] * y + table[2] * z - table[3]) / noise[1]
    u, v, depth = project(x, y, z, optics)
    i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
    if depth <= 0 or i < 0 or j < 0 or i >= pixels.shape[0] or j >= pixels.shape[1]:
        out[0] = height
        for k in range(3):
            out[1 + k] = table[k] / noise[1]
        return CAP_BEHIND
    pixel = pixels[i, j]
    surface = (pixel[PLANE] * x + pixel[PLANE + 1] * y + pixel[PLANE + 2] * z - pixel[PLANE + 3]) / noise[0]
    per_px = depth / optics[12] / noise[2]
    edge = pixel[TO_OBJECT] * per_px
    inside = pixel[TO_TABLE] * per_px
    kind = pixel[KIND]
    cap = CAP_FRONT
    if kind == UNSEEN or (kind == OBJECT and surface < 0):
        cap = CAP_BEHIND
    if pixel[TO_TABLE] < NEAR_TABLE_PX and height * height + inside * inside < surface * surface + edge * edge:
        if kind == TABLE:
            cap = CAP_FRONT
        out[0] = height
        for k in range(3):
            out[1 + k] = table[k] / noise[1]
        lateral, way = inside, TABLE_WAY
    else:
        out[0] = surface
        for k in range(3):
            out[1 + k] = pixel[PLANE + k] / noise[0]
        lateral, way = edge, OBJECT_WAY
    if lateral > 0:
        out[4] = lateral
        for k in range(3):  # the image's axes in base are columns 0 and 1 of the camera's rotation
            out[5 + k] = (pixel[way] * optics[3 * k] + pixel[way + 1] * optics[3 * k + 1]) / noise[2]
    return cap


@njit(cache=True, nogil=True, fastmath=True)
def _miss_cost(
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
    optics: Array, noise: Array, pixels: NDArray[np.float32],
) -> float:  # fmt: skip
    """What a beam without a return, given where the camera puts it, pays for piercing the seen surface."""
    pace = 0.004
    for _ in range(int(optics[16] / pace)):
        x, y, z = x + pace * dx, y + pace * dy, z + pace * dz
        u, v, depth = project(x, y, z, optics)
        i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
        if depth <= 0 or i < 0 or j < 0 or i >= pixels.shape[0] or j >= pixels.shape[1]:
            continue
        pixel = pixels[i, j]
        if pixel[KIND] != OBJECT:
            continue
        surface = pixel[PLANE] * x + pixel[PLANE + 1] * y + pixel[PLANE + 2] * z - pixel[PLANE + 3]
        if -REACH < surface < -0.001:
            inside = pixel[TO_TABLE] * depth / optics[12] / noise[2]
            s = 0.5 * inside * inside
            return CAP_FRONT * s / (CAP_FRONT + s)
    return 0.0


@njit(cache=True, nogil=True, fastmath=True)
def total_cost(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32],
) -> float:  # fmt: skip
    """Cost of the correction x (6,): weighted samples plus the prior; `factor` widens all noise (annealing)."""
    r = rotation_of(x[:3])
    wide = noise * factor
    out = np.zeros(8)
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
            cap = point_residual(q0, q1, q2, optics, table, wide, pixels, out)
            s = 0.5 * (out[0] * out[0] + out[4] * out[4])
            cost += b[7] * cap * s / (cap + s)
        else:
            d0 = r[0, 0] * b[3] + r[1, 0] * b[4] + r[2, 0] * b[5]
            d1 = r[0, 1] * b[3] + r[1, 1] * b[4] + r[2, 1] * b[5]
            d2 = r[0, 2] * b[3] + r[1, 2] * b[4] + r[2, 2] * b[5]
            cost += b[7] * _miss_cost(q0, q1, q2, d0, d1, d2, optics, wide, pixels)
    return cost


@njit(cache=True, nogil=True, fastmath=True)
def costs(
    xs: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32],
) -> Array:  # fmt: skip
    """`total_cost` of each row of xs (m, 6)."""
    result = np.empty(xs.shape[0])
    for m in range(xs.shape[0]):
        result[m] = total_cost(xs[m], factor, prior, beams, centroid, optics, table, noise, pixels)
    return result


@njit(cache=True, nogil=True, fastmath=True)
def normal_equations(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32],
) -> tuple[Array, Array, float]:  # fmt: skip
    """Information (6, 6), gradient (6,) and cost at x for a Gauss-Newton step, robust weights frozen (IRLS)."""
    r = rotation_of(x[:3])
    wide = noise * factor
    out, row = np.zeros(8), np.empty(6)
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
            cost += b[7] * _miss_cost(q0, q1, q2, d0, d1, d2, optics, wide, pixels)
            continue
        cap = point_residual(q0, q1, q2, optics, table, wide, pixels, out)
        s = 0.5 * (out[0] * out[0] + out[4] * out[4])
        cost += b[7] * cap * s / (cap + s)
        weight = b[7] * (cap / (cap + s)) ** 2
        for part in range(0, 8, 4):
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
    x: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array, pixels: NDArray[np.float32]
) -> tuple[Array, NDArray[np.bool_]]:
    """For each beam (n,): its residual along the surface's normal, m, and whether it agrees within 3 sigma.

    Misses do not agree with anything.
    """
    r = rotation_of(x[:3])
    out = np.zeros(8)
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
        point_residual(q0, q1, q2, optics, table, noise, pixels, out)
        residual[n] = out[0] / np.sqrt(out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
        agrees[n] = out[0] * out[0] + out[4] * out[4] < 9.0
    return residual, agrees
