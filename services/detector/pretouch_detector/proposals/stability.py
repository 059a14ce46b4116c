"""Proposer `stability`: random candidates ranked by what their perimeters would tell about the pose.

Each surface point on the perimeter fixes the pose along its normal, and each edge of the object that the perimeter
crosses fixes it across that edge; their 6x6 information (after Gelfand et al., "Geometrically Stable Sampling for the
ICP Algorithm", 2003, with edges added) on top of the calibration prior gives the error that the scan would leave.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.estimate import Prior
from pretouch.geometry import Array
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.random import candidates
from pretouch_detector.proposals.region import ProposedRegion
from pretouch_detector.proposals.spread import spread

_CANDIDATES = 200
_SURFACE_STD = 0.002
_EDGE_STD = 0.0025
_EFFECTIVE_POINTS = 30.0
"""Independent points that one perimeter is worth: neighbours share the camera's error."""
_SMOOTHING_PX = 2.0


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """Up to `count` regions that differ; confidence = share of the prior's error that the scan would remove."""
    drawn = candidates(scene, max(_CANDIDATES, count), rng)
    normals, outward, usable = _surface(scene)
    arms = scene.organised - scene.centroid
    surface_std = float(np.hypot(_SURFACE_STD, sensor.range_std))
    spot = 0.5 * (sensor.range_min + sensor.range_max) * np.tan(sensor.beam_half_angle) / 2
    edge_std = float(np.hypot(_EDGE_STD, spot))
    prior_information = np.asarray(np.linalg.inv(Prior().covariance()), dtype=np.float64)
    remaining = np.array(
        [
            _error(
                prior_information + _information(r, scene, normals, outward, usable, arms, surface_std, edge_std),
                scene.radius,
            )
            for r in drawn
        ]
    )
    confidence = 1.0 - remaining / _error(prior_information, scene.radius)
    order = np.argsort(-confidence, kind="stable")
    kept = order[spread(np.array([r.as_list() for r in drawn])[order], count)]
    return [ProposedRegion(drawn[k], float(np.clip(confidence[k], 0, 1))) for k in kept]


def _surface(scene: Scene) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Normals and directions across the nearest edge (h, w, 3 each) in base, and where an edge is the object's own.

    An edge is the object's own where the camera does not see something nearer beside it.
    """
    mask = scene.mask
    weight = ndimage.gaussian_filter(mask.astype(np.float64), _SMOOTHING_PX)
    inverse = np.divide(1.0, scene.depth.metres, out=np.zeros(mask.shape), where=mask)
    smooth = np.divide(
        ndimage.gaussian_filter(inverse, _SMOOTHING_PX), weight, out=np.zeros(mask.shape), where=weight > 1e-3
    )
    dv, du = np.gradient(smooth)
    v, u = np.indices(mask.shape)
    camera = scene.camera
    normals = -np.stack([du * camera.fx, dv * camera.fy, smooth + du * (camera.cx - u) + dv * (camera.cy - v)], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    ev, eu = np.gradient(weight)
    across = np.stack([eu, ev, np.zeros_like(eu)], axis=-1)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    near = np.where(scene.depth.metres > 0, scene.depth.metres, np.inf)
    nearest_around = ndimage.minimum_filter(np.where(mask, np.inf, near), size=5)
    own = ~(nearest_around < np.where(mask, near, np.inf) - 0.01)
    return scene.base_T_camera.rotate(normals), scene.base_T_camera.rotate(across), own


def _information(
    rectangle: RotatedRectangle, scene: Scene, normals: Array, across: Array, own: NDArray[np.bool_], arms: Array,
    surface_std: float, edge_std: float,
) -> Array:  # fmt: skip
    """Information (6, 6), order (rotation vector, translation), of a scan along the rectangle's perimeter."""
    h, w = scene.mask.shape
    pixels = np.round(rectangle.perimeter(1.0)).astype(np.int64)
    inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < w) & (pixels[:, 1] < h)
    u, v = pixels[inside].T
    on = scene.mask[v, u]
    if not on.any():
        return np.zeros((6, 6))
    crossing = on & ~(np.roll(on, 1) & np.roll(on, -1)) & own[v, u]
    directions = np.concatenate([normals[v, u][on] / surface_std, across[v, u][crossing] / edge_std])
    points = np.concatenate([arms[v, u][on], arms[v, u][crossing]])
    rows = np.concatenate([np.cross(points, directions), directions], axis=1)
    return np.asarray(rows.T @ rows * min(1.0, _EFFECTIVE_POINTS / len(rows)), dtype=np.float64)


def _error(information: Array, radius: float) -> float:
    """m: root mean square displacement of points at `radius` around the centroid under the inverse of `information`."""
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return float(np.sqrt(np.trace(covariance[3:, 3:]) + 2 / 3 * radius**2 * np.trace(covariance[:3, :3])))
