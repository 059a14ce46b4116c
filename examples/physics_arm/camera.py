"""A depth camera as a robot's head may carry one: the engine's rays, with the errors of an active stereo camera.

Disparity noise is correlated over a matching window; where depth jumps, a pixel may show its neighbour's surface, or
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from examples.physics_arm.rays import cast
from examples.physics_arm.world import World
from pretouch.camera import Camera
from pretouch.geometry import Pose

Array = NDArray[np.float64]

WIDTH, HEIGHT = 640, 480
INTRINSICS = Camera(fx=600.0, fy=600.0, cx=319.5, cy=239.5)
DEPTH_UNIT = 0.0005  # m
_BASELINE = 0.055  # m
_DISPARITY_STD = 0.10  # pixels
_WINDOW = 2  # pixels: radius over which neighbouring pixels share their errors
_JUMP = 0.02  # m
_LOST = 0.3
"""Share of the pixels beside a jump that show nothing."""


@dataclass(frozen=True, eq=False)
class View:
    """What the camera delivers, and what is true of it.

    Attributes:
        depth: (h, w) uint16, in DEPTH_UNIT; 0 is no data.
        base_T_camera: the camera's true pose.
        object_points: (n, 3), m, in the camera's frame: where the object's surface truly is in its pixels.
    """

    depth: NDArray[np.uint16]
    base_T_camera: Pose
    object_points: Array


def photograph(world: World, random: np.random.Generator) -> View:
    """The world from 0.8 to 1.0 m away, 40 to 50 degrees down, from the side where the arm is not."""
    base_T_camera = _look_at(world.data.body("object").xpos, random)
    v, u = np.indices((HEIGHT, WIDTH))
    ahead = INTRINSICS.back_project(np.stack([u, v], axis=-1), np.ones((HEIGHT, WIDTH))).reshape(-1, 3)
    lengths = np.linalg.norm(ahead, axis=1)
    distances, geoms = cast(world, base_T_camera.translation, base_T_camera.rotate(ahead / lengths[:, None]))
    true = (distances / lengths).reshape(HEIGHT, WIDTH)
    depth = _add_errors(true, random)
    seen = np.isin(geoms, world.object_geoms()).reshape(HEIGHT, WIDTH) & (depth > 0)
    return View(depth, base_T_camera, INTRINSICS.back_project_image(true)[seen])


def _look_at(target: Array, random: np.random.Generator) -> Pose:
    distance, down = random.uniform(0.8, 1.0), np.radians(random.uniform(40, 50))
    around = np.radians(random.uniform(90, 160))  # about the object, from the base's x: the arm waits at the other side
    back = np.array([np.cos(down) * np.cos(around), np.cos(down) * np.sin(around), np.sin(down)])
    right = np.cross(-back, [0, 0, 1])
    right /= np.linalg.norm(right)
    return Pose.of(np.stack([right, np.cross(-back, right), -back], axis=1), target + distance * back)


def _add_errors(true: Array, random: np.random.Generator) -> NDArray[np.uint16]:
    depth = np.nan_to_num(true)
    shift = np.rint(1.2 * np.stack([_smooth_noise(random), _smooth_noise(random)])).astype(int)
    v, u = np.indices(depth.shape)
    matched = depth[np.clip(v + shift[0], 0, HEIGHT - 1), np.clip(u + shift[1], 0, WIDTH - 1)]
    jump = np.abs(matched - depth) > _JUMP
    depth = np.where(jump, matched, depth)
    disparity = INTRINSICS.fx * _BASELINE / np.maximum(depth, 1e-3) + _DISPARITY_STD * _smooth_noise(random)
    noisy = INTRINSICS.fx * _BASELINE / np.maximum(disparity, 1.0)
    lost = (depth == 0) | (jump & (random.random(depth.shape) < _LOST))
    return np.where(lost, 0, np.rint(noisy / DEPTH_UNIT)).astype(np.uint16)


def _smooth_noise(random: np.random.Generator) -> Array:
    """(h, w) of standard deviation 1, alike within a window."""
    noise = random.standard_normal((HEIGHT, WIDTH))
    for axis in (0, 1):
        noise = np.mean([np.roll(noise, k, axis) for k in range(-_WINDOW, _WINDOW + 1)], axis=0)
    return np.asarray(noise / noise.std())
