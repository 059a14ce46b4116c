"""`kinect`: a depth camera like the first Kinect: structured light, so that noise acts on the disparity.

The projector sits `BASELINE` to the right of the camera; what it does not light has no depth. The
disparity is disturbed, quantised to 1/8 pixel and turned into depth.

Sources: the noise of the depth and of edges, Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D
Reconstruction and Tracking", 3DIMPVT 2012. Baseline, focal length and quantisation: published calibrations of the
Kinect v1. The window by which a surface reaches into its own shadow is an assumption: half of a 5-pixel correlation
window, whose other half sees nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pretouch.camera import Camera, DepthImage, kinect_depth_std
from pretouch.geometry import Array, Pose
from pretouch_simulation.depth_cameras.rendering import SHAPE, Rendering, look
from pretouch_simulation.world import World

BASELINE = 0.075
"""m."""
FOCAL = 580.0
"""px, of the infrared camera in which disparity is measured."""
STEPS_PER_PIXEL = 8
RANGE = (0.4, 8.0)
"""m; there is no depth outside."""

_EDGE_STEP = 0.02
"""m; a neighbouring pixel further off than this lies on another surface."""
_LATERAL_BLOCK = 2


def edge_std(incidence: Array) -> Array:
    """px: standard deviation of an edge's place; `incidence`, rad, is the angle of the surface to the view."""
    angle = np.minimum(incidence, np.radians(80.0))
    return np.asarray(0.8 + 0.035 * angle / (np.pi / 2 - angle), dtype=np.float64)


@dataclass(frozen=True)
class Kinect:
    """The camera.

    Attributes:
        noise: factor on the published noise, of the depth and of edges.
        window: px, of the correlation window that reaches into the shadow.
    """

    noise: float = 1.0
    window: int = 5

    def render(
        self,
        world: World,
        camera: Camera,
        base_T_camera: Pose,
        rng: np.random.Generator,
        shape: tuple[int, int] = SHAPE,
    ) -> Rendering:
        """The image of `world` from `base_T_camera`, `shape` = (h, w); its mask is the true one."""
        sight = look(world, camera, base_T_camera, shape, BASELINE)
        disparity = np.where(sight.lit, BASELINE * FOCAL / np.where(sight.depth > 0, sight.depth, 1.0), 0.0)
        disparity = _reach_into_shadow(disparity, self.window)
        disparity = _roughen_edges(disparity, sight.incidence, self.noise, rng)
        depth = DepthImage(_measure(disparity, self.noise, rng).astype(np.float32))
        return Rendering(depth, sight.bodies, (sight.bodies == 0) & (depth.metres > 0))


def _reach_into_shadow(disparity: Array, window: int) -> Array:
    """An unlit pixel takes the nearest surface that its correlation window sees."""
    grown = ndimage.maximum_filter(disparity, size=window)
    return np.where(disparity > 0, disparity, grown)


def _roughen_edges(disparity: Array, incidence: Array, scale: float, rng: np.random.Generator) -> Array:
    """Moves the edges of surfaces by the lateral noise, the same for blocks of 2 x 2 pixels."""
    h, w = disparity.shape
    blocks = -(-h // _LATERAL_BLOCK), -(-w // _LATERAL_BLOCK)
    normal = rng.standard_normal((2, *blocks)).repeat(_LATERAL_BLOCK, axis=1).repeat(_LATERAL_BLOCK, axis=2)[:, :h, :w]
    shift = np.rint(normal * (scale * edge_std(incidence))).astype(np.int64)
    v, u = np.indices((h, w))
    moved = disparity[np.clip(v + shift[0], 0, h - 1), np.clip(u + shift[1], 0, w - 1)]
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.abs(BASELINE * FOCAL / moved - BASELINE * FOCAL / disparity)
    return np.where(gap > _EDGE_STEP, moved, disparity)


def _measure(disparity: Array, scale: float, rng: np.random.Generator) -> Array:
    """Depth, m, 0 = none, from true disparities, px, 0 = none."""
    noise = rng.standard_normal(disparity.shape)
    there = disparity > 0
    depth = BASELINE * FOCAL / np.where(there, disparity, 1.0)
    spread = scale * kinect_depth_std(depth) * BASELINE * FOCAL / depth**2
    spread = np.sqrt(np.maximum(spread**2 - 1.0 / (12.0 * STEPS_PER_PIXEL**2), 0.0))
    steps = np.rint((disparity + noise * spread) * STEPS_PER_PIXEL)
    measured = BASELINE * FOCAL * STEPS_PER_PIXEL / np.maximum(steps, 1.0)
    good = there & (steps > 0) & (measured >= RANGE[0]) & (measured <= RANGE[1])
    return np.where(good, measured, 0.0)


def draw(rng: np.random.Generator) -> Kinect:
    """The camera; nothing about it varies."""
    return Kinect()
