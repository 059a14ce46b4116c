"""A depth camera of the first Kinect's kind: structured light, so its noise is that of a disparity.

The projector sits `BASELINE` to the right of the camera; what it does not light casts a shadow without depth. The
disparity is disturbed, quantised to 1/8 pixel and turned into depth.

Sources: sigma_z and the lateral noise, Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D
Reconstruction and Tracking", 3DIMPVT 2012. Baseline, focal length and quantisation: published calibrations of the
Kinect v1. The window by which a surface reaches into its own shadow is an assumption: half of a 5-pixel correlation
window, whose other half sees nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Array, Pose
from pretouch_simulation.world import Hits, World

BASELINE = 0.075
"""m."""
FOCAL = 580.0
"""px, of the infrared camera in which disparity is measured."""
STEPS_PER_PIXEL = 8
RANGE = (0.4, 8.0)
"""m; there is no depth outside."""
SHAPE = (480, 640)

_WINDOW = 5
_EDGE_STEP = 0.02
"""m; a neighbouring pixel further off than this lies on another surface."""
_LATERAL_BLOCK = 2
_SHADOW_TOLERANCE = 1e-3


def sigma_z(depth: Array) -> Array:
    """m: standard deviation of the depth at `depth`, m (Nguyen et al., quantisation included)."""
    return np.asarray(0.0012 + 0.0019 * (depth - 0.4) ** 2, dtype=np.float64)


def sigma_lateral(incidence: Array) -> Array:
    """px: standard deviation of an edge's place; `incidence`, rad, is the angle of the surface to the view."""
    angle = np.minimum(incidence, np.radians(80.0))
    return np.asarray(0.8 + 0.035 * angle / (np.pi / 2 - angle), dtype=np.float64)


def render(
    world: World, camera: Camera, base_T_camera: Pose, rng: np.random.Generator, shape: tuple[int, int] = SHAPE
) -> tuple[DepthImage, NDArray[np.int64]]:
    """The depth image of `world` from a camera at `base_T_camera`, `shape` = (h, w).

    Returns:
        The image; and (h, w) the index of the body that each pixel's ray truly meets, `TABLE` or `NOTHING`.
    """
    v, u = np.indices(shape)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(shape)], axis=-1).reshape(-1, 3)
    hits = world.trace(np.broadcast_to(base_T_camera.translation, rays.shape), base_T_camera.rotate(rays))
    true = hits.distances.reshape(shape)
    seen = np.isfinite(true) & (true > 0)
    lit = seen.copy()
    lit[seen] = _lit(world, base_T_camera, rays[seen.ravel()] * true[seen][:, None])
    disparity = np.where(lit, BASELINE * FOCAL / np.where(seen, true, 1.0), 0.0)
    disparity = _reaching_into_shadow(disparity)
    disparity = _ragged_edges(disparity, _incidence(hits, base_T_camera.rotate(rays)).reshape(shape), rng)
    return DepthImage(_measured(disparity, rng).astype(np.float32)), hits.bodies.reshape(shape)


def _lit(world: World, base_T_camera: Pose, points: Array) -> NDArray[np.bool_]:
    """(n,) whether the projector reaches `points` (n, 3), given in the camera frame."""
    projector = np.array([BASELINE, 0.0, 0.0])
    origins = np.broadcast_to(base_T_camera.apply(projector), points.shape)
    reached = world.cast(origins, base_T_camera.rotate(points - projector))
    return np.asarray(reached > 1.0 - _SHADOW_TOLERANCE, dtype=np.bool_)


def _incidence(hits: Hits, rays: Array) -> Array:
    cosine = np.abs(np.einsum("ij,ij->i", hits.normals, rays)) / np.linalg.norm(rays, axis=1)
    return np.asarray(np.arccos(np.clip(cosine, 0.0, 1.0)), dtype=np.float64)


def _reaching_into_shadow(disparity: Array) -> Array:
    """An unlit pixel takes the nearest surface that its correlation window sees."""
    grown = ndimage.maximum_filter(disparity, size=_WINDOW)
    return np.where(disparity > 0, disparity, grown)


def _ragged_edges(disparity: Array, incidence: Array, rng: np.random.Generator) -> Array:
    """Moves the edges of surfaces by the lateral noise, the same for blocks of 2 x 2 pixels."""
    h, w = disparity.shape
    blocks = -(-h // _LATERAL_BLOCK), -(-w // _LATERAL_BLOCK)
    normal = rng.standard_normal((2, *blocks)).repeat(_LATERAL_BLOCK, axis=1).repeat(_LATERAL_BLOCK, axis=2)[:, :h, :w]
    shift = np.rint(normal * sigma_lateral(incidence)).astype(np.int64)
    v, u = np.indices((h, w))
    moved = disparity[np.clip(v + shift[0], 0, h - 1), np.clip(u + shift[1], 0, w - 1)]
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.abs(BASELINE * FOCAL / moved - BASELINE * FOCAL / disparity)
    return np.where(gap > _EDGE_STEP, moved, disparity)


def _measured(disparity: Array, rng: np.random.Generator) -> Array:
    """Depth, m, 0 = none, from true disparities, px, 0 = none."""
    noise = rng.standard_normal(disparity.shape)
    there = disparity > 0
    depth = BASELINE * FOCAL / np.where(there, disparity, 1.0)
    spread = sigma_z(depth) * BASELINE * FOCAL / depth**2
    spread = np.sqrt(np.maximum(spread**2 - 1.0 / (12.0 * STEPS_PER_PIXEL**2), 0.0))
    steps = np.rint((disparity + noise * spread) * STEPS_PER_PIXEL)
    measured = BASELINE * FOCAL * STEPS_PER_PIXEL / np.maximum(steps, 1.0)
    good = there & (steps > 0) & (measured >= RANGE[0]) & (measured <= RANGE[1])
    return np.where(good, measured, 0.0)
