"""Boxes on a table: exact depth images, distances of points, and ranges of a finger.

    world = World((Box.standing((0.08, 0.06, 0.05)), Box.standing((0.04, 0.04, 0.1), (0.1, 0.0))))
    scene = world.scene()                        # the first box is the object
    truth = world.moved(correction)              # where everything truly is
    samples = truth.scanned(plan.path, sensor)   # what the finger measures

The table is z = 0 of base unless the world was moved.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.camera import Camera, DepthImage, kinect_depth_std
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import Scene
from pretouch.tof import RangeSamples, Sensor
from pretouch.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Box:
    """A solid box: sides (3,), m, and the pose of its centre in base."""

    sides: Array
    base_T_box: Pose

    @staticmethod
    def standing(sides: ArrayLike, at: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0, lift: float = 0.0) -> Box:
        """A box on the table z = 0, or `lift` above it."""
        size = np.asarray(sides, dtype=np.float64)
        return Box(size, Pose.from_rotation_vector((0, 0, yaw), (*at, size[2] / 2 + lift)))

    def cast(self, origins: Array, directions: Array) -> Array:
        """Beam parameters (...,) at which beams (..., 3) enter the box; inf where they miss it (slab method)."""
        box_T_base = self.base_T_box.inverse()
        start, along = box_T_base.apply(origins), box_T_base.rotate(directions)
        along = np.where(np.abs(along) < 1e-12, 1e-12, along)
        a, b = (-self.sides / 2 - start) / along, (self.sides / 2 - start) / along
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        return np.asarray(np.where((enter <= leave) & (enter >= 0), enter, np.inf), dtype=np.float64)

    def distance(self, points: Array) -> Array:
        """Distance (...,), m, of points (..., 3) from the box; 0 inside."""
        beyond = np.abs(self.base_T_box.inverse().apply(points)) - self.sides / 2
        return np.asarray(np.linalg.norm(np.maximum(beyond, 0), axis=-1), dtype=np.float64)


def looking(at: ArrayLike, distance: float = 0.8, down: float = 45.0, azimuth: float = 180.0) -> Pose:
    """`base_T_camera` of a camera that looks at a point, `down` degrees from the horizontal, from side `azimuth`."""
    pitch, side = np.radians(down), np.radians(azimuth)
    forward = -np.array([np.cos(side) * np.cos(pitch), np.sin(side) * np.cos(pitch), np.sin(pitch)])
    right = np.array([-np.sin(side), np.cos(side), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return Pose.of(rotation, np.asarray(at, dtype=np.float64) - distance * forward)


@dataclass(frozen=True, eq=False)
class View:
    """A camera and where it stands; the default is a quarter of a Kinect's pixels."""

    base_T_camera: Pose = field(default_factory=lambda: looking((0.0, 0.0, 0.02)))
    camera: Camera = field(default_factory=lambda: Camera(262.5, 262.5, 159.5, 119.5))
    width: int = 320
    height: int = 240


KINECT = View(camera=Camera(525.0, 525.0, 319.5, 239.5), width=640, height=480)


@dataclass(frozen=True, eq=False)
class World:
    """Boxes on a table; the first is the object."""

    boxes: tuple[Box, ...]
    table: Plane = field(default_factory=lambda: Plane(np.array([0.0, 0.0, 1.0]), 0.0))

    def cast(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int64]]:
        """Beam parameters (...,) of the first hit, inf for none, and what was hit: a box's index, -1 the table."""
        with np.errstate(divide="ignore", invalid="ignore"):
            table = -self.table.height(origins) / (directions @ self.table.normal)
        hits = np.stack([np.where(table > 0, table, np.inf), *(box.cast(origins, directions) for box in self.boxes)])
        return np.asarray(hits.min(axis=0), dtype=np.float64), hits.argmin(axis=0) - 1

    def distance(self, points: Array) -> Array:
        """Distance (...,), m, of points (..., 3) from the nearest box or the table; 0 inside."""
        boxes = [box.distance(points) for box in self.boxes]
        return np.asarray(np.min([np.maximum(self.table.height(points), 0), *boxes], axis=0), dtype=np.float64)

    def moved(self, base_T_correction: Pose) -> World:
        boxes = tuple(Box(box.sides, base_T_correction @ box.base_T_box) for box in self.boxes)
        return World(boxes, self.table.moved(base_T_correction))

    def depth(
        self, view: View | None = None, noise: np.random.Generator | None = None
    ) -> tuple[DepthImage, NDArray[np.bool_]]:
        """The depth image and the object's mask; with `noise`, the axial noise of a Kinect (Nguyen et al. 2012)."""
        seen = view or View()
        v, u = np.indices((seen.height, seen.width))
        rays = seen.camera.back_project(np.stack([u, v], axis=-1), np.ones(u.shape))
        directions = seen.base_T_camera.rotate(rays)
        depth, what = self.cast(np.broadcast_to(seen.base_T_camera.translation, directions.shape), directions)
        depth = np.where(np.isfinite(depth), depth, 0.0)
        if noise is not None:
            depth = np.where(depth > 0, depth + noise.normal(size=u.shape) * kinect_depth_std(depth), 0)
        return DepthImage(depth.astype(np.float32)), (what == 0) & (depth > 0)

    def scene(self, view: View | None = None, noise: np.random.Generator | None = None) -> Scene:
        """The view with the true mask and table."""
        seen = view or View()
        depth, mask = self.depth(seen, noise)
        return Scene(depth, seen.camera, seen.base_T_camera, mask, self.table)

    def scanned(self, path: Trajectory, sensor: Sensor, noise: np.random.Generator | None = None) -> RangeSamples:
        """The samples of a thin beam along `path`, at the sensor's rate; beyond its range status 7 and no range."""
        tips = path.sampled(sensor.rate)
        ranges, _ = self.cast(tips.base_T_tip[:, :3, 3], tips.base_T_tip[:, :3, 2])
        if noise is not None:
            ranges = ranges + noise.normal(size=len(ranges)) * sensor.range_std
        seen = (ranges >= sensor.range_min) & (ranges <= sensor.range_max)
        zeros = np.zeros(len(ranges), dtype=np.int64)
        return RangeSamples(tips.t, tips.base_T_tip, np.where(seen, ranges, np.nan), np.where(seen, 0, 7), zeros)
